// SPDX-License-Identifier: MIT
// A model before its bake: its file is read by the helper process into DATA/previews/ID.prt, a
// .prt without light transport, and opened like a bake.
#include "store/model_files.h"
#include "core/log.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct reading {
    struct model *model;
    struct cache_entry *entry;
    char folder[PATH_MAX]; // to remove
};

// Nobody waits for a queued reading any more. A bake's is wanted at any rate: views draw it.
static void reading_unwanted(struct cache_entry *entry)
{
    struct reading *r = entry->job;
    struct model *m = r->model;
    if (m->gone || m->state != RELIGHT__MODEL_STATE__MODEL_BAKING)
        decoder_withdraw(m->server->decoder, r); // may free it
}

// The model of a withdrawn reading was for that alone.
static void withdrawn(struct model *m)
{
    m->mesh = MESH_NONE;
    log_line(LOG_EVENT, "model id=%s is not read: nobody waits for it", m->id);
    if (!m->gone && m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW) model_unload(m, true);
}

static void not_read(struct reading *r, int status, const char *error, const char *path)
{
    struct model *m = r->model;
    int code = m->gone ? RELIGHT__ERROR_CODE__ERROR_NOT_FOUND : error_of_status(status);
    if (m->gone) error = "the model was unloaded meanwhile";
    m->mesh = MESH_FAILED;
    m->mesh_error_code = code;
    snprintf(m->mesh_error, sizeof m->mesh_error, "%s", error);
    log_line(LOG_EVENT, "model id=%s not read error=\"%s\"", m->id, error);
    // Else somebody is to write or has written the same.
    if (model_is_last(m)) file_remove(m->server->file_queue, path);
    cache_fail(r->entry, code, error);
    cache_release(r->entry);
    if (status == PRT_CANCELLED) withdrawn(m);
}

static void read_done(void *user, int status, const char *error, const char *warnings, float ms)
{
    struct reading *r = user;
    struct model *m = r->model;
    char path[PATH_MAX];
    model_preview_path(m->server, m->id, path);
    file_remove(m->server->file_queue, r->folder);
    r->entry->unwanted = NULL;
    if (status || m->gone) {
        not_read(r, status, error, path);
    } else {
        m->mesh = MESH_THERE;
        if (warnings[0] && !m->warnings) m->warnings = strdup(warnings);
        log_line(LOG_EVENT, "model id=%s read ms=%.1f", m->id, (double)ms);
        if (m->state != RELIGHT__MODEL_STATE__MODEL_READY) model_remember(m);
        model_start_opening(m, r->entry, path, true);
        model_changed(m);
    }
    model_release(m);
    free(r);
}

void preview_start(struct model *m, const struct decode_model *order, const char *folder)
{
    char key[sizeof m->key + 8], path[PATH_MAX];
    bool fresh;
    struct reading *r = NULL;
    if (m->mesh == MESH_THERE || m->mesh == MESH_READING || !(r = calloc(1, sizeof *r))) {
        file_remove(m->server->file_queue, folder);
        return;
    }
    snprintf(key, sizeof key, "%s/mesh", m->key);
    r->model = m;
    model_hold(m);
    // A preview file that exists here belongs to a removed source.
    cache_forget(m->server->files, key, true);
    r->entry = cache_get(m->server->files, key, &fresh);
    if (!fresh) { // no memory
        cache_release(r->entry);
        model_release(m);
        free(r);
        file_remove(m->server->file_queue, folder);
        return;
    }
    snprintf(r->folder, sizeof r->folder, "%s", folder);
    m->mesh = MESH_READING;
    r->entry->unwanted = reading_unwanted;
    r->entry->job = r;
    struct decode_model own = *order;
    model_preview_path(m->server, m->id, path);
    own.out = path;
    decoder_model(m->server->decoder, &own, read_done, r);
}

void preview_remove(struct model *m)
{
    char key[sizeof m->key + 8], path[PATH_MAX];
    model_charge_preview(m, 0);
    snprintf(key, sizeof key, "%s/mesh", m->key);
    struct cache_entry *e = cache_find(m->server->files, key);
    bool opening = e && e->state == CACHE_PENDING;
    cache_release(e);
    // One that is being read or opened is removed after that.
    if (m->mesh != MESH_THERE || opening) return;
    m->mesh = MESH_NONE;
    cache_forget(m->server->files, key, true);
    model_preview_path(m->server, m->id, path);
    file_remove(m->server->file_queue, path);
}

struct cache_entry *model_mesh_open(struct model *m, int *code, char error[256])
{
    char key[sizeof m->key + 8], path[PATH_MAX];
    bool fresh;
    if (m->gone || m->state == RELIGHT__MODEL_STATE__MODEL_READY)
        return model_open(m, code, error);
    if (m->mesh == MESH_NONE && m->state == RELIGHT__MODEL_STATE__MODEL_FAILED)
        return model_open(m, code, error);
    if (m->mesh == MESH_FAILED || m->mesh == MESH_NONE) {
        *code =
            m->mesh == MESH_FAILED ? m->mesh_error_code : RELIGHT__ERROR_CODE__ERROR_NOT_READY;
        snprintf(error, 256, "%.100s: %.150s", m->name,
                 m->mesh == MESH_FAILED ? m->mesh_error : "its file was not read yet");
        return NULL;
    }
    snprintf(key, sizeof key, "%s/mesh", m->key);
    struct cache_entry *e = cache_get(m->server->files, key, &fresh);
    if (fresh) {
        cache_hold(e); // one for the opening, one for the caller
        model_preview_path(m->server, m->id, path);
        model_start_opening(m, e, path, true);
    }
    return e;
}
