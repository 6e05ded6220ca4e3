// SPDX-License-Identifier: MIT
// Contractions of whole tensors against their definition and their laws (linearity, order of
// contraction, independence of threads and of other lights), and answers against the command
// contract.
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

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    snprintf(last_line, sizeof last_line, "%s", line);
}

static struct prt_context quiet(void)
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

static bool needs_coef(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL || t->storage == PRT_STORAGE_RADIAL;
}

static const float *some_coef(void)
{
    static float coef[64 * 3];
    for (int i = 0; i < 64 * 3; i++) coef[i] = 1.0f / (float)(i + 2) - 0.1f * (float)(i % 2);
    return coef;
}

// A value by its definition in double, the sum of its terms' absolute values, and the most that
// rounding to 16-bit integers may change it by.
struct defined {
    double value, sum, step;
};

static void add_term(struct defined *to, double factor, struct defined x)
{
    to->value += factor * x.value;
    to->sum += fabs(factor) * x.sum;
    to->step += fabs(factor) * x.step;
}

static void add_product(struct defined *to, double a, double b)
{
    to->value += a * b;
    to->sum += fabs(a * b);
}

// Value j of entry e of a row.
static double entry_value(const struct prt_rows *r, uint32_t row, uint64_t e, uint32_t j)
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

// Half a step of a channel's coefficients when they become 16-bit integers.
static double light_step(const struct prt_light *light, int ch)
{
    const uint32_t face = light->n * light->n;
    double most = 0;
    for (uint32_t i = 0; i < 6 * face; i++)
        if (i % face)
            most = fmax(most, fabs((double)light->coef[4 * (size_t)i + (size_t)ch]) *
                                  (double)prt_pair_gain(light->n, i));
    return 0.5 * most / INT16_MAX;
}

// Row values . light for function j (and channel ch when FULL); step: of the light, or 0.
static struct defined row_light(const struct prt_rows *r, uint32_t row, uint32_t j, int ch,
                                const struct prt_light *light, double step)
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

static struct defined row_plane(const struct prt_tensor *t, uint32_t row, uint32_t k, int ch,
                                const struct prt_light *light, const float *coef, double step)
{
    struct defined out = {0};
    if (t->coupling == PRT_COUPLE_DIAGONAL)
        return row_light(&t->rows, row, 3 * k + (uint32_t)ch, ch, light, step);
    for (uint32_t j = 0; j < t->n_radial; j++)
        add_term(&out, (double)coef[3 * j + (uint32_t)ch],
                 row_light(&t->rows, row, k * t->n_radial + j, ch, light, step));
    return out;
}

static double u_of(const struct prt_tensor *t, const struct prt_cluster *c, uint32_t r,
                   uint32_t v, uint32_t phase, int ch)
{
    const uint16_t *u = t->u + c->u_begin;
    const uint64_t stride = (c->n_vertex + 15) & ~15u;
    if (t->storage == PRT_STORAGE_RADIAL)
        return (double)prt_f16_to_f32(
            u[(3ull * (phase * t->n_radial + r) + (uint32_t)ch) * stride + v]);
    return (double)(int16_t)u[(r / 2 * stride + v) * 2 + r % 2] * (double)PRT_U_UNIT;
}

// Half a step of a column's coefficients in the integer expansion (kernels.h), added to each.
static void add_column_step(struct defined *b, uint32_t rank)
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

