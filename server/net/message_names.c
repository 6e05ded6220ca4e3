// SPDX-License-Identifier: MIT
// Names of models, uploads and poses in a message, found by its descriptor.
#include "net/message_names.h"

#include "frame.h"

#include <stdbool.h>
#include <string.h>

enum { DEPTH = 8, ID = 32 };

static void tell_text(const char *field, const char *text, message_name_fn fn, void *user)
{
    static const char *const blobs[] = {"env",        "blob",       "hash",    "image",
                                        "albedo_map", "normal_map", "bump_map"};
    if (!text) return;
    const char *hash = strncmp(text, "env:", 4) ? text : text + 4;
    for (size_t i = 0; i < sizeof blobs / sizeof *blobs; i++)
        if (!strcmp(field, blobs[i]) && relight_hash_valid(hash)) fn(user, NAME_BLOB, hash);
    if ((!strcmp(field, "pose") || !strcmp(field, "base_pose")) && relight_hash_valid(text))
        fn(user, NAME_POSE, text);
    bool id = strlen(text) == ID && strspn(text, "0123456789abcdef") == ID;
    if (!strcmp(field, "model") || (!strcmp(field, "job") && id)) fn(user, NAME_MODEL, text);
}

static void walk(const ProtobufCMessage *message, int depth, message_name_fn fn, void *user)
{
    const char *base = (const char *)message;
    for (unsigned i = 0; depth && i < message->descriptor->n_fields; i++) {
        const ProtobufCFieldDescriptor *f = &message->descriptor->fields[i];
        bool text = f->type == PROTOBUF_C_TYPE_STRING;
        if (!text && f->type != PROTOBUF_C_TYPE_MESSAGE) continue;
        if (f->flags & PROTOBUF_C_FIELD_FLAG_ONEOF &&
            *(const uint32_t *)(base + f->quantifier_offset) != f->id)
            continue;
        bool many = f->label == PROTOBUF_C_LABEL_REPEATED;
        size_t n = many ? *(const size_t *)(base + f->quantifier_offset) : 1;
        const void *const *item = (const void *const *)(base + f->offset);
        if (many) item = *(const void *const *const *)item;
        for (size_t k = 0; k < n; k++) {
            if (text) tell_text(f->name, item[k], fn, user);
            else if (item[k]) walk(item[k], depth - 1, fn, user);
        }
    }
}

void message_names(const ProtobufCMessage *message, message_name_fn fn, void *user)
{
    walk(message, DEPTH, fn, user);
}
