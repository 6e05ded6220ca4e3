// SPDX-License-Identifier: MIT
// Rows of pairs under eight lights, or one, in 16-bit integers with AVX-512 VNNI: one
// instruction takes two entries of eight lights, whose coefficient fills one cache line instead
// of two, or eight entries of one light, whose coefficients nearly fit into the L1 cache.
//
// kernels.h says how lights become integers. The sum of a block of entries stays within 32 bits
// (PRT_PAIR_MOST); sums of blocks are added as floats. Measured on bakes, colours differ from
// those in floating point by at most 1e-4 RMS under lamps and suns, and by 1e-5 under a sky.
#include "avx512.h"

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_VNNI)

// Coefficient i of lights [first, first + 4); 0 for lights that do not exist.
PRT_INLINE __m512 four(const float *const coef[], unsigned first, unsigned n_light, size_t i)
{
    float lane[4][4];
    memset(lane, 0, sizeof lane);
    for (unsigned l = first; l < n_light && l < first + 4; l++)
        memcpy(lane[l - first], coef[l] + 4 * i, 16);
    return _mm512_loadu_ps(lane[0]);
}

PRT_INLINE __m512 four_of_eight(const float *const coef[], unsigned first, size_t i)
{
    __m512 x = _mm512_castps128_ps512(_mm_loadu_ps(coef[first] + 4 * i));
    x = _mm512_insertf32x4(x, _mm_loadu_ps(coef[first + 1] + 4 * i), 1);
    x = _mm512_insertf32x4(x, _mm_loadu_ps(coef[first + 2] + 4 * i), 2);
    return _mm512_insertf32x4(x, _mm_loadu_ps(coef[first + 3] + 4 * i), 3);
}

static void fill_one(const struct integer_lights *q, const float *coef, uint32_t begin,
                     uint32_t end)
{
    const uint32_t n = q->n, line = (uint32_t)__builtin_ctz(n);
    const __m128 scale = _mm_loadu_ps(q->scale[0]);
    for (uint32_t i = begin; i < end; i++) {
        const __m128 gain = _mm_set1_ps(q->gain[(i | i >> line) & (n - 1)]);
        const __m128 x =
            _mm_mul_ps(_mm_loadu_ps(coef + 4 * (size_t)i), _mm_mul_ps(scale, gain));
        const __m128i rounded = _mm_cvtps_epi32(x);
        _mm_storel_epi64((__m128i *)(q->lane + 4 * (size_t)i),
                         _mm_packs_epi32(rounded, rounded));
    }
}

void prt_integer_lights_fill_vnni(const struct integer_lights *q, unsigned n_light,
                                  const float *const coef[], uint32_t begin, uint32_t end)
{
    const uint32_t n = q->n, line = (uint32_t)__builtin_ctz(n);
    const __m512 lo = _mm512_loadu_ps(q->scale[0]), hi = _mm512_loadu_ps(q->scale[4]);
    const bool all = n_light == LIGHT_GROUP;
    if (n_light == 1) {
        fill_one(q, coef[0], begin, end);
        return;
    }
    for (uint32_t i = begin; i < end; i++) {
        __m512 a = all ? four_of_eight(coef, 0, i) : four(coef, 0, n_light, i);
        __m512 b = all ? four_of_eight(coef, 4, i) : four(coef, 4, n_light, i);
        const __m512 gain = _mm512_set1_ps(q->gain[(i | i >> line) & (n - 1)]);
        // Each 16 bytes hold lights l and 4 + l. Scaling coefficients saturate; they are not
        // read.
        const __m512i x = _mm512_cvtps_epi32(_mm512_mul_ps(a, _mm512_mul_ps(lo, gain)));
        const __m512i y = _mm512_cvtps_epi32(_mm512_mul_ps(b, _mm512_mul_ps(hi, gain)));
        _mm512_store_si512(q->lane + 32 * (size_t)i, _mm512_packs_epi32(x, y));
    }
}

// Adds the two products of each pair. Written as an instruction because gcc copies the tied
// operand of the intrinsic.
PRT_INLINE void add_products(__m512i *sum, __m512i x, __m512i y)
{
    __asm__("vpdpwssd %2, %1, %0" : "+v"(*sum) : "v"(x), "v"(y));
}

// Lights 0 to 3, and 4 to 7.
struct integer_sum {
    __m512i lo, hi;
};

// Adds a pair times the lights at its two indices. v holds the pair in each 16 bytes: r, g, b
// and one unused lane, two entries each.
PRT_INLINE void accumulate(struct integer_sum *s, __m512i v, const int16_t *lane,
                           const uint16_t *index)
{
    const __m512i a = _mm512_load_si512(lane + 32 * (size_t)index[0]);
    const __m512i b = _mm512_load_si512(lane + 32 * (size_t)index[1]);
    add_products(&s->lo, _mm512_unpacklo_epi16(a, b), v);
    add_products(&s->hi, _mm512_unpackhi_epi16(a, b), v);
}

struct group_sum {
    __m512 lo, hi;
};

