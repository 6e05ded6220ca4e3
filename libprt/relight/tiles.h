// SPDX-License-Identifier: MIT
// How colours of several triples get from registers to their vertices: for expand_avx512.c and
// expand_vnni.c.
#ifndef PRT_RELIGHT_TILES_H
#define PRT_RELIGHT_TILES_H

#include "avx512.h"

#if defined(__x86_64__)
#include <string.h>

INLINE __m512 load_u(const uint16_t *u)
{
    return _mm512_cvtph_ps(_mm256_loadu_si256((const __m256i *)u));
}

// Two rows of U for 16 vertices.
struct two {
    __m512 x[2];
};

INLINE struct two load_pairs(const int16_t *u)
{
    const __m512i x = _mm512_loadu_si512(u);
    return (struct two){{_mm512_cvtepi32_ps(_mm512_srai_epi32(_mm512_slli_epi32(x, 16), 16)),
                         _mm512_cvtepi32_ps(_mm512_srai_epi32(x, 16))}};
}

// Whether `width` positions are as many vertices in a row in the file.
INLINE bool in_a_row(const struct expand_job *job, uint32_t v, uint32_t width)
{
    const uint32_t first = job->order[v];
    uint32_t other = 0;
    if (job->end - v < width) return false;
    for (uint32_t i = 0; i < width; i++) other |= job->order[v + i] ^ (first + i);
    return !other;
}

// r g b of 16 positions to 48 floats r g b r g b ...
INLINE void put_row(float *out, __m512 r, __m512 g, __m512 b, bool add)
{
    // lanes of each third: from r and g first (16 + i is g's lane i), then b over them
    const __m512i rg0 = _mm512_setr_epi32(0, 16, 0, 1, 17, 0, 2, 18, 0, 3, 19, 0, 4, 20, 0, 5);
    const __m512i rg1 =
        _mm512_setr_epi32(21, 0, 6, 22, 0, 7, 23, 0, 8, 24, 0, 9, 25, 0, 10, 26);
    const __m512i rg2 =
        _mm512_setr_epi32(0, 11, 27, 0, 12, 28, 0, 13, 29, 0, 14, 30, 0, 15, 31, 0);
    const __m512i b0 = _mm512_setr_epi32(0, 0, 0, 0, 0, 1, 0, 0, 2, 0, 0, 3, 0, 0, 4, 0);
    const __m512i b1 = _mm512_setr_epi32(0, 5, 0, 0, 6, 0, 0, 7, 0, 0, 8, 0, 0, 9, 0, 0);
    const __m512i b2 = _mm512_setr_epi32(10, 0, 0, 11, 0, 0, 12, 0, 0, 13, 0, 0, 14, 0, 0, 15);
    __m512 x = _mm512_mask_permutexvar_ps(_mm512_permutex2var_ps(r, rg0, g), 0x4924, b0, b);
    __m512 y = _mm512_mask_permutexvar_ps(_mm512_permutex2var_ps(r, rg1, g), 0x2492, b1, b);
    __m512 z = _mm512_mask_permutexvar_ps(_mm512_permutex2var_ps(r, rg2, g), 0x9249, b2, b);
    if (add) {
        x = _mm512_add_ps(x, _mm512_loadu_ps(out));
        y = _mm512_add_ps(y, _mm512_loadu_ps(out + 16));
        z = _mm512_add_ps(z, _mm512_loadu_ps(out + 32));
    }
    _mm512_storeu_ps(out, x);
    _mm512_storeu_ps(out + 16, y);
    _mm512_storeu_ps(out + 32, z);
}

// Colours leave block by block, for several triples at once. Where the vertices of a block are a
// few runs of neighbours in the file, a run's colours are written as whole vectors; elsewhere
// vertex by vertex.
enum { BLOCK = 128, ROW = 3 * BLOCK + 16, TILE_TRIPLES = 8, LONG_RUN = 8 };

// Vertices ahead whose U a tile asks for, row by row as it reads its own; a prefetch behind the
// end does no harm.
enum { AHEAD = 64 };

struct run {
    uint32_t from, n; // floats in a triple's row of the block
    size_t to;        // floats in a triple's plane
};

struct block {
    float rgb[TILE_TRIPLES][ROW] __attribute__((aligned(64))); // [triple][vertex][3]
    uint32_t n, n_run; // vertices; runs, 0 when they are short
    union {
        struct run run[BLOCK / LONG_RUN];
        size_t at[BLOCK]; // floats in a triple's plane
    };
};

// Finds the runs of positions [v, v + n), n <= BLOCK, or their places.
INLINE void find_places(const struct expand_job *job, uint32_t v, uint32_t n, struct block *block)
{
    const uint32_t *order = job->order + v;
    uint32_t breaks = 0;
    for (uint32_t i = 1; i < n; i++) breaks += order[i] != order[i - 1] + 1;
    block->n = n;
    block->n_run = 0;
    if ((breaks + 1) * LONG_RUN > n) {
        for (uint32_t i = 0; i < n; i++) block->at[i] = 3ull * order[i];
        return;
    }
    for (uint32_t i = 0, stop; i < n; i = stop) {
        for (stop = i + 1; stop < n && order[stop] == order[stop - 1] + 1;) stop++;
        block->run[block->n_run++] = (struct run){3 * i, 3 * (stop - i), 3ull * order[i]};
    }
}

