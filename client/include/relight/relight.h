/* SPDX-License-Identifier: MIT */
/* relight/relight.h owns the client's side of the relighting protocol: connect to a relightd,
 * upload models and environments, and get colours, pictures and frames back.
 *
 * Thread-safety: a relight_client is Safe: any number of threads may call any functions on it
 * at once, each waiting for its own answers; there is no hidden thread. Exceptions are named
 * below. Functions block unless their text says otherwise. SIGPIPE is never raised.
 *
 * Returns: 0, or a negative enum relight_code with `*error` (may be NULL) filled; outputs are
 * untouched then. Strings and arrays inside an output belong to it until its _finish call.
 * Units: millimetres where said so, else the model's own; colours are linear RGB radiance. */
#ifndef RELIGHT_RELIGHT_H
#define RELIGHT_RELIGHT_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif
#if defined(__GNUC__)
#pragma GCC visibility push(default)
#endif

/* ---- errors --------------------------------------------------------------------------------
 */

/* name, code, text. Below 100: sent by the daemon (relight.proto ErrorCode). */
#define RELIGHT_CODE_LIST(X)                                      \
    X(OK, 0, "done")                                              \
    X(BAD_FRAME, 1, "broken frame")                               \
    X(BAD_REQUEST, 2, "request not understood")                   \
    X(VERSION, 3, "no common protocol version")                   \
    X(FORBIDDEN, 4, "not allowed")                                \
    X(NOT_FOUND, 5, "not found")                                  \
    X(BUSY, 6, "server is busy")                                  \
    X(DEADLINE, 7, "deadline passed")                             \
    X(CANCELLED, 8, "cancelled")                                  \
    X(LIMIT, 9, "a limit was exceeded")                           \
    X(FORMAT, 10, "file is damaged or not of a supported format") \
    X(MISMATCH, 11, "inputs do not belong together")              \
    X(NOT_READY, 12, "model is not ready")                        \
    X(HASH, 13, "uploaded bytes do not have the promised hash")   \
    X(UNSUPPORTED, 14, "not supported")                           \
    X(OUT_OF_RANGE, 15, "parameter out of range")                 \
    X(NO_MEMORY, 16, "not enough memory")                         \
    X(INTERNAL, 17, "internal error")                             \
    X(SHUTTING_DOWN, 18, "server is shutting down")               \
    X(JOB_FAILED, 19, "job failed")                               \
    X(UNREACHABLE, 100, "server unreachable")                     \
    X(DISCONNECTED, 101, "connection lost")                       \
    X(TIMEOUT, 102, "no answer in time")                          \
    X(PROTOCOL, 103, "server's answer makes no sense")            \
    X(FILE, 104, "file could not be read")                        \
    X(ARGUMENT, 105, "argument out of range")

enum relight_code {
#define X(name, code, text) RELIGHT_E_##name = (code),
    RELIGHT_CODE_LIST(X)
#undef X
};
/* One line of English for a code (either sign). Never NULL. */
const char *relight_code_text(int code);

struct relight_error {
    int code;                /* enum relight_code, positive */
    char text[384];          /* what was wrong with what */
    char hint[256];          /* what to do; may be empty */
    uint32_t retry_after_ms; /* RELIGHT_E_BUSY: when to try again */
};

/* ---- connection -----------------------------------------------------------------------------
 */

struct relight_client;

struct relight_options {
    const char *name;         /* of the program, for the daemon's log; NULL: "librelight" */
    const char *token;        /* NULL: none */
    double connect_timeout_s; /* 0: 5 s */
    double timeout_s;     /* of each blocking call, sent to the daemon as deadline; 0: none */
    uint64_t max_payload; /* largest answer accepted, bytes; 0: 4 GiB */
};

/* address: "tcp:HOST[:PORT]" (IPv6 as tcp:[::1]:7413), "unix:PATH", or NULL for
 * $RELIGHT_SERVER, else unix:$XDG_RUNTIME_DIR/relightd.sock when that exists, else
 * tcp:127.0.0.1:7413. options may be NULL. Says hello. */
int relight_connect(const char *address, const struct relight_options *options,
                    struct relight_client **out, struct relight_error *error);
/* Frees the client; no other call may be running on it. NULL is allowed. Does not block. */
void relight_close(struct relight_client *client);

