// SPDX-License-Identifier: MIT
// LOAD: checks what is asked, has files of --models copied, names the model by its content,
// finds the bake or lays out a folder for one and orders it. Files are touched by the queue of
// file operations alone.
#include "store/model_files.h"

#include "core/log.h"
#include "net/request.h"
#include "prt/bake.h"
#include "prt/bake_limits.h"
#include "prt/medium.h"
#include "relight.pb-c.h"
#include "render/render.h"
#include "render/shared/materials.h"
#include "store/disk.h"
#include "store/eviction.h"
#include "store/import_file.h"

#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_FILES = 64, MAX_OPAQUE = 64, MAX_ARGS = 64 + MAX_OPAQUE };

struct load_file {
    char *name; // relative, as the model refers to it; the model itself is the first
    char hash[65];
    struct import_copy *copy; // of a file of --models, held; NULL: an upload
};

// One LOAD under way: its request waits for copies of files of --models, then for its folder to
// be laid out, then for the model to open.
struct load {
    struct file_task task; // first: laying out
    struct import_request import;
    struct cache_waiter waiter;
    struct blob_waiter blob_waiter; // an upload's check
    size_t n_checked;
    struct load *next;         // of those that wait for the same model
    struct cache_entry *entry; // the opening waited for
    struct server *server;
    struct request *request; // NULL: nobody waits any more
    bool importing;
    char owner[96]; // principal's name
    struct load_file file[MAX_FILES];
    size_t n_file;
    char **sibling; // of a .gltf in --models: names of the files it refers to
    size_t n_sibling;
    char source[65]; // hash that names the source
    char name[128];
    char env[96];                     // bake.env in its canonical form; "" none
    char material[PRT_MATERIAL_TEXT]; // preset's name or canonical JSON; "" none
    bool material_json;
    struct prt_material resolved; // the same, or the default material of a bake
    struct model *model;          // NULL: not known yet
    // Laying out: what is wanted and what came of it.
    bool find_bake;
    char preview_folder[PATH_MAX], bake_folder[PATH_MAX]; // "": not wanted
    uint64_t bake_bytes;                                  // of a bake that is there; 0: none
    int fault;                                            // errno
    const char *fault_name;
};

static void drop_load(struct load *load)
{
    for (size_t i = 0; i < load->n_file; i++) {
        if (load->file[i].copy) import_unuse(load->file[i].copy);
        free(load->file[i].name);
    }
    for (size_t i = 0; i < load->n_sibling; i++) free(load->sibling[i]);
    free(load->sibling);
    cache_release(load->entry);
    model_release(load->model);
    free(load);
}

static void abandon(struct request *request)
{
    struct load *load = request->state;
    load->request = NULL; // freed when its wait ends
    if (!load->importing) return;
    imports_cancel(load->server->imports, &load->import);
    drop_load(load);
}

static const Relight__LoadRequest *message_of(const struct load *load)
{
    return (const Relight__LoadRequest *)load->request->message;
}

// Ends the load with an error.
#define FAIL(load, code, ...)                                                          \
    do {                                                                               \
        request_fail((load)->request, RELIGHT__ERROR_CODE__ERROR_##code, __VA_ARGS__); \
        drop_load(load);                                                               \
    } while (0)

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
    drop_load(load); // and with it the model, perhaps
    free(copy);
}

static void opened(struct cache_waiter *waiter)
{
    struct load *load = (struct load *)((char *)waiter - offsetof(struct load, waiter));
    if (!load->request) {
        drop_load(load);
        return;
    }
    struct model *m = load->model;
    if (load->entry->state == CACHE_FAILED) {
        request_fail(load->request, load->entry->error_code, "%s", load->entry->error);
        // Without a bake there is nothing to know such a model for.
        if (!m->gone && m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW &&
            m->mesh == MESH_FAILED)
            model_unload(m, true);
        drop_load(load);
    } else if (m->gone) {
        FAIL(load, NOT_FOUND, "the model was unloaded meanwhile");
    } else {
        answer(load, m);
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
        drop_load(load);
    } else if (load->entry->state == CACHE_PENDING) {
        load->waiter.wake = opened;
        cache_wait(load->entry, &load->waiter);
    } else {
        answer(load, m);
    }
}

