// SPDX-License-Identifier: MIT
// Messages as JSON and as words: every message of every operation goes there and back; each
// type of field takes its whole range and nothing beyond; errors name the field.
#include "message_text.h"

#include <ctype.h>
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "frame.h"
#include "relight.pb-c.h"

static uint32_t seed = 1;

static uint32_t some(uint32_t n)
{
    seed = seed * 1664525 + 1013904223;
    return (uint32_t)((uint64_t)seed * n >> 32);
}

static ProtobufCMessage *some_message(const ProtobufCMessageDescriptor *d, int depth);

static void some_value(const ProtobufCFieldDescriptor *f, void *at, int depth)
{
    static const char *const text[] = {"a", "{not JSON", "\"\\ \t \xc3\xa4 \xe2\x82\xac", "12",
                                       "true"};
    const ProtobufCEnumDescriptor *words = f->descriptor;
    switch (f->type) {
    case PROTOBUF_C_TYPE_FLOAT:
        *(float *)at = ldexpf((float)some(1u << 24) - 8388608.f, (int)some(80) - 60);
        break;
    case PROTOBUF_C_TYPE_DOUBLE:
        *(double *)at = ldexp((double)some(1u << 30) - 5e8, (int)some(60) - 40);
        break;
    case PROTOBUF_C_TYPE_UINT32:
        *(uint32_t *)at = some(4) ? some(UINT32_MAX) : UINT32_MAX;
        break;
    case PROTOBUF_C_TYPE_UINT64:
        *(uint64_t *)at =
            some(4) ? (uint64_t)some(1 << 21) << 32 | some(UINT32_MAX) : 1ull << 53;
        break;
    case PROTOBUF_C_TYPE_BOOL:
        *(protobuf_c_boolean *)at = (protobuf_c_boolean)some(2);
        break;
    case PROTOBUF_C_TYPE_ENUM:
        *(int *)at = words->values[some(words->n_values)].value;
        break;
    case PROTOBUF_C_TYPE_STRING:
        *(char **)at = strdup(text[some(5)]);
        break;
    case PROTOBUF_C_TYPE_MESSAGE:
        *(ProtobufCMessage **)at = some_message(f->descriptor, depth + 1);
        break;
    default:
        fail_msg("%s has a type that message_text.c does not know", f->name);
    }
}

// A message with all fields set, to a depth of 5.
static ProtobufCMessage *some_message(const ProtobufCMessageDescriptor *d, int depth)
{
    ProtobufCMessage *m = message_new(d);
    for (unsigned i = 0; i < d->n_fields; i++) {
        const ProtobufCFieldDescriptor *f = &d->fields[i];
        char *base = (char *)m;
        if (f->type == PROTOBUF_C_TYPE_MESSAGE && depth >= 5) continue;
        if (f->label != PROTOBUF_C_LABEL_REPEATED) {
            some_value(f, base + f->offset, depth);
            continue;
        }
        const size_t n = 1 + some(3), wide = f->type == PROTOBUF_C_TYPE_STRING ||
                                                     f->type == PROTOBUF_C_TYPE_MESSAGE ||
                                                     f->type == PROTOBUF_C_TYPE_UINT64 ||
                                                     f->type == PROTOBUF_C_TYPE_DOUBLE
                                                 ? 8
                                                 : 4;
        char *list = calloc(n, wide);
        for (size_t k = 0; k < n; k++) some_value(f, list + k * wide, depth);
        *(size_t *)(void *)(base + f->quantifier_offset) = n;
        *(char **)(void *)(base + f->offset) = list;
    }
    return m;
}

static void same_bytes(const ProtobufCMessage *a, const ProtobufCMessage *b)
{
    const size_t n = protobuf_c_message_get_packed_size(a);
    assert_int_equal(n, protobuf_c_message_get_packed_size(b));
    uint8_t *bytes = malloc(2 * n + 1);
    protobuf_c_message_pack(a, bytes);
    protobuf_c_message_pack(b, bytes + n);
    if (memcmp(bytes, bytes + n, n)) fail_msg("%s comes back changed", a->descriptor->name);
    free(bytes);
}

// The message there and back through text, as a client's body is.
static void there_and_back(const ProtobufCMessageDescriptor *d)
{
    char error[MESSAGE_TEXT_ERROR] = "";
    ProtobufCMessage *m = some_message(d, 0), *copy = message_new(d);
    cJSON *json = message_to_json(m);
    char *text = cJSON_PrintUnformatted(json);
    cJSON *read = cJSON_Parse(text);
    assert_int_equal(cJSON_GetArraySize(json), d->n_fields);
    if (message_from_json(copy, read, error)) fail_msg("%s: %s", d->name, error);
    same_bytes(m, copy);
    cJSON_free(text);
    cJSON_Delete(json);
    cJSON_Delete(read);
    protobuf_c_message_free_unpacked(m, NULL);
    protobuf_c_message_free_unpacked(copy, NULL);
}

