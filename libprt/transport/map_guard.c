// SPDX-License-Identifier: MIT
// The handler of SIGBUS and the table of maps that it looks into.
#include "map_guard.h"

#include "prt/transport.h"

#include <errno.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

enum { FREE = 0, TAKEN = 1 }; // of `begin`: no address of a map

static struct watched {
    atomic_uintptr_t begin;
    atomic_size_t bytes;
    atomic_bool lost;
} watched[PRT_MOST_WATCHED];

static atomic_bool on;
static size_t page_bytes;
static struct sigaction before; // the disposition of faults elsewhere

static struct watched *map_of(uintptr_t address)
{
    for (int i = 0; i < PRT_MOST_WATCHED; i++) {
        const uintptr_t begin = atomic_load(&watched[i].begin);
        if (begin > TAKEN && address >= begin && address - begin < watched[i].bytes)
            return &watched[i];
    }
    return NULL;
}

// Puts a page of zeros where the fault was; the read is then done again. A fault elsewhere, or
// a signal that a program sent, is of the disposition before.
static void on_fault(int number, siginfo_t *info, void *context)
{
    const int error = errno;
    const uintptr_t address = (uintptr_t)info->si_addr;
    struct watched *w = info->si_code > 0 ? map_of(address) : NULL;
    void *page = (void *)(address - address % page_bytes);
    if (w && mmap(page, page_bytes, PROT_READ, MAP_PRIVATE | MAP_ANONYMOUS | MAP_FIXED, -1,
                  0) != MAP_FAILED) {
        atomic_store(&w->lost, true);
    } else {
        sigaction(number, &before, NULL);
        if (info->si_code <= 0) raise(number); // else the fault comes again
    }
    errno = error;
}

void prt_file_guard_maps(void)
{
    struct sigaction action = {.sa_sigaction = on_fault, .sa_flags = SA_SIGINFO}, now;
    page_bytes = (size_t)sysconf(_SC_PAGESIZE);
    sigemptyset(&action.sa_mask);
    if (sigaction(SIGBUS, NULL, &now)) return;
    if ((now.sa_flags & SA_SIGINFO) && now.sa_sigaction == on_fault) return;
    before = now;
    atomic_store(&on, !sigaction(SIGBUS, &action, NULL));
}

int prt_map_watch(const void *map, size_t bytes)
{
    if (!atomic_load(&on)) return -1;
    for (int i = 0; i < PRT_MOST_WATCHED; i++) {
        uintptr_t free_now = FREE;
        if (!atomic_compare_exchange_strong(&watched[i].begin, &free_now, TAKEN)) continue;
        atomic_store(&watched[i].bytes, bytes);
        atomic_store(&watched[i].lost, false);
        atomic_store(&watched[i].begin, (uintptr_t)map);
        return i;
    }
    return -1;
}

bool prt_map_lost(int number)
{
    return number >= 0 && atomic_load(&watched[number].lost);
}

void prt_map_unwatch(int number)
{
    if (number >= 0) atomic_store(&watched[number].begin, FREE);
}
