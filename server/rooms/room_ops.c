// SPDX-License-Identifier: MIT
// ROOM_CREATE, ROOM_LIST, ROOM_GET, ROOM_EDIT and ROOM_PICTURE.
#include "rooms/room_private.h"

#include "core/ledger.h"
#include "net/dispatch.h"
#include "render/shared/materials.h"
#include "render/shared/pose_files.h"
#include "rooms/state.h"

#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

#define MESSAGE(type) ((const Relight__##type *)request->message)
enum { MOST_LISTED = 1000 };

// ---- ROOM_CREATE

void give_back_room(struct server *server, const char *name)
{
    struct principal *p = ledger_principal(server->ledger, name);
    // Another replica may have made the room: it was not charged here.
    if (p && p->held[LEDGER_ROOMS]) ledger_give(p, LEDGER_ROOMS, 1);
    principal_release(p);
}

static void create(struct request *request, const Relight__RoomAction *action)
{
    struct rooms *rooms = request->server->rooms;
    char id[ROOM_ID + 1];
    uint8_t random[ROOM_ID / 2];
    randombytes_buf(random, sizeof random);
    sodium_bin2hex(id, sizeof id, random, sizeof random);
    Relight__RoomState *state = room_state_new(id);
    struct room *room = state ? room_add(rooms, id) : NULL;
    if (!room) {
        room_state_free(state);
        give_back_room(request->server, request->conn->caller.name);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    room->state = state;
    snprintf(room->owner, sizeof room->owner, "%s", request->conn->caller.name);
    room_hold(room);
    room_edit(request, room, action, RELIGHT__ROOM_ROLE__ROLE_OWNER);
    if (!room->n_edit) give_back_room(rooms->server, room->owner); // it was refused
    room_release(room);
}

static void create_room(struct request *request)
{
    const Relight__RoomCreateRequest *in = MESSAGE(RoomCreateRequest);
    char error[256];
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__RoomStart start = RELIGHT__ROOM_START__INIT;
    if (ledger_take(request->principal, LEDGER_ROOMS, 1, error)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_LIMIT, "%s", error);
        return;
    }
    start.name = in->name;
    start.scene = in->scene;
    action.start = &start;
    create(request, &action);
}

void op_room_create(struct request *request)
{
    poses_keep_then(request, create_room);
}

// ---- ROOM_LIST

struct listing {
    struct request_wait wait; // first
    struct room_task task;
};

static void fill_summary(struct rooms *rooms, const struct caller *caller,
                         const struct room_row *row, Relight__RoomSummary *out)
{
    relight__room_summary__init(out);
    bool all = (caller->scopes & SCOPE_ADMIN) && !is_guest(caller->name);
    bool looks_only = !(caller->scopes & SCOPE_EDIT) && !is_guest(caller->name);
    out->room = (char *)row->room;
    out->name = (char *)row->name;
    out->role = all ? RELIGHT__ROOM_ROLE__ROLE_OWNER : (Relight__RoomRole)row->role;
    if (looks_only && out->role > RELIGHT__ROOM_ROLE__ROLE_VIEWER)
        out->role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    out->sequence = row->sequence;
    out->created_us = row->created_us;
    out->changed_us = row->changed_us;
    out->closed = row->closed;
    const struct room *room = room_in_memory(rooms, row->room);
    out->present = room ? seats_count(room) : 0;
}

static void answer_list(struct request *request, const struct room_task *task)
{
    Relight__RoomListAnswer out = RELIGHT__ROOM_LIST_ANSWER__INIT;
    size_t n = task->n_row < MOST_LISTED ? task->n_row : MOST_LISTED;
    Relight__RoomSummary *room = calloc(task->n_row + 1, sizeof *room);
    Relight__RoomSummary **list = calloc(task->n_row + 1, sizeof *list);
    for (size_t i = 0; room && list && i < n; i++) {
        fill_summary(request->server->rooms, &request->conn->caller, &task->row[i], &room[i]);
        list[out.n_rooms++] = &room[i];
    }
    out.rooms = list;
    out.more = task->n_row > n;
    if (room && list) request_answer(request, &out.base, NULL);
    else request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    free(room);
    free(list);
}

