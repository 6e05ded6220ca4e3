// SPDX-License-Identifier: MIT
// Expansion with AVX2: in floating point, and in 16-bit integers, where one instruction
// multiplies two rows of U with their coefficients and adds the products. kernels.h says how
// coefficients become integers.
#include "avx2.h"
#include "scatter.h"

#include <string.h>

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)

PRT_INLINE __m256 load_u(const uint16_t *u)
{
    return _mm256_cvtph_ps(_mm_loadu_si128((const __m128i *)u));
}

// Two rows of U for 8 vertices.
struct two {
    __m256 x[2];
};

PRT_INLINE struct two load_pairs(const int16_t *u)
{
    const __m256i x = _mm256_loadu_si256((const __m256i *)u);
    return (struct two){{_mm256_cvtepi32_ps(_mm256_srai_epi32(_mm256_slli_epi32(x, 16), 16)),
                         _mm256_cvtepi32_ps(_mm256_srai_epi32(x, 16))}};
}

PRT_INLINE void put8(const struct expand_job *job, uint32_t v, uint32_t t, __m256 r, __m256 g,
                     __m256 b)
{
    float rg[16], blue[8];
    __m256 lo = _mm256_unpacklo_ps(r, g), hi = _mm256_unpackhi_ps(r, g);
    uint32_t n = job->end - v < 8 ? job->end - v : 8;
    _mm256_storeu_ps(rg, _mm256_permute2f128_ps(lo, hi, 0x20));
    _mm256_storeu_ps(rg + 8, _mm256_permute2f128_ps(lo, hi, 0x31));
    _mm256_storeu_ps(blue, b);
    scatter(rg, blue, job->order + v, n, job->color[t], job->add);
}

// Expands nt triples of nv vectors of 8 vertices from v on.
PRT_INLINE void expand_block(const struct expand_job *job, uint32_t v, uint32_t t0,
                             const int nt, const int nv)
{
    __m256 sum[4][3][4];
    const int16_t *u = (const int16_t *)job->u + 2 * (size_t)v;
    const float *b = job->b + 3 * t0;
    const __m256 unit = _mm256_set1_ps(PRT_U_UNIT);
    for (int t = 0; t < nt; t++)
        for (int ch = 0; ch < 3; ch++)
            for (int i = 0; i < nv; i++) sum[t][ch][i] = _mm256_setzero_ps();
    for (uint32_t r = 0; r < job->rank; r += 2, u += 2 * job->stride, b += 2 * job->b_stride) {
        const float *other =
            r + 1 < job->rank ? b + job->b_stride : b; // past an odd last row U is 0
        for (int i = 0; i < nv; i++) {
            const struct two two = load_pairs(u + 16 * i);
            for (int t = 0; t < nt; t++)
                for (int ch = 0; ch < 3; ch++) {
                    const int k = 3 * t + ch;
                    sum[t][ch][i] =
                        _mm256_fmadd_ps(two.x[0], _mm256_broadcast_ss(b + k), sum[t][ch][i]);
                    sum[t][ch][i] = _mm256_fmadd_ps(two.x[1], _mm256_broadcast_ss(other + k),
                                                    sum[t][ch][i]);
                }
        }
        _mm_prefetch((const char *)(u + 256), _MM_HINT_T0);
    }
    for (int t = 0; t < nt; t++)
        for (int i = 0; i < nv; i++)
            if (v + 8 * (uint32_t)i < job->end)
                put8(job, v + 8 * (uint32_t)i, t0 + (uint32_t)t,
                     _mm256_mul_ps(sum[t][0][i], unit), _mm256_mul_ps(sum[t][1][i], unit),
                     _mm256_mul_ps(sum[t][2][i], unit));
}

void prt_expand_avx2(const struct expand_job *job)
{
    for (uint32_t v = job->begin; v < job->end; v += 32) {
        uint32_t t = 0, n = job->n_triple;
        for (; n - t >= 4; t += 4)
            for (uint32_t i = v; i < v + 32 && i < job->end; i += 8)
                expand_block(job, i, t, 4, 1);
        for (; t < n; t++) {
            if (v + 32 <= job->stride) expand_block(job, v, t, 1, 4);
            else expand_block(job, v, t, 1, 2);
        }
    }
}

