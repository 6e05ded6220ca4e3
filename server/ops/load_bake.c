// SPDX-License-Identifier: MIT
// LOAD's folders: inputs under the names that the model refers to, laid out by the queue of
// file operations; and the settings of the bake, which name the model.
#include "ops/load.h"

#include "core/log.h"
#include "prt/bake.h"

#include <errno.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

void load_add_arg(struct load_args *args, const char *fmt, ...)
{
    va_list list;
    va_start(list, fmt);
    if (args->n < MAX_ARGS && vasprintf(&args->argv[args->n], fmt, list) >= 0) args->n++;
    va_end(list);
}

static const char *const transport_word[] = {"", "wavelet", "polynomial", "joint"};
static const char *const storage_word[] = {"", "factored", "sparse"};

// Settings in a fixed order, as options of `prt bake`: the command, and the model's id.
void load_add_settings(struct load_args *a, const Relight__LoadRequest *r)
{
    const Relight__BakeSettings *b = r->bake;
    if (r->size_mm > 0) load_add_arg(a, "--size-mm=%.9g", (double)r->size_mm);
    if (r->mm_per_unit > 0) load_add_arg(a, "--mm-per-unit=%.9g", (double)r->mm_per_unit);
    if (r->up_z) load_add_arg(a, "--up=z");
    for (size_t i = 0; i < r->n_opaque; i++) load_add_arg(a, "--opaque=%s", r->opaque[i]);
    if (!b) return;
    if (b->transport) load_add_arg(a, "--transport=%s", transport_word[b->transport]);
    if (b->storage) load_add_arg(a, "--storage=%s", storage_word[b->storage]);
    if (b->samples) load_add_arg(a, "--samples=%u", b->samples);
    if (b->cube) load_add_arg(a, "--cube=%u", b->cube);
    if (b->coeffs) load_add_arg(a, "--coeffs=%u", b->coeffs);
    if (b->rank) load_add_arg(a, "--rank=%u", b->rank);
    if (b->phase_terms) load_add_arg(a, "--phase-terms=%u", b->phase_terms);
    if (b->single_points) load_add_arg(a, "--single-points=%u", b->single_points);
    if (b->no_single) load_add_arg(a, "--no-single");
    if (b->max_error > 0) load_add_arg(a, "--max-error=%.9g", (double)b->max_error);
    if (b->seed) load_add_arg(a, "--seed=%llu", (unsigned long long)b->seed);
    if (b->env[0]) load_add_arg(a, "--rotate=%.9g", (double)b->rotate_deg);
}

void load_name_model(const struct load *load, char id[MODEL_ID + 1])
{
    struct relight_sha256 sha;
    struct load_args a = {0};
    char hex[65], versions[64];
    load_add_settings(&a, load_message(load));
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

// ---- the preview

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
