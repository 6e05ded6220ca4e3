/* SPDX-License-Identifier: MIT */
/* jobs.h owns bakes: their queue, which DATA/jobs keeps over restarts, their progress, their
 * watchers, and the runner that executes them. The runner is an interface: runner_child.c
 * starts a child process; another one could pass the same command to a batch scheduler. Loop
 * thread only. */
#ifndef RELIGHTD_JOBS_H
#define RELIGHTD_JOBS_H

#include "jobs/pace.h"

#include <stdbool.h>
#include <stdint.h>

struct server;
struct request;

/* A command to run: argv without the program, in folder cwd. `{progress}` in argv becomes the
 * descriptor number for lines of "stage fraction eta". */
struct job;
struct job_order {
    char **argv; /* NULL-terminated, malloc()ed strings; owned by the job */
    char *
        *draft; /* run before argv, which follows even where it fails; NULL: none. Owned, too */
    void (*drafted)(void *user, struct job *job); /* the draft was made; user of jobs_add */
    char *cwd;
    struct pace_kind kind;
    char request_id[65]; /* of the LOAD, "": none; jobs_add fills it, $RELIGHT_REQUEST_ID */
    char model[40];      /* id; jobs_add fills it: the bake is DATA/bakes/ID.prt */
};

/* SUSPENDED: the daemon stops; the job continues after the next start. */
enum job_outcome { JOB_OUT_DONE, JOB_OUT_FAILED, JOB_OUT_CANCELLED, JOB_OUT_SUSPENDED };

/* Events of a run. ended is called exactly once, as the last one. */
struct job_events {
    void (*progress)(void *user, const char *stage, double fraction, double eta_s);
    void (*line)(void *user, const char *line); /* of its stderr */
    /* The run waits for another replica, and another job may run; or it does so no longer. */
    void (*idle)(void *user, bool idle);
    void (*ended)(void *user, enum job_outcome outcome, const char *error);
};

struct job_run; /* the runner's own */
struct job_runner {
    const char *name;
    /* NULL: it could not be started; error has the cause. */
    struct job_run *(*start)(struct server *server, const struct job_order *order,
                             const struct job_events *events, void *user, char error[256]);
    void (*cancel)(struct job_run *run);
    /* A child process ended; true when it was a run's. */
    bool (*reap)(int pid, int how);
    const struct job_runner *draft; /* starts drafts and cancels them; NULL: this one */
};
extern const struct job_runner job_runner_child;
/* The same among replicas that share a folder (--store): one of them bakes a model. */
extern const struct job_runner job_runner_shared;

struct jobs;
int jobs_create(struct server *server, const struct job_runner *runner, struct jobs **out);
void jobs_destroy(struct jobs *jobs);
bool jobs_reap(struct jobs *jobs, int pid, int how);
/* Suspends all jobs (with a temporary data folder: cancels them); their done callbacks follow.
 */
void jobs_stop(struct jobs *jobs);
/* Queued and running; once jobs_stop was called, running. */
unsigned jobs_open(const struct jobs *jobs);
unsigned jobs_running(const struct jobs *jobs);

/* Called when a job has ended, before its watchers are notified. */
typedef void (*job_done_fn)(void *user, struct job *job, enum job_outcome outcome);

/* How a job is known: strings are copied. recipe: JSON from which the same operation can make
 * the order again after a restart. */
struct job_origin {
    const char *model, *owner, *recipe;
    const char *folder; /* below DATA/work: kept while the job is open, removed at its end */
};
/* Whether --bake-queue bakes wait already: jobs_add then refuses. */
bool jobs_full(const struct jobs *jobs);
/* Takes over the order. NULL when the queue is full. */
struct job *jobs_add(struct jobs *jobs, const struct job_origin *origin,
                     struct job_order *order, job_done_fn done, void *user);

/* Reads DATA/jobs: jobs that had ended, and jobs that wait for jobs_resume in the order in
 * which they were queued. Blocks. PRT_NOMEM: the daemon must not start. */
int jobs_recall(struct jobs *jobs);
/* The oldest job that waits for jobs_resume, or NULL. */
struct job *jobs_recalled(struct jobs *jobs);
/* Takes over the order; NULL: the job ends with the error, or without one as done. */
void jobs_resume(struct jobs *jobs, struct job *job, struct job_order *order, job_done_fn done,
                 void *user, const char *error);
/* By job id; with a model id, its newest job. */
struct job *jobs_find(struct jobs *jobs, const char *id);
/* The job stays valid until the next jobs_add. */
void jobs_cancel(struct jobs *jobs, struct job *job);
/* Answers a WATCH request now and at every change, until the job ends. */
void jobs_watch(struct jobs *jobs, struct job *job, struct request *request);

/* The model's vertices are counted: the time left is planned again. */
void job_set_vertices(struct job *job, uint32_t n_vertex);

const char *job_id(const struct job *job);
const char *job_model(const struct job *job); /* the model's id */
int job_state(const struct job *job);         /* Relight__JobState */
double job_fraction(const struct job *job);
const char *job_error(const struct job *job);
const char *job_warnings(const struct job *job); /* lines */
const char *job_owner(const struct job *job);    /* a principal's name */
const char *job_recipe(const struct job *job);
const char *job_folder(const struct job *job);
/* Whether an open job has this folder below DATA/work. */
bool jobs_use_folder(const struct jobs *jobs, const char *name);

#endif
