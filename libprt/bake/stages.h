/* SPDX-License-Identifier: MIT */
/* The stages of a bake as they hand data on (README.md in this folder names the order). */
#ifndef PRT_BAKE_STAGES_H
#define PRT_BAKE_STAGES_H

#include "prt/bake.h"
#include "prt/surface.h"
#include "prt/trace.h"

/* Not under the thread sanitizer: the resolvers of clones run before its runtime has started.
 */
#if defined(__x86_64__) && defined(__GNUC__) && !defined(__clang__) && \
    !defined(__SANITIZE_THREAD__)
#define PRT_CLONES __attribute__((target_clones("arch=x86-64-v4", "arch=x86-64-v3", "default")))
#else
#define PRT_CLONES
#endif

/* ---- directions: sub-sampled texels, jittered ------------------------------------------- */

enum { SUBS = 4 }; /* 2 x 2 sub-samples a texel, W05 §3 */

/* Packets of 16 rays: 2 x 2 texels of one face, 4 sub-samples each. A pattern is one jitter of
 * the whole sphere; weights of a texel's sub-samples sum to 1. */
struct directions {
    uint32_t n, n_coef, n_pattern, n_packet; /* packets a pattern */
    float *x, *y, *z, *weight;               /* [n_pattern][n_packet][16] */
    uint32_t *texel;                         /* [n_packet][4] texel of each four lanes */
    float *solid_angle;                      /* [n_coef] sr */
    uint16_t *bin;                           /* [n_coef] bin of a horizon each texel lies in */
};
int directions_create(uint32_t n, uint32_t n_pattern, uint64_t seed, struct directions **out);
void directions_destroy(struct directions *d);

/* F_t(eta, cos) as a table over cos in [0,1]. */
enum { FRESNEL_STEPS = 1024 };
struct fresnel_table {
    float value[FRESNEL_STEPS + 2];
};
void fresnel_table_init(struct fresnel_table *table, double eta);
static inline float fresnel_table_eval(const struct fresnel_table *table, float cosine)
{
    float x = cosine * FRESNEL_STEPS;
    int i = (int)x;
    float f = x - (float)i;
    return table->value[i] + f * (table->value[i + 1] - table->value[i]);
}

/* One row of pass 1, W05 eq 8: out[texel] = mean over the texel of F_t V (n.w)+, in [0,1]
 * (times the texel's solid angle it is the irradiance transport). fresnel NULL: 1. Returns the
 * number of rays cast. */
uint64_t irradiance_row(const struct prt_scene *scene, const struct directions *d,
                        unsigned pattern, const struct fresnel_table *fresnel,
                        const float origin[3], const float normal[3],
                        const float face_normal[3], float *out);
/* The same where a horizon knows what lies above the triangle: rays only for what it does not
 * know, and for light that grazes the surface one a texel where the four of 2 x 2 texels agree.
 */
struct horizon_view;
uint64_t irradiance_row_seen(const struct prt_scene *scene, const struct directions *d,
                             unsigned pattern, const struct fresnel_table *fresnel,
                             const float origin[3], const float normal[3],
                             const float face_normal[3], const struct horizon_view *view,
                             float *out);

/* ---- irradiance transport and its hierarchy ---------------------------------------------- */

/* Rows of half floats: samples first (in tree order), then inner nodes. Those that take more
 * bytes than `room` live in an unlinked temporary file. */
struct half_rows {
    size_t n_row, n_coef, bytes;
    uint16_t *half;
};
int half_rows_create(const struct prt_context *ctx, size_t n_row, size_t n_coef, size_t room,
                     struct half_rows *out);
void half_rows_finish(struct half_rows *rows);

struct node {
    float centre[3]; /* area-weighted mean position [mm] */
    float box[2][3];
    float area;            /* mm^2 */
    float spread;          /* standard deviation along an axis [mm] */
    uint32_t begin, count; /* samples in tree order */
    uint32_t child[2];     /* 0: leaf */
};
struct hierarchy {
    uint32_t n_node;
    struct node *node;
    uint32_t *root;  /* [n_object] node index + 1; 0 where an object has no samples */
    uint32_t *order; /* [n_sample] surface sample at each tree position */
};
/* Nodes over n samples, an upper bound that one object all but reaches. */
uint64_t hierarchy_most_nodes(uint32_t n_sample, uint32_t n_object);
int hierarchy_create(const struct prt_surface_points *surface, struct hierarchy **out);
void hierarchy_destroy(struct hierarchy *h);