// Colours by their definition, and how far a kernel's may lie from them: KERNEL_TOLERANCE of
// kernels.h, and the steps of 16-bit integers where n_light lights may be computed in these.
static void define(const struct prt_tensor *t, const struct prt_light *light, const float *coef,
                   unsigned n_light, float *color, float *bound)
{
    const bool rounds = prt_cpu_detect() & PRT_CPU_AVX512VNNI;
    const size_t plane = 3 * (size_t)t->n_vertex;
    const bool radial = t->storage == PRT_STORAGE_RADIAL;
    for (uint32_t i = 0; i < 3 * t->n_phase; i++) {
        const uint32_t k = i / 3, ch = i % 3;
        const double step = rounds && n_light > 2 ? light_step(light, (int)ch) : 0;
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
            if (rounds && !radial && n_light * t->n_phase >= 4) add_column_step(b, rank);
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

static void check_values(const char *what, const float *got, const float *expect,
                         const float *bound, double factor, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        const double off = fabs((double)got[i] - (double)expect[i]);
        if (!(off <= factor * (double)bound[i]))
            fail_msg("%s: value %zu is %.9g, expected %.9g; off by %g, %g allowed", what, i,
                     (double)got[i], (double)expect[i], off, factor * (double)bound[i]);
    }
}

static double difference(const float *a, const float *b, size_t n)
{
    double d = 0, s = 0;
    for (size_t i = 0; i < n; i++) {
        d += pow((double)a[i] - (double)b[i], 2);
        s += pow((double)b[i], 2);
    }
    return sqrt(d / (s > 0 ? s : 1));
}

static void colours_are_what_is_defined(void **state)
{
    static const unsigned cpus[] = {PRT_CPU_C, PRT_CPU_AVX2, ~0u};
    struct prt_context ctx = quiet();
    for (int i = 0; i < N_KIND; i++) {
        struct prt_tensor t;
        struct prt_light light;
        assert_int_equal(synthetic_tensor(&kind[i], &t), 0);
        assert_int_equal(synthetic_light(kind[i].cube, 3, &light), 0);
        const struct prt_light *lights[1] = {&light};
        const float *coef = needs_coef(&t) ? some_coef() : NULL;
        size_t n = 3ull * N * t.n_phase;
        float *expect = malloc(4 * n), *bound = malloc(4 * n), *got = malloc(4 * n);
        define(&t, &light, coef, 1, expect, bound);
        for (int c = 0; c < 3; c++) {
            ctx.cpu = prt_cpu_detect() & cpus[c];
            memset(got, 0xff, 4 * n);
            assert_int_equal(prt_relight(&ctx, &t, 1, lights, coef, false, got), 0);
            check_values(prt_cpu_word(ctx.cpu), got, expect, bound, 1, n);
            // adding to what is there
            assert_int_equal(prt_relight(&ctx, &t, 1, lights, coef, true, got), 0);
            for (size_t k = 0; k < n; k++) got[k] *= 0.5f;
            check_values(prt_cpu_word(ctx.cpu), got, expect, bound, 1, n);
        }
        free(expect);
        free(bound);
        free(got);
        prt_light_finish(&light);
        synthetic_tensor_finish(&t);
    }
}

// T(a l + b m) = a T l + b T m.
static void lights_superpose(void **state)
{
    static const float weight[3] = {0.3f, 2, 1};
    struct prt_context ctx = quiet();
    for (int i = 0; i < N_KIND - 1; i++) {
        struct prt_tensor t;
        struct prt_light light[3];
        assert_int_equal(synthetic_tensor(&kind[i], &t), 0);
        for (int l = 0; l < 3; l++)
            assert_int_equal(synthetic_light(kind[i].cube, (uint64_t)l + 1, &light[l]), 0);
        for (uint32_t k = 0; k < 24 * kind[i].cube * kind[i].cube; k++)
            light[2].coef[k] = weight[0] * light[0].coef[k] + weight[1] * light[1].coef[k];
        const float *coef = needs_coef(&t) ? some_coef() : NULL;
        size_t n = 3ull * N * t.n_phase;
        float *color[3], *bound[3], *sum = malloc(4 * n);
        for (int l = 0; l < 3; l++) {
            const struct prt_light *one[1] = {&light[l]};
            color[l] = malloc(4 * n);
            bound[l] = malloc(4 * n);
            define(&t, &light[l], coef, 1, color[l], bound[l]);
            assert_int_equal(prt_relight(&ctx, &t, 1, one, coef, false, color[l]), 0);
        }
        for (size_t k = 0; k < n; k++) {
            sum[k] = weight[0] * color[0][k] + weight[1] * color[1][k];
            bound[2][k] += weight[0] * bound[0][k] + weight[1] * bound[1][k];
        }
        check_values("two lights", color[2], sum, bound[2], 1, n);
        free(sum);
        for (int l = 0; l < 3; l++) {
            free(color[l]);
            free(bound[l]);
            prt_light_finish(&light[l]);
        }
        synthetic_tensor_finish(&t);
    }
}

static void many_lights_are_single_ones(void **state)
{
    static const unsigned counts[] = {2, 3, 8, 11, 16};
    struct prt_context ctx = quiet();
    struct prt_light light[16];
    const struct prt_light *lights[16];
    float *expect[16], *bound[16];
    for (int i = 0; i < N_KIND - 1; i++) {
        struct prt_tensor t;
        assert_int_equal(synthetic_tensor(&kind[i], &t), 0);
        const float *coef = needs_coef(&t) ? some_coef() : NULL;
        size_t n = 3ull * N * t.n_phase;
        for (unsigned l = 0; l < 16; l++) {
            assert_int_equal(synthetic_light(kind[i].cube, l + 1, &light[l]), 0);
            lights[l] = &light[l];
            expect[l] = malloc(4 * n);
            bound[l] = malloc(4 * n);
            define(&t, &light[l], coef, 16, expect[l], bound[l]);
        }
        float *all = malloc(16 * 4 * n);
        for (int c = 0; c < 5; c++) {
            assert_int_equal(prt_relight(&ctx, &t, counts[c], lights, coef, false, all), 0);
            for (unsigned l = 0; l < counts[c]; l++)
                check_values("many lights", all + l * n, expect[l], bound[l], 1, n);
        }
        free(all);
        for (unsigned l = 0; l < 16; l++) {
            free(expect[l]);
            free(bound[l]);
            prt_light_finish(&light[l]);
        }
        synthetic_tensor_finish(&t);
    }
}

static void threads_change_no_bit(void **state)
{
    struct prt_context ctx = quiet();
    for (int i = 0; i < N_KIND; i++) {
        struct prt_tensor t;
        struct prt_light light[8];
        const struct prt_light *lights[8];
        struct synthetic_options o = kind[i];
        o.n_vertex = 9000;
        assert_int_equal(synthetic_tensor(&o, &t), 0);
        for (unsigned l = 0; l < 8; l++) {
            assert_int_equal(synthetic_light(o.cube, l + 1, &light[l]), 0);
            lights[l] = &light[l];
        }
        const float *coef = needs_coef(&t) ? some_coef() : NULL;
        unsigned n_light = t.storage == PRT_STORAGE_RADIAL ? 1 : 8;
        size_t n = 3ull * o.n_vertex * t.n_phase * n_light;
        float *one = malloc(4 * n), *more = malloc(4 * n);
        ctx.pool = NULL;
        assert_int_equal(prt_relight(&ctx, &t, n_light, lights, coef, false, one), 0);
        for (unsigned threads = 2; threads <= 5; threads += 3) {
            assert_int_equal(prt_pool_create(threads, &ctx.pool), 0);
            memset(more, 0xff, 4 * n);
            assert_int_equal(prt_relight(&ctx, &t, n_light, lights, coef, false, more), 0);
            prt_pool_destroy(ctx.pool);
            assert_memory_equal(one, more, 4 * n);
        }
        free(one);
        free(more);
        for (unsigned l = 0; l < 8; l++) prt_light_finish(&light[l]);
        synthetic_tensor_finish(&t);
    }
}

static void material_and_light_commute(void **state)
{
    struct prt_context ctx = quiet();
    for (int i = 4; i <= 5; i++) {
        struct prt_tensor t, folded;
        struct prt_light light;
        const struct prt_light *lights[1] = {&light};
        assert_int_equal(synthetic_tensor(&kind[i], &t), 0);
        assert_int_equal(synthetic_light(kind[i].cube, 3, &light), 0);
        size_t n = 3ull * N * t.n_phase;
        float *a = malloc(4 * n), *b = malloc(4 * n);
        assert_int_equal(prt_relight(&ctx, &t, 1, lights, some_coef(), false, a), 0);
        folded = t;
        folded.coupling = PRT_COUPLE_DIAGONAL;
        folded.n_function = 3 * t.n_phase;
        assert_int_equal(prt_rows_fold(&ctx, &t, some_coef(), &folded.rows), 0);
        assert_int_equal(prt_relight(&ctx, &folded, 1, lights, NULL, false, b), 0);
        assert_true(difference(b, a, n) < 1e-3); // folded rows are halves again
        prt_rows_finish(&folded.rows);
        free(a);
        free(b);
        prt_light_finish(&light);
        synthetic_tensor_finish(&t);
    }
}

// Energy of all colours in a tensor's rows: each row's times that of its column of U.
static double energy_of(const struct prt_tensor *t, const struct prt_rows *rows)
{
    double all = 0;
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const struct prt_cluster *k = &t->cluster[c];
        const size_t padded = (k->n_vertex + 15ull) / 16 * 16;
        const int16_t *u = (const int16_t *)t->u + k->u_begin;
        for (uint32_t r = 0; r < k->rank; r++) {
            const uint64_t row = k->row_begin + r, J = rows->n_function;
            double column = 0, sum = 0;
            for (size_t v = 0; v < k->n_vertex; v++)
                column += pow(u[2 * (padded * (r / 2) + v) + r % 2], 2);
            for (uint64_t e = rows->begin[row] * J; e < rows->begin[row + 1] * J; e++)
                sum += pow((double)prt_f16_to_f32(((const uint16_t *)rows->entry)[e]), 2);
            for (uint64_t e = row * 6 * J; e < (row + 1) * 6 * J; e++)
                sum += pow((double)prt_f16_to_f32(rows->scaling[e]), 2);
            all += column * sum;
        }
    }
    return all;
}

