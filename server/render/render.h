/* SPDX-License-Identifier: MIT */
/* render.h owns evaluations: lights and a model become vertex colours or a picture. A request
 * or a view starts one; it gathers what it needs (open model, decoded environments, cubes,
 * visibility buffer), shares all of it with others through the cache, and calls back once. */
#ifndef RELIGHTD_RENDER_H
#define RELIGHTD_RENDER_H

#include "net/connection.h"
#include "render/shared/materials.h"
#include "store/models.h"
#include "prt/light.h"
#include "prt/raster.h"
#include "prt/relight.h"
#include "relight.pb-c.h"

enum { RENDER_MAX_LIGHTS = 16 };

struct render_light {
    char env[96]; /* "env:HASH", "constant:R,G,B"; "" for texels */
    double rotate_deg;
    float gain[3];
    uint32_t cube_n;     /* texels of this size lie at `texel` in spec.texels */
    size_t texel;        /* floats */
    char key[200];       /* names the light by its content */
    char still_key[200]; /* the same without its turn */
};

/* Everything an evaluation depends on, checked. Plain data but for the texels, which all copies
 * of a spec share. */
struct render_spec {
    unsigned n_light;
    struct render_light light[RENDER_MAX_LIGHTS];
    struct held_bytes *texels; /* net/request.h: floats of inline cubes; NULL: none */
    bool sum;
    int engine, term; /* Relight__Engine, Relight__Term */
    bool has_material, has_eye;
    struct prt_material material;
    char material_key[MATERIAL_KEY];
    float eye[3]; /* model's own units */
    float max_error;
    uint32_t budget_ms;
    char map[3][65]; /* uploads by enum prt_screen_map_kind; "": none */
    float bump_mm;
    bool picture;
    /* colours */
    int format; /* Relight__ColorFormat */
    float exposure_ev;
    /* picture */
    uint32_t width, height, samples;
    bool has_camera;
    float camera_eye[3], camera_target[3], camera_up[3], fovy_deg;
    int image_format, tone; /* Relight__ImageFormat, Relight__Tone */
    unsigned quality;
    float picture_ev;
    bool plain_background, no_specular;
    float background[3];
    /* a view's picture that gets finer: NULL for none; held by who made the spec */
    struct refinement *refinement;
    bool quiet; /* only adds to the mean: no picture is made */
};

/* Fills and checks pieces of a spec from messages; a missing message leaves defaults. Return 0,
 * or an error code with its text naming parameter, range and unit. */
void render_spec_init(struct render_spec *spec);
void render_spec_finish(struct render_spec *spec);
/* Holds the texels; render_spec_finish for both. */
void render_spec_copy(const struct render_spec *from, struct render_spec *to);
/* Takes the request's payload, the lights' texels, when it returns 0. */
int render_spec_lights(struct render_spec *spec, size_t n, Relight__Light *const *lights,
                       struct request *request, char error[300]);
int render_spec_shade(struct render_spec *spec, struct server *server,
                      const Relight__Shade *shade, char error[300]);
int render_spec_picture(struct render_spec *spec, const struct server *server,
                        const Relight__Picture *picture, char error[300]);
int render_spec_colors(struct render_spec *spec, int format, float exposure_ev,
                       char error[300]);
/* Fills the keys; texels of all lights, for inline cubes. */
void render_light_name(struct render_light *light, const float *texels);
/* A cube's texels lie in the spec's. */
const float *render_texels(const struct render_spec *spec, const struct render_light *light);
/* "constant" and "env:HASH" in their canonical form, 0 or an error. */
int env_canonical(const char *env, char out[96], char error[300]);

struct render_result {
    int code; /* 0, or a Relight__ErrorCode with `error` */
    char error[400];
    struct payload payload;
    uint32_t n_vertex, n_plane, width, height;
    uint64_t plane_bytes, generation;
    struct prt_camera camera;
    float queue_ms, light_ms, relight_ms, raster_ms, shade_ms, encode_ms, total_ms;
    float error_bound;
    uint32_t shared, samples, frames;
    bool preview, converged; /* preview: an image-space engine answered */
    int engine;
    char note[120];
};

struct render;
/* The result's payload is the callee's. Called on the loop's thread, possibly before
 * render_start returns, which then returns NULL. */
typedef void (*render_fn)(void *user, struct render_result *result);
/* Takes the spec's texels. */
struct render *render_start(struct model *model, struct render_spec *spec, render_fn done,
                            void *user);
/* done will not be called any more. */
void render_cancel(struct render *render);

/* Fills answer messages from a result; `camera` and its vectors must outlive the message. */
struct render_camera_message {
    Relight__Camera camera;
    Relight__Vec3 eye, target, up;
};
void render_cost_message(const struct render_result *result, Relight__Cost *cost);
void render_colors_message(const struct render_result *result, const struct render_spec *spec,
                           Relight__ColorsAnswer *out);
void render_image_message(const struct render_result *result, const struct render_spec *spec,
                          Relight__ImageAnswer *out, struct render_camera_message *camera);

/* The decoded environment "env:HASH" (or a constant one); value is struct decoded_env. NULL
 * with code and error when it was never uploaded. */
/* Decodes an uploaded image ahead of its first use, when it looks like an environment, and
 * makes the cube that backgrounds are taken from. */
void env_prefetch(struct server *server, const char *hash);
struct cache_entry *env_get(struct server *server, const char *env, int *code, char error[300]);
/* Has an upload checked, then decoded by `ask` (decoder_env, decoder_image), which calls fn
 * with the entry; without the upload the entry is failed and released. Errors call the upload
 * by its hash's first digits: the entry is shared between principals. */
typedef void (*upload_decoder_fn)(struct decoder *decoder, const char *path, const char *name,
                                  decode_fn fn, void *user);
void upload_decode(struct server *server, const char *hash, struct cache_entry *entry,
                   upload_decoder_fn ask, decode_fn fn);

#endif
