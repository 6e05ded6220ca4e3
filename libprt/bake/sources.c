// SPDX-License-Identifier: MIT
// Products of rows with lights and bases. BLAS runs on one thread: the pool runs the clusters.
#include "bake/sources.h"
#include "bake/work.h"

#include <cblas.h>
#include <string.h>

enum { BLOCK = 192 }; // rows of E converted to float at a time

struct lit_job {
    const struct half_rows *rows;
    struct lit_rows *lit;
    struct work_meters *work;
};

static int lit_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct lit_job *job = arg;
    const struct half_rows *rows = job->rows;
    const size_t n_coef = rows->n_coef, m = job->lit->n_light, n = end - begin;
    const size_t texels = prt_half_rows_texels(rows), layers = rows->n_layer;
    uint64_t started = prt_work_begin();
    float *e = prt_alloc(n * n_coef, sizeof *e);
    if (!e) return PRT_NOMEM;
    prt_f16_to_f32_array(rows->half + begin * n_coef, n * n_coef, e);
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)(n * layers), (int)m,
                (int)texels, 1, e, (int)texels, job->lit->light, (int)m, 0,
                job->lit->value + begin * layers * m, (int)m);
    prt_free(e);
    if (begin / BLOCK % 16 == 0) prt_half_rows_rest(rows);
    prt_work_end(job->work, WORK_LIT_ROWS, started, 0,
                 2 * (double)n * (double)n_coef * (double)m);
    return PRT_OK;
}

int prt_lit_rows_create(const struct prt_context *ctx, const struct half_rows *rows,
                        const float *light, uint32_t n_light, struct work_meters *work,
                        struct lit_rows *out)
{
    const size_t all = rows->n_row * rows->n_layer * n_light;
    *out = (struct lit_rows){n_light, light, prt_alloc(all, sizeof(float))};
    struct lit_job job = {rows, out, work};
    int status = out->value ? prt_parallel_for(ctx, "multiple scattering", rows->n_row, BLOCK,
                                               lit_range, &job)
                            : PRT_NOMEM;
    if (status) prt_lit_rows_finish(out);
    return status;
}

void prt_lit_rows_finish(struct lit_rows *lit)
{
    prt_free(lit->value);
    *lit = (struct lit_rows){0};
}

// Rows [first, first+n) of the cut as floats.
static void load_rows(const struct product_rows *p, uint32_t first, uint32_t n, float *out)
{
    size_t n_coef = p->rows->n_coef;
    for (uint32_t i = 0; i < n; i++)
        prt_f16_to_f32_array(p->rows->half + (size_t)p->cut->row[first + i] * n_coef, n_coef,
                             out + i * n_coef);
}

// The cut's rows times x, [C][layer][m].
static int light_rows(const struct product_rows *p, const float *x, uint32_t m, float *ex)
{
    const uint32_t C = p->cut->n_column, layers = p->rows->n_layer;
    const size_t n_coef = p->rows->n_coef, texels = prt_half_rows_texels(p->rows),
                 wide = (size_t)layers * m;
    if (p->lit && p->lit->light == x && p->lit->n_light == m) {
        for (uint32_t i = 0; i < C; i++)
            memcpy(ex + i * wide, p->lit->value + p->cut->row[i] * wide, wide * sizeof *ex);
        return PRT_OK;
    }
    float *e = prt_alloc((size_t)BLOCK * n_coef, sizeof *e);
    if (!e) return PRT_NOMEM;
    for (uint32_t first = 0; first < C; first += BLOCK) {
        uint32_t n = C - first < BLOCK ? C - first : BLOCK;
        load_rows(p, first, n, e);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)(n * layers), (int)m,
                    (int)texels, 1, e, (int)texels, x, (int)m, 0, ex + first * wide, (int)m);
    }
    prt_free(e);
    return PRT_OK;
}

// y = M_f y, [n_vertex][m].
static int smooth_answers(const struct product_rows *p, uint32_t f, uint32_t m, float *y)
{
    const size_t n = p->n_vertex;
    float *raw = prt_alloc(n * m, sizeof *raw);
    if (!raw) return PRT_NOMEM;
    memcpy(raw, y, n * m * sizeof *raw);
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m, (int)n, 1,
                p->smooth + f * n * n, (int)n, raw, (int)m, 0, y, (int)m);
    prt_free(raw);
    return PRT_OK;
}

int prt_product_multiply(void *user, const float *x, uint32_t m, float *out)
{
    struct product_rows *p = user;
    const uint32_t C = p->cut->n_column, layers = p->rows->n_layer, wide = layers * m,
                   n_kernel = p->n_function / layers;
    uint64_t started = prt_work_begin();
    float *ex = prt_alloc((size_t)C * wide + 1, sizeof *ex);
    int status = ex ? light_rows(p, x, m, ex) : PRT_NOMEM;
    size_t stride = (size_t)p->n_vertex * C;
    for (uint32_t f = 0; status == PRT_OK && f < p->n_function; f++) {
        float *y = out + (size_t)f * p->n_vertex * m;
        if (!C) memset(y, 0, (size_t)p->n_vertex * m * sizeof *y);
        else
            cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, (int)p->n_vertex, (int)m,
                        (int)C, 1, p->cut->k + f % n_kernel * stride, (int)p->n_vertex,
                        ex + f / n_kernel * m, (int)wide, 0, y, (int)m);
        if (p->smooth) status = smooth_answers(p, f, m, y);
    }
    prt_free(ex);
    prt_work_end(p->work, WORK_PRODUCTS, started, 0,
                 2.0 * p->n_function * p->n_vertex * (double)C * m);
    return status;
}

