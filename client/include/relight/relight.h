/* SPDX-License-Identifier: MIT */
/* relight/relight.h owns the client's side of the relighting protocol: connect to a relightd,
 * upload models and environments, and get colours, pictures and frames back.
 *
 * Thread-safety: a relight_client is Safe: any number of threads may call any functions on it
 * at once, each waiting for its own answers; there is no hidden thread. Exceptions are named
 * below. Functions block unless their text says otherwise. SIGPIPE is never raised. Above 600
 * lines: the one header of the library; two thirds of it are the contracts of its functions.
 *
 * Returns: 0, or a negative enum relight_code with `*error` (may be NULL) filled; outputs are
 * untouched then. Strings and arrays inside an output belong to it until its _finish call.
 * Units: millimetres where said so, else the model's own; colours are linear RGB radiance.
 * Above 600 lines: one header with the contract of each call is the library's manual. */
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

/* Errors. */

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
    X(MOVED, 20, "another server serves it")                      \
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

/* Says a status in English.
 * code: an enum relight_code of either sign.
 * Returns one line without a newline, never NULL; it lives for ever. An unknown code is
 * "internal error".
 * Thread-safety: Safe. Does not block. */
const char *relight_code_text(int code);

struct relight_error {
    int code;                /* enum relight_code, positive */
    char text[384];          /* what was wrong with what */
    char hint[256];          /* what to do; may be empty */
    uint32_t retry_after_ms; /* RELIGHT_E_BUSY: when to try again */
    /* RELIGHT_E_OUT_OF_RANGE, where one number is the fault: its name ("" otherwise), and its
     * range, if has_range */
    char parameter[80];
    bool has_range;
    double minimum, maximum;
    char unit[32]; /* "": none */
    /* RELIGHT_E_MISMATCH of relight_update_vertices: the geometry's generation now; else 0 */
    uint64_t generation;
    char address[128]; /* MOVED: of the other server */
};

/* Connection. */

struct relight_client;

struct relight_options {
    const char *name;  /* of the program, for the daemon's log; NULL: "librelight" */
    const char *token; /* NULL: none */
    const char *ca;    /* tls: PEM file of trusted certificates; NULL: $RELIGHT_CA, else the
                        * system's */
    double connect_timeout_s; /* 0: 5 s */
    double timeout_s;     /* of each blocking call, sent to the daemon as deadline; 0: none */
    uint64_t max_payload; /* largest answer accepted, bytes; 0: 4 GiB */
    /* When the connection is lost, the next call connects again, for so long, to the address
     * that the daemon named when it stopped (GOAWAY), else to the same one. Calls that were
     * waiting return RELIGHT_E_DISCONNECTED; views end and are opened again. 0: never */
    double reconnect_s;
    /* The model that this connection is for, an id or a name; NULL: none. Of several replicas
     * the daemon sends the client to the one that has it in memory; where that does not answer,
     * the first serves. */
    const char *route;
};

/* Connects to a relightd and says HELLO.
 * address: "tcp:HOST[:PORT]" (IPv6 as tcp:[::1]:7413), "tls:HOST[:PORT]" (TLS, whose
 * certificate must be HOST's and signed by one in options->ca), "unix:PATH", or NULL for
 * $RELIGHT_SERVER, else unix:$XDG_RUNTIME_DIR/relightd.sock when that exists, else
 * tcp:127.0.0.1:7413. options: NULL takes every default; strings are copied.
 * Returns 0 and a client in *out, which the caller gives to relight_close.
 * -RELIGHT_E_ARGUMENT: the address does not parse. -RELIGHT_E_UNREACHABLE: nobody listens,
 * the server's certificate is not trusted, or connect_timeout_s passed. -RELIGHT_E_FILE:
 * options->ca cannot be read. -RELIGHT_E_FORBIDDEN: the daemon wants another token.
 * -RELIGHT_E_VERSION: no common protocol version.
 * Thread-safety: Safe. Blocks for connect_timeout_s at most. */
int relight_connect(const char *address, const struct relight_options *options,
                    struct relight_client **out, struct relight_error *error);

/* Ends the connection and frees the client. Outstanding requests are cancelled by the
 * daemon; jobs go on.
 * client: NULL is allowed.
 * Thread-safety: Unsafe: no other call may be running on the client, and its views must be
 * closed. Does not block. */
void relight_close(struct relight_client *client);

struct relight_server {
    const char *name; /* program and version */
    const char *run;  /* differs at every start of the daemon; as of the first connection */
    const char *address;
    uint64_t max_payload, max_blob;
    uint32_t max_in_flight, chunk;
    size_t n_preset;
    const char *const *preset; /* names of materials */
    const char *principal;     /* this client's name at the daemon, such as "token:anna" */
    size_t n_scope;
    const char *const *scope; /* its rights: "view", "edit", "upload", "admin" */
    uint64_t expires_s;       /* its token's end, seconds since 1970; 0: never */
};

/* Tells what the daemon said in HELLO.
 * Returns a pointer that lives as long as the client.
 * Thread-safety: Safe. Does not block. */
const struct relight_server *relight_server(const struct relight_client *client);

struct relight_goaway {
    double drain_s;    /* open requests are finished for so long, from when it was sent */
    char address[128]; /* "": the same, later */
    char text[128];
};

/* Tells whether the daemon has announced that it stops (GOAWAY) on the connection as it is.
 * Returns true and fills *out (NULL is allowed). Calls of the client receive the announcement:
 * a program that waits for nothing calls relight_ping now and then. Thread-safety: Safe. Does
 * not block. */
bool relight_goaway(struct relight_client *client, struct relight_goaway *out);

/* Stops an outstanding request of this client.
 * id: from relight_colors_begin or relight_image_begin. The request still has to be ended by
 * its _end call, which returns -RELIGHT_E_CANCELLED, or the answer when it was already made.
 * Returns 0 once CANCEL is sent, or -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Safe. Does not wait for an answer. */
int relight_cancel(struct relight_client *client, uint64_t id, struct relight_error *error);

/* Measures a round trip.
 * Returns 0 and its length [s] in *seconds. -RELIGHT_E_TIMEOUT, -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_ping(struct relight_client *client, double *seconds, struct relight_error *error);

/* Uploads. */

enum relight_job_state {
    RELIGHT_JOB_QUEUED,
    RELIGHT_JOB_RUNNING,
    RELIGHT_JOB_DONE,
    RELIGHT_JOB_FAILED,
    RELIGHT_JOB_CANCELLED,
    RELIGHT_JOB_NONE /* of a model without a bake: nothing is to be waited for */
};
struct relight_progress {
    const char *stage;       /* "upload", or a stage of the bake */
    double fraction;         /* [0,1] */
    double eta_s, elapsed_s; /* eta_s < 0: unknown */
    enum relight_job_state state;
};
/* Non-zero stops waiting: the call returns RELIGHT_E_CANCELLED (a watched job continues).
 * Called on the thread that made the call, without locks held. */
typedef int (*relight_progress_fn)(void *user, const struct relight_progress *progress);

/* Fetches an upload back, as a file.
 * hash: 64 hex digits, or "env:HASH". path: a file of that name is replaced; on an error it
 * stays. fn: called between pieces, may be NULL. Returns 0 and the number of bytes in *size
 * (NULL is allowed). -RELIGHT_E_NOT_FOUND: this client did not upload it, or it was dropped.
 * -RELIGHT_E_FILE. -RELIGHT_E_HASH: the bytes are damaged. Thread-safety: Safe. Blocks until
 * all of it is here. */
int relight_download(struct relight_client *client, const char *hash, const char *path,
                     relight_progress_fn fn, void *user, uint64_t *size,
                     struct relight_error *error);

/* Computes the name of a blob: SHA-256 of bytes[n] as 64 lower-case hex digits and a zero in
 * hash.
 * Thread-safety: Safe. Does not block. */
void relight_hash(const void *bytes, size_t n, char hash[65]);

