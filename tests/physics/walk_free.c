// SPDX-License-Identifier: MIT
// Joint and polynomial bakes by random walks (METHODS §9, free media): media that no bake was
// made for, against walks of the reference; continuity; holes; the grid's interpolation.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "bodies.h"
#include "prt/bake.h"
#include "prt/relight.h"
#include "prt/walk_grid.h"
#include "walk_truth.h"

enum { CUBE = 16 };
static char joint[64], polynomial[64], holed[64];
static struct prt_mesh *ball;
static struct prt_cube light;
static struct walk_truth truth;

static void ignore_log(void *user, enum prt_log_level level, const char *line)
{
}

static struct prt_mesh *dented(uint32_t n_row)
{
    struct model m;
    model_init(&m, 28 * 15, 28 * 14 * 2);
    add_ball(&m, 28, 14, n_row, dented_ball);
    return body_mesh(&context, &m, false);
}

static void bake(const struct prt_mesh *mesh, enum prt_transport_kind engine, uint32_t n_walk,
                 bool single, const struct prt_env *env, const char *path)
{
    struct prt_material m = {.eta = 1.3f, .roughness = 0.3f};
    for (int c = 0; c < 3; c++) m.sigma_s_prime[c] = 1, m.sigma_a[c] = 0.01f;
    const struct prt_bake_options o = {.engine = engine,
                                       .media = prt_media_one(&m),
                                       .scattering = PRT_SCATTERING_WALK,
                                       .n_walk = n_walk,
                                       .n_sample = 4000,
                                       .cube = CUBE,
                                       .env = env,
                                       .no_single = !single,
                                       .unmeasured = true,
                                       .seed = 1};
    assert_int_equal(prt_bake(&context, mesh, &o, path), PRT_OK);
}

// All colours of a file in a medium, of every vertex.
static void answer(const char *path, enum prt_answer_term term, const struct prt_material *m,
                   float (*out)[3])
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const struct prt_transport *t = prt_file_transport(f);
    const struct prt_query query = {.term = term, .light = &light, .media = prt_media_one(m)};
    assert_int_equal(prt_answer_colors(&context, t, &query, out), PRT_OK);
    prt_file_close(f);
}

static struct prt_material medium(const char *name)
{
    struct prt_material m;
    assert_int_equal(prt_material_load(&context, name, &m), PRT_OK);
    m.eta = 1.3f;
    return m;
}

// A file's error in a medium, against n_walk walks of either reference.
static void check_medium(const char *name, const struct prt_material *m, bool unscattered,
                         uint32_t n_walk, double bound)
{
    const enum prt_answer_term term =
        unscattered ? PRT_ANSWER_UNSCATTERED : PRT_ANSWER_MULTIPLE;
    float(*got)[3] = calloc(ball->n_vertex, sizeof *got);
    walk_truth_take(&truth, ball, m, &light,
                    unscattered ? PRT_REFERENCE_UNSCATTERED : PRT_REFERENCE_MULTIPLE, n_walk);
    answer(joint, term, m, got);
    expect_walk_error(expect_name("joint, %s", name), &truth, got, bound);
    answer(polynomial, term, m, got);
    expect_walk_error(expect_name("polynomial, %s", name), &truth, got, bound);
    free(got);
}

// Law: one bake by walks answers for media over the whole range as walks of the reference do
// in each (METHODS §9, free media). Few walks scatter twice in ketchup, and they are short.
static void media_agree_with_walks(void **state)
{
    static const struct {
        const char *name;
        uint32_t n_walk;
    } media[] = {{"skin1", 2048}, {"marble", 1024}, {"ketchup", 16384}};
    for (unsigned i = 0; i < 3; i++) {
        const struct prt_material m = medium(media[i].name);
        check_medium(media[i].name, &m, false, media[i].n_walk, 0.035);
    }
}

