/* SPDX-License-Identifier: MIT */
/* work.h owns the worker threads: relighting, rasterisation and encoding run there, never on
 * the loop. Work waits in a fair queue (fair_queue.h), in which its principal pays for the
 * thread-seconds that it took. */
#ifndef RELIGHTD_WORK_H
#define RELIGHTD_WORK_H

#include "core/fair_queue.h"
#include "core/loop.h"
#include "prt/base.h"

struct work_pool;
enum { WORK_NAME = 96, WORK_MAX_SHARE = 16 };

/* One job, embedded in its owner. `run` is called on a worker with a context whose pool
 * is shared by all workers; `done` on the loop's thread afterwards. The first error line the
 * library logs is kept in `error`. Background work never occupies every thread. WORK_ASIDE runs
 * alone, on one more thread of lower priority; its context has no pool. */
struct work {
    struct loop_message message;
    struct fair_item item;
    struct work_pool *pool;
    enum work_class class;          /* at least; that of work_act is the other bound */
    const char (*share)[WORK_NAME]; /* principals that pay equal parts; NULL: the one it was
                                     * submitted for. Kept by the owner until `done` */
    unsigned n_share;
    int unwanted; /* atomic; work_withdraw came too late: long loops of the library end */
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

/* For whom the loop acts: work that is submitted is this principal's (its name, "" for the
 * daemon), and not above this class. Restored by the same call with what it returned. Loop
 * thread. */
struct work_actor {
    char name[WORK_NAME];
    enum work_class class;
    uint64_t begun_ns; /* when the evaluation began that its work is a part of; 0: with it */
};
struct work_actor work_act_for(struct work_pool *pool, const char *name, enum work_class class);
struct work_actor work_act(struct work_pool *pool, struct work_actor actor);
/* The one that is set. */
struct work_actor work_actor(const struct work_pool *pool);

void work_submit(struct work_pool *pool, struct work *work);
/* Nobody wants its result any more. True: it was still queued, and is not; neither run nor done
 * will be called. False: it runs, or has run; `done` follows. Loop thread. */
bool work_withdraw(struct work *work);
/* The same, but work that runs already is not told. */
bool work_dequeue(struct work *work);
/* The same, of work that its owner changes and submits again: it does not count as withdrawn.
 */
bool work_take_back(struct work *work);
/* A prt_log_fn whose user is a struct work: keeps the first error line. */
void work_keep_error(void *user, enum prt_log_level level, const char *line);
size_t work_waiting(struct work_pool *pool);
/* Submitted and not yet handed to `done`. Loop thread. */
bool work_busy(const struct work_pool *pool);

/* Thread-nanoseconds of all work, of one principal's, and jobs that were withdrawn. */
struct work_counts {
    uint64_t all_ns, own_ns, withdrawn;
};
void work_count(struct work_pool *pool, const char *name, struct work_counts *out);

#endif
