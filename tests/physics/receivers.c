// SPDX-License-Identifier: MIT
// Opaque surfaces beside a translucent body (W05 fig. 1's floor): albedo/pi times shadowed
// irradiance by every engine, as the reference has it; nothing of it scatters. And the one
// limit of eta, 1, where a boundary is none.
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

enum { U = 40, V = 24, BALL = U * (V + 1), SIDE = 25, FLOOR = SIDE * SIDE };

static struct prt_context context;
static char folder[] = "/tmp/prt-receivers-XXXXXX";
static char path[64];

// A ball of 16 mm that hovers over the middle of a square of 48 mm; without the square, the
// ball.
static struct prt_mesh *scene(bool floor)
{
    struct model m;
    model_init(&m, BALL + FLOOR, 2 * (U * V + FLOOR));
    add_round_ball(&m, U, V, 8);
    const uint32_t n_triangle = m.mesh.n_triangle;
    if (floor) add_floor(&m, 24, -10, SIDE - 1);
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    if (floor) split_opaque(mesh, BALL, n_triangle, (const float[]){0.8f, 0.5f, 0.2f});
    return mesh;
}

// A sky, brighter above, and a lamp straight over the ball.
static struct prt_cube light_of(uint32_t n)
{
    struct prt_cube cube;
    assert_int_equal(prt_cube_init(&cube, n), PRT_OK);
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        uint32_t face = i / (n * n), y = i / n % n, x = i % n;
        bool lamp = face == 2 && x >= n / 2 - 1 && x <= n / 2 && y >= n / 2 - 1 && y <= n / 2;
        for (uint32_t c = 0; c < 3; c++)
            cube.texel[i * 3 + c] =
                (face == 2 ? 0.5f : 0.2f) + (lamp ? 40 - 6.0f * (float)c : 0);
    }
    return cube;
}

static struct prt_bake_options options(enum prt_transport_kind engine)
{
    struct prt_bake_options o = {.engine = engine, .n_sample = 3000, .cube = 16, .seed = 1};
    static struct prt_material skin;
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    o.media = prt_media_one(&skin);
    return o;
}

// Colours of a bake of `mesh`, its own material given again where that is free.
static float (*baked(const struct prt_mesh *mesh, const struct prt_bake_options *o,
                     const struct prt_cube *light, enum prt_answer_term term))[3]
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    float(*color)[3] = calloc(mesh->n_vertex, sizeof *color);
    struct prt_query q = {.term = term,
                          .light = o->engine == PRT_TRANSPORT_POLYNOMIAL ? NULL : light,
                          .media = o->media};
    if (o->engine == PRT_TRANSPORT_WAVELET) q.media.n = 0;
    assert_int_equal(prt_answer_colors(&context, prt_file_transport(f), &q, color), PRT_OK);
    prt_file_close(f);
    return color;
}

static float (*reference(const struct prt_mesh *mesh, const struct prt_material *m,
                         const struct prt_cube *light, enum prt_reference_term term))[3]
{
    float(*color)[3] = calloc(mesh->n_vertex, sizeof *color);
    struct prt_reference_options o = {.term = term,
                                      .n_sample = 20000,
                                      .n_ray = 2048,
                                      .n_single = 2048,
                                      .straight_single = true,
                                      .seed = 31};
    const struct prt_media media = prt_media_one(m);
    assert_int_equal(prt_reference_colors(&context, mesh, &media, light, &o, color), PRT_OK);
    return color;
}

