// SPDX-License-Identifier: MIT
// Models of other replicas: the look at the folder's records on a worker, and what follows
// from it on the loop. Above 600 lines: records, looks and waiters change together on the
// loop.
#include "ops/shared_models.h"

#include "core/log.h"
#include "net/dispatch.h"
#include "relight.pb-c.h"
#include "store/disk.h"
#include "store/holds.h"
#include "store/model_files.h"

#include <cjson/cJSON.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LOAD_MS = 600000, MOST_REPLICAS = 64, DAY_S = 86400 };
static const double stale_s = 10;
static const uint64_t least_gap_ns = 200000000;      // between two looks that requests cause
static const uint64_t least_missing_ns = 1000000000; // of a record that is gone
static const uint64_t again_ns =
    60000000000u; // between two tries to load what a dead one baked

enum record_state { RECORD_READY, RECORD_BAKING, RECORD_PREVIEW };

struct record {
    struct record *next;
    char id[MODEL_ID + 1], name[128], owner[96], replica[17];
    char kin[MODEL_ID + 1];
    uint64_t tag, bytes, tried_ns; // tried_ns: its LOAD was repeated last; 0: never
    uint32_t file;                 // version of its .prt
    enum record_state state;
    char *load; // hex digits
    bool seen;  // in the look that ended last
    // When the first of the looks began that did not find it; 0: the last one did.
    uint64_t missing_ns;
};

// Another replica, as long as one of its records is BAKING.
struct peer {
    char run[17];
    struct object_watch watch;
    int err;
    bool dead;
};

// A record as a worker found it.
struct found {
    char id[MODEL_ID + 1];
    uint64_t tag;
    char *text; // NULL: as it was
};

struct look {
    struct work work; // first
    double keep_s;    // of --store-keep; and when to remove again what nobody uses
    uint64_t collect_ns, n_collected;
    char *held;  // lines: what rooms need; NULL: not known, or not wanted now
    char *fresh; // lines: what they need since the last look; NULL: nothing
    int keep_err;
    const struct server *server; // its folders
    struct object_store *objects;
    struct object_claim *alive; // tells others that this replica lives
    struct object_watch alive_watch, collect_watch;
    char run[17];
    size_t n_known, n_found, room, n_peer;
    struct found *known, *found;
    struct peer peer[MOST_REPLICAS];
    int err;
};

// A LOAD of another replica that is repeated here.
struct replay {
    struct replay *next;
    struct shared_models *shared;
    struct connection *conn;
    char id[MODEL_ID + 1];
    bool ended;
};

struct shared_models {
    struct server *server;
    struct loop_timer timer;
    struct look look;
    bool looking, stopping, told_away;
    uint64_t n_look, started_ns; // of the one under way or the last
    struct record *record;
    struct replay *replay;
    struct shared_model_waiter *waiter;
};

// ---- on a worker

static int by_id(const void *a, const void *b)
{
    return strcmp(((const struct found *)a)->id, ((const struct found *)b)->id);
}

static int list_one(void *user, const char *id, uint64_t tag)
{
    struct look *look = user;
    struct found key = {.tag = tag};
    if (strlen(id) != MODEL_ID) return 0;
    if (look->n_found == look->room) {
        size_t room = look->room ? 2 * look->room : 64;
        struct found *more = realloc(look->found, room * sizeof *more);
        if (!more) return -ENOMEM;
        look->found = more;
        look->room = room;
    }
    strcpy(key.id, id);
    const struct found *known =
        look->n_known ? bsearch(&key, look->known, look->n_known, sizeof key, by_id) : NULL;
    if (!known || known->tag != tag) {
        int err = object_read(look->objects, id, &key.text);
        if (err == -ENOENT) return 0;         // removed meanwhile
        if (err && err != -EFBIG) return err; // one too long is left alone
    }
    look->found[look->n_found++] = key;
    return 0;
}

static void say_alive(struct look *look)
{
    if (look->alive && object_claim_beat(look->alive, "replica") == -ESTALE) {
        object_claim_release(look->alive);
        look->alive = NULL;
    }
    if (!look->alive)
        (void)object_claim_take(look->objects, look->run, stale_s, &look->alive_watch,
                                &look->alive);
}

