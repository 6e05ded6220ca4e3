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

#include "prt/reference.h"
#include "prt/surface.h"

static struct prt_context context;

static void make_light(struct prt_cube *cube, uint32_t n, float value)
{
    assert_int_equal(prt_cube_init(cube, n), PRT_OK);
    for (uint32_t i = 0; i < 6 * n * n * 3; i++) cube->texel[i] = value;
}

// Latitude-longitude sphere of radius r mm with exact normals.
static struct prt_mesh *sphere(float r)
{
    enum { U = 48, V = 24 };
    static float p[U * (V + 1)][3], n[U * (V + 1)][3];
    static uint32_t t[U * V * 2][3];
    uint32_t nt = 0;
    for (int j = 0; j <= V; j++)
        for (int i = 0; i < U; i++) {
            double th = M_PI * j / V, ph = 2 * M_PI * i / U;
            float d[3] = {(float)(sin(th) * cos(ph)), (float)cos(th),
                          (float)(sin(th) * sin(ph))};
            for (int k = 0; k < 3; k++) n[j * U + i][k] = d[k], p[j * U + i][k] = r * d[k];
        }
    for (int j = 0; j < V; j++)
        for (int i = 0; i < U; i++) {
            uint32_t a = (uint32_t)(j * U + i), b = (uint32_t)(j * U + (i + 1) % U);
            if (j > 0) memcpy(t[nt++], ((uint32_t[3]){a, b, a + U}), 12);
            if (j < V - 1) memcpy(t[nt++], ((uint32_t[3]){b, b + U, a + U}), 12);
        }
    struct prt_mesh *mesh;
    assert_int_equal(prt_mesh_create(&context, U * (V + 1), (const float(*)[3])p,
                                     (const float(*)[3])n, nt, (const uint32_t(*)[3])t, &mesh),
                     PRT_OK);
    assert_int_equal(prt_mesh_scale(&context, mesh, 0, 1), PRT_OK);
    return mesh;
}

// A closed slab: size x thickness x size mm, g x g squares a side, flat normals. Vertex 0..g*g
// of the top come first.
static struct prt_mesh *slab(float size, float thickness, uint32_t g)
{
    uint32_t side = g + 1, nv = 2 * side * side, nt = 0;
    float(*p)[3] = calloc(nv + 16, sizeof *p), (*n)[3] = calloc(nv + 16, sizeof *n);
    uint32_t(*t)[3] = calloc(4 * g * g + 8 * g + 16, sizeof *t);
    for (uint32_t top = 0; top < 2; top++)
        for (uint32_t y = 0; y < side; y++)
            for (uint32_t x = 0; x < side; x++) {
                uint32_t v = top * side * side + y * side + x;
                p[v][0] = size * ((float)x / (float)g - 0.5f);
                p[v][1] = top ? -thickness : 0;
                p[v][2] = size * ((float)y / (float)g - 0.5f);
                n[v][1] = top ? -1 : 1;
            }
    for (uint32_t y = 0; y < g; y++)
        for (uint32_t x = 0; x < g; x++) {
            uint32_t a = y * side + x, b = a + 1, c = a + side, d = c + 1, o = side * side;
            memcpy(t[nt++], ((uint32_t[3]){a, c, b}), 12);
            memcpy(t[nt++], ((uint32_t[3]){b, c, d}), 12);
            memcpy(t[nt++], ((uint32_t[3]){o + a, o + b, o + c}), 12);
            memcpy(t[nt++], ((uint32_t[3]){o + b, o + d, o + c}), 12);
        }
    struct prt_mesh *mesh;
    assert_int_equal(prt_mesh_create(&context, nv, (const float(*)[3])p, (const float(*)[3])n,
                                     nt, (const uint32_t(*)[3])t, &mesh),
                     PRT_OK);
    assert_int_equal(prt_mesh_scale(&context, mesh, 0, 1), PRT_OK);
    free(p), free(n), free(t);
    return mesh;
}

static struct prt_material medium(const char *name)
{
    struct prt_material m;
    assert_int_equal(prt_material_load(&context, name, &m), PRT_OK);
    return m;
}

// Law: E on a convex body under a constant unit environment is 2 pi int F_t mu dmu.
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
        assert_int_equal(prt_reference_colors(&context, mesh, &m, &light, &o, color), PRT_OK);
        double mean = 0;
        for (uint32_t v = 48; v < mesh->n_vertex - 48; v++) {
            mean += color[v][1] / (mesh->n_vertex - 96.0);
            assert_true(fabs(color[v][1] / want[i].e - 1) < 0.003);
        }
        assert_true(fabs(mean / want[i].e - 1) < 0.001);
    }
    free(color);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: the sample areas add up to the surface's, whatever their number.
