/* SPDX-License-Identifier: MIT */
/* Shared by the files of screen/: samples with irradiance, tables of R_d, pair sums, trees,
 * views, one frame, maps, plans. Columns are arrays of one component each. */
#ifndef SCREEN_INTERNAL_H
#define SCREEN_INTERNAL_H

#include "prt/screen.h"

/* fmaxf and fminf are library calls, because of their rules for NaN. */
static inline float max_f(float a, float b)
{
    return a > b ? a : b;
}
static inline float min_f(float a, float b)
{
    return a < b ? a : b;
}

static inline uint32_t min_u(uint32_t a, uint32_t b)
{
    return a < b ? a : b;
}

struct frame;

/* prt_parallel_for that calls the context's progress callback before it starts and every tenth
 * of a second: PRT_CANCELLED when that returns nonzero. */
int prt_screen_loop(const struct prt_context *ctx, size_t n, size_t grain, prt_loop_fn fn,
                    void *arg);

/* samples.c: points x_i of the surface, as columns padded to 16. */
struct samples {
    uint32_t n, capacity;
    float *p[3], *normal[3], *face[3]; /* [n] mm, unit */
    float *area;                       /* [n] mm^2 */
    float *e[3];                       /* [n] irradiance, linear RGB */
    uint32_t *object;                  /* [n] ascending */
    uint32_t *triangle;                /* [n] */
    float *bary[2];                    /* [n] of the triangle's vertices 1 and 2 */
};
/* Room for `capacity` samples, n = 0; false without memory. */
bool prt_samples_init(struct samples *s, uint32_t capacity);
void prt_samples_finish(struct samples *s);

/* Atlas: n texels of equal area along a space-filling curve of each object's triangles. */
int prt_samples_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                      struct samples *out);
/* atlas_uv.c: the same in the model's own uv; *injective false, and no samples, where two
 * points of an object have the same uv. */
int prt_samples_uv_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                         struct samples *out, bool *injective);
/* A sort key: object << CODE_BITS | 30 bits of order within it. */
enum { CODE_BITS = 30 };
struct key {
    uint64_t code;
    uint32_t index;
};
/* Stable radix sort of n keys; returns the array that holds the result, key or other. */
struct key *prt_sort_keys(struct key *key, struct key *other, size_t n);
/* The cell of p on a Morton curve of 1024^3 cells over a cube that starts at lo; inv_edge:
 * prt_inverse_edge of its box. */
uint64_t prt_morton_code(const float lo[3], float inv_edge, const float p[3]);
/* One over the longest edge of a box [mm^-1]. */
float prt_inverse_edge(float box[2][3]);
/* Writes position, normals, triangle and barycentrics of sample `at`; returns the triangle's
 * area [mm^2]. */
double prt_sample_place(const struct prt_mesh *mesh, uint32_t t, double bu, double bv,
                        struct samples *s, uint32_t at);
bool prt_block_translucent(const struct prt_mesh *mesh, uint32_t block);
/* ray_grid.c: grids of parallel rays. */
struct grid {
    const uint32_t *triangle_block; /* [n_triangle] */
    float spacing_mm;
    float phase[2], turn; /* offset in steps; rotation about the light [radians] */
};
/* A distant light's view as an image: the first surface under each cell of its grid. */
struct light_map {
    uint32_t nu, nv;
    float origin[3], u[3], v[3], d[3], step;
    struct light_texel {
        float depth;     /* along the light from origin [mm] */
        uint32_t slope;  /* of depth along u and v, in the surface's plane: two bfloat16 */
        float e;         /* irradiance per area across a light of rgb 1, with F_t */
        uint32_t object; /* UINT32_MAX: nothing translucent */
    } * texel;           /* [nv][nu] */
};
int prt_light_map_make(const struct prt_context *ctx, const struct prt_scene *scene,
                       const struct prt_screen_light *light, const struct grid *grid,
                       const float *eta, struct light_map *out, uint64_t *n_ray);
void prt_light_map_finish(struct light_map *map);
/* Depth layers along the three axes, spacing_mm apart; each keeps the surface that faces it
 * most. */
int prt_samples_peel(const struct prt_context *ctx, const struct prt_scene *scene,
                     const struct grid *grid, struct samples *out, uint64_t *n_ray);
/* The points of the grid that a distant light sees, with the light's irradiance in e. */
int prt_samples_light_view(const struct prt_context *ctx, const struct prt_scene *scene,
                           const struct prt_screen_light *light, const struct grid *grid,
                           const float *eta, struct samples *out, uint32_t *n_grid,
                           uint64_t *n_ray);

