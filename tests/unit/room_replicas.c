// SPDX-License-Identifier: MIT
// A room that another replica writes to, too: the test plays the store and the people's
// carriers, so that each answer of the store comes when it is wanted.
#include "frame.h"
#include "net/dispatch.h"
#include "net/request.h"
#include "relight.pb-c.h"
#include "rooms/room_private.h"
#include "store/disk.h"
#include "store/holds.h"

#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/syscall.h>
#include <time.h>
#include <unistd.h>

#include <cmocka.h>

// Seconds that the clock is ahead.
static time_t ahead_s;

int clock_gettime(clockid_t clock, struct timespec *t)
{
    long fault = syscall(SYS_clock_gettime, clock, t);
    t->tv_sec += ahead_s;
    return (int)fault;
}

static const char id[] = "0123456789abcdef0123456789abcdef";
static char ann[] = "token:ann", bob[] = "token:bob", mine[] = "mine", theirs[] = "theirs";
enum { OWNER = RELIGHT__ROOM_ROLE__ROLE_OWNER, VIEWER = RELIGHT__ROOM_ROLE__ROLE_VIEWER };

// ---- the store: tasks wait until the test ends them

enum { MOST = 32 };
static struct room_task *given[MOST];
static unsigned n_given;

static void submit(struct room_store *store, struct room_task *task)
{
    assert_true(n_given < MOST);
    task->status = ROOM_TASK_DONE;
    given[n_given++] = task;
}

// The oldest of this kind; NULL: there is none.
static struct room_task *take(enum room_task_kind kind)
{
    for (unsigned i = 0; i < n_given; i++) {
        struct room_task *task = given[i];
        if (task->kind != kind) continue;
        memmove(given + i, given + i + 1, (--n_given - i) * sizeof *given);
        return task;
    }
    return NULL;
}

static void end_task(struct room_task *task, enum room_task_status status)
{
    assert_non_null(task);
    task->status = status;
    task->done(task);
}

// ---- events of the log

struct entry {
    char *by;
    Relight__RoomAction action;
    Relight__RoomStart start;
    Relight__RoomRename rename;
    Relight__Member member;
};

static struct entry started(char *by)
{
    struct entry e = {by, RELIGHT__ROOM_ACTION__INIT, RELIGHT__ROOM_START__INIT,
                      RELIGHT__ROOM_RENAME__INIT, RELIGHT__MEMBER__INIT};
    e.start.name = (char *)"room";
    return e;
}

static struct entry renamed(char *by, char *name)
{
    struct entry e = started(by);
    e.rename.name = name;
    return e;
}

static struct entry member(char *by, char *who, int role)
{
    struct entry e = started(by);
    e.member.by = who;
    e.member.role = (Relight__RoomRole)role;
    return e;
}

static void point(struct entry *e)
{
    if (*e->rename.name) e->action.rename = &e->rename;
    else if (*e->member.by) e->action.member = &e->member;
    else e->action.start = &e->start;
}

// Ends the LOAD that was given with this log.
static void give_log(struct entry *log, size_t n)
{
    struct room_task *task = take(ROOM_TASK_LOAD);
    assert_non_null(task);
    task->event = calloc(n, sizeof *task->event);
    task->n_event = n;
    for (size_t i = 0; i < n; i++) {
        Relight__RoomEvent event = RELIGHT__ROOM_EVENT__INIT;
        Relight__Stamp stamp = RELIGHT__STAMP__INIT;
        struct room_event_bytes *e = &task->event[i];
        point(&log[i]);
        stamp.sequence = e->sequence = i + 1;
        stamp.time_us = 1000 * (i + 1);
        stamp.by = log[i].by;
        event.stamp = &stamp;
        event.role = RELIGHT__ROOM_ROLE__ROLE_OWNER;
        event.action = &log[i].action;
        e->n = protobuf_c_message_get_packed_size(&event.base);
        e->bytes = malloc(e->n + 1);
        protobuf_c_message_pack(&event.base, e->bytes);
    }
    end_task(task, ROOM_TASK_DONE);
}

// ---- people

struct person {
    struct connection *conn;
    int error;               // the last ERROR's code
    unsigned n_answer;       // that were no errors
    uint64_t state_sequence; // of the last ROOM_STATE
    char state_name[64];
};

