/* SPDX-License-Identifier: MIT */
/* What the files of screen/ share: samples with irradiance, R_d tables, pair sums, trees. */
#ifndef SCREEN_INTERNAL_H
#define SCREEN_INTERNAL_H

#include "prt/screen.h"

/* libm's are calls, for the sake of NaN. */
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

/* prt_parallel_for that asks the context's progress callback before it and, every tenth of a
 * second, in it whether to go on: PRT_CANCELLED when not. */
int screen_loop(const struct prt_context *ctx, size_t n, size_t grain, prt_loop_fn fn,
                void *arg);

/* Points x_i of the surface, as columns padded to 16. weight = E * area. */
struct samples {
    uint32_t n, capacity;
    float *p[3], *normal[3], *face[3]; /* [n] mm, unit */
    float *area;                       /* [n] mm^2 */
    float *e[3];                       /* [n] irradiance */
    uint32_t *object;                  /* [n] ascending */
    uint32_t *triangle;                /* [n] and barycentrics of its vertices 1 and 2 */
    float *bary[2];
};
bool samples_init(struct samples *s, uint32_t capacity);
void samples_finish(struct samples *s);

/* Atlas: n texels of equal area along a space-filling curve of each object's triangles. */
int samples_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                  struct samples *out);
struct grid {
    const uint32_t *triangle_block;
    float spacing_mm, phase[2], turn; /* where its points fall: shares of a step; radians */
};
/* The same in the model's own uv; *injective false, and no samples, when two places share one.
 */
int samples_uv_atlas(const struct prt_context *ctx, const struct prt_mesh *mesh, uint32_t n,
                     struct samples *out, bool *injective);
/* Samples by object and code, 30 bits of which lie under the object. */
enum { CODE_BITS = 30 };
struct key {
    uint64_t code;
    uint32_t index;
};
struct key *sort_keys(struct key *key, struct key *other, size_t n);
double place(const struct prt_mesh *mesh, uint32_t t, double bu, double bv, struct samples *s,
             uint32_t at);
bool block_translucent(const struct prt_mesh *mesh, uint32_t block);
/* A distant light's view as a picture: what each cell of its grid shows. */
struct light_map {
    uint32_t nu, nv;
    float origin[3], u[3], v[3], d[3], step;
    struct light_texel {
        float depth;     /* mm along the light from origin */
        uint32_t slope;  /* of depth for a step along u, v, the surface's plane: bfloat16s */
        float e;         /* irradiance per area across a light of rgb 1, F_t included */
        uint32_t object; /* UINT32_MAX: nothing translucent */
    } * texel;           /* [nv][nu] */
};
int light_map_make(const struct prt_context *ctx, const struct prt_scene *scene,
                   const struct prt_screen_light *light, const struct grid *grid,
                   const float *eta, struct light_map *out, uint64_t *n_ray);
void light_map_finish(struct light_map *map);
/* Depth layers along the three axes, spacing mm apart, each keeping what faces it most. */
int samples_peel(const struct prt_context *ctx, const struct prt_scene *scene,
                 const struct grid *grid, struct samples *out, uint64_t *n_ray);
/* The grid of points a distant light sees, with its irradiance already in e. */
int samples_light_view(const struct prt_context *ctx, const struct prt_scene *scene,
                       const struct prt_screen_light *light, const struct grid *grid,
                       const float *eta, struct samples *out, uint32_t *n_grid,
                       uint64_t *n_ray);

/* E at samples: traced shadows, exact F_t (eta[object]; NULL: none, Lambertian). */
int irradiance_traced(const struct prt_context *ctx, const struct prt_scene *scene,
                      uint32_t n_light, const struct prt_screen_light *light, const float *eta,
                      struct samples *s, uint64_t *n_ray);
/* E interpolated from the mesh's vertices. */
int irradiance_vertices(const struct prt_context *ctx, const struct prt_mesh *mesh,
                        const float (*e)[3], struct samples *s);
/* n points of the G-buffer as samples, e not set; index NULL: the first n. False without
 * memory. */
