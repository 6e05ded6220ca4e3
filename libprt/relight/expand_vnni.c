// SPDX-License-Identifier: MIT
// Expanding bases in 16-bit integers: two rows of U meet their coefficients in one instruction,
// twice what floating point does. For eight triples at once, or four (the phase planes of single
// scattering), where arithmetic is the limit.
//
// Over a stretch of vertices a row of U becomes integers up to U_MOST, the largest of them that
// value; the coefficients of a triple's channel become integers whose absolute sum is at most
// SUM_MOST, so that no sum of products leaves 32 bits. Coefficients of falling size, as a
// singular value decomposition gives, keep 15 bits where it matters: the error is some 3e-5 of
// the colours (1e-4 were they all alike), beside 1.5e-4 of U's own half precision.
#include "tiles.h"

#if defined(__x86_64__)
#include <math.h>

enum {
    U_MOST = 1 << 14,
    RANK_MOST = 256,
    SUM_MOST = 131071 - RANK_MOST / 2 - 1,
    C_MOST = 32767
};
enum { COLUMNS = 24, HALF_INFINITY = 0x7c00 };

struct integers {
    float scale[RANK_MOST + 16];   // row of U -> integers; 0 behind the last row
    float inverse[RANK_MOST + 16]; // and back
    float back[COLUMNS + 8];      // sums -> colours
    int32_t c[RANK_MOST / 2 + 1][COLUMNS + 8]
        __attribute__((aligned(64))); // two rows: low, high
};

// Scales of every row over vertices [v, end); false when a value is not finite.
static bool scale_rows(const struct expand_job *job, uint32_t v, uint32_t end,
                       struct integers *q)
{
    const __m512i magnitude = _mm512_set1_epi16(0x7fff);
    const uint32_t n = ((end + 15) & ~15u) - v;
    uint16_t bits[RANK_MOST + 16];
    __mmask16 worst = 0;
    for (uint32_t r = 0; r < job->rank; r++) {
        const uint16_t *u = job->u + r * job->stride + v;
        __m512i most = _mm512_setzero_si512();
        uint32_t i = 0;
        for (; i + 32 <= n; i += 32)
            most =
                _mm512_max_epu16(most, _mm512_and_si512(_mm512_loadu_si512(u + i), magnitude));
        if (i < n)
            most = _mm512_max_epu16(
                most, _mm512_and_si512(_mm512_maskz_loadu_epi16(0xffff, u + i), magnitude));
        // the larger of the two halves of each 32 bits
        most = _mm512_max_epu32(_mm512_and_si512(most, _mm512_set1_epi32(0xffff)),
                                _mm512_srli_epi32(most, 16));
        bits[r] = (uint16_t)_mm512_reduce_max_epu32(most);
    }
    for (uint32_t r = job->rank; r % 16 || r == job->rank; r++) bits[r] = 0;
    for (uint32_t r = 0; r <= job->rank; r += 16) {
        const __m256i half = _mm256_loadu_si256((const __m256i *)(bits + r));
        const __m512 x = _mm512_cvtph_ps(half), most = _mm512_set1_ps((float)U_MOST);
        const __mmask16 some = _mm512_cmp_ps_mask(x, _mm512_setzero_ps(), _CMP_GT_OQ);
        _mm512_storeu_ps(q->scale + r, _mm512_maskz_div_ps(some, most, x));
        _mm512_storeu_ps(q->inverse + r, _mm512_div_ps(x, most));
        worst |= _mm256_cmpge_epu16_mask(half, _mm256_set1_epi16(HALF_INFINITY));
    }
    return !worst;
}

// Which columns of a part are there: 24 of eight triples, 12 of four.
INLINE __mmask16 columns(uint32_t nt, int part)
{
    return part ? 0xff : nt == 8 ? 0xffff : 0x0fff;
}

INLINE __m512 weights(const struct expand_job *job, const struct integers *q, uint32_t r,
                      uint32_t t, __mmask16 mask, int part)
{
    const float *b = job->b + r * job->b_stride + 3 * t + 16 * part;
    return _mm512_mul_ps(_mm512_maskz_loadu_ps(mask, b), _mm512_set1_ps(q->inverse[r]));
}

