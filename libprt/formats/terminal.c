// SPDX-License-Identifier: MIT
// Pictures in a terminal.
#include "terminal.h"

#include <stdbool.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>

enum { LEVELS = 6, PALETTE = LEVELS * LEVELS * LEVELS, MOST_PIXELS = 800, PIECE = 3072 };

// ---- the kind of terminal

static bool begins_with_one_of(const char *text, const char *const words[])
{
    for (; text && *words; words++)
        if (!strncmp(text, *words, strlen(*words))) return true;
    return false;
}

static enum prt_terminal_kind kind_of_environment(void)
{
    static const char *const words[] = {"blocks256", "blocks", "sixel", "kitty"};
    static const char *const kitty_programs[] = {"ghostty", "WezTerm", NULL};
    static const char *const kitty_terms[] = {"xterm-kitty", "xterm-ghostty", NULL};
    static const char *const sixel_programs[] = {"iTerm", "mintty", NULL};
    static const char *const sixel_terms[] = {"foot", "mlterm", "yaft", "contour", NULL};
    const char *said = getenv("RELIGHT_TERMINAL"), *term = getenv("TERM");
    const char *program = getenv("TERM_PROGRAM"), *colors = getenv("COLORTERM");
    for (int i = 0; said && i < 4; i++)
        if (!strcmp(said, words[i])) return (enum prt_terminal_kind)i;
    if (getenv("KITTY_WINDOW_ID") || begins_with_one_of(program, kitty_programs) ||
        begins_with_one_of(term, kitty_terms))
        return PRT_TERMINAL_KITTY;
    if (begins_with_one_of(program, sixel_programs) || begins_with_one_of(term, sixel_terms))
        return PRT_TERMINAL_SIXEL;
    if (colors && (!strcmp(colors, "truecolor") || !strcmp(colors, "24bit")))
        return PRT_TERMINAL_BLOCKS;
    return PRT_TERMINAL_BLOCKS_256;
}

static uint32_t number_of(const char *variable, uint32_t otherwise)
{
    const char *text = getenv(variable);
    long n = text ? strtol(text, NULL, 10) : 0;
    return n > 0 && n < 10000 ? (uint32_t)n : otherwise;
}

void prt_terminal_detect(int fd, struct prt_terminal *out)
{
    struct winsize size = {0};
    *out = (struct prt_terminal){.kind = kind_of_environment()};
    if (ioctl(fd, TIOCGWINSZ, &size)) size = (struct winsize){0};
    out->columns = size.ws_col ? size.ws_col : number_of("COLUMNS", 80);
    out->rows = size.ws_row ? size.ws_row : number_of("LINES", 24);
    out->width = size.ws_xpixel;
    out->height = size.ws_ypixel;
}

// Half blocks that a picture may have, one row of text left for the prompt.
static void block_room(const struct prt_terminal *t, uint32_t *width, uint32_t *height)
{
    *width = t->columns ? t->columns : 1;
    *height = 2 * (t->rows > 1 ? t->rows - 1 : 1);
}

void prt_terminal_fit(const struct prt_terminal *t, uint32_t *width, uint32_t *height)
{
    uint32_t most_width = MOST_PIXELS, most_height = MOST_PIXELS;
    if (t->kind <= PRT_TERMINAL_BLOCKS) block_room(t, &most_width, &most_height);
    else if (t->width && t->height && t->rows) {
        most_width = t->width < MOST_PIXELS ? t->width : MOST_PIXELS;
        most_height = t->height - t->height / t->rows;
    }
    const uint64_t w = *width, h = *height;
    if (!w || !h) return;
    if (w * most_height > h * most_width) {
        *width = most_width;
        *height = (uint32_t)(h * most_width / w);
    } else {
        *height = most_height;
        *width = (uint32_t)(w * most_height / h);
    }
    if (!*width) *width = 1;
    if (!*height) *height = 1;
}

// ---- half blocks