/* Pass 1 for all samples and the nodes' area-weighted means. rays counts what was cast. */
int irradiance_bake(const struct prt_context *ctx, const struct prt_scene *scene,
                    const struct prt_surface_points *surface, const struct hierarchy *h,
                    const struct directions *d, double eta, size_t room,
                    struct half_rows *out, uint64_t *rays);

/* ---- clusters of vertices -----------------------------------------------------------------
 */

struct clusters {
    uint32_t n_cluster;
    struct prt_cluster *cluster; /* vertex ranges in order; rank 0 yet */
    uint32_t *object;            /* [n_cluster] */
    uint8_t *translucent;        /* [n_cluster] */
    uint32_t *order;             /* [n_vertex] file vertices */
};
int clusters_create(const struct prt_mesh *mesh, uint32_t target, struct clusters **out);
void clusters_destroy(struct clusters *c);

/* ---- radial kernels ------------------------------------------------------------------------
 */

/* A family of radial functions: out[f][i] = function f at sqrt(r2[i]) [mm^-2]. */
struct radial_set {
    uint32_t n;
    void (*eval)(const void *user, unsigned cpu, size_t n, const float *r2, float *const *out);
    const void *user;
    float steepest; /* largest effective transport coefficient, decides when to open [mm^-1] */
};
/* The columns a cluster sees: rows of half_rows, and the matrix K [n_function][n_vertex][C]. */
struct cut {
    uint32_t n_column, capacity;
    uint32_t *row; /* row of half_rows of each column */
    float *k;      /* [n_function][n_vertex][n_column] includes 1/pi and areas */
    size_t k_capacity;
};
int cut_build(const struct prt_context *ctx, const struct prt_mesh *mesh,
              const struct prt_surface_points *surface, const struct hierarchy *h,
              const struct clusters *clusters, uint32_t c, const struct radial_set *radial,
              struct cut *cut);
void cut_finish(struct cut *cut);

/* ---- factorisation --------------------------------------------------------------------------
 */

/* What is factored: training combinations choose the shared U, functions are stored. */
struct factor_plan {
    uint32_t n_function; /* J stored */
    uint32_t n_train;    /* combinations that U must serve */
    const float *train;  /* [n_train][n_function]; NULL: identity, n_train = n_function */
    uint32_t max_rank, n_probe;
    double tail_error;        /* relative Frobenius error a cluster's last columns may leave */
    uint32_t n;               /* cube size */
    const float *solid_angle; /* [n_coef] */
    const float *probe;       /* [n_coef][n_probe] gaussian, times solid angle */
};
/* A factored cluster before the choice of what is kept: U orthonormal columns by falling
 * energy, B Haar coefficients. */
struct factored {
    uint32_t n_vertex, rank; /* rank: columns held */
    float *u;                /* [rank][n_vertex] */
    uint16_t *b;             /* [rank][n_function][n_coef] halves, scaled by 1/scale */
    float *scale;            /* [rank][n_function] */
    float *energy;           /* [rank][n_coef] of coefficients, over training */
    /* Mixed rows (plan.train): b and scale are [rank][n_direction], by falling energy, and */
    uint32_t n_direction;
    float *mix;      /* [rank][n_direction][n_function] functions of a direction */
    float *scaling;  /* [rank][6][n_function] */
    uint8_t *width;  /* [rank] directions that pack keeps, */
    float *limit;    /* [rank] the energy above which it keeps a coefficient, */
    uint32_t *count; /* [rank] and how many these are */
    double *tail;    /* [rank+1] energy left when only the first r are kept */
};
/* A source of a cluster's rows T[f][v][texel] (per texel, solid angle not yet applied):
 * multiply(X [n_coef][m]) -> [f][n_vertex][m], and project(U [r][n_vertex]) -> [r][f][n_coef].
 * blend, where projecting is what takes the time and few blends of the functions are wanted:
 * (U, w [n][f], row [n]) -> [n][n_coef], sum_f w[i][f] of row[i] (rising) of U's projection. */
