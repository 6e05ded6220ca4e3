// SPDX-License-Identifier: MIT
// The table of --models' files and of their copies. Copying has a queue of its own,
// one file at a time, so that it holds one worker at most. Above 600 lines: table, scan and
// queue share the lifetime of a copy.
#include "store/imports.h"

#include "core/log.h"
#include "frame.h"
#include "relight.pb-c.h"
#include "core/server.h"
#include "store/disk.h"
#include "store/eviction.h"
#include "store/file_queue.h"
#include "store/import_file.h"
#include "store/model_files.h"
#include "store/versions.h"

#include <cjson/cJSON.h>
#include <dirent.h>
#include <errno.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/inotify.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const uint64_t settle_ns = 100000000u, retry_ns = 2000000000u;

enum { BUCKETS = 1024, GONE_AFTER = 2 }; // scans that did not find a file

// A path below --models and the content it had when it was last copied.
struct indexed {
    struct indexed *next;  // of all
    struct indexed *chain; // of its bucket
    char *path;
    char stamp[IMPORT_STAMP]; // of the file when it was copied
    char
        refused[IMPORT_STAMP]; // of a later one that cannot be used, until it changes; "": none
    struct import_copy *copy;  // NULL: no file of this path could be used
    unsigned missed;           // scans, one after another, that did not find the file
    bool version;              // it is the model of a folder NAME/VERSION
};

struct copying {
    struct file_task task; // first
    struct copying *next;
    struct imports *imports;
    char path[PATH_MAX], owner[96];
    struct import_copy *known;
    char known_stamp[IMPORT_STAMP];
    struct import_request *waiting;
    bool scanned; // the folder's scan waits for it: no client's end stops it
    atomic_bool stop;
    struct import_file file;
};

struct imports {
    struct server *server;
    struct file_queue *queue;
    char folder[PATH_MAX];
    struct indexed *index, *bucket[BUCKETS];
    uint64_t seed;
    imports_scanned_fn scanned;
    void *scanned_user;
    struct import_copy *copy;
    struct copying *copying;
    struct copying *ended; // the one whose waiters are being told
    struct import_listed *listed;
    size_t n_listed;
    struct loop_timer timer;
    struct loop_watch watch; // inotify; fd -1: none
    bool scanning, stopped;
    bool again; // a change was reported during the scan
};

struct scan {
    struct file_task task; // first
    struct imports *imports;
    struct import_list list;
};

int64_t wall_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    return (int64_t)t.tv_sec * 1000000000 + t.tv_nsec;
}

// ---- copies

static struct import_copy *find_copy(const struct imports *imports, const char *hash)
{
    struct import_copy *copy = imports->copy;
    while (copy && strcmp(copy->hash, hash)) copy = copy->next;
    return copy;
}

static struct import_copy *make_entry(struct imports *imports, const char *hash)
{
    struct import_copy *copy = find_copy(imports, hash);
    if (!copy && (copy = calloc(1, sizeof *copy))) {
        snprintf(copy->hash, sizeof copy->hash, "%s", hash);
        copy->next = imports->copy;
        imports->copy = copy;
    }
    if (copy) copy->refs++;
    return copy;
}

void import_hold(struct import_copy *copy)
{
    copy->refs++;
}

// An entry without its file is freed with its last reference. A file without a reference stays
// for later requests until its room is needed.
static void free_unused(struct imports *imports, struct import_copy *copy)
{
    if (copy->refs || copy->present) return;
    struct import_copy **at = &imports->copy;
    while (*at != copy) at = &(*at)->next;
    *at = copy->next;
    free(copy);
}

void import_release(struct imports *imports, struct import_copy *copy)
{
    if (!copy) return;
    copy->refs--;
    free_unused(imports, copy);
}

void import_use(struct import_copy *copy)
{
    copy->refs++;
    copy->users++;
    copy->used_ns = wall_ns();
}

void import_unuse(struct import_copy *copy)
{
    copy->users--;
    copy->refs--; // the index or a model refers to it, or the file is there
}

