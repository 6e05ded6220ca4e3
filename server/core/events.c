// SPDX-License-Identifier: MIT
// The ring of events and its readers.
#include "core/events.h"

#include "relight.pb-c.h"

#include <stdlib.h>
#include <string.h>
#include <time.h>

struct events {
    unsigned n;
    uint64_t newest;
    struct events_reader *readers;
    struct event ring[]; /* [n]; the event of sequence s is at s % n */
};

int events_create(unsigned n, struct events **out)
{
    struct events *events = calloc(1, sizeof *events + n * sizeof *events->ring);
    if (!events) return -1;
    events->n = n;
    *out = events;
    return 0;
}

void events_destroy(struct events *events)
{
    free(events);
}

static uint64_t oldest(const struct events *events)
{
    return events->newest > events->n ? events->newest - events->n + 1 : 1;
}

// Only the newest state of a model or a job matters: an older event about it becomes void.
static void replace_older(struct events *events, const struct event *event)
{
    bool model = event->kind == RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED;
    if (!model && event->kind != RELIGHT__EVENT_KIND__EVENT_JOB) return;
    for (unsigned i = 0; i < events->n; i++) {
        struct event *e = &events->ring[i];
        if (e->kind != event->kind) continue;
        if (!strcmp(e->model, event->model) && !strcmp(e->job, event->job)) e->kind = 0;
    }
}

void events_publish(struct events *events, const struct event *event)
{
    struct timespec now;
    if (!events) return;
    replace_older(events, event);
    clock_gettime(CLOCK_REALTIME, &now);
    struct event *to = &events->ring[++events->newest % events->n];
    *to = *event;
    to->sequence = events->newest;
    to->time_us = (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
    for (struct events_reader *r = events->readers; r; r = r->next) r->wake(r);
}

uint64_t events_newest(const struct events *events)
{
    return events->newest;
}

const struct event *events_next(const struct events *events, uint64_t *at, bool *lost)
{
    uint64_t first = oldest(events);
    if (*at + 1 < first) {
        *lost = true;
        *at = first - 1;
    }
    while (*at < events->newest) {
        const struct event *e = &events->ring[++*at % events->n];
        if (e->kind) return e;
    }
    return NULL;
}

void events_enter(struct events *events, struct events_reader *reader)
{
    reader->next = events->readers;
    events->readers = reader;
}

void events_leave(struct events *events, struct events_reader *reader)
{
    struct events_reader **at = &events->readers;
    while (*at && *at != reader) at = &(*at)->next;
    if (*at) *at = reader->next;
}
