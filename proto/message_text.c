// SPDX-License-Identifier: MIT
// Messages as JSON and as words, by their descriptors. All allocations are malloc()'s, so that
// protobuf_c_message_free_unpacked frees what is set here.
#include "message_text.h"

#include "frame.h"

#include <ctype.h>
#include <errno.h>
#include <math.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum { PATH_ROOM = 120, MAX_REPEATED = 4096 };

// ---- enums

static const char *without_prefix(const char *name)
{
    const char *line = strchr(name, '_');
    return line ? line + 1 : name;
}

void message_enum_word(const ProtobufCEnumDescriptor *descriptor, int value, char out[40])
{
    const ProtobufCEnumValue *v = protobuf_c_enum_descriptor_get_value(descriptor, value);
    const char *from = v ? without_prefix(v->name) : "unknown";
    size_t n = 0;
    for (; from[n] && n < 39; n++) out[n] = (char)tolower((unsigned char)from[n]);
    out[n] = 0;
}

static int enum_value(const ProtobufCEnumDescriptor *descriptor, const char *word, int *value,
                      char error[MESSAGE_TEXT_ERROR])
{
    size_t n = (size_t)snprintf(error, MESSAGE_TEXT_ERROR, "expected one of");
    for (unsigned i = 0; i < descriptor->n_values; i++) {
        const ProtobufCEnumValue *v = &descriptor->values[i];
        char own[40];
        message_enum_word(descriptor, v->value, own);
        if (!strcasecmp(own, word)) {
            *value = v->value;
            return 0;
        }
        if (n < MESSAGE_TEXT_ERROR)
            n += (size_t)snprintf(error + n, MESSAGE_TEXT_ERROR - n, " %s", own);
    }
    return -1;
}

// ---- message to JSON

// The fewest digits that read back as the same float, or double where `wide`.
static cJSON *number_json(double x, bool wide)
{
    char text[40];
    if (!isfinite(x)) return cJSON_CreateNull();
    for (int digits = 6; digits <= (wide ? 17 : 9); digits++) {
        snprintf(text, sizeof text, "%.*g", digits, x);
        if (wide ? strtod(text, NULL) == x : strtof(text, NULL) == (float)x) break;
    }
    return cJSON_CreateRaw(text);
}

static cJSON *whole_json(uint64_t x)
{
    char text[24];
    snprintf(text, sizeof text, "%llu", (unsigned long long)x);
    return cJSON_CreateRaw(text);
}

// Texts from files may hold invalid bytes: each becomes a question mark.
static cJSON *text_json(const char *text)
{
    cJSON *json = text[0] == '{' ? cJSON_Parse(text) : NULL;
    char *own = json ? NULL : strdup(text);
    size_t n = own ? strlen(own) : 0;
    for (size_t i = 0; i < n;) {
        size_t m = relight_utf8_next((const uint8_t *)own + i, n - i);
        if (!m) own[i] = '?';
        i += m ? m : 1;
    }
    if (own) json = cJSON_CreateString(own);
    free(own);
    return json;
}

static cJSON *value_json(const ProtobufCFieldDescriptor *f, const void *at)
{
    char word[40];
    switch (f->type) {
    case PROTOBUF_C_TYPE_FLOAT:
        return number_json((double)*(const float *)at, false);
    case PROTOBUF_C_TYPE_DOUBLE:
        return number_json(*(const double *)at, true);
    case PROTOBUF_C_TYPE_UINT32:
        return whole_json(*(const uint32_t *)at);
    case PROTOBUF_C_TYPE_INT32:
        return cJSON_CreateNumber(*(const int32_t *)at);
    case PROTOBUF_C_TYPE_UINT64:
        return whole_json(*(const uint64_t *)at);
    case PROTOBUF_C_TYPE_BOOL:
        return cJSON_CreateBool(*(const protobuf_c_boolean *)at);
    case PROTOBUF_C_TYPE_ENUM:
        message_enum_word(f->descriptor, *(const int *)at, word);
        return cJSON_CreateString(word);
    case PROTOBUF_C_TYPE_STRING:
        return text_json(*(const char *const *)at);
    case PROTOBUF_C_TYPE_MESSAGE:
        return message_to_json(*(const ProtobufCMessage *const *)at);
    default:
        return cJSON_CreateNull(); // bytes, fixed64: no message of the HTTP API has them
    }
}