bool seen_samples(const struct frame *f, uint32_t n, const uint32_t *index, struct samples *s);
/* The frame's E at samples: from vertices, harmonics or rays. */
int frame_irradiance(struct frame *f, struct samples *s);
/* S09: E from 16 spherical harmonics of the light, no shadows. */
void irradiance_harmonics(const struct prt_cube *cube, const float *eta, struct samples *s);

/* A radial function of three channels: quadratics in q = r^2 + r0^2 on 32 segments, a power of
 * two of them an octave, so that the segment is a few bits of q and fits vector registers. */
struct radial_table {
    float coef[3][3][32]; /* [channel][power][segment & 31] */
    float r0_sq, q_max;
    uint32_t shift;
};
typedef void (*profile_fn)(const void *arg, double r_mm, double out[3]);
void radial_table_fit(struct radial_table *t, profile_fn fn, const void *arg, double scale_mm,
                      double r_max_mm);
void radial_table_eval(const struct radial_table *t, float r_sq, float out[3]);

/* C08's split is this steep [mm^-1]. */
#define SPLIT_K 1.5
struct frame;
/* R_d of an object, or its local or global part, averaged over a disc; up to r_max. The split
 * is C08's with r_p >= 0, else with own_mm > 0 local light is the share exp(-(r / own_mm)^2).
 */
void split_table(const struct frame *f, uint32_t object, double r_p, double own_mm, bool local,
                 double disc_mm, float r_max, struct radial_table *out);
/* Integral of 2 pi r R_d exp(-(r / own_mm)^2): what a flat surface gets from its own
 * irradiance. */
void own_share(const struct frame *f, uint32_t object, double own_mm, double share[3]);

/* Weighted points to sum over. Columns of `capacity`. */
struct emitters {
    uint32_t n, capacity;
    float *p[3], *w[3];
};
bool emitters_reserve(struct emitters *e, uint32_t capacity);
void emitters_finish(struct emitters *e);
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
pair_fn pair_kernel(unsigned cpu);

/* Boxes over runs of consecutive samples, four side by side: lanes of children. Samples keep
 * their columns, which must be readable TREE_LEAF past the end. Leaves of an object come first,
 * so that a node before n_leaf_end holds leaves. */
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
    const float *p[3]; /* the samples' */
    float *w[3];       /* E * area */
};
int tree_build(const struct prt_context *ctx, const struct samples *s, uint32_t n_object,
               struct tree *out);
void tree_finish(struct tree *tree);
/* Emitters for all points in a box: nodes that look small from it, samples near it, nothing
 * beyond r_max of it. */
bool tree_gather(const struct tree *tree, uint32_t object, const float lo[3], const float hi[3],
                 float opening, float r_max, struct emitters *out);

/* Receivers of a view in tiles of one object and one patch of the screen; a tile's columns are
 * padded to 16. Every point of the G-buffer is a mean of four. */
enum { TILE_POINTS = 64, VIEWS = 3, CLASSES = 4 };
#define RECEIVER_SHARE 0.75
struct view_cache {
    uint64_t key, used;
    uint32_t n_receiver, n_tile, n_column;
    uint32_t *begin;     /* [n_tile+1] columns */
    uint32_t *object;    /* [n_tile] */
    float *p[3];         /* [n_column] mm */
    uint32_t *leader;    /* [n_column] a point of the G-buffer that it stands for */
    uint32_t (*from)[4]; /* [n_point] columns */
    float (*weight)[4];  /* [n_point] */
};
void view_finish(struct view_cache *v);

/* What tangent-plane sampling reads of a view, kept while the view stays. */
struct tangent_view {
    uint64_t key;
    struct samples seen; /* the G-buffer's points; e is the frame's */
    uint32_t *point_of;  /* [pixel] the point it is known by, or UINT32_MAX */
    uint8_t *variant,
        *needed;       /* [n_point] interleaved pattern; whether light is computed there */
    uint8_t *readable; /* [n_point] irradiance is read there; elsewhere light's views tell */
    double *area_cdf;  /* [n_point+1] mm^2 seen, running */
};
void tangent_view_finish(struct tangent_view *v);

