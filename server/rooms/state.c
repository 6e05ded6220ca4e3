// SPDX-License-Identifier: MIT
// Memory, hashes and searches of a room's state.
#include "rooms/state.h"

#include "frame.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void *message_copy(const void *from)
{
    const ProtobufCMessage *message = from;
    if (!message) return NULL;
    size_t n = protobuf_c_message_get_packed_size(message);
    uint8_t *bytes = malloc(n + 1);
    if (!bytes) return NULL;
    protobuf_c_message_pack(message, bytes);
    void *copy = protobuf_c_message_unpack(message->descriptor, NULL, n, bytes);
    free(bytes);
    return copy;
}

void text_free(char *text)
{
    if (text != protobuf_c_empty_string) free(text);
}

int text_set(char **to, const char *text)
{
    char *copy = *text ? strdup(text) : (char *)(uintptr_t)protobuf_c_empty_string;
    if (!copy) return RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    text_free(*to);
    *to = copy;
    return 0;
}

void *list_add(void *list, size_t *n, void *message)
{
    void ***at = list;
    void **more = message ? realloc(*at, (*n + 1) * sizeof *more) : NULL;
    if (!more) {
        if (message) protobuf_c_message_free_unpacked(message, NULL);
        return NULL;
    }
    *at = more;
    return more[(*n)++] = message;
}

void list_remove(void *list, size_t *n, size_t at)
{
    void **items = *(void ***)list;
    protobuf_c_message_free_unpacked(items[at], NULL);
    memmove(items + at, items + at + 1, (--*n - at) * sizeof *items);
}

// Field 1 of RoomEvents, length-delimited.
enum { EVENTS_TAG = 0x0a, EVENTS_LENGTH = 10 };

size_t events_room(size_t n)
{
    return 1 + EVENTS_LENGTH + n;
}

size_t events_put(uint8_t *to, const uint8_t *event, size_t n)
{
    size_t at = 0, left = n;
    to[at++] = EVENTS_TAG;
    for (; left > 127; left >>= 7) to[at++] = (uint8_t)(left | 128);
    to[at++] = (uint8_t)left;
    memcpy(to + at, event, n);
    return at + n;
}

int fold_fail(struct folding *f, int code, const char *fmt, ...)
{
    va_list ap;
    va_start(ap, fmt);
    vsnprintf(f->error, ROOM_ERROR, fmt, ap);
    va_end(ap);
    relight_utf8_cut(f->error);
    return code;
}

int fold_no_memory(struct folding *f)
{
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
}

bool is_author(const struct folding *f, const Relight__Stamp *stamp)
{
    return !strcmp(stamp->by, f->event->stamp->by) &&
           !strcmp(stamp->name, f->event->stamp->name);
}

Relight__RoomState *room_state_new(const char *room)
{
    Relight__RoomState empty = RELIGHT__ROOM_STATE__INIT;
    empty.room = (char *)(uintptr_t)room;
    return message_copy(&empty);
}

void room_state_free(Relight__RoomState *state)
{
    if (state) protobuf_c_message_free_unpacked(&state->base, NULL);
}

bool room_message_hash(const ProtobufCMessage *message, char out[65])
{
    size_t n = protobuf_c_message_get_packed_size(message);
    uint8_t *bytes = malloc(n + 1);
    struct relight_sha256 sha;
    if (!bytes) return false;
    protobuf_c_message_pack(message, bytes);
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, bytes, n);
    relight_sha256_hex(&sha, out);
    free(bytes);
    return true;
}

bool room_state_hash(const Relight__RoomState *state, char out[65])
{
    return room_message_hash(&state->base, out);
}

// Items are in the order of their sequence.
static void *by_sequence(void *const *items, size_t n, size_t stamp_at, uint64_t sequence)
{
    size_t low = 0, high = n;
    while (low < high) {
        size_t middle = low + (high - low) / 2;
        const Relight__Stamp *stamp =
            *(Relight__Stamp *const *)((const char *)items[middle] + stamp_at);
        if (stamp->sequence == sequence) return items[middle];
        if (stamp->sequence < sequence) low = middle + 1;
        else high = middle;
    }
    return NULL;
}

Relight__Pin *room_pin(const Relight__RoomState *state, uint64_t sequence)
{
    return by_sequence((void *const *)state->pins, state->n_pins, offsetof(Relight__Pin, stamp),
                       sequence);
}

Relight__Decision *room_decision(const Relight__RoomState *state, uint64_t sequence)
{
    return by_sequence((void *const *)state->decisions, state->n_decisions,
                       offsetof(Relight__Decision, stamp), sequence);
}

Relight__Revision *room_revision(const Relight__RoomState *state, uint32_t number)
{
    return number && number <= state->n_revisions ? state->revisions[number - 1] : NULL;
}