// Law: so it is with light that crosses without a scattering (METHODS §9, terms).
static void unscattered_agrees_with_walks(void **state)
{
    const struct prt_material m = {.sigma_s_prime = {0.05f, 0.1f, 0.2f},
                                   .sigma_a = {0.05f, 0.02f, 0},
                                   .eta = 1.3f,
                                   .roughness = 0.3f};
    check_medium("unscattered light", &m, true, 8192, 0.03);
}

// Law: by similarity light that crosses without a scattering depends on sigma_s' and not on g
// (METHODS §9, terms), whatever term was answered before: single scattering, which does depend
// on g, has the same functions of the path.
static void unscattered_is_without_g(void **state)
{
    struct prt_material m = {.sigma_s_prime = {0.05f, 0.1f, 0.2f},
                             .sigma_a = {0.05f, 0.02f, 0.01f},
                             .eta = 1.3f,
                             .roughness = 0.3f};
    float(*want)[3] = calloc(ball->n_vertex, sizeof *want);
    float(*got)[3] = calloc(ball->n_vertex, sizeof *got);
    char both[80];
    snprintf(both, sizeof both, "%s/both.prt", folder);
    bake(ball, PRT_TRANSPORT_JOINT, 16, true, NULL, both);
    answer(both, PRT_ANSWER_UNSCATTERED, &m, want);
    for (int c = 0; c < 3; c++) m.g[c] = 0.8f;
    answer(both, PRT_ANSWER_SINGLE, &m, got);
    answer(both, PRT_ANSWER_UNSCATTERED, &m, got);
    expect_below("unscattered light with g 0.8 against g 0",
                 prt_relative_rmse(got[0], want[0], 3 * (size_t)ball->n_vertex), 1e-6);
    free(want);
    free(got);
}

static double mean_of(float (*color)[3], uint32_t n)
{
    double sum = 0;
    for (uint32_t v = 0; v < n; v++) sum += (double)color[v][1];
    return sum / n;
}

// Law: answers are continuous in both coefficients: steps of 1 % over the range change the
// total by little, and least at no place by much more than at its neighbours.
static void no_jumps(void **state)
{
    float(*color)[3] = calloc(ball->n_vertex, sizeof *color);
    for (unsigned walk = 0; walk < 2; walk++) {
        double last = 0, worst = 0, before = 0, bend = 0;
        enum { STEPS = 700 };
        for (unsigned i = 0; i <= STEPS; i += 2) {
            const double share = (double)i / STEPS;
            struct prt_material m = {.eta = 1.3f, .roughness = 0.3f};
            for (int c = 0; c < 3; c++) {
                m.sigma_s_prime[c] = walk ? 1 : (float)(0.021 * pow(1200, share));
                m.sigma_a[c] = walk ? (float)(2e-4 * pow(9e3, share)) : 0.02f;
            }
            answer(polynomial, PRT_ANSWER_MULTIPLE, &m, color);
            const double now = mean_of(color, ball->n_vertex);
            const double step = i ? log(now / last) : 0;
            if (i) worst = fmax(worst, fabs(step));
            if (i > 2) bend = fmax(bend, fabs(step - before));
            before = step, last = now;
        }
        const char *what = walk ? "sigma_a" : "sigma_s'";
        expect_below(expect_name("largest step of ln over %s", what), worst, 0.06);
        expect_below(expect_name("largest change of a step over %s", what), bend, 0.008);
    }
    free(color);
}

// Multiple scattering of one medium by the dipole.
static void bake_dipole(const struct prt_context *ctx, const struct prt_mesh *mesh,
                        const struct prt_material *m, const char *path)
{
    const struct prt_bake_options o = {.media = prt_media_one(m),
                                       .n_sample = 4000,
                                       .cube = CUBE,
                                       .no_single = true,
                                       .unmeasured = true,
                                       .seed = 1};
    assert_int_equal(prt_bake(ctx, mesh, &o, path), PRT_OK);
}

