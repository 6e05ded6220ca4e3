// SPDX-License-Identifier: MIT
// The shadow on the plane under a model, pictures without a background, specular occlusion.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"
#include "prt/picture.h"
#include "prt/screen.h"
#include "prt/trace.h"

enum { W = 96, H = 72, CUBE = 16 };
#define R 10.0 // radius [mm] of a ball that stands on y = 0

static struct prt_context context;
static struct prt_mesh *ball;
static struct prt_cube light;
static struct prt_visibility *visibility;

static int set_up(void **state)
{
    struct model m;
    prt_context_init(&context);
    model_init(&m, 65 * 65 * 2, 64 * 64 * 4);
    add_sphere(&m, (float[]){0, (float)R, 0}, (float)R, 48);
    ball = body_mesh(&context, &m, false);
    struct prt_camera camera = {
        .eye = {0, 60, 55}, .target = {0, 2, 0}, .up = {0, 1, 0}, .fovy_deg = 50};
    if (!ball || prt_cube_init(&light, CUBE)) return -1;
    for (int i = 0; i < 6 * CUBE * CUBE * 3; i++) light.texel[i] = 1 + (float)(i % 3);
    return prt_visibility_create(&context, ball, &camera,
                                 &(struct prt_raster){W, H, 4, PRT_RASTER_AUTO}, &visibility);
}

static int clean_up(void **state)
{
    prt_visibility_destroy(visibility);
    prt_cube_finish(&light);
    prt_mesh_destroy(ball);
    return 0;
}

// Distance [mm] from the ball's foot of the plane's point in a pixel.
static double distance_at(int x, int y)
{
    float eye[3], forward[3], right[3], up[3];
    prt_visibility_frame(visibility, eye, forward, right, up);
    double s = 2 * (x + 0.5) / W - 1, t = 1 - 2 * (y + 0.5) / H, d[3];
    for (int i = 0; i < 3; i++)
        d[i] = (double)forward[i] + s * (double)right[i] + t * (double)up[i];
    double k = -(double)eye[1] / d[1];
    return hypot((double)eye[0] + k * d[0], (double)eye[2] + k * d[2]);
}

static double covered(int x, int y)
{
    double n = 0;
    float uv[2];
    for (unsigned s = 0; s < 4; s++)
        n += prt_visibility_sample(visibility, (uint32_t)x, (uint32_t)y, s, uv) != UINT32_MAX;
    return n / 4;
}

// Law: under even light a ball of radius R on the plane leaves 1 - (1 + d^2/R^2)^(-3/2) of the
// irradiance at the distance d from its foot (the form factor of a sphere above an element).
static void shadow_of_a_ball(void **state)
{
    float *left;
    double worst = 0;
    int n = 0;
    assert_int_equal(prt_floor_shadow(&context, ball, visibility, &light, &left), PRT_OK);
    for (int i = 0; i < W * H; i++) {
        double d = distance_at(i % W, i / W);
        if (covered(i % W, i / W) > 0 || d > 3 * R) continue; // it fades from 3.1 R on
        double law = 1 - pow(1 + d * d / (R * R), -1.5);
        for (int c = 0; c < 3; c++) // whatever the light's colour
            worst = fmax(worst, fabs((double)left[3 * i + c] - law));
        n++;
    }
    assert_true(n > W * H / 5);
    expect_below("share of the irradiance beside a ball, absolute", worst, 0.015);
    expect_near("far from it", (double)left[0], 1, 1e-6);
    prt_free(left);
    prt_cube_finish(&light); // a lamp in -x: the shadow falls towards +x, in the lamp's colour
    assert_int_equal(prt_cube_init(&light, CUBE), PRT_OK);
    for (int i = 0; i < 6 * CUBE * CUBE; i++) {
        float *t = light.texel + 3 * i;
        bool lamp = i == CUBE * CUBE + 3 * CUBE + CUBE / 2; // of face -x, above the horizon
        t[0] = lamp ? 400 : 0.1f;
        t[2] = 0.5f;
    }
    assert_int_equal(prt_floor_shadow(&context, ball, visibility, &light, &left), PRT_OK);
    const float *dark = left + 3 * (H / 2 * W + W * 3 / 4),
                *lit = left + 3 * (H / 2 * W + W / 8);
    assert_true(dark[0] < 0.3f && dark[2] > 0.7f && lit[0] > 0.9f);
    prt_free(left);
}