/* Uploads bytes unless the daemon has them; then it is one round trip.
 * name: file name, which tells formats apart; NULL: none. bytes [n]. fn: called between
 * chunks, may be NULL.
 * Returns 0 with the blob's name in hash and, where sent is not NULL, the number of bytes
 * that had to be sent in *sent. -RELIGHT_E_LIMIT: larger than the daemon takes, or its disk
 * is full. -RELIGHT_E_HASH: bytes were changed while they were sent. -RELIGHT_E_CANCELLED:
 * fn returned non-zero.
 * Thread-safety: Safe. Blocks until the blob is stored. */
int relight_upload(struct relight_client *client, const char *name, const void *bytes, size_t n,
                   relight_progress_fn fn, void *user, char hash[65], uint64_t *sent,
                   struct relight_error *error);

/* The same for a file, which is read into memory first.
 * path: a regular file. Its last component becomes the name.
 * Returns as relight_upload; -RELIGHT_E_FILE: it cannot be read, or became shorter meanwhile;
 * -RELIGHT_E_NO_MEMORY.
 * Thread-safety: Safe. Blocks until the blob is stored. */
int relight_upload_file(struct relight_client *client, const char *path, relight_progress_fn fn,
                        void *user, char hash[65], uint64_t *sent, struct relight_error *error);

/* Turns an ENV word of the command line into one that the daemon takes.
 * word: "constant", "constant:R,G,B" and "env:HASH" are copied; anything else is a file and
 * is uploaded.
 * Returns 0 with the word in env, or as relight_upload_file.
 * Thread-safety: Safe. Blocks while a file is uploaded. */
int relight_env_resolve(struct relight_client *client, const char *word, relight_progress_fn fn,
                        void *user, char env[80], struct relight_error *error);

struct relight_env_info {
    bool cube; /* source is a cubemap, else lat-long */
    uint32_t width, height, full_cube, n_mended;
    float mean[3]; /* mean radiance over the sphere */
    double decode_ms;
};
/* Has the daemon decode an environment ahead of its use. */

/* Has the daemon decode an environment ahead of its first use.
 * env: as relight_env_resolve returns it.
 * Returns 0 and what was decoded in *out, which holds no memory. -RELIGHT_E_NOT_FOUND: not
 * uploaded. -RELIGHT_E_FORMAT: no image. -RELIGHT_E_LIMIT: too many pixels.
 * Thread-safety: Safe. Blocks until it is decoded. */
int relight_env_prepare(struct relight_client *client, const char *env,
                        struct relight_env_info *out, struct relight_error *error);

/* Models. */

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

enum relight_scattering {
    RELIGHT_SCATTERING_DEFAULT,
    RELIGHT_SCATTERING_DIPOLE,
    RELIGHT_SCATTERING_WALK
};

/* Zero everywhere: the daemon's defaults, as `prt bake`. */
struct relight_bake {
    enum relight_transport transport;
    enum relight_storage storage;
    enum relight_scattering scattering; /* WALK: random walks, with transport WAVELET */
    uint32_t walks;                     /* a vertex and channel, with WALK */
    uint32_t samples, cube, coeffs, rank, phase_terms, single_points;
    bool no_single;
    bool exit_planes; /* planes that correct single scattering towards an eye */
    bool any_eta;     /* joint: media of every eta from 1.2 to 1.6 */
    float max_error;
    uint64_t seed;
    const char *env; /* polynomial: the fixed light, as relight_light.env */
    float rotate_deg;
};
/* The medium of one object. */
struct relight_object_material {
    const char *object;   /* a glTF material or node, or the unique beginning of its name */
    const char *material; /* preset name or JSON text */
};
enum { RELIGHT_MAX_MATERIAL = 64 }; /* entries of one request */
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
    const char *material;       /* preset name or JSON text; NULL: the file's own, or open */
    size_t n_material;          /* media by object; the others have the above */
    const struct relight_object_material *materials;
    struct relight_bake bake;
    size_t n_opaque;
    const char *const *opaque;
    bool pin;
    const char *variant; /* of the glTF's materials; NULL: none */
    bool up_z;           /* +z is up in the file: (x,y,z) becomes (x,z,-y) */
    bool flip_v;         /* the file's images are upside down: v becomes 1 - v */
    bool preview;        /* no bake: image-space engines answer */
    bool no_draft;       /* no draft of some 3 % that answers until the bake is ready */
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

/* Returns a state's word ("ready"), never NULL. Thread-safety: Safe. Does not block. */
const char *relight_model_state_name(enum relight_model_state state);

struct relight_loaded {
    const char *model; /* id */
    enum relight_model_state state;
    const char *job; /* "": nothing to wait for */
    size_t n_warning;
    const char *const *warning;
    void *owner;
};

/* Loads a model: finds its bake, or orders one.
 * load: the model as uploaded files or as a path below the daemon's models folder, its
 * scale, material and bake settings; nothing of it is kept.
 * Returns 0 and the model's id and state in *out, to be freed by relight_loaded_finish;
 * `job` is not empty while a bake waits or runs. -RELIGHT_E_NOT_FOUND: no such blob.
 * -RELIGHT_E_FORBIDDEN: no such path inside the models folder.
 * -RELIGHT_E_FORMAT: the model cannot be read. -RELIGHT_E_OUT_OF_RANGE: a setting, with its
 * range in the text. -RELIGHT_E_BUSY: too many bakes wait.
 * Thread-safety: Safe. Blocks until the model is open or the bake is queued, not until it is
 * baked: see relight_watch. */
int relight_load(struct relight_client *client, const struct relight_load *load,
                 struct relight_loaded *out, struct relight_error *error);

/* Frees what relight_load put into *loaded; the struct is the caller's. NULL and a zeroed
 * struct are allowed.
 * Thread-safety: Safe for different structs. Does not block. */
void relight_loaded_finish(struct relight_loaded *loaded);

/* Uploads a model file and the files that it names, then loads it: the buffers and images of a
 * .gltf, the material library of an .obj and the images in that. An image that is not there,
 * or outside the model's folder, is left out: the daemon warns. path: .glb .gltf .obj .ply
 * .stl. load: as relight_load; its files and path are ignored. Returns as relight_load and
 * relight_upload_file. Thread-safety: Safe. Blocks as both. */
int relight_load_file(struct relight_client *client, const char *path,
                      const struct relight_load *load, relight_progress_fn fn, void *user,
                      struct relight_loaded *out, struct relight_error *error);

/* Follows a job to its end, however long that takes; timeout_s of the client does not apply.
 * job: a job's id, of an earlier run of the daemon too, or a model's for its newest job. fn may
 * be NULL; it runs on this thread for each change, at most ten times a second.
 * Returns 0 when the job is done, -RELIGHT_E_JOB_FAILED with the job's own words in *error,
 * -RELIGHT_E_CANCELLED when the job was cancelled or fn returned non-zero,
 * -RELIGHT_E_NOT_READY for a model without a bake, -RELIGHT_E_NOT_FOUND when there is no such
 * model and the daemon does not keep such a job (watch its model then).
 * Thread-safety: Safe. Blocks. */
int relight_watch(struct relight_client *client, const char *job, relight_progress_fn fn,
                  void *user, struct relight_error *error);

