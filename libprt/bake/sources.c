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
    uint64_t started = prt_work_begin();
    float *e = prt_alloc(n * n_coef, sizeof *e);
    if (!e) return PRT_NOMEM;
    prt_f16_to_f32_array(rows->half + begin * n_coef, n * n_coef, e);
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m, (int)n_coef, 1, e,
                (int)n_coef, job->lit->light, (int)m, 0, job->lit->value + begin * m, (int)m);
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
    *out = (struct lit_rows){n_light, light, prt_alloc(rows->n_row * n_light, sizeof(float))};
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

// The cut's rows times x, [C][m].
static int light_rows(const struct product_rows *p, const float *x, uint32_t m, float *ex)
{
    uint32_t C = p->cut->n_column, n_coef = (uint32_t)p->rows->n_coef;
    if (p->lit && p->lit->light == x && p->lit->n_light == m) {
        for (uint32_t i = 0; i < C; i++)
            memcpy(ex + (size_t)i * m, p->lit->value + (size_t)p->cut->row[i] * m,
                   m * sizeof *ex);
        return PRT_OK;
    }
    float *e = prt_alloc((size_t)BLOCK * n_coef, sizeof *e);
    if (!e) return PRT_NOMEM;
    for (uint32_t first = 0; first < C; first += BLOCK) {
        uint32_t n = C - first < BLOCK ? C - first : BLOCK;
        load_rows(p, first, n, e);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m, (int)n_coef, 1,
                    e, (int)n_coef, x, (int)m, 0, ex + (size_t)first * m, (int)m);
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
    uint32_t C = p->cut->n_column;
    uint64_t started = prt_work_begin();
    float *ex = prt_alloc((size_t)C * m + 1, sizeof *ex);
    int status = ex ? light_rows(p, x, m, ex) : PRT_NOMEM;
    size_t stride = (size_t)p->n_vertex * C;
    for (uint32_t f = 0; status == PRT_OK && f < p->n_function; f++) {
        float *y = out + (size_t)f * p->n_vertex * m;
        if (!C) memset(y, 0, (size_t)p->n_vertex * m * sizeof *y);
        else
            cblas_sgemm(CblasRowMajor, CblasTrans, CblasNoTrans, (int)p->n_vertex, (int)m,
                        (int)C, 1, p->cut->k + f * stride, (int)p->n_vertex, ex, (int)m, 0, y,
                        (int)m);
        if (p->smooth) status = smooth_answers(p, f, m, y);
    }
    prt_free(ex);
    prt_work_end(p->work, WORK_PRODUCTS, started, 0,
                 2.0 * p->n_function * p->n_vertex * (double)C * m);
    return status;
}

int prt_product_weigh(const struct product_rows *p, const float *q, uint32_t n, float *out)
{
    uint32_t C = p->cut->n_column, n_coef = (uint32_t)p->rows->n_coef;
    float *e = prt_alloc((size_t)BLOCK * n_coef, sizeof *e);
    if (!e) return PRT_NOMEM;
    memset(out, 0, (size_t)n * n_coef * sizeof *out);
    for (uint32_t first = 0; first < C; first += BLOCK) {
        uint32_t rows = C - first < BLOCK ? C - first : BLOCK;
        load_rows(p, first, rows, e);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)n_coef, (int)rows,
                    1, q + first, (int)C, e, (int)n_coef, 1, out, (int)n_coef);
    }
    prt_free(e);
    prt_half_rows_rest(p->rows);
    prt_work_count(p->work, WORK_PROJECTION, 0, 2.0 * n * (double)C * n_coef);
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
    uint32_t C = p->cut->n_column, F = p->n_function;
    float *q = prt_alloc((size_t)r * F * C + 1, sizeof *q); // [r][F][C]
    if (!q) return PRT_NOMEM;
    int status = PRT_OK;
    for (uint32_t f = 0; f < F && C && !status; f++)
        status = weights_of(p, u, r, f, q + (size_t)f * C, (size_t)F * C);
    if (!status) status = prt_product_weigh(p, q, r * F, out);
    prt_free(q);
    return status;
}

int prt_product_combine(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                        const uint32_t *row, float *out)
{
    struct product_rows *p = user;
    uint32_t C = p->cut->n_column, F = p->n_function;
    float *one = prt_alloc((size_t)r * C + 1, sizeof *one); // [r][C] of one function
    float *q = prt_calloc((size_t)n * C + 1, sizeof *q);    // [n][C]
    int status = one && q ? PRT_OK : PRT_NOMEM;
    for (uint32_t f = 0; f < F && C && !status; f++) {
        status = weights_of(p, u, r, f, one, C);
        for (uint32_t i = 0; i < n && !status; i++)
            cblas_saxpy((int)C, w[(size_t)i * F + f], one + (size_t)row[i] * C, 1,
                        q + (size_t)i * C, 1);
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