struct relight_server {
    const char *name; /* program and version */
    const char *address;
    uint64_t max_payload, max_blob;
    uint32_t max_in_flight, chunk;
    size_t n_preset;
    const char *const *preset; /* names of materials */
};
/* What hello told; lives as long as the client. Does not block. */
const struct relight_server *relight_server(const struct relight_client *client);

/* Stops an outstanding request of this client (id from a _begin call): its _end returns
 * RELIGHT_E_CANCELLED, or its answer when it was too late. Does not wait. */
int relight_cancel(struct relight_client *client, uint64_t id, struct relight_error *error);

/* *seconds: round trip. */
int relight_ping(struct relight_client *client, double *seconds, struct relight_error *error);

/* ---- uploads --------------------------------------------------------------------------------
 */

enum relight_job_state {
    RELIGHT_JOB_QUEUED,
    RELIGHT_JOB_RUNNING,
    RELIGHT_JOB_DONE,
    RELIGHT_JOB_FAILED,
    RELIGHT_JOB_CANCELLED
};
struct relight_progress {
    const char *stage;       /* "upload", or a stage of the bake */
    double fraction;         /* [0,1] */
    double eta_s, elapsed_s; /* eta_s < 0: unknown */
    enum relight_job_state state;
};
/* Non-zero stops waiting: the call returns RELIGHT_E_CANCELLED (a watched job goes on). Called
 * on the thread that made the call, without locks held. */
typedef int (*relight_progress_fn)(void *user, const struct relight_progress *progress);

/* SHA-256 in hex. Does not block. */
void relight_hash(const void *bytes, size_t n, char hash[65]);

/* Uploads bytes unless the daemon has them (then one round trip). name: file name, tells
 * formats apart. *sent may be NULL: bytes that had to be sent. fn may be NULL. */
int relight_upload(struct relight_client *client, const char *name, const void *bytes, size_t n,
                   relight_progress_fn fn, void *user, char hash[65], uint64_t *sent,
                   struct relight_error *error);
int relight_upload_file(struct relight_client *client, const char *path, relight_progress_fn fn,
                        void *user, char hash[65], uint64_t *sent, struct relight_error *error);
/* An ENV word as the commands take it to one the daemon takes: "constant…" and "env:HASH" pass,
 * a file is uploaded. env[80] gets the word. */
int relight_env_resolve(struct relight_client *client, const char *word, relight_progress_fn fn,
                        void *user, char env[80], struct relight_error *error);

struct relight_env_info {
    bool cube; /* source is a cubemap, else lat-long */
    uint32_t width, height, full_cube, n_mended;
    float mean[3]; /* mean radiance over the sphere */
    double decode_ms;
};
/* Has the daemon decode an environment ahead of its use. */
int relight_env_prepare(struct relight_client *client, const char *env,
                        struct relight_env_info *out, struct relight_error *error);

/* ---- models
 * ----------------------------------------------------------------------------------- */

enum relight_transport {
    RELIGHT_TRANSPORT_DEFAULT,
    RELIGHT_TRANSPORT_WAVELET,
    RELIGHT_TRANSPORT_POLYNOMIAL,
    RELIGHT_TRANSPORT_JOINT
};
enum relight_storage {
    RELIGHT_STORAGE_DEFAULT,
    RELIGHT_STORAGE_FACTORED,
    RELIGHT_STORAGE_SPARSE
};

/* Zero everywhere: the daemon's defaults, as `prt bake`. */
struct relight_bake {
    enum relight_transport transport;
    enum relight_storage storage;
    uint32_t samples, cube, coeffs, rank, phase_terms, single_points;
    bool no_single;
    float max_error;
    uint64_t seed;
    const char *env; /* polynomial: the fixed light, as relight_light.env */
    float rotate_deg;
};
struct relight_file {
    const char *name; /* as the model refers to it */
    const char *hash;
};
struct relight_load {
    /* One of the two: uploaded files, the model first; or a path in the daemon's folder. */
    size_t n_file;
    const struct relight_file *files;
    const char *path;
    const char *name;           /* NULL: the file's */
    float size_mm, mm_per_unit; /* at most one is not 0 */
    const char *material;       /* preset name or JSON text */
    struct relight_bake bake;
    size_t n_opaque;
    const char *const *opaque;
    bool pin;
    bool preview; /* no bake: image-space engines answer */
};
enum relight_model_state {
    RELIGHT_MODEL_UNKNOWN,
    RELIGHT_MODEL_RECEIVED,
    RELIGHT_MODEL_PREVIEW,
    RELIGHT_MODEL_BAKING,
    RELIGHT_MODEL_READY,
    RELIGHT_MODEL_UNLOADED,
    RELIGHT_MODEL_FAILED
};
const char *relight_model_state_name(enum relight_model_state state);

