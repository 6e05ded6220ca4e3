/* SPDX-License-Identifier: MIT */
/* events.h owns the daemon's events: a ring of the last ones, from which every subscription
 * reads at its own pace (ops/op_events.c). A subscription costs no memory for events it has not
 * read: where it falls behind by a whole ring, it learns that events were lost.
 * Thread-safety: loop thread only. */
#ifndef RELIGHTD_EVENTS_H
#define RELIGHTD_EVENTS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct events;

/* Fields that a kind does not have stay zero. */
struct event {
    uint64_t sequence, time_us; /* set by events_publish */
    int kind;                   /* Relight__EventKind; 0 in the ring: a newer one replaced it */
    char visible_to[96];        /* a principal's name; "": everybody */
    char model[40], before[40]; /* ids; before: of the version that this model replaces */
    char name[128];             /* of the model, as its owner called it; of an environment */
    char env[72];               /* "env:HASH" */
    int model_state;            /* Relight__ModelState */
    uint64_t generation;
    char job[32], stage[64];
    int job_state; /* Relight__JobState */
    float fraction, eta_s, elapsed_s;
    int error_code; /* of a failed model or job */
    char error[400];
};

/* n: events that are kept. 0 or -1 without memory. */
int events_create(unsigned n, struct events **out);
void events_destroy(struct events *events); /* every reader must have left; NULL is fine */

/* Adds an event; calls no client's code: readers are woken for the loop's next turn. An event
 * of kind MODEL_CHANGED or JOB replaces an earlier one of the same kind about the same model or
 * job. events may be NULL (tests without a daemon). */
void events_publish(struct events *events, const struct event *event);

/* The sequence of the newest event; 0: none yet. */
uint64_t events_newest(const struct events *events);
/* The first event after *at, which is set to its sequence; NULL when there is none. *lost is
 * set where events between *at and it are no longer kept. */
const struct event *events_next(const struct events *events, uint64_t *at, bool *lost);

/* One who is told when there are new events. */
struct events_reader {
    struct events_reader *next;
    void (*wake)(struct events_reader *reader); /* may not enter or leave readers */
};
void events_enter(struct events *events, struct events_reader *reader);
void events_leave(struct events *events, struct events_reader *reader);

#endif