void prt_radial_avx2(const struct expand_job *job)
{
    for (uint32_t v = job->begin; v < job->end; v += 16)
        for (uint32_t t = 0; t < job->n_triple; t++) {
            __m256 sum[3][2];
            const uint16_t *u = job->u + (size_t)t * job->rank * 3 * job->stride + v;
            const float *b = job->b;
            for (int ch = 0; ch < 3; ch++) sum[ch][0] = sum[ch][1] = _mm256_setzero_ps();
            for (uint32_t r = 0; r < job->rank; r++, b += job->b_stride)
                for (int ch = 0; ch < 3; ch++, u += job->stride) {
                    __m256 w = _mm256_broadcast_ss(b + ch);
                    sum[ch][0] = _mm256_fmadd_ps(load_u(u), w, sum[ch][0]);
                    sum[ch][1] = _mm256_fmadd_ps(load_u(u + 8), w, sum[ch][1]);
                }
            put8(job, v, t, sum[0][0], sum[1][0], sum[2][0]);
            if (v + 8 < job->end) put8(job, v + 8, t, sum[0][1], sum[1][1], sum[2][1]);
        }
}

// ---- in integers

enum { COLUMNS = 24 };

struct integers {
    float back[COLUMNS]; // from sums to colours
    int32_t c[EXPAND_RANK_MOST / 2 + 1][COLUMNS]
        __attribute__((aligned(32))); // pairs of rows: low half, high half
};

// Of vector `part` of n columns, the lanes that are columns.
PRT_INLINE __m256i columns(uint32_t n, uint32_t part)
{
    return _mm256_cmpgt_epi32(_mm256_set1_epi32((int)n - 8 * (int)part),
                              _mm256_setr_epi32(0, 1, 2, 3, 4, 5, 6, 7));
}

// The coefficients of columns [8 * part, 8 * part + 8) of row r; 0 past the last row.
PRT_INLINE __m256 weights(const struct expand_job *job, const float *b, uint32_t r,
                          __m256i mask)
{
    return r < job->rank ? _mm256_maskload_ps(b + r * job->b_stride, mask)
                         : _mm256_setzero_ps();
}

// Rounds the coefficients of a vector of columns; false when one is not finite.
PRT_INLINE bool scale_part(const struct expand_job *job, const float *b, __m256i mask,
                           uint32_t part, struct integers *q)
{
    const __m256 sign = _mm256_set1_ps(-0.f);
    __m256 sum = _mm256_setzero_ps(), most = sum;
    for (uint32_t r = 0; r < job->rank; r++) {
        const __m256 x = _mm256_andnot_ps(sign, weights(job, b, r, mask));
        sum = _mm256_add_ps(sum, x);
        most = _mm256_max_ps(most, x);
    }
    const __m256 some = _mm256_cmp_ps(sum, _mm256_set1_ps(1e-30f), _CMP_GT_OQ);
    const __m256 scale = _mm256_and_ps(
        some, _mm256_min_ps(_mm256_div_ps(_mm256_set1_ps(EXPAND_SUM_MOST), sum),
                            _mm256_div_ps(_mm256_set1_ps(EXPAND_COEF_MOST), most)));
    _mm256_storeu_ps(q->back + 8 * part,
                     _mm256_and_ps(some, _mm256_div_ps(_mm256_set1_ps(PRT_U_UNIT), scale)));
    for (uint32_t r = 0; r < job->rank; r += 2) {
        const __m256i x = _mm256_cvtps_epi32(_mm256_mul_ps(weights(job, b, r, mask), scale));
        const __m256i y =
            _mm256_cvtps_epi32(_mm256_mul_ps(weights(job, b, r + 1, mask), scale));
        _mm256_store_si256((__m256i *)(q->c[r / 2] + 8 * part),
                           _mm256_blend_epi16(x, _mm256_slli_epi32(y, 16), 0xaa));
    }
    const __m256 finite = _mm256_cmp_ps(sum, _mm256_set1_ps(3e38f), _CMP_LT_OQ);
    return _mm256_movemask_ps(finite) == 0xff;
}

