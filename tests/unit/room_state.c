// SPDX-License-Identifier: MIT
// Searches of a room's state, and its events as protobuf packs them (server/rooms/state.h).
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "rooms/fold.h"
#include "rooms/state.h"

enum { N = 5 };

// Revisions are found by number from 1 on, pins and decisions by the sequence of their event.
static void items_are_found(void **unused)
{
    for (uint32_t n = 0; n <= N; n++) {
        Relight__Revision revision[N], *revisions[N];
        Relight__Pin pin[N], *pins[N];
        Relight__Decision decision[N], *decisions[N];
        Relight__Stamp stamp[N];
        Relight__RoomState state = RELIGHT__ROOM_STATE__INIT;
        for (uint32_t i = 0; i < n; i++) {
            relight__stamp__init(&stamp[i]);
            relight__revision__init(revisions[i] = &revision[i]);
            relight__pin__init(pins[i] = &pin[i]);
            relight__decision__init(decisions[i] = &decision[i]);
            stamp[i].sequence = 3 * i + 2;
            pin[i].stamp = decision[i].stamp = &stamp[i];
        }
        state.n_revisions = state.n_pins = state.n_decisions = n;
        state.revisions = revisions, state.pins = pins, state.decisions = decisions;
        for (uint32_t k = 0; k < 3 * N + 3; k++) {
            const bool there = k % 3 == 2 && k / 3 < n;
            assert_ptr_equal(room_pin(&state, k), there ? pins[k / 3] : NULL);
            assert_ptr_equal(room_decision(&state, k), there ? decisions[k / 3] : NULL);
            assert_ptr_equal(room_revision(&state, k), k && k <= n ? revisions[k - 1] : NULL);
        }
    }
}

// An event of any length, in a list of two, has the bytes that protobuf packs.
static void events_have_their_length(void **unused)
{
    enum { MOST = 16500 };
    char *text = calloc(1, MOST + 1);
    uint8_t *event = malloc(MOST + 100), *whole = malloc(2 * MOST + 200),
            *own = malloc(2 * MOST + 200);
    assert_true(text && event && whole && own);
    for (size_t length = 1; length <= MOST; length += length == 300 ? 16000 : 1) {
        Relight__RoomEvent e = RELIGHT__ROOM_EVENT__INIT, *list[2] = {&e, &e};
        Relight__RoomEvents events = RELIGHT__ROOM_EVENTS__INIT;
        memset(text, 'x', length);
        e.client = text;
        events.n_events = 2, events.events = list;
        const size_t n = relight__room_event__pack(&e, event);
        const size_t want = relight__room_events__pack(&events, whole);
        const size_t first = events_put(own, event, n);
        assert_true(first <= events_room(n));
        assert_int_equal(first + events_put(own + first, event, n), want);
        assert_memory_equal(own, whole, want);
    }
    free(text);
    free(event);
    free(whole);
    free(own);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(items_are_found),
                                       cmocka_unit_test(events_have_their_length)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
