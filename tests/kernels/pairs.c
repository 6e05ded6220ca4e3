// SPDX-License-Identifier: MIT
// Sums over pairs of the image-space engines: every instruction set against the table's own
// evaluation in double, and the table against the function it was fitted to (METHODS §6).
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "guard.h"
#include "screen/internal.h"

enum { MOST_EMITTERS = 70, MOST_POINTS = 96 };

// Three functions that fall at different rates, smooth in r² as R_d is.
static void functions(const void *arg, double r, double out[3])
{
    for (int c = 0; c < 3; c++) {
        double d2 = r * r + 0.64 * (c + 1);
        out[c] = exp(-sqrt(d2) / (c + 1)) / d2;
    }
}

// Columns that end at a guard page.
struct columns {
    struct guard guard[12];
    float *p[3], *sum[3];
    struct emitters e;
};

static float *column(struct guard *g, uint32_t n)
{
    float *at = guard_alloc(g, n * sizeof *at);
    assert_non_null(at);
    return at;
}

static void columns_init(struct columns *x, uint32_t n_emitter, uint32_t n_point, float wide,
                         struct prt_rng *rng)
{
    memset(x, 0, sizeof *x);
    x->e.n = x->e.capacity = n_emitter;
    for (int c = 0; c < 3; c++) {
        x->p[c] = column(&x->guard[c], n_point);
        x->sum[c] = column(&x->guard[3 + c], n_point);
        x->e.p[c] = column(&x->guard[6 + c], n_emitter);
        x->e.w[c] = column(&x->guard[9 + c], n_emitter);
        for (uint32_t i = 0; i < n_point; i++) x->p[c][i] = wide * prt_rng_f32(rng);
        for (uint32_t i = 0; i < n_point; i++) x->sum[c][i] = prt_rng_f32(rng);
        for (uint32_t j = 0; j < n_emitter; j++) x->e.p[c][j] = wide * prt_rng_f32(rng);
        for (uint32_t j = 0; j < n_emitter; j++) x->e.w[c][j] = prt_rng_f32(rng) - 0.3f;
    }
    for (int c = 0; c < 3 && n_emitter; c++) x->p[c][0] = x->e.p[c][0]; // a distance of 0
}

static void columns_finish(struct columns *x)
{
    for (int i = 0; i < 12; i++) guard_free(&x->guard[i]);
}

// One call, each sum within 2e-6 of its own terms' absolute values.
static void call_agrees(unsigned cpu, const struct radial_table *t, uint32_t n_emitter,
                        uint32_t n_point, float wide, struct prt_rng *rng)
{
    struct columns x;
    float before[3][MOST_POINTS];
    columns_init(&x, n_emitter, n_point, wide, rng);
    for (int c = 0; c < 3; c++) memcpy(before[c], x.sum[c], n_point * sizeof(float));
    uint32_t begin = n_emitter ? prt_rng_u32(rng) % n_emitter : 0;
    uint32_t end = begin + (n_emitter ? prt_rng_u32(rng) % (n_emitter - begin + 1) : 0);
    prt_pair_kernel(cpu)(t, &x.e, begin, end, n_point, (const float *const *)x.p, x.sum);
    for (uint32_t i = 0; i < n_point; i++) {
        double want[3], terms[3];
        for (int c = 0; c < 3; c++) want[c] = terms[c] = (double)before[c][i];
        for (uint32_t j = begin; j < end; j++) {
            float r2 = 0, value[3];
            for (int k = 0; k < 3; k++)
                r2 += (x.p[k][i] - x.e.p[k][j]) * (x.p[k][i] - x.e.p[k][j]);
            prt_radial_table_eval(t, r2, value);
            for (int c = 0; c < 3; c++) {
                double term = (double)x.e.w[c][j] * (double)value[c];
                want[c] += term, terms[c] += fabs(term);
            }
        }
        for (int c = 0; c < 3; c++)
            if (!(fabs((double)x.sum[c][i] - want[c]) <= 2e-6 * terms[c]))
                fail_msg("%s, %u emitters, point %u, channel %d: %g, not %g", prt_cpu_word(cpu),
                         end - begin, i, c, (double)x.sum[c][i], want[c]);
    }
    columns_finish(&x);
}

// Every instruction set, on random sizes, near and far beyond the table's end.
static void kernels_sum_the_table(void **state)
{
    static const unsigned mask[] = {0, PRT_CPU_AVX2, PRT_CPU_AVX2 | PRT_CPU_AVX512};
    struct radial_table t;
    struct prt_rng rng;
    prt_radial_table_fit(&t, functions, NULL, 0.8, 20);
    prt_rng_init(&rng, 5, 0);
    for (int cpu = 0; cpu < 3; cpu++) {
        if ((prt_cpu_detect() & mask[cpu]) != mask[cpu]) continue;
        for (int i = 0; i < 300; i++)
            call_agrees(mask[cpu], &t, prt_rng_u32(&rng) % MOST_EMITTERS,
                        16 * (1 + prt_rng_u32(&rng) % (MOST_POINTS / 16)), i % 3 ? 8 : 400,
                        &rng);
    }
}

// The table holds its function up to r_max, and stays at its last value beyond.
static void tables_hold_the_function(void **state)
{
    static const double reach[] = {3, 20, 60};
    for (int k = 0; k < 3; k++) {
        struct radial_table t;
        float end[3], got[3];
        double worst = 0, at0[3];
        prt_radial_table_fit(&t, functions, NULL, 0.8, reach[k]);
        functions(NULL, 0, at0);
        for (double r = 0; r < reach[k]; r += reach[k] / 3000) {
            double want[3];
            functions(NULL, r, want);
            prt_radial_table_eval(&t, (float)(r * r), got);
            for (int c = 0; c < 3; c++)
                worst = fmax(worst, fabs((double)got[c] - want[c]) / at0[c]);
        }
        print_message("to %g mm: %.2g of the value at 0\n", reach[k], worst);
        assert_true(worst < (reach[k] < 10 ? 0.0009 : 0.0055)); // three times what is seen
        prt_radial_table_eval(&t, t.q_max, end);
        prt_radial_table_eval(&t, 100 * t.q_max, got);
        for (int c = 0; c < 3; c++) assert_true(got[c] == end[c]);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(kernels_sum_the_table),
        cmocka_unit_test(tables_hold_the_function),
    };
    return cmocka_run_group_tests_name("pairs", tests, NULL, NULL);
}
