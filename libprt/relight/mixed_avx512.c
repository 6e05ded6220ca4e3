// SPDX-License-Identifier: MIT
// Low-rank rows for AVX-512: each row's few components are summed over its entries, then
// functions are sums of components.
#include "avx512.h"

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX512)

PRT_INLINE __mmask16 lane_mask(uint32_t n)
{
    return (__mmask16)(n >= 16 ? 0xffff : (1u << n) - 1);
}

struct sums {
    __m512 channel[3];
};

PRT_INLINE void add_entry(const struct prt_rows *rows, uint64_t e, const int8_t *value,
                          __mmask16 mask, const float *light, struct sums *s)
{
    const float *l = light + 4ull * rows_index(rows, e);
    __m512 v = _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_maskz_loadu_epi8(mask, value)));
    v = _mm512_mul_ps(v, _mm512_set1_ps(rows_factor(rows, e)));
    for (int ch = 0; ch < 3; ch++)
        s->channel[ch] = _mm512_fmadd_ps(v, _mm512_set1_ps(l[ch]), s->channel[ch]);
}

// The shuffle that moves the n bytes of each of `together` entries to their lanes; the other
// lanes become 0.
PRT_INLINE __m128i spread_control(uint32_t n, const int together)
{
    uint8_t at[16];
    const uint32_t lanes = 16 / (uint32_t)together;
    for (uint32_t i = 0; i < 16; i++)
        at[i] = i % lanes < n ? (uint8_t)(i / lanes * n + i % lanes) : 0x80;
    return _mm_loadu_si128((const __m128i *)at);
}

// `together` (4 or 2) entries from e on in one vector, 4 or 8 lanes each.
PRT_INLINE void add_entries(const struct prt_rows *rows, uint64_t e, const int8_t *value,
                            __mmask16 bytes, __m128i control, const float *light,
                            const int together, struct sums *s)
{
    __m512 l = _mm512_castps128_ps512(_mm_loadu_ps(light + 4ull * rows_index(rows, e)));
    l = _mm512_insertf32x4(l, _mm_loadu_ps(light + 4ull * rows_index(rows, e + 1)), 1);
    int32_t shifts = 0;
    memcpy(&shifts, rows->shift + e, (size_t)together);
    __m128i power =
        _mm_sub_epi32(_mm_set1_epi32(127), _mm_cvtepu8_epi32(_mm_cvtsi32_si128(shifts)));
    __m512 factor = _mm512_castps128_ps512(_mm_castsi128_ps(_mm_slli_epi32(power, 23)));
    __m128i packed = _mm_shuffle_epi8(_mm_maskz_loadu_epi8(bytes, value), control);
    __m512 v = _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(packed));
    if (together == 4) {
        l = _mm512_insertf32x4(l, _mm_loadu_ps(light + 4ull * rows_index(rows, e + 2)), 2);
        l = _mm512_insertf32x4(l, _mm_loadu_ps(light + 4ull * rows_index(rows, e + 3)), 3);
        const __m512i quads = _mm512_setr_epi32(0, 0, 0, 0, 1, 1, 1, 1, 2, 2, 2, 2, 3, 3, 3, 3);
        v = _mm512_mul_ps(v, _mm512_permutexvar_ps(quads, factor));
        s->channel[0] = _mm512_fmadd_ps(v, _mm512_shuffle_ps(l, l, 0x00), s->channel[0]);
        s->channel[1] = _mm512_fmadd_ps(v, _mm512_shuffle_ps(l, l, 0x55), s->channel[1]);
        s->channel[2] = _mm512_fmadd_ps(v, _mm512_shuffle_ps(l, l, 0xaa), s->channel[2]);
        return;
    }
    const __m512i halves = _mm512_setr_epi32(0, 0, 0, 0, 0, 0, 0, 0, 1, 1, 1, 1, 1, 1, 1, 1);
    const __m512i from = _mm512_slli_epi32(halves, 2);
    v = _mm512_mul_ps(v, _mm512_permutexvar_ps(halves, factor));
    for (int ch = 0; ch < 3; ch++) {
        __m512i at = _mm512_add_epi32(from, _mm512_set1_epi32(ch));
        s->channel[ch] = _mm512_fmadd_ps(v, _mm512_permutexvar_ps(at, l), s->channel[ch]);
    }
}