/* irradiance.c: E at samples by shadow rays, with exact F_t (eta[object]; NULL: none, for
 * Lambertian surfaces). */
int prt_irradiance_traced(const struct prt_context *ctx, const struct prt_scene *scene,
                          uint32_t n_light, const struct prt_screen_light *light,
                          const float *eta, struct samples *s, uint64_t *n_ray);
/* E interpolated from the mesh's vertices. */
int prt_irradiance_vertices(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            const float (*e)[3], struct samples *s);
/* n points of the G-buffer as samples without e; index NULL: the first n. False without memory.
 */
bool prt_visible_samples(const struct frame *f, uint32_t n, const uint32_t *index,
                         struct samples *s);
/* screen.c: the frame's E at samples, from vertices, harmonics or rays. */
int prt_frame_irradiance(struct frame *f, struct samples *s);
/* S09: E from 16 spherical harmonics of the light, no shadows; with `add` added to e. */
void prt_irradiance_harmonics(const struct prt_cube *cube, const float *eta, bool add,
                              struct samples *s);

/* table.c: a radial function of three channels, as quadratics in q = r^2 + r0^2 on 32 segments.
 * A power of two of segments is an octave, so that the segment's index is a few bits of q; the
 * table fits into vector registers. */
struct radial_table {
    float coef[3][3][32]; /* [channel][power][segment & 31] */
    float r0_sq, q_max;
    uint32_t shift;
};
typedef void (*profile_fn)(const void *arg, double r_mm, double out[3]);
void prt_radial_table_fit(struct radial_table *t, profile_fn fn, const void *arg,
                          double scale_mm, double r_max_mm);
void prt_radial_table_eval(const struct radial_table *t, float r_sq, float out[3]);

#define SPLIT_K 1.5 /* K of C08's split [mm^-1] */
/* R_d of an object, or its local or global part, averaged over a disc; up to r_max. With r_p >=
 * 0 the split is C08's; else with own_mm > 0 the local part is exp(-(r / own_mm)^2) R_d; else
 * there is no split. */
void prt_split_table(const struct frame *f, uint32_t object, double r_p, double own_mm,
                     bool local, double disc_mm, float r_max, struct radial_table *out);
/* Integral of 2 pi r R_d exp(-(r / own_mm)^2): the local part's response of a plane to constant
 * irradiance. */
void prt_near_share(const struct frame *f, uint32_t object, double own_mm, double share[3]);

/* pair_sum.c: weighted points to sum over, weight = E * area. Columns of `capacity`. */
struct emitters {
    uint32_t n, capacity;
    float *p[3], *w[3];
};
/* Grows the columns; false without memory. */
bool prt_emitters_reserve(struct emitters *e, uint32_t capacity);
void prt_emitters_finish(struct emitters *e);
static inline void emitters_push(struct emitters *e, const float p[3], const float w[3])
{
    for (int k = 0; k < 3; k++) {
        e->p[k][e->n] = p[k];
        e->w[k][e->n] = w[k];
    }
    e->n++;
}
/* sum[c][i] += sum_j w[c][j] R_c(|p_i - p_j|); n_point a multiple of 16, columns 64-byte
 * aligned. */
typedef void (*pair_fn)(const struct radial_table *t, const struct emitters *e, uint32_t begin,
                        uint32_t end, uint32_t n_point, const float *const p[3],
                        float *const sum[3]);
/* The kernel for a CPU mask (enum prt_cpu). */
pair_fn prt_pair_kernel(unsigned cpu);

/* tree.c: boxes over runs of consecutive samples; a node has four children, as lanes. Samples
 * stay in their columns, which must be readable TREE_LEAF past the end. An object's leaves come
 * first: nodes before n_leaf_end have leaves as children. */
enum { TREE_LEAF = 8 };
struct tree_node {
    float lo[3][4], hi[3][4], p[3][4], w[3][4], size_sq[4];
    uint32_t first[4]; /* child node, or first sample of a leaf */
};
struct tree {
    struct tree_node *node;
    uint32_t n_node;
    uint32_t *root, *n_leaf_end; /* [n_object] node, or UINT32_MAX; end of its leaves */
    uint32_t *sample_end;        /* [n_object] */
    uint32_t n_object;
    const float *p[3]; /* columns of the samples */
    float *w[3];       /* E * area */
};
int prt_tree_build(const struct prt_context *ctx, const struct samples *s, uint32_t n_object,
                   struct tree *out);
void prt_tree_finish(struct tree *tree);
/* Appends the emitters for all points of a box [lo, hi]: nodes whose diagonal is less than
 * opening times their gap to the box, samples of leaves that are nearer, nothing further than
 * r_max. False without memory. */
