// SPDX-License-Identifier: MIT
// Which kernels run, and the table of several lights.
#include "kernels.h"

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

void relight_fill_table(unsigned n_light, const float *const coef[], uint32_t begin,
                        uint32_t end, float *table)
{
    const size_t unused = LIGHT_LANES - 3 * (size_t)n_light;
    for (uint32_t i = begin; i < end; i++) {
        float *row = table + (size_t)LIGHT_LANES * i;
        // four floats at a time, each overwritten by the next light: straight to the table,
        // since reading a row back that was stored in pieces waits for all of them
        for (unsigned l = 0; l + 1 < n_light; l++)
            memcpy(row + 3 * l, coef[l] + 4 * (size_t)i, 16);
        memcpy(row + 3 * (n_light - 1), coef[n_light - 1] + 4 * (size_t)i, 12);
        memset(row + 3 * n_light, 0, unused * sizeof *row);
    }
}
