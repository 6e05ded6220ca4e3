// SPDX-License-Identifier: MIT
// Files of rays in a folder with a budget. A record is appended as it is finished; one process
// writes a file at a time, any number read it.
#include "bake/ray_store.h"
#include "bake/cluster_records.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <unistd.h>

static const char magic[8] = "PRTRAYS2"; // the last character: version of the records
static const char suffix[] = ".rays";
enum { MAX_RECORDS = 1 << 22, MAX_RECORD_BYTES = 1 << 30 };

struct header {
    char magic[8];
    uint64_t key, check; // check: hash of the two above
};

struct place {
    struct record record;
    uint64_t at;
};

struct ray_store {
    const struct prt_context *ctx;
    char path[PATH_MAX];
    const char *name; // in path
    int fd;
    bool writes; // this process has the lock
    uint64_t end, budget, room;
    struct place *place; // found when it was opened
    size_t n_place, capacity;
    pthread_mutex_t lock; // of `end` and of the file behind it
    atomic_bool stopped, warned;
};

static void warn(struct ray_store *s, const char *why)
{
    if (!atomic_exchange(&s->warned, true))
        prt_log(s->ctx, PRT_LOG_WARNING, "%s: %s; its rays are cast again", s->path, why);
}

// ---- the folder

struct old_file {
    char name[NAME_MAX + 1];
    uint64_t bytes;
    struct timespec used;
};

static int by_age(const void *a, const void *b)
{
    const struct timespec *x = &((const struct old_file *)a)->used;
    const struct timespec *y = &((const struct old_file *)b)->used;
    if (x->tv_sec != y->tv_sec) return x->tv_sec < y->tv_sec ? -1 : 1;
    return x->tv_nsec < y->tv_nsec ? -1 : x->tv_nsec > y->tv_nsec;
}

