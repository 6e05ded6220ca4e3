// SPDX-License-Identifier: MIT
// Several media in one model (METHODS §10): two balls of different eta, baked together and
// alone, and an opaque body inside a translucent one.
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
#include "prt/media.h"
#include "prt/reference.h"
#include "prt/relight.h"

enum { BALLS = 2, N_TRANSPORT = 3 };

static struct prt_context context;
static char folder[] = "/tmp/prt-media-test-XXXXXX";
static struct prt_mesh *mesh; // two balls; ball i has the vertices [begin[i], begin[i + 1])
static struct prt_block block[BALLS];
static uint32_t begin[BALLS + 1];
static struct prt_cube light;
static struct prt_env env;
static struct prt_material material[BALLS]; // skin1 and marble: eta 1.3 and 1.5
static const uint8_t own[BALLS] = {0, 1};
static const char *const names[N_TRANSPORT] = {"wavelet", "polynomial", "joint"};
static struct prt_file *together[N_TRANSPORT];

static const char *file(const char *name, int i)
{
    static char path[256];
    snprintf(path, sizeof path, "%s/%s-%d.prt", folder, name, i);
    return path;
}

static struct prt_media both(void)
{
    return (struct prt_media){BALLS, material, own};
}

static void make_balls(void)
{
    struct model m;
    model_init(&m, 2000, 4000);
    add_sphere(&m, (float[3]){-8, 0, 0}, 7, 7);
    const uint32_t n_vertex = m.mesh.n_vertex, n_triangle = m.mesh.n_triangle;
    add_sphere(&m, (float[3]){8, 1, 0}, 6, 7);
    mesh = body_mesh(&context, &m, true);
    block[0] = (struct prt_block){0, 0, 0, n_vertex, 0, n_triangle};
    block[1] = (struct prt_block){
        1, 0, n_vertex, mesh->n_vertex - n_vertex, n_triangle, mesh->n_triangle - n_triangle};
    mesh->block = block, mesh->n_block = mesh->n_object = BALLS;
    mesh->object = NULL; // names of one object only
    begin[1] = n_vertex, begin[2] = mesh->n_vertex;
}

static void make_light(void)
{
    lamp_light(&light);
    env = (struct prt_env){.kind = PRT_ENV_CUBE, .cube = light};
}

// A wavelet bake's rank and coefficients are fixed, so that what is kept of one object does not
// depend on the other.
static void bake(enum prt_transport_kind engine, struct prt_media media, const char *path)
{
    struct prt_bake_options o = {.engine = engine,
                                 .media = media,
                                 .n_sample = 4000,
                                 .cube = 16,
                                 .n_phase = 1,
                                 .seed = 1};
    if (engine == PRT_TRANSPORT_POLYNOMIAL) o.env = &env;
    if (engine == PRT_TRANSPORT_WAVELET) o.rank = 40, o.n_basis_coef = 1200;
    assert_int_equal(prt_bake(&context, mesh, &o, path), PRT_OK);
}

static struct prt_file *open_prt(const char *path)
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    return f;
}

static float (*ask(const struct prt_file *f, struct prt_media media, enum prt_answer_term term,
                   const float *eye))[3]
{
    const struct prt_transport *t = prt_file_transport(f);
    float(*out)[3] = calloc(mesh->n_vertex, sizeof *out);
    struct prt_query q = {.term = term, .media = media, .eye = eye};
    if (t->engine != PRT_TRANSPORT_POLYNOMIAL) q.light = &light;
    if (t->engine == PRT_TRANSPORT_WAVELET) q.media.n = 0;
    assert_int_equal(prt_answer_colors(&context, t, &q, out), PRT_OK);
    return out;
}

static double error_on(int ball, const float (*a)[3], const float (*b)[3])
{
    return prt_relative_rmse(a[begin[ball]], b[begin[ball]],
                             3 * (size_t)(begin[ball + 1] - begin[ball]));
}

