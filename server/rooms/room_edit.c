// SPDX-License-Identifier: MIT
// An action becomes an event: the fold accepts it, it is written, then it is sent to every
// seat. The request is answered when the event is on the disk.
#include "rooms/room_private.h"

#include "core/log.h"
#include "rooms/state.h"
#include "store/disk.h"
#include "store/eviction.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { MOST_TRIES = 4 }; // another daemon may write to the same room at the same time

struct edit {
    struct request_wait wait; // first
    struct room_task task;
    struct edit *next; // of room->again
    struct room *room;
    Relight__RoomEvent *event;
    struct room_summary summary;
    bool has_summary;
    char *keeps;    // what the room needs from here on; NULL: as before
    char *told;     // by hooks: the state may have later events once this one is on the disk
    uint8_t *bytes; // the packed event
    size_t n;
    uint64_t charged;
    unsigned tries;
    char secret[GUEST_SECRET];
};

static void edit_free(struct edit *edit)
{
    if (edit->event) relight__room_event__free_unpacked(edit->event, NULL);
    summary_finish(&edit->summary);
    free(edit->bytes);
    free(edit->keeps);
    free(edit->told);
    memset(edit->secret, 0, sizeof edit->secret);
    free(edit);
}

static bool changes_summary(const Relight__RoomAction *a)
{
    return a->start || a->rename || a->member || a->invite || *a->revoke || a->close;
}

static uint64_t now_us(void)
{
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    return (uint64_t)now.tv_sec * 1000000 + (uint64_t)now.tv_nsec / 1000;
}

// ---- charges

static bool charge(struct edit *edit, char error[ROOM_ERROR])
{
    struct room *room = edit->room;
    struct server *server = room->rooms->server;
    uint64_t bytes = edit->n + ROOM_EVENT_CHARGE;
    const Relight__RoomClose *close = edit->event->action->close;
    if (close && close->closed) { // a full disk is why a room is closed
        disk_charge(server->ledger, room->owner, (int64_t)bytes);
        room_was_charged(room->rooms, room->owner, bytes);
        edit->charged = bytes;
        return true;
    }
    enum ledger_refusal refusal = disk_take(server->ledger, room->owner, bytes, error);
    if (refusal == LEDGER_ALL_FULL) {
        evict_for_event(server, bytes);
        refusal = disk_take(server->ledger, room->owner, bytes, error);
    }
    if (refusal != LEDGER_GRANTED) {
        evict_explain(server, refusal == LEDGER_CLIENT_FULL ? room->owner : NULL, error);
        return false;
    }
    room_was_charged(room->rooms, room->owner, bytes);
    edit->charged = bytes;
    return true;
}

static void give_back(struct edit *edit)
{
    room_give_back(edit->room->rooms, edit->room->owner, edit->charged);
    edit->charged = 0;
}

// ---- the end of an edit

const char room_role_hint[] = "an owner of the room gives roles: `relight room member`";
const char room_state_hint[] = "`relight room show` prints what the room has now";

// The remedies of other requests are about models.
static const char *fold_hint(int code)
{
    switch (code) {
    case RELIGHT__ERROR_CODE__ERROR_FORBIDDEN:
        return room_role_hint;
    case RELIGHT__ERROR_CODE__ERROR_NOT_FOUND:
    case RELIGHT__ERROR_CODE__ERROR_MISMATCH:
        return room_state_hint;
    case RELIGHT__ERROR_CODE__ERROR_LIMIT:
        return "every review room has this bound";
    default:
        return NULL;
    }
}

// by_fold: the room itself refuses it.
static void refuse(struct edit *edit, int code, const char *error, bool by_fold)
{
    struct request *request = request_resume(&edit->wait);
    if (request && by_fold) request->hint = fold_hint(code);
    if (request) request_fail(request, code, "%s", error);
    edit_free(edit);
}

