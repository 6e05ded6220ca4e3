// SPDX-License-Identifier: MIT
// Expanding bases to colours in AVX-512: U times the contracted rows, and the polynomial
// transport's sums.
#include "tiles.h"

#if defined(__x86_64__)
#include <string.h>

#include "scatter.h"

// Asks for the lines that the colours of positions [v, v + n) will be written to: most of them,
// since neighbours in the cluster are mostly neighbours in the file.
INLINE void claim(const struct expand_job *job, uint32_t t, uint32_t v, uint32_t n)
{
    const uint32_t end = job->end < v + n ? job->end : v + n;
    for (; v < end; v += 4)
        __builtin_prefetch(job->color + t * job->plane + 3ull * job->order[v], 1, 3);
}

// Puts 16 positions' colours where their vertices are.
INLINE void put16(const struct expand_job *job, uint32_t v, uint32_t t, bool row, __m512 r,
                  __m512 g, __m512 b)
{
    float rg[32], blue[16];
    const __m512i lo =
        _mm512_setr_epi32(0, 16, 1, 17, 2, 18, 3, 19, 4, 20, 5, 21, 6, 22, 7, 23);
    const __m512i hi =
        _mm512_setr_epi32(8, 24, 9, 25, 10, 26, 11, 27, 12, 28, 13, 29, 14, 30, 15, 31);
    float *color = job->color + t * job->plane;
    uint32_t n = job->end - v < 16 ? job->end - v : 16;
    if (row) {
        put_row(color + 3ull * job->order[v], r, g, b, job->add);
        return;
    }
    _mm512_storeu_ps(rg, _mm512_permutex2var_ps(r, lo, g));
    _mm512_storeu_ps(rg + 16, _mm512_permutex2var_ps(r, hi, g));
    _mm512_storeu_ps(blue, b);
    scatter(rg, blue, job->order + v, n, color, job->add);
}

// One triple. Reading 64 bytes of each of some forty rows in turn defeats the memory system, so
// rows come in groups of up to eight, read along CHUNK vertices while sums wait in the first
// cache; the next group's bytes are fetched meanwhile. Polynomial transport, three times the rows,
// comes to the second cache: the first has too few places for lines that are still to come.
enum { CHUNK = 1024, RADIAL_CHUNK = 2048 };

struct chunk {
    const uint16_t *u;    // first row of the group, first vertex of the chunk
    const uint16_t *next; // what the next group will read
    size_t stride;
    const float *b;
    size_t b_stride;
    uint32_t n; // vertices rounded up to 16
    float *sum; // [n/16][3][16]
};

INLINE void expand_group(const struct chunk *c, const int n_row, bool first)
{
    const size_t stride = c->stride, bs = c->b_stride;
    const float *b = c->b;
    for (uint32_t v = 0; v < c->n; v += 16) {
        float *sum = c->sum + 3 * v;
        const uint16_t *u = c->u + v, *next = c->next + v;
        __m512 x0 = first ? _mm512_setzero_ps() : _mm512_load_ps(sum);
        __m512 x1 = first ? _mm512_setzero_ps() : _mm512_load_ps(sum + 16);
        __m512 x2 = first ? _mm512_setzero_ps() : _mm512_load_ps(sum + 32);
        for (int k = 0; k < n_row; k++) {
            __m512 x = load_u(u + (size_t)k * stride);
            if (!(v & 16)) _mm_prefetch((const char *)(next + (size_t)k * stride), _MM_HINT_T0);
            x0 = _mm512_fmadd_ps(x, _mm512_set1_ps(b[k * bs]), x0);
            x1 = _mm512_fmadd_ps(x, _mm512_set1_ps(b[k * bs + 1]), x1);
            x2 = _mm512_fmadd_ps(x, _mm512_set1_ps(b[k * bs + 2]), x2);
        }
        _mm512_store_ps(sum, x0);
        _mm512_store_ps(sum + 16, x1);
        _mm512_store_ps(sum + 32, x2);
    }
}

// Polynomial: the rows of a function are its three channels.
INLINE void radial_group(const struct chunk *c, const int n_function, bool first)
{
    const size_t stride = c->stride;
    const float *b = c->b;
    for (uint32_t v = 0; v < c->n; v += 16) {
        float *sum = c->sum + 3 * v;
        const uint16_t *u = c->u + v, *next = c->next + v;
        for (int ch = 0; ch < 3; ch++) {
            __m512 x = first ? _mm512_setzero_ps() : _mm512_load_ps(sum + 16 * ch);
            for (int k = 0; k < n_function; k++) {
                size_t row = (size_t)(3 * k + ch) * stride;
                if (!(v & 16)) _mm_prefetch((const char *)(next + row), _MM_HINT_T1);
                x = _mm512_fmadd_ps(load_u(u + row),
                                    _mm512_set1_ps(b[(size_t)k * c->b_stride + (size_t)ch]), x);
            }
            _mm512_store_ps(sum + 16 * ch, x);
        }
    }
}

// Runs one group of at most `left` rows (functions); returns how many.
INLINE uint32_t run_group(const struct chunk *c, uint32_t left, bool first, bool radial)
{
    if (radial) {
        if (left >= 4 && first) return radial_group(c, 4, true), 4;
        if (left >= 4) return radial_group(c, 4, false), 4;
        if (left >= 2) return radial_group(c, 2, first), 2;
        return radial_group(c, 1, first), 1;
    }
    if (left >= 8 && first) return expand_group(c, 8, true), 8;
    if (left >= 8) return expand_group(c, 8, false), 8;
    if (left >= 4) return expand_group(c, 4, first), 4;
    if (left >= 2) return expand_group(c, 2, first), 2;
    return expand_group(c, 1, first), 1;
}

