// SPDX-License-Identifier: MIT
// The LOADs that the models folder orders by itself: of the versions NAME/VERSION with a file
// that is no .prt, and again of every model whose file of --models has other content by now.
// Each is a request of its own, of the principal that owns the model, so that limits and errors
// are those of a client's. The new model takes the names of the earlier one once it can answer;
// a LOAD or a bake that fails leaves the earlier one in its place.
#include "core/log.h"
#include "net/dispatch.h"
#include "message_text.h"
#include "net/request.h"
#include "relight.pb-c.h"
#include "store/disk.h"
#include "store/model_files.h"
#include "store/versions.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LOADS_AT_ONCE = 4, LOAD_MS = 3600000 };
static const uint64_t settle_ns = 1000000000, again_ns = 5000000000u;

enum order_state { ORDER_WAITS, ORDER_LOADING, ORDER_ANSWERED, ORDER_BAKING };

struct order {
    struct order *next;
    struct repository *repository;
    enum order_state state;
    char *version;              // NULL: `before` is to be loaded again
    char before[MODEL_ID + 1];  // id of the model that it replaces; "": none yet
    char id[MODEL_ID + 1];      // that the LOAD was answered with
    uint64_t at_ns;             // not before
    struct connection *conn;    // of the LOAD
    int code;                   // of its error
    char error[400], told[400]; // told: the last error that was logged
    struct model *model;        // held: its bake is waited for
    struct model_watcher watcher;
};

struct repository {
    struct server *server;
    struct order *order;
    struct loop_timer timer;
};

static void wake_at(struct repository *r, uint64_t at_ns)
{
    if (!r->timer.armed || at_ns < r->timer.at_ns)
        loop_timer_set(r->server->loop, &r->timer, at_ns);
}

// ---- the carrier: answers come here

static void nothing(struct connection *conn)
{
}

static void set_reading(struct connection *conn, bool on)
{
}

static void closed(struct connection *conn)
{
    struct order *o = conn->carrier_data;
    o->conn = NULL;
    if (o->state == ORDER_LOADING) o->state = ORDER_WAITS;
}

static void answered(struct connection *conn, uint16_t type, uint8_t flags,
                     const ProtobufCMessage *message, struct payload *payload)
{
    struct order *o = conn->carrier_data;
    if (payload->release) payload->release(payload->owner);
    if (type == RELIGHT_TYPE_ERROR) {
        const Relight__Error *error = (const Relight__Error *)message;
        o->code = (int)error->code;
        snprintf(o->error, sizeof o->error, "%.399s", error->text);
    } else if (type == (RELIGHT_TYPE_LOAD | RELIGHT_TYPE_ANSWER)) {
        o->code = 0;
        snprintf(o->id, sizeof o->id, "%s", ((const Relight__LoadAnswer *)message)->model);
    } else {
        return; // GOAWAY
    }
    o->state = ORDER_ANSWERED;
    wake_at(o->repository, loop_now_ns()); // the connection is still in use here
}

static const struct carrier folder_carrier = {"folder", nothing, set_reading,
                                              closed,   NULL,    answered};

// ---- one order

static struct version *version_of(const struct order *o)
{
    return o->version ? versions_get(o->repository->server->versions, o->version) : NULL;
}

static void stop_waiting(struct order *o)
{
    if (!o->model) return;
    model_unwatch(o->model, &o->watcher);
    model_release(o->model);
    o->model = NULL;
}

static void end_order(struct order *o)
{
    struct order **at = &o->repository->order;
    struct version *v = version_of(o);
    if (v && v->state == VERSION_LOADING) v->state = VERSION_IDLE;
    while (*at != o) at = &(*at)->next;
    *at = o->next;
    stop_waiting(o);
    if (o->conn) connection_close(o->conn, "the order has ended");
    free(o->version);
    free(o);
}

static void tell(struct order *o, const char *error)
{
    if (!strcmp(o->told, error)) return;
    snprintf(o->told, sizeof o->told, "%s", error);
    const char *what = o->version ? o->version : o->before;
    log_line(LOG_WARN, "models folder name=\"%s\" error=\"%s\"", what, error);
}

