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

// malloc keeps 8 bytes beside a block, rounds up to 16, and gives no less than 32.
static size_t block_memory(size_t bytes)
{
    size_t taken = (bytes + 8 + 15) / 16 * 16;
    return !bytes ? 0 : taken < 32 ? 32 : taken;
}

static size_t value_memory(const ProtobufCFieldDescriptor *field, const void *at)
{
    if (field->type == PROTOBUF_C_TYPE_MESSAGE) return message_memory(*(void *const *)at);
    if (field->type == PROTOBUF_C_TYPE_BYTES)
        return block_memory(((const ProtobufCBinaryData *)at)->len);
    if (field->type != PROTOBUF_C_TYPE_STRING) return 0;
    const char *text = *(char *const *)at;
    return text && text != protobuf_c_empty_string ? block_memory(strlen(text) + 1) : 0;
}

static size_t value_size(ProtobufCType type)
{
    switch (type) {
    case PROTOBUF_C_TYPE_INT32:
    case PROTOBUF_C_TYPE_SINT32:
    case PROTOBUF_C_TYPE_SFIXED32:
    case PROTOBUF_C_TYPE_UINT32:
    case PROTOBUF_C_TYPE_FIXED32:
    case PROTOBUF_C_TYPE_FLOAT:
    case PROTOBUF_C_TYPE_ENUM:
    case PROTOBUF_C_TYPE_BOOL:
        return 4;
    case PROTOBUF_C_TYPE_BYTES:
        return sizeof(ProtobufCBinaryData);
    default:
        return 8;
    }
}

size_t message_memory(const void *of)
{
    const ProtobufCMessage *message = of;
    if (!message) return 0;
    const char *base = of;
    size_t sum = block_memory(message->descriptor->sizeof_message);
    for (unsigned i = 0; i < message->descriptor->n_fields; i++) {
        const ProtobufCFieldDescriptor *field = &message->descriptor->fields[i];
        const char *at = base + field->offset;
        size_t n = 1, size = value_size(field->type);
        if (field->label == PROTOBUF_C_LABEL_REPEATED) {
            n = *(const size_t *)(base + field->quantifier_offset);
            at = *(char *const *)at;
            sum += block_memory(n * size);
        }
        bool flat = size == 4 || (field->type != PROTOBUF_C_TYPE_MESSAGE &&
                                  field->type != PROTOBUF_C_TYPE_STRING &&
                                  field->type != PROTOBUF_C_TYPE_BYTES);
        for (size_t j = 0; j < n && !flat; j++) sum += value_memory(field, at + j * size);
    }
    return sum;
}

size_t event_memory(const Relight__RoomState *state, const Relight__RoomEvent *event)
{
    // Stamps of six parts before and after, a step, a client's number, mentions of a note.
    enum { BESIDE = 8192 };
    // A revision is a copy of the scene.
    return message_memory(event) + message_memory(state->scene) + BESIDE;
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
