// SPDX-License-Identifier: MIT
// Nodes of the refractive index: which a file may name, and the weights between them.
#include "prt/eta_nodes.h"

#include "prt/base.h"
#include "prt/medium.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

// low, high and ascending nodes, all in [1, 3], at least 0.01 apart.
static void axes_that_are_nodes(void **state)
{
    static const struct {
        uint32_t n;
        float axis[7];
        bool good;
    } row[] = {
        {3, {1.2f, 1.6f, 1.4f}, true},
        {6, {1.2f, 1.6f, 1.1f, 1.3f, 1.5f, 1.7f}, true},
        {4, {1, 3, 1, 3}, true},
        {3, {1.3f, 1.3f, 1.3f}, true},
        {4, {1.2f, 1.6f, 1.3f, 1.3125f}, true},
        {2, {1.2f, 1.6f}, false},
        {0, {0}, false},
        {7, {1.2f, 1.6f, 1.1f, 1.2f, 1.3f, 1.5f, 1.7f}, false},
        {3, {1.6f, 1.2f, 1.4f}, false},
        {3, {0.99f, 1.6f, 1.4f}, false},
        {3, {1.2f, 3.01f, 1.4f}, false},
        {3, {1.2f, 1.6f, 0.9f}, false},
        {3, {1.2f, 1.6f, NAN}, false},
        {3, {NAN, 1.6f, 1.4f}, false},
        {3, {1.2f, INFINITY, 1.4f}, false},
        {4, {1.2f, 1.6f, 1.5f, 1.3f}, false},
        {4, {1.2f, 1.6f, 1.3f, 1.3f}, false},
        {4, {1.2f, 1.6f, 1.3f, 1.305f}, false},
        {5, {1.2f, 1.6f, 1.3f, 1.5f, 1.4f}, false},
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++) {
        struct prt_eta_nodes nodes = {0};
        const int status = prt_eta_nodes_from_axis(row[i].n, row[i].axis, &nodes);
        assert_int_equal(status, row[i].good ? PRT_OK : PRT_FORMAT);
        if (!row[i].good) continue;
        assert_int_equal(nodes.n, row[i].n - 2);
        assert_true(nodes.low == row[i].axis[0] && nodes.high == row[i].axis[1]);
        assert_memory_equal(nodes.node, row[i].axis + 2, nodes.n * sizeof *nodes.node);
    }
}

// The share of the light of all directions that the weights misplace below a flat exit: F_t
// alone, or after a path of `depth` mean free paths along the refracted direction.
static double misplaced(const struct prt_eta_nodes *nodes, const double *weight, double eta,
                        double depth)
{
    enum { STEPS = 4000 };
    double wrong = 0, all = 0;
    for (int i = 0; i < STEPS; i++) {
        const double mu = (i + 0.5) / STEPS;
        double got = 0, want = 0;
        for (uint32_t p = 0; p <= nodes->n; p++) {
            const double n = p < nodes->n ? (double)nodes->node[p] : eta;
            const double t = prt_fresnel_transmittance(n, mu) *
                             exp(-depth / sqrt(1 - (1 - mu * mu) / (n * n)));
            if (p < nodes->n) got += weight[p] * t;
            else want = t;
        }
        wrong += fabs(got - want) * mu;
        all += want * mu;
    }
    return wrong / all;
}

static void errors_are_those_of_the_weights(void **state)
{
    for (int family = 0; family < 2; family++) {
        struct prt_eta_nodes nodes;
        const bool dipole = !family;
        prt_eta_nodes_default(dipole ? PRT_FAMILY_DIPOLE : PRT_FAMILY_EXTINCTION, &nodes);
        for (double eta = 1.2; eta < 1.61; eta += 0.05) {
            double weight[PRT_ETA_MOST_NODES], error, worst = 0, mean = 0;
            assert_int_equal(prt_eta_weights(dipole ? PRT_FAMILY_DIPOLE : PRT_FAMILY_EXTINCTION,
                                             &nodes, eta, weight, &error),
                             PRT_OK);
            // depths that a path has, as far as single scattering counts
            for (double depth = 0;
                 depth<(dipole ? 0.01 : 5.6); depth = depth> 0 ? depth * 1.96 : 0.05)
                worst = fmax(worst, misplaced(&nodes, weight, eta, depth));
            assert_float_equal(error, worst, 0.03 * worst + 1e-5);
            for (uint32_t p = 0; p < nodes.n; p++)
                mean += weight[p] * prt_fresnel_mean_transmittance((double)nodes.node[p]);
            // light of an even sky is exact by the dipole
            if (dipole) assert_float_equal(mean, prt_fresnel_mean_transmittance(eta), 1e-4);
        }
    }
}

static void a_node_stands_for_itself(void **state)
{
    struct prt_eta_nodes nodes;
    prt_eta_nodes_default(PRT_FAMILY_EXTINCTION, &nodes);
    for (uint32_t at = 0; at < nodes.n; at++) {
        double weight[PRT_ETA_MOST_NODES], error;
        assert_int_equal(prt_eta_weights(PRT_FAMILY_EXTINCTION, &nodes, (double)nodes.node[at],
                                         weight, &error),
                         PRT_OK);
        for (uint32_t p = 0; p < nodes.n; p++) assert_float_equal(weight[p], p == at, 1e-6);
        assert_float_equal(error, 0, 1e-6);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(axes_that_are_nodes),
        cmocka_unit_test(errors_are_those_of_the_weights),
        cmocka_unit_test(a_node_stands_for_itself),
    };
    return cmocka_run_group_tests_name("eta_nodes", tests, NULL, NULL);
}
