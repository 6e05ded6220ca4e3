/* SPDX-License-Identifier: MIT */
/* The stages of a bake and the data that each passes to the next (README.md in this folder
 * gives their order). Functions that return int give a status (prt/base.h); *out is written on
 * PRT_OK only and belongs to the caller, who ends it with the _destroy or _finish of its type.
 * Unless stated otherwise a function is thread-safe for distinct outputs and blocks until it is
 * done. */
#ifndef PRT_BAKE_STAGES_H
#define PRT_BAKE_STAGES_H

#include "prt/bake.h"
#include "prt/bake_limits.h"
#include "prt/eta_nodes.h"
#include "prt/surface.h"
#include "prt/trace.h"

/* ---- directions: jittered sub-samples of texels ------------------------------------------ */

enum { SUBS = 4 }; /* 2 x 2 sub-samples a texel, W05 §3 */
enum { MAX_PACKETS = 6 * PRT_BAKE_CUBE_MAX * PRT_BAKE_CUBE_MAX / 4 };

/* Bins of a horizon as two masks of the 64-bit words of its sets; mask[1] is 0 where one word
 * has them all. */
struct packet_bins {
    uint64_t mask[2];
    uint16_t word[2];
};
/* Packets of 16 rays: 2 x 2 texels of one face, 4 sub-samples each. A pattern is one jitter of
 * the whole sphere. The weights of a texel's sub-samples sum to 1. */
struct directions {
    unsigned cpu;             /* mask of enum prt_cpu for the loops over packets */
    uint32_t n, n_coef;       /* cube size, a power of 2 from 16; 6 n n texels */
    uint32_t n_pattern;       /* jitters of the sphere */
    uint32_t n_packet;        /* packets of one pattern */
    float *x, *y, *z;         /* [n_pattern][n_packet][16] unit vectors */
    float *weight;            /* [n_pattern][n_packet][16] */
    uint32_t *texel;          /* [n_packet][4] texel of each four lanes */
    float *solid_angle;       /* [n_coef] sr */
    uint16_t *bin;            /* [n_coef] bin of a horizon that contains the texel's centre */
    struct packet_bins *bins; /* [n_packet] those of a packet's texels */
    float *centre[3];         /* [n_packet] unit vectors to the middle of a packet */
    float *slope; /* [n_pattern][4][2][n_coef] s and t of the direction (s, t, 1) on its
                     face, by which of a texel's sub-samples single scattering takes */
};
int prt_directions_create(unsigned cpu, uint32_t n, uint32_t n_pattern, uint64_t seed,
                          struct directions **out);
void prt_directions_destroy(struct directions *d);
/* s [n_coef] and t [n_coef] of the sub-samples that texel_ray chooses (bake/single.h). */
const float *prt_direction_slopes(const struct directions *d, unsigned pattern);

/* F_t(eta, cos) tabulated over cos in [0,1], linear between points. */
enum { FRESNEL_STEPS = 1024 };
struct fresnel_table {
    float value[FRESNEL_STEPS + 2];
};
void prt_fresnel_table_init(struct fresnel_table *table, double eta);
static inline float fresnel_table_eval(const struct fresnel_table *table, float cosine)
{
    float x = cosine * FRESNEL_STEPS;
    int i = (int)x;
    float f = x - (float)i;
    return table->value[i] + f * (table->value[i + 1] - table->value[i]);
}

/* A point that receives light. */
struct receiver {
    const float *origin;               /* [3] mm */
    const float *normal, *face_normal; /* [3] unit */
    bool model_units;                  /* of origin, in place of mm */
};
struct horizon_view;
/* The rays of a receiver that find V, the open share of a texel. */
enum texel_rays {
    EVERY_RAY,     /* SUBS rays a texel */
    AGREEING_RAYS, /* one; the others only where those of 2 x 2 texels disagree */
    RAY_A_TEXEL    /* one, which says 0 or 1, and one for 2 x 2 texels near the tangent plane;
                      pattern chooses which, so that the mean over receivers is right */
};
/* One row of pass 1, W05 eq 8: out[texel] = mean over the texel of F_t V (n.w)+, in [0,1]
 * (times the texel's solid angle it is the irradiance transport). fresnel NULL: F_t = 1. With a
 * view, the horizon of the receiver's triangle, directions whose visibility is certain take no
 * ray. view NULL: all directions do. Returns the number of rays cast. */