struct row_source {
    void *user;
    uint32_t n_vertex;
    int (*multiply)(void *user, const float *x, uint32_t m, float *out);
    int (*project)(void *user, const float *u, uint32_t r, float *out);
    int (*blend)(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                 const uint32_t *row, float *out);
};
int factor_cluster(const struct prt_context *ctx, const struct factor_plan *plan,
                   const struct row_source *source, struct factored *out);
void factored_finish(struct factored *f);

/* Keeps what a threshold on energy says (or fixed rank and count) and lays out the tensor. */
struct pack_options {
    uint32_t rank;         /* 0: by energy */
    uint32_t n_basis_coef; /* mean coefficients a basis vector; 0: by energy */
    double energy_error;   /* relative Frobenius error allowed over the whole model */
    bool mixed;            /* factored by training combinations: rows are mixed */
    double max_bytes;      /* of U and rows; what does not fit below it is lost */
};
int pack_factored(const struct prt_context *ctx, const struct clusters *clusters,
                  struct factored *factored, uint32_t n_function, uint32_t n,
                  const struct pack_options *options, struct prt_tensor *out);

/* Rows of many functions as a few directions (row_compression.c). mix_rows makes them of b
 * [rank][J][n_coef], which it overwrites; mix_blend has the source make them alone, having
 * found them in what the rows answer to the probes: answers [J][n_vertex][n_probe + 6], the
 * last six (mix_faces) the scaling coefficients. mix_choose decides for one row at a price and
 * leaves width and limit, with room for [MIX_ROOM][n_coef]; mix_lay writes the row, times s,
 * where rows says. */
enum { MIX_MOST = 20, MIX_ROOM = MIX_MOST + 2 }; /* directions held of a row */
struct mix_price {
    double byte;                         /* energy one byte must be worth */
    double entry_bytes, direction_bytes; /* beside a byte a direction of each entry */
};
struct mix_row {
    uint32_t width;
    float limit;
    uint64_t entries;
    double energy; /* of what is kept, less what its bytes lose */
};
int mix_rows(const struct factor_plan *plan, float *b, struct factored *f);
int mix_blend(const struct factor_plan *plan, const struct row_source *source,
              const float *answers, struct factored *f);
/* The plan's probes and behind them the six lights that ask for a face's scaling coefficient,
 * [n_coef][n_probe + 6]; NULL without memory. Caller prt_free()s. */
float *mix_faces(const struct factor_plan *plan);
void mix_choose(struct factored *f, uint32_t r, uint32_t n_coef, const struct mix_price *price,
                float *room, struct mix_row *out);
int mix_lay(const struct factored *f, uint32_t r, float s, struct prt_rows *rows, uint32_t row);
void tensor_finish(struct prt_tensor *tensor); /* frees what pack_* or truncate_* made */

/* W05's storage: the largest n_coef Haar coefficients a vertex. Rows arrive a cluster at a
 * time. */
struct sparse_builder;
int sparse_builder_create(const struct clusters *clusters, uint32_t n_vertex, uint32_t n,
                          uint32_t n_function, uint32_t n_coef, struct sparse_builder **out);
/* dense [n_vertex of cluster][n_function][n_coef_all] per texel incl. solid angle; overwritten.
 */
void sparse_builder_add(struct sparse_builder *b, uint32_t cluster, float *dense);
/* The four arrays of a cluster's rows, to be written out or filled in. */
struct sparse_rows {
    void *at;
    size_t bytes;
};
void sparse_builder_rows(const struct sparse_builder *b, uint32_t cluster,
                         struct sparse_rows out[4]);
int sparse_builder_finish(struct sparse_builder *b, struct prt_tensor *out);
void sparse_builder_destroy(struct sparse_builder *b);

/* ---- single scattering
 * ------------------------------------------------------------------------ */

/* Running integrals of the functions that stand for e^(-sigma_t r) (X07 eq 15), functions
 * fastest: [n_grid][EXTINCTION_WIDE] over a grid of 32 points an octave. */