// Means of the picture over to_width x to_height rectangles.
static void reduce(uint32_t width, uint32_t height, const uint8_t *rgb, uint32_t to_width,
                   uint32_t to_height, uint8_t *out)
{
    for (uint64_t y = 0; y < to_height; y++)
        for (uint64_t x = 0; x < to_width; x++) {
            const uint64_t x0 = x * width / to_width, y0 = y * height / to_height;
            uint64_t x1 = (x + 1) * width / to_width, y1 = (y + 1) * height / to_height;
            uint64_t sum[3] = {0}, n = 0;
            if (x1 <= x0) x1 = x0 + 1;
            if (y1 <= y0) y1 = y0 + 1;
            for (uint64_t i = y0; i < y1; i++)
                for (uint64_t k = x0; k < x1; k++, n++)
                    for (int c = 0; c < 3; c++)
                        sum[c] += rgb[3 * (i * width + k) + (uint64_t)c];
            for (int c = 0; c < 3; c++)
                out[3 * (y * to_width + x) + (uint64_t)c] = (uint8_t)((sum[c] + n / 2) / n);
        }
}

// The nearest of the 6 levels of xterm's colour cube.
static int cube_level(uint8_t x)
{
    return x < 48 ? 0 : x < 115 ? 1 : (x - 35) / 40;
}

static int cube_color(const uint8_t *rgb)
{
    return 16 + 36 * cube_level(rgb[0]) + 6 * cube_level(rgb[1]) + cube_level(rgb[2]);
}

static void put_color(FILE *out, bool deep, int ground, const uint8_t *rgb)
{
    if (deep) fprintf(out, "\x1b[%d;2;%d;%d;%dm", ground, rgb[0], rgb[1], rgb[2]);
    else fprintf(out, "\x1b[%d;5;%dm", ground, cube_color(rgb));
}

// Each character is an upper half block: its foreground the upper pixel, its background the
// lower one.
static void put_blocks(FILE *out, bool deep, uint32_t width, uint32_t height,
                       const uint8_t *rgb)
{
    for (uint32_t y = 0; y < height; y += 2) {
        const uint8_t *above = rgb + 3 * (size_t)y * width, *below = above + 3 * (size_t)width;
        for (size_t x = 0; x < width; x++) {
            const uint8_t *a = above + 3 * x, *b = below + 3 * x;
            const bool last = y + 1 == height;
            if (!x || memcmp(a, a - 3, 3)) put_color(out, deep, 38, a);
            if (!last && (!x || memcmp(b, b - 3, 3))) put_color(out, deep, 48, b);
            fputs("\xe2\x96\x80", out);
        }
        fputs("\x1b[0m\n", out);
    }
}

static int draw_blocks(FILE *out, const struct prt_terminal *t, uint32_t width, uint32_t height,
                       const uint8_t *rgb)
{
    struct prt_terminal blocks = *t;
    uint32_t w = width, h = height;
    if (blocks.kind > PRT_TERMINAL_BLOCKS) blocks.kind = PRT_TERMINAL_BLOCKS;
    prt_terminal_fit(&blocks, &w, &h);
    if (w > width) w = width, h = height; // never larger than it is
    uint8_t *small = malloc((size_t)w * h * 3);
    if (!small) return -1;
    reduce(width, height, rgb, w, h, small);
    put_blocks(out, t->kind == PRT_TERMINAL_BLOCKS, w, h, small);
    free(small);
    return 0;
}

// ---- sixels

// The palette's colour of a pixel, dithered with an ordered 4 x 4 pattern.
static int sixel_color(const uint8_t *rgb, uint32_t x, uint32_t y)
{
    static const uint8_t pattern[4][4] = {
        {0, 8, 2, 10}, {12, 4, 14, 6}, {3, 11, 1, 9}, {15, 7, 13, 5}};
    int color = 0;
    for (int c = 0; c < 3; c++) {
        const int scaled = rgb[c] * (LEVELS - 1) * 16 + 255 * pattern[y & 3][x & 3];
        color = color * LEVELS + scaled / (255 * 16);
    }
    return color;
}

