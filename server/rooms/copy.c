// SPDX-License-Identifier: MIT
// All rooms of one store into another, by the interface of stores alone.
#include "rooms/copy.h"

#include "rooms/room_private.h"
#include "rooms/state.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_ROOMS = 1 << 30, TOGETHER = 200, FAULT = 400 };

struct step {
    struct room_task task; // first
    bool over;
};

static void over(struct room_task *task)
{
    ((struct step *)task)->over = true;
}

static void run(struct room_store *store, struct loop *loop, struct step *step)
{
    step->task.done = over;
    step->over = false;
    store->api->submit(store, &step->task);
    while (!step->over) loop_turn(loop, -1);
}

static bool read_log(struct room_store *store, struct loop *loop, const char *room,
                     struct step *out, char fault[FAULT])
{
    *out = (struct step){.task = {.kind = ROOM_TASK_EVENTS}};
    snprintf(out->task.room, sizeof out->task.room, "%s", room);
    run(store, loop, out);
    if (out->task.status == ROOM_TASK_FAILED)
        snprintf(fault, FAULT, "room %s cannot be read: %s", room, out->task.error);
    return out->task.status != ROOM_TASK_FAILED;
}

// The state that follows from a log; NULL with the fault's text.
static Relight__RoomState *fold_log(const char *room, const struct room_task *log,
                                    uint64_t *time_us, char fault[FAULT])
{
    Relight__RoomState *state = room_state_new(room);
    char why[ROOM_ERROR] = "not enough memory";
    for (size_t i = 0; state && i < log->n_event; i++) {
        const struct room_event_bytes *e = &log->event[i];
        Relight__RoomEvent *event = relight__room_event__unpack(NULL, e->n, e->bytes);
        int code = -1;
        if (event) code = room_fold(state, event, why);
        else snprintf(why, sizeof why, "it does not parse");
        if (event) time_us[i] = event->stamp ? event->stamp->time_us : 0;
        if (event) relight__room_event__free_unpacked(event, NULL);
        if (!code) continue;
        snprintf(fault, FAULT, "room %s: event %llu is damaged: %s", room,
                 (unsigned long long)e->sequence, why);
        room_state_free(state);
        return NULL;
    }
    if (!state) snprintf(fault, FAULT, "not enough memory");
    return state;
}

static bool same_log(const struct room_task *a, const struct room_task *b)
{
    bool same = a->n_event == b->n_event;
    for (size_t i = 0; same && i < a->n_event; i++)
        same = a->event[i].sequence == b->event[i].sequence && a->event[i].n == b->event[i].n &&
               !memcmp(a->event[i].bytes, b->event[i].bytes, a->event[i].n);
    return same;
}

// The events from `first` on; those that wait together are one transaction. The last one brings
// what lists need.
static bool append(struct room_store *to, struct loop *loop, const char *room,
                   const struct room_task *log, size_t first, const uint64_t *time_us,
                   const struct room_summary *summary, const char *keeps, char fault[FAULT])
{
    struct step *steps = calloc(TOGETHER, sizeof *steps);
    bool good = steps != NULL;
    if (!good) snprintf(fault, FAULT, "not enough memory");
    for (size_t at = first; good && at < log->n_event; at += TOGETHER) {
        size_t n = log->n_event - at < TOGETHER ? log->n_event - at : TOGETHER;
        for (size_t i = 0; i < n; i++) {
            const struct room_event_bytes *e = &log->event[at + i];
            steps[i] = (struct step){.task = {.kind = ROOM_TASK_APPEND,
                                              .sequence = e->sequence,
                                              .time_us = time_us[at + i],
                                              .bytes = e->bytes,
                                              .n = e->n,
                                              .done = over}};
            snprintf(steps[i].task.room, sizeof steps[i].task.room, "%s", room);
            if (at + i + 1 == log->n_event) {
                steps[i].task.summary = summary;
                steps[i].task.keeps = keeps;
            }
            to->api->submit(to, &steps[i].task);
        }
        for (size_t i = 0; i < n; i++) {
            while (!steps[i].over) loop_turn(loop, -1);
            if (!good || steps[i].task.status == ROOM_TASK_DONE) continue;
            good = false;
            snprintf(fault, FAULT, "room %s: event %llu cannot be written: %s", room,
                     (unsigned long long)steps[i].task.sequence,
                     steps[i].task.error[0] ? steps[i].task.error : "another log is there");
        }
    }
    free(steps);
    return good;
}

// *copied: events that were not there before.
static bool copy_room(struct room_store *from, struct room_store *to, struct loop *loop,
                      const char *room, size_t *copied, char fault[FAULT])
{
    struct step log, there = {0}, after = {0};
    struct room_summary summary = {0};
    Relight__RoomState *state = NULL;
    bool good = read_log(from, loop, room, &log, fault);
    uint64_t *time_us = good ? calloc(log.task.n_event + 1, sizeof *time_us) : NULL;
    if (good && !time_us) snprintf(fault, FAULT, "not enough memory");
    good = time_us && (state = fold_log(room, &log.task, time_us, fault)) &&
           read_log(to, loop, room, &there, fault);
    size_t first = there.task.n_event;
    char *keeps = good ? room_needs(state) : NULL;
    if (good && (!keeps || !room_summarise(state, &summary))) {
        snprintf(fault, FAULT, "not enough memory");
        good = false;
    }
    *copied = good && first < log.task.n_event ? log.task.n_event - first : 0;
    good = good && append(to, loop, room, &log.task, first, time_us, &summary, keeps, fault) &&
           read_log(to, loop, room, &after, fault);
    if (good && !same_log(&log.task, &after.task)) {
        snprintf(fault, FAULT, "room %s: the other store has another log of it", room);
        good = false;
    }
    summary_finish(&summary);
    free(keeps);
    room_state_free(state);
    free(time_us);
    room_task_finish(&log.task);
    room_task_finish(&there.task);
    room_task_finish(&after.task);
    return good;
}

static bool copy_all(struct room_store *from, struct room_store *to, struct loop *loop,
                     char fault[FAULT])
{
    struct step list = {.task = {.kind = ROOM_TASK_LIST, .most = MOST_ROOMS}};
    size_t events = 0, copied;
    run(from, loop, &list);
    bool good = list.task.status == ROOM_TASK_DONE;
    if (!good) snprintf(fault, FAULT, "the rooms cannot be listed: %s", list.task.error);
    for (size_t i = 0; good && i < list.task.n_row; i++) {
        good = copy_room(from, to, loop, list.task.row[i].room, &copied, fault);
        events += copied;
    }
    if (good)
        printf("relightd: %zu rooms are the same in both stores; %zu events were copied\n",
               list.task.n_row, events);
    room_task_finish(&list.task);
    return good;
}

int rooms_copy(const char *from, const char *to)
{
    const char *words[2] = {from, to};
    struct room_store *store[2] = {NULL, NULL};
    struct loop *loop = NULL;
    char fault[FAULT] = "not enough memory";
    bool good = !loop_create(&loop);
    for (int i = 0; i < 2 && good; i++) {
        const char *where;
        const struct room_store_api *api = room_store_parse(words[i], &where, fault);
        good = api && !api->open(where, loop, &store[i], fault);
    }
    good = good && copy_all(store[0], store[1], loop, fault);
    for (int i = 0; i < 2; i++)
        if (store[i]) store[i]->api->close(store[i]);
    if (loop) loop_destroy(loop);
    if (!good) fprintf(stderr, "relightd: %s\n", fault);
    return good ? 0 : 1;
}