uint64_t prt_irradiance_row(const struct prt_scene *scene, const struct directions *d,
                            unsigned pattern, const struct fresnel_table *fresnel,
                            const struct receiver *at, const struct horizon_view *view,
                            enum texel_rays rays, float *out);
/* The same with the directions that see the sky, open [n_packet], a bit a ray: those of packets
 * in the set `fresh` are found and written, the others are taken and no ray is cast for them.
 * fresh [(n_packet + 63) / 64]; NULL: all packets. What is found for a packet does not depend
 * on the set. */
uint64_t prt_irradiance_lanes(const struct prt_scene *scene, const struct directions *d,
                              unsigned pattern, const struct fresnel_table *fresnel,
                              const struct receiver *at, const struct horizon_view *view,
                              enum texel_rays rays, const uint64_t *fresh, uint16_t *open,
                              float *out);

/* ---- irradiance transport and its hierarchy ---------------------------------------------- */

/* Rows of half floats: samples first (in tree order), then the nodes of the hierarchy. Rows
 * that take more bytes than `room` are mapped from an unlinked temporary file. */
struct half_rows {
    size_t n_row, n_coef, bytes; /* n_coef: numbers of a row, of all layers */
    size_t n_texel;
    uint32_t n_layer; /* 1; or 2, for two nodes of eta: the mean of E under both, [n_texel], and
                         half of their difference, which is small, over 2 x 2 texels,
                         [n_texel / 4]. Both are relative to the means of F_t: */
    float mix[2][2];  /* E of node i = mix[i][0] mean + mix[i][1] difference */
    uint16_t *half;
    bool on_disk;
};
/* An unlinked file of `bytes` in TMPDIR, else /var/tmp; -1: errno. */
int prt_temporary_file(uint64_t bytes);
/* Rows that are on disk are not read for a while: they need not stay in memory. */
void prt_half_rows_rest(const struct half_rows *rows);
int prt_half_rows_create(const struct prt_context *ctx, size_t n_row, size_t n_texel,
                         uint32_t n_layer, size_t room, struct half_rows *out);
void prt_half_rows_finish(struct half_rows *rows);

struct checkpoint;  /* checkpoint.h */
struct spill;       /* spill.h */
struct row_store;   /* row_store.h */
struct work_meters; /* work.h */

struct node {
    float centre[3]; /* area-weighted mean position [mm] */
    float box[2][3];
    float area;            /* mm^2 */
    float spread;          /* standard deviation along an axis [mm] */
    uint32_t begin, count; /* samples in tree order */
    uint32_t child[2];     /* indices of nodes; 0: a leaf */
};
struct hierarchy {
    uint32_t n_node;
    struct node *node;
    uint32_t *root;  /* [n_object] node index + 1; 0 where an object has no samples */
    uint32_t *order; /* [n_sample] surface sample at each tree position */
};
/* Nodes over n_sample samples: an upper bound, which one object all but reaches. */
uint64_t prt_hierarchy_most_nodes(uint32_t n_sample, uint32_t n_object);
int prt_hierarchy_create(const struct prt_surface_points *surface, struct hierarchy **out);
void prt_hierarchy_destroy(struct hierarchy *h);

/* What pass 1 computes from. */
struct irradiance_source {
    const struct prt_scene *scene;
    const struct prt_surface_points *surface;
    const struct hierarchy *hierarchy;
    const struct directions *directions;
    struct checkpoint *checkpoint;     /* or NULL */
    struct row_store *store;           /* of this pass, or NULL */
    struct work_meters *work;          /* or NULL */
    struct horizon *horizon;           /* or NULL: no direction is known */
    const struct prt_media *media;     /* whose eta each object has */
    const struct prt_eta_nodes *nodes; /* two, of all objects: rows have two layers; or NULL */
    size_t room;                       /* bytes of memory for the rows (prt_half_rows_create) */
};
/* Whether the horizon's rays are few beside the samples' own. */
bool prt_irradiance_horizon_pays(const struct directions *d, const struct prt_scene *scene,
                                 uint32_t n_sample);
/* Pass 1: the rows of all samples, and the area-weighted mean of each node's rows. Pieces that
 * the checkpoint has are read, others are recorded there. Reports "irradiance" and "hierarchy"
 * as progress. */
int prt_irradiance_bake(const struct prt_context *ctx, const struct irradiance_source *from,
                        struct half_rows *out);

/* ---- clusters of vertices -----------------------------------------------------------------
 */