/* Cancels a bake for everybody who waits for it.
 * Returns 0 and the state it had in *state (NULL is allowed); a job that has ended stays as
 * it is. -RELIGHT_E_NOT_FOUND.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_cancel_job(struct relight_client *client, const char *job,
                       enum relight_job_state *state, struct relight_error *error);

struct relight_block {
    uint32_t object;
    const char *surface;
    bool translucent;
    uint32_t vertex_begin, n_vertex, triangle_begin, n_triangle;
    float base_color[3];
    uint32_t surface_index; /* into relight_geometry.look */
    uint32_t medium;        /* into `media`, of a translucent block */
    const char *node;       /* glTF node's name, may be "" */
    bool has_gain; /* an opaque block of relight_geometry_variant has the factor `gain` */
    float gain[3]; /* of its colours from coefficients, linear RGB */
};
struct relight_named_camera {
    const char *name;
    float eye[3], target[3], up[3]; /* the model's own units */
    float fovy_deg;
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
    double error_bound; /* measured relative RMSE; 0: unknown */
    bool stale;         /* vertices moved: the bake is of another shape */
    bool draft; /* a draft answers until the bake is ready; error_bound is the draft's */
    const char *material, *settings, *errors; /* JSON text, may be "" */
    size_t n_warning, n_block;
    const char *const *warning;
    const struct relight_block *block;
    size_t n_camera; /* the file's own; relight_info only */
    const struct relight_named_camera *camera;
    size_t n_medium;            /* JSON texts of its media; relight_info only */
    const char *const *medium;  /* [n_medium] */
    uint32_t exit_planes;       /* of the bake: 9, or 0 */
    size_t n_variant;           /* names for relight_shade.variant, once the file was read */
    const char *const *variant; /* [n_variant] */
    const char *failure;        /* of RELIGHT_MODEL_FAILED, else "" */
    void *owner;                /* NULL for members of a list */
    /* relight_info only, 16 hex digits: of the model's own shape, as in relight_geometry, and
     * of its bake; "": the daemon does not say, or there is no bake */
    const char *mesh_hash, *bake_hash;
};

/* Describes a model.
 * model: its id, the unique beginning of one (eight digits or more), its name when that is
 * unique, or a beginning that no other name has.
 * Returns 0 and *out, to be freed by relight_model_finish. -RELIGHT_E_NOT_FOUND.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_info(struct relight_client *client, const char *model, struct relight_model *out,
                 struct relight_error *error);

/* Frees what relight_info put into *model. Members of a relight_list are freed with the
 * list.
 * Thread-safety: Safe for different structs. Does not block. */
void relight_model_finish(struct relight_model *model);

struct relight_list {
    size_t n_model, n_file;
    const struct relight_model *model;
    const char *const *file; /* loadable paths of the daemon's folder */
    const uint64_t *file_bytes;
    void *owner;
    size_t n_env; /* images that this client uploaded */
    const struct relight_env_entry {
        const char *env, *name; /* "env:HASH"; name: may be "" */
        uint64_t bytes;
    } * env;
};

/* Lists the models that are loaded and, with `files`, the files that relight_load takes as
 * path and the images that this client uploaded.
 * Returns 0 and *out, to be freed by relight_list_finish.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_list(struct relight_client *client, bool files, struct relight_list *out,
                 struct relight_error *error);

/* Frees what relight_list put into *list. Thread-safety: Safe for different structs. Does
 * not block. */
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
    size_t n_medium;           /* JSON texts of the model's media */
    const char *const *medium; /* [n_medium] */
    /* of the model's own shape: equal where triangles have the same numbers, also in another
     * bake or where vertices were moved; "": the daemon does not say */
    const char *mesh_hash;
    void *owner;
    /* relight_geometry_textured alone */
    uint32_t n_uv;                  /* TEXCOORD sets */
    const float (*uv)[2];           /* [n_uv][n_vertex] */
    const float (*corner_uv)[3][2]; /* [n_triangle] in place of set 0, or NULL */
    const float (*color)[4];        /* [n_vertex] COLOR_0, linear RGBA in [0,1], or NULL */
    size_t n_look, n_image;
    const struct relight_look *look;        /* [n_look] one for each surface */
    const struct relight_image_info *image; /* [n_image] fetched by relight_texture */
    float texture_split; /* share of the base colour's brightness that the bake has blurred */
    const int8_t (
        *blocked)[16]; /* [n_vertex] of a bake: spherical harmonics (l <= 3) of the sky
                          that the model hides, in steps of 4/127; NULL: not known */
};

/* An image over a model's texture coordinates: RGBA of 8 bits and its mip chain, levels one
 * after another from the full size to 1 x 1, each side half the one before, rounded down. */
enum relight_texture_kind {
    RELIGHT_TEXTURE_COLOR,  /* sRGB */
    RELIGHT_TEXTURE_DATA,   /* linear numbers */
    RELIGHT_TEXTURE_NORMAL, /* 0.5 + 0.5 n, glTF's axes */
};
struct relight_image_info {
    const char *hash; /* names its texels: equal hashes are equal images */
    uint32_t width, height;
    enum relight_texture_kind kind;
    uint64_t bytes; /* of all levels */
};
/* An image's place on a surface. */
struct relight_map {
    bool present;
    uint32_t image, uv_set;
    uint32_t wrap_u, wrap_v; /* 0 repeat, 1 clamp, 2 mirror */
    uint32_t filter;         /* bits of TextureMap in relight.proto */
    float transform[6];      /* u' = t0 u + t1 v + t2, v' = t3 u + t4 v + t5 */
    float scale;             /* of normals; strength of occlusion */
};
struct relight_look {
    float base_color[4], emissive[3]; /* linear */
    float roughness, metallic;
    struct relight_map base, normal, metallic_roughness, occlusion, emission;
};

/* Fetches a model's vertices and triangles as they are now.
 * own_units: positions in the model's own units in place of mm.
 * Returns 0 and *out, to be freed by relight_geometry_finish: one block after another, each
 * the vertices of a primitive in the file's order, the order of colours.
 * -RELIGHT_E_NOT_FOUND, -RELIGHT_E_NOT_READY.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_geometry(struct relight_client *client, const char *model, bool own_units,
                     struct relight_geometry *out, struct relight_error *error);

/* Fetches the vertices and triangles of a named pose; pose NULL is relight_geometry.
 * Returns as relight_geometry; -RELIGHT_E_NOT_FOUND: no pose of that name by relight_put_pose.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_geometry_posed(struct relight_client *client, const char *model, const char *pose,
                           bool own_units, struct relight_geometry *out,
                           struct relight_error *error);

/* The same of a variant (relight_shade.variant), with texture coordinates, vertex colours,
 * surfaces and the list of images, all as the variant has them.
 * Returns as relight_geometry; -RELIGHT_E_OUT_OF_RANGE: the model has no such variant.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_geometry_variant(struct relight_client *client, const char *model,
                             const char *variant, bool own_units, struct relight_geometry *out,
                             struct relight_error *error);

/* Fetches a model's geometry as relight_geometry, with texture coordinates, vertex colours,
 * surfaces and the list of images.
 * Returns as relight_geometry.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_geometry_textured(struct relight_client *client, const char *model, bool own_units,
                              struct relight_geometry *out, struct relight_error *error);

/* Fetches the texels of an image that relight_geometry_textured listed: *texels
 * [info->bytes], to be freed by free().
 * Returns 0; -RELIGHT_E_NOT_FOUND, -RELIGHT_E_NO_MEMORY.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_texture(struct relight_client *client, const char *model,
                    const struct relight_image_info *info, uint8_t **texels,
                    struct relight_error *error);

/* Frees what relight_geometry put into *geometry. Thread-safety: Safe for different structs.
 * Does not block. */
void relight_geometry_finish(struct relight_geometry *geometry);

/* Moves vertices [first, first+n) of a model; the topology stays.
 * position [n][3] in mm, or in the model's units with own_units. normal [n][3] unit vectors,
 * or NULL: made from the triangles.
 * Returns 0 and the geometry's number in *generation (NULL is allowed).
 * -RELIGHT_E_OUT_OF_RANGE: a range outside the model, a coordinate beyond 1e6 mm or not a
 * number; then nothing moves.
 * Thread-safety: Safe. Blocks until the vertices are at the daemon. */
int relight_update_vertices(struct relight_client *client, const char *model, uint32_t first,
                            uint32_t n, const float *position, const float *normal,
                            bool own_units, uint64_t *generation, struct relight_error *error);

/* Moves vertices as relight_update_vertices, provided that the geometry is still of this
 * generation; 0: at any rate.
 * Returns as relight_update_vertices; -RELIGHT_E_MISMATCH: others have moved vertices
 * meanwhile; error->generation is the geometry's generation now, and nothing moved.
 * Thread-safety: Safe. Blocks until the vertices are at the daemon. */
