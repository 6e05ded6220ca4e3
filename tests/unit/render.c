// SPDX-License-Identifier: MIT
// Parts of an answer that no bake is needed for: colours and pictures as bytes, which of a
// bake's measured errors is told, the numbers of a cost, keys of lights and media, and the
// camera.
#include <setjmp.h>
#include <limits.h>
#include <math.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "relight.pb-c.h"
#include "core/image_format.h"
#include "render/walk.h"

enum { N = 50, PLANES = 2, SOME = 20 };

// Colours of the first vertices of a coarse order have the bytes that all vertices have, in
// each format and with the exposure.
static void coarse_colours_are_those_of_all(void **state)
{
    struct prt_context ctx;
    struct render_spec spec = {.exposure_ev = 1.5f};
    struct vertex_values *values = calloc(1, sizeof *values + PLANES * N * 3 * sizeof(float));
    uint32_t vertex[SOME];
    uint8_t all[PLANES * N * 12], some[PLANES * SOME * 12];
    assert_non_null(values);
    prt_context_init(&ctx);
    values->n_plane = PLANES;
    values->n_vertex = N;
    for (int i = 0; i < PLANES * N * 3; i++) values->values[i] = (float)(i * 37 % 101) / 150;
    for (uint32_t i = 0; i < SOME; i++) vertex[i] = (7 * i + 3) % N;
    static const int formats[] = {
        RELIGHT__COLOR_FORMAT__COLOR_F32, RELIGHT__COLOR_FORMAT__COLOR_F16,
        RELIGHT__COLOR_FORMAT__COLOR_RGB9E5, RELIGHT__COLOR_FORMAT__COLOR_SRGB8};
    for (int k = 0; k < 4; k++) {
        spec.format = formats[k];
        const size_t n = color_bytes(spec.format);
        encode_colors(&ctx, &spec, values, all);
        assert_int_equal(encode_coarse(&ctx, &spec, values, vertex, SOME, some), 0);
        for (size_t plane = 0; plane < PLANES; plane++)
            for (size_t i = 0; i < SOME; i++)
                assert_memory_equal(some + (plane * SOME + i) * n,
                                    all + (plane * N + vertex[i]) * n, n);
    }
    free(values);
}

// Single scattering was measured along the normal and towards eyes: an answer for an eye, as a
// picture is, has the larger error.
static void the_error_is_that_of_the_view(void **state)
{
    struct render *r = calloc(1, sizeof *r);
    struct model *m = calloc(1, sizeof *m);
    assert_true(r && m);
    r->model = m;
    m->facts.error_multiple = .01f;
    m->facts.error_single = .02f;
    m->facts.error_view = .05f;
    r->spec.term = RELIGHT__TERM__TERM_SINGLE;
    assert_true(bake_error(r) == .02f);
    r->spec.has_eye = true;
    assert_true(bake_error(r) == .05f);
    m->facts.error_view = .001f;
    assert_true(bake_error(r) == .02f);
    m->facts.error_view = .05f;
    r->spec.has_eye = false;
    r->spec.picture = true;
    assert_true(bake_error(r) == .05f);
    r->spec.term = RELIGHT__TERM__TERM_MULTIPLE;
    assert_true(bake_error(r) == .01f);
    r->spec.term = RELIGHT__TERM__TERM_IRRADIANCE; // it is traced
    assert_true(bake_error(r) == 0);
    free(m);
    free(r);
}

// Every number of a cost has its own name. What is left of the whole time is the queue's.
static void a_cost_has_its_numbers(void **state)
{
    const struct render_result r = {.light_ms = 1,
                                    .relight_ms = 2,
                                    .raster_ms = 4,
                                    .shade_ms = 8,
                                    .encode_ms = 16,
                                    .total_ms = 63,
                                    .shared = 3,
                                    .error_bound = .5f,
                                    .engine = RELIGHT__ENGINE__ENGINE_JOINT,
                                    .samples = 5,
                                    .frames = 6,
                                    .converged = true,
                                    .note = "note",
                                    .bake_fraction = .25f};
    Relight__Cost c;
    render_cost_message(&r, &c);
    assert_true(c.light_ms == 1 && c.relight_ms == 2 && c.raster_ms == 4);
    assert_true(c.shade_ms == 8 && c.encode_ms == 16 && c.total_ms == 63 && c.queue_ms == 32);
    assert_true(c.shared == 3 && c.samples == 5 && c.frames == 6 && c.converged && !c.draft);
    assert_true(c.error_bound == .5f && c.bake_fraction == .25f);
    assert_int_equal(c.engine, RELIGHT__ENGINE__ENGINE_JOINT);
    assert_string_equal(c.note, "note");
}