struct clusters {
    uint32_t n_cluster;
    struct prt_cluster *cluster; /* ranges of `order`; rank and offsets are 0 until packing */
    uint32_t *object;            /* [n_cluster] */
    uint8_t *translucent;        /* [n_cluster] */
    uint32_t *order;             /* [n_vertex] vertices of the file */
};
/* Groups vertices of one object, all translucent or all opaque, by halving along the longest
 * axis until at most `target` are in each. */
int prt_clusters_create(const struct prt_mesh *mesh, uint32_t target, struct clusters **out);
void prt_clusters_destroy(struct clusters *c);

/* ---- radial kernels ------------------------------------------------------------------------
 */

/* A family of radial functions: out[f][i] = function f at sqrt(r2[i]) [mm^-2]. */
struct radial_set {
    uint32_t n; /* at most 64 */
    void (*eval)(const void *user, unsigned cpu, size_t n, const float *r2, float *const *out);
    const void *user;
    float
        steepest; /* largest effective transport coefficient: bounds a node's extent [mm^-1] */
};
/* The cut of the hierarchy that a cluster gathers from, and the matrix K between the two. */
struct cut {
    uint32_t n_column, capacity;
    uint32_t *row; /* row of half_rows of each column */
    float *k;      /* [n_function][n_column][n_vertex], includes 1/pi and areas */
    size_t k_capacity;
};
/* A body whose samples are gathered. */
struct cut_source {
    const struct prt_mesh *mesh;
    const struct prt_surface_points *surface;
    const struct hierarchy *hierarchy;
    const struct clusters *clusters;
    float coarseness; /* 1, or more: nodes of so much more solid angle stay closed */
};
/* The cut and the matrix of cluster c (W05 eq 7, JB02). A zeroed `cut`, or one of an earlier
 * call, whose memory is used again; prt_cut_finish frees it. */
int prt_cut_build(const struct prt_context *ctx, const struct cut_source *from, uint32_t c,
                  const struct radial_set *radial, struct cut *cut);
void prt_cut_finish(struct cut *cut);

/* ---- factorisation --------------------------------------------------------------------------
 */

/* Gaussian lights, white noise over the sphere: columns of the range finder's test matrix
 * (HMT11). Each value is multiplied by its texel's solid angle. */
struct probes {
    uint32_t n;
    float *light; /* [n_coef][n] */
};
/* Media that one U has to serve, as combinations of a row's functions. */
struct training {
    uint32_t n;
    float *weight; /* [n][n_function] */
};

/* The training combinations determine U; the rows of the functions are stored. */
struct factor_plan {
    uint32_t n_function; /* J stored */
    uint32_t n_train;    /* combinations that U has to serve */
    const float *train;  /* [n_train][n_function]; NULL: identity, n_train = n_function */
    uint32_t max_rank, n_probe;
    double tail_error;        /* relative Frobenius error of the columns that are dropped */
    uint32_t n;               /* cube size */
    const float *solid_angle; /* [n_coef] */
    const float *probe;       /* [n_coef][n_probe], struct probes */
    const float *lights;      /* [n_coef][n_probe + 6], prt_compression_lights; or NULL */
    struct work_meters *work; /* or NULL */
};
/* A factored cluster before packing: U with orthonormal columns by falling energy, and the rows
 * B = U^T T as Haar coefficients.
 * Without training combinations b and scale are [rank][n_function]. With them (low-rank rows)
 * the rows are expressed in components, combinations of functions by falling energy, and b and
 * scale are [rank][n_component]. */
struct factored {
    uint32_t n_vertex, rank; /* rank: columns held */
    float *u;                /* [rank][n_vertex] */
    uint16_t *b;             /* [rank][n_function][n_coef] halves, divided by scale */
    float *scale;            /* [rank][n_function] */
    float *energy;           /* [rank][n_coef] of coefficients, over training */
    uint32_t n_component;    /* 0: no low-rank rows, and the fields below are NULL */
    float *component;        /* [rank][n_component][n_function] weights of the functions */
    float *scaling;          /* [rank][6][n_function] scaling coefficients */
    uint8_t *width;          /* [rank] components that packing keeps, */
    float *limit;            /* [rank] the energy above which it keeps a coefficient, */
    uint32_t *count;         /* [rank] and the number of these */
    double *tail;            /* [rank+1] energy that remains when only the first r are kept */
    uint64_t spilled_bytes;  /* of b, which lies in a file (spill.h); 0: it is memory */
};
/* A source of a cluster's rows T[f][v][texel] (mean over the texel, solid angle not applied).
 *   multiply(X [n_coef][m]) -> [f][n_vertex][m]
 *   project(U [r][n_vertex]) -> [r][f][n_coef]
 *   combine(U, w [n][f], row [n] rising) -> [n][n_coef]: sum_f w[i][f] of row[i] of the
 *   projection; for sources whose projection is slow when few combinations are needed; or NULL.
 */
