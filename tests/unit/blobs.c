// SPDX-License-Identifier: MIT
// The store of uploads and the account of bytes on disk, without a daemon around them. Above
// 600 lines: short cases, each read alone.
#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <semaphore.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/options.h"
#include "descriptors.h"
#include "frame.h"
#include "relight.pb-c.h"
#include "store/blob_index.h"
#include "store/disk.h"

static char folder[] = "/tmp/blobs-test-XXXXXX";

// ---- the account of bytes by owner

static void test_disk_is_charged_by_owner(void **state)
{
    struct options options = {.disk = 10000, .client_disk = 6000};
    struct ledger *ledger = ledger_create(&options);
    char error[256];
    assert_non_null(ledger);
    assert_int_equal(disk_size(0), 0);
    assert_int_equal(disk_size(1), 4096);
    assert_int_equal(disk_size(4097), 8192);
    disk_charge(ledger, "uid:1", 5000);
    assert_int_equal(disk_take(ledger, "uid:1", 1001, error), LEDGER_CLIENT_FULL);
    assert_non_null(strstr(error, "--client-disk"));
    assert_int_equal(disk_take(ledger, "uid:2", 5001, error), LEDGER_ALL_FULL);
    assert_non_null(strstr(error, "--disk"));
    assert_int_equal(disk_take(ledger, "uid:2", 5000, error), LEDGER_GRANTED);
    assert_int_equal(disk_bytes(ledger), 10000);
    assert_int_equal(disk_bytes_of(ledger, "uid:1"), 5000);
    disk_charge(ledger, "uid:1", -5000);
    assert_int_equal(disk_bytes_of(ledger, "uid:1"), 0);
    disk_charge(ledger, "uid:2", -6000); // more than is held: all of it
    assert_int_equal(disk_bytes(ledger), 0);
    ledger_destroy(ledger);
}

static void test_owner_is_kept_beside_the_file(void **state)
{
    char path[128], owner[96];
    snprintf(path, sizeof path, "%s/file", folder);
    disk_owner_read(path, owner);
    assert_string_equal(owner, DISK_NOBODY);
    assert_int_equal(disk_owner_write(path, "token:ann"), 0);
    disk_owner_read(path, owner);
    assert_string_equal(owner, "token:ann");
    strcat(path, ".owner");
    assert_int_equal(unlink(path), 0);
    snprintf(path, sizeof path, "%s/none/file", folder);
    assert_int_equal(disk_owner_write(path, "token:ann"), -ENOENT);
}

// ---- a disk that does not sync folders

static _Atomic bool folders_fail;

int fsync(int fd)
{
    struct stat st;
    if (folders_fail && !fstat(fd, &st) && S_ISDIR(st.st_mode)) {
        errno = EIO;
        return -1;
    }
    return (int)syscall(SYS_fsync, fd);
}

// ---- the store, with a loop and workers of its own

enum { MB = 1 << 20 };

struct store {
    struct options options;
    struct ledger *ledger;
    struct loop *loop;
    struct work_pool *work;
    struct blobs_setup setup;
    struct blobs *blobs;
};

static void turn_until_idle(struct store *s)
{
    while (work_busy(s->work)) loop_turn(s->loop, 10);
}

static void open_store(struct store *s)
{
    static char path[128];
    snprintf(path, sizeof path, "%s/blobs", folder);
    assert_non_null(s->ledger = ledger_create(&s->options));
    assert_int_equal(loop_create(&s->loop), 0);
    assert_int_equal(work_pool_create(s->loop, 2, 0, &s->work), 0);
    s->setup.folder = path;
    s->setup.ledger = s->ledger;
    s->setup.work = s->work;
    assert_int_equal(blobs_open(&s->setup, &s->blobs), 0);
}

static void close_store(struct store *s)
{
    turn_until_idle(s);
    work_pool_destroy(s->work);
    blobs_close(s->blobs);
    assert_int_equal(disk_bytes(s->ledger), 0); // every charge was given back
    assert_int_equal(ledger_total(s->ledger, LEDGER_UPLOADS), 0);
    ledger_destroy(s->ledger);
    loop_destroy(s->loop);
}

static void reopen_store(struct store *s)
{
    close_store(s);
    open_store(s);
}

static void remove_files(void)
{
    char command[160];
    snprintf(command, sizeof command, "cd %s && rm -rf blobs shared of-another*", folder);
    assert_int_equal(system(command), 0);
}

// In place: the ledger keeps the options' address.
static void new_store(struct store *s)
{
    remove_files();
    *s = (struct store){
        .options = {.disk = 64 * MB, .client_disk = 32 * MB},
        .setup = {.max_blob = 64 * MB, .keep_s = 600, .idle_s = 600, .wanted_s = 60}};
    open_store(s);
}

struct sent {
    struct blob_put put; // first
    bool done;
};

static void put_done(struct blob_put *put)
{
    ((struct sent *)put)->done = true;
}

static void begin_put(struct store *s, struct sent *sent, const char *who, const char *hash,
                      uint64_t size, uint64_t offset, const void *bytes, size_t n)
{
    memset(sent, 0, sizeof *sent);
    snprintf(sent->put.principal, sizeof sent->put.principal, "%s", who);
    snprintf(sent->put.name, sizeof sent->put.name, "%s.hdr", who);
    memcpy(sent->put.hash, hash, BLOB_HASH);
    sent->put.size = size;
    sent->put.offset = offset;
    sent->put.bytes = (void *)bytes;
    sent->put.n = n;
    sent->put.done = put_done;
    blobs_put(s->blobs, &sent->put);
}

static struct sent put(struct store *s, const char *who, const char *hash, uint64_t size,
                       uint64_t offset, const void *bytes, size_t n)
{
    static struct sent sent;
    begin_put(s, &sent, who, hash, size, offset, bytes, n);
    while (!sent.done) loop_turn(s->loop, 10);
    return sent;
}

static void hash_of(const void *bytes, size_t n, char hash[65])
{
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, bytes, n);
    relight_sha256_hex(&sha, hash);
}

