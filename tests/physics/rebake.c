// SPDX-License-Identifier: MIT
// A bake of a model that was changed takes the rays of the bake before it, but for those that
// the change can reach, and writes the bytes that it writes without them.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bake/shape_change.h"
#include "bake_files.h"
#include "bodies.h"
#include "prt/bake.h"
#include "prt/light.h"

static char cache[64];

// A ball of 20 model units; what stands beside it, and how it differs.
struct scene {
    bool occluder, second;     // an opaque plate above, a translucent box at its side
    bool first;                // the box has the first vertices
    double moved, scale;       // factor of one vertex; mm a unit, 0: 1
    uint32_t n_sample, n_face; // n_face: squares of the plate's side
    body_radius radius;        // NULL: fluted
};

static uint32_t add_part(struct model *m, struct part *part, const float *rgb)
{
    *part = (struct part){m->mesh.n_vertex, m->mesh.n_triangle, rgb};
    return 1;
}

static struct prt_mesh *build(const struct scene *s)
{
    static const float grey[3] = {0.5f, 0.5f, 0.5f};
    struct part part[3];
    struct model m;
    uint32_t n = 0;
    model_init(&m, 4000, 8000);
    if (s->second && s->first) {
        n += add_part(&m, &part[n], NULL);
        add_box(&m, (float[3]){31, 0, 0}, (float[3]){5, 5, 5}, 6);
    }
    const uint32_t ball = m.mesh.n_vertex;
    n += add_part(&m, &part[n], NULL);
    add_ball(&m, 40, 20, 20, s->radius ? s->radius : fluted_ball);
    if (s->second && !s->first) {
        n += add_part(&m, &part[n], NULL);
        add_box(&m, (float[3]){31, 0, 0}, (float[3]){5, 5, 5}, 6);
    }
    if (s->occluder) {
        n += add_part(&m, &part[n], grey);
        add_box(&m, (float[3]){-4, 36, 0}, (float[3]){9, 1, 12}, s->n_face ? s->n_face : 1);
    }
    for (int k = 0; k < 3 && s->moved > 0; k++)
        m.mesh.position[ball + 213][k] *= (float)s->moved;
    struct prt_mesh *mesh = body_mesh(&context, &m, true);
    split_parts(mesh, n, part);
    prt_free(mesh->model); // its scale is 1
    mesh->model = NULL;
    mesh->mm_per_unit = 0;
    assert_int_equal(prt_mesh_scale(&context, mesh, 0, s->scale > 0 ? s->scale : 1), PRT_OK);
    return mesh;
}

// Returns the share of pass 1's directions that came from the folder; 0 without one.
static double bake(const struct scene *s, const char *dir, const char *out)
{
    static struct prt_material medium;
    struct prt_bake_profile profile = {0};
    struct prt_bake_options o = {.engine = PRT_TRANSPORT_WAVELET,
                                 .n_sample = s->n_sample ? s->n_sample : 2000,
                                 .cube = 16,
                                 .seed = 3,
                                 .no_single = true,
                                 .unmeasured = true,
                                 .cache = dir,
                                 .profile = &profile};
    struct prt_mesh *mesh = build(s);
    assert_int_equal(prt_material_load(&context, "marble", &medium), PRT_OK);
    o.media = prt_media_one(&medium);
    assert_int_equal(prt_bake(&context, mesh, &o, out), PRT_OK);
    prt_mesh_destroy(mesh);
    assert_true(profile.cached == !!dir);
    return profile.reused;
}

static void clear(void)
{
    char command[300];
    snprintf(command, sizeof command, "rm -rf %s", cache);
    assert_int_equal(system(command), 0);
}

// Bakes `to` after `from`, and without it: the same bytes. Returns the share that was reused.
static double rebake(const struct scene *from, const struct scene *to)
{
    clear();
    assert_true(bake(from, cache, file("before.prt")) == 0);
    bake(to, NULL, file("plain.prt"));
    const double reused = bake(to, cache, file("after.prt"));
    same_bytes(file("plain.prt"), file("after.prt"));
    return reused;
}

// Law: visibility does not depend on the unit of length. The scales are no powers of two, so
// that positions in mm are rounded anew.
static void another_scale_casts_no_ray(void **state)
{
    const struct scene large = {.scale = 1.7, .occluder = true},
                       small = {.occluder = true, .scale = 0.31};
    expect_near("reused at another scale", rebake(&small, &large), 1, 1e-12);
}

// Contract of options.cache: samples of a smaller number are among those of a larger one.
static void other_numbers_of_samples_share(void **state)
{
    const struct scene few = {.n_sample = 1200}, many = {.n_sample = 2000};
    expect_near("reused by more samples", rebake(&few, &many), 0.6, 0.03);
    expect_above("reused by fewer samples", rebake(&many, &few), 0.98);
}

// Contract of options.cache: rays that a vertex cannot have met are taken, here and when it is
// moved back.
static void moved_vertex(void **state)
{
    const struct scene still = {.n_sample = 4000}, moved = {.n_sample = 4000, .moved = 1.3};
    expect_above("reused where a vertex is moved", rebake(&still, &moved), 0.6);
    expect_above("reused where it is moved back", rebake(&moved, &still), 0.6);
    assert_true(bake(&still, cache, file("again.prt")) == 1); // now its own rays are there
    same_bytes(file("plain.prt"), file("again.prt"));
}