struct row_source {
    void *user;
    uint32_t n_vertex;
    int (*multiply)(void *user, const float *x, uint32_t m, float *out);
    int (*project)(void *user, const float *u, uint32_t r, float *out);
    int (*combine)(void *user, const float *u, uint32_t r, uint32_t n, const float *w,
                   const uint32_t *row, float *out);
};
/* The range finder (METHODS §3, HMT11). PRT_INTERNAL when LAPACK fails. */
int prt_factor_cluster(const struct prt_context *ctx, const struct factor_plan *plan,
                       const struct row_source *source, struct factored *out);
void prt_factored_finish(struct factored *f);

struct pack_options {
    uint32_t rank;         /* 0: by energy */
    uint32_t n_basis_coef; /* mean coefficients a basis vector; 0: by energy */
    double energy_error;   /* relative Frobenius error allowed over the whole model */
    bool low_rank;         /* the clusters were factored with training combinations */
    double max_bytes;      /* of U and rows; energy that does not fit is dropped */
};
/* Chooses the basis vectors and coefficients to keep and lays out the tensor (pack.c). Ends
 * with prt_tensor_finish. */
int prt_pack_factored(const struct prt_context *ctx, const struct clusters *clusters,
                      struct factored *factored, uint32_t n_function, uint32_t n,
                      const struct pack_options *options, struct prt_tensor *out);

/* ---- low-rank rows (row_compression.c) ------------------------------------------------------
 */

enum {
    MAX_COMPONENTS = 20,                 /* of a row: 1 % takes 4 to 5; chosen with room */
    COMPONENT_ROOM = MAX_COMPONENTS + 2, /* arrays of n_coef that a choice works in */
};
struct component_price {
    double byte;                         /* energy that one byte has to hold */
    double entry_bytes, component_bytes; /* beside one byte a component of each entry */
    unsigned cpu; /* mask of enum prt_cpu for the loops over coefficients */
};
struct component_choice {
    uint32_t width;   /* components kept */
    float limit;      /* energy above which a coefficient is kept */
    uint64_t entries; /* kept, with residual entries */
    double energy;    /* kept, less the rounding error of the bytes */
};
/* Components of all rows from their coefficients b [rank][J][n_coef], which it overwrites. */
int prt_compress_rows(const struct factor_plan *plan, float *b, struct factored *f);
/* The same without forming every function's row: the components follow from the rows times the
 * lights of prt_compression_lights, response [J][n_vertex][n_probe + 6], and the source
 * combines the components alone. */
int prt_compress_source(const struct factor_plan *plan, const struct row_source *source,
                        const float *response, struct factored *f);
/* The plan's probes and after them the six lights whose products are the faces' scaling
 * coefficients, [n_coef][n_probe + 6]. NULL without memory. The caller prt_free()s it. */
float *prt_compression_lights(const struct factor_plan *plan);
/* Components and coefficients of row r that are worth a price. room: [COMPONENT_ROOM][n_coef].
 * Also writes f->width, limit and count of the row. */
void prt_choose_components(struct factored *f, uint32_t r, uint32_t n_coef,
                           const struct component_price *price, float *room,
                           struct component_choice *out);
/* Writes row r times s as row `row` of `rows`, whose offsets are set. */
int prt_write_low_rank_row(const struct factored *f, uint32_t r, float s, unsigned cpu,
                           struct prt_rows *rows, uint32_t row);
/* Frees the arrays of a tensor that prt_pack_factored or prt_sparse_builder_finish made. */
void prt_tensor_finish(struct prt_tensor *tensor);

/* W05's storage: the largest n_coef Haar coefficients a vertex. Rows are added a cluster at a
 * time. */
struct sparse_builder;
int prt_sparse_builder_create(const struct clusters *clusters, uint32_t n_vertex, uint32_t n,
                              uint32_t n_function, uint32_t n_coef,
                              struct sparse_builder **out);
/* dense [n_vertex of cluster][n_function][n_coef_all] per texel incl. solid angle; overwritten.
 */
