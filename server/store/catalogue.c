// SPDX-License-Identifier: MIT
// The catalogue: a record for each baked or previewed model, and the scan of DATA at start.
#include "store/model_files.h"

#include "core/log.h"
#include "frame.h"
#include "prt/transport.h"
#include "relight.pb-c.h"
#include "store/disk.h"

#include <cjson/cJSON.h>
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { OLD_ID = 16 }; // digits of an id before version 0.2

static void record_path(const struct server *server, const char *id, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/models/%s.json", server->data, id);
}

// ---- the record in the folder that replicas share

struct record_task {
    struct file_task task; // first
    struct model *model;   // held; written: its record_err. NULL: the record is removed
    struct object_store *objects;
    char id[MODEL_ID + 1];
    char *text;
};

static int run_record(struct file_task *task)
{
    struct record_task *r = (struct record_task *)task;
    return r->model ? object_write(r->objects, r->id, r->text)
                    : object_remove(r->objects, OBJECT_RECORD, r->id);
}

static void record_done(struct file_task *task)
{
    struct record_task *r = (struct record_task *)task;
    if (task->status)
        log_line(LOG_WARN, "model id=%s its record in --store cannot be %s: %s", r->id,
                 r->model ? "written" : "removed", strerror(-task->status));
    if (r->model) r->model->record_err = task->status;
    model_release(r->model);
    free(r->text);
    free(r);
}

// text: taken; NULL: removes the record.
static void share_record(struct server *server, const char *id, struct model *m, char *text)
{
    struct record_task *r = object_store_shared(server->objects) ? calloc(1, sizeof *r) : NULL;
    if (!r) {
        free(text);
        return;
    }
    r->objects = server->objects;
    r->text = text;
    snprintf(r->id, sizeof r->id, "%s", id);
    if (m) model_hold(r->model = m);
    r->task.run = run_record;
    r->task.done = record_done;
    file_queue_add(server->file_queue, &r->task);
}

static const char *state_word(const struct model *m)
{
    return m->state == RELIGHT__MODEL_STATE__MODEL_READY    ? "ready"
           : m->state == RELIGHT__MODEL_STATE__MODEL_BAKING ? "baking"
                                                            : "preview";
}

void model_remember(struct model *m)
{
    char path[PATH_MAX];
    if (m->copy) return;
    cJSON *json = cJSON_CreateObject();
    cJSON_AddStringToObject(json, "id", m->id);
    cJSON_AddStringToObject(json, "name", m->name);
    cJSON_AddStringToObject(json, "owner", m->owner);
    cJSON_AddBoolToObject(json, "pinned", m->pinned);
    cJSON_AddStringToObject(json, "warnings", m->warnings ? m->warnings : "");
    if (m->replaces[0]) cJSON_AddStringToObject(json, "replaces", m->replaces);
    if (m->removed) cJSON_AddBoolToObject(json, "removed", true);
    if (m->replaced) cJSON_AddStringToObject(json, "successor", m->successor);
    if (m->source) cJSON_AddStringToObject(json, "source", m->source);
    cJSON *aliases = m->alias ? cJSON_AddArrayToObject(json, "aliases") : NULL;
    for (const struct model_alias *a = m->alias; a; a = a->next) {
        cJSON *one = cJSON_CreateObject();
        cJSON_AddStringToObject(one, "owner", a->owner);
        cJSON_AddStringToObject(one, "name", a->name);
        cJSON_AddItemToArray(aliases, one);
    }
    cJSON_AddStringToObject(json, "state", state_word(m));
    if (m->load) cJSON_AddStringToObject(json, "load", m->load);
    if (m->bake_bytes) cJSON_AddNumberToObject(json, "bytes", (double)m->bake_bytes);
    if (m->kin[0]) cJSON_AddStringToObject(json, "kin", m->kin);
    cJSON_AddNumberToObject(json, "bake", m->bake_version);
    cJSON_AddNumberToObject(json, "file", PRT_FILE_VERSION);
    cJSON_AddStringToObject(json, "replica", m->server->run);
    record_path(m->server, m->id, path);
    m->recorded = true;
    m->recorded_ns = loop_now_ns();
    share_record(m->server, m->id, m, cJSON_Print(json));
    file_write(m->server->file_queue, path, cJSON_Print(json));
    cJSON_Delete(json);
}

void model_forget_record(struct model *m)
{
    char path[PATH_MAX];
    if (m->recorded) share_record(m->server, m->id, NULL, NULL);
    m->recorded = false;
    record_path(m->server, m->id, path);
    if (!m->copy) file_remove(m->server->file_queue, path);
}

void model_forget_shared(struct server *server, const char *id)
{
    share_record(server, id, NULL, NULL);
}

uint32_t record_version(const cJSON *record, const char *of)
{
    const cJSON *n = cJSON_GetObjectItemCaseSensitive(record, of);
    return cJSON_IsNumber(n) && n->valuedouble >= 1 && n->valuedouble < 1e6
               ? (uint32_t)n->valuedouble
               : RECORD_BEFORE;
}

static const char *json_text(const cJSON *json, const char *key)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    return text ? text : "";
}

