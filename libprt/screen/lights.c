// SPDX-License-Identifier: MIT
// A list of distant lights that stands for an environment cube (METHODS §6).
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static uint32_t compact(uint32_t x)
{
    x &= 0x55555555;
    x = (x | x >> 1) & 0x33333333;
    x = (x | x >> 2) & 0x0f0f0f0f;
    x = (x | x >> 4) & 0x00ff00ff;
    return (x | x >> 8) & 0xffff;
}

// Writes the light of a finished stratum (rgb, power-weighted direction, power) and clears it.
static void flush(double sum[7], struct prt_screen_light *out, uint32_t *n)
{
    double l = sqrt(sum[3] * sum[3] + sum[4] * sum[4] + sum[5] * sum[5]);
    if (sum[6] > 0 && l > 0) {
        for (int k = 0; k < 3; k++) {
            out[*n].rgb[k] = (float)sum[k];
            out[*n].where[k] = (float)(sum[3 + k] / l);
        }
        out[*n].point = false;
        (*n)++;
    }
    memset(sum, 0, 7 * sizeof *sum);
}

// A texel in the order in which strata are cut: face by face along a Z curve.
struct texel {
    float power;
    uint32_t at; // (face n + y) n + x
};

static struct texel *order_texels(const struct prt_cube *cube, size_t *n_out, double *total)
{
    uint32_t size = cube->n, side = 1;
    struct texel *texel = malloc((size_t)6 * size * size * sizeof *texel);
    size_t n = 0;
    while (side < size) side *= 2;
    for (unsigned face = 0; texel && face < 6; face++) {
        for (uint32_t z = 0; z < side * side; z++) {
            uint32_t x = compact(z), y = compact(z >> 1);
            if (x >= size || y >= size) continue;
            uint32_t at = (face * size + y) * size + x;
            const float *t = cube->texel + (size_t)at * 3;
            double power = ((double)t[0] + t[1] + t[2]) * prt_cube_solid_angle(size, x, y);
            texel[n++] = (struct texel){(float)power, at};
            *total += power;
        }
    }
    *n_out = n;
    return texel;
}

// Cuts strata of at most `goal` power, none across faces; a texel above goal is a stratum
// alone. Returns their number; writes them when out is not NULL.
static uint32_t cut(const struct prt_cube *cube, const struct texel *texel, size_t n,
                    double goal, struct prt_screen_light *out)
{
    uint32_t made = 0, size = cube->n;
    size_t face_texels = (size_t)size * size;
    double sum[7] = {0};
    for (size_t i = 0; i < n; i++) {
        bool ends = i % face_texels == 0 || sum[6] + (double)texel[i].power > goal;
        if (sum[6] > 0 && ends) {
            if (out) flush(sum, out, &made);
            else made++;
            memset(sum, 0, sizeof sum);
        }
        sum[6] += (double)texel[i].power;
        if (!out) continue;
        uint32_t at = texel[i].at, x = at % size, y = at / size % size;
        const float *t = cube->texel + (size_t)at * 3;
        double omega = prt_cube_solid_angle(size, x, y);
        float d[3];
        prt_cube_direction((unsigned)(at / face_texels), (2 * x + 1.0) / size - 1,
                           (2 * y + 1.0) / size - 1, d);
        for (int k = 0; k < 3; k++) {
            sum[k] += t[k] * omega;
            sum[3 + k] += d[k] * (double)texel[i].power;
        }
    }
    if (sum[6] > 0) {
        if (out) flush(sum, out, &made);
        else made++;
    }
    return made;
}

uint32_t prt_screen_lights_from_cube(const struct prt_cube *cube, uint32_t n,
                                     struct prt_screen_light *out)
{
    double total = 0;
    size_t n_texel = 0;
    struct texel *texel = n ? order_texels(cube, &n_texel, &total) : NULL;
    uint32_t made = 0;
    if (texel && total > 0 && n >= 6) {
        // the smallest goal that needs no more than n strata
        double lo = 0, hi = total * 2;
        for (int k = 0; k < 24; k++) {
            double goal = (lo + hi) / 2;
            if (cut(cube, texel, n_texel, goal, NULL) > n) lo = goal;
            else hi = goal;
        }
        made = cut(cube, texel, n_texel, hi, out);
    } else if (texel && total > 0) {
        // fewer lights than faces: a single one for all
        struct prt_screen_light six[6];
        uint32_t m = cut(cube, texel, n_texel, total * 2, six);
        double sum[7] = {0};
        for (uint32_t i = 0; i < m; i++) {
            double power = (double)six[i].rgb[0] + six[i].rgb[1] + six[i].rgb[2];
            for (int k = 0; k < 3; k++) {
                sum[k] += six[i].rgb[k];
                sum[3 + k] += power * six[i].where[k];
            }
            sum[6] += power;
        }
        // equal light from all sides has no mean direction: the first face's is taken
        if (!(fabs(sum[3]) + fabs(sum[4]) + fabs(sum[5]) > 1e-9 * sum[6]))
            for (int k = 0; k < 3; k++) sum[3 + k] = six[0].where[k];
        flush(sum, out, &made);
    }
    free(texel);
    return made;
}
