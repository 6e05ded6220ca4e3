// SPDX-License-Identifier: MIT
// The index of blobs: found by hash, kept in the order of last use for each owner and for all,
// checked once after the start, evicted when their room is needed. Above 600 lines: index,
// order and charges change together in each of its steps.
#include "store/blob_index.h"

#include "core/log.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

#define TRASH "trash-" /* begins the name of a file that is being removed */

enum { FIRST_BUCKETS = 256, DIGITS = 12 };

static uint64_t time_ns(const struct timespec *t)
{
    return (uint64_t)t->tv_sec * 1000000000u + (uint64_t)t->tv_nsec;
}

uint64_t blob_clock_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_REALTIME, &t);
    return time_ns(&t);
}

uint64_t blob_charge(uint64_t size)
{
    return disk_size(size) + disk_size(1);
}

void blobs_path(const struct blobs *blobs, const char *hash, char *path, size_t n)
{
    snprintf(path, n, "%s/%s", blobs->folder, hash);
}

// ---- the table; blobs with the same first 12 digits share a bucket

static struct blob **bucket_of(const struct blobs *blobs, const char *hash)
{
    uint64_t x = blobs->seed;
    for (int i = 0; i < DIGITS; i++) x = (x ^ (unsigned char)hash[i]) * 0x9e3779b97f4a7c15u;
    return &blobs->bucket[(x >> 20) % blobs->n_bucket];
}

struct blob *blob_find(const struct blobs *blobs, const char *hash)
{
    struct blob *b = *bucket_of(blobs, hash);
    while (b && strcmp(b->hash, hash)) b = b->chain;
    return b;
}

// Without memory the chains get longer instead.
static void grow(struct blobs *blobs)
{
    struct blob **old = blobs->bucket;
    size_t n = blobs->n_bucket;
    struct blob **fresh = calloc(2 * n, sizeof *fresh);
    if (!fresh) return;
    blobs->bucket = fresh;
    blobs->n_bucket = 2 * n;
    for (size_t i = 0; i < n; i++)
        for (struct blob *b = old[i], *next; b; b = next) {
            struct blob **to = bucket_of(blobs, b->hash);
            next = b->chain;
            b->chain = *to;
            *to = b;
        }
    free(old);
}

// ---- the order of use

static struct blob_lru *lru_of(struct blobs *blobs, struct blob *b, int list)
{
    return list == LRU_ALL ? &blobs->lru : &b->owner->lru;
}

static void leave_order(struct blobs *blobs, struct blob *b)
{
    for (int i = 0; i < LRU_N; i++) {
        struct blob_lru *lru = lru_of(blobs, b, i);
        struct blob *older = b->link[i].older, *newer = b->link[i].newer;
        *(older ? &older->link[i].newer : &lru->oldest) = newer;
        *(newer ? &newer->link[i].older : &lru->newest) = older;
    }
}

static void enter_order(struct blobs *blobs, struct blob *b)
{
    for (int i = 0; i < LRU_N; i++) {
        struct blob_lru *lru = lru_of(blobs, b, i);
        struct blob *older = lru->newest, *newer = NULL;
        while (older && older->used_ns > b->used_ns) {
            newer = older;
            older = older->link[i].older;
        }
        b->link[i].older = older;
        b->link[i].newer = newer;
        *(older ? &older->link[i].newer : &lru->oldest) = b;
        *(newer ? &newer->link[i].older : &lru->newest) = b;
    }
}

static struct blob_owner *owner_of(struct blobs *blobs, const char *name)
{
    struct blob_owner *o = blobs->owners;
    while (o && strcmp(o->name, name)) o = o->next;
    if (o || !(o = calloc(1, sizeof *o))) return o;
    snprintf(o->name, sizeof o->name, "%s", name);
    o->next = blobs->owners;
    blobs->owners = o;
    return o;
}

static void drop_owner(struct blobs *blobs, struct blob_owner *owner)
{
    if (owner->lru.oldest) return;
    struct blob_owner **at = &blobs->owners;
    while (*at != owner) at = &(*at)->next;
    *at = owner->next;
    free(owner);
}

// ---- adding and removing

