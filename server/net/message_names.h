/* SPDX-License-Identifier: MIT */
/* message_names.h owns which fields of a message name what the daemon has on its disk: models,
 * uploads by their hash, and poses. Thread-safe. */
#ifndef RELIGHTD_MESSAGE_NAMES_H
#define RELIGHTD_MESSAGE_NAMES_H

#include <protobuf-c/protobuf-c.h>

enum message_name { NAME_BLOB, NAME_MODEL, NAME_POSE };
/* name: for NAME_BLOB and NAME_POSE the hash, 64 hex digits; for NAME_MODEL the field's text,
 * which may be "". */
typedef void (*message_name_fn)(void *user, enum message_name kind, const char *name);

/* Calls fn for each name in the message and the messages in it. */
void message_names(const ProtobufCMessage *message, message_name_fn fn, void *user);

#endif
