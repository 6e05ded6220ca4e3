// SPDX-License-Identifier: MIT
// Drafts that a bake by walks replaces (METHODS §9): they are by the dipole, scaled to what
// walks return under even irradiance.
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
#include "walk_truth.h"

enum { CUBE = 16, BOXES = 2 };

static const struct prt_material milk = {.sigma_s_prime = {0.7f, 1.2f, 1.9f},
                                         .sigma_a = {0.001f, 0.002f, 0.014f},
                                         .eta = 1.3f,
                                         .roughness = 0.3f};
static const struct prt_material syrup = {.sigma_s_prime = {0.5f, 0.5f, 0.5f},
                                          .sigma_a = {0.1f, 0.15f, 0.2f},
                                          .eta = 1.3f,
                                          .roughness = 0.3f};

static struct prt_cube even_light(void)
{
    struct prt_cube cube;
    assert_int_equal(prt_cube_init(&cube, CUBE), PRT_OK);
    for (uint32_t i = 0; i < 18 * CUBE * CUBE; i++) cube.texel[i] = 1;
    return cube;
}

// A draft's colours by multiple scattering under an even light, to free().
static float (*draft(const struct prt_mesh *mesh, struct prt_media media, bool walks_follow))[3]
{
    const struct prt_bake_options o = {.media = media,
                                       .n_sample = 4000,
                                       .cube = CUBE,
                                       .no_single = true,
                                       .unmeasured = true,
                                       .draft = true,
                                       .walks_follow = walks_follow,
                                       .seed = 1};
    struct prt_cube light = even_light();
    struct prt_file *f;
    assert_int_equal(prt_bake(&context, mesh, &o, file("draft.prt")), PRT_OK);
    assert_int_equal(prt_file_open(&context, file("draft.prt"), PRT_FILE_CHECK_ALL, &f),
                     PRT_OK);
    const struct prt_query query = {.term = PRT_ANSWER_MULTIPLE, .light = &light};
    float(*all)[3] = calloc(mesh->n_vertex, sizeof *all);
    assert_int_equal(prt_answer_colors(&context, prt_file_transport(f), &query, all), PRT_OK);
    prt_file_close(f);
    prt_cube_finish(&light);
    return all;
}

// Law: where walks follow, a draft gives under an even light what walks give, which the dipole
// does not (METHODS §9).
static void a_draft_is_scaled_to_walks(void **state)
{
    struct model m;
    struct prt_cube light = even_light();
    static struct walk_truth truth;
    model_init(&m, 500, 800);
    add_ball(&m, 28, 14, 14, dented_ball);
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    float(*scaled)[3] = draft(mesh, prt_media_one(&milk), true);
    float(*dipole)[3] = draft(mesh, prt_media_one(&milk), false);
    walk_truth_pick(&truth, mesh, NULL);
    walk_truth_take(&truth, mesh, &milk, &light, PRT_REFERENCE_MULTIPLE, 3072);
    expect_walk_error("error of a draft that walks follow", &truth, scaled, 0.036);
    expect_above("error of a draft by the dipole",
                 walk_truth_error(&truth, (const float(*)[3])dipole).least, 0.06);
    free(scaled);
    free(dipole);
    prt_cube_finish(&light);
    prt_mesh_destroy(mesh);
}

// Two boxes, one a hair above the other, whose sides lie in four planes.
static struct prt_mesh *two_boxes(uint32_t begin[BOXES + 1], uint32_t n_triangle[BOXES])
{
    struct model m;
    struct part part[BOXES] = {{0}};
    begin[0] = 0;
    model_init(&m, 700, 1000);
    for (uint32_t i = 0; i < BOXES; i++) {
        part[i] = (struct part){m.mesh.n_vertex, m.mesh.n_triangle, NULL};
        add_box(&m, (float[]){0, i ? 3.05f : -3.05f, 0}, (float[]){4, 3, 4}, 6);
        begin[i + 1] = m.mesh.n_vertex;
        n_triangle[i] = m.mesh.n_triangle - part[i].triangle_begin;
    }
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    assert_int_equal(mesh->n_vertex, begin[BOXES]);
    split_parts(mesh, BOXES, part);
    return mesh;
}