static void listed(struct room_task *task)
{
    struct listing *l = (struct listing *)((char *)task - offsetof(struct listing, task));
    struct request *request = request_resume(&l->wait);
    if (request && task->status == ROOM_TASK_DONE) answer_list(request, task);
    else if (request)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY, "the rooms could not be read");
    room_task_finish(task);
    free(l);
}

// A guest's list is the room that he was invited to.
static void list_for_guest(struct request *request, struct room *room)
{
    struct room_row row = {.role = caller_role(request, room),
                           .sequence = room->committed,
                           .created_us = room->state->created->time_us,
                           .changed_us = room->state->changed_us,
                           .closed = room->state->closed};
    struct room_task task = {.row = &row, .n_row = 1};
    snprintf(row.room, sizeof row.room, "%s", room->id);
    snprintf(row.name, sizeof row.name, "%s", room->state->name);
    answer_list(request, &task);
}

void op_room_list(struct request *request)
{
    const struct caller *caller = &request->conn->caller;
    struct rooms *rooms = request->server->rooms;
    if (is_guest(caller->name)) {
        const char *room = guests_room(&rooms->guests, caller->name);
        with_room(request, room ? room : "", list_for_guest);
        return;
    }
    struct listing *l = calloc(1, sizeof *l);
    if (!l) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    l->task.kind = ROOM_TASK_LIST;
    l->task.most = MOST_LISTED + 1; // one more tells that there are more
    l->task.done = listed;
    if (!(caller->scopes & SCOPE_ADMIN))
        snprintf(l->task.by, sizeof l->task.by, "%s", caller->name);
    request_park(request, &l->wait);
    rooms->store->api->submit(rooms->store, &l->task);
}

// ---- ROOM_GET

struct reading {
    struct request_wait wait; // first
    struct room_task task;
    struct room *room;
};

static void answer_events(struct request *request, struct room *room,
                          const struct room_task *task)
{
    Relight__RoomGetAnswer out = RELIGHT__ROOM_GET_ANSWER__INIT;
    size_t most = 1, n = 0;
    for (size_t i = 0; i < task->n_event; i++) most += events_room(task->event[i].n);
    uint8_t *bytes = malloc(most);
    for (size_t i = 0; bytes && i < task->n_event; i++) {
        const struct room_event_bytes *e = &task->event[i];
        n += events_put(bytes + n, e->bytes, e->n);
        out.last = e->sequence;
    }
    if (!bytes) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    struct payload payload = payload_of(bytes, n);
    out.sequence = room->committed;
    out.role = (Relight__RoomRole)(room->state ? caller_role(request, room) : 0);
    request_answer(request, &out.base, &payload);
}

static void events_read(struct room_task *task)
{
    struct reading *r = (struct reading *)((char *)task - offsetof(struct reading, task));
    struct request *request = request_resume(&r->wait);
    if (request && task->status == ROOM_TASK_DONE) answer_events(request, r->room, task);
    else if (request)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY, "the room could not be read");
    room_task_finish(task);
    room_release(r->room);
    free(r);
}

// A packed state with events that are not on the disk yet: it is answered once they are.
struct reader {
    struct request_wait wait; // first
    struct reader *next;
    Relight__RoomGetAnswer out;
    char hash[65];
    struct shared_bytes *state;
};

static void reader_end(struct reader *reader, bool there)
{
    struct request *request = request_resume(&reader->wait);
    if (request && there) {
        struct payload payload = shared_payload(reader->state);
        reader->state = NULL;
        request_answer(request, &reader->out.base, &payload);
    } else if (request) {
        request->retry_ms = 50;
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BUSY, "the room is being read again");
    }
    shared_release(reader->state);
    free(reader);
}