// Entries that folding drops hold error^2 of the energy at most, and most of that.
static void dropped_entries_hold_little(void **state)
{
    struct prt_context ctx = quiet();
    const double error = 0.1;
    for (int i = 4; i <= 5; i++) {
        struct prt_tensor t;
        struct prt_rows whole, some;
        assert_int_equal(synthetic_tensor(&kind[i], &t), 0);
        float *coef = malloc(sizeof *coef * 3 * t.n_radial * t.n_phase);
        for (uint32_t k = 0; k < t.n_phase; k++)
            memcpy(coef + 3ull * t.n_radial * k, some_coef(), 12ull * t.n_radial);
        assert_int_equal(prt_rows_fold_planes(&ctx, &t, coef, NULL, 0, &whole), 0);
        assert_int_equal(prt_rows_fold_planes(&ctx, &t, coef, NULL, error, &some), 0);
        assert_true(some.begin[some.n_row] < whole.begin[whole.n_row]);
        double lost = 1 - energy_of(&t, &some) / energy_of(&t, &whole);
        print_message("dropped %.4f of the energy, allowed %.4f\n", lost, error * error);
        assert_true(lost <= error * error * 1.0001 && lost > 0.3 * error * error);
        prt_rows_finish(&whole);
        prt_rows_finish(&some);
        free(coef);
        synthetic_tensor_finish(&t);
    }
}

static void wrong_calls_are_refused(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_tensor t;
    struct prt_light light;
    struct prt_rows rows;
    const struct prt_light *lights[17];
    float *color = malloc(12 * N * 4);
    assert_int_equal(synthetic_tensor(&kind[0], &t), 0);
    assert_int_equal(synthetic_light(32, 3, &light), 0);
    for (int i = 0; i < 17; i++) lights[i] = &light;
    assert_int_equal(prt_relight(&ctx, &t, 1, lights, NULL, false, color), PRT_MISMATCH);
    assert_int_equal(prt_relight(&ctx, &t, 0, lights, NULL, false, color), PRT_ARG);
    assert_int_equal(prt_relight(&ctx, &t, 17, lights, NULL, false, color), PRT_ARG);
    assert_int_equal(prt_relight(&ctx, &t, 1, lights, some_coef(), false, color), PRT_ARG);
    assert_int_equal(prt_relight_sparse(&ctx, &t, 1, lights, false, color), PRT_MISMATCH);
    assert_int_equal(prt_relight_radial(&ctx, &t, some_coef(), false, color), PRT_ARG);
    assert_int_equal(prt_contract_material(&ctx, &t, color, some_coef(), color), PRT_ARG);
    assert_int_equal(prt_rows_fold(&ctx, &t, some_coef(), &rows), PRT_ARG);
    prt_light_finish(&light);
    synthetic_tensor_finish(&t);
    free(color);
}

