// SPDX-License-Identifier: MIT
// relight-control without devices: report descriptors and reports, dead zones and curves,
// mapping files, and what a change does to a scene.
#include <math.h>
#include <pthread.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "control.h"
#include "motion.h"
#include "usb_reports.h"

static const struct hid_field *field_of(const struct hid_description *d, const char *name)
{
    for (uint32_t i = 0; i < d->n_field; i++)
        if (!strcmp(d->field[i].name, name)) return &d->field[i];
    fail_msg("no field %s", name);
    return NULL;
}

static void descriptors(void **state)
{
    struct hid_description d;
    char fault[HID_FAULT];
    int64_t value;
    assert_true(hid_parse(navigator_report, sizeof navigator_report, &d, fault));
    assert_int_equal(d.n_field, 9); // six axes, two buttons, a light
    assert_true(d.numbered);
    const struct hid_field *rz = field_of(&d, "rz"), *led = field_of(&d, "led75");
    assert_int_equal(rz->report, 2);
    assert_int_equal(rz->bit, 32);
    assert_int_equal(rz->minimum, -350);
    assert_int_equal(rz->maximum, 350);
    const uint8_t turned[7] = {2, 0, 0, 0, 0, 0x51, 0xff},
                  other[7] = {1, 0, 0, 0, 0, 0x51, 0xff};
    assert_true(hid_value(&d, rz, turned, 7, &value));
    assert_int_equal(value, -175);
    assert_false(hid_value(&d, rz, other, 7, &value));
    assert_true(hid_is_report(&d, turned, 7));
    assert_false(hid_is_report(&d, turned, 6)); // its last byte is missing
    assert_false(hid_value(&d, rz, turned, 6, &value));
    uint8_t out[4];
    assert_int_equal(hid_output(&d, led, 1, out, sizeof out), 2);
    assert_int_equal(out[0], 4);
    assert_int_equal(out[1], 1);
    // The knob's reports have no id, and a maximum of 1023 without a sign.
    assert_true(hid_parse(knob_report, sizeof knob_report, &d, fault));
    assert_false(d.numbered);
    assert_true(field_of(&d, "dial")->relative);
    const uint8_t knob[4] = {0xfe, 0xff, 0x03, 0x01};
    assert_true(hid_value(&d, field_of(&d, "dial"), knob, 4, &value) && value == -2);
    assert_true(hid_value(&d, field_of(&d, "slider"), knob, 4, &value) && value == 1023);
    assert_true(hid_value(&d, field_of(&d, "button1"), knob, 4, &value) && value == 1);
}

// Fields beyond the usages of their item take the last one (HID 1.11, 6.2.2.8).
static void last_usage_repeats(void **state)
{
    static const uint8_t report[] = {
        0x05, 1,   0x09, 0x30, 0x09, 0x31, 0x15, 0,
        0x25, 100, 0x75, 8,    0x95, 4,    0x81, 2}; // x, y and four bytes
    struct hid_description d;
    char fault[HID_FAULT];
    int64_t value;
    assert_true(hid_parse(report, sizeof report, &d, fault));
    assert_int_equal(d.n_field, 4);
    static const char *const name[] = {"x", "y", "y2", "y3"};
    const uint8_t bytes[4] = {10, 20, 30, 40};
    for (uint32_t i = 0; i < 4; i++) {
        assert_string_equal(d.field[i].name, name[i]);
        assert_true(hid_value(&d, &d.field[i], bytes, 4, &value));
        assert_int_equal(value, 10 * (i + 1));
    }
}

// A usage of four bytes names its page itself (HID 1.11, 6.2.2.8), whatever page is set.
static void long_usages_name_their_page(void **state)
{
    static const uint8_t report[] = {
        0x05, 9,   0x0b, 0x31, 0,    1, 0,    0x15, 0,
        0x25, 100, 0x75, 8,    0x95, 1, 0x81, 2}; // y, among buttons
    struct hid_description d;
    char fault[HID_FAULT];
    assert_true(hid_parse(report, sizeof report, &d, fault));
    assert_int_equal(d.n_field, 1);
    assert_string_equal(d.field[0].name, "y");
}

