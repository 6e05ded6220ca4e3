/* SPDX-License-Identifier: MIT */
/* work.h owns the worker threads: relighting, rasterisation and encoding run there, never on
 * the loop. */
#ifndef RELIGHTD_WORK_H
#define RELIGHTD_WORK_H

#include "core/loop.h"
#include "prt/base.h"

enum work_class { WORK_INTERACTIVE, WORK_BACKGROUND, WORK_N_CLASS };

struct work_pool;

/* One job, embedded in its owner. `run` is called on a worker with a context whose pool
 * is shared by all workers; `done` on the loop's thread afterwards. The first error line the
 * library logs is kept in `error`. */
struct work {
    struct loop_message message;
    struct work *next;
    struct work_pool *pool;
    enum work_class class;
    uint64_t submitted_ns, started_ns, ended_ns; /* loop_now_ns() */
    int status;                                  /* enum prt_status, returned by run */
    char error[300];
    int (*run)(struct work *work, const struct prt_context *ctx);
    void (*done)(struct work *work);
};

int work_pool_create(struct loop *loop, unsigned n_thread, unsigned cpu,
                     struct work_pool **out);
/* Waits for running jobs; drops queued ones. */
void work_pool_destroy(struct work_pool *pool);
void work_submit(struct work_pool *pool, struct work *work);
/* A prt_log_fn whose user is a struct work: keeps the first error line. */
void work_keep_error(void *user, enum prt_log_level level, const char *line);
size_t work_waiting(struct work_pool *pool);
/* Submitted and not yet handed to `done`. Loop thread. */
bool work_busy(const struct work_pool *pool);

#endif
