/* SPDX-License-Identifier: MIT */
/* drain.h owns the estimate of how long an evaluation waits: the cost of those that are open,
 * and the measured speed at which such costs are worked off. A request that would be answered
 * after its deadline is refused at its arrival, and no work is done for it.
 *
 * The cost of an evaluation is the time that workers spend on it. It is known afterwards: an
 * open one counts with the running mean of its kind (same model, operation and size). The speed
 * is the cost of the evaluations that were answered in a second while several were open.
 *
 * A principal waits for its own evaluations, and for as much of each other principal's: they
 * share the workers evenly (core/fair_queue.h). Thread-safety: none; loop thread only. Times
 * are arguments: the caller's clock. */
#ifndef RELIGHTD_DRAIN_H
#define RELIGHTD_DRAIN_H

#include "core/fair_queue.h"

#include <stdbool.h>
#include <stdint.h>

enum {
    DRAIN_KINDS =
        256, /* places of the table of costs; kinds that share one replace each other */
    DRAIN_FLOWS = 64, /* principals with open evaluations; those beyond share the last place */
    DRAIN_NAME = 96,
};

/* The cost of open evaluations, and their number. */
struct drain_flow {
    char name[DRAIN_NAME];
    double cost_ns[WORK_N_CLASS];
    unsigned n_open;
};
struct drain {
    struct drain_flow flow[DRAIN_FLOWS];
    struct {
        uint64_t kind;
        double cost_ns; /* running mean; 0: not measured */
    } mean[DRAIN_KINDS];
    unsigned n_open;
    unsigned n_thread; /* workers: the speed is at most that */
    /* Since a while ago, with weights that fall: the time in which several were open, and the
       cost of what was answered in it. */
    double busy_ns, done_ns;
    uint64_t at_ns; /* up to which busy_ns counts */
};

/* One evaluation, embedded in its owner; zeroed at first. */
struct drain_item {
    struct drain_flow *flow; /* NULL: it is not counted */
    uint64_t kind;
    enum work_class class;
    double cost_ns; /* with which it counts */
};

void drain_init(struct drain *drain, unsigned n_thread);
/* The evaluation is open from now on, as `name`'s. */
void drain_begin(struct drain *drain, struct drain_item *item, const char *name, uint64_t kind,
                 enum work_class class, uint64_t now_ns);
/* It has ended. cost_ns: measured; below 0: it was not answered, and its cost is unknown. */
void drain_end(struct drain *drain, struct drain_item *item, double cost_ns, uint64_t now_ns);
/* Nanoseconds after which one that begins now will be answered; 0 where none is open. */
double drain_wait_ns(const struct drain *drain, const char *name, uint64_t kind,
                     enum work_class class);
/* 0: it will be answered by the deadline, which is left_ns away. Else milliseconds after which
 * one would be. A quarter of the time is kept for what the estimate does not know. */
uint32_t drain_retry_ms(const struct drain *drain, const char *name, uint64_t kind,
                        enum work_class class, double left_ns);

#endif