int relight_update_vertices_if(struct relight_client *client, const char *model,
                               uint64_t if_generation, uint32_t first, uint32_t n,
                               const float *position, const float *normal, bool own_units,
                               uint64_t *generation, struct relight_error *error);

/* Sends a pose: vertices that requests name, and that change nothing for other clients.
 * base: the pose that it differs from in vertices [first, first+n); NULL: the vertices of the
 * file. position, normal, own_units as in relight_update_vertices; n may be 0.
 * Returns 0 and the pose's name in pose, for the requests of this and of other clients: the
 * SHA-256 of its vertices, 64 hex digits and a zero. The daemon may drop a pose that nothing
 * uses; requests with it then return -RELIGHT_E_NOT_FOUND, and it is sent again.
 * -RELIGHT_E_OUT_OF_RANGE as in relight_update_vertices. -RELIGHT_E_LIMIT: larger than one
 * client's poses may be.
 * Thread-safety: Safe. Blocks until the vertices are at the daemon. */
int relight_put_pose(struct relight_client *client, const char *model, const char *base,
                     uint32_t first, uint32_t n, const float *position, const float *normal,
                     bool own_units, char pose[65], struct relight_error *error);

/* Sends a pose that is a moment of an animation: nodes, skins and morph targets move.
 * path: the glTF that the model was loaded from, which is uploaded with its buffers unless the
 * daemon has them. animation: its name or the unique beginning of one; time_s in seconds, [0,
 * 1e9]. up_z as in relight_load.
 * Returns 0 and the pose's name in pose as relight_put_pose. -RELIGHT_E_OUT_OF_RANGE: no such
 * animation, with the nearest one. -RELIGHT_E_MISMATCH: the file has other vertices than the
 * model.
 * Thread-safety: Safe. Blocks until the pose is made. */
int relight_put_animation(struct relight_client *client, const char *model, const char *path,
                          const char *animation, double time_s, bool up_z, char pose[65],
                          struct relight_error *error);

/* What relight_unload removes besides the model in memory. */
enum relight_forget {
    RELIGHT_KEEP_BAKE,
    RELIGHT_FORGET,     /* its bake and its entry in the catalogue go, too */
    RELIGHT_FORGET_HELD /* the same where review rooms need it */
};
/* Takes a model out of the daemon's memory.
 * Returns 0 and the bytes that became free in *freed_bytes (NULL is allowed).
 * -RELIGHT_E_NOT_FOUND. -RELIGHT_E_MISMATCH: it is to be forgotten, and review rooms need it.
 * -RELIGHT_E_FORBIDDEN: RELIGHT_FORGET_HELD without the scope admin.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_unload(struct relight_client *client, const char *model, enum relight_forget forget,
                   uint64_t *freed_bytes, struct relight_error *error);

/* Relighting. */

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
    RELIGHT_COLOR_SRGB8,
    RELIGHT_COLOR_COEFFICIENTS, /* no colours: relight_coefficients_expand makes them */
    /* the same in two thirds of the bytes; colours differ by some 0.1 %. The daemon has the
     * feature "coefficients-packed" */
    RELIGHT_COLOR_COEFFICIENTS_PACKED
};
/* X(NAME, number in the protocol, file ending; "": pixels without a file around them, or a
 * variant of another format's files) */
#define RELIGHT_IMAGE_FORMAT_LIST(X) \
    X(JPEG, 0, "jpg")                \
    X(PNG, 1, "png")                 \
    X(EXR, 2, "exr")                 \
    X(RGB8, 3, "")                   \
    X(EXR_FLOAT, 4, "")              \
    X(F16, 5, "")                    \
    X(PNG16, 6, "")
enum relight_image_format {
#define RELIGHT_X(name, number, ending) RELIGHT_IMAGE_##name = number,
    RELIGHT_IMAGE_FORMAT_LIST(RELIGHT_X)
#undef RELIGHT_X
};
enum relight_tone { RELIGHT_TONE_FILMIC, RELIGHT_TONE_REINHARD, RELIGHT_TONE_NONE };

/* Returns an engine's word ("joint"), never NULL. Thread-safety: Safe. Does not block. */
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
    size_t n_material;    /* media by object; the others have the above */
    const struct relight_object_material *materials;
    bool has_eye;
    float eye[3];    /* the model's own units */
    float max_error; /* refuse above this error bound; 0: never */
    uint32_t budget_ms;
    /* images over the model's uv, SHA-256 of uploads; NULL: none; pictures by image-space
     * engines */
    const char *albedo_map, *normal_map, *bump_map;
    float bump_mm;       /* height of the bump map's white; 0: 0.5 */
    const char *variant; /* of relight_info's variants, or its unique beginning; "default": the
                            file's own materials; NULL: as the model was loaded */
};
struct relight_camera {
    bool set;                       /* false: the model is framed */
    float eye[3], target[3], up[3]; /* the model's own units; up 0,0,0: +y */
    float fovy_deg;                 /* 0: default */
    /* In place of the above, where the daemon places the camera: */
    char name[64];     /* one of the model's file (relight_info), or a beginning of its name */
    bool has_orbit;    /* about the framed centre; 0,0 looks along -z, azimuth 90 along -x */
    float azimuth_deg; /* [-1e6, 1e6], counter-clockwise about +y seen from above */
    float elevation_deg; /* [-90, 90] */
    float zoom;          /* [0.1, 100], magnification; 0: 1 */
};

/* Reads "AZIMUTH,ELEVATION[,ZOOM]" in degrees into an orbit.
 * Returns 0 and *out, or -RELIGHT_E_ARGUMENT.
 * Thread-safety: Safe. Does not block. */
int relight_orbit_parse(const char *text, struct relight_camera *out,
                        struct relight_error *error);

/* Reads "x,y,z:x,y,z[:x,y,z][:deg]": eye, target, up and vertical field of view. A text without
 * ':' and ',' is the name of one of the model's own cameras.
 * Returns 0 and *out, or -RELIGHT_E_ARGUMENT.
 * Thread-safety: Safe. Does not block. */
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
    bool floor;       /* the shadow of the model on a plane under it */
    bool transparent; /* no background: alpha in PNG (straight colours) and EXR (premultiplied)
                       */
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
    uint32_t reduced;    /* a view that cannot keep its rate: the picture has 1/reduced of the
                            width and height asked for, coefficients have fewer rows, colours
                            1/reduced of the vertices, and an exact frame follows; 0: as asked
                            for */
    bool draft;          /* a draft answered, or a view fades from it to the bake */
    float bake_fraction; /* with draft: how far the bake is, [0,1] */
};

/* Order of a client's own requests; between clients the compute time they used decides. */
enum relight_priority {
    RELIGHT_PRIORITY_DEFAULT, /* views: INTERACTIVE; colours and pictures: STILL */
    RELIGHT_PRIORITY_INTERACTIVE,
    RELIGHT_PRIORITY_STILL,
    RELIGHT_PRIORITY_BULK
};

struct relight_colors_request {
    const char *model;
    size_t n_light;
    const struct relight_light *lights;
    bool sum; /* one plane, the sum over the lights */
    struct relight_shade shade;
    enum relight_color_format format;
    float exposure_ev; /* RELIGHT_COLOR_SRGB8 */
    enum relight_priority priority;
    const char *pose;   /* of relight_put_pose; NULL: the model's vertices as they are */
    uint32_t most_rank; /* RELIGHT_COLOR_COEFFICIENTS: rows of each cluster, 0: all */
    /* Parts that depend on the view are sent apart: of coefficients the phases behind the
     * first, of colours the planes (relight_colors.n_part) */
    bool phases;
    /* COEFFICIENTS, and F16 and F32 with `phases`: the planes of exit of a bake that has them,
     * too (relight_colors.n_exit, relight_coefficients_exits) */
    bool exits;
};
enum {
    RELIGHT_MOST_LAYERS = 5, /* tensors of a bake (PRT_MOST_TENSORS) */
    RELIGHT_MOST_PHASES = 16,
    RELIGHT_EXIT_PLANES = 9,
    RELIGHT_MOST_RANK = 1 << 20
};
/* Coefficients of one tensor of relight_factors: half [n_row][n_phase][3] at `offset` of each
 * plane, times scale[plane]. */
