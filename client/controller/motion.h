/* SPDX-License-Identifier: MIT */
/* motion.h sums the movements of controls into one change and sends it: the latest position of
 * a control counts, at most MOST_REQUESTS requests are sent a second, and the first movement
 * after a pause is sent at once. */
#ifndef RELIGHT_CONTROL_MOTION_H
#define RELIGHT_CONTROL_MOTION_H

#include "mapping.h"

enum { MOST_REQUESTS = 125 };

/* The movements since the last request. Angles in degrees, others in stops. */
struct change {
    bool has_position[N_VALUE];
    double position[N_VALUE]; /* replaces the value: offset from its first one */
    double delta[N_VALUE];    /* then added */
    bool reset, undo, redo;
};

/* Sends a change. Called on the sender's thread; it may block while the socket is full.
 * Returns false where nothing was sent; the change is then dropped. */
typedef bool (*motion_send_fn)(void *user, const struct change *change);

struct motion;

/* Times from the report to the end of the send call, and numbers of requests and reports. */
struct motion_times {
    uint64_t requests, held; /* held: reports that waited for the limit of requests */
    double median_ms, p99_ms, most_ms;
    uint64_t most_a_second; /* requests in the fullest second */
};

/* Starts the sender's thread. NULL without memory. */
struct motion *motion_start(motion_send_fn send, void *user);
/* Stops the sender; a change that was not sent is dropped. */
void motion_stop(struct motion *motion, struct motion_times *times);

/* A device and its mapping, for motion_input. NULL without memory. */
struct bound *motion_bind(const struct device_map *map);
/* Takes the device's deflections out of the motion and frees `bound`; NULL is allowed. */
void motion_unbind(struct motion *motion, struct bound *bound);
const struct device_map *motion_map(const struct bound *bound);

/* Takes the movement of a control (usb_events.moved). Thread-safety: Safe. Blocks for
 * microseconds at most. */
void motion_input(struct motion *motion, struct bound *bound, const struct usb_control *control,
                  uint64_t previous_ns, uint64_t now_ns);

#endif
