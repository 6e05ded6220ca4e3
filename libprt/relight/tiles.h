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

// Colours leave in tiles of nt triples for width vertices, nt * width = 128. Their places, all
// over the arrays, are asked for while the tile before is computed, a line or two between two
// rows of U; loops with more than that between the rows make the compiler spill the sums.
enum { AHEAD = 512, TILE = 8 * 16 };

struct places {
    float *color;
    size_t plane, at[8]; // floats: from triple to triple, eight of the vertices
};

// Places of the tile from v on, in case that there is one.
INLINE struct places places_of(const struct expand_job *job, uint32_t v, uint32_t t0,
                               const uint32_t width)
{
    struct places p = {job->color + t0 * job->plane, job->plane, {0}};
    for (uint32_t i = 0; i < 8; i++) {
        // every fourth of the positions first: of few rows, not all get their turn
        uint32_t at = v + (i % 4 * 2 + i / 4) * (width / 8);
        p.at[i] = 3ull * job->order[at < job->end ? at : job->end - 1];
    }
    return p;
}

// Any 8 * nt successive numbers k ask for all. The second cache has them come: the first can wait
// for few lines at once, and is needed for U.
INLINE void ask(const struct places *p, uint32_t k, const uint32_t nt)
{
    __builtin_prefetch(p->color + k % nt * p->plane + p->at[k / nt % 8], 0, 2);
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

INLINE void put1(float *out, const float *rgb, bool add)
{
    uint64_t rg;
    uint32_t b;
    if (add) {
        for (int ch = 0; ch < 3; ch++) out[ch] += rgb[ch];
        return;
    }
    memcpy(&rg, rgb, 8);
    memcpy(&b, rgb + 2, 4);
    memcpy(out, &rg, 8);
    memcpy(out + 2, &b, 4);
}

// A tile in rgb[triple][width][3] to the vertices from v on.
INLINE void put_tile(const struct expand_job *job, uint32_t v, uint32_t t0, const uint32_t nt,
                     const uint32_t width, const float *rgb)
{
    const uint32_t *order = job->order + v, n = job->end - v < width ? job->end - v : width;
    for (uint32_t t = 0; t < nt; t++, rgb += 3 * width) {
        float *color = job->color + (t0 + t) * job->plane;
        if (job->add)
            for (uint32_t i = 0; i < n; i++) put1(color + 3ull * order[i], rgb + 3 * i, true);
        else if (n == width)
            for (uint32_t i = 0; i < width; i++)
                put1(color + 3ull * order[i], rgb + 3 * i, false);
        else
            for (uint32_t i = 0; i < n; i++) put1(color + 3ull * order[i], rgb + 3 * i, false);
    }
}

// A tile whose colours wait: they leave for their vertices while the next one is computed, since
// stores of a few bytes take as long as the sums and want other parts of the processor.
struct waiting {
    float rgb[3 * TILE + 1] __attribute__((aligned(64))); // [triple][width][3], one read behind
    uint32_t n;                                       // portions left of PORTIONS
    float *color;                                     // of the first triple
    size_t plane;
    size_t at[32]; // floats: where each position's vertex is
};
enum { PORTIONS = 16, PORTION = TILE / PORTIONS };

// each: portions of a triple.
INLINE void put_portion(struct waiting *w, const uint32_t each)
{
    const uint32_t k = PORTIONS - w->n--;
    const size_t *at = w->at + k % each * PORTION;
    const float *rgb = w->rgb + 3 * PORTION * k;
    float *color = w->color + k / each * w->plane;
    for (uint32_t i = 0; i < PORTION; i++)
        _mm_mask_storeu_ps(color + at[i], 7, _mm_loadu_ps(rgb + 3 * i));
}

INLINE void put_rest(struct waiting *w, const uint32_t each)
{
    while (w->n) put_portion(w, each);
}

// What waiting->rgb holds of the tile from v on is to go to nt triples from t0 on.
INLINE void put_later(const struct expand_job *job, uint32_t v, uint32_t t0, const uint32_t nt,
                      struct waiting *waiting)
{
    const uint32_t width = TILE / nt;
    if (job->add || job->end - v < width) {
        put_tile(job, v, t0, nt, width, waiting->rgb);
        return;
    }
    waiting->n = PORTIONS;
    waiting->color = job->color + t0 * job->plane;
    waiting->plane = job->plane;
    for (uint32_t i = 0; i < width; i++) waiting->at[i] = 3ull * job->order[v + i];
}

// Fetches a share of the next AHEAD vertices' rows, each row's bytes in one go.
INLINE void fetch_share(const struct expand_job *job, uint32_t v, uint32_t width)
{
    const uint32_t share = v % AHEAD / width, n_share = AHEAD / width;
    const uint32_t from = v - v % AHEAD + AHEAD;
    if (from >= job->end) return;
    for (uint32_t r = job->rank * share / n_share; r < job->rank * (share + 1) / n_share; r++)
        for (uint32_t i = 0; i < AHEAD; i += 32)
            _mm_prefetch((const char *)(job->u + r * job->stride + from + i), _MM_HINT_T1);
}

#endif
#endif
