// SPDX-License-Identifier: MIT
// Strata of the running area, and the sample of each. The area of a block is divided in halves
// again and again; the sample of a piece is that of one of its halves, which a hash chooses. So
// the samples of a coarse division are among those of a finer one, and those of a block depend
// on its own triangles alone: where a mesh is changed elsewhere, grows or is sampled otherwise,
// most samples stay where they are.
#include "trace/surface_private.h"

#include <math.h>

enum { HALVINGS = 40 }; // from a block's area to the finest piece

struct drawing {
    struct piece_list *list;
    uint64_t block, seed; // of the block at hand
    double begin, area;   // its range of the running area
    double piece;         // finest
    uint32_t capacity;
};

static uint64_t mix(uint64_t x)
{
    x += 0x9e3779b97f4a7c15u;
    x = (x ^ x >> 30) * 0xbf58476d1ce4e5b9u;
    x = (x ^ x >> 27) * 0x94d049bb133111ebu;
    return x ^ x >> 31;
}

// The finest piece that holds the sample of piece k, of 2^level of them.
static double sample_of(const struct drawing *d, unsigned level, uint64_t k)
{
    for (; level > 0; level--) k = 2 * k + (mix(k * 64 + level + d->seed) & 1);
    return ((double)k + 0.5) * d->piece;
}

// Van der Corput's sequence, shifted by the block.
static double spread_evenly(const struct drawing *d, uint64_t k)
{
    uint64_t bits = 0, i = k ^ mix(d->seed);
    for (int b = 0; b < 32; b++) bits = bits << 1 | (i >> b & 1);
    return (double)bits * 0x1p-32;
}

static int add(struct drawing *d, unsigned level, uint64_t k)
{
    struct piece_list *list = d->list;
    const double sample = sample_of(d, level, k);
    if (sample >= d->area) return PRT_OK;
    if (list->n_stratum == d->capacity) {
        const uint32_t more = 2 * d->capacity + 256;
        struct surface_stratum *grown = prt_alloc(more, sizeof *grown);
        if (!grown) return PRT_NOMEM;
        for (uint32_t i = 0; i < list->n_stratum; i++) grown[i] = list->stratum[i];
        prt_free(list->stratum);
        list->stratum = grown;
        d->capacity = more;
    }
    list->stratum[list->n_stratum++] = (struct surface_stratum){
        d->begin + ldexp((double)k, (int)level) * d->piece, d->begin + sample};
    return PRT_OK;
}

// Pieces of 2^level, and the share `fine` of them in halves.
static int draw_block(struct drawing *d, unsigned level, double fine)
{
    const double step = ldexp(d->piece, (int)level);
    int status = PRT_OK;
    d->seed = mix(d->block ^ d->seed);
    for (uint64_t k = 0; !status && (double)k * step < d->area; k++) {
        const bool halves = level && spread_evenly(d, k) < fine;
        status = add(d, level - halves, k << halves);
        if (!status && halves) status = add(d, level - 1, 2 * k + 1);
    }
    return status;
}

int prt_surface_draw(struct piece_list *list, double n_sample, uint64_t seed)
{
    struct drawing d = {.list = list, .piece = ldexp(list->edge * list->edge, -HALVINGS)};
    const double step = list->end[list->n - 1] / n_sample;
    double level = ceil(log2(step / d.piece));
    level = fmin(fmax(level, 0), HALVINGS + 20);
    const double fine = fmax(ldexp(d.piece, (int)level) / step - 1, 0);
    int status = PRT_OK;
    list->stratum = NULL;
    list->n_stratum = 0;
    for (uint32_t i = 0, last; i < list->n && !status; i = last) {
        for (last = i + 1; last < list->n && list->block[last] == list->block[i];) last++;
        d.block = list->block[i];
        d.begin = i ? list->end[i - 1] : 0;
        d.area = list->end[last - 1] - d.begin;
        d.seed = seed;
        status = draw_block(&d, (unsigned)level, fine);
    }
    return status;
}