bool prt_tree_gather(const struct tree *tree, uint32_t object, const float lo[3],
                     const float hi[3], float opening, float r_max, struct emitters *out);

/* view.c: receivers of a view, in tiles of one object and one block of the screen; a tile's
 * columns are padded to 16. Every point of the G-buffer is a weighted mean of four receivers.
 */
enum { TILE_POINTS = 64, VIEWS = 3 }; /* receivers a tile; views kept. Chosen, not measured */
enum { CLASSES = 4 };                 /* of drawn points by disc radius (texture.c) */
#define RECEIVER_SHARE 0.75           /* of the scale over which light varies (METHODS §6) */
struct view_cache {
    uint64_t key, used;
    uint32_t n_receiver, n_tile, n_column;
    uint32_t *begin;     /* [n_tile+1] columns */
    uint32_t *object;    /* [n_tile] */
    float *p[3];         /* [n_column] mm */
    uint32_t *leader;    /* [n_column] a point of the G-buffer that interpolates it */
    uint32_t (*from)[4]; /* [n_point] columns */
    float (*weight)[4];  /* [n_point] */
};
void prt_view_finish(struct view_cache *v);

/* tangent_view.c: the view as tangent-plane sampling reads it, kept while the view stays. */
struct tangent_view {
    uint64_t key;
    struct samples seen;       /* the G-buffer's points, with e of the last frame */
    uint32_t *point_of;        /* [pixel] the point that stands for it, or UINT32_MAX */
    uint8_t *variant, *needed; /* [n_point] interleaved set; whether light is computed there */
    uint8_t *readable;         /* [n_point] irradiance may be read there */
    double *area_cdf;          /* [n_point+1] running area of readable points [mm^2] */
};
void prt_tangent_view_finish(struct tangent_view *v);

struct prt_screen {
    const struct prt_mesh *mesh;
    const struct prt_scene *scene;
    struct prt_scene *own_scene;
    float diameter_mm;
    double area_mm2;
    struct samples atlas; /* texels of the last size */
    struct samples peel;  /* layers of the last spacing and seed */
    float peel_spacing;
    uint64_t peel_seed;
    uint32_t *triangle_block; /* [n_triangle] */
    uint32_t atlas_size;
    bool atlas_uv;                 /* in the model's own uv */
    struct view_cache view[VIEWS]; /* least recently used is replaced */
    struct tangent_view tangent;
    int uv_state; /* of the model's own uv: 0 not tested, 1 injective, -1 not */
    uint64_t clock;
    struct samples check; /* texels of the sum that frames are checked against */
    uint32_t check_size;
    struct checked {
        double ratio;         /* error over prt_plan_error at the last check; 0: none */
        double work, path_mm; /* samples and mean free path of that check */
        uint32_t since;       /* frames since then */
    } checked[4][2];          /* engine, few or many lights */
    double slowness[4]; /* engine's measured seconds over prt_plan_seconds; 0: no frame yet */
};

/* One frame. */
struct frame {
    const struct prt_context *ctx;
    struct prt_screen *screen;
    const struct prt_visibility *vis;
    struct prt_gbuffer g;
    uint32_t width, height;
    uint32_t n_object;
    struct prt_diffusion (*dipole)[3]; /* [n_object] */
    float *eta;                        /* [n_object] */
    struct radial_table *table;        /* [n_object] R_d */
    uint64_t view_key;
    bool any;                       /* has translucent points */
    const struct view_cache *view;  /* from prt_receivers_begin on */
    float *sum[3];                  /* [n_column] sum of R_d E dA */
    uint32_t n_light, n_cube_light; /* the cube's come first */
    struct prt_screen_light *light;
    const struct prt_cube *cube;
    const struct prt_screen_options *options;
    uint64_t seed; /* of the options and the frame's number; 0: samples without randomness */
    float (*radiance)[3];
    struct prt_screen_report *report;
};
/* view.c: prt_receivers_begin chooses receivers for light that varies over scale_mm and clears
 * their sums; prt_receivers_resolve adds the sums to radiance and ends; prt_receivers_finish
 * ends. */
int prt_receivers_begin(struct frame *f, double scale_mm);
int prt_receivers_resolve(struct frame *f);
void prt_receivers_finish(struct frame *f);
/* A hash of the points of the G-buffer. */
uint64_t prt_view_key(const struct frame *f);
/* Mean side of a pixel on the surface seen [mm]. */
float prt_view_pixel_mm(const struct prt_visibility *vis);
/* Pixels a side of a receiver where light varies over scale_mm: 1, 2 or 4. */
uint32_t prt_receiver_size(double pixel_mm, double scale_mm);
/* The view's receivers of this size, computed when they are not kept. */
int prt_view_get(struct frame *f, uint32_t size, const struct view_cache **out);
/* scatter.c: adds the sum over emitters to every receiver. An object's emitters are one list,
 * in runs that end at class_end[object][]; each run has its own table [object][CLASSES]. */
