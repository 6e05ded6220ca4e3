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

/* A cube for one roughness, interpolated between levels; false without memory. */
bool prt_specular_mix(const struct prt_specular *specular, float roughness,
                      struct border_cube *out);

/* One cube for each level of roughness, one after another in out->texel, all of one size; a
 * surface with a map of roughness reads between two. false without memory. */
bool prt_specular_stack(const struct prt_specular *specular, struct border_cube *out);
/* The lower of the two levels and the share of the upper. */
void prt_specular_level(float roughness, int *level, float *share);

#endif
