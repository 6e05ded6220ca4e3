// SPDX-License-Identifier: MIT
// Every allocation of the daemon fails once in each of the operations that allocations.c does
// not ask for. Several requests of one connection are on the way together: each is answered, or
// the connection is closed, and the next client finds the daemon and its room as they should
// be.
#include "faulty_room.h"

static const char *const options[] = {"--room-idle", "0", NULL};

static int setup(void **state)
{
    faults_setup_room(options, "operations");
    return 0;
}

// ---- batches: each adds its requests and returns how many will have a last answer

struct batch {
    struct frames *f;
    uint64_t n; // requests so far; HELLO is 1
    unsigned turn;
    uint64_t stays, cancel; // a request that ends only when `cancel` goes well
};

static void add(struct batch *b, uint16_t type, const ProtobufCMessage *message,
                const void *payload, size_t n)
{
    frames_add(b->f, type, ++b->n, message, payload, n);
}

// The model as a viewer fetches it.
static void ask_model(struct batch *b)
{
    Relight__InfoRequest info = RELIGHT__INFO_REQUEST__INIT;
    Relight__GeometryRequest geometry = RELIGHT__GEOMETRY_REQUEST__INIT;
    Relight__FactorsRequest factors = RELIGHT__FACTORS_REQUEST__INIT;
    info.model = geometry.model = factors.model = model;
    add(b, RELIGHT_TYPE_INFO, &info.base, NULL, 0);
    geometry.textures = true;
    add(b, RELIGHT_TYPE_GEOMETRY, &geometry.base, NULL, 0);
    geometry.coarse = true;
    add(b, RELIGHT_TYPE_GEOMETRY, &geometry.base, NULL, 0);
    add(b, RELIGHT_TYPE_FACTORS, &factors.base, NULL, 0);
}

static void ask_light(struct batch *b)
{
    Relight__EnvRequest env = RELIGHT__ENV_REQUEST__INIT;
    Relight__ListRequest list = RELIGHT__LIST_REQUEST__INIT;
    char word[40];
    snprintf(word, sizeof word, "constant:1,%u,0.5", b->turn);
    env.env = word;
    env.cube_n = 16;
    add(b, RELIGHT_TYPE_ENV, &env.base, NULL, 0);
    env.cube_n = 0;
    env.thumbnail = 64;
    add(b, RELIGHT_TYPE_ENV, &env.base, NULL, 0);
    list.environments = list.files = true;
    add(b, RELIGHT_TYPE_LIST, &list.base, NULL, 0);
}

// The octahedron, moved: as a pose and as the model's own vertices.
static void ask_pose(struct batch *b)
{
    Relight__PutPoseRequest pose = RELIGHT__PUT_POSE_REQUEST__INIT;
    Relight__UpdateVerticesRequest update = RELIGHT__UPDATE_VERTICES_REQUEST__INIT;
    float xyz[3] = {1, 0.5f, (float)b->turn};
    pose.model = update.model = model;
    pose.n = update.n = 1;
    pose.own_units = update.own_units = true;
    add(b, RELIGHT_TYPE_PUT_POSE, &pose.base, xyz, sizeof xyz);
    xyz[1] = 0;
    add(b, RELIGHT_TYPE_UPDATE_VERTICES, &update.base, xyz, sizeof xyz);
}

static void ask_token(struct batch *b)
{
    Relight__TokenCreateRequest create = RELIGHT__TOKEN_CREATE_REQUEST__INIT;
    Relight__TokenListRequest list = RELIGHT__TOKEN_LIST_REQUEST__INIT;
    Relight__TokenRevokeRequest revoke = RELIGHT__TOKEN_REVOKE_REQUEST__INIT;
    static char name[2][32]; // of this turn and the one before, which may have none
    char *scopes[] = {"view"};
    strcpy(name[1], *name[0] ? name[0] : "none");
    snprintf(name[0], sizeof name[0], "t%u", b->turn);
    create.name = name[0];
    revoke.name = name[1];
    create.scopes = scopes;
    create.n_scopes = 1;
    add(b, RELIGHT_TYPE_TOKEN_CREATE, &create.base, NULL, 0);
    add(b, RELIGHT_TYPE_TOKEN_LIST, &list.base, NULL, 0);
    add(b, RELIGHT_TYPE_TOKEN_REVOKE, &revoke.base, NULL, 0);
}

