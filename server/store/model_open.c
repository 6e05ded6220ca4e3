// SPDX-License-Identifier: MIT
// Opening a model's .prt on a worker, reading its properties; watching and unloading.
#include "store/model_files.h"

#include "core/events.h"
#include "core/log.h"
#include "net/request.h"
#include "relight.pb-c.h"
#include "render/shared/geometry.h"
#include "store/disk.h"
#include "store/eviction.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

// Drops the opened file and computed results; their users keep their references. A file that is
// being read or opened is finished, unless the model is removed as a whole.
void model_forget_results(struct model *m, bool all)
{
    char prefix[sizeof m->key + 1];
    snprintf(prefix, sizeof prefix, "%s/", m->key);
    cache_forget(m->server->cache, prefix, true); // shapes and contracted lights hold files
    cache_forget(m->server->files, m->key, all);
}

int model_state(const struct model *m)
{
    char key[sizeof m->key + 8];
    bool preview = m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW;
    if (!preview && m->state != RELIGHT__MODEL_STATE__MODEL_READY) return m->state;
    if (preview && m->mesh == MESH_READING) return RELIGHT__MODEL_STATE__MODEL_RECEIVED;
    snprintf(key, sizeof key, preview ? "%s/mesh" : "%s", m->key);
    bool open = cache_has(m->server->files, key);
    return open ? m->state : RELIGHT__MODEL_STATE__MODEL_UNLOADED;
}

void model_watch(struct model *m, struct model_watcher *watcher)
{
    watcher->next = m->watcher;
    m->watcher = watcher;
}

void model_unwatch(struct model *m, struct model_watcher *watcher)
{
    struct model_watcher **at = &m->watcher;
    while (*at && *at != watcher) at = &(*at)->next;
    if (*at) *at = watcher->next;
}

void model_publish(const struct model *m, int kind, const char *before)
{
    struct event e = {.kind = kind,
                      .model_state = model_state(m),
                      .generation = m->generation,
                      .error_code = m->state == RELIGHT__MODEL_STATE__MODEL_FAILED
                                        ? m->error_code
                                        : RELIGHT__ERROR_CODE__ERROR_NONE};
    snprintf(e.model, sizeof e.model, "%s", m->id);
    snprintf(e.before, sizeof e.before, "%s", before);
    snprintf(e.name, sizeof e.name, "%s", m->name);
    if (e.error_code) snprintf(e.error, sizeof e.error, "%s", m->error);
    events_publish(m->server->events, &e);
}

void model_set_state(struct model *m, int state)
{
    if (m->state == state) return;
    m->state = state;
    model_publish(m, RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED, "");
}

void model_changed(struct model *m)
{
    if (!m->gone) model_publish(m, RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED, "");
    model_wake(m);
}

void model_wake(struct model *m)
{
    // A call may end other watchers or itself: each is looked up again by its number.
    for (unsigned i = 0;; i++) {
        struct model_watcher *w = m->watcher;
        for (unsigned k = 0; w && k < i; k++) w = w->next;
        if (!w) return;
        w->changed(w);
    }
}

void model_reset_pose(struct model *m)
{
    char prefix[96];
    if (!m->pose) return;
    snprintf(prefix, sizeof prefix, "%s/%llu/", m->key, (unsigned long long)m->generation);
    cache_forget(m->server->cache, prefix, true);
    pose_release(m->pose);
    m->pose = NULL;
    m->baked_generation = ++m->generation;
    memcpy(m->facts.box, m->facts.file_box, sizeof m->facts.box);
}

void model_charge_bake(struct model *m, uint64_t bytes)
{
    int64_t before = (int64_t)disk_size(m->bake_bytes);
    disk_charge(m->server->ledger, m->owner, (int64_t)disk_size(bytes) - before);
    m->bake_bytes = bytes;
}

void model_charge_preview(struct model *m, uint64_t bytes)
{
    int64_t before = (int64_t)disk_size(m->preview_bytes);
    disk_charge(m->server->ledger, m->owner, (int64_t)disk_size(bytes) - before);
    m->preview_bytes = bytes;
}

