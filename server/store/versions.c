// SPDX-License-Identifier: MIT
// The table of NAME/VERSION: what the scans of --models find, and which model answers under
// each name.
#include "store/versions.h"

#include "core/log.h"
#include "relight.pb-c.h"
#include "store/disk.h"
#include "store/model_files.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { GONE_AFTER = 2 };

// NAME and the model that it stood for last.
struct name {
    struct name *next;
    char text[256], model[MODEL_ID + 1];
};

struct versions {
    struct models *models;
    struct version *version;
    struct name *name;
    bool scanned; // once at least
};

int versions_create(struct models *models, struct versions **out)
{
    struct versions *versions = calloc(1, sizeof *versions);
    if (!versions) return PRT_NOMEM;
    versions->models = models;
    *out = versions;
    return PRT_OK;
}

static void free_version(struct version *v)
{
    free(v->name);
    free(v->path);
    free(v->settings);
    free(v);
}

void versions_destroy(struct versions *versions)
{
    if (!versions) return;
    for (struct version *v = versions->version, *next; v; v = next) {
        next = v->next;
        free_version(v);
    }
    for (struct name *n = versions->name, *next; n; n = next) {
        next = n->next;
        free(n);
    }
    free(versions);
}

struct version *versions_next(const struct versions *versions, const struct version *v)
{
    return v ? v->next : versions->version;
}

struct version *versions_get(const struct versions *versions, const char *name)
{
    struct version *v = versions->version;
    while (v && strcmp(v->name, name)) v = v->next;
    return v;
}

// ---- names

static bool is_of(const struct version *v, const char *name)
{
    size_t n = strlen(name);
    return !strncmp(v->name, name, n) && v->name[n] == '/';
}

bool versions_is_name(const struct versions *versions, const char *text)
{
    for (const struct version *v = versions->version; v; v = v->next)
        if (is_of(v, text)) return true;
    return false;
}

// 0: it has no model, 1: one that cannot answer, 2: a preview while it bakes, 3: one that is
// complete.
static int rank(const struct models *models, const struct version *v)
{
    const struct model *m = v->model[0] ? models_get(models, v->model) : NULL;
    if (!m) return 0;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY) return 3;
    if (m->mesh != MESH_THERE) return 1;
    return m->state == RELIGHT__MODEL_STATE__MODEL_PREVIEW ? 3 : 2;
}

// The newest of NAME's versions among those of the highest rank.
static const char *newest(const struct versions *versions, const char *name)
{
    const struct version *best = NULL;
    int highest = 0;
    for (const struct version *v = versions->version; v; v = v->next) {
        int r = is_of(v, name) ? rank(versions->models, v) : 0;
        if (!r || r < highest) continue;
        if (best && r == highest && strverscmp(v->name, best->name) < 0) continue;
        best = v;
        highest = r;
    }
    return best ? best->model : "";
}

const char *versions_find(const struct versions *versions, const char *text)
{
    const struct version *v = versions_get(versions, text);
    return v ? v->model : newest(versions, text);
}

static struct name *name_of(struct versions *versions, const struct version *v)
{
    size_t n = strcspn(v->name, "/");
    struct name *name = versions->name;
    while (name && (strncmp(name->text, v->name, n) || name->text[n])) name = name->next;
    if (name || n >= sizeof name->text || !(name = calloc(1, sizeof *name))) return name;
    memcpy(name->text, v->name, n);
    name->next = versions->name;
    return versions->name = name;
}

// Views that were opened under NAME go over to the version that it stands for by now.
static void renew(struct versions *versions, struct name *name)
{
    const char *after = name ? newest(versions, name->text) : "";
    if (!after[0] || !strcmp(name->model, after)) return;
    struct model *old = models_get(versions->models, name->model);
    const struct model *next = models_get(versions->models, after);
    snprintf(name->model, sizeof name->model, "%s", after);
    log_line(LOG_EVENT, "version name=%s is now model=%s", name->text, after);
    if (!old || !next) return;
    if (!old->replaced) model_publish(next, RELIGHT__EVENT_KIND__EVENT_MODEL_REPLACED, old->id);
    model_changed(old);
}

// ---- models

// Whether another version has the model, too: two folders may hold the same.
static bool is_shared(const struct versions *versions, const struct version *v)
{
    for (const struct version *w = versions->version; w; w = w->next)
        if (w != v && !strcmp(w->model, v->model)) return true;
    return false;
}

