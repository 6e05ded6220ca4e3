/* SPDX-License-Identifier: MIT */
/* Row sources (struct row_source): a cluster's transport rows as matrix products. */
#ifndef PRT_BAKE_SOURCES_H
#define PRT_BAKE_SOURCES_H

#include "bake/stages.h"

/* T_f = K_f E: K of a cut times irradiance rows E. T is never formed. */
struct product_rows {
    const struct half_rows *rows;
    const struct cut *cut;
    uint32_t n_vertex, n_function;
};
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
