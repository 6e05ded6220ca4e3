// SPDX-License-Identifier: MIT
// Law: single scattering with a phase function cut to 1, 4 or 9 spherical harmonics (W05 eq 10,
// 11) is what the reference engine estimates along -n_o with the same cut phase function. The
// channels scatter forward, backward and strongly forward, so that a wrong sign of the odd
// Legendre terms and sigma_s' in place of sigma_s both show.
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
#include "bake/run.h"
#include "trace/triangle_grid.h"
#include "prt/reference.h"
#include "prt/relight.h"

static struct prt_context context;
static const float eye[3] = {30, 22, 41};

// A ball of about 16 mm with shallow dents.
static double shallow_dents(double theta, double phi)
{
    return 8 + 0.6 * sin(3 * phi) * sin(theta) * sin(theta);
}

static struct prt_mesh *body(void)
{
    struct model m;
    model_init(&m, 28 * 15, 28 * 14 * 2);
    add_ball(&m, 28, 14, 14, shallow_dents);
    return body_mesh(&context, &m, false);
}

// A dim sky and two lamps of a few texels, one on the side of the eye and one opposite.
static struct prt_cube light_of(uint32_t n)
{
    struct prt_cube cube;
    assert_int_equal(prt_cube_init(&cube, n), PRT_OK);
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        uint32_t face = i / (n * n), y = i / n % n, x = i % n;
        bool lamp = face >= 4 && x > n / 2 && x < n / 2 + 4 && y > 4 && y < 8;
        for (uint32_t c = 0; c < 3; c++) cube.texel[i * 3 + c] = 0.1f + (lamp ? 20 : 0);
    }
    return cube;
}

// The asymmetry is 0.25, -0.3 and 0.8; the mean free path of scattering, 1/sigma_s, is near 1
// mm in every channel, so that light crosses a good part of the body.
static const struct prt_material *medium(void)
{
    static struct prt_material m = {.eta = 1.3f, .roughness = 0.3f, .g = {0.25f, -0.3f, 0.8f}};
    static const float sigma_s[3] = {1, 0.8f, 1.2f}, sigma_a[3] = {0.02f, 0.05f, 0.1f};
    for (int c = 0; c < 3; c++) {
        m.sigma_s_prime[c] = sigma_s[c] * (1 - m.g[c]);
        m.sigma_a[c] = sigma_a[c];
    }
    snprintf(m.name, sizeof m.name, "anisotropic");
    return &m;
}

// w_o' at a vertex: the outward direction inside the body that leaves towards the eye. False
// where the vertex faces away.
static bool inside_direction(const struct prt_mesh *mesh, uint32_t v, double eta, float out[3])
{
    double w[3], length = 0, c = 0;
    for (int k = 0; k < 3; k++) w[k] = (double)eye[k] - (double)mesh->position[v][k];
    for (int k = 0; k < 3; k++) length += w[k] * w[k];
    for (int k = 0; k < 3; k++) {
        w[k] /= sqrt(length);
        c += w[k] * (double)mesh->normal[v][k];
    }
    double root = sqrt(1 - (1 - c * c) / (eta * eta));
    for (int k = 0; k < 3; k++)
        out[k] = (float)(w[k] / eta + (root - c / eta) * (double)mesh->normal[v][k]);
    return c > 0.05; // grazing views are left out: the reference gives them no light at c <= 0
}

// straight: along -n_o, as single scattering is baked; else along the refracted path.
static void reference(const struct prt_mesh *mesh, const struct prt_material *m,
                      const struct prt_cube *light, unsigned n_term, bool straight,
                      float (*out)[3])
{
    struct prt_reference_options o = {.term = PRT_REFERENCE_SINGLE,
                                      .eye = eye,
                                      .straight_single = straight,
                                      .n_single = 4096,
                                      .n_phase_term = n_term,
                                      .seed = 5};
    const struct prt_media media = prt_media_one(m);
    assert_int_equal(prt_reference_colors(&context, mesh, &media, light, &o, out), PRT_OK);
}

