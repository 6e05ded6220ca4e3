/* SPDX-License-Identifier: MIT */
/* defined_tensors.h owns made-up tensors of every kind and the colours that they define, for
 * the tests of contractions and of answers. */
#ifndef UNIT_DEFINED_TENSORS_H
#define UNIT_DEFINED_TENSORS_H

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "prt/radial.h"
#include "prt/relight.h"
#include "relight/answer.h"
#include "synthetic.h"

static char last_line[1024];

static inline void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

static inline struct prt_context quiet(void)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_line;
    return ctx;
}

enum { N = 1357, N_KIND = 8 };
static const struct synthetic_options kind[N_KIND] = {
    {.storage = PRT_STORAGE_FACTORED,
     .value = PRT_VALUE_F16,
     .n_vertex = N,
     .n_cluster = 5,
     .rank = 21,
     .n_phase = 1,
     .cube = 16,
     .coefs = 60,
     .seed = 1},
    {.storage = PRT_STORAGE_FACTORED,
     .value = PRT_VALUE_I8,
     .n_vertex = N,
     .n_cluster = 3,
     .rank = 8,
     .n_phase = 4,
     .cube = 16,
     .coefs = 40,
     .seed = 2,
     .term = PRT_TERM_SINGLE},
    {.storage = PRT_STORAGE_SPARSE,
     .value = PRT_VALUE_I8,
     .n_vertex = N,
     .n_phase = 1,
     .cube = 32,
     .coefs = 30,
     .seed = 3},
    {.storage = PRT_STORAGE_SPARSE,
     .value = PRT_VALUE_F16,
     .n_vertex = N,
     .n_phase = 9,
     .cube = 16,
     .coefs = 10,
     .seed = 4,
     .term = PRT_TERM_SINGLE},
    {.storage = PRT_STORAGE_FACTORED,
     .coupling = PRT_COUPLE_FULL,
     .value = PRT_VALUE_F16,
     .n_vertex = N,
     .n_cluster = 4,
     .rank = 7,
     .n_phase = 1,
     .n_radial = 12,
     .cube = 16,
     .coefs = 30,
     .seed = 5},
    {.storage = PRT_STORAGE_FACTORED,
     .coupling = PRT_COUPLE_FULL,
     .value = PRT_VALUE_I8,
     .n_vertex = N,
     .n_cluster = 2,
     .rank = 5,
     .n_phase = 4,
     .n_radial = 11,
     .cube = 16,
     .coefs = 30,
     .seed = 6,
     .term = PRT_TERM_SINGLE},
    {.storage = PRT_STORAGE_FACTORED,
     .value = PRT_VALUE_PAIR,
     .n_vertex = N,
     .n_cluster = 5,
     .rank = 21,
     .n_phase = 1,
     .cube = 32,
     .coefs = 61,
     .seed = 8},
    {.storage = PRT_STORAGE_RADIAL,
     .n_vertex = N,
     .n_cluster = 3,
     .n_phase = 4,
     .n_radial = 6,
     .cube = 16,
     .seed = 7,
     .term = PRT_TERM_SINGLE},
};

static inline bool needs_coef(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL || t->storage == PRT_STORAGE_RADIAL;
}

static inline const float *some_coef(void)
{
    static float coef[64 * 3];
    for (int i = 0; i < 64 * 3; i++) coef[i] = 1.0f / (float)(i + 2) - 0.1f * (float)(i % 2);
    return coef;
}

/* A value by its definition in double, the sum of its terms' absolute values, and the most that
 * rounding to 16-bit integers may change it by. */
struct defined {
    double value, sum, step;
};

static inline void add_term(struct defined *to, double factor, struct defined x)
{
    to->value += factor * x.value;
    to->sum += fabs(factor) * x.sum;
    to->step += fabs(factor) * x.step;
}

static inline void add_product(struct defined *to, double a, double b)
{
    to->value += a * b;
    to->sum += fabs(a * b);
}