// What a room needs counts as used, so that it stays, whichever replica removes the rest. What
// was removed before it was needed is put again from this replica's own file.
static void keep_one(struct look *look, const char *name)
{
    char path[PATH_MAX], owner[PATH_MAX + 8];
    int err;
    if (strlen(name) == MODEL_ID) {
        model_bake_path(look->server, name, path);
        err = object_put(look->objects, OBJECT_BAKE, name, path);
    } else {
        blobs_path(look->server->blobs, name, path, sizeof path);
        snprintf(owner, sizeof owner, "%s.owner", path);
        err = object_put(look->objects, OBJECT_BLOB, name, path);
        if (!err) (void)object_put(look->objects, OBJECT_OWNER, name, owner);
    }
    // Not here either, or a file of --models, which has a name of its own.
    if (err && err != -ENOENT && err != -EINVAL) look->keep_err = err;
}

static void keep_all(struct look *look, char *lines)
{
    for (char *line = lines, *end; line && (end = strchr(line, '\n')); line = end + 1) {
        *end = 0;
        keep_one(look, line);
    }
}

// Once an hour, by one replica at a time; not before this one knows what rooms need.
static void collect(struct look *look)
{
    static const char id[] = "c011ec7c011ec7";
    struct object_claim *claim;
    uint64_t now = loop_now_ns();
    if (now < look->collect_ns || !look->held) return;
    look->collect_ns = now + 3600000000000u;
    keep_all(look, look->held);
    if (object_claim_take(look->objects, id, stale_s, &look->collect_watch, &claim)) return;
    (void)object_collect(look->objects, look->keep_s, &look->n_collected);
    object_claim_release(claim);
}

static int run_look(struct work *work, const struct prt_context *ctx)
{
    struct look *look = (struct look *)work;
    qsort(look->known, look->n_known, sizeof *look->known, by_id);
    say_alive(look);
    keep_all(look, look->fresh);
    collect(look);
    look->err = object_list(look->objects, OBJECT_RECORD, list_one, look);
    for (size_t i = 0; i < look->n_peer; i++) {
        struct peer *p = &look->peer[i];
        unsigned generation = 0;
        char text[200] = "";
        p->err = object_claim_look(look->objects, p->run, &generation, text);
        if (p->err && p->err != -ENOENT) continue;
        bool same = p->watch.since_ns && generation == p->watch.generation &&
                    !strcmp(text, p->watch.text);
        uint64_t now = loop_now_ns();
        if (!same) {
            p->watch.generation = generation;
            memcpy(p->watch.text, text, sizeof text);
            p->watch.since_ns = now;
        }
        p->dead = same && (double)(now - p->watch.since_ns) > stale_s * 1e9;
    }
    return PRT_OK;
}

// ---- records

static const char *text_of(const cJSON *json, const char *key)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    return text ? text : "";
}

static struct record *find_record(const struct shared_models *s, const char *id)
{
    struct record *r = s->record;
    while (r && strcmp(r->id, id)) r = r->next;
    return r;
}

static void read_record(struct record *r, const cJSON *json)
{
    const char *state = text_of(json, "state"), *load = text_of(json, "load");
    const cJSON *bytes = cJSON_GetObjectItemCaseSensitive(json, "bytes");
    snprintf(r->name, sizeof r->name, "%s", text_of(json, "name"));
    snprintf(r->owner, sizeof r->owner, "%s", text_of(json, "owner"));
    snprintf(r->replica, sizeof r->replica, "%s", text_of(json, "replica"));
    snprintf(r->kin, sizeof r->kin, "%s", text_of(json, "kin"));
    r->file = record_version(json, "file");
    r->tried_ns = 0;
    relight_utf8_cut(r->name);
    r->state = !strcmp(state, "ready")    ? RECORD_READY
               : !strcmp(state, "baking") ? RECORD_BAKING
                                          : RECORD_PREVIEW;
    r->bytes =
        cJSON_IsNumber(bytes) && bytes->valuedouble > 0 ? (uint64_t)bytes->valuedouble : 0;
    free(r->load);
    r->load = load[0] ? strdup(load) : NULL;
}