// Law: far from the model, whichever way, the floor is lit in full; also where a picture sees
// it up to the horizon, in front of the model, behind it and beside it.
static void far_floor_is_lit(void **state)
{
    struct prt_visibility *const near = visibility;
    for (int side = 0; side < 4; side++) {
        const float away = 30 * (float)R, x = side < 2 ? side ? away : -away : 0,
                    z = side < 2   ? 0
                        : side > 2 ? away
                                   : -away;
        const struct prt_camera camera = {
            .eye = {x, 40, z}, .target = {0, 0, 0}, .up = {0, 1, 0}, .fovy_deg = 60};
        float *left;
        int n = 0;
        assert_int_equal(prt_visibility_create(&context, ball, &camera,
                                               &(struct prt_raster){W, H, 1, PRT_RASTER_AUTO},
                                               &visibility),
                         PRT_OK);
        assert_int_equal(prt_floor_shadow(&context, ball, visibility, &light, &left), PRT_OK);
        for (int i = 0; i < W * H; i++) {
            for (int c = 0; c < 3; c++)
                assert_true(left[3 * i + c] >= 0 && left[3 * i + c] <= 1);
            if (covered(i % W, i / W) > 0 || distance_at(i % W, i / W) < 5.3 * R) continue;
            for (int c = 0; c < 3; c++) assert_true(left[3 * i + c] == 1);
            n++;
        }
        assert_true(n > W * H / 3);
        prt_free(left);
        prt_visibility_destroy(visibility);
    }
    visibility = near;
}

// Law: a body shadows the floor in the same way whether it is opaque or translucent: the plane
// is through the lowest point of all, here of an opaque ball under a translucent one.
static void floor_under_an_opaque_foot(void **state)
{
    const struct prt_camera camera = {
        .eye = {0, 60, 55}, .target = {0, 2, 0}, .up = {0, 1, 0}, .fovy_deg = 50};
    struct prt_visibility *const one = visibility;
    struct prt_mesh *mesh;
    struct model m;
    float *left[2];
    double worst = 0;
    int n = 0;
    model_init(&m, 2 * 49 * 25, 2 * 48 * 48);
    add_sphere(&m, (float[]){0, 3 * (float)R, 0}, (float)R, 24);
    const uint32_t n_vertex = m.mesh.n_vertex, n_triangle = m.mesh.n_triangle;
    add_sphere(&m, (float[]){0, (float)R, 0}, (float)R, 24);
    assert_non_null(mesh = body_mesh(&context, &m, false));
    assert_int_equal(prt_visibility_create(&context, mesh, &camera,
                                           &(struct prt_raster){W, H, 4, PRT_RASTER_AUTO},
                                           &visibility),
                     PRT_OK);
    for (int k = 0; k < 2; k++) {
        if (k) split_opaque(mesh, n_vertex, n_triangle, (float[]){0.5f, 0.5f, 0.5f});
        assert_int_equal(prt_floor_shadow(&context, mesh, visibility, &light, &left[k]),
                         PRT_OK);
    }
    for (int i = 0; i < W * H; i++) {
        if (covered(i % W, i / W) > 0 || distance_at(i % W, i / W) > 2.5 * R) continue;
        for (int c = 0; c < 3; c++) // both fade further away
            worst = fmax(worst, fabs((double)(left[0][3 * i + c] - left[1][3 * i + c])));
        n++;
    }
    assert_true(n > 100);
    expect_below("shadow of an opaque foot against a translucent one", worst, 0.02);
    for (int k = 0; k < 2; k++) prt_free(left[k]);
    prt_visibility_destroy(visibility);
    prt_mesh_destroy(mesh);
    visibility = one;
}

