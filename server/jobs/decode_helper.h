/* SPDX-License-Identifier: MIT */
/* decode_helper.h owns the helper process that decodes untrusted files: a second,
 * single-threaded copy of the program that forks an isolated child for each. Pixels of an image
 * come back in a sealed memory file, the mesh of a model as a .prt without light transport,
 * which the daemon maps as it maps its bakes. The daemon parses no untrusted file and may have
 * any number of threads. */
#ifndef RELIGHTD_DECODE_H
#define RELIGHTD_DECODE_H

#include "core/loop.h"
#include "prt/light.h"
#include "prt/medium.h"

struct decoder;

/* A decoded environment; its pixels are in a read-only mapping. */
struct decoded_env {
    struct prt_env env;
    void *map;
    size_t map_bytes, cache_bytes; /* cache_bytes: of turns to cubes of sides 16 and 32 */
    bool turned_64;                /* turns to cubes of side 64 are charged, too */
    float decode_ms;
};
void decoded_env_destroy(void *env); /* struct decoded_env* */

/* env NULL: code (enum prt_status) and error have the cause. Called on the loop's thread. */
typedef void (*decode_fn)(void *user, struct decoded_env *env, int status, const char *error);

struct decoder_limits {
    uint64_t memory_bytes; /* of one decoding process */
    uint64_t
        total_bytes; /* of all together, though one always runs; 0: half of the machine's */
    uint64_t
        image_bytes; /* of an image's pixels: images that exceed the cache are not decoded */
};
/* n_crashed counts processes that ended by a signal; it outlives the decoder. */
int decoder_create(struct loop *loop, const struct decoder_limits *limits, uint64_t *n_crashed,
                   struct decoder **out);
void decoder_destroy(struct decoder *decoder);
/* Decodes the regular file at `path`, not a link; errors call it `name`. */
void decoder_env(struct decoder *decoder, const char *path, const char *name, decode_fn fn,
                 void *user);
/* The same for an image that is no environment: its pixels are returned as env.latlong. */
void decoder_image(struct decoder *decoder, const char *path, const char *name, decode_fn fn,
                   void *user);
/* How to read a model's file: the options of `prt bake`. */
struct decode_model {
    const char *path, *name; /* errors call the file `name` */
    const char *out;         /* the .prt to write */
    double size_mm, mm_per_unit;
    bool up_z, flip_v;
    const char *variant; /* "": none */
    /* As --material of `prt bake`; objects without one have the file's own, else marble. */
    size_t n_material;
    char *const *material;
    size_t n_opaque;
    char *const *opaque;
};
/* status PRT_OK: `out` was written; `warnings` has one a line. Called on the loop's thread. */
typedef void (*decode_model_fn)(void *user, int status, const char *error, const char *warnings,
                                float ms);
void decoder_model(struct decoder *decoder, const struct decode_model *model,
                   decode_model_fn fn, void *user);
/* Vertices of a model's file in a moment of an animation, in the file's unit: [n][3] positions,
 * then [n][3] normals; from a read-only mapping. */
struct decoded_pose {
    uint32_t n;
    const float *values;
    void *map;
    size_t map_bytes;
};
void decoded_pose_destroy(struct decoded_pose *pose); /* NULL is fine */
/* pose NULL: status and error have the cause; else the callee's. Called on the loop's thread.
 */
typedef void (*decode_pose_fn)(void *user, struct decoded_pose *pose, int status,
                               const char *error);
void decoder_pose(struct decoder *decoder, const char *path, const char *name,
                  const char *animation, double time_s, bool up_z, decode_pose_fn fn,
                  void *user);
/* json: a material of another program's file as JSON text; NULL: status and error have the
 * cause. `warnings` has one a line. Called on the loop's thread. */
typedef void (*decode_material_fn)(void *user, const char *json, int status, const char *error,
                                   const char *warnings);
/* material: the name of one of the file's, "" for the only one that has a medium. */
void decoder_material(struct decoder *decoder, const char *path, const char *name,
                      const char *material, decode_material_fn fn, void *user);
/* Nobody waits for the result any more. A file that was not sent to the helper yet leaves the
 * queue: fn is called with PRT_CANCELLED. Others are decoded to their end. */
void decoder_withdraw(struct decoder *decoder, const void *user);
/* A child ended; true when it was the helper (a new one starts with the next request). */
bool decoder_reap(struct decoder *decoder, int pid);

/* The helper process's main function: serves requests from `fd` until it closes. */
int decode_helper_main(int fd);

#endif
