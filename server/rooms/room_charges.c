// SPDX-License-Identifier: MIT
// What rooms cost their owners, in rooms and in bytes on the disk. Where several replicas write
// to one store each counts once a minute what the others made and deleted.
#include "rooms/room_private.h"

#include "core/ledger.h"
#include "store/disk.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Bytes that are charged to an owner for all of its rooms.
struct owner_charge {
    struct owner_charge *next;
    char owner[96];
    uint64_t bytes;
    bool counted;
};

static struct owner_charge *find(const struct rooms *rooms, const char *owner)
{
    struct owner_charge *c = rooms->charges;
    while (c && strcmp(c->owner, owner)) c = c->next;
    return c;
}

static struct owner_charge *find_or_add(struct rooms *rooms, const char *owner)
{
    struct owner_charge *c = find(rooms, owner);
    if (c || !(c = calloc(1, sizeof *c))) return c;
    snprintf(c->owner, sizeof c->owner, "%s", owner);
    c->next = rooms->charges;
    rooms->charges = c;
    return c;
}

void room_was_charged(struct rooms *rooms, const char *owner, uint64_t bytes)
{
    struct owner_charge *c = find_or_add(rooms, owner);
    if (c) c->bytes += bytes;
}

void room_give_back(struct rooms *rooms, const char *owner, uint64_t bytes)
{
    struct owner_charge *c = find(rooms, owner);
    uint64_t held = c ? c->bytes : 0, less = bytes < held ? bytes : held;
    disk_charge(rooms->server->ledger, owner, -(int64_t)less);
    if (c) c->bytes -= less;
}

void room_charges_finish(struct rooms *rooms)
{
    for (struct owner_charge *c = rooms->charges, *next; c; c = next) {
        next = c->next;
        free(c);
    }
    rooms->charges = NULL;
}

// ---- what other replicas made and deleted

struct counting {
    struct room_task task; // first
    struct rooms *rooms;
};

// Events on their way are charged and not counted yet.
static bool any_edit(const struct rooms *rooms)
{
    for (int i = 0; i < ROOMS_HASH; i++)
        for (const struct room *room = rooms->hash[i]; room; room = room->next)
            if (room->n_edit) return true;
    return false;
}

static void count_owner(struct rooms *rooms, struct owner_charge *c, uint64_t n_room,
                        uint64_t bytes)
{
    struct ledger *ledger = rooms->server->ledger;
    struct principal *p = ledger_principal(ledger, c->owner);
    if (!p) return;
    disk_charge(ledger, c->owner, (int64_t)(bytes - c->bytes));
    c->bytes = bytes;
    uint64_t held = p->held[LEDGER_ROOMS];
    if (n_room > held) ledger_force(p, LEDGER_ROOMS, n_room - held);
    else if (n_room < held) ledger_give(p, LEDGER_ROOMS, held - n_room);
    principal_release(p);
}

static void count_all(struct rooms *rooms, const struct room_task *task)
{
    for (struct owner_charge *c = rooms->charges; c; c = c->next) c->counted = false;
    for (size_t i = 0; i < task->n_row; i++) {
        struct owner_charge *c = find_or_add(rooms, task->row[i].by);
        if (!c) continue;
        c->counted = true;
        count_owner(rooms, c, task->row[i].sequence, task->row[i].bytes);
    }
    for (struct owner_charge **at = &rooms->charges, *c; (c = *at);) {
        if (c->counted) {
            at = &c->next;
            continue;
        }
        count_owner(rooms, c, 0, 0);
        *at = c->next;
        free(c);
    }
}

static void counted(struct room_task *task)
{
    struct rooms *rooms = ((struct counting *)task)->rooms;
    rooms->counting = false;
    if (task->status == ROOM_TASK_DONE && !rooms->stopping && !any_edit(rooms))
        count_all(rooms, task);
    room_task_finish(task);
    free(task);
}

void rooms_count(struct rooms *rooms)
{
    struct counting *c = rooms->store->shared && !rooms->counting ? calloc(1, sizeof *c) : NULL;
    if (!c) return;
    rooms->counting = true;
    c->rooms = rooms;
    c->task = (struct room_task){.kind = ROOM_TASK_OWNERS, .done = counted};
    rooms->store->api->submit(rooms->store, &c->task);
}
