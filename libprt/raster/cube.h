/* SPDX-License-Identifier: MIT */
/* Cube maps with a one-texel border round each face, so that bilinear look-ups need no seams.
 */
#ifndef RASTER_CUBE_H
#define RASTER_CUBE_H

#include "prt/raster.h"

struct border_cube {
    uint32_t n;
    float *texel; /* [6][n+2][n+2][4] */
};
/* n x n texels a face, all 0; false without memory. */
bool prt_border_cube_init(struct border_cube *cube, uint32_t n);
void prt_border_cube_finish(struct border_cube *cube);
/* Texel (x, y) of a face, 4 floats. */
static inline float *border_texel(const struct border_cube *c, unsigned face, uint32_t x,
                                  uint32_t y)
{
    size_t m = c->n + 2;
    return c->texel + ((face * m + y + 1) * m + x + 1) * 4;
}
/* Fills the borders from the adjacent faces. */
void prt_border_cube_seal(struct border_cube *cube);
/* Bilinear radiance in a direction of any length. */
void prt_border_cube_sample(const struct border_cube *cube, const float dir[3], float rgb[3]);
/* A copy of a cube without borders; false without memory. */
bool prt_border_cube_copy(struct border_cube *out, const struct prt_cube *cube);

/* Levels of growing roughness, and the side of the largest. */
enum { SPECULAR_LEVELS = 6, SPECULAR_SIDE = 32 };
struct prt_specular {
    struct border_cube level[SPECULAR_LEVELS];
    /* the levels one after another in its texels, all of SPECULAR_SIDE: a surface whose
     * roughness varies reads between two */
    struct border_cube stack;
};
#define SPECULAR_ROUGH_0 0.0f
#define SPECULAR_ROUGH_1 0.15f
#define SPECULAR_ROUGH_2 0.3f
#define SPECULAR_ROUGH_3 0.45f
#define SPECULAR_ROUGH_4 0.65f
#define SPECULAR_ROUGH_5 1.0f
/* The lower of the two levels that a roughness lies between, and the share of the upper. One
 * choice after another: nested ones keep the compiler from vectorising loops over this. */
static inline unsigned specular_level(float roughness, float *share)
{
    const float r = roughness;
    float lo = r > SPECULAR_ROUGH_1 ? SPECULAR_ROUGH_1 : SPECULAR_ROUGH_0;
    float hi = r > SPECULAR_ROUGH_1 ? SPECULAR_ROUGH_2 : SPECULAR_ROUGH_1;
    lo = r > SPECULAR_ROUGH_2 ? SPECULAR_ROUGH_2 : lo;
    hi = r > SPECULAR_ROUGH_2 ? SPECULAR_ROUGH_3 : hi;
    lo = r > SPECULAR_ROUGH_3 ? SPECULAR_ROUGH_3 : lo;
    hi = r > SPECULAR_ROUGH_3 ? SPECULAR_ROUGH_4 : hi;
    lo = r > SPECULAR_ROUGH_4 ? SPECULAR_ROUGH_4 : lo;
    hi = r > SPECULAR_ROUGH_4 ? SPECULAR_ROUGH_5 : hi;
    float f = (r - lo) / (hi - lo);
    f = f > 0 ? f : 0;
    *share = f < 1 ? f : 1;
    return (unsigned)(r > SPECULAR_ROUGH_1) + (r > SPECULAR_ROUGH_2) + (r > SPECULAR_ROUGH_3) +
           (r > SPECULAR_ROUGH_4);
}
enum { SPECULAR_LEVEL_FLOATS = 6 * (SPECULAR_SIDE + 2) * (SPECULAR_SIDE + 2) * 4 };
/* Fills `stack` from the levels; false without memory. */
bool prt_specular_stack(struct prt_specular *specular);

#endif