INLINE void expand_chunks(const struct expand_job *job, uint32_t t, bool radial)
{
    const uint32_t most = radial ? RADIAL_CHUNK : CHUNK;
    float sum[3 * RADIAL_CHUNK] __attribute__((aligned(64)));
    const size_t rows = radial ? 3 : 1, group = radial ? 4 : 8;
    const uint16_t *base = job->u + (radial ? (size_t)t * job->rank * 3 * job->stride : 0);
    for (uint32_t v0 = job->begin; v0 < job->end; v0 += most) {
        uint32_t n = job->end - v0 < most ? job->end - v0 : most;
        struct chunk c = {
            .stride = job->stride, .b_stride = job->b_stride, .n = (n + 15) & ~15u, .sum = sum};
        if (!job->rank) memset(sum, 0, 3 * c.n * sizeof *sum);
        claim(job, t, v0, n);
        for (uint32_t r = 0; r < job->rank;) {
            c.u = base + v0 + r * rows * job->stride;
            // past the last group comes the next chunk, past the last chunk what follows in
            // memory: the next plane or cluster; a prefetch of nothing does no harm
            uint32_t left = job->rank - r;
            c.next = left > group                 ? c.u + group * rows * job->stride
                     : v0 + most < job->end ? base + v0 + most
                                            : c.u + left * rows * job->stride;
            c.b = job->b + r * job->b_stride + (radial ? 0 : 3 * t);
            r += run_group(&c, left, r == 0, radial);
        }
        for (uint32_t v = 0; v < n; v += 16)
            put16(job, v0 + v, t, in_a_row(job, v0 + v, 16), _mm512_load_ps(sum + 3 * v),
                  _mm512_load_ps(sum + 3 * v + 16), _mm512_load_ps(sum + 3 * v + 32));
    }
}

// Several triples: 24 sums, for nt triples and nv vectors of 16 vertices (nt * nv = 8), stay in
// registers, so that a row of U costs 24 fused multiply-adds and little else.
// Triples [t0, t0 + nt) of vertices from v on; the second vector is the first again where it
// would lie behind the padded block: its vertices do not exist then.
INLINE void expand_tile(const struct expand_job *job, uint32_t v, uint32_t t0,
                        const uint32_t nt, const uint32_t nv)
{
    const uint32_t width = 16 * nv;
    const size_t second = nv == 2 && v + 32 <= job->stride ? 16 : 0;
    const struct places next = places_of(job, v + width, t0, width);
    __m512 sum[8][3][2];
    float rgb[3 * TILE] __attribute__((aligned(64)));
    const uint16_t *u = job->u + v;
    const float *b = job->b + 3 * t0;
    for (uint32_t t = 0; t < nt; t++)
        for (int ch = 0; ch < 3; ch++)
            for (uint32_t i = 0; i < nv; i++) sum[t][ch][i] = _mm512_setzero_ps();
    for (uint32_t r = 0; r < job->rank; r++, u += job->stride, b += job->b_stride) {
        const __m512 x[2] = {load_u(u), load_u(u + second)};
        ask(&next, r, nt);
        for (uint32_t t = 0; t < nt; t++)
            for (uint32_t ch = 0; ch < 3; ch++)
                for (uint32_t i = 0; i < nv; i++)
                    sum[t][ch][i] =
                        _mm512_fmadd_ps(x[i], _mm512_set1_ps(b[3 * t + ch]), sum[t][ch][i]);
    }
    const bool row = !job->add && in_a_row(job, v, width);
    float *first = job->color + t0 * job->plane + 3ull * job->order[v];
    for (uint32_t t = 0; t < nt; t++)
        for (uint32_t i = 0; i < nv; i++)
            put_row((row ? first + t * job->plane : rgb + 3 * width * t) + 48 * i, sum[t][0][i],
                    sum[t][1][i], sum[t][2][i], false);
    if (!row) put_tile(job, v, t0, nt, width, rgb);
}

INLINE void expand_tiles(const struct expand_job *job, uint32_t begin, uint32_t end, uint32_t t,
                         const uint32_t nt, const uint32_t nv)
{
    for (uint32_t v = begin; v < end; v += 16 * nv) {
        if (t == 0) fetch_share(job, v, 16 * nv);
        expand_tile(job, v, t, nt, nv);
    }
}

// Eight triples at a time, then four; those left over one by one.
void relight_expand_avx512(const struct expand_job *job)
{
    const uint32_t n = job->n_triple, n4 = n & ~3u;
    for (uint32_t v0 = job->begin; n4 && v0 < job->end; v0 += AHEAD) {
        const uint32_t end = job->end - v0 < AHEAD ? job->end : v0 + AHEAD;
        uint32_t t = 0;
        for (; t + 8 <= n; t += 8) expand_tiles(job, v0, end, t, 8, 1);
        if (t + 4 <= n) expand_tiles(job, v0, end, t, 4, 2);
    }
    for (uint32_t t = n4; t < n; t++) expand_chunks(job, t, false);
}

void relight_radial_avx512(const struct expand_job *job)
{
    for (uint32_t t = 0; t < job->n_triple; t++) expand_chunks(job, t, true);
}
#endif
