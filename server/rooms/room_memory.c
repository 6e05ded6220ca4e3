// SPDX-License-Identifier: MIT
// What rooms in memory cost their owners. A state is counted when it is read; an event adds
// what it may at most add, and the state is counted again when that has become much.
#include "rooms/room_private.h"

#include "core/ledger.h"
#include "rooms/state.h"

#include <stdio.h>
#include <string.h>

enum { COUNT_AGAIN = 1 << 20 };

static uint64_t needed(const struct room *room)
{
    return room->memory.state + room->memory.since + (room->packed ? room->packed->n : 0) +
           (room->tail ? room->tail->bytes : 0) + (room->batch ? room->batch->n : 0) +
           (room->last_presence.packed ? room->last_presence.packed->n : 0);
}

void room_memory_update(struct room *room)
{
    struct room_memory *m = &room->memory;
    if (!room->state) m->state = m->since = 0;
    uint64_t now = needed(room), before = m->charged;
    if (now == before) return;
    struct principal *owner = ledger_principal(room->rooms->server->ledger, room->owner);
    if (!owner) return;
    if (now > before) ledger_force(owner, LEDGER_ROOM_MEMORY, now - before);
    else ledger_give(owner, LEDGER_ROOM_MEMORY, before - now);
    m->charged = now;
    principal_release(owner);
}

static void count(struct room *room)
{
    room->memory = (struct room_memory){.state = message_memory(room->state),
                                        .charged = room->memory.charged};
    room_memory_update(room);
}

// The one that was unused longest, of this owner (NULL: of any). False: there is none.
static bool evict(struct rooms *rooms, const char *owner)
{
    for (struct room *r = rooms->oldest_idle; r; r = r->newer_idle)
        if ((!owner || !strcmp(r->owner, owner)) && room_let_go(r)) return true;
    return false;
}

static bool take(const struct room *room, uint64_t bytes, char error[ROOM_ERROR])
{
    struct rooms *rooms = room->rooms;
    struct principal *owner = ledger_principal(rooms->server->ledger, room->owner);
    enum ledger_refusal refusal;
    if (!owner) {
        snprintf(error, ROOM_ERROR, "not enough memory");
        return false;
    }
    do refusal = ledger_take(owner, LEDGER_ROOM_MEMORY, bytes, error);
    while (refusal && evict(rooms, refusal == LEDGER_CLIENT_FULL ? room->owner : NULL));
    if (refusal == LEDGER_CLIENT_FULL)
        snprintf(error, ROOM_ERROR,
                 "rooms of %s in use hold %llu bytes of memory, and %llu more would pass the "
                 "limit of %llu (--client-room-memory)",
                 room->owner, (unsigned long long)owner->held[LEDGER_ROOM_MEMORY],
                 (unsigned long long)bytes,
                 (unsigned long long)ledger_limit_client(owner, LEDGER_ROOM_MEMORY));
    principal_release(owner);
    return !refusal;
}

bool room_memory_state(struct room *room, bool forced, char error[ROOM_ERROR])
{
    struct room_memory m = {.state = message_memory(room->state),
                            .charged = room->memory.charged};
    if (!forced && !take(room, m.state, error)) return false;
    if (!forced) m.charged += m.state;
    room->memory = m;
    room_memory_update(room);
    return true;
}

// Actions that leave a state as large as it is, or make it smaller: never refused.
static bool adds_nothing(const Relight__RoomAction *a)
{
    return a->undo || a->redo || a->erase || a->close || *a->revoke || a->rename ||
           (a->member && !a->member->role);
}

bool room_memory_grow(struct room *room, const Relight__RoomEvent *event, uint64_t *bytes,
                      char error[ROOM_ERROR])
{
    struct room_memory *m = &room->memory;
    *bytes = 0;
    if (adds_nothing(event->action)) {
        m->less = true;
        return true;
    }
    if (m->since > COUNT_AGAIN + m->state / 8) count(room);
    *bytes = event_memory(room->state, event);
    bool fits = take(room, *bytes, error);
    if (!fits) {
        room_drop_tail(room); // those who come back get the state
        if (m->less || m->since > m->state / 64) count(room);
        fits = take(room, *bytes, error);
    }
    if (!fits) return false;
    m->since += *bytes;
    m->charged += *bytes;
    return true;
}

void room_memory_shrink(struct room *room, uint64_t bytes)
{
    room->memory.since -= bytes;
    room_memory_update(room);
}
