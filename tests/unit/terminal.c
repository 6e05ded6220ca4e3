// SPDX-License-Identifier: MIT
// Pictures in a terminal: what each kind writes is read back as a terminal reads it, and has
// the colours of the picture; kinds and sizes follow the environment.
#include "terminal.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { W = 20, H = 13 };
static uint8_t picture[H][W][3];

static int begin(void **state)
{
    static const char *const names[] = {
        "RELIGHT_TERMINAL", "TERM",    "TERM_PROGRAM", "KITTY_WINDOW_ID",
        "COLORTERM",        "COLUMNS", "LINES"};
    for (size_t i = 0; i < sizeof names / sizeof *names; i++) unsetenv(names[i]);
    for (int y = 0; y < H; y++)
        for (int x = 0; x < W; x++) {
            picture[y][x][0] = (uint8_t)(x * 12);
            picture[y][x][1] = (uint8_t)(y * 19);
            picture[y][x][2] = (uint8_t)((x * y) % 256);
        }
    return 0;
}

static char *draw(const struct prt_terminal *t, uint32_t width, uint32_t height,
                  const uint8_t *rgb)
{
    char *text = NULL;
    size_t n = 0;
    FILE *out = open_memstream(&text, &n);
    assert_int_equal(prt_terminal_draw(out, t, width, height, rgb), 0);
    fclose(out);
    return text;
}

