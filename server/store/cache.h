/* SPDX-License-Identifier: MIT */
/* cache.h owns what is computed once and shared: decoded environments, cubemaps, visibility
 * buffers, colours. An entry is pending until its maker fills or fails it; who asks meanwhile
 * waits. Unreferenced entries leave, least recently used first, when the budget is spent. An
 * entry counts with its value, itself and its key.
 * Loop thread only; values are read by workers while their entry is held. */
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

struct cache_entry {
    struct cache_entry *chain;         /* of its hash bucket */
    struct cache_entry *newer, *older; /* use order, while unreferenced */
    uint64_t hash;
    char *key;
    enum cache_state state;
    unsigned refs;
    void *value;
    size_t bytes;
    void (*destroy)(void *value);
    float ms;       /* what making it took */
    int error_code; /* protocol's error code when FAILED */
    char error[320];
    struct cache_waiter *waiters;
    struct cache *cache;
    bool forgotten;  /* left the table; freed with its last reference */
    bool holds_file; /* its value holds an entry of another cache */
    bool any_thread; /* its value, when large, is destroyed by a worker: set before cache_fill */
};

struct cache;
int cache_create(size_t budget_bytes, struct cache **out);
void cache_destroy(struct cache *cache); /* every entry must have been released */

/* Workers destroy large values that any thread may destroy: giving back a map of hundreds of MB
 * takes tens of milliseconds. NULL, as at first: none does. */
struct work_pool;
void cache_use_workers(struct cache *cache, struct work_pool *pool);

/* The entry of this key, with a reference for the caller. *fresh: it was not there, and the
 * caller is its maker: it calls cache_fill or cache_fail once, holding the entry until then. */
struct cache_entry *cache_get(struct cache *cache, const char *key, bool *fresh);
/* The same, NULL where there is none. */
struct cache_entry *cache_find(struct cache *cache, const char *key);
void cache_hold(struct cache_entry *entry);
void cache_release(struct cache_entry *entry); /* NULL is fine */
/* Wakes the waiters. The value belongs to the entry from here on. */
void cache_fill(struct cache_entry *entry, void *value, size_t bytes, void (*destroy)(void *));
/* Wakes the waiters; the entry is forgotten, so that a later request tries anew. */
void cache_fail(struct cache_entry *entry, int error_code, const char *text);
void cache_wait(struct cache_entry *entry, struct cache_waiter *waiter);
/* Forgets all entries whose key starts so (a model was unloaded): nobody finds them any more,
 * and who uses one keeps it. `pending`: those that are still being made, too. */
void cache_forget(struct cache *cache, const char *prefix, bool pending);
/* The same of one entry, found or not. */
void cache_forget_entry(struct cache_entry *entry);
/* Values of `holders` (holds_file) hold entries of `files`: where those are over their budget
 * and all in use, holders that nobody uses go first. */
void cache_hold_files(struct cache *holders, struct cache *files);

struct cache_counts {
    uint64_t hits, misses, evictions;
    size_t bytes, entries;
};
void cache_count(const struct cache *cache, struct cache_counts *out);

#endif