static void recall_names(struct model *m, const cJSON *json)
{
    const cJSON *one;
    cJSON_ArrayForEach(one, cJSON_GetObjectItemCaseSensitive(json, "aliases"))
        model_set_name(m, json_text(one, "owner"), json_text(one, "name"));
}

static int64_t use_time(const struct stat *st)
{
    return (int64_t)st->st_mtim.tv_sec * 1000000000 + st->st_mtim.tv_nsec;
}

static void recall_files(struct model *m, const struct stat *bake, const struct stat *preview,
                         bool baking)
{
    m->state = bake     ? RELIGHT__MODEL_STATE__MODEL_READY
               : baking ? RELIGHT__MODEL_STATE__MODEL_BAKING
                        : RELIGHT__MODEL_STATE__MODEL_PREVIEW;
    if (bake || preview) m->used_ns = use_time(bake ? bake : preview);
    if (preview) {
        m->mesh = MESH_THERE;
        model_charge_preview(m, (uint64_t)preview->st_size);
    }
    if (bake) {
        model_charge_bake(m, (uint64_t)bake->st_size);
        preview_remove(m);
        model_read_header(m);
    }
}

// A relightd of another version of the format baked it: where replicas share a folder it is
// theirs. Its file here is a copy, or belongs to this machine's earlier version and waits for
// it.
static bool is_foreign(const struct server *server, const char *id, const char *path)
{
    uint64_t bytes;
    uint32_t version = object_store_shared(server->objects) ? prt_file_version(path) : 0;
    if (!version || version == PRT_FILE_VERSION) return false;
    bool copy = !object_find(server->objects, OBJECT_BAKE, id, &bytes);
    log_line(LOG_EVENT, "model id=%s has a bake of version %u, this relightd reads %d: %s", id,
             version, PRT_FILE_VERSION, copy ? "it stays in --store" : "it stays where it is");
    if (copy) unlink(path);
    return true;
}

// PRT_NOMEM: the record may be good, and must stay.
static int recall(struct models *models, struct server *server, const char *id)
{
    struct prt_blob blob;
    struct stat bake, preview;
    char record[PATH_MAX], path[PATH_MAX];
    record_path(server, id, record);
    int status = prt_read_file(NULL, record, OBJECT_TEXT, &blob);
    if (status) return status == PRT_NOMEM ? status : PRT_OK;
    errno = 0; // cJSON reports a failed malloc as a fault of the text
    cJSON *json = cJSON_ParseWithLength(blob.bytes, blob.size);
    prt_free(blob.bytes);
    if (!json && errno == ENOMEM) return PRT_NOMEM;
    model_bake_path(server, id, path);
    if (is_foreign(server, id, path)) {
        cJSON_Delete(json);
        return PRT_OK;
    }
    bool baked = !stat(path, &bake);
    model_preview_path(server, id, path);
    bool read = !stat(path, &preview);
    const char *owner = json_text(json, "owner");
    struct model *m = NULL;
    struct job *job = jobs_find(server->jobs, id);
    bool baking = job && job_state(job) == RELIGHT__JOB_STATE__JOB_QUEUED;
    if (json && !strcmp(json_text(json, "id"), id) && (baked || read || baking)) {
        m = model_add(models, id, json_text(json, "name"), owner[0] ? owner : DISK_NOBODY);
        if (!m) status = PRT_NOMEM;
    }
    if (m) {
        m->pinned = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "pinned"));
        if (json_text(json, "warnings")[0]) m->warnings = strdup(json_text(json, "warnings"));
        if (json_text(json, "load")[0]) m->load = strdup(json_text(json, "load"));
        if (json_text(json, "source")[0]) m->source = strdup(json_text(json, "source"));
        snprintf(m->replaces, sizeof m->replaces, "%s", json_text(json, "replaces"));
        snprintf(m->kin, sizeof m->kin, "%s", json_text(json, "kin"));
        m->bake_version = record_version(json, "bake");
        m->removed = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "removed"));
        snprintf(m->successor, sizeof m->successor, "%s", json_text(json, "successor"));
        m->replaced = m->successor[0];
        recall_names(m, json);
        recall_files(m, baked ? &bake : NULL, read ? &preview : NULL, baking);
        log_line(LOG_EVENT, "model id=%s name=\"%s\" recalled", m->id, m->name);
    } else if (!status) {
        log_line(LOG_WARN, "model id=%s has no bake any more", id);
        unlink(record);
    }
    cJSON_Delete(json);
    return status;
}

// ---- ids of 16 digits: the bake keeps its name, a LOAD of its source makes a new one

static void move_file(const struct server *server, const char *from, const char *to,
                      void (*name)(const struct server *, const char *, char[PATH_MAX]))
{
    char old[PATH_MAX], new[PATH_MAX];
    name(server, from, old);
    name(server, to, new);
    if (!access(old, F_OK) && rename(old, new))
        log_line(LOG_WARN, "file %s cannot be renamed to %s", old, new);
}

