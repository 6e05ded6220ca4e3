/* SPDX-License-Identifier: MIT */
/* motion.h gathers what controls do into one change, and sends it: latest wins, at most
 * MOST_REQUESTS a second, at once when nothing was sent for a while. */
#ifndef RELIGHT_CONTROL_MOTION_H
#define RELIGHT_CONTROL_MOTION_H

#include "mapping.h"

enum { MOST_REQUESTS = 125 };

/* What happened since the last request. Angles in degrees, others in stops. */
struct change {
    bool has_position[N_VALUE];
    double position[N_VALUE]; /* in place of the value: offset from where the program began */
    double delta[N_VALUE];    /* then added */
    bool reset, undo, redo;
};

/* Sends a change. Called on the sender's thread; it may block while the socket is full.
 * Returns false where nothing was sent: the change is dropped. */
typedef bool (*motion_send_fn)(void *user, const struct change *change);

struct motion;

/* Times from the report to the end of the send call, and how many reports each request took. */
struct motion_times {
    uint64_t requests, held; /* held: reports that waited for the limit of requests */
    double median_ms, p99_ms, most_ms;
    uint64_t most_a_second; /* requests in the fullest second */
};

/* Starts the sender's thread. NULL without memory. */
struct motion *motion_start(motion_send_fn send, void *user);
/* Stops it; what was not sent is dropped. */
void motion_stop(struct motion *motion, struct motion_times *times);

/* A device and its mapping, for motion_input. NULL without memory. */
struct bound *motion_bind(const struct device_map *map);
/* What the device still moved stands still. bound: NULL is allowed; it is freed. */
void motion_unbind(struct motion *motion, struct bound *bound);
const struct device_map *motion_map(const struct bound *bound);

/* A control moved (usb_events.moved). Thread-safety: Safe. Does not block for long. */
void motion_input(struct motion *motion, struct bound *bound, const struct usb_control *control,
                  uint64_t previous_ns, uint64_t now_ns);

#endif