// A blob of n bytes of this letter.
static void put_whole(struct store *s, const char *who, char letter, size_t n, char hash[65])
{
    char *bytes = malloc(n);
    memset(bytes, letter, n);
    hash_of(bytes, n, hash);
    struct sent sent = put(s, who, hash, n, 0, bytes, n);
    if (sent.put.code) fail_msg("%s", sent.put.error);
    assert_true(sent.put.complete);
    free(bytes);
}

static uint64_t held(const struct store *s, const char *who, enum ledger_resource resource)
{
    for (const struct principal *p = ledger_first(s->ledger); p; p = p->next)
        if (!strcmp(p->name, who)) return p->held[resource];
    return 0;
}

static unsigned n_files(const char *ending)
{
    char path[128];
    unsigned n = 0;
    snprintf(path, sizeof path, "%s/blobs", folder);
    DIR *dir = opendir(path);
    for (struct dirent *e; (e = readdir(dir));) n += strstr(e->d_name, ending) != NULL;
    closedir(dir);
    return n;
}

static void test_room_is_charged_when_promised(void **state)
{
    struct store s;
    new_store(&s);
    char bytes[10000], hash[65];
    memset(bytes, 'x', sizeof bytes);
    hash_of(bytes, sizeof bytes, hash);
    struct sent sent = put(&s, "ann", hash, sizeof bytes, 0, bytes, 100);
    assert_int_equal(sent.put.received, 100);
    uint64_t room = disk_size(sizeof bytes) + disk_size(1); // and the owner's record
    assert_int_equal(held(&s, "ann", LEDGER_DISK), room);
    assert_int_equal(held(&s, "ann", LEDGER_UPLOADS), 1);
    sent = put(&s, "ann", hash, sizeof bytes, 50, bytes + 50, 100); // overlaps
    assert_int_equal(sent.put.received, 150);
    sent = put(&s, "ann", hash, sizeof bytes, 151, bytes, 1);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    sent = put(&s, "ann", hash, sizeof bytes, 150, bytes, sizeof bytes);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    sent = put(&s, "ann", hash, sizeof bytes, 150, bytes, sizeof bytes - 150);
    assert_true(sent.put.complete && sent.put.arrived);
    assert_int_equal(held(&s, "ann", LEDGER_DISK), room);
    assert_int_equal(held(&s, "ann", LEDGER_UPLOADS), 0);
    assert_true(blobs_has(s.blobs, hash));
    // Bytes that lie give their room back.
    hash[0] = hash[0] == 'a' ? 'b' : 'a';
    sent = put(&s, "ann", hash, 3, 0, "lie", 3);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_HASH);
    assert_int_equal(held(&s, "ann", LEDGER_DISK), room);
    assert_int_equal(held(&s, "ann", LEDGER_UPLOADS), 0);
    assert_int_equal(n_files(".part") + n_files(".upload"), 0);
    close_store(&s);
}

// Two principals send the same bytes at once; one of them another size before.
static void test_first_of_two_wins(void **state)
{
    struct store s;
    new_store(&s);
    static char bytes[3 * MB];
    char hash[65];
    struct sent one, two;
    memset(bytes, 'y', sizeof bytes);
    hash_of(bytes, sizeof bytes, hash);
    put(&s, "bob", hash, 17, 0, bytes, 1);
    put(&s, "ann", hash, sizeof bytes, 0, bytes, MB);
    put(&s, "bob", hash, sizeof bytes, 0, bytes, MB);
    assert_int_equal(n_files(".part"), 3);
    assert_int_equal(held(&s, "bob", LEDGER_UPLOADS), 2);
    begin_put(&s, &one, "ann", hash, sizeof bytes, MB, bytes + MB, 2 * MB);
    begin_put(&s, &two, "bob", hash, sizeof bytes, MB, bytes + MB, 2 * MB);
    while (!one.done || !two.done) loop_turn(s.loop, 10);
    assert_true(one.put.complete && two.put.complete);
    assert_true(one.put.arrived != two.put.arrived);
    assert_int_equal(ledger_total(s.ledger, LEDGER_UPLOADS), 0);
    assert_int_equal(disk_bytes(s.ledger), disk_size(sizeof bytes) + disk_size(1));
    assert_int_equal(n_files(".part") + n_files(".upload"), 0);
    close_store(&s);
}

// Chunks of one upload are taken in their order, however many wait.
static void test_pipelined_chunks(void **state)
{
    enum { N = 40, PIECE = 100000 };
    struct store s;
    new_store(&s);
    static char bytes[N * PIECE];
    static struct sent sent[N + 1];
    char hash[65];
    for (size_t i = 0; i < sizeof bytes; i++) bytes[i] = (char)(i * i >> 7);
    hash_of(bytes, sizeof bytes, hash);
    for (int i = 0; i < N; i++) {
        begin_put(&s, &sent[i], "ann", hash, sizeof bytes, (uint64_t)i * PIECE,
                  bytes + i * PIECE, PIECE);
        if (i == 4) begin_put(&s, &sent[N], "ann", hash, sizeof bytes, 0, NULL, 0);
    }
    while (!sent[N - 1].done) loop_turn(s.loop, 10);
    for (int i = 0; i < N; i++) {
        assert_true(sent[i].done);
        assert_int_equal(sent[i].put.received, (i + 1) * PIECE);
    }
    assert_int_equal(sent[N].put.received, 5 * PIECE); // a question waits its turn
    assert_true(sent[N - 1].put.complete);
    close_store(&s);
}

// A chunk beyond the bytes that are there is refused, with both numbers.
static void test_chunk_behind_a_gap(void **state)
{
    struct store s;
    new_store(&s);
    static const char bytes[] = "0123456789";
    char hash[65];
    hash_of(bytes, 10, hash);
    assert_int_equal(put(&s, "ann", hash, 10, 0, bytes, 3).put.code, 0);
    struct sent sent = put(&s, "ann", hash, 10, 7, bytes + 7, 3);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    assert_non_null(strstr(sent.put.error, "starts at 7, past the 3 bytes"));
    sent = put(&s, "ann", hash, 10, 2, bytes + 2, 8); // an overlap is none
    assert_int_equal(sent.put.code, 0);
    assert_true(sent.put.complete);
    close_store(&s);
}