// The mean on box i's sides, the rows next to the other box.
static double mean_near(const struct prt_mesh *mesh, float (*color)[3], const uint32_t *begin,
                        uint32_t i, int c)
{
    double sum = 0;
    uint32_t n = 0;
    for (uint32_t v = begin[i]; v < begin[i + 1]; v++) {
        const float y = fabsf(mesh->position[v][1]);
        if (y < 0.5f || y > 2.6f || fabsf(mesh->normal[v][1]) > 0.1f) continue;
        sum += (double)color[v][c];
        n++;
    }
    assert_true(n >= 16);
    return sum / n;
}

// Law: what walks say of a body scales that body alone, with its own medium, however near
// another one is: a box of syrup on one of milk is scaled as on one of syrup.
static void bodies_are_scaled_by_themselves(void **state)
{
    uint32_t begin[BOXES + 1], n_triangle[BOXES];
    struct prt_mesh *mesh = two_boxes(begin, n_triangle);
    const struct prt_material medium[BOXES] = {milk, syrup};
    const uint8_t of_object[BOXES] = {0, 1};
    const struct prt_media both = {BOXES, medium, of_object};
    float(*with)[3] = draft(mesh, both, true), (*without)[3] = draft(mesh, both, false);
    for (uint32_t i = 0; i < BOXES; i++) {
        float(*same)[3] = draft(mesh, prt_media_one(&medium[i]), true);
        float(*dipole)[3] = draft(mesh, prt_media_one(&medium[i]), false);
        for (int c = 0; c < 3; c++) {
            const double scale =
                mean_near(mesh, with, begin, i, c) / mean_near(mesh, without, begin, i, c);
            const double alone =
                mean_near(mesh, same, begin, i, c) / mean_near(mesh, dipole, begin, i, c);
            expect_near(expect_name("box %u: its scale, against a pair's of its medium", i),
                        scale / alone, 1, 0.03);
        }
        free(same);
        free(dipole);
    }
    free(with);
    free(without);
    prt_mesh_destroy(mesh);
}

// Law: walks that escape through a hole say nothing: such a body keeps the dipole, and the body
// beside it is scaled nevertheless.
static void a_body_with_a_hole_keeps_the_dipole(void **state)
{
    uint32_t begin[BOXES + 1], n_triangle[BOXES];
    struct prt_mesh *mesh = two_boxes(begin, n_triangle);
    mesh->n_triangle -= n_triangle[1] / 6; // the last side of the second box
    mesh->block[1].n_triangle -= n_triangle[1] / 6;
    float(*scaled)[3] = draft(mesh, prt_media_one(&milk), true);
    float(*dipole)[3] = draft(mesh, prt_media_one(&milk), false);
    double most[BOXES] = {0};
    for (uint32_t i = 0; i < BOXES; i++)
        for (uint32_t v = begin[i]; v < begin[i + 1]; v++)
            for (int c = 0; c < 3; c++)
                most[i] = fmax(most[i], fabs((double)scaled[v][c] - (double)dipole[v][c]));
    expect_above("scaling of the closed box", most[0], 0.01);
    expect_below("scaling of the open box", most[1], 1e-6);
    free(scaled);
    free(dipole);
    prt_mesh_destroy(mesh);
}

// Law: a ball is alike all over, and so are its colours under an even light, in a draft that
// few walks scale, too: their noise is smoothed (METHODS §9).
static void a_ball_is_even(void **state)
{
    struct model m;
    model_init(&m, 500, 800);
    add_round_ball(&m, 28, 14, 8);
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    float(*color)[3] = draft(mesh, prt_media_one(&milk), true);
    for (int c = 0; c < 3; c++) {
        double sum = 0, square = 0;
        for (uint32_t v = 0; v < mesh->n_vertex; v++) {
            sum += (double)color[v][c];
            square += (double)color[v][c] * (double)color[v][c];
        }
        const double mean = sum / mesh->n_vertex;
        expect_below("deviation of a ball's colours, of their mean",
                     sqrt(fmax(square / mesh->n_vertex - mean * mean, 0)) / mean, 0.012);
    }
    free(color);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_draft_is_scaled_to_walks),
        cmocka_unit_test(a_ball_is_even),
        cmocka_unit_test(bodies_are_scaled_by_themselves),
        cmocka_unit_test(a_body_with_a_hole_keeps_the_dipole),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
