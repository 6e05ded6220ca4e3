// SPDX-License-Identifier: MIT
// Writes colours of several triples from registers to their vertices. Included by
// expand_avx512.c and expand_vnni.c inside their regions of base/isa.h.
#ifndef PRT_RELIGHT_STORE_AVX512_H
#define PRT_RELIGHT_STORE_AVX512_H

PRT_INLINE __m512 load_u(const uint16_t *u)
{
    return _mm512_cvtph_ps(_mm256_loadu_si256((const __m256i *)u));
}

// Two rows of U for 16 vertices.
struct two {
    __m512 x[2];
};

PRT_INLINE struct two load_pairs(const int16_t *u)
{
    const __m512i x = _mm512_loadu_si512(u);
    return (struct two){{_mm512_cvtepi32_ps(_mm512_srai_epi32(_mm512_slli_epi32(x, 16), 16)),
                         _mm512_cvtepi32_ps(_mm512_srai_epi32(x, 16))}};
}

// Whether `width` positions are consecutive vertices of the file.
PRT_INLINE bool in_a_row(const struct expand_job *job, uint32_t v, uint32_t width)
{
    const uint32_t first = job->order[v];
    uint32_t other = 0;
    if (job->end - v < width) return false;
    for (uint32_t i = 0; i < width; i++) other |= job->order[v + i] ^ (first + i);
    return !other;
}