// A report may end within a byte: its last field is there only with that byte.
static void report_ends_within_a_byte(void **state)
{
    static const uint8_t report[] = {
        0x05, 1,   0x09, 0x30, 0x09, 0x31, 0x15, 0,
        0x25, 100, 0x75, 7,    0x95, 2,    0x81, 2}; // x and y, seven bits each
    struct hid_description d;
    char fault[HID_FAULT];
    const uint8_t bytes[2] = {10 | (20 << 7 & 0xff), 20 >> 1};
    int64_t value;
    assert_true(hid_parse(report, sizeof report, &d, fault));
    assert_true(hid_is_report(&d, bytes, 2));
    assert_false(hid_is_report(&d, bytes, 1));
    assert_true(hid_value(&d, field_of(&d, "y"), bytes, 2, &value));
    assert_int_equal(value, 20);
}

// Continuous at the end of the dead zone, odd, 1 at full deflection.
static void curves(void **state)
{
    const struct map_entry e = {.dead = .06, .curve = 1.5}, linear = {.curve = 1};
    assert_true(mapping_curve(&e, .06) == 0);
    assert_true(mapping_curve(&e, .0601) < 1e-4);
    assert_true(fabs(mapping_curve(&e, .5) - pow(.44 / .94, 1.5)) < 1e-12);
    assert_true(mapping_curve(&e, -.5) == -mapping_curve(&e, .5));
    assert_true(fabs(mapping_curve(&e, 1) - 1) < 1e-12);
    assert_true(mapping_curve(&e, 7) == mapping_curve(&e, 1));
    assert_true(mapping_curve(&linear, .25) == .25);
}

static void mapping_files(void **state)
{
    static const struct {
        const char *text, *fault;
    } bad[] = {
        {"{", "line 1: no valid JSON"},
        {"[]", "expected an object"},
        {"{\"devices\": 3}", "expected a list"},
        {"{\"devices\": [{\"vendor\": \"46d\", \"product\": \"c626\", \"map\": []}]}",
         "devices[0].vendor"},
        {"{\"devices\": [{\"vendor\": \"046d\", \"product\": \"c626\", \"maps\": []}]}",
         "no such field"},
        {"{\"devices\": [{\"vendor\": \"046d\", \"product\": \"c626\", \"map\": [{\"control\": \"rz\", "
         "\"target\": \"exposure\", \"curve\": 9}]}]}",
         "devices[0].map[0].curve: expected a number in [0.2, 5]"},
        {"{\"devices\": [{\"vendor\": \"046d\", \"product\": \"c626\", \"map\": []}, {\"vendor\": "
         "\"046D\", \"product\": \"c626\", \"map\": []}]}",
         "devices[1]: is there twice"},
    };
    char path[] = "/tmp/relight-map-XXXXXX", fault[MAPPING_FAULT];
    struct mapping m, again;
    close(mkstemp(path));
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        FILE *file = fopen(path, "w");
        fputs(bad[i].text, file);
        fclose(file);
        assert_false(mapping_read(path, &m, fault));
        if (!strstr(fault, bad[i].fault)) fail_msg("%s in place of %s", fault, bad[i].fault);
    }
    memset(&m, 0, sizeof m);
    m.n_device = 1;
    m.device[0] =
        (struct device_map){.vendor = 0x46d, .product = 0xc626, .led = .5, .n_entry = 1};
    m.device[0].entry[0] = (struct map_entry){"rz", TARGET_CAMERA_ZOOM, -1.25, .06, 2};
    assert_true(mapping_write(path, &m, fault));
    assert_true(mapping_read(path, &again, fault));
    assert_memory_equal(&m, &again, sizeof m);
    unlink(path);
}

// ---- movements

uint64_t control_now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

struct sender {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    bool held; // while it is, the sender's thread waits in take_change
    unsigned n;
    struct change last;
};

static bool take_change(void *user, const struct change *change)
{
    struct sender *s = user;
    pthread_mutex_lock(&s->lock);
    s->last = *change;
    s->n++;
    pthread_cond_broadcast(&s->changed);
    while (s->held) pthread_cond_wait(&s->changed, &s->lock);
    pthread_mutex_unlock(&s->lock);
    return true;
}