void import_path(const struct imports *imports, const char *hash, char *path, size_t n)
{
    snprintf(path, n, "%s/imports/%s", imports->server->data, hash);
}

struct import_copy *imports_next(const struct imports *imports, const struct import_copy *copy)
{
    return copy ? copy->next : imports->copy;
}

static void write_index(struct imports *imports);

void import_evict(struct imports *imports, struct import_copy *copy)
{
    char path[PATH_MAX];
    if (!copy->present) return;
    import_path(imports, copy->hash, path, sizeof path);
    disk_charge(imports->server->ledger, copy->owner, -(int64_t)disk_size(copy->bytes));
    copy->present = false;
    file_remove(imports->queue, path); // before a copying that comes after
    write_index(imports);
    free_unused(imports, copy);
}

// ---- the index

static const char *base_name(const char *path)
{
    const char *slash = strrchr(path, '/');
    return slash ? slash + 1 : path;
}

static struct indexed **bucket_of(const struct imports *imports, const char *path)
{
    uint64_t hash = prt_hash64(path, strlen(path), imports->seed);
    return (struct indexed **)&imports->bucket[hash % BUCKETS];
}

static struct indexed *find_indexed(const struct imports *imports, const char *path)
{
    struct indexed *x = *bucket_of(imports, path);
    while (x && strcmp(x->path, path)) x = x->chain;
    return x;
}

const char *import_source(const struct imports *imports, const char *hash)
{
    const char *gone = NULL;
    for (const struct indexed *x = imports->index; x; x = x->next) {
        if (!x->copy || strcmp(x->copy->hash, hash)) continue;
        if (!x->missed) return x->path;
        gone = x->path;
    }
    return gone;
}

bool import_is_current(const struct import_copy *copy)
{
    return copy->paths > 0;
}

const struct import_copy *import_called(const struct imports *imports, const char *text,
                                        const struct indexed **at)
{
    for (const struct indexed *x = *at ? (*at)->next : imports->index; x; x = x->next)
        if (x->copy && !x->version && name_matches(base_name(x->path), text)) {
            *at = x;
            return x->copy;
        }
    return NULL;
}

// Whether the file was looked at when it was as the stamp says.
static bool is_known(const struct indexed *x, const char *stamp)
{
    return !strcmp(x->stamp, stamp) || !strcmp(x->refused, stamp);
}

static struct indexed *add_indexed(struct imports *imports, const char *path)
{
    struct indexed *x = find_indexed(imports, path), **bucket = bucket_of(imports, path);
    if (x || !(x = calloc(1, sizeof *x))) return x;
    if (!(x->path = strdup(path))) {
        free(x);
        return NULL;
    }
    x->chain = *bucket;
    *bucket = x;
    x->next = imports->index;
    imports->index = x;
    return x;
}

// Versions are called by their folders, other files by their own name.
static void name_model(const char *path, bool version, char name[128])
{
    char folders[PATH_MAX];
    size_t n = (size_t)(base_name(path) - path);
    snprintf(folders, sizeof folders, "%.*s", (int)(n ? n - 1 : 0), path);
    name_printable(version ? folders : base_name(path), name, 128);
}

static void set_copy(struct imports *imports, struct indexed *x, struct import_copy *copy)
{
    char name[128];
    if (copy) {
        import_hold(copy);
        copy->paths++;
    }
    if (x->copy && !--x->copy->paths && x->copy->present && x->copy->prt) {
        name_model(x->path, x->version, name);
        models_replaced(imports->server->models, x->copy, name);
    }
    import_release(imports, x->copy);
    x->copy = copy;
}

// The file is gone. Its copy stays until its room is needed.
static void remove_indexed(struct imports *imports, struct indexed **at)
{
    struct indexed *x = *at, **chain = bucket_of(imports, x->path);
    log_line(LOG_EVENT, "models folder path=%s is gone", x->path);
    while (*chain != x) chain = &(*chain)->chain;
    *chain = x->chain;
    *at = x->next;
    set_copy(imports, x, NULL);
    free(x->path);
    free(x);
}

