// SPDX-License-Identifier: MIT
// Events of a review room, as they would stand in a damaged log or come from another replica:
// each is refused and changes nothing, or accepted by every replica alike.
#include <assert.h>
#include <stdlib.h>
#include <string.h>

#include "../unit/room_actions.h"
#include "rooms/fold.h"
#include "rooms/state.h"

int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n);

static void fold_both(Relight__RoomState *live, Relight__RoomState **replica,
                      Relight__RoomEvent *event, bool snapshot)
{
    char error[ROOM_ERROR] = "", before[65], after[65];
    assert(room_state_hash(live, before));
    int code = room_fold(live, event, error);
    assert(room_state_hash(live, after));
    assert(!code == (strcmp(before, after) != 0) && !code == !error[0]);
    assert(room_fold(*replica, event, error) == code);
    if (snapshot) {
        Relight__RoomState *copy = message_copy(*replica);
        room_state_free(*replica);
        *replica = copy;
    }
    assert(room_state_hash(*replica, before) && !strcmp(before, after));
}

// Two bytes of length, then an event; the room's next number and a role that may act are put
// in.
int LLVMFuzzerTestOneInput(const uint8_t *bytes, size_t n)
{
    struct rnd r;
    struct room_act a;
    struct room_evt e;
    Relight__RoomState *live = room_state_new("0123456789abcdef0123456789abcdef"), *replica;
    rnd_seed(&r, n);
    replica = message_copy(live);
    act_start(&a, &r);
    evt_make(&e, &a.action, 0, 3, 1, 1);
    fold_both(live, &replica, &e.event, false);
    while (n >= 2) {
        size_t size = bytes[0] | (size_t)bytes[1] << 8;
        bytes += 2;
        n -= 2;
        if (size > n) size = n;
        Relight__RoomEvent *event = relight__room_event__unpack(NULL, size, bytes);
        bytes += size;
        n -= size;
        if (!event) continue;
        if (event->stamp && (size & 3)) event->stamp->sequence = live->sequence + 1;
        if (size & 1) event->role = RELIGHT__ROOM_ROLE__ROLE_OWNER;
        fold_both(live, &replica, event, size & 16);
        relight__room_event__free_unpacked(event, NULL);
    }
    room_state_free(live);
    room_state_free(replica);
    return 0;
}