// Coefficients of nt triples from t on as integers; false when they are not finite.
static bool scale_columns(const struct expand_job *job, uint32_t t, uint32_t nt,
                          struct integers *q)
{
    __mmask16 finite = 0xffff;
    for (int part = 0; part < (nt == 8 ? 2 : 1); part++) {
        const __mmask16 mask = columns(nt, part);
        const __m512 zero = _mm512_setzero_ps();
        __m512 sum = zero, most = zero;
        for (uint32_t r = 0; r < job->rank; r++) {
            __m512 x = _mm512_abs_ps(weights(job, q, r, t, mask, part));
            sum = _mm512_add_ps(sum, x);
            most = _mm512_max_ps(most, x);
        }
        finite &= _mm512_cmp_ps_mask(sum, _mm512_set1_ps(3e38f), _CMP_LT_OQ);
        __mmask16 some = _mm512_cmp_ps_mask(sum, _mm512_set1_ps(1e-30f), _CMP_GT_OQ);
        __m512 scale = _mm512_min_ps(_mm512_maskz_div_ps(some, _mm512_set1_ps(SUM_MOST), sum),
                                     _mm512_maskz_div_ps(some, _mm512_set1_ps(C_MOST), most));
        _mm512_mask_storeu_ps(q->back + 16 * part, mask,
                              _mm512_maskz_div_ps(some, _mm512_set1_ps(1), scale));
        for (uint32_t r = 0; r < job->rank; r += 2) {
            __m512 x = _mm512_mul_ps(weights(job, q, r, t, mask, part), scale), y = zero;
            if (r + 1 < job->rank) y = _mm512_mul_ps(weights(job, q, r + 1, t, mask, part), scale);
            __m512i pair =
                _mm512_mask_blend_epi16(0xaaaaaaaa, _mm512_cvtps_epi32(x),
                                        _mm512_slli_epi32(_mm512_cvtps_epi32(y), 16));
            _mm512_store_si512(q->c[r / 2] + 16 * part, pair);
        }
    }
    return finite == 0xffff;
}

// Two rows of 16 vertices as 16 pairs. A sum with 1.5 * 2^23 has the integer in its low bits.
INLINE __m512i pairs(const uint16_t *u, const uint16_t *next, const float *scale)
{
    const __m512 magic = _mm512_set1_ps(0x1.8p23f);
    __m512 x = _mm512_fmadd_ps(load_u(u), _mm512_set1_ps(scale[0]), magic);
    __m512 y = _mm512_fmadd_ps(load_u(next), _mm512_set1_ps(scale[1]), magic);
    return _mm512_mask_blend_epi16(0xaaaaaaaa, _mm512_castps_si512(x),
                                   _mm512_slli_epi32(_mm512_castps_si512(y), 16));
}

// sum += the two products of each pair with the pair at c. As an instruction: the compiler
// moves the tied operands of its intrinsic about, which takes longer than the sums.
INLINE void add_products(__m512i *sum, __m512i x, const int32_t *c)
{
    __asm__("vpdpwssd %2%{1to16%}, %1, %0" : "+v"(*sum) : "v"(x), "m"(*c));
}