// Made by a relightd whose .prt this one cannot read: it is left alone, and its LOAD is
// repeated here when somebody asks for it.
static bool is_foreign(const struct record *r)
{
    return r->file != PRT_FILE_VERSION;
}

static const char *kin_of(const struct server *server, const char *id)
{
    const struct record *r =
        server->shared_models ? find_record(server->shared_models, id) : NULL;
    return r && is_foreign(r) ? r->kin : "";
}

// A model of this replica's own that answers for the record's.
static bool is_here(const struct shared_models *s, const struct record *r)
{
    const struct models *models = s->server->models;
    return models_get(models, r->id) || (is_foreign(r) && models_kin(models, r->kin));
}

void shared_models_forget_kin(struct shared_models *s, const struct model *m)
{
    for (const struct record *r = s && m->kin[0] ? s->record : NULL; r; r = r->next)
        if (is_foreign(r) && !strcmp(r->kin, m->kin)) model_forget_shared(s->server, r->id);
}

// The model is another's until this replica loads it itself.
static void take_over(struct shared_models *s, const struct record *r, const cJSON *json)
{
    struct model *m = models_get(s->server->models, r->id);
    if (r->state != RECORD_READY || is_foreign(r)) return;
    if (!m && !(m = model_add(s->server->models, r->id, r->name, r->owner))) return;
    if (m->job || m->preparing) return; // its own job finds the bake
    if (!m->recorded) {
        const cJSON *one;
        cJSON_ArrayForEach(one, cJSON_GetObjectItemCaseSensitive(json, "aliases"))
            model_set_name(m, text_of(one, "owner"), text_of(one, "name"));
        if (text_of(json, "warnings")[0] && !m->warnings)
            m->warnings = strdup(text_of(json, "warnings"));
    }
    if (r->load && !m->load) m->load = strdup(r->load);
    memcpy(m->kin, r->kin, sizeof m->kin);
    m->bake_version = record_version(json, "bake");
    if (m->state != RELIGHT__MODEL_STATE__MODEL_READY) {
        log_line(LOG_EVENT, "model id=%s name=\"%s\" was baked by another replica", m->id,
                 m->name);
        model_is_away(m, r->bytes);
    } else {
        model_set_name(m, r->owner, r->name);
        m->recorded = true;
    }
}

static void changed(struct shared_models *s, const struct found *f)
{
    struct record *r = find_record(s, f->id);
    cJSON *json = cJSON_ParseWithLength(f->text, strlen(f->text));
    if (!json || strcmp(text_of(json, "id"), f->id)) {
        log_line(LOG_WARN, "record %s in --store cannot be read", f->id);
        cJSON_Delete(json);
        return;
    }
    if (!r && (r = calloc(1, sizeof *r))) {
        strcpy(r->id, f->id);
        r->next = s->record;
        s->record = r;
    }
    if (r) {
        r->tag = f->tag;
        r->seen = true;
        read_record(r, json);
        take_over(s, r, json);
    }
    cJSON_Delete(json);
}

static void free_record(struct record *r)
{
    free(r->load);
    free(r);
}

// Somebody unloaded the model, unless this replica has just loaded it again.
static void removed(struct shared_models *s, const struct record *r)
{
    struct model *m = models_get(s->server->models, r->id);
    bool fresh = m && m->recorded_ns >= s->started_ns;
    if (!m || !m->recorded || m->job || m->preparing || fresh) return;
    log_line(LOG_EVENT, "model id=%s name=\"%s\" was unloaded by another replica", m->id,
             m->name);
    m->recorded = false;
    model_unload(m, true);
}

// ---- repeating a LOAD

static void nothing(struct connection *conn)
{
}

static void set_reading(struct connection *conn, bool on)
{
}

static void closed(struct connection *conn)
{
    struct replay *p = conn->carrier_data;
    p->conn = NULL;
    p->ended = true;
}

static void look_now(struct shared_models *s, uint64_t at_ns)
{
    if (!s->timer.armed || at_ns < s->timer.at_ns)
        loop_timer_set(s->server->loop, &s->timer, at_ns);
}