// An upload is complete once its name is on the disk, too: it fails with the folder's fsync.
static void test_folder_that_does_not_sync(void **state)
{
    struct store s;
    new_store(&s);
    static const char bytes[] = "0123456789";
    char hash[65], path[200];
    hash_of(bytes, 10, hash);
    snprintf(path, sizeof path, "%s/blobs/%s", folder, hash);
    folders_fail = true;
    struct sent sent = put(&s, "ann", hash, 10, 0, bytes, 10);
    folders_fail = false;
    assert_int_not_equal(sent.put.code, 0);
    assert_false(sent.put.complete);
    assert_int_equal(access(path, F_OK), -1);
    sent = put(&s, "ann", hash, 10, 0, bytes, 10);
    assert_int_equal(sent.put.code, 0);
    assert_true(sent.put.complete);
    assert_int_equal(access(path, F_OK), 0);
    close_store(&s);
}

static void test_limits_of_a_principal(void **state)
{
    struct store s;
    new_store(&s);
    s.options.client_uploads = 2;
    s.setup.wanted_s = 1;
    reopen_store(&s);
    char hash[65], name[65];
    memset(name, 'e', 64);
    name[64] = 0;
    for (int i = 0; i < 3; i++) {
        name[0] = (char)('0' + i);
        struct sent sent = put(&s, "ann", name, 2, 0, ".", 1);
        assert_int_equal(sent.put.code, i < 2 ? 0 : RELIGHT__ERROR_CODE__ERROR_BUSY);
    }
    assert_int_equal(put(&s, "bob", name, 2, 0, ".", 1).put.code, 0);
    usleep(1050000); // now ann's first is abandoned, and somebody wants its slot
    assert_int_equal(put(&s, "ann", name, 2, 0, ".", 1).put.code, 0);
    name[0] = '0';
    assert_int_equal(put(&s, "ann", name, 2, 0, NULL, 0).put.received, 0);
    assert_int_equal(held(&s, "ann", LEDGER_UPLOADS), 2);
    assert_int_equal(held(&s, "bob", LEDGER_UPLOADS), 1); // was not touched
    // A promise beyond --client-disk is refused, and evicts nothing.
    put_whole(&s, "bob", 'b', 1000, hash);
    struct sent sent = put(&s, "bob", name, 40 * MB, 0, ".", 1);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_non_null(strstr(sent.put.error, "--client-disk"));
    assert_true(blobs_has(s.blobs, hash));
    s.setup.idle_s = 60;
    reopen_store(&s);
    usleep(100000);
    blobs_maintain(s.blobs);
    assert_int_equal(ledger_total(s.ledger, LEDGER_UPLOADS), 3); // not idle for 60 s
    s.setup.idle_s = 0.05;
    reopen_store(&s);
    assert_int_equal(ledger_total(s.ledger, LEDGER_UPLOADS), 3); // still there
    usleep(60000);
    blobs_maintain(s.blobs);
    assert_int_equal(ledger_total(s.ledger, LEDGER_UPLOADS), 0);
    assert_int_equal(n_files(".part") + n_files(".upload"), 0);
    close_store(&s);
}

// Of two uploads the one that was begun first and went on is kept.
static void test_the_longest_idle_upload_goes(void **state)
{
    struct store s;
    new_store(&s);
    s.options.client_uploads = 2;
    s.setup.wanted_s = 0.02;
    reopen_store(&s);
    char name[3][65];
    for (int i = 0; i < 3; i++) {
        memset(name[i], 'e', 64);
        name[i][0] = (char)('0' + i);
        name[i][64] = 0;
    }
    put(&s, "ann", name[0], 3, 0, ".", 1);
    put(&s, "ann", name[1], 3, 0, ".", 1);
    put(&s, "ann", name[0], 3, 1, ".", 1);
    usleep(30000);
    assert_int_equal(put(&s, "ann", name[2], 3, 0, ".", 1).put.code, 0);
    assert_int_equal(put(&s, "ann", name[0], 3, 0, NULL, 0).put.received, 2);
    assert_int_equal(held(&s, "ann", LEDGER_UPLOADS), 2);
    close_store(&s);
}

