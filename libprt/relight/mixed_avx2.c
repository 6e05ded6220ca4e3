// SPDX-License-Identifier: MIT
// Low-rank rows for AVX2: each row's few components are summed over its entries, then functions
// are sums of components.
#include "avx2.h"

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)

PRT_INLINE __m256 bytes(const int8_t *p, uint32_t n)
{
    int64_t raw = 0;
    memcpy(&raw, p, n < 8 ? n : 8);
    return _mm256_cvtepi32_ps(_mm256_cvtepi8_epi32(_mm_cvtsi64_si128(raw)));
}

// Components [d0, d0 + 8) of a row of n: lanes[ch][d].
static void part(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t d0,
                 const float *light, float lanes[3][PRT_ROWS_MOST_DIRECTIONS])
{
    const uint64_t stop = rows->begin[row + 1], all = rows->value_begin[rows->n_row];
    const int8_t *value = (const int8_t *)rows->entry + rows->value_begin[row] + d0;
    const int8_t *whole = (const int8_t *)rows->entry + (all > 8 ? all - 8 : 0);
    __m256 sum[3] = {_mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps()};
    for (uint64_t e = rows->begin[row]; e < stop; e++, value += n) {
        const float *l = light + 4ull * rows_index(rows, e);
        // Bytes past an entry are read where the array has some; their sums are not used.
        __m256 v = value < whole ? bytes(value, 8) : bytes(value, n - d0);
        v = _mm256_mul_ps(v, _mm256_set1_ps(rows_factor(rows, e)));
        for (int ch = 0; ch < 3; ch++)
            sum[ch] = _mm256_fmadd_ps(v, _mm256_broadcast_ss(l + ch), sum[ch]);
    }
    for (int ch = 0; ch < 3; ch++) _mm256_storeu_ps(lanes[ch] + d0, sum[ch]);
    for (uint32_t d = d0; d < n && d < d0 + 8; d++)
        for (int ch = 0; ch < 3; ch++) lanes[ch][d] *= rows->scale[rows->direction[row] + d];
}

// Functions [j, j + 8) of a row from its components and its scaling coefficients.
static void functions(const struct prt_rows *rows, uint32_t row, uint32_t n, uint32_t j,
                      float lanes[3][PRT_ROWS_MOST_DIRECTIONS], const float *light, float *out)
{
    const uint32_t J = rows->n_function, left = J - j < 8 ? J - j : 8;
    const size_t face = rows->n_coef / 6;
    const uint16_t *scaling = rows->scaling + 6ull * row * J + j;
    const uint16_t *mix = rows->mix + (uint64_t)rows->direction[row] * J + j;
    __m256 sum[3] = {_mm256_setzero_ps(), _mm256_setzero_ps(), _mm256_setzero_ps()};
    for (size_t f = 0; f < 6; f++) {
        __m256 v = halves(scaling + f * J, left, j > 0);
        for (int ch = 0; ch < 3; ch++)
            sum[ch] =
                _mm256_fmadd_ps(v, _mm256_broadcast_ss(light + 4 * face * f + ch), sum[ch]);
    }
    for (uint32_t d = 0; d < n; d++) {
        __m256 v = halves(mix + (size_t)d * J, left, j > 0);
        for (int ch = 0; ch < 3; ch++)
            sum[ch] = _mm256_fmadd_ps(v, _mm256_broadcast_ss(&lanes[ch][d]), sum[ch]);
    }
    float column[3][8];
    for (int ch = 0; ch < 3; ch++) _mm256_storeu_ps(column[ch], sum[ch]);
    for (uint32_t i = 0; i < left; i++)
        for (int ch = 0; ch < 3; ch++) out[3 * (j + i) + ch] = column[ch][i];
}

void prt_mixed_avx2(const struct prt_rows *rows, uint32_t begin, uint32_t end,
                    const float *light, float *out)
{
    float lanes[3][PRT_ROWS_MOST_DIRECTIONS];
    for (uint32_t row = begin; row < end; row++, out += 3 * (size_t)rows->n_function) {
        const uint32_t n = rows->direction[row + 1] - rows->direction[row];
        for (uint32_t d = 0; d < n; d += 8) part(rows, row, n, d, light, lanes);
        for (uint32_t j = 0; j < rows->n_function; j += 8)
            functions(rows, row, n, j, lanes, light, out);
    }
}

PRT_ISA_END
#endif
