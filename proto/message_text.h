/* SPDX-License-Identifier: MIT */
/* message_text.h owns the protocol's messages as JSON and as words: one translation for all of
 * them, by their descriptors. Fields have the names of relight.proto. A value of an enum is its
 * name without the enum's first word, in lower case: MODEL_READY is "ready". 64-bit numbers are
 * JSON numbers. Thread-safe. */
#ifndef RELIGHT_MESSAGE_TEXT_H
#define RELIGHT_MESSAGE_TEXT_H

#include <protobuf-c/protobuf-c.h>

#include <cjson/cJSON.h>
#include <stddef.h>

enum { MESSAGE_TEXT_ERROR = 256 };

/* The message as a JSON object, the caller's. Fields with their default value are present, but
 * for empty texts and absent messages. Texts that are JSON objects themselves
 * (material, settings, errors of ModelInfo) become objects. NULL without memory. */
cJSON *message_to_json(const ProtobufCMessage *message);

/* A message with all fields at their defaults, to be freed with
 * protobuf_c_message_free_unpacked; NULL without memory. */
ProtobufCMessage *message_new(const ProtobufCMessageDescriptor *descriptor);

/* Sets the fields that the object has. 0, or -1 with the error's text, which names the field by
 * its path ("lights[0].rotate_deg"). An object in place of a text is kept as its JSON text. */
int message_from_json(ProtobufCMessage *message, const cJSON *object,
                      char error[MESSAGE_TEXT_ERROR]);

/* Sets the field of a path like "shade.engine" from its text; of a repeated message, its first
 * one ("lights.env"), of repeated texts a further one. 0, or -1 with the error's text: the
 * values or the range that are allowed, without the field's name. */
int message_set(ProtobufCMessage *message, const char *path, const char *text,
                char error[MESSAGE_TEXT_ERROR]);

/* The word of an enum's value, in `out`; "unknown" for numbers without a name. */
void message_enum_word(const ProtobufCEnumDescriptor *descriptor, int value, char out[40]);

#endif
