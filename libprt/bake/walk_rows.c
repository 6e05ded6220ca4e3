// SPDX-License-Identifier: MIT
// Rows of a free medium's walks: U^T M K of every medium from the walks' hits, without forming
// a row. Combinations of functions are combinations of media.
#include "bake/free_walks.h"
#include "bake/sources.h"

#include <cblas.h>
#include <math.h>
#include <string.h>

// The stored functions as combinations of the basis' functions, [n_function][n_radial]: of
// clusters that the dipole serves.
static float *dipole_mix(const struct walk_rows *s)
{
    const struct walk_pool *p = s->pool;
    const size_t walked = (size_t)p->n_own[0];
    float *out = prt_calloc((size_t)p->n_function * p->n_radial, sizeof *out);
    if (out)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)p->n_own[1],
                    (int)p->n_radial, (int)p->n_media, 1, p->mix + walked * p->n_media,
                    (int)p->n_media, p->dipole + (size_t)s->medium * p->n_media * p->n_radial,
                    (int)p->n_radial, 0, out + walked * p->n_radial, (int)p->n_radial);
    return out;
}

int prt_walk_rows_multiply(void *user, const float *x, uint32_t m, float *out)
{
    struct walk_rows *s = user;
    if (s->walks.smooth) { // lights are those of the walks
        prt_free_walks_mix(&s->walks, out);
        return PRT_OK;
    }
    const struct walk_pool *p = s->pool;
    const size_t block = (size_t)s->product->n_vertex * m;
    float *answers = prt_alloc(p->n_radial * block, sizeof *answers), *mix = dipole_mix(s);
    int status = answers && mix ? prt_product_multiply(s->product, x, m, answers) : PRT_NOMEM;
    if (!status)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)p->n_function, (int)block,
                    (int)p->n_radial, 1, mix, (int)p->n_radial, answers, (int)block, 0, out,
                    (int)block);
    prt_free(answers);
    prt_free(mix);
    return status;
}

struct combine {
    const struct walk_rows *s;
    const float *u; // [r][n_vertex]
    uint32_t r, n, C;
    const float *share;  // [n][n_media] weights of the media in each combination
    const uint32_t *row; // [n]
    float *um;           // [n_vertex][r] of a medium
    float *turned;       // [C][r]
    float *one;          // [r][C]
    float *q;            // [n][C]
};

// Adds the products of a medium, in c->one, to the combinations.
static void add_medium(struct combine *c, uint32_t medium)
{
    for (uint32_t i = 0; i < c->n; i++)
        cblas_saxpy((int)c->C, c->share[(size_t)i * c->s->pool->n_media + medium],
                    c->one + (size_t)c->row[i] * c->C, 1, c->q + (size_t)i * c->C, 1);
}

// U^T M K of a walked medium, into c->one.
static void walked_medium(struct combine *c, uint32_t medium)
{
    const struct free_walks *w = &c->s->walks;
    const struct walk_pool *p = c->s->pool;
    const uint32_t n = w->n_vertex, r = c->r, level = medium / p->grid.n_node;
    const float sigma_a = p->grid.node[medium % p->grid.n_node];
    const float each = 1 / ((float)M_PI * (float)w->walks[level]);
    cblas_sgemm(CblasRowMajor, CblasTrans, CblasTrans, (int)n, (int)r, (int)n, each,
                w->smooth + (size_t)medium * n * n, (int)n, c->u, (int)n, 0, c->um, (int)r);
    memset(c->turned, 0, (size_t)c->C * r * sizeof *c->turned);
    for (uint32_t v = 0; v < n; v++) {
        const float *from = c->um + (size_t)v * r;
        const uint32_t *begin = w->begin + (size_t)level * n + v;
        for (uint32_t i = begin[0]; i < begin[1]; i++) {
            const float light = expf(-sigma_a * w->hits[i].length_mm);
            float *to = c->turned + (size_t)w->hits[i].column * r;
            for (uint32_t k = 0; k < r; k++) to[k] += light * from[k];
        }
    }
    for (uint32_t at = 0; at < c->C; at++)
        for (uint32_t k = 0; k < r; k++)
            c->one[(size_t)k * c->C + at] = c->turned[(size_t)at * r + k];
}

