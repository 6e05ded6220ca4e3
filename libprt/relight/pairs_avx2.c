// SPDX-License-Identifier: MIT
// Rows of pairs under eight lights, four, or one, in 16-bit integers with AVX2: one instruction
// multiplies a pair's two entries with their coefficients and adds the products. kernels.h says
// how lights become integers; the sum of a block of entries stays within 32 bits
// (PRT_PAIR_MOST), sums of blocks are added as floats.
#include "avx2.h"

#include <string.h>

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)

// Coefficient i of light l times its factor, rounded; 0 for a light that does not exist.
PRT_INLINE __m128i rounded(const struct integer_lights *q, unsigned n_light,
                           const float *const coef[], unsigned l, uint32_t i, __m128 gain)
{
    if (l >= n_light) return _mm_setzero_si128();
    const __m128 factor = _mm_mul_ps(_mm_loadu_ps(q->scale[l]), gain);
    return _mm_cvtps_epi32(_mm_mul_ps(_mm_loadu_ps(coef[l] + 4 * (size_t)i), factor));
}

void prt_integer_lights_fill_avx2(const struct integer_lights *q, unsigned n_light,
                                  const float *const coef[], uint32_t begin, uint32_t end)
{
    const uint32_t n = q->n, line = (uint32_t)__builtin_ctz(n);
    for (uint32_t i = begin; i < end; i++) {
        const __m128 gain = _mm_set1_ps(q->gain[(i | i >> line) & (n - 1)]);
        if (n_light == 1) {
            const __m128i x = rounded(q, 1, coef, 0, i, gain);
            _mm_storel_epi64((__m128i *)(q->lane + 4 * (size_t)i), _mm_packs_epi32(x, x));
            continue;
        }
        // Scaling coefficients saturate; they are not read.
        for (unsigned l = 0; l < 4 && q->lanes == 16; l += 2)
            _mm_store_si128((__m128i *)(q->lane + 16 * (size_t)i + 4 * l),
                            _mm_packs_epi32(rounded(q, n_light, coef, l, i, gain),
                                            rounded(q, n_light, coef, l + 1, i, gain)));
        for (unsigned l = 0; l < 4 && q->lanes == 32; l++)
            _mm_store_si128((__m128i *)(q->lane + 32 * (size_t)i + 8 * l),
                            _mm_packs_epi32(rounded(q, n_light, coef, l, i, gain),
                                            rounded(q, n_light, coef, l + 4, i, gain)));
    }
}

// A pair's integers, two of each channel and one unused lane. `whole`: the 4 bytes behind them
// may be read.
PRT_INLINE __m128i load_pair(const int16_t *entry, bool whole)
{
    int32_t blue;
    if (whole) return _mm_loadu_si128((const __m128i *)entry);
    memcpy(&blue, entry + 4, 4);
    return _mm_insert_epi32(_mm_loadl_epi64((const __m128i *)entry), blue, 2);
}

// Prefetches what lies ahead: rows are read once, from memory.
PRT_INLINE void ask_ahead(const int16_t *entry, const uint16_t *index)
{
    _mm_prefetch((const char *)entry + 1024, _MM_HINT_T0);
    _mm_prefetch((const char *)entry + 1088, _MM_HINT_T0);
    _mm_prefetch((const char *)index + 512, _MM_HINT_T0);
}

// One light. The lanes of a coefficient are r, g, b, 0.

// The products of a pair, its two added in each channel.
PRT_INLINE __m128i one_pair(const int16_t *lane, const uint16_t *index, const int16_t *entry,
                            bool whole)
{
    uint32_t two;
    memcpy(&two, index, 4);
    const __m128i a = _mm_loadl_epi64((const __m128i *)(lane + 4 * (size_t)(two & 0xffff)));
    const __m128i b = _mm_loadl_epi64((const __m128i *)(lane + 4 * (size_t)(two >> 16)));
    return _mm_madd_epi16(_mm_unpacklo_epi16(a, b), load_pair(entry, whole));
}

