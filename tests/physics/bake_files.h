/* SPDX-License-Identifier: MIT */
/* bake_files.h owns what programs that test bakes share: a context with a pool, a folder for
 * their files, and comparisons of files by byte. One source of a program includes it. */
#ifndef PHYSICS_BAKE_FILES_H
#define PHYSICS_BAKE_FILES_H

#include "expect.h"
#include "prt/base.h"

#include <fcntl.h>
#include <stdbool.h>
#include <sys/stat.h>

static struct prt_context context;
static char folder[] = "/tmp/prt-bake-test-XXXXXX";

static inline void log_bake_errors(void *user, enum prt_log_level level, const char *line)
{
    if (level == PRT_LOG_ERROR) print_message("  %s\n", line);
}

/* Returns false where there is no memory or no room. */
static inline bool bake_files_begin(void)
{
    prt_context_init(&context);
    context.log = log_bake_errors;
    return !prt_pool_create(0, &context.pool) && mkdtemp(folder);
}

/* Removes the folder with all that is in it; a group teardown. */
static inline int bake_files_end(void **state)
{
    char command[300];
    (void)state;
    prt_pool_destroy(context.pool);
    snprintf(command, sizeof command, "rm -rf %s", folder);
    return system(command);
}

/* A path in the folder; valid until the next call but seven. */
static inline const char *file(const char *name)
{
    static char path[8][256];
    static unsigned next;
    char *out = path[next++ % 8];
    snprintf(out, sizeof path[0], "%s/%s", folder, name);
    return out;
}

static inline bool is_there(const char *path)
{
    return !access(path, F_OK);
}

static inline void same_bytes(const char *one, const char *other)
{
    struct prt_blob a, b;
    assert_int_equal(prt_read_file(&context, one, 1u << 30, &a), PRT_OK);
    assert_int_equal(prt_read_file(&context, other, 1u << 30, &b), PRT_OK);
    assert_int_equal(a.size, b.size);
    assert_memory_equal(a.bytes, b.bytes, a.size);
    prt_free(a.bytes), prt_free(b.bytes);
}

/* Inverts the byte at `at`; false: the file is not there, or shorter. */
static inline bool invert_byte(const char *path, off_t at)
{
    char byte;
    int fd = open(path, O_RDWR);
    bool ok = fd >= 0 && pread(fd, &byte, 1, at) == 1;
    byte = ok ? (char)~byte : 0;
    ok = ok && pwrite(fd, &byte, 1, at) == 1;
    if (fd >= 0) close(fd);
    return ok;
}

#endif
