/* SPDX-License-Identifier: MIT */
/* The state of one bake and the steps that its engines share. */
#ifndef PRT_BAKE_RUN_H
#define PRT_BAKE_RUN_H

#include "bake/stages.h"
#include "bake/work.h"

struct walk_bake;
struct lit_rows; /* sources.h */

struct bake {
    const struct prt_context *ctx;
    const struct prt_mesh *mesh;
    struct prt_bake_options o;
    struct prt_diffusion (*dipole)[3]; // [media.n]
    struct prt_scene *scene;
    struct prt_surface_points *surface; // NULL: nothing is translucent
    struct hierarchy *hierarchy;
    struct directions *directions;
    struct clusters *clusters;
    struct half_rows irradiance;
    // Both save rays; NULL: not made yet, or no memory.
    struct horizon *horizon;    // of pass 1 and of single scattering
    struct triangle_grid *grid; // of single scattering
    struct radial_set *radial;  // [media.n] R_d of each medium; wavelet
    struct single_plan
        *single;               // [media.n], with the bake's horizon and grid; NULL: not planned
    struct factored *factored; // [n_cluster] of the tensor at hand
    struct spill *spill;       // has their rows; NULL: memory has them
    struct sparse_builder *sparse; // of the tensor at hand; NULL: factored storage
    struct prt_transport out;
    uint64_t *rays_single;           // [n_cluster]
    struct shard *shard;             // one part of several; NULL: the whole bake
    struct checkpoint *checkpoint;   // NULL: none is kept
    struct walk_bake *walk;          // walks.h; NULL: the dipole
    struct draft_walks *draft_walks; // draft_walks.h; NULL: the dipole as it is
    struct lit_rows *lit; // of multiple scattering, kept for unscattered light; or NULL
    struct work_meters work;
    double started; // prt_time_s()
};

/* Checks the options against prt/bake_limits.h; logs the one that is out of bounds. */
int prt_bake_check_settings(const struct prt_context *ctx,
                            const struct prt_bake_options *options);
/* The options' number of samples, or the number that the mean free path needs; reads mesh and
 * dipole. */
uint32_t prt_bake_sample_count(const struct bake *b);
/* Fills in the settings that were left to the bake. */
void prt_bake_set_defaults(struct prt_bake_options *options);
/* Distance of fine points [mm]. */
float prt_bake_fine_mm(const struct bake *b);
/* Jittered patterns of directions. */
uint32_t prt_bake_patterns(const struct prt_bake_options *options);
/* The bake's body, and the coarseness of its cuts. */
struct cut_source prt_bake_cut_source(const struct bake *b);
/* Most vertices of a cluster; reads mesh->n_vertex, o.engine and o.scattering. */
uint32_t prt_bake_cluster_size(const struct bake *b);
/* Most columns of a cluster's U; every_medium: U is trained for a range of media. */
uint32_t prt_bake_rank(const struct prt_bake_options *options, bool every_medium,
                       uint32_t n_cluster);
/* The most bytes of a packed tensor. */
double prt_bake_byte_budget(const struct bake *b, enum prt_term term, uint32_t n_phase);
/* Bytes of disk for rows of factored clusters that find no place in options.memory; 0: they
 * have it. */
uint64_t prt_bake_spill_bytes(const struct prt_context *ctx, const struct prt_mesh *mesh,
                              const struct prt_bake_options *options);
/* Rows of pass 1 that take more bytes are kept on disk. */
size_t prt_bake_rows_room(const struct prt_bake_options *options);
/* Probes of the range finder. A material: 2.7 times the columns of U; chosen, not measured. A
 * range of media: twice the columns (64), so that U serves more lights than the probes. Opaque
 * surfaces: shadows have a higher rank than scattered light. */
enum { WAVELET_PROBES = 192, JOINT_PROBES = 128, OPAQUE_PROBES = 192 };
/* The number of a cluster's medium in o.media. */
uint32_t prt_bake_medium(const struct bake *b, uint32_t cluster);
/* Fills b->dipole; prt_free()d by the caller. PRT_NOMEM. */
int prt_bake_dipoles(struct bake *b);
/* A Fresnel table for each medium, [media.n]; NULL without memory; the caller prt_free()s. */
struct fresnel_table *prt_bake_fresnel(const struct prt_media *media);
/* The same for each node of eta, [nodes->n]. */
struct fresnel_table *prt_bake_node_fresnel(const struct prt_eta_nodes *nodes);
/* The tables of single scattering: those of the nodes of eta, or prt_bake_fresnel; and where a
 * medium's begin in them. */
