// SPDX-License-Identifier: MIT
// Properties of the fair queue under random loads: shares of compute time, priorities, idleness
// and removal. Time is counted, not measured.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <cmocka.h>

#include <stdlib.h>
#include <string.h>

#include "core/fair_queue.h"

enum { MANY = 512 };
static struct fair_item pool[MANY];
static bool taken[MANY];
static uint64_t state = 88172645463325252u;

static uint64_t rnd(uint64_t n)
{
    state ^= state << 13, state ^= state >> 7, state ^= state << 17;
    return state % n;
}

static struct fair_item *add(struct fair_queue *q, const char *name, enum work_class class)
{
    size_t i = 0;
    while (i < MANY && taken[i]) i++;
    assert_true(i < MANY);
    taken[i] = true;
    pool[i] = (struct fair_item){.class = class};
    fair_push(q, fair_flow(q, name), &pool[i]);
    return &pool[i];
}

static void drop(const struct fair_item *item)
{
    taken[item - pool] = false;
}

// Keeps `depth` items of a flow waiting.
static void keep(struct fair_queue *q, const char *name, unsigned depth, enum work_class class)
{
    struct fair_flow *f = fair_flow(q, name);
    while (f->n_waiting < depth) add(q, name, class);
}

// Serves n items of two workers, greedy at cost a, modest at cost b; returns greedy's share.
static double share_of_greedy(uint64_t a, uint64_t b, unsigned depth_a, enum work_class class_a,
                              enum work_class class_b)
{
    struct fair_queue q = {0};
    uint64_t used[2] = {0, 0};
    struct fair_item *running[2] = {NULL, NULL};
    uint64_t ends[2] = {0, 0};
    for (int round = 0; round < 20000; round++) {
        keep(&q, "greedy", depth_a, class_a);
        keep(&q, "modest", 1, class_b);
        int w = ends[0] <= ends[1] ? 0 : 1;
        if (running[w]) {
            bool greedy = !strcmp(running[w]->flow->name, "greedy");
            uint64_t cost = greedy ? a : b;
            used[!greedy] += cost;
            fair_ended(&q, running[w], cost, NULL, 0);
            drop(running[w]);
        }
        running[w] = fair_pop(&q, false);
        assert_non_null(running[w]);
        ends[w] += !strcmp(running[w]->flow->name, "greedy") ? a : b;
    }
    fair_finish(&q);
    memset(taken, 0, sizeof taken);
    return (double)used[0] / (double)(used[0] + used[1]);
}

static void equal_shares(void **data)
{
    static const uint64_t cost[][2] = {{1, 1}, {10, 1}, {1, 10}, {3, 7}, {100, 1}};
    for (size_t i = 0; i < sizeof cost / sizeof *cost; i++)
        for (unsigned depth = 1; depth <= 200; depth += 199) {
            double s = share_of_greedy(cost[i][0] * 1000000, cost[i][1] * 1000000, depth,
                                       WORK_INTERACTIVE, WORK_INTERACTIVE);
            // With one item waiting and one running, costs of 1 to 100 cannot be halved.
            bool enough = cost[i][1] >= cost[i][0] || depth > 1;
            if (enough) assert_true(s > 0.3 && s < 0.6);
        }
}

// A greedy interactive flow does not starve a modest one's stills or bulk work.
static void priorities_do_not_starve(void **data)
{
    for (int c = WORK_INTERACTIVE; c <= WORK_BACKGROUND; c++) {
        double s = share_of_greedy(5000000, 5000000, 200, WORK_INTERACTIVE, (enum work_class)c);
        assert_true(s < 0.6);
    }
}

// Within a flow priorities are strict; between idle flows a still waits for a hand.
static void priorities(void **data)
{
    struct fair_queue q = {0};
    struct fair_item *bulk = add(&q, "a", WORK_BACKGROUND), *still = add(&q, "a", WORK_STILL);
    struct fair_item *hand = add(&q, "a", WORK_INTERACTIVE);
    struct fair_item *other = add(&q, "b", WORK_STILL);
    struct fair_item *own = add(&q, "", WORK_BACKGROUND);
    assert_ptr_equal(fair_pop(&q, false), own);
    assert_ptr_equal(fair_pop(&q, true), hand);
    struct fair_item *next = fair_pop(&q, true);
    assert_true(next == still || next == other);
    next = fair_pop(&q, true);
    assert_true(next == still || next == other);
    assert_null(fair_pop(&q, true));
    assert_ptr_equal(fair_pop(&q, false), bulk);
    assert_null(fair_pop(&q, false));
    fair_finish(&q);
    memset(taken, 0, sizeof taken);
}

// Time that a flow was idle is neither saved up nor owed.
static void idleness_is_forgotten(void **data)
{
    struct fair_queue q = {0};
    struct fair_item *first = add(&q, "late", WORK_INTERACTIVE); // then it is idle
    assert_ptr_equal(fair_pop(&q, false), first);
    fair_ended(&q, first, 1000, NULL, 0);
    drop(first);
    for (int i = 0; i < 1000; i++) {
        add(&q, "busy", WORK_INTERACTIVE);
        struct fair_item *item = fair_pop(&q, false);
        fair_ended(&q, item, 1000000, NULL, 0);
        drop(item);
    }
    uint64_t used[2] = {0, 0};
    for (int i = 0; i < 1000; i++) {
        keep(&q, "busy", 3, WORK_INTERACTIVE);
        keep(&q, "late", 3, WORK_INTERACTIVE);
        struct fair_item *item = fair_pop(&q, false);
        used[!strcmp(item->flow->name, "late")] += 1;
        fair_ended(&q, item, 1000000, NULL, 0);
        drop(item);
    }
    assert_in_range(used[0], 450, 550);
    fair_finish(&q);
    memset(taken, 0, sizeof taken);
}

