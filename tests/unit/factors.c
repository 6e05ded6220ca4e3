// SPDX-License-Identifier: MIT
// Factors and coefficients of bakes, as the client takes them from a daemon's answers.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>

#include "internal.h"
#include "prt/transport.h"

// Contract of relight_factors_with_exits and relight_colors: a bake of the most tensors that a
// .prt can hold is taken, with its planes of exit; one of more is refused.
static void most_tensors(void **state)
{
    for (unsigned n = PRT_MOST_TENSORS; n <= PRT_MOST_TENSORS + 1; n++) {
        Relight__FactorTensor tensor[PRT_MOST_TENSORS + 1], *tensors[PRT_MOST_TENSORS + 1];
        Relight__CoefficientLayer layer[PRT_MOST_TENSORS + 1], *layers[PRT_MOST_TENSORS + 1];
        Relight__FactorsAnswer factors = RELIGHT__FACTORS_ANSWER__INIT;
        Relight__Coefficients coefficients = RELIGHT__COEFFICIENTS__INIT;
        Relight__ColorsAnswer colors = RELIGHT__COLORS_ANSWER__INIT;
        Relight__Outgoing outgoing = RELIGHT__OUTGOING__INIT, *outgoings[] = {&outgoing};
        float scale = 1;
        for (unsigned i = 0; i < n; i++) {
            relight__factor_tensor__init(tensors[i] = &tensor[i]);
            relight__coefficient_layer__init(layers[i] = &layer[i]);
            layer[i].tensor = i;
            layer[i].n_phase = 1;
            layer[i].n_scales = 1;
            layer[i].scales = &scale;
        }
        factors.n_tensors = n, factors.tensors = tensors;
        coefficients.n_layers = n, coefficients.layers = layers;
        coefficients.n_outgoing = 1, coefficients.outgoing = outgoings;
        colors.n_plane = 1;
        colors.coefficients = &coefficients;
        const struct answer answer = {.payload = NULL}; // tensors without clusters or vertices
        struct relight_factors f;
        struct relight_colors c = {.n_plane = 1};
        const bool fits = n <= PRT_MOST_TENSORS;
        assert_int_equal(!relight_get_factors(&factors, &answer, 0, &f, NULL), fits);
        assert_int_equal(f.n_tensor, fits ? n : 0);
        assert_int_equal(relight_get_coefficients(&colors, &c), fits);
    }
}

// Contract of relight_colors: coefficients whose scale is no finite number are refused, of any
// plane.
static void scales_are_finite(void **state)
{
    static const float scales[][2] = {{1, 2}, {1, NAN}, {INFINITY, 2}, {1, -INFINITY}};
    for (unsigned i = 0; i < sizeof scales / sizeof *scales; i++) {
        Relight__CoefficientLayer layer = RELIGHT__COEFFICIENT_LAYER__INIT,
                                  *layers[] = {&layer};
        Relight__Coefficients coefficients = RELIGHT__COEFFICIENTS__INIT;
        Relight__ColorsAnswer colors = RELIGHT__COLORS_ANSWER__INIT;
        Relight__Outgoing outgoing = RELIGHT__OUTGOING__INIT, *outgoings[] = {&outgoing};
        struct relight_colors c = {.n_plane = 2};
        float scale[2] = {scales[i][0], scales[i][1]};
        layer.n_phase = 1;
        layer.n_scales = 2, layer.scales = scale;
        coefficients.n_layers = 1, coefficients.layers = layers;
        coefficients.n_outgoing = 1, coefficients.outgoing = outgoings;
        colors.n_plane = 2;
        colors.coefficients = &coefficients;
        assert_int_equal(relight_get_coefficients(&colors, &c), i == 0);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(most_tensors),
                                       cmocka_unit_test(scales_are_finite)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
