/* SPDX-License-Identifier: MIT */
/* render.h owns evaluations: lights and a model become vertex colours or a picture. A request
 * or a view starts one; it computes the entries it depends on (open model, decoded
 * environments, cubes, visibility buffer), which all evaluations share through the cache, and
 * calls back once.
 */
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
    uint32_t cube_n;     /* side of the inline cube; 0: env is used */
    size_t texel;        /* index of its first float in spec.texels */
    char key[200];       /* of its content: equal lights have equal keys */
    char still_key[200]; /* the same without the rotation */
};

/* Media by object as a request names them, each object once. It does not change; the copies of
 * a spec share it. */
struct media_map {
    unsigned refs; /* loop thread */
    unsigned n;
    char key[MATERIAL_KEY]; /* hash of names and media */
    struct {
        char object[128]; /* a longer name is cut, and no object has it */
        struct prt_material material;
    } entry[];
};

/* Everything an evaluation depends on, checked. Plain data, except the texels, the pose and the
 * map of media, which all copies of a spec share. */
struct render_spec {
    unsigned n_light;
    struct render_light light[RENDER_MAX_LIGHTS];
    struct held_bytes *texels; /* net/request.h: floats of inline cubes; NULL: none */
    struct pose *pose;         /* a named one, which copies share, too; NULL: the model's own */
    bool sum;
    int engine, term; /* Relight__Engine, Relight__Term */
    bool has_material, has_eye;
    struct prt_material material; /* of the objects that `objects` does not name */
    char material_key[MATERIAL_KEY];
    struct media_map *objects;  /* NULL: no object is named */
    char variant[VARIANT_NAME]; /* as Shade.variant */
    bool variant_shines; /* set by its evaluation: the variant changes colours at vertices */
    float eye[3];        /* model's own units */
    float max_error;
    uint32_t budget_ms;
    char map[3][65]; /* uploads by enum prt_screen_map_kind; "": none */
    float bump_mm;
    bool picture;
    /* colours */
    int format; /* Relight__ColorFormat */
    float exposure_ev;
    uint32_t most_rank;  /* of coefficients; 0: all rows */
    uint32_t color_rank; /* of a view's colours that cannot keep their rate; 0: all rows */
    bool phases;         /* the planes that depend on the view are sent, too */
    bool exits;          /* and the planes of exit */
    unsigned coarse;     /* of colours of a view: of 1/2^coarse of the vertices */
    /* picture */
    uint32_t width, height, samples;
    bool has_camera; /* eye and target, unless one of the next two is set */
    char camera_name[64];
    bool has_orbit;
    struct prt_orbit orbit;
    float camera_eye[3], camera_target[3], camera_up[3], fovy_deg;
    int image_format, tone; /* Relight__ImageFormat, Relight__Tone */
    unsigned quality;
    float picture_ev;
    bool plain_background, no_specular, transparent, floor;
    float background[3];
    struct refinement *refinement; /* the view's running mean to add to; NULL: none. Held by the
                                      creator of the spec */
    bool quiet;                    /* adds to the mean and makes no picture */
    bool hash;                     /* render_result.hash is wanted */
    struct model *fade_from; /* the draft whose values are mixed with the bake's; held by the
                                creator. NULL: none */
    float fade;              /* (0, 1): weight of the bake */
    bool values;             /* nothing but the values at the vertices: render_result.values */
};

/* Fill parts of a spec from messages and check them; without a message the defaults stay.
 * Return 0, or an error code with a text that names parameter, range and unit. */
void render_spec_init(struct render_spec *spec);
void render_spec_finish(struct render_spec *spec);
/* Shares texels, pose and media; both specs need render_spec_finish(). */
void render_spec_copy(const struct render_spec *from, struct render_spec *to);
/* The same data for an answer's message, without what is shared. */
struct render_spec render_spec_plain(const struct render_spec *spec);
/* Takes over the request's payload (the lights' texels) where it returns 0. */
int render_spec_lights(struct render_spec *spec, size_t n, Relight__Light *const *lights,
                       struct request *request, char error[300]);
int render_spec_shade(struct render_spec *spec, struct request *request,
                      const Relight__Shade *shade, char error[300]);
int render_spec_picture(struct render_spec *spec, const struct server *server,
                        const Relight__Picture *picture, char error[300]);
/* Whether the format of a picture without a background has alpha: a view may take the two from
 * different messages. */
int render_spec_alpha(const struct render_spec *spec, char error[300]);
int render_spec_colors(struct render_spec *spec, int format, float exposure_ev,
                       uint32_t most_rank, bool phases, bool exits, char error[300]);
/* Fills the keys; texels of all lights, for inline cubes. */
void render_light_name(struct render_light *light, const float *texels, const char *hash);
/* Index of the first that is no radiance in [0, 1e9]; n: all are. Thread-safe. */
size_t render_first_bad_texel(const float *texels, size_t n);
/* Turns or scales the lights that the spec has; lights[i] gives the values of light i. */
int render_spec_turn(struct render_spec *spec, size_t n, Relight__Light *const *lights,
                     bool rotate, bool gain, char error[300]);
/* Copies the named fields ("shade", "picture.camera", …) from `values` to `spec`; names of
 * lights and options are ignored. Returns 0, or BAD_REQUEST where a name is unknown. */
