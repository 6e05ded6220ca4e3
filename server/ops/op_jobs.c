// SPDX-License-Identifier: MIT
// WATCH, CANCEL_JOB and CANCEL: bakes and open requests.
#include "core/log.h"
#include "core/server.h"
#include "jobs/jobs.h"
#include "net/connection.h"
#include "net/dispatch.h"
#include "net/request.h"
#include "relight.pb-c.h"
#include "store/models.h"

#include <string.h>

#define MESSAGE(type) ((const Relight__##type *)request->message)

// No job is kept: the model was baked long before, or no bake was ordered.
static void watch_without_job(struct request *request, const struct model *m)
{
    Relight__Progress out = RELIGHT__PROGRESS__INIT;
    Relight__Error error;
    struct error_fields fields;
    out.model = (char *)m->id;
    out.state = RELIGHT__JOB_STATE__JOB_NONE;
    out.stage = "no bake was ordered";
    out.eta_s = -1;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        out.state = RELIGHT__JOB_STATE__JOB_DONE;
        out.stage = "";
        out.fraction = 1;
        out.eta_s = 0;
    } else if (m->state == RELIGHT__MODEL_STATE__MODEL_FAILED) {
        out.state = RELIGHT__JOB_STATE__JOB_FAILED;
        out.stage = "";
        error_fill(&error, m->error_code, m->error, &fields);
        out.error = &error;
    }
    request_answer(request, &out.base, NULL);
}

void op_watch(struct request *request)
{
    struct server *server = request->server;
    const char *name = MESSAGE(WatchRequest)->job;
    char error[256];
    struct job *job = jobs_find(server->jobs, name);
    if (!job) {
        struct model *m = models_find(server->models, request->conn->caller.name, name, error);
        job = m ? jobs_find(server->jobs, m->id) : NULL;
        if (m && !job) {
            watch_without_job(request, m);
            return;
        }
    }
    if (job) jobs_watch(server->jobs, job, request);
    else
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "%.100s: no such job%s",
                     name,
                     !strncmp(name, "job-", 4) && strncmp(name + 4, server->run, 8)
                         ? "; a job of an earlier run of the daemon: watch its model"
                         : "");
}

void op_cancel_job(struct request *request)
{
    struct server *server = request->server;
    struct job *job = jobs_find(server->jobs, MESSAGE(CancelJobRequest)->job);
    if (!job) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "%.100s: no such job",
                     MESSAGE(CancelJobRequest)->job);
        return;
    }
    if (!operation_owned(request, job_owner(job), job_id(job))) return;
    log_line(LOG_EVENT, "audit act=cancel-job who=%s job=%s model=%s",
             request->conn->caller.name, job_id(job), job_model(job));
    jobs_cancel(server->jobs, job);
    Relight__CancelJobAnswer out = RELIGHT__CANCEL_JOB_ANSWER__INIT;
    out.state = (Relight__JobState)job_state(job);
    request_answer(request, &out.base, NULL);
}

void op_cancel(struct request *request)
{
    uint64_t id = MESSAGE(CancelRequest)->id;
    Relight__CancelAnswer out = RELIGHT__CANCEL_ANSWER__INIT;
    struct connection *conn = request->conn;
    for (struct request *r = conn->requests; r; r = r->next)
        if (r->id == id && r != request) {
            out.found = true;
            request->server->stats.cancelled_total++;
            request_stop(r, RELIGHT__ERROR_CODE__ERROR_CANCELLED, "cancelled by the client");
            break;
        }
    if (!conn->dead) request_answer(request, &out.base, NULL);
}
