// SPDX-License-Identifier: MIT
// Expansion for AVX-512: U times the contracted rows, and the sums of polynomial transport.
#include "avx512.h"
#include "scatter.h"

#include <string.h>

#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX512)
#include "store_avx512.h"
#include "chunk_avx512.h"

// One triple in chunks of vertices. Polynomial transport has three times the rows and
// prefetches to the L2 cache: the L1 cache has too few buffers for outstanding lines.
enum { RADIAL_CHUNK = 2048 };

struct chunk {
    const uint16_t *u;    // first row of the group, first vertex of the chunk
    const uint16_t *next; // the same of the next group
    size_t stride;
    const float *b;
    size_t b_stride;
    uint32_t n; // vertices rounded up to 16
    float *sum; // [n/16][3][16]
};

PRT_INLINE void add_row(__m512 sum[3], __m512 x, const float *b)
{
    for (int ch = 0; ch < 3; ch++) sum[ch] = _mm512_fmadd_ps(x, _mm512_set1_ps(b[ch]), sum[ch]);
}

// n_row: 1, or even.
PRT_INLINE void expand_group(const struct chunk *c, const int n_row, bool first)
{
    const size_t stride = 2 * c->stride, bs = c->b_stride;
    const float *b = c->b;
    for (uint32_t v = 0; v < c->n; v += 16) {
        float *sum = c->sum + 3 * v;
        const uint16_t *u = c->u + 2 * v, *next = c->next + 2 * v;
        __m512 x[3];
        for (int ch = 0; ch < 3; ch++)
            x[ch] = first ? _mm512_setzero_ps() : _mm512_load_ps(sum + 16 * ch);
        for (int k = 0; k < n_row; k += 2) {
            const struct two two = load_pairs((const int16_t *)u + k / 2 * stride);
            _mm_prefetch((const char *)(next + k / 2 * stride), _MM_HINT_T0);
            add_row(x, two.x[0], b + k * bs);
            if (n_row > 1) add_row(x, two.x[1], b + (k + 1) * bs);
        }
        for (int ch = 0; ch < 3; ch++) _mm512_store_ps(sum + 16 * ch, x[ch]);
    }
}

// Polynomial transport: a function has one row for each channel.
PRT_INLINE void radial_group(const struct chunk *c, const int n_function, bool first)
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
PRT_INLINE uint32_t run_group(const struct chunk *c, uint32_t left, bool first, bool radial)
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

PRT_INLINE void expand_chunks(const struct expand_job *job, uint32_t t, bool radial)
{
    const uint32_t most = radial ? RADIAL_CHUNK : CHUNK;
    float sum[3 * RADIAL_CHUNK] __attribute__((aligned(64)));
    const uint32_t group = radial ? 4 : 8;
    // numbers of U from vertex to vertex, and from function to function, of pairs half that
    const size_t each = radial ? 1 : 2, row = radial ? 3 * job->stride : job->stride;
    const uint16_t *base = job->u + (radial ? (size_t)t * job->rank * row : 0);
    const __m512 unit = _mm512_set1_ps(radial ? 1 : PRT_U_UNIT);
    for (uint32_t v0 = job->begin; v0 < job->end; v0 += most) {
        uint32_t n = job->end - v0 < most ? job->end - v0 : most;
        struct chunk c = {
            .stride = job->stride, .b_stride = job->b_stride, .n = (n + 15) & ~15u, .sum = sum};
        if (!job->rank) memset(sum, 0, 3 * c.n * sizeof *sum);
        claim(job, t, v0, n);
        for (uint32_t r = 0; r < job->rank;) {
            c.u = base + each * v0 + r * row;
            // The last group prefetches the next chunk, and the last chunk what follows it in
            // memory, which is the next plane or cluster. A prefetch never faults.
            uint32_t left = job->rank - r;
            c.next = left > group           ? c.u + group * row
                     : v0 + most < job->end ? base + each * (v0 + most)
                                            : c.u + left * row;
            c.b = job->b + r * job->b_stride + (radial ? 0 : 3 * t);
            r += run_group(&c, left, r == 0, radial);
        }
        for (uint32_t v = 0; v < n; v += 16)
            put16(job, v0 + v, t, in_a_row(job, v0 + v, 16),
                  _mm512_mul_ps(_mm512_load_ps(sum + 3 * v), unit),
                  _mm512_mul_ps(_mm512_load_ps(sum + 3 * v + 16), unit),
                  _mm512_mul_ps(_mm512_load_ps(sum + 3 * v + 32), unit));
    }
}

// Several triples. The 24 sums of nt triples and nv vectors of 16 vertices (nt * nv = 8) stay
// in registers, so that a row of U takes 24 fused multiply-adds and little else. Writes triples
// [t0, t0 + nt) of the vertices from v on to rgb[triple][ROW]. Where the second vector would
// lie past the padded rows, the first is used twice; those vertices do not exist.
PRT_INLINE void expand_tile(const struct expand_job *job, const void *user, uint32_t v,
                            uint32_t t0, float *rgb, uint32_t nt, uint32_t nv)
{
    const size_t second = nv == 2 && v + 32 <= job->stride ? 32 : 0;
    const __m512 unit = _mm512_set1_ps(PRT_U_UNIT);
    __m512 sum[8][3][2];
    const int16_t *u = (const int16_t *)job->u + 2 * (size_t)v;
    const float *b = job->b + 3 * t0;
    for (uint32_t t = 0; t < nt; t++)
        for (int ch = 0; ch < 3; ch++)
            for (uint32_t i = 0; i < nv; i++) sum[t][ch][i] = _mm512_setzero_ps();
    for (uint32_t r = 0; r < job->rank; r += 2, u += 2 * job->stride) {
        const struct two two[2] = {load_pairs(u), load_pairs(u + second)};
        for (uint32_t i = 0; i < nv; i++)
            _mm_prefetch((const char *)(u + 2 * AHEAD + 32 * i), _MM_HINT_T0);
        for (uint32_t k = 0; k < 2 && r + k < job->rank; k++, b += job->b_stride)
            for (uint32_t t = 0; t < nt; t++)
                for (uint32_t ch = 0; ch < 3; ch++)
                    for (uint32_t i = 0; i < nv; i++)
                        sum[t][ch][i] = _mm512_fmadd_ps(
                            two[i].x[k], _mm512_set1_ps(b[3 * t + ch]), sum[t][ch][i]);
    }
    for (uint32_t t = 0; t < nt; t++)
        for (uint32_t i = 0; i < nv; i++)
            put_row(rgb + ROW * t + 48 * i, _mm512_mul_ps(sum[t][0][i], unit),
                    _mm512_mul_ps(sum[t][1][i], unit), _mm512_mul_ps(sum[t][2][i], unit),
                    false);
}

// Triples go in groups of eight, then four, then one by one.
void prt_expand_avx512(const struct expand_job *job)
{
    const uint32_t n = job->n_triple;
    uint32_t t = 0;
    for (; t + 8 <= n; t += 8) expand_blocks(job, NULL, t, 8, 1, expand_tile);
    if (t + 4 <= n) expand_blocks(job, NULL, t, 4, 2, expand_tile), t += 4;
    if (t && job->stream) _mm_sfence();
    for (; t < n; t++) expand_chunks(job, t, false);
}

void prt_radial_avx512(const struct expand_job *job)
{
    for (uint32_t t = 0; t < job->n_triple; t++) expand_chunks(job, t, true);
}

PRT_ISA_END
#endif
