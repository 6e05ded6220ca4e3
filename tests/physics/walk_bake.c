// SPDX-License-Identifier: MIT
// Bakes by random walks (METHODS §9) against walks of the reference, and the laws they obey.
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
#include "prt/bake.h"
#include "prt/reference.h"
#include "prt/relight.h"
#include "prt/walk.h"

enum { CUBE = 16, PICKED = 96 };
// Bodies and numbers of walks: small ones, and with the argument `long` those with more
// vertices and walks, whose noise is less.
static bool large;
static struct prt_context context;
static char folder[] = "/tmp/prt-walk-bake-XXXXXX";
static char warnings[2000];

static const char *file(const char *name)
{
    static char path[4][256];
    static unsigned at;
    at = (at + 1) % 4;
    snprintf(path[at], sizeof path[at], "%s/%s", folder, name);
    return path[at];
}

static void keep_warnings(void *user, enum prt_log_level level, const char *line)
{
    size_t n = strlen(warnings);
    if (level <= PRT_LOG_WARNING) snprintf(warnings + n, sizeof warnings - n, "%s\n", line);
}

static void log_errors(void *user, enum prt_log_level level, const char *line)
{
    if (level == PRT_LOG_ERROR) print_message("  %s\n", line);
}

static struct prt_mesh *dented(void)
{
    struct model m;
    const uint32_t n = large ? 28 : 14;
    model_init(&m, 2 * n * (n + 1), 4 * n * n);
    add_ball(&m, 2 * n, n, n, dented_ball);
    return body_mesh(&context, &m, false);
}

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

// The picked vertices' colours of a term in a file.
static void answer(const char *path, const struct prt_cube *light, enum prt_answer_term term,
                   const uint32_t pick[PICKED], float out[PICKED][3])
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const struct prt_transport *t = prt_file_transport(f);
    const struct prt_query query = {.term = term, .light = light};
    float(*all)[3] = calloc(t->mesh.n_vertex, sizeof *all);
    assert_int_equal(prt_answer_colors(&context, t, &query, all), PRT_OK);
    for (unsigned i = 0; i < PICKED; i++) memcpy(out[i], all[pick[i]], sizeof out[i]);
    free(all);
    prt_file_close(f);
}

static void reference(const struct prt_mesh *mesh, const struct prt_material *m,
                      const struct prt_cube *light, enum prt_reference_term term,
                      const uint32_t pick[PICKED], uint32_t n_walk, uint64_t seed,
                      float out[PICKED][3])
{
    const struct prt_reference_options o = {.term = term,
                                            .n_sample = large ? 40000 : 10000,
                                            .n_ray = large ? 1024 : 256,
                                            .seed = seed,
                                            .vertex = pick,
                                            .n_vertex = PICKED,
                                            .n_walk = n_walk};
    const struct prt_media media = prt_media_one(m);
    assert_int_equal(prt_reference_colors(&context, mesh, &media, light, &o, out), PRT_OK);
}

// The relative RMSE from what two references agree on: their noise is in neither product.
static double error_from(float got[PICKED][3], float a[PICKED][3], float b[PICKED][3])
{
    double error = 0, all = 0;
    for (unsigned i = 0; i < PICKED; i++)
        for (unsigned c = 0; c < 3; c++) {
            error += (double)(got[i][c] - a[i][c]) * (double)(got[i][c] - b[i][c]);
            all += (double)a[i][c] * (double)b[i][c];
        }
    return sqrt(fmax(error, 0) / all);
}

static void pick_vertices(const struct prt_mesh *mesh, uint32_t pick[PICKED])
{
    for (uint32_t i = 0; i < PICKED; i++)
        pick[i] = (uint32_t)((uint64_t)i * mesh->n_vertex / PICKED);
}

