// SPDX-License-Identifier: MIT
// Bakes of small bodies against the reference engine, and the laws a bake obeys.
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

static struct prt_context context;
static char folder[] = "/tmp/prt-bake-test-XXXXXX";

static const char *file(const char *name)
{
    static char path[256];
    snprintf(path, sizeof path, "%s/%s", folder, name);
    return path;
}

// The dented ball, or its first n rows of 28.
static struct prt_mesh *body_of(uint32_t n)
{
    struct model m;
    model_init(&m, 56 * 29, 56 * 28 * 2);
    add_ball(&m, 56, 28, n, dented_ball);
    return body_mesh(&context, &m, false);
}

static struct prt_mesh *body(void)
{
    return body_of(28);
}

// Sky, floor and a soft box of a few texels.
static struct prt_cube light_of(uint32_t n)
{
    struct prt_cube cube;
    assert_int_equal(prt_cube_init(&cube, n), PRT_OK);
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        uint32_t face = i / (n * n), y = i / n % n, x = i % n;
        bool lamp = face == 4 && x > n / 2 && x < n / 2 + 4 && y > 2 && y < 6;
        for (uint32_t c = 0; c < 3; c++)
            cube.texel[i * 3 + c] =
                (face == 2 ? 0.6f : 0.15f) + (lamp ? 25 - 4.0f * (float)c : 0);
    }
    return cube;
}

static struct prt_material medium(const char *name)
{
    struct prt_material m;
    assert_int_equal(prt_material_load(&context, name, &m), PRT_OK);
    return m;
}

// The same in memory that lasts: of the last eight calls.
static const struct prt_material *kept(const char *name)
{
    static struct prt_material m[8];
    static unsigned n;
    m[n++ % 8] = medium(name);
    return &m[(n - 1) % 8];
}

static struct prt_bake_options options(const char *name)
{
    return (struct prt_bake_options){
        .media = prt_media_one(kept(name)), .n_sample = 12000, .cube = 16, .seed = 1};
}

static float (*reference(const struct prt_mesh *mesh, const struct prt_material *m,
                         const struct prt_cube *light, enum prt_reference_term term))[3]
{
    float(*color)[3] = calloc(mesh->n_vertex, sizeof *color);
    struct prt_reference_options o = {
        .term = term, .n_sample = 40000, .n_ray = 1024, .n_single = 2048, .seed = 31};
    const struct prt_media media = prt_media_one(m);
    assert_int_equal(prt_reference_colors(&context, mesh, &media, light, &o, color), PRT_OK);
    return color;
}

static double error_of(const char *path, const struct prt_query *query, const float (*want)[3])
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const struct prt_transport *t = prt_file_transport(f);
    float(*got)[3] = calloc(t->mesh.n_vertex, sizeof *got);
    assert_int_equal(prt_answer_colors(&context, t, query, got), PRT_OK);
    double error = prt_relative_rmse(got[0], want[0], (size_t)t->mesh.n_vertex * 3);
    free(got);
    prt_file_close(f);
    return error;
}

