// SPDX-License-Identifier: MIT
// Expanding bases in 16-bit integers: two rows of U meet their coefficients in one instruction,
// twice what floating point does. For eight triples at once, where arithmetic is the limit.
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

INLINE __m512 weights(const struct expand_job *job, const struct integers *q, uint32_t r,
                      uint32_t t, int part)
{
    const float *b = job->b + r * job->b_stride + 3 * t + 16 * part;
    return _mm512_mul_ps(_mm512_maskz_loadu_ps(part ? 0xff : 0xffff, b),
                         _mm512_set1_ps(q->inverse[r]));
}

// Coefficients of eight triples from t on as integers; false when they are not finite.
static bool scale_columns(const struct expand_job *job, uint32_t t, struct integers *q)
{
    __mmask16 finite = 0xffff;
    for (int part = 0; part < 2; part++) {
        const __m512 zero = _mm512_setzero_ps();
        __m512 sum = zero, most = zero;
        for (uint32_t r = 0; r < job->rank; r++) {
            __m512 x = _mm512_abs_ps(weights(job, q, r, t, part));
            sum = _mm512_add_ps(sum, x);
            most = _mm512_max_ps(most, x);
        }
        finite &= _mm512_cmp_ps_mask(sum, _mm512_set1_ps(3e38f), _CMP_LT_OQ);
        __mmask16 some = _mm512_cmp_ps_mask(sum, _mm512_set1_ps(1e-30f), _CMP_GT_OQ);
        __m512 scale = _mm512_min_ps(_mm512_maskz_div_ps(some, _mm512_set1_ps(SUM_MOST), sum),
                                     _mm512_maskz_div_ps(some, _mm512_set1_ps(C_MOST), most));
        _mm512_mask_storeu_ps(q->back + 16 * part, part ? 0xff : 0xffff,
                              _mm512_maskz_div_ps(some, _mm512_set1_ps(1), scale));
        for (uint32_t r = 0; r < job->rank; r += 2) {
            __m512 x = _mm512_mul_ps(weights(job, q, r, t, part), scale), y = zero;
            if (r + 1 < job->rank) y = _mm512_mul_ps(weights(job, q, r + 1, t, part), scale);
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

// A tile whose colours wait: they leave for their vertices while the next one is computed, since
// stores of a few bytes take as long as the sums and want other parts of the processor.
struct waiting {
    float rgb[3 * TILE] __attribute__((aligned(64))); // [triple][16][3]
    uint32_t n;                                       // portions left of PORTIONS
    float *color;                                     // of the first triple
    size_t plane;
    const uint32_t *order;
};
enum { PORTIONS = 16, PORTION = TILE / PORTIONS };

INLINE void put_portion(struct waiting *w)
{
    const uint32_t k = PORTIONS - w->n--;
    const uint32_t *order = w->order + k % 2 * PORTION;
    const float *rgb = w->rgb + 3 * PORTION * k;
    float *color = w->color + k / 2 * w->plane;
    for (uint32_t i = 0; i < PORTION; i++) put1(color + 3ull * order[i], rgb + 3 * i, false);
}

INLINE void put_rest(struct waiting *w)
{
    while (w->n) put_portion(w);
}

// Triples [t0, t0 + 8) of 16 vertices from v on.
INLINE void integer_tile(const struct expand_job *job, const struct integers *q, uint32_t v,
                         uint32_t t0, struct waiting *waiting)
{
    // two tiles ahead: one is computed sooner than memory answers
    const struct places next = places_of(job, v + 32, t0, 16);
    const uint16_t *u = job->u + v;
    __m512i sum[8][3];
    for (int t = 0; t < 8; t++)
        for (int ch = 0; ch < 3; ch++) sum[t][ch] = _mm512_setzero_si512();
    for (uint32_t r = 0; r < job->rank; r += 2, u += 2 * job->stride) {
        const __m512i x = pairs(u, r + 1 < job->rank ? u + job->stride : u, q->scale + r);
        const int32_t *c = q->c[r / 2];
        for (int t = 0; t < 8; t++)
            for (int ch = 0; ch < 3; ch++) add_products(&sum[t][ch], x, &c[3 * t + ch]);
        ask(&next, r, 8);
        ask(&next, r + 1, 8);
        if (waiting->n) put_portion(waiting);
    }
    put_rest(waiting);
    const bool row = !job->add && in_a_row(job, v, 16);
    float *first = job->color + t0 * job->plane + 3ull * job->order[v];
    for (int t = 0; t < 8; t++) {
        __m512 x[3];
        for (int ch = 0; ch < 3; ch++)
            x[ch] = _mm512_mul_ps(_mm512_cvtepi32_ps(sum[t][ch]),
                                  _mm512_set1_ps(q->back[3 * t + ch]));
        put_row(row ? first + (size_t)t * job->plane : waiting->rgb + 48 * t, x[0], x[1], x[2],
                false);
    }
    if (row) return;
    if (job->add || job->end - v < 16) {
        put_tile(job, v, t0, 8, 16, waiting->rgb);
        return;
    }
    waiting->n = PORTIONS;
    waiting->color = job->color + t0 * job->plane;
    waiting->plane = job->plane;
    waiting->order = job->order + v;
}

// Triples [0, n8) of vertices [v0, end), a part of the job; false where floating point must do.
static bool expand_stretch(const struct expand_job *job, struct integers *q, uint32_t v0,
                           uint32_t end, uint32_t n8)
{
    if (!scale_rows(job, v0, end, q)) return false;
    // all are looked at before anything is stored
    for (uint32_t t = 8; t < n8; t += 8)
        if (!scale_columns(job, t, q)) return false;
    if (!scale_columns(job, 0, q)) return false;
    struct waiting waiting;
    waiting.n = 0;
    for (uint32_t t = 0; t < n8; t += 8) {
        if (t) scale_columns(job, t, q);
        for (uint32_t v = v0; v < end; v += 16) {
            if (t == 0) fetch_share(job, v, 16);
            integer_tile(job, q, v, t, &waiting);
        }
    }
    put_rest(&waiting);
    return true;
}

void relight_expand_vnni(const struct expand_job *job)
{
    const uint32_t n8 = job->rank <= RANK_MOST ? job->n_triple & ~7u : 0;
    struct expand_job part = *job;
    struct integers q;
    part.n_triple = n8;
    for (uint32_t v = job->begin; n8 && v < job->end; v = part.end) {
        part.begin = v;
        // no small rest: integers have a price a stretch
        part.end = job->end - v < AHEAD + AHEAD / 2 ? job->end : v + AHEAD;
        if (expand_stretch(job, &q, v, part.end, n8)) continue;
        relight_expand_avx512(&part);
    }
    if (n8 == job->n_triple) return;
    part = *job;
    part.b += 3 * n8;
    part.color += n8 * part.plane;
    part.n_triple -= n8;
    relight_expand_avx512(&part);
}
#endif
