/* SPDX-License-Identifier: MIT */
/* Row sources (struct row_source): a cluster's transport rows as matrix products. */
#ifndef PRT_BAKE_SOURCES_H
#define PRT_BAKE_SOURCES_H

#include "bake/stages.h"

/* T_f = K_f E: K of a cut times irradiance rows E, those of each node of eta one behind the
 * other. T is never formed. */
struct product_rows {
    const struct half_rows *rows;
    const struct cut *cut;
    uint32_t n_vertex, n_function; /* functions: the cut's at each node of the rows */
    const struct lit_rows *lit;    /* products with these lights need no others; or NULL */
    struct work_meters *work;      /* or NULL */
    const float *smooth; /* [n_function][n_vertex][n_vertex] M_f in T_f = M_f K_f E; NULL: 1 */
};
/* All rows times the lights of a tensor: the clusters' cuts share most rows. */
struct lit_rows {
    uint32_t n_light;
    const float *light; /* [n_coef][n_light], as multiply's x */
    float *value;       /* [n_row][n_layer][n_light] */
};
/* PRT_NOMEM; PRT_CANCELLED. prt_lit_rows_finish frees the values. */
int prt_lit_rows_create(const struct prt_context *ctx, const struct half_rows *rows,
                        const float *light, uint32_t n_light, struct work_meters *work,
                        struct lit_rows *out);
void prt_lit_rows_finish(struct lit_rows *lit);

/* q [layer][n][n_column] times the cut's rows, [n][n_texel]. */
int prt_product_weigh(const struct product_rows *p, const float *q, uint32_t n, float *out);
int prt_product_multiply(void *user, const float *x, uint32_t m, float *out);
int prt_product_project(void *user, const float *u, uint32_t r, float *out);
int prt_product_combine(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                        const uint32_t *row, float *out);

/* Dense rows [n_vertex][n_function][n_coef]. */
struct dense_rows {
    const float *t;
    uint32_t n_vertex, n_function, n_coef;
};
int prt_dense_multiply(void *user, const float *x, uint32_t m, float *out);
int prt_dense_project(void *user, const float *u, uint32_t r, float *out);

#endif