static void test_upload_goes_on_after_a_restart(void **state)
{
    struct store s;
    new_store(&s);
    char bytes[5000], hash[65], path[300];
    memset(bytes, 'r', sizeof bytes);
    hash_of(bytes, sizeof bytes, hash);
    put(&s, "ann", hash, sizeof bytes, 0, bytes, 3000);
    reopen_store(&s);
    assert_int_equal(held(&s, "ann", LEDGER_DISK), disk_size(5000) + disk_size(1));
    assert_int_equal(held(&s, "ann", LEDGER_UPLOADS), 1);
    assert_int_equal(put(&s, "ann", hash, sizeof bytes, 0, NULL, 0).put.received, 3000);
    struct sent sent = put(&s, "ann", hash, sizeof bytes, 3000, bytes + 3000, 2000);
    assert_true(sent.put.complete);
    // The last step is done when it was all that was missing.
    memset(bytes, 'l', sizeof bytes);
    hash_of(bytes, sizeof bytes, hash);
    put(&s, "ann", hash, sizeof bytes, 0, bytes, 3000);
    close_store(&s);
    snprintf(path, sizeof path,
             "cd %s/blobs && f=$(ls | grep part) && head -c 2000 /dev/zero | tr '\\0' l >> $f",
             folder);
    assert_int_equal(system(path), 0);
    open_store(&s);
    sent = put(&s, "ann", hash, sizeof bytes, 0, NULL, 0);
    assert_true(sent.put.complete);
    assert_int_equal(n_files(".part") + n_files(".upload"), 0);
    // One whose bytes a power cut has spoilt is found out at its end.
    memset(bytes, 's', sizeof bytes);
    hash_of(bytes, sizeof bytes, hash);
    put(&s, "ann", hash, sizeof bytes, 0, bytes, 3000);
    close_store(&s);
    snprintf(path, sizeof path, "%s/blobs", folder);
    DIR *dir = opendir(path);
    for (struct dirent *e; (e = readdir(dir));)
        if (strstr(e->d_name, ".part")) {
            int fd = openat(dirfd(dir), e->d_name, O_WRONLY);
            assert_int_equal(pwrite(fd, "\0\0\0", 3, 100), 3);
            assert_int_equal(ftruncate(fd, 2500), 0);
            close(fd);
        }
    closedir(dir);
    open_store(&s);
    assert_int_equal(put(&s, "ann", hash, sizeof bytes, 0, NULL, 0).put.received, 2500);
    sent = put(&s, "ann", hash, sizeof bytes, 2500, bytes, 2500);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_HASH);
    assert_false(blobs_has(s.blobs, hash));
    assert_int_equal(ledger_total(s.ledger, LEDGER_UPLOADS), 0);
    // A part that nobody promised is removed, as is a promise that says something else.
    close_store(&s);
    snprintf(path, sizeof path, "touch %s/blobs/%s.0123456789abcdef.part", folder, hash);
    assert_int_equal(system(path), 0);
    snprintf(path, sizeof path, "printf '9\\tann\\n' > %s/blobs/%s.0123456789abcdee.upload",
             folder, hash);
    assert_int_equal(system(path), 0);
    open_store(&s);
    assert_int_equal(n_files(".part") + n_files(".upload"), 0);
    assert_int_equal(ledger_total(s.ledger, LEDGER_UPLOADS), 0);
    close_store(&s);
}

struct waiter {
    struct blob_waiter waiter; // first
    bool woken;
};

static void woken(struct blob_waiter *waiter)
{
    ((struct waiter *)waiter)->woken = true;
}

static bool check(struct store *s, const char *hash)
{
    struct waiter w = {.waiter.wake = woken}, v = w;
    blobs_check(s->blobs, hash, &w.waiter);
    blobs_check(s->blobs, hash, &v.waiter);
    while (!w.woken || !v.woken) loop_turn(s->loop, 10);
    return blobs_has(s->blobs, hash);
}

static void test_blobs_are_checked_before_first_use(void **state)
{
    struct store s;
    new_store(&s);
    char good[65], bad[65], path[4096];
    put_whole(&s, "ann", 'g', 5000, good);
    put_whole(&s, "ann", 'h', 5000, bad);
    assert_true(check(&s, bad));
    blobs_path(s.blobs, bad, path, sizeof path);
    close_store(&s);
    assert_int_equal(truncate(path, 4999), 0);
    open_store(&s);
    assert_int_equal(disk_bytes_of(s.ledger, "ann"), 2 * (8192 + 4096));
    assert_true(check(&s, good));
    assert_false(check(&s, bad));
    assert_int_equal(disk_bytes_of(s.ledger, "ann"), 8192 + 4096);
    assert_int_equal(access(path, F_OK), -1);
    reopen_store(&s);
    blobs_path(s.blobs, good, path, sizeof path);
    assert_int_equal(truncate(path, 0), 0);
    // A question about it tells the truth, too.
    struct sent sent = put(&s, "bob", good, 5000, 0, NULL, 0);
    assert_false(sent.put.complete);
    assert_int_equal(sent.put.received, 0);
    close_store(&s);
}

// A blob that cannot be read for lack of descriptors is not damaged: it stays, and is checked
// when it is used next.
static void test_check_without_descriptors(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65], path[4096];
    put_whole(&s, "ann", 'g', 5000, hash);
    reopen_store(&s);
    rlim_t before = allow_descriptors(0);
    bool there = check(&s, hash);
    struct sent sent = put(&s, "ann", hash, 5000, 0, NULL, 0);
    descriptors_again(before);
    assert_true(there);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY);
    assert_true(put(&s, "ann", hash, 5000, 0, NULL, 0).put.complete);
    reopen_store(&s);
    blobs_path(s.blobs, hash, path, sizeof path);
    assert_int_equal(truncate(path, 4999), 0);
    assert_false(check(&s, hash));
    close_store(&s);
}

static sem_t let_go;

static int run_blocker(struct work *work, const struct prt_context *ctx)
{
    while (sem_wait(&let_go)) continue;
    return 0;
}

static void blocker_done(struct work *work)
{
}

// A light that was dropped is there, and one of before the start is checked, while background
// work keeps a worker for long. The other worker takes no background work then.
static void test_small_blobs_pass_background_work(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65], bytes[5000] = "a light";
    struct sent sent;
    struct work blocker = {.run = run_blocker, .done = blocker_done, .class = WORK_BACKGROUND};
    hash_of(bytes, sizeof bytes, hash);
    assert_int_equal(sem_init(&let_go, 0, 0), 0);
    work_submit(s.work, &blocker);
    begin_put(&s, &sent, "ann", hash, sizeof bytes, 0, bytes, sizeof bytes);
    for (int i = 0; i < 2000 && !sent.done; i++) loop_turn(s.loop, 10);
    bool passed = sent.done;
    sem_post(&let_go);
    turn_until_idle(&s);
    assert_true(passed && sent.put.complete);
    reopen_store(&s); // it was not checked yet
    struct waiter w = {.waiter.wake = woken};
    work_submit(s.work, &blocker);
    blobs_check(s.blobs, hash, &w.waiter);
    for (int i = 0; i < 2000 && !w.woken; i++) loop_turn(s.loop, 10);
    passed = w.woken;
    sem_post(&let_go);
    turn_until_idle(&s);
    assert_true(passed);
    close_store(&s);
}

