// SPDX-License-Identifier: MIT
// LOAD's folders and the bake's command: inputs under the names that the model refers to, laid
// out by the queue of file operations, and `prt bake` with its options.
#include "ops/load.h"

#include "core/log.h"
#include "prt/bake.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

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

// Settings in a fixed order, as options of `prt bake`: the command, and the model's id.
static void add_settings(struct args *a, const Relight__LoadRequest *r)
{
    const Relight__BakeSettings *b = r->bake;
    if (r->size_mm > 0) add_arg(a, "--size-mm=%.9g", (double)r->size_mm);
    if (r->mm_per_unit > 0) add_arg(a, "--mm-per-unit=%.9g", (double)r->mm_per_unit);
    if (r->up_z) add_arg(a, "--up=z");
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

void load_name_model(const struct load *load, char id[MODEL_ID + 1])
{
    struct relight_sha256 sha;
    struct args a = {0};
    char hex[65], versions[64];
    add_settings(&a, load_message(load));
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

int load_run_lay_out(struct file_task *task)
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

void load_fail_lay_out(struct load *load)
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
    load_drop(load);
}

// ---- the bake's command

struct baking {
    struct model *model;
    char folder[PATH_MAX], owner[96];
};

// Has the model's file read, so that image-space engines can answer.
void load_order_preview(const struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = load_message(load);
    char path[2 * PATH_MAX];
    if (!load->preview_folder[0]) return;
    snprintf(path, sizeof path, "%s/%s", load->preview_folder, load->file[0].name);
    struct decode_model order = {.path = path,
                                 .name = load->name,
                                 .size_mm = r->size_mm,
                                 .mm_per_unit = r->mm_per_unit,
                                 .up_z = r->up_z,
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
    add_settings(a, load_message(load));
    if (!strncmp(load->env, "env:", 4)) add_arg(a, "--env=.environment");
    else if (load->env[0]) add_arg(a, "--env=%s", load->env);
}

// False, with the limit that is in the way.
bool load_order_bake(struct load *load, struct model *m, char error[256])
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
    model_set_state(m, RELIGHT__MODEL_STATE__MODEL_BAKING);
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
