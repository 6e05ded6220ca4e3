/* SPDX-License-Identifier: MIT */
/* Rays drawn from a cube light, stratified by power, by its square root and by solid angle
 * (METHODS §2). */
#ifndef PRT_REFERENCE_LIGHTS_H
#define PRT_REFERENCE_LIGHTS_H

#include "prt/light.h"

/* n_pattern sets of n_ray directions; the integral of L f over the sphere is estimated by
 * sum_k rgb[k] f(dir[k]) for each pattern. The light is constant over a texel. */
struct light_rays {
    uint32_t n_pattern, n_ray;
    float *x, *y, *z; /* [n_pattern][n_ray] unit */
    float *rgb;       /* [n_pattern][n_ray][3] radiance * solid angle / density */
};
/* *out is written on PRT_OK only and ends with prt_light_rays_destroy (NULL is allowed). */
int prt_light_rays_create(const struct prt_cube *light, uint32_t n_pattern, uint32_t n_ray,
                          uint64_t seed, struct light_rays **out);
void prt_light_rays_destroy(struct light_rays *rays);

#endif