// Law: max_error holds for every object (METHODS §3, what is kept): one that is twenty times
// darker than its neighbour differs no more from its bake alone.
static void dark_object_keeps_its_error(void **state)
{
    static const double max_error[] = {0.01, 0.05}; // of a bake and of a draft
    struct prt_material pair[BALLS] = {material[1], material[1]};
    for (int c = 0; c < 3; c++) pair[1].sigma_a[c] = 4;
    for (int i = 0; i < 2; i++) {
        struct prt_bake_options o = {.engine = PRT_TRANSPORT_WAVELET,
                                     .media = {BALLS, pair, own},
                                     .n_sample = 4000,
                                     .cube = 16,
                                     .max_error = max_error[i],
                                     .no_single = true,
                                     .seed = 1};
        assert_int_equal(prt_bake(&context, mesh, &o, file("uneven", i)), PRT_OK);
        struct prt_file *f = open_prt(file("uneven", i));
        float(*got)[3] = ask(f, o.media, PRT_ANSWER_MULTIPLE, NULL), (*want[BALLS])[3];
        for (int k = 0; k < BALLS; k++) {
            o.media = prt_media_one(&pair[k]);
            o.rank = 150; // all that can matter
            o.n_basis_coef = 6 * 16 * 16;
            assert_int_equal(prt_bake(&context, mesh, &o, file("even", k)), PRT_OK);
            struct prt_file *even = open_prt(file("even", k));
            want[k] = ask(even, o.media, PRT_ANSWER_MULTIPLE, NULL);
            expect_below(expect_name("relative RMSE of ball %d at %g", k, max_error[i]),
                         error_on(k, (const float(*)[3])got, (const float(*)[3])want[k]),
                         max_error[i]);
            prt_file_close(even);
        }
        free(got), free(want[0]), free(want[1]);
        prt_file_close(f);
    }
}

// Law: an object of a bake of several media has the colours of a bake of its medium alone
// (METHODS §10): light does not cross objects. Where the material is free the bakes differ in
// the radial basis, which serves both indices, and joint ones in what is kept.
static void each_object_is_as_with_its_medium_alone(void **state)
{
    static const enum prt_answer_term terms[] = {PRT_ANSWER_MULTIPLE, PRT_ANSWER_SINGLE,
                                                 PRT_ANSWER_TOTAL};
    static const double most[N_TRANSPORT] = {1e-6, 6e-4, 1.5e-3};
    const float eye[3] = {10, 20, 60};
    for (int e = 0; e < N_TRANSPORT; e++)
        for (int k = 0; k < BALLS; k++) {
            struct prt_media one = prt_media_one(&material[k]);
            bake((enum prt_transport_kind)e, one, file("alone", k));
            struct prt_file *alone = open_prt(file("alone", k));
            for (int t = 0; t < 4; t++) {
                const enum prt_answer_term term = terms[t == 3 ? 2 : t];
                const float *from = t == 3 ? eye : NULL;
                float(*want)[3] = ask(alone, one, term, from);
                float(*got)[3] = ask(together[e], both(), term, from);
                double error = error_on(k, (const float(*)[3])got, (const float(*)[3])want);
                double apart = error_on(1 - k, (const float(*)[3])got, (const float(*)[3])want);
                print_message("%s, ball %d, term %d: %.4f %%, the other %.1f %%\n", names[e], k,
                              t, 100 * error, 100 * apart);
                expect_below(
                    expect_name("%s: relative RMSE against its medium alone", names[e]), error,
                    most[e]);
                expect_above("difference of the two media", apart, 0.1);
                free(want), free(got);
            }
            prt_file_close(alone);
        }
}