static void hold_sender(struct sender *s, bool held)
{
    pthread_mutex_lock(&s->lock);
    s->held = held;
    pthread_cond_broadcast(&s->changed);
    pthread_mutex_unlock(&s->lock);
}

static struct change change_number(struct sender *s, unsigned n)
{
    pthread_mutex_lock(&s->lock);
    while (s->n < n) pthread_cond_wait(&s->changed, &s->lock);
    const struct change last = s->last;
    pthread_mutex_unlock(&s->lock);
    return last;
}

static void turn(struct motion *m, struct bound *b, const char *name, enum control_kind kind,
                 double value)
{
    struct usb_control c = {.kind = kind, .value = value};
    snprintf(c.name, sizeof c.name, "%s", name);
    motion_input(m, b, &c, 0, 1);
}

// Movements while a request is on its way are one change. A slider's place replaces the
// movements before it, and those after it are added to it. One that hardly moved, a button that
// is let go and a control of another device change nothing.
static void movements_are_summed(void **state)
{
    struct sender s = {.lock = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER};
    const struct device_map map = {.n_entry = 5,
                                   .entry = {{"reset", TARGET_RESET, 1, 0, 1},
                                             {"dial", TARGET_LIGHT_GAIN, .5, 0, 1},
                                             {"slider", TARGET_LIGHT_GAIN, 4, .1, 1},
                                             {"turn", TARGET_LIGHT_AZIMUTH, -2, .5, 1},
                                             {"button", TARGET_UNDO, 1, 0, 1}}};
    struct motion *m = motion_start(take_change, &s);
    struct bound *b = motion_bind(&map);
    s.held = true;
    turn(m, b, "dial", CONTROL_RELATIVE, 2);
    struct change c = change_number(&s, 1);
    assert_true(c.delta[TARGET_LIGHT_GAIN] == 1 && !c.has_position[TARGET_LIGHT_GAIN]);
    turn(m, b, "dial", CONTROL_RELATIVE, 3);
    turn(m, b, "slider", CONTROL_POSITION, .75);
    turn(m, b, "turn", CONTROL_RELATIVE, 4);
    turn(m, b, "turn", CONTROL_RELATIVE, -.4);
    turn(m, b, "button", CONTROL_BUTTON, 0);
    turn(m, b, "other", CONTROL_RELATIVE, 9);
    hold_sender(&s, false);
    c = change_number(&s, 2);
    assert_true(c.has_position[TARGET_LIGHT_GAIN] && c.position[TARGET_LIGHT_GAIN] == 1);
    assert_true(c.delta[TARGET_LIGHT_GAIN] == 0 && c.delta[TARGET_LIGHT_AZIMUTH] == -8);
    assert_false(c.undo || c.redo || c.reset || c.has_position[TARGET_LIGHT_AZIMUTH]);
    hold_sender(&s, true);
    turn(m, b, "button", CONTROL_BUTTON, 1);
    assert_true(change_number(&s, 3).undo);
    turn(m, b, "slider", CONTROL_POSITION, .25);
    turn(m, b, "slider", CONTROL_POSITION, .3); // within .1 of where it was
    turn(m, b, "dial", CONTROL_RELATIVE, 1);
    hold_sender(&s, false);
    c = change_number(&s, 4);
    assert_true(c.position[TARGET_LIGHT_GAIN] == -1 && c.delta[TARGET_LIGHT_GAIN] == .5);
    assert_false(c.undo);
    // A reset undoes the movements before it, not those after it.
    hold_sender(&s, true);
    turn(m, b, "turn", CONTROL_RELATIVE, 1);
    change_number(&s, 5);
    turn(m, b, "turn", CONTROL_RELATIVE, 5);
    turn(m, b, "slider", CONTROL_POSITION, .9);
    turn(m, b, "reset", CONTROL_BUTTON, 1);
    turn(m, b, "turn", CONTROL_RELATIVE, 2);
    hold_sender(&s, false);
    c = change_number(&s, 6);
    assert_true(c.reset && !c.has_position[TARGET_LIGHT_GAIN]);
    assert_true(c.delta[TARGET_LIGHT_AZIMUTH] == -4);
    motion_unbind(m, b);
    struct motion_times times;
    motion_stop(m, &times);
    assert_int_equal(times.requests, 6); // of more reports
}

