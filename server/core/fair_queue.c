// SPDX-License-Identifier: MIT
// Flows in a list: there are as many as clients with work, and the search is short against it.
#include "core/fair_queue.h"

#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MANY_FLOWS = 256 };
// Chosen, not measured: a still waits for one or two frames, bulk work for seconds of them.
const uint64_t fair_head_start_ns[WORK_N_CLASS] = {0, 50000000, 2000000000, 2000000000};

void fair_finish(struct fair_queue *q)
{
    for (struct fair_flow *f = q->flow, *next; f; f = next) {
        next = f->next;
        free(f);
    }
    *q = (struct fair_queue){0};
}

static void drop_idle(struct fair_queue *q)
{
    for (struct fair_flow **at = &q->flow; *at;) {
        struct fair_flow *f = *at;
        if (f->n_waiting || f->n_running || f->virtual_ns > q->virtual_ns) {
            at = &f->next;
            continue;
        }
        *at = f->next;
        q->n_flow--;
        free(f);
    }
}

struct fair_flow *fair_flow(struct fair_queue *q, const char *name)
{
    struct fair_flow *f = q->flow;
    while (f && strcmp(f->name, name)) f = f->next;
    if (f) return f;
    if (q->n_flow >= MANY_FLOWS) drop_idle(q);
    if (!(f = calloc(1, sizeof *f))) return NULL;
    snprintf(f->name, sizeof f->name, "%s", name);
    for (int c = 0; c < WORK_N_CLASS; c++) f->last[c] = &f->first[c];
    f->virtual_ns = q->virtual_ns;
    f->next = q->flow;
    q->flow = f;
    q->n_flow++;
    return f;
}

// Most begin after all that wait; of the others most are older than all.
static void insert(struct fair_flow *f, struct fair_item *item)
{
    struct fair_item **at = f->last[item->class];
    bool empty = at == &f->first[item->class];
    const struct fair_item *last =
        empty ? NULL
              : (const struct fair_item *)((char *)at - offsetof(struct fair_item, next));
    if (last && item->begun_ns < last->begun_ns) {
        at = &f->first[item->class];
        while ((*at)->begun_ns <= item->begun_ns) at = &(*at)->next;
    }
    item->next = *at;
    *at = item;
    if (!item->next) f->last[item->class] = &item->next;
}

void fair_push(struct fair_queue *q, struct fair_flow *f, struct fair_item *item)
{
    if (!f->n_waiting && !f->n_running && f->virtual_ns < q->virtual_ns)
        f->virtual_ns = q->virtual_ns;
    item->flow = f;
    item->waits = true;
    insert(f, item);
    f->n_waiting++;
    q->n_waiting++;
}

// Classes from `first` to before `end`.
static struct fair_item *best_of(const struct fair_flow *f, int first, int end)
{
    for (int c = first; c < end; c++)
        if (f->first[c]) return f->first[c];
    return NULL;
}

static uint64_t rank(const struct fair_flow *f, const struct fair_item *item)
{
    return f->name[0] ? f->virtual_ns + fair_head_start_ns[item->class] + 1 : 0;
}

bool fair_remove(struct fair_queue *q, struct fair_item *item)
{
    if (!item->waits) return false;
    struct fair_flow *f = item->flow;
    struct fair_item **at = &f->first[item->class];
    while (*at != item) at = &(*at)->next;
    *at = item->next;
    if (!*at) f->last[item->class] = at;
    item->waits = false;
    item->flow = NULL;
    f->n_waiting--;
    q->n_waiting--;
    return true;
}

static struct fair_item *pop(struct fair_queue *q, int first, int end)
{
    struct fair_item *best = NULL;
    for (struct fair_flow *f = q->flow; f; f = f->next) {
        struct fair_item *item = f->n_waiting ? best_of(f, first, end) : NULL;
        if (item && (!best || rank(f, item) < rank(best->flow, best))) best = item;
    }
    if (!best) return NULL;
    struct fair_flow *f = best->flow;
    fair_remove(q, best);
    best->flow = f;
    best->advance_ns = f->name[0] && first < WORK_ASIDE ? f->mean_ns : 0;
    f->n_running++;
    if (f->name[0] && first < WORK_ASIDE && f->virtual_ns > q->virtual_ns)
        q->virtual_ns = f->virtual_ns;
    f->virtual_ns += best->advance_ns;
    return best;
}

struct fair_item *fair_pop(struct fair_queue *q, bool no_background)
{
    return pop(q, WORK_INTERACTIVE, no_background ? WORK_BACKGROUND : WORK_ASIDE);
}

struct fair_item *fair_pop_aside(struct fair_queue *q)
{
    return pop(q, WORK_ASIDE, WORK_N_CLASS);
}

void fair_ended(struct fair_queue *q, struct fair_item *item, uint64_t cost_ns,
                struct fair_flow *const *share, unsigned n)
{
    struct fair_flow *own = item->flow;
    own->n_running--;
    own->virtual_ns -= item->advance_ns;
    item->flow = NULL;
    for (unsigned i = 0; i < (n ? n : 1); i++) {
        struct fair_flow *f = n ? share[i] : own;
        uint64_t part = cost_ns / (n ? n : 1);
        f->used_ns += part;
        if (!f->name[0] || item->class == WORK_ASIDE) continue;
        f->virtual_ns += part;
        f->mean_ns = f->mean_ns ? f->mean_ns - f->mean_ns / 8 + part / 8 : part;
    }
}
