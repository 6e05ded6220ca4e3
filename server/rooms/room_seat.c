// SPDX-License-Identifier: MIT
// SUBSCRIBE with a room: people who sit in it get its state or the events that they miss, then
// each event once it is on the disk, and see each other. A client that reads slowly gets the
// newest state in place of events it has missed; nothing is queued for it.
#include "rooms/room_private.h"

#include "net/dispatch.h"
#include "rooms/state.h"

#include "frame.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const size_t most_unsent = 256 << 10; // bytes of answers that wait: then events wait
static const size_t most_batch = 256 << 10;
static const uint64_t later_ns = 50000000;
enum { MAX_PRESENCE = 16384 }; // bytes of one participant

static struct server *server_of(const struct seat *seat)
{
    return seat->room->rooms->server;
}

static void wake_seat(struct seat *seat, uint64_t at_ns)
{
    if (!seat->timer.armed || seat->timer.at_ns > at_ns)
        loop_timer_set(server_of(seat)->loop, &seat->timer, at_ns);
}

void seats_wake(struct room *room)
{
    for (struct seat *s = room->seats; s; s = s->next) wake_seat(s, loop_now_ns());
}

unsigned seats_count(const struct room *room)
{
    unsigned n = 0;
    for (const struct seat *s = room->seats; s; s = s->next) n++;
    return n;
}

// ---- presence

static void leave(struct request *request)
{
    struct seat *seat = request->state;
    struct room *room = seat->room;
    struct seat **at = &room->seats;
    while (*at != seat) at = &(*at)->next;
    *at = seat->next;
    loop_timer_stop(request->server->loop, &seat->timer);
    room->gone[room->n_gone % ROOM_GONE].key = seat->me->key;
    room->gone[room->n_gone++ % ROOM_GONE].presence = ++room->presence;
    presence_changed(room);
    room->rooms->n_seat--;
    relight__participant__free_unpacked(seat->me, NULL);
    shared_release(seat->state);
    free(seat);
    room_release(room);
}

// Sends what changed of the participants since the last message; everybody, where a departure
// was missed. False: nothing could be sent.
static bool send_presence(struct seat *seat)
{
    struct room *room = seat->room;
    bool all =
        !seat->told || (room->n_gone > ROOM_GONE &&
                        room->gone[room->n_gone % ROOM_GONE].presence > seat->knows.departures);
    uint64_t to;
    struct shared_bytes *packed = presence_after(room, &seat->knows, all, &to);
    if (!packed) return false;
    packed->refs++;
    Relight__Event out = RELIGHT__EVENT__INIT;
    struct payload payload = shared_payload(packed);
    out.kind = RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE;
    out.room = room->id;
    out.sequence = seat->at;
    out.lost = all;
    out.participant = seat->me->key;
    out.role = (Relight__RoomRole)seat->role;
    room->presence_sent += packed->n;
    seat->knows.changes = to;
    if (all) seat->knows.departures = room->presence; // everybody in it is still here
    else if (to > seat->knows.departures) seat->knows.departures = to;
    seat->told = true;
    request_part(seat->request, &out.base, &payload);
    return true;
}

// ---- state and events

static void send_bytes(struct seat *seat, int kind, uint64_t sequence, struct payload payload)
{
    Relight__Event out = RELIGHT__EVENT__INIT;
    out.kind = (Relight__EventKind)kind;
    out.room = seat->room->id;
    out.sequence = seat->at = sequence;
    out.participant = seat->me->key;
    out.role = (Relight__RoomRole)seat->role;
    request_part(seat->request, &out.base, &payload);
}

// The state is packed when it is wanted and sent when all of it is on the disk. False: it has
// to wait.
static bool send_state(struct seat *seat)
{
    struct room *room = seat->room;
    if (!seat->state) {
        if (!(seat->state = room_packed(room))) return false;
        seat->state_at = room->state->sequence;
    }
    if (seat->state_at > room->committed) return false;
    struct payload payload = shared_payload(seat->state);
    seat->state = NULL;
    seat->wants_state = false;
    send_bytes(seat, RELIGHT__EVENT_KIND__EVENT_ROOM_STATE, seat->state_at, payload);
    return true;
}

void seats_forget_state(struct room *room)
{
    for (struct seat *s = room->seats; s; s = s->next) {
        shared_release(s->state);
        s->state = NULL;
    }
}

static struct room_event_bytes *tail_event(const struct room *room, uint64_t sequence)
{
    struct room_tail *t = room->tail;
    uint64_t oldest = t && t->n ? t->event[t->first].sequence : UINT64_MAX;
    if (sequence < oldest || sequence - oldest >= t->n) return NULL;
    return &t->event[(t->first + (sequence - oldest)) % t->most];
}

// A packed RoomEvents of what follows `from`, shared by all who are as far.
static struct shared_bytes *batch_after(struct room *room, uint64_t from)
{
    if (room->batch && room->batch_from == from) return room->batch;
    size_t most = 0;
    uint64_t to = from;
    for (struct room_event_bytes *e; to < room->committed && (e = tail_event(room, to + 1));) {
        if (most && most + e->n > most_batch) break;
        most += events_room(e->n);
        to++;
    }
    struct shared_bytes *batch = to > from ? malloc(sizeof *batch + most) : NULL;
    if (!batch) return NULL;
    batch->refs = 1;
    batch->n = 0;
    for (uint64_t s = from + 1; s <= to; s++) {
        struct room_event_bytes *e = tail_event(room, s);
        batch->n += events_put(batch->bytes + batch->n, e->bytes, e->n);
    }
    shared_release(room->batch);
    room->batch = batch;
    room->batch_from = from;
    room->batch_to = to;
    room_memory_update(room);
    return batch;
}

