// SPDX-License-Identifier: MIT
// LOAD's folders: inputs under the names that the model refers to, laid out by the queue of
// file operations; and the settings of the bake, which name the model.
#include "ops/load.h"

#include "core/log.h"
#include "prt/bake.h"
#include "prt/media.h"

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
static const char *const scattering_word[] = {"", "dipole", "walk"};
static const char *const storage_word[] = {"", "factored", "sparse"};

// A bake of fewer samples or a smaller light takes little longer than a draft, which has 20,000
// samples and a light of 6x16x16 texels.
static const uint32_t draft_least_samples = 40000, draft_least_cube = 32;

bool load_wants_draft(const struct load *load)
{
    static const Relight__BakeSettings none = RELIGHT__BAKE_SETTINGS__INIT;
    const Relight__LoadRequest *r = load_message(load);
    const Relight__BakeSettings *b = r->bake ? r->bake : &none;
    return !r->no_draft && b->transport != RELIGHT__TRANSPORT__TRANSPORT_POLYNOMIAL &&
           (!b->samples || b->samples >= draft_least_samples) &&
           (!b->cube || b->cube >= draft_least_cube);
}

static void add_placement(struct load_args *a, const Relight__LoadRequest *r)
{
    if (r->size_mm > 0) load_add_arg(a, "--size-mm=%.9g", (double)r->size_mm);
    if (r->mm_per_unit > 0) load_add_arg(a, "--mm-per-unit=%.9g", (double)r->mm_per_unit);
    if (r->up_z) load_add_arg(a, "--up=z");
    if (r->flip_v) load_add_arg(a, "--flip-v");
    if (r->variant[0]) load_add_arg(a, "--variant=%s", r->variant);
    for (size_t i = 0; i < r->n_opaque; i++) load_add_arg(a, "--opaque=%s", r->opaque[i]);
}

// The same choice as that of `prt bake`.
bool load_is_joint(const struct load *load)
{
    const Relight__BakeSettings *b = load_message(load)->bake;
    bool sparse = b && (b->coeffs || b->storage == RELIGHT__STORAGE__STORAGE_SPARSE);
    if (b && b->transport) return b->transport == RELIGHT__TRANSPORT__TRANSPORT_JOINT;
    return !load->n_material && !sparse;
}

void load_add_draft(struct load_args *a, const struct load *load)
{
    const Relight__LoadRequest *r = load_message(load);
    const Relight__BakeSettings *b = r->bake;
    load_add_arg(a, "--draft");
    if (b && b->no_single) load_add_arg(a, "--no-single");
    load_add_arg(a, "--transport=%s", load_is_joint(load) ? "joint" : "wavelet");
    if (b && b->scattering) load_add_arg(a, "--scattering=%s", scattering_word[b->scattering]);
    if (b && b->any_eta) load_add_arg(a, "--any-eta"); // a medium that the bake takes, it takes
    for (unsigned i = 0; i < load->n_material; i++)
        load_add_arg(a, "--material=%s", load->material[i].arg);
    add_placement(a, r);
    if (b && b->seed) load_add_arg(a, "--seed=%llu", (unsigned long long)b->seed);
}

// Settings in a fixed order, as options of `prt bake`: the command, and the model's id.
void load_add_settings(struct load_args *a, const Relight__LoadRequest *r)
{
    const Relight__BakeSettings *b = r->bake;
    add_placement(a, r);
    if (!b) return;
    if (b->transport) load_add_arg(a, "--transport=%s", transport_word[b->transport]);
    if (b->storage) load_add_arg(a, "--storage=%s", storage_word[b->storage]);
    if (b->scattering) load_add_arg(a, "--scattering=%s", scattering_word[b->scattering]);
    if (b->walks) load_add_arg(a, "--walks=%u", b->walks);
    if (b->samples) load_add_arg(a, "--samples=%u", b->samples);
    if (b->cube) load_add_arg(a, "--cube=%u", b->cube);
    if (b->coeffs) load_add_arg(a, "--coeffs=%u", b->coeffs);
    if (b->rank) load_add_arg(a, "--rank=%u", b->rank);
    if (b->phase_terms) load_add_arg(a, "--phase-terms=%u", b->phase_terms);
    if (b->single_points) load_add_arg(a, "--single-points=%u", b->single_points);
    if (b->no_single) load_add_arg(a, "--no-single");
    if (b->exit_planes) load_add_arg(a, "--exit-planes");
    if (b->any_eta) load_add_arg(a, "--any-eta");
    if (b->max_error > 0) load_add_arg(a, "--max-error=%.9g", (double)b->max_error);
    if (b->seed) load_add_arg(a, "--seed=%llu", (unsigned long long)b->seed);
    if (b->env[0]) load_add_arg(a, "--rotate=%.9g", (double)b->rotate_deg);
}