// A baked model is answered once it is open: `ready` is then true.
static void open_and_answer(struct load *load, struct model *m)
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

// ---- the bake's command

struct args {
    char *argv[MAX_ARGS + 1];
    size_t n;
};

static void add_arg(struct args *args, const char *fmt, ...)
    __attribute__((format(printf, 2, 3)));
static void add_arg(struct args *args, const char *fmt, ...)
{
    va_list list;
    va_start(list, fmt);
    if (args->n < MAX_ARGS && vasprintf(&args->argv[args->n], fmt, list) >= 0) args->n++;
    va_end(list);
}

static const char *const transport_word[] = {"", "wavelet", "polynomial", "joint"};
static const char *const storage_word[] = {"", "factored", "sparse"};

// Settings in a fixed order, as options of `prt bake`: the command, and what names the model.
static void add_settings(struct args *a, const Relight__LoadRequest *r)
{
    const Relight__BakeSettings *b = r->bake;
    if (r->size_mm > 0) add_arg(a, "--size-mm=%.9g", (double)r->size_mm);
    if (r->mm_per_unit > 0) add_arg(a, "--mm-per-unit=%.9g", (double)r->mm_per_unit);
    for (size_t i = 0; i < r->n_opaque; i++) add_arg(a, "--opaque=%s", r->opaque[i]);
    if (!b) return;
    if (b->transport) add_arg(a, "--transport=%s", transport_word[b->transport]);
    if (b->storage) add_arg(a, "--storage=%s", storage_word[b->storage]);
    if (b->samples) add_arg(a, "--samples=%u", b->samples);
    if (b->cube) add_arg(a, "--cube=%u", b->cube);
    if (b->coeffs) add_arg(a, "--coeffs=%u", b->coeffs);
    if (b->rank) add_arg(a, "--rank=%u", b->rank);
    if (b->phase_terms) add_arg(a, "--phase-terms=%u", b->phase_terms);
    if (b->single_points) add_arg(a, "--single-points=%u", b->single_points);
    if (b->no_single) add_arg(a, "--no-single");
    if (b->max_error > 0) add_arg(a, "--max-error=%.9g", (double)b->max_error);
    if (b->seed) add_arg(a, "--seed=%llu", (unsigned long long)b->seed);
    if (b->env[0]) add_arg(a, "--rotate=%.9g", (double)b->rotate_deg);
}

static void name_model(const struct load *load, char id[MODEL_ID + 1])
{
    struct relight_sha256 sha;
    struct args a = {0};
    char hex[65], versions[64];
    add_settings(&a, message_of(load));
    snprintf(versions, sizeof versions, "bake %d, file %d", PRT_BAKE_VERSION, PRT_FILE_VERSION);
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, versions, strlen(versions) + 1);
    relight_sha256_add(&sha, load->source, strlen(load->source) + 1);
    relight_sha256_add(&sha, load->material, strlen(load->material) + 1);
    for (size_t i = 0; i < a.n; i++) {
        relight_sha256_add(&sha, a.argv[i], strlen(a.argv[i]) + 1);
        free(a.argv[i]);
    }
    relight_sha256_add(&sha, load->env, strlen(load->env) + 1);
    relight_sha256_hex(&sha, hex);
    snprintf(id, MODEL_ID + 1, "%.*s", MODEL_ID, hex);
}

// ---- the folders: inputs under the names the model refers to (on a worker)

static void file_source(const struct load *load, const char *hash, bool copy,
                        char path[PATH_MAX])
{
    if (copy) import_path(load->server->imports, hash, path, PATH_MAX);
    else blobs_path(load->server->blobs, hash, path, PATH_MAX);
}

