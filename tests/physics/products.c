// SPDX-License-Identifier: MIT
// Products of a cluster's rows with lights from the right and with combinations of vertices
// from the left.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>

#include "bake/run.h"
#include "bake/sources.h"
#include "expect.h"

enum { ROWS = 9, TEXELS = 6 * 2 * 2, COLUMNS = 5, VERTICES = 7, FUNCTIONS = 3 };
enum { LIGHTS = 4, COMBINED = 2 };

static struct prt_rng rng;

static void fill(float *out, size_t n)
{
    for (size_t i = 0; i < n; i++) out[i] = 2 * prt_rng_f32(&rng) - 1;
}

// Law: T_f = M_f K_f E is one matrix of each function (METHODS §9): (u T_f) x = u (T_f x), with
// the smoothing of walks and without.
static void sides_agree(void **state)
{
    static float e[ROWS * TEXELS], k[FUNCTIONS * COLUMNS * VERTICES],
        smooth[FUNCTIONS * VERTICES * VERTICES], x[TEXELS * LIGHTS], u[COMBINED * VERTICES];
    static float lit[FUNCTIONS][VERTICES][LIGHTS], projected[COMBINED][FUNCTIONS][TEXELS];
    static float combined[FUNCTIONS][TEXELS], weight[FUNCTIONS][FUNCTIONS];
    static uint16_t half[ROWS * TEXELS];
    uint32_t column[COLUMNS] = {8, 0, 3, 4, 6}, of_one[FUNCTIONS] = {1, 1, 1};
    const struct half_rows rows = {
        .n_row = ROWS, .n_coef = TEXELS, .n_texel = TEXELS, .n_layer = 1, .half = half};
    const struct cut cut = {.n_column = COLUMNS, .row = column, .k = k};
    fill(e, ROWS * TEXELS);
    fill(k, FUNCTIONS * COLUMNS * VERTICES);
    fill(smooth, FUNCTIONS * VERTICES * VERTICES);
    fill(x, TEXELS * LIGHTS);
    fill(u, COMBINED * VERTICES);
    prt_f32_to_f16_array(e, ROWS * TEXELS, half);
    for (int f = 0; f < FUNCTIONS; f++) weight[f][f] = 1; // combination f: function f alone
    for (int smoothed = 0; smoothed < 2; smoothed++) {
        struct product_rows p = {.rows = &rows,
                                 .cut = &cut,
                                 .n_vertex = VERTICES,
                                 .n_function = FUNCTIONS,
                                 .smooth = smoothed ? smooth : NULL};
        assert_int_equal(prt_product_multiply(&p, x, LIGHTS, lit[0][0]), PRT_OK);
        assert_int_equal(prt_product_project(&p, u, COMBINED, projected[0][0]), PRT_OK);
        assert_int_equal(
            prt_product_combine(&p, u, COMBINED, FUNCTIONS, weight[0], of_one, combined[0]),
            PRT_OK);
        for (int i = 0; i < COMBINED; i++)
            for (int f = 0; f < FUNCTIONS; f++) {
                for (int j = 0; j < LIGHTS; j++) {
                    double left = 0, right = 0;
                    for (int v = 0; v < VERTICES; v++)
                        right += (double)u[i * VERTICES + v] * (double)lit[f][v][j];
                    for (int t = 0; t < TEXELS; t++)
                        left += (double)projected[i][f][t] * (double)x[t * LIGHTS + j];
                    expect_near("(u T_f) x - u (T_f x)", left, right, 4e-6);
                }
                for (int t = 0; t < TEXELS && i == 1; t++)
                    expect_near("a combination of one function", (double)combined[f][t],
                                (double)projected[i][f][t], 1e-6);
            }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(sides_agree)};
    prt_rng_init(&rng, 5, 0);
    return run_physics_tests(tests, NULL, NULL);
}
