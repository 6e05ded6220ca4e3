/* SPDX-License-Identifier: MIT */
/* prt/bake.h owns the precomputation of a model's transport. */
#ifndef PRT_BAKE_H
#define PRT_BAKE_H

#include "prt/light.h"
#include "prt/mesh.h"
#include "prt/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Raised when a bake of the same inputs gives other numbers than before: what is cached by a
 * bake's inputs has this among them. */
#ifndef PRT_BAKE_VERSION /* a test builds programs of the next version */
enum { PRT_BAKE_VERSION = 6 };
#endif

/* The dipole takes the surface around each point for a plane. Random walks inside the body
 * assume no shape (METHODS §9): `multiple` is then light of two scatterings or more, and the
 * file has unscattered light besides. An object of whose walks more than a tenth escape
 * through holes is baked with the dipole, with a warning. */
enum prt_scattering { PRT_SCATTERING_DIPOLE, PRT_SCATTERING_WALK };

/* Where the time of a bake went: one entry for each kind of work that was done. */
enum { PRT_BAKE_WORK_MAX = 16 };
struct prt_bake_work {
    const char *name;   /* static */
    double cpu_seconds; /* over all threads; without the wait for memory limits or other
                           programs */
    uint64_t rays;      /* cast; 0: none, or not counted */
    double flop;        /* operations of matrix products, a multiply-add counting 2; or 0 */
};
struct prt_bake_profile {
    uint32_t n_work;
    struct prt_bake_work work[PRT_BAKE_WORK_MAX];
    unsigned n_thread;
    bool cached;           /* options.cache was used, and pass 1 took from it */
    double reused;         /* this share of its directions [0,1] */
    double seconds;        /* of the whole bake */
    double rays_s, flop_s; /* what the machine reached in the same run with the bake's threads:
                            * incoherent rays [1/s], products of large matrices [flop/s] */
};

/* Settings of a bake; prt/bake_limits.h has their bounds. A zeroed struct with `media` set is a
 * valid wavelet bake. */