struct opening {
    struct work work;
    struct cache_admission room; // of `entry`: --memory
    struct work_actor actor;
    struct model *model;
    struct cache_entry *entry; // NULL: only the checksums are looked at
    bool preview;              // a mesh without transport
    bool away;                 // its file is in a folder that cannot be read now
    bool fetched;              // its file was copied from there just now
    bool decayed;              // its file is a copy of --models with other bytes than once
    bool header_only;          // without entry: only the properties that LIST shows
    char path[PATH_MAX];
    struct import_copy *used; // stays until it is read
    struct prt_file *file;
    float ms;
};

static void close_file(void *file)
{
    prt_file_close(file);
}

// A bake that another replica made, or that was removed here for room, is copied from the
// folder that they share. A folder that is away says nothing about the bake. Without an entry
// nobody asks for it: one that was removed meanwhile stays away.
static int fetch(struct opening *o, const struct prt_context *ctx)
{
    const struct model *m = o->model;
    if (!o->entry || o->preview || o->used || m->file ||
        !object_store_shared(m->server->objects) || !access(o->path, F_OK))
        return PRT_OK;
    int err = object_get(m->server->objects, OBJECT_BAKE, m->id, o->path);
    o->fetched = !err;
    o->away = err && err != -ENOENT;
    if (!o->away) return PRT_OK; // without a bake opening says so
    return prt_fail(ctx, PRT_IO, "model %.16s: its bake cannot be fetched from --store: %s",
                    m->id, strerror(-err));
}

// Where the copy of a file of --models has other bytes than when it was made, the disk is at
// fault, and the file may be good.
static bool has_decayed(const struct opening *o)
{
    char hash[65];
    return o->used && !o->preview && !blobs_hash_file(o->path, hash) &&
           strcmp(hash, o->used->hash) != 0;
}

static int run_opening(struct work *work, const struct prt_context *ctx)
{
    struct opening *o = (struct opening *)work;
    double start = prt_time_s();
    int fetched = fetch(o, ctx);
    if (fetched) return fetched;
    int status =
        o->entry ? prt_file_read(ctx, o->path, PRT_FILE_CHECK_HEADERS, &o->file)
                 : prt_file_open(ctx, o->path,
                                 o->header_only ? PRT_FILE_CHECK_HEADERS : PRT_FILE_CHECK_ALL,
                                 &o->file);
    o->ms = (float)((prt_time_s() - start) * 1e3);
    if (status == PRT_FORMAT) o->decayed = has_decayed(o);
    return status;
}

// The file itself is at fault: it can never be opened. Lack of memory or descriptors, or an I/O
// error, says nothing about it.
static void damaged(struct model *m, const char *error)
{
    m->error_code = RELIGHT__ERROR_CODE__ERROR_FORMAT;
    snprintf(m->error, sizeof m->error, "%s", error);
    if (m->file) m->state = RELIGHT__MODEL_STATE__MODEL_FAILED; // a draft is no model
    else model_set_state(m, RELIGHT__MODEL_STATE__MODEL_FAILED);
    log_line(LOG_ERR, "model id=%s damaged error=\"%s\"", m->id, m->error);
    if (m->copy || m->file) return;
    // The folder that replicas share may have it whole: its record there is no longer this
    // one's.
    m->recorded &= !object_store_shared(m->server->objects);
    char path[PATH_MAX];
    model_bake_path(m->server, m->id, path);
    model_charge_bake(m, 0);
    file_remove(m->server->file_queue, path); // the next LOAD bakes it again
}

static void start_opening(struct model *m, struct cache_entry *entry, const char *path,
                          bool preview, bool header_only);
static void hold_pin(struct model *m, struct cache_entry *e);

// The next request copies the file again.
static void drop_copy(struct model *m)
{
    log_line(LOG_ERR, "model id=%s its copy imports/%.16s is damaged and was removed", m->id,
             m->copy->hash);
    m->checked = false;
    import_evict(m->server->imports, m->copy);
}

// Its header was read for LIST; no request waits for the file.
static void looked(struct opening *o)
{
    struct model *m = o->model;
    if (o->decayed && !m->gone) {
        drop_copy(m);
        model_unload(m, false);
    } else if (o->work.status == PRT_FORMAT && m->state == RELIGHT__MODEL_STATE__MODEL_READY &&
               !m->gone) {
        damaged(m, o->work.error);
        model_unload(m, false);
    } else if (!o->work.status && !m->facts.baked) {
        model_learn_facts(m, o->file);
    }
    prt_file_close(o->file);
}