struct fresnel_table *prt_bake_single_fresnel(const struct bake *b);
static inline const struct fresnel_table *prt_plan_fresnel(const struct fresnel_table *tables,
                                                           const struct single_plan *plan,
                                                           uint32_t medium)
{
    return plan->n_eta > 1 ? tables : tables + medium;
}
/* The nodes of eta of a bake for any index, as the engine's tensor of that family has them;
 * false: each object has its medium's own. */
bool prt_bake_eta_nodes(const struct bake *b, enum prt_radial_family family,
                        struct prt_eta_nodes *out);
/* Whether some medium scatters singly: one with an R_d of its own holds all its light. */
bool prt_bake_any_single(const struct bake *b);
/* One tensor to bake: its rows and the way they are factored. `range` gets it as its argument.
 */
struct tensor_job {
    struct bake *bake;
    enum prt_term term;
    const char *stage; /* name of the loop in progress reports */
    prt_loop_fn range; /* over clusters: passes the rows of each to prt_bake_take_rows */
    uint32_t n_function, n_phase;
    const struct probes *probes;
    /* [n_training] by the number of the cluster's eta among prt_media_etas, or one for all;
     * NULL: every function is a combination of its own */
    const struct training *training;
    uint32_t n_training;
    uint32_t most_rank;         /* columns of U; 0: prt_bake_rank */
    const void *user;           /* the engine's own data */
    const float *lights;        /* struct factor_plan; prt_bake_tensor sets these three */
    const struct lit_rows *lit; /* or NULL */
    struct work_meters *work;
};
/* The job of multiple scattering with a material that is fixed: a function a channel. */
struct tensor_job prt_bake_channels(struct bake *bake, const char *stage, prt_loop_fn range,
                                    const struct probes *probes);
/* Bakes the tensor of the next slot: rows by job->range over all clusters, then packing. */
int prt_bake_tensor(struct tensor_job *job);
/* Frees the rows of pass 1 times the lights, which multiple scattering leaves in b->lit for
 * unscattered light. */
void prt_bake_drop_lit(struct bake *b);
/* Frees the factors of all clusters, in memory and on disk. */
void prt_bake_drop_factored(struct bake *b);
/* Passes a cluster's rows to the storage of the bake. Thread-safe over clusters. */
int prt_bake_take_rows(const struct tensor_job *job, uint32_t cluster,
                       const struct row_source *source);
/* Rows of an opaque cluster: albedo/pi times shadowed irradiance, three functions.
 * vertex_block: prt_mesh_vertex_blocks. */
int prt_bake_opaque_rows(const struct tensor_job *job, uint32_t cluster,
                         const uint32_t *vertex_block);
/* A range: single scattering's rows as job->bake->single plans them (cells.c). */
int prt_bake_single_range(void *tensor_job, size_t begin, size_t end, unsigned worker);
/* Whether the bake has planes of exit for single scattering, which an answer towards an eye
 * adds: not in sparse storage, nor in drafts or with a fixed light. */
bool prt_bake_has_view(const struct bake *b);
/* Bakes them after prt_bake_plan_single, into the tensor of the next slot. training as in
 * struct tensor_job; extinction: a free material's basis, or NULL. */
int prt_bake_view(struct bake *b, const struct extinction_table *extinction,
                  const struct probes *probes, const struct training *training,
                  uint32_t n_training);
/* Bakes the tensor of single scattering that a draft has: `job` with the rows of a few
 * vertices, interpolated at the others. */
int prt_bake_draft_single(struct tensor_job *job, const struct extinction_table *extinction);
/* n Gaussian lights, drawn from the bake's seed. */
int prt_probes_create(const struct bake *b, uint32_t n, struct probes *out);
void prt_probes_finish(struct probes *probes);
/* Makes b->single from the media. extinction: a radial basis in place of sigma_t, or NULL;
 * n_direction: 0: the texels of the light. PRT_NOMEM. */
int prt_bake_plan_single(struct bake *b, const struct extinction_table *extinction,
                         uint32_t n_direction);
void prt_bake_unplan_single(struct bake *b);
/* Pass 1 (prt_irradiance_bake) into b->irradiance, timed; nothing where nothing is translucent
 * or no rows are needed, because all clusters are there already. */
int prt_bake_irradiance(struct bake *b);
int prt_bake_wavelet(struct bake *b);
int prt_bake_joint(struct bake *b);
int prt_bake_polynomial(struct bake *b);
/* The settings of the bake and its ray counts as a JSON object, for the file and for the key of
 * shards. free() it; NULL without memory. */
char *prt_bake_describe(const struct bake *b);

#endif
