/* SPDX-License-Identifier: MIT */
/* The state of one bake and the steps its engines share. */
#ifndef PRT_BAKE_RUN_H
#define PRT_BAKE_RUN_H

#include "bake/stages.h"

struct bake {
    const struct prt_context *ctx;
    const struct prt_mesh *mesh;
    struct prt_bake_options o;
    struct prt_diffusion dipole[3];
    struct prt_scene *scene;
    struct prt_surface_points *surface;
    struct hierarchy *hierarchy;
    struct directions *directions;
    struct clusters *clusters;
    struct half_rows irradiance;
    struct radial_set radial;
    struct single_plan single;
    float *probe;
    struct factored *factored; // [n_cluster]
    struct sparse_builder *sparse;
    struct prt_transport out;
    void *loop_arg;     // what bake_tensor hands to range; NULL: this
    const float *train; // [n_train][n_function] of factor_plan, or NULL
    uint32_t n_train, n_probe;
    uint64_t rays_irradiance, *rays_single;
    struct shard *shard; // one part of several; NULL: the whole bake
    double seconds[8];
};
/* Lights a cluster's columns are found by; joint: twice the columns that are kept, so that they
 * are not those of a few lights alone. */
enum { DEFAULT_PROBES = 192, JOINT_PROBES = 128 };
enum { T_SAMPLES, T_IRRADIANCE, T_MULTIPLE, T_SINGLE, T_PACK, T_MEASURE };

/* Against prt/bake_limits.h; logs what is wrong. */
int bake_check_settings(const struct prt_context *ctx, const struct prt_bake_options *options);
/* Of the options, or as many as the mean free path asks for; wants mesh and dipole. */
uint32_t bake_sample_count(const struct bake *b);
/* Settings that were left to the bake. */
void bake_set_defaults(struct prt_bake_options *options);
/* How far apart fine points lie: a free medium may be as dense as METHODS' range, and a
 * sample's cell is cut for that [mm]. */
float bake_fine_mm(const struct bake *b);
/* Jittered patterns of directions. */
uint32_t bake_patterns(const struct prt_bake_options *options);
/* Most vertices of a cluster. What serves every medium needs more columns than one medium: of
 * smaller clusters, fewer. */
uint32_t bake_cluster_size(const struct bake *b);
/* Most columns of a cluster's U; every_medium: trained for a range of media. */
uint32_t bake_rank(const struct prt_bake_options *options, bool every_medium,
                   uint32_t n_cluster);
/* Bytes that a term's packed tensor may take. */
double bake_byte_budget(const struct bake *b, enum prt_term term, uint32_t n_phase);
/* Rows of pass 1 of more bytes are kept on disk. */
size_t bake_rows_room(const struct prt_bake_options *options);
/* A log that drops everything. */
void bake_drop_line(void *user, enum prt_log_level level, const char *line);
/* Gaussian lights [n_coef][m] into b->probe. */
int bake_probe(struct bake *b, uint32_t m);
/* Hands a cluster's rows to the storage that was asked for. Thread-safe over clusters. */
int bake_take_rows(struct bake *b, uint32_t cluster, uint32_t n_function,
                   const struct row_source *source);
/* Rows of an opaque cluster: albedo/pi times shadowed irradiance, three functions. */
int bake_opaque_rows(struct bake *b, uint32_t cluster, uint32_t *vertex_block);
/* A tensor of the next slot: `range` over clusters takes rows, then packing. */
int bake_tensor(struct bake *b, enum prt_term term, const char *stage, prt_loop_fn range,
                uint32_t n_function, uint32_t n_phase, unsigned clock);
/* A bake_tensor range over a struct bake: single scattering's rows as b->single plans them. */
int bake_single_range(void *bake, size_t begin, size_t end, unsigned worker);
/* Fills b->single from the material; a radial basis, when wanted, is set afterwards. */
void bake_plan_single(struct bake *b);
int bake_joint(struct bake *b);
int bake_polynomial(struct bake *b);

#endif
