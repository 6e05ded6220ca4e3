// SPDX-License-Identifier: MIT
// The shared folder: objects are linked to their names once they are on the disk, copied before
// they are read, and moved aside before they are removed.
#include "store/object_store_private.h"

#include "frame.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/random.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

static const char format_text[] = "relight store 1\n";
/* STALE_TRIES: on NFS a file that another machine replaces or removes is stale for whoever has
 * it open; its name leads to the new one, or to none. The name itself can stay stale for some
 * milliseconds (test nfs_records): from the third try on each waits, .6 s in all. */
enum { PIECE = 1 << 20, TEMPORARY_S = 3600, STALE_TRIES = 16 };

static const struct {
    const char *folder, *ending;
    bool fanned; // over folders of the id's first two digits
} kinds[OBJECT_N] = {{"blobs", "", true},
                     {"blobs", ".owner", true},
                     {"bakes", ".prt", true},
                     {"records", ".json", false}};

bool object_store_shared(const struct object_store *store)
{
    return store && store->folder[0];
}

void object_temporary(struct object_store *store, char path[PATH_MAX])
{
    snprintf(path, PATH_MAX, "%s/tmp/%s-%" PRIu64, store->folder, store->owner,
             atomic_fetch_add(&store->last_temporary, 1) + 1);
}

bool object_refresh_folder(const char *folder)
{
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd >= 0) close(fd);
    return fd >= 0;
}

bool object_stale(int err)
{
    return err == -ESTALE || err == -EBADF;
}

// Whether an operation on the path that ended so is worth another try: on NFS the file is stale
// (STALE_TRIES), or only this machine still takes it for missing.
static bool try_again(const char *path, int err, int tries)
{
    char folder[PATH_MAX];
    if (!(object_stale(err) && tries < STALE_TRIES) && !(err == -ENOENT && !tries))
        return false;
    if (tries > 1) usleep(1000u << (tries < 8 ? tries - 2 : 6));
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = 0;
    char *above = strrchr(folder, '/'); // blobs and bakes are in folders of their first digits
    *above = 0;
    (void)object_refresh_folder(folder);
    *above = '/';
    return object_refresh_folder(folder) || object_stale(err);
}

int object_sync_folder(const char *path)
{
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", path);
    *strrchr(folder, '/') = 0;
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    int err = fd < 0 || fsync(fd) ? -errno : 0;
    if (fd >= 0) close(fd);
    return err;
}

// Hex digits alone, so that no id leads out of the folder.
static bool id_valid(const char *id)
{
    size_t n = strlen(id);
    return n >= 8 && n <= OBJECT_ID && strspn(id, "0123456789abcdef") == n;
}

static int path_of(const struct object_store *store, enum object_kind kind, const char *id,
                   char path[PATH_MAX])
{
    if (!id_valid(id)) return -EINVAL;
    if (kinds[kind].fanned)
        snprintf(path, PATH_MAX, "%s/%s/%.2s/%s%s", store->folder, kinds[kind].folder, id, id,
                 kinds[kind].ending);
    else
        snprintf(path, PATH_MAX, "%s/%s/%s%s", store->folder, kinds[kind].folder, id,
                 kinds[kind].ending);
    return 0;
}

// A missing object, or a folder that is not mounted?
static int missing(const struct object_store *store)
{
    char path[PATH_MAX];
    snprintf(path, sizeof path, "%s/store", store->folder);
    return access(path, F_OK) ? -EIO : -ENOENT;
}

static int write_all(int fd, const char *bytes, size_t n)
{
    while (n) {
        ssize_t put = write(fd, bytes, n);
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) return put < 0 ? -errno : -EIO;
        bytes += put;
        n -= (size_t)put;
    }
    return 0;
}

