/* SPDX-License-Identifier: MIT */
/* The work of a bake: CPU seconds, rays and floating-point operations of each kind
 * of work, for `prt bake --profile`. */
#ifndef PRT_BAKE_WORK_H
#define PRT_BAKE_WORK_H

#include "prt/bake.h"

#include <stdatomic.h>
#include <stdint.h>

/* The kinds of work in the order of a bake, and their names in the profile. */
#define BAKE_WORK_LIST(X)                                                 \
    X(WORK_SAMPLES, "samples")       /* scene, samples, tree, clusters */ \
    X(WORK_IRRADIANCE, "irradiance") /* pass 1: rays of every sample */   \
    X(WORK_NODES, "hierarchy")       /* means of the nodes */             \
    X(WORK_LIT_ROWS, "lit rows")     /* rows times probes */              \
    X(WORK_KERNEL, "kernel")         /* cuts and radial functions */      \
    X(WORK_WALKS, "walks")           /* random walks: rays */             \
    X(WORK_SMOOTH, "smoothing")      /* of the walks' noise */            \
    X(WORK_EXITS, "exits")           /* single scattering: rays */        \
    X(WORK_PATHS, "paths")           /* single scattering: integrals */   \
    X(WORK_PRODUCTS, "products")     /* responses to the probes */        \
    X(WORK_RANGE, "range")           /* U: Gram matrix, eigenvectors */   \
    X(WORK_PROJECTION, "projection") /* rows of U, their compression */   \
    X(WORK_PACK, "pack")                                                  \
    X(WORK_ERRORS, "errors") /* the reference on a sample of vertices */

enum bake_work {
#define X(id, name) id,
    BAKE_WORK_LIST(X)
#undef X
        N_BAKE_WORK
};
_Static_assert((int)N_BAKE_WORK <= (int)PRT_BAKE_WORK_MAX, "a profile holds every kind");

struct work_meter {
    atomic_uint_fast64_t cpu_ns, rays, flop;
};
/* Counters of one bake. Thread-safe. */
struct work_meters {
    struct work_meter kind[N_BAKE_WORK];
    atomic_uint_fast64_t reused, asked; /* packets of pass 1 that a store was asked for */
};

/* CPU time of the calling thread [ns], the start of a piece of work. */
uint64_t prt_work_begin(void);
/* Adds the CPU time of the calling thread since `begin`, and what was done in it. meters NULL:
 * nothing. */
void prt_work_end(struct work_meters *meters, enum bake_work kind, uint64_t begin,
                  uint64_t rays, double flop);
/* The same without time: what was done in a piece of work that a caller measures. */
void prt_work_count(struct work_meters *meters, enum bake_work kind, uint64_t rays,
                    double flop);
/* Counts packets of pass 1 that a store knew, of those that it was asked for. */
void prt_work_reuse(struct work_meters *meters, uint64_t reused, uint64_t asked);
/* CPU time of the whole process [ns], for work that prt_parallel_for spreads, and its end. */
uint64_t prt_work_begin_all(void);
void prt_work_end_all(struct work_meters *meters, enum bake_work kind, uint64_t begin);
/* The counters as a profile; limits are left 0. */
void prt_work_report(const struct work_meters *meters, struct prt_bake_profile *out);
/* Rates that this machine reaches with the threads of ctx [1/s]: rays from the samples of a
 * surface in directions without order, and operations of a product of large matrices. About a
 * second. PRT_NOMEM. */
struct prt_scene;
struct prt_surface_points;
int prt_work_measure_limits(const struct prt_context *ctx, const struct prt_scene *scene,
                            const struct prt_surface_points *surface,
                            struct prt_bake_profile *out);

#endif