// Law: the same of a bake by walks (METHODS §9), of media that let much light through: walks
// and straight paths are those of the object's own index.
static void walks_are_as_with_their_medium_alone(void **state)
{
    struct prt_material thin[BALLS] = {material[0], material[1]};
    for (int k = 0; k < BALLS; k++)
        for (int c = 0; c < 3; c++)
            thin[k].sigma_s_prime[c] *= 0.1f, thin[k].sigma_a[c] *= 0.1f;
    const struct prt_media media[] = {prt_media_one(&thin[1]), {BALLS, thin, own}};
    float(*got[2][2])[3]; // [both][unscattered]
    for (int both = 0; both < 2; both++) {
        const struct prt_bake_options o = {.engine = PRT_TRANSPORT_WAVELET,
                                           .media = media[both],
                                           .scattering = PRT_SCATTERING_WALK,
                                           .n_walk = 16,
                                           .n_sample = 4000,
                                           .cube = 16,
                                           .rank = 40,
                                           .n_basis_coef = 1200,
                                           .no_single = true,
                                           .seed = 1};
        assert_int_equal(prt_bake(&context, mesh, &o, file("walks", both)), PRT_OK);
        struct prt_file *f = open_prt(file("walks", both));
        got[both][0] = ask(f, media[both], PRT_ANSWER_MULTIPLE, NULL);
        got[both][1] = ask(f, media[both], PRT_ANSWER_UNSCATTERED, NULL);
        prt_file_close(f);
    }
    for (int t = 0; t < 2; t++) {
        expect_below(expect_name("walks, %s: relative RMSE against its medium alone",
                                 t ? "unscattered" : "multiple"),
                     error_on(1, (const float(*)[3])got[1][t], (const float(*)[3])got[0][t]),
                     1e-6);
        free(got[0][t]), free(got[1][t]);
    }
}

// Law: colours of several eta are the reference's (METHODS §8), baked or brute force.
static void several_eta_agree_with_the_reference(void **state)
{
    const struct prt_media media = both();
    for (int single = 0; single < 2; single++) {
        struct prt_reference_options o = {.term = single ? PRT_REFERENCE_SINGLE
                                                         : PRT_REFERENCE_MULTIPLE,
                                          .n_sample = 20000,
                                          .n_ray = 1024,
                                          .n_single = 1024,
                                          .seed = 31};
        float(*want)[3] = calloc(mesh->n_vertex, sizeof *want);
        assert_int_equal(prt_reference_colors(&context, mesh, &media, &light, &o, want),
                         PRT_OK);
        for (int e = 0; e < N_TRANSPORT; e++) {
            float(*got)[3] =
                ask(together[e], media, single ? PRT_ANSWER_SINGLE : PRT_ANSWER_MULTIPLE, NULL);
            for (int k = 0; k < BALLS; k++) {
                double error = error_on(k, (const float(*)[3])got, (const float(*)[3])want);
                print_message("%s, ball %d, %s: %.2f %%\n", names[e], k,
                              single ? "single" : "multiple", 100 * error);
                expect_below(expect_name("%s: relative RMSE", names[e]), error,
                             single ? 0.06 : 0.01);
            }
            free(got);
        }
        free(want);
    }
}

// Law: an edit of one object's medium leaves the other's colours as they are, to the last bit,
// by every order of contraction.
static void an_edit_of_one_object_keeps_the_other(void **state)
{
    struct prt_material edited[BALLS] = {material[0], material[1]};
    for (int c = 0; c < 3; c++) edited[1].sigma_a[c] *= 3;
    const struct prt_media media = {BALLS, edited, own};
    for (int e = 1; e < N_TRANSPORT; e++) {
        float(*before)[3] = ask(together[e], both(), PRT_ANSWER_TOTAL, NULL);
        float(*after)[3] = ask(together[e], media, PRT_ANSWER_TOTAL, NULL);
        assert_memory_equal(before, after, begin[1] * sizeof *before);
        expect_above("change of the edited ball",
                     error_on(1, (const float(*)[3])after, (const float(*)[3])before), 0.05);
        free(before), free(after);
    }
    const struct prt_transport *t = prt_file_transport(together[2]);
    struct prt_contracted_light *lit;
    struct prt_contracted_transport *fixed;
    assert_int_equal(prt_contracted_light_create(&context, t, &light, &lit), PRT_OK);
    assert_int_equal(prt_contracted_transport_create(&context, t, &media, &fixed), PRT_OK);
    float(*plain)[3] = ask(together[2], media, PRT_ANSWER_TOTAL, NULL);
    float(*other)[3] = calloc(mesh->n_vertex, sizeof *other);
    struct prt_query q = {.term = PRT_ANSWER_TOTAL, .media = media, .lit = lit};
    assert_int_equal(prt_answer_colors(&context, t, &q, other), PRT_OK);
    assert_memory_equal(plain, other, mesh->n_vertex * sizeof *other);
    q = (struct prt_query){.term = PRT_ANSWER_TOTAL, .light = &light};
    assert_int_equal(
        prt_answer_colors(&context, prt_contracted_transport_get(fixed), &q, other), PRT_OK);
    for (int k = 0; k < BALLS; k++)
        expect_below("relative RMSE of the media contracted first",
                     error_on(k, (const float(*)[3])other, (const float(*)[3])plain),
                     PRT_FIXED_ERROR);
    prt_contracted_light_destroy(lit);
    prt_contracted_transport_destroy(fixed);
    free(plain), free(other);
}

