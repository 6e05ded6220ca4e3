// SPDX-License-Identifier: MIT
// Products of rows with lights and bases. BLAS runs on one thread: the pool runs the clusters.
#include "bake/sources.h"
#include "bake/work.h"

#include <cblas.h>
#include <math.h>
#include <string.h>

enum { BLOCK = 192 }; // rows of E converted to float at a time

// Layer 1 of a row has a value for 2 x 2 texels of layer 0: the one of texel t.
static size_t coarse_texel(size_t t, size_t wide)
{
    const size_t y = t / wide, x = t % wide; // faces lie below each other
    return y / 2 * (wide / 2) + x / 2;
}

// Edge of the cube that a row's texels are of.
static size_t edge_of(const struct half_rows *rows)
{
    return (size_t)lround(sqrt((double)rows->n_texel / 6));
}

// Sums of the lights [n_texel][m] over the texels of layer 1; NULL without memory.
static float *coarse_lights(const struct half_rows *rows, const float *light, size_t m)
{
    float *out = prt_calloc(rows->n_texel / 4 * m, sizeof *out);
    const size_t wide = edge_of(rows);
    for (size_t t = 0; out && t < rows->n_texel; t++)
        cblas_saxpy((int)m, 1, light + t * m, 1, out + coarse_texel(t, wide) * m, 1);
    return out;
}

// n rows times the lights, [n][n_layer][m]. coarse: coarse_lights; NULL with one layer.
static void rows_times_lights(const struct half_rows *rows, const float *e, size_t n,
                              const float *light, const float *coarse, size_t m, float *out)
{
    const int stride = (int)rows->n_coef, wide = (int)(rows->n_layer * m);
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m, (int)rows->n_texel,
                1, e, stride, light, (int)m, 0, out, wide);
    if (coarse)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)m,
                    (int)rows->n_texel / 4, 1, e + rows->n_texel, stride, coarse, (int)m, 0,
                    out + m, wide);
}

struct lit_job {
    const struct half_rows *rows;
    struct lit_rows *lit;
    const float *coarse;
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
    rows_times_lights(rows, e, n, job->lit->light, job->coarse, m,
                      job->lit->value + begin * rows->n_layer * m);
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
    const bool layered = rows->n_layer > 1;
    const size_t all = rows->n_row * rows->n_layer * n_light;
    *out = (struct lit_rows){n_light, light, prt_alloc(all, sizeof(float))};
    float *coarse = layered ? coarse_lights(rows, light, n_light) : NULL;
    struct lit_job job = {rows, out, coarse, work};
    int status = out->value && (coarse || !layered)
                     ? prt_parallel_for(ctx, "lit samples", rows->n_row, BLOCK, lit_range, &job)
                     : PRT_NOMEM;
    prt_free(coarse);
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

// The products of layers [C][2][m] become those of the nodes of eta.
static void mix_layers(const struct half_rows *rows, uint32_t C, size_t m, float *ex)
{
    const float(*mix)[2] = rows->mix;
    for (size_t i = 0; rows->n_layer > 1 && i < C * m; i++) {
        float *at = ex + i / m * 2 * m + i % m;
        const float one = at[0], other = at[m];
        at[0] = mix[0][0] * one + mix[0][1] * other;
        at[m] = mix[1][0] * one + mix[1][1] * other;
    }
}

// The cut's rows times x, [C][node][m].
static int light_rows(const struct product_rows *p, const float *x, uint32_t m, float *ex)
{
    const uint32_t C = p->cut->n_column;
    const size_t wide = (size_t)p->rows->n_layer * m;
    if (p->lit && p->lit->light == x && p->lit->n_light == m) {
        for (uint32_t i = 0; i < C; i++)
            memcpy(ex + i * wide, p->lit->value + p->cut->row[i] * wide, wide * sizeof *ex);
        mix_layers(p->rows, C, m, ex);
        return PRT_OK;
    }
    const bool layered = p->rows->n_layer > 1;
    float *e = prt_alloc(BLOCK * p->rows->n_coef, sizeof *e);
    float *coarse = layered ? coarse_lights(p->rows, x, m) : NULL;
    int status = e && (coarse || !layered) ? PRT_OK : PRT_NOMEM;
    for (uint32_t first = 0; first < C && !status; first += BLOCK) {
        uint32_t n = C - first < BLOCK ? C - first : BLOCK;
        load_rows(p, first, n, e);
        rows_times_lights(p->rows, e, n, x, coarse, m, ex + first * wide);
    }
    if (!status) mix_layers(p->rows, C, m, ex);
    prt_free(e);
    prt_free(coarse);
    return status;
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
    const uint32_t C = p->cut->n_column;
    const size_t n_coef = p->rows->n_coef, texels = p->rows->n_texel;
    const bool layered = p->rows->n_layer > 1;
    float *e = prt_alloc(BLOCK * n_coef, sizeof *e);
    float *coarse = layered ? prt_calloc(n * (texels / 4), sizeof *coarse) : NULL;
    if (!e || (layered && !coarse)) {
        prt_free(e);
        prt_free(coarse);
        return PRT_NOMEM;
    }
    memset(out, 0, n * texels * sizeof *out);
    for (uint32_t first = 0; first < C; first += BLOCK) {
        uint32_t rows = C - first < BLOCK ? C - first : BLOCK;
        load_rows(p, first, rows, e);
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)texels, (int)rows,
                    1, q + first, (int)C, e, (int)n_coef, 1, out, (int)texels);
        if (layered)
            cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)texels / 4,
                        (int)rows, 1, q + (size_t)n * C + first, (int)C, e + texels,
                        (int)n_coef, 1, coarse, (int)texels / 4);
    }
    for (size_t i = 0; layered && i < n * texels; i++)
        out[i] +=
            coarse[i / texels * (texels / 4) + coarse_texel(i % texels, edge_of(p->rows))];
    prt_free(e);
    prt_free(coarse);
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

