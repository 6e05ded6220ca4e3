/* SPDX-License-Identifier: MIT */
/* Owns the orthonormal non-standard 2-D Haar transform and the light vector made with it. */
#include "prt/light.h"

#include <math.h>
#include <string.h>

static int is_power_of_two(uint32_t n)
{
    return n && !(n & (n - 1));
}

/* One level turns each 2x2 block (a b; c d) into its orthonormal scaling and detail numbers
 * (a+b+c+d)/2, (a-b+c-d)/2, (a+b-c-d)/2, (a-b-c+d)/2 (NRH03's quadrants), put at (x,y),
 * (x+m,y), (x,y+m), (x+m,y+m) with m the half size: Mallat's nested layout. */
void prt_haar_forward(uint32_t n, float *plane)
{
    if (!is_power_of_two(n) || n == 1)
        return;
    float *tmp = prt_alloc((size_t)n * n, sizeof(float));
    if (!tmp)
        return;
    for (uint32_t size = n; size > 1; size /= 2) {
        const uint32_t m = size / 2;
        for (uint32_t y = 0; y < m; y++) {
            const float *r0 = plane + (size_t)(2 * y) * n, *r1 = r0 + n;
            float *o0 = tmp + (size_t)y * size, *o1 = tmp + (size_t)(y + m) * size;
            for (uint32_t x = 0; x < m; x++) {
                const float a = r0[2 * x], b = r0[2 * x + 1], c = r1[2 * x], d = r1[2 * x + 1];
                const float top = a + b, bottom = c + d, dt = a - b, db = c - d;
                o0[x] = 0.5f * (top + bottom);
                o0[x + m] = 0.5f * (dt + db);
                o1[x] = 0.5f * (top - bottom);
                o1[x + m] = 0.5f * (dt - db);
            }
        }
        for (uint32_t y = 0; y < size; y++)
            memcpy(plane + (size_t)y * n, tmp + (size_t)y * size, size * sizeof(float));
    }
    prt_free(tmp);
}

void prt_haar_inverse(uint32_t n, float *plane)
{
    if (!is_power_of_two(n) || n == 1)
        return;
    float *tmp = prt_alloc((size_t)n * n, sizeof(float));
    if (!tmp)
        return;
    for (uint32_t size = 2; size <= n; size *= 2) {
        const uint32_t m = size / 2;
        for (uint32_t y = 0; y < m; y++) {
            const float *i0 = plane + (size_t)y * n, *i1 = plane + (size_t)(y + m) * n;
            float *r0 = tmp + (size_t)(2 * y) * size, *r1 = r0 + size;
            for (uint32_t x = 0; x < m; x++) {
                const float s = i0[x], h = i0[x + m], v = i1[x], d = i1[x + m];
                r0[2 * x] = 0.5f * (s + h + v + d);
                r0[2 * x + 1] = 0.5f * (s - h + v - d);
                r1[2 * x] = 0.5f * (s + h - v - d);
                r1[2 * x + 1] = 0.5f * (s - h - v + d);
            }
        }
        for (uint32_t y = 0; y < size; y++)
            memcpy(plane + (size_t)y * n, tmp + (size_t)y * size, size * sizeof(float));
    }
    prt_free(tmp);
}

int prt_light_from_cube(const struct prt_cube *cube, struct prt_light *out)
{
    const uint32_t n = cube->n;
    const size_t n_face = (size_t)n * n;
    out->n = 0;
    out->coef = NULL;
    if (!is_power_of_two(n) || n < PRT_CUBE_MIN)
        return prt_fail(NULL, PRT_ARG, "cube size %u: a light vector needs a power of two >= %d",
                        n, PRT_CUBE_MIN);
    float *coef = prt_alloc(6 * n_face * 4, sizeof(float));
    float *plane = prt_alloc(n_face, sizeof(float));
    if (!coef || !plane) {
        prt_free(coef);
        prt_free(plane);
        return prt_fail(NULL, PRT_NOMEM, "no memory for a light vector of 6 x %u x %u", n, n);
    }
    for (unsigned face = 0; face < 6; face++) {
        float *dst = coef + face * n_face * 4;
        const float *src = cube->texel + face * n_face * 3;
        for (unsigned c = 0; c < 3; c++) {
            for (size_t i = 0; i < n_face; i++)
                plane[i] = src[i * 3 + c];
            prt_haar_forward(n, plane);
            for (size_t i = 0; i < n_face; i++)
                dst[i * 4 + c] = plane[i];
        }
        for (size_t i = 0; i < n_face; i++)
            dst[i * 4 + 3] = 0;
    }
    prt_free(plane);
    out->coef = coef;
    out->n = n;
    return PRT_OK;
}

void prt_light_finish(struct prt_light *light)
{
    if (!light)
        return;
    prt_free(light->coef);
    light->coef = NULL;
    light->n = 0;
}
