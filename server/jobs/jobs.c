// SPDX-License-Identifier: MIT
// The queue of bakes. Finished jobs are kept for a while, so that a late WATCH still gets their
// result.
#include "jobs/job_private.h"

#include "core/events.h"
#include "core/log.h"
#include "prt/base.h"
#include "relight.pb-c.h"
#include "net/request.h"
#include "core/server.h"

#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { REMEMBERED = 256 };
static const uint64_t notify_gap_ns =
    100000000; // between two progress messages: at most ten a second
static const uint64_t publish_gap_ns = 1000000000; // between two events: one a second

static void tell(struct job *job, struct request *request, bool last)
{
    Relight__Progress progress = RELIGHT__PROGRESS__INIT;
    Relight__Error error;
    struct error_fields fields;
    uint64_t end = job->ended_ns ? job->ended_ns : loop_now_ns();
    progress.job = job->id;
    progress.model = job->model;
    progress.state = job->state;
    progress.stage = job->stage;
    progress.fraction = (float)job->fraction;
    progress.eta_s = (float)job->eta_s;
    if (job->started_ns) progress.elapsed_s = (float)((double)(end - job->started_ns) * 1e-9);
    if (job->state == RELIGHT__JOB_STATE__JOB_FAILED) {
        error_fill(&error, RELIGHT__ERROR_CODE__ERROR_JOB_FAILED, job->error, &fields);
        progress.error = &error;
    }
    if (last) request_answer(request, &progress.base, NULL);
    else request_part(request, &progress.base, NULL);
}

static void publish(struct job *job)
{
    uint64_t end = job->ended_ns ? job->ended_ns : loop_now_ns();
    struct event e = {.kind = RELIGHT__EVENT_KIND__EVENT_JOB,
                      .job_state = job->state,
                      .fraction = (float)job->fraction,
                      .eta_s = (float)job->eta_s};
    if (job->started_ns) e.elapsed_s = (float)((double)(end - job->started_ns) * 1e-9);
    snprintf(e.job, sizeof e.job, "%s", job->id);
    snprintf(e.model, sizeof e.model, "%s", job->model);
    snprintf(e.stage, sizeof e.stage, "%s", job->stage);
    if (job->state == RELIGHT__JOB_STATE__JOB_FAILED) {
        e.error_code = RELIGHT__ERROR_CODE__ERROR_JOB_FAILED;
        snprintf(e.error, sizeof e.error, "%s", job->error);
    }
    job->published_ns = end;
    events_publish(job->jobs->server->events, &e);
}

static void remove_watcher(struct request *request)
{
    struct job *job = request->state;
    struct watcher **at = &job->watcher;
    while (*at && (*at)->request != request) at = &(*at)->next;
    if (!*at) return;
    struct watcher *w = *at;
    *at = w->next;
    free(w);
}

static void tell_all(struct job *job, bool now)
{
    uint64_t t = loop_now_ns();
    if (!now && t - job->told_ns < notify_gap_ns) return;
    job->told_ns = t;
    if (now || t - job->published_ns >= publish_gap_ns) publish(job);
    // A watcher whose connection breaks removes itself during its notification: iterate by
    // number.
    for (unsigned i = 0;; i++) {
        struct watcher *w = job->watcher;
        for (unsigned k = 0; w && k < i; k++) w = w->next;
        if (!w) break;
        tell(job, w->request, false);
    }
}

static void tell_end(struct job *job)
{
    while (job->watcher) {
        struct watcher *w = job->watcher;
        job->watcher = w->next;
        struct request *request = w->request;
        free(w);
        request->abandon = NULL;
        tell(job, request, true);
    }
}

// Called only where a job is added: callers that end a job, and its callbacks, still read it.
static void forget_old(struct jobs *jobs)
{
    struct job **at = &jobs->job;
    for (unsigned n = 0; *at;) {
        struct job *job = *at;
        if (!job->ended_ns || ++n <= REMEMBERED) {
            at = &job->next;
            continue;
        }
        *at = job->next;
        job_forget(job);
        job_free(job);
    }
}

// Removes the folder's path from errors that clients see.
static void keep_error(struct job *job, const char *text)
{
    const char *models = job->jobs->server->options.models, *at = NULL;
    char root[PATH_MAX + 1] = "";
    if (models[0] && realpath(models, root)) {
        strcat(root, "/");
        at = strstr(text, root);
    }
    snprintf(job->error, sizeof job->error, "%.*s%s", at ? (int)(at - text) : 0, text,
             at ? at + strlen(root) : text);
}