static ProtobufCMessage *message_of_version(const struct version *v, char error[300])
{
    char why[MESSAGE_TEXT_ERROR] = "it is not a JSON object";
    const ProtobufCMessageDescriptor *type = &relight__load_request__descriptor;
    ProtobufCMessage *message = message_new(type);
    cJSON *json = v->settings ? cJSON_Parse(v->settings) : cJSON_CreateObject();
    bool good = message && cJSON_IsObject(json) && !message_from_json(message, json, why);
    cJSON_Delete(json);
    if (good && ((Relight__LoadRequest *)message)->n_files) {
        snprintf(why, sizeof why,
                 "files: only \"path\", a file of its folder, names the model");
        good = false;
    }
    good = good && !message_set(message, "path", v->path, why) &&
           !message_set(message, "name", v->name, why);
    if (good) return message;
    snprintf(error, 300, "model.json: %s", message ? why : "not enough memory");
    if (message) protobuf_c_message_free_unpacked(message, NULL);
    return NULL;
}

static uint8_t hex_value(char c)
{
    return (uint8_t)(c <= '9' ? c - '0' : c - 'a' + 10);
}

// The LOAD from which the model came.
static ProtobufCMessage *message_of_source(const struct model *m, char error[300])
{
    char why[MESSAGE_TEXT_ERROR];
    cJSON *json = m->source ? cJSON_Parse(m->source) : NULL;
    const char *hex = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, "request"));
    size_t n = hex && strspn(hex, "0123456789abcdef") == strlen(hex) ? strlen(hex) / 2 : 0;
    uint8_t *bytes = malloc(n + 1);
    for (size_t i = 0; bytes && i < n; i++)
        bytes[i] = (uint8_t)(hex_value(hex[2 * i]) << 4 | hex_value(hex[2 * i + 1]));
    ProtobufCMessage *message = NULL;
    if (bytes)
        message = protobuf_c_message_unpack(&relight__load_request__descriptor, NULL, n, bytes);
    free(bytes);
    cJSON_Delete(json);
    if (message && !message_set(message, "name", m->name, why)) {
        ((Relight__LoadRequest *)message)->pin = m->pinned;
        return message;
    }
    if (message) protobuf_c_message_free_unpacked(message, NULL);
    snprintf(error, 300, "the record of its LOAD cannot be read: load it again");
    return NULL;
}

static void dispatch(struct connection *conn, const ProtobufCMessage *message)
{
    size_t size = protobuf_c_message_get_packed_size(message);
    uint8_t *header = malloc(size + 1);
    if (!header) return; // tried again
    protobuf_c_message_pack(message, header);
    struct relight_frame frame = {.flags = RELIGHT_FRAME_LAST,
                                  .type = RELIGHT_TYPE_LOAD,
                                  .id = 1,
                                  .deadline_ms = LOAD_MS,
                                  .header_size = (uint32_t)size,
                                  .header = header};
    dispatch_frame(conn, &frame, NULL);
    free(header);
}

// False: the order has ended.
static bool start_load(struct order *o)
{
    struct server *server = o->repository->server;
    const struct version *v = version_of(o);
    const struct model *m = o->before[0] ? models_get(server->models, o->before) : NULL;
    struct caller caller = {.scopes = SCOPE_VIEW | SCOPE_EDIT | SCOPE_UPLOAD | SCOPE_ADMIN};
    char error[300] = "its model was forgotten";
    ProtobufCMessage *message = v   ? message_of_version(v, error)
                                : m ? message_of_source(m, error)
                                    : NULL;
    if (!message) {
        tell(o, error);
        end_order(o);
        return false;
    }
    snprintf(caller.name, sizeof caller.name, "%s", o->version ? DISK_NOBODY : m->owner);
    o->at_ns = loop_now_ns() + again_ns;
    o->conn = connection_open(server, &folder_carrier, o, "models folder", caller.name);
    if (o->conn) {
        o->conn->greeted = o->conn->prepaid = true;
        o->conn->caller = caller;
        o->state = ORDER_LOADING;
        dispatch(o->conn, message);
        // Without memory for the frame; closed() lets the order wait.
        if (o->state == ORDER_LOADING && !o->conn->requests)
            connection_close(o->conn, "not enough memory");
    }
    protobuf_c_message_free_unpacked(message, NULL);
    return true;
}

static void model_has_changed(struct model_watcher *watcher)
{
    struct order *o = (struct order *)((char *)watcher - offsetof(struct order, watcher));
    wake_at(o->repository, loop_now_ns());
}

// from: NULL where it was forgotten meanwhile.
static void take_names(const struct model *from, struct model *to)
{
    for (const struct model_alias *a = from ? from->alias : NULL; a; a = a->next)
        model_set_name(to, a->owner, a->name);
    to->replaces[0] = 0;
    model_remember(to);
}

