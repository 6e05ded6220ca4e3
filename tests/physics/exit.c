// SPDX-License-Identifier: MIT
// The exit conserves light (METHODS §1): under radiance 1 from everywhere, a body that absorbs
// nothing shows radiance 1, diffuse and reflected light together.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

#include "bodies.h"
#include "expect.h"
#include "prt/bake.h"
#include "prt/raster.h"
#include "prt/reference.h"
#include "prt/relight.h"
#include "prt/screen.h"

enum { U = 64, V = 32, SIDE = 64 };
static const float radius_mm = 10;
static struct prt_context context;
static char path[] = "/tmp/prt-exit-XXXXXX";

static void log_errors(void *user, enum prt_log_level level, const char *line)
{
    if (level == PRT_LOG_ERROR) print_message("  %s\n", line);
}

// A ball that fills most of a picture, its light, and the picture's visibility.
struct scene {
    struct prt_mesh *mesh;
    struct prt_cube light;
    struct prt_specular *specular;
    struct prt_visibility *visibility;
};

static struct scene scene_of(struct prt_mesh *mesh, const float eye[3])
{
    struct scene s = {.mesh = mesh};
    struct prt_camera camera = {.up = {0, 1, 0}, .fovy_deg = 2};
    memcpy(camera.eye, eye, sizeof camera.eye);
    assert_int_equal(prt_cube_init(&s.light, 16), PRT_OK);
    for (uint32_t i = 0; i < 6 * 16 * 16 * 3; i++) s.light.texel[i] = 1;
    assert_int_equal(prt_specular_create(&context, &s.light, &s.specular), PRT_OK);
    assert_int_equal(prt_visibility_create(&context, mesh, &camera,
                                           &(struct prt_raster){SIDE, SIDE, 4, PRT_RASTER_AUTO},
                                           &s.visibility),
                     PRT_OK);
    return s;
}

static void scene_finish(struct scene *s)
{
    prt_visibility_destroy(s->visibility);
    prt_specular_destroy(s->specular);
    prt_cube_finish(&s->light);
    prt_mesh_destroy(s->mesh);
}

static struct prt_mesh *ball(void)
{
    struct model m;
    model_init(&m, U * (V + 1), 2 * U * V);
    add_round_ball(&m, U, V, (double)radius_mm);
    return body_mesh(&context, &m, true);
}

// Mean and extremes of pixels that the body covers wholly, over RGB.
struct furnace {
    double mean, least, most;
};

static struct furnace furnace_of(const struct scene *s, const struct prt_image *image)
{
    struct furnace f = {.least = INFINITY, .most = -INFINITY};
    size_t n = 0;
    for (uint32_t i = 0; i < SIDE * SIDE; i++) {
        float uv[2];
        bool inside = true;
        for (unsigned k = 0; k < 4; k++)
            inside &=
                prt_visibility_sample(s->visibility, i % SIDE, i / SIDE, k, uv) != UINT32_MAX;
        for (uint32_t c = 0; inside && c < 3; c++) {
            double x = (double)image->rgb[3 * (size_t)i + c];
            f.mean += x;
            f.least = fmin(f.least, x);
            f.most = fmax(f.most, x);
            n++;
        }
    }
    assert_true(n > SIDE * SIDE / 4);
    f.mean /= (double)n;
    return f;
}

static struct prt_shade shade_of(const struct scene *s, const struct prt_material *m)
{
    return (struct prt_shade){.n_plane = 1,
                              .media = prt_media_one(m),
                              .fresnel = true,
                              .specular = s->specular,
                              .background_rgb = {1, 1, 1}};
}

// Light that leaves a ball through the surface within a chord r of a point enters an area pi
// r^2, as on a plane: a profile of albedo 1 and short reach returns E there, too.
static struct prt_material white_profile(double eta)
{
    struct prt_material m;
    char text[200];
    const double top = 1 / (3 * M_PI); // the cone of 3 mm whose integral is 1
    snprintf(
        text, sizeof text,
        "{\"profile\":\"curve\",\"radius\":[0,3],\"rd\":[[%g,0],[%g,0],[%g,0]],\"eta\":%g}",
        top, top, top, eta);
    assert_int_equal(prt_material_load(&context, text, &m), PRT_OK);
    return m;
}

// Law: the whole picture is 1 in every direction, by the brute-force engine and by a bake.
static void vertices_of_a_white_ball(void **state)
{
    for (int k = 0; k < 2; k++) {
        struct scene s = scene_of(ball(), (const float[]){300, 400, 300});
        struct prt_material m = white_profile(k ? 1.5 : 1.3);
        struct prt_bake_options bake = {
            .media = prt_media_one(&m), .n_sample = 20000, .cube = 16, .max_error = 0.002};
        struct prt_reference_options o = {
            .term = PRT_REFERENCE_TOTAL, .no_exit = true, .n_sample = 20000, .n_ray = 512};
        float(*plane)[3] = calloc(s.mesh->n_vertex, sizeof *plane);
        struct prt_file *file;
        assert_int_equal(prt_bake(&context, s.mesh, &bake, path), PRT_OK);
        assert_int_equal(prt_file_open(&context, path, PRT_FILE_CHECK_ALL, &file), PRT_OK);
        for (int baked = 0; baked < 2; baked++) {
            struct prt_query q = {.term = PRT_ANSWER_TOTAL, .light = &s.light};
            struct prt_shade shade = shade_of(&s, &m);
            struct prt_image image;
            unsigned n_plane = 1;
            if (baked)
                assert_int_equal(prt_answer_planes(&context, prt_file_transport(file), &q,
                                                   &n_plane, plane[0]),
                                 PRT_OK);
            else
                assert_int_equal(
                    prt_reference_colors(&context, s.mesh, &bake.media, &s.light, &o, plane),
                    PRT_OK);
            assert_int_equal(n_plane, 1);
            shade.planes = plane[0];
            assert_int_equal(prt_shade_image(&context, s.visibility, s.mesh, &shade, &image),
                             PRT_OK);
            struct furnace f = furnace_of(&s, &image);
            print_message("  %s, eta %g: mean %.5f, %.5f to %.5f\n",
                          baked ? "bake" : "reference", (double)m.eta, f.mean, f.least, f.most);
            expect_near("mean of the picture", f.mean, 1, 0.003);
            expect_near("least pixel", f.least, 1, 0.003);
            expect_near("greatest pixel", f.most, 1, 0.003);
            prt_image_finish(&image);
        }
        prt_file_close(file);
        free(plane);
        scene_finish(&s);
    }
}