static void put_run(FILE *out, char sixel, uint32_t n)
{
    if (n > 3) fprintf(out, "!%u%c", n, sixel);
    else
        for (; n; n--) fputc(sixel, out);
}

// Six rows: for each colour in them, one character a column whose bits are its rows.
static void put_band(FILE *out, uint32_t width, uint32_t rows, const uint8_t *color)
{
    bool used[PALETTE] = {false}, first = true;
    for (size_t i = 0; i < (size_t)width * rows; i++) used[color[i]] = true;
    for (int c = 0; c < PALETTE; c++) {
        if (!used[c]) continue;
        if (!first) fputc('$', out); // back to the beginning of the band
        first = false;
        fprintf(out, "#%d", c);
        char run = 0;
        uint32_t n = 0;
        for (uint32_t x = 0; x < width; x++) {
            int bits = 0;
            for (uint32_t y = 0; y < rows; y++)
                bits |= (color[(size_t)y * width + x] == c) << y;
            const char sixel = (char)(63 + bits);
            if (n && sixel != run) {
                put_run(out, run, n);
                n = 0;
            }
            run = sixel;
            n++;
        }
        put_run(out, run, n);
    }
    fputc('-', out); // the next band
}

static int draw_sixels(FILE *out, uint32_t width, uint32_t height, const uint8_t *rgb)
{
    uint8_t *color = malloc((size_t)6 * width);
    if (!color) return -1;
    fprintf(out, "\x1bPq\"1;1;%u;%u", width, height);
    for (int c = 0; c < PALETTE; c++)
        fprintf(out, "#%d;2;%d;%d;%d", c, c / 36 * 20, c / 6 % 6 * 20, c % 6 * 20);
    for (uint32_t y = 0; y < height; y += 6) {
        const uint32_t rows = height - y < 6 ? height - y : 6;
        for (uint32_t i = 0; i < rows; i++)
            for (uint32_t x = 0; x < width; x++)
                color[(size_t)i * width + x] =
                    (uint8_t)sixel_color(rgb + 3 * ((size_t)(y + i) * width + x), x, y + i);
        put_band(out, width, rows, color);
    }
    fputs("\x1b\\\n", out);
    free(color);
    return 0;
}

// ---- kitty

static void put_base64(FILE *out, const uint8_t *bytes, size_t n)
{
    static const char digit[] =
        "ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";
    for (size_t i = 0; i < n; i += 3) {
        const size_t left = n - i;
        const uint32_t x = (uint32_t)bytes[i] << 16 |
                           (left > 1 ? (uint32_t)bytes[i + 1] << 8 : 0) |
                           (left > 2 ? bytes[i + 2] : 0);
        fputc(digit[x >> 18], out);
        fputc(digit[x >> 12 & 63], out);
        fputc(left > 1 ? digit[x >> 6 & 63] : '=', out);
        fputc(left > 2 ? digit[x & 63] : '=', out);
    }
}

static int draw_kitty(FILE *out, uint32_t width, uint32_t height, const uint8_t *rgb)
{
    const size_t n = (size_t)width * height * 3;
    for (size_t at = 0; at < n; at += PIECE) {
        const size_t piece = n - at < PIECE ? n - at : PIECE;
        if (!at) fprintf(out, "\x1b_Ga=T,f=24,s=%u,v=%u,m=%d;", width, height, piece < n);
        else fprintf(out, "\x1b_Gm=%d;", at + piece < n);
        put_base64(out, rgb + at, piece);
        fputs("\x1b\\", out);
    }
    fputc('\n', out);
    return 0;
}

int prt_terminal_draw(FILE *out, const struct prt_terminal *t, uint32_t width, uint32_t height,
                      const uint8_t *rgb)
{
    if (!width || !height) return -1;
    int status = t->kind == PRT_TERMINAL_KITTY   ? draw_kitty(out, width, height, rgb)
                 : t->kind == PRT_TERMINAL_SIXEL ? draw_sixels(out, width, height, rgb)
                                                 : draw_blocks(out, t, width, height, rgb);
    return status || fflush(out) || ferror(out) ? -1 : 0;
}
