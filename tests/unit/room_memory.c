// SPDX-License-Identifier: MIT
// What a state is said to take of memory is what malloc gives for it, and no event adds more
// than it is charged for.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>
#include <malloc.h>

#include "room_actions.h"
#include "rooms/state.h"

enum { ROUNDS = 20, EVENTS = 300 };

static Relight__RoomState *begin(struct rnd *r)
{
    struct room_act a;
    struct room_evt e;
    char error[ROOM_ERROR];
    Relight__RoomState *state = room_state_new("0123456789abcdef0123456789abcdef");
    act_start(&a, r);
    evt_make(&e, &a.action, 0, 3, 1, 1000);
    assert_int_equal(room_fold(state, &e.event, error), 0);
    return state;
}

// The same events for a seed each time.
static void act(Relight__RoomState *state, struct rnd *r)
{
    struct room_act a;
    struct room_evt e;
    char error[ROOM_ERROR];
    act_random(&a, r, state->sequence);
    evt_make(&e, &a.action, rnd(r, 4), 3, state->sequence + 1,
             state->changed_us + rnd(r, 2000000));
    size_t before = message_memory(state), most = event_memory(state, &e.event);
    room_fold(state, &e.event, error);
    size_t after = message_memory(state);
    if (after > before + most) fail_msg("%zu more, at most %zu", after - before, most);
}

static void no_event_adds_more(void **unused)
{
    for (uint64_t seed = 0; seed < ROUNDS; seed++) {
        struct rnd r;
        rnd_seed(&r, seed);
        Relight__RoomState *state = begin(&r);
        for (int i = 0; i < EVENTS; i++) act(state, &r);
        room_state_free(state);
    }
}

static void memory_is_mallocs(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 7);
    Relight__RoomState *state = begin(&r);
    for (int i = 0; i < 20 * EVENTS; i++) act(state, &r);
    size_t before = mallinfo2().uordblks;
    Relight__RoomState *copy = message_copy(state);
    size_t taken = mallinfo2().uordblks - before, said = message_memory(copy);
    room_state_free(copy);
    room_state_free(state);
    if (!taken) skip(); // another allocator
    print_message("%zu bytes, said to be %zu\n", taken, said);
    assert_in_range(said, taken - taken / 20, taken + taken / 20);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(no_event_adds_more),
        cmocka_unit_test(memory_is_mallocs),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
