// SPDX-License-Identifier: MIT
// The event loop (server/core/loop.h): timers and messages come in order; a stopped timer and a
// removed watch are not called.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <sys/epoll.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/loop.h"

enum { N = 200 };

static struct loop *loop;
static unsigned n_fired;
static struct entry {
    struct loop_timer timer; // first
    bool set, fired;
} entry[N];
static uint64_t last_ns;

static void fire(struct loop_timer *timer)
{
    struct entry *e = (struct entry *)timer;
    assert_true(e->set && !e->fired && timer->at_ns >= last_ns &&
                timer->at_ns <= loop_now_ns());
    last_ns = timer->at_ns;
    e->fired = true;
    n_fired++;
}

// Timers fire once, none before its time, in the order of their times, however they were set,
// stopped and set anew; stopped ones do not.
static void timers_fire_in_order(void **state)
{
    unsigned n = 0;
    srand(7);
    const uint64_t now = loop_now_ns();
    for (int i = 0; i < 10 * N; i++) {
        struct entry *e = &entry[rand() % N];
        e->timer.fire = fire;
        e->set = rand() % 3;
        if (e->set) loop_timer_set(loop, &e->timer, now + 1000 * (uint64_t)(rand() % 20000));
        else loop_timer_stop(loop, &e->timer);
        assert_true(e->timer.armed == e->set);
    }
    for (int i = 0; i < N; i++) n += entry[i].set;
    assert_in_range(n, N / 3, N - 1);
    while (n_fired < n) loop_turn(loop, -1);
    for (int i = 0; i < N; i++) assert_true(entry[i].fired == entry[i].set);
}

static struct loop_watch two[2];
static int n_ready;

static void remove_the_other(struct loop_watch *watch, uint32_t events)
{
    n_ready++;
    loop_watch_remove(loop, &two[watch == &two[0]]);
}

// Of two descriptors that are ready at once, the one that the first's call removes is not
// called.
static void removed_watches_are_silent(void **state)
{
    int end[2][2];
    for (int i = 0; i < 2; i++) {
        assert_int_equal(pipe(end[i]), 0);
        assert_int_equal(write(end[i][1], "", 1), 1);
        two[i] = (struct loop_watch){end[i][0], remove_the_other};
        assert_int_equal(loop_watch_add(loop, &two[i], EPOLLIN), 0);
    }
    loop_turn(loop, -1);
    assert_int_equal(n_ready, 1);
    loop_turn(loop, -1); // the other is still watched
    assert_int_equal(n_ready, 2);
    for (int i = 0; i < 2; i++) {
        loop_watch_remove(loop, &two[i]);
        close(end[i][0]);
        close(end[i][1]);
    }
}

static struct loop_message message[3];
static unsigned n_message;

static void handle(struct loop_message *m)
{
    assert_ptr_equal(m, &message[n_message++ % 3]);
    if (n_message == 2) loop_post(loop, &message[0]); // while those of a turn are handled
}

// Messages come in the order in which they were posted; one that is posted meanwhile comes
// after.
static void messages_keep_their_order(void **state)
{
    for (int i = 0; i < 3; i++) {
        message[i].handle = handle;
        loop_post(loop, &message[i]);
    }
    while (n_message < 4) loop_turn(loop, -1);
    assert_int_equal(n_message, 4);
}

static int setup(void **state)
{
    return loop_create(&loop);
}

static int teardown(void **state)
{
    loop_destroy(loop);
    return 0;
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(timers_fire_in_order),
        cmocka_unit_test(removed_watches_are_silent),
        cmocka_unit_test(messages_keep_their_order),
    };
    return cmocka_run_group_tests(tests, setup, teardown);
}