struct relight_layer {
    uint32_t tensor, n_phase, n_row;
    uint64_t offset;
    const float *scale; /* [n_plane] */
};
struct relight_colors {
    uint32_t n_vertex, n_plane;
    /* Colours of each plane, one after another: M, then S_0, S_1, … of PROTOCOL.md (FACTORS),
     * RELIGHT_COLOR_RGB9E5 at most S_0. 0: one colour a vertex */
    uint32_t n_part;
    uint32_t n_exit; /* of the parts, the last: planes of exit P_0, P_1, … */
    /* Colours of the first n_coarse vertices of the order with this hash
     * (relight_coarse_expand); 0: of all n_vertex. Views with `coarse` alone */
    uint32_t n_coarse;
    uint64_t coarse_order;
    uint64_t plane_bytes;
    enum relight_color_format format;
    uint64_t generation;
    const void *data; /* plane i at i*plane_bytes, 64-byte aligned */
    struct relight_cost cost;
    void *owner;
    size_t n_outgoing;     /* with coefficients or parts */
    const void *outgoings; /* relight_colors_outgoing reads them */
    /* RELIGHT_COLOR_COEFFICIENTS alone */
    uint64_t factors; /* relight_factors.hash that they belong to */
    uint32_t most_rank, n_layer;
    struct relight_layer layer[RELIGHT_MOST_LAYERS];
};

/* Asks for one colour a vertex under each light, or under their sum.
 * Returns 0 and *out, to be freed by relight_colors_finish. -RELIGHT_E_NOT_READY: no bake
 * yet. -RELIGHT_E_MISMATCH: the bake has the material or the light fixed.
 * -RELIGHT_E_OUT_OF_RANGE: the material, or an error above shade.max_error. -RELIGHT_E_BUSY:
 * try again after error->retry_after_ms. -RELIGHT_E_DEADLINE or -RELIGHT_E_TIMEOUT:
 * timeout_s of the client passed.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_colors(struct relight_client *client, const struct relight_colors_request *request,
                   struct relight_colors *out, struct relight_error *error);

/* Sends the request of relight_colors without waiting for its answer, so that many travel at
 * once.
 * timeout_s: of this request [s], sent to the daemon as its deadline; 0: the client's.
 * Returns 0 and a number in *id, which must be given to relight_colors_end exactly once, in
 * any order. -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Safe. Blocks only while the socket is full. */
int relight_colors_begin(struct relight_client *client,
                         const struct relight_colors_request *request, double timeout_s,
                         uint64_t *id, struct relight_error *error);

/* Waits for the answer of a relight_colors_begin. Returns as relight_colors; id is used up
 * either way.
 * Thread-safety: Safe, each id on one thread. Blocks until the answer is here. */
int relight_colors_end(struct relight_client *client, uint64_t id, struct relight_colors *out,
                       struct relight_error *error);

/* Frees what relight_colors put into *colors. Thread-safety: Safe for different structs.
 * Does not block. */
void relight_colors_finish(struct relight_colors *colors);

/* Turns a plane, or one part of it, into linear RGB radiance.
 * plane: [0, n_plane); with parts [0, n_plane * n_part), those of plane 0 first. out
 * [n_vertex][3], or [n_coarse][3] where that is not 0.
 * Returns 0, or -RELIGHT_E_ARGUMENT where there is no such plane, or the format is
 * RELIGHT_COLOR_COEFFICIENTS (relight_coefficients_colors).
 * Thread-safety: Safe. Does not block. */
int relight_colors_decode(const struct relight_colors *colors, uint32_t plane, float *out);

/* An order of a model's vertices in which each from n_root on is about midway between two that
 * come before it, so that colours of the first ones make colours of all. */
struct relight_coarse_order {
    uint64_t hash; /* relight_colors.coarse_order */
    uint32_t n_vertex, n_root;
    const uint32_t *vertex;      /* [n_vertex] at each position, each vertex once */
    const uint32_t (*parent)[2]; /* [n_vertex] positions before the own one, from n_root on */
    void *owner;
};
/* Fetches the coarse order of a model's bake, for views with `coarse`.
 * Returns 0 and *out, checked, to be freed by relight_coarse_order_finish.
 * -RELIGHT_E_NOT_READY: no bake yet. Thread-safety: Safe. Blocks until the answer is here. */
int relight_coarse_order(struct relight_client *client, const char *model,
                         struct relight_coarse_order *out, struct relight_error *error);
/* Frees what relight_coarse_order put into *order. Thread-safety: Safe for different structs.
 * Does not block. */
void relight_coarse_order_finish(struct relight_coarse_order *order);

/* relight_colors_decode for colours of fewer vertices: those that were left out are the mean of
 * their parents. out [n_vertex][3].
 * Returns 0, or -RELIGHT_E_ARGUMENT as relight_colors_decode, -RELIGHT_E_MISMATCH: the order is
 * of another bake: fetch it again; -RELIGHT_E_NO_MEMORY.
 * Thread-safety: Safe. Does not block. */
int relight_coarse_expand(const struct relight_coarse_order *order,
                          const struct relight_colors *colors, uint32_t plane, float *out);

/* One tensor of baked transport. Cluster c has cluster[c][0] vertices, those at the positions
 * behind the clusters before it, and a rank of cluster[c][1]. U of a cluster, i16
 * [(rank + 1) / 2][P][2] with P its vertices rounded up to a multiple of 16, times 2^-20; the
 * rank is most_rank of relight_factors where that is less and not 0. */
struct relight_factor_tensor {
    bool single; /* single scattering, else multiple */
    bool exit;   /* its planes of exit */
    uint32_t n_cluster;
    const uint32_t (*cluster)[2]; /* [n_cluster] vertices, rank */
    const uint32_t *order;        /* [n_vertex] file vertex at each position */
    const int16_t *u;             /* [n_u], cluster after cluster */
    uint64_t n_u;
};
struct relight_factors {
    uint64_t hash; /* of the bake: relight_colors.factors */
    uint32_t n_vertex, most_rank, n_tensor;
    struct relight_factor_tensor tensor[RELIGHT_MOST_LAYERS];
    void *owner;
};

/* Fetches the part of a model's transport that does not change with light and material. With
 * it, colours in RELIGHT_COLOR_COEFFICIENTS or packed, some 10 to 40 kB an answer, become
 * colours here.
 * most_rank: even; fewer columns of each cluster, which is less exact and smaller; 0: all.
 * Returns 0 and *out, checked, to be freed by relight_factors_finish. -RELIGHT_E_UNSUPPORTED:
 * the bake is not factored (sparse, polynomial). -RELIGHT_E_NOT_READY: no bake yet.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_factors(struct relight_client *client, const char *model, uint32_t most_rank,
                    struct relight_factors *out, struct relight_error *error);

/* relight_factors with the tensors of the planes of exit (PROTOCOL.md, FACTORS) as well, which
 * coefficients asked for with `exits` need. A bake without them, and a daemon that does not
 * know them, answer as relight_factors. Parameters, result and errors: as there.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_factors_with_exits(struct relight_client *client, const char *model,
                               uint32_t most_rank, struct relight_factors *out,
                               struct relight_error *error);

/* Frees what relight_factors put into *factors. Thread-safety: Safe for different structs.
 * Does not block. */
void relight_factors_finish(struct relight_factors *factors);

/* From the sums of coefficients to radiance, at vertices of one translucent block: without an
 * eye max(0, mean * (multiple + single[0])). PROTOCOL.md has the formula towards an eye. */
