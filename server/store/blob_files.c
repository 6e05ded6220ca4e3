// SPDX-License-Identifier: MIT
// The store's file operations, on workers: parts, their promises, and the step from a part to a
// blob. A blob that has its final name was on disk as a whole before it got that name.
#include "store/blob_index.h"

#include <errno.h>
#include <fcntl.h>
#include <inttypes.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

typedef char file_path[PATH_MAX];

static void path_of(const char *folder, const char *name, const char *ending, file_path path)
{
    snprintf(path, PATH_MAX, "%s/%s%s", folder, name, ending);
}

bool blob_name_valid(const char *name)
{
    if (!name[0] || strlen(name) > BLOB_NAME) return false;
    for (const char *c = name; *c; c++)
        if ((unsigned char)*c < 32 || *c == 127 || *c == '/') return false;
    return true;
}

enum blob_format blob_format_of(const void *bytes, size_t n)
{
    if (n >= 4 && !memcmp(bytes, "DDS ", 4)) return BLOB_DDS;
    bool floats =
        (n >= 2 &&
         (!memcmp(bytes, "#?", 2) || !memcmp(bytes, "PF", 2) || !memcmp(bytes, "Pf", 2))) ||
        (n >= 4 &&
         (!memcmp(bytes, "\x76\x2f\x31\x01", 4) || !memcmp(bytes, "\x53\x80\xf6\x34", 4)));
    return floats ? BLOB_FLOATS : BLOB_OTHER;
}

// Adds a file's bytes to *sha.
static int hash_bytes(int fd, struct relight_sha256 *sha)
{
    enum { PIECE = 1 << 20 };
    char *piece = malloc(PIECE);
    if (!piece) return -ENOMEM;
    ssize_t n;
    while ((n = read(fd, piece, PIECE)) > 0 || (n < 0 && errno == EINTR))
        if (n > 0) relight_sha256_add(sha, piece, (size_t)n);
    int err = n < 0 ? -errno : 0;
    free(piece);
    return err;
}

int blobs_hash_file(const char *path, char out[65])
{
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return -errno;
    struct relight_sha256 sha;
    relight_sha256_init(&sha);
    int err = hash_bytes(fd, &sha);
    close(fd);
    relight_sha256_hex(&sha, out);
    return err;
}

int blob_promise_write(const char *folder, const char *stem, uint64_t size,
                       const char *principal)
{
    file_path path;
    path_of(folder, stem, ".upload", path);
    int fd = open(path, O_CREAT | O_TRUNC | O_WRONLY | O_CLOEXEC, 0600);
    if (fd < 0) return -errno;
    int err = dprintf(fd, "%" PRIu64 "\t%s\n", size, principal) < 0 ? -errno : 0;
    close(fd);
    return err;
}

int blob_promise_read(const char *folder, const char *stem, uint64_t *size, char principal[96])
{
    file_path path;
    path_of(folder, stem, ".upload", path);
    FILE *file = fopen(path, "re");
    if (!file) return -errno;
    int n = fscanf(file, "%" SCNu64 "\t%95[^\t\n]", size, principal);
    fclose(file);
    return n == 2 ? 0 : -EINVAL;
}

int blob_part_hash(const char *folder, const char *stem, uint64_t size,
                   struct relight_sha256 *sha, uint64_t *received)
{
    file_path path;
    path_of(folder, stem, ".part", path);
    relight_sha256_init(sha);
    *received = 0;
    int fd = open(path, O_RDWR | O_CLOEXEC);
    if (fd < 0) return errno == ENOENT ? 0 : -errno;
    int err = hash_bytes(fd, sha);
    if (!err && sha->size > size) {
        relight_sha256_init(sha);
        if (ftruncate(fd, 0)) err = -errno;
    }
    close(fd);
    if (!err) *received = sha->size;
    return err;
}

int blob_part_write(const char *folder, const char *stem, uint64_t offset, const void *bytes,
                    size_t n)
{
    file_path path;
    path_of(folder, stem, ".part", path);
    int fd = open(path, O_CREAT | O_WRONLY | O_CLOEXEC, 0600), err = 0;
    if (fd < 0) return -errno;
    for (size_t put = 0; put < n && !err;) {
        ssize_t done = pwrite(fd, (const char *)bytes + put, n - put, (off_t)(offset + put));
        if (done > 0) put += (size_t)done;
        else if (done == 0) err = -EIO;
        else if (errno != EINTR) err = -errno;
    }
    close(fd);
    return err;
}

static int sync_folder(const char *folder)
{
    int fd = open(folder, O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    int err = fd < 0 || fsync(fd) ? -errno : 0;
    if (fd >= 0) close(fd);
    return err;
}

// Everything of the part must be on disk before the name that vouches for it.
static int sync_part(const char *path, enum blob_format *format)
{
    char bytes[4];
    int fd = open(path, O_RDWR | O_CLOEXEC);
    if (fd < 0) return -errno;
    ssize_t n = pread(fd, bytes, sizeof bytes, 0);
    *format = blob_format_of(bytes, n > 0 ? (size_t)n : 0);
    int err = fsync(fd) ? -errno : 0;
    close(fd);
    return err;
}

int blob_part_finish(const char *folder, const char *stem, const char *hash,
                     const char *principal, const char *name, bool *first,
                     enum blob_format *format)
{
    file_path part, path;
    char owner[96 + BLOB_NAME + 2];
    *first = false;
    path_of(folder, stem, ".part", part);
    path_of(folder, hash, "", path);
    int err = sync_part(part, format);
    if (err) return err;
    // link, not rename: of two that finish at once the second must not replace the first.
    if (link(part, path)) {
        if (errno != EEXIST) return -errno;
    } else {
        *first = true;
        snprintf(owner, sizeof owner, "%s\t%s", principal, blob_name_valid(name) ? name : "");
        err = disk_owner_write(path, owner);
    }
    if (!err) err = sync_folder(folder);
    if (err && *first) {
        unlink(path);
        *first = false;
    }
    blob_part_remove(folder, stem);
    return err;
}

void blob_part_remove(const char *folder, const char *stem)
{
    file_path path;
    path_of(folder, stem, ".part", path);
    unlink(path);
    path_of(folder, stem, ".upload", path);
    unlink(path);
}
