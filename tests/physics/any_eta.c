// SPDX-License-Identifier: MIT
// Joint transport for any refractive index (METHODS §5): one bake, held against the reference
// at indices between its nodes, and the weights of the nodes alone.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bodies.h"
#include "expect.h"
#include "lamp_light.h"
#include "prt/bake.h"
#include "prt/eta_nodes.h"
#include "prt/media.h"
#include "prt/reference.h"
#include "prt/relight.h"

static struct prt_context context;
static char folder[] = "/tmp/prt-eta-test-XXXXXX", path[64], last_line[256];
static struct prt_mesh *mesh;
static struct prt_cube light;
static struct prt_file *any; // a bake of skin1, for any eta

static void keep_line(void *user, enum prt_log_level level, const char *line)
{
    if (level == PRT_LOG_ERROR) snprintf(last_line, sizeof last_line, "%s", line);
}

static struct prt_material medium_of(float eta)
{
    struct prt_material m;
    assert_int_equal(prt_material_load(&context, "skin1", &m), PRT_OK);
    m.eta = eta;
    return m;
}

static struct prt_bake_options settings(const struct prt_material *m)
{
    return (struct prt_bake_options){.engine = PRT_TRANSPORT_JOINT,
                                     .media = prt_media_one(m),
                                     .any_eta = true,
                                     .n_sample = 4000,
                                     .cube = 16,
                                     .n_phase = 1,
                                     .unmeasured = true,
                                     .seed = 1};
}

static int ask(const struct prt_material *m, enum prt_answer_term term, float (*out)[3])
{
    struct prt_query q = {.term = term, .media = prt_media_one(m), .light = &light};
    return prt_answer_colors(&context, prt_file_transport(any), &q, out);
}

static double difference(float (*a)[3], float (*b)[3])
{
    return prt_relative_rmse(a[0], b[0], 3 * (size_t)mesh->n_vertex);
}

static float (*reference_of(const struct prt_material *m, bool single))[3]
{
    const struct prt_media media = prt_media_one(m);
    struct prt_reference_options o = {.term = single ? PRT_REFERENCE_SINGLE
                                                     : PRT_REFERENCE_MULTIPLE,
                                      .n_sample = 20000,
                                      .n_ray = 1024,
                                      .n_single = 1024,
                                      .seed = 31};
    float(*want)[3] = calloc(mesh->n_vertex, sizeof *want);
    assert_int_equal(prt_reference_colors(&context, mesh, &media, &light, &o, want), PRT_OK);
    return want;
}

// Law: a bake for any index has the reference's colours at each (METHODS §8); media of other
// indices are farther from them than the bounds are.
static void every_index_agrees_with_the_reference(void **state)
{
    static const float eta[] = {1.2f, 1.3f, 1.45f, 1.6f};
    float(*got)[3] = calloc(mesh->n_vertex, sizeof *got);
    for (int i = 0; i < 4; i++) {
        const struct prt_material m = medium_of(eta[i]), other = medium_of(1.4f);
        for (int single = 0; single < 2; single++) {
            const enum prt_answer_term term = single ? PRT_ANSWER_SINGLE : PRT_ANSWER_MULTIPLE;
            const double most = single ? 0.06 : 0.01;
            float(*want)[3] = reference_of(&m, single);
            assert_int_equal(ask(&m, term, got), PRT_OK);
            print_message("eta %g, %s: %.2f %%\n", (double)eta[i],
                          single ? "single" : "multiple", 100 * difference(got, want));
            expect_below(single ? "single: relative RMSE" : "multiple: relative RMSE",
                         difference(got, want), most);
            assert_int_equal(ask(&other, term, got), PRT_OK);
            if (!single)
                expect_above("multiple: relative RMSE of eta 1.4", difference(got, want), most);
            free(want);
        }
    }
    free(got);
}

// An index outside is refused with the range; one that a bake for 1.3 alone would refuse is
// not.
static void an_index_outside_is_refused(void **state)
{
    static const float outside[] = {1.15f, 1.65f};
    float(*out)[3] = calloc(mesh->n_vertex, sizeof *out), range[2];
    assert_true(prt_transport_any_eta(prt_file_transport(any), range));
    assert_true(range[0] == 1.2f && range[1] == 1.6f);
    for (int i = 0; i < 2; i++) {
        const struct prt_material m = medium_of(outside[i]);
        assert_int_equal(ask(&m, PRT_ANSWER_TOTAL, out), PRT_MISMATCH);
        assert_non_null(strstr(last_line, "this bake covers 1.2 to 1.6"));
        struct prt_bake_options o = settings(&m);
        assert_int_equal(prt_bake(&context, mesh, &o, "/nonexistent/x.prt"), PRT_ARG);
        assert_non_null(strstr(last_line, "--any-eta covers 1.2 to 1.6"));
    }
    free(out);
}

// Settings that have one index are refused beside any.
static void settings_of_one_index_are_refused(void **state)
{
    const struct prt_material m = medium_of(1.3f);
    struct prt_bake_options o[3];
    for (int i = 0; i < 3; i++) o[i] = settings(&m);
    o[0].engine = PRT_TRANSPORT_WAVELET;
    o[1].scattering = PRT_SCATTERING_WALK;
    o[2].exit_planes = true;
    for (int i = 0; i < 3; i++) {
        assert_int_equal(prt_bake(&context, mesh, &o[i], "/nonexistent/x.prt"), PRT_ARG);
        assert_non_null(strstr(last_line, "--any-eta"));
    }
}

