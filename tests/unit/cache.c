// SPDX-License-Identifier: MIT
// The cache of shared results: which entry goes first, and that every byte is counted.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/work.h"
#include "store/cache.h"

#include <pthread.h>
#include <time.h>

enum { VALUE = 1000 };

static unsigned n_destroyed;

static void destroy(void *value)
{
    n_destroyed++;
    free(value);
}

static size_t entry_bytes(const char *key, size_t value)
{
    return value + sizeof(struct cache_entry) + strlen(key) + 1;
}

static size_t bytes_of(const struct cache *cache)
{
    struct cache_counts counts;
    cache_count(cache, &counts);
    return counts.bytes;
}

// Makes the entry if it is not there, and lets go of it; true when it was there.
static bool use(struct cache *cache, const char *key)
{
    bool fresh;
    struct cache_entry *e = cache_get(cache, key, &fresh);
    if (fresh) cache_fill(e, malloc(VALUE), VALUE, destroy);
    cache_release(e);
    return !fresh;
}

static bool is_there(struct cache *cache, const char *key)
{
    struct cache_entry *e = cache_find(cache, key);
    if (!e) return false;
    assert_string_equal(e->key, key);
    cache_release(e);
    return true;
}

static void test_least_recently_used_goes(void **state)
{
    struct cache *cache;
    assert_int_equal(cache_create(2 * entry_bytes("A", VALUE), &cache), 0);
    n_destroyed = 0;
    assert_false(use(cache, "A"));
    assert_false(use(cache, "B"));
    assert_true(use(cache, "A")); // both fit
    assert_int_equal(bytes_of(cache), 2 * entry_bytes("A", VALUE));
    assert_int_equal(n_destroyed, 0);
    assert_false(use(cache, "C"));
    assert_int_equal(n_destroyed, 1);
    assert_false(is_there(cache, "B"));
    assert_true(is_there(cache, "A"));
    assert_true(is_there(cache, "C"));
    assert_true(cache_has(cache, "A") && !cache_has(cache, "B"));
    struct cache_counts counts;
    cache_count(cache, &counts);
    assert_int_equal(counts.evictions, 1);
    assert_int_equal(counts.entries, 2);
    assert_int_equal(counts.hits, 1);
    assert_int_equal(counts.misses, 3);
    assert_int_equal(counts.bytes, 2 * entry_bytes("A", VALUE));
    cache_destroy(cache);
    assert_int_equal(n_destroyed, 3);
}

// One byte less than two entries take is a budget for one.
static void test_budget_is_exact(void **state)
{
    struct cache *cache;
    assert_int_equal(cache_create(2 * entry_bytes("A", VALUE) - 1, &cache), 0);
    use(cache, "A");
    use(cache, "B");
    assert_false(is_there(cache, "A"));
    assert_true(is_there(cache, "B"));
    assert_int_equal(bytes_of(cache), entry_bytes("B", VALUE));
    cache_destroy(cache);
}

// Entries in use, pending, failed and forgotten ones are counted until they are freed.
// It pushes others out as if it had been as large from the start, and takes all with it.
static void test_a_value_that_grows(void **state)
{
    struct cache *cache;
    bool fresh;
    assert_int_equal(cache_create(3 * entry_bytes("a", VALUE), &cache), 0);
    use(cache, "a");
    use(cache, "b");
    struct cache_entry *e = cache_get(cache, "c", &fresh);
    cache_fill(e, malloc(VALUE), VALUE, destroy);
    assert_true(is_there(cache, "a") && is_there(cache, "b"));
    cache_grow(e, VALUE);
    assert_int_equal(bytes_of(cache), entry_bytes("b", VALUE) + entry_bytes("c", 2 * VALUE));
    assert_false(is_there(cache, "a"));
    cache_release(e);
    cache_forget(cache, "c", false);
    assert_int_equal(bytes_of(cache), entry_bytes("b", VALUE));
    cache_destroy(cache);
}

