// SPDX-License-Identifier: MIT
// A room's state as the store has it: snapshots, and the events after them.
#include "rooms/room_private.h"

#include "core/log.h"

#include "relight.pb-c.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct snapshot {
    struct room_task task;
    uint8_t *bytes;
};

static void snapshot_written(struct room_task *task)
{
    struct snapshot *s = (struct snapshot *)task;
    if (task->status == ROOM_TASK_FAILED)
        log_line(LOG_WARN, "room=%s: its snapshot could not be written: %s", task->room,
                 task->error);
    free(s->bytes);
    free(s);
}

void room_write_snapshot(struct room *room)
{
    struct snapshot *s = calloc(1, sizeof *s);
    size_t n = protobuf_c_message_get_packed_size(&room->state->base);
    if (!s || !(s->bytes = malloc(n + 1))) {
        free(s);
        return; // the log is enough
    }
    protobuf_c_message_pack(&room->state->base, s->bytes);
    s->task.kind = ROOM_TASK_SNAPSHOT;
    snprintf(s->task.room, sizeof s->task.room, "%s", room->id);
    s->task.sequence = room->snapshot = room->state->sequence;
    s->task.bytes = s->bytes;
    s->task.n = n;
    s->task.done = snapshot_written;
    room->rooms->store->api->submit(room->rooms->store, &s->task);
}

// protobuf-c tells damage and want of memory alike: *user becomes true for the latter.
static void *noting_alloc(void *user, size_t n)
{
    void *p = malloc(n);
    if (!p) *(bool *)user = true;
    return p;
}

static void noting_free(void *user, void *p)
{
    free(p);
}

static int fold_stored(Relight__RoomState *state, const struct room_event_bytes *e,
                       ProtobufCAllocator *allocator, char error[ROOM_ERROR])
{
    Relight__RoomEvent *event = relight__room_event__unpack(allocator, e->n, e->bytes);
    snprintf(error, ROOM_ERROR, "event %llu is damaged", (unsigned long long)e->sequence);
    int code = event ? room_fold(state, event, error) : RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    if (event) relight__room_event__free_unpacked(event, NULL);
    return code;
}

int room_fold_stored(const char *room, const struct room_task *task, Relight__RoomState **out,
                     char error[ROOM_ERROR])
{
    bool no_memory = false;
    ProtobufCAllocator allocator = {noting_alloc, noting_free, &no_memory};
    int code = 0;
    *out = task->snapshot
               ? relight__room_state__unpack(&allocator, task->n_snapshot, task->snapshot)
               : room_state_new(room);
    if (!*out && !task->snapshot) no_memory = true;
    if (!*out || (*out)->sequence != task->sequence || strcmp((*out)->room, room)) {
        snprintf(error, ROOM_ERROR, "its snapshot is damaged");
        code = RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    }
    for (size_t i = 0; i < task->n_event && !code; i++)
        code = fold_stored(*out, &task->event[i], &allocator, error);
    if (!code) return 0;
    room_state_free(*out);
    *out = NULL;
    if (!no_memory && code != RELIGHT__ERROR_CODE__ERROR_NO_MEMORY)
        return RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    snprintf(error, ROOM_ERROR, "not enough memory to read the room");
    return RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
}
