// SPDX-License-Identifier: MIT
// core/drain.h against a simulated server: its clock and its workers are numbers here, so that
// nothing depends on the machine's time.
#include "core/drain.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <cmocka.h>

#include <stdio.h>
#include <string.h>

enum { MOST_OPEN = 4096, KIND = 7, OTHER_KIND = 8 };
static const double MS = 1e6;

struct open_one {
    struct drain_item item;
    const char *name;
    double deadline_ns, rest_ns, cost_ns;
};

// One worker that takes turns between the principals; of one principal the oldest goes first.
struct machine {
    struct drain drain;
    struct open_one one[MOST_OPEN];
    unsigned n;
    double now_ns;
    const char *last; // served
    unsigned answered, late, refused;
    unsigned answered_modest, refused_modest;
};

static bool is_modest(const char *name)
{
    return !strcmp(name, "modest");
}

// A request arrives, and is admitted or refused. Returns its retry_after_ms.
static uint32_t arrive(struct machine *m, const char *name, uint64_t kind, double cost_ns,
                       double deadline_ns)
{
    uint32_t retry_ms = drain_retry_ms(&m->drain, name, kind, WORK_INTERACTIVE, deadline_ns);
    if (retry_ms) {
        m->refused++;
        m->refused_modest += is_modest(name);
        return retry_ms;
    }
    assert_true(m->n < MOST_OPEN);
    struct open_one *o = &m->one[m->n++];
    *o = (struct open_one){.name = name,
                           .deadline_ns = m->now_ns + deadline_ns,
                           .rest_ns = cost_ns,
                           .cost_ns = cost_ns};
    drain_begin(&m->drain, &o->item, name, kind, WORK_INTERACTIVE, (uint64_t)m->now_ns);
    return 0;
}

static unsigned choose(const struct machine *m)
{
    for (unsigned i = 0; i < m->n; i++)
        if (!m->last || strcmp(m->one[i].name, m->last) != 0) return i;
    return 0;
}

// Works until this time.
static void work(struct machine *m, double until_ns)
{
    while (m->n && m->now_ns < until_ns) {
        unsigned i = choose(m);
        struct open_one *o = &m->one[i];
        double step = until_ns - m->now_ns;
        if (o->rest_ns > step) {
            o->rest_ns -= step;
            break;
        }
        m->now_ns += o->rest_ns;
        m->last = o->name;
        bool late = m->now_ns > o->deadline_ns;
        m->late += late;
        m->answered += !late;
        m->answered_modest += !late && is_modest(o->name);
        drain_end(&m->drain, &o->item, o->cost_ns, (uint64_t)m->now_ns);
        memmove(o, o + 1, (m->n - i - 1) * sizeof *o);
        m->n--;
    }
    if (m->now_ns < until_ns) m->now_ns = until_ns;
}

// Law: at twice the capacity nearly all of the capacity is answered in time, the rest is
// refused at once, and nothing that was admitted is late.
static void twice_the_capacity(void **state)
{
    static struct machine m;
    const double cost = 1 * MS, deadline = 250 * MS;
    enum { N = 40000 };
    memset(&m, 0, sizeof m);
    drain_init(&m.drain, 2);
    for (int i = 0; i < N; i++) {
        arrive(&m, "one", KIND, cost, deadline);
        work(&m, m.now_ns + cost / 2);
    }
    print_message("%u answered, %u refused, %u late\n", m.answered, m.refused, m.late);
    assert_true(m.answered > 0.95 * N / 2);
    assert_true(m.refused > 0.45 * N);
    assert_int_equal(m.late, 0);
    // A refusal names a time after which the request is admitted.
    uint32_t retry_ms;
    while (!(retry_ms = arrive(&m, "one", KIND, cost, deadline))) {
    }
    work(&m, m.now_ns + (retry_ms + 1) * MS);
    assert_int_equal(arrive(&m, "one", KIND, cost, deadline), 0);
    // Afterwards nothing is remembered of the crowd.
    work(&m, m.now_ns + 1000 * MS);
    assert_int_equal(m.n, 0);
    assert_int_equal(arrive(&m, "one", KIND, cost, 2 * MS), 0);
}