static void answer(struct edit *edit)
{
    struct request *request = request_resume(&edit->wait);
    if (!request) return;
    if (request->type == RELIGHT_TYPE_ROOM_CREATE) {
        Relight__RoomCreateAnswer out = RELIGHT__ROOM_CREATE_ANSWER__INIT;
        out.room = edit->room->id;
        out.sequence = edit->event->stamp->sequence;
        request_answer(request, &out.base, NULL);
        return;
    }
    Relight__RoomEditAnswer out = RELIGHT__ROOM_EDIT_ANSWER__INIT;
    out.sequence = edit->event->stamp->sequence;
    out.time_us = edit->event->stamp->time_us;
    out.secret = edit->secret;
    request_answer(request, &out.base, NULL);
}

// Changes of who may do what are in the log.
static void audit(const struct edit *edit)
{
    const Relight__RoomAction *a = edit->event->action;
    const char *who = edit->event->stamp->by, *room = edit->room->id;
    if (a->start) log_line(LOG_EVENT, "audit act=room-create who=%s room=%s", who, room);
    if (a->member)
        log_line(LOG_EVENT, "audit act=room-member who=%s room=%s member=%s role=%s", who, room,
                 a->member->by, room_role_word((int)a->member->role));
    if (a->invite)
        log_line(LOG_EVENT,
                 "audit act=room-invite who=%s room=%s guest=%s role=%s expires=%llu", who,
                 room, a->invite->id, room_role_word((int)a->invite->role),
                 (unsigned long long)a->invite->expires_s);
    if (*a->revoke)
        log_line(LOG_EVENT, "audit act=room-revoke who=%s room=%s guest=%s", who, room,
                 a->revoke);
    if (a->close)
        log_line(LOG_EVENT, "audit act=room-%s who=%s room=%s",
                 a->close->closed ? "close" : "open", who, room);
}

// A snapshot may have events that are on their way: the store takes it after them, or not at
// all. Where replicas share the store another's events may take their sequences, and the store
// would take a state that never was: there it waits until nothing is on its way.
static bool snapshot_due(const struct room *room)
{
    bool due = room->committed >= room->snapshot + ROOM_SNAPSHOT_EVENTS;
    return due && (!room->rooms->store->shared || room->state->sequence == room->committed);
}

static void committed(struct edit *edit)
{
    struct room *room = edit->room;
    struct rooms *rooms = room->rooms;
    room->committed = edit->event->stamp->sequence;
    room->bytes += edit->n;
    room_keep_event(room, room->committed, edit->bytes, edit->n);
    edit->bytes = NULL;
    audit(edit);
    hooks_event(rooms->hooks, room->id, edit->event, edit->told);
    edit->told = NULL;
    answer(edit);
    if (edit->has_summary) {
        if (!guests_replace(&rooms->guests, room->id, edit->summary.invite,
                            edit->summary.n_invite))
            log_line(LOG_WARN, "room=%s: not enough memory for its invitations until a restart",
                     room->id);
        connections_recheck(rooms->server, false); // guests who may not come any more
        seats_check(room);
    }
    seats_wake(room);
    readers_check(room);
    if (!room->stale && room->state && snapshot_due(room)) room_write_snapshot(room);
}

// It starts again once the room is read, or its request fails.
static void not_written(struct edit *edit)
{
    struct room *room = edit->room;
    char error[ROOM_ERROR];
    give_back(edit);
    room_spoil(room);
    if (edit->task.status != ROOM_TASK_FAILED && ++edit->tries < MOST_TRIES &&
        !edit->event->action->start) {
        struct edit **at = &room->again; // in their order
        while (*at) at = &(*at)->next;
        *at = edit;
        edit->next = NULL;
        return;
    }
    log_line(LOG_ERR, "room=%s: an event could not be written: %s", room->id, edit->task.error);
    snprintf(error, sizeof error, "the room could not be written, nothing was changed: %s",
             edit->task.error);
    if (edit->event->action->start) give_back_room(room->rooms->server, edit->event->stamp->by);
    refuse(edit, RELIGHT__ERROR_CODE__ERROR_LIMIT, error, false);
}

