// SPDX-License-Identifier: MIT
// Mixed rows for AVX-512: sums over entries in the row's few directions, then functions.
#include "avx512.h"

#if defined(__x86_64__)

INLINE __mmask16 lane_mask(uint32_t n)
{
    return (__mmask16)(n >= 16 ? 0xffff : (1u << n) - 1);
}

struct sums {
    __m512 channel[3];
};

INLINE void add_entry(const struct prt_rows *rows, uint64_t e, const int8_t *value,
                      __mmask16 mask, const float *light, struct sums *s)
{
    const float *l = light + 4ull * rows_index(rows, e);
    __m512 v = _mm512_cvtepi32_ps(_mm512_cvtepi8_epi32(_mm_maskz_loadu_epi8(mask, value)));
    v = _mm512_mul_ps(v, _mm512_set1_ps(rows_factor(rows, e)));
    for (int ch = 0; ch < 3; ch++)
        s->channel[ch] = _mm512_fmadd_ps(v, _mm512_set1_ps(l[ch]), s->channel[ch]);
}

// Directions [d0, d0 + 16) of a row of n: lanes[ch][d].
INLINE void part(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t d0,
                 const float *light, float lanes[3][PRT_ROWS_MOST_DIRECTIONS])
{
    const __mmask16 mask = lane_mask(n - d0);
    const uint64_t stop = rows->begin[row + 1];
    const int8_t *value = (const int8_t *)rows->entry + rows->value_begin[row] + d0;
    struct sums s[2]; // two chains hide the latency of the additions
    for (int i = 0; i < 2; i++)
        for (int ch = 0; ch < 3; ch++) s[i].channel[ch] = _mm512_setzero_ps();
    uint64_t e = rows->begin[row];
    for (; e + 2 <= stop; e += 2, value += 2 * (size_t)n) {
        _mm_prefetch((const char *)value + 1024, _MM_HINT_T0);
        add_entry(rows, e, value, mask, light, &s[0]);
        add_entry(rows, e + 1, value + n, mask, light, &s[1]);
    }
    if (e < stop) add_entry(rows, e, value, mask, light, &s[0]);
    __m512 scale = _mm512_maskz_loadu_ps(mask, rows->scale + rows->direction[row] + d0);
    for (int ch = 0; ch < 3; ch++)
        _mm512_storeu_ps(
            lanes[ch] + d0,
            _mm512_mul_ps(_mm512_add_ps(s[0].channel[ch], s[1].channel[ch]), scale));
}

// Functions [j, j + 16) of a row from its directions and its scaling coefficients.
INLINE void functions(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t j,
                      float lanes[3][PRT_ROWS_MOST_DIRECTIONS], const float *light, float *out)
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

void relight_mixed_avx512(const struct prt_rows *rows, uint32_t begin, uint32_t end,
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

#endif