// U^T diag(ratio) K of a medium above the last walked level; k: [C][n_vertex] scratch.
static void dipole_medium(struct combine *c, uint32_t medium, float *k)
{
    const struct walk_pool *p = c->s->pool;
    const struct free_walks *w = &c->s->walks;
    const struct cut *cut = c->s->product->cut;
    const size_t n = w->n_vertex, all = n * c->C;
    const float *of = p->dipole + ((size_t)c->s->medium * p->n_media + medium) * p->n_radial;
    const float *ratio = w->ratio + (medium - p->n_walked) * n;
    memset(k, 0, all * sizeof *k);
    for (uint32_t f = 0; f < p->n_radial; f++)
        cblas_saxpy((int)all, of[f], cut->k + f * all, 1, k, 1);
    for (size_t i = 0; i < c->r * n; i++) c->um[i] = c->u[i] * ratio[i % n];
    cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasTrans, (int)c->r, (int)c->C, (int)n, 1, c->um,
                (int)n, k, (int)n, 0, c->one, (int)c->C);
}

static int combine_walks(const struct walk_rows *s, const float *u, uint32_t r, uint32_t n,
                         const float *w, const uint32_t *row, float *out)
{
    const struct walk_pool *p = s->pool;
    const size_t C = s->product->cut->n_column, n_vertex = s->walks.n_vertex;
    float *share = prt_alloc((size_t)n * p->n_media + 1, sizeof *share);
    float *k = prt_alloc(C * n_vertex + 1, sizeof *k);
    struct combine c = {.s = s, .u = u, .r = r, .n = n, .C = (uint32_t)C, .row = row};
    c.share = share;
    c.um = prt_alloc(n_vertex * r + 1, sizeof *c.um);
    c.turned = prt_alloc(C * r + 1, sizeof *c.turned);
    c.one = prt_alloc(C * r + 1, sizeof *c.one);
    c.q = prt_calloc(n * C + 1, sizeof *c.q);
    int status = share && k && c.um && c.turned && c.one && c.q ? PRT_OK : PRT_NOMEM;
    if (!status && n) {
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)p->n_media,
                    (int)p->n_own[0], 1, w, (int)p->n_function, p->mix, (int)p->n_media, 0,
                    share, (int)p->n_media);
        for (uint32_t m = 0; m < p->n_media; m++) {
            if (m < p->n_walked) walked_medium(&c, m);
            else dipole_medium(&c, m, k);
            add_medium(&c, m);
        }
        status = prt_product_weigh(s->product, c.q, n, out);
    }
    prt_free(share);
    prt_free(k);
    prt_free(c.um);
    prt_free(c.turned);
    prt_free(c.one);
    prt_free(c.q);
    return status;
}

int prt_walk_rows_combine(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                          const uint32_t *row, float *out)
{
    struct walk_rows *s = user;
    if (s->walks.smooth) return combine_walks(s, u, r, n, w, row, out);
    const struct walk_pool *p = s->pool;
    float *mix = dipole_mix(s);
    float *of = mix ? prt_alloc((size_t)n * p->n_radial + 1, sizeof *of) : NULL;
    int status = of ? PRT_OK : PRT_NOMEM;
    if (!status) {
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, (int)n, (int)p->n_radial,
                    (int)p->n_function, 1, w, (int)p->n_function, mix, (int)p->n_radial, 0, of,
                    (int)p->n_radial);
        status = prt_product_combine(s->product, u, r, n, of, row, out);
    }
    prt_free(mix);
    prt_free(of);
    return status;
}
