// SPDX-License-Identifier: MIT
// Which kernels run, and the table of several lights.
#include "kernels.h"

#include <math.h>
#include <string.h>

const struct relight_kernels *relight_kernels_for(unsigned cpu)
{
#if defined(__x86_64__)
    if (cpu & PRT_CPU_AVX512VNNI) return &relight_kernels_vnni;
    if (cpu & PRT_CPU_AVX512) return &relight_kernels_avx512;
    if (cpu & PRT_CPU_AVX2) return &relight_kernels_avx2;
#endif
    (void)cpu;
    return &relight_kernels_c;
}

// The power of two that brings the largest coefficient to [2^14, 2^15).
static float half_scale(const struct prt_light *light)
{
    const size_t n = 24 * (size_t)light->n * light->n;
    int32_t most = 0;
    for (size_t i = 0; i < n; i++) {
        int32_t bits;
        memcpy(&bits, light->coef + i, 4);
        bits &= 0x7fffffff;
        most = bits > most ? bits : most;
    }
    const int exponent = (most >> 23) - 127;
    return exponent < -100 || exponent > 100 ? 1 : ldexpf(1, 14 - exponent);
}

void relight_table_head(unsigned n_light, const struct prt_light *const light[],
                        struct light_table *table, float scale[LIGHT_GROUP])
{
    const size_t face = (size_t)light[0]->n * light[0]->n;
    memset(table, 0, sizeof *table);
    for (unsigned l = 0; l < n_light; l++) {
        scale[l] = half_scale(light[l]);
        for (unsigned ch = 0; ch < 3; ch++) {
            table->inverse[3 * l + ch] = 1 / scale[l];
            for (size_t f = 0; f < 6; f++)
                table->scaling[f][3 * l + ch] = light[l]->coef[4 * face * f + ch];
        }
    }
}
