/* SPDX-License-Identifier: MIT */
/* control.h declares the options, the destinations and the tasks of relight-control. */
#ifndef RELIGHT_CONTROL_H
#define RELIGHT_CONTROL_H

#include "common/program.h"
#include "motion.h"
#include "relight/relight.h"

#include <cjson/cJSON.h>

enum { MOST_LIGHTS = 16 };

enum task { TASK_CONTROL, TASK_LIST, TASK_CHECK, TASK_LEARN };
struct options {
    enum task task;
    const char *server, *ca, *target;         /* target: ID or ROOM */
    const char *mapping, *output, *as, *file; /* file: of --check and --learn */
    const char *env[MOST_LIGHTS];
    uint32_t n_env;
    int light;     /* 0-based; -1: all */
    double for_s;  /* 0: until a signal */
    double wait_s; /* of each question of --learn */
    bool camera;   /* default mappings move the camera */
    bool measure, json, quiet;
    struct relight_picture picture;
    float rotate_deg;
    uint32_t n_named; /* --device */
    struct {
        uint16_t vendor, product;
    } named[MOST_DEVICES];
};
/* Reads the command line; exits with EXIT_USAGE. */
void options_parse(int argc, char **argv, struct options *out);

struct control {
    struct options options;
    struct mapping mapping;
    struct relight_client *client;
    struct usb *usb;
    struct motion *motion;
    struct destination *destination;
    const char *me; /* display name in a room */
};

/* A line on standard error, with the program's name and without control characters. */
void say(const char *fmt, ...) __attribute__((format(printf, 1, 2)));
/* Prints an error and returns its exit status. */
int report(const struct relight_error *error);
/* Switches the devices' lights on or off as the destination gets or loses its daemon.
 * Thread-safe. */
void show_connected(struct control *control, bool connected);

/* The receiver of changes: a view of a model, or a room. */
struct destination {
    motion_send_fn send; /* with the destination as user */
    void (*stop)(struct destination *destination);
};
/* Each returns NULL after reporting, with the exit status in *status. */
struct destination *open_view(struct control *control, int *status);
struct destination *open_room(struct control *control, const char *room, int *status);

/* scene_change.c: a change applied to a room's scene (JSON of Scene). base: the scene as it was
 * when the program joined, for reset and for sliders. light: index, -1: all. Names of the parts
 * that changed are appended to `parts`; false: nothing changed. */
bool scene_change(cJSON *scene, const cJSON *base, const struct change *change, int light,
                  cJSON *parts);

/* learn.c: each an exit status. */
int run_list(struct control *control);
int run_check(struct control *control);
int run_learn(struct control *control);

#endif
