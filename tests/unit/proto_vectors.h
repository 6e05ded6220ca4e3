/* SPDX-License-Identifier: MIT */
/* The frames of proto/vectors: how each is made. Shared by the test that checks the files and
 * by its `--write DIR` mode that made them. */
#ifndef PROTO_VECTORS_H
#define PROTO_VECTORS_H

#include "frame.h"
#include "relight.pb-c.h"

struct vector {
    const char *name;           /* file NAME.bin */
    const char *note;           /* line of session.txt */
    struct relight_frame frame; /* flags, type, id, deadline_ms, payload_size */
    const ProtobufCMessage *message;
    const uint8_t *payload;
};

enum { MAX_VECTOR = 128 };
/* Fills vectors (static storage) and returns how many. */
unsigned vectors_make(struct vector out[MAX_VECTOR]);
/* Adds one behind n; returns n + 1. */
unsigned vector_add(struct vector *out, unsigned n, const char *name, const char *note,
                    uint16_t type, uint8_t flags, uint64_t id, const ProtobufCMessage *message,
                    const void *payload, uint64_t size);
/* A request without a payload and its answer: files NAME.bin and NAME_answer.bin; n + 2. */
unsigned vector_exchange(struct vector *out, unsigned n, const char *name, uint16_t type,
                         uint64_t id, const char *request_note, const ProtobufCMessage *request,
                         const char *answer_note, const ProtobufCMessage *answer);
/* Events and tokens, behind n; returns how many there are then. */
unsigned vectors_add_access(struct vector *out, unsigned n);
/* A signed link, likewise. */
unsigned vectors_add_link(struct vector *out, unsigned n);
/* What viewers draw with, likewise. */
unsigned vectors_add_viewers(struct vector *out, unsigned n);
/* Those of review rooms, behind n; returns how many there are then. */
unsigned vectors_add_rooms(struct vector *out, unsigned n);

#endif