// Multiple scattering of a file whose medium is fixed, of every vertex.
static void answer_fixed(const char *path, float (*out)[3])
{
    struct prt_file *f;
    assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const struct prt_query query = {.term = PRT_ANSWER_MULTIPLE, .light = &light};
    assert_int_equal(prt_answer_colors(&context, prt_file_transport(f), &query, out), PRT_OK);
    prt_file_close(f);
}

// Law: an object with holes is baked with the dipole, as a combination of the same functions:
// the file answers as one by the dipole does (METHODS §9, holes).
static void holes_keep_the_dipole(void **state)
{
    struct prt_mesh *mesh = dented(7);
    struct prt_context quiet = context;
    const struct prt_material m = medium("skin1");
    float(*got)[3] = calloc(mesh->n_vertex, sizeof *got);
    float(*want)[3] = calloc(mesh->n_vertex, sizeof *want);
    char dipole[80];
    quiet.log = ignore_log;
    snprintf(dipole, sizeof dipole, "%s/dipole.prt", folder);
    bake(mesh, PRT_TRANSPORT_JOINT, 16, false, NULL, holed);
    bake_dipole(&quiet, mesh, &m, dipole);
    answer(holed, PRT_ANSWER_MULTIPLE, &m, got);
    answer_fixed(dipole, want);
    expect_below("difference from the dipole",
                 prt_relative_rmse(got[0], want[0], 3 * (size_t)mesh->n_vertex), 0.03);
    free(got);
    free(want);
    prt_mesh_destroy(mesh);
}

// A closed ball, and 60 mm beside it one with a hole. *second: the latter's first vertex.
static struct prt_mesh *closed_and_open(uint32_t *second)
{
    struct model m;
    struct part part[2] = {{0, 0, NULL}};
    model_init(&m, 2 * 28 * 15, 2 * 28 * 14 * 2);
    add_ball(&m, 28, 14, 14, dented_ball);
    part[1] = (struct part){m.mesh.n_vertex, m.mesh.n_triangle, NULL};
    add_ball(&m, 28, 14, 7, dented_ball);
    for (uint32_t v = part[1].vertex_begin; v < m.mesh.n_vertex; v++)
        m.mesh.position[v][0] += 60;
    const uint32_t n_vertex = m.mesh.n_vertex;
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    assert_int_equal(mesh->n_vertex, n_vertex);
    split_parts(mesh, 2, part);
    *second = part[1].vertex_begin;
    return mesh;
}

// The relative difference of one channel's colours.
static double channel_difference(float (*a)[3], float (*b)[3], uint32_t n, int channel)
{
    double difference = 0, sum = 0;
    for (uint32_t v = 0; v < n; v++) {
        difference += pow((double)a[v][channel] - (double)b[v][channel], 2);
        sum += pow((double)b[v][channel], 2);
    }
    return sqrt(difference / sum);
}

// Law: so it is beside a body that is walked: either kind has functions of its own (METHODS §9,
// holes). Strongly absorbing media have few walks and a dipole all the same. The closed body
// answers as in a bake of it alone, but for the samples of irradiance, of which it has half as
// many beside the other. They change most in green of ketchup, where light is a thousandth of
// that in red; functions of both kinds together were 19 % off there.
static void holes_beside_a_closed_body(void **state)
{
    static const char *const media[] = {"skin1", "marble", "ketchup"};
    uint32_t second;
    struct prt_mesh *mesh = closed_and_open(&second);
    const size_t open = 3 * (size_t)(mesh->n_vertex - second);
    float(*got)[3] = calloc(mesh->n_vertex, sizeof *got);
    float(*want)[3] = calloc(mesh->n_vertex, sizeof *want);
    char dipole[80];
    snprintf(dipole, sizeof dipole, "%s/dipole.prt", folder);
    bake(mesh, PRT_TRANSPORT_JOINT, 256, false, NULL, holed);
    for (unsigned i = 0; i < 3; i++) {
        const struct prt_material m = medium(media[i]);
        bake_dipole(&context, mesh, &m, dipole);
        answer_fixed(dipole, want);
        answer(holed, PRT_ANSWER_MULTIPLE, &m, got);
        expect_below(expect_name("open body, %s: difference from the dipole", media[i]),
                     prt_relative_rmse(got[second], want[second], open), 0.03);
        answer(joint, PRT_ANSWER_MULTIPLE, &m, want);
        for (int c = 0; c < 2; c++)
            expect_below(expect_name("closed body, %s, channel %d: alone", media[i], c),
                         channel_difference(got, want, second, c), i == 2 && c ? 0.14 : 0.02);
    }
    free(got);
    free(want);
    prt_mesh_destroy(mesh);
}