static void take_state(struct person *p, const struct payload *payload)
{
    Relight__RoomState *state =
        relight__room_state__unpack(NULL, payload->size, payload->bytes);
    assert_non_null(state);
    p->state_sequence = state->sequence;
    snprintf(p->state_name, sizeof p->state_name, "%s", state->name);
    relight__room_state__free_unpacked(state, NULL);
}

static void answer(struct connection *conn, uint16_t type, uint8_t flags,
                   const ProtobufCMessage *message, struct payload *payload)
{
    struct person *p = conn->carrier_data;
    if (type == RELIGHT_TYPE_ERROR) p->error = (int)((const Relight__Error *)message)->code;
    else p->n_answer++;
    if (type == (RELIGHT_TYPE_SUBSCRIBE | RELIGHT_TYPE_ANSWER) &&
        ((const Relight__Event *)message)->kind == RELIGHT__EVENT_KIND__EVENT_ROOM_STATE)
        take_state(p, payload);
    if (payload->release) payload->release(payload->owner);
}

static void nothing(struct connection *conn)
{
}

static const struct carrier carrier = {.name = "test", .close = nothing, .answer = answer};

static struct server server;
static struct rooms rooms;
static const struct room_store_api api = {.submit = submit};
static struct room_store store = {.api = &api};

static void begin(void)
{
    server = (struct server){.options = {.idle = 1000,
                                         .handshake = 1000,
                                         .frame_time = 1000,
                                         .write_time = 1000,
                                         .requests = 10}};
    rooms = (struct rooms){.server = &server, .store = &store};
    server.rooms = &rooms;
    n_given = 0;
    ahead_s = 0;
    assert_int_equal(loop_create(&server.loop), 0);
    assert_non_null(server.ledger = ledger_create(&server.options));
    assert_non_null(server.holds = holds_create());
}

static void turn(void)
{
    for (int i = 0; i < 5; i++) loop_turn(server.loop, 0);
}

static void ignore(struct loop_timer *timer)
{
}

// Timers fire as if so many seconds had gone by.
static void let_pass(time_t seconds)
{
    struct loop_timer now = {.fire = ignore}; // wakes the loop
    ahead_s += seconds;
    loop_timer_set(server.loop, &now, 1);
    turn();
}

static void end(void)
{
    while (server.connections) connection_close(server.connections, "over");
    connections_free_closed(&server);
    turn(); // rooms that nobody uses leave
    for (struct room_task *t; (t = take(ROOM_TASK_SNAPSHOT));) end_task(t, ROOM_TASK_DONE);
    assert_int_equal(n_given, 0);
    assert_int_equal(rooms.n_room, 0);
    guests_finish(&rooms.guests);
    room_charges_finish(&rooms);
    holds_destroy(server.holds);
    disk_charge(server.ledger, ann, -(int64_t)disk_bytes(server.ledger)); // of events
    ledger_destroy(server.ledger);
    loop_destroy(server.loop);
}

static void come(struct person *p, const char *who)
{
    *p = (struct person){0};
    assert_non_null(p->conn = connection_open(&server, &carrier, p, "here", who));
    p->conn->caller.scopes = SCOPE_VIEW | SCOPE_EDIT;
}

static void ask(struct person *p, uint16_t type, const ProtobufCMessage *message,
                void (*op)(struct request *request))
{
    static uint64_t last;
    struct relight_frame frame = {.type = type, .id = ++last};
    size_t n = protobuf_c_message_get_packed_size(message);
    uint8_t *bytes = malloc(n + 1);
    protobuf_c_message_pack(message, bytes);
    frame.header = bytes;
    frame.header_size = (uint32_t)n;
    struct request *request = request_create(p->conn, &frame, NULL);
    free(bytes);
    assert_non_null(request);
    op(request);
}

static void rename_room(struct person *p)
{
    Relight__RoomEditRequest m = RELIGHT__ROOM_EDIT_REQUEST__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__RoomRename rename = RELIGHT__ROOM_RENAME__INIT;
    m.room = (char *)id;
    rename.name = mine;
    action.rename = &rename;
    m.action = &action;
    ask(p, RELIGHT_TYPE_ROOM_EDIT, &m.base, op_room_edit);
}

