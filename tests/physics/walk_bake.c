// SPDX-License-Identifier: MIT
// Bakes by random walks (METHODS §9) against walks of the reference, and the laws they obey.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "bodies.h"
#include "prt/bake.h"
#include "prt/relight.h"
#include "prt/walk.h"
#include "walk_truth.h"

enum { CUBE = 16 };
// Small bodies, and with the argument `long` those with more vertices. The bounds are the same:
// of small bodies each vertex has more walks.
static bool large;
static char warnings[2000];

static void keep_warnings(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(warnings);
    if (level <= PRT_LOG_WARNING) snprintf(warnings + n, sizeof warnings - n, "%s\n", line);
}

static struct prt_mesh *dented(void)
{
    struct model m;
    const uint32_t n = large ? 28 : 14;
    model_init(&m, 2 * n * (n + 1), 4 * n * n);
    add_ball(&m, 2 * n, n, n, dented_ball);
    return body_mesh(&context, &m, false);
}

// 16 x 2 x 16 mm.
static struct prt_mesh *slab(void)
{
    struct model m;
    const uint32_t n = large ? 16 : 8;
    model_init(&m, 6 * (n + 1) * (n + 1), 12 * n * n);
    add_box(&m, (float[]){0, 0, 0}, (float[]){8, 1, 8}, n);
    return body_mesh(&context, &m, false);
}

// A sky, a dark floor and a lamp of some texels.
static struct prt_cube light_of(bool even)
{
    struct prt_cube cube;
    assert_int_equal(prt_cube_init(&cube, CUBE), PRT_OK);
    for (uint32_t i = 0; i < 6 * CUBE * CUBE; i++) {
        uint32_t face = i / (CUBE * CUBE), y = i / CUBE % CUBE, x = i % CUBE;
        bool lamp = face == 4 && x > 8 && x < 12 && y > 2 && y < 6;
        for (uint32_t c = 0; c < 3; c++)
            cube.texel[3 * i + c] = even ? 1 : (face == 2 ? 0.6f : 0.15f) + (lamp ? 25 : 0);
    }
    return cube;
}

static struct prt_bake_options options(const struct prt_material *m)
{
    return (struct prt_bake_options){.media = prt_media_one(m),
                                     .scattering = PRT_SCATTERING_WALK,
                                     .n_sample = large ? 12000 : 4000,
                                     .cube = CUBE,
                                     .no_single = true,
                                     .unmeasured = true,
                                     .seed = 1};
}

// The vertices' colours of a term in a file, to free().
static float (*answer(const char *path, const struct prt_cube *light,
                      enum prt_answer_term term))[3]
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const struct prt_transport *t = prt_file_transport(f);
    const struct prt_query query = {.term = term, .light = light};
    float(*all)[3] = calloc(t->mesh.n_vertex, sizeof *all);
    assert_int_equal(prt_answer_colors(&context, t, &query, all), PRT_OK);
    prt_file_close(f);
    return all;
}

// The slab's edges and corners, which are finer than what smoothing takes together.
static bool at_the_edge(const float p[3])
{
    return (fabsf(p[0]) > 7.9f) + (fabsf(p[1]) > 0.9f) + (fabsf(p[2]) > 7.9f) >= 2;
}