// Adds w times row `from` [C] of kernel f's weights to weights `to` of all layers,
// [layer][n][C]; node: that of the function.
static void add_weights(const struct product_rows *p, uint32_t node, float w, const float *from,
                        uint32_t n, uint32_t to, float *q)
{
    const uint32_t C = p->cut->n_column, layers = p->rows->n_layer;
    for (uint32_t l = 0; l < layers; l++)
        cblas_saxpy((int)C, layers > 1 ? w * p->rows->mix[node][l] : w, from, 1,
                    q + ((size_t)l * n + to) * C, 1);
}

int prt_product_project(void *user, const float *u, uint32_t r, float *out)
{
    struct product_rows *p = user;
    const uint32_t C = p->cut->n_column, F = p->n_function, layers = p->rows->n_layer,
                   n_kernel = F / layers;
    float *one = prt_alloc((size_t)r * C + 1, sizeof *one);
    float *q = prt_calloc((size_t)layers * r * F * C + 1, sizeof *q); // [layer][r][F][C]
    int status = one && q ? PRT_OK : PRT_NOMEM;
    for (uint32_t f = 0; f < F && C && !status; f++) {
        status = weights_of(p, u, r, f % n_kernel, one, C);
        for (uint32_t i = 0; i < r && !status; i++)
            add_weights(p, f / n_kernel, 1, one + (size_t)i * C, r * F, i * F + f, q);
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
    float *one = prt_alloc((size_t)r * C + 1, sizeof *one);       // [r][C] of one kernel
    float *q = prt_calloc((size_t)layers * n * C + 1, sizeof *q); // [layer][n][C]
    int status = one && q ? PRT_OK : PRT_NOMEM;
    for (uint32_t f = 0; f < n_kernel && C && !status; f++) {
        status = weights_of(p, u, r, f, one, C);
        for (uint32_t i = 0; i < n * layers && !status; i++)
            add_weights(p, i % layers, w[(size_t)(i / layers) * F + i % layers * n_kernel + f],
                        one + (size_t)row[i / layers] * C, n, i / layers, q);
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
