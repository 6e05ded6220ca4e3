// SPDX-License-Identifier: MIT
// From frame to operation: which requests are allowed when, and the table of operations.
#include "net/dispatch.h"

#include "core/log.h"
#include "render/shared/materials.h"
#include "store/models.h"
#include "relight.pb-c.h"
#include "net/request_wait.h"
#include "render/shared/poses.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// ---- the table of operations

static void load_materials(const ProtobufCMessage *message, struct material_texts *texts)
{
    const Relight__LoadRequest *m = (const Relight__LoadRequest *)message;
    material_texts_add(texts, m->material);
    material_texts_of_objects(texts, m->n_materials, m->materials);
}

static void own_material(const ProtobufCMessage *message, struct material_texts *texts)
{
    const Relight__MaterialRequest *m = (const Relight__MaterialRequest *)message;
    if (!m->blob[0]) material_texts_add(texts, m->material); // else it names one of the file's
}

static void state_materials(const Relight__ViewState *state, struct material_texts *texts)
{
    if (state) material_texts_of_shade(texts, state->shade);
}

static void colors_materials(const ProtobufCMessage *message, struct material_texts *texts)
{
    material_texts_of_shade(texts, ((const Relight__ColorsRequest *)message)->shade);
}

static void image_materials(const ProtobufCMessage *message, struct material_texts *texts)
{
    material_texts_of_shade(texts, ((const Relight__ImageRequest *)message)->shade);
}

static void view_open_materials(const ProtobufCMessage *message, struct material_texts *texts)
{
    state_materials(((const Relight__ViewOpenRequest *)message)->state, texts);
}

static void view_set_materials(const ProtobufCMessage *message, struct material_texts *texts)
{
    state_materials(((const Relight__ViewSetRequest *)message)->state, texts);
}

enum { MAX_PING = SERVER_MAX_PING, ANY = SERVER_MAX_PAYLOAD };
#define BEFORE_HELLO OPERATION_BEFORE_HELLO
#define DRAINING OPERATION_WHILE_DRAINING
#define LONG OPERATION_LONG
#define ENDS OPERATION_ENDS_AT_DRAIN
#define ALWAYS OPERATION_ALWAYS
#define ORDERED OPERATION_ORDERED
#define GUEST OPERATION_GUEST
#define VIEW SCOPE_VIEW
#define EDIT SCOPE_EDIT
#define UPLOAD SCOPE_UPLOAD
#define ADMIN SCOPE_ADMIN

// A type without a row in OPERATION_LIST (dispatch.h) does not compile.
#define X(message, ...) static const struct operation message = {__VA_ARGS__};
OPERATION_LIST(X)
#undef X
#define X(message, take, flags) \
    static const struct operation message = {NULL, flags, 0, 0, NULL, take};
ONE_WAY_LIST(X)
#undef X

static const struct operation *const table[RELIGHT_TYPE_N] = {
#define X(name, number, request, answer) [number] = &(request),
    RELIGHT_TYPE_LIST(X)
#undef X
};

const struct operation *operation_of(uint16_t type)
{
    return type < RELIGHT_TYPE_N ? table[type] : NULL;
}

bool operation_allowed(struct request *request, unsigned scopes)
{
    const struct caller *caller = &request->conn->caller;
    const char *missing = access_missing(caller->scopes, scopes);
    char has[64];
    if (!missing) return true;
    scopes_print(caller->scopes, has);
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                 "%s needs the scope %s; %s has: %s", relight_type_name(request->type), missing,
                 caller->name, has);
    return false;
}

// Guests look at a room and its models.
static bool guest_allowed(struct request *request, const struct operation *operation)
{
    if (operation->flags & OPERATION_GUEST || !is_guest(request->conn->caller.name))
        return true;
    request->hint = "an owner of the room can do it, or a client with a token";
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                 "%s is not for guests of a room", relight_type_name(request->type));
    return false;
}

bool operation_owned(struct request *request, const char *owner, const char *what)
{
    const struct caller *caller = &request->conn->caller;
    if (!strcmp(owner, caller->name) || !access_missing(caller->scopes, SCOPE_ADMIN))
        return true;
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                 "%s: another client made it; %s needs the scope admin then", what,
                 relight_type_name(request->type));
    return false;
}

// The class of the request's work; false: the message names a priority that there is not.
static bool read_class(const struct request *request, enum work_class *out)
{
    const ProtobufCMessage *m = request->message;
    enum work_class class = WORK_INTERACTIVE;
    unsigned named = 0;
    if (request->type == RELIGHT_TYPE_COLORS) {
        named = ((const Relight__ColorsRequest *)m)->priority;
        class = WORK_STILL;
    } else if (request->type == RELIGHT_TYPE_IMAGE) {
        named = ((const Relight__ImageRequest *)m)->priority;
        class = WORK_STILL;
    } else if (request->type == RELIGHT_TYPE_VIEW_OPEN) {
        named = ((const Relight__ViewOpenRequest *)m)->priority;
    }
    if (named > RELIGHT__PRIORITY__PRIORITY_BULK) return false;
    *out = named ? (enum work_class)(named - RELIGHT__PRIORITY__PRIORITY_INTERACTIVE) : class;
    return true;
}

// Work that it causes is its principal's.
static void run_for_principal(struct request *request, const struct operation *operation)
{
    struct work_pool *work = request->server->work;
    enum work_class class;
    if (!read_class(request, &class)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "priority is none of INTERACTIVE, STILL and BULK");
        return;
    }
    struct work_actor before = work_act_for(work, request->principal->name, class);
    operation->run(request);
    work_act(work, before);
}