/* Value j of entry e of a row. */
static inline double entry_value(const struct prt_rows *r, uint32_t row, uint64_t e, uint32_t j)
{
    const uint32_t n = r->n_function;
    double v = 0;
    const uint32_t first = r->direction ? r->direction[row] : 0;
    const uint32_t n_direction = r->direction ? r->direction[row + 1] - first : 0;
    for (uint32_t d = 0; d < n_direction; d++) {
        uint64_t at = r->value_begin[row] + (e - r->begin[row]) * n_direction + d;
        v += ldexp(((const int8_t *)r->entry)[at], -r->shift[e]) * (double)r->scale[first + d] *
             (double)prt_f16_to_f32(r->mix[(uint64_t)(first + d) * n + j]);
    }
    if (n_direction) return v;
    if (r->value == PRT_VALUE_F16)
        return (double)prt_f16_to_f32(((const uint16_t *)r->entry)[e * n + j]);
    if (r->value == PRT_VALUE_PAIR)
        return (double)((const int16_t *)r->entry)[e / 2 * 2 * n + 2 * j + e % 2] *
               (double)r->scale[(uint64_t)row * n + j];
    return (double)((const int8_t *)r->entry)[e * n + j] *
           (double)r->scale[(uint64_t)row * n + j];
}

/* Half a step of a channel's coefficients when they become 16-bit integers. */
static inline double light_step(const struct prt_light *light, int ch)
{
    const uint32_t face = light->n * light->n;
    double most = 0;
    for (uint32_t i = 0; i < 6 * face; i++)
        if (i % face)
            most = fmax(most, fabs((double)light->coef[4 * (size_t)i + (size_t)ch]) *
                                  (double)prt_pair_gain(light->n, i));
    return 0.5 * most / INT16_MAX;
}

/* Row values . light for function j (and channel ch when FULL); step: of the light, or 0. */
static inline struct defined row_light(const struct prt_rows *r, uint32_t row, uint32_t j,
                                       int ch, const struct prt_light *light, double step)
{
    uint32_t n = r->n_function, face = r->n_coef / 6;
    struct defined out = {0};
    for (uint32_t f = 0; f < 6; f++)
        add_product(&out, (double)prt_f16_to_f32(r->scaling[((uint64_t)row * 6 + f) * n + j]),
                    (double)light->coef[4 * f * face + (uint32_t)ch]);
    for (uint64_t e = r->begin[row]; e < r->begin[row + 1]; e++) {
        const uint32_t i = r->index_bytes == 2 ? ((const uint16_t *)r->index)[e]
                                               : ((const uint32_t *)r->index)[e];
        const double gain = r->value == PRT_VALUE_PAIR ? (double)prt_pair_gain(light->n, i) : 1;
        const double v = entry_value(r, row, e, j);
        add_product(&out, v * gain, (double)light->coef[4 * i + (uint32_t)ch]);
        if (r->value == PRT_VALUE_PAIR) out.step += fabs(v) * step;
    }
    return out;
}

static inline struct defined row_plane(const struct prt_tensor *t, uint32_t row, uint32_t k,
                                       int ch, const struct prt_light *light, const float *coef,
                                       double step)
{
    struct defined out = {0};
    if (t->coupling == PRT_COUPLE_DIAGONAL)
        return row_light(&t->rows, row, 3 * k + (uint32_t)ch, ch, light, step);
    for (uint32_t j = 0; j < t->n_radial; j++)
        add_term(&out, (double)coef[3 * j + (uint32_t)ch],
                 row_light(&t->rows, row, k * t->n_radial + j, ch, light, step));
    return out;
}

static inline double u_of(const struct prt_tensor *t, const struct prt_cluster *c, uint32_t r,
                          uint32_t v, uint32_t phase, int ch)
{
    const uint16_t *u = t->u + c->u_begin;
    const uint64_t stride = (c->n_vertex + 15) & ~15u;
    const uint64_t column = 3ull * (phase * t->n_radial + r) + (uint32_t)ch;
    if (t->storage == PRT_STORAGE_RADIAL)
        return (double)prt_f16_to_f32(u[column * stride + v]) *
               (double)t->u_scale[3 * t->n_function * (uint64_t)(c - t->cluster) + column];
    return (double)(int16_t)u[(r / 2 * stride + v) * 2 + r % 2] * (double)PRT_U_UNIT;
}