struct prt_bake_options {
    enum prt_transport_kind engine;
    enum prt_storage storage; /* FACTORED default, or SPARSE (wavelet engine only) */
    struct prt_media media;   /* of the objects; joint, polynomial: gives their eta, of
                               * which at most 8 may differ */
    bool any_eta;             /* joint: media of every eta from 1.2 to 1.6 are served, at two
                               * times the memory of pass 1; the dipole without exit_planes */
    uint32_t n_sample;        /* irradiance samples; 0: one a squared mean free path,
                               * [150000, 600000]; 75000 of a fixed medium of long paths */
    uint32_t cube;            /* texels along an edge of the light: 16, 32, 64, 128; 0: 32 */
    uint32_t n_coef;          /* sparse: coefficients a vertex, at most 6 cube^2; 0: 128 */
    uint32_t rank;            /* factored: rank of every cluster; 0: from max_error */
    uint32_t n_basis_coef; /* factored: mean coefficients a basis vector; 0: from max_error */
    uint32_t n_phase;  /* spherical harmonics of the phase function: 1, 4, 9; 0: 1 for a fixed
                        * isotropic medium, else 4 */
    uint32_t n_single; /* single-scattering points a vertex of every_ray; 0: 16 */
    bool no_single;    /* leaves single scattering out */
    bool exit_planes; /* planes that correct single scattering towards an eye (METHODS §3.6) */
    bool every_ray;   /* single scattering with a ray for every texel and point, for
                       * measurements */
    double max_error; /* relative RMSE of the storage; 0: 0.01 */
    bool draft; /* some 3 % in a tenth of the time: other defaults (cube 16, 20000 samples,
                 * max_error 0.05), single scattering interpolated from few vertices, a coarser
                 * cut of the hierarchy, and one ray of four where four agree (METHODS §3.8);
                 * by the dipole */
    bool walks_follow; /* draft, WAVELET: a bake by walks replaces it: it is scaled to what
                        * walks return under even light, and its errors are against walks */
    const struct prt_env *env; /* polynomial: the fixed light */
    double rotate_deg;         /* turn of env about +y */
    uint32_t basis; /* polynomial: enum prt_radial_kind; POLYNOMIAL and HAT are X07's:
                     * 16 linear pieces of R_d, 8 of e^(-sigma_t r) */
    enum prt_scattering scattering; /* of multiple scattering */
    uint32_t n_walk; /* WALK: walks a vertex and channel, in the mean; 0: 18e6 over the
                      * vertices, [512, 2048]; where the medium is free a vertex and level of
                      * scattering, 0: 256 */
    bool unmeasured; /* the errors of the bake are left out */
    uint64_t seed;   /* of all random numbers */
    /* n_shard > 1: this process bakes part `shard` of n_shard and writes it beside out_path, as
     * OUT.I-of-N.part; a complete part is not baked again. The process that ends last assembles
     * the .prt, with the bytes of a bake in one process, and removes the parts. 0,0: all. */
    uint32_t shard, n_shard;
    uint32_t *parts_missing; /* out, or NULL: number of parts that are incomplete; 0: out_path
                              * is written; UINT32_MAX: another process assembles it */
    /* A path, or NULL. Finished work is kept in this file and in PATH.rows, and a bake of equal
     * mesh and options continues from there after any interruption, to the same bytes. Both are
     * removed when out_path, or this shard's part, is written. checkpoint_room: most bytes that
     * they take together; 0: no bound. Work that does not fit, or cannot be written, is
     * repeated after an interruption. */
    const char *checkpoint;
    uint64_t checkpoint_room;
    /* A folder, or NULL. Results of rays that do not depend on the material are kept there, and
     * a bake casts only the others, to the bytes that it writes without the folder: all of
     * pass 1 of an equal mesh, at any scale; of a mesh that differs in some triangles, those
     * towards these and those of samples on them; of other numbers of samples, those of samples
     * that were not there. Files that were not used for longest are removed beyond cache_room
     * bytes; 0: 8 GiB. A file that is damaged costs a warning and its rays. */
    const char *cache;
    uint64_t cache_room;
    uint64_t memory; /* bytes to make do with: rows of pass 1 that take more than 60 % of them,
                      * and rows of factored clusters where the bake needs more than all of
                      * them, are kept in unlinked files in TMPDIR, else /var/tmp; the result
                      * is the same. 0: the memory that is free, and factored rows stay */
    struct prt_bake_profile *profile; /* out, or NULL: filled when the bake succeeds, which
                                       * then takes a second longer */
    const char *settings_json;        /* JSON recorded as "source" of the settings, or NULL */
};
/* Bakes a mesh that has a scale (prt_mesh_scale) and writes the .prt (METHODS §3 to 5). Equal
 * inputs give equal bytes for any number of threads. Blocks; reports stages through
 * ctx->progress, which may cancel. Returns PRT_OK; PRT_ARG with the option and its range;
 * PRT_CANCELLED; PRT_NOMEM; PRT_IO; PRT_LIMIT; PRT_INTERNAL; in every failure out_path is
 * unchanged, and a line is logged. The mesh and the options stay the caller's. Thread-safe for
 * distinct out_path. */
int prt_bake(const struct prt_context *ctx, const struct prt_mesh *mesh,
             const struct prt_bake_options *options, const char *out_path);

/* The most memory that a process which does such a bake with the threads of ctx->pool is
 * expected to hold [bytes], its program and libraries included: 1.0 to 1.6 times what was
 * measured. Rows that are kept on disk (`memory`) are not counted. PRT_ARG for
 * settings out of bounds; PRT_NOMEM. Thread-safe. */
int prt_bake_memory(const struct prt_context *ctx, const struct prt_mesh *mesh,
                    const struct prt_bake_options *options, uint64_t *bytes);

/* The CPU time that such a bake is expected to take on one core of a 2.x GHz server [s], within
 * a factor of 2 of what was measured there; once_s: of it what each shard of a bake does again,
 * or one alone. A bake in n shards takes once_s + (cpu_s - once_s) / n in each. Errors as
 * prt_bake_memory. */
int prt_bake_seconds(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const struct prt_bake_options *options, double *cpu_s, double *once_s);

/* The default scattering of a mesh: walks where every translucent
 * object encloses a volume, where bakes by walks keep their bounds (wavelet transport with
 * factored storage, no draft, no profiles; METHODS §9), and where they are estimated to take at
 * most three times the time; else the dipole. options: scattering is not read. why: the reason
 * in words. Blocks for tenths of a second; equal for equal mesh and options. Errors as
 * prt_bake_memory; *out is written on PRT_OK only. Thread-safe. */
enum { PRT_BAKE_WHY = 160 };
int prt_bake_choose_scattering(const struct prt_context *ctx, const struct prt_mesh *mesh,
                               const struct prt_bake_options *options, enum prt_scattering *out,
                               char why[PRT_BAKE_WHY]);

#ifdef __cplusplus
}
#endif
#endif