static void answered(struct connection *conn, uint16_t type, uint8_t flags,
                     const ProtobufCMessage *message, struct payload *payload)
{
    struct replay *p = conn->carrier_data;
    if (payload->release) payload->release(payload->owner);
    if (type == RELIGHT_TYPE_ERROR)
        log_line(LOG_WARN, "model id=%s of another replica cannot be loaded error=\"%s\"",
                 p->id, ((const Relight__Error *)message)->text);
    if (type != RELIGHT_TYPE_ERROR && type != (RELIGHT_TYPE_LOAD | RELIGHT_TYPE_ANSWER)) return;
    p->ended = true;
    look_now(p->shared, loop_now_ns()); // the connection is still in use here
}

static const struct carrier replay_carrier = {"replica", nothing, set_reading,
                                              closed,    NULL,    answered};

static uint8_t hex_value(char c)
{
    return (uint8_t)(c <= '9' ? c - '0' : c - 'a' + 10);
}

static void dispatch(struct replay *p, const char *hex)
{
    size_t n = strspn(hex, "0123456789abcdef") / 2;
    uint8_t *header = malloc(n + 1);
    for (size_t i = 0; header && i < n; i++)
        header[i] = (uint8_t)(hex_value(hex[2 * i]) << 4 | hex_value(hex[2 * i + 1]));
    struct relight_frame frame = {.flags = RELIGHT_FRAME_LAST,
                                  .type = RELIGHT_TYPE_LOAD,
                                  .id = 1,
                                  .deadline_ms = LOAD_MS,
                                  .header_size = (uint32_t)n,
                                  .header = header};
    if (header) dispatch_frame(p->conn, &frame, NULL);
    free(header);
}

static bool repeat_load(struct shared_models *s, const struct record *r)
{
    struct caller caller = {.scopes = SCOPE_VIEW | SCOPE_EDIT | SCOPE_UPLOAD};
    for (const struct replay *p = s->replay; p; p = p->next)
        if (!strcmp(p->id, r->id)) return true;
    struct replay *p =
        r->load && !s->stopping && !s->server->draining ? calloc(1, sizeof *p) : NULL;
    if (!p) return false;
    snprintf(caller.name, sizeof caller.name, "%s", r->owner[0] ? r->owner : DISK_NOBODY);
    p->shared = s;
    strcpy(p->id, r->id);
    p->conn = connection_open(s->server, &replay_carrier, p, "another replica", caller.name);
    if (!p->conn) {
        free(p);
        return false;
    }
    log_line(LOG_EVENT, "model id=%s name=\"%s\" of another replica is loaded here", r->id,
             r->name);
    p->next = s->replay;
    s->replay = p;
    p->conn->greeted = p->conn->prepaid = true;
    p->conn->caller = caller;
    dispatch(p, r->load);
    return true;
}

static void sweep_replays(struct shared_models *s)
{
    for (struct replay **at = &s->replay, *p; (p = *at);) {
        if (!p->ended && p->conn && p->conn->requests) {
            at = &p->next;
            continue;
        }
        *at = p->next;
        if (p->conn) connection_close(p->conn, "answered");
        free(p);
    }
}

// ---- waiting requests

static bool is_called(const struct record *r, const char *text)
{
    return !strcmp(r->id, text) || name_matches(r->name, text) ||
           (strlen(text) >= 8 && !strncmp(r->id, text, strlen(text)));
}

// False: it waits on.
static bool serve(struct shared_models *s, struct shared_model_waiter *w)
{
    char error[256];
    for (const struct replay *p = s->replay; w->loading[0] && p; p = p->next)
        if (!strcmp(p->id, w->loading)) return false;
    if (w->loading[0] || models_find(s->server->models, w->asker, w->name, error)) return true;
    for (const struct record *r = s->record; r; r = r->next) {
        if (r->missing_ns || !is_called(r, w->name) || is_here(s, r)) continue;
        if (!repeat_load(s, r)) continue;
        strcpy(w->loading, r->id);
        return false;
    }
    return s->n_look >= w->look && !s->looking;
}