static int transport_of(struct prt_transport *t, const struct synthetic_options *a,
                        const struct synthetic_options *b)
{
    *t = (struct prt_transport){.cube = 16, .n_tensor = 1};
    static const struct prt_material material = {.name = "x",
                                                 .sigma_s_prime = {1, 1.5f, 2},
                                                 .sigma_a = {0.01f, 0.02f, 0.03f},
                                                 .g = {0.2f, 0, -0.1f},
                                                 .eta = 1.3f,
                                                 .roughness = 0.3f};
    t->media = prt_media_one(&material);
    assert_int_equal(synthetic_mesh(N, true, &t->mesh), 0);
    assert_int_equal(synthetic_tensor(a, &t->tensor[0]), 0);
    if (b) assert_int_equal(synthetic_tensor(b, &t->tensor[t->n_tensor++]), 0);
    return 0;
}

static void finish_transport(struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++) synthetic_tensor_finish(&t->tensor[i]);
    synthetic_mesh_finish(&t->mesh);
}

static void some_cube(struct prt_cube *cube)
{
    struct prt_rng rng;
    assert_int_equal(prt_cube_init(cube, 16), 0);
    prt_rng_init(&rng, 5, 5);
    for (int i = 0; i < 6 * 16 * 16 * 3; i++) cube->texel[i] = 1 + prt_rng_f32(&rng);
}

enum { MANY = PRT_RELIGHT_MAX_LIGHTS };

// Nine colours of one kind (a group and one), four of the planes behind them, and others.
static void ask_many(struct prt_cube cube[MANY], struct prt_query q[MANY], bool planes[MANY])
{
    static const float eye[3] = {30, 80, 10};
    for (int i = 0; i < MANY; i++) {
        some_cube(&cube[i]);
        for (int k = 0; k < 6 * 16 * 16 * 3; k++) cube[i].texel[k] *= (float)(1 + (k + i) % 3);
        q[i] = (struct prt_query){.light = &cube[i],
                                  .term =
                                      i < 13 ? PRT_ANSWER_TOTAL : (enum prt_answer_term)(i % 3),
                                  .eye = i >= 12 ? eye : NULL};
        planes[i] = i >= 8 && i < 12;
    }
}

// How far an answer's values may lie from their definition: the bounds of all planes that it
// sums. Spherical harmonics up to l = 3 and Fresnel transmittance are below 1.
static void answer_bound(const struct prt_transport *t, const struct prt_cube *cube,
                         unsigned n_light, float *bound)
{
    struct prt_light light;
    assert_int_equal(prt_light_from_cube(cube, &light), 0);
    memset(bound, 0, 12 * N);
    for (uint32_t i = 0; i < t->n_tensor; i++) {
        const size_t n = 3ull * N * t->tensor[i].n_phase;
        float *color = malloc(4 * n), *one = malloc(4 * n);
        define(&t->tensor[i], &light, NULL, n_light, color, one);
        for (size_t k = 0; k < n; k++) bound[k % (3 * N)] += one[k];
        free(color);
        free(one);
    }
    prt_light_finish(&light);
}

static void compare_many(const struct prt_transport *t)
{
    struct prt_context ctx = quiet();
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    bool planes[MANY];
    float *out[MANY], *alone = malloc((size_t)9 * 12 * N), *bound = malloc(12 * N);
    ask_many(cube, q, planes);
    for (int i = 0; i < MANY; i++) out[i] = malloc((size_t)9 * 12 * N);
    assert_int_equal(prt_answer_many(&ctx, t, MANY, q, planes, out, NULL), 0);
    for (int i = 0; i < MANY; i++) {
        unsigned n_plane = 1;
        if (planes[i]) {
            assert_int_equal(prt_answer_planes(&ctx, t, &q[i], &n_plane, alone), 0);
        } else {
            assert_int_equal(prt_answer_colors(&ctx, t, &q[i], (float(*)[3])alone), 0);
        }
        answer_bound(t, &cube[i], MANY, bound);
        for (unsigned k = 0; k < n_plane; k++)
            check_values("one of many", out[i] + k * 3 * N, alone + k * 3 * N, bound, 2, 3 * N);
        free(out[i]);
        prt_cube_finish(&cube[i]);
    }
    free(alone);
    free(bound);
}

// Queries that are answered in one pass get the values that each gets alone. Tensors have the
// same clusters or others, opaque vertices among them or not, or are sparse.
static void many_queries_equal_one_by_one(void **state)
{
    struct synthetic_options pairs = kind[6], single = kind[0];
    pairs.cube = 16;
    single.term = PRT_TERM_SINGLE; // on the clusters of the multiple one
    struct {
        const struct synthetic_options *a, *b;
        bool opaque;
    } c[] = {{&kind[0], &kind[1], true},
             {&kind[0], &kind[1], false},
             {&kind[0], &single, false},
             {&pairs, &kind[1], false},
             {&pairs, &kind[3], true}};
    for (size_t i = 0; i < sizeof c / sizeof *c; i++) {
        struct prt_transport t;
        transport_of(&t, c[i].a, c[i].b);
        for (uint32_t k = 0; k < t.mesh.n_surface && !c[i].opaque; k++)
            t.mesh.surface[k].translucent = true;
        compare_many(&t);
        finish_transport(&t);
    }
}

