/* SPDX-License-Identifier: MIT */
/* memo.h owns what is computed once and shared: decoded environments, cubemaps, visibility
 * buffers, colours. An entry is pending until its maker fills or fails it; who asks meanwhile
 * waits. Unreferenced entries leave, least recently used first, when the budget is spent.
 * Loop thread only; values are read by workers while their entry is held. */
#ifndef RELIGHTD_MEMO_H
#define RELIGHTD_MEMO_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum memo_state { MEMO_PENDING, MEMO_READY, MEMO_FAILED };

struct memo_waiter {
    struct memo_waiter *next;
    void (*wake)(struct memo_waiter *waiter); /* the entry is ready or failed */
};

struct memo_entry {
    struct memo_entry *chain;         /* of its hash bucket */
    struct memo_entry *newer, *older; /* use order, while unreferenced */
    uint64_t hash;
    char *key;
    enum memo_state state;
    unsigned refs;
    void *value;
    size_t bytes;
    void (*destroy)(void *value);
    float ms;       /* what making it took */
    int error_code; /* protocol's error code when FAILED */
    char error[320];
    struct memo_waiter *waiters;
    struct memo *memo;
    bool forgotten;  /* left the table; freed with its last reference */
    bool holds_file; /* its value holds an entry of another memo */
};

struct memo;
int memo_create(size_t budget_bytes, struct memo **out);
void memo_destroy(struct memo *memo); /* every entry must have been released */

/* The entry of this key, with a reference for the caller. *fresh: it was not there, and the
 * caller is its maker: it calls memo_fill or memo_fail once, holding the entry until then. */
struct memo_entry *memo_get(struct memo *memo, const char *key, bool *fresh);
/* The same, NULL where there is none. */
struct memo_entry *memo_find(struct memo *memo, const char *key);
void memo_hold(struct memo_entry *entry);
void memo_release(struct memo_entry *entry); /* NULL is fine */
/* Wakes the waiters. The value belongs to the entry from here on. */
void memo_fill(struct memo_entry *entry, void *value, size_t bytes, void (*destroy)(void *));
/* Wakes the waiters; the entry is forgotten, so that a later request tries anew. */
void memo_fail(struct memo_entry *entry, int error_code, const char *text);
void memo_wait(struct memo_entry *entry, struct memo_waiter *waiter);
/* Forgets all entries whose key starts so (a model was unloaded): nobody finds them any more,
 * and who uses one keeps it. `pending`: those that are still being made, too. */
void memo_forget(struct memo *memo, const char *prefix, bool pending);
/* The same of one entry, found or not. */
void memo_forget_entry(struct memo_entry *entry);
/* Values of `holders` (holds_file) hold entries of `files`: where those are over their budget
 * and all in use, holders that nobody uses go first. */
void memo_hold_files(struct memo *holders, struct memo *files);

struct memo_counts {
    uint64_t hits, misses, evictions;
    size_t bytes, entries;
};
void memo_count(const struct memo *memo, struct memo_counts *out);

#endif