// Adds n entries, at most a block. `whole`: the 4 bytes after the last one may be read.
PRT_INLINE void add_block(const uint16_t *index, const int16_t *entry, const uint32_t n,
                          bool whole, const int16_t *lane, struct group_sum *sum)
{
    struct integer_sum s = {_mm512_setzero_si512(), _mm512_setzero_si512()};
    const uint32_t last = whole ? n : n - 2;
#pragma GCC unroll 8
    for (uint32_t k = 0; k < last; k += 2)
        accumulate(&s,
                   _mm512_broadcast_i32x4(_mm_loadu_si128((const __m128i *)(entry + 3 * k))),
                   lane, index + k);
    if (!whole)
        accumulate(&s, _mm512_broadcast_i32x4(_mm_maskz_loadu_epi16(0x3f, entry + 3 * last)),
                   lane, index + last);
    sum->lo = _mm512_add_ps(sum->lo, _mm512_cvtepi32_ps(s.lo));
    sum->hi = _mm512_add_ps(sum->hi, _mm512_cvtepi32_ps(s.hi));
}

PRT_INLINE struct group_sum row_sum(const struct prt_rows *rows, uint32_t row,
                                    const int16_t *lane)
{
    struct group_sum sum = {_mm512_setzero_ps(), _mm512_setzero_ps()};
    const uint64_t stop = rows->begin[row + 1], n_entry = rows->begin[rows->n_row];
    uint64_t e = rows->begin[row];
    const uint16_t *index = (const uint16_t *)rows->index + e;
    const int16_t *entry = (const int16_t *)rows->entry + 3 * e;
    for (; e + PRT_PAIR_BLOCK <= stop && e + PRT_PAIR_BLOCK < n_entry; e += PRT_PAIR_BLOCK) {
        // rows are read once, from memory: prefetch them
        _mm_prefetch((const char *)entry + 1024, _MM_HINT_T0);
        _mm_prefetch((const char *)entry + 1088, _MM_HINT_T0);
        _mm_prefetch((const char *)index + 512, _MM_HINT_T0);
        add_block(index, entry, PRT_PAIR_BLOCK, true, lane, &sum);
        index += PRT_PAIR_BLOCK;
        entry += 3 * PRT_PAIR_BLOCK;
    }
    if (e < stop) add_block(index, entry, (uint32_t)(stop - e), false, lane, &sum);
    return sum;
}

// Writes r g b of up to four lights to out[light*pitch + ch].
PRT_INLINE void put_lights(__m512 x, unsigned n_light, size_t pitch, float *out)
{
    float lanes[16];
    const unsigned n = n_light < 4 ? n_light : 4;
    if (pitch == 3) {
        const __m512i close =
            _mm512_setr_epi32(0, 1, 2, 4, 5, 6, 8, 9, 10, 12, 13, 14, 0, 0, 0, 0);
        _mm512_mask_storeu_ps(out, (__mmask16)((1u << 3 * n) - 1),
                              _mm512_permutexvar_ps(close, x));
        return;
    }
    _mm512_storeu_ps(lanes, x);
    for (unsigned l = 0; l < n; l++) memcpy(out + l * pitch, lanes + 4 * l, 12);
}

// One light. The lanes of a coefficient are r, g, b, 0.

// Coefficients index[0] and index[1]. Both indices are read at once: reads are the limit.
PRT_INLINE __m128i one_two(const int16_t *lane, const uint16_t *index)
{
    uint32_t two;
    memcpy(&two, index, 4);
    __asm__("" : "+r"(two)); // keeps gcc from reading them one by one
    const int16_t *first = lane + 4 * (size_t)(two & 0xffff);
    const int16_t *second = lane + 4 * (size_t)(two >> 16);
    const __m128i a = _mm_loadl_epi64((const __m128i *)first);
    return _mm_castps_si128(_mm_loadh_pi(_mm_castsi128_ps(a), (const __m64 *)second));
}

PRT_INLINE __m512i one_eight(const int16_t *lane, const uint16_t *index)
{
    const __m256i lo = _mm256_inserti128_si256(_mm256_castsi128_si256(one_two(lane, index)),
                                               one_two(lane, index + 2), 1);
    const __m256i hi = _mm256_inserti128_si256(_mm256_castsi128_si256(one_two(lane, index + 4)),
                                               one_two(lane, index + 6), 1);
    return _mm512_inserti64x4(_mm512_castsi256_si512(lo), hi, 1);
}

// r0 g0 b0 0 r1 g1 b1 0 to r0 r1 g0 g1 b0 b1 0 0, as pairs lie, in each 16 bytes.
PRT_INLINE __m128i side_by_side(void)
{
    return _mm_setr_epi8(0, 1, 8, 9, 2, 3, 10, 11, 4, 5, 12, 13, 6, 7, 14, 15);
}

// Adds eight entries.
PRT_INLINE void one_accumulate(__m512i *sum, const int16_t *lane, const uint16_t *index,
                               const int16_t *entry)
{
    const __m512i apart =
        _mm512_setr_epi32(0, 1, 2, 12, 3, 4, 5, 12, 6, 7, 8, 12, 9, 10, 11, 12);
    const __m512i v = _mm512_permutexvar_epi32(apart, _mm512_maskz_loadu_epi32(0x0fff, entry));
    add_products(
        sum,
        _mm512_shuffle_epi8(one_eight(lane, index), _mm512_broadcast_i32x4(side_by_side())), v);
}

