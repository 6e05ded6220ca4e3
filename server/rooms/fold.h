/* SPDX-License-Identifier: MIT */
/* fold.h owns the rule by which events make a room's state: one function, used for new events,
 * at the start and by tests. It depends on the state and the event alone, so that every replica
 * that has the same events has the same state, byte for byte.
 * Thread-safety: one thread at a time for one state. */
#ifndef RELIGHTD_ROOMS_FOLD_H
#define RELIGHTD_ROOMS_FOLD_H

#include "relight.pb-c.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { ROOM_ID = 32, ROOM_ERROR = 256 }; /* hex digits; bytes */

/* Bounds of a room. What is beyond is refused with LIMIT. */
enum {
    ROOM_MAX_NAME = 120,  /* bytes */
    ROOM_MAX_PERSON = 64, /* bytes of a display name */
    ROOM_MAX_TEXT = 8192, /* bytes of a note */
    ROOM_MAX_MATERIAL = 65536 /* bytes */,
    ROOM_MAX_EVENT = 256 << 10, /* bytes */
    ROOM_MAX_PINS = 10000,
    ROOM_MAX_NOTES = 1000, /* of a pin */
    ROOM_MAX_STROKES = 5000,
    ROOM_MAX_POINTS = 2000,
    ROOM_MAX_DECISIONS = 10000,
    ROOM_MAX_REVISIONS = 10000,
    ROOM_MAX_MEMBERS = 1000,
    ROOM_MAX_INVITES = 1000,
    ROOM_MAX_VARIANTS = 1000,
    ROOM_MAX_MENTIONS = 16,
    ROOM_MAX_UNDO = 50,      /* steps of one person */
    ROOM_MAX_UNDO_ALL = 500, /* of all persons; the oldest go first */
    ROOM_MAX_CLIENTS = 256,  /* clients whose last number is remembered */
};

enum room_part {
    PART_MODEL,
    PART_LIGHTS,
    PART_MATERIAL,
    PART_SHADE,
    PART_CAMERA,
    PART_PICTURE
};
enum { ROOM_N_PART = 6 };

/* The empty state of a room, before its first event; free with room_state_free. NULL without
 * memory. */
Relight__RoomState *room_state_new(const char *room);
void room_state_free(Relight__RoomState *state); /* NULL is fine */

/* Applies an event. stamp.sequence must be the state's plus one. 0, or an error code of the
 * protocol with its text; the state is as before then, but for ERROR_NO_MEMORY, after which it
 * must be read again. The state holds copies. */
int room_fold(Relight__RoomState *state, const Relight__RoomEvent *event,
              char error[ROOM_ERROR]);

/* Whether this number of a principal's client was accepted before: the sequence of its event,
 * else 0. */
uint64_t room_done_before(const Relight__RoomState *state, const char *client, const char *by,
                          uint64_t number);

/* Role that the room's members and invitations give a principal at this time. */
int room_role(const Relight__RoomState *state, const char *by, int64_t now_s);
/* "viewer", …; "none". */
const char *room_role_word(int role);

/* SHA-256 of the packed state. False without memory. */
bool room_state_hash(const Relight__RoomState *state, char out[65]);
/* SHA-256 of any message as it is packed. False without memory. */
bool room_message_hash(const ProtobufCMessage *message, char out[65]);

/* Whether a scene is one that a room may keep: finite numbers, texts within bounds, lights
 * without texels. NULL is none. 0 or an error code. */
int room_scene_check(const Relight__Scene *scene, char error[ROOM_ERROR]);
/* Whether every number in the message is finite and no text or list is longer than any room
 * takes; error names the field. Unknown fields are a fault, too. */
bool room_message_sane(const ProtobufCMessage *message, char error[ROOM_ERROR]);

/* A pin, a decision, a revision by what identifies it; NULL when there is none. */
Relight__Pin *room_pin(const Relight__RoomState *state, uint64_t sequence);
Relight__Decision *room_decision(const Relight__RoomState *state, uint64_t sequence);
Relight__Revision *room_revision(const Relight__RoomState *state, uint32_t number);

#endif