static int link_file(const char *from, const char *folder, const char *name)
{
    char to[PATH_MAX];
    if (snprintf(to, sizeof to, "%s/%s", folder, name) >= PATH_MAX) return ENAMETOOLONG;
    for (char *slash = to + strlen(folder) + 1; (slash = strchr(slash, '/')); *slash++ = '/') {
        *slash = 0;
        if (mkdir(to, 0700) && errno != EEXIST) return errno;
    }
    return link(from, to) ? errno : 0;
}

static int link_files(struct load *load, const char *folder)
{
    char from[PATH_MAX];
    remove_tree(folder);
    load->fault_name = load->file[0].name;
    int err = mkdir(folder, 0700) ? errno : 0;
    for (size_t i = 0; !err && i < load->n_file; i++) {
        const struct load_file *f = &load->file[i];
        load->fault_name = f->name;
        file_source(load, f->hash, f->copy != NULL, from);
        err = link_file(from, folder, f->name);
    }
    return err;
}

static int lay_out_bake(struct load *load)
{
    char path[PATH_MAX + 16], from[PATH_MAX];
    int err = link_files(load, load->bake_folder);
    if (!err && !strncmp(load->env, "env:", 4)) {
        load->fault_name = "bake.env";
        file_source(load, load->env + 4, false, from);
        err = link_file(from, load->bake_folder, ".environment");
    }
    if (err || !load->material_json) return err;
    load->fault_name = "material";
    snprintf(path, sizeof path, "%s/.material.json", load->bake_folder);
    return prt_write_file(NULL, path, load->material, strlen(load->material)) ? errno : 0;
}

static int run_lay_out(struct file_task *task)
{
    struct load *load = (struct load *)task;
    char bake[PATH_MAX];
    struct stat st;
    model_bake_path(load->server, load->model->id, bake);
    if (load->find_bake && !stat(bake, &st)) {
        load->bake_bytes = (uint64_t)st.st_size;
        return PRT_OK;
    }
    if (load->preview_folder[0]) load->fault = link_files(load, load->preview_folder);
    if (!load->fault && load->bake_folder[0]) load->fault = lay_out_bake(load);
    if (load->fault && load->preview_folder[0]) remove_tree(load->preview_folder);
    if (load->fault && load->bake_folder[0]) remove_tree(load->bake_folder);
    return PRT_OK;
}

static void fail_lay_out(struct load *load)
{
    int code = RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    const char *text = strerror(load->fault);
    switch (load->fault) {
    case ENOENT:
        code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        text = "its upload is not there any more: upload it again";
        break;
    case EEXIST:
    case ENOTDIR:
    case EISDIR:
    case ENAMETOOLONG:
        code = RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
        text = "the name cannot stand beside those of the other files";
        break;
    case ENOSPC:
    case EDQUOT:
    case EMLINK:
        code = RELIGHT__ERROR_CODE__ERROR_LIMIT;
    }
    log_line(LOG_WARN, "model id=%s cannot be laid out file=\"%s\" error=\"%s\"",
             load->model->id, load->fault_name, strerror(load->fault));
    request_fail(load->request, code, "%.100s: %s", load->fault_name, text);
    drop_load(load);
}

// ---- the bake's command

struct baking {
    struct model *model;
    char folder[PATH_MAX], owner[96];
};

// Has the model's file read, so that image-space engines can answer.
static void order_preview(const struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = message_of(load);
    char path[2 * PATH_MAX];
    if (!load->preview_folder[0]) return;
    snprintf(path, sizeof path, "%s/%s", load->preview_folder, load->file[0].name);
    struct decode_model order = {.path = path,
                                 .name = load->name,
                                 .size_mm = r->size_mm,
                                 .mm_per_unit = r->mm_per_unit,
                                 .material = &load->resolved,
                                 .n_opaque = r->n_opaque,
                                 .opaque = r->opaque};
    preview_start(m, &order, load->preview_folder);
}