PRT_INLINE __m128 one_block(const int16_t *lane, const uint16_t *index, const int16_t *entry,
                            const uint32_t n, bool whole)
{
    __m128i x = _mm_setzero_si128(), y = x;
    uint32_t k = 0;
#pragma GCC unroll 4
    for (; k + 4 <= n; k += 4) {
        x = _mm_add_epi32(x, one_pair(lane, index + k, entry + 3 * k, whole));
        y = _mm_add_epi32(y, one_pair(lane, index + k + 2, entry + 3 * k + 6, whole));
    }
    if (k < n) x = _mm_add_epi32(x, one_pair(lane, index + k, entry + 3 * k, whole));
    return _mm_cvtepi32_ps(_mm_add_epi32(x, y));
}

// r, g, b of a row.
PRT_INLINE __m128 one_row(const struct prt_rows *rows, uint32_t row, const int16_t *lane)
{
    __m128 sum = _mm_setzero_ps();
    const uint64_t stop = rows->begin[row + 1], n_entry = rows->begin[rows->n_row];
    uint64_t e = rows->begin[row];
    const uint16_t *index = (const uint16_t *)rows->index + e;
    const int16_t *entry = (const int16_t *)rows->entry + 3 * e;
    for (; e + PRT_PAIR_BLOCK <= stop && e + PRT_PAIR_BLOCK < n_entry; e += PRT_PAIR_BLOCK) {
        ask_ahead(entry, index);
        sum = _mm_add_ps(sum, one_block(lane, index, entry, PRT_PAIR_BLOCK, true));
        index += PRT_PAIR_BLOCK;
        entry += 3 * PRT_PAIR_BLOCK;
    }
    if (e < stop)
        sum = _mm_add_ps(sum, one_block(lane, index, entry, (uint32_t)(stop - e), false));
    return sum;
}

PRT_INLINE void store_rgb(float *out, __m128 x)
{
    _mm_storel_pi((__m64 *)out, x);
    _mm_store_ss(out + 2, _mm_movehl_ps(x, x));
}

// What turns a row's sums into its r, g, b.
struct row_factors {
    __m128 scale, scaling[6];
};

PRT_INLINE struct row_factors load_factors(const struct prt_rows *rows, uint32_t row)
{
    const float *s = rows->scale + 3ull * row;
    struct row_factors out = {.scale = _mm_setr_ps(s[0], s[1], s[2], 0)};
    load_scaling(rows->scaling + 18ull * row, out.scaling);
    return out;
}

PRT_INLINE void finish(const struct row_factors *row, const struct integer_lights *q,
                       unsigned l, __m128 sum, float *out)
{
    sum = _mm_mul_ps(sum, _mm_mul_ps(row->scale, _mm_loadu_ps(q->back[l])));
#pragma GCC unroll 6
    for (int f = 0; f < 6; f++)
        sum = _mm_fmadd_ps(row->scaling[f], _mm_loadu_ps(q->scaling[f][l]), sum);
    store_rgb(out, sum);
}

// Several lights, in 4 vectors of 32 lanes or 2 of 16. Each vector holds two lights: 0 and 1,
// 4 and 5, 2 and 3, 6 and 7; of 16 lanes 0 and 2, 1 and 3.
struct group_integers {
    __m256i x[4];
};
struct group_floats {
    __m256 x[4];
};

// The barrier keeps gcc from adding the products of a whole block in a tree, whose leaves do
// not fit the registers.
PRT_INLINE void add_products(__m256i *sum, __m256i x, __m256i v)
{
    *sum = _mm256_add_epi32(*sum, _mm256_madd_epi16(x, v));
    __asm__("" : "+x"(*sum));
}

PRT_INLINE void group_pair(struct group_integers *s, const int16_t *lane, const uint16_t *index,
                           const int16_t *entry, bool whole, const uint32_t lanes)
{
    const __m256i v = _mm256_broadcastsi128_si256(load_pair(entry, whole));
    const __m256i *first = (const __m256i *)(lane + lanes * (size_t)index[0]);
    const __m256i *second = (const __m256i *)(lane + lanes * (size_t)index[1]);
#pragma GCC unroll 2
    for (uint32_t h = 0; h < lanes / 16; h++) {
        const __m256i a = _mm256_loadu_si256(first + h), b = _mm256_loadu_si256(second + h);
        const __m256i lo = _mm256_unpacklo_epi16(a, b), hi = _mm256_unpackhi_epi16(a, b);
        add_products(&s->x[2 * h], lo, v);
        add_products(&s->x[2 * h + 1], hi, v);
    }
}

