// SPDX-License-Identifier: MIT
// Shared by the tests of screen/.
#include "screen_stage.h"

struct prt_context quiet;
struct prt_material marble = {.name = "marble",
                              .sigma_s_prime = {2.19f, 2.62f, 3.0f},
                              .sigma_a = {0.0021f, 0.0041f, 0.0071f},
                              .eta = 1.5f,
                              .roughness = 0.3f};

static void swallow(void *user, enum prt_log_level level, const char *line)
{
}

void stage_init(struct stage *s, const struct model *m, struct prt_camera camera, uint32_t w,
                uint32_t h)
{
    memset(s, 0, sizeof *s);
    assert_int_equal(prt_scene_create(&quiet, &m->mesh, &s->scene), PRT_OK);
    assert_int_equal(prt_screen_create(&quiet, &m->mesh, s->scene, &s->screen), PRT_OK);
    assert_int_equal(prt_visibility_create(&quiet, &m->mesh, &camera,
                                           &(struct prt_raster){w, h, 4, PRT_RASTER_AUTO},
                                           &s->vis),
                     PRT_OK);
    prt_visibility_gbuffer(s->vis, &s->g);
}

void stage_finish(struct stage *s)
{
    prt_screen_destroy(s->screen);
    prt_scene_destroy(s->scene);
    prt_visibility_destroy(s->vis);
}

int try_render(struct stage *s, const struct prt_material *material,
               const struct prt_cube *cube, const struct prt_screen_light *light,
               const struct prt_screen_options *options, pixels out,
               struct prt_screen_report *report)
{
    struct prt_screen_input input = {.visibility = s->vis,
                                     .media = {1, material, NULL},
                                     .cube = cube,
                                     .n_extra = light != NULL,
                                     .extra = light};
    return prt_screen_radiance(&quiet, s->screen, &input, options, out, report);
}

pixels render(struct stage *s, const struct prt_material *material, const struct prt_cube *cube,
              const struct prt_screen_light *light, struct prt_screen_options options,
              struct prt_screen_report *report)
{
    pixels out = malloc(((size_t)s->g.n_point + 1) * sizeof *out);
    assert_int_equal(try_render(s, material, cube, light, &options, out, report), PRT_OK);
    for (uint32_t i = 0; i < s->g.n_point; i++)
        for (int k = 0; k < 3; k++) assert_true(isfinite(out[i][k]) && out[i][k] >= 0);
    return out;
}

// Relative RMSE over points and channels.
double relative(pixels a, pixels b, uint32_t n)
{
    double num = 0, den = 0;
    for (uint32_t i = 0; i < n; i++) {
        for (int k = 0; k < 3; k++) {
            num += ((double)a[i][k] - b[i][k]) * ((double)a[i][k] - b[i][k]);
            den += (double)b[i][k] * b[i][k];
        }
    }
    return sqrt(num / den);
}

const struct prt_screen_light from_front = {{0, 0, 1}, {1, 2, 3}, false};

struct prt_cube constant_cube(uint32_t n, const float rgb[3])
{
    struct prt_cube cube = {n, malloc((size_t)6 * n * n * 12)};
    for (size_t i = 0; i < (size_t)6 * n * n; i++) memcpy(cube.texel + 3 * i, rgb, 12);
    return cube;
}

int screen_setup(void **state)
{
    prt_context_init(&quiet);
    quiet.log = swallow;
    return prt_pool_create(0, &quiet.pool);
}

int screen_teardown(void **state)
{
    prt_pool_destroy(quiet.pool);
    return 0;
}
