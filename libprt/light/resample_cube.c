/* SPDX-License-Identifier: MIT */
/* Resamples a cubemap to another resolution and turns it by quarters of a circle, exactly: both
 * grids cut a face into rectangles, whose solid angles are in closed form. */
#include "resample.h"

#include <string.h>

struct cut {
    double at;         /* face coordinate in [-1,1] */
    uint32_t src, dst; /* cells of the interval that begins here */
};

/* Merges the edges of n_src and n_dst cells; returns the number of intervals. */
static uint32_t merge_grids(uint32_t n_src, uint32_t n_dst, struct cut *cuts)
{
    uint32_t i = 0, j = 0, count = 0;
    while (i < n_src && j < n_dst) {
        const uint64_t a = (uint64_t)i * n_dst, b = (uint64_t)j * n_src;
        const double at = 2.0 * (double)(a > b ? a : b) / ((double)n_src * n_dst) - 1.0;
        cuts[count++] = (struct cut){at, i, j};
        const uint64_t a1 = a + n_dst, b1 = b + n_src;
        i += a1 <= b1;
        j += b1 <= a1;
    }
    cuts[count].at = 1.0;
    return count;
}

static int scale_cube(const struct prt_cube *src, uint32_t n, struct prt_cube *out)
{
    const size_t n_face = (size_t)n * n, n_src = src->n;
    if (src->n == n) {
        memcpy(out->texel, src->texel, 6 * n_face * 3 * sizeof(float));
        return PRT_OK;
    }
    struct cut *cuts = prt_alloc(n_src + n + 1, sizeof *cuts);
    double *corner = prt_alloc((n_src + n + 1) * 2, sizeof *corner);
    double *acc = prt_calloc(n_face * 6 * 4, sizeof *acc);
    int err = PRT_NOMEM;
    if (!cuts || !corner || !acc) goto done;
    const uint32_t count = merge_grids(src->n, n, cuts);
    double *above = corner, *below = corner + count + 1;
    for (uint32_t r = 0; r <= count; r++) {
        const double t = cuts[r].at;
        for (uint32_t i = 0; i <= count; i++)
            below[i] = atan2(cuts[i].at * t, sqrt(1.0 + t * t + cuts[i].at * cuts[i].at));
        for (uint32_t i = 0; r > 0 && i < count; i++) {
            const double omega = below[i + 1] - below[i] - above[i + 1] + above[i];
            const struct cut *row = &cuts[r - 1];
            for (unsigned face = 0; face < 6; face++) {
                const float *s =
                    src->texel + ((face * n_src + row->src) * n_src + cuts[i].src) * 3;
                double *a = acc + (((size_t)face * n + row->dst) * n + cuts[i].dst) * 4;
                a[0] += omega * s[0];
                a[1] += omega * s[1];
                a[2] += omega * s[2];
                a[3] += omega;
            }
        }
        double *swap = above;
        above = below;
        below = swap;
    }
    for (size_t i = 0; i < 6 * n_face; i++)
        for (int c = 0; c < 3; c++)
            out->texel[i * 3 + c] = (float)(acc[i * 4 + c] / acc[i * 4 + 3]);
    err = PRT_OK;
done:
    prt_free(cuts);
    prt_free(corner);
    prt_free(acc);
    return err;
}

/* Quarter turns permute faces: the face at azimuth phi shows what was at phi + 90 degrees. */
static int quarter_turn(struct prt_cube *cube)
{
    static const unsigned from[6] = {4, 5, 2, 3, 1, 0}; /* +X shows +Z, -X -Z, +Z -X, -Z +X */
    const uint32_t n = cube->n;
    const size_t n_face = (size_t)n * n * 3;
    float *old = prt_alloc(6 * n_face, sizeof *old);
    if (!old) return PRT_NOMEM;
    memcpy(old, cube->texel, 6 * n_face * sizeof *old);
    for (unsigned face = 0; face < 6; face++)
        for (uint32_t y = 0; y < n; y++)
            for (uint32_t x = 0; x < n; x++) {
                uint32_t sx = x, sy = y;
                if (face == 2) sx = n - 1 - y, sy = x;
                if (face == 3) sx = y, sy = n - 1 - x;
                memcpy(cube->texel + face * n_face + ((size_t)y * n + x) * 3,
                       old + from[face] * n_face + ((size_t)sy * n + sx) * 3, 3 * sizeof *old);
            }
    prt_free(old);
    return PRT_OK;
}

int prt_resample_cube_to_cube(const struct prt_cube *src, uint32_t n, unsigned quarters,
                              struct prt_cube *out)
{
    int err = scale_cube(src, n, out);
    for (unsigned i = 0; !err && i < quarters; i++) err = quarter_turn(out);
    return err;
}