static void not_opened(struct opening *o)
{
    struct model *m = o->model;
    const char *error = o->work.error;
    int code = error_of_status(o->work.status);
    bool missing = o->work.status == PRT_IO && access(o->path, F_OK) && errno == ENOENT;
    if (m->gone) { // and its file with it
    } else if (o->decayed) {
        drop_copy(m);
        code = RELIGHT__ERROR_CODE__ERROR_BUSY;
        error = "its copy was damaged on the daemon's disk and is made again: ask once more";
    } else if (o->away || (o->work.status != PRT_FORMAT && !missing)) {
        // lack of memory or descriptors, an I/O error: the next request tries again, and
        // fetches it again
        if (o->fetched) file_remove(m->server->file_queue, o->path);
    } else if (o->preview) {
        model_charge_preview(m, 0);
        m->mesh = MESH_FAILED;
        m->mesh_error_code = code;
        snprintf(m->mesh_error, sizeof m->mesh_error, "%s", error);
        file_remove(m->server->file_queue, o->path);
    } else if (m->copy && missing) {
        import_evict(m->server->imports, m->copy); // the next request copies it again
    } else {
        damaged(m, error);
    }
    cache_fail(o->entry, code, error);
}

// The file's size is known now. A preview beyond the budgets is dropped, a bake is kept: it was
// allowed to begin, and took its time.
static bool charge(struct opening *o)
{
    struct model *m = o->model;
    char error[256];
    if (m->gone || m->copy) return true;
    if (!o->preview && !m->bake_bytes) {
        model_charge_bake(m, prt_file_bytes(o->file));
        evict_for_room(m->server, m, NULL);
    } else if (o->preview && !m->preview_bytes) {
        model_charge_preview(m, prt_file_bytes(o->file));
        evict_for_room(m->server, m, m->owner);
        if (!evict_over(m->server, m->owner, error)) return true;
        model_charge_preview(m, 0);
        m->mesh = MESH_FAILED;
        m->mesh_error_code = RELIGHT__ERROR_CODE__ERROR_LIMIT;
        snprintf(m->mesh_error, sizeof m->mesh_error, "%s", error);
        file_remove(m->server->file_queue, o->path);
        prt_file_close(o->file);
        cache_fail(o->entry, RELIGHT__ERROR_CODE__ERROR_LIMIT, error);
        return false;
    }
    return true;
}

static void is_open(struct opening *o)
{
    struct model *m = o->model;
    bool first = !o->preview && !m->checked && !m->gone;
    if (first) m->checked = true;
    m->n_contracted = 0;
    if (o->preview) model_learn_mesh(m, o->file);
    else model_learn_facts(m, o->file);
    log_line(LOG_EVENT, "model id=%s open ms=%.1f bytes=%llu", m->id, (double)o->ms,
             (unsigned long long)prt_file_bytes(o->file));
    if (!m->gone && !m->copy) file_touch(m->server->file_queue, o->path);
    m->used_ns = wall_ns();
    if (!charge(o)) return;
    o->entry->ms = o->ms;
    o->entry->any_thread = true;
    cache_fill(o->entry, o->file, prt_file_bytes(o->file), close_file);
    if (!o->preview) hold_pin(m, o->entry);
    if (o->preview && m->state == RELIGHT__MODEL_STATE__MODEL_READY && !m->gone)
        preview_remove(m);
    // Reads every byte once, behind the requests.
    if (first && !m->gone) start_opening(m, NULL, o->path, false, false);
}

static void free_opening(struct opening *o)
{
    cache_admission_end(o->model->server->files, &o->room);
    cache_release(o->entry);
    if (o->used) import_unuse(o->used);
    model_release(o->model);
    free(o);
}

static void done_opening(struct work *work)
{
    struct opening *o = (struct opening *)work;
    if (!o->entry) looked(o);
    else if (work->status) not_opened(o);
    else is_open(o);
    // Forgotten while it was read: what was written of it since goes, too.
    if ((o->preview || o->fetched) && o->model->gone && model_is_last(o->model))
        file_remove(o->model->server->file_queue, o->path);
    free_opening(o);
}

static void admitted(struct cache_admission *room)
{
    struct opening *o = (struct opening *)((char *)room - offsetof(struct opening, room));
    struct work_pool *work = o->model->server->work;
    struct work_actor before = work_act(work, o->actor);
    work_submit(work, &o->work);
    work_act(work, before);
}