static void sit_down(struct person *p)
{
    Relight__SubscribeRequest m = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    m.room = (char *)id;
    ask(p, RELIGHT_TYPE_SUBSCRIBE, &m.base, room_subscribe);
}

// Another replica has written: the room is read again.
static void changed_elsewhere(void)
{
    struct room *room = room_in_memory(&rooms, id);
    assert_non_null(room);
    room_spoil(room);
    room_reload_if_idle(room);
}

// ---- cases

// One sits down while an event is on its way to the disk, and another replica's event gets its
// sequence: the state with the event that was not written is never sent.
static void a_state_that_never_was(void **unused)
{
    struct person p;
    struct entry log[] = {started(ann), renamed(bob, theirs)};
    begin();
    come(&p, ann);
    rename_room(&p);
    give_log(log, 1);
    struct room_task *first = take(ROOM_TASK_APPEND);
    sit_down(&p);
    turn();
    assert_int_equal(p.state_sequence, 0); // it waits
    end_task(first, ROOM_TASK_CONFLICT);
    give_log(log, 2);
    turn();
    if (p.state_sequence == 2) assert_string_equal(p.state_name, theirs);
    end_task(take(ROOM_TASK_APPEND), ROOM_TASK_DONE); // once more, as event 3
    turn();
    assert_int_equal(p.state_sequence, 3);
    assert_string_equal(p.state_name, mine);
    assert_int_equal(p.error, 0);
    end();
}

