// SPDX-License-Identifier: MIT
// The memory a bake may take. RLIMIT_DATA cannot hold it to that: OpenBLAS tries an mmap that
// failed again and again, so a bake that meets the limit hangs, and buffers that are reserved
// and never touched count. A thread looks at the memory in use instead. It has the bake
// cancelled, which removes what is half written; when that takes too long it ends the process.
#include "tool.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

enum { LOOK_MS = 10, PATIENCE_MS = 3000 };
static const uint64_t openblas_takes = UINT64_C(160) << 20; // its buffer of a thread, and more

enum over { WITHIN, ABOVE_LIMIT, ABOVE_DATA };
static struct {
    const struct tool *tool;
    uint64_t limit;  // of memory in use; 0: none
    uint64_t data;   // RLIMIT_DATA; 0: none
    atomic_int over; // enum over
    atomic_bool done;
} watch;

struct usage {
    uint64_t own, data; // pages in use that are not a file's; writable private address space
};

static struct usage look(void)
{
    unsigned long long total, resident, shared, text, library, data;
    uint64_t page = (uint64_t)sysconf(_SC_PAGESIZE);
    FILE *f = fopen("/proc/self/statm", "re");
    if (!f) return (struct usage){0, 0};
    int n = fscanf(f, "%llu %llu %llu %llu %llu %llu", &total, &resident, &shared, &text,
                   &library, &data);
    fclose(f);
    if (n != 6) return (struct usage){0, 0};
    return (struct usage){(resident - shared) * page, data * page};
}

static enum over judge(struct usage usage)
{
    if (watch.limit && usage.own > watch.limit) return ABOVE_LIMIT;
    return watch.data && usage.data + openblas_takes > watch.data ? ABOVE_DATA : WITHIN;
}

static void explain(enum over over)
{
    if (over == ABOVE_LIMIT)
        prt_log(&watch.tool->ctx, PRT_LOG_ERROR,
                "out of memory: this bake needs more than the %llu MB it may take (prt's "
                "--memory, relightd's --bake-memory); ask for fewer samples or a smaller cube",
                (unsigned long long)(watch.limit >> 20));
    else
        prt_log(&watch.tool->ctx, PRT_LOG_ERROR,
                "out of memory: this bake needs more than the %llu MB of data this process may "
                "have (ulimit -d); raise that, or bound the bake by --memory instead",
                (unsigned long long)(watch.data >> 20));
}

static void *watch_main(void *arg)
{
    const struct timespec pause = {0, LOOK_MS * 1000000};
    unsigned waited_ms = 0;
    while (!atomic_load(&watch.done)) {
        struct usage usage = look();
        enum over over = atomic_load(&watch.over);
        if (!over) {
            over = judge(usage);
            atomic_store(&watch.over, over);
        } else if ((waited_ms += LOOK_MS) > PATIENCE_MS ||
                   (over == ABOVE_LIMIT && usage.own > watch.limit + watch.limit / 8)) {
            explain(over);
            _exit(EXIT_FAILED);
        }
        nanosleep(&pause, NULL);
    }
    return NULL;
}

bool memory_is_over(void)
{
    return atomic_load(&watch.over) != WITHIN;
}

int memory_watch(struct tool *tool, uint64_t bytes)
{
    struct rlimit data;
    pthread_t thread;
    watch.tool = tool;
    watch.limit = bytes;
    if (!getrlimit(RLIMIT_DATA, &data) && data.rlim_cur != RLIM_INFINITY)
        watch.data = data.rlim_cur;
    if (!watch.limit && !watch.data) return EXIT_DONE;
    enum over over = judge(look());
    if (over) {
        explain(over);
        return EXIT_FAILED;
    }
    int error = pthread_create(&thread, NULL, watch_main, NULL);
    if (error)
        return tool_exit(tool, prt_fail(&tool->ctx, PRT_NOMEM,
                                        "the thread that watches the memory of the bake "
                                        "cannot be started"));
    pthread_detach(thread);
    return EXIT_DONE;
}

int memory_watch_end(int status)
{
    atomic_store(&watch.done, true);
    if (status != PRT_CANCELLED || !memory_is_over()) return tool_exit(watch.tool, status);
    explain((enum over)atomic_load(&watch.over));
    return EXIT_FAILED;
}
