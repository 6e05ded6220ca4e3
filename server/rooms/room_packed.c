// SPDX-License-Identifier: MIT
// The packed state of a room, once for all who want it: it may be large, and everybody who
// sits down or reconnects asks for it.
#include "rooms/room_private.h"

#include "frame.h"

#include <stdlib.h>

void shared_release(void *owner)
{
    struct shared_bytes *shared = owner;
    if (shared && !--shared->refs) free(shared);
}

struct payload shared_payload(struct shared_bytes *shared)
{
    return (struct payload){shared->bytes, shared->n, shared, shared_release};
}

void room_packed_drop(struct room *room)
{
    shared_release(room->packed);
    room->packed = NULL;
    room->packed_hash[0] = 0;
    room_memory_update(room);
}

struct shared_bytes *room_packed(struct room *room)
{
    if (!room->packed) {
        size_t n = protobuf_c_message_get_packed_size(&room->state->base);
        struct shared_bytes *packed = malloc(sizeof *packed + n);
        if (!packed) return NULL;
        packed->refs = 1;
        packed->n = n;
        protobuf_c_message_pack(&room->state->base, packed->bytes);
        room->packed = packed;
        room_memory_update(room);
    }
    room->packed->refs++;
    return room->packed;
}

const char *room_packed_hash(struct room *room)
{
    struct relight_sha256 sha;
    if (room->packed_hash[0] || !room->packed) return room->packed_hash;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, room->packed->bytes, room->packed->n);
    relight_sha256_hex(&sha, room->packed_hash);
    return room->packed_hash;
}
