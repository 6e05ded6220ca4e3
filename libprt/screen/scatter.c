// SPDX-License-Identifier: MIT
// Adds light of emitters to the tiles of a view's receivers: all pairs, or clusters of a tree.
#include "internal.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

struct job {
    struct frame *f;
    pair_fn pairs;
    const struct radial_table *table;
    const struct emitters *list; // [n_object] in classes; NULL: the tree
    const uint32_t (*class_end)[CLASSES];
    const struct tree *tree;
    float opening, r_max;
    struct emitters *scratch; // [worker] list for a tile
    atomic_uint_fast64_t n_pair;
};

static void tile_box(const struct view_cache *v, uint32_t tile, float lo[3], float hi[3])
{
    for (int k = 0; k < 3; k++) {
        lo[k] = INFINITY;
        hi[k] = -INFINITY;
        for (uint32_t i = v->begin[tile]; i < v->begin[tile + 1]; i++) {
            lo[k] = min_f(lo[k], v->p[k][i]);
            hi[k] = max_f(hi[k], v->p[k][i]);
        }
    }
}

static int run(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *job = arg;
    struct frame *f = job->f;
    const struct view_cache *v = f->view;
    uint64_t pairs = 0;
    for (size_t tile = begin; tile < end; tile++) {
        uint32_t first = v->begin[tile], n = v->begin[tile + 1] - first,
                 object = v->object[tile];
        const float *const p[3] = {v->p[0] + first, v->p[1] + first, v->p[2] + first};
        float *const sum[3] = {f->sum[0] + first, f->sum[1] + first, f->sum[2] + first};
        if (job->list) {
            const struct emitters *e = &job->list[object];
            uint32_t at = 0;
            for (uint32_t k = 0; k < CLASSES; k++) {
                uint32_t last = job->class_end[object][k];
                // pieces of 512 emitters (12 KiB) stay in the L1 cache
                for (; at < last; at = at + 512 < last ? at + 512 : last)
                    job->pairs(&job->table[object * CLASSES + k], e, at,
                               at + 512 < last ? at + 512 : last, n, p, sum);
            }
            pairs += (uint64_t)n * e->n;
            continue;
        }
        float lo[3], hi[3];
        struct emitters *e = &job->scratch[worker];
        tile_box(v, (uint32_t)tile, lo, hi);
        e->n = 0;
        if (!prt_tree_gather(job->tree, object, lo, hi, job->opening, job->r_max, e))
            return PRT_NOMEM;
        for (uint32_t at = 0; at < e->n; at += 512)
            job->pairs(&job->table[object], e, at, at + 512 < e->n ? at + 512 : e->n, n, p,
                       sum);
        pairs += (uint64_t)n * e->n;
    }
    atomic_fetch_add(&job->n_pair, pairs);
    return PRT_OK;
}

static int go(struct job *job)
{
    struct frame *f = job->f;
    unsigned n_worker = prt_pool_size(f->ctx ? f->ctx->pool : NULL);
    job->pairs = prt_pair_kernel(f->ctx ? f->ctx->cpu : prt_cpu_detect());
    job->scratch = calloc(n_worker, sizeof *job->scratch);
    if (!job->scratch) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    int status = prt_screen_loop(f->ctx, f->view->n_tile, 4, run, job);
    for (unsigned w = 0; w < n_worker; w++) prt_emitters_finish(&job->scratch[w]);
    free(job->scratch);
    f->report->n_pair += atomic_load(&job->n_pair);
    return status;
}

int prt_scatter_all(struct frame *f, const struct radial_table *table,
                    const struct emitters *list, const uint32_t (*class_end)[CLASSES])
{
    struct job job = {.f = f, .table = table, .list = list, .class_end = class_end};
    return go(&job);
}

int prt_scatter_tree(struct frame *f, const struct radial_table *table, const struct samples *s,
                     float opening, float r_max)
{
    struct tree tree;
    int status = prt_tree_build(f->ctx, s, f->n_object, &tree);
    if (status) return prt_fail(f->ctx, status, "screen: no memory for a tree of %u", s->n);
    struct job job = {
        .f = f, .table = table, .tree = &tree, .opening = opening, .r_max = r_max};
    status = go(&job);
    prt_tree_finish(&tree);
    return status;
}
