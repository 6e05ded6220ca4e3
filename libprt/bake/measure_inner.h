/* SPDX-License-Identifier: MIT */
/* The inner loops of the bake, timed alone for prt-bench. Both functions block. */
#ifndef PRT_BAKE_MEASURE_INNER_H
#define PRT_BAKE_MEASURE_INNER_H

#include "prt/bake.h"

/* Pass 1 over n_sample samples against a bare loop of Embree calls with the same packets. */
struct prt_bake_rays {
    uint64_t rays;                /* cast by pass 1 */
    double seconds, bare_seconds; /* the same rays in a bare occlusion loop */
};
int prt_bake_measure_rays(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          uint32_t n_sample, uint32_t cube, struct prt_bake_rays *out);
/* Single scattering of n_vertex vertices under a light: as baked, and with every ray traced;
 * colours [n_vertex][3] of each (drawn by seed), rays and seconds. Uncompressed. */
enum { PRT_BAKE_SINGLE_LIGHTS = 8 };
struct prt_bake_single {
    uint64_t rays, every_rays;
    double seconds, every_seconds;
    double horizon_seconds; /* filling the horizon of the whole mesh, once a bake */
    double error[PRT_BAKE_SINGLE_LIGHTS]; /* relative RMSE of the first against the second */
};
int prt_bake_measure_single(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            const struct prt_material *material, const struct prt_cube *light,
                            uint32_t n_light, uint32_t n_vertex, struct prt_bake_single *out);

#endif