// A stick that is held moves on while another one of the device sends reports, and a movement
// of many reports is as long as one of few.
static void held_sticks_go_on(void **state)
{
    struct sender s = {.lock = PTHREAD_MUTEX_INITIALIZER, .changed = PTHREAD_COND_INITIALIZER};
    const struct device_map map = {.n_entry = 3,
                                   .entry = {{"dial", TARGET_EXPOSURE, 1, 0, 1},
                                             {"x", TARGET_LIGHT_GAIN, 1, 0, 1},
                                             {"y", TARGET_LIGHT_AZIMUTH, 100, 0, 1}}};
    struct motion *m = motion_start(take_change, &s);
    struct bound *b = motion_bind(&map);
    struct usb_control x = {.name = "x", .kind = CONTROL_DEFLECTION, .value = .5},
                       y = {.name = "y", .kind = CONTROL_DEFLECTION, .value = 1};
    s.held = true;
    turn(m, b, "dial", CONTROL_RELATIVE, 2);
    change_number(&s, 1);
    uint64_t now = control_now_ns() + 1000000000;
    motion_input(m, b, &y, 0, now);
    for (int i = 0; i <= 100; i++) { // 100 ms, a report a millisecond
        x.value = .5 + 1e-9 * (i % 2);
        motion_input(m, b, &x, 0, now + (uint64_t)i * 1000000);
    }
    x.value = y.value = 0;
    motion_input(m, b, &x, 0, now + 100000000);
    motion_input(m, b, &y, 0, now + 100000000);
    hold_sender(&s, false);
    struct change c = change_number(&s, 2);
    // With a first step of 8 ms.
    assert_true(fabs(c.delta[TARGET_LIGHT_AZIMUTH] - 10.8) < 1e-6);
    assert_true(fabs(c.delta[TARGET_LIGHT_GAIN] - .054) < 1e-6);
    motion_unbind(m, b);
    motion_stop(m, NULL);
}

// ---- scenes

static double number_at(const cJSON *json, const char *a, const char *b)
{
    const cJSON *item = cJSON_GetObjectItem(cJSON_GetObjectItem(json, a), b);
    return cJSON_IsNumber(item) ? item->valuedouble : NAN;
}

static void scenes(void **state)
{
    cJSON *scene = cJSON_Parse("{\"lights\": [{\"rotate_deg\": 350}, {\"rotate_deg\": 5}], "
                               "\"camera\": {\"eye\": {\"x\": 0, \"y\": 0, \"z\": 4}}}");
    cJSON *base = cJSON_Duplicate(scene, 1), *parts = cJSON_CreateArray();
    struct change c = {0};
    c.delta[TARGET_LIGHT_AZIMUTH] = 20;
    c.delta[TARGET_CAMERA_AZIMUTH] = 90;
    c.delta[TARGET_CAMERA_ZOOM] = 1;
    assert_true(scene_change(scene, base, &c, 0, parts));
    assert_int_equal(cJSON_GetArraySize(parts), 2);
    const cJSON *lights = cJSON_GetObjectItem(scene, "lights");
    assert_true(cJSON_GetObjectItem(cJSON_GetArrayItem(lights, 0), "rotate_deg")->valuedouble ==
                10);
    assert_true(cJSON_GetObjectItem(cJSON_GetArrayItem(lights, 1), "rotate_deg")->valuedouble ==
                5);
    // A quarter about +y, at half the distance.
    const cJSON *camera = cJSON_GetObjectItem(scene, "camera");
    assert_true(fabs(number_at(camera, "eye", "x") - 2) < 1e-6);
    assert_true(fabs(number_at(camera, "eye", "z")) < 1e-6);
    // Straight up it stops before the pole.
    memset(&c, 0, sizeof c);
    c.delta[TARGET_CAMERA_ELEVATION] = 170;
    assert_true(scene_change(scene, base, &c, -1, parts));
    double height = number_at(cJSON_GetObjectItem(scene, "camera"), "eye", "y");
    assert_true(fabs(height - 2 * sin(89 * M_PI / 180)) < 1e-5);
    // A slider counts from where the program began; reset goes back there.
    memset(&c, 0, sizeof c);
    c.has_position[TARGET_EXPOSURE] = true;
    c.position[TARGET_EXPOSURE] = 1.5;
    for (int i = 0; i < 2; i++) assert_true(scene_change(scene, base, &c, -1, parts));
    assert_true(number_at(scene, "picture", "exposure_ev") == 1.5);
    // As far as the daemon draws, and no further.
    c.position[TARGET_EXPOSURE] = 39;
    assert_true(scene_change(scene, base, &c, -1, parts));
    assert_true(number_at(scene, "picture", "exposure_ev") == 39);
    c.position[TARGET_EXPOSURE] = -41;
    assert_true(scene_change(scene, base, &c, -1, parts));
    assert_true(number_at(scene, "picture", "exposure_ev") == -40);
    struct change back = {.reset = true};
    assert_true(scene_change(scene, base, &back, -1, parts));
    assert_true(cJSON_Compare(scene, base, 1));
    struct change none = {0};
    assert_false(scene_change(scene, base, &none, -1, parts));
    cJSON_Delete(parts);
    cJSON_Delete(base);
    cJSON_Delete(scene);
}

