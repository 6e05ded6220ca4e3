/* SPDX-License-Identifier: MIT */
/* prt/walk_ratio.h owns the ratio of random walks to the dipole under even irradiance, by which
 * pictures without a bake are scaled (METHODS §6, walk ratio).
 *
 * W: exitance by walks where every point of the surface receives irradiance 1; D: the same by
 * the dipole, the integral of R_d over the surface. A picture's light by the dipole times W/D
 * is at most the irradiance, since W is in [0,1]. */
#ifndef PRT_WALK_RATIO_H
#define PRT_WALK_RATIO_H

#include "prt/medium.h"
#include "prt/trace.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The walks that W counts. */
enum prt_walk_share {
    PRT_WALK_MULTIPLE, /* of two scatterings or more: what `multiple` is (METHODS §9) */
    PRT_WALK_ALL,      /* all, unscattered and single scattering included */
    PRT_WALK_SHARES
};

struct prt_walk_ratio_report {
    uint32_t n_point;      /* of the surface, where walks start */
    uint32_t n_walk;       /* a point and channel */
    double group_walks;    /* walks a channel that a value of W is the mean of, mean */
    uint64_t walks, rays;  /* in all */
    double standard_error; /* of W/D by PRT_WALK_ALL: relative RMS over points and channels */
    double least, most;    /* of W/D by PRT_WALK_ALL, over points and channels */
    double leaked;   /* largest share of walks that escaped from an object that is walked */
    uint32_t n_kept; /* objects that keep the dipole, with a warning: W = D */
    double seconds;
};

struct prt_walk_ratio;
/* Walks from points of the translucent surface. scene: of the mesh; neither is referred to
 * afterwards. media: of the mesh's objects. n_walk: walks of each channel that a value of W is
 * the mean of, about; [16, 1048576], 0: 256. Fewer are taken where light scatters very often
 * between two sides of a body; `report` says how many. An object keeps the dipole, W = D, with
 * a warning, where it encloses no volume, where more than 10 % of its walks escape through
 * holes, or where its medium has a profile of its own. Equal inputs give equal ratios for any
 * number of threads. Blocks for seconds; reports "walk ratio" as progress. PRT_ARG: nothing is
 * translucent, n_walk or a medium out of range; PRT_NOMEM; PRT_CANCELLED. *out is written on
 * PRT_OK only; the caller ends it with prt_walk_ratio_destroy (NULL is allowed). report may be
 * NULL. */
int prt_walk_ratio_create(const struct prt_context *ctx, const struct prt_scene *scene,
                          const struct prt_media *media, uint32_t n_walk, uint64_t seed,
                          struct prt_walk_ratio **out, struct prt_walk_ratio_report *report);
void prt_walk_ratio_destroy(struct prt_walk_ratio *ratio);
/* Memory that it holds [bytes]. */
uint64_t prt_walk_ratio_bytes(const struct prt_walk_ratio *ratio);
/* W/D at the vertices, [n_vertex of the mesh][3]; 1 on opaque surfaces. Owned by the ratio. */
const float (*prt_walk_ratio_vertices(const struct prt_walk_ratio *ratio,
                                      enum prt_walk_share share))[3];
/* W/D at the point with barycentric coordinates u, v of a triangle: interpolated between the
 * vertices of triangles that are no larger than the distance of the points where walks start,
 * else between those points. A mesh with other positions and the same triangles has the same
 * values. Thread-safe. */
void prt_walk_ratio_at(const struct prt_walk_ratio *ratio, enum prt_walk_share share,
                       uint32_t triangle, float u, float v, float out[3]);

/* The dipole's error under even light, at the ratio's points: its exitance D against W of
 * PRT_WALK_MULTIPLE. */
struct prt_dipole_error {
    uint32_t n_point;   /* that were walked in the medium; 0: none, and all else is 0 */
    double rms;         /* of D - W over that of W, over points and channels */
    double above_tenth; /* share of the points where a channel is further than 10 % off */
    double brightest, darkest; /* D/W - 1, channels together: one point in fifty lies beyond */
    float bright_mm[3], dark_mm[3]; /* the points where it is most and least [mm] */
};
/* Of the objects that have medium number `medium` of the ratio's media. PRT_NOMEM. *out is
 * written on PRT_OK only. Thread-safe. */
int prt_walk_ratio_dipole_error(const struct prt_walk_ratio *ratio,
                                const struct prt_media *media, uint32_t medium,
                                struct prt_dipole_error *out);

struct prt_visibility;
/* Radiance of the points of a G-buffer, [n_point][3], times W/D; opaque points are copied. The
 * caller prt_free()s *out, which is written on PRT_OK only. PRT_MISMATCH for a visibility
 * buffer of a mesh with more triangles, PRT_NOMEM. Thread-safe. */
int prt_walk_ratio_scale(const struct prt_context *ctx, const struct prt_walk_ratio *ratio,
                         enum prt_walk_share share, const struct prt_visibility *visibility,
                         const float (*radiance)[3], float (**out)[3]);

#ifdef __cplusplus
}
#endif
#endif
