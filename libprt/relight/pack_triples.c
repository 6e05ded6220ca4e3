// SPDX-License-Identifier: MIT
// Coefficients in the packed format, 32 triples at a time.
#include "pack_triples.h"

#include "base/isa.h"

#include <math.h>
#include <string.h>

struct pack_loops {
    float (*largest)(const float *x, size_t n);
    void (*pack)(const float number[6][16], uint32_t out[2][16]);
};

#define PRT_KERNEL_FILE "relight/pack_triples_kernel.h"
#include "base/isa_each.h"

static const struct pack_loops *loops_of(unsigned cpu)
{
#if PRT_ISA_X86
    if (cpu & PRT_CPU_AVX512) return &pack_loops_avx512;
    if (cpu & PRT_CPU_AVX2) return &pack_loops_avx2;
#endif
    return &pack_loops_c;
}

float prt_largest_magnitude(unsigned cpu, const float *x, size_t n)
{
    return loops_of(cpu)->largest(x, n);
}

void prt_pack_triples(unsigned cpu, const float *rgb, float factor, size_t n, uint32_t *out)
{
    const struct pack_loops *loops = loops_of(cpu);
    float number[6][16];
    uint32_t word[2][16];
    for (size_t first = 0; first < n; first += 32) {
        const size_t m = n - first < 32 ? n - first : 32;
        if (m < 32) memset(number, 0, sizeof number);
        for (size_t i = 0; i < 3 * m; i++) number[i % 6][i / 6] = factor * rgb[3 * first + i];
        loops->pack((const float(*)[16])number, word);
        for (size_t i = 0; i < m + m % 2; i++) out[first + i] = word[i % 2][i / 2];
    }
}