static size_t size_of(ProtobufCType type)
{
    switch (type) {
    case PROTOBUF_C_TYPE_STRING:
    case PROTOBUF_C_TYPE_MESSAGE:
        return sizeof(void *);
    case PROTOBUF_C_TYPE_UINT64:
    case PROTOBUF_C_TYPE_DOUBLE:
        return 8;
    default:
        return 4;
    }
}

static cJSON *list_json(const ProtobufCMessage *message, const ProtobufCFieldDescriptor *f)
{
    const char *base = (const char *)message;
    size_t n = *(const size_t *)(const void *)(base + f->quantifier_offset);
    const char *list = *(const char *const *)(const void *)(base + f->offset);
    cJSON *out = cJSON_CreateArray();
    for (size_t i = 0; out && i < n; i++)
        cJSON_AddItemToArray(out, value_json(f, list + i * size_of(f->type)));
    return out;
}

static bool is_left_out(const ProtobufCFieldDescriptor *f, const void *at)
{
    if (f->type == PROTOBUF_C_TYPE_STRING) {
        const char *text = *(const char *const *)at;
        return !text || !text[0];
    }
    return f->type == PROTOBUF_C_TYPE_MESSAGE && !*(void *const *)at;
}

cJSON *message_to_json(const ProtobufCMessage *message)
{
    cJSON *out = cJSON_CreateObject();
    for (unsigned i = 0; out && i < message->descriptor->n_fields; i++) {
        const ProtobufCFieldDescriptor *f = &message->descriptor->fields[i];
        const char *base = (const char *)message;
        const void *at = base + f->offset;
        if (f->label == PROTOBUF_C_LABEL_REPEATED) {
            cJSON_AddItemToObject(out, f->name, list_json(message, f));
        } else if (!is_left_out(f, at)) {
            cJSON_AddItemToObject(out, f->name, value_json(f, at));
        }
    }
    return out;
}

// ---- setting values

ProtobufCMessage *message_new(const ProtobufCMessageDescriptor *descriptor)
{
    ProtobufCMessage *message = malloc(descriptor->sizeof_message);
    if (message) descriptor->message_init(message);
    return message;
}

static int set_text(char **field, const char *text, char error[MESSAGE_TEXT_ERROR])
{
    char *copy = strdup(text);
    if (!copy) {
        snprintf(error, MESSAGE_TEXT_ERROR, "not enough memory");
        return -1;
    }
    if (*field != protobuf_c_empty_string) free(*field);
    *field = copy;
    return 0;
}

static int set_number(const ProtobufCFieldDescriptor *f, void *at, double x,
                      char error[MESSAGE_TEXT_ERROR])
{
    double most = f->type == PROTOBUF_C_TYPE_UINT32   ? 4294967295.0
                  : f->type == PROTOBUF_C_TYPE_UINT64 ? 9007199254740992.0
                                                      : 3.4e38;
    bool whole = f->type == PROTOBUF_C_TYPE_UINT32 || f->type == PROTOBUF_C_TYPE_UINT64;
    if (!isfinite(x) || (whole && (x < 0 || x != floor(x))) || fabs(x) > most) {
        snprintf(error, MESSAGE_TEXT_ERROR,
                 whole ? "expected a whole number from 0 to %.0f"
                       : "expected a number up to %g",
                 most);
        return -1;
    }
    if (f->type == PROTOBUF_C_TYPE_UINT32) *(uint32_t *)at = (uint32_t)x;
    else if (f->type == PROTOBUF_C_TYPE_UINT64) *(uint64_t *)at = (uint64_t)x;
    else if (f->type == PROTOBUF_C_TYPE_FLOAT) *(float *)at = (float)x;
    else *(double *)at = x;
    return 0;
}

