/* SPDX-License-Identifier: MIT */
/* prt/reference.h owns the brute-force arbiter every engine is measured against. */
#ifndef PRT_REFERENCE_H
#define PRT_REFERENCE_H

#include "prt/light.h"
#include "prt/medium.h"
#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_reference_term {
    PRT_REFERENCE_IRRADIANCE, /* E at the vertices, with F_t into translucent surfaces */
    PRT_REFERENCE_MULTIPLE,   /* (1/pi) B */
    PRT_REFERENCE_SINGLE,     /* L1 without outgoing Fresnel */
    PRT_REFERENCE_TOTAL,
};
struct prt_reference_options {
    enum prt_reference_term term;
    const float *eye;      /* [3] mm, or NULL: METHODS' view-free convention; single
                              scattering then follows -n_o */
    bool straight_single;  /* follow -n_o even with an eye (W05's approximation) */
    uint32_t n_sample;     /* irradiance samples; 0: spacing <= l_u/4, within limits */
    uint32_t n_ray;        /* rays a sample; 0: 2048 */
    uint32_t n_single;     /* paths a vertex for single scattering; 0: 4096 */
    unsigned n_phase_term; /* 0: exact Henyey-Greenstein; else cut to 1,4,9,16 */
    uint64_t seed;
    const uint32_t *vertex; /* only these file vertices; NULL: all */
    uint32_t n_vertex;
};
/* color [n_vertex of options or mesh][3]. The light is piecewise constant over cube texels. */
int prt_reference_colors(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         const struct prt_material *material, const struct prt_cube *light,
                         const struct prt_reference_options *options, float (*color)[3]);
/* Every material under every light at once, into color[material * n_light + light]: the samples
 * and the irradiance on them, which media of one eta share, are made once. */
enum { PRT_REFERENCE_MAX_MANY = 64 };
int prt_reference_many(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       unsigned n_material, const struct prt_material *const material[],
                       unsigned n_light, const struct prt_cube *const light[],
                       const struct prt_reference_options *options, float (*const color[])[3]);
/* Relative RMSE ||a-b|| / ||b|| over n values, in double. */
double prt_relative_rmse(const float *a, const float *b, size_t n);

#ifdef __cplusplus
}
#endif
#endif
