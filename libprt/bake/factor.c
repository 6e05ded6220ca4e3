// SPDX-License-Identifier: MIT
// A cluster's transport as U (few columns a vertex) times a wavelet basis, from products with
// random lights (METHODS §3, HMT11): the dense rows of the model are never formed.
#include "bake/loops.h"
#include "bake/stages.h"
#include "bake/work.h"

#include <cblas.h>
#include <lapacke.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

// Y_t = sum_j train[t][j] Y_j for all t, [n_train][n_vertex][m].
static void combine(const struct factor_plan *plan, const float *y, size_t block, float *out)
{
    if (!plan->train) {
        memcpy(out, y, plan->n_function * block * sizeof *out);
        return;
    }
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)plan->n_train, (int)block,
                (int)plan->n_function, 1, plan->train, (int)plan->n_function, y, (int)block, 0,
                out, (int)block);
}

// Leading eigenvectors of the symmetric g [n][n] by falling value.
static int leading_eigenvectors(double *g, int n, int rank, double *value, double *vector)
{
    double *w = malloc((size_t)n * sizeof *w);
    lapack_int *support = malloc(2 * (size_t)rank * sizeof *support), found = 0;
    int info = -1;
    if (w && support)
        info = LAPACKE_dsyevr(LAPACK_COL_MAJOR, 'V', 'I', 'U', n, g, n, 0, 0, n - rank + 1, n,
                              0, &found, w, vector, n, support);
    if (!info && found == rank) {
        for (int i = 0; i < rank / 2; i++)
            cblas_dswap(n, vector + (size_t)i * (size_t)n, 1,
                        vector + (size_t)(rank - 1 - i) * (size_t)n, 1);
        for (int i = 0; i < rank; i++) value[i] = w[rank - 1 - i];
    }
    free(w);
    free(support);
    return info || found != rank ? PRT_INTERNAL : PRT_OK;
}

// The columns of Y as one matrix, and the eigenvectors of the smaller of its two Gram matrices.
struct range {
    size_t columns, side; // n_train m; the size of the Gram matrix
    bool by_vertex;       // it is that of the rows (vertices)
    uint32_t rank;
    double *a;              // [n_vertex][columns]
    double *value, *vector; // [rank] by falling value, [rank][side]
    double total;           // trace of the Gram matrix
};

static int range_create(const float *y, uint32_t n_vertex, uint32_t n_train, uint32_t m,
                        uint32_t max_rank, struct range *q)
{
    size_t block = (size_t)n_vertex * m;
    *q = (struct range){.columns = (size_t)n_train * m};
    q->by_vertex = n_vertex <= q->columns;
    q->side = q->by_vertex ? n_vertex : q->columns;
    q->rank = max_rank < q->side ? max_rank : (uint32_t)q->side;
    q->a = malloc(q->columns * n_vertex * sizeof *q->a);
    q->value = malloc(q->rank * sizeof *q->value);
    q->vector = malloc(q->side * q->rank * sizeof *q->vector);
    double *g = malloc(q->side * q->side * sizeof *g);
    int status = q->a && g && q->value && q->vector ? PRT_OK : PRT_NOMEM;
    for (uint32_t t = 0; status == PRT_OK && t < n_train; t++)
        for (uint32_t v = 0; v < n_vertex; v++)
            for (uint32_t k = 0; k < m; k++)
                q->a[v * q->columns + t * m + k] = y[t * block + (size_t)v * m + k];
    if (status == PRT_OK) {
        cblas_dsyrk(CblasRowMajor, CblasLower, q->by_vertex ? CblasNoTrans : CblasTrans,
                    (int)q->side, (int)(q->by_vertex ? q->columns : n_vertex), 1.0 / m, q->a,
                    (int)q->columns, 0, g,
                    (int)q->side); // row-major lower is column-major upper
        for (size_t i = 0; i < q->side; i++) q->total += g[i * q->side + i];
        if (q->total > 0)
            status = leading_eigenvectors(g, (int)q->side, (int)q->rank, q->value, q->vector);
        else q->rank = 0;
    }
    while (status == PRT_OK && q->rank > 0 && q->value[q->rank - 1] <= 1e-12 * q->total)
        q->rank--; // rounding alone
    free(g);
    return status;
}

// Column r of U: an eigenvector of the vertices, or Y times one of the columns, normalised.
static void fill_column(const struct range *q, uint32_t r, uint32_t n_vertex, uint32_t m,
                        float *u)
{
    const double *w = q->vector + r * q->side;
    double norm = 1 / sqrt(q->value[r] * m);
    for (uint32_t v = 0; v < n_vertex; v++)
        u[v] =
            q->by_vertex
                ? (float)w[v]
                : (float)(norm * cblas_ddot((int)q->columns, q->a + v * q->columns, 1, w, 1));
}

// U from Y [n_train][n_vertex][m], by eigenvectors of the smaller Gram matrix, in double.
static int range_basis(const float *y, uint32_t n_vertex, uint32_t n_train, uint32_t m,
                       uint32_t max_rank, struct factored *out)
{
    struct range q;
    int status = range_create(y, n_vertex, n_train, m, max_rank, &q);
    out->rank = q.rank;
    if (status == PRT_OK) {
        out->u = prt_alloc((size_t)q.rank * n_vertex + 1, sizeof *out->u);
        out->tail = malloc((q.rank + 1u) * sizeof *out->tail);
        if (!out->u || !out->tail) status = PRT_NOMEM;
    }
    double left = q.total;
    for (uint32_t r = 0; status == PRT_OK && r <= q.rank; r++) {
        out->tail[r] = fmax(left, 0);
        if (r == q.rank) break;
        left -= q.value[r];
        fill_column(&q, r, n_vertex, m, out->u + (size_t)r * n_vertex);
    }
    free(q.a), free(q.value), free(q.vector);
    return status;
}

