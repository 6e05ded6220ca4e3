// SPDX-License-Identifier: MIT
// The folder that replicas share: what was acknowledged is there with its bytes whatever
// process is killed; a claim has one holder, and is taken over when it does not change any
// more. RELIGHT_TEST_MOUNTS="DIR DIR": mounts of one folder, as two machines have it (NFS);
// half of the stores and processes use either.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/loop.h"
#include "descriptors.h"
#include "frame.h"
#include "store/object_store.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <signal.h>
#include <stdatomic.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

// ---- files that this machine does not see at first, as on NFS

static struct {
    char path[PATH_MAX];
    int fault; // of that many openings
    int left;
} unseen;

int open(const char *path, int flags, ...)
{
    va_list args;
    va_start(args, flags);
    const mode_t mode = flags & O_CREAT ? va_arg(args, mode_t) : 0;
    va_end(args);
    if (unseen.left && !strcmp(path, unseen.path)) {
        unseen.left--;
        errno = unseen.fault;
        return -1;
    }
    return (int)syscall(SYS_openat, AT_FDCWD, path, flags, mode);
}

enum { HOSTS = 2 };
static int descriptors_before;
// The folder that is shared, as either machine calls it.
static char folder[64], shared_by[HOSTS][160];
static char *const shared = shared_by[0];

static int setup(void **state)
{
    char mount[HOSTS][100];
    const char *mounts = getenv("RELIGHT_TEST_MOUNTS");
    descriptors_before = open_descriptors();
    strcpy(folder, "/tmp/relight-objects-XXXXXX");
    assert_non_null(mkdtemp(folder));
    for (int i = 0; i < HOSTS; i++) strcpy(mount[i], folder);
    if (mounts) assert_int_equal(sscanf(mounts, "%99s %99s", mount[0], mount[1]), HOSTS);
    for (int i = 0; i < HOSTS; i++)
        snprintf(shared_by[i], sizeof shared_by[i], "%s/shared-%s", mount[i],
                 strrchr(folder, '-') + 1);
    return 0;
}

// No call of the store keeps a file or a folder open.
static int teardown(void **state)
{
    char command[256];
    assert_int_equal(open_descriptors(), descriptors_before);
    snprintf(command, sizeof command, "rm -rf %s %s", folder, shared);
    return system(command);
}

static struct object_store *open_store_of(unsigned host)
{
    char error[256];
    struct object_store *store;
    if (object_store_open(shared_by[host % HOSTS], &store, error)) fail_msg("%s", error);
    return store;
}
static struct object_store *open_store(void)
{
    static unsigned host;
    return open_store_of(host++);
}

// A file of n bytes that follow from the seed, and its hash.
static void make_file(const char *path, uint32_t seed, size_t n, char hash[65])
{
    struct relight_sha256 sha;
    FILE *file = fopen(path, "w");
    if (!file) abort();
    relight_sha256_init(&sha);
    for (size_t i = 0; i < n; i++) {
        seed = seed * 1664525u + 1013904223u;
        unsigned char c = (unsigned char)(seed >> 24);
        relight_sha256_add(&sha, &c, 1);
        fputc(c, file);
    }
    relight_sha256_hex(&sha, hash);
    fclose(file);
}

static void one_machine_needs_none(void **state)
{
    char error[256];
    struct object_store *store;
    struct object_claim *claim;
    struct object_watch watch = {0};
    uint64_t n;
    assert_int_equal(object_store_open("", &store, error), 0);
    assert_false(object_store_shared(store));
    assert_int_equal(object_get(store, OBJECT_BLOB, "00112233", "/nowhere"), -ENOENT);
    assert_int_equal(object_put(store, OBJECT_BLOB, "00112233", "/nowhere"), 0);
    assert_int_equal(object_claim_take(store, "00112233", 1, &watch, &claim), 0);
    assert_int_equal(object_claim_beat(claim, "half"), 0);
    object_claim_release(claim);
    assert_int_equal(object_collect(store, 1, &n), 0);
    object_store_close(store);
}

