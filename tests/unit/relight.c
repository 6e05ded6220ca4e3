// SPDX-License-Identifier: MIT
// Contractions of whole tensors against their definition and their laws: linearity, order of
// contraction, independence of threads and of other lights.
#include "defined_tensors.h"

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
        for (int c = 0; c < 3; c++) {
            ctx.cpu = prt_cpu_detect() & cpus[c];
            define(&t, &light, coef, ctx.cpu, expect, bound);
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

// The bits of a light's colours do not depend on the lights beside it where kernels compute in
// integers, since a sum of integers is the same in any order.
static void no_light_changes_another(void **state)
{
    struct prt_context ctx = quiet();
    if (!prt_relight_in_integers(prt_cpu_detect())) skip();
    for (int i = 0; i < N_KIND - 1; i++) {
        struct synthetic_options o = kind[i];
        struct prt_tensor t;
        struct prt_light light[9];
        const struct prt_light *lights[9];
        if (o.value != PRT_VALUE_PAIR && o.coupling != PRT_COUPLE_FULL) continue;
        assert_int_equal(synthetic_tensor(&o, &t), 0);
        const float *coef = needs_coef(&t) ? some_coef() : NULL;
        for (unsigned l = 0; l < 9; l++) {
            assert_int_equal(synthetic_light(o.cube, l + 1, &light[l]), 0);
            lights[l] = &light[l];
        }
        const size_t n = 3ull * N * t.n_phase;
        float *alone = malloc(4 * n), *all = malloc(9 * 4 * n);
        for (unsigned many = 2; many <= 9; many++) {
            assert_int_equal(prt_relight(&ctx, &t, many, lights, coef, false, all), 0);
            for (unsigned l = 0; l < many; l++) {
                assert_int_equal(prt_relight(&ctx, &t, 1, &lights[l], coef, false, alone), 0);
                assert_memory_equal(alone, all + l * n, 4 * n);
            }
        }
        free(alone);
        free(all);
        for (unsigned l = 0; l < 9; l++) prt_light_finish(&light[l]);
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
            define(&t, &light[l], coef, ~0u, color[l], bound[l]);
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
            define(&t, &light[l], coef, ~0u, expect[l], bound[l]);
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

// The energies of the entries of one tensor's rows: of each, and of all with the scaling ones.
static double worths(const struct prt_tensor *t, const struct prt_rows *rows, double *worth)
{
    double all = energy_of(t, rows);
    for (uint32_t c = 0; c < t->n_cluster; c++) {
        const struct prt_cluster *k = &t->cluster[c];
        const size_t padded = (k->n_vertex + 15ull) / 16 * 16;
        const int16_t *u = (const int16_t *)t->u + k->u_begin;
        for (uint32_t r = 0; r < k->rank; r++) {
            const uint64_t row = k->row_begin + r, J = rows->n_function;
            double column = 0;
            for (size_t v = 0; v < k->n_vertex; v++)
                column += pow(u[2 * (padded * (r / 2) + v) + r % 2], 2);
            for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++) {
                worth[e] = 0;
                for (uint64_t j = 0; j < J; j++)
                    worth[e] +=
                        column *
                        pow((double)prt_f16_to_f32(((const uint16_t *)rows->entry)[e * J + j]),
                            2);
            }
        }
    }
    return all;
}

// Folding drops entries by their energy: those that go are worth less than those that stay,
// hold error^2 of all energy at most, and the next quarter octave of entries would hold more.
// Rows of few entries: the first and the last of a row count as the others do.
static void the_least_entries_go(void **state)
{
    struct prt_context ctx = quiet();
    for (int k = 0; k < 3; k++) {
        struct synthetic_options o = kind[4];
        o.coefs = (uint32_t[]){1, 2, 4}[k];
        const double error = (double[]){0.3, 0.1, 0.02}[k];
        struct prt_tensor t;
        struct prt_rows whole, some;
        assert_int_equal(synthetic_tensor(&o, &t), 0);
        assert_int_equal(prt_rows_fold_planes(&ctx, &t, some_coef(), NULL, NULL, 0, &whole), 0);
        assert_int_equal(prt_rows_fold_planes(&ctx, &t, some_coef(), NULL, NULL, error, &some),
                         0);
        const uint64_t n = whole.begin[whole.n_row], J = whole.n_function;
        double *worth = malloc(sizeof *worth * (n + 1)), gone = 0, next = 0;
        double all = worths(&t, &whole, worth), least = INFINITY, most = 0;
        bool *kept = calloc(n + 1, sizeof *kept);
        for (uint32_t row = 0; row < whole.n_row; row++) { // both ascend in every row
            uint64_t e = whole.begin[row];
            for (uint64_t s = some.begin[row]; s < some.begin[row + 1]; s++, e++) {
                while (e < whole.begin[row + 1] &&
                       memcmp((const uint16_t *)whole.entry + e * J,
                              (const uint16_t *)some.entry + s * J, 2 * J))
                    e++;
                assert_true(e < whole.begin[row + 1]);
                kept[e] = true;
            }
        }
        for (uint64_t e = 0; e < n; e++) {
            if (kept[e]) least = fmin(least, worth[e]);
            else most = fmax(most, worth[e]), gone += worth[e];
        }
        for (uint64_t e = 0; e < n; e++)
            next += kept[e] && worth[e] < 1.25 * least ? worth[e] : 0;
        print_message(
            "%llu of %llu entries dropped: %.5f of the energy, allowed %.5f, with the "
            "next %.5f\n",
            (unsigned long long)(n - some.begin[some.n_row]), (unsigned long long)n, gone / all,
            error * error, (gone + next) / all);
        assert_true(n > some.begin[some.n_row] && some.begin[some.n_row] > 0);
        assert_true(most <= least * 1.0001);
        assert_true(gone <= error * error * all * 1.0001);
        assert_true(gone + next >= error * error * all);
        free(worth);
        free(kept);
        prt_rows_finish(&whole);
        prt_rows_finish(&some);
        synthetic_tensor_finish(&t);
    }
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
        assert_int_equal(prt_rows_fold_planes(&ctx, &t, coef, NULL, NULL, 0, &whole), 0);
        assert_int_equal(prt_rows_fold_planes(&ctx, &t, coef, NULL, NULL, error, &some), 0);
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

// All tensors of a sum are of one model, and each has the input that its storage needs.
static void wrong_sums_are_refused(void **state)
{
    struct prt_context ctx = quiet();
    struct synthetic_options larger = kind[0];
    struct prt_tensor t, u, sparse;
    larger.n_vertex = 2 * N;
    assert_int_equal(synthetic_tensor(&kind[0], &t), 0);
    assert_int_equal(synthetic_tensor(&larger, &u), 0);
    assert_int_equal(synthetic_tensor(&kind[2], &sparse), 0);
    float *lit = calloc(4096, 4 * sizeof *lit), *color = calloc(2 * N, 3 * sizeof *color);
    struct prt_term_input part[2] = {{.tensor = &t, .lit = lit}, {.tensor = &t, .lit = lit}};
    assert_int_equal(prt_sum_parts(&ctx, 2, part, 1, color), PRT_OK);
    part[1].tensor = &u;
    assert_int_equal(prt_sum_parts(&ctx, 2, part, 1, color), PRT_ARG);
    part[1].tensor = &sparse;
    assert_int_equal(prt_sum_parts(&ctx, 2, part, 1, color), PRT_ARG);
    part[1] = (struct prt_term_input){.tensor = &t};
    assert_int_equal(prt_sum_parts(&ctx, 2, part, 1, color), PRT_ARG);
    assert_int_equal(prt_sum_parts(&ctx, 0, part, 1, color), PRT_ARG);
    assert_int_equal(prt_sum_parts(&ctx, 1, part, 0, color), PRT_ARG);
    assert_int_equal(prt_sum_parts(&ctx, 1, part, 17, color), PRT_ARG);
    synthetic_tensor_finish(&sparse);
    synthetic_tensor_finish(&u);
    synthetic_tensor_finish(&t);
    free(color);
    free(lit);
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
    // each light is of the transport's size, not the first alone
    struct prt_light right;
    assert_int_equal(synthetic_light(kind[0].cube, 3, &right), 0);
    float *both = malloc(2 * 12 * N * 4);
    for (int wrong = 0; wrong < 3; wrong++) {
        for (int i = 0; i < 3; i++) lights[i] = i == wrong ? &light : &right;
        assert_int_equal(prt_relight(&ctx, &t, 2, lights, NULL, false, both),
                         wrong < 2 ? PRT_MISMATCH : PRT_OK);
        assert_int_equal(prt_relight(&ctx, &t, 3, lights, NULL, false, both), PRT_MISMATCH);
    }
    free(both);
    prt_light_finish(&right);
    prt_light_finish(&light);
    synthetic_tensor_finish(&t);
    free(color);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(colours_are_what_is_defined),
        cmocka_unit_test(no_light_changes_another),
        cmocka_unit_test(lights_superpose),
        cmocka_unit_test(many_lights_are_single_ones),
        cmocka_unit_test(threads_change_no_bit),
        cmocka_unit_test(material_and_light_commute),
        cmocka_unit_test(dropped_entries_hold_little),
        cmocka_unit_test(the_least_entries_go),
        cmocka_unit_test(wrong_calls_are_refused),
        cmocka_unit_test(wrong_sums_are_refused),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
