/* SPDX-License-Identifier: MIT */
/* screen_stage.h owns what the tests of screen/ share: a stage that models are seen on, and
 * comparisons. */
#ifndef SCREEN_STAGE_H
#define SCREEN_STAGE_H

#include "../../libprt/screen/internal.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"

extern struct prt_context quiet; // with a pool, from screen_setup on
extern struct prt_material marble;
extern const struct prt_screen_light from_front; // along -z, irradiance 1, 2, 3
typedef float (*pixels)[3];

// A model with its scene, view and engines.
struct stage {
    struct prt_scene *scene;
    struct prt_screen *screen;
    struct prt_visibility *vis;
    struct prt_gbuffer g;
};
void stage_init(struct stage *s, const struct model *m, struct prt_camera camera, uint32_t w,
                uint32_t h);
void stage_finish(struct stage *s);
// radiance [n_point] of the stage's view; cube and light may be NULL.
int try_render(struct stage *s, const struct prt_material *material,
               const struct prt_cube *cube, const struct prt_screen_light *light,
               const struct prt_screen_options *options, pixels out,
               struct prt_screen_report *report);
// The same in new memory; asserts success and values that are finite and >= 0.
pixels render(struct stage *s, const struct prt_material *material, const struct prt_cube *cube,
              const struct prt_screen_light *light, struct prt_screen_options options,
              struct prt_screen_report *report);
// Relative RMSE over points and channels.
double relative(pixels a, pixels b, uint32_t n);
struct prt_cube constant_cube(uint32_t n, const float rgb[3]);
int screen_setup(void **state);
int screen_teardown(void **state);

#endif
