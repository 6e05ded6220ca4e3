// SPDX-License-Identifier: MIT
// Rooms in memory: read from the store when they are used, written back as snapshots, and gone
// when nobody has used them for a while.
#include "rooms/room_private.h"

#include "core/log.h"
#include "rooms/room_backup.h"
#include "store/disk.h"
#include "store/holds.h"

#include "relight.pb-c.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

// ---- the table

static struct room **slot(struct rooms *rooms, const char *id)
{
    uint64_t hash = 0;
    for (const char *c = id; *c; c++) hash = hash * 31 + (unsigned char)*c;
    struct room **at = &rooms->hash[hash % ROOMS_HASH]; // ids are random
    while (*at && strcmp((*at)->id, id)) at = &(*at)->next;
    return at;
}

struct room *room_in_memory(struct rooms *rooms, const char *id)
{
    return *slot(rooms, id);
}

static void idle_over(struct loop_timer *timer);

struct room *room_add(struct rooms *rooms, const char *id)
{
    struct room *room = calloc(1, sizeof *room);
    if (!room) return NULL;
    room->rooms = rooms;
    snprintf(room->id, sizeof room->id, "%s", id);
    room->last_waiter = &room->waiters;
    room->idle.fire = idle_over;
    *slot(rooms, id) = room;
    rooms->n_room++;
    return room;
}

static void unlink_idle(struct room *room)
{
    struct rooms *rooms = room->rooms;
    if (!room->is_idle) return;
    *(room->newer_idle ? &room->newer_idle->older_idle : &rooms->newest_idle) =
        room->older_idle;
    *(room->older_idle ? &room->older_idle->newer_idle : &rooms->oldest_idle) =
        room->newer_idle;
    room->newer_idle = room->older_idle = NULL;
    room->is_idle = false;
}

static void link_idle(struct room *room)
{
    struct rooms *rooms = room->rooms;
    unlink_idle(room);
    room->older_idle = rooms->newest_idle;
    *(rooms->newest_idle ? &rooms->newest_idle->newer_idle : &rooms->oldest_idle) = room;
    rooms->newest_idle = room;
    room->is_idle = true;
}

void room_drop_tail(struct room *room)
{
    for (unsigned i = 0; room->tail && i < room->tail->n; i++)
        free(room->tail->event[(room->tail->first + i) % room->tail->most].bytes);
    free(room->tail);
    room->tail = NULL;
    room_memory_update(room);
}

static void room_free(struct room *room)
{
    struct rooms *rooms = room->rooms;
    *slot(rooms, room->id) = room->next;
    unlink_idle(room);
    loop_timer_stop(rooms->server->loop, &room->idle);
    loop_timer_stop(rooms->server->loop, &room->tick);
    room_drop_tail(room);
    shared_release(room->batch);
    room->batch = NULL;
    presence_drop(room);
    room_packed_drop(room);
    room_state_free(room->state);
    room->state = NULL;
    room_memory_update(room);
    rooms->n_room--;
    free(room);
}

static bool in_use(const struct room *room)
{
    return room->users || room->n_edit || room->loading || room->again || room->waiters ||
           room->seats || room->readers;
}

bool room_let_go(struct room *room)
{
    if (in_use(room)) return false;
    if (room->state && !room->stale && room->committed > room->snapshot)
        room_write_snapshot(room);
    room_free(room);
    return true;
}

static void idle_over(struct loop_timer *timer)
{
    struct room *room = (struct room *)((char *)timer - offsetof(struct room, idle));
    if (!room->rooms->stopping) room_let_go(room); // else the store may be closed
}

void room_hold(struct room *room)
{
    room->users++;
    unlink_idle(room);
}

void room_release(struct room *room)
{
    const struct server *server = room->rooms->server;
    room->users--;
    if (in_use(room)) return;
    // One that failed to be read, or to begin, is not worth keeping.
    uint64_t keep_ns = room->state && !room->stale && room->committed
                           ? (uint64_t)(server->options.room_idle * 1e9)
                           : 0;
    link_idle(room);
    loop_timer_set(server->loop, &room->idle, loop_now_ns() + keep_ns);
}

