// SPDX-License-Identifier: MIT
// LOAD: has files of --models copied, names the model by its content, finds the bake or lays
// out a folder for one and orders it. load.h names the files of its steps.
#include "ops/load.h"

#include "core/log.h"
#include "net/dispatch.h"
#include "store/disk.h"
#include "store/eviction.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void load_drop(struct load *load)
{
    for (size_t i = 0; i < load->n_file; i++) {
        if (load->file[i].copy) import_unuse(load->file[i].copy);
        free(load->file[i].name);
    }
    for (size_t i = 0; i < load->n_sibling; i++) free(load->sibling[i]);
    for (unsigned i = 0; i < load->n_material; i++) {
        free(load->material[i].arg);
        free(load->material[i].text);
    }
    free(load->sibling);
    cache_release(load->entry);
    model_release(load->model);
    free(load);
}

static void abandon(struct request *request)
{
    struct load *load = request->state;
    load->request = NULL; // freed when its wait ends
    if (load->entry && load->entry->state == CACHE_PENDING) {
        cache_leave(load->entry, &load->waiter);
        load_drop(load);
        return;
    }
    if (load->importing) imports_cancel(load->server->imports, &load->import);
    else if (load->checking[0])
        blobs_check_leave(load->server->blobs, load->checking, &load->blob_waiter);
    else return;
    load_drop(load);
}

const Relight__LoadRequest *load_message(const struct load *load)
{
    return (const Relight__LoadRequest *)load->request->message;
}

static void answer(struct load *load, const struct model *m)
{
    Relight__LoadAnswer out = RELIGHT__LOAD_ANSWER__INIT;
    char *warnings[64], *copy = m->warnings ? strdup(m->warnings) : NULL;
    out.model = (char *)m->id;
    out.state = model_state(m);
    if (m->state != RELIGHT__MODEL_STATE__MODEL_READY) out.job = (char *)m->job_id;
    out.warnings = warnings;
    char *save = NULL;
    for (char *line = copy ? strtok_r(copy, "\n", &save) : NULL; line && out.n_warnings < 64;
         line = strtok_r(NULL, "\n", &save))
        warnings[out.n_warnings++] = line;
    request_answer(load->request, &out.base, NULL);
    load_drop(load); // and with it the model, perhaps
    free(copy);
}

// A bake is acknowledged once its job is on the disk.

static int run_nothing(struct file_task *task)
{
    return PRT_OK;
}

static void written(struct file_task *task)
{
    struct load *load = (struct load *)task;
    struct model *m = load->model;
    if (!load->request) load_drop(load);
    else if (m->gone) LOAD_FAIL(load, NOT_FOUND, "the model was unloaded meanwhile");
    else if (m->record_err)
        LOAD_FAIL(load, LIMIT, "the bake is queued, but --store takes no record of it: %s",
                  strerror(-m->record_err));
    else answer(load, m);
}

// Behind the records of the model, of which the load has a reference, and of its job.
static void answer_when_written(struct load *load)
{
    load->task.run = run_nothing;
    load->task.done = written;
    file_queue_add(load->server->file_queue, &load->task);
}

// Other replicas are asked for it from now on.
static void answer_opened(struct load *load)
{
    if (object_store_shared(load->server->objects)) answer_when_written(load);
    else answer(load, load->model);
}

static void opened(struct cache_waiter *waiter)
{
    struct load *load = (struct load *)((char *)waiter - offsetof(struct load, waiter));
    if (!load->request) {
        load_drop(load);
        return;
    }
    struct model *m = load->model;
    if (load->entry->state == CACHE_FAILED) {
        request_fail(load->request, load->entry->error_code, "%s", load->entry->error);
        // Such a model exists only for its bake.
        if (!m->gone && m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW &&
            m->mesh == MESH_FAILED)
            model_unload(m, true);
        load_drop(load);
    } else if (m->gone) {
        LOAD_FAIL(load, NOT_FOUND, "the model was unloaded meanwhile");
    } else {
        answer_opened(load);
    }
}

static void answer_when(struct load *load, struct model *m, struct cache_entry *entry, int code,
                        const char *error)
{
    load->model = m;
    model_hold(m);
    load->entry = entry;
    if (!load->entry) {
        request_fail(load->request, code, "%s", error);
        load_drop(load);
    } else if (load->entry->state == CACHE_PENDING) {
        load->waiter.wake = opened;
        cache_wait(load->entry, &load->waiter);
    } else {
        answer_opened(load);
    }
}

// A baked model is answered once it is open: `ready` is then true.
void load_open_and_answer(struct load *load, struct model *m)
{
    int code = 0;
    char error[256] = "";
    struct cache_entry *entry = model_open(m, &code, error);
    answer_when(load, m, entry, code, error);
}

// A model without a bake is answered once its file was read, or refused.
static void mesh_and_answer(struct load *load, struct model *m)
{
    int code = 0;
    char error[256] = "";
    struct cache_entry *entry = model_mesh_open(m, &code, error);
    answer_when(load, m, entry, code, error);
}

