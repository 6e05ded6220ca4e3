/* SPDX-License-Identifier: MIT */
/* job_private.h owns a job as the queue (jobs.c) and its record on disk (job_store.c) share it.
 */
#ifndef RELIGHTD_JOB_PRIVATE_H
#define RELIGHTD_JOB_PRIVATE_H

#include "jobs/job_record.h"
#include "jobs/jobs.h"

struct watcher {
    struct watcher *next;
    struct request *request;
};

struct job {
    struct job *next; // newest first
    struct jobs *jobs;
    char id[32], model[40], owner[96], folder[64];
    uint64_t order_us; // microseconds since 1970; unique
    char *recipe;
    bool recalled; // it waits for jobs_resume
    bool drafting; // order.draft runs
    bool suspended, idle;
    int state;
    char stage[64];
    double fraction, eta_s;
    struct pace pace;
    uint64_t queued_ns, started_ns, ended_ns, told_ns, published_ns;
    char error[400];
    char warnings[JOB_WARNING_BYTES];
    struct watcher *watcher;
    struct job_order order;
    struct job_run *run;
    bool cancel_asked;
    job_done_fn done;
    void *user;
};

struct jobs {
    struct server *server;
    const struct job_runner *runner;
    struct job *job;
    struct pace_history history;
    uint64_t last_id, last_order_us;
    unsigned n_queued, n_running, n_idle, n_kept; // n_idle: of n_running
    bool stopping;
};

void job_free(struct job *job);
void job_free_order(struct job_order *order);
/* Seconds that it ran. */
double job_elapsed_s(const struct job *job);
/* Writes the job's record, behind earlier file operations; nothing with a temporary folder. */
void job_remember(const struct job *job);
void job_forget(const struct job *job);
void job_remove_folder(const struct job *job); /* after job_remember of its end */

#endif
