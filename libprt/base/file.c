// SPDX-License-Identifier: MIT
// Reading whole files; writing files that appear whole or not at all.
#include "prt/base.h"

#include <errno.h>
#include <fcntl.h>
#include <libgen.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

int prt_read_fd(const struct prt_context *ctx, const char *name, int fd, uint64_t max_bytes,
                struct prt_blob *out)
{
    struct stat st;
    int status = PRT_OK;
    char *bytes = NULL;
    size_t have = 0;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) {
        status = prt_fail(ctx, PRT_IO, "%s: not a regular file", name);
    } else if ((uint64_t)st.st_size > max_bytes) {
        status = prt_fail(ctx, PRT_LIMIT, "%s: %lld bytes, the limit is %llu", name,
                          (long long)st.st_size, (unsigned long long)max_bytes);
    } else if (!st.st_size) {
        status = prt_fail(ctx, PRT_FORMAT, "%s: the file is empty", name);
    } else if (!(bytes = prt_alloc((size_t)st.st_size + 1, 1))) {
        status = prt_fail(ctx, PRT_NOMEM, "%s: no memory for %lld bytes", name,
                          (long long)st.st_size);
    }
    while (status == PRT_OK && have < (size_t)st.st_size) {
        ssize_t got = pread(fd, bytes + have, (size_t)st.st_size - have, (off_t)have);
        if (got > 0) have += (size_t)got;
        else if (got == 0 || errno != EINTR)
            status = prt_fail(ctx, PRT_IO, "%s: %s", name,
                              got ? strerror(errno) : "the file shrank while it was read");
    }
    if (status != PRT_OK) {
        prt_free(bytes);
        return status;
    }
    bytes[have] = 0;
    *out = (struct prt_blob){bytes, have};
    return PRT_OK;
}

int prt_read_file(const struct prt_context *ctx, const char *path, uint64_t max_bytes,
                  struct prt_blob *out)
{
    // A pipe would wait for a writer before it is seen that it is no regular file.
    int fd = open(path, O_RDONLY | O_CLOEXEC | O_NONBLOCK | O_NOCTTY);
    if (fd < 0) return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(errno));
    int status = prt_read_fd(ctx, path, fd, max_bytes, out);
    close(fd);
    return status;
}

static int write_all(int fd, const char *bytes, size_t n)
{
    while (n) {
        ssize_t put = write(fd, bytes, n < (1u << 30) ? n : (1u << 30));
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) return -1;
        bytes += put;
        n -= (size_t)put;
    }
    return 0;
}

// special: a device or pipe (/dev/stdout), which is written in place and not renamed.
struct prt_writer {
    const struct prt_context *ctx;
    int fd;
    bool special, bad;
    char path[PATH_MAX], temp[PATH_MAX];
};

int prt_writer_open(const struct prt_context *ctx, const char *path, struct prt_writer **out)
{
    struct stat st;
    struct prt_writer *w = calloc(1, sizeof *w);
    if (!w) return prt_fail(ctx, PRT_NOMEM, "%s: no memory to write it", path);
    w->ctx = ctx;
    if (snprintf(w->path, sizeof w->path, "%s", path) >= (int)sizeof w->path ||
        snprintf(w->temp, sizeof w->temp, "%s.tmp-%ld", path, (long)getpid()) >=
            (int)sizeof w->temp) {
        free(w);
        return prt_fail(ctx, PRT_IO, "%.80s...: the path is too long", path);
    }
    w->special = stat(path, &st) == 0 && !S_ISREG(st.st_mode);
    w->fd = w->special ? open(path, O_WRONLY | O_CLOEXEC)
                       : open(w->temp, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (w->fd < 0) {
        free(w);
        return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(errno));
    }
    *out = w;
    return PRT_OK;
}

int prt_writer_write(struct prt_writer *w, const void *bytes, size_t n)
{
    if (w->bad) return PRT_IO;
    if (!write_all(w->fd, bytes, n)) return PRT_OK;
    w->bad = true;
    return prt_fail(w->ctx, PRT_IO, "%s: %s", w->path, strerror(errno));
}

void prt_writer_abandon(struct prt_writer *w)
{
    if (!w) return;
    close(w->fd);
    if (!w->special) unlink(w->temp);
    free(w);
}

static void sync_folder(const char *path)
{
    char folder[PATH_MAX];
    snprintf(folder, sizeof folder, "%s", path);
    int fd = open(dirname(folder), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd < 0) return;
    (void)!fsync(fd);
    close(fd);
}

int prt_writer_finish(struct prt_writer *w)
{
    int status = w->bad ? PRT_IO : PRT_OK;
    if (!status && !w->special && (fsync(w->fd) || rename(w->temp, w->path)))
        status = prt_fail(w->ctx, PRT_IO, "%s: %s", w->path, strerror(errno));
    if (status) {
        prt_writer_abandon(w);
        return status;
    }
    if (close(w->fd) && w->special)
        status = prt_fail(w->ctx, PRT_IO, "%s: %s", w->path, strerror(errno));
    if (!w->special) sync_folder(w->path);
    free(w);
    return status;
}

int prt_write_file(const struct prt_context *ctx, const char *path, const void *bytes, size_t n)
{
    struct prt_writer *w;
    int status = prt_writer_open(ctx, path, &w);
    if (status) return status;
    if ((status = prt_writer_write(w, bytes, n))) {
        prt_writer_abandon(w);
        return status;
    }
    return prt_writer_finish(w);
}