static void what_is_put_is_got(void **state)
{
    struct object_store *a = open_store(), *b = open_store();
    char file[128], copy[128], hash[65], other[65], *text;
    uint64_t bytes;
    snprintf(file, sizeof file, "%s/file", folder);
    snprintf(copy, sizeof copy, "%s/copy", folder);
    make_file(file, 1, 3000000, hash);
    assert_int_equal(object_get(b, OBJECT_BLOB, hash, copy), -ENOENT);
    assert_int_equal(object_put(a, OBJECT_BLOB, hash, file), 0);
    assert_int_equal(object_get(b, OBJECT_BLOB, hash, copy), 0);
    assert_int_equal(object_find(b, OBJECT_BAKE, hash, &bytes), -ENOENT);
    assert_int_equal(object_put(a, OBJECT_BAKE, hash, file), 0);
    assert_int_equal(object_find(b, OBJECT_BAKE, hash, &bytes), 0);
    assert_int_equal(object_read(b, "0123456789", &text), -ENOENT);
    assert_int_equal(object_put(b, OBJECT_BLOB, hash, file), 0);
    assert_int_equal(object_find(b, OBJECT_BLOB, hash, &bytes), 0);
    assert_int_equal(bytes, 3000000);
    assert_int_equal(object_get(b, OBJECT_BLOB, hash, copy), 0);
    // A blob under another's name is taken by no replica.
    make_file(file, 2, 10, other);
    other[0] = other[0] == '0' ? '1' : '0';
    assert_int_equal(object_put(a, OBJECT_BLOB, other, file), -EBADMSG);
    assert_int_equal(object_find(b, OBJECT_BLOB, other, &bytes), -ENOENT);
    assert_int_equal(object_put(a, OBJECT_BLOB, "../../../etc/passwd", file), -EINVAL);
    // Damage in the folder is noticed.
    char path[320];
    snprintf(path, sizeof path, "%s/blobs/%.2s/%s", shared, hash, hash);
    assert_int_equal(truncate(path, 100), 0);
    assert_int_equal(object_get(b, OBJECT_BLOB, hash, copy), -EBADMSG);
    assert_int_equal(object_write(a, "0123456789", "one"), 0);
    assert_int_equal(object_read(b, "0123456789", &text), 0);
    assert_string_equal(text, "one");
    free(text);
    assert_int_equal(object_write(b, "0123456789", "two"), 0);
    assert_int_equal(object_read(a, "0123456789", &text), 0);
    assert_string_equal(text, "two");
    free(text);
    // A folder that is not mounted is no empty store.
    char aside[320];
    snprintf(path, sizeof path, "%s/store", shared_by[1]);
    snprintf(aside, sizeof aside, "%s/aside", shared_by[1]);
    assert_int_equal(rename(path, aside), 0);
    assert_int_equal(object_get(b, OBJECT_BAKE, "0123456789", copy), -EIO);
    assert_int_equal(rename(aside, path), 0);
    FILE *f = fopen(path, "w");
    fputs("relight store 2\n", f);
    fclose(f);
    char error[256];
    struct object_store *none;
    assert_int_equal(object_store_open(shared, &none, error), -EPROTO);
    assert_non_null(strstr(error, "relight store 2"));
    object_store_close(a);
    object_store_close(b);
}

static void claims_are_watched_by_the_observers_clock(void **state)
{
    struct object_store *a = open_store(), *b = open_store();
    struct object_claim *mine, *theirs;
    struct object_watch watch = {0};
    const char *id = "0123456789abcdef";
    assert_int_equal(object_claim_take(a, id, .2, &watch, &mine), 0);
    // Its file's time is an hour off, forwards or back: nobody looks at it. A lease of a
    // minute, since this process may be stopped for longer than .2 s.
    for (int hour = -1; hour <= 1; hour += 2) {
        char path[320];
        struct timespec t = {time(NULL) + hour * 3600, 0}, both[2] = {t, t};
        snprintf(path, sizeof path, "%s/claims/%s.000001", shared, id);
        assert_int_equal(utimensat(AT_FDCWD, path, both, 0), 0);
        assert_int_equal(object_claim_take(b, id, 60, &watch, &theirs), -EBUSY);
        usleep(150000);
        assert_int_equal(object_claim_beat(mine, "half"), 0);
        assert_int_equal(object_claim_take(b, id, 60, &watch, &theirs), -EBUSY);
        usleep(150000);
        assert_int_equal(object_claim_take(b, id, 60, &watch, &theirs), -EBUSY);
        assert_non_null(strstr(watch.text, "half"));
        assert_int_equal(object_claim_beat(mine, "more"), 0);
        assert_int_equal(object_claim_take(b, id, 60, &watch, &theirs), -EBUSY);
    }
    usleep(250000);
    assert_int_equal(object_claim_take(b, id, .2, &watch, &theirs), 0);
    assert_int_equal(object_claim_beat(mine, "late"), -ESTALE);
    assert_int_equal(object_claim_beat(theirs, ""), 0);
    object_claim_release(mine);
    memset(&watch, 0, sizeof watch);
    assert_int_equal(object_claim_take(a, id, .2, &watch, &mine), -EBUSY);
    object_claim_release(theirs);
    assert_int_equal(object_claim_take(a, id, .2, &watch, &mine), 0);
    object_claim_release(mine);
    object_store_close(a);
    object_store_close(b);
}

