// SPDX-License-Identifier: MIT
// LOAD: checks what is asked, names it by its content, finds the bake or orders one.
#include "store/model_files.h"

#include "store/bake_eviction.h"
#include "core/log.h"
#include "render/shared/materials.h"
#include "prt/bake_limits.h"
#include "prt/medium.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <dirent.h>
#include <errno.h>
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_FILES = 64, MAX_OPAQUE = 64, MAX_ARGS = 64 + MAX_OPAQUE };

// One LOAD under way: its request waits for a hash, then for the model to open.
struct load {
    struct work work; // hashing a file of --models
    struct cache_waiter waiter;
    struct cache_entry *entry;      // the opening waited for
    struct blob_waiter blob_waiter; // an upload's check
    size_t n_checked;
    struct server *server;
    struct request *request; // NULL: nobody waits any more
    char path[PATH_MAX];     // the model in --models, absolute; "" for uploaded files
    char source[65];         // hash that names the source
    char name[128];
    char material[PRT_MATERIAL_TEXT]; // preset's name or canonical JSON; "" none
    bool material_json;
    struct prt_material resolved; // the same, or what a bake without one takes
    struct model *model;          // NULL: not known yet
};

static void drop_load(struct load *load)
{
    cache_release(load->entry);
    model_release(load->model);
    free(load);
}

static void abandon(struct request *request)
{
    struct load *load = request->state;
    load->request = NULL; // freed when what it waits for comes
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
    char hex[65];
    const Relight__LoadRequest *r = message_of(load);
    add_settings(&a, r);
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, load->source, strlen(load->source) + 1);
    relight_sha256_add(&sha, load->material, strlen(load->material) + 1);
    for (size_t i = 0; i < a.n; i++) {
        relight_sha256_add(&sha, a.argv[i], strlen(a.argv[i]) + 1);
        free(a.argv[i]);
    }
    if (r->bake) relight_sha256_add(&sha, r->bake->env, strlen(r->bake->env) + 1);
    relight_sha256_hex(&sha, hex);
    snprintf(id, MODEL_ID + 1, "%.*s", MODEL_ID, hex);
}

// ---- the bake's folder: its inputs under the names the model refers to

struct baking {
    struct model *model;
    char folder[PATH_MAX];
};

void remove_tree(const char *folder)
{
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        char path[PATH_MAX];
        if (!strcmp(d->d_name, ".") || !strcmp(d->d_name, "..")) continue;
        if (snprintf(path, sizeof path, "%s/%s", folder, d->d_name) >= PATH_MAX) continue;
        if (unlink(path) && errno == EISDIR) remove_tree(path);
    }
    if (dir) closedir(dir);
    rmdir(folder);
}

static bool stage_blob(const struct server *server, const char *folder, const char *name,
                       const char *hash)
{
    char from[PATH_MAX], to[PATH_MAX];
    blobs_path(server->blobs, hash, from, sizeof from);
    blobs_touch(server->blobs, hash);
    if (snprintf(to, sizeof to, "%s/%s", folder, name) >= PATH_MAX) return false;
    for (char *slash = to + strlen(folder) + 1; (slash = strchr(slash, '/')); *slash++ = '/') {
        *slash = 0;
        if (mkdir(to, 0700) && errno != EEXIST) return false;
    }
    return !link(from, to) || errno == EEXIST;
}

static bool stage_files(const struct load *load, const char *folder)
{
    const Relight__LoadRequest *r = message_of(load);
    remove_tree(folder);
    if (mkdir(folder, 0700)) return false;
    for (size_t i = 0; i < r->n_files; i++)
        if (!stage_blob(load->server, folder, r->files[i]->name, r->files[i]->blob))
            return false;
    return true;
}

static bool stage(const struct load *load, struct baking *b)
{
    const Relight__LoadRequest *r = message_of(load);
    snprintf(b->folder, sizeof b->folder, "%s/work/%s", load->server->data, b->model->key);
    if (!stage_files(load, b->folder)) return false;
    if (r->bake && !strncmp(r->bake->env, "env:", 4) &&
        !stage_blob(load->server, b->folder, ".environment", r->bake->env + 4))
        return false;
    if (!load->material_json) return true;
    char path[PATH_MAX + 16];
    snprintf(path, sizeof path, "%s/.material.json", b->folder);
    return !prt_write_file(NULL, path, load->material, strlen(load->material));
}