static void expect_different(const char *a, const char *b)
{
    if (!strcmp(a, b)) fail_msg("the same key: %s", a);
}

// Keys name all that a light depends on: its cube within a payload, its gain and its turn. The
// key of a light before its turn has all but the turn.
static void keys_of_lights(void **state)
{
    static const float texels[2 * 18 * 16 * 16];
    struct render_light first = {.cube_n = 16, .gain = {1, 1, 1}}, other = first;
    for (int hashed = 0; hashed < 2; hashed++) {
        static const char *const hash[] = {"", "0123"};
        other = first;
        render_light_name(&first, texels, hash[hashed]);
        other.texel = 18 * 16 * 16;
        render_light_name(&other, texels, hash[hashed]);
        if (hashed) expect_different(first.key, other.key);
        else assert_string_equal(first.key, other.key); // equal texels
        for (int c = 0; c < 3; c++) {
            other = first;
            other.gain[c] = 2;
            render_light_name(&other, texels, hash[hashed]);
            expect_different(first.key, other.key);
            expect_different(first.still_key, other.still_key);
        }
        other = first;
        other.rotate_deg = 30;
        render_light_name(&other, texels, hash[hashed]);
        expect_different(first.key, other.key);
        assert_string_equal(first.still_key, other.still_key);
    }
    // Turned in a view, a light has the key of one that came so.
    struct render_spec *spec = calloc(1, sizeof *spec);
    Relight__Light turn = RELIGHT__LIGHT__INIT, *turns[] = {&turn};
    char error[300];
    assert_non_null(spec);
    spec->n_light = 1;
    spec->light[0] = first;
    turn.rotate_deg = 30 - 720;
    assert_int_equal(render_spec_turn(spec, 1, turns, true, false, error), 0);
    assert_string_equal(spec->light[0].key, other.key);
    assert_int_equal(render_spec_turn(spec, 0, turns, true, false, error),
                     RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    free(spec);
}

static void expect_other_material(const struct prt_material *a, const struct prt_material *b)
{
    char one[MATERIAL_KEY], two[MATERIAL_KEY];
    material_key(a, one);
    material_key(b, two);
    expect_different(one, two);
}

// So do those of media, whatever a medium's name is.
static void keys_of_media(void **state)
{
    struct prt_material *m = calloc(2, sizeof *m);
    char one[MATERIAL_KEY], two[MATERIAL_KEY];
    assert_non_null(m);
    m[0] = (struct prt_material){
        .name = "a", .eta = 1.3f, .roughness = .3f, .profile = 1, .n_point = 4};
    for (int field = 0; field < 6; field++)
        for (int c = 0; c < (field < 4 ? 3 : 1); c++) {
            m[1] = m[0];
            float *const at[] = {&m[1].sigma_s_prime[c],  &m[1].sigma_a[c], &m[1].g[c],
                                 &m[1].reflectance[c][3], &m[1].eta,        &m[1].roughness};
            *at[field] += .125f;
            expect_other_material(&m[0], &m[1]);
        }
    m[1] = m[0];
    m[1].radius[3] = 1;
    expect_other_material(&m[0], &m[1]);
    m[1] = m[0];
    m[1].name[0] = 'b';
    material_key(&m[0], one);
    material_key(&m[1], two);
    assert_string_equal(one, two);
    // The same media of the same objects in another order are other media.
    struct media_map *map[3];
    for (int k = 0; k < 3; k++) {
        assert_non_null(map[k] = media_map_create(2));
        for (unsigned i = 0; i < 2; i++) {
            snprintf(map[k]->entry[i].object, 8, "%c", k == 1 ? 'b' - (int)i : 'a' + (int)i);
            map[k]->entry[i].material = m[0];
            map[k]->entry[i].material.eta += (float)i / 8;
        }
        if (k == 2) map[k]->entry[1].material.eta += .25f;
        media_map_set_key(map[k]);
    }
    expect_different(map[0]->key, map[1]->key);
    expect_different(map[0]->key, map[2]->key);
    for (int k = 0; k < 3; k++) media_map_release(map[k]);
    free(m);
}

static void wait_for(struct server *server, const struct cache_entry *entry)
{
    while (entry->state == CACHE_PENDING) loop_turn(server->loop, -1);
    assert_int_equal(entry->state, CACHE_READY);
}

// Without a camera a model is framed for the picture's shape, whatever shape the picture before
// had, and for its vertices as they are, and from where an orbit is; one variant's parts are
// not another's. A worker does that, since it reads every vertex: choosing the camera takes the
// same time for a mesh that has none of the vertices that it says.
static void frames_fit_the_picture(void **state)
{
    static const float position[][3] = {{-3, -1, 0}, {3, -1, 0}, {3, 1, 0}, {-3, 1, 0}};
    static const uint32_t triangle[][3] = {{0, 1, 2}, {0, 2, 3}};
    static const uint32_t sides[][2] = {{90, 30}, {30, 90}, {60, 60}, {90, 30}};
    static const struct prt_orbit orbits[] = {{0, 0, 1}, {30, 0, 1}, {0, 30, 1}, {0, 0, 2}};
    float moved[4][3];
    struct prt_context ctx;
    struct prt_mesh *mesh[2];
    struct server *server = calloc(1, sizeof *server);
    struct model *model = calloc(1, sizeof *model);
    struct render_spec *spec = calloc(1, sizeof *spec);
    char error[300];
    assert_true(server && model && spec);
    prt_context_init(&ctx);
    assert_int_equal(loop_create(&server->loop), 0);
    assert_int_equal(work_pool_create(server->loop, 1, 0, &server->work), 0);
    assert_int_equal(cache_create(1 << 30, &server->cache), 0);
    model->server = server;
    strcpy(model->key, "model");
    for (int i = 0; i < 12; i++) moved[i / 3][i % 3] = 2 * position[i / 3][i % 3];
    assert_int_equal(prt_mesh_create(&ctx, 4, position, NULL, 2, triangle, &mesh[0]), 0);
    assert_int_equal(
        prt_mesh_create(&ctx, 4, (const float(*)[3])moved, NULL, 2, triangle, &mesh[1]), 0);
    for (int i = 0; i < 28; i++) {
        struct prt_camera chosen, want, got;
        struct prt_mesh unread = {.n_vertex = UINT32_MAX}; // without vertices: not to be read
        const struct prt_mesh *seen = mesh[i / 4 % 2];
        snprintf(spec->variant, sizeof spec->variant, "%s", i % 12 < 8 ? "" : "other");
        spec->width = sides[i % 4][0];
        spec->height = sides[i % 4][1];
        spec->samples = 1;
        spec->has_camera = spec->has_orbit = i >= 12;
        spec->orbit = orbits[i / 4 % 4];
        float aspect = (float)spec->width / (float)spec->height;
        if (spec->has_orbit) prt_camera_frame_from(seen, aspect, &spec->orbit, &want);
        else prt_camera_frame(seen, aspect, &want);
        assert_int_equal(camera_choose(spec, &unread, &chosen, error), 0);
        struct cache_entry *entry =
            visibility_get(model, 1 + (uint64_t)(i / 4 % 2), NULL, seen, spec, &chosen);
        wait_for(server, entry);
        prt_visibility_camera(entry->value, &got, NULL, NULL, NULL);
        assert_memory_equal(got.eye, want.eye, sizeof want.eye);
        assert_memory_equal(got.target, want.target, sizeof want.target);
        assert_true(got.fovy_deg == want.fovy_deg && !got.automatic);
        cache_release(entry);
    }
    cache_destroy(server->cache);
    work_pool_destroy(server->work);
    loop_destroy(server->loop);
    prt_mesh_destroy(mesh[0]);
    prt_mesh_destroy(mesh[1]);
    free(spec);
    free(model);
    free(server);
}

static struct prt_blob picture_as(int format, unsigned quality, float ev)
{
    enum { SIDE = 16 };
    struct prt_context ctx;
    float rgb[SIDE * SIDE][3];
    struct prt_image image = {SIDE, SIDE, rgb[0], NULL};
    struct render_spec *spec = calloc(1, sizeof *spec);
    struct prt_blob out = {0};
    assert_non_null(spec);
    prt_context_init(&ctx);
    for (int i = 0; i < SIDE * SIDE; i++)
        for (int c = 0; c < 3; c++) rgb[i][c] = (float)(i * (7 + c) % 31 + 1) / 300;
    spec->width = spec->height = SIDE;
    spec->image_format = format;
    spec->quality = quality;
    spec->picture_ev = ev;
    spec->tone = RELIGHT__TONE__TONE_NONE;
    assert_int_equal(encode_image(&ctx, spec, &image, &out), 0);
    free(spec);
    return out;
}

static bool equal_pictures(int format, const unsigned quality[2], const float ev[2])
{
    struct prt_blob a = picture_as(format, quality[0], ev[0]),
                    b = picture_as(format, quality[1], ev[1]);
    const bool equal = a.size == b.size && !memcmp(a.bytes, b.bytes, a.size);
    prt_free(a.bytes);
    prt_free(b.bytes);
    return equal;
}

// A JPEG has the quality that its request names, pictures of 8 and 16 bits the exposure; linear
// ones are not exposed. OpenEXR of floats keeps all their bits, of halves not.
static void pictures_have_their_options(void **state)
{
    static const int exposed[] = {
        RELIGHT__IMAGE_FORMAT__IMAGE_JPEG, RELIGHT__IMAGE_FORMAT__IMAGE_PNG,
        RELIGHT__IMAGE_FORMAT__IMAGE_PNG16, RELIGHT__IMAGE_FORMAT__IMAGE_RGB8};
    static const int linear[] = {RELIGHT__IMAGE_FORMAT__IMAGE_EXR,
                                 RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT,
                                 RELIGHT__IMAGE_FORMAT__IMAGE_F16};
    static const unsigned same[2] = {90, 90}, worse[2] = {90, 40};
    static const float none[2] = {0, 0}, brighter[2] = {0, 1};
    assert_false(equal_pictures(RELIGHT__IMAGE_FORMAT__IMAGE_JPEG, worse, none));
    for (size_t i = 0; i < sizeof exposed / sizeof *exposed; i++)
        assert_false(equal_pictures(exposed[i], same, brighter));
    for (size_t i = 0; i < sizeof linear / sizeof *linear; i++)
        assert_true(equal_pictures(linear[i], same, brighter));
    struct prt_context ctx;
    prt_context_init(&ctx);
    for (int whole = 0; whole < 2; whole++) {
        struct prt_image image;
        double worst = 0;
        struct prt_blob file = picture_as(whole ? RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT
                                                : RELIGHT__IMAGE_FORMAT__IMAGE_EXR,
                                          90, 0);
        assert_int_equal(prt_image_load_memory(&ctx, "a.exr", file.bytes, file.size, &image),
                         0);
        for (int i = 0; i < 16 * 16 * 3; i++) {
            const float want = (float)(i / 3 * (7 + i % 3) % 31 + 1) / 300;
            worst = fmax(worst, fabs((double)(image.rgb[i] - want)));
        }
        assert_true(whole ? worst == 0 : worst > 0 && worst < 1e-4);
        prt_image_finish(&image);
        prt_free(file.bytes);
    }
}

// A mean is of one engine's pictures: it begins anew with another's.
static void a_mean_is_of_one_engine(void **state)
{
    struct refinement *r = refinement_create();
    struct screen_radiance *a = calloc(1, sizeof *a + sizeof *a->rgb);
    assert_true(r && a);
    a->n_point = 1;
    for (int i = 0; i < 5; i++) {
        const bool second = i >= 3;
        a->report.engine = second ? PRT_SCREEN_TANGENT : PRT_SCREEN_SPLAT;
        a->report.n_asked = second ? 50 : 7;
        a->report.expected_error = second ? .02 : .25;
        for (int c = 0; c < 3; c++) a->rgb[0][c] = second ? 5 : 1;
        assert_int_equal(refinement_add(r, a), 0);
        assert_int_equal(r->n_frame, i + 1);
        assert_int_equal(r->n_mean, second ? i - 2 : i + 1);
        assert_int_equal(r->engine, a->report.engine);
        assert_int_equal(r->n_sample, a->report.n_asked);
        assert_true(r->expected_error == a->report.expected_error);
        for (int c = 0; c < 3; c++) assert_true(r->mean[0][c] == a->rgb[0][c]);
    }
    a->n_point = 2; // of another picture
    assert_int_equal(refinement_add(r, a), PRT_INTERNAL);
    refinement_release(r);
    free(a);
}

static void every_format_of_the_protocol_is_drawn(void **state)
{
    const ProtobufCEnumDescriptor *list = &relight__image_format__descriptor;
    for (unsigned i = 0; i < list->n_values; i++)
        if (!image_format_of((unsigned)list->values[i].value))
            fail_msg("server/core/image_format.c has no row for %s", list->values[i].name);
    assert_null(image_format_of(list->n_values));
    assert_null(image_format_of(UINT_MAX));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(coarse_colours_are_those_of_all),
        cmocka_unit_test(the_error_is_that_of_the_view),
        cmocka_unit_test(a_cost_has_its_numbers),
        cmocka_unit_test(keys_of_lights),
        cmocka_unit_test(keys_of_media),
        cmocka_unit_test(frames_fit_the_picture),
        cmocka_unit_test(pictures_have_their_options),
        cmocka_unit_test(every_format_of_the_protocol_is_drawn),
        cmocka_unit_test(a_mean_is_of_one_engine),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