// Colours from the first rows of each cluster are those of a transport without the others, bit
// for bit, alone and beside queries for all rows. An odd number of rows is one more.
static void fewer_rows_are_a_smaller_transport(void **state)
{
    static const uint32_t ranks[] = {2, 6, 8, 1000};
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    float *cut = malloc(12 * N), *whole = malloc(12 * N), *few = malloc(12 * N);
    float *out[MANY];
    some_cube(&cube);
    for (int i = 0; i < MANY; i++) out[i] = malloc(12 * N);
    for (size_t k = 0; k < sizeof ranks / sizeof *ranks; k++) {
        struct prt_query q[MANY];
        const bool planes[MANY] = {false};
        transport_of(&t, &kind[0], &kind[1]);
        for (uint32_t i = 0; i < t.mesh.n_surface; i++) t.mesh.surface[i].translucent = true;
        for (int i = 0; i < MANY; i++)
            q[i] = (struct prt_query){.light = &cube,
                                      .term = PRT_ANSWER_TOTAL,
                                      .most_rank = i % 2 ? ranks[k] - (k == 2) : 0};
        assert_int_equal(prt_answer_colors(&ctx, &t, &q[0], (float(*)[3])whole), 0);
        assert_int_equal(prt_answer_colors(&ctx, &t, &q[1], (float(*)[3])few), 0);
        assert_int_equal(prt_answer_many(&ctx, &t, MANY, q, planes, out, NULL), 0);
        double off = difference(few, whole, 3 * N);
        if (ranks[k] == 1000) assert_memory_equal(few, whole, 12 * N);
        else assert_true(off > 1e-3);
        for (int i = 0; i < MANY; i++)
            assert_true(difference(out[i], i % 2 ? few : whole, 3 * N) < 1e-4);
        for (uint32_t i = 0; i < t.n_tensor; i++)
            for (uint32_t c = 0; c < t.tensor[i].n_cluster; c++) {
                struct prt_cluster *own = (struct prt_cluster *)&t.tensor[i].cluster[c];
                if (own->rank > ranks[k]) own->rank = ranks[k];
            }
        assert_int_equal(prt_answer_colors(&ctx, &t, &q[0], (float(*)[3])cut), 0);
        assert_memory_equal(few, cut, 12 * N);
        finish_transport(&t);
    }
    prt_cube_finish(&cube);
    for (int i = 0; i < MANY; i++) free(out[i]);
    free(cut);
    free(whole);
    free(few);
}

static void wrong_queries_are_refused(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    bool planes[MANY];
    float *out[MANY] = {NULL};
    transport_of(&t, &kind[0], &kind[1]);
    ask_many(cube, q, planes);
    q[0].light = NULL;
    assert_int_equal(prt_answer_many(&ctx, &t, 0, q, planes, out, NULL), PRT_ARG);
    assert_int_equal(prt_answer_many(&ctx, &t, MANY + 1, q, planes, out, NULL), PRT_ARG);
    assert_int_equal(prt_answer_many(&ctx, &t, MANY, q, planes, out, NULL), PRT_ARG);
    for (int i = 0; i < MANY; i++) prt_cube_finish(&cube[i]);
    finish_transport(&t);
}

// Planes of single scattering [4][N][3] as they are for a view: times the exit's divisor,
// corrected, with plane 0 of multiple scattering added (METHODS §1, exit; §3.6).
static void toward_a_view(const struct prt_transport *t, const float *multiple, double divisor,
                          float *planes)
{
    struct prt_context ctx = quiet();
    for (int i = 0; i < 3 * N; i++) planes[i] *= 0.28209479f;
    for (int i = 0; i < 4 * 3 * N; i++) planes[i] *= (float)divisor;
    assert_int_equal(prt_view_correct(&ctx, t->mesh.n_vertex, 0, t->mesh.n_vertex,
                                      (const float(*)[3])t->mesh.normal,
                                      (double)t->media.medium->eta, 4, 4, planes),
                     0);
    for (int i = 0; i < 3 * N; i++) planes[i] += multiple[i];
}

// Planes of exit are added to the corrected planes of an answer with a view, on translucent
// vertices, and answers without one are as before (METHODS §3.6).
static void planes_of_exit_are_added(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    struct synthetic_options view = kind[1];
    const float eye[3] = {30, 80, 10};
    struct prt_query q = {.light = &cube, .term = PRT_ANSWER_TOTAL};
    float *flat = malloc(12 * N), *again = malloc(12 * N), *own = malloc(9 * 12 * N);
    float *before = calloc(9 * 3 * N, 4), *after = malloc(9 * 12 * N);
    unsigned n_plane;
    some_cube(&cube);
    transport_of(&t, &kind[0], &kind[1]);
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])flat), 0);
    q.eye = eye;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, before), 0);
    assert_int_equal(n_plane, 4);
    view.n_phase = 9;
    view.term = PRT_TERM_VIEW;
    view.seed = 41;
    assert_int_equal(synthetic_tensor(&view, &t.tensor[t.n_tensor++]), 0);
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, after), 0);
    assert_int_equal(n_plane, 9);
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    assert_int_equal(prt_light_from_cube(&cube, &light), 0);
    assert_int_equal(prt_relight(&ctx, &t.tensor[2], 1, lights, NULL, false, own), 0);
    for (int k = 0; k < 9; k++)
        for (int i = 0; i < 3 * N; i++) {
            const bool opaque = i / 3 >= N - N / 4;
            const double gain = 0.938868 * (k ? 1 : 0.28209479),
                         base = (double)before[k * 3 * N + i];
            const double want = base + (opaque ? 0 : gain * (double)own[k * 3 * N + i]);
            assert_true(fabs((double)after[k * 3 * N + i] - want) < 1e-3 * (1 + fabs(want)));
        }
    q.eye = NULL;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])again), 0);
    assert_memory_equal(again, flat, 12 * N);
    prt_light_finish(&light);
    prt_cube_finish(&cube);
    finish_transport(&t);
    free(flat), free(again), free(own), free(before), free(after);
}