// r, g, b of a row, summed as row_sum sums them.
PRT_INLINE __m128 one_row_sum(const struct prt_rows *rows, uint32_t row, const int16_t *lane)
{
    __m128 sum = _mm_setzero_ps();
    __m128i s = _mm_setzero_si128();
    const uint64_t stop = rows->begin[row + 1];
    uint64_t e = rows->begin[row];
    const uint16_t *index = (const uint16_t *)rows->index + e;
    const int16_t *entry = (const int16_t *)rows->entry + 3 * e;
    for (; e + PRT_PAIR_BLOCK <= stop; e += PRT_PAIR_BLOCK) {
        __m512i a = _mm512_setzero_si512(), b = a;
        // rows are read once, from memory: prefetch them
        _mm_prefetch((const char *)entry + 2048, _MM_HINT_T0);
        _mm_prefetch((const char *)entry + 2112, _MM_HINT_T0);
        _mm_prefetch((const char *)index + 704, _MM_HINT_T0);
        one_accumulate(&a, lane, index, entry);
        one_accumulate(&b, lane, index + 8, entry + 24);
        a = _mm512_add_epi32(a, b);
        const __m256i half =
            _mm256_add_epi32(_mm512_castsi512_si256(a), _mm512_extracti64x4_epi64(a, 1));
        s = _mm_add_epi32(_mm256_castsi256_si128(half), _mm256_extracti128_si256(half, 1));
        sum = _mm_add_ps(sum, _mm_cvtepi32_ps(s));
        index += PRT_PAIR_BLOCK;
        entry += 3 * PRT_PAIR_BLOCK;
    }
    if (e == stop) return sum;
    s = _mm_setzero_si128();
    for (; e < stop; e += 2, index += 2, entry += 6)
        s = _mm_dpwssd_epi32(s, _mm_shuffle_epi8(one_two(lane, index), side_by_side()),
                             _mm_maskz_loadu_epi16(0x3f, entry));
    return _mm_add_ps(sum, _mm_cvtepi32_ps(s));
}

static void pairs_one(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                      const struct integer_lights *q, size_t row_pitch, float *out)
{
    const __m128 back = _mm_loadu_ps(q->back[0]);
    for (uint32_t row = begin; row < end; row++, out += row_pitch) {
        const __m128 scale = _mm_maskz_loadu_ps(7, rows->scale + 3ull * row);
        const uint16_t *scaling = rows->scaling + 18ull * row;
        __m128 sum = _mm_mul_ps(one_row_sum(rows, row, q->lane), _mm_mul_ps(scale, back));
        _mm_prefetch((const char *)(rows->begin + row + 8), _MM_HINT_T0);
        _mm_prefetch((const char *)(scaling + 18 * 8), _MM_HINT_T0);
        _mm_prefetch((const char *)(rows->scale + 3ull * (row + 8)), _MM_HINT_T0);
        for (int f = 0; f < 6; f++, scaling += 3)
            sum = _mm_fmadd_ps(_mm_cvtph_ps(_mm_maskz_loadu_epi16(7, scaling)),
                               _mm_loadu_ps(q->scaling[f][0]), sum);
        _mm_mask_storeu_ps(out, 7, sum);
    }
}

void prt_pairs_vnni(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const struct integer_lights *q, unsigned n_light, size_t light_pitch,
                    size_t row_pitch, float *out)
{
    const __m512 back_lo = _mm512_loadu_ps(q->back[0]), back_hi = _mm512_loadu_ps(q->back[4]);
    if (n_light == 1) {
        pairs_one(rows, begin, end, q, row_pitch, out);
        return;
    }
    for (uint32_t row = begin; row < end; row++, out += row_pitch) {
        struct group_sum sum = row_sum(rows, row, q->lane);
        const __m512 scale =
            _mm512_broadcast_f32x4(_mm_maskz_loadu_ps(7, rows->scale + 3ull * row));
        sum.lo = _mm512_mul_ps(sum.lo, _mm512_mul_ps(scale, back_lo));
        sum.hi = _mm512_mul_ps(sum.hi, _mm512_mul_ps(scale, back_hi));
        const uint16_t *scaling = rows->scaling + 18ull * row;
        for (int f = 0; f < 6; f++, scaling += 3) {
            const __m512 v =
                _mm512_broadcast_f32x4(_mm_cvtph_ps(_mm_maskz_loadu_epi16(7, scaling)));
            sum.lo = _mm512_fmadd_ps(v, _mm512_loadu_ps(q->scaling[f][0]), sum.lo);
            sum.hi = _mm512_fmadd_ps(v, _mm512_loadu_ps(q->scaling[f][4]), sum.hi);
        }
        put_lights(sum.lo, n_light, light_pitch, out);
        if (n_light > 4) put_lights(sum.hi, n_light - 4, light_pitch, out + 4 * light_pitch);
    }
}

PRT_ISA_END
#endif
