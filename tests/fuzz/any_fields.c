// SPDX-License-Identifier: MIT
#include "any_fields.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_ENTRIES = 3, MOST_DEPTH = 4 };

static ProtobufCMessage *fill(struct rnd *r, const ProtobufCMessageDescriptor *type, int depth);

static size_t size_of(ProtobufCType type)
{
    switch (type) {
    case PROTOBUF_C_TYPE_SINT64:
    case PROTOBUF_C_TYPE_SFIXED64:
    case PROTOBUF_C_TYPE_INT64:
    case PROTOBUF_C_TYPE_UINT64:
    case PROTOBUF_C_TYPE_FIXED64:
    case PROTOBUF_C_TYPE_DOUBLE:
        return 8;
    case PROTOBUF_C_TYPE_BOOL:
        return sizeof(protobuf_c_boolean);
    case PROTOBUF_C_TYPE_STRING:
    case PROTOBUF_C_TYPE_MESSAGE:
        return sizeof(void *);
    case PROTOBUF_C_TYPE_BYTES:
        return sizeof(ProtobufCBinaryData);
    default:
        return 4;
    }
}

static char *any_text(struct rnd *r)
{
    static const char *const texts[] = {"",   "a", "bunny",          "../a",      "name:studio",
                                        "{}", "ä", "constant:1,2,3", "/v1/models"};
    return strdup(RND_PICK(r, texts));
}

static uint64_t any_whole(struct rnd *r)
{
    static const uint64_t odd[] = {0, 1, 2, 255, 65535, INT32_MAX, UINT32_MAX, UINT64_MAX};
    return rnd_chance(r, 2) ? rnd(r, 40) : RND_PICK(r, odd);
}

static double any_real(struct rnd *r)
{
    static const double odd[] = {0, -1, 1, 0.5, 1e-30, 1e30, -INFINITY, NAN};
    return rnd_chance(r, 2) ? (double)rnd(r, 1000) * 0.01 : RND_PICK(r, odd);
}

static void set(struct rnd *r, const ProtobufCFieldDescriptor *field, void *to, int depth)
{
    const ProtobufCEnumDescriptor *words = field->descriptor;
    const uint64_t whole = any_whole(r);
    const double real = any_real(r);
    const float single = (float)real;
    const protobuf_c_boolean flag = (protobuf_c_boolean)rnd(r, 2);
    const ProtobufCMessageDescriptor *type = field->descriptor;
    switch (field->type) {
    case PROTOBUF_C_TYPE_DOUBLE:
        memcpy(to, &real, 8);
        break;
    case PROTOBUF_C_TYPE_FLOAT:
        memcpy(to, &single, 4);
        break;
    case PROTOBUF_C_TYPE_BOOL:
        memcpy(to, &flag, sizeof flag);
        break;
    case PROTOBUF_C_TYPE_ENUM:
        memcpy(to, &words->values[rnd(r, words->n_values)].value, 4);
        break;
    case PROTOBUF_C_TYPE_STRING:
        *(char **)to = any_text(r);
        break;
    case PROTOBUF_C_TYPE_BYTES: {
        ProtobufCBinaryData *bytes = to;
        bytes->len = rnd(r, 40);
        bytes->data = calloc(1, bytes->len + 1);
        break;
    }
    case PROTOBUF_C_TYPE_MESSAGE:
        *(ProtobufCMessage **)to = fill(r, type, depth + 1);
        break;
    default:
        memcpy(to, &whole, size_of(field->type));
        break;
    }
}

static void fill_list(struct rnd *r, const ProtobufCFieldDescriptor *field, char *message,
                      int depth)
{
    const size_t n = rnd(r, MOST_ENTRIES + 1), size = size_of(field->type);
    char *entries = n ? calloc(n, size) : NULL;
    if (!entries) return;
    for (size_t i = 0; i < n; i++) set(r, field, entries + i * size, depth);
    memcpy(message + field->quantifier_offset, &n, sizeof n);
    memcpy(message + field->offset, &entries, sizeof entries);
}

static ProtobufCMessage *fill(struct rnd *r, const ProtobufCMessageDescriptor *type, int depth)
{
    ProtobufCMessage *message = calloc(1, type->sizeof_message);
    char *at = (char *)message;
    if (!message) return NULL;
    protobuf_c_message_init(type, message);
    const uint64_t seed = rnd_bits(r);
    for (unsigned i = 0; i < type->n_fields; i++) {
        const ProtobufCFieldDescriptor *field = &type->fields[i];
        struct rnd own; // a field that is added later leaves the others as they are
        rnd_seed(&own, seed + field->id);
        const bool inner = field->type == PROTOBUF_C_TYPE_MESSAGE;
        if ((inner && depth >= MOST_DEPTH) || rnd_chance(&own, 4)) continue;
        if (field->label == PROTOBUF_C_LABEL_REPEATED) {
            fill_list(&own, field, at, depth);
            continue;
        }
        set(&own, field, at + field->offset, depth);
        if (field->label == PROTOBUF_C_LABEL_OPTIONAL && !inner &&
            field->type != PROTOBUF_C_TYPE_STRING)
            *(protobuf_c_boolean *)(at + field->quantifier_offset) = 1;
    }
    return message;
}

ProtobufCMessage *any_fields(struct rnd *rnd, const ProtobufCMessageDescriptor *type)
{
    return fill(rnd, type, 0);
}