static void charge_job(struct server *server, const char *owner)
{
    struct principal *p = ledger_principal(server->ledger, owner);
    if (!p) return;
    if (p->held[LEDGER_JOBS]) ledger_give(p, LEDGER_JOBS, 1);
    principal_release(p);
}

static void bake_ended(void *user, struct job *job, enum job_outcome outcome)
{
    struct baking *b = user;
    struct model *m = b->model;
    struct server *server = m->server;
    char path[PATH_MAX];
    model_bake_path(server, m->id, path);
    charge_job(server, b->owner);
    file_remove(server->file_queue, b->folder);
    m->job = NULL;
    if (job_warnings(job)[0]) {
        free(m->warnings);
        m->warnings = strdup(job_warnings(job));
    }
    if (m->gone) {
        if (model_is_last(m)) file_remove(server->file_queue, path);
    } else if (outcome == JOB_OUT_DONE) {
        int code;
        char error[256];
        m->state = RELIGHT__MODEL_STATE__MODEL_READY;
        model_remember(m);
        // Opened at once: watchers request colours next, and opening determines the file's
        // size.
        cache_release(model_open(m, &code, error));
        preview_remove(m);
    } else {
        m->state = RELIGHT__MODEL_STATE__MODEL_FAILED;
        m->error_code = outcome == JOB_OUT_CANCELLED ? RELIGHT__ERROR_CODE__ERROR_CANCELLED
                                                     : RELIGHT__ERROR_CODE__ERROR_JOB_FAILED;
        snprintf(m->error, sizeof m->error, "%s",
                 job_error(job)[0] ? job_error(job) : "the bake wrote no file");
    }
    if (!m->gone) model_changed(m);
    model_release(m);
    free(b);
}

static void bake_command(const struct load *load, const struct model *m, struct args *a)
{
    const struct options *o = &load->server->options;
    char out[PATH_MAX];
    model_bake_path(load->server, m->id, out);
    add_arg(a, "bake");
    add_arg(a, "./%s", load->file[0].name);
    add_arg(a, "-o");
    add_arg(a, "%s", out);
    add_arg(a, "--progress-fd");
    add_arg(a, "{progress}");
    add_arg(a, "--quiet");
    add_arg(a, "--memory=%llu", (unsigned long long)o->bake_memory);
    if (o->bake_threads) add_arg(a, "--threads=%u", o->bake_threads);
    if (load->material_json) add_arg(a, "--material=.material.json");
    else if (load->material[0]) add_arg(a, "--material=%s", load->material);
    add_settings(a, message_of(load));
    if (!strncmp(load->env, "env:", 4)) add_arg(a, "--env=.environment");
    else if (load->env[0]) add_arg(a, "--env=%s", load->env);
}

// False, with the limit that is in the way.
static bool order_bake(struct load *load, struct model *m, char error[256])
{
    struct server *server = load->server;
    struct baking *b = calloc(1, sizeof *b);
    struct args a = {0};
    snprintf(error, 256, "not enough memory");
    if (!b) return false;
    if (ledger_take(load->request->conn->principal, LEDGER_JOBS, 1, error)) {
        free(b);
        return false;
    }
    b->model = m;
    snprintf(b->folder, sizeof b->folder, "%s", load->bake_folder);
    snprintf(b->owner, sizeof b->owner, "%s", load->owner);
    bake_command(load, m, &a);
    struct job_order order = {calloc(a.n + 1, sizeof(char *)), strdup(b->folder)};
    if (order.argv) memcpy(order.argv, a.argv, a.n * sizeof(char *));
    m->state = RELIGHT__MODEL_STATE__MODEL_BAKING;
    m->error[0] = m->job_id[0] = 0;
    m->checked = false;
    m->job = NULL;
    model_hold(m);
    struct job *job = jobs_add(server->jobs, m->id, &order, bake_ended, b);
    if (!job) {
        snprintf(error, 256, "%u bakes wait already (--bake-queue)", jobs_open(server->jobs));
        charge_job(server, b->owner);
        free(b);
        model_release(m);
        return false;
    }
    snprintf(m->job_id, sizeof m->job_id, "%s", job_id(job));
    // One that could not be started has ended already.
    if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING) m->job = job;
    return true;
}