// Relative RMSE of each channel over the vertices that face the eye.
static void channel_errors(const struct prt_mesh *mesh, const float (*got)[3],
                           const float (*want)[3], double out[3])
{
    double difference[3] = {0}, norm[3] = {0};
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        float w[3];
        if (!inside_direction(mesh, v, 1.3, w)) continue;
        for (int c = 0; c < 3; c++) {
            double d = (double)got[v][c] - (double)want[v][c];
            difference[c] += d * d;
            norm[c] += (double)want[v][c] * (double)want[v][c];
        }
    }
    for (int c = 0; c < 3; c++) out[c] = sqrt(difference[c] / norm[c]);
}

// L1 of every vertex from its rows: sum over harmonics k of Y_k(w_o') row_k . light.
static void shade(const struct bake *b, const struct prt_cube *light, float (*out)[3])
{
    const struct directions *d = b->directions;
    struct fresnel_table fresnel;
    uint32_t K = b->single[0].n_phase, n = d->n_coef;
    float *row = prt_alloc((size_t)K * 3 * n, sizeof *row);
    void *scratch = prt_alloc(prt_single_scratch_bytes(&b->single[0]), 1);
    assert_true(row && scratch);
    prt_fresnel_table_init(&fresnel, b->o.media.medium->eta);
    for (uint32_t v = 0; v < b->mesh->n_vertex; v++) {
        float w[3], y[9];
        memset(out[v], 0, sizeof out[v]);
        if (!inside_direction(b->mesh, v, 1.3, w)) continue;
        prt_sh_eval(3, w, y);
        prt_single_rows(&b->single[0], &fresnel, v, row, scratch);
        for (uint32_t k = 0; k < K; k++)
            for (uint32_t c = 0; c < 3; c++)
                for (uint32_t t = 0; t < n; t++)
                    out[v][c] += y[k] * row[((size_t)k * 3 + c) * n + t] * d->solid_angle[t] *
                                 light->texel[t * 3 + c];
    }
    prt_free(row);
    prt_free(scratch);
}

