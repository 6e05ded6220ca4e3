/* SPDX-License-Identifier: MIT */
/* evaluation.h declares the results that evaluations share (shared/: cache entries, each with a
 * reference for the caller; the comment of a section names the type of their value) and how
 * results are encoded. Entries that are passed in are held until the result is computed. */
#ifndef RELIGHTD_EVALUATION_H
#define RELIGHTD_EVALUATION_H

#include "render/render.h"
#include "render/shared/geometry.h"
#include "prt/variant.h"

/* ---- lights.c: struct prt_cube ---- */

/* The sum of lights [first, first + n) at cube_n, rotated or not. env[i] is the
 * decoded environment of light i, NULL for inline cubes. */
struct cache_entry *light_get(struct server *server, const struct render_spec *spec,
                              struct cache_entry *const env[], unsigned first, unsigned n,
                              uint32_t cube_n, bool turned);
/* The first light as a background: not rotated, at its own resolution up to a limit. */
struct cache_entry *background_get(struct server *server, const struct render_spec *spec,
                                   struct cache_entry *const env[]);

/* ---- specular.c: struct prt_specular ---- */

/* Of a light of light_get(), ready or not; NULL without memory. */
struct cache_entry *specular_get(struct server *server, struct cache_entry *light);

/* ---- variants.c: struct variant_view ---- */

struct variant_view {
    struct prt_variant *variant;
    struct cache_entry *file; /* whose arrays it shares; held */
};
/* The open file in the spec's variant, ready; NULL with *code and error where the file has no
 * such variant or its bake does not hold for it. */
struct cache_entry *variant_get(struct model *model, const struct render_spec *spec,
                                struct cache_entry *file, int *code, char error[300]);
/* A prt_log_fn: keeps the line in user, char[300]. */
void variant_keep_error(void *user, enum prt_log_level level, const char *line);

/* ---- visibility.c: struct prt_visibility ---- */

/* The camera that the request gives; `automatic`, without its numbers, where the model is
 * framed, by an orbit or by itself: visibility_get's worker does that. 0, or an error's code
 * for a name that none of the model's cameras has. */
int camera_choose(const struct render_spec *s, const struct prt_mesh *mesh,
                  struct prt_camera *out, char error[300]);
/* WORK_BACKGROUND for pictures that take seconds: they may not occupy every worker. */
enum work_class picture_class(const struct render_spec *s);
/* owner is held while `mesh`, which is of this generation, is read. prt_visibility_camera gives
 * the camera's numbers. */
struct cache_entry *visibility_get(struct model *model, uint64_t generation,
                                   struct cache_entry *owner, const struct prt_mesh *mesh,
                                   const struct render_spec *s, const struct prt_camera *c);

/* ---- media.c: struct prt_media ---- */

/* A map of n entries for the caller to fill; NULL without memory. */
struct media_map *media_map_create(unsigned n);
void media_map_set_key(struct media_map *map); /* of its n entries */
void media_map_release(struct media_map *map); /* NULL is fine */
/* Names the media that the spec gives, and its variant where that changes colours at vertices;
 * "": the model's own. */
enum { MEDIA_KEY = 2 * MATERIAL_KEY + 3 + VARIANT_NAME };
void media_key(const struct render_spec *spec, char key[MEDIA_KEY]);
/* The media by object of a mesh with these of its own; NULL where the spec names none. `owner`
 * is held while mesh and media, which belong to the file of this hash, are read. own: they are
 * wanted even where the spec names none, as those of a variant are. */
struct cache_entry *media_get(const struct model *model, const struct render_spec *spec,
                              struct cache_entry *owner, const struct prt_mesh *mesh,
                              const struct prt_media *media, uint64_t file_hash, bool own);

/* ---- floor.c: float[height][width][3], prt_floor_shadow() ---- */

/* For the camera of `visibility` (ready) and `light` (ready); owner is held while `mesh` is
 * read. NULL without memory. */
struct cache_entry *floor_get(struct server *server, struct cache_entry *owner,
                              const struct prt_mesh *mesh, struct cache_entry *visibility,
                              struct cache_entry *light, size_t pixels);

/* ---- light_contraction.c: struct light_contraction ---- */

struct light_contraction {
    struct prt_contracted_light *contracted;
    struct cache_entry *file; /* whose transport it refers to; held */
};
/* The joint transport contracted with a light: NULL where there is none yet. */
struct cache_entry *light_contraction_find(struct model *model, uint64_t generation,
                                           const struct cache_entry *file,
                                           const struct cache_entry *light);
/* Computes it from the second evaluation under the same light on; NULL at the first one and for
 * other transport: a plain pass costs no more. */
struct cache_entry *light_contraction_get(struct model *model, uint64_t generation,
                                          struct cache_entry *file, struct cache_entry *light);