struct relight_loaded {
    const char *model; /* id */
    enum relight_model_state state;
    const char *job; /* "": nothing to wait for */
    size_t n_warning;
    const char *const *warning;
    void *owner;
};
int relight_load(struct relight_client *client, const struct relight_load *load,
                 struct relight_loaded *out, struct relight_error *error);
void relight_loaded_finish(struct relight_loaded *loaded);
/* Uploads a model file and, for .gltf, the buffers it names beside it; then as relight_load
 * with load->files replaced. */
int relight_load_file(struct relight_client *client, const char *path,
                      const struct relight_load *load, relight_progress_fn fn, void *user,
                      struct relight_loaded *out, struct relight_error *error);

/* Follows a job (or a model's newest job) to its end, however long that takes. 0 when it is
 * done, RELIGHT_E_JOB_FAILED or RELIGHT_E_CANCELLED otherwise. */
int relight_watch(struct relight_client *client, const char *job, relight_progress_fn fn,
                  void *user, struct relight_error *error);
int relight_cancel_job(struct relight_client *client, const char *job,
                       enum relight_job_state *state, struct relight_error *error);

struct relight_block {
    uint32_t object;
    const char *surface;
    bool translucent;
    uint32_t vertex_begin, n_vertex, triangle_begin, n_triangle;
    float base_color[3];
};
struct relight_model {
    const char *id, *name, *job;
    enum relight_model_state state;
    double fraction; /* of the bake that runs */
    uint32_t n_vertex, n_triangle, n_object;
    double mm_per_unit;
    float box_min[3], box_max[3]; /* mm */
    const char *engine, *storage; /* words: "wavelet", "factored", "" */
    uint32_t cube;
    uint64_t bytes, resident_bytes, generation;
    bool pinned;
    double error_bound;                       /* measured relative RMSE; 0: unknown */
    bool stale;                               /* vertices moved: the bake is of another shape */
    const char *material, *settings, *errors; /* JSON text, may be "" */
    size_t n_warning, n_block;
    const char *const *warning;
    const struct relight_block *block;
    const char *failure; /* of RELIGHT_MODEL_FAILED, else "" */
    void *owner;         /* NULL for members of a list */
};
int relight_info(struct relight_client *client, const char *model, struct relight_model *out,
                 struct relight_error *error);
void relight_model_finish(struct relight_model *model);

struct relight_list {
    size_t n_model, n_file;
    const struct relight_model *model;
    const char *const *file; /* loadable paths of the daemon's folder */
    const uint64_t *file_bytes;
    void *owner;
};
int relight_list(struct relight_client *client, bool files, struct relight_list *out,
                 struct relight_error *error);
void relight_list_finish(struct relight_list *list);

struct relight_geometry {
    uint32_t n_vertex, n_triangle;
    const float (*position)[3];    /* [n_vertex] mm, or the model's own units */
    const float (*normal)[3];      /* [n_vertex] unit; NULL when left out */
    const uint32_t (*triangle)[3]; /* [n_triangle]; NULL when left out */
    double mm_per_unit;
    uint64_t generation;
    size_t n_block;
    const struct relight_block *block;
    void *owner;
};
int relight_geometry(struct relight_client *client, const char *model, bool own_units,
                     struct relight_geometry *out, struct relight_error *error);
void relight_geometry_finish(struct relight_geometry *geometry);

/* position [n][3], normal [n][3] or NULL; vertices [first, first+n). */
int relight_update_vertices(struct relight_client *client, const char *model, uint32_t first,
                            uint32_t n, const float *position, const float *normal,
                            bool own_units, uint64_t *generation, struct relight_error *error);
/* forget: delete its bake too. */
int relight_unload(struct relight_client *client, const char *model, bool forget,
                   uint64_t *freed_bytes, struct relight_error *error);

/* ---- relighting
 * --------------------------------------------------------------------------------- */