static void one_removed_elsewhere_leaves(void **unused)
{
    struct person p;
    struct entry log[] = {started(ann), member(ann, bob, VIEWER), member(ann, bob, 0)};
    begin();
    come(&p, bob);
    sit_down(&p);
    give_log(log, 2);
    turn();
    assert_int_equal(p.state_sequence, 2);
    assert_int_equal(p.conn->n_request, 1);
    changed_elsewhere();
    give_log(log, 3);
    turn();
    assert_int_equal(p.error, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    assert_int_equal(p.conn->n_request, 0);
    end();
}

// The event that came first took the author's role.
static void a_role_that_was_lost(void **unused)
{
    struct person p;
    struct entry log[] = {started(ann), member(ann, bob, OWNER), member(ann, bob, 0)};
    begin();
    come(&p, bob);
    rename_room(&p);
    give_log(log, 2);
    end_task(take(ROOM_TASK_APPEND), ROOM_TASK_CONFLICT);
    give_log(log, 3);
    assert_null(take(ROOM_TASK_APPEND));
    assert_int_equal(p.error, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    assert_int_equal(ledger_total(server.ledger, LEDGER_DISK), 0);
    end();
}

static void a_room_that_is_deleted(void **unused)
{
    struct person p;
    struct entry log[] = {started(ann)};
    begin();
    come(&p, ann);
    sit_down(&p);
    give_log(log, 1);
    turn();
    changed_elsewhere();
    end_task(take(ROOM_TASK_LOAD), ROOM_TASK_MISSING);
    turn();
    assert_int_equal(p.error, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_int_equal(p.conn->n_request, 0);
    assert_int_equal(rooms.n_room, 0);
    end();
}

// This replica deletes a room that another one made, which was not charged here.
static void a_room_that_was_not_charged(void **unused)
{
    begin();
    give_back_room(&server, ann);
    assert_int_equal(ledger_total(server.ledger, LEDGER_ROOMS), 0);
    end();
}

// A copy of the rooms that takes long to make is not dropped meanwhile.
static void a_slow_copy_is_kept(void **unused)
{
    enum { KEPT_S = 60 }; // after its last use
    struct person p;
    Relight__RoomBackupRequest m = RELIGHT__ROOM_BACKUP_REQUEST__INIT;
    begin();
    come(&p, ann);
    ask(&p, RELIGHT_TYPE_ROOM_BACKUP, &m.base, op_room_backup);
    struct room_task *task = take(ROOM_TASK_BACKUP);
    assert_non_null(rooms.backups);
    let_pass(KEPT_S + 1);
    assert_non_null(rooms.backups);
    end_task(task, ROOM_TASK_FAILED);
    assert_null(rooms.backups);
    assert_int_equal(p.error, RELIGHT__ERROR_CODE__ERROR_INTERNAL);
    end();
}

// A snapshot has events that are in the log alone: one on its way may find its sequence taken
// by another replica's, and the store could not tell the two states apart.
static void a_snapshot_of_the_log_alone(void **unused)
{
    struct person p;
    struct entry log[ROOM_SNAPSHOT_EVENTS - 1] = {started(ann)};
    for (size_t i = 1; i < ROOM_SNAPSHOT_EVENTS - 1; i++)
        log[i] = renamed(ann, i % 2 ? theirs : mine);
    begin();
    store.shared = true;
    come(&p, ann);
    rename_room(&p);
    give_log(log, ROOM_SNAPSHOT_EVENTS - 1);
    rename_room(&p);
    end_task(take(ROOM_TASK_APPEND), ROOM_TASK_DONE);
    assert_null(take(ROOM_TASK_SNAPSHOT));
    end_task(take(ROOM_TASK_APPEND), ROOM_TASK_DONE);
    struct room_task *snapshot = take(ROOM_TASK_SNAPSHOT);
    assert_non_null(snapshot);
    assert_int_equal(snapshot->sequence, ROOM_SNAPSHOT_EVENTS + 1);
    end_task(snapshot, ROOM_TASK_DONE);
    assert_int_equal(p.error, 0);
    store.shared = false;
    end();
}

// All events of a room are given back with it, however many they were.
static void charges_add_up(void **unused)
{
    begin();
    for (int i = 0; i < 3; i++) {
        disk_charge(server.ledger, ann, 100);
        room_was_charged(&rooms, ann, 100);
    }
    room_give_back(&rooms, ann, 200);
    assert_int_equal(disk_bytes_of(server.ledger, ann), 100);
    room_give_back(&rooms, ann, 200); // more than is left
    assert_int_equal(disk_bytes_of(server.ledger, ann), 0);
    end();
}

static void give_owners(char *owner, uint64_t n, uint64_t bytes)
{
    struct room_task *task = take(ROOM_TASK_OWNERS);
    assert_non_null(task);
    task->row = calloc(1, sizeof *task->row);
    task->n_row = n ? 1 : 0;
    snprintf(task->row->by, sizeof task->row->by, "%s", owner);
    task->row->sequence = n;
    task->row->bytes = bytes;
    end_task(task, ROOM_TASK_DONE);
}

// What another replica makes and deletes counts for its owner here, too, but not while an event
// of this one is on its way.
static void rooms_of_others_are_counted(void **unused)
{
    struct person p;
    struct entry log[] = {started(ann)};
    begin();
    store.shared = true;
    holds_know(server.holds, true);
    rooms_maintain(&rooms);
    give_owners(ann, 2, 5000);
    assert_int_equal(ledger_total(server.ledger, LEDGER_ROOMS), 2);
    assert_int_equal(disk_bytes_of(server.ledger, ann), 5000);
    come(&p, ann);
    rename_room(&p);
    give_log(log, 1);
    uint64_t with_event = disk_bytes_of(server.ledger, ann);
    assert_true(with_event > 5000);
    rooms_maintain(&rooms);
    give_owners(ann, 1, 4000);
    assert_int_equal(disk_bytes_of(server.ledger, ann), with_event);
    end_task(take(ROOM_TASK_APPEND), ROOM_TASK_DONE);
    rooms_maintain(&rooms);
    give_owners(ann, 1, 4000);
    assert_int_equal(ledger_total(server.ledger, LEDGER_ROOMS), 1);
    assert_int_equal(disk_bytes_of(server.ledger, ann), 4000);
    rooms_maintain(&rooms);
    give_owners(ann, 0, 0);
    assert_int_equal(ledger_total(server.ledger, LEDGER_ROOMS), 0);
    assert_int_equal(disk_bytes_of(server.ledger, ann), 0);
    store.shared = false;
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_state_that_never_was),
        cmocka_unit_test(one_removed_elsewhere_leaves),
        cmocka_unit_test(a_role_that_was_lost),
        cmocka_unit_test(a_room_that_is_deleted),
        cmocka_unit_test(a_room_that_was_not_charged),
        cmocka_unit_test(a_slow_copy_is_kept),
        cmocka_unit_test(a_snapshot_of_the_log_alone),
        cmocka_unit_test(charges_add_up),
        cmocka_unit_test(rooms_of_others_are_counted),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