void readers_check(struct room *room)
{
    for (struct reader **at = &room->readers, *r; (r = *at);) {
        bool there = r->out.sequence <= room->committed;
        if (!there && !room->stale) {
            at = &r->next;
            continue;
        }
        *at = r->next;
        reader_end(r, there);
    }
}

static void get_state(struct request *request, struct room *room)
{
    struct reader *r = calloc(1, sizeof *r);
    if (!r || !(r->state = room_packed(room))) {
        free(r);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    relight__room_get_answer__init(&r->out);
    snprintf(r->hash, sizeof r->hash, "%s", room_packed_hash(room));
    r->out.sequence = room->state->sequence;
    r->out.hash = r->hash;
    r->out.role = (Relight__RoomRole)caller_role(request, room);
    request_park(request, &r->wait);
    r->next = room->readers;
    room->readers = r;
    readers_check(room);
}

static void get(struct request *request, struct room *room)
{
    const Relight__RoomGetRequest *in = MESSAGE(RoomGetRequest);
    if (!in->events) {
        get_state(request, room);
        return;
    }
    struct reading *r = calloc(1, sizeof *r);
    if (!r) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    r->room = room;
    r->task.kind = ROOM_TASK_EVENTS;
    r->task.sequence = in->after;
    r->task.most = ROOM_ANSWER;
    r->task.done = events_read;
    snprintf(r->task.room, sizeof r->task.room, "%s", room->id);
    room_hold(room);
    request_park(request, &r->wait);
    room->rooms->store->api->submit(room->rooms->store, &r->task);
}

void op_room_get(struct request *request)
{
    with_room(request, MESSAGE(RoomGetRequest)->room, get);
}

// ---- ROOM_EDIT

// The same action, with the scene and what was seen of it.
static void edit_seen(struct request *request, struct room *room, Relight__Scene *scene,
                      const Relight__Seen *seen)
{
    Relight__RoomAction action = *MESSAGE(RoomEditRequest)->action;
    Relight__PutPin pin;
    Relight__Decide decide;
    if (action.pin) {
        pin = *action.pin;
        pin.seen = (Relight__Seen *)(uintptr_t)seen;
        pin.scene = scene;
        action.pin = &pin;
    } else {
        decide = *action.decide;
        decide.seen = (Relight__Seen *)(uintptr_t)seen;
        decide.scene = scene;
        action.decide = &decide;
    }
    room_edit(request, room, &action, caller_role(request, room));
}

// What a pin or a decision is about; NULL: the action is neither.
static const Relight__Scene *scene_of(const Relight__RoomAction *action,
                                      const struct room *room)
{
    const Relight__Scene *own = action->pin      ? action->pin->scene
                                : action->decide ? action->decide->scene
                                                 : NULL;
    if (!action->pin && !action->decide) return NULL;
    return own ? own : room->state->scene;
}

static void look_and_edit(struct request *request, struct room *room)
{
    find_seen(request, room, scene_of(MESSAGE(RoomEditRequest)->action, room), edit_seen);
}

static void edit_fetched(struct request *request)
{
    with_room(request, MESSAGE(RoomEditRequest)->room, look_and_edit);
}

static void edit(struct request *request, struct room *room)
{
    const Relight__RoomAction *action = MESSAGE(RoomEditRequest)->action;
    int role = caller_role(request, room);
    bool reviews = role >= RELIGHT__ROOM_ROLE__ROLE_REVIEWER;
    bool looks = action && (action->pin || action->decide) && reviews;
    const Relight__Scene *scene = looks ? scene_of(action, room) : NULL;
    if (!action || action->start)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "the request has no action, or one that creates a room");
    else if (scene) fetch_scene_then(request, &scene->base, edit_fetched);
    else if (looks) look_and_edit(request, room); // says that there is none
    else room_edit(request, room, action, role);
}

