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

void relight_fill_table(unsigned n_light, const struct prt_light *const light[], uint32_t begin,
                        uint32_t end, float *table)
{
    float lanes[LIGHT_LANES + 1] = {0};
    for (uint32_t i = begin; i < end; i++) {
        // four floats at a time, each overwritten by the next light
        for (unsigned l = 0; l < n_light; l++)
            memcpy(lanes + 3 * l, light[l]->coef + 4 * (size_t)i, 16);
        lanes[3 * n_light] = 0;
        memcpy(table + (size_t)LIGHT_LANES * i, lanes, LIGHT_LANES * sizeof *lanes);
    }
}