static uint64_t pinned_bytes(const struct server *server)
{
    uint64_t bytes = 0;
    for (struct model *m = NULL; (m = models_next(server->models, m));)
        bytes += m->pin ? m->pin->bytes : 0;
    return bytes;
}

// False: what can never be freed is in the way.
static bool fits_beside_pinned(const struct cache_admission *room)
{
    const struct opening *o =
        (const struct opening *)((const char *)room - offsetof(struct opening, room));
    uint64_t pinned = pinned_bytes(o->model->server);
    return !pinned || pinned + room->bytes <= o->model->server->options.memory;
}

static void refuse_opening(struct cache_admission *room)
{
    struct opening *o = (struct opening *)((char *)room - offsetof(struct opening, room));
    const struct server *server = o->model->server;
    char error[256];
    snprintf(error, sizeof error,
             "the model needs %llu bytes, and pinned models hold %llu of %llu (--memory): "
             "unload one of them",
             (unsigned long long)room->bytes, (unsigned long long)pinned_bytes(server),
             (unsigned long long)server->options.memory);
    cache_fail(o->entry, RELIGHT__ERROR_CODE__ERROR_LIMIT, error);
    free_opening(o);
}

// Others wait no longer for room that a pinned model will not give back. In a turn of its own:
// a refusal may end the request that pins.
static void check_waiting(struct loop_timer *timer)
{
    struct server *server = (struct server *)((char *)timer - offsetof(struct server, pinned));
    cache_admissions_check(server->files, fits_beside_pinned, refuse_opening);
}

// A pinned model keeps its file open from the first time on that it is.
static void hold_pin(struct model *m, struct cache_entry *e)
{
    struct server *server = m->server;
    if (!m->pinned || m->pin || e->forgotten || e->state != CACHE_READY) return;
    cache_hold(m->pin = e);
    server->pinned.fire = check_waiting;
    loop_timer_set(server->loop, &server->pinned, loop_now_ns());
}

static void start_opening(struct model *m, struct cache_entry *entry, const char *path,
                          bool preview, bool header_only)
{
    struct opening *o = calloc(1, sizeof *o);
    if (!o) {
        if (entry) cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        cache_release(entry);
        return;
    }
    o->work.run = run_opening;
    o->work.done = done_opening;
    o->work.class = entry ? WORK_INTERACTIVE : WORK_BACKGROUND;
    o->model = m;
    model_hold(m);
    o->entry = entry;
    o->preview = preview;
    o->header_only = header_only;
    if ((o->used = m->copy)) import_use(o->used);
    snprintf(o->path, sizeof o->path, "%s", path);
    o->actor = work_actor(m->server->work);
    if (!entry) {
        work_submit(m->server->work, &o->work);
        return;
    }
    cache_set_owner(entry, o->actor.name[0] ? o->actor.name : m->owner);
    o->room.owner = entry->owner;
    o->room.admitted = admitted;
    o->room.bytes = preview ? m->preview_bytes : m->copy ? m->copy->bytes : m->bake_bytes;
    if (!preview && !o->room.bytes) o->room.bytes = m->away_bytes;
    if (fits_beside_pinned(&o->room)) cache_admit(m->server->files, &o->room);
    else refuse_opening(&o->room);
}

void model_start_opening(struct model *m, struct cache_entry *entry, const char *path,
                         bool preview)
{
    start_opening(m, entry, path, preview, false);
}

void model_read_header(struct model *m)
{
    char path[PATH_MAX];
    if (m->copy) import_path(m->server->imports, m->copy->hash, path, sizeof path);
    else model_bake_path(m->server, m->id, path);
    if (!m->copy && !m->bake_bytes) return; // it would be fetched
    if (!m->facts.baked) start_opening(m, NULL, path, false, true);
}

// ---- a copy of --models that was dropped for room is made again

struct reopening {
    struct import_request import; // first
    struct model *model;
    struct cache_entry *entry;
};