// Law: a principal is not refused for what others ask beyond their share.
static void beside_a_greedy_one(void **state)
{
    static struct machine m;
    const double cost = 1 * MS, deadline = 100 * MS;
    enum { N = 20000 };
    memset(&m, 0, sizeof m);
    drain_init(&m.drain, 2);
    for (int i = 0; i < N; i++) {
        for (int k = 0; k < 4; k++) arrive(&m, "greedy", KIND, cost, deadline);
        if (i % 4 == 0) arrive(&m, "modest", KIND, cost, deadline);
        work(&m, m.now_ns + cost);
    }
    print_message("modest: %u answered, %u refused; late %u\n", m.answered_modest,
                  m.refused_modest, m.late);
    assert_int_equal(m.refused_modest, 0);
    assert_true(m.answered_modest > N / 4 - 10);
    assert_int_equal(m.late, 0);
}

// Law: what goes behind a request does not refuse it, and costs are told apart by their kind.
static void kinds_and_classes(void **state)
{
    struct drain d;
    struct drain_item item[40];
    drain_init(&d, 1);
    for (int i = 0; i < 2; i++) { // the first of a kind is no measure
        drain_begin(&d, &item[0], "a", OTHER_KIND, WORK_BACKGROUND, 0);
        drain_end(&d, &item[0], i ? 3000 * MS : 9e6 * MS, 0);
        drain_begin(&d, &item[0], "a", KIND, WORK_INTERACTIVE, 0);
        drain_end(&d, &item[0], i ? 2 * MS : 9e6 * MS, 0);
    }
    for (int i = 0; i < 8; i++) drain_begin(&d, &item[i], "a", OTHER_KIND, WORK_BACKGROUND, 0);
    assert_int_equal(drain_retry_ms(&d, "a", KIND, WORK_INTERACTIVE, 100 * MS), 0);
    assert_true(drain_retry_ms(&d, "a", OTHER_KIND, WORK_BACKGROUND, 100 * MS) > 0);
    for (int i = 8; i < 40; i++) drain_begin(&d, &item[i], "a", KIND, WORK_INTERACTIVE, 0);
    // 32 of 2 ms wait, and itself.
    assert_true(drain_wait_ns(&d, "a", KIND, WORK_INTERACTIVE) == 66 * MS);
    assert_int_equal(drain_retry_ms(&d, "a", KIND, WORK_INTERACTIVE, 100 * MS), 0);
    assert_int_equal(drain_retry_ms(&d, "a", KIND, WORK_INTERACTIVE, 80 * MS), 6);
    for (int i = 0; i < 40; i++) drain_end(&d, &item[i], -1, 1);
    assert_true(drain_wait_ns(&d, "a", KIND, WORK_INTERACTIVE) == 0);
}

// More principals than there are places: the sums stay right.
static void many_principals(void **state)
{
    static struct drain d;
    static struct drain_item item[3 * DRAIN_FLOWS];
    char name[32];
    drain_init(&d, 2);
    for (int round = 0; round < 2; round++) {
        for (unsigned i = 0; i < 3 * DRAIN_FLOWS; i++) {
            snprintf(name, sizeof name, "addr:192.0.2.%u", i);
            drain_begin(&d, &item[i], name, KIND, WORK_STILL, i);
        }
        assert_int_equal(d.n_open, 3 * DRAIN_FLOWS);
        for (unsigned i = 0; i < 3 * DRAIN_FLOWS; i++) drain_end(&d, &item[i], 1 * MS, 1000);
        assert_int_equal(d.n_open, 0);
        assert_int_equal(drain_retry_ms(&d, name, KIND, WORK_STILL, 0), 0);
    }
}

