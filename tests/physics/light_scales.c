// SPDX-License-Identifier: MIT
// A polynomial bake is linear in its light (METHODS §4), whatever the light's unit: a dim room,
// a sunlit sky. Its columns are halves with factors of their own.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bake_files.h"
#include "bodies.h"
#include "lamp_light.h"
#include "prt/bake.h"
#include "prt/reference.h"
#include "prt/relight.h"

enum { CUBE = 16, N_SCALE = 4, BINARY = 3 }; // the last one changes exponents alone
static const float scales[N_SCALE] = {1, 1e-6f, 3e5f, 0x1p-20f};
static struct prt_mesh *body; // a dented ball beside an opaque one
static uint32_t first_opaque;
static struct prt_cube light;
static const struct prt_material medium = {.sigma_s_prime = {0.3f, 0.6f, 1.2f},
                                           .sigma_a = {0.01f, 0.05f, 0.2f},
                                           .g = {0.5f, 0.5f, 0.5f},
                                           .eta = 1.3f,
                                           .roughness = 0.3f};
static const struct prt_material thin = {.sigma_s_prime = {0.05f, 0.1f, 0.2f},
                                         .sigma_a = {0.05f, 0.02f, 0},
                                         .g = {0.5f, 0.5f, 0.5f},
                                         .eta = 1.3f,
                                         .roughness = 0.3f};

static void make_body(void)
{
    static const float rgb[3] = {0.7f, 0.5f, 0.3f};
    struct model m;
    model_init(&m, 2 * 28 * 15, 2 * 28 * 14 * 2);
    add_ball(&m, 28, 14, 14, dented_ball);
    first_opaque = m.mesh.n_vertex;
    const uint32_t n_triangle = m.mesh.n_triangle;
    add_ball(&m, 28, 14, 14, dented_ball);
    for (uint32_t v = first_opaque; v < m.mesh.n_vertex; v++) m.mesh.position[v][0] += 60;
    body = body_mesh(&context, &m, false);
    split_opaque(body, first_opaque, n_triangle, rgb);
}

static void bake(enum prt_scattering scattering, float scale, const char *path)
{
    struct prt_env env = {.kind = PRT_ENV_CUBE};
    assert_int_equal(prt_cube_init(&env.cube, CUBE), PRT_OK);
    for (size_t i = 0; i < 6 * CUBE * CUBE * 3; i++) env.cube.texel[i] = light.texel[i] * scale;
    const struct prt_bake_options o = {.engine = PRT_TRANSPORT_POLYNOMIAL,
                                       .media = prt_media_one(&medium),
                                       .scattering = scattering,
                                       .n_walk = 32,
                                       .n_sample = 4000,
                                       .cube = CUBE,
                                       .n_phase = 4,
                                       .env = &env,
                                       .unmeasured = true,
                                       .seed = 1};
    assert_int_equal(prt_bake(&context, body, &o, path), PRT_OK);
    prt_cube_finish(&env.cube);
}

static void answer(const struct prt_transport *t, const struct prt_material *m,
                   enum prt_answer_term term, const float *eye, float (*out)[3])
{
    const struct prt_query query = {.term = term, .media = prt_media_one(m), .eye = eye};
    assert_int_equal(prt_answer_colors(&context, t, &query, out), PRT_OK);
}

// The colours of a term in the files of all scales, each over its scale, against those of 1.
static void compare_scales(const char *kind, const char *name, enum prt_answer_term term,
                           const struct prt_material *m, const char *const path[])
{
    static const float eye[3] = {30, 20, 70};
    const size_t n = 3 * (size_t)body->n_vertex, n_inside = 3 * (size_t)first_opaque;
    float *own = calloc(n, sizeof *own), *want = calloc(2 * n, sizeof *want);
    assert_true(own && want);
    for (int s = 0; s < N_SCALE; s++) {
        const double bound = s == BINARY ? 1e-6 : 1e-3;
        const char *what = expect_name("%s, %s, x %g", kind, name, (double)scales[s]);
        struct prt_file *f;
        assert_int_equal(prt_file_open(&context, path[s], PRT_FILE_CHECK_ALL, &f), PRT_OK);
        for (int toward = 0; toward < 2; toward++) {
            float *to = s ? own : want + toward * n;
            answer(prt_file_transport(f), m, term, toward ? eye : NULL, (float(*)[3])to);
            for (size_t k = 0; k < n; k++) to[k] /= scales[s];
            if (!s || (toward && s != BINARY)) continue; // the eye multiplies rounding errors
            expect_below(what, prt_relative_rmse(own, want + toward * n, n_inside), bound);
            if (term == PRT_ANSWER_MULTIPLE)
                expect_below(expect_name("%s, opaque, x %g", kind, (double)scales[s]),
                             prt_relative_rmse(own + n_inside, want + toward * n + n_inside,
                                               n - n_inside),
                             bound);
        }
        prt_file_close(f);
    }
    free(own);
    free(want);
}

// Law: colours are proportional to the light that was baked, in every term (METHODS §4). Halves
// round otherwise, but for a light whose exponents alone differ.
static void colours_follow_the_light(void **state)
{
    static const char *const kinds[] = {"dipole", "walk"};
    for (int kind = 0; kind < 2; kind++) {
        const char *path[N_SCALE];
        for (int s = 0; s < N_SCALE; s++) {
            char name[16];
            snprintf(name, sizeof name, "%s%d.prt", kinds[kind], s);
            path[s] = file(name);
            bake(kind ? PRT_SCATTERING_WALK : PRT_SCATTERING_DIPOLE, scales[s], path[s]);
        }
        compare_scales(kinds[kind], "multiple", PRT_ANSWER_MULTIPLE, &medium, path);
        compare_scales(kinds[kind], "single", PRT_ANSWER_SINGLE, &medium, path);
        compare_scales(kinds[kind], "total", PRT_ANSWER_TOTAL, &medium, path);
        if (kind)
            compare_scales(kinds[kind], "unscattered", PRT_ANSWER_UNSCATTERED, &thin, path);
    }
}

static int end(void **state)
{
    prt_cube_finish(&light);
    prt_mesh_destroy(body);
    return bake_files_end(state);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    make_body();
    lamp_light(&light);
    const struct CMUnitTest tests[] = {cmocka_unit_test(colours_follow_the_light)};
    return run_physics_tests(tests, NULL, end);
}
