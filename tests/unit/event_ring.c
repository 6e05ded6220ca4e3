// SPDX-License-Identifier: MIT
// The ring of events: a reader gets each kept event once, and learns when one was lost.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "core/events.h"
#include "relight.pb-c.h"

enum { KEPT = 8 };

static void publish(struct events *events, int kind, const char *model, const char *job)
{
    struct event e = {.kind = kind};
    snprintf(e.model, sizeof e.model, "%s", model);
    snprintf(e.job, sizeof e.job, "%s", job);
    events_publish(events, &e);
}

static void publish_many(struct events *events, unsigned n)
{
    for (unsigned i = 0; i < n; i++)
        publish(events, RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED, "m", "");
}

// Reads all after `at`, and checks that none of the kept ones is left out.
static void reads(const struct events *events, uint64_t at, uint64_t first, bool is_lost)
{
    bool lost = false;
    const struct event *e;
    for (uint64_t next = first; next <= events_newest(events); next++) {
        assert_non_null(e = events_next(events, &at, &lost));
        assert_int_equal(e->sequence, next);
        assert_int_equal(at, next);
        assert_int_equal(lost, is_lost);
    }
    assert_null(events_next(events, &at, &lost));
}

// The cursor of every age, before and after the ring is full.
static void each_kept_event_is_read_once(void **unused)
{
    struct events *events;
    assert_int_equal(events_create(KEPT, &events), 0);
    reads(events, 0, 1, false);
    for (uint64_t n = 1; n <= 3 * KEPT; n++) {
        publish_many(events, 1);
        assert_int_equal(events_newest(events), n);
        const uint64_t oldest = n > KEPT ? n - KEPT + 1 : 1;
        for (uint64_t at = 0; at < n; at++)
            reads(events, at, at + 1 < oldest ? oldest : at + 1, at + 1 < oldest);
    }
    events_destroy(events);
}

static unsigned count(const struct events *events, int kind, const char *job)
{
    uint64_t at = 0;
    bool lost = false;
    unsigned n = 0;
    for (const struct event *e; (e = events_next(events, &at, &lost));)
        n += e->kind == kind && !strcmp(e->job, job);
    return n;
}

// Of each job and of each model the newest state is kept; of other kinds every event.
static void the_newest_state_is_kept(void **unused)
{
    const int job = RELIGHT__EVENT_KIND__EVENT_JOB,
              changed = RELIGHT__EVENT_KIND__EVENT_MODEL_CHANGED,
              added = RELIGHT__EVENT_KIND__EVENT_MODEL_ADDED;
    struct events *events;
    assert_int_equal(events_create(KEPT, &events), 0);
    for (int i = 0; i < 2; i++) {
        publish(events, job, "m", "one");
        publish(events, job, "m", "two");
        publish(events, changed, "m", "");
        publish(events, added, "m", "");
    }
    assert_int_equal(count(events, job, "one"), 1);
    assert_int_equal(count(events, job, "two"), 1);
    assert_int_equal(count(events, changed, ""), 1);
    assert_int_equal(count(events, added, ""), 2);
    events_destroy(events);
}

struct reader {
    struct events_reader reader; // first
    unsigned n;
};

static void woken(struct events_reader *reader)
{
    ((struct reader *)reader)->n++;
}

// Who leaves is not woken again, and those who stay are.
static void readers_are_woken(void **unused)
{
    struct events *events;
    struct reader r[3] = {{.n = 0}};
    assert_int_equal(events_create(KEPT, &events), 0);
    for (int i = 0; i < 3; i++) {
        r[i].reader.wake = woken;
        events_enter(events, &r[i].reader);
    }
    publish_many(events, 1);
    events_leave(events, &r[1].reader);
    events_leave(events, &r[1].reader); // once more does nothing
    publish_many(events, 1);
    assert_int_equal(r[0].n, 2);
    assert_int_equal(r[1].n, 1);
    assert_int_equal(r[2].n, 2);
    events_destroy(events);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(each_kept_event_is_read_once),
        cmocka_unit_test(the_newest_state_is_kept),
        cmocka_unit_test(readers_are_woken),
    };
    return cmocka_run_group_tests_name("event ring", tests, NULL, NULL);
}
