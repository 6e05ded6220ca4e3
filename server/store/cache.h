/* SPDX-License-Identifier: MIT */
/* cache.h owns the shared results: decoded environments, cubemaps, visibility buffers, colours.
 * An entry is pending until its creator fills or fails it; other users wait meanwhile. Beyond
 * the budget, unreferenced entries are evicted, least recently used first. An entry's size is
 * that of its value, its struct and its key. Loop thread only; values are read by workers while
 * their entry is held. */
#ifndef RELIGHTD_CACHE_H
#define RELIGHTD_CACHE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum cache_state { CACHE_PENDING, CACHE_READY, CACHE_FAILED };

struct cache_waiter {
    struct cache_waiter *next;
    void (*wake)(struct cache_waiter *waiter); /* the entry is ready or failed */
};

/* A chain of the entries whose keys begin alike. */
struct cache_link {
    uint64_t hash; /* of that beginning */
    struct cache_entry *next, **at;
};
enum { CACHE_BEGINNINGS = 2 }; /* MODEL/ and MODEL/GENERATION/ */

/* A principal that made entries. */
struct cache_owner {
    struct cache_owner *next;
    char name[96];
    size_t bytes, promised; /* of values; of admissions without their value */
    unsigned n_entry;
};

struct cache_entry {
    struct cache_entry *chain;                       /* of its hash bucket */
    struct cache_link beginning[CACHE_BEGINNINGS];   /* at is NULL: it is in no such chain */
    struct cache_entry *newer, *older;               /* use order, while unreferenced */
    struct cache_entry *newer_holder, *older_holder; /* the same of those that hold a file */
    uint64_t hash;
    char *key;
    enum cache_state state;
    unsigned refs;
    void *value;
    size_t bytes;
    void (*destroy)(void *value);
    float ms;       /* time to compute it */
    int error_code; /* protocol's error code when FAILED */
    char error[320];
    struct cache_waiter *waiters;
    struct cache *cache;
    /* Called by cache_leave when nobody waits any more; job: its argument's owner. NULL: the
     * entry is computed in any case. Set by the creator. */
    void (*unwanted)(struct cache_entry *entry);
    void *job;
    struct cache_owner *owner; /* NULL: nobody's */
    bool forgotten;            /* removed from the table; freed with its last reference */
    bool holds_file; /* its value holds an entry of another cache: set before cache_fill */
    bool
        any_thread; /* its value, when large, is destroyed by a worker: set before cache_fill */
};

struct cache;
int cache_create(size_t budget_bytes, struct cache **out);
void cache_destroy(struct cache *cache); /* every entry must have been released */

/* Large values that any thread may destroy are destroyed by workers: unmapping hundreds of MB
 * takes tens of milliseconds. NULL, as at first: the loop destroys them. */
struct work_pool;
void cache_use_workers(struct cache *cache, struct work_pool *pool);

/* The entry of this key, with a reference for the caller. *fresh: it is new, and the caller
 * has to call cache_fill or cache_fail once, and to hold the entry until then. Without memory a
 * failed entry with this code. */
enum { CACHE_ERROR_NO_MEMORY = 16 }; /* the protocol's ERROR_NO_MEMORY */
struct cache_entry *cache_get(struct cache *cache, const char *key, bool *fresh);
/* The entry of this key, with a reference, or NULL; creates none. */
struct cache_entry *cache_find(struct cache *cache, const char *key);
/* Whether a ready entry of this key is there. To ask is no use of it. */
bool cache_has(const struct cache *cache, const char *key);
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry); /* NULL is fine */
/* Takes over the value and wakes the waiters. */
void cache_fill(struct cache_entry *entry, void *value, size_t bytes, void (*destroy)(void *));
/* A ready entry that the caller holds takes so many more bytes than it was filled with. */
void cache_grow(struct cache_entry *entry, size_t bytes);
/* Wakes the waiters and removes the entry from the table: a later request computes it again. */
void cache_fail(struct cache_entry *entry, int error_code, const char *text);
/* Before cache_fill: who caused the entry. Beyond the budget those go first whose owner's
 * entries take more than an equal share of it among the owners, then the least recently used.
 * Without memory it stays nobody's. */
void cache_set_owner(struct cache_entry *entry, const char *name);
void cache_wait(struct cache_entry *entry, struct cache_waiter *waiter);
/* A waiter whose wake was not called yet stops waiting for the entry, which the caller holds:
 * also where the entry has ended and others are being woken. When the entry is pending, it was
 * the last and only the entry's job holds it besides, the entry's `unwanted` is called. */
void cache_leave(struct cache_entry *entry, struct cache_waiter *waiter);
/* Removes all entries whose key begins with the prefix (a model was unloaded): they cannot be
 * found any more, and their users keep them. `pending`: pending entries, too. Takes time for
 * the entries of the model, or of its generation where the prefix is MODEL/NUMBER/… with digits
 * alone; for a prefix without a slash, for all entries. */
void cache_forget(struct cache *cache, const char *prefix, bool pending);
/* The same for one entry, in the table or not. */
void cache_forget_entry(struct cache_entry *entry);
/* Values of `holders` (holds_file) hold entries of `files`: where those are over their budget
 * and all in use, unreferenced holders are evicted. */
void cache_hold_files(struct cache *holders, struct cache *files);

/* Room for a value before it is made. Those that ask get it in their order: when it fits beside
 * what is held and promised, or when nothing else is held, so that a value above the budget is
 * alone. `admitted` is called once, at once or later; until cache_admission_end the room counts
 * as taken. */
struct cache_admission {
    struct cache_admission *next;
    size_t bytes;
    void (*admitted)(struct cache_admission *admission);
    struct cache_owner *owner; /* of an entry that the caller holds; NULL: nobody */
    bool holds;
};
void cache_admit(struct cache *cache, struct cache_admission *admission);
/* Those that wait and can never be admitted, for which `fits` is false by now, leave the queue;
 * `refused` is called for each. */
void cache_admissions_check(struct cache *cache,
                            bool (*fits)(const struct cache_admission *admission),
                            void (*refused)(struct cache_admission *admission));
/* After cache_fill or cache_fail. */
void cache_admission_end(struct cache *cache, struct cache_admission *admission);

/* Memory of the workers that is no entry's counts towards the budget, too, from cache_charge
 * until cache_discharge: entries that nobody holds make room for it. */
void cache_charge(struct cache *cache, size_t bytes);
void cache_discharge(struct cache *cache, size_t bytes);
size_t cache_budget(const struct cache *cache);

struct cache_counts {
    uint64_t hits, misses, evictions;
    size_t bytes, entries;
};
void cache_count(const struct cache *cache, struct cache_counts *out);

#endif
