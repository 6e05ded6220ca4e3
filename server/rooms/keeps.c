// SPDX-License-Identifier: MIT
// What a room needs of the disk (store/holds.h): the models and uploads of its pins, decisions,
// revisions, and, while it is open, of its scene and of what can be undone. It is written with
// the event that names something new, so that a start knows it without the states of the rooms.
#include "rooms/room_private.h"

#include "core/log.h"
#include "net/message_names.h"
#include "store/holds.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// ---- names in a state

struct names {
    char **name;
    size_t n, room;
    bool failed;
};

static void add_name(void *user, enum message_name kind, const char *name)
{
    struct names *names = user;
    if (!*name || strchr(name, '\n')) return;
    if (names->n == names->room) {
        size_t room = names->room ? names->room * 2 : 64;
        char **more = realloc(names->name, room * sizeof *more);
        if (!more) names->failed = true;
        if (!more) return;
        names->name = more;
        names->room = room;
    }
    names->name[names->n++] = (char *)(uintptr_t)name; // the message's
}

static int by_text(const void *a, const void *b)
{
    return strcmp(*(char *const *)a, *(char *const *)b);
}

// Each name once, in lines, as holds_set takes them. NULL without memory.
static char *join(struct names *names)
{
    size_t bytes = 2;
    for (size_t i = 0; i < names->n; i++) bytes += strlen(names->name[i]) + 1;
    char *text = names->failed ? NULL : calloc(1, bytes), *end = text;
    if (names->n) qsort(names->name, names->n, sizeof *names->name, by_text);
    for (size_t i = 0; text && i < names->n; i++) {
        if (i && !strcmp(names->name[i], names->name[i - 1])) continue;
        if (end == text) *end++ = '\n';
        end = stpcpy(end, names->name[i]);
        *end++ = '\n';
    }
    free(names->name);
    return text;
}

char *room_needs(const Relight__RoomState *s)
{
    struct names names = {0};
    for (size_t i = 0; i < s->n_revisions; i++)
        message_names(&s->revisions[i]->scene->base, add_name, &names);
    for (size_t i = 0; i < s->n_pins; i++)
        add_name(&names, NAME_MODEL, s->pins[i]->seen->model);
    for (size_t i = 0; i < s->n_decisions; i++)
        add_name(&names, NAME_MODEL, s->decisions[i]->seen->model);
    if (s->scene && !s->closed) message_names(&s->scene->base, add_name, &names);
    for (size_t i = 0; !s->closed && i < s->n_undo; i++)
        message_names(&s->undo[i]->other->base, add_name, &names);
    return join(&names);
}

// ---- a change

struct looking {
    const char *held;
    bool fresh;
};

static void look_for(void *user, enum message_name kind, const char *name)
{
    struct looking *looking = user;
    if (*name && !holds_among(looking->held, name)) looking->fresh = true;
}

bool room_new_needs(const struct room *room, const Relight__RoomEvent *event, char **out)
{
    struct holds *holds = room->rooms->server->holds;
    struct looking looking = {.held = holds_of(holds, room->id)};
    *out = NULL;
    message_names(&event->base, look_for, &looking);
    bool first = event->action->start != NULL;
    if (!looking.fresh && !first && !event->action->close) return true;
    char *needs = room_needs(room->state);
    if (!needs) return false;
    if (!first && !strcmp(needs, looking.held)) {
        free(needs);
        return true;
    }
    holds_set(holds, room->id, needs);
    *out = needs;
    return true;
}

// ---- a room that was read

struct setting {
    struct room_task task; // first
    char *keeps;
};

static void was_set(struct room_task *task)
{
    struct setting *s = (struct setting *)task;
    if (task->status == ROOM_TASK_FAILED) // the next time that it is read
        log_line(LOG_WARN, "room=%s: what it needs could not be written: %s", task->room,
                 task->error);
    free(s->keeps);
    free(s);
}

static void write_needs(struct rooms *rooms, const char *room, uint64_t sequence, char *keeps)
{
    struct setting *s = calloc(1, sizeof *s);
    if (!s) {
        free(keeps);
        return;
    }
    s->keeps = keeps;
    s->task = (struct room_task){
        .kind = ROOM_TASK_SET_KEEPS, .sequence = sequence, .keeps = keeps, .done = was_set};
    snprintf(s->task.room, sizeof s->task.room, "%s", room);
    rooms->store->api->submit(rooms->store, &s->task);
}