// The error of multiple scattering of a bake of the medium, and of a part of its vertices; that
// of the dipole is far greater.
static void check_error(const char *name, struct prt_mesh *mesh, const char *medium,
                        double bound, bool (*part)(const float position[3]), double part_bound)
{
    struct prt_material m;
    static struct walk_truth truth, dipole;
    struct prt_cube light = light_of(false);
    assert_int_equal(prt_material_load(&context, medium, &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    o.n_walk = large ? 1024 : 2560;
    assert_int_equal(prt_bake(&context, mesh, &o, file("error.prt")), PRT_OK);
    float(*got)[3] = answer(file("error.prt"), &light, PRT_ANSWER_MULTIPLE);
    walk_truth_pick(&truth, mesh, NULL);
    walk_truth_take(&truth, mesh, &m, &light, PRT_REFERENCE_MULTIPLE, 6144);
    expect_walk_error(expect_name("%s, %s: error of multiple", name, medium), &truth, got,
                      bound);
    if (part) {
        static struct walk_truth own;
        walk_truth_pick(&own, mesh, part);
        walk_truth_take(&own, mesh, &m, &light, PRT_REFERENCE_MULTIPLE, 6144);
        expect_walk_error(expect_name("%s, %s: error at its edges", name, medium), &own, got,
                          part_bound);
    }
    walk_truth_pick(&dipole, mesh, NULL);
    walk_truth_take(&dipole, mesh, &m, &light, PRT_REFERENCE_MULTIPLE, 0);
    for (uint32_t i = 0; i < truth.n; i++)
        memcpy(got[truth.vertex[i]], dipole.color[0][i], sizeof *got);
    expect_above(expect_name("%s, %s: error of the dipole", name, medium),
                 walk_truth_error(&truth, got).least, 0.05);
    free(got);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: a bake by walks gives the light of two scatterings or more that walks of the reference
// give, where the dipole does not, and at edges, whose vertices differ from all neighbours
// (METHODS §9).
static void multiple_agrees_with_walks(void **state)
{
    check_error("dented ball", dented(), "skin1", 0.015, NULL, 0);
    check_error("slab of 2 mm", slab(), "skimmilk", 0.02, at_the_edge, 0.02);
}

static void count_single(void *arg, const struct prt_walk_exit *exit)
{
    *(double *)arg += exit->scatterings == 1;
}

// Law: without absorption all light that enters leaves: multiple, unscattered and the walks of
// one scattering have the sum E/pi under radiance 1 (METHODS §9, furnace).
static void no_light_is_made_or_lost(void **state)
{
    const struct prt_material m = {
        .sigma_s_prime = {0.3f, 1, 3}, .eta = 1.3f, .roughness = 0.3f};
    struct prt_mesh *mesh = dented();
    struct prt_cube light = light_of(true);
    struct prt_scene *scene;
    struct prt_walk_space *space;
    struct walk_truth picked;
    struct prt_bake_options o = options(&m);
    const double all = prt_fresnel_mean_transmittance(1.3); // E/pi
    double sum[3] = {0};
    walk_truth_pick(&picked, mesh, NULL);
    o.n_walk = 768;
    assert_int_equal(prt_bake(&context, mesh, &o, file("white.prt")), PRT_OK);
    float(*multiple)[3] = answer(file("white.prt"), &light, PRT_ANSWER_MULTIPLE);
    float(*unscattered)[3] = answer(file("white.prt"), &light, PRT_ANSWER_UNSCATTERED);
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_walk_space_create(&context, scene, &space), PRT_OK);
    for (uint32_t i = 0; i < picked.n; i++)
        for (unsigned c = 0; c < 3; c++) {
            enum { WALKS = 2048 };
            const uint32_t v = picked.vertex[i];
            struct prt_walk_start start;
            struct prt_walk_counts counts = {0};
            double n = 0;
            prt_walk_start_at(space, v, 0, 7 + i, &start);
            prt_walk_run(space, &start, &(struct prt_walk_medium){m.sigma_s_prime[c], m.eta, 0},
                         WALKS, count_single, &n, &counts);
            sum[c] += n / WALKS + (double)(multiple[v][c] + unscattered[v][c]) / all;
        }
    for (unsigned c = 0; c < 3; c++)
        expect_near("light that leaves", sum[c] / picked.n, 1, 0.004);
    free(multiple);
    free(unscattered);
    prt_walk_space_destroy(space);
    prt_scene_destroy(scene);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: unscattered light of a bake, by paths that divide, is that of the reference's walks
// (METHODS §9, terms).
static void unscattered_agrees_with_walks(void **state)
{
    const struct prt_material m = {.sigma_s_prime = {0.05f, 0.1f, 0.2f}, // clear: many cross
                                   .sigma_a = {0.05f, 0.02f, 0},
                                   .eta = 1.3f,
                                   .roughness = 0.3f};
    struct prt_mesh *mesh = dented();
    struct prt_cube light = light_of(false);
    static struct walk_truth truth;
    struct prt_bake_options o = options(&m);
    o.n_walk = 16;
    assert_int_equal(prt_bake(&context, mesh, &o, file("clear.prt")), PRT_OK);
    float(*got)[3] = answer(file("clear.prt"), &light, PRT_ANSWER_UNSCATTERED);
    walk_truth_pick(&truth, mesh, NULL);
    walk_truth_take(&truth, mesh, &m, &light, PRT_REFERENCE_UNSCATTERED, 8192);
    expect_walk_error("error of unscattered light", &truth, got, 0.02);
    free(got);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// The share of even light that crosses a slab without a scattering, reflected between its faces
// any number of times.
static double crossing_share(double depth, double eta)
{
    enum { ANGLES = 20000 };
    double share = 0, all = 0;
    for (int k = 0; k < ANGLES; k++) {
        const double mu = (k + 0.5) / ANGLES, f = prt_fresnel_transmittance(eta, mu);
        const double through = exp(-depth / sqrt(1 - (1 - mu * mu) / (eta * eta)));
        share += mu * f * f * through / (1 - (1 - f) * through);
        all += mu * f;
    }
    return share / all;
}

static bool in_the_middle(const float p[3])
{
    return fabsf(p[0]) < 4.5f && fabsf(p[2]) < 4.5f && fabsf(p[1]) > 0.99f;
}

// Law: in the middle of a wide slab under even light that share of E/pi is unscattered
// (METHODS §9, terms).
static void unscattered_follows_the_closed_form(void **state)
{
    struct prt_material m;
    struct prt_mesh *mesh = slab();
    struct prt_cube light = light_of(true);
    static struct walk_truth middle;
    assert_int_equal(prt_material_load(&context, "skin1", &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    o.n_walk = 16;
    assert_int_equal(prt_bake(&context, mesh, &o, file("slab.prt")), PRT_OK);
    float(*got)[3] = answer(file("slab.prt"), &light, PRT_ANSWER_UNSCATTERED);
    walk_truth_pick(&middle, mesh, in_the_middle);
    for (int c = 0; c < 3; c++) {
        const double depth = 2 * (double)(m.sigma_s_prime[c] + m.sigma_a[c]);
        const double want = crossing_share(depth, (double)m.eta) *
                            prt_fresnel_mean_transmittance((double)m.eta);
        for (uint32_t i = 0; i < middle.n; i++)
            expect_close(expect_name("unscattered, channel %d", c), got[middle.vertex[i]][c],
                         want, 0.01);
    }
    free(got);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: equal bakes are equal bytes for any number of threads (prt_bake).
static void threads_do_not_matter(void **state)
{
    struct prt_material m;
    struct prt_mesh *mesh = dented();
    struct prt_context one = context;
    assert_int_equal(prt_material_load(&context, "skimmilk", &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    o.n_walk = 32;
    assert_int_equal(prt_pool_create(1, &one.pool), PRT_OK);
    assert_int_equal(prt_bake(&context, mesh, &o, file("many.prt")), PRT_OK);
    assert_int_equal(prt_bake(&one, mesh, &o, file("one.prt")), PRT_OK);
    same_bytes(file("many.prt"), file("one.prt"));
    prt_pool_destroy(one.pool);
    prt_mesh_destroy(mesh);
}

// Law: a body with holes, through which more than a tenth of the walks escape, is baked with
// the dipole and said to be; with fewer the share is said (METHODS §9, holes).
static void holes_are_told(void **state)
{
    struct prt_material m;
    struct model sheets;
    struct prt_context listening = context;
    static const uint32_t rows[] = {7, 13};
    static const char *const words[] = {"baked with the dipole", "too dark"};
    listening.log = keep_warnings;
    assert_int_equal(prt_material_load(&context, "skin1", &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    o.n_walk = 16;
    for (unsigned i = 0; i < 2; i++) {
        model_init(&sheets, 28 * 15, 28 * 14 * 2);
        add_ball(&sheets, 28, 14, rows[i], dented_ball);
        struct prt_mesh *mesh = body_mesh(&context, &sheets, false);
        warnings[0] = 0;
        assert_int_equal(prt_bake(&listening, mesh, &o, file("open.prt")), PRT_OK);
        print_message("  %s", warnings);
        assert_non_null(strstr(warnings, words[i]));
        prt_mesh_destroy(mesh);
    }
}

// Contract of prt_bake: bad settings of walks are refused, with their range.
static void bad_settings_are_refused(void **state)
{
    struct prt_material m;
    struct prt_mesh *mesh = slab();
    struct prt_context listening = context;
    listening.log = keep_warnings;
    assert_int_equal(prt_material_load(&context, "skin1", &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    warnings[0] = 0;
    o.n_walk = 3;
    assert_int_equal(prt_bake(&listening, mesh, &o, file("bad.prt")), PRT_ARG);
    assert_non_null(strstr(warnings, "16 to 1048576"));
    o.n_walk = 0;
    m.eta = 0.9f;
    warnings[0] = 0;
    assert_true(prt_bake(&listening, mesh, &o, file("bad.prt")) < 0);
    assert_non_null(strstr(warnings, "eta"));
    m.eta = 1.3f;
    for (uint32_t t = 0; t < mesh->n_triangle; t++) { // inside out: it encloses nothing
        uint32_t *corner = (uint32_t *)(uintptr_t)mesh->triangle[t], c = corner[1];
        corner[1] = corner[2], corner[2] = c;
    }
    warnings[0] = 0;
    assert_int_equal(prt_bake(&listening, mesh, &o, file("bad.prt")), PRT_ARG);
    assert_non_null(strstr(warnings, "encloses"));
    assert_false(is_there(file("bad.prt")));
    prt_mesh_destroy(mesh);
}

int main(int argc, char **argv)
{
    large = argc > 1 && !strcmp(argv[1], "long");
    if (!bake_files_begin()) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(unscattered_agrees_with_walks),
        cmocka_unit_test(unscattered_follows_the_closed_form),
        cmocka_unit_test(no_light_is_made_or_lost),
        cmocka_unit_test(multiple_agrees_with_walks),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(holes_are_told),
        cmocka_unit_test(bad_settings_are_refused),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
