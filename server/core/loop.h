/* SPDX-License-Identifier: MIT */
/* loop.h owns the event loop: descriptors, timers, signals and messages from other threads.
 * All state of the daemon is confined to the loop's thread; no locks. */
#ifndef RELIGHTD_LOOP_H
#define RELIGHTD_LOOP_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct loop;

/* A descriptor that is watched. Embedded in its owner; remove it before freeing. */
struct loop_watch {
    int fd;
    void (*ready)(struct loop_watch *watch, uint32_t epoll_events);
};

/* A timer, embedded in its owner. Zero-initialise. */
struct loop_timer {
    uint64_t at_ns;
    bool armed;
    struct loop_timer *child, *next,
        *prev; /* of the heap; prev: the one before it, or its parent */
    void (*fire)(struct loop_timer *timer);
};

/* A message from another thread: `handle` runs on the loop's thread. */
struct loop_message {
    struct loop_message *next;
    void (*handle)(struct loop_message *message);
};

int loop_create(struct loop **out); /* 0 or -errno */
void loop_destroy(struct loop *loop);

int loop_watch_add(struct loop *loop, struct loop_watch *watch, uint32_t epoll_events);
void loop_watch_change(struct loop *loop, struct loop_watch *watch, uint32_t epoll_events);
void loop_watch_remove(struct loop *loop, struct loop_watch *watch); /* fd stays open */

void loop_timer_set(struct loop *loop, struct loop_timer *timer, uint64_t at_ns);
void loop_timer_stop(struct loop *loop, struct loop_timer *timer);

/* Thread-safe. */
void loop_post(struct loop *loop, struct loop_message *message);

/* Hands these signals to fn on the loop's thread. */
int loop_signals(struct loop *loop, const int *signals, size_t n,
                 void (*fn)(void *user, int signal), void *user);

/* Handles pending events; waits up to timeout_ms for one (-1: without limit). */
void loop_turn(struct loop *loop, int timeout_ms);
/* A descriptor that is readable whenever loop_turn has work: to run inside another loop. */
int loop_fd(const struct loop *loop);

uint64_t loop_now_ns(void); /* monotonic */

#endif