// Law: rows of a vertex give the reference's L1 (W05 eq 10), by the bake's plan (METHODS §3.5)
// and by W05's own sum over points (W05 eq 12).
static void rows_agree_with_the_reference(void **state)
{
    static const unsigned terms[] = {1, 4, 9};
    struct prt_mesh *mesh = body();
    struct prt_cube light = light_of(16);
    struct bake b = {.ctx = &context, .mesh = mesh};
    float(*want)[3] = calloc(mesh->n_vertex, sizeof *want);
    float(*got)[3] = calloc(mesh->n_vertex, sizeof *got);
    assert_true(want && got);
    b.o.media = prt_media_one(medium());
    b.o.n_single = 32;
    assert_int_equal(prt_scene_create(&context, mesh, &b.scene), PRT_OK);
    assert_int_equal(prt_directions_create(context.cpu, 16, 4, 1, &b.directions), PRT_OK);
    for (int i = 0; i < 3; i++) {
        reference(mesh, b.o.media.medium, &light, terms[i], true, want);
        b.o.n_phase = terms[i];
        for (int every = 0; every < 2; every++) {
            double error[3];
            b.o.every_ray = every;
            assert_int_equal(prt_bake_plan_single(&b, NULL, 0), PRT_OK);
            shade(&b, &light, got);
            prt_bake_unplan_single(&b);
            channel_errors(mesh, (const float(*)[3])got, (const float(*)[3])want, error);
            print_message("%u terms%s: %.2f %%, %.2f %%, %.2f %%\n", terms[i],
                          every ? ", every ray" : "", 100 * error[0], 100 * error[1],
                          100 * error[2]);
            for (int c = 0; c < 3; c++)
                expect_below(expect_name("%u terms%s: relative RMSE", terms[i],
                                         every ? ", every ray" : ""),
                             error[c], every ? 0.015 : 0.02);
        }
    }
    prt_horizon_destroy(b.horizon);
    prt_triangle_grid_destroy(b.grid);
    prt_directions_destroy(b.directions);
    prt_scene_destroy(b.scene);
    free(want), free(got);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// The mean light of each vertex along -n_o from its rows, isotropic.
static void shade_straight(const struct bake *b, const struct prt_cube *light,
                           const uint32_t *vertex, uint32_t n_vertex, float (*out)[3])
{
    const struct directions *d = b->directions;
    struct fresnel_table fresnel;
    float *row = prt_alloc(3 * (size_t)d->n_coef, sizeof *row);
    void *scratch = prt_alloc(prt_single_scratch_bytes(&b->single[0]), 1);
    assert_true(row && scratch);
    prt_fresnel_table_init(&fresnel, b->o.media.medium->eta);
    for (uint32_t i = 0; i < n_vertex; i++) {
        (void)prt_single_rows(&b->single[0], &fresnel, vertex[i], row, scratch);
        for (int c = 0; c < 3; c++) {
            double sum = 0;
            for (uint32_t t = 0; t < d->n_coef; t++)
                sum += (double)row[(size_t)c * d->n_coef + t] * (double)d->solid_angle[t] *
                       (double)light->texel[t * 3 + (uint32_t)c];
            out[i][c] = (float)(sum / sqrt(4 * M_PI)); // Y_00
        }
    }
    prt_free(row);
    prt_free(scratch);
}

// Law: in the folds of a finely divided body, where shadows are shares of the horizon's bins
// (METHODS §3.5), single scattering is the reference's under lamps of a few texels.
static void shadows_agree_with_the_reference(void **state)
{
    enum { PARTS = 80, EVERY = 97, N = 2 * PARTS * (PARTS + 1) / EVERY };
    struct model model;
    model_init(&model, 2 * PARTS * (PARTS + 1), 4 * PARTS * PARTS);
    add_ball(&model, 2 * PARTS, PARTS, PARTS, fluted_ball);
    struct prt_mesh *mesh = body_mesh(&context, &model, false);
    struct prt_material m = *medium();
    struct prt_cube light = light_of(32);
    const struct prt_cube *lights[] = {&light};
    struct bake b = {.ctx = &context, .mesh = mesh};
    uint32_t vertex[N];
    float want[N][3], got[N][3], (*const out[1])[3] = {want};
    for (uint32_t i = 0; i < N; i++) vertex[i] = i * EVERY + 40;
    for (int c = 0; c < 3; c++) m.g[c] = 0;
    b.o.media = prt_media_one(&m);
    b.o.n_phase = 1;
    b.o.n_single = 32;
    const struct prt_reference_options o = {.term = PRT_REFERENCE_SINGLE,
                                            .straight_single = true,
                                            .n_single = 16384,
                                            .seed = 5,
                                            .vertex = vertex,
                                            .n_vertex = N};
    assert_int_equal(prt_reference_many(&context, mesh, 1, &b.o.media, 1, lights, &o, out),
                     PRT_OK);
    assert_int_equal(prt_scene_create(&context, mesh, &b.scene), PRT_OK);
    assert_int_equal(prt_directions_create(context.cpu, 32, 4, 1, &b.directions), PRT_OK);
    assert_int_equal(prt_bake_plan_single(&b, NULL, 0), PRT_OK);
    shade_straight(&b, &light, vertex, N, got);
    const double error = prt_relative_rmse(got[0], want[0], (size_t)N * 3);
    print_message("%d vertices of a fluted ball: %.2f %%\n", N, 100 * error);
    expect_below("relative RMSE in folds", error, 0.009);
    prt_bake_unplan_single(&b);
    prt_horizon_destroy(b.horizon);
    prt_triangle_grid_destroy(b.grid);
    prt_directions_destroy(b.directions);
    prt_scene_destroy(b.scene);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Answers of a baked file towards the eye.
static void bake_and_answer(const struct prt_mesh *mesh, const struct prt_bake_options *o,
                            const struct prt_cube *light, float (*out)[3])
{
    char path[] = "/tmp/prt-phases-XXXXXX";
    int fd = mkstemp(path);
    assert_true(fd >= 0);
    close(fd);
    assert_int_equal(prt_bake(&context, mesh, o, path), PRT_OK);
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    struct prt_query q = {.term = PRT_ANSWER_SINGLE, .light = light, .eye = eye};
    assert_int_equal(prt_answer_colors(&context, prt_file_transport(f), &q, out), PRT_OK);
    prt_file_close(f);
    unlink(path);
}

// Law: a baked file gives the reference's L1 for an eye (W05 eq 10, METHODS §3.6): along the
// refracted path as far as the correction of -n_o goes, which depends on the body, and with
// planes of exit as far as harmonics of degree 2 follow the exact phase function. Answers along
// -n_o are farther from the reference.
static void a_baked_file_agrees_with_the_reference(void **state)
{
    // for the last channel, g = 0.8, degree 2 is far too low
    static const double most[2][3] = {{0.12, 0.12, 0.12}, {0.05, 0.05, INFINITY}};
    struct prt_mesh *mesh = body();
    struct prt_cube light = light_of(16);
    float(*want)[3] = calloc(mesh->n_vertex, sizeof *want);
    float(*got)[3] = calloc(mesh->n_vertex, sizeof *got);
    float(*along)[3] = calloc(mesh->n_vertex, sizeof *along);
    assert_true(want && got && along);
    for (int view = 0; view < 2; view++) {
        const unsigned n_term = view ? 0 : 9; // 0: the exact phase function
        const struct prt_bake_options o = {.media = prt_media_one(medium()),
                                           .n_sample = 2000,
                                           .cube = 16,
                                           .n_phase = 9,
                                           .exit_planes = view,
                                           .seed = 1};
        double error[3], uncorrected[3];
        reference(mesh, o.media.medium, &light, n_term, false, want);
        reference(mesh, o.media.medium, &light, n_term, true, along);
        bake_and_answer(mesh, &o, &light, got);
        // a cut phase function may be negative, a colour of an answer is not
        for (uint32_t v = 0; v < mesh->n_vertex; v++)
            for (int c = 0; c < 3; c++) {
                want[v][c] = fmaxf(want[v][c], 0);
                along[v][c] = fmaxf(along[v][c], 0);
            }
        channel_errors(mesh, (const float(*)[3])along, (const float(*)[3])want, uncorrected);
        channel_errors(mesh, (const float(*)[3])got, (const float(*)[3])want, error);
        print_message("baked file, %s: %.2f %%, %.2f %%, %.2f %%; along -n_o %.2f %%, %.2f "
                      "%%, %.2f %%\n",
                      view ? "planes of exit" : "9 terms", 100 * error[0], 100 * error[1],
                      100 * error[2], 100 * uncorrected[0], 100 * uncorrected[1],
                      100 * uncorrected[2]);
        for (int c = 0; c < 3; c++) {
            expect_below("relative RMSE towards an eye", error[c], most[view][c]);
            if (most[view][c] < 1)
                expect_below("of the error without the correction", error[c] / uncorrected[c],
                             0.8);
        }
    }
    free(want), free(got), free(along);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    prt_context_init(&context);
    if (prt_pool_create(0, &context.pool)) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_agree_with_the_reference),
        cmocka_unit_test(shadows_agree_with_the_reference),
        cmocka_unit_test(a_baked_file_agrees_with_the_reference),
    };
    int failed = run_physics_tests(tests, NULL, NULL);
    prt_pool_destroy(context.pool);
    return failed;
}
