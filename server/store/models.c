// SPDX-License-Identifier: MIT
// The registry's own part: finding, opening, unloading and remembering models. How a LOAD
// becomes a model is in op_load.c.
#include "store/models.h"

#include "store/bake_eviction.h"
#include "store/model_files.h"
#include "core/log.h"
#include "relight.pb-c.h"
#include "net/request.h"
#include "render/shared/geometry.h"

#include <cjson/cJSON.h>
#include <dirent.h>
#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

struct models {
    struct server *server;
    struct model *model;
    uint64_t scanned_ns;
    uint32_t last_key;
};

// ---- finding

struct model *models_next(const struct models *models, const struct model *model)
{
    return model ? model->next : models->model;
}

static bool name_matches(const char *name, const char *text)
{
    size_t n = strlen(text);
    const char *dot = strrchr(name, '.');
    return !strcmp(name, text) || (dot && (size_t)(dot - name) == n && !strncmp(name, text, n));
}

// The name it was given, and that of its file in --models.
static bool is_called(const struct model *m, const char *text)
{
    const char *slash = m->foreign ? strrchr(m->prt, '/') : NULL;
    return name_matches(m->name, text) || (slash && name_matches(slash + 1, text));
}

static struct model *find_once(struct models *models, const char *text, unsigned *n)
{
    struct model *found = NULL;
    *n = 0;
    for (struct model *m = models->model; m; m = m->next)
        if (!strcmp(m->id, text)) {
            *n = 1;
            return m;
        }
    size_t length = strlen(text);
    for (struct model *m = models->model; m; m = m->next)
        if (is_called(m, text) || (length >= 4 && !strncmp(m->id, text, length))) {
            found = m;
            ++*n;
        }
    return found;
}

struct model *models_find(struct models *models, const char *text, char error[256])
{
    unsigned n;
    struct model *found = find_once(models, text, &n);
    if (!found) {
        models_scan(models);
        found = find_once(models, text, &n);
    }
    if (n == 1) return found;
    snprintf(error, 256,
             n ? "%.100s: %u models are called so; use an id" : "%.100s: no such model", text,
             n);
    return NULL;
}

struct model *model_by_id(struct models *models, const char *id)
{
    struct model *m = models->model;
    while (m && strcmp(m->id, id)) m = m->next;
    return m;
}

bool model_is_last(const struct model *m)
{
    const struct model *other = model_by_id(m->server->models, m->id);
    return !other || other == m;
}

// What was opened and computed for it: who uses some of it keeps that. A file that is being
// read or opened comes to its end, unless the model goes altogether.
static void model_forget_results(struct model *m, bool all)
{
    char prefix[sizeof m->key + 1];
    snprintf(prefix, sizeof prefix, "%s/", m->key);
    cache_forget(m->server->cache, prefix, true); // shapes and contracted lights hold files
    cache_forget(m->server->files, m->key, all);
}

enum { MAX_FAILED = 256 };

// Failures are remembered for who asks, but not for ever.
static void forget_failures(struct models *models)
{
    unsigned n = 0;
    for (struct model **at = &models->model; *at;) {
        struct model *m = *at;
        bool failed = m->state == RELIGHT__MODEL_STATE__MODEL_FAILED && m->users == 1;
        if (!failed || ++n <= MAX_FAILED) {
            at = &m->next;
            continue;
        }
        *at = m->next;
        m->gone = true;
        model_forget_results(m, true);
        preview_remove(m);
        model_release(m);
    }
}

struct model *model_add(struct models *models, const char *id, const char *name)
{
    forget_failures(models);
    struct model *m = calloc(1, sizeof *m);
    if (!m) return NULL;
    m->server = models->server;
    m->state = RELIGHT__MODEL_STATE__MODEL_RECEIVED;
    m->generation = m->baked_generation = 1;
    m->users = 1; // the registry
    snprintf(m->id, sizeof m->id, "%s", id);
    snprintf(m->name, sizeof m->name, "%s", name);
    snprintf(m->key, sizeof m->key, "%s.%08x", id, ++models->last_key);
    m->next = models->model;
    models->model = m;
    return m;
}