// Law: a factored bake gives the reference's B/pi and L1 (METHODS §3.4, W05 eq 7; §3.5, W05 eq
// 11).
static void factored_agrees_with_the_reference(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("skin1");
    struct prt_cube light = light_of(16);
    assert_int_equal(prt_bake(&context, mesh, &o, file("a.prt")), PRT_OK);
    struct prt_query q = {.term = PRT_ANSWER_MULTIPLE, .light = &light};
    float(*want)[3] = reference(mesh, o.media.medium, &light, PRT_REFERENCE_MULTIPLE);
    double multiple = error_of(file("a.prt"), &q, (const float(*)[3])want);
    free(want);
    q.term = PRT_ANSWER_SINGLE;
    want = reference(mesh, o.media.medium, &light, PRT_REFERENCE_SINGLE);
    double single = error_of(file("a.prt"), &q, (const float(*)[3])want);
    free(want);
    print_message("factored: multiple %.2f %%, single %.2f %%\n", 100 * multiple, 100 * single);
    expect_below("relative RMSE of multiple scattering", multiple, 0.0075);
    expect_below("relative RMSE of single scattering", single, 0.02);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: light that other bodies keep from an exit is missing there (W05 eq 11): of a bright
// ground under an opaque square little reaches the ball above it.
static void a_square_shadows_single_scattering(void **state)
{
    struct prt_mesh *mesh = ball_over_square(&context, 48, 32);
    struct prt_bake_options o = options("skin1");
    struct prt_cube light;
    assert_int_equal(prt_cube_init(&light, 16), PRT_OK);
    for (uint32_t i = 0; i < 6 * 16 * 16 * 3; i++)
        light.texel[i] = i / (16 * 16 * 3) == 3 ? 1 : 0.05f; // from -y
    assert_int_equal(prt_bake(&context, mesh, &o, file("a.prt")), PRT_OK);
    const struct prt_query q = {.term = PRT_ANSWER_SINGLE, .light = &light};
    float(*want)[3] = reference(mesh, o.media.medium, &light, PRT_REFERENCE_SINGLE);
    expect_below("relative RMSE of single scattering over a square",
                 error_of(file("a.prt"), &q, (const float(*)[3])want), 0.05);
    free(want);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: W05's truncation converges to the reference as it keeps more coefficients (W05 eq 7).
static void sparse_converges_to_the_reference(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("skin1");
    struct prt_cube light = light_of(16);
    o.storage = PRT_STORAGE_SPARSE;
    o.no_single = true;
    o.n_coef = 96;
    assert_int_equal(prt_bake(&context, mesh, &o, file("s.prt")), PRT_OK);
    struct prt_query q = {.term = PRT_ANSWER_MULTIPLE, .light = &light};
    float(*want)[3] = reference(mesh, o.media.medium, &light, PRT_REFERENCE_MULTIPLE);
    double coarse = error_of(file("s.prt"), &q, (const float(*)[3])want);
    o.n_coef = 1536;
    assert_int_equal(prt_bake(&context, mesh, &o, file("s.prt")), PRT_OK);
    double whole = error_of(file("s.prt"), &q, (const float(*)[3])want);
    print_message("sparse: 96 coefficients %.2f %%, all %.2f %%\n", 100 * coarse, 100 * whole);
    expect_below("relative RMSE with all coefficients", whole, 0.0085);
    expect_below("relative RMSE with 96", coarse, 0.06);
    expect_below("all coefficients over 96", whole / coarse, 1);
    free(want);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: one joint bake gives the reference for media that it was not trained on (METHODS §5).
static void joint_serves_every_medium(void **state)
{
    static const char *const name[] = {"skin1", "ketchup", "skimmilk"};
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("skin1");
    struct prt_cube light = light_of(16);
    o.engine = PRT_TRANSPORT_JOINT;
    assert_int_equal(prt_bake(&context, mesh, &o, file("j.prt")), PRT_OK);
    for (int i = 0; i < 3; i++) {
        struct prt_material m = medium(name[i]);
        struct prt_query q = {
            .term = PRT_ANSWER_MULTIPLE, .light = &light, .media = prt_media_one(&m)};
        float(*want)[3] = reference(mesh, &m, &light, PRT_REFERENCE_MULTIPLE);
        double multiple = error_of(file("j.prt"), &q, (const float(*)[3])want);
        free(want);
        q.term = PRT_ANSWER_SINGLE;
        want = reference(mesh, &m, &light, PRT_REFERENCE_SINGLE);
        double single = error_of(file("j.prt"), &q, (const float(*)[3])want);
        free(want);
        print_message("joint, %s: multiple %.2f %%, single %.2f %%\n", name[i], 100 * multiple,
                      100 * single);
        expect_below("relative RMSE of multiple scattering", multiple, 0.01);
        expect_below("relative RMSE of single scattering", single, 0.06);
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: the same of a draft with more texels of light than its single scattering is traced with.
static void a_draft_takes_a_finer_light(void **state)
{
    struct prt_mesh *mesh = body();
    const struct prt_bake_options o = {
        .cube = 32, .n_sample = 4000, .media = prt_media_one(kept("skin1")), .draft = true};
    struct prt_cube light = light_of(32);
    const struct prt_query q = {.term = PRT_ANSWER_SINGLE, .light = &light};
    assert_int_equal(prt_bake(&context, mesh, &o, file("d.prt")), PRT_OK);
    float(*want)[3] = reference(mesh, o.media.medium, &light, PRT_REFERENCE_SINGLE);
    const double error = error_of(file("d.prt"), &q, (const float(*)[3])want);
    free(want);
    print_message("draft, cube of 32: single %.2f %%\n", 100 * error);
    expect_below("relative RMSE of single scattering", error, 0.04);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: a draft for every medium keeps the terms of their phase functions (METHODS §3.8).
static void a_draft_scatters_forwards(void **state)
{
    struct prt_mesh *mesh = body();
    const struct prt_bake_options o = {
        .engine = PRT_TRANSPORT_JOINT, .media = prt_media_one(kept("skin1")), .draft = true};
    struct prt_cube light = light_of(16);
    struct prt_material m = medium("skin1");
    for (int c = 0; c < 3; c++) m.g[c] = 0.5f;
    const struct prt_query q = {
        .term = PRT_ANSWER_SINGLE, .light = &light, .media = prt_media_one(&m)};
    assert_int_equal(prt_bake(&context, mesh, &o, file("d.prt")), PRT_OK);
    float(*want)[3] = reference(mesh, &m, &light, PRT_REFERENCE_SINGLE);
    expect_below("relative RMSE of single scattering, g 0.5",
                 error_of(file("d.prt"), &q, (const float(*)[3])want), 0.1);
    free(want);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: a draft gives the reference's multiple scattering within 3 % and its total within 5 %
// for media that it was not trained on (METHODS §3.8), and its profile counts the work that was
// done.
static void a_draft_is_within_three_percent(void **state)
{
    static const char *const name[] = {"skin1", "ketchup", "skimmilk"};
    struct prt_mesh *mesh = body();
    struct prt_bake_profile profile;
    struct prt_bake_options o = {
        .engine = PRT_TRANSPORT_JOINT, .media = prt_media_one(kept("skin1")), .draft = true};
    struct prt_cube light = light_of(16);
    o.profile = &profile;
    assert_int_equal(prt_bake(&context, mesh, &o, file("d.prt")), PRT_OK);
    for (int i = 0; i < 3; i++) {
        struct prt_material m = medium(name[i]);
        struct prt_query q = {
            .term = PRT_ANSWER_MULTIPLE, .light = &light, .media = prt_media_one(&m)};
        float(*want)[3] = reference(mesh, &m, &light, PRT_REFERENCE_MULTIPLE);
        double error = error_of(file("d.prt"), &q, (const float(*)[3])want);
        free(want);
        print_message("draft, %s: multiple %.2f %%\n", name[i], 100 * error);
        expect_below("relative RMSE of multiple scattering", error, 0.03);
        want = reference(mesh, &m, &light, PRT_REFERENCE_TOTAL);
        q.term = PRT_ANSWER_TOTAL;
        error = error_of(file("d.prt"), &q, (const float(*)[3])want);
        free(want);
        print_message("draft, %s: total %.2f %%\n", name[i], 100 * error);
        expect_below("relative RMSE of the total", error, 0.05);
    }
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, file("d.prt"), PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const struct prt_transport *t = prt_file_transport(f);
    assert_non_null(strstr(t->settings, "\"draft\":true"));
    assert_int_equal(t->n_tensor, 2); // of multiple and of single scattering
    prt_file_close(f);
    double rays = 0, flop = 0;
    for (uint32_t i = 0; i < profile.n_work; i++) {
        assert_true(profile.work[i].cpu_seconds > 0);
        rays += (double)profile.work[i].rays, flop += profile.work[i].flop;
    }
    // a ray for each visible texel of each sample is the least, four rays for each the most
    expect_above("rays over samples times texels", rays / (20000.0 * 1536), 0.25);
    expect_below("rays over samples times texels", rays / (20000.0 * 1536), 2);
    expect_above("operations of the products", flop, 1e9);
    assert_true(profile.rays_s > 0 && profile.flop_s > 0);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: one polynomial bake gives the reference for every medium (METHODS §4, X07 eq 9, X07 eq
// 14).
static void polynomial_serves_every_medium(void **state)
{
    static const char *const name[] = {"skin1", "ketchup", "cream"};
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("skin1");
    struct prt_cube light = light_of(16);
    struct prt_env env = {.kind = PRT_ENV_CUBE, .cube = light};
    o.engine = PRT_TRANSPORT_POLYNOMIAL;
    o.env = &env;
    assert_int_equal(prt_bake(&context, mesh, &o, file("p.prt")), PRT_OK);
    for (int i = 0; i < 3; i++) {
        struct prt_material m = medium(name[i]);
        struct prt_query q = {.term = PRT_ANSWER_MULTIPLE, .media = prt_media_one(&m)};
        float(*want)[3] = reference(mesh, &m, &light, PRT_REFERENCE_MULTIPLE);
        double multiple = error_of(file("p.prt"), &q, (const float(*)[3])want);
        free(want);
        q.term = PRT_ANSWER_SINGLE;
        want = reference(mesh, &m, &light, PRT_REFERENCE_SINGLE);
        double single = error_of(file("p.prt"), &q, (const float(*)[3])want);
        free(want);
        print_message("polynomial, %s: multiple %.2f %%, single %.2f %%\n", name[i],
                      100 * multiple, 100 * single);
        expect_below("relative RMSE of multiple scattering", multiple, 0.01);
        expect_below("relative RMSE of single scattering", single, 0.06);
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: single scattering stays finite and of the closed body's size where a ray inwards leaves
// through a hole and hits nothing: the path's length is bounded (METHODS §3.5).
static void an_open_body_is_lit_like_others(void **state)
{
    struct prt_mesh *closed = body(), *open = body_of(22);
    struct prt_bake_options o = options("skin1");
    struct prt_cube light = light_of(16);
    o.engine = PRT_TRANSPORT_JOINT;
    o.n_sample = 2000;
    assert_int_equal(prt_bake(&context, closed, &o, file("closed.prt")), PRT_OK);
    assert_int_equal(prt_bake(&context, open, &o, file("open.prt")), PRT_OK);
    struct prt_query q = {.term = PRT_ANSWER_SINGLE, .light = &light, .media = o.media};
    float most[2] = {0, 0};
    for (int i = 0; i < 2; i++) {
        struct prt_file *f;
        const char *path = file(i ? "open.prt" : "closed.prt");
        assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
        const struct prt_transport *t = prt_file_transport(f);
        float(*got)[3] = calloc(t->mesh.n_vertex, sizeof *got);
        assert_int_equal(prt_answer_colors(&context, t, &q, got), PRT_OK);
        for (uint32_t v = 0; v < t->mesh.n_vertex; v++)
            for (int c = 0; c < 3; c++) {
                assert_true(isfinite(got[v][c]));
                most[i] = fmaxf(most[i], got[v][c]);
            }
        free(got);
        prt_file_close(f);
    }
    print_message("single scattering at most %.3f, of an open body %.3f\n", (double)most[0],
                  (double)most[1]);
    expect_above("largest value, closed body", most[0], 0);
    expect_near("largest value, open over closed", most[1] / most[0], 1, 0.001);
    prt_cube_finish(&light);
    prt_mesh_destroy(closed);
    prt_mesh_destroy(open);
}

// Contract of prt_bake: equal bytes whatever the number of threads.
static void threads_do_not_matter(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("marble");
    struct prt_blob a, b;
    o.n_sample = 2000;
    assert_int_equal(prt_bake(&context, mesh, &o, file("t2.prt")), PRT_OK);
    struct prt_context alone = context;
    alone.pool = NULL;
    assert_int_equal(prt_bake(&alone, mesh, &o, file("t1.prt")), PRT_OK);
    assert_int_equal(prt_read_file(&context, file("t1.prt"), 1u << 30, &a), PRT_OK);
    assert_int_equal(prt_read_file(&context, file("t2.prt"), 1u << 30, &b), PRT_OK);
    assert_int_equal(a.size, b.size);
    assert_memory_equal(a.bytes, b.bytes, a.size);
    prt_free(a.bytes), prt_free(b.bytes);
    prt_mesh_destroy(mesh);
}

static int stop(void *user, const char *stage, double fraction, double eta_s)
{
    return strcmp(stage, user) == 0;
}

// Contract of prt_bake: a cancelled bake leaves no file.
static void cancelling_leaves_no_file(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_bake_options o = options("marble");
    struct prt_context c = context;
    c.progress = stop;
    c.progress_user = (void *)(uintptr_t) "irradiance";
    o.n_sample = 60000;
    assert_int_equal(prt_bake(&c, mesh, &o, file("c.prt")), PRT_CANCELLED);
    assert_int_not_equal(access(file("c.prt"), F_OK), 0);
    prt_mesh_destroy(mesh);
}

static void say_nothing(void *user, enum prt_log_level level, const char *line)
{
    snprintf(user, 256, "%s", line);
}

// Contract of prt_bake: options out of range are refused, and the message names the range.
static void nonsense_is_refused(void **state)
{
    struct prt_mesh *mesh = body();
    char line[256] = "";
    struct prt_context c = context;
    c.log = say_nothing, c.log_user = line;
    struct prt_bake_options o = options("marble");
    o.cube = 33;
    assert_int_equal(prt_bake(&c, mesh, &o, file("n.prt")), PRT_ARG);
    assert_non_null(strstr(line, "16, 32, 64 or 128"));
    o = options("marble"), o.n_phase = 5;
    assert_int_equal(prt_bake(&c, mesh, &o, file("n.prt")), PRT_ARG);
    o = options("marble"), o.max_error = 3;
    assert_int_equal(prt_bake(&c, mesh, &o, file("n.prt")), PRT_ARG);
    struct prt_material wrong = medium("marble");
    wrong.sigma_a[1] = -1;
    o = options("marble"), o.media = prt_media_one(&wrong);
    assert_int_equal(prt_bake(&c, mesh, &o, file("n.prt")), PRT_ARG);
    o = options("marble"), o.engine = PRT_TRANSPORT_POLYNOMIAL;
    assert_int_equal(prt_bake(&c, mesh, &o, file("n.prt")), PRT_ARG);
    prt_mesh_destroy(mesh);
}

static int clean_up(void **state)
{
    static const char *const name[] = {"a", "s", "j", "p", "t1", "t2", "open", "closed"};
    for (size_t i = 0; i < sizeof name / sizeof *name; i++) {
        char n[16];
        snprintf(n, sizeof n, "%s.prt", name[i]);
        unlink(file(n));
    }
    return rmdir(folder);
}

int main(void)
{
    prt_context_init(&context);
    prt_pool_create(0, &context.pool);
    if (!mkdtemp(folder)) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(factored_agrees_with_the_reference),
        cmocka_unit_test(a_square_shadows_single_scattering),
        cmocka_unit_test(sparse_converges_to_the_reference),
        cmocka_unit_test(joint_serves_every_medium),
        cmocka_unit_test(a_draft_takes_a_finer_light),
        cmocka_unit_test(a_draft_scatters_forwards),
        cmocka_unit_test(a_draft_is_within_three_percent),
        cmocka_unit_test(polynomial_serves_every_medium),
        cmocka_unit_test(an_open_body_is_lit_like_others),
        cmocka_unit_test(threads_do_not_matter),
        cmocka_unit_test(cancelling_leaves_no_file),
        cmocka_unit_test(nonsense_is_refused),
    };
    int failed = run_physics_tests(tests, NULL, clean_up);
    prt_pool_destroy(context.pool);
    return failed;
}
