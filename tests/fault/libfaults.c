// SPDX-License-Identifier: MIT
// The n-th allocation, or the n-th call on a file, fails: see faults.h.
#include "faults.h"

#include <errno.h>
#include <fcntl.h>
#include <link.h>
#include <stdarg.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <sys/stat.h>
#include <sys/syscall.h>
#include <unistd.h>

extern void *__libc_malloc(size_t n);
extern void *__libc_calloc(size_t n, size_t size);
extern void *__libc_realloc(void *p, size_t n);
extern void *__libc_memalign(size_t align, size_t n);

static struct faults *faults;

// ---- the choice of calls that fail

enum { RANGES = 32 };
static struct {
    uintptr_t begin, end;
} ours[RANGES];
static unsigned n_ours;

// Code of the program and of the parsers beside it. libc's and OpenGL's own allocations are not
// the daemon's to handle.
static int note_object(struct dl_phdr_info *info, size_t size, void *user)
{
    bool program = !info->dlpi_name[0];
    if (!program && !strstr(info->dlpi_name, "libprotobuf-c") &&
        !strstr(info->dlpi_name, "libcjson"))
        return 0;
    for (int i = 0; i < info->dlpi_phnum && n_ours < RANGES; i++) {
        const ElfW(Phdr) *p = &info->dlpi_phdr[i];
        if (p->p_type != PT_LOAD || !(p->p_flags & PF_X)) continue;
        ours[n_ours].begin = info->dlpi_addr + p->p_vaddr;
        ours[n_ours++].end = info->dlpi_addr + p->p_vaddr + p->p_memsz;
    }
    return 0;
}