// ---- from a source's hash to an answer

static void source_known(struct load *load);

// A model of which nothing is there, and for which nobody waits.
static bool is_bare(const struct model *m)
{
    return !m->gone && !m->preparing && !m->loads && m->mesh == MESH_NONE &&
           m->state == RELIGHT__MODEL_STATE__MODEL_RECEIVED;
}

static void go_on(struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = message_of(load);
    int before = m->state;
    char error[256];
    if (load->bake_bytes) {
        m->state = RELIGHT__MODEL_STATE__MODEL_READY;
        model_charge_bake(m, load->bake_bytes);
        load->server->stats.bakes_cached++;
        model_remember(m);
        open_and_answer(load, m);
        return;
    }
    order_preview(load, m);
    if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING) {
        answer(load, m);
    } else if (r->preview) {
        m->state = RELIGHT__MODEL_STATE__MODEL_PREVIEW;
        m->error[0] = 0;
        mesh_and_answer(load, m);
    } else if (order_bake(load, m, error)) {
        answer(load, m);
    } else {
        file_remove(load->server->file_queue, load->bake_folder);
        m->state = before;
        if (before == RELIGHT__MODEL_STATE__MODEL_RECEIVED) model_unload(m, true);
        FAIL(load, BUSY, "%s", error);
    }
}

