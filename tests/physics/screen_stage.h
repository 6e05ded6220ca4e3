/* SPDX-License-Identifier: MIT */
/* screen_stage.h owns what the tests of screen/ share: small models, a stage they are seen on,
 * and comparisons. */
#ifndef SCREEN_STAGE_H
#define SCREEN_STAGE_H

#include "../../libprt/screen/internal.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

extern struct prt_context quiet; // with a pool, from screen_setup on
extern struct prt_material marble;
extern const struct prt_screen_light from_front; // along -z, irradiance 1, 2, 3
typedef float (*pixels)[3];

// One block an object, surfaces of 0.5.
struct model {
    struct prt_mesh mesh;
    struct prt_block block[4];
    struct prt_surface surface[4];
};
void model_init(struct model *m, uint32_t max_vertex, uint32_t max_triangle);
void model_finish(struct model *m);
struct prt_block *begin_block(struct model *m, bool translucent);
void end_block(struct model *m, struct prt_block *b);
// n x n squares spanned by u and v about a centre; the normal is u x v.
void add_sheet(struct model *m, const float c[3], const float u[3], const float v[3],
               uint32_t n);
// A closed box of half sizes h.
void add_box(struct model *m, const float c[3], const float h[3], uint32_t n);
void add_sphere(struct model *m, const float c[3], float radius, uint32_t n);
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
// Chi-square of counts against expectations; true below the 99.9 % point (Wilson-Hilferty).
bool chi_square_ok(const double *want, const uint32_t *got, int n, double *value);
struct prt_cube constant_cube(uint32_t n, const float rgb[3]);
int screen_setup(void **state);
int screen_teardown(void **state);

#endif