int prt_product_weigh(const struct product_rows *p, const float *q, uint32_t n, float *out)
{
    const uint32_t C = p->cut->n_column, layers = p->rows->n_layer;
    const size_t n_coef = p->rows->n_coef, texels = prt_half_rows_texels(p->rows);
    float *e = prt_alloc((size_t)BLOCK * n_coef, sizeof *e);
    if (!e) return PRT_NOMEM;
    memset(out, 0, (size_t)n * texels * sizeof *out);
    for (uint32_t first = 0; first < C; first += BLOCK) {
        uint32_t rows = C - first < BLOCK ? C - first : BLOCK;
        load_rows(p, first, rows, e);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)texels,
                    (int)(rows * layers), 1, q + (size_t)first * layers, (int)(C * layers), e,
                    (int)texels, 1, out, (int)texels);
    }
    prt_free(e);
    prt_half_rows_rest(p->rows);
    prt_work_count(p->work, WORK_PROJECTION, 0, 2.0 * n * (double)C * (double)n_coef);
    return PRT_OK;
}

// U K_f^T into [r][C], rows `stride` apart.
static void raw_weights(const struct product_rows *p, const float *u, uint32_t r, uint32_t f,
                        float *q, size_t stride)
{
    uint32_t C = p->cut->n_column;
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)r, (int)C, (int)p->n_vertex, 1, u,
                (int)p->n_vertex, p->cut->k + f * ((size_t)p->n_vertex * C), (int)p->n_vertex,
                0, q, (int)stride);
    prt_work_count(p->work, WORK_PROJECTION, 0, 2.0 * r * (double)C * p->n_vertex);
}

// U M_f K_f^T.
static int weights_of(const struct product_rows *p, const float *u, uint32_t r, uint32_t f,
                      float *q, size_t stride)
{
    const size_t n = p->n_vertex;
    if (!p->smooth) {
        raw_weights(p, u, r, f, q, stride);
        return PRT_OK;
    }
    float *um = prt_alloc(r * n + 1, sizeof *um);
    if (!um) return PRT_NOMEM;
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)r, (int)n, (int)n, 1, u, (int)n,
                p->smooth + f * n * n, (int)n, 0, um, (int)n);
    raw_weights(p, um, r, f, q, stride);
    prt_free(um);
    return PRT_OK;
}

int prt_product_project(void *user, const float *u, uint32_t r, float *out)
{
    struct product_rows *p = user;
    const uint32_t C = p->cut->n_column, F = p->n_function, layers = p->rows->n_layer,
                   n_kernel = F / layers;
    const size_t wide = (size_t)C * layers;
    float *one = prt_alloc((size_t)r * C + 1, sizeof *one);
    float *q = prt_calloc(r * F * wide + 1, sizeof *q); // [r][F][C][layer]
    int status = one && q ? PRT_OK : PRT_NOMEM;
    for (uint32_t f = 0; f < F && C && !status; f++) {
        status = weights_of(p, u, r, f % n_kernel, one, C);
        for (uint32_t i = 0; i < r; i++)
            cblas_scopy((int)C, one + (size_t)i * C, 1,
                        q + ((size_t)i * F + f) * wide + f / n_kernel, (int)layers);
    }
    if (!status) status = prt_product_weigh(p, q, r * F, out);
    prt_free(one);
    prt_free(q);
    return status;
}

int prt_product_combine(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                        const uint32_t *row, float *out)
{
    struct product_rows *p = user;
    const uint32_t C = p->cut->n_column, F = p->n_function, layers = p->rows->n_layer,
                   n_kernel = F / layers;
    const size_t wide = (size_t)C * layers;
    float *one = prt_alloc((size_t)r * C + 1, sizeof *one); // [r][C] of one kernel
    float *q = prt_calloc(n * wide + 1, sizeof *q);         // [n][C][layer]
    int status = one && q ? PRT_OK : PRT_NOMEM;
    for (uint32_t f = 0; f < n_kernel && C && !status; f++) {
        status = weights_of(p, u, r, f, one, C);
        for (uint32_t i = 0; i < n * layers && !status; i++)
            cblas_saxpy((int)C, w[(size_t)(i / layers) * F + i % layers * n_kernel + f],
                        one + (size_t)row[i / layers] * C, 1,
                        q + i / layers * wide + i % layers, (int)layers);
    }
    if (!status) status = prt_product_weigh(p, q, n, out);
    prt_free(one);
    prt_free(q);
    return status;
}

int prt_dense_multiply(void *user, const float *x, uint32_t m, float *out)
{
    struct dense_rows *d = user;
    size_t row = (size_t)d->n_function * d->n_coef;
    for (uint32_t f = 0; f < d->n_function; f++)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)d->n_vertex, (int)m,
                    (int)d->n_coef, 1, d->t + (size_t)f * d->n_coef, (int)row, x, (int)m, 0,
                    out + (size_t)f * d->n_vertex * m, (int)m);
    return PRT_OK;
}

int prt_dense_project(void *user, const float *u, uint32_t r, float *out)
{
    struct dense_rows *d = user;
    int row = (int)(d->n_function * d->n_coef);
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)r, row, (int)d->n_vertex, 1, u,
                (int)d->n_vertex, d->t, row, 0, out, row);
    return PRT_OK;
}
