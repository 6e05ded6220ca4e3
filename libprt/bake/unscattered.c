// SPDX-License-Identifier: MIT
// Light that crosses a body without a scattering (METHODS §9), gathered diffusely: straight
// paths fill the matrix between vertices and rows.
#include "bake/sources.h"
#include "bake/walks.h"

#include "prt/radial.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct gather {
    const struct bake *b;
    const uint32_t *column;
    float *k; // of the vertex at hand
    size_t n_vertex, stride;
    double sigma_t[3];
};

static void take_exit(void *arg, const struct prt_walk_exit *exit)
{
    const struct gather *g = arg;
    const struct walk_bake *w = g->b->walk;
    const uint32_t sample = prt_surface_stratum(w->strata, exit->triangle, exit->u, exit->v);
    if (sample == UINT32_MAX) return;
    const uint32_t column = g->column[w->place[sample]];
    if (column == UINT32_MAX) return;
    float *k = g->k + (size_t)column * g->n_vertex;
    for (int c = 0; c < 3; c++)
        k[(size_t)c * g->stride] +=
            (float)((double)exit->weight / (M_PI * PRT_UNSCATTERED_PATHS) *
                    exp(-g->sigma_t[c] * (double)exit->length_mm));
}

void prt_bake_unscattered_paths(const struct bake *b, uint32_t c, uint32_t v, float sigma_t,
                                void (*sink)(void *arg, const struct prt_walk_exit *exit),
                                void *arg)
{
    const uint32_t vertex = b->clusters->order[b->clusters->cluster[c].vertex_begin + v];
    struct prt_walk_start start;
    prt_walk_start_at(b->walk->space, vertex, b->clusters->object[c],
                      prt_hash64(&vertex, sizeof vertex, b->o.seed + 0x0c1e), &start);
    prt_walk_unscattered(b->walk->space, &start, b->o.media.medium[prt_bake_medium(b, c)].eta,
                         sigma_t, PRT_UNSCATTERED_PATHS, sink, arg);
}

static int fill(const struct bake *b, uint32_t c, struct cut *cut)
{
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    const struct prt_material *m = &b->o.media.medium[prt_bake_medium(b, c)];
    uint32_t *column = prt_walk_columns(b, cut);
    struct gather g = {.b = b,
                       .column = column,
                       .n_vertex = cluster->n_vertex,
                       .stride = (size_t)cluster->n_vertex * cut->n_column};
    double least = INFINITY;
    if (!column) return PRT_NOMEM;
    for (int ch = 0; ch < 3; ch++) {
        g.sigma_t[ch] = (double)m->sigma_s_prime[ch] + (double)m->sigma_a[ch];
        least = fmin(least, g.sigma_t[ch]);
    }
    memset(cut->k, 0, 3 * g.stride * sizeof *cut->k);
    for (uint32_t v = 0; v < cluster->n_vertex; v++) {
        g.k = cut->k + v;
        prt_bake_unscattered_paths(b, c, v, (float)least, take_exit, &g);
    }
    prt_free(column);
    return PRT_OK;
}

static int build_cut(const struct bake *b, uint32_t c, struct cut *cut)
{
    const struct cut_source from = prt_bake_cut_source(b);
    return prt_cut_build(b->ctx, &from, c, &b->radial[prt_bake_medium(b, c)], cut);
}

// The rows of a cluster, of n_function functions in cut->k.
static int take_rows(const struct tensor_job *job, uint32_t c, const struct cut *cut,
                     uint32_t n_function)
{
    const struct bake *b = job->bake;
    const uint32_t n = b->clusters->cluster[c].n_vertex;
    struct product_rows rows = {&b->irradiance, cut, n, n_function, job->lit, job->work, NULL};
    const struct row_source source = {&rows, n, prt_product_multiply, prt_product_project,
                                      prt_product_combine};
    return prt_bake_take_rows(job, c, &source);
}

int prt_bake_unscattered_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    const struct bake *b = job->bake;
    int status = PRT_OK;
    prt_trace_thread_init();
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!prt_walks_in(b, (uint32_t)c)) continue;
        struct cut cut = {0};
        const uint64_t started = prt_work_begin();
        status = build_cut(b, (uint32_t)c, &cut);
        if (status == PRT_OK) status = fill(b, (uint32_t)c, &cut);
        prt_work_end(job->work, WORK_WALKS, started, 0, 0);
        if (status == PRT_OK) status = take_rows(job, (uint32_t)c, &cut, 3);
        prt_cut_finish(&cut);
    }
    return status;
}

// ---- a free medium

struct free_gather {
    const struct bake *b;
    const struct prt_radial *extinction;
    const uint32_t *column;
    float *k; // of the vertex at hand
    size_t n_vertex, stride;
};

static void take_free_exit(void *arg, const struct prt_walk_exit *exit)
{
    const struct free_gather *g = arg;
    const struct walk_bake *w = g->b->walk;
    const uint32_t sample = prt_surface_stratum(w->strata, exit->triangle, exit->u, exit->v);
    if (sample == UINT32_MAX || g->column[w->place[sample]] == UINT32_MAX) return;
    float value[64], *k = g->k + g->column[w->place[sample]] * g->n_vertex;
    const float share = exit->weight / ((float)M_PI * PRT_UNSCATTERED_PATHS);
    prt_radial_eval(g->extinction, 1, &exit->length_mm, value);
    for (uint32_t j = 0; j < g->extinction->n_function; j++)
        k[j * g->stride] += share * value[j];
}

// One cluster: the functions of the paths' lengths, in place of the cut's kernel.
static int free_cluster(const struct tensor_job *job, uint32_t c)
{
    const struct bake *b = job->bake;
    const uint32_t n = b->clusters->cluster[c].n_vertex, J = job->n_function;
    struct cut cut = {0};
    const uint64_t started = prt_work_begin();
    int status = build_cut(b, c, &cut);
    uint32_t *column = status ? NULL : prt_walk_columns(b, &cut);
    float *k = prt_calloc((size_t)J * n * cut.n_column + 1, sizeof *k);
    if (!status && (!k || !column)) status = PRT_NOMEM;
    struct free_gather g = {b, job->user, column, NULL, n, (size_t)n * cut.n_column};
    for (uint32_t v = 0; v < n && !status; v++) {
        g.k = k + v;
        prt_bake_unscattered_paths(b, c, v, PRT_LEAST_EXTINCTION, take_free_exit, &g);
    }
    prt_work_end(job->work, WORK_WALKS, started, 0, 0);
    struct cut own = cut;
    own.k = k;
    if (!status) status = take_rows(job, c, &own, J);
    prt_free(k);
    prt_free(column);
    prt_cut_finish(&cut);
    return status;
}

int prt_bake_free_unscattered_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    int status = PRT_OK;
    prt_trace_thread_init();
    for (size_t c = begin; status == PRT_OK && c < end; c++)
        if (prt_walks_in(job->bake, (uint32_t)c)) status = free_cluster(job, (uint32_t)c);
    return status;
}