static void floor_is_lit_by(enum prt_transport_kind engine, const char *name)
{
    struct prt_mesh *mesh = scene(true);
    struct prt_cube light = light_of(16);
    struct prt_env env = {.kind = PRT_ENV_CUBE, .cube = light};
    struct prt_bake_options o = options(engine);
    if (engine == PRT_TRANSPORT_POLYNOMIAL) o.env = &env;
    assert_int_equal(prt_bake(&context, mesh, &o, path), PRT_OK);
    static const enum prt_answer_term term[] = {PRT_ANSWER_MULTIPLE, PRT_ANSWER_TOTAL};
    float(*want)[3] = reference(mesh, o.media.medium, &light, PRT_REFERENCE_MULTIPLE);
    for (int k = 0; k < 2; k++) {
        float(*got)[3] = baked(mesh, &o, &light, term[k]);
        double error = prt_relative_rmse(got[BALL], want[BALL], (size_t)FLOOR * 3);
        expect_below(
            expect_name("%s, floor, %s: relative RMSE", name, k ? "total" : "multiple"), error,
            0.025); // the wavelet storage, under a lamp of four texels
        // The lamp's shadow lies under the ball.
        const float *under = got[BALL + SIDE / 2 * SIDE + SIDE / 2], *corner = got[BALL];
        for (int c = 0; c < 3; c++) {
            expect_above("floor under the ball", under[c], 0);
            expect_below("floor under the ball over its corner", under[c] / corner[c], 0.2);
        }
        free(got);
    }
    float(*single)[3] = baked(mesh, &o, &light, PRT_ANSWER_SINGLE);
    for (uint32_t i = 0; i < FLOOR; i++)
        for (int c = 0; c < 3; c++)
            expect_near("single scattering of the floor", single[BALL + i][c], 0, 0);
    double lit = 0;
    for (uint32_t i = 0; i < BALL; i++) lit += (double)single[i][1];
    expect_above("single scattering of the ball, summed", lit, 0);
    free(single);
    free(want);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: an opaque surface gives albedo/pi int V L cos dw, and nothing of it scatters (METHODS
// §1).
static void wavelet_floor(void **state)
{
    floor_is_lit_by(PRT_TRANSPORT_WAVELET, "wavelet");
}

static void polynomial_floor(void **state)
{
    floor_is_lit_by(PRT_TRANSPORT_POLYNOMIAL, "polynomial");
}

// Law: a floor under a constant light of 1 returns its albedo, less the share of the sky that
// the ball hides (METHODS §1, opaque surfaces).
static void floor_returns_its_albedo(void **state)
{
    struct prt_mesh *mesh = scene(true);
    struct prt_cube light;
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET);
    o.no_single = true;
    assert_int_equal(prt_cube_init(&light, 16), PRT_OK);
    for (uint32_t i = 0; i < 6 * 16 * 16 * 3; i++) light.texel[i] = 1;
    assert_int_equal(prt_bake(&context, mesh, &o, path), PRT_OK);
    float(*got)[3] = baked(mesh, &o, &light, PRT_ANSWER_MULTIPLE);
    static const double albedo[3] = {0.8, 0.5, 0.2};
    // A ball of radius r in direction cos from the normal, wholly above the horizon, hides
    // cos (r/d)^2 of the cosine-weighted sky.
    double d2 = 24 * 24 + 24 * 24 + 10 * 10, hidden = 10 / sqrt(d2) * 64 / d2;
    for (int c = 0; c < 3; c++)
        expect_close("radiance of the floor's corner", got[BALL][c], albedo[c] * (1 - hidden),
                     0.01);
    free(got);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: at eta = 1 F_t is 1 and paths are straight: L1 is the reference's (METHODS §1, W05 eq
// 4).
static void eta_one_has_no_boundary(void **state)
{
    struct prt_mesh *mesh = scene(false);
    struct prt_cube light = light_of(16);
    struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET);
    struct prt_material flat = *o.media.medium;
    flat.eta = 1;
    o.media = prt_media_one(&flat);
    assert_int_equal(prt_bake(&context, mesh, &o, path), PRT_OK);
    float(*got)[3] = baked(mesh, &o, &light, PRT_ANSWER_SINGLE);
    float(*want)[3] = reference(mesh, o.media.medium, &light, PRT_REFERENCE_SINGLE);
    double error = prt_relative_rmse(got[0], want[0], (size_t)mesh->n_vertex * 3);
    expect_below("relative RMSE of single scattering", error, 0.016);
    free(got);
    free(want);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

static int clean_up(void **state)
{
    unlink(path);
    return rmdir(folder);
}

int main(void)
{
    prt_context_init(&context);
    prt_pool_create(0, &context.pool);
    if (!mkdtemp(folder)) return 1;
    snprintf(path, sizeof path, "%s/a.prt", folder);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(wavelet_floor),
        cmocka_unit_test(polynomial_floor),
        cmocka_unit_test(floor_returns_its_albedo),
        cmocka_unit_test(eta_one_has_no_boundary),
    };
    int failed = run_physics_tests(tests, NULL, clean_up);
    prt_pool_destroy(context.pool);
    return failed;
}