static void edit_done(struct room_task *task)
{
    struct edit *edit = (struct edit *)((char *)task - offsetof(struct edit, task));
    struct room *room = edit->room;
    room_hold(room);
    room->n_edit--;
    if (task->status == ROOM_TASK_DONE) {
        committed(edit);
        edit_free(edit);
    } else {
        not_written(edit);
    }
    room_reload_if_idle(room);
    room_release(room);
}

// ---- the beginning of an edit

static bool pack(struct edit *edit, uint64_t sequence)
{
    Relight__RoomEvent *e = edit->event;
    e->stamp->sequence = sequence;
    e->stamp->time_us = now_us();
    // Clocks are set back; the order of the log is the order of time.
    if (edit->room->state->changed_us >= e->stamp->time_us)
        e->stamp->time_us = edit->room->state->changed_us + 1;
    free(edit->bytes);
    edit->n = protobuf_c_message_get_packed_size(&e->base);
    edit->bytes = malloc(edit->n + 1);
    if (edit->bytes) protobuf_c_message_pack(&e->base, edit->bytes);
    return edit->bytes;
}

static void submit(struct edit *edit)
{
    struct room *room = edit->room;
    struct room_task *t = &edit->task;
    *t = (struct room_task){.kind = ROOM_TASK_APPEND, .done = edit_done};
    snprintf(t->room, sizeof t->room, "%s", room->id);
    t->sequence = edit->event->stamp->sequence;
    t->time_us = edit->event->stamp->time_us;
    t->bytes = edit->bytes;
    t->n = edit->n;
    t->summary = edit->has_summary ? &edit->summary : NULL;
    t->keeps = edit->keeps;
    room->n_edit++;
    room->rooms->store->api->submit(room->rooms->store, t);
}