// Bytes and fixed64 have no JSON: messages of the binary protocol alone have them.
static bool is_binary(const ProtobufCMessageDescriptor *d)
{
    bool has = false;
    for (unsigned i = 0; i < d->n_fields; i++)
        has |= d->fields[i].type == PROTOBUF_C_TYPE_BYTES ||
               d->fields[i].type == PROTOBUF_C_TYPE_FIXED64 ||
               (d->fields[i].type == PROTOBUF_C_TYPE_MESSAGE &&
                is_binary(d->fields[i].descriptor));
    return has;
}

static void every_message_comes_back(void **state)
{
    unsigned n = 0;
    for (unsigned type = 1; type < 0x10000; type++) {
        const ProtobufCMessageDescriptor *d = relight_type_message((uint16_t)type);
        if (!d || is_binary(d)) continue;
        for (int k = 0; k < 20; k++) there_and_back(d);
        n++;
    }
    print_message("%u messages\n", n);
    assert_true(n > 60);
}

// A field of a type somewhere in the messages; not repeated.
static const ProtobufCMessageDescriptor *field_of(ProtobufCType type,
                                                  const ProtobufCFieldDescriptor **field)
{
    for (unsigned t = 1; t < 0x10000; t++) {
        const ProtobufCMessageDescriptor *d = relight_type_message((uint16_t)t);
        for (unsigned i = 0; d && i < d->n_fields; i++)
            if (d->fields[i].type == type && d->fields[i].label != PROTOBUF_C_LABEL_REPEATED) {
                *field = &d->fields[i];
                return d;
            }
    }
    return NULL;
}

// message_set and message_from_json of one value: both take it or neither does.
static bool takes(const ProtobufCMessageDescriptor *d, const ProtobufCFieldDescriptor *f,
                  const char *text, double *value)
{
    char error[2][MESSAGE_TEXT_ERROR] = {"", ""}, json_text[200];
    ProtobufCMessage *m[2] = {message_new(d), message_new(d)};
    snprintf(json_text, sizeof json_text, "{\"%s\":%s}", f->name, text);
    cJSON *json = cJSON_Parse(json_text);
    const bool set = !message_set(m[0], f->name, text, error[0]);
    const bool filled = json && !message_from_json(m[1], json, error[1]);
    if (json) assert_int_equal(set, filled);
    if (set) {
        same_bytes(m[0], m[1]);
        const void *at = (char *)m[0] + f->offset;
        *value = f->type == PROTOBUF_C_TYPE_FLOAT    ? (double)*(const float *)at
                 : f->type == PROTOBUF_C_TYPE_DOUBLE ? *(const double *)at
                 : f->type == PROTOBUF_C_TYPE_UINT32 ? *(const uint32_t *)at
                                                     : (double)*(const uint64_t *)at;
    } else {
        assert_non_null(strstr(error[0], "expected a"));
        assert_true(!json || !strncmp(error[1], f->name, strlen(f->name)));
    }
    cJSON_Delete(json);
    for (int k = 0; k < 2; k++) protobuf_c_message_free_unpacked(m[k], NULL);
    return set;
}

static void numbers_have_their_range(void **state)
{
    static const struct {
        ProtobufCType type;
        const char *good[5], *bad[9];
    } want[] = {{PROTOBUF_C_TYPE_UINT32,
                 {"0", "1", "4294967295", "1e3"},
                 {"-1", "4294967296", "0.5", "", "x", "1x", "nan", "inf"}},
                {PROTOBUF_C_TYPE_UINT64,
                 {"0", "4294967296", "9007199254740992"},
                 {"-1", "9007199254740994", "1.5", "1e300", " ", "0x", "-inf"}},
                {PROTOBUF_C_TYPE_FLOAT,
                 {"0", "-1.5", "3.4e38", "-3.4e38"},
                 {"3.5e38", "-3.5e38", "nan", "inf", "1 2", ""}},
                {PROTOBUF_C_TYPE_DOUBLE, {"-2", "0.1", "1e30"}, {"1e39", "nan", "1,5"}}};
    for (size_t i = 0; i < sizeof want / sizeof *want; i++) {
        const ProtobufCFieldDescriptor *f = NULL;
        const ProtobufCMessageDescriptor *d = field_of(want[i].type, &f);
        double value;
        if (!d) continue; // doubles are in lists and inner messages alone
        for (int k = 0; k < 5 && want[i].good[k]; k++) {
            if (!takes(d, f, want[i].good[k], &value))
                fail_msg("%s.%s = %s is refused", d->name, f->name, want[i].good[k]);
            const double x = strtod(want[i].good[k], NULL);
            assert_true(fabs(value - x) <= 1e-7 * fabs(x));
        }
        for (int k = 0; k < 9 && want[i].bad[k]; k++)
            if (takes(d, f, want[i].bad[k], &value))
                fail_msg("%s.%s = %s is taken as %g", d->name, f->name, want[i].bad[k], value);
    }
}