// Law: the errors in a file are those of the bake's own scattering: of a body with holes, which
// keeps the dipole, against the dipole (METHODS §9, errors). Walks in it lose most of the
// light.
static void holes_are_measured_with_the_dipole(void **state)
{
    uint32_t second;
    double sky = NAN;
    struct prt_mesh *mesh = closed_and_open(&second);
    struct prt_context quiet = context;
    struct prt_file *f;
    const struct prt_material m = medium("skin1");
    const struct prt_bake_options o = {.media = prt_media_one(&m),
                                       .scattering = PRT_SCATTERING_WALK,
                                       .n_walk = 64,
                                       .n_sample = 4000,
                                       .cube = CUBE,
                                       .draft = true, // measured against few samples
                                       .no_single = true,
                                       .seed = 1};
    quiet.log = ignore_log;
    assert_int_equal(prt_bake(&quiet, mesh, &o, holed), PRT_OK);
    assert_int_equal(prt_file_open(&context, holed, PRT_FILE_CHECK_ALL, &f), PRT_OK);
    const char *errors = prt_file_transport(f)->errors;
    const char *multiple = strstr(errors, "\"multiple\":{\"sky\":");
    assert_non_null(multiple);
    assert_int_equal(sscanf(multiple, "\"multiple\":{\"sky\":%lf", &sky), 1);
    expect_below("measured error beside an open body, under the sky", sky, 0.085);
    prt_file_close(f);
    prt_mesh_destroy(mesh);
}

// Law: the grid's interpolation reproduces the answers of its own media, and misplaces little
// of the light of the measured ones (METHODS §9, free media).
static void grid_holds_media(void **state)
{
    struct prt_walk_grid grid, again;
    double weight[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_NODES], error;
    float axes[PRT_WALK_MOST_LEVELS + PRT_WALK_MOST_NODES];
    prt_walk_grid_default(&grid);
    const uint32_t n = grid.n_level * grid.n_node;
    for (uint32_t i = 0; i < n; i += 7) {
        const uint32_t k = i / grid.n_node, j = i % grid.n_node;
        prt_walk_grid_weights(&grid, 1.3, (double)grid.level[k], (double)grid.node[j], weight,
                              &error);
        for (uint32_t m = 0; m < n; m++)
            expect_near("weight at a medium of the grid", weight[m], m == i ? 1 : 0, 1e-6);
    }
    const struct prt_material *preset;
    for (unsigned p = 0; (preset = prt_material_preset(p)); p++)
        for (int c = 0; c < 3; c++) {
            prt_walk_grid_weights(&grid, 1.3, (double)preset->sigma_s_prime[c],
                                  (double)preset->sigma_a[c], weight, &error);
            const bool within = preset->sigma_s_prime[c] >= 0.1f;
            expect_below("light that the grid misplaces", error,
                         within && preset->sigma_s_prime[c] <= 10 ? 0.01 : 0.03);
        }
    prt_walk_grid_weights(&grid, 1.3, 200, 0.01, weight, &error);
    expect_above("error of a medium far outside", error, 0.1);
    memcpy(axes, grid.level, grid.n_level * sizeof *axes);
    memcpy(axes + grid.n_level, grid.node, grid.n_node * sizeof *axes);
    assert_int_equal(prt_walk_grid_from_axes(grid.n_level + grid.n_node, axes, &again), PRT_OK);
    assert_memory_equal(&again, &grid, sizeof grid);
    axes[1] = axes[0];
    assert_int_equal(prt_walk_grid_from_axes(grid.n_level + grid.n_node, axes, &again),
                     PRT_FORMAT);
    assert_int_equal(prt_walk_grid_from_axes(3, axes, &again), PRT_FORMAT);
}