// ---- from a source's hash to an answer

// A model without files that no request waits for.
static bool is_bare(const struct model *m)
{
    return !m->gone && !m->preparing && !m->loads && m->mesh == MESH_NONE &&
           m->state == RELIGHT__MODEL_STATE__MODEL_RECEIVED;
}

static void go_on(struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = load_message(load);
    int before = m->state;
    char error[256];
    int code;
    if (load->bake_bytes) {
        model_set_state(m, RELIGHT__MODEL_STATE__MODEL_READY);
        if (load->away) m->away_bytes = load->bake_bytes;
        else model_charge_bake(m, load->bake_bytes);
        load->server->stats.bakes_cached++;
        model_remember(m);
        load_open_and_answer(load, m);
        return;
    }
    load_order_preview(load, m);
    if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING) {
        answer(load, m);
    } else if (r->preview) {
        model_set_state(m, RELIGHT__MODEL_STATE__MODEL_PREVIEW);
        m->error[0] = m->job_id[0] = 0; // those of a bake that ended
        mesh_and_answer(load, m);
    } else if (!(code = load_order_bake(load, m, error))) {
        model_hold(load->model = m);
        answer_when_written(load);
    } else {
        file_remove(load->server->file_queue, load->bake_folder);
        model_set_state(m, before);
        if (before == RELIGHT__MODEL_STATE__MODEL_RECEIVED) model_unload(m, true);
        request_fail(load->request, code, "%s", error);
        load_drop(load);
    }
}

void load_laid_out(struct file_task *task)
{
    struct load *load = (struct load *)task;
    struct model *m = load->model;
    struct file_queue *queue = load->server->file_queue;
    load->model = NULL; // the reference is this function's
    m->preparing = false;
    if (!load->request || m->gone) {
        file_remove(queue, load->preview_folder);
        file_remove(queue, load->bake_folder);
        if (load->request) LOAD_FAIL(load, NOT_FOUND, "the model was unloaded meanwhile");
        else load_drop(load);
    } else if (load->fault) {
        model_hold(load->model = m);
        load_fail_lay_out(load);
    } else {
        log_request_set(load->request->request_id);
        go_on(load, m);
        log_request_set("");
    }
    while (m->loads && !m->preparing) {
        struct load *next = m->loads;
        m->loads = next->next;
        if (next->request) load_source_known(next);
        else load_drop(next);
    }
    if (is_bare(m)) model_unload(m, true);
    model_release(m);
}

static void lay_out(struct load *load, struct model *m)
{
    const char *data = load->server->data;
    bool baking = m->state == RELIGHT__MODEL_STATE__MODEL_BAKING;
    load->model = m;
    model_hold(m);
    load->find_bake = !baking;
    if (m->mesh != MESH_THERE && m->mesh != MESH_READING)
        snprintf(load->preview_folder, PATH_MAX, "%s/work/%s.preview", data, m->key);
    if (!baking && !load_message(load)->preview)
        snprintf(load->bake_folder, PATH_MAX, "%s/work/%s", data, m->key);
    for (size_t i = 0; i < load->n_file; i++)
        if (!load->file[i].copy) blobs_touch(load->server->blobs, load->file[i].hash);
    if (!strncmp(load->env, "env:", 4)) blobs_touch(load->server->blobs, load->env + 4);
    m->preparing = true;
    load->task.run = load_run_lay_out;
    load->task.done = load_laid_out;
    file_queue_add(load->server->file_queue, &load->task);
}

static struct model *add_model(struct load *load, const char *id, char error[256])
{
    struct principal *p = load->request->conn->principal;
    enum ledger_refusal refusal = ledger_take(p, LEDGER_MODELS, 1, error);
    // One that failed, or an old preview, makes room for a new one.
    if (refusal &&
        evict_preview(load->server, refusal == LEDGER_CLIENT_FULL ? p->name : NULL, p->name))
        refusal = ledger_take(p, LEDGER_MODELS, 1, error);
    if (refusal) return NULL;
    snprintf(error, 256, "not enough memory");
    struct model *m = model_add(load->server->models, id, load->name, load->owner);
    ledger_give(p, LEDGER_MODELS, 1); // model_add has charged it
    return m;
}

bool load_pin(struct load *load, struct model *m)
{
    if (!load_message(load)->pin || m->pinned) return true;
    if (!operation_owned(load->request, m->owner, load->name)) {
        load_drop(load); // the request is answered
        return false;
    }
    log_line(LOG_EVENT, "audit act=pin who=%s model=%s owner=%s", load->owner, m->id, m->owner);
    return m->pinned = true;
}

// A model of a file of --models follows the file, unless its content was uploaded, too.
static bool keep_source(struct load *load, struct model *m, bool fresh)
{
    bool by_path = load_message(load)->path[0];
    char *text = by_path && (fresh || m->source) ? load_source_text(load) : NULL;
    bool same = text && m->source ? !strcmp(text, m->source) : text == m->source;
    free(m->source);
    m->source = text;
    return !same;
}