struct relight_outgoing {
    float eta, roughness;
    float mean;       /* of the outgoing Fresnel transmittance, over divisor; 1 for one term */
    float divisor;    /* of the Fresnel transmittance towards an eye */
    float view_slope; /* single scattering towards an eye: 1 + view_slope (1 - cosine inside) */
};
/* Returns 0 and the values of a block of the geometry, or -RELIGHT_E_ARGUMENT where colours
 * are finished (neither coefficients nor parts) or there is no such block.
 * Thread-safety: Safe. Does not block. */
int relight_colors_outgoing(const struct relight_colors *colors, size_t block,
                            struct relight_outgoing *out);

/* Multiplies a plane of coefficients with U.
 * n_phase: of single scattering, at most RELIGHT_MOST_PHASES; 0: single may be NULL.
 * multiple [n_vertex][3], single [n_phase][n_vertex][3]: sums before everything that
 * relight_outgoing describes, overwritten, in the order of relight_geometry.
 * Returns 0. -RELIGHT_E_MISMATCH: the factors are of another bake: fetch them again.
 * -RELIGHT_E_ARGUMENT: another format, or no such plane.
 * Thread-safety: Safe. Does not block. */
int relight_coefficients_expand(const struct relight_factors *factors,
                                const struct relight_colors *colors, uint32_t plane,
                                uint32_t n_phase, float *multiple, float *single,
                                struct relight_error *error);

/* Multiplies the planes of exit of a plane of coefficients with U.
 * exits [RELIGHT_EXIT_PLANES][n_vertex][3], overwritten: the P_k of PROTOCOL.md; 0 where the
 * coefficients have none.
 * Returns as relight_coefficients_expand.
 * Thread-safety: Safe. Does not block. */
int relight_coefficients_exits(const struct relight_factors *factors,
                               const struct relight_colors *colors, uint32_t plane,
                               float *exits, struct relight_error *error);

/* The colours that the daemon would have sent, without an eye, to 0.1 % (RMS).
 * block [n_block]: of relight_geometry or relight_info. out [n_vertex][3]: linear RGB radiance.
 * Returns as relight_coefficients_expand. Thread-safety: Safe. Does not block. */
int relight_coefficients_colors(const struct relight_factors *factors,
                                const struct relight_colors *colors, uint32_t plane,
                                size_t n_block, const struct relight_block *block, float *out,
                                struct relight_error *error);

struct relight_image_request {
    const char *model;
    size_t n_light;
    const struct relight_light *lights; /* summed; the first is the background */
    struct relight_shade shade;
    struct relight_picture picture;
    enum relight_priority priority;
    const char *pose; /* of relight_put_pose; NULL: the model's vertices as they are */
};
struct relight_image {
    uint32_t width, height;
    enum relight_image_format format;
    struct relight_camera camera; /* used */
    uint64_t generation, n_byte;
    const void *data; /* encoded file, or raw pixels */
    /* Of the file that the picture was made from, as in struct relight_model; "": not known. A
     * decision that has them as `drawn` is refused once the model has another file. */
    const char *mesh_hash, *bake_hash;
    struct relight_cost cost;
    void *owner;
};

/* Asks for a picture. The lights are summed; the first is seen in the background.
 * Returns 0 and *out, to be freed by relight_image_finish; otherwise as relight_colors. A
 * model whose bake is not there is drawn by an image-space engine, and out->cost.note says
 * so.
 * Thread-safety: Safe. Blocks until the answer is here. */
int relight_image(struct relight_client *client, const struct relight_image_request *request,
                  struct relight_image *out, struct relight_error *error);

/* Sends the request of relight_image without waiting for its answer; as
 * relight_colors_begin. */
int relight_image_begin(struct relight_client *client,
                        const struct relight_image_request *request, double timeout_s,
                        uint64_t *id, struct relight_error *error);

/* Waits for the answer of a relight_image_begin; as relight_colors_end. */
int relight_image_end(struct relight_client *client, uint64_t id, struct relight_image *out,
                      struct relight_error *error);

/* Frees what relight_image put into *image. Thread-safety: Safe for different structs. Does
 * not block. */
void relight_image_finish(struct relight_image *image);

/* Turns n halves into floats. Thread-safety: Safe. Does not block. */
void relight_decode_f16(const uint16_t *in, size_t n, float *out);

/* Turns n colours in RGB9E5 (R in bits 0-8, G 9-17, B 18-26, exponent 27-31) into linear
 * RGB, out [n][3].
 * Thread-safety: Safe. Does not block. */
void relight_decode_rgb9e5(const uint32_t *in, size_t n, float *out);

/* Turns n colours, in [n][4] sRGB bytes, into linear RGB in [0,1], out [n][3]; the fourth
 * byte is ignored.
 * Thread-safety: Safe. Does not block. */
void relight_decode_srgb8(const uint8_t *in, size_t n, float *out);

/* Views: state that frames follow, latest wins. */

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
    uint32_t max_fps, window; /* window: most frames on the way, up to 256; 0: 2 */
    uint64_t window_bytes;    /* a frame waits while frames on the way take more; 0: no limit */
    uint32_t frame_deadline_ms; /* a frame that takes longer is RELIGHT_E_DEADLINE; 0: none */
    enum relight_priority priority;
    bool skip_equal;    /* frames equal to the one before come without their contents */
    uint32_t most_rank; /* as in relight_colors_request */
    bool phases, exits;
    bool coarse; /* the client has relight_coarse_order: while its link is slow and the state
                    moves, colours may be of fewer vertices */
    const char *pose; /* of relight_put_pose; NULL: the model's vertices as they are */
};
struct relight_frame_out {
    uint64_t frame, sequence, skipped; /* skipped: frames received and dropped before this */
    uint64_t hash;                     /* of colours or picture: equal hashes, equal bytes */
    bool
        equal; /* skip_equal: as the frame before, which `skipped` may count; nothing is here */
    bool has_colors, has_image;
    struct relight_colors colors;
    struct relight_image image;
    void *owner;
};

/* Opens a view: a state on the daemon that frames follow. The newest state wins; states that
 * were
 * overtaken are never drawn. request: the first state; nothing of it is kept.
 * Returns 0 and *out, which the caller gives to relight_view_close before it closes the
 * client, once the request is sent. An error of the daemon, such as a model that is not there,
 * is what the first relight_view_next returns.
 * Thread-safety: Safe. Blocks only while the socket is full. */
int relight_view_open(struct relight_client *client, const struct relight_view_request *request,
                      struct relight_view **out, struct relight_error *error);

/* Changes the state of a view.
 * n_light 0, shade NULL, picture NULL: that part stays as it is. *sequence: the number of
 * this state, which frames repeat; NULL is allowed.
 * Returns 0 once it is sent; a state that cannot be drawn is the error of a later
 * relight_view_next. -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Safe. Blocks only while the socket is full. */
int relight_view_set(struct relight_view *view, size_t n_light,
                     const struct relight_light *lights, const struct relight_shade *shade,
                     const struct relight_picture *picture, uint64_t *sequence,
                     struct relight_error *error);

/* Changes named fields of a view's state; all others stay. A slider step sends its one number.
 * fields [n_field]: names as in relight.proto, ViewState.fields: "shade.material",
 * "shade.materials", "lights.rotate_deg", "picture.camera", "options.max_fps"; "lights" with
 * n_light 0 removes all lights. values: where the fields' new values are; a field that is zero
 * there takes its default. With "lights.rotate_deg" and "lights.gain" the lights of
 * values need no environment. model and colors are ignored. *sequence as in relight_view_set.
 * Returns 0 once it is sent. -RELIGHT_E_ARGUMENT, -RELIGHT_E_DISCONNECTED. A name that the
 * daemon does not have changes nothing, and no frame follows.
 * Thread-safety: Safe. Blocks only while the socket is full. */
int relight_view_change(struct relight_view *view, const struct relight_view_request *values,
                        size_t n_field, const char *const *fields, uint64_t *sequence,
                        struct relight_error *error);

