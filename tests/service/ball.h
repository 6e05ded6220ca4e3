// SPDX-License-Identifier: MIT
// What the tests of pictures without a bake share: a relightd, a client, a ball of a few
// hundred vertices loaded for previews, its pictures, and the exact sum they are measured
// against.
#ifndef TESTS_SERVICE_BALL_H
#define TESTS_SERVICE_BALL_H

#include "daemon.h"

#include "prt/screen.h"

#include <math.h>

enum { RINGS = 16, SIDES = 24, N_VERTEX = 2 + (RINGS - 1) * SIDES, SIDE = 96, CUBE = 16 };
extern struct daemon d;
extern struct relight_client *client;
extern struct relight_error error;
extern char ball[ID_SIZE]; // loaded with --preview, never baked
extern const struct relight_light white;

void write_ball(const char *path, float stretch);
struct relight_load small_load(bool preview);
int load_ball(const char *name, struct relight_load load, struct relight_loaded *out);
int ball_setup(void **state);
int ball_teardown(void **state);
const struct relight_light *sun(void);
struct relight_image_request request_of(const char *model, enum relight_engine engine);
float *pixels_of(const struct relight_image *image);
// Over pixels that either picture covers.
double difference(const float *a, const float *b, size_t n);
void expect(int status, int code, const char *word);
float *picture(const struct relight_image_request *r, struct relight_cost *cost);
// The exact sum over the surface of a file of the daemon's folder at 20 mm, under sun() by the
// same camera; maps are the options'.
float *exact_by(const struct relight_camera *seen, const char *file,
                const struct prt_material *material, struct prt_screen_options options);
float *exact_picture(const struct relight_camera *seen); // of ball.obj in skin1
// The next picture of a view; frame->image is the caller's.
void next_frame(struct relight_view *view, struct relight_frame_out *frame);
struct relight_view *open_view(const char *model, enum relight_engine engine);

#endif
