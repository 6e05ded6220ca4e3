// SPDX-License-Identifier: MIT
// Random walks inside closed bodies against laws that hold for every body (METHODS §9).
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
#include "prt/medium.h"
#include "prt/reference.h"
#include "prt/surface.h"
#include "prt/walk.h"

static struct prt_context context;

static void ignore_log(void *user, enum prt_log_level level, const char *line)
{
}

static struct prt_mesh *ball(body_radius radius, double radius_mm)
{
    struct model m;
    model_init(&m, 96 * 49, 96 * 48 * 2);
    if (radius) add_ball(&m, 96, 48, 48, radius);
    else add_round_ball(&m, 96, 48, radius_mm);
    return body_mesh(&context, &m, true);
}

static struct prt_mesh *box(float x, float y, float z, uint32_t n)
{
    struct model m;
    model_init(&m, 6 * (n + 1) * (n + 1), 12 * n * n);
    add_box(&m, (float[]){0, 0, 0}, (float[]){x / 2, y / 2, z / 2}, n);
    return body_mesh(&context, &m, false);
}

struct body {
    struct prt_mesh *mesh;
    struct prt_scene *scene;
    struct prt_walk_space *space;
};

static struct body body(struct prt_mesh *mesh)
{
    struct body b = {.mesh = mesh};
    assert_int_equal(prt_scene_create(&context, mesh, &b.scene), PRT_OK);
    assert_int_equal(prt_walk_space_create(&context, b.scene, &b.space), PRT_OK);
    return b;
}

static void end(struct body *b)
{
    prt_walk_space_destroy(b->space);
    prt_scene_destroy(b->scene);
    prt_mesh_destroy(b->mesh);
}

// Sums over the exits of walks by order: no scattering, one, two and more.
struct sums {
    double n[3], length, length2, scatterings;
};

static void add_exit(void *arg, const struct prt_walk_exit *exit)
{
    struct sums *s = arg;
    unsigned order = exit->scatterings < 2 ? exit->scatterings : 2;
    s->n[order]++;
    s->length += exit->length_mm;
    s->length2 += (double)exit->length_mm * exit->length_mm;
    s->scatterings += exit->scatterings;
}

static struct prt_walk_counts run(const struct body *b, uint32_t n_start, uint32_t n_walk,
                                  struct prt_walk_medium medium, struct sums *sums)
{
    struct prt_walk_counts counts = {0};
    struct prt_surface_points *points;
    assert_int_equal(prt_surface_create(&context, b->mesh, n_start, 1, 7, &points), PRT_OK);
    for (uint32_t i = 0; i < points->n_sample; i++) {
        struct prt_walk_start start = {.seed = i + 1};
        memcpy(start.position, points->position[i], sizeof start.position);
        memcpy(start.normal, points->face_normal[i], sizeof start.normal);
        prt_walk_run(b->space, &start, &medium, n_walk, add_exit, sums, &counts);
    }
    prt_surface_destroy(points);
    return counts;
}

// Law: without absorption every walk leaves a closed body, so that B = 1 where E = 1 (METHODS
// §9, furnace).
static void every_walk_leaves(void **state)
{
    struct body bodies[] = {body(ball(NULL, 10)), body(ball(dented_ball, 0)),
                            body(ball(fluted_ball, 0)), body(box(20, 2, 20, 8))};
    static const float sigma[] = {0.1f, 1, 3};
    for (unsigned i = 0; i < 4; i++) {
        for (unsigned k = 0; k < 3; k++) {
            struct sums sums = {0};
            struct prt_walk_counts c =
                run(&bodies[i], 64, 256, (struct prt_walk_medium){sigma[k], 1.3f, 0}, &sums);
            expect_below("share of walks that do not leave", 1 - (double)c.exits / c.walks,
                         3e-4);
            assert_true(c.exits == sums.n[0] + sums.n[1] + sums.n[2]);
        }
        end(&bodies[i]);
    }
}

static void add_crossing(void *arg, const struct prt_walk_exit *exit)
{
    if (!exit->scatterings) *(double *)arg += (double)exit->weight;
}