static void end_job(struct job *job, enum job_outcome outcome, const char *error)
{
    static const int state[] = {RELIGHT__JOB_STATE__JOB_DONE, RELIGHT__JOB_STATE__JOB_FAILED,
                                RELIGHT__JOB_STATE__JOB_CANCELLED};
    struct jobs *jobs = job->jobs;
    struct stats *stats = &jobs->server->stats;
    job->ended_ns = loop_now_ns();
    job->state = state[outcome];
    job->eta_s = outcome == JOB_OUT_DONE ? 0 : -1;
    job->run = NULL;
    job->drafting = false;
    if (outcome == JOB_OUT_DONE) {
        pace_learn(&job->pace, &job->order.kind, &jobs->history, (double)job->ended_ns * 1e-9);
        job->fraction = 1;
    }
    keep_error(job, error ? error : "");
    uint64_t *count[] = {&stats->bakes_done, &stats->bakes_failed, &stats->bakes_cancelled};
    ++*count[outcome];
    static const char *const word[] = {"done", "failed", "cancelled"};
    log_line(outcome == JOB_OUT_FAILED ? LOG_WARN : LOG_EVENT,
             "job id=%s request=%s model=%s %s after=%.1fs error=\"%s\"", job->id,
             job->order.request_id, job->model, word[outcome],
             job->started_ns ? (double)(job->ended_ns - job->started_ns) * 1e-9 : 0.0,
             job->error);
    if (job->done) job->done(job->user, job, outcome);
    job_remember(job);
    job_remove_folder(job);
    publish(job);
    tell_end(job);
}

static void on_progress(void *user, const char *stage, double fraction, double eta_s)
{
    struct job *job = user;
    char name[sizeof job->stage];
    if (pace_is_walk(stage)) {
        if (!job->order.kind.walk) {
            job->order.kind.walk = true;
            pace_plan(&job->pace, &job->order.kind, &job->jobs->history);
        }
        return;
    }
    snprintf(name, sizeof name, "%s%.40s", job->drafting ? "draft-" : "", stage);
    bool fresh = strcmp(job->stage, name) != 0;
    memcpy(job->stage, name, sizeof name);
    const double now_s = (double)loop_now_ns() * 1e-9;
    pace_report(&job->pace, job->drafting, stage, fraction, now_s);
    job->fraction = job->pace.fraction;
    job->eta_s = pace_left_s(&job->pace, now_s);
    tell_all(job, fresh);
}

static void on_line(void *user, const char *line)
{
    struct job *job = user;
    log_line(LOG_EVENT, "job id=%s request=%s output=\"%s\"", job->id, job->order.request_id,
             line);
    if (job->drafting || strncmp(line, "warning: ", 9)) return; // the bake repeats it
    size_t n = strlen(job->warnings);
    snprintf(job->warnings + n, sizeof job->warnings - n, "%s\n", line + 9);
}

// It is as it was before it started; its folder and its record stay.
static void suspend(struct job *job)
{
    job->suspended = true;
    job->state = RELIGHT__JOB_STATE__JOB_QUEUED;
    log_line(LOG_EVENT, "job id=%s model=%s suspended at=%.2f", job->id, job->model,
             job->fraction);
    if (job->done) job->done(job->user, job, JOB_OUT_SUSPENDED);
    job->done = NULL;
}

static void start_next(struct jobs *jobs);
static void on_ended(void *user, enum job_outcome outcome, const char *error);
static void on_idle(void *user, bool idle);

static const struct job_runner *runner_of(const struct job *job)
{
    const struct job_runner *runner = job->jobs->runner;
    return job->drafting && runner->draft ? runner->draft : runner;
}

static void start_run(struct job *job, bool draft, char error[256])
{
    static const struct job_events events = {on_progress, on_line, on_idle, on_ended};
    struct job_order order = job->order;
    if (draft) order.argv = order.draft;
    job->drafting = draft;
    job->run = runner_of(job)->start(job->jobs->server, &order, &events, job, error);
}

// The draft has ended, well or not: the bake follows in the same place of the queue. False: it
// could not be started.
static bool bake_after_draft(struct job *job, enum job_outcome outcome, char error[256])
{
    log_line(outcome == JOB_OUT_DONE ? LOG_EVENT : LOG_WARN,
             "job id=%s request=%s model=%s draft %s after=%.1fs", job->id,
             job->order.request_id, job->model, outcome == JOB_OUT_DONE ? "done" : "failed",
             (double)(loop_now_ns() - job->started_ns) * 1e-9);
    if (outcome == JOB_OUT_DONE && job->order.drafted) job->order.drafted(job->user, job);
    start_run(job, false, error);
    return job->run != NULL;
}