struct prt_screen {
    const struct prt_mesh *mesh;
    const struct prt_scene *scene;
    struct prt_scene *own_scene;
    float diameter_mm;
    double area_mm2;
    struct samples atlas; /* texels of the last size asked for */
    struct samples peel;  /* layers of the last spacing asked for */
    float peel_spacing;
    uint64_t peel_seed;
    uint32_t *triangle_block; /* [n_triangle] */
    uint32_t atlas_size;
    bool atlas_uv;                 /* in the model's own uv */
    struct view_cache view[VIEWS]; /* views last drawn */
    struct tangent_view tangent;
    int uv_state; /* of the model's own uv: 0 not looked at, 1 injective, -1 not */
    uint64_t clock;
    struct samples check; /* texels that frames are checked against */
    uint32_t check_size;
    struct checked {
        double trouble;       /* error over plan_error, as last seen; 0: not yet */
        double work, path_mm; /* samples and mean free path it was seen with */
        uint32_t since;       /* frames */
    } checked[4][2];          /* engine, few or many lights */
    double slowness[4];       /* engine's seconds over plan_seconds, as seen; 0: not yet */
};

/* One frame on its way through an engine. */
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
    bool any;                      /* translucent points */
    const struct view_cache *view; /* while light is received */
    float *sum[3];                 /* [n_column] B so far */
    uint32_t n_light;
    struct prt_screen_light *light;
    const struct prt_cube *cube;
    const struct prt_screen_options *options;
    uint64_t seed; /* of this frame: options' and the frame's number */
    float (*radiance)[3];
    struct prt_screen_report *report;
};
/* Receivers for light that changes over scale_mm, with sums of 0; the sums added to radiance.
 */
int receive_begin(struct frame *f, double scale_mm);
int receive_end(struct frame *f);
void receive_finish(struct frame *f);
uint64_t view_key(const struct frame *f);
float view_pixel_mm(const struct prt_visibility *vis);
/* Pixels to a receiver's side where light changes over scale_mm: 1, 2 or 4. */
uint32_t receiver_size(double pixel_mm, double scale_mm);
int view_get(struct frame *f, uint32_t size, const struct view_cache **out);
/* Adds the sum over emitters to every receiver. Emitters of each object in one list, in runs
 * that end at class_end[object][], each with its own table [object][CLASSES]. */
int scatter_all(struct frame *f, const struct radial_table *table, const struct emitters *list,
                const uint32_t (*class_end)[CLASSES]);
/* The same over a tree of samples; one table per object. */
int scatter_tree(struct frame *f, const struct radial_table *table, const struct samples *s,
                 float opening, float r_max);
/* Texels of the atlas with irradiance of this frame's lights; kept for the frame. */
int frame_atlas(struct frame *f, uint32_t n);
float smallest_mean_free_path(const struct frame *f);

/* R_d exp(-(r / own_mm[object])^2) at every point, from the picture's own irradiance. */
int own_light(struct frame *f, const double *own_mm);

/* C08's local pattern at every receiver. */
int scatter_pattern(struct frame *f, double r_p, float spacing, float reach);

/* Few enough distant lights, and nothing else, that each may have its own view. */
bool only_light_views(const struct frame *f);
/* The frame's grid: coherent while seed and frame stay. */
struct grid frame_grid(const struct frame *f, float spacing_mm);
/* Light from points of the surface as discs of their mean area: R_d, or with r_p >= 0 its part
 * that is local (C08). */
int scatter_discs(struct frame *f, const struct samples *s, double r_p, float opening,
                  float r_max);
/* Points that distant light l sees, with the E it gives them, by the normals of maps. */
int frame_light_view(struct frame *f, uint32_t l, const struct grid *grid, struct samples *out);
int scatter_light_views(struct frame *f, double r_p, float spacing, float opening, float r_max);