static int sextet(char c)
{
    static const char digits[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    const char *at = strchr(digits, c);
    return c && at ? (int)(at - digits) : -1;
}

static void kitty(void **state)
{
    enum { WIDE = 70, HIGH = 50, N = WIDE * HIGH * 3 };
    static uint8_t rgb[N], got[N + 3];
    const struct prt_terminal t = {.kind = PRT_TERMINAL_KITTY, .columns = 80, .rows = 24};
    for (int i = 0; i < N; i++) rgb[i] = (uint8_t)(i * 7);
    char *text = draw(&t, WIDE, HIGH, rgb);
    size_t n = 0;
    assert_true(!strncmp(text, "\x1b_Ga=T,f=24,s=70,v=50,m=1;", 26));
    for (const char *at = text; (at = strstr(at, "\x1b_G"));) {
        bool last = !strstr(at + 3, "\x1b_G");
        const char *data = strchr(at, ';') + 1;
        assert_int_equal(data[-2], last ? '0' : '1');
        for (; sextet(*data) >= 0; data += 4, n += 3) {
            int v[4];
            for (int i = 0; i < 4; i++) v[i] = sextet(data[i]) < 0 ? 0 : sextet(data[i]);
            assert_true(n < N);
            got[n] = (uint8_t)(v[0] << 2 | v[1] >> 4);
            got[n + 1] = (uint8_t)(v[1] << 4 | v[2] >> 2);
            got[n + 2] = (uint8_t)(v[2] << 6 | v[3]);
        }
        at = data;
    }
    assert_memory_equal(got, rgb, N);
    free(text);
}

// Reads sixels as a terminal does; every pixel has to be set exactly once.
static void sixels(void **state)
{
    const struct prt_terminal t = {.kind = PRT_TERMINAL_SIXEL, .columns = 80, .rows = 24};
    static int palette[256][3], seen[H][W][4];
    char *text = draw(&t, W, H, &picture[0][0][0]);
    int color = -1, x = 0, y = 0, times = 1;
    assert_true(!strncmp(text, "\x1bPq\"1;1;20;13", 13));
    char *at = text + 13;
    while (*at != '\x1b') {
        if (*at == '#') {
            color = (int)strtol(at + 1, &at, 10);
            if (*at == ';')
                assert_int_equal(sscanf(at, ";2;%d;%d;%d", &palette[color][0],
                                        &palette[color][1], &palette[color][2]),
                                 3);
            while (*at == ';' || (*at >= '0' && *at <= '9')) at++;
        } else if (*at == '!') {
            times = (int)strtol(at + 1, &at, 10);
        } else if (*at == '$' || *at == '-') {
            if (*at++ == '-') y += 6;
            x = 0;
        } else {
            for (; times; times--, x++)
                for (int i = 0; i < 6; i++)
                    if ((*at - 63) >> i & 1) {
                        assert_true(x < W && y + i < H && color >= 0);
                        for (int c = 0; c < 3; c++) seen[y + i][x][c] = palette[color][c];
                        seen[y + i][x][3]++;
                    }
            times = 1;
            at++;
        }
    }
    double sum[2][3] = {{0}};
    for (int i = 0; i < H; i++)
        for (int k = 0; k < W; k++) {
            assert_int_equal(seen[i][k][3], 1);
            for (int c = 0; c < 3; c++) {
                sum[0][c] += picture[i][k][c];
                sum[1][c] += seen[i][k][c] * 2.55;
                assert_true(abs(picture[i][k][c] - (int)(seen[i][k][c] * 2.55)) <= 52);
            }
        }
    // The dither keeps the mean.
    for (int c = 0; c < 3; c++) assert_true(abs((int)(sum[0][c] - sum[1][c])) < 8 * W * H);
    free(text);
}

// Two pixels a character, the upper one in front. A picture that fits is shown pixel by pixel.
static void half_blocks(void **state)
{
    const struct prt_terminal t = {.kind = PRT_TERMINAL_BLOCKS, .columns = 80, .rows = 24};
    char *text = draw(&t, W, H, &picture[0][0][0]);
    int front[3] = {0}, back[3] = {0}, x = 0, y = 0, ground, rgb[3];
    for (const char *at = text; *at;) {
        if (!strncmp(at, "\x1b[0m\n", 5)) {
            assert_int_equal(x, W);
            at += 5, x = 0, y += 2;
        } else if (*at == '\x1b') {
            assert_int_equal(sscanf(at, "\x1b[%d;2;%d;%d;%dm", &ground, rgb, rgb + 1, rgb + 2),
                             4);
            memcpy(ground == 38 ? front : back, rgb, sizeof rgb);
            at = strchr(at, 'm') + 1;
        } else {
            assert_true(!strncmp(at, "\xe2\x96\x80", 3));
            for (int c = 0; c < 3; c++) {
                assert_int_equal(front[c], picture[y][x][c]);
                if (y + 1 < H) assert_int_equal(back[c], picture[y + 1][x][c]);
            }
            at += 3, x++;
        }
    }
    assert_int_equal(y, H + 1);
    free(text);
}

// A larger one is averaged: one colour stays that colour, and the shape fits.
static void large_pictures_are_reduced(void **state)
{
    static uint8_t grey[300][400][3];
    const struct prt_terminal t = {.kind = PRT_TERMINAL_BLOCKS_256, .columns = 40, .rows = 30};
    memset(grey, 135, sizeof grey);
    char *text = draw(&t, 400, 300, &grey[0][0][0]);
    unsigned lines = 0, blocks = 0;
    for (const char *at = text; *at; at++) {
        lines += *at == '\n';
        blocks += !strncmp(at, "\xe2\x96\x80", 3);
        if (!strncmp(at, "8;5;", 4)) assert_int_equal(atoi(at + 4), 16 + 2 * (36 + 6 + 1));
    }
    assert_int_equal(lines, 15);
    assert_int_equal(blocks, 40 * 15);
    free(text);
}

// Each channel gets the nearest of the levels that xterm's colour cube has.
static void nearest_of_256_colours(void **state)
{
    static const int level[6] = {0, 95, 135, 175, 215, 255};
    const struct prt_terminal t = {.kind = PRT_TERMINAL_BLOCKS_256, .columns = 4, .rows = 4};
    for (int i = 0; i < 256; i++) {
        const uint8_t rgb[3] = {(uint8_t)i, (uint8_t)(255 - i), (uint8_t)(i * 7)};
        char *text = draw(&t, 1, 1, rgb);
        int code = 0;
        assert_int_equal(sscanf(text, "\x1b[38;5;%dm", &code), 1);
        assert_in_range(code, 16, 231);
        for (int c = 0; c < 3; c++) {
            const int got = level[(code - 16) / (c == 0 ? 36 : c == 1 ? 6 : 1) % 6];
            for (int k = 0; k < 6; k++)
                assert_true(abs(got - rgb[c]) <= abs(level[k] - rgb[c]));
        }
        free(text);
    }
}

// A pixel of a reduced picture is the mean of what it covers, rounded to the nearest.
static void means_are_rounded(void **state)
{
    const struct prt_terminal t = {.kind = PRT_TERMINAL_BLOCKS, .columns = 1, .rows = 2};
    for (int round = 0; round < 64; round++) {
        uint8_t rgb[4][2][3]; // two columns and four rows: one character
        int got[2][3];
        for (int i = 0; i < 24; i++) rgb[i / 6][i / 3 % 2][i % 3] = (uint8_t)(i * i * round);
        char *text = draw(&t, 2, 4, &rgb[0][0][0]);
        assert_int_equal(sscanf(text, "\x1b[38;2;%d;%d;%dm\x1b[48;2;%d;%d;%dm", &got[0][0],
                                &got[0][1], &got[0][2], &got[1][0], &got[1][1], &got[1][2]),
                         6);
        for (int k = 0; k < 2; k++)
            for (int c = 0; c < 3; c++) {
                const int sum = rgb[2 * k][0][c] + rgb[2 * k][1][c] + rgb[2 * k + 1][0][c] +
                                rgb[2 * k + 1][1][c];
                assert_int_equal(got[k][c], (sum + 2) / 4);
            }
        free(text);
    }
}

static void sizes(void **state)
{
    struct prt_terminal t = {.kind = PRT_TERMINAL_BLOCKS, .columns = 80, .rows = 25};
    uint32_t w = 800, h = 600;
    prt_terminal_fit(&t, &w, &h);
    assert_int_equal(w, 64);
    assert_int_equal(h, 48);
    t = (struct prt_terminal){PRT_TERMINAL_KITTY, 80, 20, 1600, 400};
    w = 800, h = 600;
    prt_terminal_fit(&t, &w, &h);
    assert_int_equal(h, 380);
    w = 1, h = 1000000;
    prt_terminal_fit(&t, &w, &h);
    assert_int_equal(w, 1);
    assert_int_equal(prt_terminal_draw(stderr, &t, 0, 5, &picture[0][0][0]), -1);
}

static enum prt_terminal_kind kind_with(const char *name, const char *value)
{
    struct prt_terminal t;
    setenv(name, value, 1);
    prt_terminal_detect(-1, &t);
    unsetenv(name);
    assert_true(t.columns == 80 && t.rows == 24);
    return t.kind;
}

static void environment(void **state)
{
    struct prt_terminal t;
    assert_int_equal(kind_with("TERM", "xterm-256color"), PRT_TERMINAL_BLOCKS_256);
    assert_int_equal(kind_with("COLORTERM", "truecolor"), PRT_TERMINAL_BLOCKS);
    assert_int_equal(kind_with("TERM", "xterm-kitty"), PRT_TERMINAL_KITTY);
    assert_int_equal(kind_with("TERM_PROGRAM", "WezTerm"), PRT_TERMINAL_KITTY);
    assert_int_equal(kind_with("TERM", "foot-extra"), PRT_TERMINAL_SIXEL);
    setenv("RELIGHT_TERMINAL", "blocks", 1);
    assert_int_equal(kind_with("TERM", "xterm-kitty"), PRT_TERMINAL_BLOCKS);
    unsetenv("RELIGHT_TERMINAL");
    setenv("COLUMNS", "132", 1);
    setenv("LINES", "-3", 1);
    prt_terminal_detect(-1, &t);
    assert_true(t.columns == 132 && t.rows == 24);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup(kitty, begin),
        cmocka_unit_test_setup(sixels, begin),
        cmocka_unit_test_setup(half_blocks, begin),
        cmocka_unit_test_setup(large_pictures_are_reduced, begin),
        cmocka_unit_test_setup(nearest_of_256_colours, begin),
        cmocka_unit_test_setup(means_are_rounded, begin),
        cmocka_unit_test_setup(sizes, begin),
        cmocka_unit_test_setup(environment, begin),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
