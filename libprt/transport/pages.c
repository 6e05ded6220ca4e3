// SPDX-License-Identifier: MIT
// Pages of files that are read, and the spare ones of closed files.
#include "pages.h"

#include "prt/transport.h"

#include <pthread.h>
#include <stdint.h>
#include <sys/mman.h>
#include <unistd.h>

enum { HUGE_PAGE = 2 << 20, MOST_SPARE = 8 };

static struct {
    pthread_mutex_t lock;
    size_t most, held; // bytes
    unsigned n;
    struct {
        char *pages;
        size_t bytes;
    } spare[MOST_SPARE]; // the oldest first
} kept = {.lock = PTHREAD_MUTEX_INITIALIZER};

// A file's size in whole pages.
static size_t whole(size_t size)
{
    const size_t page = (size_t)sysconf(_SC_PAGESIZE);
    return (size + page - 1) / page * page;
}

// Pages of its own that begin where a huge page does.
static char *map_huge(size_t bytes)
{
    char *map = mmap(NULL, bytes + HUGE_PAGE, PROT_READ | PROT_WRITE,
                     MAP_PRIVATE | MAP_ANONYMOUS, -1, 0);
    if (map == MAP_FAILED) return NULL;
    const size_t before = (HUGE_PAGE - (uintptr_t)map % HUGE_PAGE) % HUGE_PAGE;
    if (before) munmap(map, before);
    if (before < HUGE_PAGE) munmap(map + before + bytes, HUGE_PAGE - before);
    (void)madvise(map + before, bytes, MADV_HUGEPAGE); // its failure changes speed only
    return map + before;
}

// Takes spare i off the list; its pages are the caller's.
static char *take_off(unsigned i)
{
    char *pages = kept.spare[i].pages;
    kept.held -= kept.spare[i].bytes;
    kept.n--;
    for (; i < kept.n; i++) kept.spare[i] = kept.spare[i + 1];
    return pages;
}

// Until so many bytes more are within the limit.
static void drop_oldest(size_t more)
{
    while (kept.n && (kept.n == MOST_SPARE || kept.held + more > kept.most)) {
        const size_t bytes = kept.spare[0].bytes;
        munmap(take_off(0), bytes);
    }
}

char *prt_pages_take(size_t size)
{
    const size_t bytes = whole(size);
    unsigned best = MOST_SPARE;
    char *pages = NULL;
    size_t found = 0;
    pthread_mutex_lock(&kept.lock);
    for (unsigned i = 0; i < kept.n; i++)
        if (kept.spare[i].bytes >= bytes &&
            (best == MOST_SPARE || kept.spare[i].bytes < kept.spare[best].bytes))
            best = i;
    if (best < MOST_SPARE) {
        found = kept.spare[best].bytes;
        pages = take_off(best);
    }
    pthread_mutex_unlock(&kept.lock);
    if (found > bytes) munmap(pages + bytes, found - bytes);
    return pages ? pages : map_huge(bytes);
}

void prt_pages_give(char *pages, size_t size)
{
    const size_t bytes = whole(size);
    if (!pages) return;
    pthread_mutex_lock(&kept.lock);
    const bool keep = bytes <= kept.most;
    if (keep) {
        drop_oldest(bytes);
        kept.spare[kept.n].pages = pages;
        kept.spare[kept.n++].bytes = bytes;
        kept.held += bytes;
    }
    pthread_mutex_unlock(&kept.lock);
    if (!keep) munmap(pages, bytes);
}

void prt_file_keep_pages(size_t most)
{
    pthread_mutex_lock(&kept.lock);
    kept.most = 0;
    drop_oldest(1);
    kept.most = most;
    pthread_mutex_unlock(&kept.lock);
}