// ---- the tail

// Twice as long, from its first event on; false without memory.
static bool grow_tail(struct room *room)
{
    struct room_tail *old = room->tail;
    unsigned most = old ? old->most * 2 : 8;
    struct room_tail *t = calloc(1, sizeof *t + most * sizeof *t->event);
    if (!t) return false;
    t->most = most;
    for (unsigned i = 0; old && i < old->n; i++)
        t->event[t->n++] = old->event[(old->first + i) % old->most];
    if (old) t->bytes = old->bytes;
    free(old);
    room->tail = t;
    return true;
}

void room_keep_event(struct room *room, uint64_t sequence, uint8_t *bytes, size_t n)
{
    struct room_tail *t = room->tail;
    if ((!t || (t->n == t->most && t->most < ROOM_TAIL)) && !grow_tail(room)) {
        room_drop_tail(room); // those who sit here get the state instead
        free(bytes);
        return;
    }
    t = room->tail;
    while (t->n && (t->n == t->most || t->bytes + n > ROOM_TAIL_BYTES)) {
        struct room_event_bytes *oldest = &t->event[t->first];
        t->bytes -= oldest->n;
        free(oldest->bytes);
        t->first = (t->first + 1) % t->most;
        t->n--;
    }
    t->event[(t->first + t->n++) % t->most] =
        (struct room_event_bytes){.sequence = sequence, .bytes = bytes, .n = n};
    t->bytes += n;
    room_memory_update(room);
}

// ---- reading a room

// An edit among them may spoil the state: those after it wait until it is read again.
static void tell_waiters(struct room *room, int code, const char *error)
{
    struct room_waiter *all = room->waiters, **last = room->last_waiter;
    room->waiters = NULL;
    room->last_waiter = &room->waiters;
    while (all && (code || !room->spoilt)) {
        struct room_waiter *w = all;
        all = w->next;
        w->then(w, code ? NULL : room, code, error);
    }
    if (!all) return;
    *last = room->waiters;
    if (room->waiters) last = room->last_waiter;
    room->waiters = all;
    room->last_waiter = last;
}

// Where nobody sits in it, a state that does not fit is not kept.
static bool has_room(struct room *room)
{
    char error[ROOM_ERROR];
    bool fits = room_memory_state(room, room->seats != NULL, error);
    if (!fits) {
        room_state_free(room->state);
        room->state = NULL;
        tell_waiters(room, RELIGHT__ERROR_CODE__ERROR_LIMIT, error);
    }
    return fits;
}

static void tell_unreadable(struct room *room, int code, const char *error)
{
    if (code != RELIGHT__ERROR_CODE__ERROR_NO_MEMORY) {
        log_line(LOG_ERR, "room=%s: %s: restore the store from a backup", room->id, error);
        error = "the room's log is damaged: an administrator can restore a backup";
    }
    tell_waiters(room, code, error);
}

static void take_loaded(struct room *room, struct room_task *task)
{
    char error[ROOM_ERROR];
    int code = room_fold_stored(room->id, task, &room->state, error);
    if (code) {
        tell_unreadable(room, code, error);
        return;
    }
    room->committed = room->state->sequence;
    room->snapshot = task->sequence;
    room->bytes = task->stored_bytes;
    snprintf(room->owner, sizeof room->owner, "%s", room->state->created->by);
    if (!has_room(room)) return;
    room_set_needs(room->rooms, room->state, false);
    room_drop_tail(room); // its events may not be those of the store
    for (size_t i = task->n_event > ROOM_TAIL ? task->n_event - ROOM_TAIL : 0;
         i < task->n_event; i++) {
        room_keep_event(room, task->event[i].sequence, task->event[i].bytes, task->event[i].n);
        task->event[i].bytes = NULL;
    }
    edits_again(room);
    tell_waiters(room, 0, "");
    seats_check(room); // another replica may have changed who may be here
    seats_wake(room);
}

