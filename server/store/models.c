// SPDX-License-Identifier: MIT
// The registry: the list of models, their names, and the files of --models. Opening is in
// model_open.c, the catalogue in catalogue.c; how a LOAD becomes a model is in op_load.c.
#include "store/model_files.h"

#include "core/access.h"
#include "core/log.h"
#include "frame.h"
#include "prt/bake.h"
#include "relight.pb-c.h"
#include "render/shared/poses.h"
#include "store/disk.h"
#include "store/versions.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>

struct models {
    struct server *server;
    struct model *model;
    uint32_t last_key;
};

enum { MAX_FAILED = 256, MAX_ALIAS = 256, MIN_PREFIX = 8 };

struct server *models_server(const struct models *models)
{
    return models->server;
}

struct model *models_next(const struct models *models, const struct model *model)
{
    return model ? model->next : models->model;
}

// ---- names

bool name_matches(const char *name, const char *text)
{
    size_t n = strlen(text);
    const char *dot = strrchr(name, '.');
    return !strcmp(name, text) || (dot && (size_t)(dot - name) == n && !strncmp(name, text, n));
}

static const struct model_alias *alias_of(const struct model *m, const char *owner)
{
    const struct model_alias *a = m->alias;
    while (a && strcmp(a->owner, owner)) a = a->next;
    return a;
}

const char *model_name_for(const struct model *m, const char *asker)
{
    const struct model_alias *a = alias_of(m, asker);
    return a ? a->name : m->name;
}

bool model_set_name(struct model *m, const char *owner, const char *name)
{
    struct model_alias *a = (struct model_alias *)alias_of(m, owner);
    unsigned n = 0;
    if (!strcmp(m->owner, owner)) {
        bool other = strcmp(m->name, name) != 0;
        snprintf(m->name, sizeof m->name, "%s", name);
        if (other) model_publish(m, RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED, "");
        return other;
    }
    // Also where the owner calls it so: that one's name may change, and a third may give it.
    if (a && !strcmp(a->name, name)) return false;
    for (const struct model_alias *b = m->alias; b; b = b->next) n++;
    if (!a && n < MAX_ALIAS && (a = calloc(1, sizeof *a))) {
        snprintf(a->owner, sizeof a->owner, "%s", owner);
        a->next = m->alias;
        m->alias = a;
    }
    if (a) snprintf(a->name, sizeof a->name, "%s", name);
    return a != NULL;
}

bool model_is_named(const struct model *m)
{
    return !m->replaced && !m->removed && !m->replaces[0];
}

static bool is_own(const struct model *m, const char *asker, const char *text)
{
    const struct model_alias *a = alias_of(m, asker);
    return model_is_named(m) && ((a && name_matches(a->name, text)) ||
                                 (!strcmp(m->owner, asker) && name_matches(m->name, text)));
}

static bool is_of_folder(const struct model *m, const char *asker, const char *text)
{
    const struct indexed *at = NULL;
    const struct import_copy *copy = m->copy;
    while (copy && (copy = import_called(m->server->imports, text, &at)))
        if (copy == m->copy) return true;
    return false;
}

static bool has_prefix(const struct model *m, const char *asker, const char *text)
{
    size_t n = strlen(text);
    return n >= MIN_PREFIX && !strncmp(m->id, text, n);
}

static bool is_named(const struct model *m, const char *asker, const char *text)
{
    if (!model_is_named(m)) return false;
    if (!m->copy && name_matches(m->name, text)) return true;
    for (const struct model_alias *a = m->alias; a; a = a->next)
        if (name_matches(a->name, text)) return true;
    return false;
}

static void say_ambiguous(const struct models *models, const char *asker, const char *text,
                          bool (*fits)(const struct model *, const char *, const char *),
                          unsigned n, char error[256])
{
    int at = snprintf(error, 256, "%.60s: %u models are called so; use an id:", text, n);
    for (struct model *m = models->model; m && at < 200; m = m->next)
        if (fits(m, asker, text))
            at += snprintf(error + at, (size_t)(256 - at), " %.*s", MODEL_SHOWN, m->id);
}

