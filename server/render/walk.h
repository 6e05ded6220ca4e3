/* SPDX-License-Identifier: MIT */
/* walk.h owns one evaluation while it runs: the entries it depends on, and the functions that
 * walk.c, checks.c, error_bounds.c and finish.c call in each other. */
#ifndef RELIGHTD_WALK_H
#define RELIGHTD_WALK_H

#include "render/evaluation.h"

struct render;

/* One cache entry that an evaluation depends on. */
struct dependency {
    struct cache_waiter waiter; /* first: dependency_ended() is given it */
    struct render *render;
    struct cache_entry *entry; /* held; NULL: not needed */
    bool waits;                /* dependency_ended() will be called */
    bool was_ready;            /* it was in the cache: this evaluation did not cause its cost */
};

/* The steps of an evaluation, in their order. */
enum render_step {
    STEP_MODEL,
    STEP_MEDIA,
    STEP_ENVIRONMENTS,
    STEP_LIGHTS,
    STEP_CONTRACTIONS,
    STEP_RADIANCE,
    STEP_ENCODING,
    STEP_FINISH,
};

struct render {
    struct work work; /* first: the last step's work */
    struct server *server;
    struct model *model;
    struct model *bakes; /* held: `model` is the draft of its bake; NULL: it is none */
    struct render_spec spec;
    render_fn done; /* NULL: cancelled */
    void *user;
    struct work_actor actor; /* whose evaluation it is, and its priority */
    enum render_step step;   /* the next one */
    unsigned n_waiting;      /* dependencies that are pending */
    bool walking;
    bool turning;        /* counted in the model's n_turning */
    bool finishing;      /* its last step's work was submitted */
    bool *ended;         /* set when the evaluation ends while render_start still runs */
    bool screen;         /* an image-space engine answers, for the current vertices */
    uint64_t generation; /* of the geometry that is shown */
    bool encodes;   /* the pass encodes its colours: vertex_values have the spec's format */
    bool transient; /* one frame of many: its radiance is dropped from the cache at the end */
    /* geometry: the open .prt file, or with `screen` the shape */
    struct dependency file, shape;
    struct dependency variant; /* of the open file; NULL: none, or `screen` */
    struct dependency media;   /* that the request gives; NULL: the model's own */
    struct dependency env[RENDER_MAX_LIGHTS], light[RENDER_MAX_LIGHTS];
    /* joint transport contracted with light i */
    struct dependency contracted_light[RENDER_MAX_LIGHTS];
    /* the transport contracted with the material: held and ready; NULL: the file's is used */
    struct cache_entry *contracted_material[RENDER_MAX_LIGHTS];
    struct dependency vertex_values[RENDER_MAX_LIGHTS]; /* without `screen` */
    char *values_key[RENDER_MAX_LIGHTS];                /* of their entries; owned */
    struct render *fading; /* computes the draft's values to fade from; NULL: it has ended */
    struct cache_entry *faded;         /* those; NULL: there are none */
    float faded_error;                 /* their error bound */
    struct dependency encoded;         /* one plane of colours that are not float */
    struct dependency screen_radiance; /* with `screen` */
    struct cache_entry *ratio;         /* held and ready: it is scaled by this one; or NULL */
    bool ratio_of_other;               /* it is of the media before, until theirs is there */
    struct dependency coarse;          /* order of the vertices; NULL: colours of all */
    struct dependency visibility, specular, background, floor, map[3];
    uint64_t start_ns;
    struct drain_item drain; /* core/drain.h */
    struct render_result result;
};

/* ---- walk.c ---- */

const struct prt_transport *render_transport(const struct render *r); /* without `screen` */
/* Where the vertices are that this evaluation draws; NULL: where the file has them. */
const struct pose *render_pose(const struct render *r);
struct shape *render_shape(const struct render *r); /* with `screen` */
/* The media by object: the request's, or the model's own. */
const struct prt_media *render_media(const struct render *r);
const struct prt_mesh *render_mesh(const struct render *r);
/* How many vertex_values the evaluation has: one for a picture or a sum, else one a light. */
unsigned render_n_values(const struct render_spec *spec);
/* Milliseconds that making the entry took; 0 where it was in the cache. */
float dependency_ms(const struct dependency *dependency);
/* Releases every entry. */
void render_release(struct render *r);

/* ---- checks.c: each returns 0, or an error code with its text ---- */

/* True where an image-space engine draws: pictures of a model without a bake, with moved
 * vertices or with maps, and pictures for which such an engine is named. */
bool render_uses_screen(const struct render *r);
/* True where the bake fixed the light (polynomial transport). */
bool render_light_is_baked(const struct render *r);
/* Whether the image-space engines, or the open bake, can answer the request. */
int check_request(const struct render *r, char error[300]);
/* Whether they can with these media. */
int check_media(const struct render *r, char error[300]);
/* Whether result.error_bound is within the request's max_error. */
int check_error_bound(const struct render *r, char error[300]);

/* ---- error_bounds.c: relative RMS errors ---- */

/* The bake's measured error for the requested term. */
float bake_error(const struct render *r);
/* The largest error of any vertex_values from projecting the material on the bake's bases; it
 * adds to bake_error(). */
float material_error(const struct render *r);

/* ---- backlog.c ---- */

/* The evaluation is open, and is not any more: render_retry_ms() (render.h) counts them. */
void render_count(struct render *r);
void render_uncount(struct render *r);

/* ---- finish.c ---- */

/* The last step: fills the result and encodes it, on a worker where that takes time. */
void render_finish(struct render *r);
/* Ends the evaluation now: releases r, then calls done. */
void render_end(struct render *r);
void render_end_with_error(struct render *r, int code, const char *text);

#endif
