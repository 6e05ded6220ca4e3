// SPDX-License-Identifier: MIT
// Requests that name an upload or a model that is not here: they wait until it has come from
// the folder that replicas share, or is not there either, and then run as always. So do those
// with a pose that is on the disk and not in memory.
#include "ops/shared_models.h"

#include "net/message_names.h"
#include "net/request_wait.h"
#include "relight.pb-c.h"
#include "render/shared/pose_files.h"
#include "render/shared/poses.h"
#include "store/models.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_BLOBS = 96, MOST_POSES = 8 };

struct shared_blob {
    struct blob_waiter waiter; // first
    struct shared_wait *wait;
};

// A pose: its file comes here, then it is read.
struct shared_pose {
    struct blob_waiter waiter; // first
    struct shared_wait *wait;
    char name[65];
};

// A request held back.
struct shared_wait {
    struct request_wait wait; // first
    struct shared_model_waiter model;
    struct shared_wait *next; // of its connection, where `ordered`
    struct connection *conn;  // NULL: not ordered, or closed
    unsigned pending;
    bool ready;
    void (*run)(struct request *request);
    struct server *server;
    struct principal *principal; // pays for poses
    struct shared_pose pose[MOST_POSES];
    size_t n_blob;
    struct shared_blob blob[];
};

struct needs {
    struct server *server;
    const char *asker, *model; // model: NULL: none is missing
    size_t n_blob, n_pose;
    const char *blob[MOST_BLOBS], *pose[MOST_POSES];
};

// ---- names in a message

static void need_blob(struct needs *needs, const char *hash)
{
    if (blobs_has(needs->server->blobs, hash)) return;
    for (size_t i = 0; i < needs->n_blob; i++)
        if (!strcmp(needs->blob[i], hash)) return;
    if (needs->n_blob < MOST_BLOBS) needs->blob[needs->n_blob++] = hash;
}

static void need_model(struct needs *needs, const char *name)
{
    char error[256];
    if (!name[0] || needs->model ||
        strlen(name) >= sizeof((struct shared_model_waiter *)0)->name)
        return;
    if (!models_find(needs->server->models, needs->asker, name, error)) needs->model = name;
}

static void need_pose(struct needs *needs, const char *name)
{
    bool may_be_there = needs->server->shared_models || blobs_has(needs->server->blobs, name);
    if (!may_be_there || poses_known(needs->server->poses, name)) return;
    if (needs->n_pose < MOST_POSES) needs->pose[needs->n_pose++] = name;
}

static void need(void *user, enum message_name kind, const char *name)
{
    struct needs *needs = user;
    if (kind == NAME_POSE) need_pose(needs, name);
    else if (!needs->server->shared_models) return; // what is not here is nowhere
    else if (kind == NAME_BLOB) need_blob(needs, name);
    else need_model(needs, name);
}

// ---- waiting

static void finish(struct shared_wait *w)
{
    struct request *request = request_resume(&w->wait);
    void (*run)(struct request *) = w->run;
    principal_release(w->principal);
    free(w);
    if (request) run(request);
}

static void run_ready(struct connection *conn)
{
    while (!conn->dead && conn->fetches && conn->fetches->ready) {
        struct shared_wait *w = conn->fetches;
        conn->fetches = w->next;
        finish(w);
    }
}

static void one_came(struct shared_wait *w)
{
    if (--w->pending) return;
    w->ready = true;
    if (w->conn) run_ready(w->conn);
    else finish(w);
}

static void blob_came(struct blob_waiter *waiter)
{
    one_came(((struct shared_blob *)waiter)->wait);
}

static void pose_came(void *user)
{
    one_came(user);
}

static void pose_file_came(struct blob_waiter *waiter)
{
    struct shared_pose *pose = (struct shared_pose *)waiter;
    pose_restore(pose->wait->server, pose->name, pose->wait->principal, pose_came, pose->wait);
}

static void model_came(struct shared_model_waiter *waiter)
{
    one_came((struct shared_wait *)((char *)waiter - offsetof(struct shared_wait, model)));
}

void shared_fetch_drop(struct connection *conn)
{
    for (struct shared_wait *w = conn->fetches, *next; w; w = next) {
        next = w->next;
        w->conn = NULL;
        w->wait.request = NULL;
        if (w->ready) finish(w);
    }
    conn->fetches = NULL;
}

static void hold_back(struct request *request, const struct needs *needs, bool ordered,
                      struct shared_wait *w)
{
    struct server *server = request->server;
    struct connection *conn = request->conn;
    struct shared_wait **last = &conn->fetches;
    request_park(request, &w->wait);
    if (ordered) {
        w->conn = conn;
        while (*last) last = &(*last)->next;
        *last = w;
    }
    w->pending = 1; // none ends before all have begun
    for (size_t i = 0; i < needs->n_blob; i++) {
        w->blob[i] = (struct shared_blob){.waiter.wake = blob_came, .wait = w};
        w->pending++;
        blobs_fetch(server->blobs, needs->blob[i], &w->blob[i].waiter);
    }
    for (size_t i = 0; i < needs->n_pose; i++) {
        w->pose[i] = (struct shared_pose){.waiter.wake = pose_file_came, .wait = w};
        snprintf(w->pose[i].name, sizeof w->pose[i].name, "%s", needs->pose[i]);
        w->pending++;
        if (blobs_has(server->blobs, needs->pose[i])) pose_file_came(&w->pose[i].waiter);
        else blobs_fetch(server->blobs, needs->pose[i], &w->pose[i].waiter);
    }
    if (needs->model) {
        strcpy(w->model.name, needs->model);
        snprintf(w->model.asker, sizeof w->model.asker, "%s", needs->asker);
        w->model.wake = model_came;
        w->pending++;
        shared_models_wait(server->shared_models, &w->model);
    }
    one_came(w);
}

void shared_fetch_then(struct request *request, const ProtobufCMessage *message, bool ordered,
                       void (*run)(struct request *request))
{
    struct needs needs = {.server = request->server, .asker = request->conn->caller.name};
    bool chunk = request->type == RELIGHT_TYPE_PUT_BLOB && request->payload_size;
    if (!chunk) message_names(message, need, &needs);
    bool wait =
        needs.n_blob || needs.n_pose || needs.model || (ordered && request->conn->fetches);
    struct shared_wait *w = wait ? calloc(1, sizeof *w + needs.n_blob * sizeof *w->blob) : NULL;
    if (!w) { // without memory the operation says what is missing
        run(request);
        return;
    }
    w->run = run;
    w->server = request->server;
    w->principal = request->principal;
    principal_hold(w->principal);
    hold_back(request, &needs, ordered, w);
}
