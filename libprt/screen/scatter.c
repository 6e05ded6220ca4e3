// SPDX-License-Identifier: MIT
// Light spread from emitters to the tiles of a G-buffer.
#include "internal.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

struct columns {
    float p[3][TILE_POINTS], sum[3][TILE_POINTS];
} __attribute__((aligned(64)));

struct job {
    struct frame *f;
    pair_fn pairs;
    const struct radial_table *table;
    const struct emitters *list;   // per object, or
    const struct tree *tree;
    const struct samples *samples;
    float opening, r_max;
    struct emitters *scratch;      // per worker
    atomic_uint_fast64_t n_pair;
};

static uint32_t load_tile(const struct frame *f, uint32_t tile, struct columns *c, float lo[3],
                          float hi[3])
{
    uint32_t first = f->tiles.begin[tile], n = f->tiles.begin[tile + 1] - first;
    uint32_t padded = (n + 15) & ~15u;
    memset(c->sum, 0, sizeof c->sum);
    for (int k = 0; k < 3; k++) {
        const float *p = f->g.position[k];
        lo[k] = INFINITY;
        hi[k] = -INFINITY;
        for (uint32_t i = 0; i < padded; i++) {
            c->p[k][i] = p[f->tiles.order[first + (i < n ? i : 0)]];
            lo[k] = min_f(lo[k], c->p[k][i]);
            hi[k] = max_f(hi[k], c->p[k][i]);
        }
    }
    return n;
}

static int run(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *job = arg;
    struct frame *f = job->f;
    uint64_t pairs = 0;
    for (size_t tile = begin; tile < end; tile++) {
        struct columns c;
        float lo[3], hi[3];
        uint32_t n = load_tile(f, (uint32_t)tile, &c, lo, hi), object = f->tiles.object[tile];
        const struct emitters *e = job->list ? &job->list[object] : &job->scratch[worker];
        if (job->tree) {
            job->scratch[worker].n = 0;
            if (!tree_gather(job->tree, job->samples, object, lo, hi, job->opening, job->r_max,
                             &job->scratch[worker]))
                return PRT_NOMEM;
        }
        const float *const p[3] = {c.p[0], c.p[1], c.p[2]};
        float *const sum[3] = {c.sum[0], c.sum[1], c.sum[2]};
        // long lists in pieces that stay in the first-level cache
        for (uint32_t at = 0; at < e->n; at += 512)
            job->pairs(&job->table[object], e, at, at + 512 < e->n ? at + 512 : e->n,
                       (n + 15) & ~15u, p, sum);
        pairs += (uint64_t)n * e->n;
        for (uint32_t i = 0; i < n; i++) {
            uint32_t point = f->tiles.order[f->tiles.begin[tile] + i];
            for (int k = 0; k < 3; k++)
                f->radiance[point][k] += c.sum[k][i] * (float)(1 / M_PI);
        }
    }
    atomic_fetch_add(&job->n_pair, pairs);
    return PRT_OK;
}

static int go(struct job *job)
{
    struct frame *f = job->f;
    unsigned n_worker = prt_pool_size(f->ctx ? f->ctx->pool : NULL);
    job->pairs = pair_kernel(f->ctx ? f->ctx->cpu : prt_cpu_detect());
    job->scratch = calloc(n_worker, sizeof *job->scratch);
    if (!job->scratch) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    int status = prt_parallel_for(f->ctx, NULL, f->tiles.n_tile, 8, run, job);
    for (unsigned w = 0; w < n_worker; w++) emitters_finish(&job->scratch[w]);
    free(job->scratch);
    f->report->n_pair += atomic_load(&job->n_pair);
    return status;
}

int scatter_all(struct frame *f, const struct radial_table *table, const struct emitters *list)
{
    struct job job = {.f = f, .table = table, .list = list};
    return go(&job);
}

int scatter_tree(struct frame *f, const struct radial_table *table, const struct samples *s,
                 float opening, float r_max)
{
    struct tree tree;
    int status = tree_build(s, f->n_object, &tree);
    if (status) return prt_fail(f->ctx, status, "screen: no memory for a tree of %u", s->n);
    struct job job = {.f = f, .table = table, .tree = &tree, .samples = s, .opening = opening,
                      .r_max = r_max};
    status = go(&job);
    tree_finish(&tree);
    return status;
}