int render_spec_copy_fields(struct render_spec *spec, const struct render_spec *values,
                            size_t n, char *const *fields, char error[300]);
/* Whether fields name `field`, or the part that it belongs to. */
bool render_fields_name(size_t n, char *const *fields, const char *field);
/* The texels of an inline cube. */
const float *render_texels(const struct render_spec *spec, const struct render_light *light);
/* Sets the pose of this name, "" for the model's own. */
int render_spec_pose(struct render_spec *spec, const struct model *model, const char *name,
                     char error[300]);
/* "constant" and "env:HASH" in their canonical form, 0 or an error. */
int env_canonical(const char *env, char out[96], char error[300]);
/* The same for the client of a request: "name:WORD" is the image that it uploaded under that
 * file name, which may lack its ending. */
int env_of_request(const struct request *request, const char *env, char out[96],
                   char error[300]);

struct render_result {
    int code; /* 0, or a Relight__ErrorCode with `error` */
    char error[400];
    struct payload payload;
    uint32_t n_vertex, n_plane, width, height;
    uint64_t plane_bytes, generation;
    uint32_t n_part;       /* colours whose parts are apart: of each plane; else 0 */
    uint32_t n_exit;       /* of them planes of exit, the last */
    uint32_t n_coarse;     /* colours of so many vertices of a coarse order; 0: of all */
    uint64_t coarse_order; /* its hash */
    uint64_t factors;      /* coefficients: hash of the file with their U */
    uint32_t n_layer;
    struct prt_coefficient_layer layer[PRT_MOST_PARTS]; /* without their scales */
    float scale[PRT_MOST_PARTS][RENDER_MAX_LIGHTS];     /* of each plane */
    /* Coefficients and n_part: one for all blocks, or one of each block; one allocation, freed
       by the callee of render_fn. NULL: none. */
    Relight__Outgoing **outgoing;
    uint32_t n_outgoing;
    uint64_t hash;              /* of the payload, where the spec asks for it */
    struct cache_entry *values; /* struct vertex_values, for the callee to release; or NULL */
    struct prt_camera camera;
    struct model_hashes drawn; // of the file that a picture was made from
    float queue_ms, light_ms, relight_ms, raster_ms, shade_ms, encode_ms, total_ms;
    float error_bound;
    uint32_t shared, samples, frames;
    bool preview, converged; /* preview: an image-space engine answered */
    bool draft;              /* a draft answered */
    float bake_fraction;     /* with draft: how far the bake is */
    int engine;
    char note[120];
};

struct render;
/* The callee owns the result's payload. Called on the loop's thread, possibly before
 * render_start returns, which then returns NULL. */
typedef void (*render_fn)(void *user, struct render_result *result);
/* Takes over what the spec shares. */
struct render *render_start(struct model *model, struct render_spec *spec, render_fn done,
                            void *user);
/* 0: an evaluation that the loop's actor begins now will be answered within left_ns; else the
 * milliseconds after which one would be. */
uint32_t render_retry_ms(const struct model *model, const struct render_spec *spec,
                         double left_ns);
/* done is not called after this. */
void render_cancel(struct render *render);

/* Fills answer messages from a result; `camera` and `coefficients` must outlive the message. */
struct render_camera_message {
    Relight__Camera camera;
    Relight__Vec3 eye, target, up;
    Relight__Drawn drawn;
};
void render_cost_message(const struct render_result *result, Relight__Cost *cost);
/* The parts of an answer with coefficients. */
struct render_coefficients_message {
    Relight__Coefficients coefficients;
    Relight__CoefficientLayer layer[PRT_MOST_PARTS], *layers[PRT_MOST_PARTS];
};
void render_colors_message(const struct render_result *result, const struct render_spec *spec,
                           Relight__ColorsAnswer *out,
                           struct render_coefficients_message *coefficients);
void render_image_message(const struct render_result *result, const struct render_spec *spec,
                          Relight__ImageAnswer *out, struct render_camera_message *camera);

/* Decodes an uploaded image ahead of its first use as an environment, and computes the cube
 * that backgrounds are drawn from. */
void env_prefetch(struct server *server, const char *hash);
/* The decoded environment "env:HASH" (or a constant one); value is struct decoded_env. NULL
 * with code and error when it was never uploaded. */
struct cache_entry *env_get(struct server *server, const char *env, int *code, char error[300]);
enum { ENV_TURNED_CUBE = 64 }; /* larger cubes that come as texels are resampled at each turn */
/* The texels of a light that has its own, as an environment (struct decoded_env) that keeps
 * what turning it needs. NULL at their first angle: texels that are turned once are not kept.
 */
struct cache_entry *env_of_texels(struct server *server, const struct render_spec *spec,
                                  const struct render_light *light);
/* Verifies the upload's hash, then calls `decode` (decoder_env, decoder_image), which calls fn
 * with the entry; where the upload is gone or damaged, fails and releases the entry. Errors
 * name the upload by the first digits of its hash: principals share the entry, not their file
 * names.
 */
typedef void (*upload_decoder_fn)(struct decoder *decoder, const char *path, const char *name,
                                  decode_fn fn, void *user);
void upload_decode(struct server *server, const char *hash, struct cache_entry *entry,
                   upload_decoder_fn decode, decode_fn fn);

#endif
