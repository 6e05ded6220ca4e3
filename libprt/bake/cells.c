// SPDX-License-Identifier: MIT
// A row source: single scattering of a cluster's vertices as the cells that single.c
// integrates. Texels that share their rays share one value: half the values of dense rows, in
// half precision, which together is a quarter of their memory (0.9 GB a cluster as dense rows).
#include "bake/loops.h"
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
    unsigned cpu;                             // mask of enum prt_cpu
    uint32_t n_vertex, n_function, n, n_coef; // n: texels across a face
    bool smooth;                              // between blocks
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

// Copies the cells of one vertex.
static int copy_cells(const struct cell_rows *r, const struct single_cells *from,
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

// A matrix [n_coef][m], and its rows summed over blocks of 2 x 2 texels and tiles of 4 x 4.
struct sums {
    uint32_t n, m;       // texels across a face, columns
    const float *texel;  // [6 n n][m]
    float *block, *tile; // [6 n n / 4][m], [6 n n / 16][m]
};

// Sums the rows of each 2 x 2 squares; a face of `from` is `wide` squares across, of `out`
// half.
static void sum_squares(const float *from, uint32_t wide, uint32_t m, float *out)
{
    for (uint32_t i = 0; i < FACES * wide * wide / 4; i++) {
        const uint32_t x = i % (wide / 2), y = i / (wide / 2);
        const float *a = from + (size_t)(2 * y * wide + 2 * x) * m, *b = a + m;
        const float *c = a + (size_t)wide * m, *d = c + m;
        for (uint32_t k = 0; k < m; k++) out[(size_t)i * m + k] = (a[k] + b[k]) + (c[k] + d[k]);
    }
}

// Copies the sum of each of a vertex's cells to out [n_cell][m]. A cell is a tile, a block or a
// texel (make_cells in single.c).
static void gather_sums(const struct sums *s, const uint32_t *cell, float *out)
{
    const uint32_t n = s->n, m = s->m, wide = n / 4;
    const unsigned log_wide = (unsigned)__builtin_ctz(wide);
    const size_t bytes = (size_t)m * sizeof *out;
    for (uint32_t t = 0; t < FACES * wide * wide; t++) {
        const uint32_t first = t / wide * 4 * n + t % wide * 4;
        if (cell[first] == cell[first + 3 * n + 3]) {
            memcpy(out + (size_t)cell[first] * m, s->tile + (size_t)t * m, bytes);
            continue;
        }
        for (uint32_t j = 0; j < 4; j++) {
            const uint32_t at = first + (j >> 1) * 2 * n + (j & 1) * 2;
            const uint32_t b = block_of(t, j, log_wide);
            if (cell[at] == cell[at + n + 1]) {
                memcpy(out + (size_t)cell[at] * m, s->block + (size_t)b * m, bytes);
                continue;
            }
            for (uint32_t i = 0; i < 4; i++) {
                const uint32_t texel = at + (i >> 1) * n + (i & 1);
                memcpy(out + (size_t)cell[texel] * m, s->texel + (size_t)texel * m, bytes);
            }
        }
    }
}

// Vertex by vertex: the light is summed over each cell before the product. Values that are
// smoothed are near those of the cells, near enough to find functions for them.
static int cells_multiply(void *user, const float *x, uint32_t m, float *out)
{
    const struct cell_rows *r = user;
    float *lit = prt_alloc((size_t)r->n_coef * m, sizeof *lit);
    float *value = prt_alloc((size_t)r->n_function * r->n_coef, sizeof *value);
    struct sums sums = {.n = r->n, .m = m, .texel = x};
    sums.block = prt_alloc((size_t)r->n_coef / 4 * m, sizeof *sums.block);
    sums.tile = prt_alloc((size_t)r->n_coef / 16 * m, sizeof *sums.tile);
    int status = lit && value && sums.block && sums.tile ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK) {
        sum_squares(x, r->n, m, sums.block);
        sum_squares(sums.block, r->n / 2, m, sums.tile);
    }
    for (uint32_t v = 0; status == PRT_OK && v < r->n_vertex; v++) {
        const struct vertex_cells *c = &r->vertex[v];
        gather_sums(&sums, c->cell, lit);
        prt_f16_to_f32_array(c->value, (size_t)r->n_function * c->n_cell, value);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)r->n_function, (int)m,
                    (int)c->n_cell, 1, value, (int)c->n_cell, lit, (int)m, 0,
                    out + (size_t)v * m, (int)(r->n_vertex * m));
    }
    prt_free(sums.block);
    prt_free(sums.tile);
    prt_free(lit);
    prt_free(value);
    return status;
}