// Law: an opaque object shadows what is far from it, and shadows no more when it is removed. A
// plate of two triangles a face and a plate of many are the same to the rays.
static void receiver_comes_and_goes(void **state)
{
    for (uint32_t n_face = 1; n_face <= 9; n_face += 8) {
        const struct scene with = {.occluder = true, .n_face = n_face}, without = {0};
        expect_above("reused where a receiver comes", rebake(&without, &with), 0.4);
        expect_above("reused where it goes", rebake(&with, &without), 0.4);
    }
    // and the change is one: the shadow changes the bytes
    const struct scene with = {.occluder = true}, without = {0};
    struct prt_blob a, b;
    bake(&with, NULL, file("with.prt"));
    bake(&without, NULL, file("without.prt"));
    assert_int_equal(prt_read_file(&context, file("with.prt"), 1u << 30, &a), PRT_OK);
    assert_int_equal(prt_read_file(&context, file("without.prt"), 1u << 30, &b), PRT_OK);
    assert_true(a.size != b.size || memcmp(a.bytes, b.bytes, a.size));
    prt_free(a.bytes), prt_free(b.bytes);
}

// Contract of options.cache: one more translucent object leaves the samples of the first, which
// are fewer then; all numbers of vertices, triangles and objects may change.
static void one_more_object(void **state)
{
    for (int first = 0; first < 2; first++) {
        const struct scene two = {.second = true, .first = first}, one = {0};
        expect_above("reused where an object comes", rebake(&one, &two), 0.4);
        expect_above("reused where it goes", rebake(&two, &one), 0.4);
    }
}

// Contract of options.cache: of several files the most similar is taken; another model takes
// nothing.
static void most_similar_is_taken(void **state)
{
    const struct scene other = {.radius = dented_ball}, still = {0}, moved = {.moved = 1.02};
    clear();
    bake(&other, cache, file("other.prt"));
    assert_true(bake(&still, cache, file("still.prt")) == 0);
    bake(&moved, NULL, file("plain.prt"));
    expect_above("reused beside another model's", bake(&moved, cache, file("after.prt")), 0.6);
    same_bytes(file("plain.prt"), file("after.prt"));
}

// Contract of prt_shape_change_mark: no ray from a point within `apart` of a sample meets a
// changed triangle in a packet that is not marked; and far triangles mark few packets.
static void marks_what_rays_meet(void **state)
{
    enum { RAYS = 200000 };
    const struct scene still = {0}, moved = {.moved = 1.3};
    struct prt_mesh *a = build(&still), *b = build(&moved);
    struct directions *d;
    struct shape_change *change = NULL;
    struct prt_rng rng;
    const struct shape before = {a->n_vertex, a->n_triangle, (const float(*)[3])a->model,
                                 (const uint32_t(*)[3])a->triangle};
    const struct shape now = {b->n_vertex, b->n_triangle, (const float(*)[3])b->model,
                              (const uint32_t(*)[3])b->triangle};
    assert_int_equal(prt_directions_create(0, 16, 4, 1, &d), PRT_OK);
    assert_int_equal(prt_shape_change_create(&before, &before, d, &change), PRT_OK);
    assert_null(change);
    assert_int_equal(prt_shape_change_create(&before, &now, d, &change), PRT_OK);
    assert_non_null(change);
    prt_rng_init(&rng, 5, 5);
    double share = 0;
    for (int i = 0; i < RAYS; i++) {
        const uint32_t v = prt_rng_u32(&rng) % a->n_vertex;
        const uint32_t t = i % 2 ? 213 : v; // a point of the old or the new vertex's triangles
        const float(*target)[3] = (const float(*)[3])(i % 4 < 2 ? a->model : b->model);
        const float *at = a->model[v], *normal = a->normal[v];
        uint64_t fresh[6 * 8 * 8 / 64 + 1] = {0};
        float w[3], s, u, up = 0;
        unsigned face;
        prt_shape_change_mark(change, at, normal, 0.01f, fresh);
        for (int k = 0; k < 6; k++) share += __builtin_popcountll(fresh[k]) / 384.0 / RAYS;
        for (int k = 0; k < 3; k++) w[k] = target[t][k] - at[k], up += w[k] * normal[k];
        if (t != 213 || v == t || up <= 0) continue;
        prt_cube_lookup(w, &face, &s, &u);
        const uint32_t x = (uint32_t)fminf((s + 1) * 4, 7), y = (uint32_t)fminf((u + 1) * 4, 7);
        const uint32_t packet = (face * 8 + y) * 8 + x;
        assert_true(fresh[packet / 64] >> packet % 64 & 1);
    }
    expect_below("packets that one vertex marks", share, 0.2);
    prt_shape_change_destroy(change);
    prt_directions_destroy(d);
    prt_mesh_destroy(a);
    prt_mesh_destroy(b);
}

int main(void)
{
    if (!bake_files_begin()) return 1;
    snprintf(cache, sizeof cache, "%s/cache", folder);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(another_scale_casts_no_ray),
        cmocka_unit_test(other_numbers_of_samples_share),
        cmocka_unit_test(moved_vertex),
        cmocka_unit_test(receiver_comes_and_goes),
        cmocka_unit_test(one_more_object),
        cmocka_unit_test(most_similar_is_taken),
        cmocka_unit_test(marks_what_rays_meet),
    };
    return run_physics_tests(tests, NULL, bake_files_end);
}
