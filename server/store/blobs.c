// SPDX-License-Identifier: MIT
// Uploads go to HASH.part while their hash is computed chunk by chunk, and are renamed to HASH
// when it is right: a blob that has its final name is whole.
#include "store/blobs.h"

#include "frame.h"
#include "core/loop.h"
#include "relight.pb-c.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <time.h>
#include <unistd.h>

enum { MAX_UPLOADS = 64 };

struct upload {
    struct upload *next;
    char hash[BLOB_HASH + 1];
    uint64_t size, received, used_ns;
    int fd;
    struct relight_sha256 sha;
};

struct blobs {
    char folder[3900];
    uint64_t max_blob, disk;
    int64_t bytes;
    struct upload *upload;
    unsigned n_upload;
};

static void part_path(const struct blobs *blobs, const char *hash, char *path, size_t n)
{
    snprintf(path, n, "%s/%s.part", blobs->folder, hash);
}

void blobs_path(const struct blobs *blobs, const char *hash, char *path, size_t n)
{
    snprintf(path, n, "%s/%s", blobs->folder, hash);
}

int blobs_open(const char *folder, uint64_t max_blob, uint64_t disk, struct blobs **out)
{
    struct blobs *blobs = calloc(1, sizeof *blobs);
    if (!blobs) return -ENOMEM;
    *blobs = (struct blobs){.max_blob = max_blob, .disk = disk};
    snprintf(blobs->folder, sizeof blobs->folder, "%s", folder);
    DIR *dir;
    if ((mkdir(folder, 0700) && errno != EEXIST) || !(dir = opendir(folder))) {
        int err = -errno;
        free(blobs);
        return err;
    }
    for (struct dirent *d; (d = readdir(dir));) {
        struct stat st;
        if (fstatat(dirfd(dir), d->d_name, &st, 0) || !S_ISREG(st.st_mode)) continue;
        if (relight_hash_valid(d->d_name)) blobs->bytes += st.st_size;
        else if (strstr(d->d_name, ".part")) unlinkat(dirfd(dir), d->d_name, 0);
    }
    closedir(dir);
    *out = blobs;
    return 0;
}

static void drop_upload(struct blobs *blobs, struct upload *upload)
{
    struct upload **at = &blobs->upload;
    while (*at != upload) at = &(*at)->next;
    *at = upload->next;
    blobs->n_upload--;
    char path[4096];
    part_path(blobs, upload->hash, path, sizeof path);
    close(upload->fd);
    unlink(path);
    blobs->bytes -= (int64_t)upload->received;
    free(upload);
}

void blobs_close(struct blobs *blobs)
{
    if (!blobs) return;
    while (blobs->upload) drop_upload(blobs, blobs->upload);
    free(blobs);
}

void blobs_expire(struct blobs *blobs, double seconds)
{
    uint64_t now = loop_now_ns();
    for (struct upload *u = blobs->upload, *next; u; u = next) {
        next = u->next;
        if ((double)(now - u->used_ns) > seconds * 1e9) drop_upload(blobs, u);
    }
}

bool blobs_has(struct blobs *blobs, const char *hash)
{
    char path[4096];
    if (!relight_hash_valid(hash)) return false;
    blobs_path(blobs, hash, path, sizeof path);
    return !access(path, R_OK);
}

void blobs_set_name(struct blobs *blobs, const char *hash, const char *name)
{
    char path[4096 + 8];
    struct stat st;
    snprintf(path, sizeof path, "%s/%s.name", blobs->folder, hash);
    if (!name[0] || strlen(name) > 200 || strchr(name, '/') || !stat(path, &st)) return;
    FILE *file = fopen(path, "we");
    if (!file) return;
    fputs(name, file);
    fclose(file);
}

void blobs_name(const struct blobs *blobs, const char *hash, char *name, size_t n)
{
    char path[4096 + 8];
    snprintf(name, n, "%.12s…", hash);
    snprintf(path, sizeof path, "%s/%s.name", blobs->folder, hash);
    FILE *file = fopen(path, "re");
    if (!file) return;
    char text[256];
    if (fgets(text, sizeof text, file) && text[0]) snprintf(name, n, "%s", text);
    fclose(file);
}

uint64_t blobs_bytes(const struct blobs *blobs)
{
    return blobs->bytes > 0 ? (uint64_t)blobs->bytes : 0;
}

void blobs_charge(struct blobs *blobs, int64_t bytes)
{
    blobs->bytes += bytes;
}

// Drops the longest unused blobs, none that was used in the last ten minutes.
static void make_room(struct blobs *blobs, uint64_t wanted)
{
    enum { KEEP_S = 600 };
    while (blobs_bytes(blobs) + wanted > blobs->disk) {
        char oldest[BLOB_HASH + 1] = "";
        time_t when = time(NULL) - KEEP_S;
        off_t size = 0;
        DIR *dir = opendir(blobs->folder);
        for (struct dirent *d; dir && (d = readdir(dir));) {
            struct stat st;
            if (!relight_hash_valid(d->d_name) || fstatat(dirfd(dir), d->d_name, &st, 0) ||
                st.st_mtime >= when)
                continue;
            when = st.st_mtime;
            size = st.st_size;
            memcpy(oldest, d->d_name, BLOB_HASH + 1);
        }
        if (dir) closedir(dir);
        char path[4096], name[4096 + 8];
        if (!oldest[0]) return;
        blobs_path(blobs, oldest, path, sizeof path);
        snprintf(name, sizeof name, "%s.name", path);
        if (unlink(path)) return;
        unlink(name);
        blobs->bytes -= size;
    }
}

