// SPDX-License-Identifier: MIT
#include "picture_compare.h"

#include "color_difference.h"

#include <math.h>
#include <png.h>
#include <stdlib.h>
#include <string.h>

enum { GAP = 4 };

// ---- numbers

static int by_value(const void *a, const void *b)
{
    float x = *(const float *)a, y = *(const float *)b;
    return (x > y) - (x < y);
}

static float difference(const uint8_t a[3], const uint8_t b[3])
{
    double x[3], y[3];
    if (!memcmp(a, b, 3)) return 0;
    prt_lab_from_srgb8(a, x);
    prt_lab_from_srgb8(b, y);
    return (float)prt_ciede2000(x, y);
}

bool picture_compare(const uint8_t *a, const uint8_t *b, size_t n, float *delta,
                     struct picture_difference *out)
{
    float *sorted = malloc((n + 1) * sizeof *sorted);
    double sum = 0, changed = 0, noticeable = 0;
    *out = (struct picture_difference){0};
    if (!sorted) return false;
    for (size_t i = 0; i < n; i++) {
        sorted[i] = delta[i] = difference(a + 3 * i, b + 3 * i);
        sum += delta[i];
        changed += delta[i] > 0;
        noticeable += delta[i] > 1;
    }
    if (n) {
        qsort(sorted, n, sizeof *sorted, by_value);
        *out = (struct picture_difference){.mean = sum / (double)n,
                                           .median = sorted[n / 2],
                                           .p95 = sorted[(uint64_t)n * 95 / 100],
                                           .most = sorted[n - 1],
                                           .changed = changed / (double)n,
                                           .changed_mean = changed > 0 ? sum / changed : 0,
                                           .noticeable = noticeable / (double)n};
    }
    free(sorted);
    return true;
}

// ---- pictures

struct canvas {
    uint8_t *rgb;
    uint32_t width;
};

static void put(struct canvas *c, uint32_t x, uint32_t y, const uint8_t rgb[3])
{
    memcpy(c->rgb + 3 * ((size_t)y * c->width + x), rgb, 3);
}

// 0 black, 1 blue, 2.5 red, 5 yellow, 10 white: a difference of 1 is seen at once.
static void heat(float delta, uint8_t rgb[3])
{
    static const float at[] = {0, 1, 2.5f, 5, 10};
    static const uint8_t color[][3] = {
        {0, 0, 0}, {40, 40, 150}, {190, 40, 60}, {250, 200, 40}, {255, 255, 255}};
    int i = 0;
    while (i < 3 && delta > at[i + 1]) i++;
    float t = fminf(1, (delta - at[i]) / (at[i + 1] - at[i]));
    for (int k = 0; k < 3; k++)
        rgb[k] =
            (uint8_t)lrintf((float)color[i][k] + t * (float)(color[i + 1][k] - color[i][k]));
}

static void draw_copy(struct canvas *c, uint32_t x0, uint32_t y0, const uint8_t *rgb,
                      uint32_t w, uint32_t h)
{
    for (uint32_t y = 0; y < h; y++)
        memcpy(c->rgb + 3 * ((size_t)(y0 + y) * c->width + x0), rgb + 3 * (size_t)y * w,
               3 * (size_t)w);
}

static void draw_wipe(struct canvas *c, uint32_t x0, uint32_t y0, const uint8_t *a,
                      const uint8_t *b, uint32_t w, uint32_t h)
{
    static const uint8_t line[3] = {255, 255, 255};
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++)
            put(c, x0 + x, y0 + y,
                x == w / 2 ? line : (x < w / 2 ? a : b) + 3 * ((size_t)y * w + x));
}

static void draw_delta(struct canvas *c, uint32_t x0, uint32_t y0, const float *delta,
                       uint32_t w, uint32_t h)
{
    uint8_t rgb[3];
    for (uint32_t y = 0; y < h; y++)
        for (uint32_t x = 0; x < w; x++) {
            heat(delta[(size_t)y * w + x], rgb);
            put(c, x0 + x, y0 + y, rgb);
        }
}

uint8_t *compare_draw(enum compare_layout layout, const uint8_t *a, const uint8_t *b,
                      const float *delta, uint32_t w, uint32_t h, uint32_t *out_w,
                      uint32_t *out_h)
{
    bool sheet = layout == COMPARE_SHEET, wide = sheet || layout == COMPARE_SIDE;
    *out_w = wide ? 2 * w + GAP : w;
    *out_h = sheet ? 2 * h + GAP : h;
    uint32_t below = sheet ? h + GAP : 0, right = sheet ? w + GAP : 0;
    struct canvas c = {malloc(3 * (size_t)*out_w * *out_h), *out_w};
    if (!c.rgb) return NULL;
    memset(c.rgb, 128, 3 * (size_t)*out_w * *out_h);
    if (wide) {
        draw_copy(&c, 0, 0, a, w, h);
        draw_copy(&c, w + GAP, 0, b, w, h);
    }
    if (sheet || layout == COMPARE_WIPE) draw_wipe(&c, 0, below, a, b, w, h);
    if (sheet || layout == COMPARE_DELTA) draw_delta(&c, right, below, delta, w, h);
    return c.rgb;
}

void *encode_png(const uint8_t *rgb, uint32_t width, uint32_t height, size_t *n)
{
    png_image image = {.version = PNG_IMAGE_VERSION,
                       .width = width,
                       .height = height,
                       .format = PNG_FORMAT_RGB};
    png_alloc_size_t size = PNG_IMAGE_PNG_SIZE_MAX(image);
    void *bytes = malloc(size);
    if (!bytes) return NULL;
    if (!png_image_write_to_memory(&image, bytes, &size, 0, rgb, 0, NULL)) {
        free(bytes);
        return NULL;
    }
    *n = size;
    return bytes;
}