// Copies of .prt files that rooms need and that are no file's content any more.
static void write_replaced(struct imports *imports, cJSON *all)
{
    struct server *server = imports->server;
    for (struct model *m = NULL; (m = models_next(server->models, m));) {
        const struct import_copy *copy = m->copy;
        if (!copy || !copy->present || copy->paths || !holds_has(server->holds, m->id))
            continue;
        cJSON *one = cJSON_CreateObject();
        cJSON_AddStringToObject(one, "replaced", m->name);
        cJSON_AddStringToObject(one, "hash", copy->hash);
        cJSON_AddStringToObject(one, "owner", copy->owner);
        cJSON_AddBoolToObject(one, "prt", copy->prt);
        cJSON_AddItemToArray(all, one);
    }
}

// DATA/imports/index.json: which files the copies are of, so that a restart copies nothing.
static void write_index(struct imports *imports)
{
    char path[PATH_MAX];
    cJSON *all = cJSON_CreateArray();
    for (const struct indexed *x = imports->index; x; x = x->next) {
        if (!x->copy || !x->copy->present) continue;
        cJSON *one = cJSON_CreateObject();
        cJSON_AddStringToObject(one, "path", x->path);
        cJSON_AddStringToObject(one, "stamp", x->stamp);
        cJSON_AddStringToObject(one, "hash", x->copy->hash);
        cJSON_AddStringToObject(one, "owner", x->copy->owner);
        cJSON_AddBoolToObject(one, "prt", x->copy->prt);
        cJSON_AddItemToArray(all, one);
    }
    write_replaced(imports, all);
    snprintf(path, sizeof path, "%s/imports/index.json", imports->server->data);
    file_write(imports->queue, path, cJSON_Print(all));
    cJSON_Delete(all);
}

static const char *text_of(const cJSON *json, const char *key)
{
    const char *text = cJSON_GetStringValue(cJSON_GetObjectItemCaseSensitive(json, key));
    return text ? text : "";
}

static void recall_copy(struct imports *imports, struct import_copy *copy, const cJSON *json,
                        const struct stat *st)
{
    if (copy->present) return;
    copy->present = true;
    copy->prt = cJSON_IsTrue(cJSON_GetObjectItemCaseSensitive(json, "prt"));
    copy->bytes = (uint64_t)st->st_size;
    copy->used_ns = (int64_t)st->st_mtim.tv_sec * 1000000000 + st->st_mtim.tv_nsec;
    snprintf(copy->owner, sizeof copy->owner, "%s",
             text_of(json, "owner")[0] ? text_of(json, "owner") : DISK_NOBODY);
    disk_charge(imports->server->ledger, copy->owner, (int64_t)disk_size(copy->bytes));
}

static void read_entry(struct imports *imports, const cJSON *json)
{
    char path[PATH_MAX];
    struct stat st;
    const char *hash = text_of(json, "hash"), *replaced = text_of(json, "replaced");
    if (!relight_hash_valid(hash) || (!text_of(json, "path")[0] && !*replaced)) return;
    import_path(imports, hash, path, sizeof path);
    if (stat(path, &st) || !S_ISREG(st.st_mode)) return;
    struct indexed *x = *replaced ? NULL : add_indexed(imports, text_of(json, "path"));
    struct import_copy *copy = make_entry(imports, hash);
    if (copy && (x || *replaced)) recall_copy(imports, copy, json, &st);
    if (copy && *replaced && copy->prt)
        models_replaced(imports->server->models, copy, replaced);
    if (x && copy) {
        snprintf(x->stamp, sizeof x->stamp, "%s", text_of(json, "stamp"));
        set_copy(imports, x, copy);
    }
    import_release(imports, copy);
}