static void ask_material(struct batch *b)
{
    Relight__MaterialRequest material = RELIGHT__MATERIAL_REQUEST__INIT;
    material.material = "skin1";
    add(b, RELIGHT_TYPE_MATERIAL, &material.base, NULL, 0);
    material.material =
        "{\"profile\":\"burley\",\"albedo\":[0.8,0.7,0.6],\"mean_free_path\":[1,1,1]}";
    add(b, RELIGHT_TYPE_MATERIAL, &material.base, NULL, 0);
}

static void cancel(struct batch *b, uint64_t id)
{
    Relight__CancelRequest m = RELIGHT__CANCEL_REQUEST__INIT;
    m.id = b->stays = id;
    b->cancel = b->n + 1;
    add(b, RELIGHT_TYPE_CANCEL, &m.base, NULL, 0);
}

static void ask_events(struct batch *b)
{
    Relight__SubscribeRequest m = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    add(b, RELIGHT_TYPE_SUBSCRIBE, &m.base, NULL, 0);
    cancel(b, b->n);
}

static void edit(struct batch *b, const Relight__RoomAction *action)
{
    room_add_edit(b->f, ++b->n, room, action, "Ann", "", 0);
}

// Somebody comes in, waves and leaves, while others edit.
static void ask_seat(struct batch *b)
{
    Relight__RoomPresenceRequest wave = RELIGHT__ROOM_PRESENCE_REQUEST__INIT;
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    Relight__RoomRename rename = RELIGHT__ROOM_RENAME__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    const uint64_t seat = ++b->n;
    room_add_subscribe(b->f, seat, room, 0, "Ann");
    me.name = "Anna";
    wave.subscription = seat;
    wave.me = &me;
    frames_add(b->f, RELIGHT_TYPE_ROOM_PRESENCE, 900, &wave.base, NULL, 0);
    rename.name = "operations";
    action.rename = &rename;
    edit(b, &action);
    cancel(b, seat);
}

static void ask_new_room(struct batch *b)
{
    Relight__RoomCreateRequest create = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    Relight__RoomListRequest list = RELIGHT__ROOM_LIST_REQUEST__INIT;
    create.name = "another";
    create.me = "Ann";
    add(b, RELIGHT_TYPE_ROOM_CREATE, &create.base, NULL, 0);
    add(b, RELIGHT_TYPE_ROOM_LIST, &list.base, NULL, 0);
}

static void edit_scene(struct batch *b)
{
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    char *parts[] = {"model", "lights"};
    light.env = "constant";
    light.rotate_deg = (float)b->turn;
    scene.model = model;
    scene.lights = lights;
    scene.n_lights = 1;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 2;
    action.scene = &change;
    edit(b, &action);
}

// The room's scene, a revision of it, a pin on it, an invitation and an undo.
static void ask_review(struct batch *b)
{
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__SaveRevision save = RELIGHT__SAVE_REVISION__INIT;
    Relight__PutPin pin = RELIGHT__PUT_PIN__INIT;
    Relight__SurfacePoint at = RELIGHT__SURFACE_POINT__INIT;
    Relight__Invite invite = RELIGHT__INVITE__INIT;
    Relight__Nothing nothing = RELIGHT__NOTHING__INIT;
    edit_scene(b);
    save.note = "as it is";
    action.save = &save;
    edit(b, &action);
    action.save = NULL;
    pin.text = "here, @Bob";
    pin.at = &at;
    action.pin = &pin;
    edit(b, &action);
    action.pin = NULL;
    invite.role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    invite.name = "Bob";
    action.invite = &invite;
    edit(b, &action);
    action.invite = NULL;
    action.undo = &nothing;
    edit(b, &action);
}

static void ask_picture(struct batch *b)
{
    Relight__RoomPictureRequest m = RELIGHT__ROOM_PICTURE_REQUEST__INIT;
    edit_scene(b);
    m.room = room;
    m.width = 32;
    m.height = 24;
    add(b, RELIGHT_TYPE_ROOM_PICTURE, &m.base, NULL, 0);
}

