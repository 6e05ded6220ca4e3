// SPDX-License-Identifier: MIT
// LOAD's files of --models: each is copied into the daemon's folder before anything reads it, a
// .gltf with the files that it names.
#include "ops/load.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void load_hash_source(struct load *load)
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

bool load_add_file(struct load *load, const char *name, const char *hash,
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
        if (!load_safe_name(name[i])) continue; // the reader refuses it, with its reason
        if (!(load->sibling[load->n_sibling] = strdup(name[i]))) return false;
        load->n_sibling++;
    }
    return load->sibling != NULL;
}

// A .prt is a model by itself.
static void load_prt(struct load *load, struct import_copy *copy)
{
    const Relight__LoadRequest *r = load_message(load);
    struct model *m = models_found(load->server->models, copy, load->name);
    if (!m) {
        LOAD_FAIL(load, NO_MEMORY, "not enough memory");
        return;
    }
    if (!load_pin(load, m)) return;
    if (r->name[0]) model_set_name(m, load->owner, r->name);
    load_open_and_answer(load, m);
}

static void imported(struct import_request *request, struct import_copy *copy,
                     char *const *names, size_t n_name, int code, const char *error)
{
    struct load *load = (struct load *)((char *)request - offsetof(struct load, import));
    const char *path = load_message(load)->path, *base = load_file_part(path);
    char plain[16];
    bool first = !load->n_file;
    load->importing = false;
    if (!copy) {
        if (code == RELIGHT__ERROR_CODE__ERROR_FORBIDDEN) // a path, and no right of the caller
            load->request->hint = "`relight models` lists what the models folder has; other "
                                  "files are uploaded: `relight load FILE`";
        request_fail(load->request, code, "%s", error);
        load_drop(load);
        return;
    }
    if (first && copy->prt) {
        load_prt(load, copy);
        return;
    }
    if (first && !load_check_material(load)) {
        load_drop(load); // the request is answered
        return;
    }
    if (first && !load_safe_name(base)) {
        const char *dot = strrchr(base, '.');
        snprintf(plain, sizeof plain, "model%.8s", dot ? dot : "");
        base = plain;
    }
    if (!load_add_file(load, first ? base : load->sibling[load->n_file - 1], copy->hash,
                       copy) ||
        (first && !keep_siblings(load, names, n_name))) {
        LOAD_FAIL(load, NO_MEMORY, "not enough memory");
        return;
    }
    load_import_next(load);
}

// Below --models: the model's path, and that of a file which it names.
static void path_of(const struct load *load, size_t index, char out[PATH_MAX])
{
    const char *path = load_message(load)->path;
    int folder = index ? (int)(load_file_part(path) - path) : 0;
    snprintf(out, PATH_MAX, "%.*s%s", folder, path, index ? load->sibling[index - 1] : path);
}

void load_import_next(struct load *load)
{
    char path[PATH_MAX];
    if (load->n_file > load->n_sibling) {
        load_hash_source(load);
        load_source_known(load);
        return;
    }
    load->importing = true;
    load->import.done = imported;
    path_of(load, load->n_file, path);
    imports_get(load->server->imports, path, load->owner, &load->import);
}

char *load_packed(const struct load *load)
{
    static const char digits[] = "0123456789abcdef";
    const ProtobufCMessage *message = load->request->message;
    size_t n = protobuf_c_message_get_packed_size(message);
    uint8_t *bytes = malloc(n + 1);
    char *hex = calloc(n + 1, 2);
    if (bytes && hex) {
        protobuf_c_message_pack(message, bytes);
        for (size_t i = 0; i < n; i++) {
            hex[2 * i] = digits[bytes[i] >> 4];
            hex[2 * i + 1] = digits[bytes[i] & 15];
        }
    } else {
        free(hex);
        hex = NULL;
    }
    free(bytes);
    return hex;
}

char *load_source_text(const struct load *load)
{
    char *hex = load_packed(load), path[PATH_MAX], *text = NULL;
    cJSON *json = cJSON_CreateObject(), *files = cJSON_AddArrayToObject(json, "files");
    for (size_t i = 0; i < load->n_file; i++) {
        path_of(load, i, path);
        cJSON_AddItemToArray(files, cJSON_CreateString(path));
    }
    if (hex) {
        cJSON_AddStringToObject(json, "request", hex);
        text = cJSON_PrintUnformatted(json);
    }
    cJSON_Delete(json);
    free(hex);
    return text;
}

const char *load_file_part(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}