// Law: what is dropped where media are contracted first is a share of every object's own light
// (METHODS §5, two orders of contraction): of one that is far darker than its neighbour, too.
static void contraction_keeps_a_dark_object(void **state)
{
    struct prt_material pair[BALLS] = {material[0], material[1]};
    for (int c = 0; c < 3; c++) {
        pair[0].sigma_s_prime[c] = 5, pair[0].sigma_a[c] = 0;
        pair[1].sigma_s_prime[c] = 0.5f, pair[1].sigma_a[c] = 1.5f;
    }
    const struct prt_media media = {BALLS, pair, own};
    const struct prt_transport *t = prt_file_transport(together[2]);
    struct prt_contracted_transport *fixed;
    assert_int_equal(prt_contracted_transport_create(&context, t, &media, &fixed), PRT_OK);
    static const enum prt_answer_term terms[] = {PRT_ANSWER_MULTIPLE, PRT_ANSWER_SINGLE};
    for (int i = 0; i < 2; i++) {
        float(*plain)[3] = ask(together[2], media, terms[i], NULL);
        float(*first)[3] = calloc(mesh->n_vertex, sizeof *first);
        const struct prt_query q = {.term = terms[i], .light = &light};
        assert_int_equal(
            prt_answer_colors(&context, prt_contracted_transport_get(fixed), &q, first),
            PRT_OK);
        for (int k = 0; k < BALLS; k++)
            expect_below(expect_name("%s: relative RMSE of ball %d, media contracted first",
                                     i ? "single" : "multiple", k),
                         error_on(k, (const float(*)[3])first, (const float(*)[3])plain),
                         PRT_FIXED_ERROR);
        free(plain), free(first);
    }
    prt_contracted_transport_destroy(fixed);
}

// Multiple scattering of a file in a medium; NULL: its own.
static void answer_multiple(const char *path, const struct prt_material *m, float (*out)[3])
{
    struct prt_file *f = open_prt(path);
    struct prt_query q = {.term = PRT_ANSWER_MULTIPLE, .light = &light};
    if (m) q.media = prt_media_one(m);
    assert_int_equal(prt_answer_colors(&context, prt_file_transport(f), &q, out), PRT_OK);
    prt_file_close(f);
}

