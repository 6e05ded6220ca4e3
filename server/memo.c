// SPDX-License-Identifier: MIT
// The table of shared results: chained hashing by key text, and a use-ordered list of entries
// that nobody holds.
#include "memo.h"

#include "prt/base.h"

#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { N_BUCKET = 4096 };

struct memo {
    struct memo_entry *bucket[N_BUCKET];
    struct memo_entry *newest, *oldest;
    size_t budget;
    struct memo_counts counts;
    struct memo *files;   // entries of it are held by values of this one
    struct memo *holders; // the other way round
    bool relieving;
};

int memo_create(size_t budget_bytes, struct memo **out)
{
    struct memo *memo = calloc(1, sizeof *memo);
    if (!memo) return PRT_NOMEM;
    memo->budget = budget_bytes;
    *out = memo;
    return PRT_OK;
}

static void unlink_use(struct memo *memo, struct memo_entry *e)
{
    *(e->newer ? &e->newer->older : &memo->newest) = e->older;
    *(e->older ? &e->older->newer : &memo->oldest) = e->newer;
    e->newer = e->older = NULL;
}

static void unlink_key(struct memo *memo, struct memo_entry *e)
{
    struct memo_entry **at = &memo->bucket[e->hash % N_BUCKET];
    while (*at && *at != e) at = &(*at)->chain;
    if (*at) {
        *at = e->chain;
        memo->counts.entries--;
    }
    e->chain = NULL;
}

static void free_entry(struct memo *memo, struct memo_entry *e)
{
    if (e->value && e->destroy) e->destroy(e->value);
    memo->counts.bytes -= e->bytes;
    free(e->key);
    free(e);
}

static void drop(struct memo *memo, struct memo_entry *e)
{
    unlink_use(memo, e);
    unlink_key(memo, e);
    free_entry(memo, e);
}

// The one used longest ago, of those that nobody uses.
static bool drop_holder(struct memo *memo)
{
    struct memo_entry *e = memo->oldest;
    while (e && !e->holds_file) e = e->newer;
    if (!e) return false;
    memo->counts.evictions++;
    drop(memo, e);
    return true;
}

static void keep_budget(struct memo *memo)
{
    while (memo->counts.bytes > memo->budget && memo->oldest) {
        memo->counts.evictions++;
        drop(memo, memo->oldest);
    }
    if (memo->relieving || !memo->holders) return;
    memo->relieving = true; // what is let go comes back here, and is dropped
    while (memo->counts.bytes > memo->budget && drop_holder(memo->holders)) continue;
    memo->relieving = false;
}

void memo_hold_files(struct memo *holders, struct memo *files)
{
    holders->files = files;
    files->holders = holders;
}

void memo_destroy(struct memo *memo)
{
    if (!memo) return;
    while (memo->oldest) drop(memo, memo->oldest);
    free(memo);
}

struct memo_entry *memo_find(struct memo *memo, const char *key)
{
    uint64_t hash = prt_hash64(key, strlen(key), 1);
    struct memo_entry *e = memo->bucket[hash % N_BUCKET];
    while (e && (e->hash != hash || strcmp(e->key, key))) e = e->chain;
    if (e) memo_hold(e);
    return e;
}

struct memo_entry *memo_get(struct memo *memo, const char *key, bool *fresh)
{
    struct memo_entry *e = memo_find(memo, key);
    *fresh = !e;
    if (e) {
        memo->counts.hits++;
        return e;
    }
    memo->counts.misses++;
    e = calloc(1, sizeof *e);
    if (!e || !(e->key = strdup(key))) abort(); // a few hundred bytes: nothing left to save
    e->memo = memo;
    e->refs = 1;
    e->hash = prt_hash64(key, strlen(key), 1);
    e->chain = memo->bucket[e->hash % N_BUCKET];
    memo->bucket[e->hash % N_BUCKET] = e;
    memo->counts.entries++;
    return e;
}

void memo_hold(struct memo_entry *e)
{
    if (!e->refs++ && e->state != MEMO_FAILED) unlink_use(e->memo, e);
}

void memo_release(struct memo_entry *e)
{
    if (!e) return;
    assert(e->refs);
    if (--e->refs) return;
    struct memo *memo = e->memo;
    if (e->state != MEMO_READY || e->forgotten) { // it left the table already
        free_entry(memo, e);
        return;
    }
    e->older = memo->newest;
    *(memo->newest ? &memo->newest->newer : &memo->oldest) = e;
    memo->newest = e;
    bool holds_file = e->holds_file;
    keep_budget(memo); // may drop it
    if (holds_file && memo->files) keep_budget(memo->files);
}

static void wake_all(struct memo_entry *e)
{
    struct memo_waiter *w = e->waiters;
    e->waiters = NULL;
    while (w) {
        struct memo_waiter *next = w->next;
        w->wake(w);
        w = next;
    }
}

void memo_fill(struct memo_entry *e, void *value, size_t bytes, void (*destroy)(void *))
{
    assert(e->state == MEMO_PENDING && e->refs);
    e->state = MEMO_READY;
    e->value = value;
    e->bytes = bytes;
    e->destroy = destroy;
    e->memo->counts.bytes += bytes;
    keep_budget(e->memo);
    wake_all(e);
}

void memo_fail(struct memo_entry *e, int error_code, const char *text)
{
    assert(e->state == MEMO_PENDING && e->refs);
    e->state = MEMO_FAILED;
    e->error_code = error_code;
    snprintf(e->error, sizeof e->error, "%s", text);
    unlink_key(e->memo, e);
    wake_all(e);
}

void memo_wait(struct memo_entry *e, struct memo_waiter *waiter)
{
    assert(e->state == MEMO_PENDING);
    struct memo_waiter **last = &e->waiters;
    while (*last) last = &(*last)->next; // served in the order they came
    waiter->next = NULL;
    *last = waiter;
}

// Out of the table; nothing is freed yet.
static void leave(struct memo *memo, struct memo_entry *e, struct memo_entry **unused)
{
    if (e->forgotten || e->state == MEMO_FAILED) return;
    unlink_key(memo, e);
    e->forgotten = true;
    if (e->refs) return;
    unlink_use(memo, e);
    e->chain = *unused;
    *unused = e;
}

static void free_list(struct memo *memo, struct memo_entry *e)
{
    for (struct memo_entry *next; e; e = next) {
        next = e->chain;
        free_entry(memo, e); // which may release entries of any memo
    }
}

void memo_forget(struct memo *memo, const char *prefix, bool pending)
{
    size_t n = strlen(prefix);
    struct memo_entry *unused = NULL;
    for (int i = 0; i < N_BUCKET; i++)
        for (struct memo_entry *e = memo->bucket[i], *next; e; e = next) {
            next = e->chain;
            if (!strncmp(e->key, prefix, n) && (pending || e->state != MEMO_PENDING))
                leave(memo, e, &unused);
        }
    free_list(memo, unused);
}

void memo_forget_entry(struct memo_entry *e)
{
    struct memo_entry *unused = NULL;
    struct memo *memo = e->memo;
    leave(memo, e, &unused);
    free_list(memo, unused);
}

void memo_count(const struct memo *memo, struct memo_counts *out)
{
    *out = memo->counts;
}
