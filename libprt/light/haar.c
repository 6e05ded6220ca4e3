/* SPDX-License-Identifier: MIT */
/* The orthonormal non-standard 2-D Haar transform, and the light vector made with it. */
#include "prt/light.h"

#include <assert.h>
#include <string.h>

static int is_power_of_two(uint32_t n)
{
    return n && !(n & (n - 1));
}

enum { COLUMNS = 8 }; /* transformed together; chosen, not measured: half a cache line */

/* One level turns each 2x2 block (a b; c d) into its orthonormal scaling and detail
 * coefficients (a+b+c+d)/2, (a-b+c-d)/2, (a+b-c-d)/2, (a-b-c+d)/2 (NRH03's quadrants), put at
 * (x,y), (x+m,y), (x,y+m), (x+m,y+m) with m the half size: Mallat's nested layout. First along
 * the rows, then along the columns, which take the whole factor 1/2. */
static void rows_forward(uint32_t n, uint32_t size, float *plane, float *tmp)
{
    const uint32_t m = size / 2;
    for (uint32_t y = 0; y < size; y++) {
        float *row = plane + (size_t)y * n;
        for (uint32_t x = 0; x < m; x++) {
            tmp[x] = row[2 * x] + row[2 * x + 1];
            tmp[x + m] = row[2 * x] - row[2 * x + 1];
        }
        memcpy(row, tmp, size * sizeof *tmp);
    }
}

static void columns_forward(uint32_t n, uint32_t size, float *plane, float *tmp)
{
    const uint32_t m = size / 2;
    for (uint32_t x0 = 0; x0 < size; x0 += COLUMNS) {
        const uint32_t count = size - x0 < COLUMNS ? size - x0 : COLUMNS;
        for (uint32_t y = 0; y < m; y++) {
            const float *a = plane + (size_t)(2 * y) * n + x0, *b = a + n;
            for (uint32_t i = 0; i < count; i++) {
                tmp[y * COLUMNS + i] = 0.5f * (a[i] + b[i]);
                tmp[(y + m) * COLUMNS + i] = 0.5f * (a[i] - b[i]);
            }
        }
        for (uint32_t y = 0; y < size; y++)
            memcpy(plane + (size_t)y * n + x0, tmp + y * COLUMNS, count * sizeof *tmp);
    }
}

static void columns_inverse(uint32_t n, uint32_t size, float *plane, float *tmp)
{
    const uint32_t m = size / 2;
    for (uint32_t x0 = 0; x0 < size; x0 += COLUMNS) {
        const uint32_t count = size - x0 < COLUMNS ? size - x0 : COLUMNS;
        for (uint32_t y = 0; y < m; y++) {
            const float *s = plane + (size_t)y * n + x0, *d = s + (size_t)m * n;
            for (uint32_t i = 0; i < count; i++) {
                tmp[2 * y * COLUMNS + i] = 0.5f * (s[i] + d[i]);
                tmp[(2 * y + 1) * COLUMNS + i] = 0.5f * (s[i] - d[i]);
            }
        }
        for (uint32_t y = 0; y < size; y++)
            memcpy(plane + (size_t)y * n + x0, tmp + y * COLUMNS, count * sizeof *tmp);
    }
}

static void rows_inverse(uint32_t n, uint32_t size, float *plane, float *tmp)
{
    const uint32_t m = size / 2;
    for (uint32_t y = 0; y < size; y++) {
        float *row = plane + (size_t)y * n;
        for (uint32_t x = 0; x < m; x++) {
            tmp[2 * x] = row[x] + row[x + m];
            tmp[2 * x + 1] = row[x] - row[x + m];
        }
        memcpy(row, tmp, size * sizeof *tmp);
    }
}

void prt_haar_forward(uint32_t n, float *plane)
{
    float tmp[PRT_CUBE_MAX * COLUMNS]; /* 64 KiB */
    assert(is_power_of_two(n) && n <= PRT_CUBE_MAX);
    for (uint32_t size = n; size > 1; size /= 2) {
        rows_forward(n, size, plane, tmp);
        columns_forward(n, size, plane, tmp);
    }
}

void prt_haar_inverse(uint32_t n, float *plane)
{
    float tmp[PRT_CUBE_MAX * COLUMNS];
    assert(is_power_of_two(n) && n <= PRT_CUBE_MAX);
    for (uint32_t size = 2; size <= n; size *= 2) {
        columns_inverse(n, size, plane, tmp);
        rows_inverse(n, size, plane, tmp);
    }
}

typedef float rgbx __attribute__((vector_size(16)));

/* prt_haar_forward of three channels at once, with the same sums in the same order. Each level
 * stores its details at their final position in `out` and its scaling coefficients at the front
 * of `texel`. */
static void texels_forward(uint32_t n, rgbx *texel, rgbx *out)
{
    const rgbx half = {0.5f, 0.5f, 0.5f, 0.5f};
    for (uint32_t size = n; size > 1; size /= 2) {
        const uint32_t m = size / 2;
        for (uint32_t y = 0; y < m; y++) {
            const rgbx *a = texel + (size_t)(2 * y) * size, *b = a + size;
            rgbx *top = out + (size_t)y * n, *low = top + (size_t)m * n;
            for (uint32_t x = 0; x < m; x++) {
                rgbx as = a[2 * x] + a[2 * x + 1], ad = a[2 * x] - a[2 * x + 1];
                rgbx bs = b[2 * x] + b[2 * x + 1], bd = b[2 * x] - b[2 * x + 1];
                texel[(size_t)y * m + x] = half * (as + bs);
                top[m + x] = half * (ad + bd);
                low[x] = half * (as - bs);
                low[m + x] = half * (ad - bd);
            }
        }
    }
    out[0] = texel[0];
}

int prt_light_from_cube(const struct prt_cube *cube, struct prt_light *out)
{
    const uint32_t n = cube->n;
    const size_t n_face = (size_t)n * n;
    out->n = 0;
    out->coef = NULL;
    if (!is_power_of_two(n) || n < PRT_CUBE_MIN)
        return prt_fail(NULL, PRT_ARG,
                        "cube size %u: a light vector needs a power of two >= %d", n,
                        PRT_CUBE_MIN);
    float *coef = prt_alloc(6 * n_face * 4, sizeof(float));
    rgbx *plane = prt_alloc(n_face, sizeof *plane);
    if (!coef || !plane) {
        prt_free(coef);
        prt_free(plane);
        return prt_fail(NULL, PRT_NOMEM, "no memory for a light vector of 6 x %u x %u", n, n);
    }
    for (unsigned face = 0; face < 6; face++) {
        const float *src = cube->texel + face * n_face * 3;
        for (size_t i = 0; i < n_face; i++)
            plane[i] = (rgbx){src[3 * i], src[3 * i + 1], src[3 * i + 2], 0};
        texels_forward(n, plane, (rgbx *)(coef + face * n_face * 4));
    }
    prt_free(plane);
    out->coef = coef;
    out->n = n;
    return PRT_OK;
}

void prt_light_finish(struct prt_light *light)
{
    if (!light) return;
    prt_free(light->coef);
    light->coef = NULL;
    light->n = 0;
}
