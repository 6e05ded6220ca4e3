/* SPDX-License-Identifier: MIT */
/* The error of a finished bake: its colours against the reference engine at some vertices. */
#ifndef PRT_BAKE_MEASURE_H
#define PRT_BAKE_MEASURE_H

#include "prt/bake.h"

/* Synthetic lights of growing contrast: 0 gradient sky, 1 soft boxes, 2 low sun. */
enum { MEASURE_LIGHTS = 3 };
extern const char *const prt_measure_light_name[MEASURE_LIGHTS];
int prt_measure_light(unsigned which, uint32_t n, struct prt_cube *out);
/* Relights the transport's multiple and single terms. *errors gets a JSON object of relative
 * RMSEs, to free(): by light for the bake's own material, and where the material is free the
 * worst light of each of three media that are not in the training ("media"). At most n_vertex
 * translucent vertices, drawn by seed. The reference takes least_samples or as many as its
 * densest medium needs. own: the light that a polynomial bake fixed, used alone;
 * NULL: the synthetic ones. Blocks; reports "measuring" as progress. */
int prt_measure_bake(const struct prt_context *ctx, const struct prt_transport *transport,
                     const struct prt_cube *own, uint32_t n_vertex, uint32_t least_samples,
                     uint64_t seed, char **errors);

#endif
