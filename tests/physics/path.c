// SPDX-License-Identifier: MIT
// Law: the integral of single scattering along a vertex's path, from the exits of a few depths,
// is that of the paths between them (W05 eq 10, X07 eq 15, METHODS §3.5).
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "expect.h"
#include "bake/path_integral.h"
#include "prt/radial.h"

enum { N = 150 }; // directions: more than one tile, and no multiple of it

static struct prt_context context;
static struct fresnel_table fresnel;

// The exits that a direction has at depth s: n_o and light lie in one plane with the exits.
struct exit {
    double u;    // s + s' [mm]
    double ft;   // F_t V
    double w[3]; // w_i'
};
// The direction number t at a depth s of `end` mm.
typedef struct exit exit_function(int t, double s, double end);

// All of the surface is the tangent plane of the vertex.
static struct exit plane(int t, double s, double end)
{
    double cosine = 0.1 + 0.9 * t / N, sine2 = 1 - cosine * cosine;
    double inside = sqrt(1 - sine2 / (1.3 * 1.3)), phi = 0.7 * t;
    double sine = sqrt(1 - inside * inside);
    (void)end;
    return (struct exit){.u = s + s / inside,
                         .ft = fresnel_table_eval(&fresnel, (float)cosine),
                         .w = {sine * cos(phi), sine * sin(phi), inside}};
}

// The surface bends: the way out grows more slowly with depth, and its direction turns.
static struct exit bent(int t, double s, double end)
{
    struct exit e = plane(t, s, end);
    double x = s / end, turn = 1.2 * x * (t % 2 ? 1 : -1);
    double a = e.w[0], b = e.w[2];
    e.u = s + (e.u - s) / (1 + 0.5 * x);
    e.ft *= 1 - 0.4 * x;
    e.w[0] = cos(turn) * a + sin(turn) * b;
    e.w[2] = cos(turn) * b - sin(turn) * a;
    return e;
}

struct bench {
    struct single_plan plan;
    struct scratch s;
    float depth[SINGLE_MAX_NODES], end;
    float *memory;
};

static float *take(struct bench *b, size_t n)
{
    float *at = b->memory;
    b->memory += n;
    return at;
}

// A vertex over `end` mm of the medium, with the nodes of the bake's plan.
static void bench_init(struct bench *b, unsigned cpu, unsigned n_phase,
                       const struct extinction_table *extinction, float end,
                       exit_function *exit)
{
    static const float sigma_s[3] = {1, 0.7f, 0.2f}, sigma_t[3] = {1.1f, 1, 0.5f};
    static const double g[3] = {0.25, -0.3, 0.8};

    memset(b, 0, sizeof *b);
    b->plan = (struct single_plan){.cpu = cpu,
                                   .n_eta = 1,
                                   .eta = {1.3f},
                                   .n_phase = n_phase,
                                   .extinction = extinction,
                                   .n_direction = N,

                                   .n_node = extinction ? 6 : SINGLE_MAX_NODES,
                                   .first_mm = extinction ? 0.05f : 0.09f,
                                   .last_mm = extinction ? 60 : 8};
    for (int c = 0; c < 3; c++) {
        b->plan.sigma_s[c] = sigma_s[c];
        b->plan.sigma_t[c] = sigma_t[c];
        assert_int_equal(prt_phase_hg(&b->plan.phase[c], g[c], n_phase), PRT_OK);
    }
    b->end = end;
    prt_single_plan_nodes(&b->plan, end, b->depth);
    b->memory = calloc(N * (1 + 5 * SINGLE_MAX_NODES), sizeof *b->memory);
    assert_non_null(b->memory);
    b->s.node = b->s.of_eta[0];
    b->s.cosine = take(b, N);
    for (int t = 0; t < N; t++) b->s.cosine[t] = 0.1f + 0.9f * (float)t / N;
    for (uint32_t a = 0; a < b->plan.n_node; a++) {
        struct exits *node = &b->s.node[a];
        node->path_mm = take(b, N);
        node->transmittance = take(b, N);
        for (int k = 0; k < 3; k++) node->dir[k] = take(b, N);
        for (int t = 0; t < N; t++) {
            struct exit e = exit(t, (double)b->depth[a], (double)end);
            node->path_mm[t] = (float)(e.u - (double)b->depth[a]);
            node->transmittance[t] = (float)e.ft;
            for (int k = 0; k < 3; k++) node->dir[k][t] = (float)e.w[k];
        }
    }
}