// The store's files except `own`, to free().
static struct old_file *list_files(int folder, const char *own, size_t *n)
{
    enum { MOST = 65536 };
    int fd = openat(folder, ".", O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    DIR *dir = fd < 0 ? NULL : fdopendir(fd);
    struct old_file *list = NULL;
    size_t room = 0;
    *n = 0;
    if (!dir && fd >= 0) close(fd);
    for (struct dirent *e; dir && *n < MOST && (e = readdir(dir));) {
        struct stat st;
        size_t length = strlen(e->d_name), tail = sizeof suffix - 1;
        if (length <= tail || strcmp(e->d_name + length - tail, suffix)) continue;
        if (!strcmp(e->d_name, own) || fstatat(folder, e->d_name, &st, AT_SYMLINK_NOFOLLOW) ||
            !S_ISREG(st.st_mode))
            continue;
        if (*n == room) {
            room = 2 * room + 64;
            struct old_file *grown = realloc(list, room * sizeof *grown);
            if (!grown) break;
            list = grown;
        }
        snprintf(list[*n].name, sizeof list->name, "%s", e->d_name);
        list[*n].bytes = (uint64_t)st.st_size;
        list[(*n)++].used = st.st_mtim;
    }
    if (dir) closedir(dir);
    return list;
}

// Removes the files that were used least recently until the others leave `own` bytes of the
// budget, and sets what is left for this file.
static void evict(struct ray_store *s, uint64_t own)
{
    char dir[PATH_MAX];
    size_t n = 0;
    snprintf(dir, sizeof dir, "%.*s", (int)(s->name - s->path), s->path);
    s->room = 0;
    int folder = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (folder < 0 || own > s->budget) {
        if (folder >= 0) close(folder);
        return;
    }
    struct old_file *list = list_files(folder, s->name, &n);
    uint64_t others = 0;
    for (size_t i = 0; i < n; i++) others += list[i].bytes;
    if (n) qsort(list, n, sizeof *list, by_age);
    for (size_t i = 0; i < n && others > s->budget - own; i++)
        if (!unlinkat(folder, list[i].name, 0)) others -= list[i].bytes;
    free(list);
    close(folder);
    s->room = others < s->budget ? s->budget - others : 0;
}

// ---- opening

static bool add_place(struct ray_store *s, const struct place *place)
{
    if (s->n_place == MAX_RECORDS) return false;
    if (s->n_place == s->capacity) {
        size_t more = 2 * s->capacity + 256;
        struct place *grown = realloc(s->place, more * sizeof *grown);
        if (!grown) return false;
        s->place = grown;
        s->capacity = more;
    }
    s->place[s->n_place++] = *place;
    return true;
}

static int by_slot(const void *a, const void *b)
{
    const struct place *x = a, *y = b;
    if (x->record.slot != y->record.slot) return x->record.slot < y->record.slot ? -1 : 1;
    if (x->record.cluster != y->record.cluster)
        return x->record.cluster < y->record.cluster ? -1 : 1;
    return x->at > y->at ? -1 : 1; // the last of equal ones first
}

// Finds the records up to the first one that was not written whole. The hash of a record's data
// is checked where they are read.
static void scan(struct ray_store *s, uint64_t key)
{
    struct header h, own = {.key = key};
    struct stat st;
    struct place p;
    memcpy(own.magic, magic, sizeof magic);
    own.check = prt_hash64(&own, offsetof(struct header, check), 2);
    uint64_t size = fstat(s->fd, &st) ? 0 : (uint64_t)st.st_size, at = sizeof h;
    s->end = sizeof h;
    if (size && (!prt_read_at(s->fd, &h, sizeof h, 0) || memcmp(&h, &own, sizeof h))) {
        warn(s, "damaged, or of another version");
        size = 0;
    }
    while (size && prt_read_at(s->fd, &p.record, sizeof p.record, at) &&
           prt_record_whole(&p.record)) {
        p.at = at + sizeof p.record;
        if (p.record.bytes > MAX_RECORD_BYTES || p.at > size || p.record.bytes > size - p.at ||
            !add_place(s, &p))
            break;
        s->end = at = p.at + p.record.bytes;
    }
    if (size && s->end != size) warn(s, "damaged or cut short");
    if (s->n_place) qsort(s->place, s->n_place, sizeof *s->place, by_slot);
    if (s->writes && (ftruncate(s->fd, size ? (off_t)s->end : 0) ||
                      !prt_write_at(s->fd, &own, sizeof own, 0)))
        s->writes = false;
}

static struct ray_store *prepare(const struct prt_context *ctx, const char *dir,
                                 const char *kind, uint64_t key)
{
    struct ray_store *s = calloc(1, sizeof *s);
    if (!s) return NULL;
    s->ctx = ctx;
    s->fd = -1;
    pthread_mutex_init(&s->lock, NULL);
    int length = snprintf(s->path, sizeof s->path, "%s/%.32s-%016llx%s", dir, kind,
                          (unsigned long long)key, suffix);
    bool fits = length >= 0 && (size_t)length < sizeof s->path;
    s->name = fits ? strrchr(s->path, '/') + 1 : NULL;
    return s;
}

struct ray_store *prt_ray_store_open(const struct prt_context *ctx, const char *dir,
                                     const char *kind, uint64_t key, uint64_t budget)
{
    struct ray_store *s = prepare(ctx, dir, kind, key);
    if (!s) return NULL;
    s->budget = budget;
    if (!s->name) errno = ENAMETOOLONG;
    s->fd = s->name && (!mkdir(dir, 0700) || errno == EEXIST)
                ? open(s->path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600)
                : -1;
    if (s->fd < 0) {
        prt_log(ctx, PRT_LOG_WARNING, "cache %s: %s; rays are not kept", dir, strerror(errno));
        prt_ray_store_close(s);
        return NULL;
    }
    s->writes = !flock(s->fd, LOCK_EX | LOCK_NB) || errno != EWOULDBLOCK;
    (void)futimens(s->fd, NULL);
    scan(s, key);
    evict(s, s->end);
    return s;
}

struct ray_store *prt_ray_store_reopen(const struct prt_context *ctx, const char *dir,
                                       const char *kind, uint64_t key)
{
    struct ray_store *s = prepare(ctx, dir, kind, key);
    if (!s) return NULL;
    s->fd = s->name ? open(s->path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW) : -1;
    if (s->fd < 0) {
        prt_ray_store_close(s);
        return NULL;
    }
    (void)futimens(s->fd, NULL);
    scan(s, key);
    return s;
}

// The first record of a file.
static void show_first(int folder, const struct old_file *file, size_t most, ray_store_fn *fn,
                       void *user)
{
    struct header h;
    struct record r;
    int fd = openat(folder, file->name, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (fd < 0) return;
    if (prt_read_at(fd, &h, sizeof h, 0) && !memcmp(h.magic, magic, sizeof magic) &&
        prt_read_at(fd, &r, sizeof r, sizeof h) && prt_record_whole(&r) && r.bytes &&
        r.bytes <= most) {
        void *data = prt_alloc(r.bytes, 1);
        const struct view view = {data, r.bytes};
        if (data && prt_record_read(&r, fd, sizeof h + sizeof r, &view, 1))
            fn(user, h.key, r.slot, data, r.bytes);
        prt_free(data);
    }
    close(fd);
}

void prt_ray_store_each(const char *dir, const char *kind, size_t most, ray_store_fn *fn,
                        void *user)
{
    int folder = open(dir, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    size_t n = 0, length = strlen(kind);
    if (folder < 0) return;
    struct old_file *list = list_files(folder, "", &n);
    for (size_t i = 0; i < n; i++)
        if (!strncmp(list[i].name, kind, length) && list[i].name[length] == '-')
            show_first(folder, &list[i], most, fn, user);
    free(list);
    close(folder);
}

void prt_ray_store_close(struct ray_store *s)
{
    if (!s) return;
    if (s->fd >= 0) close(s->fd);
    pthread_mutex_destroy(&s->lock);
    free(s->place);
    free(s);
}

// ---- records

static const struct place *find(const struct ray_store *s, uint32_t slot, uint32_t id)
{
    size_t low = 0, high = s->n_place;
    while (low < high) {
        size_t mid = (low + high) / 2;
        const struct record *r = &s->place[mid].record;
        if (r->slot < slot || (r->slot == slot && r->cluster < id)) low = mid + 1;
        else high = mid;
    }
    const struct place *p = low < s->n_place ? &s->place[low] : NULL;
    return p && p->record.slot == slot && p->record.cluster == id ? p : NULL;
}

bool prt_ray_store_has(const struct ray_store *s, uint32_t slot, uint32_t id)
{
    return s && find(s, slot, id);
}

void *prt_ray_store_get(struct ray_store *s, uint32_t slot, uint32_t id, size_t *bytes,
                        uint64_t *rays)
{
    const struct place *p = s ? find(s, slot, id) : NULL;
    if (!p || !p->record.bytes) return NULL;
    void *data = prt_alloc(p->record.bytes, 1);
    const struct view view = {data, p->record.bytes};
    if (!data) return NULL;
    if (!prt_record_read(&p->record, s->fd, p->at, &view, 1)) {
        warn(s, "damaged");
        prt_free(data);
        return NULL;
    }
    *bytes = p->record.bytes;
    *rays = p->record.rays;
    return data;
}

void prt_ray_store_put(struct ray_store *s, uint32_t slot, uint32_t id, const void *data,
                       size_t bytes, uint64_t rays)
{
    if (!s || !s->writes || atomic_load(&s->stopped) || bytes > MAX_RECORD_BYTES) return;
    struct record r = {.slot = slot, .cluster = id, .rays = rays};
    const struct view view = {(void *)(uintptr_t)data, bytes};
    prt_record_sign(&r, &view, 1);
    pthread_mutex_lock(&s->lock);
    const uint64_t want = s->end + sizeof r + bytes;
    if (want > s->room) evict(s, want);
    bool fits = want <= s->room;
    bool ok = fits && prt_write_at(s->fd, data, bytes, s->end + sizeof r) &&
              prt_write_at(s->fd, &r, sizeof r, s->end);
    if (ok) s->end += sizeof r + bytes;
    pthread_mutex_unlock(&s->lock);
    if (!ok && !atomic_exchange(&s->stopped, true))
        prt_log(s->ctx, PRT_LOG_NOTE, "%s: %s; further rays are not kept", s->path,
                fits ? strerror(errno) : "the cache is full");
}