void blobs_touch(const struct blobs *blobs, const char *hash)
{
    char path[4096];
    blobs_path(blobs, hash, path, sizeof path);
    utimensat(AT_FDCWD, path, NULL, 0); // read-only stores keep their times
}

static struct upload *find_upload(struct blobs *blobs, const char *hash)
{
    struct upload *u = blobs->upload;
    while (u && strcmp(u->hash, hash)) u = u->next;
    return u;
}

static int begin_upload(struct blobs *blobs, const char *hash, uint64_t size,
                        struct upload **out, char error[256])
{
    if (blobs->n_upload >= MAX_UPLOADS) {
        snprintf(error, 256, "%d uploads are under way already", MAX_UPLOADS);
        return RELIGHT__ERROR_CODE__ERROR_BUSY;
    }
    make_room(blobs, size);
    if (blobs_bytes(blobs) + size > blobs->disk) {
        snprintf(error, 256, "the daemon's disk budget of %llu bytes is spent",
                 (unsigned long long)blobs->disk);
        return RELIGHT__ERROR_CODE__ERROR_LIMIT;
    }
    char path[4096];
    part_path(blobs, hash, path, sizeof path);
    int fd = open(path, O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
    struct upload *u = fd < 0 ? NULL : calloc(1, sizeof *u);
    if (!u) {
        snprintf(error, 256, "the upload cannot be stored: %s", strerror(errno));
        if (fd >= 0) close(fd);
        return RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    }
    *u = (struct upload){.next = blobs->upload, .size = size, .fd = fd};
    memcpy(u->hash, hash, BLOB_HASH);
    relight_sha256_init(&u->sha);
    blobs->upload = u;
    blobs->n_upload++;
    *out = u;
    return 0;
}

static int finish_upload(struct blobs *blobs, struct upload *u, char error[256])
{
    char hash[65], path[4096], part[4096];
    relight_sha256_hex(&u->sha, hash);
    if (strcmp(hash, u->hash)) {
        snprintf(error, 256, "the bytes have hash %.12s…, not the promised %.12s…", hash,
                 u->hash);
        drop_upload(blobs, u);
        return RELIGHT__ERROR_CODE__ERROR_HASH;
    }
    part_path(blobs, hash, part, sizeof part);
    blobs_path(blobs, hash, path, sizeof path);
    int64_t size = (int64_t)u->received;
    int err = rename(part, path) ? errno : 0;
    drop_upload(blobs, u);
    if (err) {
        snprintf(error, 256, "the upload cannot be stored: %s", strerror(err));
        return RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    }
    blobs->bytes += size;
    return 0;
}

int blobs_put(struct blobs *blobs, const char *hash, uint64_t size, uint64_t offset,
              const void *bytes, size_t n, uint64_t *received, bool *complete, char error[256])
{
    *received = 0;
    *complete = false;
    if (!relight_hash_valid(hash)) {
        snprintf(error, 256, "hash is not 64 lower-case hex digits");
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    if (blobs_has(blobs, hash)) {
        blobs_touch(blobs, hash); // who asks is about to use it
        *received = size;
        *complete = true;
        return 0;
    }
    if (!size || size > blobs->max_blob) {
        snprintf(error, 256, "size %llu is outside 1..%llu bytes", (unsigned long long)size,
                 (unsigned long long)blobs->max_blob);
        return size ? RELIGHT__ERROR_CODE__ERROR_LIMIT
                    : RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    struct upload *u = find_upload(blobs, hash);
    if (u) *received = u->received;
    if (!n) return 0;
    if (offset > *received) {
        snprintf(error, 256, "the chunk starts at %llu, past the %llu bytes that are there",
                 (unsigned long long)offset, (unsigned long long)*received);
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    if (offset > size || n > size - offset || (u && u->size != size)) {
        snprintf(error, 256, "the chunk reaches beyond the promised %llu bytes",
                 (unsigned long long)size);
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    uint64_t known = *received - offset; // an overlap is skipped
    if (known >= n) return 0;
    bytes = (const char *)bytes + known;
    n -= known;
    int code = u ? 0 : begin_upload(blobs, hash, size, &u, error);
    if (code) return code;
    for (size_t put = 0; put < n;) {
        ssize_t done = write(u->fd, (const char *)bytes + put, n - put);
        if (done < 0 && errno == EINTR) continue;
        if (done <= 0) {
            snprintf(error, 256, "the upload cannot be stored: %s", strerror(errno));
            drop_upload(blobs, u);
            return RELIGHT__ERROR_CODE__ERROR_LIMIT;
        }
        put += (size_t)done;
    }
    relight_sha256_add(&u->sha, bytes, n);
    u->received += n;
    u->used_ns = loop_now_ns();
    blobs->bytes += (int64_t)n;
    *received = u->received;
    if (u->received < size) return 0;
    code = finish_upload(blobs, u, error);
    *complete = !code;
    if (code) *received = 0;
    return code;
}

int blobs_hash_file(const char *path, char out[65])
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return -errno;
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    enum { PIECE = 1 << 20 };
    char *piece = malloc(PIECE);
    ssize_t n = piece ? 1 : -1;
    while (n > 0 && (n = read(fd, piece, PIECE)) > 0)
        relight_sha256_add(&sha, piece, (size_t)n);
    int err = n < 0 ? errno : 0;
    free(piece);
    close(fd);
    relight_sha256_hex(&sha, out);
    return -err;
}