static void add_straight(void *arg, const struct prt_walk_exit *exit)
{
    *(double *)arg += (double)exit->weight * exp(-0.1 * (double)exit->length_mm);
}

// Law: of the walks of one start as many cross a body unscattered as straight paths say; they
// err by no more than walks with independent random numbers would (METHODS §9, estimator).
static void walks_of_a_start_are_stratified(void **state)
{
    enum { STARTS = 64, WALKS = 8192, PATHS = 4096 };
    struct body b = body(ball(dented_ball, 0));
    double square = 0;
    for (uint32_t i = 0; i < STARTS; i++) {
        struct prt_walk_start start;
        struct prt_walk_counts counts = {0};
        double got = 0, want = 0;
        prt_walk_start_at(b.space, i * (b.mesh->n_vertex / STARTS), 0, i + 1, &start);
        prt_walk_run(b.space, &start, &(struct prt_walk_medium){0.1f, 1.3f, 0}, WALKS,
                     add_crossing, &got, &counts);
        prt_walk_unscattered(b.space, &start, 1.3f, 0.1f, PATHS, add_straight, &want);
        got /= WALKS, want /= PATHS;
        square += (got - want) * (got - want) * WALKS / (want * (1 - want)) / STARTS;
    }
    expect_below("deviation over that of independent walks", sqrt(square), 1);
    end(&b);
}

// A slab between plane boundaries of reflectance r(mu), solved without random numbers: the
// collision density in cells of equal optical depth, order by order, for light that enters at
// depth 0 as it would from an even environment. Optical depths count sigma_s' alone; absorption
// shortens every path by `loss` = 1 + sigma_a / sigma_s'.
enum { CELLS = 160, DIRECTIONS = 200, ORDERS = 3 };
struct slab {
    double near[ORDERS], far[ORDERS]; // exits after 0, 1, 2 and more scatterings, of light 1
};

static double boundary_reflectance(double eta, double inside)
{
    double sine2 = eta * eta * (1 - inside * inside);
    return sine2 >= 1 ? 1 : 1 - prt_fresnel_transmittance(eta, sqrt(1 - sine2));
}

static void solve_slab(double depth, double loss, double eta, struct slab *out)
{
    static double kernel[CELLS][CELLS], to_near[CELLS], to_far[CELLS];
    double source[CELLS] = {0}, h = depth / CELLS, flux = 0;
    memset(kernel, 0, sizeof kernel);
    memset(to_near, 0, sizeof to_near);
    memset(to_far, 0, sizeof to_far);
    memset(out, 0, sizeof *out);
    // The light that enters: outside cosines with the density 2 mu F_t.
    for (int k = 0; k < 4 * DIRECTIONS; k++) {
        double mu = (k + 0.5) / (4 * DIRECTIONS);
        flux += mu * prt_fresnel_transmittance(eta, mu);
    }
    for (int k = 0; k < 4 * DIRECTIONS; k++) {
        double mu = (k + 0.5) / (4 * DIRECTIONS);
        double share = mu * prt_fresnel_transmittance(eta, mu) / flux;
        double m = sqrt(1 - (1 - mu * mu) / (eta * eta)), r = boundary_reflectance(eta, m);
        double through = exp(-loss * depth / m), all = 1 / (1 - r * r * through * through);
        out->far[0] += share * (1 - r) * through * all;
        out->near[0] += share * (1 - r) * r * through * through * all;
        double cell = (1 - exp(-loss * h / m)) / loss;
        for (int i = 0; i < CELLS; i++)
            source[i] +=
                share * all * cell *
                (exp(-loss * i * h / m) + r * through * exp(-loss * (CELLS - 1 - i) * h / m));
    }
    // Isotropic emission in cell j, per direction: direct, reflected once at either side, and
    // at both; then all further round trips.
    for (int k = 0; k < DIRECTIONS; k++) {
        double m = (k + 0.5) / DIRECTIONS, w = 0.5 / DIRECTIONS;
        double r = boundary_reflectance(eta, m), a = loss / m, e = exp(-a * h);
        double through = exp(-a * depth), all = 1 / (1 - r * r * through * through);
        double pass = (1 - e) / (a * h), caught = (1 - e) / loss;
        for (int j = 0; j < CELLS; j++) {
            double up = exp(-a * j * h) * pass, down = exp(-a * (CELLS - 1 - j) * h) * pass;
            to_near[j] += w * (1 - r) * all * (up + r * through * down);
            to_far[j] += w * (1 - r) * all * (down + r * through * up);
            for (int i = 0; i < CELLS; i++) {
                double fall_in = exp(-a * i * h), rise_in = exp(-a * (CELLS - 1 - i) * h);
                double direct = i == j ? 2 * (1 - pass) / loss
                                       : pass * caught * exp(-a * (abs(i - j) - 1) * h);
                kernel[i][j] += w * direct;
                // Rays that were reflected an odd or even number of times.
                kernel[i][j] += w * all * caught * r *
                                (up * fall_in + down * rise_in +
                                 r * through * (up * rise_in + down * fall_in));
            }
        }
    }
    for (int order = 1; order < 20000; order++) {
        double next[CELLS], sum = 0;
        for (int i = 0; i < CELLS; i++) {
            int at = order < 2 ? order : 2;
            out->near[at] += source[i] * to_near[i];
            out->far[at] += source[i] * to_far[i];
            next[i] = 0;
            for (int j = 0; j < CELLS; j++) next[i] += kernel[i][j] * source[j];
            sum += next[i];
        }
        memcpy(source, next, sizeof source);
        if (sum < 1e-9) break;
    }
}