static void words(void **state)
{
    static const struct {
        const char *text;
        int value; // -1: refused
    } word[] = {{"yes", 1}, {"No", 0}, {"TRUE", 1}, {"false", 0}, {"1", 1},
                {"0", 0},   {"", 1},   {"2", -1},   {"y", -1}};
    char error[MESSAGE_TEXT_ERROR], own[40];
    const ProtobufCFieldDescriptor *f = NULL;
    const ProtobufCMessageDescriptor *d = field_of(PROTOBUF_C_TYPE_BOOL, &f);
    for (size_t i = 0; i < sizeof word / sizeof *word; i++) {
        ProtobufCMessage *m = message_new(d);
        protobuf_c_boolean *at = (protobuf_c_boolean *)(void *)((char *)m + f->offset);
        *at = word[i].value != 1;
        assert_int_equal(message_set(m, f->name, word[i].text, error),
                         word[i].value < 0 ? -1 : 0);
        if (word[i].value >= 0) assert_int_equal(*at, word[i].value);
        protobuf_c_message_free_unpacked(m, NULL);
    }
    d = field_of(PROTOBUF_C_TYPE_ENUM, &f);
    const ProtobufCEnumDescriptor *e = f->descriptor;
    for (unsigned i = 0; i < e->n_values; i++) {
        ProtobufCMessage *m = message_new(d);
        message_enum_word(e, e->values[i].value, own);
        assert_null(strpbrk(own, "ABCDEFGHIJKLMNOPQRSTUVWXYZ"));
        assert_int_equal(message_set(m, f->name, own, error), 0);
        assert_int_equal(*(int *)(void *)((char *)m + f->offset), e->values[i].value);
        *(int *)(void *)((char *)m + f->offset) = -1;
        for (char *c = own; *c; c++) *c = (char)toupper((unsigned char)*c); // of any case
        assert_int_equal(message_set(m, f->name, own, error), 0);
        assert_int_equal(*(int *)(void *)((char *)m + f->offset), e->values[i].value);
        protobuf_c_message_free_unpacked(m, NULL);
    }
    ProtobufCMessage *m = message_new(d);
    assert_int_equal(message_set(m, f->name, "none such", error), -1);
    for (unsigned i = 0; i < e->n_values; i++) { // the error lists every word
        message_enum_word(e, e->values[i].value, own);
        assert_non_null(strstr(error, own));
    }
    message_enum_word(e, 12345, own);
    assert_string_equal(own, "unknown");
    protobuf_c_message_free_unpacked(m, NULL);
}

static void paths_and_faults(void **state)
{
    static const struct {
        const char *json, *error;
    } bad[] = {{"[]", "body: expected a JSON object"},
               {"{\"nothing\":1}", "nothing: no such field"},
               {"{\"lights\":{}}", "lights: expected a list"},
               {"{\"lights\":[1]}", "lights[0]: expected an object"},
               {"{\"lights\":[{},{\"rotate_deg\":\"x\"}]}", "lights[1].rotate_deg: expected a"},
               {"{\"model\":3}", "model: expected a text"}};
    char error[MESSAGE_TEXT_ERROR];
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        ProtobufCMessage *own = message_new(&relight__colors_request__descriptor);
        cJSON *json = cJSON_Parse(bad[i].json);
        assert_int_equal(message_from_json(own, json, error), -1);
        if (strncmp(error, bad[i].error, strlen(bad[i].error)))
            fail_msg("\"%s\", not \"%s\"", error, bad[i].error);
        cJSON_Delete(json);
        protobuf_c_message_free_unpacked(own, NULL);
    }
    ProtobufCMessage *own = message_new(&relight__colors_request__descriptor);
    const Relight__ColorsRequest *m = (const void *)own;
    assert_int_equal(message_set(own, "lights.rotate_deg", "30", error), 0);
    assert_int_equal(message_set(own, "lights.env", "studio", error), 0); // of the same light
    assert_int_equal(message_set(own, "model", "first", error), 0);
    assert_int_equal(message_set(own, "model", "second", error), 0);
    assert_int_equal(m->n_lights, 1);
    assert_float_equal(m->lights[0]->rotate_deg, 30, 0);
    assert_string_equal(m->lights[0]->env, "studio");
    assert_string_equal(m->model, "second");
    assert_int_equal(message_set(own, "model.name", "x", error), -1);
    assert_int_equal(message_set(own, "lights.none", "x", error), -1);
    assert_string_equal(error, "no such field");
    protobuf_c_message_free_unpacked(own, NULL);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(every_message_comes_back),
        cmocka_unit_test(numbers_have_their_range),
        cmocka_unit_test(words),
        cmocka_unit_test(paths_and_faults),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
