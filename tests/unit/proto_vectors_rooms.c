// SPDX-License-Identifier: MIT
// A review room in the vectors: it is made, read, edited, drawn and left.
#include "proto_vectors.h"

enum { LAST = RELIGHT_FRAME_LAST, ANSWER = RELIGHT_TYPE_ANSWER };
static char room[] = "0123456789abcdef0123456789abcdef";
static uint8_t payload[512];

// The scene that all of them have: one light, turned.
static Relight__Scene *small_scene(void)
{
    static Relight__Scene scene;
    static Relight__Light light, *lights[] = {&light};
    static Relight__Camera camera;
    static Relight__Orbit orbit;
    relight__scene__init(&scene);
    relight__light__init(&light);
    relight__camera__init(&camera);
    relight__orbit__init(&orbit);
    light.env = "constant:1,0.5,0.25";
    light.rotate_deg = 30;
    orbit.azimuth_deg = 45;
    orbit.zoom = 1;
    camera.orbit = &orbit;
    scene.model = "3f9ad2c1";
    scene.n_lights = 1;
    scene.lights = lights;
    scene.camera = &camera;
    return &scene;
}

static unsigned add_create(struct vector *out, unsigned n)
{
    static Relight__RoomCreateRequest ask;
    static Relight__RoomCreateAnswer made;
    relight__room_create_request__init(&ask);
    relight__room_create_answer__init(&made);
    ask.name = "Bunny in jade";
    ask.me = "Ann";
    ask.scene = small_scene();
    made.room = room;
    made.sequence = 1;
    return vector_exchange(out, n, "room_create", 28, 30, "C: ROOM_CREATE", &ask.base,
                           "S: ROOM_CREATE", &made.base);
}

static unsigned add_list(struct vector *out, unsigned n)
{
    static Relight__RoomListRequest ask;
    static Relight__RoomListAnswer list;
    static Relight__RoomSummary one, *all[] = {&one};
    relight__room_list_request__init(&ask);
    relight__room_list_answer__init(&list);
    relight__room_summary__init(&one);
    one.room = room;
    one.name = "Bunny in jade";
    one.role = RELIGHT__ROOM_ROLE__ROLE_OWNER;
    one.sequence = 2;
    one.created_us = 1700000000000000;
    one.changed_us = 1700000001000000;
    one.present = 1;
    list.n_rooms = 1;
    list.rooms = all;
    return vector_exchange(out, n, "room_list", 29, 31, "C: ROOM_LIST", &ask.base,
                           "S: ROOM_LIST", &list.base);
}

// A turn of the light, with the number that makes a retry safe.
static unsigned add_edit(struct vector *out, unsigned n)
{
    static Relight__RoomEditRequest ask;
    static Relight__RoomEditAnswer done;
    static Relight__RoomAction action;
    static Relight__SceneChange change;
    static char *parts[] = {"lights"};
    relight__room_edit_request__init(&ask);
    relight__room_edit_answer__init(&done);
    relight__room_action__init(&action);
    relight__scene_change__init(&change);
    change.scene = small_scene();
    change.n_parts = 1;
    change.parts = parts;
    action.scene = &change;
    ask.room = room;
    ask.action = &action;
    ask.name = "Ann";
    ask.client = "00112233445566aa";
    ask.number = 7;
    done.sequence = 2;
    done.time_us = 1700000001000000;
    return vector_exchange(out, n, "room_edit", 31, 32,
                           "C: ROOM_EDIT: the lights, edit 7 of its client", &ask.base,
                           "S: ROOM_EDIT, once it is on the disk", &done.base);
}

// A decision about a picture that was made from this bake.
static unsigned add_decide(struct vector *out, unsigned n)
{
    static Relight__RoomEditRequest ask;
    static Relight__RoomAction action;
    static Relight__Decide decide;
    static Relight__Drawn drawn;
    relight__room_edit_request__init(&ask);
    relight__room_action__init(&action);
    relight__decide__init(&decide);
    relight__drawn__init(&drawn);
    drawn.mesh_hash = "00112233445566aa";
    drawn.bake_hash = "8899aabbccddeeff";
    decide.approve = true;
    decide.note = "as agreed";
    decide.scene = small_scene();
    decide.drawn = &drawn;
    action.decide = &decide;
    ask.room = room;
    ask.action = &action;
    ask.name = "Ann";
    return vector_add(out, n, "room_decide", "C: ROOM_EDIT: a decision about this bake alone",
                      31, LAST, 37, &ask.base, NULL, 0);
}