int prt_scatter_all(struct frame *f, const struct radial_table *table,
                    const struct emitters *list, const uint32_t (*class_end)[CLASSES]);
/* The same over a tree of samples; one table per object. */
int prt_scatter_tree(struct frame *f, const struct radial_table *table, const struct samples *s,
                     float opening, float r_max);
/* screen.c: fills screen->atlas with n texels and their irradiance, in the model's own uv where
 * they are one to one, or with `equal` along triangles, all of one area. */
int prt_frame_atlas(struct frame *f, uint32_t n, bool equal);
/* Distant lights that stand for the input's cube; 0 without one. options may be NULL. */
uint32_t prt_cube_lights(const struct prt_screen_input *input,
                         const struct prt_screen_options *options);
/* The smallest over all objects and channels [mm]. */
float prt_frame_mean_free_path(const struct frame *f);

/* near_field.c: adds light by R_d exp(-(r / own_mm[object])^2) at every point, from the
 * picture's irradiance. */
int prt_near_field_add(struct frame *f, const double *own_mm);

/* pattern.c: adds C08's ring pattern at every receiver. */
int prt_scatter_pattern(struct frame *f, double r_p, float spacing, float reach);

/* splat.c: whether all light is at most 4 distant lights, so that each has its own view. */
bool prt_frame_light_views_only(const struct frame *f);
/* The frame's grid; equal for equal seed and frame. */
struct grid prt_frame_grid(const struct frame *f, float spacing_mm);
/* Adds light of samples as discs of their mean area: by R_d, or with r_p >= 0 by its local part
 * (C08). */
int prt_scatter_discs(struct frame *f, const struct samples *s, double r_p, float opening,
                      float r_max);
/* Points that distant light l sees, with its E for the normals of maps. */
int prt_frame_light_view(struct frame *f, uint32_t l, const struct grid *grid,
                         struct samples *out);
/* Adds light of the points that each light sees. */
int prt_scatter_light_views(struct frame *f, double r_p, float spacing, float opening,
                            float r_max);

/* The engines add to f->radiance and fill f->report. */
int prt_engine_splat(struct frame *f);
int prt_engine_tangent(struct frame *f);
int prt_engine_texture(struct frame *f, bool hybrid);
/* Every stride-th translucent point; error NULL: written to radiance, else compared with it. */
int prt_engine_reference(struct frame *f, uint32_t n_texel, uint32_t stride, double *error);

/* surface_maps.c: classes of points by object and factors of sigma_s' and sigma_a. */
enum { MOST_MEDIA = 48 };
struct media {
    uint32_t n;
    uint8_t *of;        /* [n_point] class */
    float (*factor)[6]; /* [n] of sigma_s', then of sigma_a */
    uint32_t *object;   /* [n] */
    float (*rho)[3];    /* [n_point] total reflectance of the point's own coefficients */
};
/* Channel c of a medium with scaled coefficients; one with its own profile is copied. */
void prt_map_medium(const struct prt_diffusion *base, const float factor[6], int c,
                    struct prt_diffusion *out);
/* The total reflectance of that channel; of a profile: scaled like that of a dipole with its
 * coefficients. */
double prt_map_reflectance(const struct prt_diffusion *base, const float factor[6], int c);
/* PRT_ARG with a message for a map that cannot be used. factor: values must be >= 0; checked:
 * values were checked before. */
int prt_map_check(const struct prt_context *ctx, const struct prt_mesh *mesh,
                  const struct prt_screen_map *map, bool factor, bool checked);
/* Bilinear, repeated. */
void prt_map_lookup(const struct prt_screen_map *map, const float uv[2], float rgb[3]);
/* Factors at point i of the G-buffer. */
void prt_map_point_factor(const struct frame *f, uint32_t i, float factor[6]);
/* Replaces s->normal[] by new columns with the normals of maps; the old ones are not freed. */
int prt_map_normals(const struct frame *f, struct samples *s);
/* Multiplies radiance that was summed with the objects' plain media by the ratio of every
 * point's total reflectance to the plain one. */
int prt_map_tint(const struct frame *f);
/* Factors of irradiance by the textures of the mesh (prt_mesh_tint, occlusion maps); 1 where it
 * has none. */