/* ---- material_contraction.c: struct material_contraction ---- */

struct material_contraction {
    struct prt_contracted_transport *contracted;
    struct cache_entry *file; /* whose transport it refers to; held */
};
/* The joint transport contracted with media (an entry of media.c; NULL: the bake's), ready.
 * NULL until it was used with enough lights and then computed in the background. */
struct cache_entry *material_contraction_get(struct model *model, uint64_t generation,
                                             struct cache_entry *file,
                                             const struct cache_entry *light,
                                             struct cache_entry *media, const char *media_key);

/* ---- relight_pass.c: struct vertex_values ---- */

/* Values at the vertices for one light and query. */
struct vertex_values {
    unsigned n_plane;          /* with most_apart: M, S_k and planes of exit of PROTOCOL.md */
    unsigned n_exit;           /* of them planes of exit */
    uint32_t n_vertex, shared; /* shared: evaluations in its pass */
    float
        material_error; /* relative RMS error of projecting the material on the bake's bases */
    struct prt_coefficients coefficients; /* n_layer 0: these are values at vertices */
    float values[]; /* [n_plane][n_vertex][3], the coefficients' halves, or encoded colours */
};
struct vertex_query {
    int term;            /* enum prt_answer_term */
    bool planes;         /* per-phase planes for pictures, else final colours */
    unsigned most_apart; /* planes of prt_query.most_apart; 0: together */
    bool coefficients;   /* in place of both */
    uint32_t most_rank;  /* rows of a cluster; 0: all */
    bool phases;
    bool packed; /* coefficients: three in 32 bits */
    bool exits;  /* the planes of exit, where parts are apart and of coefficients */
    int format;  /* of colours, a Relight__ColorFormat; COLOR_F32 of all others */
    float exposure_ev;
    struct cache_entry *media;   /* of media.c; NULL: the bake's */
    struct cache_entry *variant; /* of variants.c; NULL: none */
    bool has_eye;
    float eye[3]; /* mm */
};
/* The entry of `key`; where there is none yet, it joins the model's next pass. The pass holds
 * the other entries and the query's media; all but file may be NULL. */
struct cache_entry *relight_pass_get(struct model *model, const char *key,
                                     const struct vertex_query *query, struct cache_entry *file,
                                     struct cache_entry *light,
                                     struct cache_entry *contracted_light,
                                     struct cache_entry *contracted_material);

/* Starts the passes that waited for an evaluation whose light was being turned. */
void relight_pass_go_on(struct model *model);

/* ---- irradiance.c: struct vertex_values of one plane, E at the vertices ---- */

/* Traced under the light's cube, which takes seconds. */
struct cache_entry *irradiance_get(struct server *server, const char *key,
                                   const struct vertex_query *query, struct cache_entry *file,
                                   struct cache_entry *light);

/* ---- encoded_colors.c: uint8_t[] ---- */

/* The values (ready, of floats) as one plane of colours in the spec's format; NULL without
 * memory. */
struct cache_entry *encoded_colors_get(struct server *server, const struct render_spec *spec,
                                       struct cache_entry *values);

/* ---- coarse_order.c: struct coarse_order ---- */

struct coarse_order {
    uint32_t n, n_root;
    uint64_t hash;
    const uint32_t *vertex; /* [n], of struct prt_coarse_order */
    uint8_t *bytes;         /* of the wire: u32 vertex[n], at `parents` u32 parent[n][2] */
    size_t parents, size;
};
struct cache_entry *coarse_order_get(struct model *model, struct cache_entry *file);
/* Colours of a frame of this level: 1/2^level of the vertices. */
uint32_t coarse_count(const struct coarse_order *coarse, unsigned level);

/* ---- texture_files.c: struct texture_files ---- */

enum { TEXTURE_LEVELS = 16 }; /* of an image of at most 32768 texels a side */
struct texture_files {
    uint8_t *bytes; /* PNG files of RGBA, from the full size on */
    size_t size;
    uint32_t n_level, level[TEXTURE_LEVELS]; /* bytes of each file */
};
/* image: index into the images of the shape's mesh. */
struct cache_entry *texture_files_get(struct model *model, struct cache_entry *shape,
                                      uint32_t image);

/* ---- surface_maps.c: struct prt_screen_map ---- */

/* The map of an uploaded image, shrunk to 1024 texels a side; material: of an albedo map. NULL
 * with code and error when it was never uploaded. */
struct cache_entry *surface_map_get(struct server *server, enum prt_screen_map_kind kind,
                                    const char *hash, const struct prt_material *material,
                                    float bump_mm, int *code, char error[300]);

/* ---- screen.c: struct screen_radiance, by image-space engines ---- */