// False: nothing could be sent.
static bool send_events(struct seat *seat)
{
    struct room *room = seat->room;
    if (!tail_event(room, seat->at + 1)) {
        seat->wants_state = true;
        return true;
    }
    struct shared_bytes *batch = batch_after(room, seat->at);
    if (!batch) return false;
    batch->refs++;
    send_bytes(seat, RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS, room->batch_to,
               shared_payload(batch));
    return true;
}

// Sends what there is, as far as the client reads.
static void deliver(struct loop_timer *timer)
{
    struct seat *seat = (struct seat *)((char *)timer - offsetof(struct seat, timer));
    struct connection *conn = seat->request->conn;
    struct room *room = seat->room;
    bool ready = room->state && !room->stale;
    while (!conn->dead && conn->out_bytes < most_unsent) {
        bool sent = false;
        if (seat->wants_state) sent = ready && send_state(seat);
        else if (seat->at < room->committed) sent = send_events(seat);
        else if (!seat->told || seat->knows.changes < room->shown) sent = send_presence(seat);
        if (!sent) break;
    }
    if (!conn->dead &&
        (seat->wants_state || seat->at < room->committed || conn->out_bytes >= most_unsent))
        wake_seat(seat, loop_now_ns() + later_ns);
}

// ---- coming in

// NULL: the participant is one that a room takes.
static const char *me_fault(const Relight__Participant *me, char error[ROOM_ERROR])
{
    if (strlen(me->name) > ROOM_MAX_PERSON) return "me.name: at most 64 bytes";
    if (protobuf_c_message_get_packed_size(&me->base) > MAX_PRESENCE)
        return "me: a participant takes at most 16384 bytes";
    if (me->n_hand_parts > ROOM_N_PART) return "me.hand_parts: at most 6 parts";
    bool sane = room_message_sane(&me->base, error) && !room_scene_check(me->hand, error) &&
                !room_scene_check(me->own, error);
    return sane ? NULL : error;
}

// Whose hand moves the shared scene may also change it.
static bool may_move(const struct seat *seat)
{
    const Relight__RoomState *state = seat->room->state;
    return seat->role >= RELIGHT__ROOM_ROLE__ROLE_REVIEWER && state && !state->closed;
}

// What the client says about itself, with what the daemon says.
static bool set_me(struct seat *seat, const Relight__Participant *from)
{
    static const Relight__Participant nobody = RELIGHT__PARTICIPANT__INIT;
    Relight__Participant m = from ? *from : nobody;
    m.key = seat->me ? seat->me->key : ++seat->room->rooms->last_key;
    m.by = seat->request->conn->caller.name;
    m.role = (Relight__RoomRole)seat->role;
    m.gone = false;
    if (!may_move(seat)) {
        m.hand = NULL;
        m.n_hand_parts = 0;
        m.leads = false;
    }
    Relight__Participant *copy = message_copy(&m);
    if (!copy) return false;
    if (seat->me) relight__participant__free_unpacked(seat->me, NULL);
    seat->me = copy;
    seat->changed = ++seat->room->presence;
    presence_changed(seat->room);
    return true;
}

static void take_seat(struct request *request, struct room *room)
{
    const Relight__SubscribeRequest *in = (const Relight__SubscribeRequest *)request->message;
    struct seat *seat = calloc(1, sizeof *seat);
    if (seat) {
        seat->request = request;
        seat->room = room;
        seat->role = caller_role(request, room);
        seat->timer.fire = deliver;
    }
    if (!seat || !set_me(seat, in->me)) {
        free(seat);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    seat->at = in->after;
    // A cursor beyond the room's end is of another store (one that was restored, say).
    seat->wants_state = !in->after || in->after > room->committed;
    seat->next = room->seats;
    room->seats = seat;
    room->rooms->n_seat++;
    room_hold(room);
    request->state = seat;
    request->abandon = leave;
    wake_seat(seat, loop_now_ns());
}

void room_subscribe(struct request *request)
{
    const Relight__SubscribeRequest *in = (const Relight__SubscribeRequest *)request->message;
    char error[ROOM_ERROR];
    const char *fault = in->me ? me_fault(in->me, error) : NULL;
    if (fault) request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "%s", fault);
    else with_room(request, in->room, take_seat);
}

void seats_check(struct room *room)
{
    for (struct seat *s = room->seats; s && room->state;) {
        int role = caller_role(s->request, room);
        if (!role && s->role) {
            s->request->hint = room_role_hint;
            request_stop(s->request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                         "you are no member of this room any more");
            s = room->seats; // the refusal may close the connection, and end other seats
            continue;
        }
        bool moves = s->me->hand || s->me->n_hand_parts || s->me->leads;
        if (role != s->role || (moves && !may_move(s))) { // a closed room lets go of hands
            s->role = role;
            set_me(s, s->me);
        }
        s = s->next;
    }
}

void seats_end(struct room *room)
{
    while (room->seats)
        request_stop(room->seats->request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "the room was deleted");
}

void take_room_presence(struct connection *conn, const ProtobufCMessage *message)
{
    const Relight__RoomPresenceRequest *in = (const Relight__RoomPresenceRequest *)message;
    char error[ROOM_ERROR];
    struct request *r = conn->requests;
    while (r && (r->id != in->subscription || !request_state(r, leave))) r = r->next;
    if (!r || !in->me || me_fault(in->me, error)) return;
    set_me(r->state, in->me);
}