// The only model whose name begins with the text, else the nearest name for the error.
static struct model *find_beginning(struct models *models, const char *asker, const char *text,
                                    char error[256])
{
    size_t n = 0;
    char remedy[160] = "";
    int found = -1;
    for (struct model *m = models->model; m; m = m->next) n++;
    const char **name = calloc(n + 1, sizeof *name);
    struct model **model = calloc(n + 1, sizeof *model);
    n = 0;
    for (struct model *m = models->model; m && name && model; m = m->next) {
        if (!model_is_named(m)) continue;
        model[n] = m;
        name[n++] = model_name_for(m, asker);
    }
    if (n) found = prt_name_choose(text, name, (unsigned)n, remedy, sizeof remedy);
    struct model *m = found < 0 ? NULL : model[found];
    if (!m)
        snprintf(error, 256, "%.80s: no such model%s%s", text, remedy[0] ? "; " : "", remedy);
    free(name);
    free(model);
    return m;
}

// Whether is_of_folder may be true of a model.
static bool is_file_name(const struct models *models, const char *text)
{
    const struct indexed *at = NULL;
    return import_called(models->server->imports, text, &at) != NULL;
}

// Whether the second is to be taken of two models that differ in the version that baked them.
static bool is_better_kin(const struct model *m, const struct model *other)
{
    bool ready = m->state == RELIGHT__MODEL_STATE__MODEL_READY;
    bool other_ready = other->state == RELIGHT__MODEL_STATE__MODEL_READY;
    return ready == other_ready ? other->bake_version > m->bake_version : other_ready;
}

static bool are_kin(const struct model *m, const struct model *other)
{
    return m->kin[0] && !strcmp(m->kin, other->kin);
}

struct model *models_kin(const struct models *models, const char *kin)
{
    struct model *found = NULL;
    for (struct model *m = kin[0] ? models->model : NULL; m; m = m->next)
        if (!strcmp(m->kin, kin) && (!found || is_better_kin(found, m))) found = m;
    return found;
}

struct model *models_find(struct models *models, const char *asker, const char *text,
                          char error[256])
{
    // In this order, so that no principal's names hide an id, another's own models or the
    // folder's.
    static bool (*const each[])(const struct model *, const char *,
                                const char *) = {is_own, is_of_folder, has_prefix, is_named};
    struct model *found = models_get(models, text);
    if (!found && models->server->kin_of)
        found = models_kin(models, models->server->kin_of(models->server, text));
    if (is_guest(asker)) {
        const struct server *s = models->server;
        if (found && s->guest_may_see && s->guest_may_see(s, asker, text)) return found;
        snprintf(error, 256, "%.40s: no model of the room that you are invited to", text);
        return NULL;
    }
    if (found) return found;
    for (int i = 0; i < 4; i++) {
        unsigned n = 0;
        if (each[i] == is_of_folder) {
            found = models_get(models, versions_find(models->server->versions, text));
            if (found) return found;
            if (!is_file_name(models, text)) continue;
        }
        for (struct model *m = models->model; m; m = m->next)
            if (each[i](m, asker, text)) {
                bool kin = found && are_kin(found, m);
                if (!kin || is_better_kin(found, m)) found = m;
                n += !kin;
            }
        if (n == 1) return found;
        if (!n) continue;
        say_ambiguous(models, asker, text, each[i], n, error);
        return NULL;
    }
    return find_beginning(models, asker, text, error);
}

struct model *models_get(const struct models *models, const char *id)
{
    struct model *m = models->model;
    while (m && strcmp(m->id, id)) m = m->next;
    return m;
}

bool model_is_last(const struct model *m)
{
    const struct model *other = models_get(m->server->models, m->id);
    return !other || other == m;
}

// ---- coming and going

static void charge_entry(const struct model *m, bool add)
{
    struct principal *p = ledger_principal(m->server->ledger, m->owner);
    if (!p) return;
    if (add) ledger_force(p, LEDGER_MODELS, 1);
    else if (p->held[LEDGER_MODELS]) ledger_give(p, LEDGER_MODELS, 1);
    principal_release(p);
}

void model_take_out(struct model *m)
{
    struct model **at = &m->server->models->model;
    while (*at && *at != m) at = &(*at)->next;
    if (!*at) return;
    *at = m->next;
    __atomic_store_n(&m->gone, true, __ATOMIC_RELAXED); // threads read it
    poses_forget(m->server->poses, m);
    model_publish(m, RELIGHT__EVENT_KIND__EVENT_MODEL_REMOVED, "");
    charge_entry(m, false);
    model_release(m);
}