// hex: the SHA-256 of what was copied.
static int copy_bytes(int from, int to, char hex[65])
{
    struct relight_sha256 sha;
    char *piece = malloc(PIECE);
    ssize_t n = 0;
    int err = piece ? 0 : -ENOMEM;
    relight_sha256_init(&sha);
    while (!err && ((n = read(from, piece, PIECE)) > 0 || (n < 0 && errno == EINTR))) {
        if (n < 0) continue;
        relight_sha256_add(&sha, piece, (size_t)n);
        err = write_all(to, piece, (size_t)n);
    }
    if (!err && n < 0) err = -errno;
    relight_sha256_hex(&sha, hex);
    free(piece);
    return err;
}

// Copies `from` to the new file `to`; sync: it is on the disk afterwards.
static int copy_file(const char *from, const char *to, bool sync, char hex[65])
{
    int source = open(from, O_RDONLY | O_CLOEXEC | O_NOFOLLOW);
    if (source < 0) return -errno;
    int fd = open(to, O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
    int err = fd < 0 ? -errno : copy_bytes(source, fd, hex);
    if (!err && sync && fsync(fd)) err = -errno;
    if (fd >= 0 && close(fd) && !err) err = -errno; // NFS reports a full disk here
    if (err && fd >= 0) unlink(to);
    close(source);
    return err;
}

// ---- opening

static int make_folder(const struct object_store *store, const char *name)
{
    char path[PATH_MAX];
    snprintf(path, sizeof path, "%s/%s", store->folder, name);
    return mkdir(path, 0700) && errno != EEXIST ? -errno : 0;
}

// A file that is written now has the folder's time.
static void compare_clocks(struct object_store *store, int fd)
{
    struct timespec now;
    struct stat st;
    clock_gettime(CLOCK_REALTIME, &now);
    if (fstat(fd, &st)) return;
    store->ahead_s = (double)(now.tv_sec - st.st_mtim.tv_sec) +
                     1e-9 * (double)(now.tv_nsec - st.st_mtim.tv_nsec);
}

static int check_format(struct object_store *store, char error[256])
{
    char path[PATH_MAX], temporary[PATH_MAX], text[64] = "";
    snprintf(path, sizeof path, "%s/store", store->folder);
    object_temporary(store, temporary);
    int fd = open(temporary, O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
    int err = fd < 0 ? -errno : write_all(fd, format_text, strlen(format_text));
    if (!err && fsync(fd)) err = -errno;
    if (!err) compare_clocks(store, fd);
    if (fd >= 0) close(fd);
    if (!err && link(temporary, path) && errno != EEXIST) err = -errno;
    unlink(temporary);
    if (!err) err = object_sync_folder(path);
    FILE *file = err ? NULL : fopen(path, "re");
    if (!err && !file) err = -errno;
    if (file && !fgets(text, sizeof text, file)) text[0] = 0;
    if (file) fclose(file);
    if (!err && strcmp(text, format_text)) {
        text[strcspn(text, "\n")] = 0;
        snprintf(error, 256, "--store %.100s: it is \"%.40s\", this relightd uses \"%.15s\"",
                 store->folder, text, format_text);
        return -EPROTO;
    }
    return err;
}

static int open_folder(struct object_store *store, const char *folder, char error[256])
{
    char real[PATH_MAX];
    if (mkdir(folder, 0700) && errno != EEXIST) return -errno;
    if (!realpath(folder, real)) return -errno;
    if (strlen(real) >= sizeof store->folder) return -ENAMETOOLONG;
    strcpy(store->folder, real);
    int err = make_folder(store, "tmp");
    if (!err) err = make_folder(store, "claims");
    for (int i = 0; !err && i < OBJECT_N; i++) err = make_folder(store, kinds[i].folder);
    return err ? err : check_format(store, error);
}

int object_store_open(const char *folder, struct object_store **out, char error[256])
{
    struct object_store *store = calloc(1, sizeof *store);
    char host[64] = "";
    uint64_t digits = 0;
    int err = store ? 0 : -ENOMEM;
    error[0] = 0;
    gethostname(host, sizeof host - 1);
    host[strcspn(host, " /")] = 0;
    if (!err && getrandom(&digits, sizeof digits, 0) != sizeof digits) err = -errno;
    if (!err)
        snprintf(store->owner, sizeof store->owner, "%.40s-%d-%016" PRIx64, host, (int)getpid(),
                 digits);
    if (!err && folder[0]) err = open_folder(store, folder, error);
    if (err) {
        if (!error[0]) snprintf(error, 256, "--store %.150s: %s", folder, strerror(-err));
        free(store);
        return err;
    }
    *out = store;
    return 0;
}

double object_store_clock(const struct object_store *store)
{
    return store ? store->ahead_s : 0;
}

void object_store_close(struct object_store *store)
{
    free(store);
}

// ---- objects

int object_get(struct object_store *store, enum object_kind kind, const char *id,
               const char *path)
{
    char from[PATH_MAX], temporary[PATH_MAX + 64], hex[65];
    if (!object_store_shared(store)) return -ENOENT;
    int err = path_of(store, kind, id, from);
    if (err) return err;
    snprintf(temporary, sizeof temporary, "%s.tmp-%" PRIu64, path,
             atomic_fetch_add(&store->last_temporary, 1) + 1);
    int tries = 0;
    do err = copy_file(from, temporary, false, hex);
    while (try_again(from, err, tries++));
    if (err) return err == -ENOENT ? missing(store) : err;
    if (kind == OBJECT_BLOB && strcmp(hex, id)) err = -EBADMSG;
    if (!err && rename(temporary, path)) err = -errno;
    if (err) unlink(temporary);
    else utimensat(AT_FDCWD, from, NULL, 0); // a use; on a read-only folder it is not counted
    return err;
}

// Marks an object as used; -ENOENT: it is not there, perhaps moved aside meanwhile.
static int touch(const char *path, struct stat *st)
{
    if (utimensat(AT_FDCWD, path, NULL, 0) && (errno == ENOENT || errno == ESTALE))
        return -ENOENT;
    if (!stat(path, st)) return 0;
    return errno == ESTALE ? -ENOENT : -errno;
}

int object_find(struct object_store *store, enum object_kind kind, const char *id,
                uint64_t *bytes)
{
    char path[PATH_MAX];
    struct stat st;
    if (!object_store_shared(store)) return -ENOENT;
    int err = path_of(store, kind, id, path), tries = 0;
    if (err) return err;
    do err = touch(path, &st);
    while (try_again(path, err, tries++));
    if (!err) *bytes = (uint64_t)st.st_size;
    return err == -ENOENT ? missing(store) : err;
}

// Links a synced temporary file to its name; one that is there stays.
static int publish(struct object_store *store, const char *temporary, const char *path)
{
    char folder[PATH_MAX];
    struct stat st;
    int err = link(temporary, path) ? -errno : 0;
    if (err == -ENOENT) { // the folder of its first digits
        snprintf(folder, sizeof folder, "%s", path);
        *strrchr(folder, '/') = 0;
        if (mkdir(folder, 0700) && errno != EEXIST) return missing(store);
        if ((err = object_sync_folder(folder))) return err;
        err = link(temporary, path) ? -errno : 0;
    }
    if (err == -EEXIST && !touch(path, &st)) err = 0;
    return err ? err : object_sync_folder(path);
}

int object_put(struct object_store *store, enum object_kind kind, const char *id,
               const char *path)
{
    char to[PATH_MAX], temporary[PATH_MAX], hex[65];
    struct stat st;
    if (!object_store_shared(store)) return 0;
    int err = path_of(store, kind, id, to);
    if (err) return err;
    if (!touch(to, &st)) return object_sync_folder(to); // whoever put it may not have yet
    object_temporary(store, temporary);
    err = copy_file(path, temporary, true, hex);
    if (err) return err;
    if (kind == OBJECT_BLOB && strcmp(hex, id)) {
        unlink(temporary);
        return -EBADMSG;
    }
    // Collected between two steps: there is a place for it, which NFS may not know yet.
    int tries = 0;
    do err = publish(store, temporary, to);
    while (try_again(to, err == -EEXIST ? -ESTALE : err, tries++));
    unlink(temporary);
    return err;
}

static int read_text(const char *path, char **text)
{
    struct stat st;
    char *bytes = NULL;
    ssize_t n = 0;
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NOFOLLOW), err = 0;
    if (fd < 0) return -errno;
    if (fstat(fd, &st)) err = -errno;
    else if (st.st_size > OBJECT_TEXT) err = -EFBIG;
    else if (!(bytes = malloc((size_t)st.st_size + 1))) err = -ENOMEM;
    else if ((n = read(fd, bytes, (size_t)st.st_size)) < 0) err = -errno;
    else if (n != st.st_size) err = -EIO;
    close(fd);
    if (err) {
        free(bytes);
        return err;
    }
    bytes[n] = 0;
    *text = bytes;
    return 0;
}

int object_read(struct object_store *store, const char *id, char **text)
{
    char path[PATH_MAX];
    if (!object_store_shared(store)) return -ENOENT;
    int err = path_of(store, OBJECT_RECORD, id, path);
    if (err) return err;
    int tries = 0;
    do err = read_text(path, text);
    while (try_again(path, err, tries++));
    return err == -ENOENT ? missing(store) : err;
}

int object_write(struct object_store *store, const char *id, const char *text)
{
    char path[PATH_MAX], temporary[PATH_MAX];
    if (!object_store_shared(store)) return 0;
    int err = path_of(store, OBJECT_RECORD, id, path);
    if (err) return err;
    object_temporary(store, temporary);
    int fd = open(temporary, O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
    if (fd < 0) return errno == ENOENT ? missing(store) : -errno;
    err = write_all(fd, text, strlen(text));
    if (!err && fsync(fd)) err = -errno;
    if (close(fd) && !err) err = -errno;
    if (!err) {
        // On NFS the file that is replaced may be stale. It may be missing for a moment, too: a
        // machine that has it open moves it aside before it replaces it.
        int tries = 0;
        do err = rename(temporary, path) ? -errno : 0;
        while (try_again(path, err == -ENOENT ? -ESTALE : err, tries++));
        if (err == -ENOENT) err = missing(store);
    }
    if (err) unlink(temporary);
    return err ? err : object_sync_folder(path);
}

int object_remove(struct object_store *store, enum object_kind kind, const char *id)
{
    char path[PATH_MAX];
    if (!object_store_shared(store)) return 0;
    int err = path_of(store, kind, id, path);
    if (err) return err;
    return unlink(path) && errno != ENOENT ? -errno : 0;
}

// ---- lists

static int list_folder(const char *folder, const char *ending, object_fn fn, void *user)
{
    char id[OBJECT_ID + 1];
    DIR *dir = opendir(folder);
    if (!dir) return errno == ENOENT ? 0 : -errno;
    int err = 0;
    size_t m = strlen(ending);
    for (struct dirent *d; !err && (d = readdir(dir));) {
        struct stat st;
        size_t n = strlen(d->d_name);
        if (n <= m || n - m > OBJECT_ID || strcmp(d->d_name + n - m, ending)) continue;
        snprintf(id, sizeof id, "%.*s", (int)(n - m), d->d_name);
        if (!id_valid(id) || fstatat(dirfd(dir), d->d_name, &st, AT_SYMLINK_NOFOLLOW)) continue;
        uint64_t tag = (uint64_t)st.st_ino * 0x9e3779b97f4a7c15u ^
                       (uint64_t)st.st_mtim.tv_sec * 1000000007u ^ (uint64_t)st.st_mtim.tv_nsec;
        err = fn(user, id, tag);
    }
    closedir(dir);
    return err;
}

int object_list(struct object_store *store, enum object_kind kind, object_fn fn, void *user)
{
    char folder[PATH_MAX];
    if (!object_store_shared(store)) return 0;
    snprintf(folder, sizeof folder, "%s/%s", store->folder, kinds[kind].folder);
    if (access(folder, F_OK)) return missing(store) == -EIO ? -EIO : 0;
    if (!kinds[kind].fanned) return list_folder(folder, kinds[kind].ending, fn, user);
    int err = 0;
    size_t n = strlen(folder);
    for (int i = 0; !err && i < 256; i++) {
        snprintf(folder + n, sizeof folder - n, "/%02x", (unsigned)i);
        err = list_folder(folder, kinds[kind].ending, fn, user);
    }
    return err;
}

// ---- removing what nobody uses

struct collecting {
    struct object_store *store;
    enum object_kind kind;
    struct timespec now; // the folder's own clock
    double keep_s;
    uint64_t n;
};

static bool is_older(const struct stat *st, const struct collecting *c, double seconds)
{
    double age = (double)(c->now.tv_sec - st->st_mtim.tv_sec) +
                 1e-9 * (double)(c->now.tv_nsec - st->st_mtim.tv_nsec);
    return age > seconds;
}

// A new file's time is the folder's clock.
static int folder_clock(struct object_store *store, struct timespec *now)
{
    char path[PATH_MAX];
    struct stat st;
    object_temporary(store, path);
    int fd = open(path, O_CREAT | O_EXCL | O_WRONLY | O_CLOEXEC, 0600);
    if (fd < 0) return -errno;
    int err = write_all(fd, "", 1);
    if (!err && fstat(fd, &st)) err = -errno;
    close(fd);
    unlink(path);
    if (!err) *now = st.st_mtim;
    return err;
}

// Moved aside first: whoever used it since then finds it by its newer time, and it comes back.
static int collect_one(void *user, const char *id, uint64_t tag)
{
    struct collecting *c = user;
    struct stat st;
    char path[PATH_MAX], record[PATH_MAX], aside[PATH_MAX];
    if (path_of(c->store, c->kind, id, path) || stat(path, &st)) return 0;
    if (!is_older(&st, c, c->keep_s)) return 0;
    path_of(c->store, OBJECT_RECORD, id, record);
    if (c->kind == OBJECT_BAKE && !access(record, F_OK)) return 0;
    object_temporary(c->store, aside);
    if (rename(path, aside)) return 0;
    if (stat(aside, &st) || is_older(&st, c, c->keep_s)) {
        c->n++;
    } else if (link(aside, path) && errno != EEXIST) {
        rename(aside, path);
        return 0;
    }
    unlink(aside);
    return 0;
}

static void collect_temporary(struct collecting *c)
{
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s/tmp", c->store->folder);
    DIR *dir = opendir(folder);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        struct stat st;
        if (fstatat(dirfd(dir), d->d_name, &st, AT_SYMLINK_NOFOLLOW) || !S_ISREG(st.st_mode))
            continue;
        if (is_older(&st, c, TEMPORARY_S) && !unlinkat(dirfd(dir), d->d_name, 0)) c->n++;
    }
    if (dir) closedir(dir);
}

int object_collect(struct object_store *store, double keep_s, uint64_t *n)
{
    struct collecting c = {.store = store, .keep_s = keep_s};
    *n = 0;
    if (!object_store_shared(store)) return 0;
    int err = folder_clock(store, &c.now);
    if (err) return err;
    collect_temporary(&c);
    for (int kind = 0; !err && keep_s > 0 && kind < OBJECT_RECORD; kind++) {
        c.kind = (enum object_kind)kind;
        err = object_list(store, c.kind, collect_one, &c);
    }
    *n = c.n;
    return err;
}
