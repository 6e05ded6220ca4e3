// SPDX-License-Identifier: MIT
// Requests about review rooms.
#include "messages.h"

#include "../unit/room_actions.h"
#include "frame.h"

static char *any_room(struct world *world)
{
    struct rnd *r = world->rnd;
    if (!world->n_room || rnd_chance(r, 20))
        return rnd_chance(r, 2) ? "00000000000000000000000000000000" : "no room";
    return world->room[rnd(r, world->n_room)];
}

static void edit(struct world *world, uint64_t id, struct bytes *out)
{
    static char *const clients[] = {"", "", "00112233445566aa", "00112233445566ab", "short"};
    struct rnd *r = world->rnd;
    Relight__RoomEditRequest in = RELIGHT__ROOM_EDIT_REQUEST__INIT;
    struct room_act act;
    act_random(&act, r, 40);
    if (rnd_chance(r, 20)) act_start(&act, r);
    in.room = any_room(world);
    in.action = rnd_chance(r, 40) ? NULL : &act.action;
    in.name = rnd_chance(r, 2) ? "Ann" : "";
    in.client = RND_PICK(r, clients);
    in.number = rnd(r, 30);
    message_emit(world, RELIGHT_TYPE_ROOM_EDIT, id, &in.base, NULL, 0, out);
}

static void presence(struct world *world, uint64_t id, uint64_t other, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__RoomPresenceRequest in = RELIGHT__ROOM_PRESENCE_REQUEST__INIT;
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    Relight__SurfacePoint at;
    act_point(&at, r);
    me.name = "Ann";
    me.cursor = &at;
    me.follows = rnd(r, 4);
    in.subscription = other;
    in.me = rnd_chance(r, 10) ? NULL : &me;
    message_emit(world, RELIGHT_TYPE_ROOM_PRESENCE, rnd_chance(r, 30) ? id : 0, &in.base, NULL,
                 0, out);
}

static void sit(struct world *world, uint64_t id, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    in.room = any_room(world);
    in.after = rnd_chance(r, 2) ? 0 : rnd(r, 60);
    in.me = rnd_chance(r, 3) ? NULL : &me;
    message_emit(world, RELIGHT_TYPE_SUBSCRIBE, id, &in.base, NULL, 0, out);
}

static void create(struct world *world, uint64_t id, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__RoomCreateRequest in = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    struct room_act act;
    memset(&act, 0, sizeof act);
    act_scene(&act, r);
    in.name = rnd_chance(r, 12) ? "" : "room";
    in.scene = rnd_chance(r, 3) ? &act.scene : NULL;
    message_emit(world, RELIGHT_TYPE_ROOM_CREATE, id, &in.base, NULL, 0, out);
}

static void read_room(struct world *world, uint16_t type, uint64_t id, struct bytes *out)
{
    struct rnd *r = world->rnd;
    Relight__RoomGetRequest get = RELIGHT__ROOM_GET_REQUEST__INIT;
    Relight__RoomPictureRequest picture = RELIGHT__ROOM_PICTURE_REQUEST__INIT;
    get.room = picture.room = any_room(world);
    get.events = rnd_chance(r, 2);
    get.after = rnd(r, 50);
    if (rnd_chance(r, 2)) picture.revision = rnd(r, 4);
    if (rnd_chance(r, 3)) picture.pin = rnd(r, 40);
    picture.width = picture.height = 16;
    message_emit(world, type, id, type == RELIGHT_TYPE_ROOM_GET ? &get.base : &picture.base,
                 NULL, 0, out);
}

void message_room(struct world *world, uint16_t type, uint64_t id, uint64_t other,
                  struct bytes *out)
{
    Relight__RoomListRequest list = RELIGHT__ROOM_LIST_REQUEST__INIT;
    Relight__RoomBackupRequest backup = RELIGHT__ROOM_BACKUP_REQUEST__INIT;
    Relight__MaterialRequest material = RELIGHT__MATERIAL_REQUEST__INIT;
    switch (type) {
    case RELIGHT_TYPE_ROOM_CREATE:
        create(world, id, out);
        break;
    case RELIGHT_TYPE_ROOM_EDIT:
        edit(world, id, out);
        break;
    case RELIGHT_TYPE_ROOM_PRESENCE:
        presence(world, id, other, out);
        break;
    case RELIGHT_TYPE_ROOM_GET:
    case RELIGHT_TYPE_ROOM_PICTURE:
        read_room(world, type, id, out);
        break;
    case RELIGHT_TYPE_SUBSCRIBE:
        sit(world, id, out);
        break;
    case RELIGHT_TYPE_ROOM_LIST:
        message_emit(world, type, id, &list.base, NULL, 0, out);
        break;
    case RELIGHT_TYPE_ROOM_BACKUP:
        if (rnd_chance(world->rnd, 3)) backup.backup = "0123";
        message_emit(world, type, id, &backup.base, NULL, 0, out);
        break;
    case RELIGHT_TYPE_MATERIAL:
        material.material = rnd_chance(world->rnd, 2) ? "marble" : "{\"profile\":\"none\"}";
        message_emit(world, type, id, &material.base, NULL, 0, out);
        break;
    }
}