// Shared work is paid in equal parts.
static void shares_are_split(void **data)
{
    struct fair_queue q = {0};
    struct fair_flow *share[4];
    static const char *const name[] = {"a", "b", "c", "d"};
    for (int i = 0; i < 4; i++) share[i] = fair_flow(&q, name[i]);
    add(&q, "a", WORK_INTERACTIVE);
    struct fair_item *item = fair_pop(&q, false);
    fair_ended(&q, item, 4000, share, 4);
    for (int i = 0; i < 4; i++) assert_int_equal(share[i]->used_ns, 1000);
    fair_finish(&q);
    memset(taken, 0, sizeof taken);
}

// The cost of work aside is counted and does not change the virtual time of its flow.
static void aside_is_not_charged(void **data)
{
    struct fair_queue q = {0};
    add(&q, "a", WORK_ASIDE);
    assert_null(fair_pop(&q, false));
    struct fair_item *item = fair_pop_aside(&q);
    struct fair_flow *f = item->flow;
    fair_ended(&q, item, 5000, NULL, 0);
    assert_int_equal(f->used_ns, 5000);
    assert_int_equal(f->virtual_ns, 0);
    assert_int_equal(f->mean_ns, 0);
    fair_finish(&q);
    memset(taken, 0, sizeof taken);
}

// Random pushes, pops and removals: every item comes out once, counts stay right, no flow's
// virtual time goes back behind the one that was served.
static void random_operations(void **data)
{
    struct fair_queue q = {0};
    struct fair_item *waiting[MANY], *running[8];
    unsigned n = 0, n_running = 0;
    for (int round = 0; round < 200000; round++) {
        unsigned what = (unsigned)rnd(4);
        if (what == 0 && n < 300) {
            char name[8] = {(char)('a' + rnd(20)), 0};
            waiting[n++] = add(&q, rnd(16) ? name : "", (enum work_class)rnd(WORK_N_CLASS));
        } else if (what == 1 && n) {
            unsigned i = (unsigned)rnd(n);
            assert_true(fair_remove(&q, waiting[i]));
            assert_false(fair_remove(&q, waiting[i]));
            drop(waiting[i]);
            waiting[i] = waiting[--n];
        } else if (what == 2 && n_running < 8) {
            bool aside = !rnd(4);
            struct fair_item *item = aside ? fair_pop_aside(&q) : fair_pop(&q, rnd(2));
            assert_true(!item || aside == (item->class == WORK_ASIDE));
            unsigned i = 0;
            while (item && i < n && waiting[i] != item) i++;
            if (!item) continue;
            assert_true(i < n);
            waiting[i] = waiting[--n];
            running[n_running++] = item;
        } else if (what == 3 && n_running) {
            fair_ended(&q, running[--n_running], rnd(1000000), NULL, 0);
            drop(running[n_running]);
        }
        assert_int_equal(q.n_waiting, n);
    }
    while (n_running) fair_ended(&q, running[--n_running], 1, NULL, 0);
    while (fair_pop(&q, false) || fair_pop_aside(&q)) n--;
    assert_int_equal(n, 0);
    fair_finish(&q);
    memset(taken, 0, sizeof taken);
}

// While an item runs its flow is charged what its items took on average; when it ended, what it
// took: virtual time is the compute time used, so that costs that vary are paid once.
static void what_was_used_is_paid(void **unused)
{
    struct fair_queue q = {0};
    uint64_t used = 0;
    for (int i = 0; i < 50; i++) {
        struct fair_flow *f = fair_flow(&q, "anna");
        uint64_t cost = 1000 + rnd(100000);
        struct fair_item *item = add(&q, "anna", WORK_INTERACTIVE);
        assert_ptr_equal(fair_pop(&q, false), item);
        assert_int_equal(f->virtual_ns, used + f->mean_ns);
        fair_ended(&q, item, cost, NULL, 0);
        drop(item);
        used += cost;
        assert_int_equal(f->virtual_ns, used);
        assert_int_equal(f->used_ns, used);
    }
    fair_finish(&q);
}

// Of one flow and priority the work of what began first goes first: an evaluation's last step
// is not behind the first steps of later ones. Works that began together keep their order.
static void what_began_first_goes_first(void **data)
{
    struct fair_queue q = {0};
    struct fair_flow *f = fair_flow(&q, "anna");
    enum { N = 200 };
    for (size_t i = 0; i < N; i++) {
        pool[i] = (struct fair_item){.class = WORK_STILL, .begun_ns = 1 + rnd(40)};
        fair_push(&q, f, &pool[i]);
        if (i % 3 == 2) assert_true(fair_remove(&q, &pool[rnd(2) ? i : i - 1]));
    }
    const struct fair_item *last = NULL;
    for (struct fair_item *item; (item = fair_pop(&q, false)); last = item) {
        fair_ended(&q, item, 1, NULL, 0);
        assert_true(!last || item->begun_ns > last->begun_ns ||
                    (item->begun_ns == last->begun_ns && item > last));
    }
    fair_finish(&q);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(equal_shares),
        cmocka_unit_test(priorities_do_not_starve),
        cmocka_unit_test(priorities),
        cmocka_unit_test(idleness_is_forgotten),
        cmocka_unit_test(shares_are_split),
        cmocka_unit_test(aside_is_not_charged),
        cmocka_unit_test(random_operations),
        cmocka_unit_test(what_was_used_is_paid),
        cmocka_unit_test(what_began_first_goes_first),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
