// SPDX-License-Identifier: MIT
// From frame to operation: who may ask what when, and the table of operations.
#include "net/dispatch.h"

#include "core/log.h"
#include "render/shared/materials.h"
#include "store/models.h"
#include "relight.pb-c.h"
#include "net/request.h"
#include "render/shared/geometry.h"

#include <stdio.h>
#include <stdlib.h>

static void (*const operation[])(struct request *request) = {
    [RELIGHT_TYPE_HELLO] = op_hello,
    [RELIGHT_TYPE_PING] = op_ping,
    [RELIGHT_TYPE_LIST] = op_list,
    [RELIGHT_TYPE_PUT_BLOB] = op_put_blob,
    [RELIGHT_TYPE_ENV] = op_env,
    [RELIGHT_TYPE_LOAD] = models_load,
    [RELIGHT_TYPE_WATCH] = op_watch,
    [RELIGHT_TYPE_CANCEL_JOB] = op_cancel_job,
    [RELIGHT_TYPE_CANCEL] = op_cancel,
    [RELIGHT_TYPE_INFO] = op_info,
    [RELIGHT_TYPE_GEOMETRY] = op_geometry,
    [RELIGHT_TYPE_COLORS] = op_colors,
    [RELIGHT_TYPE_IMAGE] = op_image,
    [RELIGHT_TYPE_VIEW_OPEN] = op_view_open,
    [RELIGHT_TYPE_VIEW_SET] = op_view_set,
    [RELIGHT_TYPE_VIEW_CLOSE] = op_view_close,
    [RELIGHT_TYPE_UPDATE_VERTICES] = op_update_vertices,
    [RELIGHT_TYPE_UNLOAD] = op_unload,
    [RELIGHT_TYPE_STATS] = op_stats,
};
enum { N_OPERATION = sizeof operation / sizeof *operation };
_Static_assert((int)N_OPERATION <= (int)STATS_N_TYPE, "a counter for each type");

// What a draining daemon still does: finish what is under way, and say how it is.
static bool while_draining(uint16_t type)
{
    return type == RELIGHT_TYPE_CANCEL || type == RELIGHT_TYPE_PING ||
           type == RELIGHT_TYPE_STATS || type == RELIGHT_TYPE_VIEW_CLOSE ||
           type == RELIGHT_TYPE_CANCEL_JOB;
}

static void run_operation(struct request *request)
{
    if (request->server->draining && !while_draining(request->type))
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN,
                     "the daemon is draining: it finishes what is open and takes nothing new");
    else operation[request->type](request);
}

void dispatch_frame(struct connection *conn, const struct relight_frame *frame,
                    uint8_t *payload)
{
    struct server *server = conn->server;
    struct request *request = request_create(conn, frame, payload);
    if (!request) return;
    uint16_t type = request->type;
    log_line(LOG_TRACE, "request conn=%llu id=%llu op=%s payload=%llu",
             (unsigned long long)conn->number, (unsigned long long)frame->id,
             relight_type_name(type), (unsigned long long)frame->payload_size);
    if (type < N_OPERATION) server->stats.requests_total[type]++;
    if (type >= N_OPERATION || !operation[type])
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED, "type %u is unknown",
                     type);
    else if (!conn->greeted && type != RELIGHT_TYPE_HELLO)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "the first request of a connection is HELLO");
    else material_then(request, run_operation);
}

// ---- waiting for a model

struct opening_wait {
    struct cache_waiter waiter; // first
    struct request *request;    // NULL: nobody waits any more
    struct model *model;
    struct cache_entry *file;
    with_model_fn fn;
};

static void end_wait(struct opening_wait *w)
{
    cache_release(w->file);
    model_release(w->model);
    free(w);
}

static void model_opened(struct cache_waiter *waiter)
{
    struct opening_wait *w = (struct opening_wait *)waiter;
    struct request *request = w->request;
    if (request) {
        request->state = NULL;
        request->abandon = NULL;
        if (w->file->state == CACHE_READY) w->fn(request, w->model, w->file);
        else request_fail(request, w->file->error_code, "%s", w->file->error);
    }
    end_wait(w);
}

static void abandon_wait(struct request *request)
{
    ((struct opening_wait *)request->state)->request = NULL;
}

static void with(struct request *request, const char *name, with_model_fn fn,
                 struct cache_entry *(*get)(struct model *model, int *code, char error[256]))
{
    char error[256];
    int code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    struct model *model =
        models_find(request->server->models, request->conn->principal->name, name, error);
    struct cache_entry *file = model ? get(model, &code, error) : NULL;
    struct opening_wait *w = file ? calloc(1, sizeof *w) : NULL;
    if (!w) {
        if (file) snprintf(error, sizeof error, "not enough memory");
        cache_release(file);
        request_fail(request, code, "%s", error);
        return;
    }
    *w = (struct opening_wait){.request = request,
                               .model = model,
                               .file = file,
                               .fn = fn,
                               .waiter.wake = model_opened};
    model_hold(model);
    request->state = w;
    request->abandon = abandon_wait;
    if (file->state == CACHE_PENDING) cache_wait(file, &w->waiter);
    else model_opened(&w->waiter);
}

void with_model(struct request *request, const char *name, with_model_fn fn)
{
    with(request, name, fn, model_open);
}

void with_mesh(struct request *request, const char *name, with_model_fn fn)
{
    with(request, name, fn, model_mesh_open);
}

void with_shape(struct request *request, const char *name, with_model_fn fn)
{
    with(request, name, fn, shape_get);
}