static void loaded(struct room_task *task)
{
    struct room *room = (struct room *)((char *)task - offsetof(struct room, load));
    room_hold(room);                 // `task` is a part of it
    room->stale = room->again_stale; // written by another replica meanwhile
    room->again_stale = room->spoilt = false;
    if (task->status == ROOM_TASK_DONE) take_loaded(room, task);
    else if (task->status == ROOM_TASK_MISSING) {
        tell_waiters(room, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "");
        seats_end(room);
    } else {
        log_line(LOG_ERR, "room=%s: it could not be read: %s", room->id, task->error);
        tell_waiters(room, RELIGHT__ERROR_CODE__ERROR_BUSY, "the room could not be read");
    }
    room_task_finish(task);
    if (!room->state) edits_again(room); // they fail
    room->loading = false;               // until here nothing may begin to read it anew
    room_reload_if_idle(room);
    room_release(room);
}

static void begin_load(struct room *room)
{
    room->loading = true;
    room_packed_drop(room);
    room_state_free(room->state);
    room->state = NULL;
    room_memory_update(room);
    room->load = (struct room_task){.kind = ROOM_TASK_LOAD, .done = loaded};
    snprintf(room->load.room, sizeof room->load.room, "%s", room->id);
    room->rooms->store->api->submit(room->rooms->store, &room->load);
}

void room_spoil(struct room *room)
{
    room->stale = room->spoilt = true;
    room_packed_drop(room);
    seats_forget_state(room);
    readers_check(room);
}

void room_reload_if_idle(struct room *room)
{
    bool wanted = room->stale || room->waiters;
    if (wanted && !room->n_edit && !room->loading) begin_load(room);
}