static struct prt_image shade(bool transparent, const float *shadow)
{
    struct prt_image image;
    float *plane = prt_alloc(ball->n_vertex, 12);
    for (uint32_t i = 0; i < 3 * ball->n_vertex; i++) plane[i] = 0.5f;
    const struct prt_material surface = {.eta = 1.3f, .roughness = 0.3f};
    struct prt_shade s = {.n_plane = 1,
                          .planes = plane,
                          .media = prt_media_one(&surface),
                          .background_rgb = {1, 2, 4},
                          .transparent = transparent,
                          .shadow = shadow};
    assert_int_equal(prt_shade_image(&context, visibility, ball, &s, &image), PRT_OK);
    prt_free(plane);
    return image;
}

// Law: a transparent picture over a background of any colour is the picture with that
// background.
static void composition(void **state)
{
    float *shadow = prt_alloc(W * H, 12);
    for (int i = 0; i < W * H * 3; i++) shadow[i] = 0.25f + 0.5f * (float)(i / 3 % 7) / 7;
    for (int k = 0; k < 2; k++) {
        struct prt_image plain = shade(false, k ? shadow : NULL);
        struct prt_image clear = shade(true, k ? shadow : NULL);
        double worst = 0;
        assert_null(plain.alpha);
        assert_non_null(clear.alpha);
        for (int i = 0; i < W * H * 3; i++) {
            float b = (float[]){1, 2, 4}[i % 3];
            float over = clear.rgb[i] + (1 - clear.alpha[i / 3]) * b;
            worst = fmax(worst, fabs((double)(over - plain.rgb[i])));
        }
        expect_below("a transparent picture over a background", worst, 4e-3); // 1e-3 of 4
        for (int i = 0; i < W * H && !k; i++)
            assert_float_equal(clear.alpha[i], covered(i % W, i / W), 1e-5);
        prt_image_finish(&plain);
        prt_image_finish(&clear);
    }
    prt_free(shadow);
}

// PNG holds straight colours: half covered by radiance 0.5 is the code of 0.5 and alpha 128.
static void files_with_alpha(void **state)
{
    float rgb[2][3] = {{0.25f, 0.25f, 0.25f}, {0, 0, 0}}, alpha[2] = {0.5f, 0};
    struct prt_image image = {2, 1, rgb[0], alpha};
    struct prt_picture_options o = {.tone = PRT_TONE_NONE};
    struct prt_blob blob;
    assert_false(prt_picture_format("a.jpg")->alpha);
    assert_false(prt_picture_format("a.hdr")->alpha);
    assert_int_equal(
        prt_picture_encode(&context, prt_picture_format("a.png"), &image, &o, &blob), PRT_OK);
    assert_int_equal(((uint8_t *)blob.bytes)[25], 6); // IHDR: RGB and alpha
    struct prt_image back;
    assert_int_equal(prt_image_load_memory(&context, "a.png", blob.bytes, blob.size, &back),
                     PRT_OK);
    assert_float_equal(back.rgb[0], 0.5f, 4e-3); // 1/255 of sRGB
    prt_image_finish(&back);
    prt_free(blob.bytes);
    assert_int_equal(
        prt_picture_encode(&context, prt_picture_format("a.exr"), &image, &o, &blob), PRT_OK);
    assert_non_null(memmem(blob.bytes, blob.size, "A\0\1\0\0\0", 6)); // a channel of halves
    assert_int_equal(prt_image_load_memory(&context, "a.exr", blob.bytes, blob.size, &back),
                     PRT_OK);
    assert_float_equal(back.rgb[0], 0.25f, 1e-4);
    prt_image_finish(&back);
    prt_free(blob.bytes);
}