PRT_INLINE void group_block(const int16_t *lane, const uint16_t *index, const int16_t *entry,
                            const uint32_t n, bool whole, const uint32_t lanes,
                            struct group_floats *sum)
{
    struct group_integers s;
#pragma GCC unroll 4
    for (uint32_t i = 0; i < lanes / 8; i++) s.x[i] = _mm256_setzero_si256();
#pragma GCC unroll 8
    for (uint32_t k = 0; k < n; k += 2)
        group_pair(&s, lane, index + k, entry + 3 * k, whole, lanes);
#pragma GCC unroll 4
    for (uint32_t i = 0; i < lanes / 8; i++)
        sum->x[i] = _mm256_add_ps(sum->x[i], _mm256_cvtepi32_ps(s.x[i]));
}

PRT_INLINE struct group_floats group_row(const struct prt_rows *rows, uint32_t row,
                                         const int16_t *lane, const uint32_t lanes)
{
    struct group_floats sum;
    const uint64_t stop = rows->begin[row + 1], n_entry = rows->begin[rows->n_row];
    uint64_t e = rows->begin[row];
    const uint16_t *index = (const uint16_t *)rows->index + e;
    const int16_t *entry = (const int16_t *)rows->entry + 3 * e;
#pragma GCC unroll 4
    for (uint32_t i = 0; i < lanes / 8; i++) sum.x[i] = _mm256_setzero_ps();
    for (; e + PRT_PAIR_BLOCK <= stop && e + PRT_PAIR_BLOCK < n_entry; e += PRT_PAIR_BLOCK) {
        ask_ahead(entry, index);
        group_block(lane, index, entry, PRT_PAIR_BLOCK, true, lanes, &sum);
        index += PRT_PAIR_BLOCK;
        entry += 3 * PRT_PAIR_BLOCK;
    }
    if (e < stop) group_block(lane, index, entry, (uint32_t)(stop - e), false, lanes, &sum);
    return sum;
}

// The part of group_floats and its half that hold light l.
PRT_INLINE __m128 light_of(const struct group_floats *sum, unsigned l, const uint32_t lanes)
{
    const __m256 x = sum->x[lanes == 16 ? l & 1 : (l & 2) + (l >> 2)];
    const unsigned half = lanes == 16 ? l >> 1 : l & 1;
    return half ? _mm256_extractf128_ps(x, 1) : _mm256_castps256_ps128(x);
}

// Rows under several lights.
PRT_INLINE void group_rows(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                           const struct integer_lights *q, unsigned n_light, size_t light_pitch,
                           size_t row_pitch, const uint32_t lanes, float *out)
{
    for (uint32_t row = begin; row < end; row++, out += row_pitch) {
        const struct row_factors factors = load_factors(rows, row);
        const struct group_floats sum = group_row(rows, row, q->lane, lanes);
        for (unsigned l = 0; l < n_light; l++)
            finish(&factors, q, l, light_of(&sum, l, lanes), out + l * light_pitch);
    }
}

void prt_pairs_avx2(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const struct integer_lights *q, unsigned n_light, size_t light_pitch,
                    size_t row_pitch, float *out)
{
    if (q->lanes == 32)
        group_rows(rows, begin, end, q, n_light, light_pitch, row_pitch, 32, out);
    if (q->lanes == 16)
        group_rows(rows, begin, end, q, n_light, light_pitch, row_pitch, 16, out);
    for (uint32_t row = begin; row < end && q->lanes == 4; row++, out += row_pitch) {
        const struct row_factors factors = load_factors(rows, row);
        finish(&factors, q, 0, one_row(rows, row, q->lane), out);
    }
}

PRT_ISA_END
#endif