static void ask_log(struct batch *b)
{
    Relight__RoomGetRequest get = RELIGHT__ROOM_GET_REQUEST__INIT;
    Relight__RoomBackupRequest backup = RELIGHT__ROOM_BACKUP_REQUEST__INIT;
    get.room = room;
    get.events = true;
    add(b, RELIGHT_TYPE_ROOM_GET, &get.base, NULL, 0);
    add(b, RELIGHT_TYPE_ROOM_BACKUP, &backup.base, NULL, 0);
}

static const struct operation {
    const char *name;
    void (*ask)(struct batch *b);
    unsigned sampled; // above this many allocations not each fails
} operations[] = {
    {"a model's data", ask_model},
    {"a light", ask_light},
    {"a pose", ask_pose},
    {"a token", ask_token, 60},
    {"a material", ask_material, 60},
    {"events", ask_events},
    {"a new room", ask_new_room},
    {"a seat in a room", ask_seat, 60},
    {"a review", ask_review, 60},
    {"a room's picture", ask_picture, 60},
    {"a room's log", ask_log, 60},
};

// ---- one batch under one fault

static char last_refusal[512];

// The number of requests that were refused; -1: the connection was closed.
static int answers(struct batch *b, const char *name)
{
    bool over[32] = {false};
    int refused = 0;
    for (uint64_t left = b->n; left;) {
        struct frames_answer a;
        if (!frames_next(b->f, &a, 20000, NULL))
            fail_msg("%s: %d of %d requests have no answer, fault %u", name, (int)left,
                     (int)b->n, b->turn);
        if (a.closed) return -1;
        if (!a.id && a.code) return -1; // about the connection, which is closed
        if (a.id < 1 || a.id > b->n || over[a.id])
            fail_msg("%s: an answer of type %x to %d: %s", name, a.type, (int)a.id, a.text);
        if (!a.last) continue;
        over[a.id] = true;
        left--;
        if (a.id == b->cancel && a.code && !over[b->stays]) left--;
        if (!a.code || a.code == RELIGHT__ERROR_CODE__ERROR_CANCELLED ||
            a.code == RELIGHT__ERROR_CODE__ERROR_NOT_FOUND)
            continue;
        snprintf(last_refusal, sizeof last_refusal, "%s", a.text);
        refused++;
    }
    return refused;
}

static int run_batch(const struct operation *operation, unsigned turn)
{
    struct batch b = {.f = frames_connect(&d), .n = 1, .turn = turn};
    frames_add_hello(b.f, "faults");
    operation->ask(&b);
    int refused = frames_try_send(b.f) ? answers(&b, operation->name) : -1;
    frames_close(b.f);
    return refused;
}

static void must_serve(const char *after, int64_t n)
{
    must_live(after, n);
    struct frames *f = frames_open(&d);
    Relight__RoomState *state = room_state(f, room, NULL, NULL);
    relight__room_state__free_unpacked(state, NULL);
    frames_close(f);
    if (log_says(&d, "is damaged", 0)) fail_msg("without memory a room counts as damaged");
}

// Raises n until the batch is over before its n-th allocation.
static void each_allocation(const struct operation *operation)
{
    int64_t n = 1, left = 0, n_refused = 0;
    for (; n < 4000 && left == 0; n += operation->sampled ? 1 + n / operation->sampled : 1) {
        int64_t failed = faults->n_failed;
        faults->allocation = n;
        int refused = run_batch(operation, (unsigned)n);
        left = faults->n_failed == failed;
        faults_off();
        if (left && refused) fail_msg("%s without a fault: %s", operation->name, last_refusal);
        n_refused += refused != 0;
        must_serve(operation->name, n);
    }
    print_message("%s: %lld allocations, %lld of them fatal to a request\n", operation->name,
                  (long long)n - 2, (long long)n_refused);
    assert_true(n > 3 && n < 4000);
}

static void each_operation(void **state)
{
    for (size_t i = 0; i < sizeof operations / sizeof *operations; i++)
        each_allocation(&operations[i]);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(each_operation)};
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("operations", tests, setup, faults_teardown);
}