struct blob *blob_add(struct blobs *blobs, const char *hash, uint64_t size, uint64_t charged,
                      const char *owner, uint64_t used_ns)
{
    struct blob *b = calloc(1, sizeof *b);
    if (b) b->owner = owner_of(blobs, owner);
    if (!b || !b->owner) {
        free(b);
        return NULL;
    }
    memcpy(b->hash, hash, BLOB_HASH);
    b->size = size;
    b->charged = charged;
    b->used_ns = used_ns;
    if (blobs->n_blob >= blobs->n_bucket) grow(blobs);
    struct blob **bucket = bucket_of(blobs, hash);
    b->chain = *bucket;
    *bucket = b;
    blobs->n_blob++;
    enter_order(blobs, b);
    return b;
}

static void free_blob(struct blob *b)
{
    for (struct blob_name *n = b->names, *next; n; n = next) {
        next = n->next;
        free(n);
    }
    free(b);
}

struct discard {
    struct work work;
    char path[4096];
};

static int run_discard(struct work *work, const struct prt_context *ctx)
{
    unlink(((struct discard *)work)->path); // frees its blocks, which takes a while
    return PRT_OK;
}

static void free_work(struct work *work)
{
    free(work);
}

void blob_discard(struct blobs *blobs, const char *name)
{
    char path[4096];
    struct discard *d = calloc(1, sizeof *d);
    snprintf(path, sizeof path, "%s/%s", blobs->folder, name);
    if (d)
        snprintf(d->path, sizeof d->path, "%s/" TRASH "%llu", blobs->folder,
                 (unsigned long long)++blobs->last_trash);
    if (!d || rename(path, d->path)) {
        unlink(path);
        free(d);
        return;
    }
    d->work.run = run_discard;
    d->work.done = free_work;
    d->work.class = WORK_BACKGROUND;
    work_submit(blobs->setup.work, &d->work);
}

void blob_remove(struct blobs *blobs, struct blob *b)
{
    char owner[BLOB_HASH + 8];
    struct blob **at = bucket_of(blobs, b->hash);
    while (*at != b) at = &(*at)->chain;
    *at = b->chain;
    blobs->n_blob--;
    leave_order(blobs, b);
    snprintf(owner, sizeof owner, "%s.owner", b->hash);
    blob_discard(blobs, b->hash);
    blob_discard(blobs, owner);
    disk_charge(blobs->setup.ledger, b->owner->name, -(int64_t)b->charged);
    drop_owner(blobs, b->owner);
    free_blob(b);
}

// One that replicas share comes back from there.
static bool is_held(const struct blobs *blobs, const struct blob *b)
{
    return !object_store_shared(blobs->setup.objects) && holds_has(blobs->setup.holds, b->hash);
}

uint64_t blobs_held(const struct blobs *blobs, const char *owner)
{
    uint64_t bytes = 0;
    for (const struct blob *b = blobs->lru.oldest; b; b = b->link[LRU_ALL].newer)
        if ((!owner || !strcmp(b->owner->name, owner)) && is_held(blobs, b))
            bytes += b->charged;
    return bytes;
}

// The longest unused of a list, if it may go.
static struct blob *oldest(const struct blobs *blobs, const struct blob_lru *lru, int list)
{
    struct blob *b = lru->oldest;
    while (b && (b->checking || is_held(blobs, b))) b = b->link[list].newer;
    uint64_t keep_ns = (uint64_t)(blobs->setup.keep_s * 1e9);
    return b && b->used_ns + keep_ns <= blob_clock_ns() ? b : NULL;
}

static bool drop_blob(struct blobs *blobs, struct blob *b)
{
    if (!b) return false;
    log_line(LOG_EVENT, "blob hash=%.12s owner=\"%s\" dropped for room", b->hash,
             b->owner->name);
    blob_remove(blobs, b);
    return true;
}

bool blob_evict(struct blobs *blobs, const char *owner)
{
    struct blob_owner *o = blobs->owners;
    while (o && strcmp(o->name, owner)) o = o->next;
    return o && drop_blob(blobs, oldest(blobs, &o->lru, LRU_OWNER));
}

bool blob_evict_for(struct blobs *blobs, const char *asker, uint64_t more)
{
    const struct ledger *ledger = blobs->setup.ledger;
    struct blob *found = NULL;
    for (struct blob_owner *o = blobs->owners; o; o = o->next) {
        if (strcmp(o->name, DISK_NOBODY) &&
            !ledger_above_share(ledger, LEDGER_DISK, o->name, asker, more))
            continue;
        struct blob *b = oldest(blobs, &o->lru, LRU_OWNER);
        if (b && (!found || b->used_ns < found->used_ns)) found = b;
    }
    if (!found && !ledger_above_share(ledger, LEDGER_DISK, asker, asker, more))
        found = oldest(blobs, &blobs->lru, LRU_ALL);
    return drop_blob(blobs, found);
}