// Law: a medium beyond the grid is answered as the nearest one on its edge, and what that
// misplaces is in its error.
static void grid_ends_at_its_edge(void **state)
{
    struct prt_walk_grid grid;
    double edge[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_NODES];
    double weight[PRT_WALK_MOST_LEVELS * PRT_WALK_MOST_NODES], error[2];
    prt_walk_grid_default(&grid);
    const double most_s = (double)grid.level[grid.n_level - 1], least_s = (double)grid.level[0],
                 most_a = (double)grid.node[grid.n_node - 1];
    const double beyond[][4] = {// sigma_s', sigma_a; on the edge
                                {1, 3 * most_a, 1, most_a},
                                {1, -1, 1, 0},
                                {least_s / 3, 0.1, least_s, 0.1},
                                {3 * most_s, 0.1, most_s, 0.1},
                                {3 * most_s, 3 * most_a, most_s, most_a}};
    for (unsigned i = 0; i < sizeof beyond / sizeof *beyond; i++) {
        prt_walk_grid_weights(&grid, 1.3, beyond[i][0], beyond[i][1], weight, &error[0]);
        prt_walk_grid_weights(&grid, 1.3, beyond[i][2], beyond[i][3], edge, &error[1]);
        for (uint32_t k = 0; k < grid.n_level * grid.n_node; k++)
            expect_near("weight beyond the grid", weight[k], edge[k], 1e-9);
        if (beyond[i][1] > 0)
            expect_above("error beyond the grid, against the edge's", error[0], error[1]);
    }
}

static int end(void **state)
{
    prt_cube_finish(&light);
    prt_mesh_destroy(ball);
    return bake_files_end(state);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    snprintf(joint, sizeof joint, "%s", file("joint.prt"));
    snprintf(polynomial, sizeof polynomial, "%s", file("polynomial.prt"));
    snprintf(holed, sizeof holed, "%s", file("holed.prt"));
    ball = dented(14);
    walk_truth_pick(&truth, ball, NULL);
    if (prt_cube_init(&light, CUBE)) return 1;
    for (uint32_t i = 0; i < 6 * CUBE * CUBE; i++) { // a sky, a dark floor and a lamp
        const uint32_t face = i / (CUBE * CUBE), y = i / CUBE % CUBE, x = i % CUBE;
        const bool lamp = face == 4 && x > 8 && x < 12 && y > 2 && y < 6;
        for (uint32_t c = 0; c < 3; c++)
            light.texel[3 * i + c] = (face == 2 ? 0.6f : 0.15f) + (lamp ? 25 : 0);
    }
    struct prt_env env = {.kind = PRT_ENV_CUBE, .cube = light};
    bake(ball, PRT_TRANSPORT_JOINT, 256, false, NULL, joint);
    bake(ball, PRT_TRANSPORT_POLYNOMIAL, 256, false, &env, polynomial);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(grid_holds_media),
        cmocka_unit_test(grid_ends_at_its_edge),
        cmocka_unit_test(media_agree_with_walks),
        cmocka_unit_test(unscattered_agrees_with_walks),
        cmocka_unit_test(unscattered_is_without_g),
        cmocka_unit_test(no_jumps),
        cmocka_unit_test(holes_keep_the_dipole),
        cmocka_unit_test(holes_beside_a_closed_body),
        cmocka_unit_test(holes_are_measured_with_the_dipole),
    };
    return run_physics_tests(tests, NULL, end);
}
