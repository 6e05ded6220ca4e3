// SPDX-License-Identifier: MIT
// A request that needs a room: reading it, and what its caller may do there.
#include "rooms/room_private.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

struct call {
    struct request_wait wait; // first
    struct room_waiter waiter;
    with_room_fn fn;
    char id[ROOM_ID + 1];
};

int caller_role(const struct request *request, const struct room *room)
{
    const struct caller *caller = &request->conn->caller;
    int role = room_role(room->state, caller->name, time(NULL));
    if (is_guest(caller->name)) return role; // the invitation's own
    if (caller->scopes & SCOPE_ADMIN) return RELIGHT__ROOM_ROLE__ROLE_OWNER;
    bool looks_only = !(caller->scopes & SCOPE_EDIT);
    return looks_only && role > RELIGHT__ROOM_ROLE__ROLE_VIEWER
               ? RELIGHT__ROOM_ROLE__ROLE_VIEWER
               : role;
}

void no_such_room(struct request *request, const char *id)
{
    request->hint = "`relight room list` lists your rooms";
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                 "%.40s: no such room, or you are no member of it", id);
}

static void there(struct room_waiter *waiter, struct room *room, int code, const char *error)
{
    struct call *call = (struct call *)((char *)waiter - offsetof(struct call, waiter));
    struct request *request = request_resume(&call->wait);
    if (request && room && caller_role(request, room)) call->fn(request, room);
    else if (request && (room || code == RELIGHT__ERROR_CODE__ERROR_NOT_FOUND))
        no_such_room(request, call->id);
    else if (request) request_fail(request, code, "%s", error);
    free(call);
}

void with_room(struct request *request, const char *id, with_room_fn fn)
{
    if (strlen(id) != ROOM_ID || strspn(id, "0123456789abcdef") != ROOM_ID) {
        no_such_room(request, id);
        return;
    }
    struct call *call = calloc(1, sizeof *call);
    if (!call) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    call->fn = fn;
    call->waiter.then = there;
    snprintf(call->id, sizeof call->id, "%s", id);
    request_park(request, &call->wait);
    room_use(request->server->rooms, id, &call->waiter);
}

struct payload payload_of(void *bytes, size_t n)
{
    return (struct payload){.bytes = bytes, .size = n, .owner = bytes, .release = free};
}