// Law: the error of a joint bake beside an opaque body is that without it (METHODS §5): the
// media that U serves are weighed by what they return on the translucent body.
static void an_opaque_body_leaves_the_training(void **state)
{
    static const float grey[3] = {0.5f, 0.5f, 0.5f};
    double error[2];
    for (int with = 0; with < 2; with++) {
        struct model m;
        model_init(&m, 6000, 12000);
        add_sphere(&m, (float[3]){0, 0, 0}, 8, 12);
        const uint32_t n_vertex = m.mesh.n_vertex, n_triangle = m.mesh.n_triangle;
        if (with) add_floor(&m, 40, -100, 60);
        struct prt_mesh *ball = body_mesh(&context, &m, true);
        if (with) split_opaque(ball, n_vertex, n_triangle, grey);
        struct prt_bake_options o = {.engine = PRT_TRANSPORT_JOINT,
                                     .media = prt_media_one(&material[1]),
                                     .n_sample = 4000,
                                     .cube = 16,
                                     .no_single = true,
                                     .unmeasured = true,
                                     .seed = 1};
        float(*got)[3] = calloc(ball->n_vertex, sizeof *got);
        float(*want)[3] = calloc(ball->n_vertex, sizeof *want);
        assert_int_equal(prt_bake(&context, ball, &o, file("free", with)), PRT_OK);
        o.engine = PRT_TRANSPORT_WAVELET;
        o.rank = 150; // all that can matter
        o.n_basis_coef = 6 * 16 * 16;
        assert_int_equal(prt_bake(&context, ball, &o, file("fixed", with)), PRT_OK);
        answer_multiple(file("free", with), &material[1], got);
        answer_multiple(file("fixed", with), NULL, want);
        error[with] = prt_relative_rmse(got[0], want[0], 3 * (size_t)n_vertex);
        free(got), free(want);
        prt_mesh_destroy(ball);
    }
    print_message("joint bake alone %.3f %%, beside an opaque body %.3f %%\n", 100 * error[0],
                  100 * error[1]);
    expect_below("error beside an opaque body, of that alone", error[1] / error[0], 1.5);
}

// A medium of another eta than its object's bake is refused; so is one for all, here.
static void eta_belongs_to_the_object(void **state)
{
    const struct prt_transport *t = prt_file_transport(together[2]);
    const struct prt_material swapped[BALLS] = {material[1], material[0]};
    const struct prt_media wrong[] = {{BALLS, swapped, own}, prt_media_one(&material[0])};
    float(*out)[3] = calloc(mesh->n_vertex, sizeof *out);
    for (int i = 0; i < 2; i++) {
        struct prt_query q = {.term = PRT_ANSWER_TOTAL, .light = &light, .media = wrong[i]};
        assert_int_equal(prt_answer_colors(&context, t, &q, out), PRT_MISMATCH);
    }
    free(out);
}