static void bench_finish(struct bench *b)
{
    free(b->s.cosine); // the first piece of the memory
}

static void integrate(const struct bench *b, const float *rgb, float *out)
{
    prt_path_integrate(
        &(struct path_job){&b->plan, &fresnel, &b->s, b->depth, b->end, N, rgb, out});
}

// ∫₀^end f(s) ds, where f is F_t V Y_k(w') times a function of u, by midpoints that are dense
// near the vertex.
static double quadrature(int t, unsigned k, double end, exit_function *exit,
                         double (*of_u)(const void *of, double u), const void *of)
{
    enum { STEPS = 2000 };
    double sum = 0;
    for (int i = 0; i < STEPS; i++) {
        double x = (i + 0.5) / STEPS, s = end * x * x;
        struct exit e = exit(t, s, end);
        float y[9], w[3] = {(float)e.w[0], (float)e.w[1], (float)e.w[2]};
        prt_sh_eval(3, w, y);
        sum += e.ft * (double)y[k] * of_u(of, e.u) * 2 * end * x / STEPS;
    }
    return sum;
}

static double attenuation(const void *of, double u)
{
    return exp(-(double)*(const float *)of * u);
}

// Every harmonic and channel of a medium, against quadrature; relative to the isotropic term.
static void medium_agrees(const char *name, exit_function *exit, float end, double bound)
{
    static const unsigned terms[] = {1, 4, 9};
    float *out = calloc(27 * N, sizeof *out);
    assert_non_null(out);
    for (int i = 0; i < 6; i++) {
        struct bench b;
        unsigned K = terms[i / 2];
        bench_init(&b, i % 2 ? prt_cpu_detect() : 0, K, NULL, end, exit);
        integrate(&b, NULL, out);
        for (int t = 0; t < N; t += 7)
            for (unsigned c = 0; c < 3; c++) {
                const struct single_plan *p = &b.plan;
                double scale = (double)p->sigma_s[c] *
                               quadrature(t, 0, (double)end, exit, attenuation, &p->sigma_t[c]);
                for (unsigned k = 0; k < K; k++) {
                    double want =
                        p->phase[c].a[path_degree(k)] * (double)p->sigma_s[c] *
                        quadrature(t, k, (double)end, exit, attenuation, &p->sigma_t[c]);
                    expect_near(expect_name("%s, %u terms: share of the light", name, K),
                                (double)out[(k * 3 + c) * N + (unsigned)t] / scale,
                                want / scale, bound);
                }
            }
        bench_finish(&b);
    }
    free(out);
}

// Law: where the surface is a plane, u is linear and the nodes give the integral exactly
// (W05 eq 10), to the end of a path that the nodes do not reach
static void planes_are_exact(void **state)
{
    (void)state;
    medium_agrees("plane, 4 mm", plane, 4, 1e-5);
    medium_agrees("plane, 30 mm", plane, 30, 1e-5);
}

// Law: between the nodes way, light and direction run from the nearer to the farther (METHODS
// §3.5). The direction turns by up to 70 degrees; the nine nodes hold that to 0.4 %.
static void bent_surfaces_are_followed(void **state)
{
    (void)state;
    medium_agrees("bent, 4 mm", bent, 4, 0.01);
    medium_agrees("bent, 8 mm", bent, 8, 0.01);
}

struct basis_function {
    const struct prt_radial *radial;
    uint32_t j;
};