static void test_every_state_is_counted(void **state)
{
    struct cache *cache;
    bool fresh;
    assert_int_equal(cache_create(1 << 20, &cache), 0);
    struct cache_entry *pending = cache_get(cache, "model/1", &fresh);
    assert_int_equal(bytes_of(cache), entry_bytes("model/1", 0));
    struct cache_entry *failing = cache_get(cache, "model/22", &fresh);
    cache_fail(failing, 1, "no");
    assert_int_equal(bytes_of(cache), entry_bytes("model/1", 0) + entry_bytes("model/22", 0));
    cache_release(failing);
    assert_int_equal(bytes_of(cache), entry_bytes("model/1", 0));
    cache_fill(pending, malloc(VALUE), VALUE, destroy);
    cache_forget(cache, "model/", true);
    assert_false(is_there(cache, "model/1"));
    assert_int_equal(bytes_of(cache), entry_bytes("model/1", VALUE));
    cache_release(pending);
    assert_int_equal(bytes_of(cache), 0);
    use(cache, "model/1");
    cache_forget(cache, "model/", true);
    assert_int_equal(bytes_of(cache), 0);
    cache_destroy(cache);
}

// Small values do not make a cache without end: an entry counts with its key.
static void test_small_values_are_bounded(void **state)
{
    struct cache *cache;
    char key[32];
    assert_int_equal(cache_create(100 * entry_bytes("0001", 0), &cache), 0);
    for (int i = 0; i < 1000; i++) {
        bool fresh;
        snprintf(key, sizeof key, "%04d", i);
        struct cache_entry *e = cache_get(cache, key, &fresh);
        cache_fill(e, NULL, 0, NULL);
        cache_release(e);
    }
    struct cache_counts counts;
    cache_count(cache, &counts);
    assert_int_equal(counts.entries, 100);
    assert_false(is_there(cache, "0899"));
    assert_true(is_there(cache, "0900"));
    cache_destroy(cache);
}

// Results that are computed just now stay where only those that are there are forgotten.
static void test_pending_ones_stay(void **state)
{
    struct cache *cache;
    bool fresh;
    assert_int_equal(cache_create(1 << 20, &cache), 0);
    use(cache, "model/1");
    struct cache_entry *pending = cache_get(cache, "model/2", &fresh);
    cache_forget(cache, "model/", false);
    assert_false(is_there(cache, "model/1"));
    struct cache_entry *same = cache_get(cache, "model/2", &fresh);
    assert_ptr_equal(same, pending);
    assert_false(fresh);
    cache_fill(pending, malloc(VALUE), VALUE, destroy);
    cache_release(same);
    cache_release(pending);
    assert_true(is_there(cache, "model/2"));
    pending = cache_get(cache, "model/3", &fresh);
    cache_forget(cache, "model/", true);
    assert_false(is_there(cache, "model/2") || is_there(cache, "model/3"));
    cache_fill(pending, malloc(VALUE), VALUE, destroy);
    cache_release(pending);
    assert_int_equal(bytes_of(cache), 0);
    cache_destroy(cache);
}

struct waiting {
    struct cache_waiter waiter; // first
    unsigned at;                // when it was woken; 0: not yet
};

static unsigned n_woken, n_unwanted;

static void wake(struct cache_waiter *waiter)
{
    ((struct waiting *)waiter)->at = ++n_woken;
}

static void count_unwanted(struct cache_entry *e)
{
    n_unwanted++;
}

// Who waits is woken in the order of coming, who left is not; a result is unwanted when nobody
// but its job holds it any more.
static void test_waiters(void **state)
{
    enum { N = 3 };
    struct cache *cache;
    struct waiting w[N] = {{.at = 0}};
    bool fresh;
    assert_int_equal(cache_create(1 << 20, &cache), 0);
    struct cache_entry *e = cache_get(cache, "a", &fresh); // the job's
    e->unwanted = count_unwanted;
    n_woken = n_unwanted = 0;
    for (int i = 0; i < N; i++) {
        w[i].waiter.wake = wake;
        assert_ptr_equal(cache_get(cache, "a", &fresh), e);
        cache_wait(e, &w[i].waiter);
    }
    for (int i = N; i-- > 0;) { // the last holds it alone besides the job
        cache_leave(e, &w[i].waiter);
        assert_int_equal(n_unwanted, i == 0);
        cache_release(e);
    }
    assert_ptr_equal(cache_get(cache, "a", &fresh), e); // held, and not waited for
    cache_hold(e);
    cache_wait(e, &w[0].waiter);
    cache_leave(e, &w[0].waiter);
    assert_int_equal(n_unwanted, 1);
    for (int i = 0; i < N; i++) cache_wait(e, &w[i].waiter);
    cache_leave(e, &w[1].waiter);
    cache_fill(e, malloc(VALUE), VALUE, destroy);
    assert_int_equal(w[0].at, 1);
    assert_int_equal(w[1].at, 0);
    assert_int_equal(w[2].at, 2);
    for (int i = 0; i < 3; i++) cache_release(e);
    cache_destroy(cache);
}