// ---- the catalogue: DATA/models/ID.json

static void record_path(const struct server *server, const char *id, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/models/%s.json", server->data, id);
}

void model_bake_path(const struct server *server, const char *id, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/bakes/%s.prt", server->data, id);
}

void model_preview_path(const struct server *server, const char *id, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/previews/%s.prt", server->data, id);
}

void model_remember(const struct model *m)
{
    if (m->foreign) return;
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "id", m->id);
    cJSON_AddStringToObject(json, "name", m->name);
    cJSON_AddBoolToObject(json, "pinned", m->pinned);
    cJSON_AddStringToObject(json, "warnings", m->warnings ? m->warnings : "");
    char *text = cJSON_Print(json), path[PATH_MAX];
    cJSON_Delete(json);
    record_path(m->server, m->id, path);
    if (text && prt_write_file(NULL, path, text, strlen(text)))
        log_line(LOG_WARN, "model id=%s cannot be remembered in %s", m->id, path);
    free(text);
}

static const char *json_text(const cJSON *json, const char *key)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    return text ? text : "";
}

static void recall(struct models *models, const char *path, const char *id)
{
    struct prt_blob blob;
    if (prt_read_file(NULL, path, 1 << 20, &blob)) return;
    cJSON *json = cJSON_ParseWithLength(blob.bytes, blob.size);
    prt_free(blob.bytes);
    char prt[PATH_MAX], preview[PATH_MAX];
    model_bake_path(models->server, id, prt);
    model_preview_path(models->server, id, preview);
    struct model *m = NULL;
    bool baked = !access(prt, R_OK), read = !access(preview, R_OK);
    if (json && !strcmp(json_text(json, "id"), id) && (baked || read))
        m = model_add(models, id, json_text(json, "name"));
    if (m) {
        m->state =
            baked ? RELIGHT__MODEL_STATE__MODEL_READY : RELIGHT__MODEL_STATE__MODEL_PREVIEW;
        if (read) m->mesh = MESH_THERE;
        m->pinned = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "pinned"));
        if (json_text(json, "warnings")[0]) m->warnings = strdup(json_text(json, "warnings"));
        if (baked) {
            snprintf(m->prt, sizeof m->prt, "%s", prt);
            preview_remove(m);
        }
        log_line(LOG_EVENT, "model id=%s name=\"%s\" recalled", m->id, m->name);
        if (baked) model_read_header(m);
    } else {
        log_line(LOG_WARN, "model id=%s has no bake any more", id);
        unlink(path);
    }
    cJSON_Delete(json);
}

static void recall_all(struct models *models)
{
    char folder[PATH_MAX], path[PATH_MAX], id[MODEL_ID + 1];
    snprintf(folder, sizeof folder, "%s/models", models->server->data);
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        size_t n = strlen(d->d_name);
        if (n != MODEL_ID + 5 || strcmp(d->d_name + MODEL_ID, ".json")) continue;
        snprintf(id, sizeof id, "%.*s", MODEL_ID, d->d_name);
        record_path(models->server, id, path);
        recall(models, path, id);
    }
    if (dir) closedir(dir);
}

// Bakes count against the disk budget; what a killed baker left half written goes.
static void sweep(struct models *models, const char *name)
{
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s/%s", models->server->data, name);
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        struct stat st;
        if (fstatat(dirfd(dir), d->d_name, &st, 0) || !S_ISREG(st.st_mode)) continue;
        if (strstr(d->d_name, ".tmp-")) unlinkat(dirfd(dir), d->d_name, 0);
        else blobs_charge(models->server->blobs, st.st_size);
    }
    if (dir) closedir(dir);
}

// ---- .prt files in --models

