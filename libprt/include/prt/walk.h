/* SPDX-License-Identifier: MIT */
/* prt/walk.h owns random walks of light inside closed bodies (METHODS §9). */
#ifndef PRT_WALK_H
#define PRT_WALK_H

#include "prt/trace.h"

#ifdef __cplusplus
extern "C" {
#endif

/* The bodies of a scene, prepared for walks: their volumes and areas, and a grid of lower
 * bounds on the distance to the nearest surface. Immutable after creation: any number of
 * threads may walk at once. */
struct prt_walk_space;
/* Blocks for some tenths of a second. `scene` and its mesh are referred to and must outlive the
 * space. PRT_ARG: no triangle is translucent; PRT_NOMEM. *out is written on PRT_OK only; the
 * caller ends it with prt_walk_space_destroy (NULL is allowed). */
int prt_walk_space_create(const struct prt_context *ctx, const struct prt_scene *scene,
                          struct prt_walk_space **out);
void prt_walk_space_destroy(struct prt_walk_space *space);
/* Volume [mm^3] and area [mm^2] of an object's translucent surface. The volume is that of the
 * divergence theorem and has no meaning for an open surface. */
double prt_walk_volume(const struct prt_walk_space *space, uint32_t object);
double prt_walk_area(const struct prt_walk_space *space, uint32_t object);
/* The mean length [mm] of all walks that start on a closed object's surface, 4 V eta^2 / (S T),
 * for every sigma_s' (METHODS §9, mean path). 0 where the volume is not positive. */
double prt_walk_mean_length(const struct prt_walk_space *space, uint32_t object, double eta);

/* One medium in one channel. Scattering is isotropic at sigma_s' (similarity). */
struct prt_walk_medium {
    float sigma_s_prime; /* [1e-5, 1000] mm^-1 */
    float eta;           /* [1, 3] */
    float max_length_mm; /* a longer walk ends and is counted as cut; 0: 256 mean lengths */
};

/* Where a walk starts: a point of the surface, its unit outward normal, the object. The point
 * is moved inwards by two millionths of the scene's diagonal. */
struct prt_walk_start {
    float position[3], normal[3];
    float inward[3]; /* unit direction of that move; 0: against the normal */
    uint32_t object;
    uint64_t seed; /* of this start's walks */
};

/* Walks of a vertex: the move leads away from all its faces, so that walks from the edges of a
 * box begin inside. Does not block. */
void prt_walk_start_at(const struct prt_walk_space *space, uint32_t vertex, uint32_t object,
                       uint64_t seed, struct prt_walk_start *out);

/* Where a walk left the object. */
struct prt_walk_exit {
    uint32_t walk;        /* 0 .. n_walk-1 */
    uint32_t triangle;    /* of the mesh */
    float u, v;           /* barycentric coordinates in it */
    float length_mm;      /* of the path inside */
    uint32_t scatterings; /* along it */
    float weight; /* the share of the walk's light that leaves here; 1 of prt_walk_run */
};

/* Sums over walks. leaked: walks that met a surface from outside or left the scene's box (the
 * surface is open, crosses itself or is wound inwards). absorbed: walks that met an opaque
 * surface or another object. cut: walks that became too long. None of these has an exit. */
struct prt_walk_counts {
    uint64_t walks, exits, leaked, absorbed, cut;
    uint64_t segments; /* straight pieces between scatterings and reflections */
    uint64_t rays;     /* that were traced for them */
};

/* Runs n_walk walks and calls `sink` for each that leaves the object, in an order that depends
 * on the arguments alone. The first direction has the density F_t cos about the normal and is
 * refracted; it and the first flight are stratified over the walks. The mean over n_walk of
 * e^(-sigma_a length) E(exit) is the exitance B at the start (METHODS §9). *counts is added to.
 * Thread-safe. */
void prt_walk_run(const struct prt_walk_space *space, const struct prt_walk_start *start,
                  const struct prt_walk_medium *medium, uint32_t n_walk,
                  void (*sink)(void *arg, const struct prt_walk_exit *exit), void *arg,
                  struct prt_walk_counts *counts);

/* Light that crosses the object without a scattering: n_ray straight paths with the first
 * directions of prt_walk_run, stratified; each divides at the boundary and goes on reflected
 * until less than 1e-4 of its light is left, with e^(-sigma_t length) for the least sigma_t
 * [mm^-1] of the channels. The mean over n_ray of the sums of weight e^(-sigma_t length)
 * E(exit) is its share of B. Thread-safe. */
void prt_walk_unscattered(const struct prt_walk_space *space,
                          const struct prt_walk_start *start, float eta, float sigma_t,
                          uint32_t n_ray,
                          void (*sink)(void *arg, const struct prt_walk_exit *exit), void *arg);

#ifdef __cplusplus
}
#endif
#endif