struct leaver {
    struct cache_waiter waiter; // first
    struct cache_entry *entry;
    struct waiting *other;
};

static void leave_for_another(struct cache_waiter *waiter)
{
    struct leaver *l = (struct leaver *)waiter;
    cache_leave(l->entry, &l->other->waiter);
    memset(l->other, 0xa5, sizeof *l->other); // it is freed
}

// One that is woken may end the wait of another, which is not woken then.
static void test_leaving_while_others_are_woken(void **state)
{
    struct cache *cache;
    struct waiting gone = {.waiter.wake = wake}, last = gone;
    bool fresh;
    assert_int_equal(cache_create(1 << 20, &cache), 0);
    for (int fails = 0; fails < 2; fails++) {
        struct cache_entry *e = cache_get(cache, fails ? "bad" : "good", &fresh);
        struct leaver first = {{.wake = leave_for_another}, e, &gone};
        n_woken = n_unwanted = 0;
        e->unwanted = count_unwanted;
        gone = last = (struct waiting){.waiter.wake = wake};
        cache_hold(e);
        cache_wait(e, &first.waiter);
        cache_wait(e, &gone.waiter);
        cache_wait(e, &last.waiter);
        if (fails) cache_fail(e, 1, "no");
        else cache_fill(e, malloc(VALUE), VALUE, destroy);
        assert_int_equal(n_woken, 1);
        assert_int_equal(last.at, 1);
        assert_int_equal(n_unwanted, 0);
        for (int i = 0; i < 2; i++) cache_release(e);
    }
    cache_destroy(cache);
}

static unsigned longest_chain(const struct cache_entry *const *entry, unsigned n)
{
    unsigned longest = 0;
    for (unsigned i = 0; i < n; i++) {
        unsigned length = 0;
        for (const struct cache_entry *e = entry[i]; e; e = e->chain) length++;
        if (length > longest) longest = length;
    }
    return longest;
}

// The table grows with its load: chains stay short, and all entries are found.
static void test_table_grows(void **state)
{
    enum { N = 100000 };
    struct cache *cache;
    char key[32];
    bool fresh;
    static struct cache_entry *entry[N];
    assert_int_equal(cache_create((size_t)1 << 30, &cache), 0);
    for (unsigned i = 0; i < N; i++) {
        snprintf(key, sizeof key, "key %u", i);
        entry[i] = cache_get(cache, key, &fresh);
        assert_true(fresh);
        cache_fill(entry[i], NULL, 0, NULL);
    }
    for (unsigned i = 0; i < N; i++) {
        snprintf(key, sizeof key, "key %u", i);
        struct cache_entry *e = cache_find(cache, key);
        assert_ptr_equal(e, entry[i]);
        cache_release(e);
    }
    // 4096 buckets would make chains of 24 and more.
    assert_true(longest_chain((const struct cache_entry *const *)entry, N) < 16);
    for (unsigned i = 0; i < N; i++) cache_release(entry[i]);
    cache_forget(cache, "key ", true);
    assert_int_equal(bytes_of(cache), 0);
    cache_destroy(cache);
}