enum relight_engine {
    RELIGHT_ENGINE_DEFAULT,
    RELIGHT_ENGINE_REFERENCE,
    RELIGHT_ENGINE_WAVELET,
    RELIGHT_ENGINE_POLYNOMIAL,
    RELIGHT_ENGINE_JOINT,
    RELIGHT_ENGINE_SPLAT,
    RELIGHT_ENGINE_TANGENT,
    RELIGHT_ENGINE_TEXTURE,
    RELIGHT_ENGINE_HYBRID
};
enum relight_term {
    RELIGHT_TERM_TOTAL,
    RELIGHT_TERM_IRRADIANCE,
    RELIGHT_TERM_MULTIPLE,
    RELIGHT_TERM_SINGLE
};
enum relight_color_format {
    RELIGHT_COLOR_F32,
    RELIGHT_COLOR_F16,
    RELIGHT_COLOR_RGB9E5,
    RELIGHT_COLOR_SRGB8
};
enum relight_image_format {
    RELIGHT_IMAGE_JPEG,
    RELIGHT_IMAGE_PNG,
    RELIGHT_IMAGE_EXR,
    RELIGHT_IMAGE_RGB8,
    RELIGHT_IMAGE_EXR_FLOAT,
    RELIGHT_IMAGE_F16
};
enum relight_tone { RELIGHT_TONE_FILMIC, RELIGHT_TONE_REINHARD, RELIGHT_TONE_NONE };
const char *relight_engine_name(enum relight_engine engine);

struct relight_light {
    const char *env;   /* "env:HASH", "constant", "constant:R,G,B" */
    float rotate_deg;  /* counter-clockwise about +y seen from above */
    float gain[3];     /* 0,0,0: 1,1,1 */
    uint32_t cube_n;   /* with cube instead of env: 16, 32, 64, 128 */
    const float *cube; /* [6][n][n][3], faces +X -X +Y -Y +Z -Z, linear RGB radiance */
};
struct relight_shade {
    enum relight_engine engine;
    enum relight_term term;
    const char *material; /* preset or JSON text; NULL: the model's */
    bool has_eye;
    float eye[3];    /* the model's own units */
    float max_error; /* refuse above this error bound; 0: never */
    uint32_t budget_ms;
    /* images over the model's uv, SHA-256 of uploads; NULL: none; pictures by image-space
     * engines */
    const char *albedo_map, *normal_map, *bump_map;
    float bump_mm; /* height of the bump map's white; 0: 0.5 */
};
struct relight_camera {
    bool set;                       /* false: the model is framed */
    float eye[3], target[3], up[3]; /* the model's own units; up 0,0,0: +y */
    float fovy_deg;                 /* 0: default */
};
/* "x,y,z:x,y,z[:x,y,z][:deg]". Does not block. */
int relight_camera_parse(const char *text, struct relight_camera *out,
                         struct relight_error *error);
struct relight_picture {
    uint32_t width, height; /* 0: 800 x 600 */
    struct relight_camera camera;
    enum relight_image_format format;
    uint32_t quality; /* JPEG 1..100; 0: 90 */
    enum relight_tone tone;
    float exposure_ev;
    bool plain_background;
    float background[3];
    uint32_t samples; /* 0: 4 */
    bool no_specular;
};
struct relight_cost {
    float queue_ms, light_ms, relight_ms, raster_ms, shade_ms, encode_ms, total_ms;
    uint32_t shared;   /* requests that shared the pass */
    float error_bound; /* relative RMSE that holds, measured at the bake or foreseen for
                          an image-space engine; 0: unknown */
    enum relight_engine engine;
    const char *note;
    uint32_t samples, frames; /* image space: see relight.proto; 0 otherwise */
    bool converged;           /* a view sends nothing finer of this state */
};

struct relight_colors_request {
    const char *model;
    size_t n_light;
    const struct relight_light *lights;
    bool sum; /* one plane, the sum over the lights */
    struct relight_shade shade;
    enum relight_color_format format;
    float exposure_ev; /* RELIGHT_COLOR_SRGB8 */
};
struct relight_colors {
    uint32_t n_vertex, n_plane;
    uint64_t plane_bytes;
    enum relight_color_format format;
    uint64_t generation;
    const void *data; /* plane i at i*plane_bytes, 64-byte aligned */
    struct relight_cost cost;
    void *owner;
};
int relight_colors(struct relight_client *client, const struct relight_colors_request *request,
                   struct relight_colors *out, struct relight_error *error);
