// SPDX-License-Identifier: MIT
// Jobs that compute cache entries: their entry, the entries they hold, their time.
#include "render/shared/cache_compute.h"

#include "net/request.h"
#include "relight.pb-c.h"

#include <assert.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>

void cache_job_goes_on(struct cache_job *job)
{
}

static void withdraw(struct cache_job *job)
{
    // Who asks for the same from now on gets an entry of its own.
    cache_forget_entry(job->entry);
    if (job->awaited && !job->submitted) {
        struct cache_entry *awaited = job->awaited;
        if (awaited->state == CACHE_PENDING) cache_leave(awaited, &job->waiter);
        else return; // it is being woken
    } else if (!job->submitted || !work_withdraw(&job->work)) {
        return;
    }
    snprintf(job->work.error, sizeof job->work.error, "nobody waits for it any more");
    cache_job_complete(job, PRT_CANCELLED);
}

static void unwanted(struct cache_entry *entry)
{
    struct cache_job *job = entry->job;
    if (job->kind->unwanted) job->kind->unwanted(job);
    else withdraw(job);
}

struct cache_entry *cache_compute(struct server *server, const char *key,
                                  const struct cache_job_kind *kind, struct cache_job **job)
{
    bool fresh;
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    *job = NULL;
    if (!fresh) return entry;
    struct cache_job *made = calloc(1, kind->size);
    if (!made) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    made->kind = kind;
    made->server = server;
    made->entry = entry;
    made->work.class = kind->class;
    made->actor = work_actor(server->work);
    entry->job = made;
    entry->unwanted = unwanted;
    cache_hold(entry); // one reference for the caller, one for the job
    *job = made;
    return entry;
}

void cache_job_hold(struct cache_job *job, struct cache_entry *entry)
{
    if (!entry) return;
    assert(job->n_held < CACHE_JOB_HELD);
    job->held[job->n_held++] = entry;
    cache_hold(entry);
}

static int run_job(struct work *work, const struct prt_context *ctx)
{
    struct cache_job *job = (struct cache_job *)work;
    double start = prt_time_s();
    int status = job->kind->run(job, ctx);
    job->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void job_done(struct work *work)
{
    cache_job_complete((struct cache_job *)work, work->status);
}

void cache_job_submit(struct cache_job *job)
{
    job->work.run = run_job;
    job->work.done = job_done;
    job->submitted = true;
    struct work_actor before = work_act(job->server->work, job->actor);
    work_submit(job->server->work, &job->work);
    work_act(job->server->work, before);
}

static void free_job(struct cache_job *job)
{
    job->entry->unwanted = NULL;
    cache_release(job->entry);
    for (unsigned i = 0; i < job->n_held; i++) cache_release(job->held[i]);
    free(job);
}

static void fail(struct cache_job *job, int status, int code, const char *text)
{
    job->status = status;
    if (job->kind->done) job->kind->done(job);
    if (job->value && job->kind->destroy) job->kind->destroy(job->value);
    cache_fail(job->entry, code, text);
    free_job(job);
}

static void awaited_ended(struct cache_waiter *waiter)
{
    struct cache_job *job =
        (struct cache_job *)((char *)waiter - offsetof(struct cache_job, waiter));
    const struct cache_entry *awaited = job->awaited;
    if (awaited->state == CACHE_FAILED)
        fail(job, PRT_CANCELLED, awaited->error_code, awaited->error);
    else job->ready(job);
}

void cache_job_await(struct cache_job *job, struct cache_entry *held,
                     void (*ready)(struct cache_job *job))
{
    job->awaited = held;
    job->ready = ready;
    job->waiter.wake = awaited_ended;
    if (held->state == CACHE_PENDING) cache_wait(held, &job->waiter);
    else awaited_ended(&job->waiter);
}

void cache_job_complete(struct cache_job *job, int status)
{
    job->entry->ms = job->ms;
    if (status) {
        fail(job, status, error_of_status(status),
             job->work.error[0] ? job->work.error : prt_status_text(status));
        return;
    }
    if (job->kind->done) job->kind->done(job);
    job->entry->holds_file = job->holds_file;
    cache_fill(job->entry, job->value, job->bytes, job->kind->destroy);
    free_job(job);
}