bool blobs_has(const struct blobs *blobs, const char *hash)
{
    return relight_hash_valid(hash) && blob_find(blobs, hash);
}

void blobs_touch(struct blobs *blobs, const char *hash)
{
    struct blob *b = relight_hash_valid(hash) ? blob_find(blobs, hash) : NULL;
    if (!b) return;
    leave_order(blobs, b);
    b->used_ns = blob_clock_ns();
    b->touched = true; // written by blobs_maintain
    enter_order(blobs, b);
}

enum blob_format blobs_format(const struct blobs *blobs, const char *hash)
{
    const struct blob *b = relight_hash_valid(hash) ? blob_find(blobs, hash) : NULL;
    return b ? b->format : BLOB_OTHER;
}

// ---- names

struct append {
    struct work work;
    char path[4096 + 8], line[96 + BLOB_NAME + 3];
};

static int run_append(struct work *work, const struct prt_context *ctx)
{
    struct append *a = (struct append *)work;
    // Without O_CREAT: the blob may have been evicted.
    int fd = open(a->path, O_WRONLY | O_APPEND | O_CLOEXEC);
    if (fd < 0) return PRT_OK;
    size_t n = strlen(a->line);
    if (write(fd, a->line, n) != (ssize_t)n)
        log_line(LOG_WARN, "%s: %s", a->path, strerror(errno));
    futimens(fd, NULL); // when a name was given last
    close(fd);
    return PRT_OK;
}

static struct blob_name *find_name(const struct blob *b, const char *principal)
{
    struct blob_name *n = b->names;
    while (n && strcmp(n->principal, principal)) n = n->next;
    return n;
}

static struct blob_name *new_name(struct blob *b, const char *principal, const char *name)
{
    size_t n_principal = strlen(principal) + 1, n_name = strlen(name) + 1;
    if (b->names_bytes + n_principal + n_name > BLOB_OWNER_FILE) return NULL;
    struct blob_name *n = malloc(sizeof *n + n_principal + n_name);
    if (!n) return NULL;
    memcpy(n->principal, principal, n_principal);
    n->name = n->principal + n_principal;
    memcpy(n->name, name, n_name);
    b->names_bytes += n_principal + n_name;
    return n;
}

void blob_add_name(struct blobs *blobs, struct blob *b, const char *principal, const char *name,
                   uint64_t named_ns, bool write)
{
    struct blob_name **at = &b->names, *n;
    if (!blob_name_valid(name)) return;
    while ((n = *at) && (strcmp(n->principal, principal) || strcmp(n->name, name)))
        at = &n->next;
    bool known = n != NULL;
    if (known) *at = n->next;
    else if (!(n = new_name(b, principal, name))) return;
    n->named_ns = named_ns;
    n->next = b->names;
    b->names = n;
    struct append *a = write ? calloc(1, sizeof *a) : NULL;
    if (!a) return;
    snprintf(a->path, sizeof a->path, "%s/%s.owner", blobs->folder, b->hash);
    if (!known) snprintf(a->line, sizeof a->line, "%s\t%s\n", principal, name);
    a->work.run = run_append;
    a->work.done = free_work;
    a->work.class = WORK_BACKGROUND;
    work_submit(blobs->setup.work, &a->work);
}

void blobs_name(const struct blobs *blobs, const char *principal, const char *hash, char *name,
                size_t n)
{
    const struct blob *b = relight_hash_valid(hash) ? blob_find(blobs, hash) : NULL;
    const struct blob_name *found = b && principal ? find_name(b, principal) : NULL;
    if (found) snprintf(name, n, "%s", found->name);
    else snprintf(name, n, "%.*s…", DIGITS, hash);
}

// The principal's name of the blob whose first digits these are.
static const char *name_of_digits(const struct blobs *blobs, const char *principal,
                                  const char *digits)
{
    for (const struct blob *b = *bucket_of(blobs, digits); b; b = b->chain) {
        const struct blob_name *n = NULL;
        if (!strncmp(b->hash, digits, DIGITS)) n = find_name(b, principal);
        if (n) return n->name;
    }
    return NULL;
}

