/* SPDX-License-Identifier: MIT */
/* cache_compute.h owns the way from a missing cache entry to a filled one: a job that holds the
 * entries it reads, runs on a worker, and fills its entry or fails it. Loop thread only, but
 * for run().
 *
 * The life of a job: cache_compute() makes it, together with its entry; the caller fills in its
 * own members and calls cache_job_hold() for each entry that run() reads; then exactly one of
 * cache_job_submit(), cache_job_await() or cache_job_complete() is called. cache_job_complete()
 * ends it: it fills or fails the entry and releases everything. */
#ifndef RELIGHTD_CACHE_COMPUTE_H
#define RELIGHTD_CACHE_COMPUTE_H

#include "core/server.h"

struct cache_job;

struct cache_job_kind {
    size_t size;           /* of the struct that begins with a struct cache_job */
    enum work_class class; /* cache_compute() copies it to the job's work */
    /* On a worker: makes value and bytes. Returns an enum prt_status. */
    int (*run)(struct cache_job *job, const struct prt_context *ctx);
    /* Of value: when its entry is evicted, or when the job failed and value is not NULL. */
    void (*destroy)(void *value);
    /* On the loop thread, before the entry is filled or failed: takes the value's
     * own references, and frees the job's own members. job->status tells which. NULL: none. */
    void (*done)(struct cache_job *job);
    /* On the loop thread: nobody waits for the entry any more. Completes the job, or lets it go
     * on. NULL: a job that is queued is taken out, one that runs is told to end. */
    void (*unwanted)(struct cache_job *job);
};
/* An `unwanted` that does nothing. */
void cache_job_goes_on(struct cache_job *job);

enum { CACHE_JOB_HELD = 18 }; /* the most entries a job holds */

struct cache_job {
    struct work work;
    const struct cache_job_kind *kind;
    struct server *server;
    struct cache_entry *entry; /* the one to fill; held */
    struct cache_entry *held[CACHE_JOB_HELD];
    unsigned n_held;
    int status;              /* enum prt_status, from cache_job_complete() on */
    void *value;             /* becomes the entry's */
    size_t bytes;            /* that the cache counts for the value */
    bool holds_file;         /* the value holds an entry of another cache (store/cache.h) */
    struct work_actor actor; /* who caused it, and pays */
    bool submitted;
    float ms; /* the entry's cost, measured around run() */
    struct cache_waiter waiter;
    struct cache_entry *awaited; /* one of held */
    void (*ready)(struct cache_job *job);
};

/* The entry of `key`, with a reference for the caller: never NULL. *job: NULL where the entry
 * was there, or failed for lack of memory; otherwise a zeroed job of kind->size bytes that the
 * caller has to start. */
struct cache_entry *cache_compute(struct server *server, const char *key,
                                  const struct cache_job_kind *kind, struct cache_job **job);
/* Keeps a reference of its own to an entry (NULL is fine) until the job is complete. */
void cache_job_hold(struct cache_job *job, struct cache_entry *entry);
/* Runs the job on a worker, and then completes it. */
void cache_job_submit(struct cache_job *job);
/* Calls ready(job), now or later, when a held entry is ready; where that failed, the job's
 * entry fails with the same error. ready() then submits or completes the job. */
void cache_job_await(struct cache_job *job, struct cache_entry *held,
                     void (*ready)(struct cache_job *job));
/* Fills the entry with job->value, or fails it where status (enum prt_status) is not 0 with the
 * text in job->work.error, or the status's own. Frees the job. */
void cache_job_complete(struct cache_job *job, int status);

#endif