/* Pipelining: begin returns once the request is sent; end waits for the answer, in any order.
 * Every id must be ended once. timeout_s as relight_options.timeout_s; 0: the client's. */
int relight_colors_begin(struct relight_client *client,
                         const struct relight_colors_request *request, double timeout_s,
                         uint64_t *id, struct relight_error *error);
int relight_colors_end(struct relight_client *client, uint64_t id, struct relight_colors *out,
                       struct relight_error *error);
void relight_colors_finish(struct relight_colors *colors);
/* Plane to linear f32 out[n_vertex][3]. Does not block. */
int relight_colors_decode(const struct relight_colors *colors, uint32_t plane, float *out);

struct relight_image_request {
    const char *model;
    size_t n_light;
    const struct relight_light *lights; /* summed; the first is the background */
    struct relight_shade shade;
    struct relight_picture picture;
};
struct relight_image {
    uint32_t width, height;
    enum relight_image_format format;
    struct relight_camera camera; /* used */
    uint64_t generation, n_byte;
    const void *data; /* encoded file, or raw pixels */
    struct relight_cost cost;
    void *owner;
};
int relight_image(struct relight_client *client, const struct relight_image_request *request,
                  struct relight_image *out, struct relight_error *error);
int relight_image_begin(struct relight_client *client,
                        const struct relight_image_request *request, double timeout_s,
                        uint64_t *id, struct relight_error *error);
int relight_image_end(struct relight_client *client, uint64_t id, struct relight_image *out,
                      struct relight_error *error);
void relight_image_finish(struct relight_image *image);

/* Colour formats to linear f32, n values (or n colours). Do not block. */
void relight_decode_f16(const uint16_t *in, size_t n, float *out);
void relight_decode_rgb9e5(const uint32_t *in, size_t n, float *out); /* out[n][3] */
void relight_decode_srgb8(const uint8_t *in, size_t n, float *out);   /* in[n][4], out[n][3] */

/* ---- views: state that frames follow, latest wins
 * -------------------------------------------------- */

struct relight_view; /* Thread-safety: Safe, but relight_view_next on one thread */

struct relight_view_request {
    const char *model;
    size_t n_light;
    const struct relight_light *lights;
    struct relight_shade shade;
    struct relight_picture picture;
    bool colors; /* frames are colours, else pictures */
    enum relight_color_format color_format;
    float color_exposure_ev;
    uint32_t max_fps, window;
};
struct relight_frame_out {
    uint64_t frame, sequence, skipped; /* skipped: frames received and dropped before this */
    bool has_colors, has_image;
    struct relight_colors colors;
    struct relight_image image;
    void *owner;
};
int relight_view_open(struct relight_client *client, const struct relight_view_request *request,
                      struct relight_view **out, struct relight_error *error);
/* NULL arguments (n_light 0) leave that part as it is. Returns once sent. *sequence may be
 * NULL. */
int relight_view_set(struct relight_view *view, size_t n_light,
                     const struct relight_light *lights, const struct relight_shade *shade,
                     const struct relight_picture *picture, uint64_t *sequence,
                     struct relight_error *error);
/* The newest frame; waits for one up to timeout_s (RELIGHT_E_TIMEOUT; the view stays usable).
 * A state that could not be drawn is returned as its error; the view stays open. */
int relight_view_next(struct relight_view *view, double timeout_s,
                      struct relight_frame_out *out, struct relight_error *error);
void relight_frame_out_finish(struct relight_frame_out *frame);
/* Closes and frees; *frames, *dropped may be NULL. */
int relight_view_close(struct relight_view *view, uint64_t *frames, uint64_t *dropped,
                       struct relight_error *error);

/* ---- statistics
 * ---------------------------------------------------------------------------------- */

struct relight_metric {
    const char *name, *help;
    double value;
};
struct relight_stats {
    size_t n_metric;
    const struct relight_metric *metric;
    void *owner;
};
int relight_stats(struct relight_client *client, struct relight_stats *out,
                  struct relight_error *error);
void relight_stats_finish(struct relight_stats *stats);

#if defined(__GNUC__)
#pragma GCC visibility pop
#endif
#ifdef __cplusplus
}
#endif
#endif