static void take_over(struct order *o)
{
    struct server *server = o->repository->server;
    struct version *v = version_of(o);
    struct model *before = o->before[0] ? models_get(server->models, o->before) : NULL;
    if (v) version_answers(server->versions, v, o->model);
    if (!o->version) take_names(before, o->model);
    if (!o->version && before) model_supersede(before, o->model);
    models_drop_replaced(server->models);
}

// The LOAD was answered: its bake is waited for. False: the order has ended.
static bool take_answer(struct order *o)
{
    static const int later[] = {
        RELIGHT__ERROR_CODE__ERROR_BUSY,      RELIGHT__ERROR_CODE__ERROR_LIMIT,
        RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN,
        RELIGHT__ERROR_CODE__ERROR_DEADLINE,  RELIGHT__ERROR_CODE__ERROR_CANCELLED};
    struct server *server = o->repository->server;
    if (o->conn) connection_close(o->conn, "answered");
    o->state = ORDER_WAITS;
    if (o->code) {
        bool again = false;
        for (size_t i = 0; i < sizeof later / sizeof *later; i++) again |= o->code == later[i];
        tell(o, o->error);
        if (!again) end_order(o);
        return again;
    }
    struct version *v = version_of(o);
    struct model *m = models_get(server->models, o->id);
    if (!m || (o->version && !v) || !strcmp(o->id, o->before)) {
        end_order(o); // the content is the same after all
        return false;
    }
    model_revive(m);
    // The first model of a version answers before its bake has ended, by its preview.
    if (v && (!v->model[0] || !models_get(server->models, v->model)))
        version_answers(server->versions, v, m);
    // One that a client uploaded, too, is that client's, whatever becomes of the file.
    bool own = m->source && m->state != RELIGHT__MODEL_STATE__MODEL_READY;
    if (!o->version && own && !m->replaces[0]) {
        snprintf(m->replaces, sizeof m->replaces, "%s", o->before);
        model_remember(m);
    }
    o->model = m;
    model_hold(m);
    o->watcher.changed = model_has_changed;
    model_watch(m, &o->watcher);
    o->state = ORDER_BAKING;
    return true;
}

// False: the order has ended.
static bool look_at_bake(struct order *o)
{
    struct model *m = o->model;
    bool failed = m->state == RELIGHT__MODEL_STATE__MODEL_FAILED || m->mesh == MESH_FAILED;
    bool complete = m->state == RELIGHT__MODEL_STATE__MODEL_READY ||
                    (m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW && m->mesh == MESH_THERE);
    if (!m->gone && complete) {
        take_over(o);
    } else if (!m->gone && failed) {
        tell(o, m->error[0] ? m->error : m->mesh_error);
        model_hold(m);
        stop_waiting(o);
        // The earlier one keeps its names.
        if (!o->version && m->replaces[0]) model_unload(m, true);
        model_release(m);
    } else if (!m->gone) {
        return true;
    }
    end_order(o);
    return false;
}

// ---- all orders

static struct order *find_order(const struct repository *r, const char *version,
                                const char *model)
{
    struct order *o = r->order;
    while (o &&
           !(version ? o->version && !strcmp(o->version, version)
                     : !o->version && (!strcmp(o->before, model) || !strcmp(o->id, model))))
        o = o->next;
    return o;
}

static struct order *add_order(struct repository *r, const char *version, const char *before)
{
    struct order *o = calloc(1, sizeof *o);
    if (!o || (version && !(o->version = strdup(version)))) {
        free(o);
        return NULL;
    }
    o->repository = r;
    snprintf(o->before, sizeof o->before, "%s", before);
    o->next = r->order;
    return r->order = o;
}

// The content has changed again: a bake of the earlier content is for nothing. False: its LOAD
// is under way, and may read either.
static bool restart(struct order *o)
{
    struct model *m = o->model;
    if (o->state != ORDER_BAKING) return o->state == ORDER_WAITS;
    model_hold(m);
    stop_waiting(o);
    bool own = !strcmp(m->owner, DISK_NOBODY) || m->replaces[0];
    if (own && m->state != RELIGHT__MODEL_STATE__MODEL_READY) model_unload(m, true);
    model_release(m);
    o->state = ORDER_WAITS;
    o->id[0] = 0;
    return true;
}