// The error of multiple scattering of a bake of the medium, and that of the dipole for scale.
static void check_error(const char *name, struct prt_mesh *mesh, const char *medium,
                        double bound)
{
    struct prt_material m;
    uint32_t pick[PICKED];
    static float got[PICKED][3], a[PICKED][3], b[PICKED][3];
    struct prt_cube light = light_of(false);
    char what[64];
    assert_int_equal(prt_material_load(&context, medium, &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    const uint32_t reference_walks = large ? 2048 : 1024;
    o.n_walk = large ? 1024 : 512;
    pick_vertices(mesh, pick);
    assert_int_equal(prt_bake(&context, mesh, &o, file("error.prt")), PRT_OK);
    answer(file("error.prt"), &light, PRT_ANSWER_MULTIPLE, pick, got);
    reference(mesh, &m, &light, PRT_REFERENCE_MULTIPLE, pick, reference_walks, 51, a);
    reference(mesh, &m, &light, PRT_REFERENCE_MULTIPLE, pick, reference_walks, 52, b);
    snprintf(what, sizeof what, "%s, %s: error of multiple", name, medium);
    expect_below(what, error_from(got, a, b), bound);
    reference(mesh, &m, &light, PRT_REFERENCE_MULTIPLE, pick, 0, 53, got);
    snprintf(what, sizeof what, "%s, %s: error of the dipole", name, medium);
    expect_above(what, error_from(got, a, b), 0.05);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: a bake by walks gives the light of two scatterings or more that walks of the reference
// give, where the dipole does not (METHODS §9).
static void multiple_agrees_with_walks(void **state)
{
    check_error("dented ball", dented(), "skin1", large ? 0.015 : 0.03);
    check_error("slab of 2 mm", slab(), "skimmilk", large ? 0.02 : 0.03);
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
    uint32_t pick[PICKED];
    static float multiple[PICKED][3], unscattered[PICKED][3];
    struct prt_bake_options o = options(&m);
    const uint32_t N = large ? 4096 : 2048;
    const double all = prt_fresnel_mean_transmittance(1.3); // E/pi
    double sum[3] = {0}, single[3] = {0};
    pick_vertices(mesh, pick);
    o.n_walk = 256;
    assert_int_equal(prt_bake(&context, mesh, &o, file("white.prt")), PRT_OK);
    answer(file("white.prt"), &light, PRT_ANSWER_MULTIPLE, pick, multiple);
    answer(file("white.prt"), &light, PRT_ANSWER_UNSCATTERED, pick, unscattered);
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_walk_space_create(&context, scene, &space), PRT_OK);
    for (unsigned i = 0; i < PICKED; i++)
        for (unsigned c = 0; c < 3; c++) {
            struct prt_walk_start start;
            struct prt_walk_counts counts = {0};
            double n = 0;
            prt_walk_start_at(space, pick[i], 0, 7 + i, &start);
            prt_walk_run(space, &start, &(struct prt_walk_medium){m.sigma_s_prime[c], m.eta, 0},
                         N, count_single, &n, &counts);
            single[c] += n / N / PICKED;
            sum[c] += (double)(multiple[i][c] + unscattered[i][c]) / all / PICKED;
        }
    for (unsigned c = 0; c < 3; c++)
        expect_near("light that leaves", sum[c] + single[c], 1, large ? 0.004 : 0.006);
    prt_walk_space_destroy(space);
    prt_scene_destroy(scene);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: unscattered light of a bake, by paths that divide, is that of the reference's walks
// (METHODS §9, terms).
static void unscattered_agrees_with_walks(void **state)
{
    struct prt_material m;
    struct prt_mesh *mesh = slab();
    struct prt_cube light = light_of(true);
    uint32_t pick[PICKED];
    static float got[PICKED][3], a[PICKED][3], b[PICKED][3];
    assert_int_equal(prt_material_load(&context, "skin1", &m), PRT_OK);
    struct prt_bake_options o = options(&m);
    o.n_walk = 16;
    pick_vertices(mesh, pick);
    assert_int_equal(prt_bake(&context, mesh, &o, file("clear.prt")), PRT_OK);
    answer(file("clear.prt"), &light, PRT_ANSWER_UNSCATTERED, pick, got);
    reference(mesh, &m, &light, PRT_REFERENCE_UNSCATTERED, pick, large ? 4096 : 2048, 51, a);
    reference(mesh, &m, &light, PRT_REFERENCE_UNSCATTERED, pick, large ? 4096 : 2048, 52, b);
    expect_below("error of unscattered light", error_from(got, a, b), 0.02);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

static bool same_bytes(const char *a, const char *b)
{
    FILE *f = fopen(a, "rb"), *g = fopen(b, "rb");
    bool same = f && g;
    for (int c = 0, d = 0; same && c != EOF;) {
        c = fgetc(f), d = fgetc(g);
        same = c == d;
    }
    if (f) fclose(f);
    if (g) fclose(g);
    return same;
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
    assert_true(same_bytes(file("many.prt"), file("one.prt")));
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
    assert_int_not_equal(access(file("bad.prt"), F_OK), 0);
    prt_mesh_destroy(mesh);
}

int main(int argc, char **argv)
{
    char command[300];
    large = argc > 1 && !strcmp(argv[1], "long");
    if (!mkdtemp(folder)) return 1;
    prt_context_init(&context);
    context.log = log_errors;
    assert_int_equal(prt_pool_create(0, &context.pool), PRT_OK);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(unscattered_agrees_with_walks),
        cmocka_unit_test(no_light_is_made_or_lost),
        cmocka_unit_test(multiple_agrees_with_walks),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(holes_are_told),
        cmocka_unit_test(bad_settings_are_refused),
    };
    int status = run_physics_tests(tests, NULL, NULL);
    prt_pool_destroy(context.pool);
    snprintf(command, sizeof command, "rm -rf %s", folder);
    return system(command) ? 1 : status;
}