/* Waits for a frame and takes the newest; older ones that wait are dropped and counted in
 * `skipped`.
 * Returns 0 and *out, to be freed by relight_frame_out_finish. -RELIGHT_E_TIMEOUT after
 * timeout_s: the view stays usable. A state that could not be drawn returns its own error;
 * the view stays open.
 * Thread-safety: one thread a view. Blocks for timeout_s at most. */
int relight_view_next(struct relight_view *view, double timeout_s,
                      struct relight_frame_out *out, struct relight_error *error);

/* Frees what relight_view_next put into *frame. Thread-safety: Safe for different structs.
 * Does not block. */
void relight_frame_out_finish(struct relight_frame_out *frame);

/* Closes a view and frees it, whatever the daemon answers.
 * *frames: frames sent; *dropped: states that were never drawn; NULL is allowed for both.
 * Returns 0, or -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Unsafe: no other call may be running on the view. Blocks for a round trip. */
int relight_view_close(struct relight_view *view, uint64_t *frames, uint64_t *dropped,
                       struct relight_error *error);

/* Tokens: the rights of clients. These calls need the scope admin. */

enum { RELIGHT_SECRET = 128 }; /* bytes of a token's text, with the end */

/* In place of the daemon's limits for one client; 0: those. */
struct relight_quotas {
    double rate;                           /* requests a second */
    uint64_t connections, requests, views; /* open at once */
    uint64_t memory;                       /* bytes held by requests and views */
    uint64_t output;                       /* bytes of answers not yet read */
    uint64_t bakes, uploads, models;
    uint64_t disk; /* bytes */
};

struct relight_token_order {
    const char *name;         /* 1 to 63 letters, digits, dots, hyphens and underscores */
    const char *const *scope; /* [n_scope] of "view", "edit", "upload", "admin" */
    size_t n_scope;
    uint64_t lifetime_s; /* from now; 0: it does not expire */
    struct relight_quotas quotas;
};

/* Creates a token.
 * Returns 0 and its text in secret, the only time that it exists; it is valid at once, for
 * relight_options.token. From the first token on, TCP, HTTP and WebSocket clients need one.
 * -RELIGHT_E_FORBIDDEN: the scope admin is missing, or one of those to be given.
 * -RELIGHT_E_BAD_REQUEST: the name is in use. -RELIGHT_E_OUT_OF_RANGE: a bad name, scope or
 * quota.
 * Thread-safety: Safe. Blocks until the daemon has it on disk. */
int relight_token_create(struct relight_client *client, const struct relight_token_order *order,
                         char secret[RELIGHT_SECRET], struct relight_error *error);

struct relight_token {
    const char *name, *by;    /* by: the principal that created it */
    const char *const *scope; /* [n_scope] */
    size_t n_scope;
    uint64_t created_s, expires_s; /* since 1970; expires_s 0: never */
    uint32_t connections;          /* open now */
    struct relight_quotas quotas;
};
struct relight_tokens {
    size_t n_token;
    const struct relight_token *token;
    void *owner;
};

/* Lists the tokens, expired ones included, in the order of their creation.
 * Returns 0 and *out, to be freed by relight_tokens_finish. -RELIGHT_E_FORBIDDEN.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_token_list(struct relight_client *client, struct relight_tokens *out,
                       struct relight_error *error);

/* Frees what relight_token_list put into *tokens. Thread-safety: Safe for different structs.
 * Does not block. */
void relight_tokens_finish(struct relight_tokens *tokens);

/* Revokes a token; its connections are closed within a second.
 * Returns 0 and their number in *connections (NULL is allowed). -RELIGHT_E_NOT_FOUND,
 * -RELIGHT_E_FORBIDDEN.
 * Thread-safety: Safe. Blocks until the daemon has it on disk. */
int relight_token_revoke(struct relight_client *client, const char *name, uint32_t *connections,
                         struct relight_error *error);

struct relight_link {
    const char *url;    /* path and query: put it behind the address of the daemon's HTTP */
    uint64_t expires_s; /* since 1970 */
    void *owner;
};
/* Signs a link to a picture with this client's token, for viewers that have none.
 * url: path and query of GET /v1/models/MODEL/image.ENDING. lifetime_s: from now, at most 366
 * days; 0: one day.
 * Returns 0 and *out, to be freed by relight_link_finish. The link ends at expires_s, and when
 * the token is revoked or expires. -RELIGHT_E_FORBIDDEN: the client has no token.
 * -RELIGHT_E_BAD_REQUEST: not such a path. -RELIGHT_E_OUT_OF_RANGE.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_sign(struct relight_client *client, const char *url, uint64_t lifetime_s,
                 struct relight_link *out, struct relight_error *error);

/* Frees what relight_sign put into *link. Thread-safety: Safe for different structs. Does not
 * block. */
void relight_link_finish(struct relight_link *link);

/* Events. */

/* Numbers of relight.proto's EventKind; later daemons may send others. */
enum relight_event_kind {
    RELIGHT_EVENT_NONE, /* a note: only `lost` and the cursor mean something */
    RELIGHT_EVENT_MODEL_ADDED,
    RELIGHT_EVENT_MODEL_CHANGED,
    RELIGHT_EVENT_MODEL_REPLACED,
    RELIGHT_EVENT_MODEL_REMOVED,
    RELIGHT_EVENT_JOB,
    RELIGHT_EVENT_ENVIRONMENT_ADDED
};
/* Where a reader of events is; all zero: from now on. */
struct relight_cursor {
    char run[24];
    uint64_t sequence;
};
struct relight_event {
    int kind;         /* enum relight_event_kind, or a later one */
    bool lost;        /* events before this one are gone: list models again */
    uint64_t time_us; /* since 1970; 0 for notes */
    const char *model, *before, *name, *env, *job, *stage,
        *failure; /* "" where they do not apply */
    enum relight_model_state state;
    uint64_t generation;
    enum relight_job_state job_state;
    double fraction, eta_s;
};
/* Returns a kind's words ("model added"), never NULL. Thread-safety: Safe. Does not block. */
const char *relight_event_name(int kind);
/* Non-zero ends relight_events. Called on its thread; the event lives until it returns. */
typedef int (*relight_event_fn)(void *user, const struct relight_event *event);

/* Follows the daemon's events: models, bakes, uploads of this client.
 * cursor: where to begin; it follows every event, so that a program that stores it continues
 * after a restart of its own, of the connection or of the daemon. NULL: from now on. wait_s:
 * longest time without an event after which the call ends; < 0: no limit. With
 * relight_options.reconnect_s it outlives the connection. Returns 0 when fn returned non-zero
 * or wait_s passed, else why it ended. Thread-safety: Safe. Blocks. */
int relight_events(struct relight_client *client, struct relight_cursor *cursor, double wait_s,
                   relight_event_fn fn, void *user, struct relight_error *error);

/* Numbers of a medium. */
struct relight_medium {
    const char *json;           /* its whole text, for `material` of requests */
    bool profile;               /* it has a diffuse profile of its own; the numbers are those of
                                   the dipole medium nearest to it */
    float reflectance[3];       /* [0,1], of a half-space under even light */
    float mean_free_path_mm[3]; /* 1 / (sigma_s' + sigma_a) */
    float sigma_t[3];           /* [mm^-1] sigma_s' / (1 - g) + sigma_a */
    float g[3], eta, roughness;
    size_t n_warning; /* one for each property of the file that the medium does not keep */
    const char *const *warning;
    void *owner;
};
/* Asks for the numbers of a preset or of a material's JSON text. Returns 0 and *out, to be
 * freed by relight_medium_finish. -RELIGHT_E_OUT_OF_RANGE. Thread-safety: Safe. Blocks. */
int relight_material(struct relight_client *client, const char *material,
                     struct relight_medium *out, struct relight_error *error);