// Folds the event and sends it to the disk, or refuses it.
static void begin(struct edit *edit)
{
    struct room *room = edit->room;
    char error[ROOM_ERROR];
    if (room->rooms->store->away) { // the state stays, for those who look at it
        refuse(edit, RELIGHT__ERROR_CODE__ERROR_BUSY,
               "the database of rooms is away: nothing was changed, try again later", false);
        return;
    }
    if (!pack(edit, room->state->sequence + 1)) {
        refuse(edit, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory", false);
        return;
    }
    if (edit->n > ROOM_MAX_EVENT) {
        snprintf(error, sizeof error, "the action takes %zu bytes, and at most %d are kept",
                 edit->n, ROOM_MAX_EVENT);
        refuse(edit, RELIGHT__ERROR_CODE__ERROR_LIMIT, error, true);
        return;
    }
    if (!charge(edit, error)) {
        refuse(edit, RELIGHT__ERROR_CODE__ERROR_LIMIT, error, false);
        return;
    }
    uint64_t grown;
    room_packed_drop(room);
    if (!room_memory_grow(room, edit->event, &grown, error)) {
        give_back(edit);
        refuse(edit, RELIGHT__ERROR_CODE__ERROR_LIMIT, error, false);
        return;
    }
    int code = room_fold(room->state, edit->event, error);
    if (code) room_memory_shrink(room, grown);
    edit->has_summary = !code && changes_summary(edit->event->action);
    summary_finish(&edit->summary);
    free(edit->keeps);
    edit->keeps = NULL;
    if ((edit->has_summary && !room_summarise(room->state, &edit->summary)) ||
        (!code && !room_new_needs(room, edit->event, &edit->keeps))) {
        code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
        snprintf(error, sizeof error, "not enough memory");
    }
    if (!code) {
        free(edit->told);
        edit->told = hooks_describe(room->rooms->hooks, room->state, edit->event);
        submit(edit);
        return;
    }
    give_back(edit);
    if (code == RELIGHT__ERROR_CODE__ERROR_NO_MEMORY) {
        room_spoil(room); // the state may be half-way
        room_reload_if_idle(room);
    }
    refuse(edit, code, error, true);
}

// The role of the author as the room says now: what came between may have changed it.
static void begin_again(struct edit *edit)
{
    const struct request *request = edit->wait.request;
    int role = request ? caller_role(request, edit->room) : RELIGHT__ROOM_ROLE__ROLE_NONE;
    if ((int)edit->event->role > role) edit->event->role = (Relight__RoomRole)role;
    begin(edit); // one whose request has ended is refused
}

void edits_again(struct room *room)
{
    for (struct edit *edit; (edit = room->again);) {
        room->again = edit->next;
        if (!room->state || room->stale)
            refuse(edit, RELIGHT__ERROR_CODE__ERROR_BUSY, "the room is not available now",
                   false);
        else begin_again(edit);
    }
}

// An invitation gets an id and a secret here; the log has the secret's hash.
static bool complete_invite(struct edit *edit)
{
    Relight__Invite *invite = edit->event->action->invite;
    char id[GUEST_ID + 1], hash[65];
    guest_generate(id, edit->secret, hash);
    text_free(invite->id);
    text_free(invite->hash);
    invite->id = strdup(id);
    invite->hash = strdup(hash);
    return invite->id && invite->hash;
}

static struct edit *new_edit(struct request *request, struct room *room,
                             const Relight__RoomAction *action, int role)
{
    const Relight__RoomEditRequest *in =
        request->type == RELIGHT_TYPE_ROOM_EDIT
            ? (const Relight__RoomEditRequest *)request->message
            : NULL;
    struct edit *edit = calloc(1, sizeof *edit);
    Relight__RoomEvent event = RELIGHT__ROOM_EVENT__INIT;
    Relight__Stamp stamp = RELIGHT__STAMP__INIT;
    if (!edit) return NULL;
    stamp.by = request->conn->caller.name;
    stamp.name = in ? in->name : ((const Relight__RoomCreateRequest *)request->message)->me;
    event.stamp = &stamp;
    event.role = (Relight__RoomRole)role;
    event.action = (Relight__RoomAction *)(uintptr_t)action;
    if (in) {
        event.client = in->client;
        event.number = in->number;
    }
    edit->room = room;
    edit->event = message_copy(&event);
    if (edit->event && (!action->invite || complete_invite(edit))) return edit;
    edit_free(edit);
    return NULL;
}

bool room_edit_repeated(struct request *request, const struct room *room)
{
    const Relight__RoomEditRequest *in = (const Relight__RoomEditRequest *)request->message;
    if (request->type != RELIGHT_TYPE_ROOM_EDIT) return false;
    uint64_t sequence =
        room_done_before(room->state, in->client, request->conn->caller.name, in->number);
    if (!sequence) return false;
    if (in->number < UINT64_MAX &&
        room_done_before(room->state, in->client, request->conn->caller.name, in->number + 1)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                     "a later number of this client was done before it: use a new number");
        return true;
    }
    if (sequence > room->committed) {
        request->retry_ms = 20;
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY, "it is being written just now");
        return true;
    }
    if (in->action && in->action->invite) { // the log has its hash alone
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                     "the invitation was made, but its secret went with the first answer: "
                     "revoke it and make another");
        return true;
    }
    Relight__RoomEditAnswer out = RELIGHT__ROOM_EDIT_ANSWER__INIT;
    out.sequence = sequence;
    out.repeated = true;
    request_answer(request, &out.base, NULL);
    return true;
}

void room_edit(struct request *request, struct room *room, const Relight__RoomAction *action,
               int role)
{
    if (room_edit_repeated(request, room)) return;
    struct edit *edit = new_edit(request, room, action, role);
    if (!edit) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    request_park(request, &edit->wait);
    begin(edit);
}
