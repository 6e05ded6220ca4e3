// SPDX-License-Identifier: MIT
// A connection from HELLO to GOAWAY: features and limits, versions, flags, ranges in errors,
// and the daemon's farewell.
#include "frames.h"
#include "lone_daemon.h"

static Relight__HelloAnswer *hello_of(struct frames *f, uint32_t low, uint32_t high)
{
    Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    hello.client = "session";
    hello.version_min = low;
    hello.version_max = high;
    frames_add(f, RELIGHT_TYPE_HELLO, 1, &hello.base, NULL, 0);
    frames_send(f);
    assert_true(frames_next(f, &a, 20000, &m));
    assert_false(a.closed);
    assert_int_equal(a.type, RELIGHT_TYPE_HELLO | RELIGHT_TYPE_ANSWER);
    return (Relight__HelloAnswer *)m;
}

static void hello_lists_features_and_limits(void **state)
{
    begin((const char *const[]){"--idle", "77", "--frame-time", "8.5", "--handshake", "3",
                                "--deadline", "33", "--max-side", "512", NULL});
    struct frames *f = frames_connect(&d);
    Relight__HelloAnswer *h = hello_of(f, 0, 99); // the newest client
    assert_int_equal(h->version, 1);
    assert_int_equal(strlen(h->run), 16);
    assert_int_equal(h->max_lights, 16);
    assert_int_equal(h->max_side, 512);
    assert_int_equal(h->max_ping, 64 << 10);
    assert_int_equal(h->idle_ms, 77000);
    assert_int_equal(h->frame_time_ms, 8500);
    assert_int_equal(h->handshake_ms, 3000);
    assert_int_equal(h->deadline_ms, 33000);
    assert_int_equal(h->write_time_ms, 10000);
    assert_int_equal(h->max_answer_header, 16 << 20);
    assert_true(h->max_window >= 2);
    bool events = false;
    for (size_t i = 0; i < h->n_features; i++) events |= !strcmp(h->features[i], "events");
    assert_true(events);
    protobuf_c_message_free_unpacked(&h->base, NULL);
    frames_close(f);
    // A client of a later version only: ERROR, in a frame that it can read.
    f = frames_connect(&d);
    Relight__HelloRequest later = RELIGHT__HELLO_REQUEST__INIT;
    later.version_min = 2;
    later.version_max = 9;
    frames_add(f, RELIGHT_TYPE_HELLO, 1, &later.base, NULL, 0);
    frames_send(f);
    assert_int_equal(frames_wait(f, 1).code, RELIGHT__ERROR_CODE__ERROR_VERSION);
    frames_close(f);
    end();
}

// Flags of the fixed part: hints that nobody knows are ignored, others end the connection.
static void flags_of_later_versions(void **state)
{
    begin(NULL);
    for (unsigned bit = 2; bit < 8; bit++) {
        struct frames *f = frames_open(&d);
        Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
        frames_add(f, RELIGHT_TYPE_PING, 5, &ping.base, NULL, 0);
        f->bytes[5] |= (uint8_t)(1u << bit);
        frames_send(f);
        struct frames_answer a;
        assert_true(frames_next(f, &a, 20000, NULL));
        if (bit < 4) {
            assert_int_equal(a.code, RELIGHT__ERROR_CODE__ERROR_BAD_FRAME);
            assert_int_equal(a.id, 0);
            assert_true(frames_next(f, &a, 20000, NULL));
            assert_true(a.closed);
        } else {
            assert_int_equal(a.type, RELIGHT_TYPE_PING | RELIGHT_TYPE_ANSWER);
        }
        frames_close(f);
    }
    end();
}

// The ERROR that answers this id.
static Relight__Error *error_for(struct frames *f, uint64_t id)
{
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    while (!m || a.id != id) {
        if (m) protobuf_c_message_free_unpacked(m, NULL);
        assert_true(frames_next(f, &a, 20000, &m));
    }
    assert_int_equal(a.type, RELIGHT_TYPE_ERROR);
    return (Relight__Error *)m;
}

static void expect_range(struct frames *f, uint64_t id, const char *parameter, double low,
                         double high, const char *unit)
{
    Relight__Error *e = error_for(f, id);
    if (strcmp(e->parameter, parameter) || !e->has_range || e->minimum != low ||
        e->maximum != high || strcmp(e->unit, unit))
        fail_msg("%s: parameter \"%s\" range %g to %g %s", e->text, e->parameter, e->minimum,
                 e->maximum, e->unit);
    protobuf_c_message_free_unpacked(&e->base, NULL);
}