/* The same of a file of another program: MaterialX, Blender's Principled as JSON, pbrt's named
 * media. path: it is uploaded unless the daemon has it. name: of one of its materials, or the
 * unique beginning of one; NULL where one alone has a medium.
 * Returns as relight_material, or as relight_upload_file. Thread-safety: Safe. Blocks. */
int relight_material_file(struct relight_client *client, const char *path, const char *name,
                          struct relight_medium *out, struct relight_error *error);
/* Frees what relight_material put into *medium. Thread-safety: Safe for different structs. Does
 * not block. */
void relight_medium_finish(struct relight_medium *medium);

/* Review rooms. */

/* Scenes, actions, states and events of rooms are JSON texts with the field names of
 * relight.proto (Scene, RoomAction, RoomState, RoomEvents, Presence). An enum's value is its
 * name without the first word, in lower case: "reviewer". */
enum { RELIGHT_ROOM = 33 }; /* bytes of a room's id, with the end */

/* Creates a room; the caller is its owner.
 * scene: JSON of a Scene, NULL for none. me: display name. Returns 0 and the room's id.
 * -RELIGHT_E_LIMIT, -RELIGHT_E_FORBIDDEN without the scope edit.
 * Thread-safety: Safe. Blocks until the daemon has it on disk. */
int relight_room_create(struct relight_client *client, const char *name, const char *scene,
                        const char *me, char room[RELIGHT_ROOM], struct relight_error *error);

/* Lists the rooms that the caller may see: JSON of RoomListAnswer, to be freed with free().
 * Thread-safety: Safe. Blocks. */
int relight_room_list(struct relight_client *client, char **json, struct relight_error *error);

struct relight_room_info {
    uint64_t sequence; /* of the newest event */
    int role;          /* the caller's: 1 viewer, 2 reviewer, 3 owner */
    char hash[65];     /* SHA-256 of the state: equal on every replica */
};
/* Fetches a room's state: JSON of RoomState, to be freed with free(). info may be NULL.
 * -RELIGHT_E_NOT_FOUND also for a room that the caller may not see.
 * Thread-safety: Safe. Blocks. */
int relight_room_state(struct relight_client *client, const char *room, char **json,
                       struct relight_room_info *info, struct relight_error *error);

/* Fetches events after this sequence, some 4 MiB of them: JSON of RoomEvents, to be freed with
 * free(). *last: sequence of the last one, 0 when there are no more.
 * Thread-safety: Safe. Blocks. */
int relight_room_log(struct relight_client *client, const char *room, uint64_t after,
                     char **json, uint64_t *last, struct relight_error *error);

struct relight_room_edited {
    uint64_t sequence; /* of the event; also the id of the item it made */
    uint64_t time_us;
    bool repeated;               /* an earlier try had done it */
    char secret[RELIGHT_SECRET]; /* of an invitation: the guest's token */
};
/* Acts in a room. action: JSON of a RoomAction, such as {"undo":{}}. me: display name. out may
 * be NULL. With relight_options.reconnect_s an edit whose connection was lost is sent again,
 * and done once. Returns 0 when the event is on the daemon's disk; -RELIGHT_E_ARGUMENT for JSON
 * that is no action, -RELIGHT_E_FORBIDDEN for a role that may not, -RELIGHT_E_MISMATCH for a
 * conflict, -RELIGHT_E_LIMIT.
 * Thread-safety: Safe; edits of one process wait for each other. Blocks. */
int relight_room_edit(struct relight_client *client, const char *room, const char *action,
                      const char *me, struct relight_room_edited *out,
                      struct relight_error *error);

/* Sends an edit without waiting until it is on the disk, for changes that follow one another
 * quickly. It is not sent again when the connection is lost.
 * Returns 0 and a number in *id, which must be given to relight_room_edit_end exactly once.
 * -RELIGHT_E_ARGUMENT, -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Safe; waits for an edit of relight_room_edit. Blocks only while the socket is
 * full. */
int relight_room_edit_begin(struct relight_client *client, const char *room, const char *action,
                            const char *me, uint64_t *id, struct relight_error *error);

/* Waits for the answer of a relight_room_edit_begin. Returns as relight_room_edit; id is used
 * up either way. Thread-safety: Safe, each id on one thread. Blocks until the answer is here.
 */
int relight_room_edit_end(struct relight_client *client, uint64_t id,
                          struct relight_room_edited *out, struct relight_error *error);

/* The `client` of this process's events (RoomEvent): 16 hex digits, "" where the system gives
 * no random numbers. Returns a pointer that lives for ever. Thread-safety: Safe. Does not
 * block. */
const char *relight_room_author(void);

/* Which scene of a room: one of pin, decision and revision, none for the scene as it is. */
struct relight_room_view {
    uint64_t pin, decision;
    uint32_t revision, width, height; /* width, height: 0: as it was seen */
    enum relight_image_format format; /* JPEG stands for PNG16 */
};
/* Draws a scene that the room keeps. Of a pin or a decision the same build of the daemon gives
 * the same bytes. Returns 0 and *out, to be freed by relight_image_finish.
 * Thread-safety: Safe. Blocks. */
int relight_room_picture(struct relight_client *client, const char *room,
                         const struct relight_room_view *view, struct relight_image *out,
                         struct relight_error *error);

/* Copies all rooms of the daemon into a file that relightd --rooms opens. size, fn: may be
 * NULL. -RELIGHT_E_FORBIDDEN without the scope admin. On an error a file of that name stays.
 * Thread-safety: Safe. Blocks. */
int relight_room_backup(struct relight_client *client, const char *path, relight_progress_fn fn,
                        void *user, uint64_t *size, struct relight_error *error);

enum relight_room_news {
    RELIGHT_ROOM_STATE,   /* JSON of RoomState, which replaces earlier state */
    RELIGHT_ROOM_EVENTS,  /* JSON of RoomEvents */
    RELIGHT_ROOM_PRESENCE /* JSON of Presence: participants that are new, changed or gone */
};
/* Non-zero ends relight_room_follow. The text lives until it returns. */
typedef int (*relight_room_fn)(void *user, enum relight_room_news news, const char *json);

/* Takes a seat in a room and follows it.
 * after: sequence of the last event that the caller has, 0 or NULL to get the state first; it
 * follows every event. wait_s: longest time without news after which the call ends; < 0: no
 * limit. With relight_options.reconnect_s it outlives the connection. Returns 0 when fn
 * returned non-zero or wait_s passed. Thread-safety: Safe. Blocks. */
int relight_room_follow(struct relight_client *client, const char *room, const char *me,
                        uint64_t *after, double wait_s, relight_room_fn fn, void *user,
                        struct relight_error *error);

/* Says what others see of this process in a room that a thread of it follows: JSON of
 * Participant, such as {"name":"Ann","hand":{"lights":[…]},"hand_parts":["lights"]} while a
 * hand moves a part of the scene. The newest counts; nothing is stored, and what the role does
 * not allow is dropped. Returns 0 when it is sent; -RELIGHT_E_NOT_FOUND while no
 * relight_room_follow has its seat; -RELIGHT_E_ARGUMENT, -RELIGHT_E_DISCONNECTED.
 * Thread-safety: Safe. Blocks only while the socket is full. */
int relight_room_present(struct relight_client *client, const char *room,
                         const char *participant, struct relight_error *error);

/* Statistics. */

struct relight_metric {
    const char *name, *help;
    double value;
};
struct relight_stats {
    size_t n_metric;
    const struct relight_metric *metric;
    void *owner;
};

/* Fetches the daemon's counters, those of /metrics.
 * Returns 0 and *out, to be freed by relight_stats_finish.
 * Thread-safety: Safe. Blocks for a round trip. */
int relight_stats(struct relight_client *client, struct relight_stats *out,
                  struct relight_error *error);

/* Frees what relight_stats put into *stats. Thread-safety: Safe for different structs. Does
 * not block. */
void relight_stats_finish(struct relight_stats *stats);

#if defined(__GNUC__)
#pragma GCC visibility pop
#endif
#ifdef __cplusplus
}
#endif
#endif
