// SPDX-License-Identifier: MIT
// Checks of a header before it is unpacked: the memory that it would take, and valid UTF-8 in
// its strings. One pass over the protobuf encoding, along the generated descriptors.
#include "frame.h"

#include "relight.pb-c.h"

#include <stdio.h>
#include <string.h>

// Bytes that protobuf-c allocates for each message or string beside its contents: the header of
// malloc and a pointer in an array.
enum { ALLOCATION = 32 };

struct walk {
    const struct relight_header_limits *limits; // NULL: none
    bool repair;
    struct relight_header_cost cost;
    char *error; // [RELIGHT_HEADER_ERROR]
};

size_t relight_utf8_next(const uint8_t *bytes, size_t n)
{
    static const uint32_t least[5] = {0, 0, 0x80, 0x800, 0x10000};
    uint8_t first = n ? bytes[0] : 0;
    if (!n) return 0;
    if (first < 0x80) return 1;
    size_t size = first >= 0xf0 ? 4 : first >= 0xe0 ? 3 : 2;
    if (first < 0xc2 || first > 0xf4 || size > n) return 0;
    uint32_t code = first & (0xffu >> (size + 1));
    for (size_t i = 1; i < size; i++) {
        if ((bytes[i] & 0xc0) != 0x80) return 0;
        code = code << 6 | (bytes[i] & 0x3f);
    }
    bool surrogate = code >= 0xd800 && code < 0xe000;
    return code < least[size] || code > 0x10ffff || surrogate ? 0 : size;
}

void relight_utf8_cut(char *text)
{
    size_t n = strlen(text), begin = n;
    while (begin > 0 && n - begin < 4 && ((uint8_t)text[begin - 1] & 0xc0) == 0x80) begin--;
    if (begin > 0 && (uint8_t)text[begin - 1] >= 0xc0) begin--;
    if (begin < n && !relight_utf8_next((const uint8_t *)text + begin, n - begin))
        text[begin] = 0;
}

static bool is_control(const uint8_t *c, size_t size)
{
    if (size == 1) return c[0] < 0x20 || c[0] == 0x7f;
    return size == 2 && c[0] == 0xc2 && c[1] < 0xa0; // C1
}

// Names come to stand in lists, logs and terminals, each on one line.
static bool is_name(const ProtobufCFieldDescriptor *field)
{
    return !strcmp(field->name, "name") || !strcmp(field->name, "client");
}

static bool refuse(struct walk *w, const char *field, const char *fault)
{
    if (w->error) snprintf(w->error, RELIGHT_HEADER_ERROR, "%s: %s", field, fault);
    return false;
}

static bool check_text(struct walk *w, const ProtobufCFieldDescriptor *field, uint8_t *bytes,
                       size_t n)
{
    bool name = is_name(field);
    for (size_t at = 0; at < n;) {
        size_t size = bytes[at] ? relight_utf8_next(bytes + at, n - at) : 0;
        if (!size && !w->repair) return refuse(w, field->name, "the text is not valid UTF-8");
        if (!size) {
            bytes[at] = '?';
            size = 1;
        }
        if (name && !w->repair && is_control(bytes + at, size))
            return refuse(w, field->name, "a name has no control characters");
        at += size;
    }
    return true;
}

// A base-128 number; false when it does not end.
static bool get_varint(const uint8_t **at, const uint8_t *end, uint64_t *out)
{
    *out = 0;
    for (unsigned shift = 0; shift < 64 && *at < end; shift += 7) {
        uint8_t byte = *(*at)++;
        *out |= (uint64_t)(byte & 127) << shift;
        if (byte < 128) return true;
    }
    return false;
}

static bool spend(struct walk *w, const char *what, size_t bytes)
{
    w->cost.items++;
    w->cost.bytes += bytes + ALLOCATION;
    if (!w->limits) return true;
    if (w->cost.items > w->limits->max_items || w->cost.bytes > w->limits->max_bytes)
        return refuse(w, what, "the header has more parts than a request may have");
    return true;
}

static bool walk_message(struct walk *w, const ProtobufCMessageDescriptor *message,
                         uint8_t *bytes, size_t n);

static bool walk_bytes(struct walk *w, const ProtobufCFieldDescriptor *field, uint8_t *bytes,
                       size_t n)
{
    if (!field) return spend(w, "unknown fields", n + sizeof(ProtobufCMessageUnknownField));
    if (field->type == PROTOBUF_C_TYPE_MESSAGE)
        return spend(w, field->name,
                     ((const ProtobufCMessageDescriptor *)field->descriptor)->sizeof_message) &&
               walk_message(w, field->descriptor, bytes, n);
    if (!spend(w, field->name, 8 * n)) return false; // packed numbers take most
    return field->type != PROTOBUF_C_TYPE_STRING || check_text(w, field, bytes, n);
}

// The schema bounds the depth: no message contains itself.
static bool walk_message(struct walk *w, const ProtobufCMessageDescriptor *message,
                         uint8_t *bytes, size_t n)
{
    static const char *const broken = "the header does not parse as this type's message";
    const uint8_t *at = bytes, *end = bytes + n;
    while (at < end) {
        uint64_t key, size = 0;
        if (!get_varint(&at, end, &key)) return refuse(w, message->short_name, broken);
        const ProtobufCFieldDescriptor *field =
            key >> 3 <= UINT32_MAX
                ? protobuf_c_message_descriptor_get_field(message, (unsigned)(key >> 3))
                : NULL;
        switch (key & 7) {
        case 0:
            if (!get_varint(&at, end, &size)) return refuse(w, message->short_name, broken);
            size = 0;
            break;
        case 1:
            size = 8;
            break;
        case 5:
            size = 4;
            break;
        case 2:
            if (get_varint(&at, end, &size)) break;
            return refuse(w, message->short_name, broken);
        default:
            return refuse(w, message->short_name, broken);
        }
        if (size > (uint64_t)(end - at)) return refuse(w, message->short_name, broken);
        uint8_t *content = bytes + (at - bytes);
        bool ok = (key & 7) == 2 ? walk_bytes(w, field, content, (size_t)size)
                                 : field || spend(w, "unknown fields", 16);
        if (!ok) return false;
        at += size;
    }
    return true;
}

bool relight_header_check(uint16_t type, const uint8_t *bytes, size_t n,
                          const struct relight_header_limits *limits,
                          struct relight_header_cost *cost, char error[RELIGHT_HEADER_ERROR])
{
    const ProtobufCMessageDescriptor *message = relight_type_message(type);
    struct walk w = {.limits = limits, .error = error};
    *cost = w.cost;
    if (!message) return refuse(&w, "type", "unknown");
    // Nothing is written without `repair`.
    bool ok = spend(&w, message->short_name, message->sizeof_message) &&
              walk_message(&w, message, (uint8_t *)(uintptr_t)bytes, n);
    *cost = w.cost;
    return ok;
}

void relight_header_repair(uint16_t type, uint8_t *bytes, size_t n)
{
    const ProtobufCMessageDescriptor *message = relight_type_message(type);
    struct walk w = {.repair = true};
    if (message) walk_message(&w, message, bytes, n);
}
