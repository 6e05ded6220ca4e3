// SPDX-License-Identifier: MIT
// Rows of pairs under eight lights in 16-bit integers with AVX-512 VNNI: one instruction takes
// two entries, and the lights of one coefficient fill one cache line instead of two.
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

void prt_integer_lights_fill_vnni(const struct integer_lights *q, unsigned n_light,
                                  const float *const coef[], uint32_t begin, uint32_t end)
{
    const uint32_t n = q->n, line = (uint32_t)__builtin_ctz(n);
    const __m512 lo = _mm512_loadu_ps(q->scale[0]), hi = _mm512_loadu_ps(q->scale[4]);
    const bool all = n_light == LIGHT_GROUP;
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

void prt_pairs_vnni(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const struct integer_lights *q, unsigned n_light, size_t light_pitch,
                    size_t row_pitch, float *out)
{
    const __m512 back_lo = _mm512_loadu_ps(q->back[0]), back_hi = _mm512_loadu_ps(q->back[4]);
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