static void on_ended(void *user, enum job_outcome outcome, const char *error)
{
    struct job *job = user;
    struct jobs *jobs = job->jobs;
    bool drafted = job->drafting;
    char fault[256] = "";
    jobs->n_idle -= job->idle;
    job->idle = false;
    if (job->cancel_asked && (drafted || outcome == JOB_OUT_FAILED)) {
        outcome = JOB_OUT_CANCELLED;
        error = "cancelled";
    }
    if (job->suspended && (drafted || outcome != JOB_OUT_DONE)) {
        jobs->n_running--;
        job->run = NULL;
        suspend(job);
        return;
    }
    if (drafted && outcome != JOB_OUT_CANCELLED) {
        if (bake_after_draft(job, outcome, fault)) return;
        outcome = JOB_OUT_FAILED;
        error = fault;
    }
    jobs->n_running--;
    end_job(job, outcome, error);
    start_next(jobs);
}

static void on_idle(void *user, bool idle)
{
    struct job *job = user;
    if (job->idle == idle) return;
    job->idle = idle;
    job->jobs->n_idle += idle ? 1u : -1u;
    if (idle) start_next(job->jobs);
}

static void start_next(struct jobs *jobs)
{
    unsigned limit = jobs->server->options.bakes;
    while (!jobs->stopping && jobs->n_running - jobs->n_idle < (limit ? limit : 1) &&
           jobs->n_queued) {
        struct job *job = NULL;
        for (struct job *j = jobs->job; j; j = j->next)
            if (j->state == RELIGHT__JOB_STATE__JOB_QUEUED && !j->recalled)
                job = j; // the oldest is the last
        if (!job) return;
        char error[256];
        jobs->n_queued--;
        job->started_ns = loop_now_ns();
        pace_plan(&job->pace, &job->order.kind, &jobs->history);
        start_run(job, job->order.draft != NULL, error);
        if (!job->run) {
            end_job(job, JOB_OUT_FAILED, error);
            continue;
        }
        jobs->n_running++;
        job->state = RELIGHT__JOB_STATE__JOB_RUNNING;
        log_line(LOG_EVENT, "job id=%s request=%s model=%s started", job->id,
                 job->order.request_id, job->model);
        tell_all(job, true);
    }
}

int jobs_create(struct server *server, const struct job_runner *runner, struct jobs **out)
{
    struct jobs *jobs = calloc(1, sizeof *jobs);
    if (!jobs) return PRT_NOMEM;
    *jobs = (struct jobs){.server = server, .runner = runner};
    *out = jobs;
    return PRT_OK;
}

void jobs_destroy(struct jobs *jobs)
{
    if (!jobs) return;
    for (struct job *job = jobs->job, *next; job; job = next) {
        next = job->next;
        job_free(job);
    }
    free(jobs);
}

bool jobs_reap(struct jobs *jobs, int pid, int how)
{
    return jobs->runner->reap(pid, how);
}

void jobs_stop(struct jobs *jobs)
{
    jobs->stopping = true;
    for (struct job *job = jobs->job; job; job = job->next) {
        if (job->ended_ns || job->cancel_asked) continue;
        if (jobs->server->data_temporary) {
            jobs_cancel(jobs, job);
        } else if (job->run) {
            job->suspended = true;
            runner_of(job)->cancel(job->run);
        } else {
            suspend(job);
        }
    }
}

unsigned jobs_open(const struct jobs *jobs)
{
    return (jobs->stopping ? 0 : jobs->n_queued) + jobs->n_running;
}

unsigned jobs_running(const struct jobs *jobs)
{
    return jobs->n_running;
}

// Microseconds since 1970, later than any before.
static uint64_t next_order(struct jobs *jobs)
{
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    uint64_t now = (uint64_t)t.tv_sec * 1000000 + (uint64_t)t.tv_nsec / 1000;
    if (now <= jobs->last_order_us) now = jobs->last_order_us + 1;
    return jobs->last_order_us = now;
}

bool jobs_full(const struct jobs *jobs)
{
    return jobs->n_queued >= jobs->server->options.bake_queue;
}