// Two requests wait for one check. One leaves before it begins; the other is still woken.
static void test_one_of_two_leaves_a_check(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65];
    struct work blocker[2] = {{.run = run_blocker, .done = blocker_done}}; // both workers
    blocker[1] = blocker[0];
    put_whole(&s, "ann", 'g', 5000, hash);
    assert_int_equal(sem_init(&let_go, 0, 0), 0);
    for (int first = 0; first < 2; first++) {
        struct waiter w[2] = {{.waiter.wake = woken}, {.waiter.wake = woken}};
        reopen_store(&s); // it was not checked yet
        for (int i = 0; i < 2; i++) work_submit(s.work, &blocker[i]);
        for (int i = 0; i < 2; i++) blobs_check(s.blobs, hash, &w[i].waiter);
        blobs_check_leave(s.blobs, hash, &w[first].waiter);
        for (int i = 0; i < 2; i++) sem_post(&let_go);
        turn_until_idle(&s);
        assert_false(w[first].woken);
        assert_true(w[!first].woken);
        assert_true(check(&s, hash));
    }
    close_store(&s);
    sem_destroy(&let_go);
}

struct leaver {
    struct blob_waiter waiter; // first
    struct store *store;
    const char *hash;
    struct waiter *other;
};

static void leave_for_another(struct blob_waiter *waiter)
{
    struct leaver *l = (struct leaver *)waiter;
    blobs_check_leave(l->store->blobs, l->hash, &l->other->waiter);
    memset(l->other, 0xa5, sizeof *l->other); // it is freed
}

// Whoever is woken by a check may end another's wait for it, be the blob good or damaged.
static void test_leaving_a_check_that_has_ended(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65], path[4096];
    put_whole(&s, "ann", 'g', 5000, hash);
    blobs_path(s.blobs, hash, path, sizeof path);
    for (int damaged = 0; damaged < 2; damaged++) {
        struct waiter gone = {.waiter.wake = woken}, last = gone;
        struct leaver first = {{.wake = leave_for_another}, &s, hash, &gone};
        if (damaged) assert_int_equal(truncate(path, 4999), 0);
        reopen_store(&s);
        blobs_check(s.blobs, hash, &first.waiter);
        blobs_check(s.blobs, hash, &gone.waiter);
        blobs_check(s.blobs, hash, &last.waiter);
        turn_until_idle(&s);
        assert_true(last.woken);
        assert_int_equal(blobs_has(s.blobs, hash), !damaged);
    }
    close_store(&s);
}

static void test_names_and_owners(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65], name[256], wanted[32], text[256], said[256];
    put_whole(&s, "ann", 'n', 100, hash);
    put_whole(&s, "bob", 'n', 100, hash); // is told that it is there
    turn_until_idle(&s);
    snprintf(wanted, sizeof wanted, "%.12s…", hash);
    snprintf(text, sizeof text, "%s: not an image, %s", wanted, "0123456789ab…");
    for (int i = 0; i < 2; i++) {
        assert_int_equal(disk_bytes_of(s.ledger, "ann"), 2 * 4096);
        assert_int_equal(disk_bytes_of(s.ledger, "bob"), 0);
        blobs_name(s.blobs, "ann", hash, name, sizeof name);
        assert_string_equal(name, "ann.hdr");
        blobs_name(s.blobs, "bob", hash, name, sizeof name);
        assert_string_equal(name, "bob.hdr");
        blobs_name(s.blobs, "eve", hash, name, sizeof name);
        assert_string_equal(name, wanted);
        blobs_name(s.blobs, NULL, hash, name, sizeof name);
        assert_string_equal(name, wanted);
        blobs_name_in_text(s.blobs, "bob", text, said, sizeof said);
        assert_string_equal(said, "bob.hdr: not an image, 0123456789ab…");
        blobs_name_in_text(s.blobs, "bob", text, said, 5);
        assert_string_equal(said, "bob.");
        blobs_name_in_text(s.blobs, "eve", text, said, 14); // ends inside the "…"
        assert_int_equal(strlen(said), 12);
        blobs_name_in_text(s.blobs, "eve", text, said, sizeof said);
        assert_string_equal(said, text);
        reopen_store(&s);
    }
    close_store(&s);
}

// Says that the blob is uploaded under this name, as a client does whose blob is there.
static void name_blob(struct store *s, const char *who, const char *hash, const char *name)
{
    struct sent sent = {.put = {.size = 100, .done = put_done}};
    struct timespec later = {0, 20000000}; // times of files are that coarse
    nanosleep(&later, NULL);
    strcpy(sent.put.principal, who);
    strcpy(sent.put.name, name);
    memcpy(sent.put.hash, hash, BLOB_HASH);
    blobs_put(s->blobs, &sent.put);
    while (!sent.done || work_busy(s->work)) loop_turn(s->loop, 10);
    assert_true(sent.put.complete);
}

// Of several images the name is that of the last upload, whichever was used last.
static void test_newest_of_a_name(void **state)
{
    struct store s;
    new_store(&s);
    char first[65], second[65];
    put_whole(&s, "ann", 'a', 100, first);
    put_whole(&s, "ann", 'b', 100, second);
    name_blob(&s, "ann", first, "day.hdr");
    name_blob(&s, "ann", second, "day.hdr");
    for (int i = 0; i < 2; i++) {
        blobs_touch(s.blobs, first); // used
        assert_string_equal(blobs_image_named(s.blobs, "ann", "day"), second);
        assert_null(blobs_image_named(s.blobs, "bob", "day"));
        assert_null(blobs_image_named(s.blobs, "ann", "night"));
        reopen_store(&s);
    }
    name_blob(&s, "ann", second, "night.hdr"); // under two names
    name_blob(&s, "ann", first, "day.hdr");    // again
    for (int i = 0; i < 2; i++) {
        blobs_touch(s.blobs, second);
        assert_string_equal(blobs_image_named(s.blobs, "ann", "day"), first);
        assert_string_equal(blobs_image_named(s.blobs, "ann", "night.hdr"), second);
        reopen_store(&s);
    }
    close_store(&s);
}

