// SPDX-License-Identifier: MIT
// Who sits in a room and what they say of themselves. Each tells all, so that the bytes grow
// with the square of their number: what is sent at once is packed once for all who are as far,
// and the time until the next changes are sent grows with the bytes of the last ones.
#include "rooms/room_private.h"

#include "rooms/state.h"

#include <stdlib.h>
#include <string.h>

static const uint64_t tick_ns = 30000000;
static const size_t most_message = 256 << 10;
static const double most_rate = 16e6; // bytes a second of a room's changes, to all together

// What was sent since the last changes were shown may still take its time.
static void tick(struct loop_timer *timer)
{
    struct room *room = (struct room *)((char *)timer - offsetof(struct room, tick));
    uint64_t now_ns = loop_now_ns();
    uint64_t next_ns =
        room->ticked_ns + (uint64_t)((double)room->presence_sent / most_rate * 1e9);
    if (next_ns > now_ns) {
        loop_timer_set(room->rooms->server->loop, &room->tick, next_ns);
        return;
    }
    room->shown = room->presence;
    room->ticked_ns = now_ns;
    room->presence_sent = 0;
    seats_wake(room);
}

// The first change is sent at once, those that follow it together, some thirty times a second
// where they are few.
void presence_changed(struct room *room)
{
    uint64_t now_ns = loop_now_ns(), at_ns = room->ticked_ns + tick_ns;
    room->tick.fire = tick;
    if (!room->tick.armed)
        loop_timer_set(room->rooms->server->loop, &room->tick, at_ns > now_ns ? at_ns : now_ns);
}

// One that changed, or has gone.
struct change {
    uint64_t at;
    Relight__Participant *who;
};

static int earlier(const void *a, const void *b)
{
    const struct change *x = a, *y = b;
    return x->at < y->at ? -1 : x->at > y->at;
}

// In the order of the changes; gone: [ROOM_GONE], for those that left.
static size_t list_changes(const struct room *room, const struct presence_known *known,
                           bool all, struct change *list, Relight__Participant *gone)
{
    size_t n = 0;
    unsigned kept = room->n_gone < ROOM_GONE ? room->n_gone : ROOM_GONE;
    for (struct seat *s = room->seats; s; s = s->next)
        if (all || s->changed > known->changes) list[n++] = (struct change){s->changed, s->me};
    for (unsigned i = 0; !all && i < kept; i++) {
        if (room->gone[i].presence <= known->departures) continue;
        relight__participant__init(&gone[i]);
        gone[i].key = room->gone[i].key;
        gone[i].gone = true;
        list[n++] = (struct change){room->gone[i].presence, &gone[i]};
    }
    qsort(list, n, sizeof *list, earlier);
    return n;
}

// As many as one message takes; *to: the last change among them.
static struct shared_bytes *pack(const struct room *room, const struct change *list, size_t n,
                                 uint64_t *to)
{
    size_t size = 0, taken = 0;
    Relight__Presence presence = RELIGHT__PRESENCE__INIT;
    Relight__Participant **who = calloc(n + 1, sizeof *who);
    while (who && taken < n) {
        size_t more = events_room(protobuf_c_message_get_packed_size(&list[taken].who->base));
        if (taken && size + more > most_message) break;
        size += more;
        who[taken] = list[taken].who;
        taken++;
    }
    *to = taken < n ? list[taken - 1].at : room->presence;
    presence.participants = who;
    presence.n_participants = taken;
    size = who ? protobuf_c_message_get_packed_size(&presence.base) : 0;
    struct shared_bytes *packed = who ? malloc(sizeof *packed + size) : NULL;
    if (packed) {
        packed->refs = 1;
        packed->n = size;
        protobuf_c_message_pack(&presence.base, packed->bytes);
    }
    free(who);
    return packed;
}

void presence_drop(struct room *room)
{
    shared_release(room->last_presence.packed);
    room->last_presence.packed = NULL;
}

struct shared_bytes *presence_after(struct room *room, const struct presence_known *known,
                                    bool all, uint64_t *to)
{
    struct room_presence *last = &room->last_presence;
    if (!last->packed || last->of != room->presence || last->all != all ||
        (!all && memcmp(&last->from, known, sizeof *known))) {
        size_t most = ROOM_GONE + seats_count(room);
        struct change *list = calloc(most + 1, sizeof *list);
        Relight__Participant *gone = calloc(ROOM_GONE, sizeof *gone);
        presence_drop(room);
        *last = (struct room_presence){.all = all, .from = *known, .of = room->presence};
        if (list && gone) {
            size_t n = list_changes(room, known, all, list, gone);
            last->packed = pack(room, list, n, &last->to);
        }
        free(list);
        free(gone);
        room_memory_update(room);
    }
    *to = last->to;
    return last->packed;
}