// Nobody can prepare keys that share a bucket: the hash differs from process to process, as it
// does from cache to cache.
static void test_hash_is_seeded(void **state)
{
    struct cache *cache[2];
    struct cache_entry *entry[2];
    bool fresh;
    for (int i = 0; i < 2; i++) {
        assert_int_equal(cache_create(1 << 20, &cache[i]), 0);
        entry[i] = cache_get(cache[i], "the same key", &fresh);
        cache_fill(entry[i], NULL, 0, NULL);
    }
    assert_int_not_equal(entry[0]->hash, entry[1]->hash);
    for (int i = 0; i < 2; i++) {
        cache_release(entry[i]);
        cache_destroy(cache[i]);
    }
}

static pthread_t destroyed_by;

static void destroy_and_tell(void *value)
{
    n_destroyed++;
    destroyed_by = pthread_self();
    free(value);
}

// Giving back hundreds of MB takes long: a worker does it, where any thread may.
static void test_large_values_are_destroyed_by_a_worker(void **state)
{
    enum { LARGE = 8 << 20 };
    const struct {
        size_t bytes;
        bool any_thread, by_worker;
    } rows[] = {{LARGE, true, true}, {LARGE, false, false}, {VALUE, true, false}};
    struct loop *loop;
    struct work_pool *pool;
    struct cache *cache;
    assert_int_equal(loop_create(&loop), 0);
    assert_int_equal(work_pool_create(loop, 1, 0, &pool), 0);
    assert_int_equal(cache_create(2 * LARGE, &cache), 0);
    cache_use_workers(cache, pool);
    for (size_t i = 0; i < sizeof rows / sizeof *rows; i++) {
        bool fresh;
        n_destroyed = 0;
        struct cache_entry *e = cache_get(cache, "image", &fresh);
        assert_true(fresh);
        e->any_thread = rows[i].any_thread;
        cache_fill(e, malloc(rows[i].bytes), rows[i].bytes, destroy_and_tell);
        cache_release(e);
        cache_forget(cache, "image", false);
        assert_int_equal(bytes_of(cache), 0);
        for (int turn = 0; work_busy(pool) && turn < 1000; turn++) loop_turn(loop, 10);
        assert_int_equal(n_destroyed, 1);
        assert_true(!pthread_equal(destroyed_by, pthread_self()) == rows[i].by_worker);
    }
    cache_use_workers(cache, NULL);
    work_pool_destroy(pool);
    cache_destroy(cache);
    loop_destroy(loop);
}

struct waiter {
    struct cache_admission admission;
    unsigned n;
};

static void admitted(struct cache_admission *admission)
{
    ((struct waiter *)admission)->n++;
}

static void ask(struct cache *cache, struct waiter *w, size_t bytes)
{
    *w = (struct waiter){.admission = {.bytes = bytes, .admitted = admitted}};
    cache_admit(cache, &w->admission);
}

// Room is promised in order, counts as taken, and is not given while values in use hold it.
static void test_room_is_promised(void **state)
{
    struct cache *cache;
    struct waiter a, b, c, d;
    bool fresh;
    assert_int_equal(cache_create(10 * VALUE, &cache), 0);
    use(cache, "old");
    ask(cache, &a, 6 * VALUE);
    assert_int_equal(a.n, 1);
    ask(cache, &b, 5 * VALUE);
    ask(cache, &c, VALUE); // would fit, and waits behind b
    assert_int_equal(b.n + c.n, 0);
    struct cache_entry *e = cache_get(cache, "a", &fresh);
    cache_fill(e, malloc(VALUE), 6 * VALUE, destroy);
    cache_admission_end(cache, &a.admission);
    assert_int_equal(b.n + c.n, 0); // a is in use
    assert_false(is_there(cache, "old"));
    cache_release(e);
    assert_int_equal(b.n, 1);
    assert_int_equal(c.n, 1);
    assert_false(is_there(cache, "a")); // made room for b
    cache_admission_end(cache, &b.admission);
    ask(cache, &d, 11 * VALUE); // above the budget: when it is alone
    assert_int_equal(d.n, 0);
    cache_admission_end(cache, &c.admission);
    assert_int_equal(d.n, 1);
    cache_admission_end(cache, &d.admission);
    cache_destroy(cache);
}

static bool is_small(const struct cache_admission *admission)
{
    return admission->bytes <= 3 * VALUE;
}

static unsigned n_refused;