void prt_sparse_builder_add(struct sparse_builder *b, uint32_t cluster, float *dense);
/* The four arrays of a cluster's rows: shards write them to a part or fill them from one. */
struct sparse_rows {
    void *at;
    size_t bytes;
};
void prt_sparse_builder_rows(const struct sparse_builder *b, uint32_t cluster,
                             struct sparse_rows out[4]);
int prt_sparse_builder_finish(struct sparse_builder *b, struct prt_tensor *out);
void prt_sparse_builder_destroy(struct sparse_builder *b);

/* ---- single scattering
 * -----------------------------------------------------------------------
 */

/* Running integrals of the functions that stand for e^(-sigma_t r) (X07 eq 15), functions
 * fastest: [n_grid][EXTINCTION_WIDE] over a grid of 32 points an octave. */
enum {
    EXTINCTION_WIDE = 32,
    EXTINCTION_SHIFT = 18, /* a grid index is a float's bits above these: 32 points an octave */
    SINGLE_MAX_NODES = 9,
};
struct prt_radial;
struct extinction_table {
    uint32_t n_function, n_grid, base; /* base: float bits >> 18 of the first point but 0 */
    float *integral, *r;
};
int prt_extinction_table_create(const struct prt_radial *radial, struct extinction_table **out);
void prt_extinction_table_destroy(struct extinction_table *table);

/* Conservative visibility per vertex and direction bin. A vertex is traced on first use; the
 * result does not depend on the order of uses. Thread-safe after creation; refers to the scene,
 * which must outlive it. */
enum {
    HORIZON_WIDE = 32, /* bins: 6 x 32 x 32 of a cubemap, [face][y][x] */
    HORIZON_WORDS = 6 * HORIZON_WIDE * HORIZON_WIDE / 64,
};
struct horizon;
/* Words of 8 bytes that hold the bins of one place: fewer where there are many, whose bins are
 * 2 x 2 of these. */
uint32_t prt_horizon_words(uint32_t n_place);
/* Places are the mesh's vertices and, on its larger triangles, about most_more
 * points at most. */
int prt_horizon_create(const struct prt_scene *scene, uint32_t most_more, struct horizon **out);
void prt_horizon_destroy(struct horizon *horizon);
/* Rays that leave a triangle into a bin: 1 all visible, -1 all blocked, 0 unknown (cast one).
 * Those of a divided triangle are unknown: by its parts single scattering was less
 * exact. */
int prt_horizon_bin(struct horizon *horizon, uint32_t triangle, uint32_t bin);
/* The same for the rays of mask, lane i into bins[texel[i]]: the sets of lanes whose rays are
 * visible and blocked. */
void prt_horizon_bins(struct horizon *horizon, uint32_t mask, const uint32_t triangle[16],
                      const uint16_t *bins, const uint32_t texel[16], uint32_t *visible,
                      uint32_t *blocked);
/* The share of a square of wide x wide bins (a power of 2, aligned to it) that is open at
 * barycentric (u, v) of a triangle, between its corners; -1 where it is not known. */
float prt_horizon_share(struct horizon *horizon, uint32_t triangle, float u, float v,
                        unsigned bin, unsigned wide);
/* Every bin near (u, v) of a triangle: bit b % 64 of word b / 64. A bin in neither set is
 * unknown. */
struct horizon_view {
    uint64_t visible[HORIZON_WORDS], blocked[HORIZON_WORDS];
};
void prt_horizon_view(struct horizon *horizon, uint32_t triangle, float u, float v,
                      struct horizon_view *view);
/* The three places that the view at (u, v) of a triangle follows from, in model units. Returns
 * the words of their bins; 0: the triangle has no view, and out is not written. */
struct horizon_corner {
    float position[3], normal[3];
};
unsigned prt_horizon_around(const struct horizon *horizon, uint32_t triangle, float u, float v,
                            struct horizon_corner out[3]);
/* The largest angle [rad] between a texel's centre and a ray that decides its visibility:
 * the fine bin around the texel, one beside it, the coarse bin around that, one beside it. */
static const float prt_horizon_reach = 0.36f;
/* How many more places than vertices n_sample samples pay for, beside n_vertex. */
uint32_t prt_horizon_more(uint32_t n_vertex, uint32_t n_sample);

/* How single scattering of a model is traced and integrated. The caller fills the fields up to
 * work, prt_single_plan_depths the rest. */