// Numbers begin again at 1 after a release: neither the watcher of an old claim nor its late
// owner may take it for the new one.
static void a_released_claim_is_another(void **state)
{
    struct object_store *a = open_store(), *b = open_store();
    struct object_claim *mine, *late, *theirs;
    struct object_watch watch = {0};
    const char *id = "0123456789abcdef";
    assert_int_equal(object_claim_take(a, id, .1, &watch, &mine), 0);
    assert_int_equal(object_claim_take(b, id, .1, &watch, &theirs), -EBUSY);
    object_claim_release(mine);
    struct object_watch fresh = {0};
    assert_int_equal(object_claim_take(a, id, .1, &fresh, &late), 0);
    usleep(150000);
    assert_int_equal(object_claim_take(b, id, .1, &watch, &theirs), -EBUSY);
    usleep(150000);
    assert_int_equal(object_claim_take(b, id, .1, &watch, &theirs), 0);
    object_claim_release(theirs);
    assert_int_equal(object_claim_take(b, id, .1, &watch, &theirs), 0);
    assert_int_equal(object_claim_beat(late, ""), -ESTALE);
    object_claim_release(late);
    assert_int_equal(object_claim_beat(theirs, ""), 0);
    object_claim_release(theirs);
    // A late owner that releases without a look.
    struct object_watch first = {0}, last = {0};
    assert_int_equal(object_claim_take(a, id, .1, &first, &late), 0);
    assert_int_equal(object_claim_take(b, id, .1, &last, &theirs), -EBUSY);
    usleep(150000);
    assert_int_equal(object_claim_take(b, id, .1, &last, &theirs), 0);
    object_claim_release(theirs);
    assert_int_equal(object_claim_take(b, id, .1, &last, &theirs), 0);
    object_claim_release(late);
    assert_int_equal(object_claim_beat(theirs, ""), 0);
    object_claim_release(theirs);
    object_store_close(a);
    object_store_close(b);
}

// What others do between the look at a claim and the creation of its successor.
static void (*before_link)(void);

int link(const char *from, const char *to)
{
    void (*others)(void) = before_link;
    before_link = NULL;
    if (others) others();
    return linkat(AT_FDCWD, from, AT_FDCWD, to, 0);
}

static const char raced[] = "fedcba9876543210";
static struct object_store *first_store, *second_store;
static struct object_claim *first_claim, *second_claim;

// One claims, is taken over, and releases: number 2 alone is left.
static void claimed_and_taken_over(void)
{
    struct object_watch one = {0}, two = {0};
    assert_int_equal(object_claim_take(first_store, raced, .01, &one, &first_claim), 0);
    assert_int_equal(object_claim_take(second_store, raced, .01, &two, &second_claim), -EBUSY);
    usleep(20000);
    assert_int_equal(object_claim_take(second_store, raced, .01, &two, &second_claim), 0);
    object_claim_release(first_claim);
}

static void owner_beats(void)
{
    assert_int_equal(object_claim_beat(first_claim, "alive"), 0);
}

static void owner_releases(void)
{
    object_claim_release(first_claim);
    first_claim = NULL;
}