enum {
    EXTINCTION_WIDE = 32,
    EXTINCTION_SHIFT =
        18, /* 32 points an octave: a grid index is a float's own bits above these */
    SINGLE_MAX_NODES = 9,
};
struct prt_radial;
struct extinction_table {
    uint32_t n_function, n_grid, base; /* base: float bits >> 18 of the first point but 0 */
    float *integral, *r;
};
int extinction_table_create(const struct prt_radial *radial, struct extinction_table **out);
void extinction_table_destroy(struct extinction_table *table);

/* Which directions the surface sees unhindered, found at the vertices as it is asked (the
 * answer does not depend on who asks first). Thread-safe after creation; uses the scene. */
enum {
    HORIZON_WIDE = 16, /* bins: 6 x 16 x 16 of a cubemap, [face][y][x] */
    HORIZON_WORDS = 6 * HORIZON_WIDE * HORIZON_WIDE / 64,
};
struct horizon;
int horizon_create(const struct prt_scene *scene, struct horizon **out);
void horizon_destroy(struct horizon *horizon);
/* Rays that leave a triangle into a bin: 1 all open, -1 all blocked, 0 cast one to know. */
int horizon_known(struct horizon *horizon, uint32_t triangle, uint32_t bin);
/* What is known of every bin above a triangle: bit b % 64 of word b / 64. */
struct horizon_view {
    uint64_t open[HORIZON_WORDS], shut[HORIZON_WORDS];
};
void horizon_all(struct horizon *horizon, uint32_t triangle, struct horizon_view *view);

struct single_plan {
    const struct prt_scene *scene;
    const struct prt_mesh *mesh;
    const struct directions *directions; /* pattern 0 centres are not used: own jitter */
    float sigma_t[3], sigma_s[3];        /* mm^-1 */
    float eta;
    unsigned n_phase;          /* 1, 4, 9 */
    struct prt_phase phase[3]; /* per channel */
    uint32_t n_point;          /* 16 */
    bool every_ray;
    uint64_t seed;
    struct horizon *horizon;                   /* spares shadow rays, or NULL */
    const struct extinction_table *extinction; /* radial basis in place of sigma_t, or NULL */
    uint32_t n_direction;               /* most directions at once: n_coef, or light rays */
    uint32_t n_node;                    /* depths traced */
    float first_mm, last_mm, inward_mm; /* depths; reach of rays through the bulk */
    float weakest;                      /* extinction that says which rays matter [mm^-1] */
    /* Of full light at the depth that weighs most: tiles and blocks whose neighbours differ
     * more, and tiles that may hide more, are traced finer. */
    float differ, differ_texel, doubt;
    float lost; /* optical depth from where one ray serves all nodes */
};
/* Fills what follows n_direction from the extinction, and makes the horizon; finish frees it.
 */
void single_plan_depths(struct single_plan *plan);
void single_plan_finish(struct single_plan *plan);
/* Rows of one vertex: out[n_phase*3][n_coef] (or [n_phase*n_radial][n_coef] with a radial
 * basis) per texel mean (solid angle not applied). Returns rays cast. */
uint64_t single_rows(const struct single_plan *plan, const struct fresnel_table *fresnel,
                     uint32_t vertex, float *out, void *scratch);
/* The same as cells of texels that share their rays: value (room for [planes][n_coef]) gets
 * [planes][n_cell], and out's cell lies in scratch. */
struct single_cells {
    uint32_t n_cell;
    const uint32_t *cell; /* [n_coef], a face's cells contiguous */
    const float *value;
};
uint64_t single_cells(const struct single_plan *plan, const struct fresnel_table *fresnel,
                      uint32_t vertex, float *value, struct single_cells *out, void *scratch);
/* A fixed light's rays (weights rgb [n][3]): out [n_phase][n_radial][3], X07 eq 15. */
uint64_t single_light(const struct single_plan *plan, const struct fresnel_table *fresnel,
                      uint32_t vertex, uint32_t n, const float *x, const float *y,
                      const float *z, const float *rgb, float *out, void *scratch);
size_t single_scratch_bytes(const struct single_plan *plan);

#endif