// The blob that was unused longest goes first, of the owner whose room is spent.
static void test_eviction(void **state)
{
    struct store s;
    new_store(&s);
    enum { N = 5 };
    char hash[N][65], other[65], last[65];
    s.setup.keep_s = 0;
    s.options.client_disk = N * 16384;
    s.options.disk = (N + 2) * 16384;
    reopen_store(&s);
    put_whole(&s, "bob", 'o', 12288, other); // the oldest of all
    for (int i = 0; i < N; i++) put_whole(&s, "ann", (char)('a' + i), 12288, hash[i]);
    blobs_touch(s.blobs, hash[0]);
    blobs_maintain(s.blobs);
    turn_until_idle(&s);
    reopen_store(&s); // the order of use survives
    put_whole(&s, "ann", 'z', 12288, last);
    assert_true(blobs_has(s.blobs, hash[0]));
    assert_false(blobs_has(s.blobs, hash[1]));
    assert_true(blobs_has(s.blobs, hash[2]));
    assert_true(blobs_has(s.blobs, other));
    put_whole(&s, "eve", 'E', 12288, last);
    assert_true(blobs_has(s.blobs, other));
    put_whole(&s, "eve", 'F', 12288, last); // now --disk is spent, most of it by ann
    assert_false(blobs_has(s.blobs, hash[2]));
    assert_true(blobs_has(s.blobs, other));
    assert_int_equal(disk_bytes(s.ledger), (N + 2) * 16384);
    turn_until_idle(&s);
    assert_int_equal(n_files("trash"), 0);
    assert_int_equal(n_files(""), 2 + 2 * (N + 2)); // ".", "..", blobs and their owners
    s.setup.keep_s = 600;                           // nothing that was used so recently
    reopen_store(&s);
    struct sent sent = put(&s, "eve", hash[2], 12288, 0, ".", 1);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    close_store(&s);
}

// What bob left days ago stays while ann, who holds most of the disk, wants more; carl, who has
// nothing yet, gets it, as what ann holds was used just now.
static void test_eviction_within_shares(void **state)
{
    struct store s;
    new_store(&s);
    char old[65], hash[65], path[4096];
    struct timespec days_ago[2] = {{.tv_sec = 1000000}, {.tv_sec = 1000000}};
    s.setup.keep_s = 600;
    s.options.disk = 6 * 16384;
    reopen_store(&s);
    put_whole(&s, "bob", 'o', 12288, old);
    for (int i = 0; i < 5; i++) put_whole(&s, "ann", (char)('a' + i), 12288, hash);
    blobs_path(s.blobs, old, path, sizeof path);
    close_store(&s);
    assert_int_equal(utimensat(AT_FDCWD, path, days_ago, 0), 0);
    open_store(&s);
    memset(hash, 'f', 64);
    struct sent sent = put(&s, "ann", hash, 12288, 0, ".", 1);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_true(blobs_has(s.blobs, old));
    sent = put(&s, "carl", hash, 12288, 0, ".", 1);
    assert_int_equal(sent.put.code, 0);
    assert_false(blobs_has(s.blobs, old));
    close_store(&s);
}

// A principal above its share may still take the room of blobs without an owner.
static void test_room_of_nobody(void **state)
{
    struct store s;
    new_store(&s);
    char lost[65], hash[65], path[4096 + 8];
    s.setup.keep_s = 0;
    s.options.disk = 6 * 16384;
    s.options.client_disk = 0;
    reopen_store(&s);
    put_whole(&s, "bob", 'o', 12288, lost);
    blobs_path(s.blobs, lost, path, sizeof path);
    strcat(path, ".owner");
    close_store(&s);
    assert_int_equal(unlink(path), 0);
    open_store(&s);
    assert_int_equal(disk_bytes_of(s.ledger, DISK_NOBODY), 16384);
    put_whole(&s, "carl", 'c', 12288, hash);
    for (int i = 0; i < 4; i++) put_whole(&s, "ann", (char)('p' + i), 12288, hash);
    assert_true(blobs_has(s.blobs, lost));
    put_whole(&s, "ann", 'z', 12288, hash);
    assert_false(blobs_has(s.blobs, lost));
    assert_int_equal(disk_bytes_of(s.ledger, "ann"), 5 * 16384);
    assert_int_equal(disk_bytes_of(s.ledger, "carl"), 16384);
    close_store(&s);
}

// A promise beyond --disk is refused whatever is evicted: so nothing is.
static void test_what_never_fits_evicts_nothing(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65], large[65];
    s.setup.keep_s = 0;
    s.options.disk = MB;
    s.options.client_disk = 4 * MB;
    reopen_store(&s);
    put_whole(&s, "bob", 'b', 700000, hash); // above its share while two want room
    memset(large, 'f', 64);
    struct sent sent = put(&s, "ann", large, 2 * MB, 0, ".", 1);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_non_null(strstr(sent.put.error, "--disk"));
    assert_true(blobs_has(s.blobs, hash));
    close_store(&s);
}

static void test_largest_blob(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65];
    s.setup.max_blob = 5000;
    reopen_store(&s);
    put_whole(&s, "ann", 'm', 5000, hash);
    memset(hash, 'f', 64);
    struct sent sent = put(&s, "ann", hash, 5001, 0, ".", 1);
    assert_int_equal(sent.put.code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_non_null(strstr(sent.put.error, "allowed range 1 to 5000"));
    close_store(&s);
}

// A store with room for n blocks of 16 KiB and two old uploads of ann's, the first used last.
static void two_old_uploads(struct store *s, uint64_t n, char first[65], char second[65])
{
    new_store(s);
    s->setup.keep_s = 0;
    s->options.client_disk = n * 16384;
    reopen_store(s);
    put_whole(s, "ann", 'a', 12288, first);
    put_whole(s, "ann", 'b', 12288, second);
    blobs_maintain(s->blobs);
    turn_until_idle(s);
    blobs_touch(s->blobs, first);
}