// A picture of more points than are measured is measured all over, not at its first rows.
static void larger_pictures_err_alike(const struct prt_mesh *mesh,
                                      const struct prt_scene *scene, const struct prt_cube *sky,
                                      const struct prt_camera *camera, double with,
                                      double without)
{
    struct prt_visibility *seen;
    struct prt_gbuffer g;
    double now, plain;
    assert_int_equal(prt_visibility_create(&context, mesh, camera,
                                           &(struct prt_raster){640, 480, 1, PRT_RASTER_AUTO},
                                           &seen),
                     PRT_OK);
    prt_visibility_gbuffer(seen, &g);
    assert_true(g.n_point > 3 * 4096);
    assert_int_equal(prt_specular_error(&context, scene, seen, sky, 1.5f, 0.2f, &now, &plain),
                     PRT_OK);
    expect_near("error of a larger picture over a smaller one's", now / with, 1, 0.2);
    expect_near("the same without occlusion", plain / without, 1, 0.1);
    prt_visibility_destroy(seen);
}

// Specular occlusion: none on a convex body, and on one that sees itself closer to traced rays
// than reflections without it.
static void reflections_of_hidden_sky(void **state)
{
    struct prt_camera camera = {
        .eye = {30, 45, 70}, .target = {0, 0, 0}, .up = {0, 1, 0}, .fovy_deg = 40};
    struct prt_cube sky;
    assert_int_equal(prt_cube_init(&sky, 64), PRT_OK);
    for (int i = 0; i < 6 * 64 * 64 * 3; i++) sky.texel[i] = i / (64 * 64 * 3) == 2 ? 4 : 0.5f;
    for (int k = 0; k < 2; k++) {
        struct model m;
        struct prt_scene *scene;
        struct prt_visibility *seen;
        struct prt_gbuffer g;
        double with, without;
        model_init(&m, 240 * 121, 240 * 120 * 2);
        if (k) add_ball(&m, 240, 120, 120, fluted_ball);
        else add_round_ball(&m, 240, 120, 20);
        struct prt_mesh *mesh = body_mesh(&context, &m, false);
        mesh->blocked = prt_alloc(mesh->n_vertex, sizeof *mesh->blocked);
        assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
        assert_int_equal(prt_scene_blocked(&context, scene, mesh->blocked), PRT_OK);
        assert_int_equal(
            prt_visibility_create(&context, mesh, &camera,
                                  &(struct prt_raster){160, 120, 1, PRT_RASTER_AUTO}, &seen),
            PRT_OK);
        prt_visibility_gbuffer(seen, &g);
        double least = 1;
        for (uint32_t i = 0; i < g.n_point; i++) least = fmin(least, (double)g.unblocked[i]);
        assert_int_equal(
            prt_specular_error(&context, scene, seen, &sky, 1.5f, 0.2f, &with, &without),
            PRT_OK);
        if (k) {
            expect_above("error of reflections without occlusion, flutes", without, 0.2);
            expect_below("with occlusion, as a share of that", with / without, 0.6);
            larger_pictures_err_alike(mesh, scene, &sky, &camera, with, without);
        } else {
            expect_above("least share of a reflection that a ball leaves", least, 0.999);
        }
        prt_visibility_destroy(seen);
        prt_scene_destroy(scene);
        prt_free(mesh->blocked);
        prt_mesh_destroy(mesh);
    }
    prt_cube_finish(&sky);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(floor_under_an_opaque_foot), // under the even light
        cmocka_unit_test(shadow_of_a_ball),
        cmocka_unit_test(far_floor_is_lit),
        cmocka_unit_test(composition),
        cmocka_unit_test(files_with_alpha),
        cmocka_unit_test(reflections_of_hidden_sky),
    };
    return run_physics_tests(tests, set_up, clean_up);
}