// One medium for all objects, or "", then those by object.
static void add_materials(const struct load *load, struct relight_sha256 *sha)
{
    const bool one = load->n_material && !prt_media_name_length(load->material[0].arg);
    if (!one) relight_sha256_add(sha, "", 1);
    for (unsigned i = 0; i < load->n_material; i++) {
        const struct load_material *m = &load->material[i];
        relight_sha256_add(sha, m->arg, prt_media_name_length(m->arg));
        if (prt_media_name_length(m->arg)) relight_sha256_add(sha, "=", 1);
        relight_sha256_add(sha, m->text, strlen(m->text) + 1);
    }
}

static void hash_load(const struct load *load, const char *versions, char id[MODEL_ID + 1])
{
    struct relight_sha256 sha;
    struct load_args a = {0};
    char hex[65];
    load_add_settings(&a, load_message(load));
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, versions, strlen(versions) + 1);
    relight_sha256_add(&sha, load->source, strlen(load->source) + 1);
    add_materials(load, &sha);
    for (size_t i = 0; i < a.n; i++) {
        relight_sha256_add(&sha, a.argv[i], strlen(a.argv[i]) + 1);
        free(a.argv[i]);
    }
    relight_sha256_add(&sha, load->env, strlen(load->env) + 1);
    relight_sha256_hex(&sha, hex);
    snprintf(id, MODEL_ID + 1, "%.*s", MODEL_ID, hex);
}

void load_name_model(const struct load *load, char id[MODEL_ID + 1], char kin[MODEL_ID + 1])
{
    char versions[64];
    snprintf(versions, sizeof versions, "bake %d, file %d", PRT_BAKE_VERSION, PRT_FILE_VERSION);
    hash_load(load, versions, id);
    hash_load(load, "any version", kin);
}

// ---- the folders: inputs under the names the model refers to (on a worker)

static void file_source(const struct load *load, const char *hash, bool copy,
                        char path[PATH_MAX])
{
    if (copy) import_path(load->server->imports, hash, path, PATH_MAX);
    else blobs_path(load->server->blobs, hash, path, PATH_MAX);
}

int load_link_file(const char *from, const char *folder, const char *name)
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
        err = load_link_file(from, folder, f->name);
    }
    return err;
}

static int write_materials(struct load *load, const char *folder)
{
    char path[PATH_MAX + 40];
    load->fault_name = "material";
    for (unsigned i = 0; i < load->n_material; i++) {
        const struct load_material *m = &load->material[i];
        if (!m->file[0]) continue;
        snprintf(path, sizeof path, "%s/%s", folder, m->file);
        if (prt_write_file(NULL, path, m->text, strlen(m->text))) return errno;
    }
    return 0;
}

static int lay_out_preview(struct load *load)
{
    int err = link_files(load, load->preview_folder);
    return err ? err : write_materials(load, load->preview_folder);
}

static int lay_out_bake(struct load *load)
{
    char from[PATH_MAX];
    int err = link_files(load, load->bake_folder);
    if (!err && !strncmp(load->env, "env:", 4)) {
        load->fault_name = "bake.env";
        file_source(load, load->env + 4, false, from);
        err = load_link_file(from, load->bake_folder, ".environment");
    }
    return err ? err : write_materials(load, load->bake_folder);
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
    load->away = load->find_bake && !object_find(load->server->objects, OBJECT_BAKE,
                                                 load->model->id, &load->bake_bytes);
    if (load->away) return PRT_OK;
    if (load->preview_folder[0]) load->fault = lay_out_preview(load);
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

char *load_material_path(const char *arg, const char *folder)
{
    const size_t n = prt_media_name_length(arg), name = n ? n + 1 : 0;
    char *out = NULL;
    if (strncmp(arg + name, ".material", 9)) return strdup(arg);
    // A '/' before any '=' of the folder's own name.
    return asprintf(&out, "%.*s%s%s/%s", (int)name, arg, *folder == '/' ? "" : "./", folder,
                    arg + name) < 0
               ? NULL
               : out;
}

// Has the model's file read, so that image-space engines can answer.
void load_order_preview(const struct load *load, struct model *m)
{
    const Relight__LoadRequest *r = load_message(load);
    char path[2 * PATH_MAX], *material[MATERIAL_TEXTS];
    size_t n = 0;
    if (!load->preview_folder[0]) return;
    for (; n < load->n_material; n++)
        if (!(material[n] = load_material_path(load->material[n].arg, load->preview_folder)))
            break;
    snprintf(path, sizeof path, "%s/%s", load->preview_folder, load->file[0].name);
    struct decode_model order = {.path = path,
                                 .name = load->name,
                                 .size_mm = r->size_mm,
                                 .mm_per_unit = r->mm_per_unit,
                                 .up_z = r->up_z,
                                 .flip_v = r->flip_v,
                                 .variant = r->variant,
                                 .n_material = n,
                                 .material = material,
                                 .n_opaque = r->n_opaque,
                                 .opaque = r->opaque};
    preview_start(m, &order, load->preview_folder);
    while (n) free(material[--n]);
}
