// SPDX-License-Identifier: MIT
// Strokes over the picture of a pin lie where its camera shows them, whatever its up is.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "picture_compare.h"
#include "room.h"

enum { EDGE = 32 };

static struct relight_camera camera; // of the next picture
static uint8_t drawn[EDGE * EDGE * 3];

// ---- a daemon's black picture, and a file that is kept here

int relight_room_picture(struct relight_client *client, const char *room,
                         const struct relight_room_view *view, struct relight_image *out,
                         struct relight_error *error)
{
    static uint8_t black[EDGE * EDGE * 3];
    *out = (struct relight_image){
        .camera = camera, .width = EDGE, .height = EDGE, .data = black, .n_byte = sizeof black};
    return 0;
}

void relight_image_finish(struct relight_image *image)
{
}

void *encode_png(const uint8_t *rgb, uint32_t width, uint32_t height, size_t *n)
{
    assert_true(width == EDGE && height == EDGE);
    memcpy(drawn, rgb, sizeof drawn);
    *n = 1;
    return malloc(1);
}

int write_file(const struct options *options, const char *path, const void *bytes, size_t n)
{
    return 0;
}

int report_usage(const struct options *options, const char *fmt, ...)
{
    fail_msg("%s", fmt);
    return 1;
}

int room_failed(struct room_call *c)
{
    fail_msg("no picture");
    return 1;
}

double number_of(const cJSON *json, const char *field)
{
    const cJSON *item = cJSON_GetObjectItemCaseSensitive(json, field);
    return cJSON_IsNumber(item) ? item->valuedouble : 0;
}

const cJSON *list_of(const cJSON *json, const char *field)
{
    return cJSON_GetObjectItemCaseSensitive(json, field);
}

// ---- one point that is drawn in red

// The mean pixel of what was drawn, from the middle of the picture, the second one upwards.
static void draw(float up_x, float up_y, float up_z, double x, double y, double out[2])
{
    char text[256];
    struct room_call call = {0};
    camera = (struct relight_camera){
        .eye = {0, 0, 2}, .target = {0, 0, 0}, .up = {up_x, up_y, up_z}, .fovy_deg = 90};
    snprintf(text, sizeof text,
             "{\"strokes\": [{\"line\": {\"pin\": 3, \"width\": 2, \"color\": 16711680, "
             "\"points\": [{\"position\": {\"x\": %g, \"y\": %g, \"z\": 0}}]}}]}",
             x, y);
    cJSON *state = cJSON_Parse(text);
    assert_non_null(state);
    assert_int_equal(room_write_strokes(&call, state, 3, "picture.png"), 0);
    cJSON_Delete(state);
    int n = 0;
    out[0] = out[1] = 0;
    for (int j = 0; j < EDGE; j++)
        for (int i = 0; i < EDGE; i++) {
            const uint8_t *at = drawn + 3 * (j * EDGE + i);
            if (!at[0]) continue;
            assert_true(at[0] == 255 && !at[1] && !at[2]);
            out[0] += i + .5 - EDGE / 2;
            out[1] += EDGE / 2 - (j + .5);
            n++;
        }
    assert_true(n > 0);
    out[0] /= n;
    out[1] /= n;
}

static void expect_pixel(const double at[2], double x, double y)
{
    assert_float_equal(at[0], x, .6);
    assert_float_equal(at[1], y, .6);
}

// 32 pixels are 4 units at the distance 2 under 90 degrees: 8 pixels a unit.
static void camera_and_its_up(void **state)
{
    double at[2];
    draw(0, 1, 0, 1, .5, at);
    expect_pixel(at, 8, 4);
    draw(1, 0, 0, 1, .5, at); // lies on its side: +x is up, +y is to the left
    expect_pixel(at, -4, 8);
    draw(0, -1, 0, 1, .5, at);
    expect_pixel(at, -8, -4);
    draw(1, 1, 0, 1, 1, at);
    expect_pixel(at, 0, 8 * 1.4142);
    draw(0, 0, 0, 1, .5, at); // none: +y
    expect_pixel(at, 8, 4);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(camera_and_its_up)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
