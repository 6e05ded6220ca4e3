// SPDX-License-Identifier: MIT
// Units of columns with AVX-512: the entries of a unit's rows, which lie together, are expanded
// to the lanes of their rows.
#include "avx512.h"
#include "prt/columns.h"

#if PRT_ISA_X86
// Of a mask of rows: its lanes.
#define ROW(m, r) ((m) >> (r)&1 ? 7 << 3 * (r) : 0)
#define LANES(m) (ROW(m, 0) | ROW(m, 1) | ROW(m, 2) | ROW(m, 3) | ROW(m, 4))
#define LANES4(m) LANES(m), LANES((m) + 1), LANES((m) + 2), LANES((m) + 3)
#define LANES16(m) LANES4(m), LANES4((m) + 4), LANES4((m) + 8), LANES4((m) + 12)
static const uint16_t lanes[32] = {LANES16(0), LANES16(16)};

PRT_ISA_BEGIN(PRT_ISA_AVX512)

// Units [begin, end) under the first n_light lights. Returns the entries behind them.
PRT_INLINE const int16_t *add_units(const struct column_part *part, uint32_t begin,
                                    uint32_t end, const int16_t *entry, unsigned n_light,
                                    size_t stride, float *sum)
{
    const __m512i rgb = _mm512_setr_epi32(0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 0, 1, 2, 3);
    __m512 x[LIGHT_GROUP];
    size_t at[LIGHT_GROUP];
    for (unsigned l = 0; l < n_light; l++)
        x[l] = _mm512_permutexvar_ps(rgb, _mm512_maskz_loadu_ps(7, part->x[l]));
    // copies: a store through `to` might change what `part` points to
    const uint16_t *const units = part->unit;
    for (unsigned l = 0; l < n_light; l++) at[l] = part->at[l];
    for (uint32_t k = begin; k < end; k++) {
        const uint32_t unit = units[k], mask = lanes[unit & 31];
        const __m512i packed =
            _mm512_cvtepi16_epi32(_mm256_loadu_si256((const __m256i *)entry));
        const __m512 v = _mm512_cvtepi32_ps(_mm512_maskz_expand_epi32((__mmask16)mask, packed));
        float *chunk = sum + (unit >> 5) * stride;
        entry += __builtin_popcount(mask);
        for (unsigned l = 0; l < n_light; l++) {
            float *to = chunk + at[l];
            _mm512_storeu_ps(to, _mm512_fmadd_ps(v, x[l], _mm512_loadu_ps(to)));
        }
    }
    return entry;
}

#define COLUMNS_NAME prt_columns_avx512
#include "columns_each.h"

PRT_ISA_END
#endif
