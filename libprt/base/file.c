// SPDX-License-Identifier: MIT
// Whole files in and out.
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

int prt_read_file(const struct prt_context *ctx, const char *path, uint64_t max_bytes,
                  struct prt_blob *out)
{
    struct stat st;
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd < 0) return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(errno));
    int status = PRT_OK;
    char *bytes = NULL;
    size_t have = 0;
    if (fstat(fd, &st) || !S_ISREG(st.st_mode)) {
        status = prt_fail(ctx, PRT_IO, "%s: not a regular file", path);
    } else if ((uint64_t)st.st_size > max_bytes) {
        status = prt_fail(ctx, PRT_LIMIT, "%s: %lld bytes, the limit is %llu", path,
                          (long long)st.st_size, (unsigned long long)max_bytes);
    } else if (!st.st_size) {
        status = prt_fail(ctx, PRT_FORMAT, "%s: the file is empty", path);
    } else if (!(bytes = prt_alloc((size_t)st.st_size + 1, 1))) {
        status = prt_fail(ctx, PRT_NOMEM, "%s: no memory for %lld bytes", path,
                          (long long)st.st_size);
    }
    while (status == PRT_OK && have < (size_t)st.st_size) {
        ssize_t got = read(fd, bytes + have, (size_t)st.st_size - have);
        if (got > 0)
            have += (size_t)got;
        else if (got == 0 || errno != EINTR)
            status = prt_fail(ctx, PRT_IO, "%s: %s", path,
                              got ? strerror(errno) : "the file shrank while it was read");
    }
    close(fd);
    if (status != PRT_OK) {
        prt_free(bytes);
        return status;
    }
    bytes[have] = 0;
    *out = (struct prt_blob){bytes, have};
    return PRT_OK;
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

int prt_write_file(const struct prt_context *ctx, const char *path, const void *bytes, size_t n)
{
    char temp[PATH_MAX], folder[PATH_MAX];
    if (snprintf(temp, sizeof temp, "%s.tmp-%ld", path, (long)getpid()) >= (int)sizeof temp)
        return prt_fail(ctx, PRT_IO, "%s: the path is too long", path);
    // Devices and pipes (/dev/stdout) are written in place: there is nothing to rename.
    struct stat st;
    bool special = stat(path, &st) == 0 && !S_ISREG(st.st_mode);
    int fd = special ? open(path, O_WRONLY | O_CLOEXEC)
                     : open(temp, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC, 0666);
    if (fd < 0) return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(errno));
    bool bad = write_all(fd, bytes, n) || (!special && fsync(fd));
    int error = errno;
    bad |= close(fd) != 0;
    if (!bad && !special && rename(temp, path)) {
        bad = true;
        error = errno;
    }
    if (bad) {
        if (!special) unlink(temp);
        return prt_fail(ctx, PRT_IO, "%s: %s", path, strerror(error));
    }
    if (special) return PRT_OK;
    snprintf(folder, sizeof folder, "%s", path);
    fd = open(dirname(folder), O_RDONLY | O_DIRECTORY | O_CLOEXEC);
    if (fd >= 0) {
        (void)!fsync(fd);
        close(fd);
    }
    return PRT_OK;
}