// Asks for the lines of a plane that are to be read before they are written: all of them, or
// when whole lines go past the caches the others, where runs begin and end. The second cache has
// them come: the first can wait for few lines at once, and is needed for U.
INLINE void ask_plane(const struct block *block, const float *plane, bool stream)
{
    const uintptr_t line = 63;
    if (!block->n_run)
        for (uint32_t i = 0; i < block->n; i += 2)
            __builtin_prefetch(plane + block->at[i], 0, 2);
    for (uint32_t i = 0; i < block->n_run; i++) {
        const struct run *run = &block->run[i];
        const float *first = plane + run->to, *end = first + run->n;
        if (!stream || (uintptr_t)first & line) __builtin_prefetch(first, 0, 2);
        for (const float *p = first + 16; !stream && p < end; p += 16)
            __builtin_prefetch(p, 0, 2);
        if (!stream || (uintptr_t)end & line) __builtin_prefetch(end - 1, 0, 2);
    }
}

// n < 16 floats, in whole stores: a masked one that misses the caches waits for its line.
INLINE void put_few(float *out, const float *in, size_t n, bool add)
{
    if (n & 8) {
        const __m256 x = _mm256_loadu_ps(in);
        _mm256_storeu_ps(out, add ? _mm256_add_ps(x, _mm256_loadu_ps(out)) : x);
        in += 8, out += 8;
    }
    if (n & 4) {
        const __m128 x = _mm_loadu_ps(in);
        _mm_storeu_ps(out, add ? _mm_add_ps(x, _mm_loadu_ps(out)) : x);
        in += 4, out += 4;
    }
    if (n & 2) {
        out[0] = add ? out[0] + in[0] : in[0];
        out[1] = add ? out[1] + in[1] : in[1];
        in += 2, out += 2;
    }
    if (n & 1) *out = add ? *out + *in : *in;
}

INLINE void put_run(float *out, const float *in, size_t n, bool add, bool stream)
{
    if (stream && n >= 16) {
        const size_t head = (size_t)(-((uintptr_t)out / sizeof *out) & 15);
        put_few(out, in, head, false);
        out += head, in += head, n -= head;
    }
    for (; n >= 16; n -= 16, in += 16, out += 16) {
        __m512 x = _mm512_loadu_ps(in);
        if (add) x = _mm512_add_ps(x, _mm512_loadu_ps(out));
        if (stream) _mm512_stream_ps(out, x);
        else _mm512_storeu_ps(out, x);
    }
    put_few(out, in, n, add);
}

INLINE void put_vertices(const struct block *block, const float *rgb, float *plane, bool add)
{
    for (uint32_t i = 0; i < block->n; i++, rgb += 3) {
        float *out = plane + block->at[i];
        __m128 x = _mm_loadu_ps(rgb); // one behind
        if (add) x = _mm_add_ps(x, _mm_maskz_loadu_ps(7, out));
        _mm_mask_storeu_ps(out, 7, x);
    }
}

INLINE void put_runs(const struct block *block, const float *rgb, float *plane, bool add,
                     bool stream)
{
    if (!block->n_run) {
        put_vertices(block, rgb, plane, add);
        return;
    }
    for (uint32_t i = 0; i < block->n_run; i++) {
        const struct run *run = &block->run[i];
        put_run(plane + run->to, rgb + run->from, run->n, add, stream);
    }
}

INLINE void put_plane(const struct expand_job *job, const struct block *block, uint32_t t0,
                      uint32_t t)
{
    float *plane = job->color[t0 + t];
    if (job->stream) put_runs(block, block->rgb[t], plane, false, true);
    else if (job->add) put_runs(block, block->rgb[t], plane, true, false);
    else put_runs(block, block->rgb[t], plane, false, false);
}

// nt triples from t0 on of all the job's vertices, in tiles of 16 * nv vertices, nt * nv = 8, which
// `tile` computes: a block has as many tiles as triples. With every tile a plane of the block
// before leaves, since stores take their time and want other parts of the processor, and a plane's
// lines are asked for.
INLINE void expand_blocks(const struct expand_job *job, const void *user, uint32_t t0,
                          const uint32_t nt, const uint32_t nv,
                          void (*tile)(const struct expand_job *job, const void *user,
                                       uint32_t v, uint32_t t0, float *rgb, uint32_t nt,
                                       uint32_t nv))
{
    struct block block[2], *last = NULL;
    for (uint32_t v = job->begin, n; v < job->end; v += n) {
        struct block *now = last == block ? block + 1 : block;
        n = job->end - v < BLOCK ? job->end - v : BLOCK;
        find_places(job, v, n, now);
        for (uint32_t t = 0; t < nt; t++) {
            const uint32_t at = t * 16 * nv;
            ask_plane(now, job->color[t0 + t], job->stream);
            if (at < n) tile(job, user, v + at, t0, now->rgb[0] + 3 * at, nt, nv);
            if (last) put_plane(job, last, t0, t);
        }
        last = now;
    }
    for (uint32_t t = 0; last && t < nt; t++) put_plane(job, last, t0, t);
}

#endif
#endif