struct sides {
    double near[ORDERS], far[ORDERS], sigma_a;
    const struct prt_mesh *mesh;
};

static void add_side(void *arg, const struct prt_walk_exit *exit)
{
    struct sides *s = arg;
    unsigned order = exit->scatterings < 2 ? exit->scatterings : 2;
    double weight = exp(-s->sigma_a * exit->length_mm);
    float y = s->mesh->position[s->mesh->triangle[exit->triangle][0]][1];
    (y > 0 ? s->near : s->far)[order] += weight;
}

// Law: a slab under even light reflects and transmits as transport theory says, order by order:
// walks against the collision densities of the same slab (METHODS §9, slabs).
static void slabs_follow_transport_theory(void **state)
{
    static const struct {
        double sigma_s_prime, sigma_a, eta;
    } media[] = {{2.19, 0.0021, 1.5}, {0.7, 0.0014, 1.3}, {0.74, 0.032, 1.3}, {0.88, 0.17, 1}};
    enum { WALKS = 100000 };
    struct body slab = body(box(60, 2, 60, 2));
    for (unsigned i = 0; i < sizeof media / sizeof *media; i++) {
        struct slab want;
        struct sides got = {.sigma_a = media[i].sigma_a, .mesh = slab.mesh};
        struct prt_walk_counts counts = {0};
        struct prt_walk_start start = {
            .position = {1, 1, 2}, .normal = {0, 1, 0}, .seed = i + 1};
        solve_slab(2 * media[i].sigma_s_prime, 1 + media[i].sigma_a / media[i].sigma_s_prime,
                   media[i].eta, &want);
        prt_walk_run(
            slab.space, &start,
            &(struct prt_walk_medium){(float)media[i].sigma_s_prime, (float)media[i].eta, 0},
            WALKS, add_side, &got, &counts);
        for (unsigned order = 0; order < ORDERS; order++) {
            double near = got.near[order] / WALKS, far = got.far[order] / WALKS;
            print_message("  %.3g %.3g: order %u near %.4f (%.4f) far %.4f (%.4f)\n",
                          media[i].sigma_s_prime, media[i].sigma_a, order, near,
                          want.near[order], far, want.far[order]);
            expect_below("reflected share, difference", fabs(near - want.near[order]), 0.005);
            expect_below("transmitted share, difference", fabs(far - want.far[order]), 0.005);
        }
    }
    end(&slab);
}