// Writes r, g, b of 16 positions as 48 floats r g b r g b ...
PRT_INLINE void put_row(float *out, __m512 r, __m512 g, __m512 b, bool add)
{
    // each third takes lanes of r and g first (16 + i is lane i of g), then of b
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

// Colours are written block by block for several triples at once. The vertices of a block are
// runs of neighbours in the file, so the stores of a plane are planned once for all planes.
enum { BLOCK = 128, TILE_TRIPLES = 8, BESIDE = 16, ROW = BESIDE + 3 * BLOCK + BESIDE };

// A tile prefetches U of the vertices this far ahead, row by row as it reads its own. A
// prefetch past the end never faults.
enum { AHEAD = 64 };

struct store {
    int32_t from;   // floats from a row's first vertex, at least -BESIDE
    uint32_t lanes; // mask of the vector's lanes
    ptrdiff_t to;   // floats in a plane
};

// Partial stores use vectors of 4, 8 or 16 floats, so that they do not reach into cache lines
// where they store nothing. Blocks whose runs are shorter than SHORT_RUN on average are stored
// vertex by vertex.
enum { WIDTHS = 3, SHORT_RUN = 4 };

struct block {
    float rgb[TILE_TRIPLES][ROW] __attribute__((aligned(64))); // BESIDE, then [vertex][3]
    const uint32_t *order;                                     // of its n vertices
    uint32_t n;
    uint32_t shift; // floats between a cache line's begin and the plane's, which the stores
                    // were planned for
    uint32_t n_alone, n_whole, n_part[WIDTHS];
    struct store whole[3 * BLOCK / 16], part[WIDTHS][2 * BLOCK / SHORT_RUN];
    size_t alone[BLOCK]; // floats in a plane, of vertices that are stored alone
};

// Adds a partial store of n in [1, 15] floats, in the last lanes of its vector or the first.
PRT_INLINE void add_part(struct block *block, int32_t from, uint32_t n, ptrdiff_t to, bool last)
{
    const uint32_t width = (n > 4) + (n > 8), lead = last ? (4u << width) - n : 0;
    block->part[width][block->n_part[width]++] =
        (struct store){from - (int32_t)lead, ((1u << n) - 1) << lead, to - (ptrdiff_t)lead};
}

// Adds the stores of a run of n > 0 floats. Streamed stores are whole cache lines.
PRT_INLINE void add_run(struct block *block, int32_t from, uint32_t n, ptrdiff_t to,
                        bool stream)
{
    if (stream && n >= 16) {
        const uint32_t head = -((uint32_t)to + block->shift) & 15;
        if (head) add_part(block, from, head, to, true);
        from += (int32_t)head, to += (ptrdiff_t)head, n -= head;
    }
    for (; n >= 16; n -= 16, from += 16, to += 16)
        block->whole[block->n_whole++] = (struct store){from, 0xffff, to};
    if (n) add_part(block, from, n, to, false);
}

// Plans the stores of planes that begin `shift` floats after a cache line's begin.
PRT_INLINE void find_stores(struct block *block, uint32_t shift, bool stream)
{
    const uint32_t *order = block->order;
    uint32_t runs = 1;
    block->shift = shift;
    block->n_alone = block->n_whole = 0;
    memset(block->n_part, 0, sizeof block->n_part);
    for (uint32_t i = 1; i < block->n; i++) runs += order[i] != order[i - 1] + 1;
    if (runs * SHORT_RUN > block->n) {
        for (uint32_t i = 0; i < block->n; i++) block->alone[i] = 3ull * order[i];
        block->n_alone = block->n;
        return;
    }
    for (uint32_t i = 0, stop; i < block->n; i = stop) {
        for (stop = i + 1; stop < block->n && order[stop] == order[stop - 1] + 1;) stop++;
        add_run(block, (int32_t)(3 * i), 3 * (stop - i), (ptrdiff_t)(3ull * order[i]), stream);
    }
}

PRT_INLINE uint32_t shift_of(const float *plane, bool stream)
{
    return stream ? (uint32_t)((uintptr_t)plane / sizeof *plane & 15) : 0;
}

PRT_INLINE void begin_block(const struct expand_job *job, uint32_t v, uint32_t n, uint32_t t0,
                            struct block *block)
{
    block->order = job->order + v;
    block->n = n;
    find_stores(block, shift_of(job->color[t0], job->stream), job->stream);
}

PRT_INLINE float *place(float *plane, const struct store *s)
{
    return (float *)((uintptr_t)plane + (uintptr_t)(s->to * (ptrdiff_t)sizeof *plane));
}

// Prefetches the lines of a plane that are read before they are written: all of them, or, when
// whole lines bypass the caches, those where runs begin and end. They go to the L2 cache: L1
// has buffers for few outstanding lines and holds U.
PRT_INLINE void prefetch_plane(const struct block *block, float *plane, bool stream)
{
    for (uint32_t i = 0; i < block->n_alone; i += 2)
        __builtin_prefetch(plane + block->alone[i], 0, 2);
    for (uint32_t i = 0; !stream && i < block->n_whole; i++)
        __builtin_prefetch(place(plane, &block->whole[i]), 0, 2);
    for (uint32_t w = 0; w < WIDTHS; w++)
        for (uint32_t i = 0; i < block->n_part[w]; i++)
            __builtin_prefetch(place(plane, &block->part[w][i]), 0, 2);
}

PRT_INLINE void put_stores(const struct block *block, const float *rgb, float *plane, bool add,
                           bool stream)
{
    for (uint32_t i = 0; i < block->n_alone; i++) {
        float *out = plane + block->alone[i];
        __m128 x = _mm_loadu_ps(rgb + 3 * i);
        if (add) x = _mm_add_ps(x, _mm_maskz_loadu_ps(7, out));
        _mm_mask_storeu_ps(out, 7, x);
    }
    for (uint32_t i = 0; i < block->n_whole; i++) {
        const struct store *s = &block->whole[i];
        float *out = place(plane, s);
        __m512 x = _mm512_loadu_ps(rgb + s->from);
        if (add) x = _mm512_add_ps(x, _mm512_loadu_ps(out));
        if (stream) _mm512_stream_ps(out, x); // they begin at lines
        else _mm512_storeu_ps(out, x);
    }
    for (uint32_t i = 0; i < block->n_part[0]; i++) {
        const struct store *s = &block->part[0][i];
        const __mmask8 lanes = (__mmask8)s->lanes;
        float *out = place(plane, s);
        __m128 x = _mm_loadu_ps(rgb + s->from);
        if (add) x = _mm_add_ps(x, _mm_maskz_loadu_ps(lanes, out));
        _mm_mask_storeu_ps(out, lanes, x);
    }
    for (uint32_t i = 0; i < block->n_part[1]; i++) {
        const struct store *s = &block->part[1][i];
        const __mmask8 lanes = (__mmask8)s->lanes;
        float *out = place(plane, s);
        __m256 x = _mm256_loadu_ps(rgb + s->from);
        if (add) x = _mm256_add_ps(x, _mm256_maskz_loadu_ps(lanes, out));
        _mm256_mask_storeu_ps(out, lanes, x);
    }
    for (uint32_t i = 0; i < block->n_part[2]; i++) {
        const struct store *s = &block->part[2][i];
        const __mmask16 lanes = (__mmask16)s->lanes;
        float *out = place(plane, s);
        __m512 x = _mm512_loadu_ps(rgb + s->from);
        if (add) x = _mm512_add_ps(x, _mm512_maskz_loadu_ps(lanes, out));
        _mm512_mask_storeu_ps(out, lanes, x);
    }
}

PRT_INLINE void put_plane(const struct expand_job *job, struct block *block, uint32_t t0,
                          uint32_t t)
{
    float *plane = job->color[t0 + t];
    const float *rgb = block->rgb[t] + BESIDE;
    const uint32_t shift = shift_of(plane, job->stream);
    if (shift != block->shift) find_stores(block, shift, job->stream);
    if (job->stream) put_stores(block, rgb, plane, false, true);
    else if (job->add) put_stores(block, rgb, plane, true, false);
    else put_stores(block, rgb, plane, false, false);
}

// Expands nt triples from t0 on for all the job's vertices in tiles of 16 * nv vertices, nt *
// nv = 8, which `tile` computes. A block has as many tiles as triples. Each tile is followed by
// the stores of one plane of the block before, which overlap with its arithmetic, and by one
// plane's prefetches.
PRT_INLINE void expand_blocks(const struct expand_job *job, const void *user, uint32_t t0,
                              const uint32_t nt, const uint32_t nv,
                              void (*tile)(const struct expand_job *job, const void *user,
                                           uint32_t v, uint32_t t0, float *rgb, uint32_t nt,
                                           uint32_t nv))
{
    struct block block[2], *last = NULL;
    for (uint32_t v = job->begin, n; v < job->end; v += n) {
        struct block *now = last == block ? block + 1 : block;
        n = job->end - v < BLOCK ? job->end - v : BLOCK;
        begin_block(job, v, n, t0, now);
        for (uint32_t t = 0; t < nt; t++) {
            const uint32_t at = t * 16 * nv;
            prefetch_plane(now, job->color[t0 + t], job->stream);
            if (at < n) tile(job, user, v + at, t0, now->rgb[0] + BESIDE + 3 * at, nt, nv);
            if (last) put_plane(job, last, t0, t);
        }
        last = now;
    }
    for (uint32_t t = 0; last && t < nt; t++) put_plane(job, last, t0, t);
}

#endif