static bool scale_columns(const struct expand_job *job, uint32_t t, uint32_t nt,
                          struct integers *q)
{
    bool finite = true;
    for (uint32_t part = 0; 8 * part < 3 * nt; part++)
        if (!scale_part(job, job->b + 3 * t + 8 * part, columns(3 * nt, part), part, q))
            finite = false;
    return finite;
}

// nt triples of nv vectors of 8 vertices from v on, nt * nv at most 4. t: the first triple; k:
// its number in q.
PRT_INLINE void integer_block(const struct expand_job *job, const struct integers *q,
                              uint32_t v, uint32_t t, uint32_t k, const uint32_t nt,
                              const uint32_t nv)
{
    __m256i sum[12], x[4];
    const int16_t *u = (const int16_t *)job->u + 2 * (size_t)v;
#pragma GCC unroll 12
    for (uint32_t i = 0; i < 12; i++) sum[i] = _mm256_setzero_si256();
    for (uint32_t r = 0; r < (job->rank + 1) / 2; r++, u += 2 * job->stride) {
#pragma GCC unroll 4
        for (uint32_t i = 0; i < nv; i++)
            x[i] = _mm256_loadu_si256((const __m256i *)(u + 16 * i));
        _mm_prefetch((const char *)(u + 256), _MM_HINT_T0);
#pragma GCC unroll 6
        for (uint32_t c = 0; c < 3 * nt; c++) {
            const __m256i w = _mm256_set1_epi32(q->c[r][3 * k + c]);
#pragma GCC unroll 4
            for (uint32_t i = 0; i < nv; i++)
                sum[c * nv + i] = _mm256_add_epi32(sum[c * nv + i], _mm256_madd_epi16(x[i], w));
        }
    }
#pragma GCC unroll 4
    for (uint32_t i = 0; i < nt * nv; i++) {
        const uint32_t triple = i / nv, part = i % nv;
        __m256 rgb[3];
        if (v + 8 * part >= job->end) continue;
#pragma GCC unroll 3
        for (uint32_t ch = 0; ch < 3; ch++)
            rgb[ch] = _mm256_mul_ps(_mm256_cvtepi32_ps(sum[(3 * triple + ch) * nv + part]),
                                    _mm256_set1_ps(q->back[3 * (k + triple) + ch]));
        put8(job, v + 8 * part, t + triple, rgb[0], rgb[1], rgb[2]);
    }
}

static void integer_triples(const struct expand_job *job, const struct integers *q, uint32_t t,
                            uint32_t nt)
{
    for (uint32_t v = job->begin; v < job->end; v += 32) {
        for (uint32_t k = 0; k + 2 <= nt; k += 2)
            for (uint32_t i = v; i < v + 32 && i < job->end; i += 16)
                integer_block(job, q, i, t + k, k, 2, 2);
        if (nt == 1 && v + 32 <= job->stride) integer_block(job, q, v, t, 0, 1, 4);
        else if (nt == 1) integer_block(job, q, v, t, 0, 1, 2);
    }
}

// More than eight triples take several passes over U, a piece of which stays in the cache.
void prt_expand_integers_avx2(const struct expand_job *job)
{
    const uint32_t n = job->rank <= EXPAND_RANK_MOST ? job->n_triple : 0;
    struct expand_job rest = *job;
    struct integers q;
    uint32_t t = 0;
    for (uint32_t nt; t < n; t += nt) {
        nt = n - t >= 8 ? 8 : n - t >= 4 ? 4 : 1;
        if (!scale_columns(job, t, nt, &q)) break; // floating point takes the rest
        integer_triples(job, &q, t, nt);
    }
    if (t == job->n_triple) return;
    rest.b += 3 * t;
    rest.color += t;
    rest.n_triple -= t;
    prt_expand_avx2(&rest);
}

PRT_ISA_END
#endif
