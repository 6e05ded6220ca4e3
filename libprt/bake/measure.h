/* SPDX-License-Identifier: MIT */
/* A bake's own examination: its colours against the reference engine on some vertices. */
#ifndef PRT_BAKE_MEASURE_H
#define PRT_BAKE_MEASURE_H

#include "prt/bake.h"

/* Synthetic lights of growing contrast: 0 gradient sky, 1 soft boxes, 2 low sun. */
enum { MEASURE_LIGHTS = 3 };
extern const char *const measure_light_name[MEASURE_LIGHTS];
int measure_light(unsigned which, uint32_t n, struct prt_cube *out);
/* Relights the transport's multiple and single terms and fills errors with a JSON object of
 * relative RMSEs, by light for the bake's own material; where the material is free, also of
 * media that no training met, the worst light each ("media"). At most n_vertex vertices drawn
 * by seed. own: the light a polynomial bake fixed, used alone; NULL: the synthetic ones. */
int measure_bake(const struct prt_context *ctx, const struct prt_transport *transport,
                 const struct prt_cube *own, uint32_t n_vertex, uint64_t seed, char *errors,
                 size_t n);

#endif