// The events after the first: that edit alone.
static unsigned add_get(struct vector *out, unsigned n)
{
    static Relight__RoomGetRequest ask;
    static Relight__RoomGetAnswer answer;
    Relight__RoomEvents events = RELIGHT__ROOM_EVENTS__INIT;
    Relight__RoomEvent event = RELIGHT__ROOM_EVENT__INIT, *list[] = {&event};
    Relight__Stamp stamp = RELIGHT__STAMP__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__SaveRevision save = RELIGHT__SAVE_REVISION__INIT;
    relight__room_get_request__init(&ask);
    relight__room_get_answer__init(&answer);
    ask.room = room;
    ask.events = true;
    ask.after = 1;
    stamp.sequence = 2;
    stamp.time_us = 1700000001000000;
    stamp.by = "token:anna";
    stamp.name = "Ann";
    save.note = "as agreed";
    action.save = &save;
    event.stamp = &stamp;
    event.role = RELIGHT__ROOM_ROLE__ROLE_OWNER;
    event.action = &action;
    events.n_events = 1;
    events.events = list;
    size_t size = relight__room_events__pack(&events, payload);
    answer.sequence = 2;
    answer.hash = "e3b0c44298fc1c149afbf4c8996fb92427ae41e4649b934ca495991b7852b855";
    answer.role = RELIGHT__ROOM_ROLE__ROLE_OWNER;
    answer.last = 2;
    n = vector_add(out, n, "room_get", "C: ROOM_GET, events after 1", 30, LAST, 33, &ask.base,
                   NULL, 0);
    return vector_add(out, n, "room_get_answer", "S: ROOM_GET, RoomEvents: save", 30 | ANSWER,
                      LAST, 33, &answer.base, payload, size);
}

// The model of the room, with the hashes that tell what a decision was about.
static unsigned add_info(struct vector *out, unsigned n)
{
    static Relight__InfoRequest ask;
    static Relight__ModelInfo info;
    relight__info_request__init(&ask);
    relight__model_info__init(&info);
    ask.model = "3f9ad2c1";
    info.model = "3f9ad2c10123456789abcdef01234567";
    info.name = "bunny";
    info.state = RELIGHT__MODEL_STATE__MODEL_READY;
    info.n_vertex = 3;
    info.n_triangle = 1;
    info.mesh_hash = "00112233445566aa";
    info.bake_hash = "8899aabbccddeeff";
    return vector_exchange(out, n, "info", 10, 36, "C: INFO of the room's model", &ask.base,
                           "S: INFO with mesh_hash and bake_hash", &info.base);
}

static unsigned add_hand(struct vector *out, unsigned n)
{
    static Relight__RoomPresenceRequest presence;
    static Relight__Participant me;
    static char *parts[] = {"lights"};
    relight__room_presence_request__init(&presence);
    relight__participant__init(&me);
    me.name = "Ann";
    me.hand = small_scene();
    me.n_hand_parts = 1;
    me.hand_parts = parts;
    presence.subscription = 40;
    presence.me = &me;
    return vector_add(out, n, "room_hand", "C: ROOM_PRESENCE: a hand turns the light", 33, LAST,
                      0, &presence.base, NULL, 0);
}

static unsigned add_rest(struct vector *out, unsigned n)
{
    static Relight__RoomPictureRequest picture;
    static Relight__RoomPresenceRequest presence;
    static Relight__Participant me;
    static Relight__SurfacePoint cursor;
    static Relight__RoomBackupRequest backup;
    relight__room_picture_request__init(&picture);
    relight__room_presence_request__init(&presence);
    relight__participant__init(&me);
    relight__surface_point__init(&cursor);
    relight__room_backup_request__init(&backup);
    picture.room = room;
    picture.revision = 7;
    picture.format = RELIGHT__IMAGE_FORMAT__IMAGE_PNG;
    cursor.triangle = 1204;
    cursor.b1 = 0.25f;
    cursor.b2 = 0.5f;
    me.name = "Ann";
    me.color = 0xe0714f;
    me.cursor = &cursor;
    presence.subscription = 40;
    presence.me = &me;
    n = vector_add(out, n, "room_picture", "C: ROOM_PICTURE of revision 7", 32, LAST, 34,
                   &picture.base, NULL, 0);
    n = vector_add(out, n, "room_presence", "C: ROOM_PRESENCE, one-way: a cursor", 33, LAST, 0,
                   &presence.base, NULL, 0);
    n = add_hand(out, n);
    return vector_add(out, n, "room_backup", "C: ROOM_BACKUP, a new copy", 34, LAST, 35,
                      &backup.base, NULL, 0);
}

unsigned vectors_add_rooms(struct vector *out, unsigned n)
{
    n = add_create(out, n);
    n = add_list(out, n);
    n = add_edit(out, n);
    n = add_decide(out, n);
    n = add_get(out, n);
    n = add_rest(out, n);
    return add_info(out, n);
}
