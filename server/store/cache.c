// SPDX-License-Identifier: MIT
// The table of shared results: chained hashing by key text, and a use-ordered list of entries
// that nobody holds. Clients choose keys: the hash has a secret seed, and the table grows.
#include "store/cache_private.h"

#include "core/work.h"
#include "prt/base.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>

enum { FIRST_BUCKETS = 1024, LARGE = 4 << 20 };

// One block: by keys, then by their beginnings.
static void set_tables(struct cache *cache, struct cache_entry **block, size_t n)
{
    cache->bucket = block;
    cache->n_bucket = n;
    for (int i = 0; i < CACHE_BEGINNINGS; i++) cache->begin[i] = block + (size_t)(i + 1) * n;
}

int cache_create(size_t budget_bytes, struct cache **out)
{
    struct cache *cache = calloc(1, sizeof *cache);
    if (cache) cache->bucket = calloc(FIRST_BUCKETS, (1 + CACHE_BEGINNINGS) * sizeof(void *));
    if (!cache || !cache->bucket) {
        free(cache);
        return PRT_NOMEM;
    }
    set_tables(cache, cache->bucket, FIRST_BUCKETS);
    if (getrandom(&cache->seed, sizeof cache->seed, 0) != sizeof cache->seed) {
        cache_destroy(cache);
        return PRT_IO;
    }
    cache->no_memory = (struct cache_entry){.key = (char *)"",
                                            .state = CACHE_FAILED,
                                            .refs = 1,
                                            .error_code = CACHE_ERROR_NO_MEMORY,
                                            .error = "not enough memory",
                                            .cache = cache};
    cache->last_admission = &cache->admission;
    cache->budget = budget_bytes;
    *out = cache;
    return PRT_OK;
}

static struct cache_entry **bucket_of(const struct cache *cache, uint64_t hash)
{
    return &cache->bucket[hash % cache->n_bucket];
}

// ---- entries whose keys begin alike

size_t cache_beginning(const char *text, int which)
{
    const char *slash = strchr(text, '/');
    if (!slash || !which) return slash ? (size_t)(slash - text) + 1 : 0;
    size_t digits = strspn(slash + 1, "0123456789");
    return digits && slash[1 + digits] == '/' ? (size_t)(slash - text) + digits + 2 : 0;
}

static void link_beginning(struct cache *cache, struct cache_entry *e, int which)
{
    struct cache_link *link = &e->beginning[which];
    struct cache_entry **head = &cache->begin[which][link->hash % cache->n_bucket];
    if ((link->next = *head)) link->next->beginning[which].at = &link->next;
    link->at = head;
    *head = e;
}

static void enter_beginnings(struct cache *cache, struct cache_entry *e)
{
    for (int i = 0; i < CACHE_BEGINNINGS; i++) {
        size_t n = cache_beginning(e->key, i);
        if (!n) continue;
        e->beginning[i].hash = prt_hash64(e->key, n, cache->seed);
        link_beginning(cache, e, i);
    }
}

static void leave_beginnings(struct cache_entry *e)
{
    for (int i = 0; i < CACHE_BEGINNINGS; i++) {
        struct cache_link *link = &e->beginning[i];
        if (!link->at) continue;
        *link->at = link->next;
        if (link->next) link->next->beginning[i].at = link->at;
        link->at = NULL;
    }
}

// Without memory the tables keep their size, and chains get longer.
static void grow(struct cache *cache)
{
    size_t n = cache->n_bucket;
    struct cache_entry **old = cache->bucket;
    struct cache_entry **fresh = calloc(2 * n, (1 + CACHE_BEGINNINGS) * sizeof *fresh);
    if (!fresh) return;
    set_tables(cache, fresh, 2 * n);
    for (size_t i = 0; i < n; i++)
        for (struct cache_entry *e = old[i], *next; e; e = next) {
            struct cache_entry **to = bucket_of(cache, e->hash);
            next = e->chain;
            e->chain = *to;
            *to = e;
            for (int k = 0; k < CACHE_BEGINNINGS; k++)
                if (e->beginning[k].at) link_beginning(cache, e, k);
        }
    free(old);
}

// The size of an entry without its value.
static size_t overhead(const struct cache_entry *e)
{
    return sizeof *e + strlen(e->key) + 1;
}

static void link_use(struct cache *cache, struct cache_entry *e)
{
    e->older = cache->newest;
    *(cache->newest ? &cache->newest->newer : &cache->oldest) = e;
    cache->newest = e;
    if (!e->holds_file) return;
    e->older_holder = cache->newest_holder;
    *(cache->newest_holder ? &cache->newest_holder->newer_holder : &cache->oldest_holder) = e;
    cache->newest_holder = e;
}