void room_set_needs(struct rooms *rooms, const Relight__RoomState *state, bool write)
{
    struct holds *holds = rooms->server->holds;
    char *needs = room_needs(state);
    if (!needs) {
        holds_know(holds, false);
        return;
    }
    write |= strcmp(needs, holds_of(holds, state->room)) != 0;
    holds_set(holds, state->room, needs);
    if (write) write_needs(rooms, state->room, state->sequence, needs);
    else free(needs);
}

// ---- what the store has

struct keeps_reading {
    struct room_task task; // first
    struct room_task load; // of the room that has no names yet
    struct rooms *rooms;
    size_t at;
    bool all; // of all rooms
};

static bool is_there(void *user, const char *room)
{
    const struct keeps_reading *r = user;
    if (room_in_memory(r->rooms, room)) return true;
    for (size_t i = 0; i < r->task.n_row; i++)
        if (!strcmp(r->task.row[i].room, room)) return true;
    return false;
}

static void finish_reading(struct keeps_reading *r, bool good)
{
    struct rooms *rooms = r->rooms;
    struct holds *holds = rooms->server->holds;
    bool again = !r->all && !good;
    if (r->all) {
        rooms->reading_keeps = false;
        again = rooms->keeps_again;
        if (good) holds_retain(holds, is_there, r);
        holds_know(holds, good); // else rooms_maintain reads them again
    }
    room_task_finish(&r->task);
    free(r);
    if (again && !rooms->stopping) rooms_read_keeps(rooms);
}

static void take_next(struct keeps_reading *r);

static void state_read(struct room_task *task)
{
    struct keeps_reading *r =
        (struct keeps_reading *)((char *)task - offsetof(struct keeps_reading, load));
    char error[ROOM_ERROR];
    bool there = task->status == ROOM_TASK_DONE, failed = task->status == ROOM_TASK_FAILED;
    Relight__RoomState *state = NULL;
    int code = there ? room_fold_stored(task->room, task, &state, error) : 0;
    if (state) room_set_needs(r->rooms, state, true);
    if (code == RELIGHT__ERROR_CODE__ERROR_NO_MEMORY) failed = true; // it is read again
    else if (code)
        log_line(LOG_ERR, "room=%s: %s: what it needs is not kept on the disk", task->room,
                 error);
    room_state_free(state);
    room_task_finish(task);
    if (failed) finish_reading(r, false);
    else take_next(r);
}

// Rooms that an earlier version wrote are read one after another, once.
static void take_next(struct keeps_reading *r)
{
    struct rooms *rooms = r->rooms;
    while (r->at < r->task.n_row && !rooms->stopping) {
        const struct room_row *row = &r->task.row[r->at++];
        const struct room *room = room_in_memory(rooms, row->room);
        if (room && room->state) continue; // it knows better
        if (row->keeps) {
            holds_set(rooms->server->holds, row->room, row->keeps);
            continue;
        }
        r->load = (struct room_task){.kind = ROOM_TASK_LOAD, .done = state_read};
        snprintf(r->load.room, sizeof r->load.room, "%s", row->room);
        rooms->store->api->submit(rooms->store, &r->load);
        return;
    }
    finish_reading(r, !rooms->stopping);
}

static void keeps_read(struct room_task *task)
{
    struct keeps_reading *r = (struct keeps_reading *)task;
    bool good = task->status == ROOM_TASK_DONE;
    if (good && task->room[0] && !task->n_row) // it was deleted
        holds_set(r->rooms->server->holds, task->room, "");
    if (good) take_next(r);
    else finish_reading(r, false);
}

static bool read_keeps(struct rooms *rooms, const char *room)
{
    struct keeps_reading *r = calloc(1, sizeof *r);
    if (!r) return false;
    r->rooms = rooms;
    r->all = !*room;
    r->task = (struct room_task){.kind = ROOM_TASK_KEEPS, .done = keeps_read};
    snprintf(r->task.room, sizeof r->task.room, "%s", room);
    rooms->store->api->submit(rooms->store, &r->task);
    return true;
}

void rooms_read_keeps(struct rooms *rooms)
{
    rooms->keeps_again = rooms->reading_keeps;
    if (rooms->reading_keeps) return;
    rooms->reading_keeps = read_keeps(rooms, "");
    if (!rooms->reading_keeps) holds_know(rooms->server->holds, false);
}

void room_keeps_changed(struct rooms *rooms, const char *room)
{
    const struct room *here = room_in_memory(rooms, room);
    if (here && here->state) return; // this replica wrote it, or reads it again just now
    if (!read_keeps(rooms, room)) holds_know(rooms->server->holds, false);
}