struct single_plan {
    unsigned cpu; /* mask of enum prt_cpu for the loops over rays and paths */
    const struct prt_scene *scene;
    const struct prt_mesh *mesh;
    const struct directions *directions; /* one sub-sample of each texel is used */
    float sigma_t[3], sigma_s[3];        /* mm^-1 */
    uint32_t n_eta; /* 1, or the nodes of any index: then functions are those of a radial basis
                       at each node, and `fresnel` is an array of n_eta tables below */
    float eta[PRT_ETA_MOST_NODES];
    unsigned n_phase;          /* 1, 4, 9 */
    struct prt_phase phase[3]; /* per channel */
    uint32_t n_point;          /* every_ray: points a path */
    bool every_ray;            /* W05 as printed: a ray for every texel at every point */
    uint64_t seed;
    const struct extinction_table *extinction; /* radial basis in place of sigma_t, or NULL */
    uint32_t n_direction; /* most directions at once: n_coef, or a light's rays */
    /* Rows are radiances towards one direction of exit (prt_single_toward), with `phase` whole;
     * n_phase is 1. isotropic: every g is 0. */
    bool toward, isotropic;

    struct work_meters *work; /* or NULL */

    /* Both save rays, and are NULL without memory for them. A plan that has one before
     * prt_single_plan_depths keeps it. */
    struct horizon *horizon;    /* shadow rays */
    struct triangle_grid *grid; /* rays to exits: triangles near a vertex are drawn */
    uint32_t n_node;            /* depths traced */
    float first_mm, last_mm;    /* least and greatest depth */
    float inward_mm;            /* reach of rays through the body */
    float weakest;              /* extinction that weighs differences between rays [mm^-1] */
    /* Thresholds relative to full light at the node that contributes most: a tile is refined
     * when it differs more from a neighbour, or when its shadow may hide more; and a block. */
    float differ, uncertain, differ_texel, uncertain_texel;
    float max_optical_depth; /* beyond it one node's ray is used for all nodes */
};
/* Fills the fields behind work, and creates the horizon and the grid that it has none of;
 * finish destroys both. A bake keeps them for all its plans and does not call it. */
void prt_single_plan_depths(struct single_plan *plan);
void prt_single_plan_finish(struct single_plan *plan);
/* Depths [mm] of the nodes along a path through `thickness` mm of the body, geometric. */
void prt_single_plan_nodes(const struct single_plan *plan, float thickness, float *depth);
/* Rows of one vertex: out[n_phase*3][n_coef] (or [n_phase][n_eta*n_radial][n_coef] with a
 * radial basis), means over texels, solid angle not applied. Returns the number of rays cast.
 * scratch: prt_single_scratch_bytes, 64-byte aligned, one for each thread. */
uint64_t prt_single_rows(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         uint32_t vertex, float *out, void *scratch);
/* The same as cells of texels that share their rays: value (room for [planes][n_coef]) gets
 * [planes][n_cell]. out->cell points into scratch. */
struct single_cells {
    uint32_t n_cell;
    const uint32_t *cell; /* [n_coef], the cells of a face are contiguous */
    const float *value;
};
uint64_t prt_single_cells(const struct single_plan *plan, const struct fresnel_table *fresnel,
                          uint32_t vertex, float *value, struct single_cells *out,
                          void *scratch);
/* The same along -path, for a plan of plan->toward: radiances L1 towards `toward` before the
 * outgoing Fresnel factor, [3][n_cell]; with a radial basis the functions of prt_single_cells.
 * path, toward: unit, inside, outward; they differ at creases alone. */
uint64_t prt_single_toward(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           uint32_t vertex, const float path[3], const float toward[3],
                           float *value, struct single_cells *out, void *scratch);
/* Whether the refracted directions of the light are needed. */
static inline bool prt_single_keeps_directions(const struct single_plan *plan)
{
    return plan->n_phase > 1 || (plan->toward && !plan->isotropic);
}
/* n directions of a fixed light. */
struct light_directions {
    uint32_t n;
    const float *x, *y, *z; /* [n] unit */
    const float *rgb;       /* [n][3] radiance times solid angle */
};
/* Single scattering of one vertex under them: out [n_phase][n_radial][3], X07 eq 15. */
uint64_t prt_single_light(const struct single_plan *plan, const struct fresnel_table *fresnel,
                          uint32_t vertex, const struct light_directions *light, float *out,
                          void *scratch);
size_t prt_single_scratch_bytes(const struct single_plan *plan);

#endif