__attribute__((constructor)) static void begin(void)
{
    const char *path = getenv("FAULTS");
    int fd = path ? (int)syscall(SYS_openat, AT_FDCWD, path, O_RDWR | O_CLOEXEC) : -1;
    if (fd >= 0) {
        void *map = mmap(NULL, sizeof *faults, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
        close(fd);
        dl_iterate_phdr(note_object, NULL);
        faults = map == MAP_FAILED ? NULL : map;
    }
    unsetenv("LD_PRELOAD"); // children decode and bake undisturbed
}

static bool is_ours(const void *caller)
{
    for (unsigned i = 0; i < n_ours; i++)
        if ((uintptr_t)caller >= ours[i].begin && (uintptr_t)caller < ours[i].end) return true;
    return false;
}

static bool allocation_fails(const void *caller)
{
    if (!faults || !is_ours(caller)) return false;
    faults->n_allocation++;
    if (!faults->allocation || --faults->allocation) return false;
    faults->n_failed++;
    errno = ENOMEM;
    return true;
}

#define FAILS() allocation_fails(__builtin_return_address(0))

void *malloc(size_t n)
{
    return FAILS() ? NULL : __libc_malloc(n);
}

void *calloc(size_t n, size_t size)
{
    return FAILS() ? NULL : __libc_calloc(n, size);
}

void *realloc(void *p, size_t n)
{
    return FAILS() ? NULL : __libc_realloc(p, n);
}

void *aligned_alloc(size_t align, size_t n)
{
    return FAILS() ? NULL : __libc_memalign(align, n);
}

int posix_memalign(void **out, size_t align, size_t n)
{
    void *p = FAILS() ? NULL : __libc_memalign(align, n);
    if (p) *out = p;
    return p ? 0 : ENOMEM;
}

char *strndup(const char *s, size_t n)
{
    size_t m = strnlen(s, n);
    char *p = FAILS() ? NULL : __libc_malloc(m + 1);
    if (!p) return NULL;
    memcpy(p, s, m);
    p[m] = 0;
    return p;
}

char *strdup(const char *s)
{
    size_t n = strlen(s) + 1;
    char *p = FAILS() ? NULL : __libc_malloc(n);
    return p ? memcpy(p, s, n) : NULL;
}

// ---- files

static bool call_fails(int kind, const char *path)
{
    if (!faults || !(faults->kinds & kind) || !faults->folder[0] ||
        strncmp(path, faults->folder, strlen(faults->folder)) != 0)
        return false;
    faults->n_call++;
    if (!faults->call) return false;
    if (faults->call > 1) {
        faults->call--;
        return false;
    }
    if (!faults->lasting) faults->call = 0;
    faults->n_failed++;
    errno = faults->error;
    return true;
}

static bool fd_fails(int kind, int fd)
{
    char link[64], path[512];
    if (!faults || !(faults->kinds & kind)) return false;
    snprintf(link, sizeof link, "/proc/self/fd/%d", fd);
    ssize_t n = readlink(link, path, sizeof path - 1);
    if (n <= 0) return false;
    path[n] = 0;
    return call_fails(kind, path);
}

static int open_mode(int flags, va_list args)
{
    return flags & (O_CREAT | O_TMPFILE) ? va_arg(args, int) : 0;
}

static int do_open(int dir, const char *path, int flags, int mode)
{
    if (call_fails(FAULT_OPEN, path)) return -1;
    return (int)syscall(SYS_openat, dir, path, flags, mode);
}

#define OPEN(name)                                   \
    int name(const char *path, int flags, ...)       \
    {                                                \
        va_list args;                                \
        va_start(args, flags);                       \
        int mode = open_mode(flags, args);           \
        va_end(args);                                \
        return do_open(AT_FDCWD, path, flags, mode); \
    }
OPEN(open)
OPEN(open64)

#define OPENAT(name)                                    \
    int name(int dir, const char *path, int flags, ...) \
    {                                                   \
        va_list args;                                   \
        va_start(args, flags);                          \
        int mode = open_mode(flags, args);              \
        va_end(args);                                   \
        return do_open(dir, path, flags, mode);         \
    }
OPENAT(openat)
OPENAT(openat64)

// errno 0: a short write, which is no error.
static ssize_t shorten(size_t n)
{
    return errno ? -1 : (ssize_t)(n > 1 ? n / 2 : n);
}

ssize_t write(int fd, const void *bytes, size_t n)
{
    if (fd_fails(FAULT_WRITE, fd)) {
        ssize_t most = shorten(n);
        if (most < 0) return -1;
        n = (size_t)most;
    }
    return syscall(SYS_write, fd, bytes, n);
}

#define PWRITE(name)                                            \
    ssize_t name(int fd, const void *bytes, size_t n, off_t at) \
    {                                                           \
        if (fd_fails(FAULT_WRITE, fd)) {                        \
            ssize_t most = shorten(n);                          \
            if (most < 0) return -1;                            \
            n = (size_t)most;                                   \
        }                                                       \
        return syscall(SYS_pwrite64, fd, bytes, n, at);         \
    }
PWRITE(pwrite)
PWRITE(pwrite64)

int fsync(int fd)
{
    return fd_fails(FAULT_SYNC, fd) ? -1 : (int)syscall(SYS_fsync, fd);
}

int fdatasync(int fd)
{
    return fd_fails(FAULT_SYNC, fd) ? -1 : (int)syscall(SYS_fdatasync, fd);
}

int ftruncate(int fd, off_t n)
{
    return fd_fails(FAULT_SIZE, fd) ? -1 : (int)syscall(SYS_ftruncate, fd, n);
}

int rename(const char *from, const char *to)
{
    if (call_fails(FAULT_NAME, to)) return -1;
    return (int)syscall(SYS_renameat2, AT_FDCWD, from, AT_FDCWD, to, 0);
}

int link(const char *from, const char *to)
{
    if (call_fails(FAULT_NAME, to)) return -1;
    return (int)syscall(SYS_linkat, AT_FDCWD, from, AT_FDCWD, to, 0);
}

int mkdir(const char *path, mode_t mode)
{
    if (call_fails(FAULT_NAME, path)) return -1;
    return (int)syscall(SYS_mkdirat, AT_FDCWD, path, mode);
}