struct screen_radiance {
    uint32_t n_point;
    struct prt_screen_report report;
    float rgb[][3]; /* [n_point] of the visibility's G-buffer */
};
struct screen_query {
    unsigned slot;     /* of the shape */
    int engine;        /* enum prt_screen_engine, < 0: the daemon chooses */
    uint32_t n_sample; /* 0: from the budget, else the engine's own */
    float budget_ms;   /* 0: none */
    uint32_t frame;    /* of a running mean */
    bool background;
    struct cache_entry *media; /* of media.c; NULL: the shape's */
};
/* map: by enum prt_screen_map_kind, NULL: none. A caller that stops waiting calls
 * screen_radiance_unwant(). */
struct cache_entry *
screen_radiance_get(struct server *server, const char *key, const struct screen_query *query,
                    struct cache_entry *shape, struct cache_entry *visibility,
                    struct cache_entry *light, struct cache_entry *const map[3]);

/* ---- walk_ratio.c: struct walk_ratio ---- */

struct walk_ratio {
    struct prt_walk_ratio *ratio;
    struct prt_walk_ratio_report report;
};
/* The ratio by which pictures of a shape are scaled with these media (NULL: the shape's own),
 * ready, with a reference for the caller. Where it is not there yet it is computed in the
 * background, one of a shape at a time, and the last one of the shape, of other media, holds
 * until then (*other); NULL: there is none. Vertices that moved keep the ratio of the file's.
 */
struct cache_entry *walk_ratio_get(struct model *model, const struct render_spec *spec,
                                   struct cache_entry *shape, struct cache_entry *media,
                                   bool *other);

/* One evaluation stops waiting for this pending entry; the last one cancels its job. */
void screen_radiance_unwant(struct cache_entry *shape, struct cache_entry *entry);

/* The running mean of a view's pictures while its state does not change. Held by the view and
 * by the evaluation that adds to it; changed by the evaluation's worker alone. */
struct refinement {
    unsigned refs;            /* loop thread */
    uint32_t n_frame, n_mean; /* drawn; of them in the mean: those by the engine */
    uint32_t n_point, n_sample;
    int engine;
    double expected_error; /* of one picture by it */
    bool converged;
    float (*mean)[3];
    struct principal *principal; /* held: charged for the mean; NULL: nobody is */
    uint64_t charged;
};
struct refinement *refinement_create(void);
void refinement_release(struct refinement *refinement);
/* Charges the principal for the mean, once there is one; false where a limit would be passed.
 */
bool refinement_charge(struct refinement *refinement, struct principal *principal);
double refinement_error(const struct refinement *refinement);
int refinement_add(struct refinement *refinement, const struct screen_radiance *radiance);

/* ---- encode.c ---- */

/* Colours whose parts are sent apart: at most so many; 0: one colour a vertex. */
unsigned most_parts(const struct render_spec *spec);
/* Whether colours or coefficients of a bake that has planes of exit come with them. */
bool sends_exits(const struct render_spec *spec);
static inline bool is_coefficients(const struct render_spec *spec)
{
    return !spec->picture && (spec->format == RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS ||
                              spec->format == RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED);
}
/* 0, or an error where the transport is not factored, so that it has no coefficients. */
int check_factored(const struct model *model, const struct prt_transport *transport,
                   char error[300]);
size_t color_bytes(int format); /* of one colour; 0: of no colour */
/* Of one plane of colours or coefficients in the spec's format, without padding. */
size_t plane_bytes(const struct render_spec *spec, const struct vertex_values *values);
/* The colours of the first n vertices of a coarse order: [values->n_plane][n]. */
int encode_coarse(const struct prt_context *ctx, const struct render_spec *spec,
                  const struct vertex_values *values, const uint32_t *vertex, uint32_t n,
                  uint8_t *to);
void encode_colors(const struct prt_context *ctx, const struct render_spec *spec,
                   const struct vertex_values *values, uint8_t *to);
/* n colours [n][3], on the calling thread. */
void encode_some_colors(const struct prt_context *ctx, int format, float exposure_ev,
                        const float *from, size_t n, uint8_t *to);
/* Whether the daemon encodes this Relight__ImageFormat. */
bool image_format_known(unsigned format);
bool image_format_alpha(unsigned format); /* keeps alpha */
int encode_image(const struct prt_context *ctx, const struct render_spec *s,
                 const struct prt_image *image, struct prt_blob *out);
/* Whether the spec's format is made of pixels of 8 bits, which shading writes at once, and its
 * file from them. encode_rgb8() takes rgb8 over: prt_free()s it, or puts it into *out. */
bool draws_rgb8(const struct render_spec *s);
int encode_rgb8(const struct prt_context *ctx, const struct render_spec *s, uint8_t *rgb8,
                struct prt_blob *out);

#endif