static double basis_value(const void *of, double u)
{
    const struct basis_function *b = of;
    float r = (float)u, value[EXTINCTION_WIDE];
    prt_radial_eval(b->radial, 1, &r, value);
    return (double)value[b->j];
}

static double basis_size(const void *of, double u)
{
    return fabs(basis_value(of, u));
}

// Function j of a basis: out [9][J][N] of single directions and sum [9][J][3] of a light rgb.
struct basis_result {
    const struct prt_radial *radial;
    const float *out, *sum, *rgb;
    const char *name;
    exit_function *exit;
    double end, bound;
};

static void function_agrees(const struct basis_result *r, uint32_t j)
{
    struct basis_function of = {r->radial, j};
    uint32_t J = r->radial->n_function;
    double most = 0;
    for (int t = 0; t < N; t += 7)
        most = fmax(most, quadrature(t, 0, r->end, r->exit, basis_size, &of));
    for (uint32_t k = 0; k < 9; k++) {
        const float *out = r->out + (size_t)(k * J + j) * N, *sum = r->sum + (k * J + j) * 3;
        for (int t = 0; t < N; t += 7)
            expect_near(r->name, (double)out[t] / most,
                        quadrature(t, k, r->end, r->exit, basis_value, &of) / most, r->bound);
        for (int c = 0; c < 3; c++) {
            double total = 0, absolute = 0;
            for (int t = 0; t < N; t++) {
                total += (double)(out[t] * r->rgb[3 * t + c]);
                absolute += (double)fabsf(out[t] * r->rgb[3 * t + c]);
            }
            expect_near("sum over directions, share", (double)sum[c] / absolute,
                        total / absolute, 2e-6);
        }
    }
}

// Law: for any medium the integrals are those of the basis functions along the way (X07 eq 15),
// and a light's directions add up. Six nodes follow the bent surface to 5 % of the light.
static void bases_are_integrated(void **state)
{
    static const float end = 9;
    struct prt_radial_options o = {
        .kind = PRT_RADIAL_REDUCED, .family = PRT_FAMILY_EXTINCTION, .radius_mm = 60};
    struct prt_radial *radial;
    struct extinction_table *table;
    (void)state;
    assert_int_equal(prt_radial_create(&context, &o, &radial), PRT_OK);
    assert_int_equal(prt_extinction_table_create(radial, &table), PRT_OK);
    uint32_t J = radial->n_function;
    float *out = calloc((size_t)9 * J * N, sizeof *out), *rgb = calloc(3 * N, sizeof *rgb);
    assert_true(out && rgb);
    for (int i = 0; i < 3 * N; i++) rgb[i] = (float)(1 + i % 5);
    for (int i = 0; i < 4; i++) {
        struct bench b;
        float *sum = calloc(27 * (size_t)J, sizeof *sum);
        exit_function *exit = i / 2 ? bent : plane;
        assert_non_null(sum);
        bench_init(&b, i % 2 ? prt_cpu_detect() : 0, 9, table, end, exit);
        integrate(&b, NULL, out);
        integrate(&b, rgb, sum);
        struct basis_result r = {radial,
                                 out,
                                 sum,
                                 rgb,
                                 i / 2 ? "bent: share of the light"
                                       : "plane: share of the light",
                                 exit,
                                 (double)end,
                                 i / 2 ? 0.1 : 6e-4};
        for (uint32_t j = 0; j < J; j++) function_agrees(&r, j);
        bench_finish(&b);
        free(sum);
    }
    free(out), free(rgb);
    prt_extinction_table_destroy(table);
    prt_radial_destroy(radial);
}

int main(void)
{
    prt_context_init(&context);
    prt_fresnel_table_init(&fresnel, 1.3f);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(planes_are_exact),
        cmocka_unit_test(bent_surfaces_are_followed),
        cmocka_unit_test(bases_are_integrated),
    };
    return run_physics_tests(tests, NULL, NULL);
}
