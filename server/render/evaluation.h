/* SPDX-License-Identifier: MIT */
/* evaluation.h owns the pieces an evaluation is put together from: what is made once and shared
 * (cache entries, each held for the caller) and how results are encoded. */
#ifndef RELIGHTD_EVALUATION_H
#define RELIGHTD_EVALUATION_H

#include "render/render.h"
#include "render/shared/geometry.h"

/* ---- lights.c: struct prt_cube ---- */

/* The sum of lights [first, first + n) at cube_n, as they are turned or unturned. env[i] is the
 * decoded environment of light i, NULL for inline cubes. */
struct cache_entry *light_get(struct server *server, const struct render_spec *spec,
                              struct cache_entry *const env[], unsigned first, unsigned n,
                              uint32_t cube_n, bool turned);
/* The first light, unturned and fine enough to look at. */
struct cache_entry *sky_get(struct server *server, const struct render_spec *spec,
                            struct cache_entry *const env[]);

/* ---- visibility.c: struct prt_visibility ---- */

/* The camera asked for, or one that frames the model. */
void camera_choose(struct model *model, uint64_t generation, const struct render_spec *s,
                   const struct prt_mesh *mesh, struct prt_camera *out);
/* Pictures that take seconds may not hold every worker. */
enum work_class picture_class(const struct render_spec *s);
/* owner is held while `mesh`, which is of this generation, is looked at. */
struct cache_entry *visibility_get(struct model *model, uint64_t generation,
                                   struct cache_entry *owner, const struct prt_mesh *mesh,
                                   const struct render_spec *s, const struct prt_camera *c);

/* ---- light_contraction.c: struct contracted ---- */

struct contracted {
    struct prt_contracted_light *lit;
    struct cache_entry *file; /* whose transport it refers to */
};
/* A joint transport under a light, contracted once it has been asked for twice, for whatever
 * material comes. NULL: a plain pass is as good. Not `make`: only what is there already. */
struct cache_entry *contracted_get(struct model *model, uint64_t generation,
                                   struct cache_entry *file, struct cache_entry *light,
                                   bool make);

/* ---- material_contraction.c: struct fixed ---- */

struct fixed {
    struct prt_contracted_transport *fixed;
    struct cache_entry *file; /* whose transport it refers to */
};
/* A joint transport with a material put in, for whatever light comes, once it is there: after
 * so many lights have been asked for with the material (NULL: the bake's). NULL: a plain pass.
 */
struct cache_entry *fixed_get(struct model *model, uint64_t generation,
                              struct cache_entry *file, const struct cache_entry *light,
                              const struct prt_material *material, const char *material_key);

/* ---- relight_pass.c: struct answer, through passes that are shared ---- */

/* What a pass makes for one light and query. */
struct answer {
    unsigned n_plane;
    uint32_t n_vertex, shared; /* shared: evaluations of its pass */
    float
        material_error; /* what the transport's radial bases leave of a material given to it */
    float values[];     /* [n_plane][n_vertex][3] */
};
struct answer_query {
    int term;    /* enum prt_answer_term */
    bool planes; /* per-phase planes for pictures, else final colours */
    bool has_material, has_eye;
    struct prt_material material;
    float eye[3]; /* mm */
};
/* The entry of `key`; when it is not there yet, it joins the model's next pass. file, light,
 * contracted and fixed are held by the pass (the last three may be NULL). */
struct cache_entry *answer_get(struct model *model, const char *key,
                               const struct answer_query *query, struct cache_entry *file,
                               struct cache_entry *light, struct cache_entry *contracted,
                               struct cache_entry *fixed);

/* ---- irradiance.c: struct answer of one plane, E at the vertices ---- */

/* Traced under the light's cube, which takes seconds. file and light are held meanwhile. */
struct cache_entry *irradiance_get(struct server *server, const char *key,
                                   const struct answer_query *query, struct cache_entry *file,
                                   struct cache_entry *light);

/* ---- surface_maps.c: struct prt_screen_map ---- */

/* The map of an uploaded image, shrunk to 1024 texels a side; material: of an albedo map. NULL
 * with code and error when it was never uploaded. */
struct cache_entry *surface_map_get(struct server *server, enum prt_screen_map_kind kind,
                                    const char *hash, const struct prt_material *material,
                                    float bump_mm, int *code, char error[300]);

/* ---- screen.c: struct screen_answer, by image-space engines ---- */

struct screen_answer {
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
    bool background, has_material;
    struct prt_material material;
};
/* map: by enum prt_screen_map_kind, NULL: none. All entries are held while it is made. Who
 * gives up waiting says screen_unwant. */
struct cache_entry *screen_get(struct server *server, const char *key,
                               const struct screen_query *query, struct cache_entry *shape,
                               struct cache_entry *seen, struct cache_entry *light,
                               struct cache_entry *const map[3]);

/* One of those who asked for this pending entry does so no more. */
void screen_unwant(struct cache_entry *shape, struct cache_entry *entry);

/* The running mean of a view's pictures while nothing changes. Held by the view and by the
 * evaluation that adds to it; changed by the evaluation's worker alone. */
struct refinement {
    unsigned refs;            /* loop thread */
    uint32_t n_frame, n_mean; /* drawn; of them in the mean: those by the engine */
    uint32_t n_point, n_sample;
    int engine;
    double expected_error; /* of one picture by it */
    bool converged;
    float (*mean)[3];
};
struct refinement *refinement_create(void);
void refinement_release(struct refinement *refinement);
double refinement_error(const struct refinement *refinement);
int refinement_add(struct refinement *refinement, const struct screen_answer *answer);

/* ---- encode.c ---- */

size_t color_bytes(int format); /* of one colour */
void encode_colors(const struct prt_context *ctx, const struct render_spec *spec,
                   const struct answer *answer, uint8_t *to);
int encode_image(const struct prt_context *ctx, const struct render_spec *s,
                 const struct prt_image *image, struct prt_blob *out);

#endif