static void serve_all(struct shared_models *s)
{
    struct shared_model_waiter *list = s->waiter, *keep = NULL;
    s->waiter = NULL;
    for (struct shared_model_waiter *w = list, *next; w; w = next) {
        next = w->next;
        if (serve(s, w)) {
            w->wake(w); // may add waiters
        } else {
            w->next = keep;
            keep = w;
        }
    }
    while (keep) {
        struct shared_model_waiter *next = keep->next;
        keep->next = s->waiter;
        s->waiter = keep;
        keep = next;
    }
}

// What is not here and could be: of another version's only what it finished.
static bool is_listed(const struct shared_models *s, const struct record *r)
{
    bool wanted = is_foreign(r) ? r->state != RECORD_BAKING : r->state != RECORD_READY;
    return wanted && !r->missing_ns && !is_here(s, r);
}

size_t shared_models_list(const struct shared_models *s, size_t from, struct shared_listed *out,
                          size_t most)
{
    size_t n = 0, at = 0;
    for (const struct record *r = s ? s->record : NULL; r && n < most; r = r->next)
        if (is_listed(s, r) && at++ >= from)
            out[n++] = (struct shared_listed){r->id, r->name, r->state == RECORD_BAKING};
    return n;
}

void shared_models_wait(struct shared_models *s, struct shared_model_waiter *w)
{
    uint64_t soon = s->started_ns + least_gap_ns, now = loop_now_ns();
    w->next = s->waiter;
    w->look = s->n_look + 1; // one that begins after this
    s->waiter = w;
    look_now(s, soon > now ? soon : now);
}

// ---- looking

static void forget_look(struct look *look)
{
    for (size_t i = 0; i < look->n_found; i++) free(look->found[i].text);
    free(look->found);
    free(look->known);
    free(look->held);
    free(look->fresh);
    look->held = look->fresh = NULL;
    look->found = look->known = NULL;
    look->n_found = look->room = look->n_known = 0;
}

// A model whose replica has died is loaded here; of several replicas the one that gets the
// claim bakes it.
static void adopt_orphans(struct shared_models *s)
{
    for (size_t i = 0; i < s->look.n_peer; i++)
        for (struct record *r = s->record; r && s->look.peer[i].dead; r = r->next) {
            uint64_t now = loop_now_ns();
            if (r->state != RECORD_BAKING || strcmp(r->replica, s->look.peer[i].run) ||
                r->missing_ns || is_here(s, r) || (r->tried_ns && now - r->tried_ns < again_ns))
                continue;
            if (repeat_load(s, r)) r->tried_ns = now;
        }
}

static uint64_t poll_ns(const struct shared_models *s)
{
    double poll = s->server->options.store_poll;
    return (uint64_t)((poll > .2 ? poll : .2) * 1e9);
}

// On NFS a record that another machine replaces can be missing for a moment (object_write), so
// that one look without it says nothing.
static bool is_gone(const struct shared_models *s, struct record *r)
{
    const uint64_t patience = poll_ns(s) > least_missing_ns ? poll_ns(s) : least_missing_ns;
    if (r->seen) r->missing_ns = 0;
    else if (!r->missing_ns) r->missing_ns = s->started_ns;
    return r->missing_ns && s->started_ns - r->missing_ns >= patience;
}

static void take_look(struct shared_models *s)
{
    struct look *look = &s->look;
    for (struct record *r = s->record; r; r = r->next) r->seen = false;
    for (size_t i = 0; i < look->n_found; i++) {
        struct record *r = look->found[i].text ? NULL : find_record(s, look->found[i].id);
        if (look->found[i].text) changed(s, &look->found[i]);
        else if (r) r->seen = true;
    }
    for (struct record **at = &s->record, *r; (r = *at);) {
        if (!is_gone(s, r)) {
            at = &r->next;
            continue;
        }
        *at = r->next;
        removed(s, r);
        free_record(r);
    }
    adopt_orphans(s);
}

