// SPDX-License-Identifier: MIT
// Headers before they are unpacked, text on its way in and out, and payloads that are refused.
#include "frame.h"
#include "relight.pb-c.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

static bool check(uint16_t type, const void *bytes, size_t n, char error[RELIGHT_HEADER_ERROR])
{
    static const struct relight_header_limits limits = {100, 1 << 16};
    struct relight_header_cost cost;
    error[0] = 0;
    return relight_header_check(type, bytes, n, &limits, &cost, error);
}

// Whatever unpacks passes, with a cost that covers it; of every prefix, those pass that unpack.
static void test_check_agrees_with_unpacking(void **state)
{
    Relight__ColorsRequest request = RELIGHT__COLORS_REQUEST__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light, &light, &light};
    Relight__Vec3 gain = RELIGHT__VEC3__INIT;
    Relight__Shade shade = RELIGHT__SHADE__INIT;
    uint8_t bytes[512];
    char error[RELIGHT_HEADER_ERROR];
    gain.x = 1.5f;
    light.env = "constant:1,2,3";
    light.gain = &gain;
    light.rotate_deg = 90;
    shade.material = "grün";
    shade.budget_ms = 300;
    request.model = "bunny";
    request.lights = lights;
    request.n_lights = 3;
    request.sum = true;
    request.shade = &shade;
    size_t n = protobuf_c_message_pack(&request.base, bytes);
    struct relight_header_cost cost;
    assert_true(relight_header_check(RELIGHT_TYPE_COLORS, bytes, n, NULL, &cost, error));
    assert_int_equal(cost.items, 1 + 1 + 3 * 3 + 1 + 1); // messages and strings
    assert_true(cost.bytes > sizeof request + 3 * (sizeof light + sizeof gain) + sizeof shade);
    for (size_t i = 0; i <= n; i++) {
        uint8_t *exact = malloc(i ? i : 1); // a read past its end is seen by the sanitisers
        memcpy(exact, bytes, i);
        struct relight_frame frame = {
            .type = RELIGHT_TYPE_COLORS, .header_size = (uint32_t)i, .header = exact};
        ProtobufCMessage *message = relight_frame_unpack(&frame);
        assert_int_equal(check(RELIGHT_TYPE_COLORS, exact, i, error), message != NULL);
        if (message) protobuf_c_message_free_unpacked(message, NULL);
        free(exact);
    }
}

// Varints of ten bytes: the largest numbers, negative enums, and one that goes on for an
// eleventh.
static void test_long_varints(void **state)
{
    char error[RELIGHT_HEADER_ERROR];
    uint8_t bytes[16];
    const ProtobufCMessageDescriptor *d = relight_type_message(RELIGHT_TYPE_COLORS);
    for (uint32_t number = 1; number < 100; number += 98) { // a bool, an unknown field
        for (size_t n = 1; n <= 11; n++) {
            size_t at = 0;
            bytes[at++] = (uint8_t)((number == 1 ? 3u : number) << 3 & 127) |
                          (uint8_t)(number == 1 ? 0 : 128);
            if (number != 1) bytes[at++] = (uint8_t)(number >> 4);
            for (size_t i = 0; i + 1 < n; i++) bytes[at++] = 0xff;
            bytes[at++] = 1;
            ProtobufCMessage *m = protobuf_c_message_unpack(d, NULL, at, bytes);
            assert_int_equal(check(RELIGHT_TYPE_COLORS, bytes, at, error), m != NULL);
            assert_int_equal(m != NULL, n <= 10);
            if (m) protobuf_c_message_free_unpacked(m, NULL);
            for (size_t cut = 1; cut < at; cut++)
                assert_false(check(RELIGHT_TYPE_COLORS, bytes, cut, error));
        }
    }
}

static void test_limits(void **state)
{
    uint8_t bytes[400];
    char error[RELIGHT_HEADER_ERROR];
    for (size_t i = 0; i < sizeof bytes; i += 2) {
        bytes[i] = 2 << 3 | 2; // lights
        bytes[i + 1] = 0;
    }
    assert_true(check(RELIGHT_TYPE_COLORS, bytes, 2 * 99, error));
    assert_false(check(RELIGHT_TYPE_COLORS, bytes, 2 * 100, error));
    assert_string_equal(error, "lights: the header has more parts than a request may have");
    assert_false(check(60, bytes, 2, error));
}