// Texel means to Haar coefficients, in place.
static void to_haar(const struct factor_plan *plan, float *row)
{
    uint32_t face = plan->n * plan->n;
    for (uint32_t i = 0; i < 6 * face; i++) row[i] *= plan->solid_angle[i];
    for (int f = 0; f < 6; f++) prt_haar_forward(plan->n, row + f * face);
}

// b as halves, each row divided by its own scale; energy of each coefficient over training.
static int store_rows(const struct factor_plan *plan, float *b, struct factored *out)
{
    uint32_t n_coef = 6 * plan->n * plan->n, J = plan->n_function;
    size_t rows = (size_t)out->rank * J;
    out->b = prt_alloc(rows * n_coef + 1, sizeof *out->b);
    out->scale = prt_alloc(rows + 1, sizeof *out->scale);
    out->energy = prt_alloc((size_t)out->rank * n_coef + 1, sizeof *out->energy);
    if (!out->b || !out->scale || !out->energy) return PRT_NOMEM;
    for (size_t i = 0; i < rows; i++) {
        const float most = largest_of(b + i * n_coef, n_coef);
        out->scale[i] = most > 0 ? most : 1;
    }
    for (uint32_t r = 0; r < out->rank; r++) {
        float *e = out->energy + (size_t)r * n_coef, *first = b + (size_t)r * J * n_coef;
        memset(e, 0, n_coef * sizeof *e);
        for (uint32_t t = 0; t < J; t++)
            for (uint32_t k = 0; k < n_coef; k++) {
                float x = first[(size_t)t * n_coef + k];
                e[k] += x * x;
            }
        for (uint32_t j = 0; j < J; j++) {
            float *row = first + (size_t)j * n_coef, inv = 1 / out->scale[r * J + j];
            for (uint32_t k = 0; k < n_coef; k++) row[k] *= inv;
            prt_f32_to_f16_array(row, n_coef, out->b + ((size_t)r * J + j) * n_coef);
        }
    }
    return PRT_OK;
}

// The first m of `wide` columns, [rows][m].
static float *first_columns(const float *y, size_t rows, uint32_t wide, uint32_t m)
{
    float *out = prt_alloc(rows * m, sizeof *out);
    for (size_t i = 0; out && i < rows; i++) memcpy(out + i * m, y + i * wide, m * sizeof *out);
    return out;
}

// Every function of every column of U.
static int project_all(const struct factor_plan *plan, const struct row_source *source,
                       struct factored *out)
{
    uint32_t n_coef = 6 * plan->n * plan->n;
    float *b = prt_alloc((size_t)out->rank * plan->n_function * n_coef + 1, sizeof *b);
    int status = b ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK && out->rank)
        status = source->project(source->user, out->u, out->rank, b);
    for (size_t i = 0; status == PRT_OK && i < (size_t)out->rank * plan->n_function; i++)
        to_haar(plan, b + i * n_coef);
    if (status == PRT_OK)
        status = plan->train ? prt_compress_rows(plan, b, out) : store_rows(plan, b, out);
    prt_free(b);
    return status;
}

int prt_factor_cluster(const struct prt_context *ctx, const struct factor_plan *plan,
                       const struct row_source *source, struct factored *out)
{
    uint32_t n_vertex = source->n_vertex, m = plan->n_probe;
    bool combined = plan->train && source->combine;
    uint32_t wide = combined ? m + 6 : m;
    size_t block = (size_t)n_vertex * m;
    memset(out, 0, sizeof *out);
    out->n_vertex = n_vertex;
    float *own = NULL;
    float *y = prt_alloc((size_t)plan->n_function * n_vertex * wide, sizeof *y);
    float *t = prt_alloc(plan->n_train * block, sizeof *t);
    int status = y && t ? PRT_OK : PRT_NOMEM;
    if (status == PRT_OK)
        status = source->multiply(source->user, combined ? plan->lights : plan->probe, wide, y);
    uint64_t started = prt_work_begin();
    if (status == PRT_OK && combined) {
        own = first_columns(y, (size_t)plan->n_function * n_vertex, wide, m);
        if (!own) status = PRT_NOMEM;
    }
    if (status == PRT_OK) {
        combine(plan, own ? own : y, block, t);
        status = range_basis(t, n_vertex, plan->n_train, m, plan->max_rank, out);
    }
    prt_free(own);
    prt_free(t);
    while (status == PRT_OK && out->rank > 1 &&
           out->tail[out->rank - 1] <= plan->tail_error * plan->tail_error * out->tail[0])
        out->rank--;
    prt_work_end(plan->work, WORK_RANGE, started, 0, 0);
    started = prt_work_begin();
    if (status == PRT_OK)
        status = combined ? prt_compress_source(plan, source, y, out)
                          : project_all(plan, source, out);
    prt_free(y);
    prt_work_end(plan->work, WORK_PROJECTION, started, 0, 0);
    if (status == PRT_INTERNAL)
        status = prt_fail(
            ctx, status,
            "the transport of a cluster of %u vertices could not be factored: LAPACK found no "
            "eigenvectors",
            n_vertex);
    if (status) prt_factored_finish(out);
    return status;
}

void prt_factored_finish(struct factored *f)
{
    prt_free(f->u);
    if (!f->spilled_bytes) prt_free(f->b);
    prt_free(f->scale);
    prt_free(f->energy);
    prt_free(f->component);
    prt_free(f->scaling);
    free(f->width);
    free(f->limit);
    free(f->count);
    free(f->tail);
    memset(f, 0, sizeof *f);
}
