// SPDX-License-Identifier: MIT
// Units of columns with AVX2: the entries of a unit's rows are spread over the lanes of a chunk
// (spread.h).
#include "avx2.h"
#include "prt/columns.h"
#include "spread.h"

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)

PRT_INLINE __m256 spread_half(const int16_t *entry, const char *shuffle)
{
    const __m128i x = _mm_shuffle_epi8(_mm_loadu_si128((const __m128i *)entry),
                                       _mm_loadu_si128((const __m128i *)shuffle));
    return _mm256_cvtepi32_ps(_mm256_cvtepi16_epi32(x));
}

// Units [begin, end) under the first n_light lights. Returns the entries behind them.
PRT_INLINE const int16_t *add_units(const struct column_part *part, uint32_t begin,
                                    uint32_t end, const int16_t *entry, unsigned n_light,
                                    size_t stride, float *sum)
{
    __m256 lo[LIGHT_GROUP], hi[LIGHT_GROUP];
    size_t at[LIGHT_GROUP];
    for (unsigned l = 0; l < n_light; l++) {
        const float *x = part->x[l];
        lo[l] = _mm256_setr_ps(x[0], x[1], x[2], x[0], x[1], x[2], x[0], x[1]);
        hi[l] = _mm256_setr_ps(x[2], x[0], x[1], x[2], x[0], x[1], x[2], 0);
    }
    // copies: a store through `to` might change what `part` points to
    const uint16_t *const units = part->unit;
    for (unsigned l = 0; l < n_light; l++) at[l] = part->at[l];
    for (uint32_t k = begin; k < end; k++) {
        const uint32_t unit = units[k];
        const struct spread *s = &spreads[unit & 31];
        const __m256 a = spread_half(entry, s->shuffle);
        const __m256 b = spread_half(entry + s->half, s->shuffle + 16);
        float *chunk = sum + (unit >> 5) * stride;
        entry += s->n;
        for (unsigned l = 0; l < n_light; l++) {
            float *to = chunk + at[l];
            _mm256_storeu_ps(to, _mm256_fmadd_ps(a, lo[l], _mm256_loadu_ps(to)));
            _mm256_storeu_ps(to + 8, _mm256_fmadd_ps(b, hi[l], _mm256_loadu_ps(to + 8)));
        }
    }
    return entry;
}

#define COLUMNS_NAME prt_columns_avx2
#include "columns_each.h"

PRT_ISA_END
#endif