// A claim that was made while another's began, or that lives again, is not taken.
static void who_loses_the_race_claims_nothing(void **state)
{
    struct object_store *late = open_store();
    struct object_claim *claim = NULL;
    first_store = open_store(), second_store = open_store();
    struct object_watch watch = {0};
    before_link = claimed_and_taken_over;
    assert_int_equal(object_claim_take(late, raced, .01, &watch, &claim), -EBUSY);
    assert_null(claim);
    assert_int_equal(object_claim_beat(second_claim, "mine"), 0);
    object_claim_release(second_claim);
    for (int releases = 0; releases < 2; releases++) {
        memset(&watch, 0, sizeof watch);
        struct object_watch fresh = {0};
        assert_int_equal(object_claim_take(first_store, raced, .01, &fresh, &first_claim), 0);
        assert_int_equal(object_claim_take(late, raced, .01, &watch, &claim), -EBUSY);
        usleep(20000);
        before_link = releases ? owner_releases : owner_beats;
        assert_int_equal(object_claim_take(late, raced, .01, &watch, &claim), -EBUSY);
        assert_null(claim);
        if (first_claim) assert_int_equal(object_claim_beat(first_claim, "still"), 0);
        if (first_claim) object_claim_release(first_claim);
    }
    // Nothing of the losers is left: the next one claims at once.
    memset(&watch, 0, sizeof watch);
    assert_int_equal(object_claim_take(late, raced, .01, &watch, &claim), 0);
    object_claim_release(claim);
    object_store_close(late);
    object_store_close(first_store);
    object_store_close(second_store);
}

static void used_objects_are_not_collected(void **state)
{
    struct object_store *a = open_store();
    char file[128], path[320], hash[3][65];
    uint64_t n, bytes;
    snprintf(file, sizeof file, "%s/file", folder);
    for (uint32_t i = 0; i < 3; i++) {
        make_file(file, i, 100, hash[i]);
        assert_int_equal(object_put(a, i ? OBJECT_BAKE : OBJECT_BLOB, hash[i], file), 0);
        snprintf(path, sizeof path, "%s/%s/%.2s/%s%s", shared, i ? "bakes" : "blobs", hash[i],
                 hash[i], i ? ".prt" : "");
        struct timespec t = {time(NULL) - 5000, 0}, both[2] = {t, t};
        assert_int_equal(utimensat(AT_FDCWD, path, both, 0), 0);
    }
    object_write(a, hash[1], "its model");
    assert_int_equal(object_collect(a, 6000, &n), 0);
    assert_int_equal(n, 0);
    assert_int_equal(object_collect(a, 4000, &n), 0);
    assert_int_equal(n, 2); // the one with a record stays
    assert_int_equal(object_find(a, OBJECT_BAKE, hash[1], &bytes), 0);
    assert_int_equal(object_find(a, OBJECT_BAKE, hash[2], &bytes), -ENOENT);
    object_store_close(a);
}

// Finding, getting and putting again are uses: each keeps an object that was idle too long.
static void each_use_keeps_an_object(void **state)
{
    struct object_store *a = open_store();
    char file[128], copy[128], path[320], hash[65];
    uint64_t n, bytes;
    snprintf(file, sizeof file, "%s/file", folder);
    snprintf(copy, sizeof copy, "%s/copy", folder);
    make_file(file, 77, 100, hash);
    snprintf(path, sizeof path, "%s/blobs/%.2s/%s", shared, hash, hash);
    for (int use = 0; use < 4; use++) {
        struct timespec t = {time(NULL) - 5000, 0}, both[2] = {t, t};
        assert_int_equal(object_put(a, OBJECT_BLOB, hash, file), 0);
        assert_int_equal(utimensat(AT_FDCWD, path, both, 0), 0);
        if (use == 0) assert_int_equal(object_find(a, OBJECT_BLOB, hash, &bytes), 0);
        if (use == 1) assert_int_equal(object_get(a, OBJECT_BLOB, hash, copy), 0);
        if (use == 2) assert_int_equal(object_put(a, OBJECT_BLOB, hash, file), 0);
        assert_int_equal(object_collect(a, 4000, &n), 0);
        assert_int_equal(n, use == 3);
    }
    unlink(copy);
    object_store_close(a);
}

// ---- processes that are killed

enum { PROCESSES = 4, OBJECTS = 24, CLAIMS = 4 };
static int acknowledged; // a file to which each process appends the objects that it put
// Claims in the order in which they were taken, and the last of them that held afterwards:
// one pair an id, shared by the processes.
static struct turns {
    _Atomic unsigned taken, held;
} * turns;