static void edit_room(struct request *request)
{
    with_room(request, MESSAGE(RoomEditRequest)->room, edit);
}

// The poses of scenes are on the disk before the room names them. A retry needs neither them
// nor a model: they may be gone since.
static void keep_and_edit(struct request *request, struct room *room)
{
    if (room_edit_repeated(request, room)) return;
    if (caller_role(request, room) >= RELIGHT__ROOM_ROLE__ROLE_REVIEWER)
        poses_keep_then(request, edit_room);
    else edit(request, room);
}

void op_room_edit(struct request *request)
{
    with_room(request, MESSAGE(RoomEditRequest)->room, keep_and_edit);
}

// ---- ROOM_PICTURE

static const Relight__Scene *find_scene(const Relight__RoomState *state,
                                        const Relight__RoomPictureRequest *in,
                                        const Relight__Seen **seen)
{
    const Relight__Pin *pin = in->pin ? room_pin(state, in->pin) : NULL;
    const Relight__Decision *decision =
        in->decision ? room_decision(state, in->decision) : NULL;
    *seen = pin ? pin->seen : decision ? decision->seen : NULL;
    if (!in->pin && !in->decision && !in->revision) return state->scene;
    const Relight__Revision *revision =
        room_revision(state, *seen ? (*seen)->revision : in->revision);
    bool missing = (in->pin && !pin) || (in->decision && !decision);
    return revision && !missing ? revision->scene : NULL;
}

// The IMAGE request of a scene; the engine that was seen draws it. Without one the engine is
// chosen when the model is here.
static ProtobufCMessage *image_of(const Relight__Scene *scene, const Relight__Seen *seen,
                                  const Relight__RoomPictureRequest *in)
{
    Relight__ImageRequest out = RELIGHT__IMAGE_REQUEST__INIT;
    Relight__Shade shade = RELIGHT__SHADE__INIT;
    Relight__Picture picture = RELIGHT__PICTURE__INIT;
    if (scene->shade) shade = *scene->shade;
    if (scene->picture) picture = *scene->picture;
    shade.material = scene->material;
    shade.budget_ms = 0; // a picture that was cut short is not the same again
    if (seen && seen->engine) shade.engine = seen->engine;
    picture.camera = scene->camera;
    picture.format = in->format == RELIGHT__IMAGE_FORMAT__IMAGE_JPEG
                         ? RELIGHT__IMAGE_FORMAT__IMAGE_PNG16
                         : in->format;
    if (in->width) picture.width = in->width;
    if (in->height) picture.height = in->height;
    out.model = scene->model;
    out.pose = scene->pose;
    out.lights = scene->lights;
    out.n_lights = scene->n_lights;
    out.shade = &shade;
    out.picture = &picture;
    return message_copy(&out);
}

static void draw(struct request *request)
{
    const Relight__ImageRequest *image = MESSAGE(ImageRequest);
    struct material_texts texts = {.n = 0};
    image->shade->engine = engine_for(request->server, image->model, image->shade);
    material_texts_of_shade(&texts, image->shade);
    material_then(request, &texts, false, op_image);
}

static void picture(struct request *request, struct room *room)
{
    const Relight__RoomPictureRequest *in = MESSAGE(RoomPictureRequest);
    const Relight__Seen *seen;
    const Relight__Scene *scene = find_scene(room->state, in, &seen);
    request->hint = room_state_hint;
    if (!scene) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "the room has no such pin, decision or revision");
        return;
    }
    if (!*scene->model) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                     "the scene has no model: set it first");
        return;
    }
    ProtobufCMessage *image = image_of(scene, seen, in);
    if (!image) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    request->hint = NULL;
    protobuf_c_message_free_unpacked(request->message, NULL);
    request->message = image;
    fetch_scene_then(request, image, draw);
}

void op_room_picture(struct request *request)
{
    with_room(request, MESSAGE(RoomPictureRequest)->room, picture);
}