// Law: the same by the image-space engines, whose pixels have errors of some 3 %, in the mean
// of the picture. Tangent-plane sampling is left out: its density ends with the cone, and
// samples near the end weigh without bound.
static void pixels_of_a_white_ball(void **state)
{
    struct scene s = scene_of(ball(), (const float[]){300, 400, 300});
    struct prt_material m = white_profile(1.5);
    struct prt_screen *screen;
    assert_int_equal(prt_screen_create(&context, s.mesh, NULL, &screen), PRT_OK);
    for (int engine = 0; engine <= PRT_SCREEN_REFERENCE; engine++) {
        if (engine == PRT_SCREEN_TANGENT) continue;
        struct prt_screen_options o = {.engine = (enum prt_screen_engine)engine};
        struct prt_screen_input input = {
            .visibility = s.visibility, .media = prt_media_one(&m), .cube = &s.light};
        struct prt_shade shade = shade_of(&s, &m);
        struct prt_image image;
        assert_int_equal(prt_screen_image(&context, screen, &input, &o, &shade, &image, NULL),
                         PRT_OK);
        struct furnace f = furnace_of(&s, &image);
        print_message("  engine %d: mean %.5f, %.5f to %.5f\n", engine, f.mean, f.least,
                      f.most);
        expect_near("mean of the picture", f.mean, 1, 0.003);
        prt_image_finish(&image);
    }
    prt_screen_destroy(screen);
    scene_finish(&s);
}

// An egg with axes of 8, 8 and 12 mm.
static double egg(double theta, double phi)
{
    double s = sin(theta) / 8, c = cos(theta) / 12;
    return 1 / sqrt(s * s + c * c);
}

// The picture of a body that hardly scatters, under radiance 1, by walks.
static struct furnace clear_body(struct prt_mesh *mesh)
{
    struct scene s = scene_of(mesh, (const float[]){300, 200, 400});
    struct prt_material clear = {.eta = 1.4f, .roughness = 0.3f, .name = "clear"};
    for (int c = 0; c < 3; c++) clear.sigma_s_prime[c] = 2e-5f;
    float(*plane)[3] = calloc(s.mesh->n_vertex, sizeof *plane);
    struct prt_reference_options o = {.term = PRT_REFERENCE_TOTAL,
                                      .no_exit = true,
                                      .n_sample = 4000,
                                      .n_ray = 1024,
                                      .n_single = 16,
                                      .n_walk = 512};
    struct prt_image image;
    const struct prt_media media = prt_media_one(&clear);
    assert_int_equal(prt_reference_colors(&context, s.mesh, &media, &s.light, &o, plane),
                     PRT_OK);
    struct prt_shade shade = shade_of(&s, &clear);
    shade.planes = plane[0];
    assert_int_equal(prt_shade_image(&context, s.visibility, s.mesh, &shade, &image), PRT_OK);
    struct furnace f = furnace_of(&s, &image);
    print_message("  mean %.5f, %.5f to %.5f\n", f.mean, f.least, f.most);
    prt_image_finish(&image);
    free(plane);
    scene_finish(&s);
    return f;
}

// Law: a convex body that hardly scatters is clear, and its picture is 1: by walks, of which
// all cross unscattered. (Where it scatters, single scattering as JMLH01 has it, with light
// that enters unrefracted, is not an order of the walks, and no such law holds.) Of the mean:
// some walks in a hundred of single vertices end at 256 mean lengths, or miss a facet by
// rounding.
static void clear_bodies_are_invisible(void **state)
{
    struct model m;
    expect_near("ball, mean", clear_body(ball()).mean, 1, 0.001);
    model_init(&m, U * (V + 1), 2 * U * V);
    add_ball(&m, U, V, V, egg);
    expect_near("egg, mean", clear_body(body_mesh(&context, &m, false)).mean, 1, 0.001);
    model_init(&m, 6 * 9 * 9, 12 * 64);
    add_box(&m, (const float[]){0, 0, 0}, (const float[]){5, 3, 4}, 8);
    expect_near("box, mean", clear_body(body_mesh(&context, &m, true)).mean, 1, 0.001);
}

int main(void)
{
    prt_context_init(&context);
    context.log = log_errors;
    close(mkstemp(path));
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(vertices_of_a_white_ball),
        cmocka_unit_test(pixels_of_a_white_ball),
        cmocka_unit_test(clear_bodies_are_invisible),
    };
    int status = run_physics_tests(tests, NULL, NULL);
    unlink(path);
    return status;
}