// Holds a claim, sometimes beyond its lease. Law: once a later owner held it, no beat of this
// one succeeds.
static void hold(struct object_claim *claim, struct turns *t, bool sleep)
{
    unsigned mine = atomic_fetch_add(&t->taken, 1) + 1, held = atomic_load(&t->held);
    int err = object_claim_beat(claim, "works");
    if (!err) {
        while (held < mine && !atomic_compare_exchange_weak(&t->held, &held, mine)) {
        }
        if (sleep) usleep(150000);
        bool replaced = atomic_load(&t->held) > mine;
        err = object_claim_beat(claim, "ends");
        if (!err && replaced) _exit(5);
    }
    if (err && err != -ESTALE) _exit(6);
    object_claim_release(claim);
}

// A record's text is a number, so many letters, and a full stop.
static void use_record(struct object_store *store, unsigned which, unsigned *seed)
{
    char id[20], *text, *at;
    snprintf(id, sizeof id, "%016x", which + 1000);
    if (rand_r(seed) % 2) {
        unsigned long n = (unsigned long)rand_r(seed) % 9000;
        char fresh[9020];
        int head = snprintf(fresh, sizeof fresh, "%lu ", n);
        memset(fresh + head, 'x', n);
        strcpy(fresh + head + n, ".");
        const int err = object_write(store, id, fresh);
        if (err) {
            print_error("writing a record: %s\n", strerror(-err));
            _exit(8);
        }
        return;
    }
    int err = object_read(store, id, &text);
    if (err == -ENOENT) return;
    if (err) {
        print_error("reading a record: %s\n", strerror(-err));
        _exit(9);
    }
    unsigned long n = strtoul(text, &at, 10);
    if (*at != ' ' || strspn(at + 1, "x") != n || strcmp(at + 1 + n, ".")) _exit(10);
    free(text);
}

// What one process does until it is killed: puts, gets, claims, collects, reads records.
static void act(unsigned host, unsigned seed)
{
    struct object_store *store = open_store_of(host);
    char file[128], copy[128], hash[65], id[20];
    struct object_watch watch[CLAIMS] = {0};
    const bool records_alone = getenv("OBJECT_RECORDS") != NULL;
    uint64_t n, bytes;
    snprintf(file, sizeof file, "%s/file-%d", folder, (int)getpid());
    snprintf(copy, sizeof copy, "%s/copy-%d", folder, (int)getpid());
    for (;;) {
        uint32_t i = (uint32_t)rand_r(&seed) % OBJECTS;
        switch (records_alone ? 3 : rand_r(&seed) % 5) {
        case 0:
            make_file(file, i, 1000 + 4000 * i, hash);
            if (!object_put(store, OBJECT_BLOB, hash, file) &&
                write(acknowledged, &i, sizeof i) != sizeof i)
                _exit(3);
            break;
        case 1:
            make_file(file, i, 1000 + 4000 * i, hash);
            if (!object_find(store, OBJECT_BLOB, hash, &bytes) &&
                object_get(store, OBJECT_BLOB, hash, copy))
                _exit(4);
            break;
        case 2: {
            struct object_claim *claim;
            snprintf(id, sizeof id, "%016x", i % CLAIMS);
            if (!object_claim_take(store, id, .1, &watch[i % CLAIMS], &claim))
                hold(claim, &turns[i % CLAIMS], rand_r(&seed) % 8 == 0);
            break;
        }
        case 3:
            use_record(store, i % CLAIMS, &seed);
            break;
        default:
            if (rand_r(&seed) % 16 == 0 && object_collect(store, 3600, &n)) _exit(7);
        }
    }
}

static bool faulty;

// All processes are ended before the test fails: none writes into its folder any more.
static void end(pid_t pid)
{
    int how;
    kill(pid, SIGKILL);
    waitpid(pid, &how, 0);
    if (WIFEXITED(how)) {
        print_error("a process found fault %d\n", WEXITSTATUS(how));
        faulty = true;
    }
}

