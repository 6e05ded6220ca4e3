// SPDX-License-Identifier: MIT
// The search for the file to remove next. Sizes and times of use are kept in memory.
#include "store/eviction.h"

#include "core/log.h"
#include "relight.pb-c.h"
#include "store/disk.h"
#include "store/holds.h"
#include "store/model_files.h"

#include <stdio.h>
#include <string.h>

enum kind { PREVIEW, IMPORT, BAKE, N_KIND };

struct victim {
    struct model *model;
    struct import_copy *copy;
    bool over, open; // its owner holds more than its share; the file is open
    int64_t used_ns;
};

// What room is wanted for, and whose files may go.
struct wish {
    enum ledger_resource resource; // of which shares are counted
    const char *owner;             // only files of this one; NULL: of all
    const char *asker;             // who is refused if no room is found; NULL: nobody
    uint64_t more;                 // that it wants, and does not hold yet
    const struct model *newest;    // stays; may be NULL
    bool busy;                     // files that somebody reads, too
};

uint64_t bakes_bytes(const struct server *server)
{
    uint64_t bytes = 0;
    for (struct model *m = NULL; (m = models_next(server->models, m));) bytes += m->bake_bytes;
    return bytes;
}

static bool above_share(const struct server *server, const struct wish *w, const char *name)
{
    return ledger_above_share(server->ledger, w->resource, name, w->asker, w->more);
}

// Of two that may go the first: of a principal above its share, closed, longest unused.
static bool goes_before(const struct victim *a, const struct victim *b)
{
    if (a->over != b->over) return a->over;
    if (a->open != b->open) return !a->open;
    return a->used_ns < b->used_ns;
}

// A room needs it, and no other replica has it.
static bool is_held(const struct model *m)
{
    const struct server *server = m->server;
    bool shared = m->recorded && object_store_shared(server->objects);
    return !shared && holds_has(server->holds, m->id);
}

// The copy of a .prt of --models whose model a room needs: the file may have other content by
// now.
static bool copy_is_held(const struct server *server, const struct import_copy *copy)
{
    for (struct model *m = NULL; (m = models_next(server->models, m));)
        if (m->copy == copy && is_held(m)) return true;
    return false;
}

uint64_t evict_held(const struct server *server, const char *owner)
{
    uint64_t bytes = blobs_held(server->blobs, owner);
    for (struct model *m = NULL; (m = models_next(server->models, m));)
        if ((!owner || !strcmp(m->owner, owner)) && is_held(m))
            bytes += m->bake_bytes + m->preview_bytes;
    return bytes;
}

void evict_explain(const struct server *server, const char *owner, char error[256])
{
    uint64_t bytes = evict_held(server, owner);
    size_t n = strlen(error);
    if (!bytes) return;
    snprintf(error + n, 256 - n,
             "; review rooms need %llu bytes of it: close rooms that are over (--rooms-keep "
             "deletes them later), or raise the limit",
             (unsigned long long)bytes);
}

static bool may_go(const struct model *m, enum kind kind, bool busy)
{
    if (m->pinned || m->preparing || is_held(m) || (m->users > 1 && !busy)) return false;
    if (kind == BAKE)
        return !m->copy && m->bake_bytes && m->state == RELIGHT__MODEL_STATE__MODEL_READY;
    return kind == PREVIEW && m->preview_bytes && m->mesh == MESH_THERE &&
           (m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW ||
            m->state == RELIGHT__MODEL_STATE__MODEL_FAILED);
}

static bool is_open(const struct model *m)
{
    int state = model_state(m);
    return state == RELIGHT__MODEL_STATE__MODEL_READY ||
           state == RELIGHT__MODEL_STATE__MODEL_PREVIEW;
}

// `greedy`: the asker is above its share.
static bool may_give(const struct server *server, const struct wish *w, const char *owner,
                     bool greedy, struct victim *v)
{
    v->over = above_share(server, w, owner);
    if (w->owner) return !strcmp(w->owner, owner);
    return !greedy || v->over || !strcmp(owner, DISK_NOBODY);
}

static bool find(const struct server *server, enum kind kind, const struct wish *w,
                 struct victim *best)
{
    bool found = false;
    // Whoever wants more than its share gets it from those above theirs.
    bool greedy = w->asker && strcmp(w->asker, DISK_NOBODY) && above_share(server, w, w->asker);
    struct import_copy *c = NULL;
    while (kind == IMPORT && (c = imports_next(server->imports, c))) {
        struct victim v = {.copy = c, .used_ns = c->used_ns};
        if (!c->present || c->users || copy_is_held(server, c) ||
            !may_give(server, w, c->owner, greedy, &v))
            continue;
        if (!found || goes_before(&v, best)) *best = v;
        found = true;
    }
    for (struct model *m = NULL; kind != IMPORT && (m = models_next(server->models, m));) {
        struct victim v = {.model = m, .used_ns = m->used_ns, .open = is_open(m)};
        if (m == w->newest || !may_go(m, kind, w->busy) ||
            !may_give(server, w, m->owner, greedy, &v))
            continue;
        if (!found || goes_before(&v, best)) *best = v;
        found = true;
    }
    return found;
}

