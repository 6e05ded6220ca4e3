// SPDX-License-Identifier: MIT
// The jobs in DATA/jobs.
#include "jobs/job_private.h"

#include "core/log.h"
#include "core/server.h"
#include "prt/base.h"
#include "relight.pb-c.h"
#include "store/file_queue.h"

#include <dirent.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void job_free_order(struct job_order *order)
{
    for (char **a = order->argv; a && *a; a++) free(*a);
    for (char **a = order->draft; a && *a; a++) free(*a);
    free(order->argv);
    free(order->draft);
    free(order->cwd);
    *order = (struct job_order){0};
}

void job_free(struct job *job)
{
    job_free_order(&job->order);
    free(job->recipe);
    free(job);
}

static void record_path(const struct job *job, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/jobs/%s.json", job->jobs->server->data, job->id);
}

double job_elapsed_s(const struct job *job)
{
    uint64_t end = job->ended_ns ? job->ended_ns : loop_now_ns();
    return job->started_ns ? (double)(end - job->started_ns) * 1e-9 : 0;
}

void job_remember(const struct job *job)
{
    char path[PATH_MAX];
    struct job_record r = {.order = job->order_us,
                           .state =
                               job->ended_ns ? job->state : (int)RELIGHT__JOB_STATE__JOB_QUEUED,
                           .fraction = job->fraction,
                           .elapsed_s = job_elapsed_s(job),
                           .recipe = job->recipe};
    if (job->jobs->server->data_temporary) return;
    snprintf(r.id, sizeof r.id, "%s", job->id);
    snprintf(r.model, sizeof r.model, "%s", job->model);
    snprintf(r.owner, sizeof r.owner, "%s", job->owner);
    snprintf(r.folder, sizeof r.folder, "%s", job->folder);
    snprintf(r.stage, sizeof r.stage, "%s", job->stage);
    snprintf(r.error, sizeof r.error, "%s", job->error);
    snprintf(r.warnings, sizeof r.warnings, "%s", job->warnings);
    record_path(job, path);
    file_write(job->jobs->server->file_queue, path, job_record_print(&r));
}

void job_forget(const struct job *job)
{
    char path[PATH_MAX];
    record_path(job, path);
    file_remove(job->jobs->server->file_queue, path);
}

// After the record: a folder without an ended record is that of an unfinished bake.
void job_remove_folder(const struct job *job)
{
    char path[PATH_MAX];
    if (!job->folder[0]) return;
    if (snprintf(path, sizeof path, "%s/work/%s", job->jobs->server->data, job->folder) <
        PATH_MAX)
        file_remove(job->jobs->server->file_queue, path);
}

// PRT_FORMAT: it is no job. PRT_NOMEM: it may be one.
static int read_record(const char *path, struct job_record *r)
{
    struct prt_blob blob;
    int status = prt_read_file(NULL, path, 1 << 20, &blob);
    if (status) return status == PRT_NOMEM ? status : PRT_FORMAT;
    char *text = strndup((const char *)blob.bytes, blob.size);
    prt_free(blob.bytes);
    errno = 0; // cJSON reports a failed malloc as a fault of the text
    if (!text) status = PRT_NOMEM;
    else if (!job_record_parse(text, r)) status = errno == ENOMEM ? PRT_NOMEM : PRT_FORMAT;
    free(text);
    return status;
}

static struct job *recall(struct jobs *jobs, struct job_record *r)
{
    struct job *job = calloc(1, sizeof *job);
    if (!job) return NULL;
    bool ended = r->state > RELIGHT__JOB_STATE__JOB_RUNNING;
    uint64_t now = loop_now_ns();
    *job = (struct job){.jobs = jobs,
                        .eta_s = ended ? 0 : -1,
                        .fraction = ended ? r->fraction : 0,
                        .order_us = r->order,
                        .recipe = r->recipe,
                        .recalled = !ended,
                        .queued_ns = now,
                        .started_ns = ended ? now - (uint64_t)(r->elapsed_s * 1e9) : 0,
                        .ended_ns = ended ? now : 0,
                        .state = ended ? r->state : (int)RELIGHT__JOB_STATE__JOB_QUEUED};
    snprintf(job->id, sizeof job->id, "%s", r->id);
    snprintf(job->model, sizeof job->model, "%s", r->model);
    snprintf(job->owner, sizeof job->owner, "%s", r->owner);
    snprintf(job->folder, sizeof job->folder, "%s", r->folder);
    snprintf(job->stage, sizeof job->stage, "%s", ended ? r->stage : "queued");
    snprintf(job->error, sizeof job->error, "%s", r->error);
    snprintf(job->warnings, sizeof job->warnings, "%s", r->warnings);
    struct job **at = &jobs->job; // the newest first
    while (*at && (*at)->order_us > job->order_us) at = &(*at)->next;
    job->next = *at;
    *at = job;
    if (!ended) jobs->n_queued++;
    if (r->order > jobs->last_order_us) jobs->last_order_us = r->order;
    return job;
}

int jobs_recall(struct jobs *jobs)
{
    int status = PRT_OK;
    char folder[PATH_MAX], path[PATH_MAX];
    snprintf(folder, sizeof folder, "%s/jobs", jobs->server->data);
    DIR *dir = opendir(folder);
    if (!dir && errno == ENOMEM) status = PRT_NOMEM;
    for (struct dirent *d; dir && status != PRT_NOMEM && (d = readdir(dir));) {
        struct job_record r = {0};
        if (d->d_name[0] == '.' && (!d->d_name[1] || !strcmp(d->d_name, ".."))) continue;
        if (snprintf(path, sizeof path, "%s/%s", folder, d->d_name) >= PATH_MAX) continue;
        const char *dot = strrchr(d->d_name, '.');
        status = dot && !strcmp(dot, ".json") ? read_record(path, &r) : PRT_FORMAT;
        if (!status && strncmp(r.id, d->d_name, (size_t)(dot - d->d_name))) status = PRT_FORMAT;
        if (!status && recall(jobs, &r)) continue;
        if (!status) status = PRT_NOMEM;
        free(r.recipe);
        if (status == PRT_NOMEM) continue;
        log_line(LOG_WARN, "file jobs/%s is no job and is removed", d->d_name);
        remove_tree(path);
    }
    if (dir) closedir(dir);
    if (status != PRT_NOMEM) return PRT_OK;
    log_line(LOG_ERR, "not enough memory to read the jobs: nothing was changed");
    return status;
}