// The welded vertex nearest to the middle of the upper face.
static uint32_t middle_vertex(const struct prt_mesh *mesh)
{
    uint32_t best = 0;
    float least = INFINITY;
    for (uint32_t v = 0; v < mesh->n_vertex; v++) {
        const float *p = mesh->position[v];
        float d = p[0] * p[0] + p[2] * p[2];
        if (mesh->normal[v][1] > 0.9f && d < least) least = d, best = v;
    }
    return best;
}

// Law: under an even environment the middle of a wide slab has the exitance of transport
// theory: E (near + far), for each order (METHODS §9, slabs), and the reference says how exact
// it is.
static void reference_of_a_slab(void **state)
{
    static const char *const name[] = {"marble", "skimmilk", "skin1"};
    struct prt_mesh *mesh = box(40, 2, 40, 8);
    struct prt_cube light;
    uint32_t vertex = middle_vertex(mesh);
    assert_int_equal(prt_cube_init(&light, 16), PRT_OK);
    for (uint32_t i = 0; i < 6 * 16 * 16 * 3; i++) light.texel[i] = 1;
    for (unsigned i = 0; i < 3; i++) {
        struct prt_material m;
        assert_int_equal(prt_material_load(&context, name[i], &m), PRT_OK);
        float color[3], error[3], (*errors)[3] = &error;
        struct prt_reference_options options = {.term = PRT_REFERENCE_MULTIPLE,
                                                .n_sample = 4000,
                                                .n_ray = 256,
                                                .vertex = &vertex,
                                                .n_vertex = 1,
                                                .n_walk = 20000,
                                                .standard_error = &errors};
        double e = M_PI * prt_fresnel_mean_transmittance((double)m.eta);
        for (unsigned term = 0; term < 2; term++) {
            options.term = term ? PRT_REFERENCE_UNSCATTERED : PRT_REFERENCE_MULTIPLE;
            assert_int_equal(prt_reference_colors(&context, mesh,
                                                  &(struct prt_media){1, &m, NULL}, &light,
                                                  &options, &color),
                             PRT_OK);
            for (int c = 0; c < 3; c++) {
                struct slab want;
                double s = (double)m.sigma_s_prime[c];
                solve_slab(2 * s, 1 + (double)m.sigma_a[c] / s, (double)m.eta, &want);
                double sum = term ? want.near[0] + want.far[0] : want.near[2] + want.far[2];
                expect_near(term ? "unscattered over E/pi" : "multiple over E/pi",
                            (double)color[c] * M_PI / e, sum, 0.012);
                expect_below("standard error over E/pi", (double)error[c] * M_PI / e, 0.005);
                assert_true(error[c] > 0);
            }
        }
    }
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: transport theory for a slab of 2 mm, lit evenly from both sides: what leaves it after
// one scattering or more (METHODS §9; the walk column of README's table, rounded to its
// digits).
static void walk_column_of_the_readme(void **state)
{
    static const struct {
        const char *medium;
        int channel;
        double want;
    } row[] = {
        {"marble", 0, 0.97}, {"skimmilk", 0, 0.81}, {"skin1", 0, 0.66}, {"skin1", 1, 0.36}};
    for (int i = 0; i < 4; i++) {
        struct prt_material m;
        struct slab slab;
        const int c = row[i].channel;
        assert_int_equal(prt_material_load(&context, row[i].medium, &m), PRT_OK);
        const double s = (double)m.sigma_s_prime[c], a = (double)m.sigma_a[c];
        solve_slab(2 * s, 1 + a / s, (double)m.eta, &slab);
        expect_near(expect_name("2 mm of %s, channel %d", row[i].medium, c),
                    slab.near[1] + slab.near[2] + slab.far[1] + slab.far[2], row[i].want,
                    0.006);
    }
}

// Contract of prt_reference_colors: a profile has no walk.
static void profiles_have_no_walks(void **state)
{
    struct prt_mesh *mesh = box(4, 4, 4, 2);
    struct prt_cube light;
    struct prt_material m;
    float color[3];
    uint32_t vertex = 0;
    struct prt_reference_options options = {.vertex = &vertex, .n_vertex = 1, .n_walk = 16};
    assert_int_equal(prt_cube_init(&light, 16), PRT_OK);
    assert_int_equal(prt_material_load(&context,
                                       "{\"profile\":\"burley\",\"albedo\":[0.8,0.5,0.3],"
                                       "\"mean_free_path\":[1,0.5,0.3]}",
                                       &m),
                     PRT_OK);
    struct prt_context quiet = context;
    quiet.log = ignore_log;
    assert_int_equal(prt_reference_colors(&quiet, mesh, &(struct prt_media){1, &m, NULL},
                                          &light, &options, &color),
                     PRT_MISMATCH);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Law: the mean length of walks that start on a closed surface is 4 V eta^2 / (S T), for every
// sigma_s' (METHODS §9, mean path).
static void mean_length_is_invariant(void **state)
{
    static const struct {
        float sigma, eta;
    } media[] = {{0.3f, 1.3f}, {1, 1.5f}, {2, 1}};
    struct body bodies[] = {body(ball(NULL, 5)), body(box(10, 2, 10, 8))};
    for (unsigned i = 0; i < 2; i++) {
        for (unsigned k = 0; k < 3; k++) {
            struct sums sums = {0};
            run(&bodies[i], 8192, 32, (struct prt_walk_medium){media[k].sigma, media[k].eta, 0},
                &sums);
            double n = sums.n[0] + sums.n[1] + sums.n[2], mean = sums.length / n;
            double want = prt_walk_mean_length(bodies[i].space, 0, media[k].eta);
            double error = sqrt((sums.length2 / n - mean * mean) / n);
            expect_below("relative deviation of the mean length", fabs(mean / want - 1), 0.012);
            expect_below("the same, in standard errors", fabs(mean - want) / error, 3.5);
            expect_below("scatterings over sigma_s' times length",
                         fabs(sums.scatterings / n / (media[k].sigma * mean) - 1), 0.012);
        }
        end(&bodies[i]);
    }
}

// Law: a body's volume is that within all of its faces, its area that of the faces by which
// light leaves: an opaque face bounds it, too (METHODS §9, mean path).
static void opaque_faces_bound_the_body(void **state)
{
    enum { SIDE = 4, FACE = 2 * SIDE * SIDE, CORNERS = (SIDE + 1) * (SIDE + 1) };
    struct prt_mesh *mesh = box(4, 6, 8, SIDE);
    struct prt_surface surface[2] = {mesh->surface[0], {.name = "lid"}};
    double lid = 0;
    for (uint32_t t = 5 * FACE; t < 6 * FACE; t++) {
        const float *p[3];
        double n[3];
        for (int j = 0; j < 3; j++) p[j] = mesh->position[mesh->triangle[t][j]];
        for (int k = 0; k < 3; k++) {
            const int a = (k + 1) % 3, b = (k + 2) % 3;
            n[k] = (double)(p[1][a] - p[0][a]) * (double)(p[2][b] - p[0][b]) -
                   (double)(p[1][b] - p[0][b]) * (double)(p[2][a] - p[0][a]);
        }
        lid += sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]) / 2;
    }
    struct prt_block block[2] = {{0, 0, 0, 5 * CORNERS, 0, 5 * FACE},
                                 {0, 1, 5 * CORNERS, CORNERS, 5 * FACE, FACE}};
    mesh->surface = surface, mesh->n_surface = 2;
    mesh->block = block, mesh->n_block = 2;
    struct body b = body(mesh);
    expect_above("area of the opaque face", lid, 23);
    expect_close("volume of a box with an opaque face", prt_walk_volume(b.space, 0), 192, 1e-6);
    expect_close("area of its other faces", prt_walk_area(b.space, 0), 208 - lid, 1e-6);
    end(&b);
}

int main(void)
{
    prt_context_init(&context);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_walk_leaves),
        cmocka_unit_test(walks_of_a_start_are_stratified),
        cmocka_unit_test(mean_length_is_invariant),
        cmocka_unit_test(slabs_follow_transport_theory),
        cmocka_unit_test(reference_of_a_slab),
        cmocka_unit_test(walk_column_of_the_readme),
        cmocka_unit_test(profiles_have_no_walks),
        cmocka_unit_test(opaque_faces_bound_the_body),
    };
    return run_physics_tests(tests, NULL, NULL);
}