static void pin(struct model *m)
{
    int code;
    char error[256];
    m->pinned = true;
    if (m->state == RELIGHT__MODEL_STATE__MODEL_READY)
        cache_release(model_open(m, &code, error));
}

// A client has uploaded the same content: the model is that client's and stays.
static bool is_uploaded(const struct model *m)
{
    return !m->source && strcmp(m->owner, DISK_NOBODY) != 0;
}

void version_answers(struct versions *versions, struct version *v, struct model *m)
{
    struct model *old = NULL;
    if (v->pin && !m->pinned) pin(m);
    model_revive(m);
    if (v->model[0] && strcmp(v->model, m->id) && !is_shared(versions, v))
        old = models_get(versions->models, v->model);
    if (strcmp(v->model, m->id))
        log_line(LOG_EVENT, "version name=%s model=%s", v->name, m->id);
    snprintf(v->model, sizeof v->model, "%s", m->id);
    if (old && !is_uploaded(old)) model_supersede(old, m);
    renew(versions, name_of(versions, v));
}

static void removed(struct versions *versions, struct version **at)
{
    struct version *v = *at;
    struct name *name = name_of(versions, v);
    struct model *m =
        v->model[0] && !is_shared(versions, v) ? models_get(versions->models, v->model) : NULL;
    log_line(LOG_EVENT, "version name=%s is gone", v->name);
    *at = v->next;
    free_version(v);
    renew(versions, name);
    if (!m || m->copy || is_uploaded(m)) return; // a .prt is removed with its file: imports.h
    m->removed = true;
    // A bake in progress is for nothing.
    if (m->state != RELIGHT__MODEL_STATE__MODEL_READY) model_unload(m, true);
    else model_changed(m);
}

// ---- scans

static bool same_text(const char *a, const char *b)
{
    return a && b ? !strcmp(a, b) : a == b;
}

static bool is_pinned(const char *settings)
{
    cJSON *json = settings ? cJSON_Parse(settings) : NULL;
    bool pin = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "pin"));
    cJSON_Delete(json);
    return pin;
}

static bool take(struct version *v, const struct import_entry *e)
{
    char *path = strdup(e->name), *settings = e->settings ? strdup(e->settings) : NULL;
    if (!path || (e->settings && !settings)) {
        free(path);
        free(settings);
        return false;
    }
    free(v->path);
    free(v->settings);
    v->path = path;
    v->settings = settings;
    v->prt = e->prt;
    v->pin = is_pinned(settings);
    snprintf(v->stamp, sizeof v->stamp, "%s", e->stamp);
    return true;
}

static struct version *add(struct versions *versions, const char *name)
{
    struct version *v = calloc(1, sizeof *v);
    if (!v || !(v->name = strdup(name))) {
        free(v);
        return NULL;
    }
    v->next = versions->version;
    return versions->version = v;
}

static void look_at(struct versions *versions, const struct import_entry *e)
{
    struct version *v = versions_get(versions, e->version);
    if (!v && !(v = add(versions, e->version))) return;
    v->missed = 0;
    if (strcmp(v->fault, e->fault) && e->fault[0])
        log_line(LOG_WARN, "version name=%s error=\"%s\"", v->name, e->fault);
    snprintf(v->fault, sizeof v->fault, "%s", e->fault);
    bool same = v->path && !strcmp(v->path, e->name) && !strcmp(v->stamp, e->stamp) &&
                same_text(v->settings, e->settings);
    if (e->fault[0]) {
        // It was not loaded: the scan that finds no fault treats it as a new version.
        if (v->state == VERSION_SETTLING || v->state == VERSION_WANTED) v->stamp[0] = 0;
        v->state = VERSION_IDLE;
    } else if (!same && take(v, e)) {
        // A file that is still being written has other times in the next scan.
        v->state = v->prt              ? VERSION_IDLE
                   : versions->scanned ? VERSION_SETTLING
                                       : VERSION_WANTED;
    } else if (same && v->state == VERSION_SETTLING) {
        v->state = VERSION_WANTED;
    }
}

void versions_scanned(struct versions *versions, const struct import_entry *entry, size_t n)
{
    for (struct version *v = versions->version; v; v = v->next) v->missed++;
    for (size_t i = 0; i < n; i++)
        if (entry[i].version) look_at(versions, &entry[i]);
    versions->scanned = true;
    for (struct version **at = &versions->version; *at;)
        if ((*at)->missed >= GONE_AFTER) removed(versions, at);
        else at = &(*at)->next;
}