// Expands one function and one face at a time to dense rows.
static int cells_project(void *user, const float *u, uint32_t rank, float *out)
{
    const struct cell_rows *r = user;
    uint32_t face = r->n_coef / FACES, F = r->n_function;
    float *dense = prt_alloc((size_t)r->n_vertex * face, sizeof *dense);
    float *value = prt_alloc(r->n_coef, sizeof *value);
    float *mean = prt_alloc(face / 4, sizeof *mean);
    const struct bake_loops *loops = prt_bake_loops(r->cpu);
    int status = dense && value && mean ? PRT_OK : PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < F * FACES; i++) {
        uint32_t f = i / FACES, k = i % FACES;
        for (uint32_t v = 0; v < r->n_vertex; v++) {
            const struct vertex_cells *c = &r->vertex[v];
            prt_f16_to_f32_array(c->value + (size_t)f * c->n_cell + c->begin[k],
                                 c->begin[k + 1] - c->begin[k], value);
            loops->expand_cells(value, c->cell + k * face, c->begin[k], face,
                                dense + (size_t)v * face);
            if (r->smooth)
                prt_smooth_blocks(c->cell + k * face, r->n, dense + (size_t)v * face, mean);
        }
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)rank, (int)face,
                    (int)r->n_vertex, 1, u, (int)r->n_vertex, dense, (int)face, 0,
                    out + (size_t)f * r->n_coef + k * face, (int)(F * r->n_coef));
    }
    prt_free(dense);
    prt_free(value);
    prt_free(mean);
    return status;
}

static int bake_cluster(const struct tensor_job *job, uint32_t c,
                        const struct fresnel_table *fresnel, float *value, void *scratch)
{
    struct bake *b = job->bake;
    const struct prt_cluster *cluster = &b->clusters->cluster[c];
    struct cell_rows rows = {.cpu = b->ctx->cpu,
                             .n_vertex = cluster->n_vertex,
                             .n_function = job->n_function,
                             .n = b->directions->n,
                             .n_coef = b->directions->n_coef,
                             .smooth = prt_single_smooth(&b->single[prt_bake_medium(b, c)]),
                             .vertex = calloc(cluster->n_vertex, sizeof *rows.vertex)};
    int status = rows.vertex ? PRT_OK : PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < cluster->n_vertex; i++) {
        struct single_cells cells;
        b->rays_single[c] += prt_single_cells(&b->single[prt_bake_medium(b, c)], fresnel,
                                              b->clusters->order[cluster->vertex_begin + i],
                                              value, &cells, scratch);
        status = copy_cells(&rows, &cells, &rows.vertex[i]);
    }
    struct row_source source = {&rows, cluster->n_vertex, cells_multiply, cells_project};
    if (status == PRT_OK) status = prt_bake_take_rows(job, c, &source);
    cell_rows_finish(&rows);
    return status;
}

int prt_bake_single_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tensor_job *job = arg;
    const struct bake *b = job->bake;
    struct fresnel_table *fresnel = prt_bake_single_fresnel(b);
    prt_trace_thread_init();
    void *scratch = prt_alloc(prt_single_scratch_bytes(&b->single[0]), 1);
    float *value = prt_alloc((size_t)job->n_function * b->directions->n_coef, sizeof *value);
    int status = scratch && value && fresnel ? PRT_OK : PRT_NOMEM;
    for (size_t c = begin; status == PRT_OK && c < end; c++) {
        const uint32_t medium = prt_bake_medium(b, (uint32_t)c);
        if (!b->clusters->translucent[c]) continue;
        if (b->o.engine == PRT_TRANSPORT_WAVELET && b->o.media.medium[medium].profile) continue;
        status =
            bake_cluster(job, (uint32_t)c,
                         prt_plan_fresnel(fresnel, &b->single[medium], medium), value, scratch);
    }
    prt_free(fresnel);
    prt_free(scratch);
    prt_free(value);
    return status;
}