static void refused(struct cache_admission *admission)
{
    n_refused++;
}

// What will never fit leaves the queue, and those behind it are admitted.
static void test_hopeless_admissions_leave(void **state)
{
    struct cache *cache;
    struct waiter a, b, c, d, last;
    assert_int_equal(cache_create(10 * VALUE, &cache), 0);
    n_refused = 0;
    ask(cache, &a, 6 * VALUE);
    ask(cache, &b, 5 * VALUE);
    ask(cache, &c, 2 * VALUE);
    ask(cache, &d, 4 * VALUE);
    assert_int_equal(a.n + b.n + c.n + d.n, 1);
    cache_admissions_check(cache, is_small, refused);
    assert_int_equal(n_refused, 2);
    assert_int_equal(b.n + d.n, 0);
    assert_int_equal(c.n, 1);
    ask(cache, &last, 3 * VALUE);
    assert_int_equal(last.n, 0);
    cache_admission_end(cache, &a.admission);
    assert_int_equal(last.n, 1);
    cache_admission_end(cache, &c.admission);
    cache_admission_end(cache, &last.admission);
    cache_destroy(cache);
}

// Memory beside the entries counts as theirs does, and makes an admission wait.
static void test_charges_take_room(void **state)
{
    struct cache *cache;
    struct waiter w;
    assert_int_equal(cache_create(10 * VALUE, &cache), 0);
    assert_int_equal(cache_budget(cache), 10 * VALUE);
    use(cache, "a");
    const size_t before = bytes_of(cache);
    cache_charge(cache, 5 * VALUE);
    assert_true(is_there(cache, "a"));
    assert_int_equal(bytes_of(cache), before + 5 * VALUE);
    cache_charge(cache, 5 * VALUE);
    assert_false(is_there(cache, "a"));
    cache_discharge(cache, 4 * VALUE);
    use(cache, "b");
    bool fresh;
    struct cache_entry *held = cache_get(cache, "held", &fresh);
    cache_fill(held, malloc(VALUE), VALUE, destroy);
    ask(cache, &w, 5 * VALUE);
    assert_int_equal(w.n, 0);
    cache_discharge(cache, 6 * VALUE);
    assert_int_equal(w.n, 1);
    cache_admission_end(cache, &w.admission);
    cache_release(held);
    cache_forget(cache, "", false);
    assert_int_equal(bytes_of(cache), 0);
    cache_destroy(cache);
}

static struct cache *files;

static void destroy_holder(void *value)
{
    n_destroyed++;
    cache_release(value);
}

// A ready entry whose value holds the file of this name.
static void hold_file(struct cache *holders, const char *name)
{
    bool fresh;
    struct cache_entry *file = cache_get(files, name, &fresh);
    if (fresh) cache_fill(file, malloc(VALUE), VALUE, destroy);
    struct cache_entry *e = cache_get(holders, name, &fresh);
    assert_true(fresh);
    e->holds_file = true;
    cache_fill(e, file, 1, destroy_holder);
    cache_release(e);
}

// Files beyond their budget: the holder used longest ago goes, and what holds no file stays,
// however old.
static void test_holders_release_files(void **state)
{
    struct cache *holders;
    assert_int_equal(cache_create(3 * VALUE + 3 * entry_bytes("x", 0), &files), 0);
    assert_int_equal(cache_create(100 * VALUE, &holders), 0);
    cache_hold_files(holders, files);
    use(holders, "plain");
    hold_file(holders, "a");
    use(holders, "plain2");
    hold_file(holders, "b");
    hold_file(holders, "c");
    assert_true(is_there(holders, "a")); // and is used last now
    hold_file(holders, "d");
    assert_false(is_there(holders, "b"));
    assert_false(is_there(files, "b"));
    assert_true(is_there(holders, "a") && is_there(holders, "c") && is_there(holders, "d"));
    cache_forget(holders, "a", false); // the oldest
    hold_file(holders, "e");
    assert_true(is_there(holders, "c") && is_there(holders, "d") && is_there(holders, "e"));
    hold_file(holders, "f");
    assert_false(is_there(holders, "c"));
    assert_true(is_there(holders, "d") && is_there(holders, "e") && is_there(holders, "f"));
    assert_true(is_there(holders, "plain") && is_there(holders, "plain2"));
    cache_forget(holders, "", false);
    assert_int_equal(bytes_of(holders), 0);
    cache_destroy(holders);
    cache_destroy(files);
}