struct job *jobs_add(struct jobs *jobs, const struct job_origin *origin,
                     struct job_order *order, job_done_fn done, void *user)
{
    struct job *job = NULL;
    forget_old(jobs);
    if (!jobs->stopping && !jobs_full(jobs)) job = calloc(1, sizeof *job);
    if (!job) {
        job_free_order(order);
        return NULL;
    }
    *job = (struct job){.next = jobs->job,
                        .jobs = jobs,
                        .eta_s = -1,
                        .order = *order,
                        .queued_ns = loop_now_ns(),
                        .done = done,
                        .user = user,
                        .state = RELIGHT__JOB_STATE__JOB_QUEUED,
                        .stage = "queued"};
    // No other run of the daemon gives the same id.
    snprintf(job->id, sizeof job->id, "job-%.8s-%llu", jobs->server->run,
             (unsigned long long)++jobs->last_id);
    snprintf(job->model, sizeof job->model, "%s", origin->model);
    snprintf(job->owner, sizeof job->owner, "%s", origin->owner);
    snprintf(job->folder, sizeof job->folder, "%s", origin->folder);
    snprintf(job->order.request_id, sizeof job->order.request_id, "%s", log_request());
    snprintf(job->order.model, sizeof job->order.model, "%s", origin->model);
    job->recipe = strdup(origin->recipe);
    job->order_us = next_order(jobs);
    jobs->job = job;
    jobs->n_queued++;
    job_remember(job);
    publish(job);
    start_next(jobs);
    return job;
}

struct job *jobs_recalled(struct jobs *jobs)
{
    struct job *oldest = NULL;
    for (struct job *job = jobs->job; job; job = job->next)
        if (job->recalled) oldest = job;
    return oldest;
}

void jobs_resume(struct jobs *jobs, struct job *job, struct job_order *order, job_done_fn done,
                 void *user, const char *error)
{
    job->recalled = false;
    if (!order) {
        jobs->n_queued--;
        end_job(job, error ? JOB_OUT_FAILED : JOB_OUT_DONE, error);
        return;
    }
    job->order = *order;
    snprintf(job->order.model, sizeof job->order.model, "%s", job->model);
    job->done = done;
    job->user = user;
    log_line(LOG_EVENT, "job id=%s model=%s recalled", job->id, job->model);
    start_next(jobs);
}

struct job *jobs_find(struct jobs *jobs, const char *id)
{
    for (struct job *job = jobs->job; job; job = job->next)
        if (!strcmp(job->id, id) || !strcmp(job->model, id)) return job;
    return NULL;
}

void jobs_cancel(struct jobs *jobs, struct job *job)
{
    if (job->ended_ns || job->cancel_asked) return;
    job->cancel_asked = true;
    if (job->run) {
        runner_of(job)->cancel(job->run);
        return;
    }
    jobs->n_queued--;
    end_job(job, JOB_OUT_CANCELLED, "cancelled while it was queued");
}

void job_set_vertices(struct job *job, uint32_t n_vertex)
{
    if (job->order.kind.n_vertex == n_vertex) return;
    job->order.kind.n_vertex = n_vertex;
    pace_plan(&job->pace, &job->order.kind, &job->jobs->history);
}

void jobs_watch(struct jobs *jobs, struct job *job, struct request *request)
{
    if (job->ended_ns) {
        tell(job, request, true);
        return;
    }
    struct watcher *w = calloc(1, sizeof *w);
    if (!w) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    w->request = request;
    w->next = job->watcher;
    job->watcher = w;
    request->state = job;
    request->abandon = remove_watcher;
    tell(job, request, false);
}

const char *job_id(const struct job *job)
{
    return job->id;
}

int job_state(const struct job *job)
{
    return job->state;
}

double job_fraction(const struct job *job)
{
    return job->fraction;
}

const char *job_error(const struct job *job)
{
    return job->error;
}

const char *job_warnings(const struct job *job)
{
    return job->warnings;
}

const char *job_owner(const struct job *job)
{
    return job->owner;
}

const char *job_model(const struct job *job)
{
    return job->model;
}

const char *job_recipe(const struct job *job)
{
    return job->recipe;
}

const char *job_folder(const struct job *job)
{
    return job->folder;
}

bool jobs_use_folder(const struct jobs *jobs, const char *name)
{
    const struct job *job = jobs->job;
    while (job && (job->ended_ns || strcmp(job->folder, name))) job = job->next;
    return job != NULL;
}