// Failures are kept for later requests, but not for ever, unless a room needs the preview.
static void forget_failures(struct models *models)
{
    unsigned n = 0;
    for (struct model *m = models->model, *next; m; m = next) {
        next = m->next;
        bool failed = m->state == RELIGHT__MODEL_STATE__MODEL_FAILED && m->users == 1 &&
                      !holds_has(models->server->holds, m->id);
        if (!failed || ++n <= MAX_FAILED) continue;
        model_unload(m, true);
    }
}

struct model *model_add(struct models *models, const char *id, const char *name,
                        const char *owner)
{
    forget_failures(models);
    struct model *m = calloc(1, sizeof *m);
    if (!m) return NULL;
    m->server = models->server;
    m->state = RELIGHT__MODEL_STATE__MODEL_RECEIVED;
    m->generation = m->baked_generation = 1;
    m->bake_version = PRT_BAKE_VERSION;
    m->users = 1; // the registry
    m->used_ns = wall_ns();
    snprintf(m->id, sizeof m->id, "%s", id);
    snprintf(m->name, sizeof m->name, "%s", name);
    snprintf(m->owner, sizeof m->owner, "%s", owner);
    m->serial = ++models->last_key;
    snprintf(m->key, sizeof m->key, "%s.%08x", id, m->serial);
    m->next = models->model;
    models->model = m;
    charge_entry(m, true);
    model_publish(m, RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED, "");
    return m;
}

void model_bake_path(const struct server *server, const char *id, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/bakes/%s.prt", server->data, id);
}

void model_preview_path(const struct server *server, const char *id, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/previews/%s.prt", server->data, id);
}

void model_hold(struct model *m)
{
    m->users++;
}

void model_release(struct model *m)
{
    if (!m || --m->users) return;
    if (m->file) model_forget_results(m, true);
    model_drop_draft(m);
    cache_release(m->pin);
    pose_release(m->pose);
    import_release(m->server->imports, m->copy);
    for (struct model_alias *a = m->alias, *next; a; a = next) {
        next = a->next;
        free(a);
    }
    free(m->variant);
    free(m->warnings);
    free(m->source);
    free(m->file);
    free(m->load);
    free(m);
}

// ---- drafts

void model_take_draft(struct model *m, const char *path, bool single_follows)
{
    struct stat st;
    struct model *d = stat(path, &st) ? NULL : calloc(1, sizeof *d);
    if (!d || !(d->file = strdup(path))) {
        free(d);
        return; // image-space engines answer until the bake is ready
    }
    model_drop_draft(m);
    d->server = m->server;
    d->state = RELIGHT__MODEL_STATE__MODEL_READY;
    d->users = 1; // of m
    d->single_follows = single_follows;
    d->used_ns = wall_ns();
    d->bake_bytes = (uint64_t)st.st_size; // the bake's folder is charged with them
    snprintf(d->id, sizeof d->id, "%s", m->id);
    snprintf(d->name, sizeof d->name, "%s", m->name);
    snprintf(d->owner, sizeof d->owner, "%s", m->owner);
    d->serial = ++m->server->models->last_key;
    snprintf(d->key, sizeof d->key, "%s.%08x", d->id, d->serial);
    m->draft = d;
    log_line(LOG_EVENT, "model id=%s has a draft bytes=%llu", m->id,
             (unsigned long long)d->bake_bytes);
}

void model_drop_draft(struct model *m)
{
    model_release(m->draft);
    m->draft = NULL;
}

struct model *model_answering(struct model *m)
{
    struct model *d =
        m->state == RELIGHT__MODEL_STATE__MODEL_BAKING && !m->gone ? m->draft : NULL;
    if (!d || d->state != RELIGHT__MODEL_STATE__MODEL_READY) return m;
    d->generation = d->baked_generation = m->baked_generation;
    return d;
}

// ---- .prt files of --models

static void id_of_prt(const char *hash, char id[MODEL_ID + 1])
{
    struct relight_sha256 sha;
    char hex[65];
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, "prt", 4);
    relight_sha256_add(&sha, hash, sizeof hex);
    relight_sha256_hex(&sha, hex);
    snprintf(id, MODEL_ID + 1, "%.*s", MODEL_ID, hex);
}

void model_revive(struct model *m)
{
    m->removed = m->replaced = false;
    m->successor[0] = 0;
}