// Objects whose put was acknowledged; *all: puts.
static unsigned count_acknowledged(bool put[OBJECTS], unsigned *all)
{
    uint32_t i;
    unsigned n = 0;
    memset(put, 0, OBJECTS * sizeof *put);
    for (*all = 0; pread(acknowledged, &i, sizeof i, *all * (off_t)sizeof i) == sizeof i;
         ++*all)
        put[i % OBJECTS] = true;
    for (i = 0; i < OBJECTS; i++) n += put[i];
    return n;
}

// Half of the objects have to be put: where the folder is slow that takes more kills.
static bool goes_on(unsigned k, unsigned kills)
{
    bool put[OBJECTS];
    unsigned all;
    return k < kills || (!getenv("OBJECT_RECORDS") && k < 20 * kills &&
                         count_acknowledged(put, &all) <= OBJECTS / 2);
}

static void nothing_acknowledged_is_lost(void **state)
{
    char path[128], copy[128], hash[65];
    pid_t pid[PROCESSES] = {0};
    unsigned k, seed = 1,
                kills = getenv("OBJECT_KILLS") ? (unsigned)atoi(getenv("OBJECT_KILLS")) : 40;
    bool put[OBJECTS];
    snprintf(path, sizeof path, "%s/acknowledged", folder);
    acknowledged = open(path, O_CREAT | O_RDWR | O_APPEND, 0600);
    turns = mmap(NULL, CLAIMS * sizeof *turns, PROT_READ | PROT_WRITE,
                 MAP_SHARED | MAP_ANONYMOUS, -1, 0);
    assert_ptr_not_equal(turns, MAP_FAILED);
    for (k = 0; goes_on(k, kills); k++) {
        pid_t *p = &pid[k % PROCESSES];
        if (*p) end(*p);
        if (!(*p = fork())) act(k, k * 7919u);
        usleep(20000 + (useconds_t)rand_r(&seed) % 40000);
    }
    for (int i = 0; i < PROCESSES; i++) end(pid[i]);
    assert_false(faulty);
    munmap(turns, CLAIMS * sizeof *turns);
    struct object_store *store = open_store();
    unsigned all, n = count_acknowledged(put, &all);
    snprintf(path, sizeof path, "%s/file", folder);
    snprintf(copy, sizeof copy, "%s/copy", folder);
    for (uint32_t i = 0; i < OBJECTS; i++) {
        make_file(path, i, 1000 + 4000 * i, hash);
        if (put[i] && object_get(store, OBJECT_BLOB, hash, copy))
            fail_msg("object %u was acknowledged and is lost", i);
    }
    print_message("%u kills, %u puts acknowledged, %u objects intact\n", k, all, n);
    close(acknowledged);
    assert_true(n > OBJECTS / 2 || getenv("OBJECT_RECORDS"));
    object_store_close(store);
}

// Puts, finds, gets and collects objects that nobody keeps, n times.
static void act_on_the_unkept(unsigned host, int n_turn)
{
    struct object_store *store = open_store_of(host);
    char file[128], copy[128], hash[65];
    unsigned seed = host * 7919u + 1;
    uint64_t bytes, n;
    snprintf(file, sizeof file, "%s/file-%d", folder, (int)getpid());
    snprintf(copy, sizeof copy, "%s/copy-%d", folder, (int)getpid());
    for (int i = 0; i < n_turn; i++) {
        uint32_t which = (uint32_t)rand_r(&seed) % 4;
        make_file(file, which, 300000 + 1000 * which, hash);
        int err = object_put(store, OBJECT_BLOB, hash, file);
        if (err) print_error("object_put: %s\n", strerror(-err));
        if (err) _exit(11);
        if ((err = object_find(store, OBJECT_BLOB, hash, &bytes)) && err != -ENOENT) _exit(12);
        if (!err && bytes != 300000 + 1000 * which) _exit(13);
        if ((err = object_get(store, OBJECT_BLOB, hash, copy)) && err != -ENOENT) _exit(14);
        if (rand_r(&seed) % 2 && (err = object_collect(store, 1e-9, &n))) _exit(15);
    }
    object_store_close(store);
    _exit(0);
}

// Who reads an object while another removes it has all of it, or finds none.
static void one_that_is_removed_is_whole_or_gone(void **state)
{
    pid_t pid[PROCESSES];
    int how;
    for (unsigned k = 0; k < PROCESSES; k++)
        if (!(pid[k] = fork())) act_on_the_unkept(k, 150);
    for (unsigned k = 0; k < PROCESSES; k++) {
        waitpid(pid[k], &how, 0);
        if (how) print_error("a process found fault %d\n", WEXITSTATUS(how));
        faulty |= how != 0;
    }
    assert_false(faulty);
}

