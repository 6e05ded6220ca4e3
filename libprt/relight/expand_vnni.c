// SPDX-License-Identifier: MIT
// Expansion in 16-bit integers with AVX-512 VNNI: one instruction multiplies two rows of U with
// their coefficients and adds the products, twice the rate of floating point.
//
// kernels.h says how coefficients become integers. Coefficients of falling size, as a singular
// value decomposition gives, keep 15 bits where it matters: the error is some 3e-5 of the
// colours (1e-4 when all coefficients are of one size), as much as the rounding of U itself.
#include "avx512.h"
#include "scatter.h"

#include <math.h>

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_VNNI)
#include "store_avx512.h"

#include "chunk_avx512.h"

enum { COLUMNS = 24 };

struct integers {
    float back[COLUMNS + 8]; // from sums to colours
    int32_t c[EXPAND_RANK_MOST / 2 + 1][COLUMNS + 8]
        __attribute__((aligned(64))); // pairs of rows: low half, high half
};

// The mask of a part's columns: 24 columns of eight triples in two parts, those of four or one
// in one.
PRT_INLINE __mmask16 columns(uint32_t nt, int part)
{
    return part ? 0xff : nt == 8 ? 0xffff : nt == 4 ? 0x0fff : 0x0007;
}

PRT_INLINE __m512 weights(const struct expand_job *job, uint32_t r, uint32_t t, __mmask16 mask,
                          int part)
{
    return _mm512_maskz_loadu_ps(mask, job->b + r * job->b_stride + 3 * t + 16 * part);
}

// Rounds the coefficients of nt triples from t on; false when one is not finite.
static bool scale_columns(const struct expand_job *job, uint32_t t, uint32_t nt,
                          struct integers *q)
{
    __mmask16 finite = 0xffff;
    for (int part = 0; part < (nt == 8 ? 2 : 1); part++) {
        const __mmask16 mask = columns(nt, part);
        const __m512 zero = _mm512_setzero_ps();
        __m512 sum = zero, most = zero;
        for (uint32_t r = 0; r < job->rank; r++) {
            __m512 x = _mm512_abs_ps(weights(job, r, t, mask, part));
            sum = _mm512_add_ps(sum, x);
            most = _mm512_max_ps(most, x);
        }
        finite &= _mm512_cmp_ps_mask(sum, _mm512_set1_ps(3e38f), _CMP_LT_OQ);
        __mmask16 some = _mm512_cmp_ps_mask(sum, _mm512_set1_ps(1e-30f), _CMP_GT_OQ);
        __m512 scale =
            _mm512_min_ps(_mm512_maskz_div_ps(some, _mm512_set1_ps(EXPAND_SUM_MOST), sum),
                          _mm512_maskz_div_ps(some, _mm512_set1_ps(EXPAND_COEF_MOST), most));
        _mm512_mask_storeu_ps(q->back + 16 * part, mask,
                              _mm512_maskz_div_ps(some, _mm512_set1_ps(PRT_U_UNIT), scale));
        for (uint32_t r = 0; r < job->rank; r += 2) {
            __m512 x = _mm512_mul_ps(weights(job, r, t, mask, part), scale), y = zero;
            if (r + 1 < job->rank) y = _mm512_mul_ps(weights(job, r + 1, t, mask, part), scale);
            __m512i pair =
                _mm512_mask_blend_epi16(0xaaaaaaaa, _mm512_cvtps_epi32(x),
                                        _mm512_slli_epi32(_mm512_cvtps_epi32(y), 16));
            _mm512_store_si512(q->c[r / 2] + 16 * part, pair);
        }
    }
    return finite == 0xffff;
}

// Adds the two products of each pair with the pair at c. Written as an instruction because gcc
// copies the tied operand of the intrinsic, which takes longer than the sums.
PRT_INLINE void add_products(__m512i *sum, __m512i x, const int32_t *c)
{
    __asm__("vpdpwssd %2%{1to16%}, %1, %0" : "+v"(*sum) : "v"(x), "m"(*c));
}