static void errors_name_parameter_and_range(void **state)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    Relight__ColorsRequest colors = RELIGHT__COLORS_REQUEST__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light, &light};
    Relight__Shade shade = RELIGHT__SHADE__INIT;
    Relight__ImageRequest image = RELIGHT__IMAGE_REQUEST__INIT;
    Relight__Picture picture = RELIGHT__PICTURE__INIT;
    Relight__LoadRequest load = RELIGHT__LOAD_REQUEST__INIT;
    Relight__BakeSettings bake = RELIGHT__BAKE_SETTINGS__INIT;
    light.env = "constant";
    light.rotate_deg = 1e7f;
    colors.model = "none";
    colors.lights = lights;
    colors.n_lights = 2;
    frames_add(f, RELIGHT_TYPE_COLORS, 2, &colors.base, NULL, 0);
    light.rotate_deg = 0;
    shade.material = "{\"sigma_s_prime\":[1,1,1],\"sigma_a\":[0,-1,0]}";
    colors.shade = &shade;
    frames_add(f, RELIGHT_TYPE_COLORS, 3, &colors.base, NULL, 0);
    // Parsed on a worker, and kept in the cache: the range survives both.
    shade.material = "{\"profile\":\"burley\",\"albedo\":[2,0.5,0.5],\"mean_free_path\":1}";
    frames_add(f, RELIGHT_TYPE_COLORS, 4, &colors.base, NULL, 0);
    image.model = "none";
    image.picture = &picture;
    picture.width = 100000;
    frames_add(f, RELIGHT_TYPE_IMAGE, 5, &image.base, NULL, 0);
    load.path = "x.obj";
    load.bake = &bake;
    bake.samples = 3;
    frames_add(f, RELIGHT_TYPE_LOAD, 6, &load.base, NULL, 0);
    frames_send(f);
    expect_range(f, 2, "lights[0].rotate_deg", -1e6, 1e6, "degrees");
    expect_range(f, 3, "sigma_a[1]", 0, 1000, "mm^-1");
    expect_range(f, 5, "picture.width", 1, 4096, "pixels");
    expect_range(f, 6, "samples", 16, 1e7, "");
    frames_add(f, RELIGHT_TYPE_COLORS, 7, &colors.base, NULL, 0);
    frames_send(f);
    Relight__Error *e = error_for(f, 7);
    assert_int_equal(e->code, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    assert_true(e->has_range && e->maximum == 1);
    protobuf_c_message_free_unpacked(&e->base, NULL);
    frames_close(f);
    end();
}

// --idle closes a silent connection, and not one that waits for an answer or an event.
static void waiting_is_not_idle(void **state)
{
    begin((const char *const[]){"--idle", "1", NULL});
    struct frames_answer a;
    Relight__SubscribeRequest subscribe = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    Relight__PingRequest ping = RELIGHT__PING_REQUEST__INIT;
    struct frames *waits = frames_open(&d);
    frames_add(waits, RELIGHT_TYPE_SUBSCRIBE, 2, &subscribe.base, NULL, 0);
    frames_send(waits);
    assert_true(frames_next(waits, &a, 20000, NULL));
    assert_int_equal(a.id, 2);
    struct frames *idle = frames_open(&d); // younger: its time ends later
    assert_true(frames_next(idle, &a, 20000, NULL));
    assert_true(a.closed);
    frames_add(waits, RELIGHT_TYPE_PING, 3, &ping.base, NULL, 0);
    assert_true(frames_try_send(waits));
    assert_true(frames_next(waits, &a, 20000, NULL));
    assert_false(a.closed);
    assert_int_equal(a.id, 3);
    frames_close(idle);
    frames_close(waits);
    end();
}

// At SIGTERM every connection learns how long its requests have and where to go.
static void goaway(void **state)
{
    begin(
        (const char *const[]){"--drain", "7", "--goaway-address", "tcp:192.0.2.7:7413", NULL});
    struct frames *f = frames_open(&d), *quiet = frames_connect(&d);
    kill(d.pid, SIGTERM);
    struct frames_answer a;
    ProtobufCMessage *m = NULL;
    assert_true(frames_next(f, &a, 20000, &m));
    assert_int_equal(a.type, RELIGHT_TYPE_GOAWAY);
    assert_int_equal(a.id, 0);
    assert_true(a.last);
    Relight__Goaway *g = (Relight__Goaway *)m;
    assert_int_equal(g->drain_ms, 7000);
    assert_string_equal(g->address, "tcp:192.0.2.7:7413");
    assert_true(strlen(g->text) > 0);
    protobuf_c_message_free_unpacked(m, NULL);
    // One that has not said HELLO is told nothing.
    assert_true(frames_next(quiet, &a, 20000, NULL));
    assert_true(a.closed);
    frames_close(quiet);
    frames_close(f);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(hello_lists_features_and_limits, teardown),
        cmocka_unit_test_teardown(flags_of_later_versions, teardown),
        cmocka_unit_test_teardown(errors_name_parameter_and_range, teardown),
        cmocka_unit_test_teardown(waiting_is_not_idle, teardown),
        cmocka_unit_test_teardown(goaway, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