// At start: files that the index does not name are leftovers of a killed copy.
static void read_index(struct imports *imports)
{
    char folder[PATH_MAX], path[PATH_MAX];
    struct prt_blob blob;
    import_path(imports, "index.json", path, sizeof path);
    if (!access(path, R_OK) && !prt_read_file(NULL, path, 64 << 20, &blob)) {
        cJSON *all = cJSON_ParseWithLength(blob.bytes, blob.size);
        const cJSON *one;
        prt_free(blob.bytes);
        cJSON_ArrayForEach(one, all) read_entry(imports, one);
        cJSON_Delete(all);
    }
    snprintf(folder, sizeof folder, "%s/imports", imports->server->data);
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));)
        if (d->d_name[0] != '.' || !strncmp(d->d_name, ".tmp-", 5))
            if (strcmp(d->d_name, "index.json") && !find_copy(imports, d->d_name))
                unlinkat(dirfd(dir), d->d_name, 0);
    if (dir) closedir(dir);
}

// ---- copying

static int run_copying(struct file_task *task)
{
    struct copying *c = (struct copying *)task;
    struct server *server = c->imports->server;
    char to[PATH_MAX];
    if (snprintf(to, sizeof to, "%s/imports", server->data) >= PATH_MAX) return PRT_IO;
    import_copy_file(c->imports->folder, c->path, to, c->known ? c->known->hash : "",
                     c->known_stamp, server->options.disk ? server->options.disk : UINT64_MAX,
                     &c->stop, &c->file);
    return PRT_OK;
}

static void tell(struct copying *c, struct import_copy *copy, int code, const char *error)
{
    struct import_request *r;
    while ((r = c->waiting)) {
        c->waiting = r->next;
        r->done(r, copy, c->file.name, c->file.n_name, code, error);
    }
}

// A .prt is a model.
static void found(struct imports *imports, struct import_copy *copy, const char *path,
                  bool version)
{
    char name[128];
    name_model(path, version, name);
    struct model *m = models_found(imports->server->models, copy, name);
    struct version *v = m && version ? versions_get(imports->server->versions, name) : NULL;
    if (v) version_answers(imports->server->versions, v, m);
}

// The model of the earlier file at this path lives until its last user has ended.
static void take_in(struct copying *c, struct import_copy *copy)
{
    struct imports *imports = c->imports;
    struct indexed *x = add_indexed(imports, c->path);
    if (c->file.copied) {
        if (!copy->present) {
            snprintf(copy->owner, sizeof copy->owner, "%s", c->owner);
            copy->bytes = c->file.bytes;
            disk_charge(imports->server->ledger, copy->owner, (int64_t)disk_size(copy->bytes));
        }
        copy->present = true;
        copy->prt = c->file.prt;
        log_line(LOG_EVENT, "import path=%s hash=%.16s bytes=%llu", c->path, copy->hash,
                 (unsigned long long)copy->bytes);
    }
    if (x) {
        bool other = x->copy != copy || strcmp(x->stamp, c->file.stamp);
        snprintf(x->stamp, sizeof x->stamp, "%s", c->file.stamp);
        x->refused[0] = 0;
        set_copy(imports, x, copy);
        x->missed = 0;
        if (other) write_index(imports);
    }
    if (copy->prt) found(imports, copy, c->path, x && x->version);
}