static void test_utf8(void **state)
{
    static const struct {
        size_t size;
        const char *text;
    } row[] = {
        {1, "a"},
        {2, "\xc2\x80"},
        {2, "\xdf\xbf"},
        {3, "\xe0\xa0\x80"},
        {3, "\xed\x9f\xbf"},
        {3, "\xef\xbf\xbf"},
        {4, "\xf0\x90\x80\x80"},
        {4, "\xf4\x8f\xbf\xbf"},
        {0, "\x80"},             // goes on without a beginning
        {0, "\xc0\x80"},         // overlong
        {0, "\xc1\xbf"},         // overlong
        {0, "\xe0\x9f\xbf"},     // overlong
        {0, "\xf0\x8f\xbf\xbf"}, // overlong
        {0, "\xc2"},             // cut off
        {0, "\xc2-"},            // cut off
        {0, "\xe2\x82"},         // cut off
        {0, "\xed\xa0\x80"},     // the first surrogate
        {0, "\xed\xb0\x80"},     // a low one
        {0, "\xed\xbf\xbf"},     // the last
        {3, "\xee\x80\x80"},
        {0, "\xf4\x90\x80\x80"}, // beyond Unicode
        {0, "\xf5\x80\x80\x80"},
        {0, "\xff"},
    };
    for (size_t i = 0; i < sizeof row / sizeof *row; i++)
        assert_int_equal(relight_utf8_next((const uint8_t *)row[i].text, strlen(row[i].text)),
                         row[i].size);
    static const char *const cut[][2] = {{"", ""},
                                         {"abc", "abc"},
                                         {"ab\xc3", "ab"},
                                         {"ab\xe2\x82", "ab"},
                                         {"ab\xe2\x82\xac", "ab\xe2\x82\xac"},
                                         {"\xf0\x9f\x90", ""},
                                         {"\xf0\x9f\x90\xb0", "\xf0\x9f\x90\xb0"}};
    for (size_t i = 0; i < sizeof cut / sizeof *cut; i++) {
        char text[16];
        strcpy(text, cut[i][0]);
        relight_utf8_cut(text);
        assert_string_equal(text, cut[i][1]);
    }
}

// An answer with broken text reaches its reader with question marks in its place.
static void test_repair(void **state)
{
    Relight__LoadAnswer answer = RELIGHT__LOAD_ANSWER__INIT;
    char *warnings[] = {"fine: \xe2\x82\xac", "cut \xe2\x82", "\xff\xfe"};
    uint8_t bytes[128];
    answer.model = "id\xc0";
    answer.warnings = warnings;
    answer.n_warnings = 3;
    size_t n = protobuf_c_message_pack(&answer.base, bytes);
    relight_header_repair(RELIGHT_TYPE_LOAD | RELIGHT_TYPE_ANSWER, bytes, n);
    Relight__LoadAnswer *got = relight__load_answer__unpack(NULL, n, bytes);
    assert_non_null(got);
    assert_string_equal(got->model, "id?");
    assert_string_equal(got->warnings[0], "fine: \xe2\x82\xac");
    assert_string_equal(got->warnings[1], "cut ??");
    assert_string_equal(got->warnings[2], "??");
    relight__load_answer__free_unpacked(got, NULL);
}

static bool refuse_large(void *user, const struct relight_frame *frame)
{
    ++*(int *)user;
    return frame->payload_size <= 100;
}

static int feed(struct relight_decoder *decoder, const uint8_t *bytes, size_t n)
{
    int status = 0;
    for (size_t at = 0, used; at < n && !status; at += used)
        status = relight_decoder_feed(decoder, bytes + at, n - at, &used);
    return status;
}

// The decoder asks before it makes room; what is refused is read and dropped, and the next
// frame follows.
static void test_refused_payloads(void **state)
{
    struct relight_frame_limits limits = {1 << 20, 1 << 30, true};
    struct relight_decoder decoder;
    static const uint64_t size[] = {64, 300000, 100, 101};
    int asked = 0;
    relight_decoder_init(&decoder, &limits);
    decoder.admit = refuse_large;
    decoder.admit_user = &asked;
    for (size_t i = 0; i < 4; i++) {
        struct relight_frame frame = {.flags = RELIGHT_FRAME_LAST,
                                      .type = RELIGHT_TYPE_PING,
                                      .id = i + 1,
                                      .payload_size = size[i]};
        uint8_t *bytes = calloc(1, 64 + size[i]);
        relight_frame_put_fixed(&frame, bytes);
        memset(bytes + 64, 7, size[i]);
        assert_int_equal(feed(&decoder, bytes, 64 + size[i]), 1);
        assert_int_equal(decoder.frame.id, i + 1);
        assert_int_equal(decoder.refused, size[i] > 100);
        uint8_t *payload = relight_decoder_take(&decoder);
        assert_int_equal(payload != NULL, size[i] <= 100);
        if (payload) assert_memory_equal(payload, bytes + 64, size[i]);
        free(payload);
        free(bytes);
    }
    assert_int_equal(asked, 4);
    relight_decoder_finish(&decoder);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_check_agrees_with_unpacking),
        cmocka_unit_test(test_long_varints),
        cmocka_unit_test(test_limits),
        cmocka_unit_test(test_utf8),
        cmocka_unit_test(test_repair),
        cmocka_unit_test(test_refused_payloads),
    };
    return cmocka_run_group_tests_name("header", tests, NULL, NULL);
}