static void unlink_use(struct cache *cache, struct cache_entry *e)
{
    *(e->newer ? &e->newer->older : &cache->newest) = e->older;
    *(e->older ? &e->older->newer : &cache->oldest) = e->newer;
    e->newer = e->older = NULL;
    if (!e->holds_file) return;
    *(e->newer_holder ? &e->newer_holder->older_holder : &cache->newest_holder) =
        e->older_holder;
    *(e->older_holder ? &e->older_holder->newer_holder : &cache->oldest_holder) =
        e->newer_holder;
    e->newer_holder = e->older_holder = NULL;
}

static void unlink_key(struct cache *cache, struct cache_entry *e)
{
    struct cache_entry **at = bucket_of(cache, e->hash);
    while (*at && *at != e) at = &(*at)->chain;
    if (*at) {
        *at = e->chain;
        leave_beginnings(e);
        cache->counts.entries--;
    }
    e->chain = NULL;
}

struct disposal {
    struct work work;
    void (*destroy)(void *value);
    void *value;
};

static int run_disposal(struct work *work, const struct prt_context *ctx)
{
    struct disposal *d = (struct disposal *)work;
    d->destroy(d->value);
    return PRT_OK;
}

static void done_disposal(struct work *work)
{
    free(work);
}

static void destroy_value(const struct cache *cache, struct cache_entry *e)
{
    bool large = cache->workers && e->any_thread && e->bytes >= LARGE;
    struct disposal *d = large ? calloc(1, sizeof *d) : NULL;
    if (!d) {
        e->destroy(e->value);
        return;
    }
    *d = (struct disposal){.work.run = run_disposal,
                           .work.done = done_disposal,
                           .destroy = e->destroy,
                           .value = e->value};
    work_submit(cache->workers, &d->work);
}

void cache_use_workers(struct cache *cache, struct work_pool *pool)
{
    cache->workers = pool;
}

struct cache_entry *cache_look_up(const struct cache *cache, const char *key)
{
    uint64_t hash = prt_hash64(key, strlen(key), cache->seed);
    struct cache_entry *e = *bucket_of(cache, hash);
    while (e && (e->hash != hash || strcmp(e->key, key))) e = e->chain;
    return e;
}

static void free_entry(struct cache *cache, struct cache_entry *e)
{
    if (e->value && e->destroy) destroy_value(cache, e);
    cache_leave_owner(cache, e);
    cache->counts.bytes -= e->bytes + overhead(e);
    cache->values -= e->bytes;
    free(e->key);
    free(e);
}

static void drop(struct cache *cache, struct cache_entry *e)
{
    unlink_use(cache, e);
    unlink_key(cache, e);
    free_entry(cache, e);
}

// Evicts the least recently used unreferenced holder; false where there is none.
static bool drop_holder(struct cache *cache)
{
    struct cache_entry *e = cache->oldest_holder;
    if (!e) return false;
    cache->counts.evictions++;
    drop(cache, e);
    return true;
}

static void evict(struct cache *cache, struct cache_entry *e)
{
    cache->counts.evictions++;
    drop(cache, e);
}

// One that holds a file of an owner above its share goes, and the file may.
static bool evict_holder(struct cache *cache, const struct cache_asker *asker)
{
    struct cache_entry *e = cache->relieving ? NULL : cache_holder_above_share(cache, asker);
    if (!e) return false;
    cache->relieving = true; // its file is released, which calls make_room again
    evict(cache->holders, e);
    cache->relieving = false;
    return true;
}

// Evicts until the values and `more` bytes fit, or nothing is left that may go.
static void make_room(struct cache *cache, size_t more, struct cache_asker asker)
{
    while (cache->counts.bytes + more > cache->budget) {
        struct cache_entry *e = cache_above_share(cache, &asker);
        if (!e && evict_holder(cache, &asker)) continue;
        if (!e) e = cache->oldest;
        if (!e) break;
        evict(cache, e);
    }
    if (cache->relieving || !cache->holders) return;
    cache->relieving = true; // evicted holders release files, which calls this function again
    while (cache->counts.bytes + more > cache->budget && drop_holder(cache->holders)) continue;
    cache->relieving = false;
    // What the last of them held.
    while (cache->counts.bytes + more > cache->budget && cache->oldest)
        evict(cache, cache->oldest);
}

static void keep_budget(struct cache *cache)
{
    make_room(cache, 0, (struct cache_asker){NULL, 0});
}