static void copying_done(struct file_task *task)
{
    struct copying *c = (struct copying *)task, **at;
    struct imports *imports = c->imports;
    const struct import_file *f = &c->file;
    struct import_copy *copy = NULL;
    char error[256] = "";
    int code = task->status ? RELIGHT__ERROR_CODE__ERROR_INTERNAL : f->code;
    for (at = &imports->copying; *at != c;) at = &(*at)->next;
    *at = c->next;
    imports->ended = c;
    if (!code && !(copy = make_entry(imports, f->hash)))
        code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    if (copy) {
        import_use(copy);
        take_in(c, copy);
        evict_for_room(imports->server, NULL, copy->owner);
        if (evict_over(imports->server, copy->owner, error))
            code = RELIGHT__ERROR_CODE__ERROR_LIMIT;
        tell(c, code ? NULL : copy, code, error);
        import_unuse(copy);
        if (code && !copy->users) import_evict(imports, copy);
        import_release(imports, copy);
    } else {
        // Looked at again when it changes; by each scan, where the copying is at fault.
        struct indexed *x = c->scanned && f->lasts ? add_indexed(imports, c->path) : NULL;
        if (x) snprintf(x->refused, sizeof x->refused, "%s", f->stamp);
        if (x && x->copy && x->copy->present && x->copy->prt)
            found(imports, x->copy, c->path, x->version); // goes on with the earlier content
        if (c->scanned) log_line(LOG_WARN, "import path=%s error=\"%s\"", c->path, f->error);
        tell(c, NULL, code, f->error[0] ? f->error : "not enough memory");
    }
    imports->ended = NULL;
    if (c->known) {
        import_unuse(c->known);
        free_unused(imports, c->known);
    }
    import_file_finish(&c->file);
    free(c);
}

static struct copying *start_copying(struct imports *imports, const char *path,
                                     const char *owner)
{
    struct copying *c = imports->copying;
    while (c && (strcmp(c->path, path) || atomic_load(&c->stop))) c = c->next;
    if (c || !(c = calloc(1, sizeof *c))) return c;
    const struct indexed *x = find_indexed(imports, path);
    c->task.run = run_copying;
    c->task.done = copying_done;
    c->imports = imports;
    snprintf(c->path, sizeof c->path, "%s", path);
    snprintf(c->owner, sizeof c->owner, "%s", owner);
    if (x && x->copy && x->copy->present) {
        c->known = x->copy;
        import_use(c->known);
        snprintf(c->known_stamp, sizeof c->known_stamp, "%s", x->stamp);
    }
    c->next = imports->copying;
    imports->copying = c;
    file_queue_add(imports->queue, &c->task);
    return c;
}

void imports_get(struct imports *imports, const char *path, const char *owner,
                 struct import_request *request)
{
    struct copying *c = NULL;
    if (!imports->folder[0]) {
        request->done(request, NULL, NULL, 0, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                      "the daemon serves no models folder (--models): upload the file");
        return;
    }
    if (strlen(path) < PATH_MAX && !imports->stopped) c = start_copying(imports, path, owner);
    if (!c) {
        request->done(request, NULL, NULL, 0, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY,
                      "the file cannot be copied now");
        return;
    }
    request->next = c->waiting;
    c->waiting = request;
}

// False where it does not wait for this one.
static bool take_out(struct copying *c, const struct import_request *request)
{
    struct import_request **at = &c->waiting;
    while (*at && *at != request) at = &(*at)->next;
    if (!*at) return false;
    *at = request->next;
    return true;
}

void imports_cancel(struct imports *imports, struct import_request *request)
{
    if (imports->ended && take_out(imports->ended, request)) return;
    for (struct copying *c = imports->copying; c; c = c->next) {
        if (!take_out(c, request)) continue;
        if (!c->waiting && !c->scanned) atomic_store(&c->stop, true);
        return;
    }
}

// ---- the folder

static int run_scan(struct file_task *task)
{
    struct scan *scan = (struct scan *)task;
    import_list(scan->imports->folder, &scan->list);
    return PRT_OK;
}

static void keep_list(struct imports *imports, const struct import_list *list)
{
    for (size_t i = 0; i < imports->n_listed; i++) free(imports->listed[i].name);
    free(imports->listed);
    imports->n_listed = 0;
    imports->listed = calloc(list->n + 1, sizeof *imports->listed);
    for (size_t i = 0; imports->listed && i < list->n; i++) {
        char name[1024];
        if (!list->entry[i].name[0]) continue;
        name_printable(list->entry[i].name, name, sizeof name);
        struct import_listed *l = &imports->listed[imports->n_listed];
        l->bytes = list->entry[i].bytes;
        if ((l->name = strdup(name))) imports->n_listed++;
    }
}

