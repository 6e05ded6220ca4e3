// SPDX-License-Identifier: MIT
// Single scattering's rows of a cluster as the cells they were integrated in (single.c): texels
// that share their rays share one value. Half the numbers of dense rows, and those as halves.
#include "bake/run.h"

#include <cblas.h>
#include <stdlib.h>
#include <string.h>

enum { FACES = 6 };

struct vertex_cells {
    uint32_t n_cell, begin[FACES + 1]; // a face's cells are contiguous
    uint32_t *cell;                    // [n_coef]
    uint16_t *value;                   // [n_function][n_cell] halves
};

struct cell_rows {
    uint32_t n_vertex, n_function, n_coef;
    struct vertex_cells *vertex;
};

static void cell_rows_finish(struct cell_rows *r)
{
    for (uint32_t v = 0; r->vertex && v < r->n_vertex; v++) {
        prt_free(r->vertex[v].cell);
        prt_free(r->vertex[v].value);
    }
    free(r->vertex);
    memset(r, 0, sizeof *r);
}

// Takes the cells of one vertex.
static int keep(const struct cell_rows *r, const struct single_cells *from,
                struct vertex_cells *to)
{
    uint32_t face = r->n_coef / FACES;
    to->n_cell = from->n_cell;
    to->cell = prt_alloc(r->n_coef, sizeof *to->cell);
    to->value = prt_alloc((size_t)r->n_function * from->n_cell, sizeof *to->value);
    if (!to->cell || !to->value) return PRT_NOMEM;
    memcpy(to->cell, from->cell, r->n_coef * sizeof *to->cell);
    prt_f32_to_f16_array(from->value, (size_t)r->n_function * from->n_cell, to->value);
    for (uint32_t f = 0; f < FACES; f++) {
        to->begin[f] = UINT32_MAX;
        for (uint32_t t = 0; t < face; t++)
            if (to->cell[f * face + t] < to->begin[f]) to->begin[f] = to->cell[f * face + t];
    }
    to->begin[FACES] = to->n_cell;
    return PRT_OK;
}

// Vertex by vertex, with the light summed over each cell first.
static int cells_multiply(void *user, const float *x, uint32_t m, float *out)
{
    const struct cell_rows *r = user;
    float *lit = prt_alloc((size_t)r->n_coef * m, sizeof *lit);
    float *value = prt_alloc((size_t)r->n_function * r->n_coef, sizeof *value);
    int status = lit && value ? PRT_OK : PRT_NOMEM;
    for (uint32_t v = 0; status == PRT_OK && v < r->n_vertex; v++) {
        const struct vertex_cells *c = &r->vertex[v];
        memset(lit, 0, (size_t)c->n_cell * m * sizeof *lit);
        for (uint32_t t = 0; t < r->n_coef; t++) {
            float *to = lit + (size_t)c->cell[t] * m;
            const float *from = x + (size_t)t * m;
            for (uint32_t k = 0; k < m; k++) to[k] += from[k];
        }
        prt_f16_to_f32_array(c->value, (size_t)r->n_function * c->n_cell, value);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)r->n_function, (int)m,
                    (int)c->n_cell, 1, value, (int)c->n_cell, lit, (int)m, 0,
                    out + (size_t)v * m, (int)(r->n_vertex * m));
    }
    prt_free(lit);
    prt_free(value);
    return status;
}

PRT_CLONES static void spread(const float *value, const uint32_t *cell, uint32_t first,
                              uint32_t n, float *out)
{
    for (uint32_t t = 0; t < n; t++) out[t] = value[cell[t] - first];
}

// A function and a face at a time are spread to dense rows.
static int cells_project(void *user, const float *u, uint32_t rank, float *out)
{
    const struct cell_rows *r = user;
    uint32_t face = r->n_coef / FACES, F = r->n_function;
    float *dense = prt_alloc((size_t)r->n_vertex * face, sizeof *dense);
    float *value = prt_alloc(r->n_coef, sizeof *value);
    int status = dense && value ? PRT_OK : PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < F * FACES; i++) {
        uint32_t f = i / FACES, k = i % FACES;
        for (uint32_t v = 0; v < r->n_vertex; v++) {
            const struct vertex_cells *c = &r->vertex[v];
            prt_f16_to_f32_array(c->value + (size_t)f * c->n_cell + c->begin[k],
                                 c->begin[k + 1] - c->begin[k], value);
            spread(value, c->cell + k * face, c->begin[k], face, dense + (size_t)v * face);
        }
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rank, (int)face,
                    (int)r->n_vertex, 1, u, (int)r->n_vertex, dense, (int)face, 0,
                    out + (size_t)f * r->n_coef + k * face, (int)(F * r->n_coef));
    }
    prt_free(dense);
    prt_free(value);
    return status;
}

static int bake_cluster(struct bake *b, uint32_t c, uint32_t n_function,
                        const struct fresnel_table *fresnel, float *value, void *scratch)
{
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    struct cell_rows rows = {cluster->n_vertex, n_function, b->directions->n_coef,
                             calloc(cluster->n_vertex, sizeof *rows.vertex)};
    int status = rows.vertex ? PRT_OK : PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < cluster->n_vertex; i++) {
        struct single_cells cells;
        b->rays_single[c] +=
            single_cells(&b->single, fresnel, b->clusters->order[cluster->vertex_begin + i],
                         value, &cells, scratch);
        status = keep(&rows, &cells, &rows.vertex[i]);
    }
    struct row_source source = {&rows, cluster->n_vertex, cells_multiply, cells_project};
    if (status == PRT_OK) status = bake_take_rows(b, c, n_function, &source);
    cell_rows_finish(&rows);
    return status;
}

int bake_single_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct bake *b = arg;
    struct fresnel_table fresnel;
    uint32_t F = b->o.n_phase * (b->single.extinction ? b->single.extinction->n_function : 3);
    prt_trace_thread_init();
    fresnel_table_init(&fresnel, b->o.material.eta);
    void *scratch = prt_alloc(single_scratch_bytes(&b->single), 1);
    float *value = prt_alloc((size_t)F * b->directions->n_coef, sizeof *value);
    int status = scratch && value ? PRT_OK : PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++)
        if (b->clusters->translucent[c])
            status = bake_cluster(b, (uint32_t)c, F, &fresnel, value, scratch);
    prt_free(scratch);
    prt_free(value);
    return status;
}