// A .prt begins with a table of its sections' checksums: this names its content.
static bool prt_id(const char *path, char id[MODEL_ID + 1])
{
    char bytes[8192], hex[65];
    FILE *file = fopen(path, "rb");
    if (!file) return false;
    size_t n = fread(bytes, 1, sizeof bytes, file);
    struct stat st;
    bool ok = n > 64 && !fstat(fileno(file), &st);
    fclose(file);
    if (!ok) return false;
    uint64_t size = (uint64_t)st.st_size;
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, "prt", 4);
    relight_sha256_add(&sha, &size, sizeof size);
    relight_sha256_add(&sha, bytes, n);
    relight_sha256_hex(&sha, hex);
    snprintf(id, MODEL_ID + 1, "%.*s", MODEL_ID, hex);
    return true;
}

struct model *model_from_prt(struct models *models, const char *path, const char *name)
{
    char id[MODEL_ID + 1];
    if (!prt_file_probe(path) || !prt_id(path, id)) return NULL;
    struct model *m = model_by_id(models, id);
    if (m) return m;
    if (!(m = model_add(models, id, name))) return NULL;
    m->state = RELIGHT__MODEL_STATE__MODEL_READY;
    m->foreign = true;
    snprintf(m->prt, sizeof m->prt, "%s", path);
    log_line(LOG_EVENT, "model id=%s name=\"%s\" found path=%s", m->id, m->name, path);
    model_read_header(m);
    return m;
}

void models_scan(struct models *models)
{
    const char *folder = models->server->options.models;
    uint64_t now = loop_now_ns();
    if (!folder[0] || (models->scanned_ns && now - models->scanned_ns < 1000000000u)) return;
    models->scanned_ns = now;
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        size_t n = strlen(d->d_name);
        if (n < 5 || strcasecmp(d->d_name + n - 4, ".prt")) continue;
        char path[PATH_MAX];
        if (snprintf(path, sizeof path, "%s/%s", folder, d->d_name) < PATH_MAX)
            model_from_prt(models, path, d->d_name);
    }
    if (dir) closedir(dir);
}

// ---- opening and unloading