void blobs_name_in_text(const struct blobs *blobs, const char *principal, const char *text,
                        char *out, size_t n)
{
    static const char mark[] = "…";
    size_t at = 0;
    while (*text && at + 1 < n) {
        const char *name = NULL;
        if (strspn(text, "0123456789abcdef") == DIGITS &&
            !strncmp(text + DIGITS, mark, strlen(mark)))
            name = name_of_digits(blobs, principal, text);
        if (name) {
            at += (size_t)snprintf(out + at, n - at, "%s", name);
            if (at >= n) at = n - 1;
            text += DIGITS + strlen(mark);
        } else {
            out[at++] = *text++;
        }
    }
    out[at] = 0;
    relight_utf8_cut(out);
}

// ---- checking a blob that was there at the start

struct check {
    struct work work;
    struct blobs *blobs;
    struct blob *blob; // stays while it is checking
    char path[4096], hash[65];
    enum blob_format format;
    int err; // the bytes could not be read
};

static int run_check(struct work *work, const struct prt_context *ctx)
{
    struct check *c = (struct check *)work;
    char bytes[4];
    c->err = blobs_hash_file(c->path, c->hash);
    int fd = open(c->path, O_RDONLY | O_CLOEXEC);
    ssize_t n = fd < 0 ? 0 : read(fd, bytes, sizeof bytes);
    if (fd >= 0) close(fd);
    c->format = blob_format_of(bytes, n > 0 ? (size_t)n : 0);
    return PRT_OK;
}

// Lack of memory or descriptors says nothing about a blob: its next use checks it.
static bool says_nothing(int err)
{
    return err == -ENOMEM || err == -EMFILE || err == -ENFILE;
}

static void done_check(struct work *work)
{
    struct check *c = (struct check *)work;
    struct blob *b = c->blob;
    struct blob_waiter *waiters = b->waiters;
    bool good = !c->err && !strcmp(c->hash, b->hash);
    b->waiters = NULL;
    b->checking = false;
    b->check = NULL;
    b->checked = good;
    b->format = c->format;
    if (says_nothing(c->err)) {
        log_line(LOG_WARN, "blob hash=%.12s cannot be checked: %s", b->hash, strerror(-c->err));
    } else if (!good) {
        log_line(LOG_WARN, "blob hash=%.12s is damaged on disk and was removed", b->hash);
        blob_remove(c->blobs, b);
    }
    c->blobs->woken = waiters;
    for (struct blob_waiter *w; (w = c->blobs->woken);) {
        c->blobs->woken = w->next;
        w->wake(w); // may end the waits of others
    }
    free(c);
}

void blobs_check(struct blobs *blobs, const char *hash, struct blob_waiter *waiter)
{
    struct blob *b = relight_hash_valid(hash) ? blob_find(blobs, hash) : NULL;
    struct check *c = NULL;
    if (b && !b->checked && !b->checking) c = calloc(1, sizeof *c);
    if (!b || b->checked || (!b->checking && !c)) {
        waiter->wake(waiter); // without memory no check: opening the file reports its errors
        return;
    }
    struct blob_waiter **last = &b->waiters;
    while (*last) last = &(*last)->next;
    waiter->next = NULL;
    *last = waiter;
    if (!c) return;
    b->checking = true;
    b->check = c;
    c->blobs = blobs;
    c->blob = b;
    blobs_path(blobs, hash, c->path, sizeof c->path);
    c->work.run = run_check;
    c->work.done = done_check;
    c->work.class = b->size <= BLOB_SMALL ? WORK_INTERACTIVE : WORK_BACKGROUND;
    work_submit(blobs->setup.work, &c->work);
}

// False where the list has no such waiter.
static bool take_out(struct blob_waiter **at, const struct blob_waiter *waiter)
{
    while (*at && *at != waiter) at = &(*at)->next;
    if (!*at) return false;
    *at = waiter->next;
    return true;
}

void blobs_check_leave(struct blobs *blobs, const char *hash, struct blob_waiter *waiter)
{
    if (take_out(&blobs->woken, waiter)) return;
    struct blob *b = blob_find(blobs, hash);
    take_out(&b->waiters, waiter);
    if (b->waiters || !work_dequeue(&b->check->work)) return;
    free(b->check);
    b->check = NULL;
    b->checking = false;
}