void room_use(struct rooms *rooms, const char *id, struct room_waiter *waiter)
{
    struct room *room = *slot(rooms, id);
    if (!room && !(room = room_add(rooms, id))) {
        waiter->then(waiter, NULL, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    if (room->state && !room->stale) {
        room_hold(room);
        waiter->then(waiter, room, 0, "");
        room_release(room);
        return;
    }
    waiter->next = NULL;
    *room->last_waiter = waiter;
    room->last_waiter = &waiter->next;
    if (!room->loading && !room->n_edit) begin_load(room);
}

// ---- start and end

static void refresh_guests(struct rooms *rooms);

static void wait_for(struct rooms *rooms, struct room_task *task, bool *over)
{
    rooms->store->api->submit(rooms->store, task);
    while (!*over) loop_turn(rooms->server->loop, -1);
}

struct guests_reading {
    struct room_task task; // first
    struct rooms *rooms;
};

struct at_start {
    struct room_task task;
    bool over;
};

static void read_at_start(struct room_task *task)
{
    ((struct at_start *)task)->over = true;
}

static bool take_guests(struct rooms *rooms, const struct room_task *task)
{
    bool good = true;
    for (size_t i = 0; i < task->n_row && good; i++) {
        const struct room_row *row = &task->row[i];
        struct room_invite invite = {.role = row->role, .expires_s = row->expires_s};
        snprintf(invite.id, sizeof invite.id, "%.32s", row->by);
        snprintf(invite.hash, sizeof invite.hash, "%s", row->hash);
        snprintf(invite.inviter, sizeof invite.inviter, "%.95s", row->name);
        good = guests_add(&rooms->guests, row->room, &invite);
    }
    return good;
}

static int read_guests(struct rooms *rooms)
{
    struct at_start s = {.task = {.kind = ROOM_TASK_INVITES, .done = read_at_start}};
    wait_for(rooms, &s.task, &s.over);
    bool failed = s.task.status != ROOM_TASK_DONE || !take_guests(rooms, &s.task);
    room_task_finish(&s.task);
    return failed ? -1 : 0;
}

static int charge_owners(struct rooms *rooms)
{
    struct at_start s = {.task = {.kind = ROOM_TASK_OWNERS, .done = read_at_start}};
    wait_for(rooms, &s.task, &s.over);
    for (size_t i = 0; i < s.task.n_row; i++) {
        const struct room_row *row = &s.task.row[i];
        disk_charge(rooms->server->ledger, row->by, (int64_t)row->bytes);
        room_was_charged(rooms, row->by, row->bytes);
        struct principal *p = ledger_principal(rooms->server->ledger, row->by);
        if (p) ledger_force(p, LEDGER_ROOMS, row->sequence);
        principal_release(p);
    }
    room_task_finish(&s.task);
    return s.task.status == ROOM_TASK_DONE ? 0 : -1;
}

// A scene of the room shows it, or did so in a revision. Somebody has to be in the room.
static bool guest_may_see(const struct server *server, const char *guest, const char *model)
{
    const char *id = guests_room(&server->rooms->guests, guest);
    const struct room *room = id ? room_in_memory(server->rooms, id) : NULL;
    const Relight__RoomState *s = room ? room->state : NULL;
    if (!s) return false;
    bool shown = !strcmp(s->scene->model, model);
    for (size_t i = 0; i < s->n_revisions && !shown; i++)
        shown = !strcmp(s->revisions[i]->scene->model, model);
    return shown;
}

// ---- what other replicas wrote

static void guests_read(struct room_task *task)
{
    struct rooms *rooms = ((struct guests_reading *)task)->rooms;
    rooms->reading_guests = false;
    if (task->status == ROOM_TASK_DONE) {
        guests_finish(&rooms->guests);
        if (take_guests(rooms, task) && !rooms->stopping)
            connections_recheck(rooms->server, false); // guests who may not come any more
    } else {
        rooms->guests_missed = true; // until the database is back
    }
    room_task_finish(task);
    free(task);
    if (rooms->guests_again) refresh_guests(rooms);
}

static void refresh_guests(struct rooms *rooms)
{
    rooms->guests_again = rooms->reading_guests;
    struct guests_reading *g = rooms->reading_guests ? NULL : calloc(1, sizeof *g);
    if (!g) return;
    rooms->reading_guests = true;
    g->rooms = rooms;
    g->task = (struct room_task){.kind = ROOM_TASK_INVITES, .done = guests_read};
    rooms->store->api->submit(rooms->store, &g->task);
}

// Events of another replica are read with the room's state, as after a conflict.
static void reread(struct room *room, uint64_t sequence)
{
    bool known = room->state && !room->stale && room->state->sequence >= sequence;
    if (known || (!room->state && !room->loading)) return;
    room_spoil(room);
    room->again_stale |= room->loading;
    room_reload_if_idle(room);
}

static void changed_elsewhere(void *user, const struct room_change *change)
{
    struct rooms *rooms = user;
    struct room *room = change->room[0] ? room_in_memory(rooms, change->room) : NULL;
    if (rooms->stopping) return;
    // Sequence 0: it was deleted.
    if (room) reread(room, change->sequence ? change->sequence : UINT64_MAX);
    for (int i = 0; change->all && i < ROOMS_HASH; i++)
        for (room = rooms->hash[i]; room; room = room->next) reread(room, UINT64_MAX);
    if (change->all || change->summary) refresh_guests(rooms);
    if (change->all) rooms_read_keeps(rooms);
    else if (change->keeps) room_keeps_changed(rooms, change->room);
    if (change->tokens) tokens_changed(rooms);
}

static int read_keeps_at_start(struct rooms *rooms)
{
    rooms_read_keeps(rooms);
    while (rooms->reading_keeps) loop_turn(rooms->server->loop, -1);
    return holds_known(rooms->server->holds) ? 0 : -1;
}

int rooms_create(struct server *server, struct rooms **out)
{
    char fault[256], option[4096];
    const char *where;
    struct timespec now;
    struct rooms *rooms = calloc(1, sizeof *rooms);
    if (server->options.rooms[0]) snprintf(option, sizeof option, "%s", server->options.rooms);
    else snprintf(option, sizeof option, "sqlite:%s/rooms.sqlite", server->data);
    const struct room_store_api *api = room_store_parse(option, &where, fault);
    if (rooms && api && hooks_create(server, &rooms->hooks, fault)) api = NULL;
    if (!rooms || !api || api->open(where, server->loop, &rooms->store, fault)) {
        log_line(LOG_ERR, "%s", rooms ? fault : "not enough memory");
        if (rooms) hooks_destroy(rooms->hooks);
        free(rooms);
        return -1;
    }
    rooms->server = server;
    clock_gettime(CLOCK_REALTIME, &now);
    rooms->last_key = (uint64_t)now.tv_sec * 1000000; // above those of earlier runs
    rooms->last_key += (uint64_t)now.tv_nsec / 1000;
    *out = rooms;
    if (read_guests(rooms) || charge_owners(rooms) || read_keeps_at_start(rooms) ||
        tokens_share(rooms)) {
        log_line(LOG_ERR, "rooms %s could not be read", option);
        return -1;
    }
    rooms->store->user = rooms;
    rooms->store->changed = changed_elsewhere;
    server->guest_may_see = guest_may_see;
    access_set_guests(server->access, guests_check, guests_current, &rooms->guests);
    return 0;
}

// What the ends of the last tasks and timers still ask of the store fails.
static void submit_closed(struct room_store *store, struct room_task *task)
{
    task->status = ROOM_TASK_FAILED;
    snprintf(task->error, sizeof task->error, "the daemon stops");
    task->done(task);
}

static const struct room_store_api closed_api = {.submit = submit_closed};
static struct room_store closed_store = {.api = &closed_api};

void rooms_destroy(struct rooms *rooms)
{
    if (!rooms) return;
    struct server *server = rooms->server;
    server->guest_may_see = NULL;
    server->write_tokens = NULL;
    access_set_guests(server->access, NULL, NULL, NULL);
    rooms->stopping = true;
    for (int i = 0; i < ROOMS_HASH; i++)
        for (struct room *room = rooms->hash[i]; room; room = room->next)
            if (room->state && !room->stale && !room->n_edit &&
                room->committed > room->snapshot + ROOM_SNAPSHOT_EVENTS / 4)
                room_write_snapshot(room);
    rooms->store->api->close(rooms->store);
    rooms->store = &closed_store;
    loop_turn(server->loop, 0); // the ends of its last tasks, of which hooks are told
    hooks_destroy(rooms->hooks);
    backups_drop(rooms); // one of them may have been written until here
    for (int i = 0; i < ROOMS_HASH; i++)
        while (rooms->hash[i]) room_free(rooms->hash[i]);
    guests_finish(&rooms->guests);
    room_charges_finish(rooms);
    free(rooms);
}

struct purge {
    struct room_task task;
    struct rooms *rooms;
};

static void purged(struct room_task *task)
{
    struct rooms *rooms = ((struct purge *)task)->rooms;
    if (task->status == ROOM_TASK_FAILED)
        log_line(LOG_WARN, "rooms: closed ones could not be deleted: %s", task->error);
    for (size_t i = 0; i < task->n_row; i++) {
        const struct room_row *row = &task->row[i];
        struct room *room = room_in_memory(rooms, row->room);
        log_line(LOG_EVENT, "room=%s deleted=closed owner=%s", row->room, row->by);
        room_give_back(rooms, row->by, row->bytes);
        give_back_room(rooms->server, row->by);
        guests_replace(&rooms->guests, row->room, NULL, 0);
        holds_set(rooms->server->holds, row->room, "");
        if (!room) continue;
        room_spoil(room);
        room_reload_if_idle(room); // to find that it is gone
    }
    room_task_finish(task);
    free(task);
}

void rooms_maintain(struct rooms *rooms)
{
    double keep_s = rooms->server->options.rooms_keep;
    if (rooms->stopping) return; // the store may be closed
    if (!holds_known(rooms->server->holds)) rooms_read_keeps(rooms);
    rooms_count(rooms);
    struct purge *purge = keep_s > 0 ? calloc(1, sizeof *purge) : NULL;
    struct timespec now;
    if (!purge) return;
    struct room_task *task = &purge->task;
    purge->rooms = rooms;
    clock_gettime(CLOCK_REALTIME, &now);
    double before_us = ((double)now.tv_sec - keep_s) * 1e6 + 1e-3 * (double)now.tv_nsec;
    task->kind = ROOM_TASK_PURGE;
    task->time_us = before_us > 0 ? (uint64_t)before_us : 0;
    task->done = purged;
    rooms->store->api->submit(rooms->store, task);
}