int model_state(const struct model *m)
{
    char key[sizeof m->key + 8];
    bool preview = m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW;
    if (!preview && m->state != RELIGHT__MODEL_STATE__MODEL_READY) return m->state;
    if (preview && m->mesh == MESH_READING) return RELIGHT__MODEL_STATE__MODEL_RECEIVED;
    snprintf(key, sizeof key, preview ? "%s/mesh" : "%s", m->key);
    struct cache_entry *e = cache_find(m->server->files, key);
    bool open = e && e->state == CACHE_READY;
    cache_release(e);
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

void model_changed(struct model *m)
{
    // One that is told may end others, or itself: each is found anew by its number.
    for (unsigned i = 0;; i++) {
        struct model_watcher *w = m->watcher;
        for (unsigned k = 0; w && k < i; k++) w = w->next;
        if (!w) return;
        w->changed(w);
    }
}

void model_reset_pose(struct model *m)
{
    char prefix[64];
    if (!m->pose) return;
    snprintf(prefix, sizeof prefix, "%s/%llu/", m->key, (unsigned long long)m->generation);
    cache_forget(m->server->cache, prefix, true);
    pose_release(m->pose);
    m->pose = NULL;
    m->baked_generation = ++m->generation;
    memcpy(m->facts.box, m->facts.file_box, sizeof m->facts.box);
}

struct opening {
    struct work work;
    struct model *model;
    struct cache_entry *entry; // NULL: only the checksums are looked at
    bool preview;              // a mesh without transport
    bool header_only;          // without entry: only what LIST shows of it
    char path[PATH_MAX];
    struct prt_file *file;
    float ms;
};

static void close_file(void *file)
{
    prt_file_close(file);
}

static int run_opening(struct work *work, const struct prt_context *ctx)
{
    struct opening *o = (struct opening *)work;
    double start = prt_time_s();
    int status = prt_file_open(
        ctx, o->path, o->entry || o->header_only ? PRT_FILE_CHECK_HEADERS : PRT_FILE_CHECK_ALL,
        &o->file);
    o->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

// The worst of a term's lights in the bake's own measurement.
static float json_error(const char *errors, const char *term)
{
    cJSON *json = errors ? cJSON_Parse(errors) : NULL;
    const cJSON *worst =
        cJSON_GetObjectItemCaseSensitive(cJSON_GetObjectItemCaseSensitive(json, term), "worst");
    float x = cJSON_IsNumber(worst) ? (float)worst->valuedouble : 0;
    cJSON_Delete(json);
    return x;
}

static void learn_mesh(struct model *m, const struct prt_file *file)
{
    const struct prt_mesh *mesh = &prt_file_transport(file)->mesh;
    struct model_facts *f = &m->facts;
    if (f->known) return;
    *f = (struct model_facts){.known = true,
                              .n_vertex = mesh->n_vertex,
                              .n_triangle = mesh->n_triangle,
                              .n_object = mesh->n_object,
                              .mm_per_unit = mesh->mm_per_unit};
    prt_mesh_bounds(mesh, f->file_box);
    memcpy(f->box, f->file_box, sizeof f->box);
}

static void learn_facts(struct model *m, const struct prt_file *file)
{
    const struct prt_transport *t = prt_file_transport(file);
    struct model_facts *f = &m->facts;
    float box[2][3];
    memcpy(box, f->box, sizeof box);
    *f = (struct model_facts){.known = true,
                              .baked = true,
                              .n_vertex = t->mesh.n_vertex,
                              .n_triangle = t->mesh.n_triangle,
                              .n_object = t->mesh.n_object,
                              .mm_per_unit = t->mesh.mm_per_unit,
                              .engine = t->engine,
                              .storage = t->n_tensor ? t->tensor[0].storage : 0,
                              .cube = t->cube,
                              .bytes = prt_file_bytes(file),
                              .error_multiple = json_error(t->errors, "multiple"),
                              .error_single = json_error(t->errors, "single"),
                              .error_total = json_error(t->errors, "total")};
    prt_mesh_bounds(&t->mesh, f->file_box);
    memcpy(f->box, m->pose ? box : f->file_box, sizeof f->box);
}

static void damaged(struct model *m, const char *error)
{
    m->state = RELIGHT__MODEL_STATE__MODEL_FAILED;
    m->error_code = RELIGHT__ERROR_CODE__ERROR_FORMAT;
    snprintf(m->error, sizeof m->error, "%s", error);
    log_line(LOG_ERR, "model id=%s damaged error=\"%s\"", m->id, m->error);
    struct stat st;
    if (m->foreign || stat(m->prt, &st)) return;
    blobs_charge(m->server->blobs, -(int64_t)st.st_size);
    unlink(m->prt); // the next load bakes it anew
}

static void start_opening(struct model *m, struct cache_entry *entry, const char *path,
                          bool preview, bool header_only);

// Its bytes were looked at, nobody waits for the file.
static void looked(struct opening *o)
{
    struct model *m = o->model;
    if (o->work.status && m->state == RELIGHT__MODEL_STATE__MODEL_READY && !m->gone) {
        damaged(m, o->work.error);
        model_unload(m, false);
    } else if (!o->work.status && !m->facts.baked) {
        learn_facts(m, o->file);
    }
    prt_file_close(o->file);
}

static void not_opened(struct opening *o)
{
    struct model *m = o->model;
    const char *error = o->work.error;
    int code = error_of_status(o->work.status);
    struct stat st;
    if (m->gone) { // and its file with it
    } else if (o->preview) {
        if (m->mesh == MESH_THERE && !stat(o->path, &st))
            blobs_charge(m->server->blobs, -(int64_t)st.st_size);
        m->mesh = MESH_FAILED;
        m->mesh_error_code = code;
        snprintf(m->mesh_error, sizeof m->mesh_error, "%s", error);
        unlink(o->path);
    } else {
        damaged(m, error);
    }
    cache_fail(o->entry, code, error);
}

static void is_open(struct opening *o)
{
    struct model *m = o->model;
    bool first = !o->preview && !m->checked && !m->gone;
    if (first) m->checked = true;
    if (o->preview) learn_mesh(m, o->file);
    else learn_facts(m, o->file);
    log_line(LOG_EVENT, "model id=%s open ms=%.1f bytes=%llu", m->id, (double)o->ms,
             (unsigned long long)prt_file_bytes(o->file));
    if (m->pinned && !m->pin && !o->preview && !o->entry->forgotten) {
        m->pin = o->entry;
        cache_hold(m->pin);
    }
    if (!m->gone) bakes_touch(m);
    o->entry->ms = o->ms;
    o->entry->any_thread = true;
    cache_fill(o->entry, o->file, prt_file_bytes(o->file), close_file);
    if (o->preview && m->state == RELIGHT__MODEL_STATE__MODEL_READY && !m->gone)
        preview_remove(m);
    // Reads every byte once, behind the requests.
    if (first && !m->gone) start_opening(m, NULL, m->prt, false, false);
}

static void done_opening(struct work *work)
{
    struct opening *o = (struct opening *)work;
    if (!o->entry) looked(o);
    else if (work->status) not_opened(o);
    else is_open(o);
    if (o->preview && o->model->gone && model_is_last(o->model)) unlink(o->path);
    cache_release(o->entry);
    model_release(o->model);
    free(o);
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
    snprintf(o->path, sizeof o->path, "%s", path);
    work_submit(m->server->work, &o->work);
}

void model_start_opening(struct model *m, struct cache_entry *entry, const char *path,
                         bool preview)
{
    start_opening(m, entry, path, preview, false);
}

void model_read_header(struct model *m)
{
    if (!m->facts.baked) start_opening(m, NULL, m->prt, false, true);
}

struct cache_entry *model_open(struct model *m, int *code, char error[256])
{
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
            model_start_opening(m, e, m->prt, false);
        }
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
    if (!forget) return freed;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING && m->job)
        jobs_cancel(server->jobs, m->job);
    char path[PATH_MAX];
    struct stat st;
    if (!m->foreign && m->prt[0]) {
        if (!stat(m->prt, &st)) blobs_charge(server->blobs, -(int64_t)st.st_size);
        unlink(m->prt);
    }
    if (!m->foreign) {
        record_path(server, m->id, path);
        unlink(path);
    }
    struct model **at = &server->models->model;
    while (*at && *at != m) at = &(*at)->next;
    if (*at) {
        *at = m->next;
        m->gone = true;
        preview_remove(m);
        model_changed(m);
        model_release(m);
    }
    return freed;
}

void model_hold(struct model *m)
{
    m->users++;
}

void model_release(struct model *m)
{
    if (!m || --m->users) return;
    cache_release(m->pin);
    pose_release(m->pose);
    free(m->warnings);
    free(m);
}

int models_create(struct server *server, struct models **out)
{
    struct models *models = calloc(1, sizeof *models);
    if (!models) return PRT_NOMEM;
    models->server = server;
    server->models = models;
    *out = models;
    sweep(models, "bakes");
    sweep(models, "previews");
    recall_all(models);
    models_scan(models);
    // Pinned models are ready before anybody asks.
    for (struct model *m = models->model; m; m = m->next) {
        int code;
        char error[256];
        if (m->pinned) cache_release(model_open(m, &code, error));
    }
    return PRT_OK;
}

void models_destroy(struct models *models)
{
    if (!models) return;
    for (struct model *m = models->model, *next; m; m = next) {
        next = m->next;
        model_release(m);
    }
    free(models);
}