// Each of three sliders of the camera stays where it is while the others move.
static void camera_sliders(void **state)
{
    static const char *const cameras[] = {
        "{\"camera\": {\"eye\": {\"x\": 3, \"y\": 2, \"z\": 5}, \"target\": {\"x\": 1, \"y\": 1, "
        "\"z\": 1}, \"up\": {\"x\": 0, \"y\": 2, \"z\": 0}}}",
        "{\"camera\": {\"orbit\": {\"azimuth_deg\": 170, \"elevation_deg\": 10, \"zoom\": 2}}}",
        "{}"};
    static const double place[3] = {120, 25, -1};
    for (int i = 0; i < 3; i++) {
        cJSON *base = cJSON_Parse(cameras[i]), *parts = cJSON_CreateArray();
        cJSON *once = cJSON_Duplicate(base, 1), *each = cJSON_Duplicate(base, 1);
        struct change all = {0};
        for (int k = 0; k < 3; k++) {
            enum target t = (enum target)(TARGET_CAMERA_AZIMUTH + k);
            struct change one = {0};
            all.has_position[t] = one.has_position[t] = true;
            all.position[t] = place[k];
            one.position[t] = 7;
            assert_true(scene_change(each, base, &one, -1, parts));
            one.position[t] = place[k];
            assert_true(scene_change(each, base, &one, -1, parts));
        }
        assert_true(scene_change(once, base, &all, -1, parts));
        const cJSON *a = cJSON_GetObjectItem(once, "camera"),
                    *b = cJSON_GetObjectItem(each, "camera");
        static const char *const names[2][3] = {{"x", "y", "z"},
                                                {"azimuth_deg", "elevation_deg", "zoom"}};
        for (int k = 0; k < 3; k++) {
            const char *field = i ? "orbit" : "eye", *name = names[i > 0][k];
            if (!(fabs(number_at(a, field, name) - number_at(b, field, name)) < 1e-4))
                fail_msg("camera %d: %s %g, not %g", i, name, number_at(b, field, name),
                         number_at(a, field, name));
        }
        cJSON_Delete(parts);
        cJSON_Delete(once);
        cJSON_Delete(each);
        cJSON_Delete(base);
    }
}

// A quarter turn about the target and its up leaves the height and the distance, wherever the
// target is: with up along y, (x, z) from it becomes (z, -x).
static void camera_turns_about_its_target(void **state)
{
    cJSON *scene = cJSON_Parse("{\"camera\": {\"eye\": {\"x\": 3, \"y\": 2, \"z\": 5}, "
                               "\"target\": {\"x\": 1, \"y\": -4, \"z\": 2}}}");
    cJSON *base = cJSON_Duplicate(scene, 1), *parts = cJSON_CreateArray();
    struct change c = {0};
    c.delta[TARGET_CAMERA_AZIMUTH] = 90;
    assert_true(scene_change(scene, base, &c, -1, parts));
    const cJSON *camera = cJSON_GetObjectItem(scene, "camera");
    assert_true(fabs(number_at(camera, "eye", "x") - (1 + 3)) < 1e-6);
    assert_true(fabs(number_at(camera, "eye", "y") - 2) < 1e-6);
    assert_true(fabs(number_at(camera, "eye", "z") - (2 - 2)) < 1e-6);
    // The zoom halves the way to the target.
    memset(&c, 0, sizeof c);
    c.delta[TARGET_CAMERA_ZOOM] = 1;
    assert_true(scene_change(scene, base, &c, -1, parts));
    assert_true(fabs(number_at(camera, "eye", "x") - (1 + 1.5)) < 1e-6);
    assert_true(fabs(number_at(camera, "eye", "y") - (-4 + 3)) < 1e-6);
    assert_true(fabs(number_at(camera, "eye", "z") - (2 - 1)) < 1e-6);
    cJSON_Delete(parts);
    cJSON_Delete(base);
    cJSON_Delete(scene);
}

