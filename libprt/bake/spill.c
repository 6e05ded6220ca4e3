// SPDX-License-Identifier: MIT
// Rows of factored clusters in a temporary file that is mapped whole.
#include "bake/spill.h"

#include <errno.h>
#include <fcntl.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

struct spill {
    int fd;
    char *map;
    uint64_t bytes;
    atomic_uint_fast64_t used;
};

enum { PAGE = 65536 }; // arrays begin at multiples of it, on machines of any page size

int prt_temporary_file(uint64_t bytes)
{
    const char *dir = getenv("TMPDIR");
    char path[512];
    snprintf(path, sizeof path, "%s/prt-bake-XXXXXX", dir && *dir ? dir : "/var/tmp");
    int fd = mkostemp(path, O_CLOEXEC);
    if (fd >= 0) unlink(path);
    if (fd >= 0 && ftruncate(fd, (off_t)bytes)) {
        close(fd);
        fd = -1;
    }
    return fd;
}

struct spill *prt_spill_create(const struct prt_context *ctx, uint64_t bytes)
{
    struct spill *s = calloc(1, sizeof *s);
    if (!s) return NULL;
    s->bytes = bytes;
    s->fd = prt_temporary_file(bytes);
    void *map = s->fd < 0 ? MAP_FAILED
                          : mmap(NULL, bytes, PROT_READ | PROT_WRITE,
                                 MAP_SHARED | MAP_NORESERVE, s->fd, 0);
    s->map = map == MAP_FAILED ? NULL : map;
    if (!s->map) {
        prt_log(ctx, PRT_LOG_WARNING,
                "no temporary file of %llu MB (TMPDIR): the bake takes them as memory",
                (unsigned long long)(bytes >> 20));
        prt_spill_destroy(s);
        return NULL;
    }
    prt_log(ctx, PRT_LOG_NOTE, "factored rows (up to %llu MB) are kept on disk",
            (unsigned long long)(bytes >> 20));
    return s;
}

void prt_spill_destroy(struct spill *s)
{
    if (!s) return;
    if (s->map) munmap(s->map, s->bytes);
    if (s->fd >= 0) close(s->fd);
    free(s);
}

// Writes by pwrite, which tells of a full disk where a mapped page would raise SIGBUS.
static void *move(struct spill *s, void *from, uint64_t bytes)
{
    const uint64_t room = (bytes + PAGE - 1) / PAGE * PAGE;
    const uint64_t at = atomic_fetch_add(&s->used, room);
    if (at + room > s->bytes) return NULL;
    for (uint64_t done = 0; done < bytes;) {
        ssize_t put = pwrite(s->fd, (char *)from + done, bytes - done, (off_t)(at + done));
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) return NULL;
        done += (uint64_t)put;
    }
    prt_free(from);
    return s->map + at;
}

static uint64_t bytes_of_rows(const struct factored *f, uint32_t n_function, uint32_t n_coef)
{
    return (uint64_t)f->rank * (f->n_component ? f->n_component : n_function) * n_coef *
           sizeof *f->b;
}

void prt_spill_factored(struct spill *s, struct factored *f, uint32_t n_function,
                        uint32_t n_coef)
{
    if (!s || !f->b || !f->rank || f->spilled_bytes) return;
    const uint64_t bytes = bytes_of_rows(f, n_function, n_coef);
    void *rows = move(s, f->b, bytes);
    if (!rows) return;
    f->b = rows;
    f->spilled_bytes = bytes;
}

void prt_spill_rest(const struct factored *f)
{
    if (f->spilled_bytes) madvise(f->b, f->spilled_bytes, MADV_DONTNEED); // the file has them
}

void prt_spill_clear(struct spill *s)
{
    if (!s) return;
    atomic_store(&s->used, 0);
    if (ftruncate(s->fd, 0) || ftruncate(s->fd, (off_t)s->bytes))
        atomic_store(&s->used, s->bytes);
}
