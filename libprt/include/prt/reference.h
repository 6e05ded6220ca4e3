/* SPDX-License-Identifier: MIT */
/* prt/reference.h owns the reference engine, which every other engine is measured against. */
#ifndef PRT_REFERENCE_H
#define PRT_REFERENCE_H

#include "prt/light.h"
#include "prt/medium.h"
#include "prt/mesh.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_reference_term {
    PRT_REFERENCE_IRRADIANCE,  /* E at the vertices, with F_t into translucent surfaces */
    PRT_REFERENCE_MULTIPLE,    /* B/pi */
    PRT_REFERENCE_SINGLE,      /* L1, without F_t of the exit */
    PRT_REFERENCE_TOTAL,       /* F_t (multiple/T + L1), at least 0, T the mean of F_t; with
                                * walks unscattered light is added to multiple (METHODS §1,
                                * exit) */
    PRT_REFERENCE_UNSCATTERED, /* walks only: light that crosses without a scattering, as B/pi
                                */
};
struct prt_reference_options {
    enum prt_reference_term term;
    const float *eye; /* [3] mm, or NULL: without a view, METHODS §1 (exit); single scattering
                       * then follows -n_o and is isotropic */
    enum prt_exit exit;   /* of PRT_REFERENCE_TOTAL */
    bool no_exit;         /* PRT_REFERENCE_TOTAL before the factor F_t / prt_exit_divisor, which
                           * pictures apply at the pixel */
    bool straight_single; /* follow -n_o even with an eye (W05's approximation) */
    uint32_t n_sample;    /* irradiance samples; 0: l_u/4 apart, [60000, 240000] */
    uint32_t n_ray;       /* rays a sample; 0: 2048 */
    uint32_t n_single;    /* paths a vertex of single scattering; 0: 4096 */
    unsigned n_phase_term; /* 0: exact Henyey-Greenstein; else cut to 1, 4, 9, 16 terms */
    uint64_t seed;
    const uint32_t *vertex; /* [n_vertex] vertices of the file; NULL: all */
    uint32_t n_vertex;
    uint32_t n_walk; /* walks a vertex and channel, in place of the dipole; 0: the dipole */
    /* With walks: standard errors of the colours by the walks' noise, shaped like color; NULL:
     * none are written. Single scattering's own noise is not in them. */
    float (*const *standard_error)[3];
};
/* Colours by brute force (METHODS §8): color [n_vertex of options or mesh][3], linear RGB. The
 * light is constant over each texel of the cube. Equal inputs give equal colours for any number
 * of threads. Blocks; reports "surface", "reference irradiance" and "reference" as progress.
 * PRT_ARG, PRT_LIMIT, PRT_NOMEM, PRT_CANCELLED; color is then undefined. Thread-safe. */
int prt_reference_colors(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         const struct prt_media *media, const struct prt_cube *light,
                         const struct prt_reference_options *options, float (*color)[3]);
/* Every map of media under every light, into color[map * n_light + light]. The samples and
 * their irradiance are computed once for all maps, which must give each object one eta
 * (PRT_MISMATCH otherwise). n_map and n_light in [1, PRT_REFERENCE_MAX_MANY]. */
enum { PRT_REFERENCE_MAX_MANY = 64 };
int prt_reference_many(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       unsigned n_map, const struct prt_media media[], unsigned n_light,
                       const struct prt_cube *const light[],
                       const struct prt_reference_options *options, float (*const color[])[3]);
/* Relative RMSE |a-b|/|b| over n values (METHODS §8), in double. INFINITY where b is 0 and a is
 * not. */
double prt_relative_rmse(const float *a, const float *b, size_t n);

#ifdef __cplusplus
}
#endif
#endif