static void laid_out(struct file_task *task)
{
    struct load *load = (struct load *)task;
    struct model *m = load->model;
    struct file_queue *queue = load->server->file_queue;
    load->model = NULL; // the reference is this function's
    m->preparing = false;
    if (!load->request || m->gone) {
        file_remove(queue, load->preview_folder);
        file_remove(queue, load->bake_folder);
        if (load->request) FAIL(load, NOT_FOUND, "the model was unloaded meanwhile");
        else drop_load(load);
    } else if (load->fault) {
        model_hold(load->model = m);
        fail_lay_out(load);
    } else {
        go_on(load, m);
    }
    while (m->loads && !m->preparing) {
        struct load *next = m->loads;
        m->loads = next->next;
        if (next->request) source_known(next);
        else drop_load(next);
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
    if (!baking && !message_of(load)->preview)
        snprintf(load->bake_folder, PATH_MAX, "%s/work/%s", data, m->key);
    for (size_t i = 0; i < load->n_file; i++)
        if (!load->file[i].copy) blobs_touch(load->server->blobs, load->file[i].hash);
    if (!strncmp(load->env, "env:", 4)) blobs_touch(load->server->blobs, load->env + 4);
    m->preparing = true;
    load->task.run = run_lay_out;
    load->task.done = laid_out;
    file_queue_add(load->server->file_queue, &load->task);
}

static struct model *add_model(struct load *load, const char *id, char error[256])
{
    struct principal *p = load->request->conn->principal;
    enum ledger_refusal refusal = ledger_take(p, LEDGER_MODELS, 1, error);
    // An old preview makes room for a new one.
    if (refusal && evict_preview(load->server, refusal == LEDGER_CLIENT_FULL ? p->name : NULL))
        refusal = ledger_take(p, LEDGER_MODELS, 1, error);
    if (refusal) return NULL;
    snprintf(error, 256, "not enough memory");
    struct model *m = model_add(load->server->models, id, load->name, load->owner);
    ledger_give(p, LEDGER_MODELS, 1); // model_add has charged it
    return m;
}

static void source_known(struct load *load)
{
    const Relight__LoadRequest *r = message_of(load);
    char id[MODEL_ID + 1], error[256];
    name_model(load, id);
    struct model *m = model_by_id(load->server->models, id);
    bool fresh = !m;
    if (fresh && !(m = add_model(load, id, error))) {
        FAIL(load, LIMIT, "%s", error);
        return;
    }
    const char *before = model_name_for(m, load->owner);
    bool own = !strcmp(m->owner, load->owner);
    bool other = strcmp(before, load->name) && (r->name[0] || !own);
    bool changed = other || (r->pin && !m->pinned);
    if (other) model_set_name(m, load->owner, load->name);
    if (r->pin) m->pinned = true;
    m->used_ns = wall_ns();
    if (changed && m->state == RELIGHT__MODEL_STATE__MODEL_READY) model_remember(m);
    log_line(LOG_EVENT, "load model=%s name=\"%s\" conn=%llu %s", m->id, load->name,
             (unsigned long long)load->request->conn->number, fresh ? "new" : "known");
    bool complete = m->mesh == MESH_THERE || m->mesh == MESH_READING;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        open_and_answer(load, m);
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

// ---- files of --models

static bool safe_name(const char *name);
static const char *file_part(const char *path);

static void hash_source(struct load *load)
{
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    for (size_t i = 0; i < load->n_file; i++) {
        // The first file's name matters for its ending only, the others are referred to by
        // theirs.
        const struct load_file *f = &load->file[i];
        const char *dot = strrchr(f->name, '.');
        const char *name = i ? f->name : dot ? dot : "";
        relight_sha256_add(&sha, name, strlen(name) + 1);
        relight_sha256_add(&sha, f->hash, BLOB_HASH);
    }
    relight_sha256_hex(&sha, load->source);
}

static bool add_file(struct load *load, const char *name, const char *hash,
                     struct import_copy *copy)
{
    struct load_file *f = &load->file[load->n_file];
    if (load->n_file == MAX_FILES || !(f->name = strdup(name))) return false;
    snprintf(f->hash, sizeof f->hash, "%s", hash);
    if ((f->copy = copy)) import_use(copy);
    load->n_file++;
    return true;
}

static bool keep_siblings(struct load *load, char *const *name, size_t n)
{
    load->sibling = calloc(n + 1, sizeof *load->sibling);
    for (size_t i = 0; load->sibling && i < n; i++) {
        if (!safe_name(name[i])) continue; // the reader refuses it, with its reason
        if (!(load->sibling[load->n_sibling] = strdup(name[i]))) return false;
        load->n_sibling++;
    }
    return load->sibling != NULL;
}

// A .prt is a model by itself.
static void load_prt(struct load *load, struct import_copy *copy)
{
    const Relight__LoadRequest *r = message_of(load);
    struct model *m = models_found(load->server->models, copy, load->name);
    if (!m) {
        FAIL(load, NO_MEMORY, "not enough memory");
        return;
    }
    m->pinned |= r->pin;
    if (r->name[0]) model_set_name(m, load->owner, r->name);
    open_and_answer(load, m);
}

static bool check_material(struct load *load);
static void import_next(struct load *load);

static void imported(struct import_request *request, struct import_copy *copy,
                     char *const *names, size_t n_name, int code, const char *error)
{
    struct load *load = (struct load *)((char *)request - offsetof(struct load, import));
    const char *path = message_of(load)->path, *base = file_part(path);
    char plain[16];
    bool first = !load->n_file;
    load->importing = false;
    if (!copy) {
        request_fail(load->request, code, "%s", error);
        drop_load(load);
        return;
    }
    if (first && copy->prt) {
        load_prt(load, copy);
        return;
    }
    if (first && !check_material(load)) {
        drop_load(load); // the request is answered
        return;
    }
    if (first && !safe_name(base)) {
        const char *dot = strrchr(base, '.');
        snprintf(plain, sizeof plain, "model%.8s", dot ? dot : "");
        base = plain;
    }
    if (!add_file(load, first ? base : load->sibling[load->n_file - 1], copy->hash, copy) ||
        (first && !keep_siblings(load, names, n_name))) {
        FAIL(load, NO_MEMORY, "not enough memory");
        return;
    }
    import_next(load);
}

static void import_next(struct load *load)
{
    const char *path = message_of(load)->path;
    char beside[PATH_MAX];
    if (load->n_file > load->n_sibling) {
        hash_source(load);
        source_known(load);
        return;
    }
    load->importing = true;
    load->import.done = imported;
    const char *wanted = path;
    if (load->n_file) {
        int folder = (int)(file_part(path) - path);
        snprintf(beside, sizeof beside, "%.*s%s", folder, path,
                 load->sibling[load->n_file - 1]);
        wanted = beside;
    }
    imports_get(load->server->imports, wanted, load->owner, &load->import);
}

// ---- checking the request

static bool safe_name(const char *name)
{
    if (!name[0] || name[0] == '/' || name[0] == '.' || strlen(name) > 200) return false;
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < 32 || *p == 127 || *p == '\\' ||
            (p[0] == '/' && (p[1] == '.' || p[1] == '/')))
            return false;
    return true;
}

static bool bad_real(float x, float low, float high)
{
    return !(x >= low && x <= high); // catches NaN
}

// NULL when the numbers make sense, else which one does not.
static const char *bad_setting(const Relight__LoadRequest *r, char reason[128])
{
    const Relight__BakeSettings *b = r->bake;
    if (r->size_mm != 0 && bad_real(r->size_mm, 1e-3f, 1e6f))
        return "size_mm is outside [0.001, 1e6] mm";
    if (r->mm_per_unit != 0 && bad_real(r->mm_per_unit, 1e-9f, 1e9f))
        return "mm_per_unit is outside [1e-9, 1e9] mm";
    if (r->size_mm != 0 && r->mm_per_unit != 0)
        return "size_mm and mm_per_unit are both given: one scale is wanted";
    if (r->n_opaque > MAX_OPAQUE) return "more than 64 opaque names";
    if (!b) return NULL;
    if (!protobuf_c_enum_descriptor_get_value(&relight__transport__descriptor,
                                              (int)b->transport))
        return "transport is unknown";
    if (!protobuf_c_enum_descriptor_get_value(&relight__storage__descriptor, (int)b->storage))
        return "storage is unknown";
    // The library's bounds and its words.
    if (!prt_bake_setting_ok(PRT_BAKE_CUBE, b->cube, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_PHASE_TERMS, b->phase_terms, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_SAMPLES, b->samples, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_RANK, b->rank, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_COEFFS, b->coeffs, reason) ||
        !prt_bake_setting_ok(PRT_BAKE_SINGLE_POINTS, b->single_points, reason) ||
        !prt_bake_error_ok((double)b->max_error, reason))
        return reason;
    if (bad_real(b->rotate_deg, -1e6f, 1e6f))
        return "rotate_deg is outside [-1e6, 1e6] degrees";
    return NULL;
}

// The settings' checks that need more than numbers; answers and returns false when one fails.
static bool check_material(struct load *load)
{
    const Relight__LoadRequest *r = message_of(load);
    struct prt_material material;
    char error[300];
    bool preset;
    load->resolved = *prt_material_preset(0); // as prt bake
    if (!r->material[0]) {
        // As prt bake: where no transport is named either, a bake that leaves the material
        // open.
        bool fixed = r->bake && r->bake->transport == RELIGHT__TRANSPORT__TRANSPORT_WAVELET;
        if (fixed)
            request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "material is missing: a preset's name or JSON text");
        return !fixed;
    }
    int status = material_of_request(load->request, r->material, &material, &preset, error);
    if (status) {
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, "%s", error);
        return false;
    }
    load->material_json = !preset;
    load->resolved = material;
    if (preset) snprintf(load->material, sizeof load->material, "%s", material.name);
    else prt_material_print(&material, load->material, sizeof load->material);
    return true;
}

