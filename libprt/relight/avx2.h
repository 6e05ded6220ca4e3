// SPDX-License-Identifier: MIT
// Kernels for AVX2 that one file defines and another one's table names.
#ifndef PRT_RELIGHT_AVX2_H
#define PRT_RELIGHT_AVX2_H

#include "kernels.h"

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
// r, g, b of a row's scaling coefficients; the fourth lanes are not to be stored. Each load
// takes eight bytes, of which six are wanted; that of the last face begins two bytes early.
// Six bytes copied to the stack and loaded as eight would wait for the copy.
PRT_INLINE void load_scaling(const uint16_t *p, __m128 out[6])
{
#pragma GCC unroll 5
    for (int f = 0; f < 5; f++)
        out[f] = _mm_cvtph_ps(_mm_loadl_epi64((const __m128i *)(p + 3 * f)));
    out[5] = _mm_cvtph_ps(_mm_srli_epi64(_mm_loadl_epi64((const __m128i *)(p + 14)), 16));
}

// The n <= 8 halves at p, and zeros behind them. before: the 8 - n halves in front of them may
// be read, too; otherwise they are copied first, which is slower.
PRT_INLINE __m256 halves(const uint16_t *p, uint32_t n, bool before)
{
    static const uint8_t from[32] = {0,    1,    2,    3,    4,    5,    6,    7,
                                     8,    9,    10,   11,   12,   13,   14,   15,
                                     0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80,
                                     0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80, 0x80};
    uint64_t raw[2] = {0, 0};
    if (n == 8) return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)p));
    if (before) {
        const __m128i last = _mm_loadu_si128((const __m128i *)(p - (8 - n)));
        const __m128i places = _mm_loadu_si128((const __m128i *)(from + 2 * (8 - n)));
        return _mm256_cvtph_ps(_mm_shuffle_epi8(last, places));
    }
    memcpy(raw, p, 2 * (size_t)n);
    return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)raw));
}
PRT_ISA_END

void prt_columns_avx2(const struct column_part *part, size_t n, size_t stride, float *sum);
void prt_mixed_avx2(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const float *light, float *out);
void prt_integer_lights_fill_avx2(const struct integer_lights *q, unsigned n_light,
                                  const float *const coef[], uint32_t begin, uint32_t end);
void prt_pairs_avx2(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const struct integer_lights *lights, unsigned n_light, size_t light_pitch,
                    size_t row_pitch, float *out);
// In floating point:
void prt_expand_avx2(const struct expand_job *job);
void prt_radial_avx2(const struct expand_job *job);
// prt_expand_avx2 in 16-bit integers.
void prt_expand_integers_avx2(const struct expand_job *job);
#endif
#endif