static void cells_cover_the_surface(void **state)
{
    struct prt_mesh *mesh = sphere(10);
    struct prt_surface_points *s;
    for (uint32_t n = 200; n < 30000; n *= 5) {
        double sum = 0;
        assert_int_equal(prt_surface_create(&context, mesh, n, 0.2f, 3, &s), PRT_OK);
        for (uint32_t i = 0; i < s->n_sample; i++) sum += s->area[i];
        assert_true(fabs(sum / prt_surface_area(mesh) - 1) < 1e-4);
        prt_surface_destroy(s);
    }
    prt_mesh_destroy(mesh);
}

// Law: on a large plane under uniform irradiance B = rho_d E (the far side's share is added in
// closed form: the slab is thick enough that it is far below the tolerance).
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
        assert_int_equal(prt_reference_colors(&context, mesh, &m, &light, &o, color), PRT_OK);
        double e = M_PI * prt_fresnel_mean_transmittance(m.eta);
        for (int c = 0; c < 3; c++) {
            prt_diffusion_init(&d, m.sigma_s_prime[c], m.sigma_a[c], m.eta);
            double inside = d.rho_d - prt_diffusion_tail(&d, 60) * 1.1;
            print_message("%s channel %d: pi L / (rho_d E) = %.5f\n", m.name, c,
                          color[0][c] * M_PI / (inside * e));
            assert_true(fabs(color[0][c] * M_PI / (inside * e) - 1) < 0.005);
        }
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: a half-space lit from one direction returns METHODS §8's closed form along -n_o.
static void single_scattering_of_a_half_space(void **state)
{
    struct prt_mesh *mesh = slab(400, 100, 4);
    struct prt_cube light;
    make_light(&light, 16, 0);
    uint32_t lit = (2 * 16 + 10) * 16 + 9, centre = 2 * 5 + 2; // a texel of +Y
    for (int c = 0; c < 3; c++) light.texel[lit * 3 + (uint32_t)c] = 1;
    struct prt_material m = medium("marble");
    struct prt_reference_options o = {
        .term = PRT_REFERENCE_SINGLE, .vertex = &centre, .n_vertex = 1, .n_single = 65536};
    float color[1][3];
    assert_int_equal(prt_reference_colors(&context, mesh, &m, &light, &o, color), PRT_OK);
    for (int c = 0; c < 3; c++) {
        double sum = 0, st = m.sigma_s_prime[c] + m.sigma_a[c];
        for (int k = 0; k < 64 * 64; k++) { // the texel's own integral
            double s = 2 * (9 + (k % 64 + 0.5) / 64) / 16 - 1,
                   t = 2 * (10 + (k / 64 + 0.5) / 64) / 16 - 1;
            double q = 1 + s * s + t * t, mu = 1 / sqrt(q);
            double mu_in = sqrt(1 - (1 - mu * mu) / (m.eta * m.eta));
            sum += prt_fresnel_transmittance(m.eta, mu) * m.sigma_s_prime[c] / (4 * M_PI) /
                   (st * (1 + 1 / mu_in)) * (2.0 / 16 / 64) * (2.0 / 16 / 64) / (q * sqrt(q));
        }
        print_message("channel %d: L1 / closed form = %.5f\n", c, color[0][c] / sum);
        assert_true(fabs(color[0][c] / sum - 1) < 0.01);
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: linear in the light; doubling the samples moves the answer by less than 0.5 %.
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
    assert_int_equal(prt_reference_colors(&context, mesh, &m, &light, &o, a), PRT_OK);
    assert_int_equal(prt_reference_colors(&context, mesh, &m, &twice, &o, b), PRT_OK);
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) b[i][c] *= 0.5f;
    assert_true(prt_relative_rmse(a[0], b[0], n * 3) < 1e-5);
    o.n_sample = 40000, o.n_ray = 2048, o.seed = 6;
    assert_int_equal(prt_reference_colors(&context, mesh, &m, &light, &o, b), PRT_OK);
    double moved = prt_relative_rmse(a[0], b[0], n * 3);
    print_message("doubling samples and rays moves it by %.3f %%\n", 100 * moved);
    assert_true(moved < 0.005);
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
        cmocka_unit_test(linear_and_converged),
    };
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    prt_pool_destroy(context.pool);
    return failed;
}