// A half-space lit from one direction: single scattering along the path to the eye is (1 +
// 1/mu_i') / (1 + mu_o'/mu_i') times that along -n_o (METHODS §8). mu_i' is not known to the
// correction.
static void half_space_seen_from_the_side(void **state)
{
    struct prt_context ctx = quiet();
    for (int e = 0; e < 2; e++) {
        const double eta = e ? 1.5 : 1.3, low = sqrt(1 - 1 / (eta * eta));
        float normal[1][3] = {{0.6f, 0, 0.8f}};
        for (int i = 0; i <= 8; i++) {
            double mu_o = low + (1 - low) * i / 8, sine = sqrt(1 - mu_o * mu_o);
            // two azimuths about the normal
            for (int side = -1; side <= 1; side += 2) {
                const float w[3] = {(float)(0.6 * mu_o + side * 0.8 * sine), 0,
                                    (float)(0.8 * mu_o - side * 0.6 * sine)};
                float planes[4][3] = {{1, 1, 1}}, y[4];
                assert_int_equal(prt_view_correct(&ctx, 1, 0, 1, (const float(*)[3])normal, eta,
                                                  1, 4, planes[0]),
                                 0);
                prt_sh_eval(2, w, y);
                double got = (double)planes[0][0];
                for (int k = 1; k < 4; k++) got += (double)(y[k] * planes[k][0]);
                // light at 0, 45 and 90 degrees
                for (int l = 0; l < 3; l++) {
                    double outside = l == 1 ? sqrt(0.5) : l == 2 ? 0 : 1;
                    double mu_i = sqrt(1 - (1 - outside * outside) / (eta * eta));
                    double want = (1 + 1 / mu_i) / (1 + mu_o / mu_i);
                    assert_true(fabs(got / want - 1) < 0.04);
                    if (i == 8) assert_true(fabs(got - 1) < 1e-5);
                }
                double mean = eta < 1.4 ? 0.826 : 0.874; // mu_i' of even light
                double even = (1 + 1 / mean) / (1 + mu_o / mean);
                assert_true(fabs(got / even - 1) < 0.012);
            }
        }
    }
}

// total = F_t(eta, w_o) [multiple/T + sum_k Y_k(w_o') plane_k], clamped; W05 section 5 and
// METHODS §1 (exit). The planes of single scattering are corrected for the view.
static void check_answers(bool papers)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    float eye[3] = {30, 80, 10};
    struct prt_query q = {.light = &cube,
                          .exit = papers ? PRT_EXIT_PAPERS : PRT_EXIT_NORMALISED};
    const float y00 = 0.28209479f;
    const double divisor = papers ? 1 : 0.938868;
    float *multiple = malloc(12 * N), *single = malloc(12 * N), *total = malloc(12 * N);
    float *own = malloc(4 * 12 * N), *planes = malloc(4 * 12 * N);
    unsigned n_plane, n_bright = 0;
    transport_of(&t, &kind[0], &kind[1]);
    some_cube(&cube);
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    assert_int_equal(prt_light_from_cube(&cube, &light), 0);
    assert_int_equal(prt_relight(&ctx, &t.tensor[0], 1, lights, NULL, false, multiple), 0);
    assert_int_equal(prt_relight(&ctx, &t.tensor[1], 1, lights, NULL, false, own), 0);

    q.term = PRT_ANSWER_MULTIPLE;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), 0);
    for (int i = 0; i < 3 * N; i++) assert_float_equal(total[i], fmaxf(0, multiple[i]), 1e-4);
    q.term = PRT_ANSWER_SINGLE;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])single), 0);
    // the last quarter is opaque: nothing scatters in it, whatever the tensor says
    for (int i = 3 * (N - N / 4); i < 3 * N; i++)
        for (int k = 0; k < 4; k++) own[k * 3 * N + i] = 0;
    for (int i = 0; i < 3 * N; i++) assert_float_equal(single[i], fmaxf(0, y00 * own[i]), 1e-4);
    q.term = PRT_ANSWER_TOTAL;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), 0);
    for (int i = 0; i < 3 * N; i++) {
        // never Fresnel on opaque surfaces
        bool opaque = i / 3 >= N - N / 4;
        double mean = opaque ? 1 : 0.938868, share = opaque ? 1 : divisor;
        double want = fmax(0, mean * ((double)multiple[i] / share + (double)(y00 * own[i])));
        assert_true(fabs((double)total[i] - want) < 1e-4 * (1 + want));
        n_bright += total[i] > 0;
    }
    assert_true(n_bright > N / 2);

    q.eye = eye;
    toward_a_view(&t, multiple, divisor, own);
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), 0);
    for (int v = 0; v < N; v++) {
        const float *p = t.mesh.position[v], *n = t.mesh.normal[v];
        float w[3] = {eye[0] - p[0], eye[1] - p[1], eye[2] - p[2]}, y[4];
        float length = sqrtf(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), cosine = 0;
        for (int i = 0; i < 3; i++) cosine += (w[i] /= length) * n[i];
        bool opaque = v >= N - N / 4;
        // w bent to the normal: same azimuth, sine / eta
        float inside[3], tangent[3], sine = sqrtf(fmaxf(0, 1 - cosine * cosine)) / 1.3f;
        for (int i = 0; i < 3; i++) tangent[i] = w[i] - cosine * n[i];
        float l =
            sqrtf(tangent[0] * tangent[0] + tangent[1] * tangent[1] + tangent[2] * tangent[2]);
        for (int i = 0; i < 3; i++)
            inside[i] = sqrtf(1 - sine * sine) * n[i] + (l > 0 ? tangent[i] / l * sine : 0);
        prt_sh_eval(2, inside, y);
        double ft = cosine > 0 ? prt_fresnel_transmittance((double)1.3f, (double)cosine) : 0;
        ft /= divisor;
        for (int ch = 0; ch < 3; ch++) {
            int at = 3 * v + ch;
            double sum = (double)own[at], want;
            for (int k = 1; k < (opaque ? 1 : 4); k++)
                sum += (double)y[k] * (double)own[k * 3 * N + at];
            want = fmax(0, sum * (opaque ? 1 : ft));
            if (cosine <= 0 && !opaque) assert_true(total[at] == 0); // it faces away
            else assert_true(fabs((double)total[at] - want) < 2e-4 * (1 + fabs(sum)));
        }
    }

    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, NULL), 0);
    assert_int_equal(n_plane, 4);
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, planes), 0);
    for (int i = 0; i < 3 * N; i++) {
        assert_true(fabsf(planes[i] - own[i]) < 1e-3f);
        for (int k = 1; k < 4; k++)
            assert_true(fabsf(planes[k * 3 * N + i] - own[k * 3 * N + i]) < 1e-3f);
    }

    // what does not fit together is refused
    q.media = t.media;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), PRT_MISMATCH);
    q.media.n = 0;
    cube.n = 8;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), PRT_MISMATCH);
    cube.n = 16;
    q.light = NULL;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), PRT_ARG);
    eye[1] = NAN;
    q.light = &cube;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])total), PRT_ARG);

    prt_light_finish(&light);
    prt_cube_finish(&cube);
    finish_transport(&t);
    free(multiple);
    free(single);
    free(total);
    free(own);
    free(planes);
}