// A row of at most 16 / together components: `together` entries in one vector.
PRT_INLINE struct sums few(const struct prt_rows *rows, uint32_t row, uint32_t n,
                           const float *light, const int together)
{
    const uint64_t stop = rows->begin[row + 1];
    const int8_t *value = (const int8_t *)rows->entry + rows->value_begin[row];
    const __m128i control = spread_control(n, together);
    const __mmask16 bytes = lane_mask(n * (uint32_t)together);
    struct sums s[2]; // two chains hide the latency of the additions
    for (int i = 0; i < 2; i++)
        for (int ch = 0; ch < 3; ch++) s[i].channel[ch] = _mm512_setzero_ps();
    uint64_t e = rows->begin[row];
    const uint64_t step = (uint64_t)together;
    for (; e + 2 * step <= stop; e += 2 * step, value += 2 * step * n) {
        _mm_prefetch((const char *)value + 1024, _MM_HINT_T0);
        add_entries(rows, e, value, bytes, control, light, together, &s[0]);
        add_entries(rows, e + step, value + step * n, bytes, control, light, together, &s[1]);
    }
    for (; e < stop; e++, value += n) add_entry(rows, e, value, lane_mask(n), light, &s[0]);
    for (int ch = 0; ch < 3; ch++) {
        __m512 sum = _mm512_add_ps(s[0].channel[ch], s[1].channel[ch]);
        __m256 half =
            _mm256_add_ps(_mm512_castps512_ps256(sum), _mm512_extractf32x8_ps(sum, 1));
        if (together == 4)
            half = _mm256_castps128_ps256(
                _mm_add_ps(_mm256_castps256_ps128(half), _mm256_extractf128_ps(half, 1)));
        s[0].channel[ch] = _mm512_zextps256_ps512(half);
    }
    return s[0];
}

// Components [d0, d0 + 16) of a row of n.
PRT_INLINE struct sums many(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t d0,
                            const float *light)
{
    const __mmask16 mask = lane_mask(n - d0);
    const uint64_t stop = rows->begin[row + 1];
    const int8_t *value = (const int8_t *)rows->entry + rows->value_begin[row] + d0;
    struct sums s[2];
    for (int i = 0; i < 2; i++)
        for (int ch = 0; ch < 3; ch++) s[i].channel[ch] = _mm512_setzero_ps();
    uint64_t e = rows->begin[row];
    for (; e + 2 <= stop; e += 2, value += 2 * (size_t)n) {
        _mm_prefetch((const char *)value + 1024, _MM_HINT_T0);
        add_entry(rows, e, value, mask, light, &s[0]);
        add_entry(rows, e + 1, value + n, mask, light, &s[1]);
    }
    if (e < stop) add_entry(rows, e, value, mask, light, &s[0]);
    for (int ch = 0; ch < 3; ch++)
        s[0].channel[ch] = _mm512_add_ps(s[0].channel[ch], s[1].channel[ch]);
    return s[0];
}

// Components [d0, d0 + 16) of a row of n: lanes[ch][d].
static void part(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t d0,
                 const float *light, float lanes[3][PRT_ROWS_MOST_DIRECTIONS])
{
    struct sums s = n <= 4   ? few(rows, row, n, light, 4)
                    : n <= 8 ? few(rows, row, n, light, 2)
                             : many(rows, row, n, d0, light);
    __m512 scale =
        _mm512_maskz_loadu_ps(lane_mask(n - d0), rows->scale + rows->direction[row] + d0);
    for (int ch = 0; ch < 3; ch++)
        _mm512_storeu_ps(lanes[ch] + d0, _mm512_mul_ps(s.channel[ch], scale));
}

// Functions [j, j + 16) of a row from its components and its scaling coefficients.
PRT_INLINE void functions(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t j,
                          float lanes[3][PRT_ROWS_MOST_DIRECTIONS], const float *light,
                          float *out)
{
    const uint32_t J = rows->n_function, left = J - j < 16 ? J - j : 16;
    const size_t face = rows->n_coef / 6;
    const __mmask16 mask = lane_mask(J - j);
    const uint16_t *scaling = rows->scaling + 6ull * row * J + j;
    const uint16_t *mix = rows->mix + (uint64_t)rows->direction[row] * J + j;
    __m512 sum[3] = {_mm512_setzero_ps(), _mm512_setzero_ps(), _mm512_setzero_ps()};
    for (size_t f = 0; f < 6; f++) {
        __m512 v = _mm512_cvtph_ps(_mm256_maskz_loadu_epi16(mask, scaling + f * J));
        for (int ch = 0; ch < 3; ch++)
            sum[ch] = _mm512_fmadd_ps(v, _mm512_set1_ps(light[4 * face * f + ch]), sum[ch]);
    }
    for (uint32_t d = 0; d < n; d++) {
        __m512 v = _mm512_cvtph_ps(_mm256_maskz_loadu_epi16(mask, mix + (size_t)d * J));
        for (int ch = 0; ch < 3; ch++)
            sum[ch] = _mm512_fmadd_ps(v, _mm512_set1_ps(lanes[ch][d]), sum[ch]);
    }
    float column[3][16];
    for (int ch = 0; ch < 3; ch++) _mm512_storeu_ps(column[ch], sum[ch]);
    for (uint32_t i = 0; i < left; i++)
        for (int ch = 0; ch < 3; ch++) out[3 * (j + i) + ch] = column[ch][i];
}

void prt_mixed_avx512(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                      const float *light, float *out)
{
    float lanes[3][PRT_ROWS_MOST_DIRECTIONS];
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)rows->n_function) {
        const uint32_t n = rows->direction[row + 1] - rows->direction[row];
        for (uint32_t d = 0; d < n; d += 16) part(rows, row, n, d, light, lanes);
        for (uint32_t j = 0; j < rows->n_function; j += 16)
            functions(rows, row, n, j, lanes, light, out);
    }
}

PRT_ISA_END
#endif