static int set_bool(protobuf_c_boolean *at, const char *text, char error[MESSAGE_TEXT_ERROR])
{
    static const char *const words[] = {"no", "yes", "false", "true", "0", "1"};
    for (int i = 0; i < 6; i++)
        if (!strcasecmp(text, words[i])) {
            *at = i % 2;
            return 0;
        }
    if (!text[0]) { // ?preview without a value
        *at = 1;
        return 0;
    }
    snprintf(error, MESSAGE_TEXT_ERROR, "expected yes or no");
    return -1;
}

static int set_value(const ProtobufCFieldDescriptor *f, void *at, const char *text,
                     char error[MESSAGE_TEXT_ERROR])
{
    char *end;
    double x;
    switch (f->type) {
    case PROTOBUF_C_TYPE_STRING:
        return set_text(at, text, error);
    case PROTOBUF_C_TYPE_BOOL:
        return set_bool(at, text, error);
    case PROTOBUF_C_TYPE_ENUM:
        return enum_value(f->descriptor, text, at, error);
    case PROTOBUF_C_TYPE_MESSAGE:
        snprintf(error, MESSAGE_TEXT_ERROR, "expected an object");
        return -1;
    default:
        x = strtod(text, &end);
        return set_number(f, at, end == text || *end ? NAN : x, error);
    }
}

// A new last element of a repeated field, zero or an initialised message; NULL without memory.
static void *append(ProtobufCMessage *message, const ProtobufCFieldDescriptor *f)
{
    char *base = (char *)message;
    size_t *n = (size_t *)(void *)(base + f->quantifier_offset), size = size_of(f->type);
    char **list = (char **)(void *)(base + f->offset);
    char *longer = *n < MAX_REPEATED ? realloc(*list, (*n + 1) * size) : NULL;
    if (!longer) return NULL;
    *list = longer;
    char *at = longer + *n * size;
    memset(at, 0, size);
    if (f->type == PROTOBUF_C_TYPE_MESSAGE) {
        ProtobufCMessage *one = message_new(f->descriptor);
        if (!one) return NULL;
        *(ProtobufCMessage **)(void *)at = one;
    } else if (f->type == PROTOBUF_C_TYPE_STRING) {
        *(const char **)(void *)at = protobuf_c_empty_string;
    }
    ++*n;
    return at;
}

// The message in a field, created where it is absent; of a repeated field, the first one.
static ProtobufCMessage *child(ProtobufCMessage *message, const ProtobufCFieldDescriptor *f)
{
    char *base = (char *)message;
    ProtobufCMessage **at = (ProtobufCMessage **)(void *)(base + f->offset);
    if (f->label == PROTOBUF_C_LABEL_REPEATED) {
        if (*(size_t *)(void *)(base + f->quantifier_offset))
            return **(ProtobufCMessage ***)(void *)(base + f->offset);
        at = append(message, f);
    } else if (!*at) {
        *at = message_new(f->descriptor);
    }
    return at ? *at : NULL;
}

int message_set(ProtobufCMessage *message, const char *path, const char *text,
                char error[MESSAGE_TEXT_ERROR])
{
    char name[PATH_ROOM];
    const char *dot = strchr(path, '.');
    snprintf(name, sizeof name, "%.*s", dot ? (int)(dot - path) : PATH_ROOM - 1, path);
    const ProtobufCFieldDescriptor *f =
        protobuf_c_message_descriptor_get_field_by_name(message->descriptor, name);
    snprintf(error, MESSAGE_TEXT_ERROR, f ? "not enough memory" : "no such field");
    if (!f || (dot && f->type != PROTOBUF_C_TYPE_MESSAGE)) return -1;
    if (dot) {
        ProtobufCMessage *inner = child(message, f);
        return inner ? message_set(inner, dot + 1, text, error) : -1;
    }
    void *at = f->label == PROTOBUF_C_LABEL_REPEATED ? append(message, f)
                                                     : (char *)message + f->offset;
    return at ? set_value(f, at, text, error) : -1;
}

// ---- JSON to message

static int fill(ProtobufCMessage *message, const cJSON *object, const char *path,
                char error[MESSAGE_TEXT_ERROR]);