// Law: the error of an answer's medium contains what the nodes' weights misplace.
static void the_error_contains_the_weights(void **state)
{
    static const float eta[] = {1.23f, 1.35f}; // a node, and between two
    double error[2], weight[PRT_ETA_MOST_NODES], misplaced;
    struct prt_eta_nodes nodes;
    prt_eta_nodes_default(PRT_FAMILY_DIPOLE, &nodes);
    for (int i = 0; i < 2; i++) {
        const struct prt_material m = medium_of(eta[i]);
        const struct prt_media media = prt_media_one(&m);
        assert_int_equal(prt_answer_material_error(&context, prt_file_transport(any), &media,
                                                   PRT_ANSWER_MULTIPLE, &error[i]),
                         PRT_OK);
        assert_int_equal(
            prt_eta_weights(PRT_FAMILY_DIPOLE, &nodes, (double)eta[i], weight, &misplaced),
            PRT_OK);
        if (i) expect_above("the answer's error less the weights'", error[i], misplaced);
        else expect_below("what a node's own weights misplace", misplaced, 1e-9);
    }
}

// Law: at a node the weights are 1 and 0; between nodes they misplace little light, and those
// of multiple scattering keep the mean of F_t.
static void weights_rebuild_every_index(void **state)
{
    static const double most[] = {1e-3, 1e-3};
    double weight[PRT_ETA_MOST_NODES], error;
    for (int f = 0; f < 2; f++) {
        struct prt_eta_nodes nodes;
        prt_eta_nodes_default((enum prt_radial_family)f, &nodes);
        for (double eta = 1.2; eta < 1.601; eta += 0.0125) {
            double mean = 0;
            assert_int_equal(
                prt_eta_weights((enum prt_radial_family)f, &nodes, eta, weight, &error),
                PRT_OK);
            expect_below(f ? "single: misplaced" : "multiple: misplaced", error, most[f]);
            for (uint32_t b = 0; b < nodes.n; b++)
                mean += weight[b] * prt_fresnel_mean_transmittance((double)nodes.node[b]);
            if (!f)
                expect_close("mean of F_t", mean, prt_fresnel_mean_transmittance(eta), 1e-4);
        }
        for (uint32_t b = 0; b < nodes.n; b++) {
            assert_int_equal(prt_eta_weights((enum prt_radial_family)f, &nodes,
                                             (double)nodes.node[b], weight, NULL),
                             PRT_OK);
            for (uint32_t k = 0; k < nodes.n; k++)
                expect_near("weight of a node at a node", weight[k], k == b, 1e-6);
        }
    }
}

// Law: visibility does not depend on eta. On a body that shades itself, single scattering
// agrees with the reference as well at the last node of eta as at the first (METHODS §5).
static void shadows_fall_at_every_node(void **state)
{
    struct prt_mesh *const plain = mesh;
    struct prt_file *const plain_file = any;
    const struct prt_material skin = medium_of(1.3f);
    struct prt_bake_options o = settings(&skin);
    struct prt_eta_nodes nodes;
    struct model m;
    char fluted[80];
    model_init(&m, 2000, 4000);
    add_ball(&m, 36, 10, 10, fluted_ball);
    mesh = body_mesh(&context, &m, false);
    snprintf(fluted, sizeof fluted, "%s/fluted.prt", folder);
    assert_int_equal(prt_bake(&context, mesh, &o, fluted), PRT_OK);
    assert_int_equal(prt_file_open(&context, fluted, PRT_FILE_CHECK_ALL, &any), PRT_OK);
    prt_eta_nodes_default(PRT_FAMILY_EXTINCTION, &nodes);
    float(*got)[3] = calloc(mesh->n_vertex, sizeof *got);
    for (uint32_t i = 0; i < nodes.n; i++) {
        const struct prt_material own = medium_of(nodes.node[i]);
        float(*want)[3] = reference_of(&own, true);
        assert_int_equal(ask(&own, PRT_ANSWER_SINGLE, got), PRT_OK);
        expect_below(expect_name("node %u: relative RMSE", i), difference(got, want), 0.034);
        free(want);
    }
    free(got);
    prt_file_close(any);
    unlink(fluted);
    prt_mesh_destroy(mesh);
    mesh = plain;
    any = plain_file;
}

static int begin_test(void **state)
{
    struct model m;
    assert_non_null(mkdtemp(folder));
    prt_context_init(&context);
    context.log = keep_line;
    assert_int_equal(prt_pool_create(0, &context.pool), PRT_OK);
    model_init(&m, 2000, 4000);
    add_ball(&m, 20, 12, 12, dented_ball);
    mesh = body_mesh(&context, &m, false);
    lamp_light(&light);
    const struct prt_material skin = medium_of(1.3f);
    const struct prt_bake_options o = settings(&skin);
    snprintf(path, sizeof path, "%s/any.prt", folder);
    assert_int_equal(prt_bake(&context, mesh, &o, path), PRT_OK);
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &any), PRT_OK);
    return 0;
}

static int end_test(void **state)
{
    prt_file_close(any);
    prt_mesh_destroy(mesh);
    prt_cube_finish(&light);
    prt_pool_destroy(context.pool);
    unlink(path);
    return rmdir(folder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_index_agrees_with_the_reference),
        cmocka_unit_test(shadows_fall_at_every_node),
        cmocka_unit_test(an_index_outside_is_refused),
        cmocka_unit_test(settings_of_one_index_are_refused),
        cmocka_unit_test(the_error_contains_the_weights),
        cmocka_unit_test(weights_rebuild_every_index),
    };
    return run_physics_tests(tests, begin_test, end_test);
}