// Law: an opaque body inside a translucent one (a wick) stops the straight rays of single
// scattering, in the bake as in the reference, and is dark itself. The dipole does not see it:
// multiple scattering is that without it (METHODS §10).
static void an_opaque_body_inside_stops_rays(void **state)
{
    struct model m;
    static struct prt_block part[2];
    static struct prt_surface surface[2];
    model_init(&m, 2000, 4000);
    add_sphere(&m, (float[3]){0, 0, 0}, 7, 8);
    const uint32_t n_vertex = m.mesh.n_vertex, n_triangle = m.mesh.n_triangle;
    add_box(&m, (float[3]){0, 0, 0}, (float[3]){3.6f, 4, 3.6f}, 2);
    struct prt_mesh *candle = body_mesh(&context, &m, true);
    surface[0] = candle->surface[0];
    surface[1] = (struct prt_surface){.name = "wick", .base_color = {1, 1, 1, 1}};
    part[0] = (struct prt_block){0, 0, 0, n_vertex, 0, n_triangle};
    part[1] = (struct prt_block){1,          1,
                                 n_vertex,   candle->n_vertex - n_vertex,
                                 n_triangle, candle->n_triangle - n_triangle};
    candle->surface = surface, candle->n_surface = 2;
    candle->block = part, candle->n_block = candle->n_object = 2;
    candle->object = NULL;
    struct prt_mesh bare = *candle; // without the wick
    bare.n_block = bare.n_object = 1, bare.n_vertex = n_vertex, bare.n_triangle = n_triangle;
    struct prt_material thin = material[0]; // whose light reaches the wick
    for (int c = 0; c < 3; c++) thin.sigma_s_prime[c] *= 0.2f, thin.sigma_a[c] *= 0.2f;
    const struct prt_media media = prt_media_one(&thin);
    struct prt_bake_options o = {.media = media, .n_sample = 5000, .cube = 16, .seed = 1};
    float(*want[2][2])[3]; // [bare][single]
    for (int i = 0; i < 4; i++) {
        struct prt_reference_options r = {.term = i % 2 ? PRT_REFERENCE_SINGLE
                                                        : PRT_REFERENCE_MULTIPLE,
                                          .n_sample = 30000,
                                          .n_ray = 1024,
                                          .n_single = 2048,
                                          .seed = 31};
        want[i / 2][i % 2] = calloc(candle->n_vertex, sizeof(float[3]));
        assert_int_equal(prt_reference_colors(&context, i / 2 ? &bare : candle, &media, &light,
                                              &r, want[i / 2][i % 2]),
                         PRT_OK);
    }
    for (uint32_t v = n_vertex; v < candle->n_vertex; v++)
        for (int c = 0; c < 3; c++) assert_true(want[0][0][v][c] == 0);
    assert_int_equal(prt_bake(&context, candle, &o, file("wick", 0)), PRT_OK);
    struct prt_file *f = open_prt(file("wick", 0));
    float(*got)[3] = calloc(candle->n_vertex, sizeof *got);
    for (int single = 0; single < 2; single++) {
        struct prt_query q = {.term = single ? PRT_ANSWER_SINGLE : PRT_ANSWER_MULTIPLE,
                              .light = &light};
        assert_int_equal(prt_answer_colors(&context, prt_file_transport(f), &q, got), PRT_OK);
        double error =
            prt_relative_rmse(got[0], want[0][single][0], 3 * (size_t)candle->n_vertex);
        double without =
            prt_relative_rmse(want[0][single][0], want[1][single][0], 3 * (size_t)n_vertex);
        print_message("wick, %s: %.2f %%, without it %.2f %% apart\n",
                      single ? "single" : "multiple", 100 * error, 100 * without);
        expect_below("relative RMSE with a wick", error, single ? 0.06 : 0.01);
        if (single) expect_above("light that the wick stops", without, 0.2);
        else expect_below("effect of the wick on the dipole", without, 1e-6);
    }
    prt_file_close(f);
    for (int i = 0; i < 4; i++) free(want[i / 2][i % 2]);
    free(got);
    prt_mesh_destroy(candle);
}

static int begin_test(void **state)
{
    assert_non_null(mkdtemp(folder));
    prt_context_init(&context);
    assert_int_equal(prt_pool_create(0, &context.pool), PRT_OK);
    make_balls();
    make_light();
    assert_int_equal(prt_material_load(&context, "skin1", &material[0]), PRT_OK);
    assert_int_equal(prt_material_load(&context, "marble", &material[1]), PRT_OK);
    for (int e = 0; e < N_TRANSPORT; e++) {
        bake((enum prt_transport_kind)e, both(), file("both", e));
        together[e] = open_prt(file("both", e));
    }
    return 0;
}

static int end_test(void **state)
{
    char command[300];
    for (int e = 0; e < N_TRANSPORT; e++) prt_file_close(together[e]);
    prt_mesh_destroy(mesh);
    prt_cube_finish(&light);
    prt_pool_destroy(context.pool);
    snprintf(command, sizeof command, "rm -rf %s", folder);
    return system(command);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_object_is_as_with_its_medium_alone),
        cmocka_unit_test(walks_are_as_with_their_medium_alone),
        cmocka_unit_test(dark_object_keeps_its_error),
        cmocka_unit_test(several_eta_agree_with_the_reference),
        cmocka_unit_test(an_edit_of_one_object_keeps_the_other),
        cmocka_unit_test(contraction_keeps_a_dark_object),
        cmocka_unit_test(an_opaque_body_leaves_the_training),
        cmocka_unit_test(eta_belongs_to_the_object),
        cmocka_unit_test(an_opaque_body_inside_stops_rays),
    };
    return run_physics_tests(tests, begin_test, end_test);
}