struct model *models_found(struct models *models, struct import_copy *copy, const char *name)
{
    char id[MODEL_ID + 1];
    id_of_prt(copy->hash, id);
    struct model *m = models_get(models, id);
    if (m) model_revive(m);
    if (m || !(m = model_add(models, id, name, DISK_NOBODY))) return m;
    m->state = RELIGHT__MODEL_STATE__MODEL_READY;
    m->copy = copy;
    import_hold(copy);
    log_line(LOG_EVENT, "model id=%s name=\"%s\" found in the models folder", m->id, m->name);
    model_read_header(m);
    return m;
}

struct model *model_successor(const struct model *m)
{
    struct model *next = m->server->models->model;
    if (m->successor[0]) return models_get(m->server->models, m->successor);
    if (!m->copy || import_is_current(m->copy)) return NULL;
    while (next && !(next != m && next->copy && !strcmp(next->name, m->name) &&
                     import_is_current(next->copy)))
        next = next->next;
    return next;
}

void model_supersede(struct model *m, struct model *next)
{
    if (m == next || m->replaced) return;
    m->replaced = true;
    snprintf(m->successor, sizeof m->successor, "%s", next->id);
    log_line(LOG_EVENT, "model id=%s name=\"%s\" is replaced by id=%s", m->id, m->name,
             next->id);
    model_publish(next, RELIGHT__EVENT_KIND__EVENT_MODEL_REPLACED, m->id);
    if (!m->copy) model_remember(m);
    model_changed(m);
}

// The file of a .prt has other content, or is gone.
static void look_for_file(struct model *m)
{
    if (!m->copy || import_is_current(m->copy)) return;
    struct model *next = m->replaced ? NULL : model_successor(m);
    if (next) model_supersede(m, next);
    m->removed |= !m->replaced;
}

// The bake of a version that was removed stays on the disk until its room is needed: the file
// may come back, such as that of a server that was away.
static bool keeps_bake(const struct model *m)
{
    return !m->copy && !m->replaced && m->state == RELIGHT__MODEL_STATE__MODEL_READY;
}

void models_drop_replaced(struct models *models)
{
    for (struct model *m = models->model, *next; m; m = next) {
        next = m->next;
        look_for_file(m);
        if (!m->replaced && !m->removed) continue;
        m->pinned = false;
        cache_release(m->pin);
        m->pin = NULL;
        if (m->users > 1 || keeps_bake(m) || holds_has(models->server->holds, m->id)) continue;
        struct import_copy *copy = m->copy;
        bool other = m->replaced;
        if (copy) import_hold(copy);
        log_line(LOG_EVENT, "model id=%s name=\"%s\" %s", m->id, m->name,
                 other ? "has another version" : "has no file any more");
        model_unload(m, true);
        if (copy && !copy->users && other) import_evict(models->server->imports, copy);
        import_release(models->server->imports, copy);
    }
}

void models_replaced(struct models *models, struct import_copy *copy, const char *name)
{
    char id[MODEL_ID + 1];
    id_of_prt(copy->hash, id);
    if (models_get(models, id) || !holds_has(models->server->holds, id)) return;
    struct model *m = models_found(models, copy, name);
    if (m) m->removed = true;
}

void models_keep_pages(const struct server *server)
{
    const uint64_t most = 64 << 20, quarter = server->options.memory / 4;
    prt_file_keep_pages((size_t)(quarter < most ? quarter : most));
}

int models_create(struct server *server, struct models **out)
{
    struct models *models = calloc(1, sizeof *models);
    if (!models) return PRT_NOMEM;
    models->server = server;
    server->models = models;
    *out = models;
    models_keep_pages(server);
    int status = file_queue_create(server->work, &server->file_queue);
    if (!status) status = versions_create(models, &server->versions);
    if (!status) status = imports_create(server, &server->imports);
    if (status) return status;
    return catalogue_read(models);
}

void models_start(struct models *models)
{
    imports_start(models->server->imports, 10);
    // Pinned models are opened at start.
    for (struct model *m = models->model; m; m = m->next) {
        int code;
        char error[256];
        if (m->pinned) cache_release(model_open(m, &code, error));
    }
}

void models_destroy(struct models *models)
{
    if (!models) return;
    struct server *server = models->server;
    for (struct model *m = models->model, *next; m; m = next) {
        next = m->next;
        model_release(m);
    }
    imports_destroy(server->imports);
    versions_destroy(server->versions);
    file_queue_destroy(server->file_queue);
    free(models);
}