// True when one name equals the other or is a folder above it: one folder cannot hold both.
static bool names_clash(const char *a, const char *b)
{
    size_t n = strlen(a), m = strlen(b), least = n < m ? n : m;
    return !strncmp(a, b, least) && (n == m || (n < m ? b : a)[least] == '/');
}

static bool check_file(struct load *load, size_t index)
{
    const Relight__FileRef *f = message_of(load)->files[index];
    if (!safe_name(f->name)) {
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "files[%zu]: the name is not a plain relative path", index);
        return false;
    }
    if (!blobs_has(load->server->blobs, f->blob)) {
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "%.100s: its blob was not uploaded", f->name);
        return false;
    }
    for (size_t i = 0; i < load->n_file; i++) {
        const struct load_file *other = &load->file[i];
        if (!strcmp(other->name, f->name) && !strcmp(other->hash, f->blob)) return true;
        if (!names_clash(other->name, f->name)) continue;
        request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "files[%zu]: %.100s cannot be beside %.100s: one name for two things",
                     index, f->name, other->name);
        return false;
    }
    if (add_file(load, f->name, f->blob, NULL)) return true;
    request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    return false;
}

static bool check_files(struct load *load)
{
    for (size_t i = 0; i < message_of(load)->n_files; i++)
        if (!check_file(load, i)) return false;
    hash_source(load);
    return true;
}