static void look_at(struct imports *imports, const struct import_entry *e)
{
    struct indexed *x = find_indexed(imports, e->name);
    if (x && is_known(x, e->stamp)) {
        if (x->copy && x->copy->prt) found(imports, x->copy, e->name, e->version != NULL);
        return;
    }
    struct copying *c = start_copying(imports, e->name, DISK_NOBODY);
    if (c) c->scanned = true;
}

// Of the files that were copied before: the scan found them, or did not. The paths of those of
// models that are to be loaded again are added to `changed`.
static size_t compare_known(struct imports *imports, const struct import_list *list,
                            const char **changed)
{
    size_t n = 0;
    bool removed = false;
    for (size_t i = 0; i < list->n_known; i++) {
        const struct import_known *k = &list->known[i];
        struct indexed *x = find_indexed(imports, k->name);
        if (!x) continue;
        x->missed = k->stamp[0] ? 0 : x->missed + 1;
        if (k->stamp[0] && !is_known(x, k->stamp) && !(x->copy && x->copy->prt))
            changed[n++] = k->name;
    }
    for (struct indexed **at = &imports->index; *at;)
        if ((*at)->missed >= GONE_AFTER) {
            remove_indexed(imports, at);
            removed = true;
        } else {
            at = &(*at)->next;
        }
    if (removed) write_index(imports);
    return n;
}

static void take_list(struct imports *imports, const struct import_list *list)
{
    const char **changed = calloc(list->n_known + 1, sizeof *changed);
    log_line(LOG_TRACE, "models folder looked at files=%zu", list->n);
    keep_list(imports, list);
    size_t n_changed = changed ? compare_known(imports, list, changed) : 0;
    versions_scanned(imports->server->versions, list->entry, list->n);
    for (size_t i = 0; i < list->n; i++) {
        const struct import_entry *e = &list->entry[i];
        struct indexed *x = find_indexed(imports, e->name);
        if (e->prt && !x) x = add_indexed(imports, e->name);
        if (x) {
            x->missed = 0;
            x->version = e->version != NULL;
        }
        if (e->prt) look_at(imports, e);
    }
    if (imports->scanned)
        imports->scanned(imports->scanned_user, list->entry, list->n, changed, n_changed);
    models_drop_replaced(imports->server->models);
    free(changed);
}

static void scan_later(struct imports *imports, uint64_t gap_ns)
{
    if (gap_ns) loop_timer_set(imports->server->loop, &imports->timer, loop_now_ns() + gap_ns);
}

static void scan_done(struct file_task *task)
{
    struct scan *scan = (struct scan *)task;
    struct imports *imports = scan->imports;
    imports->scanning = false;
    // A folder that cannot be read now, such as one of a server that is away, loses no model.
    if (!imports->stopped && scan->list.readable) take_list(imports, &scan->list);
    else if (!imports->stopped) log_line(LOG_WARN, "models folder cannot be read");
    if (!imports->stopped) {
        scan_later(imports, (uint64_t)(imports->server->options.poll * 1e9));
        if (imports->again) scan_later(imports, settle_ns);
    }
    imports->again = false;
    import_list_finish(&scan->list);
    free(scan);
}

// The files whose stamps the scan reads besides those that it finds.
static void add_known(const struct imports *imports, struct import_list *list)
{
    size_t n = 0;
    for (const struct indexed *x = imports->index; x; x = x->next) n++;
    list->known = calloc(n + 1, sizeof *list->known);
    for (const struct indexed *x = imports->index; x && list->known; x = x->next)
        if ((list->known[list->n_known].name = strdup(x->path))) list->n_known++;
}