static char put_file[128], put_hash[65];

static void another_puts_it(void)
{
    char path[256];
    struct timespec old[2] = {{1000000000, 0}, {1000000000, 0}};
    assert_int_equal(object_put(first_store, OBJECT_BLOB, put_hash, put_file), 0);
    snprintf(path, sizeof path, "%s/blobs/%.2s/%s", shared, put_hash, put_hash);
    assert_int_equal(utimensat(AT_FDCWD, path, old, 0), 0);
}

// Who puts a blob that another has put meanwhile uses it: its time is that of the last use, by
// which the collection goes.
static void a_blob_that_is_there_is_used(void **state)
{
    char path[256];
    struct stat st;
    // The first puts by the mount of `shared`: on NFS the other may not know its file yet.
    first_store = open_store_of(0);
    struct object_store *late = open_store_of(1);
    snprintf(put_file, sizeof put_file, "%s/file", folder);
    make_file(put_file, 3, 1000, put_hash);
    before_link = another_puts_it;
    assert_int_equal(object_put(late, OBJECT_BLOB, put_hash, put_file), 0);
    snprintf(path, sizeof path, "%s/blobs/%.2s/%s", shared, put_hash, put_hash);
    int fd = open(path, O_RDONLY | O_CLOEXEC); // on NFS a path's times may be those of before
    assert_true(fd >= 0);
    assert_int_equal(fstat(fd, &st), 0);
    close(fd);
    assert_true(st.st_mtime > 1000000000);
    object_store_close(late);
    object_store_close(first_store);
}

// A file that is missing is looked for once more, behind a look at its folder; one that is
// stale as often as another machine may replace it meanwhile.
static void an_object_is_looked_for_again(void **state)
{
    enum { TRIES = 16 };
    static const struct {
        int fault, times, code;
    } cases[] = {{ENOENT, 1, 0},      {ENOENT, 2, -ENOENT}, {ESTALE, 1, 0},
                 {EBADF, 3, 0},       {ESTALE, TRIES, 0},   {ESTALE, TRIES + 1, -ESTALE},
                 {EACCES, 1, -EACCES}};
    struct object_store *store = open_store_of(0);
    char file[128], copy[128], hash[65];
    snprintf(file, sizeof file, "%s/file", folder);
    snprintf(copy, sizeof copy, "%s/copy", folder);
    make_file(file, 1, 1000, hash);
    assert_int_equal(object_put(store, OBJECT_BLOB, hash, file), 0);
    snprintf(unseen.path, sizeof unseen.path, "%s/blobs/%.2s/%s", shared, hash, hash);
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        unseen.fault = cases[i].fault;
        unseen.left = cases[i].times;
        assert_int_equal(object_get(store, OBJECT_BLOB, hash, copy), cases[i].code);
        unseen.left = 0;
        assert_int_equal(object_get(store, OBJECT_BLOB, hash, copy), 0);
    }
    object_store_close(store);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_setup_teardown(one_machine_needs_none, setup, teardown),
        cmocka_unit_test_setup_teardown(what_is_put_is_got, setup, teardown),
        cmocka_unit_test_setup_teardown(claims_are_watched_by_the_observers_clock, setup,
                                        teardown),
        cmocka_unit_test_setup_teardown(a_released_claim_is_another, setup, teardown),
        cmocka_unit_test_setup_teardown(who_loses_the_race_claims_nothing, setup, teardown),
        cmocka_unit_test_setup_teardown(used_objects_are_not_collected, setup, teardown),
        cmocka_unit_test_setup_teardown(each_use_keeps_an_object, setup, teardown),
        cmocka_unit_test_setup_teardown(one_that_is_removed_is_whole_or_gone, setup, teardown),
        cmocka_unit_test_setup_teardown(a_blob_that_is_there_is_used, setup, teardown),
        cmocka_unit_test_setup_teardown(an_object_is_looked_for_again, setup, teardown),
        cmocka_unit_test_setup_teardown(nothing_acknowledged_is_lost, setup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