static void run_orders(struct loop_timer *timer)
{
    struct repository *r =
        (struct repository *)((char *)timer - offsetof(struct repository, timer));
    unsigned n_loading = 0;
    uint64_t now = loop_now_ns(), next_ns = UINT64_MAX;
    for (struct order *o = r->order, *next; o; o = next) {
        next = o->next;
        if (o->state == ORDER_ANSWERED && !take_answer(o)) continue;
        if (o->state == ORDER_BAKING && !look_at_bake(o)) continue;
        if (r->server->draining) continue;
        n_loading += o->state == ORDER_LOADING;
        if (o->state != ORDER_WAITS) continue;
        if (n_loading < LOADS_AT_ONCE && o->at_ns <= now) {
            n_loading++;
            if (!start_load(o)) continue;
        }
        if (o->at_ns < next_ns) next_ns = o->at_ns > now ? o->at_ns : now + settle_ns;
    }
    if (next_ns < UINT64_MAX) wake_at(r, next_ns);
}

static bool lists_file(const cJSON *source, const char *path)
{
    const cJSON *file;
    cJSON_ArrayForEach(
        file, cJSON_GetObjectItemCaseSensitive(source, "files")) if (cJSON_IsString(file) &&
                                                                     !strcmp(file->valuestring,
                                                                             path)) return true;
    return false;
}

static bool is_changed(const struct model *m, const char *const *changed, size_t n)
{
    cJSON *source = cJSON_Parse(m->source);
    bool found = false;
    for (size_t i = 0; i < n; i++) found |= lists_file(source, changed[i]);
    cJSON_Delete(source);
    return found;
}

// A version's model is the version's to load.
static bool is_of_version(const struct repository *r, const struct model *m)
{
    bool found = false;
    for (struct version *v = NULL; (v = versions_next(r->server->versions, v));) {
        if (strcmp(v->model, m->id)) continue;
        found = true;
        if (v->state == VERSION_IDLE) v->state = VERSION_SETTLING;
    }
    for (const struct order *o = r->order; o; o = o->next)
        found |= o->version && !strcmp(o->id, m->id);
    return found;
}

static void file_changed(struct repository *r, struct model *m)
{
    if (is_of_version(r, m) || m->replaced || m->removed) return;
    struct order *o = find_order(r, NULL, m->id);
    if (o) (void)restart(o); // a scan finds the file changed until it was copied again
    else if ((o = add_order(r, NULL, m->id))) o->at_ns = loop_now_ns() + settle_ns;
}

static void scanned(void *user, const struct import_entry *entry, size_t n,
                    const char *const *changed, size_t n_changed)
{
    struct repository *r = user;
    for (struct model *m = NULL; n_changed && (m = models_next(r->server->models, m));)
        if (m->source && is_changed(m, changed, n_changed)) file_changed(r, m);
    for (struct version *v = NULL; (v = versions_next(r->server->versions, v));) {
        struct order *o = v->state == VERSION_WANTED ? find_order(r, v->name, "") : NULL;
        if (v->state != VERSION_WANTED) continue;
        if (o ? restart(o) : add_order(r, v->name, "") != NULL) v->state = VERSION_LOADING;
    }
    if (r->order) wake_at(r, loop_now_ns());
}

// Bakes that are to replace another model, and that the daemon's end interrupted.
static void recall(struct repository *r)
{
    for (struct model *m = NULL; (m = models_next(r->server->models, m));) {
        struct order *o = m->replaces[0] ? add_order(r, NULL, m->replaces) : NULL;
        if (!o) continue;
        snprintf(o->id, sizeof o->id, "%s", m->id);
        o->model = m;
        model_hold(m);
        o->watcher.changed = model_has_changed;
        model_watch(m, &o->watcher);
        o->state = ORDER_BAKING;
    }
    if (r->order) wake_at(r, loop_now_ns());
}

int models_follow_folder(struct server *server)
{
    struct repository *r = calloc(1, sizeof *r);
    if (!r) return PRT_NOMEM;
    server->repository = r;
    r->server = server;
    r->timer.fire = run_orders;
    recall(r);
    imports_on_scan(server->imports, scanned, r);
    return PRT_OK;
}

void models_unfollow_folder(struct server *server)
{
    struct repository *r = server->repository;
    if (!r) return;
    loop_timer_stop(server->loop, &r->timer);
    while (r->order) end_order(r->order);
    free(r);
    server->repository = NULL;
}