// A time of use is written though an upload has arrived since.
static void test_use_before_an_upload_is_kept(void **state)
{
    struct store s;
    char first[65], second[65], hash[65];
    two_old_uploads(&s, 3, first, second);
    put_whole(&s, "ann", 'c', 12288, hash);
    reopen_store(&s);
    put_whole(&s, "ann", 'd', 12288, hash);
    assert_true(blobs_has(s.blobs, first));
    assert_false(blobs_has(s.blobs, second));
    close_store(&s);
}

// Nor is it lost by one that was fetched from the folder of all replicas.
static void test_use_before_a_fetch_is_kept(void **state)
{
    static const char bytes[] = "from another replica";
    struct store s;
    char first[65], second[65], fetched[65], path[4096], hash[65];
    two_old_uploads(&s, 2, first, second);
    hash_of(bytes, sizeof bytes, fetched);
    blobs_path(s.blobs, fetched, path, sizeof path);
    int fd = open(path, O_CREAT | O_WRONLY, 0600);
    assert_int_equal(write(fd, bytes, sizeof bytes), sizeof bytes);
    close(fd);
    assert_int_equal(blob_adopt(s.blobs, fetched, sizeof bytes), 0);
    reopen_store(&s);
    assert_true(blobs_has(s.blobs, fetched));
    put_whole(&s, "ann", 'd', 12288, hash);
    assert_true(blobs_has(s.blobs, first));
    assert_false(blobs_has(s.blobs, second));
    close_store(&s);
}

static void fetch(struct store *s, const char *hash)
{
    struct waiter w = {.waiter.wake = woken};
    blobs_fetch(s->blobs, hash, &w.waiter);
    while (!w.woken) loop_turn(s->loop, 10);
    assert_true(disk_bytes(s->ledger) <= s->options.disk);
}

// An upload of ann's that another replica took: it is in the shared folder alone.
static void share_blob(struct store *s, char letter, char hash[65])
{
    char bytes[12288], path[128];
    memset(bytes, letter, sizeof bytes);
    hash_of(bytes, sizeof bytes, hash);
    snprintf(path, sizeof path, "%s/of-another", folder);
    int fd = open(path, O_CREAT | O_TRUNC | O_WRONLY, 0600);
    assert_int_equal(write(fd, bytes, sizeof bytes), sizeof bytes);
    close(fd);
    assert_int_equal(disk_owner_write(path, "ann"), 0);
    assert_int_equal(object_put(s->setup.objects, OBJECT_BLOB, hash, path), 0);
    strcat(path, ".owner");
    assert_int_equal(object_put(s->setup.objects, OBJECT_OWNER, hash, path), 0);
}

static unsigned n_made_room;

static void make_room(void *user, const char *owner)
{
    assert_string_equal(owner, "ann");
    n_made_room++;
}

// What is fetched from the folder of all replicas stays within --disk: others go for it, and
// where none may go it is not kept.
static void test_fetches_stay_within_the_disk(void **state)
{
    struct store s;
    char shared[128], hash[4][65], error[256];
    new_store(&s);
    snprintf(shared, sizeof shared, "%s/shared", folder);
    assert_int_equal(object_store_open(shared, &s.setup.objects, error), 0);
    s.setup.keep_s = 0;
    s.setup.make_room = make_room;
    s.options.disk = s.options.client_disk = 3 * 16384;
    reopen_store(&s);
    for (int i = 0; i < 4; i++) {
        share_blob(&s, (char)('a' + i), hash[i]);
        fetch(&s, hash[i]);
        assert_int_equal(disk_bytes_of(s.ledger, "ann"), 16384 * (i < 3 ? i + 1 : 3));
    }
    assert_false(blobs_has(s.blobs, hash[0]));
    for (int i = 1; i < 4; i++) assert_true(blobs_has(s.blobs, hash[i]));
    assert_int_equal(n_made_room, 0);
    s.setup.keep_s = 600; // from here on all of them were just used
    reopen_store(&s);
    fetch(&s, hash[0]);
    assert_int_equal(n_made_room, 1);
    assert_false(blobs_has(s.blobs, hash[0]));
    close_store(&s);
    object_store_close(s.setup.objects);
}

// However many principals upload the same bytes, the names kept of them are bounded.
static void test_names_of_many(void **state)
{
    struct store s;
    new_store(&s);
    char hash[65], who[32], name[256], path[4096 + 8], last[32] = "";
    unsigned n_named = 0;
    put_whole(&s, "ann", 'n', 100, hash);
    for (int i = 0; i < 400; i++) {
        snprintf(who, sizeof who, "principal %d", i);
        assert_true(put(&s, who, hash, 100, 0, NULL, 0).put.complete);
        blobs_name(s.blobs, who, hash, name, sizeof name);
        if (strncmp(name, who, strlen(who))) break;
        n_named++;
        strcpy(last, who);
    }
    assert_in_range(n_named, 100, 200);
    turn_until_idle(&s);
    struct stat st;
    blobs_path(s.blobs, hash, path, sizeof path);
    strcat(path, ".owner");
    assert_int_equal(stat(path, &st), 0);
    assert_in_range(st.st_size, 2000, 4096);
    reopen_store(&s);
    blobs_name(s.blobs, last, hash, name, sizeof name);
    assert_int_equal(strncmp(name, last, strlen(last)), 0);
    close_store(&s);
}

static void test_index_of_many(void **state)
{
    enum { N = 3000 };
    struct store s;
    new_store(&s);
    static char hash[N][65];
    char path[4096];
    for (int i = 0; i < N; i++) {
        hash_of(&i, sizeof i, hash[i]);
        blobs_path(s.blobs, hash[i], path, sizeof path);
        int fd = open(path, O_CREAT | O_WRONLY, 0600);
        assert_int_equal(write(fd, &i, sizeof i), sizeof i);
        close(fd);
    }
    assert_false(blobs_has(s.blobs, hash[0])); // the folder is read at the start only
    reopen_store(&s);
    for (int i = 0; i < N; i++) assert_true(blobs_has(s.blobs, hash[i]));
    assert_int_equal(disk_bytes_of(s.ledger, DISK_NOBODY), N * 2 * 4096);
    assert_false(blobs_has(s.blobs, "nonsense"));
    hash[0][0] ^= 1;
    assert_false(blobs_has(s.blobs, hash[0]));
    close_store(&s);
}