static int fail_at(const char *path, const char *why, char error[MESSAGE_TEXT_ERROR])
{
    char text[MESSAGE_TEXT_ERROR];
    snprintf(text, sizeof text, "%s: %.120s", path, why);
    snprintf(error, MESSAGE_TEXT_ERROR, "%s", text);
    return -1;
}

static int fill_text(char **at, const cJSON *value, const char *path,
                     char error[MESSAGE_TEXT_ERROR])
{
    char *text = cJSON_IsObject(value) ? cJSON_PrintUnformatted(value) : NULL;
    char why[MESSAGE_TEXT_ERROR] = "expected a text";
    const char *plain = cJSON_IsString(value) ? value->valuestring : text;
    int failed = !plain || set_text(at, plain, why);
    cJSON_free(text);
    return failed ? fail_at(path, why, error) : 0;
}

static int fill_value(const ProtobufCFieldDescriptor *f, void *at, const cJSON *value,
                      const char *path, char error[MESSAGE_TEXT_ERROR])
{
    char why[MESSAGE_TEXT_ERROR] = "expected a number";
    int failed = 1;
    switch (f->type) {
    case PROTOBUF_C_TYPE_STRING:
        return fill_text(at, value, path, error);
    case PROTOBUF_C_TYPE_MESSAGE:
        if (!cJSON_IsObject(value)) return fail_at(path, "expected an object", error);
        return fill(*(ProtobufCMessage **)at, value, path, error);
    case PROTOBUF_C_TYPE_BOOL:
        snprintf(why, sizeof why, "expected true or false");
        if (!(failed = !cJSON_IsBool(value))) *(protobuf_c_boolean *)at = cJSON_IsTrue(value);
        break;
    case PROTOBUF_C_TYPE_ENUM:
        failed =
            enum_value(f->descriptor, cJSON_IsString(value) ? value->valuestring : "", at, why);
        break;
    default:
        if (cJSON_IsNumber(value)) failed = set_number(f, at, value->valuedouble, why);
    }
    return failed ? fail_at(path, why, error) : 0;
}

static int fill_list(ProtobufCMessage *message, const ProtobufCFieldDescriptor *f,
                     const cJSON *list, const char *path, char error[MESSAGE_TEXT_ERROR])
{
    const cJSON *value;
    int i = 0;
    if (!cJSON_IsArray(list)) return fail_at(path, "expected a list", error);
    cJSON_ArrayForEach(value, list)
    {
        char inner[PATH_ROOM];
        snprintf(inner, sizeof inner, "%.100s[%d]", path, i++);
        void *at = append(message, f);
        if (!at) return fail_at(inner, "too many elements", error);
        if (fill_value(f, at, value, inner, error)) return -1;
    }
    return 0;
}

static int fill(ProtobufCMessage *message, const cJSON *object, const char *path,
                char error[MESSAGE_TEXT_ERROR])
{
    const cJSON *value;
    cJSON_ArrayForEach(value, object)
    {
        char inner[PATH_ROOM];
        snprintf(inner, sizeof inner, "%.80s%s%.30s", path, *path ? "." : "", value->string);
        const ProtobufCFieldDescriptor *f =
            protobuf_c_message_descriptor_get_field_by_name(message->descriptor, value->string);
        if (!f) return fail_at(inner, "no such field", error);
        void *at = (char *)message + f->offset;
        int failed;
        if (f->label == PROTOBUF_C_LABEL_REPEATED) {
            failed = fill_list(message, f, value, inner, error);
        } else {
            if (f->type == PROTOBUF_C_TYPE_MESSAGE && !child(message, f))
                return fail_at(inner, "not enough memory", error);
            failed = fill_value(f, at, value, inner, error);
        }
        if (failed) return -1;
    }
    return 0;
}

int message_from_json(ProtobufCMessage *message, const cJSON *object,
                      char error[MESSAGE_TEXT_ERROR])
{
    if (!cJSON_IsObject(object)) return fail_at("body", "expected a JSON object", error);
    return fill(message, object, "", error);
}