static void evict(struct server *server, enum kind kind, const struct victim *v)
{
    if (kind == IMPORT) {
        log_line(LOG_EVENT, "import hash=%.16s dropped for room", v->copy->hash);
        import_evict(server->imports, v->copy);
        return;
    }
    log_line(LOG_EVENT, "model id=%s name=\"%s\" owner=%s %s dropped for room", v->model->id,
             v->model->name, v->model->owner, kind == BAKE ? "bake" : "preview");
    if (kind == BAKE) server->stats.bakes_evicted++;
    model_evict(v->model); // requests in progress keep the open file until they end
}

static bool evict_one(struct server *server, enum kind first, struct wish w)
{
    struct victim v = {0};
    for (int busy = 0; busy < 2; busy++) {
        w.busy = busy;
        for (enum kind kind = first; kind < N_KIND; kind++)
            if (find(server, kind, &w, &v)) {
                evict(server, kind, &v);
                return true;
            }
    }
    return false; // all that remains is pinned or foreign
}

// The oldest model that can answer nothing: neither its bake nor its file's mesh is there.
static struct model *oldest_failure(const struct server *server, const char *owner)
{
    struct model *oldest = NULL;
    for (struct model *m = NULL; (m = models_next(server->models, m));) { // newest first
        bool failed = m->state == RELIGHT__MODEL_STATE__MODEL_FAILED && m->mesh != MESH_THERE &&
                      m->mesh != MESH_READING;
        if (failed && m->users == 1 && !m->preparing && !is_held(m) &&
            (!owner || !strcmp(m->owner, owner)))
            oldest = m;
    }
    return oldest;
}

bool evict_preview(struct server *server, const char *owner, const char *asker)
{
    struct victim v = {0};
    struct model *failed = oldest_failure(server, owner);
    if (failed) {
        log_line(LOG_EVENT, "model id=%s name=\"%s\" owner=%s failed, dropped for room",
                 failed->id, failed->name, failed->owner);
        model_unload(failed, true);
        return true;
    }
    struct wish w = {.resource = LEDGER_MODELS, .owner = owner, .asker = asker, .more = 1};
    if (!find(server, PREVIEW, &w, &v)) return false;
    evict(server, PREVIEW, &v);
    return true;
}

static bool evict_of_principal(struct server *server, const struct model *newest)
{
    for (const struct principal *p = ledger_first(server->ledger); p; p = p->next) {
        char name[96];
        uint64_t most = ledger_limit_client(p, LEDGER_DISK);
        if (!most || p->held[LEDGER_DISK] <= most || !strcmp(p->name, DISK_NOBODY)) continue;
        snprintf(name, sizeof name, "%s", p->name); // freed with its last charge
        struct wish w = {.resource = LEDGER_DISK, .owner = name, .newest = newest};
        if (evict_one(server, PREVIEW, w)) return true;
    }
    return false;
}

// Whether so many bytes more would pass --disk; 0 is no limit, as for the ledger.
static bool beyond_disk(const struct server *server, uint64_t more)
{
    uint64_t most = server->options.disk;
    return most && disk_bytes(server->ledger) + more > most;
}

void evict_for_room(struct server *server, const struct model *newest, const char *asker)
{
    const struct options *o = &server->options;
    struct wish w = {.resource = LEDGER_DISK, .asker = asker, .newest = newest};
    struct wish bake = {.resource = LEDGER_DISK, .newest = newest};
    for (;;) {
        if (evict_of_principal(server, newest)) continue;
        if (beyond_disk(server, 0) && evict_one(server, PREVIEW, w)) continue;
        if (bakes_bytes(server) > o->bakes_disk && evict_one(server, BAKE, bake)) continue;
        return;
    }
}

void evict_for_upload(struct server *server, const char *owner, uint64_t bytes)
{
    const struct options *o = &server->options;
    uint64_t most = disk_limit_of(server->ledger, owner),
             more = disk_size(bytes) + disk_size(1); // and the owner's record
    // Refused whatever is evicted.
    if ((o->disk && more > o->disk) || (most && more > most)) return;
    struct wish all = {.resource = LEDGER_DISK, .asker = owner, .more = more}, own = all;
    own.owner = owner;
    while (most && disk_bytes_of(server->ledger, owner) + more > most)
        if (!evict_one(server, PREVIEW, own)) return; // refused: other principals keep theirs
    while (beyond_disk(server, more))
        if (!evict_one(server, PREVIEW, all)) break;
}

void evict_for_event(struct server *server, uint64_t bytes)
{
    struct wish w = {.resource = LEDGER_DISK, .more = bytes};
    while (beyond_disk(server, bytes))
        if (!evict_one(server, PREVIEW, w)) return;
}

bool evict_over(const struct server *server, const char *owner, char error[256])
{
    const struct options *o = &server->options;
    uint64_t mine = disk_bytes_of(server->ledger, owner);
    uint64_t most = disk_limit_of(server->ledger, owner);
    if (most && mine > most)
        snprintf(error, 256,
                 "%s holds %llu bytes on disk, its limit is %llu (--client-disk, or its "
                 "token's quota)",
                 owner, (unsigned long long)mine, (unsigned long long)most);
    else if (beyond_disk(server, 0))
        snprintf(error, 256, "the disk budget of %llu bytes is spent (--disk)",
                 (unsigned long long)o->disk);
    else return false;
    evict_explain(server, most && mine > most ? owner : NULL, error);
    return true;
}