// Nothing more begins when what rooms need fills the disk.
static bool rooms_fill_disk(const struct load *load, const struct model *m, char error[256])
{
    struct server *server = load->server;
    if (m && (m->copy || m->state == RELIGHT__MODEL_STATE__MODEL_READY ||
              m->state == RELIGHT__MODEL_STATE__MODEL_BAKING))
        return false;
    evict_for_room(server, m, NULL);
    return evict_over(server, load->owner, error) && evict_held(server, NULL);
}

void load_source_known(struct load *load)
{
    const Relight__LoadRequest *r = load_message(load);
    char id[MODEL_ID + 1], kin[MODEL_ID + 1], error[256];
    load_name_model(load, id, kin);
    struct model *m = models_get(load->server->models, id);
    bool fresh = !m;
    if (rooms_fill_disk(load, m, error) || (fresh && !(m = add_model(load, id, error)))) {
        LOAD_FAIL(load, LIMIT, "%s", error);
        return;
    }
    strcpy(m->kin, kin);
    bool own = !strcmp(m->owner, load->owner);
    bool pinned = m->pinned;
    if (!load_pin(load, m)) return;
    bool changed = m->pinned != pinned;
    changed |= keep_source(load, m, fresh);
    if (!m->load && object_store_shared(load->server->objects)) m->load = load_packed(load);
    if (m->removed) model_revive(m);
    // What the folder calls a client's model is the name of a version: store/versions.h.
    bool names = own ? r->name[0] : strcmp(load->owner, DISK_NOBODY) != 0;
    if (names) changed |= model_set_name(m, load->owner, load->name);
    m->used_ns = wall_ns();
    // One without a bake or a preview is remembered as soon as it has one.
    bool is_there = m->state == RELIGHT__MODEL_STATE__MODEL_READY || m->mesh == MESH_THERE;
    if (changed && is_there) model_remember(m);
    log_line(LOG_EVENT, "load model=%s name=\"%s\" conn=%llu %s", m->id, load->name,
             (unsigned long long)load->request->conn->number, fresh ? "new" : "known");
    bool complete = m->mesh == MESH_THERE || m->mesh == MESH_READING;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        load_open_and_answer(load, m);
    } else if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING && complete) {
        answer(load, m);
    } else if (m->preparing) {
        struct load **last = &m->loads;
        while (*last) last = &(*last)->next;
        load->next = NULL;
        *last = load;
    } else {
        lay_out(load, m);
    }
}

// The uploads a load needs: its files, then its environment. NULL past the last.
static const char *needed_blob(const struct load *load, size_t index)
{
    size_t n = load_message(load)->n_files ? load->n_file : 0;
    bool light = !strncmp(load->env, "env:", 4);
    if (index < n) return load->file[index].hash;
    return index == n && light ? load->env + 4 : NULL;
}

// Has every upload checked, one after another, before any of them is used.

static void blob_checked(struct blob_waiter *waiter)
{
    struct load *load = (struct load *)((char *)waiter - offsetof(struct load, blob_waiter));
    load->checking[0] = 0;
    load_check_next(load);
}

void load_check_next(struct load *load)
{
    size_t i = load->n_checked++;
    const char *before = i ? needed_blob(load, i - 1) : NULL, *hash = needed_blob(load, i);
    if (before && !blobs_has(load->server->blobs, before)) {
        LOAD_FAIL(load, NOT_FOUND, "%.12s… was damaged on the daemon's disk: upload it again",
                  before);
    } else if (hash) {
        load->blob_waiter.wake = blob_checked;
        snprintf(load->checking, sizeof load->checking, "%s", hash);
        blobs_check(load->server->blobs, hash, &load->blob_waiter);
    } else if (load_message(load)->n_files) {
        load_source_known(load);
    } else {
        load_import_next(load);
    }
}

void models_load(struct request *request)
{
    const Relight__LoadRequest *r = (const Relight__LoadRequest *)request->message;
    struct load *load = calloc(1, sizeof *load);
    if (!load) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    load->server = request->server;
    load->request = request;
    request->state = load;
    request->abandon = abandon;
    snprintf(load->owner, sizeof load->owner, "%s", request->conn->principal->name);
    if (!r->n_files == !r->path[0]) {
        LOAD_FAIL(load, BAD_REQUEST, "either files or path names the model, not both");
        return;
    }
    if (r->n_files > MAX_FILES) {
        LOAD_FAIL(load, LIMIT, "more than %d files", MAX_FILES);
        return;
    }
    char reason[128];
    const char *bad = load_bad_setting(r, reason);
    if (bad) {
        LOAD_FAIL(load, OUT_OF_RANGE, "%s", bad);
        return;
    }
    name_printable(r->name[0] ? r->name
                              : load_file_part(r->n_files ? r->files[0]->name : r->path),
                   load->name, sizeof load->name);
    if (!load_check_env(load) ||
        (r->n_files && (!load_check_material(load) || !load_check_files(load)))) {
        load_drop(load); // the request is answered
        return;
    }
    load_check_next(load);
}