// Chunks that nobody waits for any more: one that a worker has, and those behind it.
static void test_abandoned_chunks(void **state)
{
    struct store s;
    new_store(&s);
    enum { N = 4, PIECE = 2 * MB };
    struct sent *sent[N];
    char hash[65], *bytes[N];
    memset(hash, 'f', 64);
    hash[64] = 0;
    for (int i = 0; i < N; i++) {
        bytes[i] = calloc(1, PIECE);
        sent[i] = malloc(sizeof *sent[i]);
        begin_put(&s, sent[i], "ann", hash, 20 * MB, (uint64_t)i * PIECE, bytes[i], PIECE);
    }
    for (int i = 0; i < N; i++) {
        blobs_put_abandon(&sent[i]->put);
        if (i) assert_true(sent[i]->done); // the first is with a worker
        if (!i) continue;
        free(bytes[i]);
        free(sent[i]);
    }
    while (!sent[0]->done) loop_turn(s.loop, 10);
    free(bytes[0]);
    free(sent[0]);
    assert_int_equal(put(&s, "ann", hash, 20 * MB, 0, NULL, 0).put.received, PIECE);
    close_store(&s);
}

// The last chunk that waits is abandoned: the next one is served.
static void test_chunk_after_an_abandoned_one(void **state)
{
    struct store s;
    new_store(&s);
    enum { PIECE = 100000 };
    static struct sent sent[3];
    static char bytes[2 * PIECE];
    char hash[65];
    hash_of(bytes, sizeof bytes, hash);
    begin_put(&s, &sent[0], "ann", hash, sizeof bytes, 0, bytes, PIECE);
    begin_put(&s, &sent[1], "ann", hash, sizeof bytes, PIECE, bytes + PIECE, PIECE);
    blobs_put_abandon(&sent[1].put);
    assert_true(sent[1].done);
    begin_put(&s, &sent[2], "ann", hash, sizeof bytes, PIECE, bytes + PIECE, PIECE);
    turn_until_idle(&s);
    assert_true(sent[0].done && sent[2].done);
    assert_true(sent[2].put.complete);
    close_store(&s);
}

static int setup(void **state)
{
    return mkdtemp(folder) ? 0 : -1;
}

static int teardown(void **state)
{
    remove_files();
    return rmdir(folder);
}

static unsigned n_freed;

static void free_put(struct blob_put *put)
{
    n_freed++;
    free(put->bytes);
    free(put);
}

// As the daemon does it: whoever is answered is freed at once, the winner and the losers.
static void test_puts_are_freed_when_done(void **state)
{
    struct store s;
    new_store(&s);
    enum { N = 3, SIZE = 200000 };
    char hash[65], lie[65];
    memset(lie, 'd', 64);
    put(&s, "idle", lie, 2, 0, ".", 1); // which others' hashes are compared with
    for (int round = 0; round < 2 * N; round++) {
        bool wrong = round % 2;
        for (int i = 0; i < N; i++)
            for (int half = 0; half < 2; half++) {
                struct blob_put *p = calloc(1, sizeof *p);
                p->size = SIZE;
                p->offset = half ? SIZE / 2 : 0;
                p->n = SIZE / 2;
                p->bytes = malloc(SIZE);
                memset(p->bytes, 'A' + round, SIZE);
                hash_of(p->bytes, SIZE, hash);
                memset(lie, 'c', 64);
                memcpy(p->hash, wrong ? lie : hash, 64);
                snprintf(p->principal, sizeof p->principal, "client %d", i);
                p->done = free_put;
                blobs_put(s.blobs, p);
            }
        turn_until_idle(&s);
        assert_int_equal(blobs_has(s.blobs, hash), !wrong);
    }
    assert_int_equal(n_freed, 2 * N * N * 2);
    close_store(&s);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_disk_is_charged_by_owner),
        cmocka_unit_test(test_owner_is_kept_beside_the_file),
        cmocka_unit_test(test_room_is_charged_when_promised),
        cmocka_unit_test(test_first_of_two_wins),
        cmocka_unit_test(test_pipelined_chunks),
        cmocka_unit_test(test_chunk_behind_a_gap),
        cmocka_unit_test(test_folder_that_does_not_sync),
        cmocka_unit_test(test_limits_of_a_principal),
        cmocka_unit_test(test_the_longest_idle_upload_goes),
        cmocka_unit_test(test_upload_goes_on_after_a_restart),
        cmocka_unit_test(test_blobs_are_checked_before_first_use),
        cmocka_unit_test(test_check_without_descriptors),
        cmocka_unit_test(test_small_blobs_pass_background_work),
        cmocka_unit_test(test_one_of_two_leaves_a_check),
        cmocka_unit_test(test_leaving_a_check_that_has_ended),
        cmocka_unit_test(test_names_and_owners),
        cmocka_unit_test(test_newest_of_a_name),
        cmocka_unit_test(test_eviction),
        cmocka_unit_test(test_eviction_within_shares),
        cmocka_unit_test(test_room_of_nobody),
        cmocka_unit_test(test_what_never_fits_evicts_nothing),
        cmocka_unit_test(test_largest_blob),
        cmocka_unit_test(test_use_before_an_upload_is_kept),
        cmocka_unit_test(test_use_before_a_fetch_is_kept),
        cmocka_unit_test(test_fetches_stay_within_the_disk),
        cmocka_unit_test(test_names_of_many),
        cmocka_unit_test(test_index_of_many),
        cmocka_unit_test(test_abandoned_chunks),
        cmocka_unit_test(test_chunk_after_an_abandoned_one),
        cmocka_unit_test(test_puts_are_freed_when_done),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
