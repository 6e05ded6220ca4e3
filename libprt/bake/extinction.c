// SPDX-License-Identifier: MIT
// Running integrals of the basis of e^(-sigma_t r).
#include "bake/stages.h"
#include "base/log_grid.h"

#include "prt/radial.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Adds the integral over [a,b] by composite Simpson.
static void add_integral(const struct prt_radial *radial, double a, double b, double *sum)
{
    enum { N = 8 };
    float r[N + 1], value[(N + 1) * EXTINCTION_WIDE];
    for (int i = 0; i <= N; i++) r[i] = (float)(a + (b - a) * i / N);
    prt_radial_eval(radial, N + 1, r, value);
    for (uint32_t j = 0; j < radial->n_function; j++)
        for (int i = 0; i <= N; i++) {
            double w = i == 0 || i == N ? 1 : i & 1 ? 4 : 2;
            sum[j] += w * (b - a) / (3 * N) * value[(uint32_t)i * radial->n_function + j];
        }
}

int prt_extinction_table_create(const struct prt_radial *radial, struct extinction_table **out)
{
    if (radial->n_function > EXTINCTION_WIDE) return PRT_LIMIT;
    struct extinction_table *t = calloc(1, sizeof *t);
    if (!t) return PRT_NOMEM;
    float last = radial->r[radial->n_grid - 1];
    t->n_function = radial->n_function;
    t->base = prt_log_index(radial->r[1], EXTINCTION_SHIFT);
    t->n_grid = prt_log_index(last, EXTINCTION_SHIFT) - t->base + 2;
    t->r = prt_alloc(t->n_grid, sizeof *t->r);
    t->integral = prt_calloc((size_t)t->n_grid * EXTINCTION_WIDE, sizeof *t->integral);
    if (!t->r || !t->integral) {
        prt_extinction_table_destroy(t);
        return PRT_NOMEM;
    }
    double sum[EXTINCTION_WIDE] = {0}, before = 0;
    for (uint32_t i = 0; i < t->n_grid; i++) {
        double r = fmin(prt_log_node(t->base + i, EXTINCTION_SHIFT), last);
        if (r > before) add_integral(radial, before, r, sum);
        before = r;
        t->r[i] = (float)r;
        for (uint32_t j = 0; j < t->n_function; j++)
            t->integral[(size_t)i * EXTINCTION_WIDE + j] = (float)sum[j];
    }
    *out = t;
    return PRT_OK;
}

void prt_extinction_table_destroy(struct extinction_table *t)
{
    if (!t) return;
    prt_free(t->r);
    prt_free(t->integral);
    free(t);
}