static void copied_again(struct import_request *request, struct import_copy *copy,
                         char *const *names, size_t n_name, int code, const char *error)
{
    struct reopening *r = (struct reopening *)request;
    struct model *m = r->model;
    char path[PATH_MAX];
    if (copy && copy != m->copy) {
        code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        error = "its file in the models folder has other content by now";
    }
    if (code) {
        cache_fail(r->entry, code, error);
        cache_release(r->entry);
    } else {
        import_path(m->server->imports, copy->hash, path, sizeof path);
        model_start_opening(m, r->entry, path, false);
    }
    model_release(m);
    free(r);
}

static void start_reopening(struct model *m, struct cache_entry *entry)
{
    const char *source = import_source(m->server->imports, m->copy->hash);
    struct reopening *r = source ? calloc(1, sizeof *r) : NULL;
    if (!r) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                   "its file in the models folder has gone");
        cache_release(entry);
        return;
    }
    *r = (struct reopening){{NULL, copied_again}, m, entry};
    model_hold(m);
    imports_get(m->server->imports, source, m->copy->owner, &r->import);
}

static void start_opening_bake(struct model *m, struct cache_entry *entry)
{
    char path[PATH_MAX];
    m->used_ns = wall_ns();
    if (m->copy && !m->copy->present) {
        start_reopening(m, entry);
        return;
    }
    if (m->copy) import_path(m->server->imports, m->copy->hash, path, sizeof path);
    else if (m->file) snprintf(path, sizeof path, "%s", m->file);
    else model_bake_path(m->server, m->id, path);
    model_start_opening(m, entry, path, false);
}

struct cache_entry *model_open(struct model *m, int *code, char error[256])
{
    m = model_answering(m);
    if (m->gone) {
        *code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        snprintf(error, 256, "%.100s was unloaded and forgotten", m->name);
        return NULL;
    }
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        bool fresh;
        struct cache_entry *e = cache_get(m->server->files, m->key, &fresh);
        if (fresh) {
            cache_hold(e); // one for the opening, one for the caller
            start_opening_bake(m, e);
        }
        hold_pin(m, e);
        return e;
    }
    if (m->state == RELIGHT__MODEL_STATE__MODEL_FAILED) {
        *code = m->error_code ? m->error_code : RELIGHT__ERROR_CODE__ERROR_JOB_FAILED;
        snprintf(error, 256, "%.100s: %.150s", m->name, m->error);
    } else if (m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW) {
        *code = RELIGHT__ERROR_CODE__ERROR_NOT_READY;
        snprintf(error, 256, "%.100s is a preview without a bake: load it without preview",
                 m->name);
    } else {
        *code = RELIGHT__ERROR_CODE__ERROR_NOT_READY;
        snprintf(error, 256, "%.100s still bakes (%.0f %%)", m->name,
                 m->job ? 100 * job_fraction(m->job) : 0.0);
    }
    return NULL;
}

void model_is_away(struct model *m, uint64_t bytes)
{
    m->recorded = true;
    m->away_bytes = bytes;
    m->error[0] = 0;
    model_set_state(m, RELIGHT__MODEL_STATE__MODEL_READY);
    model_changed(m);
}

void model_evict(struct model *m)
{
    char path[PATH_MAX];
    bool shared = m->recorded && object_store_shared(m->server->objects);
    if (shared && m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        model_unload(m, false);
        model_bake_path(m->server, m->id, path);
        m->away_bytes = m->bake_bytes;
        model_charge_bake(m, 0);
        file_remove(m->server->file_queue, path);
        return;
    }
    m->recorded &= !shared;
    model_unload(m, true);
}

uint64_t model_unload(struct model *m, bool forget)
{
    struct server *server = m->server;
    struct cache_counts before, after;
    cache_count(server->files, &before);
    cache_release(m->pin);
    m->pin = NULL;
    model_reset_pose(m);
    model_forget_results(m, forget);
    cache_count(server->files, &after);
    uint64_t freed = before.bytes - after.bytes;
    log_line(LOG_EVENT, "model id=%s unloaded freed=%llu", m->id, (unsigned long long)freed);
    if (!forget || m->gone) return freed;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING && m->job)
        jobs_cancel(server->jobs, m->job);
    model_forget_record(m);
    if (!m->copy && m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        char path[PATH_MAX];
        model_bake_path(server, m->id, path);
        model_charge_bake(m, 0);
        file_remove(server->file_queue, path);
    }
    model_hold(m);
    model_take_out(m);
    model_drop_draft(m);
    preview_remove(m);
    model_changed(m);
    model_release(m);
    return freed;
}