static void migrate(const struct server *server, const char *old)
{
    struct relight_sha256 sha;
    struct prt_blob blob;
    char hex[65], id[MODEL_ID + 1], path[PATH_MAX], new[PATH_MAX];
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, "old id", 7);
    relight_sha256_add(&sha, old, strlen(old));
    relight_sha256_hex(&sha, hex);
    snprintf(id, sizeof id, "%.*s", MODEL_ID, hex);
    record_path(server, old, path);
    record_path(server, id, new);
    if (prt_read_file(NULL, path, OBJECT_TEXT, &blob)) return;
    cJSON *json = cJSON_ParseWithLength(blob.bytes, blob.size);
    prt_free(blob.bytes);
    cJSON_DeleteItemFromObjectCaseSensitive(json, "id");
    if (json) cJSON_AddStringToObject(json, "id", id);
    char *text = json ? cJSON_Print(json) : NULL;
    cJSON_Delete(json);
    if (text && !prt_write_file(NULL, new, text, strlen(text))) {
        move_file(server, old, id, model_bake_path);
        move_file(server, old, id, model_preview_path);
        unlink(path);
        log_line(LOG_EVENT, "model id=%s is now id=%s: ids have %d digits", old, id, MODEL_ID);
    }
    free(text);
}

// Ends with the first status other than 0 that fn returns.
static int each_record(const struct server *server, size_t digits,
                       int (*fn)(void *user, const char *id), void *user)
{
    int status = PRT_OK;
    char folder[PATH_MAX], id[MODEL_ID + 1];
    snprintf(folder, sizeof folder, "%s/models", server->data);
    DIR *dir = opendir(folder);
    if (!dir && errno == ENOMEM) return PRT_NOMEM;
    for (struct dirent *d; dir && !status && (d = readdir(dir));) {
        if (strlen(d->d_name) != digits + 5 || strcmp(d->d_name + digits, ".json") ||
            strspn(d->d_name, "0123456789abcdef") != digits)
            continue;
        snprintf(id, sizeof id, "%.*s", (int)digits, d->d_name);
        status = fn(user, id);
    }
    if (dir) closedir(dir);
    return status;
}

static int migrate_one(void *user, const char *id)
{
    migrate(((struct server *)user), id);
    return PRT_OK;
}

struct recalling {
    struct models *models;
    struct server *server;
};

static int recall_one(void *user, const char *id)
{
    return recall(((struct recalling *)user)->models, ((struct recalling *)user)->server, id);
}

// ---- leftovers of a killed daemon or bake

// A bake without a record, perhaps of another daemon, is found by a LOAD of its source.
static void adopt(struct models *models, const char *id, const struct stat *st)
{
    struct model *m = model_add(models, id, id, DISK_NOBODY);
    if (!m) return;
    log_line(LOG_EVENT, "model id=%s has a bake and no record", id);
    recall_files(m, st, NULL, false);
}

static void sweep(struct models *models, const struct server *server, const char *name)
{
    char folder[PATH_MAX], path[PATH_MAX + 256], id[MODEL_ID + 1];
    snprintf(folder, sizeof folder, "%s/%s", server->data, name);
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        struct stat st;
        if (fstatat(dirfd(dir), d->d_name, &st, AT_SYMLINK_NOFOLLOW) || !S_ISREG(st.st_mode))
            continue;
        snprintf(id, sizeof id, "%.*s", MODEL_ID, d->d_name);
        bool ours = strspn(d->d_name, "0123456789abcdef") == MODEL_ID &&
                    !strcmp(d->d_name + MODEL_ID, ".prt");
        if (ours && models_get(models, id)) continue;
        if (ours && !strcmp(name, "bakes")) {
            snprintf(path, sizeof path, "%s/%s", folder, d->d_name);
            if (is_foreign(server, id, path)) continue;
            adopt(models, id, &st);
            continue;
        }
        log_line(LOG_EVENT, "file %s/%s belongs to no model and is removed", name, d->d_name);
        unlinkat(dirfd(dir), d->d_name, 0);
    }
    if (dir) closedir(dir);
}

static void sweep_work(const struct server *server)
{
    char folder[PATH_MAX], path[PATH_MAX];
    snprintf(folder, sizeof folder, "%s/work", server->data);
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        if (!strcmp(d->d_name, ".") || !strcmp(d->d_name, "..") ||
            jobs_use_folder(server->jobs, d->d_name))
            continue;
        if (snprintf(path, sizeof path, "%s/%s", folder, d->d_name) >= PATH_MAX) continue;
        log_line(LOG_EVENT, "folder work/%s was left by a daemon that was killed", d->d_name);
        remove_tree(path);
    }
    if (dir) closedir(dir);
}

int catalogue_read(struct models *models)
{
    struct server *server = models_server(models);
    struct recalling recalling = {models, server};
    sweep_work(server);
    int status = each_record(server, OLD_ID, migrate_one, server);
    if (!status) status = each_record(server, MODEL_ID, recall_one, &recalling);
    if (status) {
        log_line(LOG_ERR, "not enough memory to read the catalogue: nothing was changed");
        return status;
    }
    sweep(models, server, "bakes");
    sweep(models, server, "previews");
    return PRT_OK;
}