static bool has_room(struct cache *cache, const struct cache_admission *a)
{
    const size_t bytes = a->bytes;
    make_room(cache, cache->promised + bytes, (struct cache_asker){a->owner, bytes});
    return cache->counts.bytes + cache->promised + bytes <= cache->budget ||
           (!cache->values && !cache->promised);
}

static void admit_next(struct cache *cache)
{
    if (cache->admitting || cache->relieving) return;
    cache->admitting = true;
    while (cache->admission && has_room(cache, cache->admission)) {
        struct cache_admission *a = cache->admission;
        cache->admission = a->next;
        if (!cache->admission) cache->last_admission = &cache->admission;
        cache->promised += a->bytes;
        if (a->owner) a->owner->promised += a->bytes;
        a->holds = true;
        a->admitted(a);
    }
    cache->admitting = false;
}

void cache_admit(struct cache *cache, struct cache_admission *a)
{
    a->next = NULL;
    a->holds = false;
    *cache->last_admission = a;
    cache->last_admission = &a->next;
    admit_next(cache);
}

void cache_admissions_check(struct cache *cache, bool (*fits)(const struct cache_admission *a),
                            void (*refused)(struct cache_admission *a))
{
    struct cache_admission *gone = NULL, **last = &gone, **at = &cache->admission;
    for (struct cache_admission *a; (a = *at);) {
        if (fits(a)) {
            at = &a->next;
            continue;
        }
        *at = a->next;
        a->next = NULL;
        *last = a;
        last = &a->next;
    }
    cache->last_admission = at;
    for (struct cache_admission *a; (a = gone);) {
        gone = a->next;
        refused(a);
    }
    admit_next(cache);
}

void cache_admission_end(struct cache *cache, struct cache_admission *a)
{
    if (!a->holds) return;
    a->holds = false;
    cache->promised -= a->bytes;
    if (a->owner) a->owner->promised -= a->bytes;
    admit_next(cache);
}

void cache_charge(struct cache *cache, size_t bytes)
{
    cache->counts.bytes += bytes;
    keep_budget(cache);
}

void cache_discharge(struct cache *cache, size_t bytes)
{
    assert(cache->counts.bytes >= bytes);
    cache->counts.bytes -= bytes;
    admit_next(cache);
}

size_t cache_budget(const struct cache *cache)
{
    return cache->budget;
}

void cache_hold_files(struct cache *holders, struct cache *files)
{
    holders->files = files;
    files->holders = holders;
}

void cache_destroy(struct cache *cache)
{
    if (!cache) return;
    while (cache->oldest) drop(cache, cache->oldest);
    free(cache->bucket);
    free(cache);
}

struct cache_entry *cache_find(struct cache *cache, const char *key)
{
    struct cache_entry *e = cache_look_up(cache, key);
    if (e) cache_hold(e);
    return e;
}

bool cache_has(const struct cache *cache, const char *key)
{
    const struct cache_entry *e = cache_look_up(cache, key);
    return e && e->state == CACHE_READY;
}

struct cache_entry *cache_get(struct cache *cache, const char *key, bool *fresh)
{
    struct cache_entry *e = cache_find(cache, key);
    *fresh = !e;
    if (e) {
        cache->counts.hits++;
        return e;
    }
    cache->counts.misses++;
    e = calloc(1, sizeof *e);
    if (!e || !(e->key = strdup(key))) {
        free(e);
        cache_hold(&cache->no_memory);
        *fresh = false;
        return &cache->no_memory;
    }
    e->cache = cache;
    e->refs = 1;
    e->hash = prt_hash64(key, strlen(key), cache->seed);
    if (cache->counts.entries >= cache->n_bucket) grow(cache);
    struct cache_entry **bucket = bucket_of(cache, e->hash);
    e->chain = *bucket;
    *bucket = e;
    enter_beginnings(cache, e);
    cache->counts.entries++;
    cache->counts.bytes += overhead(e);
    return e;
}

void cache_hold(struct cache_entry *e)
{
    if (!e->refs++ && e->state != CACHE_FAILED) unlink_use(e->cache, e);
}

void cache_release(struct cache_entry *e)
{
    if (!e) return;
    assert(e->refs);
    if (--e->refs) return;
    struct cache *cache = e->cache;
    if (e->state != CACHE_READY || e->forgotten) { // it was removed from the table already
        bool freed_file = e->holds_file && cache->files;
        free_entry(cache, e);
        admit_next(freed_file ? cache->files : cache);
        return;
    }
    link_use(cache, e);
    bool holds_file = e->holds_file;
    keep_budget(cache); // may evict it
    if (holds_file && cache->files) keep_budget(cache->files);
    admit_next(holds_file && cache->files ? cache->files : cache);
}

