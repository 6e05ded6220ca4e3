// SPDX-License-Identifier: MIT
// Frames: names and messages of types, packing, and parsing of whole frames.
#include "frame.h"

#include "frame_private.h"
#include "relight.pb-c.h"

#include <stdlib.h>
#include <string.h>

static const struct {
    const char *name;
    const ProtobufCMessageDescriptor *request, *answer;
} kinds[] = {
#define X(name, number, request, answer) \
    [number] = {#name, &relight__##request##__descriptor, &relight__##answer##__descriptor},
    RELIGHT_TYPE_LIST(X)
#undef X
};
enum { N_KIND = sizeof kinds / sizeof *kinds };

const char *relight_type_name(uint16_t type)
{
    if (type == RELIGHT_TYPE_ERROR) return "ERROR";
    if (type == RELIGHT_TYPE_GOAWAY) return "GOAWAY";
    unsigned number = type & ~RELIGHT_TYPE_ANSWER;
    return number < N_KIND && kinds[number].name ? kinds[number].name : "unknown";
}

const ProtobufCMessageDescriptor *relight_type_message(uint16_t type)
{
    if (type == RELIGHT_TYPE_ERROR) return &relight__error__descriptor;
    if (type == RELIGHT_TYPE_GOAWAY) return &relight__goaway__descriptor;
    unsigned number = type & ~RELIGHT_TYPE_ANSWER;
    if (number >= N_KIND) return NULL;
    return type & RELIGHT_TYPE_ANSWER ? kinds[number].answer : kinds[number].request;
}

const char *relight_frame_fault_text(int fault)
{
    switch (fault) {
#define X(name, code, text) \
    case code:              \
        return text;
        RELIGHT_FRAME_FAULT_LIST(X)
#undef X
    default:
        return "no fault";
    }
}

// Byte by byte: the format is little-endian on every machine, and compilers see one load or
// store.
static void put(uint8_t *p, uint64_t value, unsigned n)
{
    for (unsigned i = 0; i < n; i++) p[i] = (uint8_t)(value >> 8 * i);
}

static uint64_t get(const uint8_t *p, unsigned n)
{
    uint64_t value = 0;
    for (unsigned i = 0; i < n; i++) value |= (uint64_t)p[i] << 8 * i;
    return value;
}

size_t relight_frame_prefix_size(uint32_t header_size, uint64_t payload_size)
{
    size_t size = RELIGHT_FRAME_FIXED + (size_t)header_size;
    if (!payload_size) return size;
    return (size + RELIGHT_FRAME_ALIGN - 1) / RELIGHT_FRAME_ALIGN * RELIGHT_FRAME_ALIGN;
}

void relight_frame_put_fixed(const struct relight_frame *frame,
                             uint8_t out[RELIGHT_FRAME_FIXED])
{
    put(out, RELIGHT_FRAME_MAGIC, 4);
    put(out + 4, RELIGHT_PROTOCOL_VERSION, 1);
    put(out + 5, frame->flags, 1);
    put(out + 6, frame->type, 2);
    put(out + 8, frame->id, 8);
    put(out + 16, frame->header_size, 4);
    put(out + 20, frame->deadline_ms, 4);
    put(out + 24, frame->payload_size, 8);
}

int relight_frame_get_fixed(const uint8_t *p, const struct relight_frame_limits *limits,
                            struct relight_frame *out)
{
    if (get(p, 4) != RELIGHT_FRAME_MAGIC) return RELIGHT_FAULT_MAGIC;
    if (p[4] != RELIGHT_PROTOCOL_VERSION) return RELIGHT_FAULT_VERSION;
    uint8_t known = RELIGHT_FRAME_LAST | (limits->whole ? 0 : RELIGHT_FRAME_MORE);
    if (p[5] & ~(known | RELIGHT_FRAME_IGNORABLE)) return RELIGHT_FAULT_FLAGS;
    *out = (struct relight_frame){.flags = p[5] & known,
                                  .type = (uint16_t)get(p + 6, 2),
                                  .id = get(p + 8, 8),
                                  .header_size = (uint32_t)get(p + 16, 4),
                                  .deadline_ms = (uint32_t)get(p + 20, 4),
                                  .payload_size = get(p + 24, 8)};
    if (out->header_size > limits->max_header) return RELIGHT_FAULT_HEADER;
    if (out->payload_size > limits->max_payload || out->payload_size > SIZE_MAX / 2)
        return RELIGHT_FAULT_PAYLOAD;
    return 0;
}

int relight_frame_check_padding(const uint8_t *bytes, size_t begin, size_t end)
{
    for (size_t i = begin; i < end; i++)
        if (bytes[i]) return RELIGHT_FAULT_PADDING;
    return 0;
}

int relight_frame_pack(struct relight_frame *frame, const ProtobufCMessage *message,
                       size_t lead, size_t room, uint8_t **out, size_t *size)
{
    size_t header = message ? protobuf_c_message_get_packed_size(message) : 0, total;
    if (header > UINT32_MAX / 2) return -1;
    frame->header_size = (uint32_t)header;
    size_t prefix = relight_frame_prefix_size(frame->header_size, frame->payload_size);
    if (__builtin_add_overflow(lead, prefix, &total) ||
        __builtin_add_overflow(total, room, &total))
        return -1;
    uint8_t *bytes = malloc(total);
    if (!bytes) return -1;
    relight_frame_put_fixed(frame, bytes + lead);
    if (message) protobuf_c_message_pack(message, bytes + lead + RELIGHT_FRAME_FIXED);
    size_t used = RELIGHT_FRAME_FIXED + header;
    memset(bytes + lead + used, 0, prefix - used);
    *out = bytes;
    *size = prefix;
    return 0;
}

int relight_frame_parse(const void *data, size_t n, const struct relight_frame_limits *limits,
                        struct relight_frame *out)
{
    const uint8_t *bytes = data;
    struct relight_frame frame;
    if (n < RELIGHT_FRAME_FIXED) return RELIGHT_FAULT_SHORT;
    int fault = relight_frame_get_fixed(bytes, limits, &frame);
    if (fault) return fault;
    size_t prefix = relight_frame_prefix_size(frame.header_size, frame.payload_size);
    if (n < prefix || n - prefix < frame.payload_size) return RELIGHT_FAULT_SHORT;
    if (n - prefix > frame.payload_size) return RELIGHT_FAULT_LONG;
    fault = relight_frame_check_padding(bytes, RELIGHT_FRAME_FIXED + (size_t)frame.header_size,
                                        prefix);
    if (fault) return fault;
    frame.header = bytes + RELIGHT_FRAME_FIXED;
    // The caller's bytes; frame.payload is only writable when they are.
    frame.payload = frame.payload_size ? (uint8_t *)(uintptr_t)(bytes + prefix) : NULL;
    *out = frame;
    return 0;
}

ProtobufCMessage *relight_frame_unpack(const struct relight_frame *frame)
{
    const ProtobufCMessageDescriptor *descriptor = relight_type_message(frame->type);
    if (!descriptor) return NULL;
    static const uint8_t empty[1];
    return protobuf_c_message_unpack(descriptor, NULL, frame->header_size,
                                     frame->header ? frame->header : empty);
}