/* Half a step of a column's coefficients in the integer expansion (kernels.h), added to each.
 */
static inline void add_column_step(struct defined *b, uint32_t rank)
{
    const double sum_most = (double)(INT32_MAX / PRT_U_MOST - 129);
    double sum = 0, most = 0;
    for (uint32_t r = 0; r < rank; r++) {
        sum += fabs(b[r].value) + b[r].step;
        most = fmax(most, fabs(b[r].value) + b[r].step);
    }
    for (uint32_t r = 0; r < rank && sum > 0; r++)
        b[r].step += 0.5 / fmin(sum_most / sum, INT16_MAX / most);
}

/* Colours by their definition, and how far those of a kernel for `cpu` may lie from them:
 * KERNEL_TOLERANCE of kernels.h, and the steps of 16-bit integers where it computes in these.
 */
static inline void define(const struct prt_tensor *t, const struct prt_light *light,
                          const float *coef, unsigned cpu, float *color, float *bound)
{
    const bool rounds = prt_relight_in_integers(prt_cpu_detect() & cpu);
    const size_t plane = 3 * (size_t)t->n_vertex;
    const bool radial = t->storage == PRT_STORAGE_RADIAL;
    for (uint32_t i = 0; i < 3 * t->n_phase; i++) {
        const uint32_t k = i / 3, ch = i % 3;
        const double step = rounds ? light_step(light, (int)ch) : 0;
        float *to = color + k * plane + ch, *most = bound + k * plane + ch;
        for (uint32_t p = 0; t->storage == PRT_STORAGE_SPARSE && p < t->n_vertex; p++) {
            const struct defined x = row_plane(t, p, k, (int)ch, light, NULL, 0);
            to[3 * t->order[p]] = (float)x.value;
            most[3 * t->order[p]] = (float)(1e-5 * x.sum);
        }
        for (uint32_t c = 0; c < t->n_cluster; c++) {
            const struct prt_cluster *q = &t->cluster[c];
            struct defined b[64];
            const uint32_t rank = radial ? t->n_radial : q->rank;
            for (uint32_t r = 0; r < rank; r++) {
                const double x = radial ? (double)coef[3 * r + ch] : 0;
                b[r] = radial ? (struct defined){x, fabs(x), 0}
                              : row_plane(t, q->row_begin + r, k, (int)ch, light, coef, step);
            }
            if (rounds && !radial) add_column_step(b, rank);
            for (uint32_t v = 0; v < q->n_vertex; v++) {
                struct defined x = {0};
                for (uint32_t r = 0; r < rank; r++)
                    add_term(&x, u_of(t, q, r, v, k, (int)ch), b[r]);
                to[3 * t->order[q->vertex_begin + v]] = (float)x.value;
                most[3 * t->order[q->vertex_begin + v]] = (float)(1e-5 * x.sum + 1.01 * x.step);
            }
        }
    }
}

static inline void check_values(const char *what, const float *got, const float *expect,
                                const float *bound, double factor, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        const double off = fabs((double)got[i] - (double)expect[i]);
        if (!(off <= factor * (double)bound[i]))
            fail_msg("%s: value %zu is %.9g, expected %.9g; off by %g, %g allowed", what, i,
                     (double)got[i], (double)expect[i], off, factor * (double)bound[i]);
    }
}

static inline double difference(const float *a, const float *b, size_t n)
{
    double d = 0, s = 0;
    for (size_t i = 0; i < n; i++) {
        d += pow((double)a[i] - (double)b[i], 2);
        s += pow((double)b[i], 2);
    }
    return sqrt(d / (s > 0 ? s : 1));
}

#endif
