// SPDX-License-Identifier: MIT
// Bakes by walks (METHODS §9) in shards, and bakes that are killed again and again, write what
// one process writes, byte for byte: with a fixed material, a fixed light, and neither.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "bake_parts.h"
#include "bodies.h"
#include "prt/reference.h"
#include "prt/relight.h"

// Four boxes, each a cluster of its own, over an opaque square.
static struct prt_mesh *boxes(void)
{
    enum { BOXES = 4 };
    static const float grey[3] = {0.5f, 0.5f, 0.5f};
    struct model m;
    struct part part[BOXES + 1];
    model_init(&m, BOXES * 6 * 9 + 4, BOXES * 6 * 8 + 2);
    for (uint32_t i = 0; i <= BOXES; i++) {
        part[i] = (struct part){m.mesh.n_vertex, m.mesh.n_triangle, i < BOXES ? NULL : grey};
        const float x = 3 * (float)i, half = 1 + 0.2f * (float)i;
        if (i < BOXES) add_box(&m, (float[]){x, 0, 0}, (float[]){1, half, half}, 2);
        else add_floor(&m, 15, -3, 1);
    }
    struct prt_mesh *mesh = body_mesh(&context, &m, false);
    split_parts(mesh, BOXES + 1, part);
    return mesh;
}

// A draft is measured against few samples; the noise of all parts' walks is in its errors.
static struct prt_bake_options options(enum prt_transport_kind engine)
{
    static struct prt_material skin;
    assert_int_equal(prt_material_load(&context, "skin1", &skin), PRT_OK);
    return (struct prt_bake_options){.engine = engine,
                                     .media = prt_media_one(&skin),
                                     .scattering = PRT_SCATTERING_WALK,
                                     .n_walk = 16,
                                     .n_sample = 400,
                                     .cube = 16,
                                     .rank = 8,
                                     .no_single = true,
                                     .draft = engine != PRT_TRANSPORT_POLYNOMIAL,
                                     .unmeasured = engine == PRT_TRANSPORT_POLYNOMIAL,
                                     .seed = 3};
}

static void parted_and_killed(const struct prt_bake_options *o, unsigned more)
{
    struct prt_mesh *mesh = boxes();
    parts_make_the_whole(mesh, *o);
    killed_makes_the_whole(mesh, *o, more);
    prt_mesh_destroy(mesh);
}

// Contract of prt_bake: three shards of a bake by walks write its bytes, and so does one that
// is killed every few records: its unscattered light reads the rows of pass 1, too.
static void fixed_material(void **state)
{
    const struct prt_bake_options o = options(PRT_TRANSPORT_WAVELET);
    parted_and_killed(&o, 2);
}

// Contract of prt_bake: the same where light and material are free: every part walks from the
// same clusters to find the functions that the file stores.
static void free_light_and_material(void **state)
{
    const struct prt_bake_options o = options(PRT_TRANSPORT_JOINT);
    parted_and_killed(&o, 6);
}

// Contract of prt_bake: the same where the light is fixed and the material free.
static void fixed_light(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_POLYNOMIAL);
    struct prt_env *env;
    assert_int_equal(prt_env_load(&context, "constant:1,0.8,0.5", &env), PRT_OK);
    o.env = env;
    parted_and_killed(&o, 4);
    prt_env_destroy(env);
}

// The file's answers with the light or the media contracted first are those of a query at once.
static void contracted_first(const struct prt_transport *t, struct prt_query q,
                             const float (*want)[3])
{
    const size_t n = 3 * (size_t)t->mesh.n_vertex;
    struct prt_contracted_light *lit;
    struct prt_contracted_transport *fixed;
    float(*got)[3] = calloc(t->mesh.n_vertex, sizeof *got);
    assert_int_equal(prt_contracted_light_create(&context, t, q.light, &lit), PRT_OK);
    q.lit = lit;
    assert_int_equal(prt_answer_colors(&context, t, &q, got), PRT_OK);
    expect_below("relative RMSE of the light contracted first",
                 prt_relative_rmse(got[0], want[0], n), 1e-6);
    prt_contracted_light_destroy(lit);
    q.lit = NULL;
    assert_int_equal(prt_contracted_transport_create(&context, t, &t->media, &fixed), PRT_OK);
    assert_int_equal(prt_answer_colors(&context, prt_contracted_transport_get(fixed), &q, got),
                     PRT_OK);
    expect_below("relative RMSE of the media contracted first",
                 prt_relative_rmse(got[0], want[0], n), PRT_FIXED_ERROR);
    prt_contracted_transport_destroy(fixed);
    free(got);
}

// Contract of prt_bake: a joint bake by walks has the most tensors that a file can hold, with
// planes of exit beside an opaque object; the file answers, in every order of contraction.
static void every_tensor_at_once(void **state)
{
    struct prt_bake_options o = options(PRT_TRANSPORT_JOINT);
    struct prt_mesh *mesh = boxes();
    struct prt_file *f;
    struct prt_cube light;
    o.no_single = o.draft = false;
    o.exit_planes = o.unmeasured = true;
    assert_int_equal(prt_bake(&context, mesh, &o, file("whole.prt")), PRT_OK);
    assert_int_equal(prt_file_open(&context, file("whole.prt"), PRT_FILE_CHECK_ALL, &f),
                     PRT_OK);
    const struct prt_transport *t = prt_file_transport(f);
    assert_int_equal(t->n_tensor, PRT_MOST_TENSORS);
    assert_int_equal(prt_cube_init(&light, t->cube), PRT_OK);
    for (uint32_t i = 0; i < 18 * t->cube * t->cube; i++) light.texel[i] = 1;
    float(*color)[3] = calloc(t->mesh.n_vertex, sizeof *color);
    const float eye[3] = {0, 5, 60};
    const struct prt_query query = {.term = PRT_ANSWER_TOTAL, .light = &light, .eye = eye};
    assert_int_equal(prt_answer_colors(&context, t, &query, color), PRT_OK);
    double most = 0;
    for (uint32_t v = 0; v < t->mesh.n_vertex; v++)
        for (int c = 0; c < 3; c++) {
            assert_true(isfinite(color[v][c]) && color[v][c] >= 0);
            most = fmax(most, (double)color[v][c]);
        }
    expect_near("brightest vertex under radiance 1", most, 0.6, 0.5);
    contracted_first(t, query, (const float(*)[3])color);
    free(color);
    prt_cube_finish(&light);
    prt_file_close(f);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(fixed_material),
        cmocka_unit_test(free_light_and_material),
        cmocka_unit_test(fixed_light),
        cmocka_unit_test(every_tensor_at_once),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