// Triples [t0, t0 + nt) of nv vectors of 16 vertices from v on, nt * nv = 8: 24 sums. The second
// vector is the first again where it would lie behind the padded block.
INLINE void integer_tile(const struct expand_job *job, const struct integers *q, uint32_t v,
                         uint32_t t0, struct waiting *waiting, const uint32_t nt,
                         const uint32_t nv)
{
    const uint32_t width = 16 * nv, each = width / PORTION;
    const size_t second = nv == 2 && v + 32 <= job->stride ? 16 : 0;
    // two tiles ahead: one is computed sooner than memory answers
    const struct places next = places_of(job, v + 2 * width, t0, width);
    const uint16_t *u = job->u + v;
    __m512i sum[24];
#pragma GCC unroll 24
    for (uint32_t k = 0; k < 24; k++) sum[k] = _mm512_setzero_si512();
    for (uint32_t r = 0; r < job->rank; r += 2, u += 2 * job->stride) {
        const uint16_t *other = r + 1 < job->rank ? u + job->stride : u;
        __m512i x[2];
        x[0] = pairs(u, other, q->scale + r);
        if (nv == 2) x[1] = pairs(u + second, other + second, q->scale + r);
        const int32_t *c = q->c[r / 2];
#pragma GCC unroll 24
        for (uint32_t k = 0; k < 24; k++) // k / nv: column
            add_products(&sum[k], x[k % nv], &c[k / nv]);
        ask(&next, r, nt);
        ask(&next, r + 1, nt);
        if (waiting->n) put_portion(waiting, each);
    }
    put_rest(waiting, each);
    const bool row = !job->add && in_a_row(job, v, width);
    float *first = job->color + t0 * job->plane + 3ull * job->order[v];
#pragma GCC unroll 8
    for (uint32_t k = 0; k < 8; k++) {
        const uint32_t t = k / nv, i = k % nv;
        __m512 x[3];
#pragma GCC unroll 3
        for (uint32_t ch = 0; ch < 3; ch++)
            x[ch] = _mm512_mul_ps(_mm512_cvtepi32_ps(sum[(3 * t + ch) * nv + i]),
                                  _mm512_set1_ps(q->back[3 * t + ch]));
        float *to = row ? first + t * job->plane : waiting->rgb + 3 * width * t;
        put_row(to + 48 * i, x[0], x[1], x[2], false);
    }
    if (row) return;
    put_later(job, v, t0, nt, waiting);
}

INLINE void integer_tiles(const struct expand_job *job, const struct integers *q, uint32_t v,
                          uint32_t end, uint32_t t0, const uint32_t nt, const uint32_t nv)
{
    struct waiting waiting;
    waiting.n = 0;
    for (; v < end; v += 16 * nv) {
        if (t0 == 0) fetch_share(job, v, 16 * nv);
        integer_tile(job, q, v, t0, &waiting, nt, nv);
    }
    put_rest(&waiting, 16 * nv / PORTION);
}

// Triples of this tile: eight, or the last four.
static uint32_t tile_triples(uint32_t t, uint32_t n)
{
    return n - t >= 8 ? 8 : 4;
}

// Triples [0, n) of vertices [v0, end), a part of the job; false where floating point must do.
static bool expand_stretch(const struct expand_job *job, struct integers *q, uint32_t v0,
                           uint32_t end, uint32_t n)
{
    if (!scale_rows(job, v0, end, q)) return false;
    // all are looked at before anything is stored
    for (uint32_t t = tile_triples(0, n); t < n; t += tile_triples(t, n))
        if (!scale_columns(job, t, tile_triples(t, n), q)) return false;
    if (!scale_columns(job, 0, tile_triples(0, n), q)) return false;
    for (uint32_t t = 0, nt; t < n; t += nt) {
        nt = tile_triples(t, n);
        if (t) scale_columns(job, t, nt, q);
        if (nt == 8) integer_tiles(job, q, v0, end, t, 8, 1);
        else integer_tiles(job, q, v0, end, t, 4, 2);
    }
    return true;
}

void relight_expand_vnni(const struct expand_job *job)
{
    const uint32_t n = job->rank <= RANK_MOST ? job->n_triple & ~3u : 0;
    struct expand_job part = *job;
    struct integers q;
    part.n_triple = n;
    for (uint32_t v = job->begin; n && v < job->end; v = part.end) {
        part.begin = v;
        // no small rest: integers have a price a stretch
        part.end = job->end - v < AHEAD + AHEAD / 2 ? job->end : v + AHEAD;
        if (expand_stretch(job, &q, v, part.end, n)) continue;
        relight_expand_avx512(&part);
    }
    if (n == job->n_triple) return;
    part = *job;
    part.b += 3 * n;
    part.color += n * part.plane;
    part.n_triple -= n;
    relight_expand_avx512(&part);
}
#endif