// expand_tile of expand_avx512.c in integers: nt triples of nv vectors, nt * nv = 8, in 24
// sums.
PRT_INLINE void integer_tile(const struct expand_job *job, const void *user, uint32_t v,
                             uint32_t t0, float *rgb, uint32_t nt, uint32_t nv)
{
    const struct integers *q = user;
    const size_t second = nv == 2 && v + 32 <= job->stride ? 32 : 0;
    const uint16_t *u = job->u + 2 * (size_t)v;
    __m512i sum[24];
#pragma GCC unroll 24
    for (uint32_t k = 0; k < 24; k++) sum[k] = _mm512_setzero_si512();
    for (uint32_t r = 0; r < (job->rank + 1) / 2; r++, u += 2 * job->stride) {
        __m512i x[2];
        x[0] = _mm512_loadu_si512(u);
        for (uint32_t i = 0; i < nv; i++)
            _mm_prefetch((const char *)(u + 2 * AHEAD + 32 * i), _MM_HINT_T0);
        if (nv == 2) x[1] = _mm512_loadu_si512(u + second);
#pragma GCC unroll 24
        for (uint32_t k = 0; k < 24; k++) // k / nv: column
            add_products(&sum[k], x[k % nv], &q->c[r][k / nv]);
    }
#pragma GCC unroll 8
    for (uint32_t k = 0; k < 8; k++) {
        const uint32_t t = k / nv, i = k % nv;
        __m512 x[3];
#pragma GCC unroll 3
        for (uint32_t ch = 0; ch < 3; ch++)
            x[ch] = _mm512_mul_ps(_mm512_cvtepi32_ps(sum[(3 * t + ch) * nv + i]),
                                  _mm512_set1_ps(q->back[3 * t + ch]));
        put_row(rgb + ROW * t + 48 * i, x[0], x[1], x[2], false);
    }
}

// n_pair pairs of rows for n vertices. u: the first pair at the chunk's first vertex; next: the
// pairs that the next call reads, which are prefetched.
PRT_INLINE void add_pairs(const struct integers *q, uint32_t pair, const uint32_t n_pair,
                          const uint16_t *u, const uint16_t *next, size_t stride, uint32_t n,
                          int32_t *sum)
{
    for (uint32_t v = 0; v < n; v += 16, u += 32, next += 32) {
        __m512i x[3];
        for (int ch = 0; ch < 3; ch++)
            x[ch] = pair ? _mm512_load_si512(sum + 3 * v + 16 * ch) : _mm512_setzero_si512();
        for (uint32_t k = 0; k < n_pair; k++) {
            const __m512i two = _mm512_loadu_si512(u + k * 2 * stride);
            _mm_prefetch((const char *)(next + k * 2 * stride), _MM_HINT_T0);
            for (int ch = 0; ch < 3; ch++) add_products(&x[ch], two, &q->c[pair + k][ch]);
        }
        for (int ch = 0; ch < 3; ch++) _mm512_store_si512(sum + 3 * v + 16 * ch, x[ch]);
    }
}

// One triple.
static void integer_chunks(const struct expand_job *job, const struct integers *q, uint32_t t)
{
    int32_t sum[3 * CHUNK] __attribute__((aligned(64)));
    const uint32_t n_pair = (job->rank + 1) / 2;
    for (uint32_t v0 = job->begin, n; v0 < job->end; v0 += n) {
        n = job->end - v0 < CHUNK ? job->end - v0 : CHUNK;
        const uint16_t *u = job->u + 2 * (size_t)v0, *next = u;
        if (!n_pair) memset(sum, 0, sizeof sum);
        claim(job, t, v0, n);
        for (uint32_t r = 0, k; r < n_pair; r += k, u = next) {
            k = n_pair - r >= 4 ? 4 : n_pair - r >= 2 ? 2 : 1;
            next = u + k * 2 * job->stride;
            const uint16_t *after = r + k < n_pair ? next : job->u + 2 * (size_t)(v0 + n);
            if (k == 4) add_pairs(q, r, 4, u, after, job->stride, n, sum);
            else if (k == 2) add_pairs(q, r, 2, u, after, job->stride, n, sum);
            else add_pairs(q, r, 1, u, after, job->stride, n, sum);
        }
        for (uint32_t v = 0; v < n; v += 16) {
            __m512 x[3];
            for (int ch = 0; ch < 3; ch++)
                x[ch] =
                    _mm512_mul_ps(_mm512_cvtepi32_ps(_mm512_load_si512(sum + 3 * v + 16 * ch)),
                                  _mm512_set1_ps(q->back[ch]));
            put16(job, v0 + v, t, in_a_row(job, v0 + v, 16), x[0], x[1], x[2]);
        }
    }
}

// More than eight triples take several passes over U, a piece of which stays in the cache.
void prt_expand_vnni(const struct expand_job *job)
{
    const uint32_t n = job->rank <= EXPAND_RANK_MOST ? job->n_triple : 0;
    struct expand_job rest = *job;
    struct integers q;
    uint32_t t = 0;
    for (uint32_t nt; t < n; t += nt) {
        nt = n - t >= 8 ? 8 : n - t >= 4 ? 4 : 1;
        if (!scale_columns(job, t, nt, &q)) break; // floating point takes the rest
        if (nt == 8) expand_blocks(job, &q, t, 8, 1, integer_tile);
        else if (nt == 4) expand_blocks(job, &q, t, 4, 2, integer_tile);
        else integer_chunks(job, &q, t);
    }
    if (t && job->stream) _mm_sfence();
    if (t == job->n_triple) return;
    rest.b += 3 * t;
    rest.color += t;
    rest.n_triple -= t;
    prt_expand_avx512(&rest);
}

PRT_ISA_END
#endif
