// SPDX-License-Identifier: MIT
// SUBSCRIBE: answers with the daemon's events as they happen, and from a cursor on with those
// that a client missed. A client that reads slowly stays behind in the ring and loses events;
// nothing is queued for it.
#include "core/events.h"
#include "net/dispatch.h"
#include "net/request.h"
#include "relight.pb-c.h"
#include "store/models.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const size_t most_unsent = 64 << 10; // bytes of answers that wait: then events wait
static const uint64_t later_ns = 50000000;

enum { MAX_KIND = 32 };

struct subscription {
    struct request *request;
    struct events_reader reader;
    struct loop_timer timer;
    uint64_t at; // of the last event that was sent or skipped
    char model[MODEL_ID + 1];
    unsigned n_kind;
    int kind[MAX_KIND]; // none: all
};

static void leave(struct request *request)
{
    struct subscription *s = request->state;
    events_leave(request->server->events, &s->reader);
    loop_timer_stop(request->server->loop, &s->timer);
    free(s);
}

static void wake(struct events_reader *reader)
{
    struct subscription *s =
        (struct subscription *)((char *)reader - offsetof(struct subscription, reader));
    if (!s->timer.armed) loop_timer_set(s->request->server->loop, &s->timer, loop_now_ns());
}

static bool wanted(const struct subscription *s, const struct event *e)
{
    bool kind = !s->n_kind;
    for (unsigned i = 0; i < s->n_kind; i++) kind |= s->kind[i] == e->kind;
    if (e->visible_to[0] && strcmp(e->visible_to, s->request->conn->caller.name)) return false;
    if (!s->model[0] || !strcmp(s->model, e->model)) return kind;
    return kind && !strcmp(s->model, e->before); // its name went over
}

static void send_note(struct subscription *s, bool lost)
{
    Relight__Event out = RELIGHT__EVENT__INIT;
    out.run = s->request->server->run;
    out.sequence = s->at;
    out.lost = lost;
    request_part(s->request, &out.base, NULL);
}

static void send_event(struct subscription *s, const struct event *e)
{
    Relight__Event out = RELIGHT__EVENT__INIT;
    Relight__Progress progress = RELIGHT__PROGRESS__INIT;
    Relight__Error error;
    struct error_fields fields;
    out.run = s->request->server->run;
    out.sequence = e->sequence;
    out.time_us = e->time_us;
    out.kind = e->kind;
    out.model = (char *)e->model;
    out.before = (char *)e->before;
    out.name = (char *)e->name;
    out.env = (char *)e->env;
    out.state = e->model_state;
    out.generation = e->generation;
    if (e->error_code) error_fill(&error, e->error_code, e->error, &fields);
    if (e->job[0]) {
        progress.job = (char *)e->job;
        progress.model = (char *)e->model;
        progress.state = e->job_state;
        progress.stage = (char *)e->stage;
        progress.fraction = e->fraction;
        progress.eta_s = e->eta_s;
        progress.elapsed_s = e->elapsed_s;
        if (e->error_code) progress.error = &error;
        out.progress = &progress;
    } else if (e->error_code) {
        out.error = &error;
    }
    request_part(s->request, &out.base, NULL);
}

// Sends what there is, as far as the client reads.
static void deliver(struct loop_timer *timer)
{
    struct subscription *s =
        (struct subscription *)((char *)timer - offsetof(struct subscription, timer));
    struct connection *conn = s->request->conn;
    struct server *server = s->request->server;
    while (conn->out_bytes < most_unsent) {
        bool lost = false;
        const struct event *e = events_next(server->events, &s->at, &lost);
        if (lost) send_note(s, true);
        if (conn->dead || !e) return; // dead: the subscription was freed with it
        if (wanted(s, e)) send_event(s, e);
        if (conn->dead) return;
    }
    loop_timer_set(server->loop, &s->timer, loop_now_ns() + later_ns);
}

void op_subscribe(struct request *request)
{
    const Relight__SubscribeRequest *in = (const Relight__SubscribeRequest *)request->message;
    struct server *server = request->server;
    struct connection *conn = request->conn;
    if (in->room[0]) {
        room_subscribe(request);
        return;
    }
    if (is_guest(request->conn->caller.name)) {
        request->hint = "SUBSCRIBE with the id of the invitation's room";
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "a guest can subscribe to the room of the invitation alone: set `room`");
        return;
    }
    if (in->n_kinds > MAX_KIND) {
        char error[128];
        request_fail(
            request,
            range_refuse(error, sizeof error, (double)in->n_kinds, 0, MAX_KIND, "", "kinds"),
            "%s", error);
        return;
    }
    if (in->model[0] &&
        (strlen(in->model) != MODEL_ID || in->model[strspn(in->model, "0123456789abcdef")])) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "model: expected an id of 32 hex digits");
        return;
    }
    struct subscription *s = calloc(1, sizeof *s);
    if (!s) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    s->request = request;
    s->n_kind = (unsigned)in->n_kinds;
    for (unsigned i = 0; i < s->n_kind; i++) s->kind[i] = (int)in->kinds[i];
    strcpy(s->model, in->model);
    uint64_t newest = events_newest(server->events);
    bool resumed = in->run[0] && !strcmp(in->run, server->run) && in->after <= newest;
    s->at = resumed ? in->after : newest;
    s->reader.wake = wake;
    s->timer.fire = deliver;
    events_enter(server->events, &s->reader);
    request->state = s;
    request->abandon = leave;
    send_note(s, in->run[0] && !resumed);
    if (!conn->dead) wake(&s->reader);
}