// ---- times of use

struct times {
    struct work work;
    struct object_store *objects; // a use here keeps it there, too
    char folder[BLOB_FOLDER];
    size_t n;
    struct {
        char hash[BLOB_HASH + 1];
        uint64_t used_ns;
    } blob[];
};

static int run_times(struct work *work, const struct prt_context *ctx)
{
    struct times *t = (struct times *)work;
    int folder = open(t->folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    for (size_t i = 0; folder >= 0 && i < t->n; i++) {
        struct timespec when = {(time_t)(t->blob[i].used_ns / 1000000000u),
                                (long)(t->blob[i].used_ns % 1000000000u)};
        struct timespec both[2] = {when, when};
        uint64_t bytes;
        utimensat(folder, t->blob[i].hash, both, 0); // read-only stores keep their times
        (void)object_find(t->objects, OBJECT_BLOB, t->blob[i].hash, &bytes);
        (void)object_find(t->objects, OBJECT_OWNER, t->blob[i].hash, &bytes);
    }
    if (folder >= 0) close(folder);
    return PRT_OK;
}

// Touched blobs are the newest.
static struct times *collect_times(struct blobs *blobs)
{
    size_t n = 0;
    for (struct blob *b = blobs->lru.newest; b && b->touched; b = b->link[LRU_ALL].older) n++;
    struct times *t = n ? calloc(1, sizeof *t + n * sizeof *t->blob) : NULL;
    if (!t) return NULL;
    t->objects = blobs->setup.objects;
    snprintf(t->folder, sizeof t->folder, "%s", blobs->folder);
    for (struct blob *b = blobs->lru.newest; t->n < n; b = b->link[LRU_ALL].older, t->n++) {
        memcpy(t->blob[t->n].hash, b->hash, sizeof b->hash);
        t->blob[t->n].used_ns = b->used_ns;
        b->touched = false;
    }
    return t;
}

void blobs_maintain(struct blobs *blobs)
{
    uploads_expire(blobs);
    struct times *t = collect_times(blobs);
    if (!t) return;
    t->work.run = run_times;
    t->work.done = free_work;
    t->work.class = WORK_BACKGROUND;
    work_submit(blobs->setup.work, &t->work);
}

// ---- opening and closing

static void read_names(struct blobs *blobs, struct blob *b)
{
    char path[4096 + 8], line[96 + BLOB_NAME + 3];
    snprintf(path, sizeof path, "%s/%s.owner", blobs->folder, b->hash);
    FILE *file = fopen(path, "re");
    struct stat st = {0};
    if (!file) return;
    (void)fstat(fileno(file), &st);
    while (fgets(line, sizeof line, file)) {
        char *tab = strchr(line, '\t');
        line[strcspn(line, "\n")] = 0;
        if (!tab) continue;
        *tab = 0;
        blob_add_name(blobs, b, line, tab + 1, time_ns(&st.st_mtim), false);
    }
    fclose(file);
}

static int recover_blob(struct blobs *blobs, const char *hash, const struct stat *st)
{
    char path[4096], owner[96];
    uint64_t size = (uint64_t)st->st_size, charge = blob_charge(size);
    uint64_t used_ns = time_ns(&st->st_mtim);
    blobs_path(blobs, hash, path, sizeof path);
    disk_owner_read(path, owner);
    struct blob *b = blob_add(blobs, hash, size, charge, owner, used_ns);
    if (!b) return -ENOMEM;
    disk_charge(blobs->setup.ledger, owner, (int64_t)charge);
    read_names(blobs, b);
    return 0;
}

int blob_adopt(struct blobs *blobs, const char *hash, uint64_t size)
{
    struct stat st = {.st_size = (off_t)size};
    clock_gettime(CLOCK_REALTIME, &st.st_mtim);
    int err = recover_blob(blobs, hash, &st);
    if (!err) blob_find(blobs, hash)->touched = true; // in one run with those used since
    return err;
}

struct found {
    char hash[BLOB_HASH + 1];
    struct stat st;
};

static int by_use(const void *a, const void *b)
{
    const struct timespec *s = &((const struct found *)a)->st.st_mtim;
    const struct timespec *t = &((const struct found *)b)->st.st_mtim;
    if (s->tv_sec != t->tv_sec) return s->tv_sec < t->tv_sec ? -1 : 1;
    return s->tv_nsec < t->tv_nsec ? -1 : s->tv_nsec > t->tv_nsec;
}

static bool ends_with(const char *name, const char *ending)
{
    size_t n = strlen(name), m = strlen(ending);
    return n > m && !strcmp(name + n - m, ending);
}

// A file that is not a blob: an upload's part, or of no use any more.
static void recover_other(struct blobs *blobs, int folder, const char *name)
{
    char stem[NAME_MAX + 1], hash[BLOB_HASH + 1];
    snprintf(stem, sizeof stem, "%s", name);
    snprintf(hash, sizeof hash, "%.*s", BLOB_HASH, name);
    char *dot = strrchr(stem, '.');
    if (!strncmp(name, TRASH, strlen(TRASH))) unlinkat(folder, name, 0);
    if (!dot || !relight_hash_valid(hash)) return;
    *dot = 0;
    if (ends_with(name, ".upload")) {
        upload_recover(blobs, stem);
    } else if (ends_with(name, ".part")) {
        char promise[NAME_MAX + 8];
        snprintf(promise, sizeof promise, "%s.upload", stem);
        if (faccessat(folder, promise, F_OK, 0)) unlinkat(folder, name, 0);
    } else if (ends_with(name, ".name") || // of an older version, without its principal
               (ends_with(name, ".owner") && faccessat(folder, hash, F_OK, 0))) {
        unlinkat(folder, name, 0);
    }
}

static int scan(struct blobs *blobs, DIR *dir)
{
    struct found *found = NULL;
    size_t n = 0, room = 0;
    int err = 0;
    for (struct dirent *d; !err && (d = readdir(dir));) {
        struct stat st;
        if (fstatat(dirfd(dir), d->d_name, &st, AT_SYMLINK_NOFOLLOW) || !S_ISREG(st.st_mode))
            continue;
        if (!relight_hash_valid(d->d_name)) {
            recover_other(blobs, dirfd(dir), d->d_name);
            continue;
        }
        if (n == room) {
            struct found *more = realloc(found, (room = room ? 2 * room : 256) * sizeof *found);
            if (!more) err = -ENOMEM;
            if (err) break;
            found = more;
        }
        memcpy(found[n].hash, d->d_name, BLOB_HASH + 1);
        found[n++].st = st;
    }
    if (n) qsort(found, n, sizeof *found, by_use); // so that each becomes the newest
    for (size_t i = 0; !err && i < n; i++)
        err = recover_blob(blobs, found[i].hash, &found[i].st);
    free(found);
    return err;
}

int blobs_open(const struct blobs_setup *setup, struct blobs **out)
{
    struct blobs *blobs = calloc(1, sizeof *blobs);
    if (!blobs || !(blobs->bucket = calloc(FIRST_BUCKETS, sizeof *blobs->bucket))) {
        free(blobs);
        return -ENOMEM;
    }
    blobs->setup = *setup;
    blobs->n_bucket = FIRST_BUCKETS;
    snprintf(blobs->folder, sizeof blobs->folder, "%s", setup->folder);
    DIR *dir = NULL;
    int err = getrandom(&blobs->seed, sizeof blobs->seed, 0) < 0 ? -errno : 0;
    if (!err &&
        ((mkdir(setup->folder, 0700) && errno != EEXIST) || !(dir = opendir(setup->folder))))
        err = -errno;
    if (!err) err = scan(blobs, dir);
    if (dir) closedir(dir);
    if (err) blobs_close(blobs);
    else *out = blobs;
    return err;
}

void blobs_close(struct blobs *blobs)
{
    if (!blobs) return;
    uploads_close(blobs);
    struct times *t = collect_times(blobs);
    if (t) run_times(&t->work, NULL);
    free(t);
    for (struct blob *b = blobs->lru.oldest, *next; b; b = next) {
        next = b->link[LRU_ALL].newer;
        disk_charge(blobs->setup.ledger, b->owner->name, -(int64_t)b->charged);
        free_blob(b);
    }
    for (struct blob_owner *o = blobs->owners, *next; o; o = next) {
        next = o->next;
        free(o);
    }
    free(blobs->bucket);
    free(blobs);
}

void blobs_charge(struct blobs *blobs, int64_t bytes)
{
    disk_charge(blobs->setup.ledger, DISK_NOBODY, bytes);
}
