// SPDX-License-Identifier: MIT
// The reference engine against closed forms (METHODS §1, 8).
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"
#include "prt/reference.h"
#include "prt/surface.h"

static struct prt_context context;

static void make_light(struct prt_cube *cube, uint32_t n, float value)
{
    assert_int_equal(prt_cube_init(cube, n), PRT_OK);
    for (uint32_t i = 0; i < 6 * n * n * 3; i++) cube->texel[i] = value;
}

// A sphere of radius r mm with exact normals.
static struct prt_mesh *sphere(double r)
{
    struct model m;
    model_init(&m, 48 * 25, 48 * 24 * 2);
    add_round_ball(&m, 48, 24, r);
    return body_mesh(&context, &m, true);
}

static struct prt_mesh *slab(float size, float thickness, uint32_t n)
{
    struct model m;
    model_init(&m, 2 * (n + 1) * (n + 1), 4 * n * n);
    add_slab(&m, size, thickness, n);
    return body_mesh(&context, &m, true);
}

static struct prt_material medium(const char *name)
{
    struct prt_material m;
    assert_int_equal(prt_material_load(&context, name, &m), PRT_OK);
    return m;
}

// Law: E on a convex body under a constant unit environment is 2 pi int F_t mu dmu (METHODS
// §1).
static void irradiance_of_a_convex_body(void **state)
{
    static const struct {
        const char *name;
        double e;
    } want[] = {{"skin1", 2.949541}, {"marble", 2.853264}};
    struct prt_mesh *mesh = sphere(10);
    struct prt_cube light;
    make_light(&light, 16, 1);
    float(*color)[3] = calloc(mesh->n_vertex, sizeof *color);
    for (int i = 0; i < 2; i++) {
        struct prt_material m = medium(want[i].name);
        struct prt_reference_options o = {.term = PRT_REFERENCE_IRRADIANCE, .seed = 1};
        assert_int_equal(prt_reference_colors(&context, mesh, &(struct prt_media){1, &m, NULL},
                                              &light, &o, color),
                         PRT_OK);
        double mean = 0;
        for (uint32_t v = 48; v < mesh->n_vertex - 48; v++) {
            mean += color[v][1] / (mesh->n_vertex - 96.0);
            expect_close("E at a vertex", color[v][1], want[i].e, 0.003);
        }
        expect_close("mean E", mean, want[i].e, 1e-5);
    }
    free(color);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: the sample areas A_i add up to the surface's, whatever their number (METHODS §3.1).
static void cells_cover_the_surface(void **state)
{
    struct prt_mesh *mesh = sphere(10);
    struct prt_surface_points *s;
    for (uint32_t n = 200; n < 30000; n *= 5) {
        double sum = 0;
        assert_int_equal(prt_surface_create(&context, mesh, n, 0.2f, 3, &s), PRT_OK);
        for (uint32_t i = 0; i < s->n_sample; i++) sum += s->area[i];
        expect_close("sum of areas over the surface's", sum / prt_surface_area(mesh), 1, 1e-7);
        prt_surface_destroy(s);
    }
    prt_mesh_destroy(mesh);
}

// Law: on a large plane under uniform irradiance B = rho_d E (METHODS §8). The slab's far side
// adds its own share in closed form, which the thickness keeps far below the tolerance.
static void plane_returns_rho_d(void **state)
{
    struct prt_mesh *mesh = slab(120, 60, 60);
    struct prt_cube light;
    make_light(&light, 16, 1);
    uint32_t centre = 30 * 61 + 30;
    for (int i = 0; i < 2; i++) {
        struct prt_material m = medium(i ? "ketchup" : "marble");
        struct prt_reference_options o = {.term = PRT_REFERENCE_MULTIPLE,
                                          .vertex = &centre,
                                          .n_vertex = 1,
                                          .n_sample = 100000,
                                          .n_ray = 1024};
        struct prt_diffusion d;
        float color[1][3];
        assert_int_equal(prt_reference_colors(&context, mesh, &(struct prt_media){1, &m, NULL},
                                              &light, &o, color),
                         PRT_OK);
        double e = M_PI * prt_fresnel_mean_transmittance(m.eta);
        for (int c = 0; c < 3; c++) {
            prt_diffusion_init(&d, m.sigma_s_prime[c], m.sigma_a[c], m.eta);
            double inside = d.rho_d - prt_diffusion_tail(&d, 60) * 1.1;
            expect_near(expect_name("%s channel %d: pi L / (rho_d E)", m.name, c),
                        color[0][c] * M_PI / (inside * e), 1, 7e-4);
        }
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// L1 of a half-space along -n_o, lit by texel (9,10) of a cube's +Y of 16 texels a side.
static double half_space(double sigma_s, double sigma_a, double eta)
{
    double sum = 0, st = sigma_s + sigma_a;
    for (int k = 0; k < 64 * 64; k++) { // the texel's own integral
        double s = 2 * (9 + (k % 64 + 0.5) / 64) / 16 - 1,
               t = 2 * (10 + (k / 64 + 0.5) / 64) / 16 - 1;
        double q = 1 + s * s + t * t, mu = 1 / sqrt(q);
        double mu_in = sqrt(1 - (1 - mu * mu) / (eta * eta));
        sum += prt_fresnel_transmittance(eta, mu) * sigma_s / (4 * M_PI) /
               (st * (1 + 1 / mu_in)) * (2.0 / 16 / 64) * (2.0 / 16 / 64) / (q * sqrt(q));
    }
    return sum;
}

// Law: a half-space lit from one direction returns the closed form of L1 along -n_o (METHODS
// §8). Without an eye scattering is isotropic, of sigma_s, whatever g is.
static void single_scattering_of_a_half_space(void **state)
{
    struct prt_mesh *mesh = slab(400, 100, 4);
    struct prt_cube light;
    make_light(&light, 16, 0);
    uint32_t lit = (2 * 16 + 10) * 16 + 9, centre = 2 * 5 + 2; // a texel of +Y
    for (int c = 0; c < 3; c++) light.texel[lit * 3 + (uint32_t)c] = 1;
    struct prt_reference_options o = {
        .term = PRT_REFERENCE_SINGLE, .vertex = &centre, .n_vertex = 1, .n_single = 65536};
    for (int k = 0; k < 2; k++) {
        struct prt_material m = medium("marble");
        float color[1][3];
        for (int c = 0; c < 3 && k; c++) m.g[c] = 0.3f * (float)(c - 1);
        assert_int_equal(prt_reference_colors(&context, mesh, &(struct prt_media){1, &m, NULL},
                                              &light, &o, color),
                         PRT_OK);
        for (int c = 0; c < 3; c++) {
            double want = half_space((double)m.sigma_s_prime[c] / (1 - (double)m.g[c]),
                                     (double)m.sigma_a[c], (double)m.eta);
            expect_near(expect_name("channel %d: L1 over the closed form", c),
                        color[0][c] / want, 1, 0.01);
        }
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// F_t over T of what leaves a vertex towards an eye, F_t's mean over T without one.
static double share_that_leaves(const struct prt_mesh *mesh, uint32_t v, const float *eye,
                                double eta)
{
    const double divisor = prt_exit_divisor(eta, PRT_EXIT_NORMALISED);
    double length = 0, cosine = 0;
    if (!eye) return prt_fresnel_mean_transmittance(eta) / divisor;
    for (int k = 0; k < 3; k++) {
        const double w = (double)eye[k] - (double)mesh->position[v][k];
        length += w * w;
        cosine += w * (double)mesh->normal[v][k];
    }
    cosine /= sqrt(length);
    return cosine > 0 ? prt_fresnel_transmittance(eta, fmin(cosine, 1)) / divisor : 0;
}

// Law: an exit takes F_t of a colour and the same share of its standard error (METHODS §1,
// exit; §9), towards an eye and without one.
static void errors_leave_as_colours(void **state)
{
    struct prt_mesh *mesh = sphere(2);
    struct prt_cube light;
    struct prt_material m = medium("skin1");
    const float eye[3] = {2, 1, 4};
    const uint32_t vertex = 12 * 48 + 4;
    make_light(&light, 16, 1);
    for (int k = 0; k < 2; k++) {
        float color[2][3], error[2][3], (*errors)[3];
        for (int leaves = 0; leaves < 2; leaves++) {
            struct prt_reference_options o = {.term = PRT_REFERENCE_TOTAL,
                                              .eye = k ? eye : NULL,
                                              .no_exit = !leaves,
                                              .n_sample = 2000,
                                              .n_ray = 64,
                                              .n_single = 64,
                                              .vertex = &vertex,
                                              .n_vertex = 1,
                                              .n_walk = 200,
                                              .standard_error = &errors};
            errors = &error[leaves];
            assert_int_equal(prt_reference_colors(&context, mesh,
                                                  &(struct prt_media){1, &m, NULL}, &light, &o,
                                                  &color[leaves]),
                             PRT_OK);
        }
        const double leave = share_that_leaves(mesh, vertex, k ? eye : NULL, (double)m.eta);
        for (int c = 0; c < 3; c++) {
            expect_near("share of the colour that leaves", (double)(color[1][c] / color[0][c]),
                        leave, 1e-5);
            expect_above("standard error over the colour", (double)(error[1][c] / color[1][c]),
                         1e-3);
            expect_near("share of the error that leaves over the colour's",
                        (double)(error[1][c] / error[0][c] * color[0][c] / color[1][c]), 1,
                        1e-5);
        }
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: B is linear in L; twice the samples and rays move it by less than 0.5 % (METHODS §8).
static void linear_and_converged(void **state)
{
    struct prt_mesh *mesh = sphere(8);
    struct prt_cube light, twice;
    make_light(&light, 16, 0.1f);
    make_light(&twice, 16, 0.2f);
    for (int c = 0; c < 3; c++) {
        light.texel[(2 * 256 + 70) * 3 + c] = 300;
        twice.texel[(2 * 256 + 70) * 3 + c] = 600;
    }
    struct prt_material m = medium("skin1");
    struct prt_reference_options o = {
        .term = PRT_REFERENCE_MULTIPLE, .n_sample = 20000, .n_ray = 1024, .seed = 5};
    size_t n = mesh->n_vertex;
    float(*a)[3] = calloc(n, sizeof *a), (*b)[3] = calloc(n, sizeof *b);
    assert_int_equal(
        prt_reference_colors(&context, mesh, &(struct prt_media){1, &m, NULL}, &light, &o, a),
        PRT_OK);
    assert_int_equal(
        prt_reference_colors(&context, mesh, &(struct prt_media){1, &m, NULL}, &twice, &o, b),
        PRT_OK);
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) b[i][c] *= 0.5f;
    expect_below("half of twice the light", prt_relative_rmse(a[0], b[0], n * 3), 1e-5);
    o.n_sample = 40000, o.n_ray = 2048, o.seed = 6;
    assert_int_equal(
        prt_reference_colors(&context, mesh, &(struct prt_media){1, &m, NULL}, &light, &o, b),
        PRT_OK);
    double moved = prt_relative_rmse(a[0], b[0], n * 3);
    expect_below("change with twice the samples and rays", moved, 4e-4);
    free(a), free(b);
    prt_cube_finish(&light);
    prt_cube_finish(&twice);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    prt_context_init(&context);
    prt_pool_create(0, &context.pool);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(irradiance_of_a_convex_body),
        cmocka_unit_test(cells_cover_the_surface),
        cmocka_unit_test(plane_returns_rho_d),
        cmocka_unit_test(single_scattering_of_a_half_space),
        cmocka_unit_test(errors_leave_as_colours),
        cmocka_unit_test(linear_and_converged),
    };
    int failed = run_physics_tests(tests, NULL, NULL);
    prt_pool_destroy(context.pool);
    return failed;
}
