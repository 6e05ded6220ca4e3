// SPDX-License-Identifier: MIT
// Memory that ends (or begins) at an unreadable page: a kernel that reads past it dies.
#ifndef PRT_TEST_GUARD_H
#define PRT_TEST_GUARD_H

#include <stdint.h>
#include <string.h>
#include <sys/mman.h>
#include <unistd.h>

struct guard {
    void *map;
    size_t size;
};

// n bytes whose last one is the last before the guard page, filled with 0xa5. `align` is kept.
static inline void *guard_alloc(struct guard *g, size_t n)
{
    size_t page = (size_t)sysconf(_SC_PAGESIZE), room = (n + page - 1) / page * page;
    g->size = room + 2 * page;
    g->map = mmap(NULL, g->size, PROT_READ | PROT_WRITE, MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (g->map == MAP_FAILED) return NULL;
    mprotect(g->map, page, PROT_NONE);
    mprotect((char *)g->map + page + room, page, PROT_NONE);
    memset((char *)g->map + page, 0xa5, room);
    return (char *)g->map + page + room - n;
}

static inline void *guard_copy(struct guard *g, const void *from, size_t n)
{
    void *p = guard_alloc(g, n);
    if (p && n) memcpy(p, from, n);
    return p;
}

static inline void guard_free(struct guard *g)
{
    if (g->map) munmap(g->map, g->size);
    g->map = NULL;
}

#endif