static void answers_follow_the_command_contract(void **state)
{
    check_answers(false);
    check_answers(true);
}

static void give_basis(struct prt_tensor *t, const struct prt_radial *radial)
{
    size_t n = (size_t)radial->n_grid * radial->n_function;
    float *knot = prt_alloc(radial->n_grid, 4), *basis = prt_alloc(n, 4);
    memcpy(knot, radial->r, 4ull * radial->n_grid);
    memcpy(basis, radial->value, 4 * n);
    t->n_knot = radial->n_grid;
    t->basis_kind = (uint32_t)radial->kind;
    t->knot = knot;
    t->basis = basis;
}

// Joint and polynomial transport: coefficients from the radial basis in the file, sigma_s and
// the phase function's a_l at run time.
static void free_materials_follow_the_basis(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    struct prt_radial *radial[2];
    struct prt_material m = {.name = "y",
                             .sigma_s_prime = {0.8f, 1, 3},
                             .sigma_a = {0.02f, 0.05f, 0.1f},
                             .g = {0.3f, 0, -0.2f},
                             .eta = 1.3f,
                             .roughness = 0.3f};
    for (int f = 0; f < 2; f++) {
        struct prt_radial_options o = {.kind = PRT_RADIAL_REDUCED,
                                       .family = (enum prt_radial_family)f,
                                       .eta = 1.3,
                                       .n_function = f ? 11 : 12};
        assert_int_equal(prt_radial_create(&ctx, &o, &radial[f]), 0);
    }
    transport_of(&t, &kind[4], &kind[5]);
    t.engine = PRT_TRANSPORT_JOINT;
    give_basis(&t.tensor[0], radial[0]);
    give_basis(&t.tensor[1], radial[1]);
    some_cube(&cube);
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    assert_int_equal(prt_light_from_cube(&cube, &light), 0);
    float coef[2][36], *multiple = malloc(12 * N), *own = malloc(4 * 12 * N);
    float *planes = malloc(4 * 12 * N), *again = malloc(4 * 12 * N);
    float *bound = malloc(12 * N), *own_bound = malloc(4 * 12 * N);
    double error;
    for (int f = 0; f < 2; f++)
        assert_int_equal(prt_radial_fit_material(radial[f], &m, coef[f], &error), 0);
    define(&t.tensor[0], &light, coef[0], 1, multiple, bound);
    define(&t.tensor[1], &light, coef[1], 1, own, own_bound);
    assert_int_equal(prt_relight(&ctx, &t.tensor[0], 1, lights, coef[0], false, multiple), 0);
    assert_int_equal(prt_relight(&ctx, &t.tensor[1], 1, lights, coef[1], false, own), 0);
    struct prt_query q = {.term = PRT_ANSWER_TOTAL, .light = &cube, .media = prt_media_one(&m)};
    unsigned n_plane;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, planes), 0);
    assert_int_equal(n_plane, 4);
    float *wanted = malloc(4 * 12 * N);
    for (int i = 0; i < 3 * N; i++)
        for (int k = 0; k < 4; k++) {
            // outward convention: a_0 = 1, a_1 = -g
            int ch = i % 3;
            double a = i >= 3 * (N - N / 4) ? 0 : k ? -(double)m.g[ch] : 1;
            double sigma_s = (double)m.sigma_s_prime[ch] / (1 - (double)m.g[ch]);
            wanted[k * 3 * N + i] = (float)(a * sigma_s * (double)own[k * 3 * N + i]);
            own_bound[k * 3 * N + i] *= (float)(fabs(a) * sigma_s);
        }
    toward_a_view(&t, multiple, 0.938868, wanted);
    for (int i = 0; i < 3 * N; i++)
        for (int k = 0; k < 4; k++) {
            // the correction mixes the four planes; its factors are below 3 with Y_1's constant
            double most = k ? 0 : (double)bound[i];
            for (int l = 0; l < 4; l++) most += 3 * (double)own_bound[l * 3 * N + i];
            const double want = (double)wanted[k * 3 * N + i];
            const double off = fabs(want - (double)planes[k * 3 * N + i]);
            if (!(off <= 2 * most))
                fail_msg("plane %d, value %d: %g, expected %g, %g allowed", k, i,
                         (double)planes[k * 3 * N + i], want, 2 * most);
        }
    free(wanted);
    free(bound);
    free(own_bound);
    // the bake's own material when none is given; the same answer the second time
    q.media.n = 0;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, again), 0);
    assert_true(difference(again, planes, 12 * N) > 1e-3);
    q.media = prt_media_one(&m);
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, again), 0);
    assert_memory_equal(again, planes, 4 * 12 * N);
    // light contracted once, whichever material comes: the same bits
    struct prt_contracted_light *lit, *other;
    struct prt_transport elsewhere = t;
    assert_int_equal(prt_contracted_light_create(&ctx, &t, &cube, &lit), 0);
    assert_int_equal(prt_contracted_light_create(&ctx, &elsewhere, &cube, &other), 0);
    assert_true(prt_contracted_light_bytes(lit) > 0);
    q.light = NULL;
    q.lit = lit;
    memset(again, 0xff, 4 * 12 * N);
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, again), 0);
    assert_memory_equal(again, planes, 4 * 12 * N);
    const struct prt_query both[2] = {
        q, {.term = PRT_ANSWER_TOTAL, .light = &cube, .media = prt_media_one(&m)}};
    const bool as_planes[2] = {true, true};
    float *pair[2] = {again, own};
    assert_int_equal(prt_answer_many(&ctx, &t, 2, both, as_planes, pair, NULL), 0);
    assert_memory_equal(again, planes, 4 * 12 * N);
    assert_memory_equal(own, planes, 4 * 12 * N);
    // the material first, whichever light comes
    struct prt_contracted_transport *fixed;
    const struct prt_query wavelet = {
        .term = PRT_ANSWER_TOTAL, .light = &cube, .media = prt_media_one(&m)};
    assert_int_equal(prt_contracted_transport_create(&ctx, &t, &wavelet.media, &fixed), 0);
    assert_true(prt_contracted_transport_bytes(fixed) > 0);
    const struct prt_query lit_only = {.term = PRT_ANSWER_TOTAL, .light = &cube};
    assert_int_equal(prt_answer_planes(&ctx, prt_contracted_transport_get(fixed), &lit_only,
                                       &n_plane, again),
                     0);
    assert_int_equal(n_plane, 4);
    double off = difference(again, planes, 4 * 3 * N);
    assert_true(off > 0 && off < 2 * PRT_FIXED_ERROR);
    assert_int_equal(
        prt_answer_planes(&ctx, prt_contracted_transport_get(fixed), &wavelet, &n_plane, again),
        PRT_MISMATCH);
    struct prt_contracted_transport *twice;
    assert_int_equal(prt_contracted_transport_create(&ctx, prt_contracted_transport_get(fixed),
                                                     &wavelet.media, &twice),
                     PRT_MISMATCH);
    prt_contracted_transport_destroy(fixed);
    q.lit = other;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, again), PRT_ARG);
    q.lit = NULL;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, again), PRT_ARG);
    q.light = &cube;
    prt_contracted_light_destroy(lit);
    prt_contracted_light_destroy(other);
    m.eta = 1.5f;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, again), PRT_MISMATCH);
    prt_light_finish(&light);
    prt_cube_finish(&cube);
    finish_transport(&t);
    prt_radial_destroy(radial[0]);
    prt_radial_destroy(radial[1]);
    free(multiple);
    free(own);
    free(planes);
    free(again);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(colours_are_what_is_defined),
        cmocka_unit_test(lights_superpose),
        cmocka_unit_test(many_lights_are_single_ones),
        cmocka_unit_test(threads_change_no_bit),
        cmocka_unit_test(material_and_light_commute),
        cmocka_unit_test(dropped_entries_hold_little),
        cmocka_unit_test(wrong_calls_are_refused),
        cmocka_unit_test(many_queries_equal_one_by_one),
        cmocka_unit_test(fewer_rows_are_a_smaller_transport),
        cmocka_unit_test(wrong_queries_are_refused),
        cmocka_unit_test(answers_follow_the_command_contract),
        cmocka_unit_test(planes_of_exit_are_added),
        cmocka_unit_test(half_space_seen_from_the_side),
        cmocka_unit_test(free_materials_follow_the_basis),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
