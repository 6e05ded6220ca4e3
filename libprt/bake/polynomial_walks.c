// SPDX-License-Identifier: MIT
// Polynomial transport by random walks: the answers of joint transport's functions to the three
// channels of one light.
#include "bake/polynomial_walks.h"

#include <math.h>
#include <string.h>

void prt_radial_store(const struct prt_tensor *t, uint32_t cluster, float *columns)
{
    const struct prt_cluster *c = &t->cluster[cluster];
    const size_t n = c->n_vertex, padded = (n + 15) / 16 * 16, n_column = 3 * (size_t)c->rank;
    uint16_t *u = (uint16_t *)(uintptr_t)t->u + c->u_begin;
    float *scale = (float *)(uintptr_t)t->u_scale + (size_t)cluster * t->n_function * 3;
    for (size_t k = 0; k < n_column; k++, columns += n, u += padded) {
        float most = 0;
        int exponent = 15;
        for (size_t v = 0; v < n; v++) most = fmaxf(most, fabsf(columns[v]));
        if (most > 0 && isfinite(most)) frexpf(most, &exponent);
        if (exponent < -100) exponent = -100;
        const float inverse = ldexpf(1, 15 - exponent);
        for (size_t v = 0; v < n; v++) columns[v] *= inverse;
        scale[k] = ldexpf(1, exponent - 15);
        prt_f32_to_f16_array(columns, n, u);
    }
}

// [n_function][n_vertex][3] to the cluster's columns.
static void store(const struct prt_tensor *t, uint32_t c, uint32_t n_function, const float *x,
                  float *column)
{
    const size_t n = t->cluster[c].n_vertex;
    for (uint32_t j = 0; j < n_function; j++)
        for (size_t ch = 0; ch < 3; ch++)
            for (size_t v = 0; v < n; v++)
                column[(j * 3 + ch) * n + v] = x[(j * n + v) * 3 + ch];
    prt_radial_store(t, c, column);
}

static int multiple_cluster(const struct polynomial_walks *p, uint32_t c, const struct cut *cut)
{
    const struct bake *b = p->b;
    const uint32_t n = b->clusters->cluster[c].n_vertex;
    struct half_rows none = {.n_layer = 1};
    struct product_rows product = {&none, cut, n, p->pool.n_radial, &p->lit, NULL, NULL};
    struct walk_rows rows = {
        .pool = &p->pool, .product = &product, .medium = prt_bake_medium(b, c)};
    const struct free_walks_job job = {
        b, &p->pool, cut, &p->lit, (struct work_meters *)&b->work, c, b->walk->n_walk, false};
    float *out = prt_alloc((size_t)p->pool.n_function * n * 3, sizeof *out);
    float *column = prt_alloc((size_t)p->pool.n_function * n * 3, sizeof *column);
    int status = out && column ? PRT_OK : PRT_NOMEM;
    if (!status && prt_walks_in(b, c)) status = prt_free_walks_run(&job, &rows.walks);
    memcpy(b->walk->noise[c], rows.walks.noise, sizeof rows.walks.noise);
    if (!status) status = prt_walk_rows_multiply(&rows, p->lit.light, 3, out);
    if (!status) store(p->tensor, c, p->pool.n_function, out, column);
    prt_free_walks_finish(&rows.walks);
    prt_free(column);
    prt_free(out);
    return status;
}

int prt_polynomial_walks_multiple(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct polynomial_walks *p = arg;
    const struct bake *b = p->b;
    const struct radial_set radial = prt_bases_radial_set(p->bases);
    int status = PRT_OK;
    prt_trace_thread_init();
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!b->clusters->translucent[c]) continue;
        struct cut cut = {0};
        const struct cut_source from = prt_bake_cut_source(b);
        status = prt_cut_build(b->ctx, &from, (uint32_t)c, &radial, &cut);
        if (!status) status = multiple_cluster(p, (uint32_t)c, &cut);
        prt_cut_finish(&cut);
    }
    return status;
}

struct gather {
    const struct polynomial_walks *p;
    float *sum; // [n_function][3] of the vertex at hand, a vertex' stride apart
    size_t stride;
};

static void take_exit(void *arg, const struct prt_walk_exit *exit)
{
    const struct gather *g = arg;
    const struct walk_bake *w = g->p->b->walk;
    const struct prt_radial *extinction = g->p->bases->extinction;
    const uint32_t sample = prt_surface_stratum(w->strata, exit->triangle, exit->u, exit->v);
    if (sample == UINT32_MAX) return;
    const float *e = g->p->lit.value + (size_t)w->place[sample] * 3;
    const float share = exit->weight / ((float)M_PI * PRT_UNSCATTERED_PATHS);
    float value[64];
    prt_radial_eval(extinction, 1, &exit->length_mm, value);
    for (uint32_t j = 0; j < extinction->n_function; j++)
        for (int ch = 0; ch < 3; ch++)
            g->sum[j * g->stride + (size_t)ch] += share * value[j] * e[ch];
}

int prt_polynomial_walks_unscattered(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct polynomial_walks *p = arg;
    const struct bake *b = p->b;
    const uint32_t J = p->bases->extinction->n_function;
    int status = PRT_OK;
    prt_trace_thread_init();
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        if (!prt_walks_in(b, (uint32_t)c)) continue;
        const uint32_t n = b->clusters->cluster[c].n_vertex;
        float *sum = prt_calloc((size_t)J * n * 3, sizeof *sum);
        float *column = prt_alloc((size_t)J * n * 3, sizeof *column);
        struct gather g = {p, NULL, 3 * (size_t)n};
        if (!sum || !column) status = PRT_NOMEM;
        for (uint32_t v = 0; v < n && !status; v++) {
            g.sum = sum + 3 * (size_t)v;
            prt_bake_unscattered_paths(b, (uint32_t)c, v, PRT_LEAST_EXTINCTION, take_exit, &g);
        }
        if (!status) store(p->tensor, (uint32_t)c, J, sum, column);
        prt_free(sum);
        prt_free(column);
    }
    return status;
}