// ---- shares

enum { FILE_BYTES = 100 * VALUE };

static void granted(struct cache_admission *a)
{
    assert_true(a->holds);
}

// Opens a file of this owner, as models do; `keeps`: it stays in use.
static struct cache_entry *open_file(const char *key, const char *owner, bool keeps)
{
    bool fresh;
    struct cache_entry *e = cache_get(files, key, &fresh);
    assert_true(fresh);
    cache_set_owner(e, owner);
    struct cache_admission a = {.bytes = FILE_BYTES, .admitted = granted, .owner = e->owner};
    cache_admit(files, &a);
    assert_true(a.holds);
    cache_fill(e, malloc(FILE_BYTES), FILE_BYTES, destroy);
    cache_admission_end(files, &a);
    if (keeps) return e;
    cache_release(e);
    return NULL;
}

// One that opens file after file takes the place of its own, not of another's within its share.
static void test_files_have_shares(void **state)
{
    struct cache *holders;
    bool fresh;
    char key[16];
    assert_int_equal(cache_create(4 * FILE_BYTES + 4 * entry_bytes("e/mesh", 0), &files), 0);
    assert_int_equal(cache_create(1 << 20, &holders), 0);
    cache_hold_files(holders, files);
    open_file("ann0", "ann", false);
    open_file("ann1", "ann", false);
    for (int i = 0; i < 9; i++) {
        snprintf(key, sizeof key, "eve%d", i);
        open_file(key, "eve", false);
    }
    assert_true(is_there(files, "ann0") && is_there(files, "ann1"));
    assert_true(is_there(files, "eve7") && is_there(files, "eve8"));
    // Alone she has all of it; of Ann's third file the oldest of hers goes.
    cache_forget(files, "ann", false);
    open_file("eve9", "eve", false);
    open_file("evea", "eve", false);
    open_file("ann2", "ann", false);
    assert_true(is_there(files, "ann2") && !is_there(files, "eve7"));
    // Results that hold files of hers go first, too.
    cache_forget(files, "eve", false);
    open_file("ann3", "ann", false);
    struct cache_entry *shape = cache_get(holders, "e/1/shape", &fresh);
    shape->holds_file = true;
    cache_fill(shape, open_file("e/mesh", "eve", true), 1, destroy_holder);
    cache_release(shape);
    open_file("eveb", "eve", false);
    open_file("evec", "eve", false);
    assert_true(is_there(files, "ann2") && is_there(files, "ann3"));
    assert_false(is_there(files, "e/mesh") && is_there(files, "eveb"));
    // Where all of hers are in use, others' make room: she is not kept from working.
    struct cache_entry *used[3];
    for (int i = 0; i < 3; i++) {
        snprintf(key, sizeof key, "use%d", i);
        used[i] = open_file(key, "eve", true);
    }
    assert_false(is_there(files, "ann2") && is_there(files, "ann3"));
    for (int i = 0; i < 3; i++) cache_release(used[i]);
    cache_forget(holders, "", false);
    cache_forget(files, "", false);
    assert_int_equal(bytes_of(files), 0);
    cache_destroy(holders);
    cache_destroy(files);
}

// ---- forgetting what begins alike

// Some have no generation, or something else in its place.
static void numbered(char key[64], unsigned model, unsigned generation, unsigned i)
{
    const char *form = i % 5 == 0   ? "m%u/%u.x/%u"
                       : i % 5 == 1 ? "m%u/light/%u/%u"
                                    : "m%u/%u/%u";
    snprintf(key, 64, form, model, generation, i);
}

enum { MODELS = 7, GENERATIONS = 12, EACH = 20 };

