/* SPDX-License-Identifier: MIT */
/* prt/bake.h owns the precomputation: samples, hierarchy, two passes, single scattering. */
#ifndef PRT_BAKE_H
#define PRT_BAKE_H

#include "prt/light.h"
#include "prt/mesh.h"
#include "prt/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

struct prt_bake_options {
    enum prt_transport_kind engine;
    enum prt_storage storage;     /* FACTORED default, or SPARSE (wavelet engine only) */
    struct prt_material material; /* wavelet: the medium; joint, polynomial: gives eta */
    uint32_t n_sample;            /* irradiance samples; 0: 150000 or spacing <= l_u */
    uint32_t cube;                /* 16..128 power of two; 0: 32 */
    uint32_t n_coef;              /* sparse: coefficients a vertex; 0: 128 */
    uint32_t rank;                /* factored: fixed rank a cluster; 0: chosen from max_error */
    uint32_t n_basis_coef;     /* factored: mean coefficients a basis vector; 0: from error */
    uint32_t n_phase;          /* 1, 4, 9 */
    uint32_t n_single;         /* single-scattering points a vertex; 0: 16 */
    bool no_single;            /* leave single scattering out */
    bool every_ray;            /* single scattering without ray saving (measurement) */
    double max_error;          /* 0: 0.01 */
    const struct prt_env *env; /* polynomial: the fixed light */
    double rotate_deg;
    uint32_t basis; /* polynomial: enum prt_radial_kind; POLYNOMIAL and HAT are X07's:
                     * 16 linear pieces of R_d, 8 of e^(-sigma_t r) */
    uint64_t seed;
    /* This process does shard of n_shard (0,0: all) and leaves its part beside out_path, as
     * OUT.I-of-N.part; the last one to end assembles the .prt, the same bytes as one process'
     * alone, and removes the parts. A part that is there already is not made again. */
    uint32_t shard, n_shard;
    uint32_t *parts_missing;   /* out, or NULL: parts not there yet; 0: out_path is written;
                                * UINT32_MAX: another process assembles it */
    uint64_t memory; /* bytes to make do with: rows of pass 1 that take more than 60 % of them
                      * are kept on disk; 0: what is free */
    const char *settings_json; /* extra provenance to record, may be NULL */
};
/* Bakes `mesh` (scaled) and writes the .prt. Same bytes for any thread count. Progress and
 * cancellation through ctx. */
int prt_bake(const struct prt_context *ctx, const struct prt_mesh *mesh,
             const struct prt_bake_options *options, const char *out_path);

/* The most memory that a process which does such a bake with ctx->pool's threads is expected to
 * hold [bytes], its program and libraries included: 1.0 to 1.6 times what was measured.
 * PRT_ARG for settings out of bounds. Rows of pass 1 that are kept on disk (`memory`) are not
 * counted. Thread-safe. */
int prt_bake_memory(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    const struct prt_bake_options *options, uint64_t *bytes);

/* For prt-bench: what the bake's inner loops do, measured apart. Both block. */

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
    double horizon_seconds; /* finding the whole mesh's open directions, once a bake */
    double error[PRT_BAKE_SINGLE_LIGHTS]; /* relative RMSE of the first against the second */
};
int prt_bake_measure_single(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            const struct prt_material *material, const struct prt_cube *light,
                            uint32_t n_light, uint32_t n_vertex, struct prt_bake_single *out);

#ifdef __cplusplus
}
#endif
#endif