int engine_splat(struct frame *f);
int engine_tangent(struct frame *f);
int engine_texture(struct frame *f, bool hybrid);
int engine_reference(struct frame *f, uint32_t n_texel, uint32_t stride, double *error);

/* Maps over uv. map_media: every point's medium, objects apart: factors of sigma_s', sigma_a.
 */
enum { MOST_MEDIA = 48 };
struct media {
    uint32_t n;
    uint8_t *of;        /* [n_point] */
    float (*factor)[6]; /* [n] */
    uint32_t *object;   /* [n] */
    float (*rho)[3];    /* [n_point] total reflectance of the point's own coefficients */
};
/* Channel c of a medium whose coefficients the factors scale; one with a profile stays as it
 * is. */
void mapped_dipole(const struct prt_diffusion *base, const float factor[6], int c,
                   struct prt_diffusion *out);
/* Its total reflectance; of a profile: scaled as that of the nearest dipole. */
double mapped_reflectance(const struct prt_diffusion *base, const float factor[6], int c);
int map_check(const struct prt_context *ctx, const struct prt_mesh *mesh,
              const struct prt_screen_map *map, bool factor, bool checked);
void map_lookup(const struct prt_screen_map *map, const float uv[2], float rgb[3]);
void point_factor(const struct frame *f, uint32_t i, float factor[6]);
/* Own columns of normals for samples with triangle and bary: s->normal[] is replaced, not
 * freed. */
int map_normals(const struct frame *f, struct samples *s);
/* Scales radiance that was summed with the objects' plain media by every point's own
 * reflectance. */
int map_tint(const struct frame *f);
static inline bool maps_turn(const struct prt_screen_options *o)
{
    return o->bump_map || o->normal_map;
}
static inline bool maps_tint(const struct prt_screen_options *o)
{
    return o->sigma_s_map || o->sigma_a_map;
}
int map_media(const struct frame *f, struct media *out);
void media_finish(struct media *media);

/* Seconds of two cores and relative RMSE foreseen; the samples that fit; what a frame took. */
struct plan_view {
    uint32_t n_point, n_light;
    double pixel_mm, area_mm2, diameter_mm, mean_free_path_mm;
};
enum { FEW_LIGHTS = 4 };
double plan_seconds(enum prt_screen_engine e, uint32_t n, const struct plan_view *view);
double plan_error(enum prt_screen_engine e, uint32_t n, const struct plan_view *view);
uint32_t plan_samples(const struct prt_screen *screen, enum prt_screen_engine e,
                      const struct plan_view *view, double seconds);
void plan_learn(struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                const struct plan_view *view, double seconds);
struct plan_view frame_plan(const struct frame *f);
/* Error to foresee: plan_error, corrected by what frames of this kind were seen to do. */
double plan_expect(const struct prt_screen *screen, enum prt_screen_engine e, uint32_t n,
                   const struct plan_view *view);
/* Relative RMS difference of radiance from a sum over many texels, at some 160 points. */
int frame_check(struct frame *f, double *error);
bool frame_measurable(const struct prt_screen_options *options);
/* Relative RMSE of radiance [n_point][3] against REFERENCE at some 500 points. */
int screen_measure(const struct prt_context *ctx, struct prt_screen *screen,
                   const struct prt_visibility *vis, const struct prt_material *material,
                   const struct prt_cube *cube, uint32_t n_extra,
                   const struct prt_screen_light *extra,
                   const struct prt_screen_options *options, const float (*radiance)[3],
                   double *error);
/* Samples asked for: the options', a budget's, or the default, doubled by refine. */
uint32_t frame_samples(const struct frame *f, uint32_t normal, uint32_t most);

/* Profiles as tables are fitted to: three dipoles, or a prt_screen_profile. */
void prt_screen_dipole_profile(const void *dipole3, double r_mm, double out[3]);
void prt_screen_table_profile(const void *profile, double r_mm, double out[3]);
int prt_screen_profile_check(const struct prt_context *ctx, const struct prt_screen_profile *p);

#endif
