// SPDX-License-Identifier: MIT
// Backlog by principal and class, divided by the measured speed.
#include "core/drain.h"

#include <math.h>
#include <stdio.h>
#include <string.h>

// Chosen, not measured.
enum { SEVERAL = 4 };                  // open ones from which on the workers are taken for busy
static const double WINDOW_NS = 5e8;   // busy time after which what was counted weighs half
static const double SLOWEST = 0.25;    // of one worker: an opening model is no measure of speed
static const double PART = 0.75;       // of the time to the deadline that may be planned with
static const double NEWEST = 1 / 16.0; // weight in a mean
static const uint32_t MOST_RETRY_MS = 10000;

void drain_init(struct drain *d, unsigned n_thread)
{
    *d = (struct drain){.n_thread = n_thread ? n_thread : 1};
}

static void count_busy(struct drain *d, uint64_t now_ns)
{
    if (d->n_open >= SEVERAL && now_ns > d->at_ns) d->busy_ns += (double)(now_ns - d->at_ns);
    d->at_ns = now_ns;
    if (d->busy_ns < 2 * WINDOW_NS) return;
    d->busy_ns /= 2;
    d->done_ns /= 2;
}

// Cost a nanosecond. Before it was measured: one worker's.
static double speed(const struct drain *d)
{
    if (d->busy_ns < WINDOW_NS / 8) return 1;
    return fmin(fmax(d->done_ns / d->busy_ns, SLOWEST), d->n_thread);
}

static double mean_ns(const struct drain *d, uint64_t kind)
{
    const unsigned i = (unsigned)(kind % DRAIN_KINDS);
    return d->mean[i].kind == kind ? d->mean[i].cost_ns : 0;
}

static void measure(struct drain *d, uint64_t kind, double cost_ns)
{
    const unsigned i = (unsigned)(kind % DRAIN_KINDS);
    double *mean = &d->mean[i].cost_ns;
    bool first = d->mean[i].kind != kind || !(*mean > 0);
    d->mean[i].kind = kind;
    *mean = first ? cost_ns : *mean + NEWEST * (cost_ns - *mean);
}

// Its index; DRAIN_FLOWS: it has nothing open.
static unsigned find(const struct drain *d, const char *name)
{
    unsigned i = 0;
    while (i < DRAIN_FLOWS && (!d->flow[i].n_open || strcmp(d->flow[i].name, name) != 0)) i++;
    return i;
}

static struct drain_flow *find_or_make(struct drain *d, const char *name)
{
    unsigned i = find(d, name);
    if (i < DRAIN_FLOWS) return &d->flow[i];
    for (i = 0; i < DRAIN_FLOWS - 1 && d->flow[i].n_open;) i++;
    if (!d->flow[i].n_open) snprintf(d->flow[i].name, DRAIN_NAME, "%s", name);
    return &d->flow[i];
}

void drain_begin(struct drain *d, struct drain_item *item, const char *name, uint64_t kind,
                 enum work_class class, uint64_t now_ns)
{
    count_busy(d, now_ns);
    struct drain_flow *f = find_or_make(d, name);
    *item = (struct drain_item){f, kind, class, mean_ns(d, kind)};
    f->cost_ns[class] += item->cost_ns;
    f->n_open++;
    d->n_open++;
}

void drain_end(struct drain *d, struct drain_item *item, double cost_ns, uint64_t now_ns)
{
    struct drain_flow *f = item->flow;
    if (!f) return;
    count_busy(d, now_ns);
    if (cost_ns >= 0) measure(d, item->kind, cost_ns);
    if (cost_ns >= 0 && d->n_open >= SEVERAL) d->done_ns += cost_ns;
    f->cost_ns[item->class] -= item->cost_ns;
    d->n_open--;
    if (!--f->n_open) memset(f->cost_ns, 0, sizeof f->cost_ns);
    item->flow = NULL;
}

// Of the classes that go before it, or with it.
static double backlog_ns(const struct drain_flow *f, enum work_class class)
{
    double sum = 0;
    for (int c = 0; c <= (int)class; c++) sum += f->cost_ns[c];
    return fmax(sum, 0);
}

double drain_wait_ns(const struct drain *d, const char *name, uint64_t kind,
                     enum work_class class)
{
    if (!d->n_open) return 0;
    const unsigned own = find(d, name);
    const double before = own < DRAIN_FLOWS ? backlog_ns(&d->flow[own], class) : 0;
    const double mine = before + mean_ns(d, kind);
    double all = mine;
    for (unsigned i = 0; i < DRAIN_FLOWS; i++)
        if (d->flow[i].n_open && i != own) all += fmin(backlog_ns(&d->flow[i], class), mine);
    return all / speed(d);
}

uint32_t drain_retry_ms(const struct drain *d, const char *name, uint64_t kind,
                        enum work_class class, double left_ns)
{
    const double over_ms = (drain_wait_ns(d, name, kind, class) - PART * left_ns) * 1e-6;
    if (over_ms <= 0) return 0;
    return over_ms < 1 ? 1 : over_ms > MOST_RETRY_MS ? MOST_RETRY_MS : (uint32_t)over_ms;
}