// Only an upload or words: any other text would be a path to the baker.
static bool check_env(struct load *load)
{
    const Relight__LoadRequest *r = message_of(load);
    char error[300];
    if (!r->bake || !r->bake->env[0]) return true;
    int code = env_canonical(r->bake->env, load->env, error);
    if (!code && !strncmp(load->env, "env:", 4) &&
        !blobs_has(load->server->blobs, load->env + 4)) {
        code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        request_fail(load->request, code, "bake.env: %.80s was not uploaded", r->bake->env);
    } else if (code) {
        request_fail(load->request, code,
                     "bake.env %.60s: neither env:HASH nor constant[:R,G,B] with radiances in "
                     "[0, 1e6]",
                     r->bake->env);
    }
    return !code;
}

// The uploads a load needs: its files, then its environment. NULL past the last.
static const char *needed_blob(const struct load *load, size_t index)
{
    size_t n = message_of(load)->n_files ? load->n_file : 0;
    bool light = !strncmp(load->env, "env:", 4);
    if (index < n) return load->file[index].hash;
    return index == n && light ? load->env + 4 : NULL;
}

// Has every upload checked, one after another, before any of them is used.
static void check_next(struct load *load);

static void blob_checked(struct blob_waiter *waiter)
{
    struct load *load = (struct load *)((char *)waiter - offsetof(struct load, blob_waiter));
    if (load->request) check_next(load);
    else drop_load(load);
}

static void check_next(struct load *load)
{
    size_t i = load->n_checked++;
    const char *before = i ? needed_blob(load, i - 1) : NULL, *hash = needed_blob(load, i);
    if (before && !blobs_has(load->server->blobs, before)) {
        FAIL(load, NOT_FOUND, "%.12s… was damaged on the daemon's disk: upload it again",
             before);
    } else if (hash) {
        load->blob_waiter.wake = blob_checked;
        blobs_check(load->server->blobs, hash, &load->blob_waiter);
    } else if (message_of(load)->n_files) {
        source_known(load);
    } else {
        import_next(load);
    }
}

static const char *file_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
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
        FAIL(load, BAD_REQUEST, "either files or path names the model, not both");
        return;
    }
    if (r->n_files > MAX_FILES) {
        FAIL(load, LIMIT, "more than %d files", MAX_FILES);
        return;
    }
    char reason[128];
    const char *bad = bad_setting(r, reason);
    if (bad) {
        FAIL(load, OUT_OF_RANGE, "%s", bad);
        return;
    }
    name_printable(r->name[0] ? r->name : file_part(r->n_files ? r->files[0]->name : r->path),
                   load->name, sizeof load->name);
    if (!check_env(load) || (r->n_files && (!check_material(load) || !check_files(load)))) {
        drop_load(load); // the request is answered
        return;
    }
    check_next(load);
}
