/* SPDX-License-Identifier: MIT */
/* The error of a finished bake: its colours against the reference engine at some vertices. */
#ifndef PRT_BAKE_MEASURE_H
#define PRT_BAKE_MEASURE_H

#include "prt/bake.h"

/* Synthetic lights of growing contrast: 0 gradient sky, 1 soft boxes, 2 low sun. */
enum { MEASURE_LIGHTS = 3 };
extern const char *const prt_measure_light_name[MEASURE_LIGHTS];
int prt_measure_light(unsigned which, uint32_t n, struct prt_cube *out);
struct measure_options {
    const struct prt_cube *own; /* the light that a polynomial bake fixed, used alone; NULL: the
                                 * synthetic ones */
    uint32_t n_vertex;          /* at most, translucent, drawn by seed */
    uint32_t least_samples;     /* of the reference, or as many as its densest medium needs */
    uint64_t seed;
    uint32_t n_walk; /* walks a vertex and channel of each of two references, whose noise is
                      * taken out of the errors; 0: the dipole */
    const uint8_t *walked; /* [n_object] with n_walk, 0: this object's references are by the
                            * dipole, as the bake is; NULL: all are walked */
    double noise;          /* recorded beside the errors of walks */
    bool draft; /* also "total", the error of multiple scattering alone against the sum with
                 * single scattering, of the own material */
};
/* Relights the transport's terms. *errors gets a JSON object of relative RMSEs, to free(): by
 * light for the bake's own material, and where the material is free the worst light of each of
 * three media that are not in the training ("media"). Blocks; reports "measuring" as progress.
 */
int prt_measure_bake(const struct prt_context *ctx, const struct prt_transport *transport,
                     const struct measure_options *options, char **errors);

#endif
