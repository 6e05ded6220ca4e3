// SPDX-License-Identifier: MIT
// Random requests that mean something: they name models, jobs, views and uploads that are
// there, or were, or never will be.
#ifndef TESTS_FUZZ_MESSAGES_H
#define TESTS_FUZZ_MESSAGES_H

#include <stddef.h>

#include "frame.h"
#include "random.h"

enum {
    WORLD_MODELS = 8,
    WORLD_JOBS = 512,
    WORLD_BLOBS = 4,
    WORLD_POSES = 8,
    WORLD_ROOMS = 4,
    MODEL_VERTICES = 21
};

struct blob {
    uint8_t bytes[4096];
    size_t n;
    char hash[65], name[16];
};

// What the fuzzer learned from answers, over all connections.
struct world {
    struct rnd *rnd;
    char model[WORLD_MODELS][32];
    unsigned n_model;
    char job[WORLD_JOBS][32];
    bool cancelled[WORLD_JOBS]; // the fuzzer asked for it
    unsigned n_job;
    char pose[WORLD_POSES][65];
    unsigned n_pose;
    struct blob blob[WORLD_BLOBS];
    char room[WORLD_ROOMS][33];
    unsigned n_room;
    uint64_t last_seed; // makes a LOAD differ from all before it
};

// The blobs: a model, a light, a picture of nothing, and noise.
void world_init(struct world *world, struct rnd *rnd);
void world_forget(struct world *world); // models and jobs: the daemon was started anew
void world_learn_model(struct world *world, const char *id);
void world_learn_pose(struct world *world, const char *name);
void world_learn_job(struct world *world, const char *id);

void world_learn_room(struct world *world, const char *id);

// A model, or a name that is none; a pose likewise.
const char *world_any_model(struct world *world);
char *world_any_pose(struct world *world);

// Lengths, counts and numbers at which somebody may have erred.
uint32_t rnd_odd(struct rnd *r);

// Frames, one behind another.
struct bytes {
    uint8_t *at;
    size_t n, room;
};
void bytes_add(struct bytes *out, const void *bytes, size_t n);

void message_emit(struct world *world, uint16_t type, uint64_t id,
                  const ProtobufCMessage *message, const void *payload, size_t n,
                  struct bytes *out);
// A message without a payload, in a function with world, id and out.
#define EMIT(NAME, message) \
    message_emit(world, RELIGHT_TYPE_##NAME, id, &(message).base, NULL, 0, out)
// One about review rooms (and MATERIAL). other: another request's id.
void message_room(struct world *world, uint16_t type, uint64_t id, uint64_t other,
                  struct bytes *out);

// One frame of a random request. ids: how many different ids a connection may have open; small
// numbers make views that others name.
void message_hello(struct world *world, uint64_t id, bool good, struct bytes *out);
uint16_t message_random(struct world *world, uint64_t id, uint32_t ids, struct bytes *out);
// LOAD_NEW_BAKE is not refused for a fault of its own and differs from all before;
// LOAD_SAME_BAKE repeats the last of those: where its bake was cancelled, another is ordered.
enum load_kind { LOAD_PREVIEW, LOAD_BAKE, LOAD_NEW_BAKE, LOAD_SAME_BAKE };
void message_load(struct world *world, uint64_t id, enum load_kind kind, struct bytes *out);
void message_cancel_job(struct world *world, uint64_t id, const char *job, struct bytes *out);
void message_upload(struct world *world, uint64_t id, unsigned blob, struct bytes *out);
// A job by chance, rather one that was not cancelled.
const char *world_job(struct world *world);

// Pieces and requests that message_random chooses from; `other` is of no use to them.
char *message_environment(struct world *world, char text[128]);
void message_colors(struct world *world, uint64_t id, uint64_t other, struct bytes *out);
void message_image(struct world *world, uint64_t id, uint64_t other, struct bytes *out);
void message_put_pose(struct world *world, uint64_t id, uint64_t other, struct bytes *out);
void message_update_vertices(struct world *world, uint64_t id, uint64_t other,
                             struct bytes *out);
void message_view_open(struct world *world, uint64_t id, uint64_t other, struct bytes *out);
void message_view_set(struct world *world, uint64_t id, uint64_t view, struct bytes *out);

#endif
