// SPDX-License-Identifier: MIT
// Units of columns with AVX2: the entries of a unit's rows, which lie together, are moved to
// the lanes of their rows by a shuffle for each half of a chunk.
#include "avx2.h"
#include "prt/columns.h"

#if PRT_ISA_X86
// Of a mask m of rows: how many of the first ones are there; whether row r is; the word of the
// packed entries that goes to a lane; its bytes.
#define ROWS2(m) (((m)&1) + ((m) >> 1 & 1))
#define ROWS3(m) (ROWS2(m) + ((m) >> 2 & 1))
#define ROWS4(m) (ROWS3(m) + ((m) >> 3 & 1))
#define BEFORE(m, r) \
    ((r) == 0 ? 0 : (r) == 1 ? ((m)&1) : (r) == 2 ? ROWS2(m) : (r) == 3 ? ROWS3(m) : ROWS4(m))
// words before lane 8, the third row's b
#define FIRST_HALF(m) (3 * ROWS2(m) + 2 * ((m) >> 2 & 1))
#define WORD(m, lane) \
    (3 * BEFORE(m, (lane) / 3) + (lane) % 3 - ((lane) < 8 ? 0 : FIRST_HALF(m)))
#define HAS(m, lane) ((lane) < 15 && ((m) >> (lane) / 3 & 1))
#define BYTES(m, lane)                               \
    (char)(HAS(m, lane) ? 2 * WORD(m, lane) : -128), \
        (char)(HAS(m, lane) ? 2 * WORD(m, lane) + 1 : -128)
#define HALF(m, a)                                                                           \
    BYTES(m, a), BYTES(m, (a) + 1), BYTES(m, (a) + 2), BYTES(m, (a) + 3), BYTES(m, (a) + 4), \
        BYTES(m, (a) + 5), BYTES(m, (a) + 6), BYTES(m, (a) + 7)
#define MASK(m)                                                                        \
    {                                                                                  \
        {HALF(m, 0), HALF(m, 8)}, FIRST_HALF(m), 3 * BEFORE(m, 4) + 3 * ((m) >> 4 & 1) \
    }
#define MASKS4(m) MASK(m), MASK((m) + 1), MASK((m) + 2), MASK((m) + 3)
#define MASKS16(m) MASKS4(m), MASKS4((m) + 4), MASKS4((m) + 8), MASKS4((m) + 12)

static const struct spread {
    char shuffle[32];
    uint32_t half, n; // words of the first half, and of all
} spreads[32] __attribute__((aligned(64))) = {MASKS16(0), MASKS16(16)};

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
    for (unsigned l = 0; l < n_light; l++) {
        const float *x = part->x[l];
        lo[l] = _mm256_setr_ps(x[0], x[1], x[2], x[0], x[1], x[2], x[0], x[1]);
        hi[l] = _mm256_setr_ps(x[2], x[0], x[1], x[2], x[0], x[1], x[2], 0);
    }
    for (uint32_t k = begin; k < end; k++) {
        const uint32_t unit = part->unit[k];
        const struct spread *s = &spreads[unit & 31];
        const __m256 a = spread_half(entry, s->shuffle);
        const __m256 b = spread_half(entry + s->half, s->shuffle + 16);
        float *chunk = sum + (unit >> 5) * stride;
        entry += s->n;
        for (unsigned l = 0; l < n_light; l++) {
            float *to = chunk + part->at[l];
            _mm256_storeu_ps(to, _mm256_fmadd_ps(a, lo[l], _mm256_loadu_ps(to)));
            _mm256_storeu_ps(to + 8, _mm256_fmadd_ps(b, hi[l], _mm256_loadu_ps(to + 8)));
        }
    }
    return entry;
}

void prt_columns_avx2(const struct column_part *part, size_t n, size_t stride, float *sum)
{
#define CASE(n_light)                                                  \
    case n_light:                                                      \
        entry = add_units(part, k, stop, entry, n_light, stride, sum); \
        break;
    for (const struct column_part *end = part + n; part < end; part++) {
        const int16_t *entry = part->entry;
        uint32_t k = 0;
        // fewer and fewer lights
        for (unsigned l = part->n_light; l; l--) {
            const uint32_t stop = part->n[l - 1];
            switch (l) {
                CASE(1) CASE(2) CASE(3) CASE(4) CASE(5) CASE(6) CASE(7) CASE(8)
            }
            k = stop;
        }
    }
#undef CASE
}

PRT_ISA_END
#endif
