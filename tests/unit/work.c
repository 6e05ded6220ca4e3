// SPDX-License-Identifier: MIT
// The worker threads: which classes of work keep which others waiting.
#include <semaphore.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <sys/resource.h>
#include <unistd.h>

#include <cmocka.h>

#include "core/work.h"

struct held {
    struct work work;
    sem_t go;
    bool done, had_pool;
    int nice;
};

static int run_held(struct work *work, const struct prt_context *ctx)
{
    struct held *h = (struct held *)work;
    h->had_pool = ctx->pool != NULL;
    h->nice = getpriority(PRIO_PROCESS, (id_t)gettid());
    while (sem_wait(&h->go)) continue;
    return PRT_OK;
}

static void held_done(struct work *work)
{
    ((struct held *)work)->done = true;
}

static void submit(struct work_pool *pool, struct held *h, enum work_class class, bool may_go)
{
    *h = (struct held){.work = {.run = run_held, .done = held_done, .class = class}};
    assert_int_equal(sem_init(&h->go, 0, may_go), 0);
    work_submit(pool, &h->work);
}

// At most twenty seconds.
static bool wait_for(struct loop *loop, const struct held *h)
{
    for (int i = 0; i < 2000 && !h->done; i++) loop_turn(loop, 10);
    return h->done;
}

// Work aside keeps its own thread of lower priority: with two workers background work goes on,
// on both more urgent work. What waits for that thread can be withdrawn.
static void aside_delays_nothing(void **state)
{
    struct loop *loop;
    struct work_pool *pool;
    struct held aside, next, bulk, hand[2];
    assert_int_equal(loop_create(&loop), 0);
    assert_int_equal(work_pool_create(loop, 2, 0, &pool), 0);
    struct work_actor before = work_act_for(pool, "ann", WORK_INTERACTIVE);
    submit(pool, &aside, WORK_ASIDE, false);
    submit(pool, &next, WORK_ASIDE, false);
    submit(pool, &bulk, WORK_BACKGROUND, true);
    assert_true(wait_for(loop, &bulk));
    assert_true(bulk.had_pool && bulk.nice == getpriority(PRIO_PROCESS, 0));
    submit(pool, &hand[0], WORK_INTERACTIVE, false);
    submit(pool, &hand[1], WORK_INTERACTIVE, true);
    assert_true(wait_for(loop, &hand[1]));
    sem_post(&hand[0].go);
    assert_true(wait_for(loop, &hand[0]));
    assert_false(aside.done);
    assert_true(work_withdraw(&next.work));
    sem_post(&aside.go);
    assert_true(wait_for(loop, &aside));
    const int lower = bulk.nice + 10 < 19 ? bulk.nice + 10 : 19;
    assert_true(!aside.had_pool && aside.nice == lower);
    assert_false(next.done || work_busy(pool));
    submit(pool, &next, WORK_ASIDE, true);
    assert_true(wait_for(loop, &next));
    work_act(pool, before);
    work_pool_destroy(pool);
    loop_destroy(loop);
}

// One background piece runs at a time on two workers: the other stays free for a hand.
static void background_leaves_a_worker(void **state)
{
    struct loop *loop;
    struct work_pool *pool;
    struct held bulk[2], hand;
    assert_int_equal(loop_create(&loop), 0);
    assert_int_equal(work_pool_create(loop, 2, 0, &pool), 0);
    submit(pool, &bulk[0], WORK_BACKGROUND, false);
    submit(pool, &bulk[1], WORK_BACKGROUND, true);
    submit(pool, &hand, WORK_INTERACTIVE, true);
    assert_true(wait_for(loop, &hand));
    assert_false(bulk[1].done);
    sem_post(&bulk[0].go);
    assert_true(wait_for(loop, &bulk[0]) && wait_for(loop, &bulk[1]));
    work_pool_destroy(pool);
    loop_destroy(loop);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(aside_delays_nothing),
        cmocka_unit_test(background_leaves_a_worker),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