int prt_map_occlude(const struct frame *f, struct samples *s);
/* Whether some of these factors may differ from 1. */
bool prt_map_occludes(const struct frame *f);
/* Whether a map turns normals: of the options, or of the mesh. */
static inline bool maps_turn(const struct frame *f)
{
    return f->options->bump_map || f->options->normal_map || f->screen->mesh->maps;
}
static inline bool maps_tint(const struct prt_screen_options *o)
{
    return o->sigma_s_map || o->sigma_a_map;
}
int prt_map_media(const struct frame *f, struct media *out);
void prt_media_finish(struct media *media);

/* plan.c: the view, light and medium as cost and error depend on them. */
struct plan_view {
    uint32_t n_point, n_light;
    double pixel_mm, area_mm2, diameter_mm, mean_free_path_mm;
};
enum { FEW_LIGHTS = 4 }; /* kinds of light by their number: up to this, and more */
/* Seconds of two cores. */
double prt_plan_seconds(enum prt_screen_engine e, uint32_t n, const struct plan_view *view);
/* Relative RMSE by the fit alone. */
double prt_plan_error(enum prt_screen_engine e, uint32_t n, const struct plan_view *view);
/* The largest sample count whose expected time fits. */
uint32_t prt_plan_samples(const struct prt_screen *screen, enum prt_screen_engine e,
                          const struct plan_view *view, double seconds);
/* Updates the engine's speed by the seconds that a frame took. */
void prt_plan_learn(struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                    const struct plan_view *view, double seconds);
struct plan_view prt_frame_plan(const struct frame *f);
/* Expected error: prt_plan_error times the ratio at the last check of such a frame, and a
 * margin. */
double prt_plan_expect(const struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                       const struct plan_view *view);
/* texel_sum.c: R_d summed over texels [first, last) of one object, with their e. */
struct texel_sum {
    struct radial_table table;
    struct emitters list;
    double share[3];
};
/* False without memory; the caller ends it with prt_texel_sum_finish. */
bool prt_texel_sum_init(const struct frame *f, const struct samples *texels, uint32_t first,
                        uint32_t last, struct texel_sum *out);
/* Adds to sum[c][n] at points p, whose own irradiance is e; n a multiple of 16, columns 64-byte
 * aligned. Thread-safe for different points. */
void prt_texel_sum_add(const struct prt_context *ctx, const struct texel_sum *s, uint32_t n,
                       const float *const p[3], const float *const e[3], float *const sum[3]);
void prt_texel_sum_finish(struct texel_sum *s);

/* check.c: relative RMS difference of radiance from a sum over many texels, at some 160 points.
 */
int prt_frame_check(struct frame *f, double *error);
/* screen.c: the options' sample count, a budget's, or `normal`, doubled by each refinement up
 * to `most`. */
uint32_t prt_frame_samples(const struct frame *f, uint32_t normal, uint32_t most);

/* M03: the radius >= from_mm below which lies a share xi in [0,1) of 2 pi r R_d / rho_d, the
 * mean of three channels. from_mm: a radius known to be smaller, 0 at first. */
double prt_screen_tangent_radius(const struct prt_diffusion dipole[3], double xi,
                                 double from_mm);
/* C08: share of R_d that is local at r (METHODS §7): 1 - 0.5 e^(K(r-R_p)) up to R_p. */
double prt_screen_local_weight(double r_mm, double r_p_mm);
/* C08: R_p for a bound [mm^-1], the largest over three channels. */
double prt_screen_split_radius(const struct prt_diffusion dipole[3], double bound);
/* C08 eq 9: index drawn by u in [0,1) in proportion to value[n], n a power of 4, by walking
 * down the mip chain; mip holds value first, then each coarser level: 4n/3 numbers. */
uint32_t prt_screen_mip_sample(const float *mip, uint32_t n, float u);
/* At most n distant lights that stand for a cube: strata of equal power, each at the mean
 * direction of its power. Powers add up to the cube's integral. Returns the number written. */
uint32_t prt_screen_lights_from_cube(const struct prt_cube *cube, uint32_t n,
                                     struct prt_screen_light *out);
/* Factors of sigma_a (>= 1) that give a medium albedo[n] (clamped to [0,1]) times its own total
 * reflectance, for sigma_a_map. factor may be albedo. PRT_ARG where sigma_a is 0. */
int prt_screen_albedo_factors(const struct prt_context *ctx,
                              const struct prt_material *material, size_t n,
                              const float (*albedo)[3], float (*factor)[3]);

/* R_d of three channels as radial_table_fit takes it; dipole3: struct prt_diffusion[3]. */
void prt_dipole_profile(const void *dipole3, double r_mm, double out[3]);

#endif
