// SPDX-License-Identifier: MIT
// A cube of light as a short list of distant lights.
#include "internal.h"

#include <math.h>
#include <string.h>

static uint32_t compact(uint32_t x)
{
    x &= 0x55555555;
    x = (x | x >> 1) & 0x33333333;
    x = (x | x >> 2) & 0x0f0f0f0f;
    x = (x | x >> 4) & 0x00ff00ff;
    return (x | x >> 8) & 0xffff;
}

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

uint32_t prt_screen_lights_from_cube(const struct prt_cube *cube, uint32_t n,
                                     struct prt_screen_light *out)
{
    uint32_t size = cube->n, side = 1, made = 0;
    double total = 0;
    if (!n) return 0;
    while (side < size) side *= 2;
    for (int pass = 0; pass < 2; pass++) {
        // strata are runs along each face's Z curve; a face ends one, so some lights are kept
        // back for the ends
        double goal = n > 6 ? total / (n - 6) : total * 2, sum[7] = {0};
        for (unsigned face = 0; face < 6; face++) {
            for (uint32_t z = 0; z < side * side; z++) {
                uint32_t x = compact(z), y = compact(z >> 1);
                if (x >= size || y >= size) continue;
                const float *t = cube->texel + (((size_t)face * size + y) * size + x) * 3;
                double omega = prt_cube_solid_angle(size, x, y);
                double power = ((double)t[0] + t[1] + t[2]) * omega;
                if (!pass) {
                    total += power;
                    continue;
                }
                if (sum[6] > 0 && sum[6] + power > goal && made + 1 < n) flush(sum, out, &made);
                float d[3];
                prt_cube_direction(face, (2 * x + 1.0) / size - 1, (2 * y + 1.0) / size - 1, d);
                for (int k = 0; k < 3; k++) {
                    sum[k] += t[k] * omega;
                    sum[3 + k] += d[k] * power;
                }
                sum[6] += power;
            }
            if (pass && n > 6 && made + 1 < n) flush(sum, out, &made);
        }
        if (pass) flush(sum, out, &made);
    }
    return made;
}