static void look_done(struct work *work)
{
    struct look *look = (struct look *)work;
    struct shared_models *s =
        (struct shared_models *)((char *)look - offsetof(struct shared_models, look));
    s->looking = false;
    if (look->err && !s->told_away)
        log_line(LOG_ERR, "--store %s cannot be read: %s", s->server->options.store,
                 strerror(-look->err));
    if (!look->err && s->told_away) log_line(LOG_EVENT, "--store can be read again");
    s->told_away = look->err != 0;
    if (look->n_collected)
        log_line(LOG_EVENT, "store removed=%llu objects that nobody uses",
                 (unsigned long long)look->n_collected);
    look->n_collected = 0;
    if (look->keep_err)
        log_line(LOG_WARN, "what rooms need cannot be kept in --store: %s",
                 strerror(-look->keep_err));
    look->keep_err = 0;
    if (!look->err) take_look(s);
    forget_look(look);
    serve_all(s);
    look_now(s, s->started_ns + poll_ns(s));
    for (const struct shared_model_waiter *w = s->waiter; w; w = w->next)
        if (!w->loading[0]) look_now(s, s->started_ns + least_gap_ns);
}

static void watch_peers(struct shared_models *s)
{
    struct look *look = &s->look;
    for (const struct record *r = s->record; r; r = r->next) {
        size_t i = 0;
        if (r->state != RECORD_BAKING || !strcmp(r->replica, look->run)) continue;
        while (i < look->n_peer && strcmp(look->peer[i].run, r->replica)) i++;
        if (i < look->n_peer || i == MOST_REPLICAS) continue;
        look->peer[look->n_peer] = (struct peer){0};
        strcpy(look->peer[look->n_peer++].run, r->replica);
    }
}

static void begin_look(struct shared_models *s)
{
    struct look *look = &s->look;
    size_t n = 0;
    for (const struct record *r = s->record; r; r = r->next) n++;
    look->known = calloc(n + 1, sizeof *look->known);
    for (const struct record *r = s->record; look->known && r; r = r->next) {
        strcpy(look->known[look->n_known].id, r->id);
        look->known[look->n_known++].tag = r->tag;
    }
    if (loop_now_ns() >= look->collect_ns) look->held = holds_list(s->server->holds);
    look->fresh = holds_take_fresh(s->server->holds);
    watch_peers(s);
    s->looking = true;
    s->n_look++;
    s->started_ns = loop_now_ns();
    work_submit(s->server->work, &look->work);
}

static void fire(struct loop_timer *timer)
{
    struct shared_models *s =
        (struct shared_models *)((char *)timer - offsetof(struct shared_models, timer));
    sweep_replays(s);
    serve_all(s);
    if (!s->looking && !s->stopping) begin_look(s);
}

int shared_models_create(struct server *server, struct shared_models **out)
{
    server->fetch_then = shared_fetch_then;
    server->fetch_drop = shared_fetch_drop;
    if (!object_store_shared(server->objects)) return PRT_OK;
    struct shared_models *s = calloc(1, sizeof *s);
    if (!s) return PRT_NOMEM;
    s->server = server;
    s->timer.fire = fire;
    s->look.objects = server->objects;
    s->look.server = server;
    double keep_s = server->options.store_keep;
    s->look.keep_s = keep_s > 0 && keep_s < DAY_S ? DAY_S : keep_s;
    s->look.work.run = run_look;
    s->look.work.done = look_done;
    s->look.work.class = WORK_STILL;
    snprintf(s->look.run, sizeof s->look.run, "%s", server->run);
    *out = s;
    server->kin_of = kin_of;
    // Models that only this replica had, from before --store, are the others', too.
    for (struct model *m = NULL; (m = models_next(server->models, m));)
        if (!m->copy && m->state != RELIGHT__MODEL_STATE__MODEL_FAILED) model_remember(m);
    begin_look(s);
    return PRT_OK;
}

void shared_models_destroy(struct shared_models *s)
{
    if (!s) return;
    s->server->kin_of = NULL;
    s->stopping = true;
    loop_timer_stop(s->server->loop, &s->timer);
    while (s->replay) {
        struct replay *p = s->replay;
        p->ended = true;
        sweep_replays(s);
    }
    while (s->waiter) {
        struct shared_model_waiter *w = s->waiter;
        s->waiter = w->next;
        w->wake(w);
    }
    if (s->look.alive) object_claim_release(s->look.alive);
    for (struct record *r = s->record, *next; r; r = next) {
        next = r->next;
        free_record(r);
    }
    free(s);
}