// A call may end the waits of others, as where an answer closes its connection.
static void wake_all(struct cache_entry *e)
{
    for (struct cache_waiter *w; (w = e->waiters);) {
        e->waiters = w->next;
        w->wake(w);
    }
}

void cache_fill(struct cache_entry *e, void *value, size_t bytes, void (*destroy)(void *))
{
    assert(e->state == CACHE_PENDING && e->refs);
    e->state = CACHE_READY;
    e->value = value;
    e->bytes = bytes;
    e->destroy = destroy;
    e->cache->counts.bytes += bytes;
    e->cache->values += bytes;
    if (e->owner) e->owner->bytes += bytes;
    keep_budget(e->cache);
    wake_all(e);
}

void cache_grow(struct cache_entry *e, size_t bytes)
{
    assert(e->state == CACHE_READY && e->refs);
    e->bytes += bytes;
    e->cache->counts.bytes += bytes;
    e->cache->values += bytes;
    if (e->owner) e->owner->bytes += bytes;
    keep_budget(e->cache);
}

void cache_fail(struct cache_entry *e, int error_code, const char *text)
{
    assert(e->state == CACHE_PENDING && e->refs);
    e->state = CACHE_FAILED;
    e->error_code = error_code;
    snprintf(e->error, sizeof e->error, "%s", text);
    unlink_key(e->cache, e);
    wake_all(e);
}

void cache_wait(struct cache_entry *e, struct cache_waiter *waiter)
{
    assert(e->state == CACHE_PENDING);
    struct cache_waiter **last = &e->waiters;
    while (*last) last = &(*last)->next; // woken in the order of their calls
    waiter->next = NULL;
    *last = waiter;
}

void cache_leave(struct cache_entry *e, struct cache_waiter *waiter)
{
    struct cache_waiter **at = &e->waiters;
    while (*at && *at != waiter) at = &(*at)->next;
    assert(*at);
    *at = waiter->next;
    if (e->state != CACHE_PENDING) return;
    if (!e->waiters && e->refs == 2 && e->unwanted) e->unwanted(e);
}

// Removes an entry from the table; collects unreferenced ones in *unused.
static void leave(struct cache *cache, struct cache_entry *e, struct cache_entry **unused)
{
    if (e->forgotten || e->state == CACHE_FAILED) return;
    unlink_key(cache, e);
    e->forgotten = true;
    if (e->refs) return;
    unlink_use(cache, e);
    e->chain = *unused;
    *unused = e;
}

static void free_list(struct cache *cache, struct cache_entry *e)
{
    for (struct cache_entry *next; e; e = next) {
        next = e->chain;
        free_entry(cache, e); // which may release entries of any cache
    }
}

static bool begins(const struct cache_entry *e, const char *prefix, bool pending)
{
    return !strncmp(e->key, prefix, strlen(prefix)) && (pending || e->state != CACHE_PENDING);
}

// Those of a model, or of its generation.
static void leave_alike(struct cache *cache, const char *prefix, bool pending, int which,
                        struct cache_entry **unused)
{
    uint64_t hash = prt_hash64(prefix, cache_beginning(prefix, which), cache->seed);
    for (struct cache_entry *e = cache->begin[which][hash % cache->n_bucket], *next; e;
         e = next) {
        next = e->beginning[which].next;
        if (begins(e, prefix, pending)) leave(cache, e, unused);
    }
}

void cache_forget(struct cache *cache, const char *prefix, bool pending)
{
    struct cache_entry *unused = NULL;
    if (cache_beginning(prefix, 1)) leave_alike(cache, prefix, pending, 1, &unused);
    else if (cache_beginning(prefix, 0)) leave_alike(cache, prefix, pending, 0, &unused);
    else
        for (size_t i = 0; i < cache->n_bucket; i++)
            for (struct cache_entry *e = cache->bucket[i], *next; e; e = next) {
                next = e->chain;
                if (begins(e, prefix, pending)) leave(cache, e, &unused);
            }
    free_list(cache, unused);
}

void cache_forget_entry(struct cache_entry *e)
{
    struct cache_entry *unused = NULL;
    struct cache *cache = e->cache;
    leave(cache, e, &unused);
    free_list(cache, unused);
}

void cache_count(const struct cache *cache, struct cache_counts *out)
{
    *out = cache->counts;
}