static double light_number(const cJSON *scene, int i, const char *field, const char *axis)
{
    const cJSON *light = cJSON_GetArrayItem(cJSON_GetObjectItem(scene, "lights"), i);
    if (axis) return number_at(light, field, axis);
    const cJSON *item = cJSON_GetObjectItem(light, field);
    return item ? item->valuedouble : NAN;
}

// Knobs go on from the light as it is, sliders from each light's own beginning. A camera by
// name is turned as an orbit without it.
static void lights_of_their_own(void **state)
{
    cJSON *scene = cJSON_Parse(
        "{\"lights\": [{\"rotate_deg\": 10, \"gain\": {\"x\": 1, \"y\": 0.5, \"z\": 0.25}}, "
        "{\"rotate_deg\": -40}], \"camera\": {\"name\": \"front\"}}");
    cJSON *base = cJSON_Duplicate(scene, 1), *parts = cJSON_CreateArray();
    struct change push = {0}, slide = {0}, zoom = {0};
    push.delta[TARGET_LIGHT_GAIN] = 1;
    for (int i = 0; i < 2; i++) assert_true(scene_change(scene, base, &push, -1, parts));
    assert_true(light_number(scene, 0, "gain", "x") == 4);
    assert_true(light_number(scene, 0, "gain", "z") == 1);
    assert_true(light_number(scene, 1, "gain", "y") == 4);
    push.delta[TARGET_LIGHT_GAIN] = 16;
    assert_true(scene_change(scene, base, &push, -1, parts));
    assert_true(light_number(scene, 0, "gain", "x") == 4 << 16);
    assert_true(scene_change(scene, base, &push, -1, parts));
    assert_true(light_number(scene, 0, "gain", "x") == 1e6);
    slide.has_position[TARGET_LIGHT_GAIN] = slide.has_position[TARGET_LIGHT_AZIMUTH] = true;
    slide.position[TARGET_LIGHT_GAIN] = -1;
    slide.position[TARGET_LIGHT_AZIMUTH] = 30;
    for (int i = 0; i < 2; i++) assert_true(scene_change(scene, base, &slide, -1, parts));
    assert_true(light_number(scene, 0, "gain", "y") == .25);
    assert_true(light_number(scene, 1, "gain", "y") == .5);
    assert_true(light_number(scene, 0, "rotate_deg", NULL) == 40);
    assert_true(light_number(scene, 1, "rotate_deg", NULL) == -10);
    zoom.delta[TARGET_CAMERA_ZOOM] = 2;
    assert_true(scene_change(scene, base, &zoom, -1, parts));
    const cJSON *camera = cJSON_GetObjectItem(scene, "camera");
    assert_false(cJSON_HasObjectItem(camera, "name"));
    assert_true(number_at(camera, "orbit", "zoom") == 4);
    cJSON_Delete(parts);
    cJSON_Delete(base);
    cJSON_Delete(scene);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(descriptors),
                                       cmocka_unit_test(last_usage_repeats),
                                       cmocka_unit_test(long_usages_name_their_page),
                                       cmocka_unit_test(report_ends_within_a_byte),
                                       cmocka_unit_test(curves),
                                       cmocka_unit_test(mapping_files),
                                       cmocka_unit_test(movements_are_summed),
                                       cmocka_unit_test(held_sticks_go_on),
                                       cmocka_unit_test(camera_sliders),
                                       cmocka_unit_test(camera_turns_about_its_target),
                                       cmocka_unit_test(lights_of_their_own),
                                       cmocka_unit_test(scenes)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
