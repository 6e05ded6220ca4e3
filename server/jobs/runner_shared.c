// SPDX-License-Identifier: MIT
// The runner where replicas share a folder: one replica at a time bakes a model. It claims the
// model's id, has the configured runner bake it, puts the bake into the folder and only then
// ends. A replica that does not get the claim waits, with the progress that the owner's claim
// tells, until the bake is there or the owner has died.
#include "jobs/jobs.h"
#include "core/log.h"
#include "core/server.h"
#include "store/object_store.h"

#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t beat_ns = 2000000000, look_ns = 500000000, again_ns = 5000000000u;
static const double stale_s = 10;

enum step { STEP_CLAIM, STEP_BAKE, STEP_PUT, STEP_RELEASE };

struct job_run {
    struct work work; // first: one file operation at a time
    struct loop_timer timer;
    struct server *server;
    struct job_order order; // the job's
    struct job_events events;
    void *user;
    enum step step, doing;          // wanted; of the file operation under way
    bool working, cancelled, found; // found: the bake is in the folder
    struct object_watch watch;
    struct object_claim *claim;
    struct job_run *inner;
    char path[PATH_MAX], note[90];
    int err;
    enum job_outcome outcome;
    char error[480];
};

static const struct job_runner *runner = &job_runner_child;

static int run_step(struct work *work, const struct prt_context *ctx)
{
    struct job_run *r = (struct job_run *)work;
    struct object_store *objects = r->server->objects;
    uint64_t bytes;
    switch (r->doing) {
    case STEP_CLAIM:
        r->err = object_find(objects, OBJECT_BAKE, r->order.model, &bytes);
        r->found = !r->err;
        if (r->err == -ENOENT)
            r->err = object_claim_take(objects, r->order.model, stale_s, &r->watch, &r->claim);
        // Its owner may have put the bake and released the claim since the first look.
        if (r->claim && !object_find(objects, OBJECT_BAKE, r->order.model, &bytes))
            r->found = true;
        break;
    case STEP_BAKE:
        r->err = object_claim_beat(r->claim, r->note);
        break;
    case STEP_PUT:
        r->err = object_put(objects, OBJECT_BAKE, r->order.model, r->path);
        (void)object_claim_beat(r->claim, "storing");
        break;
    case STEP_RELEASE:
        if (r->claim) object_claim_release(r->claim);
        r->claim = NULL;
    }
    return PRT_OK;
}

static void done_step(struct work *work);

static void start(struct job_run *r, enum step step)
{
    r->step = r->doing = step;
    r->working = true;
    r->work.run = run_step;
    r->work.done = done_step;
    r->work.class = WORK_BACKGROUND;
    work_submit(r->server->work, &r->work);
}

static void later(struct job_run *r, uint64_t ns)
{
    loop_timer_set(r->server->loop, &r->timer, loop_now_ns() + ns);
}

// The next file operation: the claim goes, then the job ends.
static void end(struct job_run *r, enum job_outcome outcome, const char *error)
{
    r->outcome = outcome;
    snprintf(r->error, sizeof r->error, "%s", error);
    loop_timer_stop(r->server->loop, &r->timer);
    if (!r->working) start(r, STEP_RELEASE);
    else r->step = STEP_RELEASE;
}

// ---- the bake itself

static void progress(void *user, const char *stage, double fraction, double eta_s)
{
    struct job_run *r = user;
    snprintf(r->note, sizeof r->note, "%.40s %.4f %.1f", stage, fraction, eta_s);
    r->events.progress(r->user, stage, fraction, eta_s);
}

static void line(void *user, const char *text)
{
    struct job_run *r = user;
    r->events.line(r->user, text);
}

static void ended(void *user, enum job_outcome outcome, const char *error)
{
    struct job_run *r = user;
    r->inner = NULL;
    if (outcome != JOB_OUT_DONE) {
        end(r, outcome, error ? error : "");
        return;
    }
    loop_timer_stop(r->server->loop, &r->timer);
    r->events.progress(r->user, "storing", 1, -1);
    r->outcome = JOB_OUT_DONE;
    if (r->working) r->step = STEP_PUT;
    else start(r, STEP_PUT);
}