static void run_operation(struct request *request)
{
    const struct operation *operation = operation_of(request->type);
    if (request->server->draining && !(operation->flags & OPERATION_WHILE_DRAINING))
        request_fail(
            request, RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN,
            "the daemon is stopping: it finishes open requests and accepts no new ones");
    else {
        log_request_set(request->request_id);
        run_for_principal(request, operation);
        log_request_set("");
    }
}

// A broken one, or one before HELLO, is ignored: there is no answer that could say so.
static void take_one_way(struct connection *conn, const struct relight_frame *frame,
                         const struct operation *operation)
{
    // ROOM_PRESENCE may have two scenes, of 16 lights and 64 media by object each.
    static const struct relight_header_limits limits = {640, 256 << 10};
    struct relight_header_cost cost;
    char error[RELIGHT_HEADER_ERROR];
    static const uint8_t empty[1];
    conn->server->stats.requests_total[frame->type][STATS_OK]++;
    if (!conn->greeted ||
        !relight_header_check(frame->type, frame->header ? frame->header : empty,
                              frame->header_size, &limits, &cost, error))
        return;
    ProtobufCMessage *message = relight_frame_unpack(frame);
    if (!message) return;
    operation->take(conn, message);
    protobuf_c_message_free_unpacked(message, NULL);
}

static void resolve_materials(struct request *request)
{
    const struct operation *operation = operation_of(request->type);
    struct material_texts texts;
    texts.n = 0;
    if (operation->materials) operation->materials(request->message, &texts);
    material_then(request, operation->materials ? &texts : NULL,
                  operation->flags & OPERATION_ORDERED, run_operation);
}

// Uploads and models that another replica has come here first.
static void fetched_then(struct request *request, const struct operation *operation)
{
    struct server *server = request->server;
    if (server->fetch_then && request->conn->greeted)
        server->fetch_then(request, request->message, operation->flags & OPERATION_ORDERED,
                           resolve_materials);
    else resolve_materials(request);
}

void dispatch_frame(struct connection *conn, const struct relight_frame *frame,
                    uint8_t *payload)
{
    const struct operation *one_way = operation_of(frame->type);
    if (one_way && one_way->take && !conn->refusal.code) {
        take_one_way(conn, frame, one_way);
        return;
    }
    struct request *request = request_create(conn, frame, payload);
    if (!request) return;
    const struct operation *operation = operation_of(request->type);
    log_line(LOG_TRACE, "begin request=%s conn=%llu id=%llu op=%s payload=%llu",
             request->request_id, (unsigned long long)conn->number,
             (unsigned long long)frame->id, relight_type_name(request->type),
             (unsigned long long)frame->payload_size);
    if (!conn->greeted && !(operation->flags & OPERATION_BEFORE_HELLO)) {
        request->hint = "PROTOCOL.md tells how a connection begins";
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "the first request of a connection has to be HELLO");
    } else if (guest_allowed(request, operation) &&
               operation_allowed(request, operation->scopes))
        fetched_then(request, operation);
}

// ---- waiting for a model

struct opening {
    struct request_wait wait; // for the file
    struct model *model;
    with_model_fn fn;
};

static void opened(struct request_wait *wait, struct request *request)
{
    struct opening *o = (struct opening *)wait;
    struct cache_entry *file = wait->entry;
    if (request && file->state == CACHE_READY) o->fn(request, o->model, file);
    else if (request) request_fail(request, file->error_code, "%s", file->error);
    cache_release(file);
    model_release(o->model);
    free(o);
}

// Awaits the entry of the model; NULL: code and error say why there is none.
static void await_entry(struct request *request, struct model *model, struct cache_entry *file,
                        int code, char error[256], with_model_fn fn)
{
    struct opening *o = file ? calloc(1, sizeof *o) : NULL;
    if (!o) {
        if (file) {
            code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
            snprintf(error, 256, "not enough memory");
        }
        cache_release(file);
        request_fail(request, code, "%s", error);
        return;
    }
    o->model = model;
    o->fn = fn;
    model_hold(model);
    request_await_entry(request, &o->wait, file, opened);
}

static struct model *find(struct request *request, const char *name, char error[256])
{
    return models_find(request->server->models, request->conn->caller.name, name, error);
}

static void with(struct request *request, const char *name, with_model_fn fn,
                 struct cache_entry *(*get)(struct model *model, int *code, char error[256]))
{
    char error[256];
    int code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    struct model *model = find(request, name, error);
    await_entry(request, model, model ? get(model, &code, error) : NULL, code, error, fn);
}

void with_model(struct request *request, const char *name, with_model_fn fn)
{
    with(request, name, fn, model_open);
}

void with_mesh(struct request *request, const char *name, with_model_fn fn)
{
    with(request, name, fn, model_mesh_open);
}

void with_shape(struct request *request, const char *name, const char *pose_name,
                const char *variant, with_model_fn fn)
{
    char error[256];
    int code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    struct model *model = find(request, name, error);
    struct pose *pose = NULL;
    struct cache_entry *shape = NULL;
    if (model && strlen(variant) >= VARIANT_NAME) {
        code = RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
        snprintf(error, sizeof error, "variant: the name has more than 63 bytes");
    } else if (model) {
        if (pose_name[0])
            pose = poses_find(request->server->poses, model, pose_name, &code, error);
        if (pose || !pose_name[0]) shape = shape_get(model, pose, variant, &code, error);
        pose_release(pose); // the shape holds it
    }
    await_entry(request, model, shape, code, error, fn);
}