// Law: the speed is measured while the workers are busy: an evaluation that was answered alone,
// whatever it cost, says nothing about it.
static void the_speed_is_that_of_busy_workers(void **state)
{
    struct drain d;
    struct drain_item item[8], alone;
    double now = 0;
    drain_init(&d, 2);
    for (int i = 0; i < 1000; i++) { // eight open at each time: two milliseconds of cost in two
        for (int k = 0; k < 8; k++)
            drain_begin(&d, &item[k], "a", KIND, WORK_STILL, (uint64_t)now);
        for (int k = 0; k < 5; k++) {
            now += 1 * MS;
            drain_end(&d, &item[k], 1 * MS, (uint64_t)now);
        }
        for (int k = 5; k < 8; k++) drain_end(&d, &item[k], -1, (uint64_t)now);
        drain_begin(&d, &alone, "b", OTHER_KIND, WORK_STILL, (uint64_t)now);
        drain_end(&d, &alone, 50 * MS, (uint64_t)now);
    }
    for (int k = 0; k < 8; k++) drain_begin(&d, &item[k], "a", KIND, WORK_STILL, (uint64_t)now);
    const double wait = drain_wait_ns(&d, "a", KIND, WORK_STILL);
    print_message("nine of 1 ms wait %.2f ms\n", wait / MS);
    assert_true(fabs(wait - 9 * MS) < 0.5 * MS);
}

// Law: the speed is that of about the last second: one that falls to a quarter is known after
// two.
static void the_speed_follows(void **state)
{
    struct drain d;
    struct drain_item item[8];
    double now = 0, wait[2];
    drain_init(&d, 4);
    for (int part = 0; part < 2; part++) { // four workers' cost a millisecond, then one's
        for (int i = 0; i < (part ? 2000 : 20000); i++) {
            for (int k = 0; k < 8; k++)
                drain_begin(&d, &item[k], "a", KIND, WORK_STILL, (uint64_t)now);
            now += 1 * MS;
            for (int k = 0; k < 8; k++)
                drain_end(&d, &item[k], k < (part ? 1 : 4) ? 1 * MS : -1, (uint64_t)now);
        }
        for (int k = 0; k < 8; k++)
            drain_begin(&d, &item[k], "a", KIND, WORK_STILL, (uint64_t)now);
        wait[part] = drain_wait_ns(&d, "a", KIND, WORK_STILL);
        for (int k = 0; k < 8; k++) drain_end(&d, &item[k], -1, (uint64_t)now);
    }
    print_message("nine of 1 ms wait %.2f ms, of slower workers %.2f ms\n", wait[0] / MS,
                  wait[1] / MS);
    assert_true(fabs(wait[0] - 9 * MS / 4) < 0.1 * MS);
    assert_true(wait[1] > 6 * MS && wait[1] <= 9 * MS);
}

// Law: all principals beyond the table share its last place: they wait for each other's work,
// and nothing behind the table is written.
static void principals_beyond_the_table(void **state)
{
    struct {
        struct drain drain;
        uint8_t behind[sizeof(struct drain_flow)];
    } m;
    static struct drain_item item[DRAIN_FLOWS + 8];
    char name[32];
    drain_init(&m.drain, 1);
    memset(m.behind, 0x5a, sizeof m.behind);
    for (int i = 0; i < 2; i++) { // the first of a kind is no measure
        drain_begin(&m.drain, &item[0], "a", KIND, WORK_STILL, 0);
        drain_end(&m.drain, &item[0], 1 * MS, 0);
    }
    for (unsigned i = 0; i < DRAIN_FLOWS + 8; i++) {
        snprintf(name, sizeof name, "addr:192.0.2.%u", i);
        drain_begin(&m.drain, &item[i], name, KIND, WORK_STILL, 0);
        assert_in_range(item[i].flow - m.drain.flow, 0, DRAIN_FLOWS - 1);
    }
    assert_int_equal(m.drain.flow[DRAIN_FLOWS - 1].n_open, 9);
    for (size_t i = 0; i < sizeof m.behind; i++) assert_int_equal(m.behind[i], 0x5a);
    // A newcomer waits for at most its own cost of each place.
    assert_true(drain_wait_ns(&m.drain, "b", KIND, WORK_STILL) == (DRAIN_FLOWS + 1) * MS);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(twice_the_capacity),
        cmocka_unit_test(beside_a_greedy_one),
        cmocka_unit_test(kinds_and_classes),
        cmocka_unit_test(many_principals),
        cmocka_unit_test(the_speed_is_that_of_busy_workers),
        cmocka_unit_test(the_speed_follows),
        cmocka_unit_test(principals_beyond_the_table),
    };
    return cmocka_run_group_tests_name("drain", tests, NULL, NULL);
}