// Has the model's file read, so that image-space engines can answer.
static void order_preview(const struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = message_of(load);
    char folder[PATH_MAX] = "", path[2 * PATH_MAX];
    if (load->path[0]) {
        snprintf(path, sizeof path, "%s", load->path);
    } else {
        snprintf(folder, sizeof folder, "%s/work/%s.preview", load->server->data, m->key);
        snprintf(path, sizeof path, "%s/%s", folder, r->files[0]->name);
        if (m->mesh != MESH_THERE && m->mesh != MESH_READING && !stage_files(load, folder)) {
            log_line(LOG_WARN, "model id=%s cannot be laid out in %s: %s", m->id, folder,
                     strerror(errno));
            return;
        }
    }
    struct decode_model order = {.path = path,
                                 .name = load->name,
                                 .size_mm = r->size_mm,
                                 .mm_per_unit = r->mm_per_unit,
                                 .material = &load->resolved,
                                 .n_opaque = r->n_opaque,
                                 .opaque = r->opaque};
    bool reading = m->mesh == MESH_THERE || m->mesh == MESH_READING;
    if (!reading) preview_start(m, &order, folder);
}

static void bake_ended(void *user, struct job *job, enum job_outcome outcome)
{
    struct baking *b = user;
    struct model *m = b->model;
    struct server *server = m->server;
    char path[PATH_MAX];
    struct stat st;
    model_bake_path(server, m->id, path);
    remove_tree(b->folder);
    m->job = NULL;
    if (outcome == JOB_OUT_DONE && stat(path, &st)) outcome = JOB_OUT_FAILED;
    if (job_warnings(job)[0]) {
        free(m->warnings);
        m->warnings = strdup(job_warnings(job));
    }
    if (m->gone) {
        if (model_is_last(m)) unlink(path);
    } else if (outcome == JOB_OUT_DONE) {
        int code;
        char error[256];
        m->state = RELIGHT__MODEL_STATE__MODEL_READY;
        snprintf(m->prt, sizeof m->prt, "%s", path);
        blobs_charge(server->blobs, st.st_size);
        model_remember(m);
        bakes_make_room(server, m);
        cache_release(model_open(m, &code, error)); // who watched asks for colours next
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

static bool order_bake(struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = message_of(load);
    struct baking *b = calloc(1, sizeof *b);
    struct args a = {0};
    if (!b) return false;
    b->model = m;
    if (!stage(load, b)) {
        log_line(LOG_ERR, "model id=%s inputs cannot be laid out in %s: %s", m->id, b->folder,
                 strerror(errno));
        remove_tree(b->folder);
        free(b);
        return false;
    }
    char out[PATH_MAX];
    model_bake_path(load->server, m->id, out);
    add_arg(&a, "bake");
    if (load->path[0]) add_arg(&a, "%s", load->path);
    else add_arg(&a, "./%s", r->files[0]->name);
    add_arg(&a, "-o");
    add_arg(&a, "%s", out);
    add_arg(&a, "--progress-fd");
    add_arg(&a, "{progress}");
    add_arg(&a, "--quiet");
    add_arg(&a, "--memory=%llu", (unsigned long long)load->server->options.bake_memory);
    if (load->server->options.bake_threads)
        add_arg(&a, "--threads=%u", load->server->options.bake_threads);
    if (load->material_json) add_arg(&a, "--material=.material.json");
    else if (load->material[0]) add_arg(&a, "--material=%s", load->material);
    add_settings(&a, r);
    if (r->bake && !strncmp(r->bake->env, "env:", 4)) add_arg(&a, "--env=.environment");
    else if (r->bake && r->bake->env[0]) add_arg(&a, "--env=%s", r->bake->env);
    struct job_order order = {calloc(a.n + 1, sizeof(char *)), strdup(b->folder)};
    if (order.argv) memcpy(order.argv, a.argv, a.n * sizeof(char *));
    m->state = RELIGHT__MODEL_STATE__MODEL_BAKING;
    m->error[0] = m->job_id[0] = 0;
    m->checked = false;
    m->job = NULL;
    model_hold(m);
    struct job *job = jobs_add(load->server->jobs, m->id, &order, bake_ended, b);
    if (!job) {
        remove_tree(b->folder);
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

static void source_known(struct load *load)
{
    struct server *server = load->server;
    const Relight__LoadRequest *r = message_of(load);
    char id[MODEL_ID + 1], bake[PATH_MAX];
    name_model(load, id);
    struct model *m = model_by_id(server->models, id);
    bool fresh = !m;
    if (fresh && !(m = model_add(server->models, id, load->name))) {
        FAIL(load, NO_MEMORY, "not enough memory");
        return;
    }
    bool known_better = (r->name[0] && strcmp(m->name, r->name)) || (r->pin && !m->pinned);
    if (r->name[0]) snprintf(m->name, sizeof m->name, "%s", r->name);
    if (r->pin) m->pinned = true;
    if (known_better && m->state == RELIGHT__MODEL_STATE__MODEL_READY) model_remember(m);
    log_line(LOG_EVENT, "load model=%s name=\"%s\" conn=%llu %s", m->id, m->name,
             (unsigned long long)load->request->conn->number, fresh ? "new" : "known");
    model_bake_path(server, id, bake);
    if (m->state != RELIGHT__MODEL_STATE__MODEL_READY &&
        m->state != RELIGHT__MODEL_STATE__MODEL_BAKING && !access(bake, R_OK)) {
        m->state = RELIGHT__MODEL_STATE__MODEL_READY;
        snprintf(m->prt, sizeof m->prt, "%s", bake);
        server->stats.bakes_cached++;
        model_remember(m);
    }
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY) {
        open_and_answer(load, m);
        return;
    }
    bool baking = m->state == RELIGHT__MODEL_STATE__MODEL_BAKING;
    order_preview(load, m);
    if (!baking && r->preview) {
        m->state = RELIGHT__MODEL_STATE__MODEL_PREVIEW;
        m->error[0] = 0;
        mesh_and_answer(load, m);
        return;
    }
    if (!baking && !order_bake(load, m)) {
        if (fresh) model_unload(m, true);
        else m->state = RELIGHT__MODEL_STATE__MODEL_FAILED;
        FAIL(load, BUSY, "too many bakes wait already, or their folder is full");
        return;
    }
    answer(load, m);
}

// A .gltf names its buffers: they are part of the source. Their names are looked for as text,
// so that nothing is parsed here; one that is missed only makes two models count as one source.
static void add_siblings(struct relight_sha256 *sha, const char *path)
{
    struct prt_blob text;
    char folder[PATH_MAX], hex[65];
    snprintf(folder, sizeof folder, "%s", path);
    char *slash = strrchr(folder, '/');
    const char *dot = strrchr(path, '.');
    if (!slash || !dot || strcasecmp(dot, ".gltf")) return;
    if (prt_read_file(NULL, path, 64 << 20, &text)) return;
    const char *at = text.bytes, *end = at + text.size;
    for (; (at = memmem(at, (size_t)(end - at), "\"uri\"", 5)); at += 5) {
        const char *open = memchr(at + 5, '"', (size_t)(end - at - 5));
        const char *close = open ? memchr(open + 1, '"', (size_t)(end - open - 1)) : NULL;
        char sibling[PATH_MAX + 300];
        if (!close) break;
        if (close - open > 256) continue;
        snprintf(sibling, sizeof sibling, "%.*s/%.*s", (int)(slash - folder), folder,
                 (int)(close - open - 1), open + 1);
        if (!strstr(sibling, "..") && !blobs_hash_file(sibling, hex))
            relight_sha256_add(sha, hex, 64);
    }
    prt_free(text.bytes);
}

static int run_hash(struct work *work, const struct prt_context *ctx)
{
    struct load *load = (struct load *)work;
    char hex[65];
    int err = blobs_hash_file(load->path, hex);
    if (err) return prt_fail(ctx, PRT_IO, "%s: %s", load->name, strerror(-err));
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, hex, 64);
    add_siblings(&sha, load->path);
    relight_sha256_hex(&sha, load->source);
    return PRT_OK;
}

static void done_hash(struct work *work)
{
    struct load *load = (struct load *)work;
    if (!load->request) drop_load(load);
    else if (work->status) FAIL(load, NOT_FOUND, "%s", work->error);
    else source_known(load);
}

// ---- checking the request

static bool safe_name(const char *name)
{
    if (!name[0] || name[0] == '/' || name[0] == '.' || strlen(name) > 200) return false;
    for (const char *p = name; *p; p++)
        if ((unsigned char)*p < 32 || *p == '\\' ||
            (p[0] == '/' && (p[1] == '.' || p[1] == '/')))
            return false;
    return true;
}

// Fills load->path from the request's path; false when it leads out of --models.
static bool inside_models(struct load *load, const char *path, char error[300])
{
    const char *folder = load->server->options.models;
    char root[PATH_MAX], wanted[2 * PATH_MAX];
    if (!folder[0]) {
        snprintf(error, 300, "the daemon serves no models folder (--models): upload the file");
        return false;
    }
    snprintf(wanted, sizeof wanted, "%s/%s", folder, path);
    if (!realpath(folder, root) || !realpath(wanted, load->path)) {
        snprintf(error, 300, "%.100s: %s", path, strerror(errno));
        return false;
    }
    size_t n = strlen(root);
    struct stat st;
    if (strncmp(load->path, root, n) || load->path[n] != '/' || stat(load->path, &st) ||
        !S_ISREG(st.st_mode)) {
        snprintf(error, 300,
                 "%.100s: not a file inside the models folder (links that lead out of "
                 "it are not followed)",
                 path);
        return false;
    }
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
    if (b->transport > 3u) return "transport is unknown";
    if (b->storage > 2u) return "storage is unknown";
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

static bool check_files(struct load *load)
{
    const Relight__LoadRequest *r = message_of(load);
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    for (size_t i = 0; i < r->n_files; i++) {
        const Relight__FileRef *f = r->files[i];
        if (!safe_name(f->name)) {
            request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                         "files[%zu]: the name is not a plain relative path", i);
            return false;
        }
        if (!blobs_has(load->server->blobs, f->blob)) {
            request_fail(load->request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                         "%.100s: its blob was not uploaded", f->name);
            return false;
        }
        // The first file's name matters for its ending only, the others are referred to by
        // theirs.
        const char *dot = strrchr(f->name, '.');
        const char *name = i ? f->name : dot ? dot : "";
        relight_sha256_add(&sha, name, strlen(name) + 1);
        relight_sha256_add(&sha, f->blob, BLOB_HASH);
    }
    relight_sha256_hex(&sha, load->source);
    return true;
}

// Has every uploaded file checked, one after another, before any of them is used.
static void check_next(struct load *load);

static void blob_checked(struct blob_waiter *waiter)
{
    struct load *load = (struct load *)((char *)waiter - offsetof(struct load, blob_waiter));
    if (load->request) check_next(load);
    else drop_load(load);
}

static void check_next(struct load *load)
{
    const Relight__LoadRequest *r = message_of(load);
    struct blobs *blobs = load->server->blobs;
    bool light = r->bake && !strncmp(r->bake->env, "env:", 4);
    size_t n = r->n_files + light, i = load->n_checked++;
    const char *before = !i ? NULL : i <= r->n_files ? r->files[i - 1]->blob : r->bake->env + 4;
    if (before && !blobs_has(blobs, before)) {
        FAIL(load, NOT_FOUND, "%.12s… was damaged on the daemon's disk: upload it again",
             before);
    } else if (i < n) {
        load->blob_waiter.wake = blob_checked;
        blobs_check(blobs, i < r->n_files ? r->files[i]->blob : r->bake->env + 4,
                    &load->blob_waiter);
    } else if (r->n_files) {
        source_known(load);
    } else {
        load->work.run = run_hash;
        load->work.done = done_hash;
        load->work.class = WORK_INTERACTIVE;
        work_submit(load->server->work, &load->work);
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
    char error[300];
    if (!load) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    load->server = request->server;
    load->request = request;
    request->state = load;
    request->abandon = abandon;
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
    if (r->bake && !strncmp(r->bake->env, "env:", 4) &&
        !blobs_has(load->server->blobs, r->bake->env + 4)) {
        FAIL(load, NOT_FOUND, "bake.env: %.80s was not uploaded", r->bake->env);
        return;
    }
    if (r->bake && r->bake->env[0] && strncmp(r->bake->env, "env:", 4) &&
        strncmp(r->bake->env, "constant", 8)) {
        FAIL(load, BAD_REQUEST, "bake.env: neither env:HASH nor constant");
        return;
    }
    snprintf(load->name, sizeof load->name, "%s",
             r->name[0] ? r->name : file_part(r->n_files ? r->files[0]->name : r->path));
    if (r->path[0]) {
        if (!inside_models(load, r->path, error)) {
            FAIL(load, FORBIDDEN, "%s", error);
            return;
        }
        struct model *m = model_from_prt(load->server->models, load->path, load->name);
        if (m) {
            m->pinned |= r->pin;
            if (r->name[0]) snprintf(m->name, sizeof m->name, "%s", r->name);
            open_and_answer(load, m);
            return;
        }
    }
    if (!check_material(load) || (r->n_files && !check_files(load))) {
        free(load); // the request is answered
        return;
    }
    check_next(load);
}
