// SPDX-License-Identifier: MIT
// Requests about review rooms, frame by frame.
#ifndef TESTS_SERVICE_ROOM_FRAMES_H
#define TESTS_SERVICE_ROOM_FRAMES_H

#include "frames.h"

// The one answer to this id; its message and payload are the caller's. Answers to other ids are
// dropped.
struct reply {
    int code;
    char text[512];
    uint16_t type;
    bool last, closed;
    ProtobufCMessage *message;
    uint8_t *payload;
    size_t n;
};

static inline void reply_free(struct reply *r)
{
    if (r->message) protobuf_c_message_free_unpacked(r->message, NULL);
    free(r->payload);
    memset(r, 0, sizeof *r);
}

// False: nothing came in time. id 0: of any request.
static inline bool reply_next(struct frames *f, uint64_t id, int ms, struct reply *out,
                              uint64_t *from)
{
    struct frames_answer a;
    memset(out, 0, sizeof *out);
    do {
        if (out->message) protobuf_c_message_free_unpacked(out->message, NULL);
        out->message = NULL;
        if (!frames_next(f, &a, ms, &out->message)) return false;
    } while (!a.closed && id && a.id != id);
    out->closed = a.closed;
    if (a.closed) return true;
    out->code = a.code;
    out->type = a.type;
    out->last = a.last;
    snprintf(out->text, sizeof out->text, "%s", a.text);
    out->n = a.payload;
    out->payload = malloc(a.payload + 1);
    if (a.payload) memcpy(out->payload, f->decoder.frame.payload, a.payload);
    if (from) *from = a.id;
    return true;
}

static inline struct reply reply_to(struct frames *f, uint64_t id)
{
    struct reply r;
    if (!reply_next(f, id, 20000, &r, NULL)) fail_msg("no answer to %d", (int)id);
    if (r.closed) fail_msg("the connection was closed");
    return r;
}

// The last refusal that frames_token got.
static char token_text[512];

// A connection whose HELLO has this token; NULL for none. *code: of its answer.
static inline struct frames *frames_token(const struct daemon *d, const char *token, int *code)
{
    struct frames *f = frames_connect(d);
    Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
    hello.client = "rooms";
    hello.version_min = hello.version_max = RELIGHT_PROTOCOL_VERSION;
    if (token) hello.token = (char *)token;
    frames_add(f, RELIGHT_TYPE_HELLO, 1, &hello.base, NULL, 0);
    frames_send(f);
    struct frames_answer answer = frames_wait(f, 1);
    int got = answer.code;
    snprintf(token_text, sizeof token_text, "%s", answer.text);
    if (code) *code = got;
    else assert_int_equal(got, 0);
    return f;
}

// A token with the scope view, and edit for n_scope 2.
static inline void make_token(const struct daemon *d, const char *name, size_t n_scope,
                              char secret[RELIGHT_SECRET])
{
    struct relight_client *client = client_open(d->address);
    struct relight_error error;
    const char *scopes[] = {"view", "edit"};
    struct relight_token_order order = {.name = name, .scope = scopes, .n_scope = n_scope};
    OK(relight_token_create(client, &order, secret, &error));
    relight_close(client);
}

static inline void room_create(struct frames *f, const char *name, char room[33])
{
    Relight__RoomCreateRequest m = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    m.name = (char *)name;
    m.me = "Ann";
    frames_add(f, RELIGHT_TYPE_ROOM_CREATE, 5, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 5);
    if (r.code) fail_msg("ROOM_CREATE: %s", r.text);
    snprintf(room, 33, "%s", ((Relight__RoomCreateAnswer *)r.message)->room);
    reply_free(&r);
}

static inline void room_add_edit(struct frames *f, uint64_t id, const char *room,
                                 const Relight__RoomAction *action, const char *me,
                                 const char *client, uint64_t number)
{
    Relight__RoomEditRequest m = RELIGHT__ROOM_EDIT_REQUEST__INIT;
    m.room = (char *)room;
    m.action = (Relight__RoomAction *)action;
    m.name = (char *)me;
    m.client = (char *)client;
    m.number = number;
    frames_add(f, RELIGHT_TYPE_ROOM_EDIT, id, &m.base, NULL, 0);
}

// One edit and its answer's code; *sequence and text may be NULL.
static inline int room_edit_now(struct frames *f, const char *room,
                                const Relight__RoomAction *action, uint64_t *sequence,
                                char text[512])
{
    room_add_edit(f, 6, room, action, "Ann", "", 0);
    frames_send(f);
    struct reply r = reply_to(f, 6);
    int code = r.code;
    if (text) snprintf(text, 512, "%s", r.text);
    if (!code && sequence) *sequence = ((Relight__RoomEditAnswer *)r.message)->sequence;
    reply_free(&r);
    return code;
}

static inline int room_rotate(struct frames *f, const char *room, float deg)
{
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    char *parts[] = {"lights"};
    light.env = "constant";
    light.rotate_deg = deg;
    scene.lights = lights;
    scene.n_lights = 1;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 1;
    action.scene = &change;
    return room_edit_now(f, room, &action, NULL, NULL);
}

// The room's state, whose hash was checked; NULL with the error's code.
static inline Relight__RoomState *room_state(struct frames *f, const char *room, char hash[65],
                                             int *code)
{
    Relight__RoomGetRequest m = RELIGHT__ROOM_GET_REQUEST__INIT;
    struct relight_sha256 sha;
    char own[65];
    m.room = (char *)room;
    frames_add(f, RELIGHT_TYPE_ROOM_GET, 7, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 7);
    if (code) *code = r.code;
    else if (r.code) fail_msg("ROOM_GET: %s", r.text);
    Relight__RoomState *state = NULL;
    if (!r.code) {
        relight_sha256_init(&sha);
        relight_sha256_add(&sha, r.payload, r.n);
        relight_sha256_hex(&sha, own);
        assert_string_equal(own, ((Relight__RoomGetAnswer *)r.message)->hash);
        if (hash) strcpy(hash, own);
        state = relight__room_state__unpack(NULL, r.n, r.payload);
        assert_non_null(state);
    }
    reply_free(&r);
    return state;
}

static inline void room_add_subscribe(struct frames *f, uint64_t id, const char *room,
                                      uint64_t after, const char *name)
{
    Relight__SubscribeRequest m = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    me.name = (char *)name;
    me.color = 0x123456;
    m.room = (char *)room;
    m.after = after;
    m.me = &me;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, id, &m.base, NULL, 0);
}

#endif
