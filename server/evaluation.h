/* SPDX-License-Identifier: MIT */
/* evaluation.h owns the pieces an evaluation is put together from: what is made once and shared
 * (memo entries, each held for the caller) and how results are encoded. */
#ifndef RELIGHTD_EVALUATION_H
#define RELIGHTD_EVALUATION_H

#include "render.h"

/* ---- lights.c: struct prt_cube ---- */

/* The sum of lights [first, first + n) at cube_n, as they are turned or unturned. env[i] is the
 * decoded environment of light i, NULL for inline cubes. */
struct memo_entry *light_get(struct server *server, const struct render_spec *spec,
                             struct memo_entry *const env[], unsigned first, unsigned n,
                             uint32_t cube_n, bool turned);
/* The first light, unturned and fine enough to look at. */
struct memo_entry *sky_get(struct server *server, const struct render_spec *spec,
                           struct memo_entry *const env[]);

/* ---- sight.c: struct prt_visibility ---- */

/* The camera asked for, or one that frames the model. */
void camera_choose(const struct render_spec *s, const struct prt_mesh *mesh,
                   struct prt_camera *out);
/* Pictures that take seconds may not hold every worker. */
enum work_class picture_class(const struct render_spec *s);
struct memo_entry *visibility_get(struct model *model, struct memo_entry *file,
                                  const struct render_spec *s, const struct prt_camera *c);

/* ---- answers.c: struct answer, through passes that are shared ---- */

/* What a pass makes for one light and query. */
struct answer {
    unsigned n_plane;
    uint32_t n_vertex, shared; /* shared: evaluations of its pass */
    float material_error;  /* what the transport's radial bases leave of a material given to it */
    float values[];        /* [n_plane][n_vertex][3] */
};
struct answer_query {
    int term;              /* enum prt_answer_term */
    bool planes;           /* per-phase planes for pictures, else final colours */
    bool has_material, has_eye;
    struct prt_material material;
    float eye[3];          /* mm */
};
/* The entry of `key`; when it is not there yet, it joins the model's next pass. file and light are
 * held by the pass (light may be NULL). */
struct memo_entry *answer_get(struct model *model, const char *key,
                              const struct answer_query *query, struct memo_entry *file,
                              struct memo_entry *light);

/* ---- encode.c ---- */

size_t color_bytes(int format); /* of one colour */
void encode_colors(const struct prt_context *ctx, const struct render_spec *spec,
                   const struct answer *answer, uint8_t *to);
int encode_image(const struct prt_context *ctx, const struct render_spec *s,
                 const struct prt_image *image, struct prt_blob *out);

#endif