static unsigned n_beginning(struct cache *cache, const char *prefix)
{
    unsigned n = 0;
    char key[64];
    for (unsigned m = 0; m < MODELS; m++)
        for (unsigned g = 0; g < GENERATIONS; g++)
            for (unsigned i = 0; i < EACH; i++) {
                numbered(key, m, g, i);
                n += !strncmp(key, prefix, strlen(prefix)) && cache_has(cache, key);
            }
    return n;
}

static void test_what_begins_alike_goes(void **state)
{
    static const char *const prefixes[] = {"m1/3/",   "m1/1", "m2/",   "m3/light/", "m4/5/7",
                                           "m5/7.x/", "m6",   "m1/3/", "m9/",       ""};
    struct cache *cache;
    struct cache_counts counts;
    assert_int_equal(cache_create(1 << 24, &cache), 0);
    for (unsigned m = 0; m < MODELS; m++)
        for (unsigned g = 0; g < GENERATIONS; g++)
            for (unsigned i = 0; i < EACH; i++) {
                char key[64];
                numbered(key, m, g, i);
                use(cache, key);
            }
    for (size_t i = 0; i < sizeof prefixes / sizeof *prefixes; i++) {
        unsigned all = n_beginning(cache, ""), alike = n_beginning(cache, prefixes[i]);
        cache_forget(cache, prefixes[i], true);
        cache_count(cache, &counts);
        assert_int_equal(n_beginning(cache, prefixes[i]), 0);
        assert_int_equal(n_beginning(cache, ""), all - alike);
        assert_int_equal(counts.entries, all - alike);
    }
    assert_int_equal(bytes_of(cache), 0);
    cache_destroy(cache);
}

static double seconds_of(struct cache *cache, const char *form, unsigned n)
{
    struct timespec a, b;
    char prefix[32];
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &a);
    for (unsigned i = 0; i < n; i++) {
        snprintf(prefix, sizeof prefix, form, i, i);
        cache_forget(cache, prefix, true);
    }
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &b);
    return ((double)(b.tv_sec - a.tv_sec) + 1e-9 * (double)(b.tv_nsec - a.tv_nsec)) / n;
}

// A model or a shape is forgotten on the loop's thread, which others wait for: that takes no
// time for what the cache has of other models.
static void test_a_full_cache_forgets_as_fast(void **state)
{
    enum { N = 200000, PARTS = 100 };
    struct cache *cache;
    bool fresh;
    assert_int_equal(cache_create((size_t)1 << 30, &cache), 0);
    for (unsigned i = 0; i < N; i++) {
        char key[32];
        snprintf(key, sizeof key, "x%u/%u/a", i / 20, i);
        struct cache_entry *e = cache_get(cache, key, &fresh);
        cache_fill(e, NULL, 0, NULL);
        cache_release(e);
    }
    double all = seconds_of(cache, "none", 20);
    double shape = seconds_of(cache, "y%u/%u/", 1000), model = seconds_of(cache, "y%u/", 1000);
    print_message("all %.3f ms, a model %.5f, a shape %.5f\n", all * 1e3, model * 1e3,
                  shape * 1e3);
    assert_true(shape < all / PARTS && model < all / PARTS);
    cache_destroy(cache);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_least_recently_used_goes),
        cmocka_unit_test(test_budget_is_exact),
        cmocka_unit_test(test_every_state_is_counted),
        cmocka_unit_test(test_a_value_that_grows),
        cmocka_unit_test(test_small_values_are_bounded),
        cmocka_unit_test(test_pending_ones_stay),
        cmocka_unit_test(test_waiters),
        cmocka_unit_test(test_leaving_while_others_are_woken),
        cmocka_unit_test(test_table_grows),
        cmocka_unit_test(test_hash_is_seeded),
        cmocka_unit_test(test_room_is_promised),
        cmocka_unit_test(test_hopeless_admissions_leave),
        cmocka_unit_test(test_charges_take_room),
        cmocka_unit_test(test_holders_release_files),
        cmocka_unit_test(test_files_have_shares),
        cmocka_unit_test(test_what_begins_alike_goes),
        cmocka_unit_test(test_a_full_cache_forgets_as_fast),
        cmocka_unit_test(test_large_values_are_destroyed_by_a_worker),
    };
    return cmocka_run_group_tests_name("cache", tests, NULL, NULL);
}