static void bake(struct job_run *r)
{
    static const struct job_events events = {progress, line, NULL, ended};
    char error[256] = "";
    r->step = STEP_BAKE;
    r->events.idle(r->user, false);
    later(r, beat_ns);
    r->inner = runner->start(r->server, &r->order, &events, r, error);
    if (!r->inner) end(r, JOB_OUT_FAILED, error);
}

// ---- after a file operation

// Another replica bakes: its claim's note is the progress.
static void claimed_by_another(struct job_run *r)
{
    char stage[64], owner[100];
    double fraction, eta_s;
    if (sscanf(r->watch.text, "%99s %*u %63s %lf %lf", owner, stage, &fraction, &eta_s) == 4 &&
        fraction >= 0 && fraction <= 1)
        r->events.progress(r->user, stage, fraction, eta_s);
    else r->events.progress(r->user, "claimed by another replica", 0, -1);
    r->events.idle(r->user, true);
    later(r, look_ns);
}

static void claim_done(struct job_run *r)
{
    if (r->cancelled) {
        end(r, JOB_OUT_CANCELLED, "cancelled");
    } else if (r->found) {
        end(r, JOB_OUT_DONE, "");
    } else if (r->claim) {
        bake(r);
    } else if (r->err == -EBUSY) {
        claimed_by_another(r);
    } else {
        log_line(LOG_WARN, "model=%s cannot be claimed in --store: %s", r->order.model,
                 strerror(-r->err));
        r->events.progress(r->user, "waiting for --store", 0, -1);
        later(r, again_ns);
    }
}

static void put_done(struct job_run *r)
{
    if (!r->err) {
        end(r, JOB_OUT_DONE, "");
        return;
    }
    log_line(LOG_WARN, "model=%s: its bake cannot be put into --store, tried again: %s",
             r->order.model, strerror(-r->err));
    if (r->cancelled) end(r, JOB_OUT_CANCELLED, "cancelled");
    else later(r, again_ns);
}

static void release_done(struct job_run *r)
{
    r->events.ended(r->user, r->outcome, r->error);
    free(r);
}

static void done_step(struct work *work)
{
    struct job_run *r = (struct job_run *)work;
    r->working = false;
    if (r->doing != r->step) { // the bake ended meanwhile
        start(r, r->step);
        return;
    }
    switch (r->step) {
    case STEP_CLAIM:
        claim_done(r);
        break;
    case STEP_BAKE:
        if (r->err == -ESTALE)
            log_line(LOG_WARN, "model=%s: another replica has taken over its claim",
                     r->order.model);
        later(r, beat_ns);
        break;
    case STEP_PUT:
        put_done(r);
        break;
    case STEP_RELEASE:
        release_done(r);
    }
}

static void fire(struct loop_timer *timer)
{
    struct job_run *r = (struct job_run *)((char *)timer - offsetof(struct job_run, timer));
    if (!r->working) start(r, r->step);
}

static struct job_run *shared_start(struct server *server, const struct job_order *order,
                                    const struct job_events *events, void *user,
                                    char error[256])
{
    struct job_run *r = calloc(1, sizeof *r);
    if (!r) {
        snprintf(error, 256, "not enough memory");
        return NULL;
    }
    *r = (struct job_run){
        .server = server, .order = *order, .events = *events, .user = user, .timer.fire = fire};
    snprintf(r->path, sizeof r->path, "%s/bakes/%s.prt", server->data, order->model);
    start(r, STEP_CLAIM);
    return r;
}

static void shared_cancel(struct job_run *r)
{
    r->cancelled = true;
    if (r->inner) runner->cancel(r->inner);
    else if (!r->working && r->step != STEP_RELEASE) end(r, JOB_OUT_CANCELLED, "cancelled");
}

static bool shared_reap(int pid, int how)
{
    return runner->reap(pid, how);
}

// Each replica makes a draft for its own clients.
const struct job_runner job_runner_shared = {"shared", shared_start, shared_cancel, shared_reap,
                                             &job_runner_child};