static void scan_now(struct loop_timer *timer)
{
    struct imports *imports =
        (struct imports *)((char *)timer - offsetof(struct imports, timer));
    struct scan *scan = imports->scanning ? NULL : calloc(1, sizeof *scan);
    if (!scan) {
        scan_later(imports, retry_ns);
        return;
    }
    imports->scanning = true;
    add_known(imports, &scan->list);
    scan->imports = imports;
    scan->task.run = run_scan;
    scan->task.done = scan_done;
    file_queue_add(imports->server->file_queue, &scan->task);
}

static void folder_changed(struct loop_watch *watch, uint32_t events)
{
    struct imports *imports =
        (struct imports *)((char *)watch - offsetof(struct imports, watch));
    char text[8192];
    while (read(watch->fd, text, sizeof text) > 0) continue;
    // Several changes at once are one scan.
    imports->again = imports->scanning;
    if (!imports->scanning && !imports->stopped) scan_later(imports, settle_ns);
}

int imports_create(struct server *server, struct imports **out)
{
    struct imports *imports = calloc(1, sizeof *imports);
    if (!imports) return PRT_NOMEM;
    imports->server = server;
    imports->watch.fd = -1;
    *out = imports;
    if (getrandom(&imports->seed, sizeof imports->seed, 0) != sizeof imports->seed)
        return PRT_IO;
    int status = file_queue_create(server->work, &imports->queue);
    if (status) return status;
    if (server->options.models[0] && !realpath(server->options.models, imports->folder))
        imports->folder[0] = 0;
    char path[PATH_MAX];
    import_path(imports, "", path, sizeof path);
    if (mkdir(path, 0700) && errno != EEXIST) {
        log_line(LOG_ERR, "data folder %s: %s", path, strerror(errno));
        return PRT_IO;
    }
    read_index(imports);
    return PRT_OK;
}

void imports_on_scan(struct imports *imports, imports_scanned_fn fn, void *user)
{
    imports->scanned = fn;
    imports->scanned_user = user;
}

void imports_start(struct imports *imports, double seconds)
{
    struct server *server = imports->server;
    if (!imports->folder[0]) return;
    int fd = inotify_init1(IN_NONBLOCK | IN_CLOEXEC);
    if (fd >= 0 && inotify_add_watch(fd, imports->folder,
                                     IN_CLOSE_WRITE | IN_MOVED_TO | IN_MOVED_FROM | IN_DELETE |
                                         IN_ONLYDIR) >= 0) {
        imports->watch = (struct loop_watch){fd, folder_changed};
        if (loop_watch_add(server->loop, &imports->watch, EPOLLIN)) imports->watch.fd = -1;
    }
    if (fd >= 0 && imports->watch.fd < 0) close(fd);
    imports->timer.fire = scan_now;
    scan_now(&imports->timer);
    uint64_t limit = loop_now_ns() + (uint64_t)(seconds * 1e9);
    while ((imports->scanning || imports->copying) && loop_now_ns() < limit &&
           !server->draining)
        loop_turn(server->loop, 50);
}

void imports_stop(struct imports *imports)
{
    if (!imports) return;
    imports->stopped = true;
    loop_timer_stop(imports->server->loop, &imports->timer);
    if (imports->watch.fd >= 0) {
        loop_watch_remove(imports->server->loop, &imports->watch);
        close(imports->watch.fd);
        imports->watch.fd = -1;
    }
    for (struct copying *c = imports->copying; c; c = c->next) atomic_store(&c->stop, true);
}

void imports_destroy(struct imports *imports)
{
    if (!imports) return;
    imports_stop(imports);
    for (struct indexed *x = imports->index, *next; x; x = next) {
        next = x->next;
        free(x->path);
        free(x);
    }
    for (struct import_copy *copy = imports->copy, *next; copy; copy = next) {
        next = copy->next;
        free(copy);
    }
    for (size_t i = 0; i < imports->n_listed; i++) free(imports->listed[i].name);
    free(imports->listed);
    file_queue_destroy(imports->queue);
    free(imports);
}

const struct import_listed *imports_files(const struct imports *imports, size_t *n)
{
    *n = imports->n_listed;
    return imports->listed;
}
