/* SPDX-License-Identifier: MIT */
/* fair_queue.h owns the order of work: start-time fair queueing over principals by the compute
 * time that they used (Goyal, Vin and Cheng 1996), and priorities.
 *
 * Each flow (a principal) has a virtual time: the thread-seconds that its work took. The
 * waiting flow that used least goes next. A flow that was idle starts at the virtual time of
 * the flow served last: nobody saves up time, and nobody pays for time when nobody else waited.
 * Costs are known afterwards: a flow is charged its mean cost in advance, and the difference
 * when the work has ended.
 *
 * A priority orders the work of one flow strictly, and in it the time at which the evaluation
 * began that the work is a part of. Between flows it is a head start in compute
 * time (fair_head_start_ns), so that a still never delays a hand that moves, and bulk work of a
 * modest flow is not starved by a greedy interactive one.
 * Thread-safety: none; the caller locks. */
#ifndef RELIGHTD_FAIR_QUEUE_H
#define RELIGHTD_FAIR_QUEUE_H

#include <stdbool.h>
#include <stdint.h>

/* WORK_ASIDE: long work that no request waits for. Only a thread of its own runs it. */
enum work_class { WORK_INTERACTIVE, WORK_STILL, WORK_BACKGROUND, WORK_ASIDE, WORK_N_CLASS };
extern const uint64_t fair_head_start_ns[WORK_N_CLASS];

struct fair_flow;
/* One piece of work, embedded in its owner. */
struct fair_item {
    struct fair_item *next;
    struct fair_flow *flow; /* NULL: it does not wait and does not run */
    enum work_class class;
    uint64_t begun_ns;   /* when what it is a part of began */
    uint64_t advance_ns; /* charged in advance */
    bool waits;
};
struct fair_flow {
    struct fair_flow *next;
    char name[96]; /* "": the daemon itself, always first and never charged */
    uint64_t virtual_ns, used_ns, mean_ns; /* used_ns: all that it was charged */
    unsigned n_waiting, n_running;
    struct fair_item *first[WORK_N_CLASS], **last[WORK_N_CLASS];
};
struct fair_queue {
    struct fair_flow *flow;
    uint64_t virtual_ns; /* of the flow served last */
    unsigned n_waiting, n_flow;
};

void fair_finish(struct fair_queue *queue); /* frees the flows; items are the callers' */
/* The flow of this name, made where there is none; idle ones are dropped when there are many.
 * NULL without memory. */
struct fair_flow *fair_flow(struct fair_queue *queue, const char *name);
/* Of a flow and priority the one that began first goes first: the last step of an evaluation is
 * not behind the first steps of those that came later. */
void fair_push(struct fair_queue *queue, struct fair_flow *flow, struct fair_item *item);
/* The item to run next, of every class but WORK_ASIDE; no_background: nor of that. NULL: none.
 */
struct fair_item *fair_pop(struct fair_queue *queue, bool no_background);
/* The item of WORK_ASIDE to run next. */
struct fair_item *fair_pop_aside(struct fair_queue *queue);
/* Takes an item out that waits; false: it does not wait (any more). */
bool fair_remove(struct fair_queue *queue, struct fair_item *item);
/* An item that was popped has ended after this many thread-nanoseconds. share[n]: the flows
 * that pay equal parts; NULL: its own pays all. The cost of WORK_ASIDE is counted in used_ns
 * and does not change virtual_ns: its thread takes little from other flows. */
void fair_ended(struct fair_queue *queue, struct fair_item *item, uint64_t cost_ns,
                struct fair_flow *const *share, unsigned n);

#endif
