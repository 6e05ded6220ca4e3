// SPDX-License-Identifier: MIT
// A message of any type with random fields.
#ifndef TESTS_FUZZ_ANY_FIELDS_H
#define TESTS_FUZZ_ANY_FIELDS_H

#include <protobuf-c/protobuf-c.h>

#include "frame.h"
#include "random.h"

// Every type of request, and whether it has an answer.
static const struct request_type {
    uint16_t type;
    bool answered;
} request_types[] = {
#define X(name, number, request, answer) {number, sizeof #answer != sizeof "nothing"},
    RELIGHT_TYPE_LIST(X)
#undef X
};
enum { N_REQUEST_TYPE = sizeof request_types / sizeof *request_types };

// Fields of every kind are set or left out by chance: numbers at the ends of their range and
// small ones, some text, up to three entries of a list, messages in messages to a depth of 4.
// Freed by protobuf_c_message_free_unpacked; NULL without memory.
ProtobufCMessage *any_fields(struct rnd *rnd, const ProtobufCMessageDescriptor *type);

#endif
