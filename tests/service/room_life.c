// SPDX-License-Identifier: MIT
// Review rooms over the protocol: what is acknowledged survives, people see each other, roles
// and invitations are the daemon's to enforce. Above 600 lines: a list of scenarios, each
// read alone.
#include "room_frames.h"

#include "lone_daemon.h"

#include <math.h>
#include <sys/resource.h>

static void free_state(Relight__RoomState *s)
{
    relight__room_state__free_unpacked(s, NULL);
}

static void survives_a_restart(void **unused)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33], hash[65], again[65];
    room_create(f, "Bunny in jade", room);
    for (int i = 0; i < 20; i++) assert_int_equal(room_rotate(f, room, (float)i), 0);
    Relight__RoomState *s = room_state(f, room, hash, NULL);
    assert_string_equal(s->name, "Bunny in jade");
    assert_int_equal(s->sequence, 21);
    assert_float_equal(s->scene->lights[0]->rotate_deg, 19, 0);
    free_state(s);
    kill(d.pid, SIGKILL); // what was answered is on the disk
    waitpid(d.pid, NULL, 0);
    frames_close(f);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    free_state(room_state(f, room, again, NULL));
    assert_string_equal(hash, again);
    // A regular end, too.
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    free_state(room_state(f, room, again, NULL));
    assert_string_equal(hash, again);
    int code;
    assert_null(room_state(f, "00000000000000000000000000000000", NULL, &code));
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_null(room_state(f, "../../etc", NULL, &code));
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    frames_close(f);
    end();
}

// A room that is left when the daemon stops is due to leave the memory when the store is closed
// already.
static void is_left_at_the_end(void **unused)
{
    const char *const at_once[] = {"--room-idle", "0", NULL};
    begin(at_once);
    struct frames *f = frames_open(&d);
    char room[33];
    room_create(f, "until the end", room);
    room_add_subscribe(f, 10, room, 0, "Ann");
    frames_send(f);
    struct reply r = reply_to(f, 10);
    assert_int_equal(r.code, 0);
    reply_free(&r);
    assert_int_equal(room_rotate(f, room, 30), 0); // no snapshot has it
    sleep(3); // where the work of the start goes on, the room leaves while it is waited for
    // Both in one turn of the loop: there is none between the room's last user and the stop.
    kill(d.pid, SIGSTOP);
    kill(d.pid, SIGTERM);
    kill(d.pid, SIGINT);
    kill(d.pid, SIGCONT);
    assert_int_equal(daemon_stop(&d), 0);
    frames_close(f);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    Relight__RoomState *s = room_state(f, room, NULL, NULL);
    assert_int_equal(s->sequence, 2);
    free_state(s);
    frames_close(f);
    end();
}

// ---- seats

// The next event of a kind; events of others are dropped.
static struct reply event_of(struct frames *f, uint64_t id, int kind)
{
    for (;;) {
        struct reply r = reply_to(f, id);
        if (r.code) fail_msg("SUBSCRIBE: %s", r.text);
        if ((int)((Relight__Event *)r.message)->kind == kind) return r;
        reply_free(&r);
    }
}

static uint64_t sequence_of(const struct reply *r)
{
    return ((const Relight__Event *)r->message)->sequence;
}

// Sends what a participant of that subscription says of itself.
static void send_presence(struct frames *f, uint64_t subscription, Relight__Participant *me)
{
    Relight__RoomPresenceRequest m = RELIGHT__ROOM_PRESENCE_REQUEST__INIT;
    m.subscription = subscription;
    m.me = me;
    frames_add(f, RELIGHT_TYPE_ROOM_PRESENCE, 0, &m.base, NULL, 0);
    frames_send(f);
}

static void people_see_each_other(void **unused)
{
    begin(NULL);
    struct frames *ann = frames_open(&d), *bob = frames_open(&d);
    char room[33];
    room_create(ann, "table", room);
    room_add_subscribe(ann, 10, room, 0, "Ann");
    frames_send(ann);
    struct reply r = event_of(ann, 10, RELIGHT__EVENT_KIND__EVENT_ROOM_STATE);
    assert_int_equal(sequence_of(&r), 1);
    uint64_t ann_key = ((Relight__Event *)r.message)->participant;
    reply_free(&r);
    room_add_subscribe(bob, 11, room, 0, "Bob");
    frames_send(bob);
    r = event_of(bob, 11, RELIGHT__EVENT_KIND__EVENT_ROOM_STATE);
    uint64_t bob_key = ((Relight__Event *)r.message)->participant;
    reply_free(&r);
    r = event_of(bob, 11, RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE);
    Relight__Presence *p = relight__presence__unpack(NULL, r.n, r.payload);
    assert_int_equal(p->n_participants, 2);
    relight__presence__free_unpacked(p, NULL);
    reply_free(&r);
    // Bob follows Ann and points at the surface; Ann sees it.
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    Relight__SurfacePoint at = RELIGHT__SURFACE_POINT__INIT;
    at.triangle = 5;
    at.b1 = 0.25f;
    me.name = "Bob";
    me.by = "token:someone-else"; // is not his to say
    me.follows = ann_key;
    me.cursor = &at;
    send_presence(bob, 11, &me);
    for (bool seen = false; !seen;) {
        r = event_of(ann, 10, RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE);
        p = relight__presence__unpack(NULL, r.n, r.payload);
        for (size_t i = 0; i < p->n_participants; i++) {
            const Relight__Participant *who = p->participants[i];
            if (who->key != bob_key || !who->cursor) continue;
            seen = true;
            assert_true(who->follows == ann_key && who->cursor->triangle == 5);
            assert_int_equal(strncmp(who->by, "uid:", 4), 0);
        }
        relight__presence__free_unpacked(p, NULL);
        reply_free(&r);
    }
    // An edit reaches both, in one piece each.
    assert_int_equal(room_rotate(bob, room, 90), 0);
    r = event_of(ann, 10, RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS);
    Relight__RoomEvents *events = relight__room_events__unpack(NULL, r.n, r.payload);
    assert_int_equal(events->n_events, 1);
    assert_int_equal(events->events[0]->stamp->sequence, 2);
    assert_int_equal(sequence_of(&r), 2);
    relight__room_events__free_unpacked(events, NULL);
    reply_free(&r);
    // Bob leaves.
    frames_close(bob);
    for (bool gone = false; !gone;) {
        r = event_of(ann, 10, RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE);
        p = relight__presence__unpack(NULL, r.n, r.payload);
        for (size_t i = 0; i < p->n_participants; i++)
            gone |= p->participants[i]->key == bob_key && p->participants[i]->gone;
        relight__presence__free_unpacked(p, NULL);
        reply_free(&r);
    }
    frames_close(ann);
    end();
}

static int invite(struct frames *f, const char *room, int role, uint64_t expires_s,
                  char secret[64], uint64_t *sequence);

// Nobody sits down under a name that is too long.
static void a_seat_has_a_name_of_bounded_length(void **unused)
{
    enum { MOST = 64 };
    char room[33], name[MOST + 2] = "";
    begin(NULL);
    struct frames *f = frames_open(&d);
    room_create(f, "names", room);
    memset(name, 'n', MOST + 1);
    for (uint64_t id = 10; id < 12; id++) {
        room_add_subscribe(f, id, room, 0, name);
        frames_send(f);
        struct reply r = reply_to(f, id);
        assert_int_equal(r.code, id == 10 ? RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST : 0);
        reply_free(&r);
        name[MOST] = 0;
    }
    frames_close(f);
    end();
}

static int sit_down(struct frames *f, uint64_t id, const char *room, Relight__Participant *me)
{
    Relight__SubscribeRequest in = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    in.room = (char *)room;
    in.me = me;
    frames_add(f, RELIGHT_TYPE_SUBSCRIBE, id, &in.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, id);
    const int code = r.code;
    reply_free(&r);
    return code;
}

// A participant is sane, and of bounded size, in its hand and in its own scene.
static void a_seat_has_a_sane_participant(void **unused)
{
    enum { BAD = RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, LIGHTS = 17, PARTS = 7 };
    char room[33], *parts[PARTS], large[16400];
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[LIGHTS];
    begin(NULL);
    struct frames *f = frames_open(&d);
    room_create(f, "sane", room);
    memset(large, ' ', sizeof large - 1);
    large[sizeof large - 1] = 0;
    light.env = "constant";
    for (int i = 0; i < LIGHTS; i++) lights[i] = &light;
    for (int i = 0; i < PARTS; i++) parts[i] = "lights";
    uint64_t id = 100;
    for (int own = 0; own < 2; own++) {
        Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
        Relight__Scene scene = RELIGHT__SCENE__INIT;
        me.name = "Ann";
        if (own) me.own = &scene;
        else me.hand = &scene;
        scene.lights = lights;
        scene.n_lights = LIGHTS - 1;
        me.hand_parts = parts;
        me.n_hand_parts = PARTS - 1;
        assert_int_equal(sit_down(f, id++, room, &me), 0);
        me.n_hand_parts = PARTS;
        assert_int_equal(sit_down(f, id++, room, &me), BAD);
        me.n_hand_parts = 0;
        scene.n_lights = LIGHTS;
        assert_int_equal(sit_down(f, id++, room, &me), BAD);
        scene.n_lights = 1;
        light.rotate_deg = NAN;
        assert_int_equal(sit_down(f, id++, room, &me), BAD);
        light.rotate_deg = 0;
        scene.material = large;
        assert_int_equal(sit_down(f, id++, room, &me), BAD);
        scene.material = "marble";
        assert_int_equal(sit_down(f, id++, room, &me), 0);
    }
    frames_close(f);
    end();
}

// Adds ROOM_PRESENCE with a hand on the light, or with none.
static void add_hand(struct frames *f, uint64_t subscription, float deg)
{
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    char *parts[] = {"lights"};
    light.env = "constant";
    light.rotate_deg = deg;
    scene.lights = lights;
    scene.n_lights = 1;
    me.name = "Hand";
    me.leads = true;
    me.hand = &scene;
    me.hand_parts = parts;
    me.n_hand_parts = 1;
    send_presence(f, subscription, &me);
}

// The next participant named Hand that f sees.
static Relight__Participant *next_hand(struct frames *f, uint64_t id, Relight__Presence **out)
{
    for (;;) {
        struct reply r = event_of(f, id, RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE);
        *out = relight__presence__unpack(NULL, r.n, r.payload);
        reply_free(&r);
        for (size_t i = 0; i < (*out)->n_participants; i++)
            if (!strcmp((*out)->participants[i]->name, "Hand")) return (*out)->participants[i];
        relight__presence__free_unpacked(*out, NULL);
    }
}

// While a hand moves a part others see it, and the log has nothing of it; a viewer's hand moves
// nothing.
static void a_hand_is_seen(void **unused)
{
    begin(NULL);
    struct frames *ann = frames_open(&d), *bob = frames_open(&d);
    char room[33], secret[64];
    uint64_t at;
    Relight__Presence *p;
    room_create(ann, "hands", room);
    room_add_subscribe(ann, 10, room, 0, "Ann");
    frames_send(ann);
    room_add_subscribe(bob, 11, room, 0, "Bob");
    frames_send(bob);
    add_hand(bob, 11, 42);
    Relight__Participant *who = next_hand(ann, 10, &p);
    assert_int_equal(who->n_hand_parts, 1);
    assert_string_equal(who->hand_parts[0], "lights");
    assert_float_equal(who->hand->lights[0]->rotate_deg, 42, 0);
    assert_true(who->leads);
    relight__presence__free_unpacked(p, NULL);
    Relight__RoomState *s = room_state(ann, room, NULL, NULL);
    assert_int_equal(s->sequence, 1);
    free_state(s);
    for (int open = 0; open < 2; open++) { // a room that is closed lets go of it
        Relight__RoomClose close = RELIGHT__ROOM_CLOSE__INIT;
        Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
        char text[512];
        close.closed = !open;
        action.close = &close;
        assert_int_equal(room_edit_now(bob, room, &action, NULL, text), 0);
        if (open) break;
        who = next_hand(ann, 10, &p);
        assert_true(!who->hand && !who->n_hand_parts && !who->leads);
        relight__presence__free_unpacked(p, NULL);
    }
    assert_int_equal(invite(ann, room, RELIGHT__ROOM_ROLE__ROLE_VIEWER, 0, secret, &at), 0);
    frames_close(bob);
    bob = frames_token(&d, secret, NULL);
    room_add_subscribe(bob, 11, room, 0, "Eve");
    frames_send(bob);
    add_hand(bob, 11, 43);
    do {
        who = next_hand(ann, 10, &p);
        at = who->role;
        if (at == RELIGHT__ROOM_ROLE__ROLE_VIEWER)
            assert_true(!who->hand && !who->n_hand_parts && !who->leads);
        relight__presence__free_unpacked(p, NULL);
    } while (at != RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    frames_close(bob);
    frames_close(ann);
    end();
}

// Adds ROOM_PRESENCE of someone who looks around alone, at a light with so many texels and a
// material of so many bytes.
static void add_alone(struct frames *f, const char *name, float deg, uint32_t cube_n, size_t n)
{
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__Light light = RELIGHT__LIGHT__INIT, *lights[] = {&light};
    char *material = malloc(n + 1);
    memset(material, 'x', n);
    material[n] = 0;
    light.env = "constant";
    light.rotate_deg = deg;
    light.cube_n = cube_n;
    scene.lights = lights;
    scene.n_lights = 1;
    scene.material = material;
    me.name = (char *)name;
    me.alone = true;
    me.own = &scene;
    send_presence(f, 11, &me);
    free(material);
}

// Who follows a person that looks around alone gets that person's own scene, a viewer's, too;
// one that no room would keep, or that is too large, never comes.
static void an_own_scene_is_seen(void **unused)
{
    begin(NULL);
    struct frames *ann = frames_open(&d), *bob;
    char room[33], secret[64];
    uint64_t at;
    Relight__Presence *p;
    room_create(ann, "alone", room);
    room_add_subscribe(ann, 10, room, 0, "Ann");
    frames_send(ann);
    assert_int_equal(invite(ann, room, RELIGHT__ROOM_ROLE__ROLE_VIEWER, 0, secret, &at), 0);
    bob = frames_token(&d, secret, NULL);
    room_add_subscribe(bob, 11, room, 0, "Bob");
    frames_send(bob);
    add_alone(bob, "Hand", 1, 16, 10);    // texels
    add_alone(bob, "Hand", 2, 0, 17000);  // too large
    add_alone(bob, "Hand", NAN, 0, 10);   // no number
    add_alone(bob, "Hand", 42, 0, 12000); // as large as media of many objects are
    Relight__Participant *who = next_hand(ann, 10, &p);
    assert_true(who->alone);
    assert_int_equal(who->role, RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    assert_float_equal(who->own->lights[0]->rotate_deg, 42, 0);
    assert_int_equal(strlen(who->own->material), 12000);
    relight__presence__free_unpacked(p, NULL);
    Relight__RoomState *s = room_state(ann, room, NULL, NULL);
    assert_int_equal(s->sequence, 2); // the invitation
    free_state(s);
    frames_close(bob);
    frames_close(ann);
    end();
}

static void a_cursor_resumes(void **unused)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33];
    room_create(f, "cursor", room);
    for (int i = 0; i < 5; i++) room_rotate(f, room, (float)i);
    room_add_subscribe(f, 10, room, 3, "Ann");
    frames_send(f);
    struct reply r = reply_to(f, 10);
    assert_int_equal(((Relight__Event *)r.message)->kind,
                     RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS);
    Relight__RoomEvents *events = relight__room_events__unpack(NULL, r.n, r.payload);
    assert_int_equal(events->n_events, 3);
    assert_int_equal(events->events[0]->stamp->sequence, 4);
    relight__room_events__free_unpacked(events, NULL);
    reply_free(&r);
    // Over a restart.
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    room_add_subscribe(f, 10, room, 5, "Ann");
    frames_send(f);
    r = reply_to(f, 10);
    assert_int_equal(((Relight__Event *)r.message)->kind,
                     RELIGHT__EVENT_KIND__EVENT_ROOM_EVENTS);
    assert_int_equal(sequence_of(&r), 6);
    reply_free(&r);
    // A cursor beyond the end is of a room that was restored from an older copy.
    room_add_subscribe(f, 11, room, 600, "Ann");
    frames_send(f);
    r = event_of(f, 11, RELIGHT__EVENT_KIND__EVENT_ROOM_STATE);
    assert_int_equal(sequence_of(&r), 6);
    reply_free(&r);
    frames_close(f);
    end();
}

// ---- rights

// n_scope: view alone, or edit, too.
static int set_member(struct frames *f, const char *room, const char *by, int role)
{
    Relight__Member member = RELIGHT__MEMBER__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    member.by = (char *)by;
    member.role = (Relight__RoomRole)role;
    action.member = &member;
    return room_edit_now(f, room, &action, NULL, NULL);
}

static size_t n_rooms(struct frames *f)
{
    Relight__RoomListRequest m = RELIGHT__ROOM_LIST_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_ROOM_LIST, 8, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 8);
    if (r.code) fail_msg("ROOM_LIST: %s", r.text);
    size_t n = ((Relight__RoomListAnswer *)r.message)->n_rooms;
    reply_free(&r);
    return n;
}

static void members_and_scopes(void **unused)
{
    begin(NULL);
    struct frames *owner = frames_open(&d);
    char room[33], bob_secret[RELIGHT_SECRET], text[512];
    room_create(owner, "members", room);
    make_token(&d, "bob", 1, bob_secret);
    struct frames *bob = frames_token(&d, bob_secret, NULL);
    int code;
    // A room of others is not there.
    assert_null(room_state(bob, room, NULL, &code));
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_int_equal(n_rooms(bob), 0);
    assert_int_equal(room_rotate(bob, room, 1), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    room_add_subscribe(bob, 10, room, 0, "Bob");
    frames_send(bob);
    struct reply r = reply_to(bob, 10);
    assert_int_equal(r.code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    reply_free(&r);
    // As a reviewer his token's scope still lets him look alone.
    assert_int_equal(set_member(owner, room, "token:bob", RELIGHT__ROOM_ROLE__ROLE_REVIEWER),
                     0);
    assert_int_equal(n_rooms(bob), 1);
    free_state(room_state(bob, room, NULL, NULL));
    assert_int_equal(room_rotate(bob, room, 1), RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    room_add_subscribe(bob, 10, room, 0, "Bob");
    frames_send(bob);
    r = event_of(bob, 10, RELIGHT__EVENT_KIND__EVENT_ROOM_STATE);
    assert_int_equal(((Relight__Event *)r.message)->role, RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    reply_free(&r);
    // Taken away, his seat goes, too.
    assert_int_equal(set_member(owner, room, "token:bob", RELIGHT__ROOM_ROLE__ROLE_NONE), 0);
    do {
        reply_free(&r);
        r = reply_to(bob, 10);
    } while (!r.code);
    assert_int_equal(r.code, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    reply_free(&r);
    assert_int_equal(n_rooms(bob), 0);
    // What an owner alone may do, and what nobody may.
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__RoomStart start = RELIGHT__ROOM_START__INIT;
    start.name = "again";
    action.start = &start;
    assert_int_equal(room_edit_now(owner, room, &action, NULL, text),
                     RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    frames_close(bob);
    frames_close(owner);
    end();
}

// False where the connection was closed before.
static bool sits(struct frames *f, const char *room, uint64_t id)
{
    struct frames_answer a = {0};
    room_add_subscribe(f, id, room, 0, "");
    if (!frames_try_send(f)) return false;
    while (a.id != id)
        if (!frames_next(f, &a, 20000, NULL) || a.closed) return false;
    return true;
}

// Somebody who sits in a room 40 times is taken out of it. Whether his connection was closed
// for the refusals, which he does not take in.
static bool is_closed_with(const char *send_buffer)
{
    enum { N = 40 };
    begin((const char *const[]){"--send-buffer", send_buffer, NULL});
    struct frames *owner = frames_open(&d);
    char room[33], secret[RELIGHT_SECRET];
    room_create(owner, "seats", room);
    make_token(&d, "bob", 1, secret);
    assert_int_equal(set_member(owner, room, "token:bob", RELIGHT__ROOM_ROLE__ROLE_VIEWER), 0);
    struct frames *bob = frames_token(&d, secret, NULL);
    bool all = true;
    for (uint64_t id = 10; id < 10 + N && all; id++) all = sits(bob, room, id);
    assert_int_equal(set_member(owner, room, "token:bob", RELIGHT__ROOM_ROLE__ROLE_NONE), 0);
    bool closed = all && log_says(&d, "why=\"it reads too slowly", 2000);
    free_state(room_state(owner, room, NULL, NULL));
    frames_close(bob);
    frames_close(owner);
    end();
    return closed;
}

// The connection is closed in the midst of the refusals. They are a little longer than what the
// last one to sit down makes the daemon send: the buffer shrinks until it is between the two.
static void closed_while_it_leaves_its_seats(void **unused)
{
    char text[16];
    int tries = 0, size;
    do {
        size = 1500 - 60 * (tries % 8);
        snprintf(text, sizeof text, "%d", size);
    } while (!is_closed_with(text) && ++tries < 40);
    print_message("closed with a send buffer of %d bytes, after %d others\n", size, tries);
    assert_true(tries < 40);
}

// Waits until that subscription has seen a participant of this principal in this role.
static void see_role(struct frames *f, uint64_t id, const char *by, int role)
{
    for (bool seen = false; !seen;) {
        struct reply r = event_of(f, id, RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE);
        Relight__Presence *p = relight__presence__unpack(NULL, r.n, r.payload);
        for (size_t i = 0; i < p->n_participants; i++)
            seen |=
                !strcmp(p->participants[i]->by, by) && (int)p->participants[i]->role == role;
        relight__presence__free_unpacked(p, NULL);
        reply_free(&r);
    }
}

// A guest whose role the owner changes has it at once, and everybody in the room sees it.
static void a_new_role_is_seen(void **unused)
{
    begin(NULL);
    struct frames *owner = frames_open(&d), *watch = frames_open(&d);
    char room[33], secret[RELIGHT_SECRET];
    make_token(&d, "eve", 2, secret);
    room_create(owner, "roles", room);
    assert_int_equal(set_member(owner, room, "token:eve", RELIGHT__ROOM_ROLE__ROLE_VIEWER), 0);
    struct frames *eve = frames_token(&d, secret, NULL);
    room_add_subscribe(watch, 10, room, 0, "Ann");
    room_add_subscribe(eve, 11, room, 0, "Eve");
    frames_send(watch);
    frames_send(eve);
    see_role(watch, 10, "token:eve", RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    assert_int_equal(set_member(owner, room, "token:eve", RELIGHT__ROOM_ROLE__ROLE_REVIEWER),
                     0);
    see_role(watch, 10, "token:eve", RELIGHT__ROOM_ROLE__ROLE_REVIEWER);
    see_role(eve, 11, "token:eve", RELIGHT__ROOM_ROLE__ROLE_REVIEWER);
    frames_close(eve);
    frames_close(watch);
    frames_close(owner);
    end();
}

static int invite(struct frames *f, const char *room, int role, uint64_t expires_s,
                  char secret[64], uint64_t *sequence)
{
    Relight__Invite m = RELIGHT__INVITE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    m.role = (Relight__RoomRole)role;
    m.name = "Carl of the press";
    m.id = "chosen by the client"; // is the daemon's to choose
    m.expires_s = expires_s;
    action.invite = &m;
    room_add_edit(f, 6, room, &action, "Ann", "", 0);
    frames_send(f);
    struct reply r = reply_to(f, 6);
    int code = r.code;
    if (!code) {
        snprintf(secret, 64, "%s", ((Relight__RoomEditAnswer *)r.message)->secret);
        *sequence = ((Relight__RoomEditAnswer *)r.message)->sequence;
        assert_true(strlen(secret) > 40);
    }
    reply_free(&r);
    return code;
}

static void guests(void **unused)
{
    begin(NULL);
    struct frames *owner = frames_open(&d);
    char room[33], other[33], secret[64], late[64];
    uint64_t at;
    int code;
    room_create(owner, "guests", room);
    room_create(owner, "not theirs", other);
    assert_int_equal(invite(owner, room, RELIGHT__ROOM_ROLE__ROLE_REVIEWER, 0, secret, &at), 0);
    struct frames *guest = frames_token(&d, secret, NULL);
    assert_int_equal(n_rooms(guest), 1);
    assert_int_equal(room_rotate(guest, room, 5), 0);
    assert_null(room_state(guest, other, NULL, &code));
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    // Rooms, models and tokens beyond the invitation are not the guest's.
    Relight__RoomCreateRequest create = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    create.name = "mine";
    frames_add(guest, RELIGHT_TYPE_ROOM_CREATE, 9, &create.base, NULL, 0);
    frames_send(guest);
    struct reply r = reply_to(guest, 9);
    assert_int_equal(r.code, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    reply_free(&r);
    Relight__ListRequest list = RELIGHT__LIST_REQUEST__INIT;
    frames_add(guest, RELIGHT_TYPE_LIST, 9, &list.base, NULL, 0);
    Relight__SubscribeRequest all = RELIGHT__SUBSCRIBE_REQUEST__INIT;
    frames_add(guest, RELIGHT_TYPE_SUBSCRIBE, 10, &all.base, NULL, 0);
    Relight__InfoRequest info = RELIGHT__INFO_REQUEST__INIT;
    info.model = "small"; // loaded, but not shown in the room
    frames_add(guest, RELIGHT_TYPE_INFO, 11, &info.base, NULL, 0);
    frames_send(guest);
    for (uint64_t i = 9; i < 12; i++) {
        r = reply_to(guest, i);
        assert_int_equal(r.code, i < 11 ? RELIGHT__ERROR_CODE__ERROR_FORBIDDEN
                                        : RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
        reply_free(&r);
    }
    assert_int_equal(set_member(guest, room, "token:eve", 1),
                     RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    // Its secret is nowhere in the room, nor on the disk.
    Relight__RoomState *s = room_state(owner, room, NULL, NULL);
    assert_int_equal(s->n_invites, 1);
    assert_null(strstr(secret, s->invites[0]->hash));
    char id[40];
    snprintf(id, sizeof id, "%s", s->invites[0]->id);
    free_state(s);
    // Revoked: the connection ends, and the link is dead.
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    action.revoke = id;
    assert_int_equal(room_edit_now(owner, room, &action, NULL, NULL), 0);
    do assert_true(reply_next(guest, 0, 5000, &r, NULL));
    while (!r.closed && (reply_free(&r), true));
    reply_free(&r);
    frames_close(guest);
    guest = frames_token(&d, secret, &code);
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    assert_non_null(strstr(token_text, "it was revoked, or its link is incomplete"));
    frames_close(guest);
    // One that expires; also over a restart.
    assert_int_equal(invite(owner, room, RELIGHT__ROOM_ROLE__ROLE_VIEWER,
                            (uint64_t)time(NULL) + 3, late, &at),
                     0);
    assert_int_equal(daemon_stop(&d), 0);
    frames_close(owner);
    daemon_start(&d, NULL);
    guest = frames_token(&d, late, &code);
    if (!code) {
        assert_int_equal(room_rotate(guest, room, 5), RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
        do assert_true(reply_next(guest, 0, 8000, &r, NULL));
        while (!r.closed && (reply_free(&r), true));
        reply_free(&r);
    }
    frames_close(guest);
    sleep_ms(code ? 3000 : 10);
    guest = frames_token(&d, late, &code);
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
    assert_non_null(strstr(token_text, "expired: ask the room's owner for another"));
    frames_close(guest);
    end();
}

// The caller's role in the first room of its list.
static int role_in_list(struct frames *f)
{
    Relight__RoomListRequest m = RELIGHT__ROOM_LIST_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_ROOM_LIST, 8, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 8);
    if (r.code) fail_msg("ROOM_LIST: %s", r.text);
    const Relight__RoomListAnswer *a = (Relight__RoomListAnswer *)r.message;
    assert_int_equal(a->n_rooms, 1);
    int role = (int)a->rooms[0]->role;
    reply_free(&r);
    return role;
}

// The list tells what each may do: a token that may only look is a viewer's, whatever the room
// says, and an invitation is its own.
static void the_list_tells_roles(void **unused)
{
    static const int reviewer = RELIGHT__ROOM_ROLE__ROLE_REVIEWER,
                     viewer = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    begin(NULL);
    struct frames *owner = frames_open(&d), *f;
    char room[33], secret[RELIGHT_SECRET];
    uint64_t at;
    room_create(owner, "roles", room);
    assert_int_equal(role_in_list(owner), RELIGHT__ROOM_ROLE__ROLE_OWNER);
    make_token(&d, "bob", 1, secret);
    for (int role = viewer; role <= reviewer; role++) {
        assert_int_equal(set_member(owner, room, "token:bob", role), 0);
        f = frames_token(&d, secret, NULL);
        assert_int_equal(role_in_list(f), viewer);
        frames_close(f);
    }
    make_token(&d, "eve", 2, secret);
    for (int role = viewer; role <= reviewer; role++) {
        assert_int_equal(set_member(owner, room, "token:eve", role), 0);
        f = frames_token(&d, secret, NULL);
        assert_int_equal(role_in_list(f), role);
        frames_close(f);
        char guest[64];
        assert_int_equal(invite(owner, room, role, 0, guest, &at), 0);
        f = frames_token(&d, guest, NULL);
        assert_int_equal(role_in_list(f), role);
        frames_close(f);
    }
    frames_close(owner);
    end();
}

static void show_model(struct frames *f, const char *room, const char *model)
{
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    char *parts[] = {"model"}, text[512];
    scene.model = (char *)model;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 1;
    action.scene = &change;
    if (room_edit_now(f, room, &action, NULL, text)) fail_msg("%s", text);
}

// An octahedron whose first vertex is at x; its id.
static void load_preview(struct relight_client *client, const char *x, char id[ID_SIZE])
{
    struct relight_error error;
    struct relight_loaded loaded;
    char text[sizeof octahedron + 16], hash[65];
    snprintf(text, sizeof text, "v %s 0 0%s", x, strchr(octahedron, '\n'));
    OK(relight_upload(client, "o.obj", text, strlen(text), NULL, NULL, hash, NULL, &error));
    struct relight_file file = {"o.obj", hash};
    struct relight_load load = {.n_file = 1, .files = &file, .size_mm = 10, .preview = true};
    OK(relight_load(client, &load, &loaded, &error));
    snprintf(id, ID_SIZE, "%s", loaded.model);
    relight_loaded_finish(&loaded);
}

static int info_code(struct frames *f, const char *model)
{
    Relight__InfoRequest info = RELIGHT__INFO_REQUEST__INIT;
    info.model = (char *)model;
    frames_add(f, RELIGHT_TYPE_INFO, 11, &info.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 11);
    int code = r.code;
    reply_free(&r);
    return code;
}

// A decision without a scene is about the one that the room showed when it came, also where
// another follows while the model's file is opened.
static void a_decision_has_one_scene(void **unused)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char room[33], first[ID_SIZE], second[ID_SIZE];
    load_preview(client, "2", first);
    load_preview(client, "3", second);
    room_create(f, "quick", room);
    show_model(f, room, first);
    OK(relight_unload(client, first, RELIGHT_KEEP_BAKE, NULL, &error)); // it has to be opened
    Relight__Decide decide = RELIGHT__DECIDE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    action.decide = &decide;
    room_add_edit(f, 8, room, &action, "Ann", "", 0);
    show_model(f, room, second);
    for (Relight__RoomState *s;; free_state(s)) {
        s = room_state(f, room, NULL, NULL);
        if (!s->n_decisions) continue;
        assert_string_equal(s->decisions[0]->seen->model, first);
        assert_string_equal(s->revisions[0]->scene->model, first);
        assert_string_equal(s->scene->model, second);
        free_state(s);
        break;
    }
    relight_close(client);
    frames_close(f);
    end();
}

// An edit that another of the same client has overtaken is not taken for a retry of that one.
static void an_overtaken_edit_is_refused(void **unused)
{
    static const char client_id[] = "00112233445566cc";
    begin(NULL);
    struct frames *f = frames_open(&d);
    struct relight_client *client = client_open(d.address);
    struct relight_error error;
    char room[33], model[ID_SIZE];
    load_preview(client, "2", model);
    room_create(f, "quick", room);
    show_model(f, room, model);
    OK(relight_unload(client, model, RELIGHT_KEEP_BAKE, NULL, &error)); // it has to be opened
    Relight__Decide decide = RELIGHT__DECIDE__INIT;
    Relight__SaveRevision save = RELIGHT__SAVE_REVISION__INIT;
    Relight__RoomAction slow = RELIGHT__ROOM_ACTION__INIT, quick = slow;
    slow.decide = &decide;
    quick.save = &save;
    room_add_edit(f, 8, room, &slow, "Ann", client_id, 1);
    room_add_edit(f, 9, room, &quick, "Ann", client_id, 2);
    frames_send(f);
    for (int i = 0; i < 2; i++) {
        uint64_t from;
        struct reply r;
        assert_true(reply_next(f, 0, 20000, &r, &from));
        assert_int_equal(r.code, from == 8 ? RELIGHT__ERROR_CODE__ERROR_MISMATCH : 0);
        reply_free(&r);
    }
    relight_close(client);
    frames_close(f);
    end();
}

// A guest sees the models of the room's scene and of its revisions, and no other.
static void a_guest_sees_the_rooms_models(void **unused)
{
    enum { SAVED, NEITHER, SHOWN, N };
    begin(NULL);
    struct frames *owner = frames_open(&d);
    struct relight_client *client = client_open(d.address);
    char room[33], secret[64], id[N][ID_SIZE];
    uint64_t at;
    Relight__SaveRevision save = RELIGHT__SAVE_REVISION__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    load_preview(client, "1.5", id[SAVED]);
    load_preview(client, "2.5", id[NEITHER]);
    load_preview(client, "3.5", id[SHOWN]);
    room_create(owner, "models", room);
    show_model(owner, room, id[SAVED]);
    action.save = &save;
    assert_int_equal(room_edit_now(owner, room, &action, NULL, NULL), 0);
    show_model(owner, room, id[NEITHER]); // for a moment
    show_model(owner, room, id[SHOWN]);
    assert_int_equal(invite(owner, room, RELIGHT__ROOM_ROLE__ROLE_VIEWER, 0, secret, &at), 0);
    struct frames *guest = frames_token(&d, secret, NULL);
    assert_int_equal(info_code(guest, id[SHOWN]), 0);
    assert_int_equal(info_code(guest, id[SAVED]), 0);
    assert_int_equal(info_code(guest, id[NEITHER]), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_int_equal(info_code(owner, id[NEITHER]), 0);
    frames_close(guest);
    frames_close(owner);
    relight_close(client);
    end();
}

// ROOM_CREATE's code.
static int try_room(struct frames *f)
{
    Relight__RoomCreateRequest m = RELIGHT__ROOM_CREATE_REQUEST__INIT;
    m.name = "one more";
    m.me = "Ann";
    frames_add(f, RELIGHT_TYPE_ROOM_CREATE, 5, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 5);
    int code = r.code;
    reply_free(&r);
    return code;
}

// Rooms count for their owner over restarts, closed ones too, until they are deleted.
static void rooms_are_counted(void **unused)
{
    static const char *const extra[] = {"--client-rooms", "3", NULL}, *const brief[] = {
                                                                          "--client-rooms", "3",
                                                                          "--rooms-keep",
                                                                          "0.001", NULL};
    char room[33];
    begin(extra);
    struct frames *f = frames_open(&d);
    room_create(f, "first", room);
    for (int i = 0; i < 2; i++) assert_int_equal(try_room(f), 0);
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__RoomClose close = RELIGHT__ROOM_CLOSE__INIT;
    close.closed = true;
    action.close = &close;
    assert_int_equal(room_edit_now(f, room, &action, NULL, NULL), 0);
    for (int start = 0; start < 2; start++) {
        assert_int_equal(try_room(f), RELIGHT__ERROR_CODE__ERROR_LIMIT);
        frames_close(f);
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, start ? brief : extra);
        f = frames_open(&d);
    }
    assert_true(log_says(&d, "deleted=closed", 20000));
    assert_int_equal(try_room(f), 0);
    assert_int_equal(try_room(f), RELIGHT__ERROR_CODE__ERROR_LIMIT);
    frames_close(f);
    end();
}

// A room that is refused does not count: for a name that is too long, and for such a model.
static void refused_rooms_do_not_count(void **unused)
{
    char name[1000], room[33];
    memset(name, 'n', sizeof name - 1);
    name[sizeof name - 1] = 0;
    begin((const char *const[]){"--client-rooms", "1", NULL});
    struct frames *f = frames_open(&d);
    for (uint64_t i = 0; i < 4; i++) {
        Relight__RoomCreateRequest m = RELIGHT__ROOM_CREATE_REQUEST__INIT;
        Relight__Scene scene = RELIGHT__SCENE__INIT;
        m.name = i % 2 ? name : "a room";
        m.me = "Ann";
        scene.model = name;
        if (i % 2 == 0) m.scene = &scene;
        frames_add(f, RELIGHT_TYPE_ROOM_CREATE, 100 + i, &m.base, NULL, 0);
        frames_send(f);
        struct reply r = reply_to(f, 100 + i);
        assert_int_not_equal(r.code, 0);
        reply_free(&r);
    }
    room_create(f, "the one", room);
    assert_int_equal(try_room(f), RELIGHT__ERROR_CODE__ERROR_LIMIT);
    frames_close(f);
    end();
}

// On a full disk what can be made again goes for an event, a preview first.
static void an_event_gets_its_room(void **unused)
{
    begin((const char *const[]){"--disk", "32k", NULL});
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    char room[33], id[ID_SIZE];
    load_preview(client, "2", id);
    room_create(f, "full", room);
    int n = 0;
    for (; info_code(f, id) == 0 && n < 400; n++)
        assert_int_equal(room_rotate(f, room, (float)n), 0);
    assert_int_equal(info_code(f, id), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_true(n > 10);
    assert_int_equal(room_rotate(f, room, 1000), 0);
    frames_close(f);
    relight_close(client);
    end();
}

// ---- faults

static void a_retry_is_done_once(void **unused)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33];
    room_create(f, "once", room);
    Relight__SaveRevision save = RELIGHT__SAVE_REVISION__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    action.save = &save;
    uint64_t first = 0;
    for (int i = 0; i < 3; i++) {
        room_add_edit(f, 6, room, &action, "Ann", "00112233445566aa", 7);
        frames_send(f);
        struct reply r = reply_to(f, 6);
        if (r.code) fail_msg("%s", r.text);
        const Relight__RoomEditAnswer *a = (Relight__RoomEditAnswer *)r.message;
        assert_int_equal(a->repeated, i > 0);
        if (!i) first = a->sequence;
        assert_int_equal(a->sequence, first);
        reply_free(&r);
    }
    frames_close(f);
    end();
}

// The answer to an edit of this client's number 7.
static struct reply edit_seven(struct frames *f, const char *room,
                               const Relight__RoomAction *action)
{
    room_add_edit(f, 6, room, action, "Ann", "00112233445566bb", 7);
    frames_send(f);
    return reply_to(f, 6);
}

// A decision whose answer was lost is done, whatever became of its model.
static void a_retry_needs_no_model(void **unused)
{
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    char room[33], id[ID_SIZE];
    load_preview(client, "2", id);
    room_create(f, "once", room);
    show_model(f, room, id);
    Relight__Decide decide = RELIGHT__DECIDE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    action.decide = &decide;
    struct reply r = edit_seven(f, room, &action);
    if (r.code) fail_msg("%s", r.text);
    reply_free(&r);
    Relight__UnloadRequest unload = RELIGHT__UNLOAD_REQUEST__INIT;
    unload.model = id;
    unload.forget = unload.force = true;
    frames_add(f, RELIGHT_TYPE_UNLOAD, 9, &unload.base, NULL, 0);
    frames_send(f);
    r = reply_to(f, 9);
    if (r.code) fail_msg("UNLOAD: %s", r.text);
    reply_free(&r);
    r = edit_seven(f, room, &action);
    if (r.code) fail_msg("%s", r.text);
    assert_true(((Relight__RoomEditAnswer *)r.message)->repeated);
    reply_free(&r);
    frames_close(f);
    relight_close(client);
    end();
}

// The secret of an invitation is in its first answer alone: a retry says so.
static void a_retried_invitation_has_no_secret(void **unused)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33];
    room_create(f, "once", room);
    Relight__Invite invite = RELIGHT__INVITE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    invite.role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    action.invite = &invite;
    struct reply r = edit_seven(f, room, &action);
    if (r.code) fail_msg("%s", r.text);
    reply_free(&r);
    r = edit_seven(f, room, &action);
    assert_int_equal(r.code, RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    assert_non_null(strstr(r.text, "revoke it"));
    reply_free(&r);
    frames_close(f);
    end();
}

// The participant of a new seat.
static uint64_t seat_key(struct frames *f, const char *room)
{
    room_add_subscribe(f, 10, room, 0, "Ann");
    frames_send(f);
    struct reply r = event_of(f, 10, RELIGHT__EVENT_KIND__EVENT_ROOM_STATE);
    uint64_t key = ((Relight__Event *)r.message)->participant;
    reply_free(&r);
    return key;
}

// After a restart participants have new keys, so that a client follows nobody else by an old
// one.
static void a_restart_gives_other_participants(void **unused)
{
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33];
    room_create(f, "people", room);
    uint64_t before = seat_key(f, room);
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    assert_true(seat_key(f, room) > before);
    frames_close(f);
    end();
}

// The engine that drew the room's scene.
static int engine_of_picture(struct frames *f, const char *room)
{
    Relight__RoomPictureRequest m = RELIGHT__ROOM_PICTURE_REQUEST__INIT;
    m.room = (char *)room;
    m.width = m.height = 16;
    frames_add(f, RELIGHT_TYPE_ROOM_PICTURE, 9, &m.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 9);
    if (r.code) fail_msg("ROOM_PICTURE: %s", r.text);
    int engine = (int)((Relight__ImageAnswer *)r.message)->cost->engine;
    reply_free(&r);
    return engine;
}

// A preview that is on the disk alone is no bake.
static void a_preview_is_drawn_alike_after_a_restart(void **unused)
{
    begin(NULL);
    struct relight_client *client = client_open(d.address);
    struct frames *f = frames_open(&d);
    char room[33], id[ID_SIZE];
    load_preview(client, "2", id);
    relight_close(client);
    room_create(f, "preview", room);
    assert_int_equal(room_rotate(f, room, 1), 0);
    show_model(f, room, id);
    assert_int_equal(engine_of_picture(f, room), RELIGHT__ENGINE__ENGINE_SPLAT);
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    assert_int_equal(engine_of_picture(f, room), RELIGHT__ENGINE__ENGINE_SPLAT);
    frames_close(f);
    end();
}

// Files can not grow any more, as on a full disk.
static void a_full_disk_loses_nothing(void **unused)
{
    if (getenv("RELIGHT_TEST_POSTGRES")) skip(); // the disk is the server's
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33], hash[65], again[65], text[512], *big = malloc(60001);
    Relight__PutVariant variant = RELIGHT__PUT_VARIANT__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    room_create(f, "full", room);
    assert_int_equal(room_rotate(f, room, 1), 0);
    memset(big, 'x', 60000);
    big[60000] = 0;
    variant.name = "big";
    variant.material = big;
    action.variant = &variant;
    struct rlimit limit = {400 << 10, RLIM_INFINITY};
    assert_int_equal(prlimit(d.pid, RLIMIT_FSIZE, &limit, NULL), 0);
    int code = 0, done = 0;
    while (!code && done < 50) {
        code = room_edit_now(f, room, &action, NULL, text);
        done += !code;
    }
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_non_null(strstr(text, "nothing was changed"));
    Relight__RoomState *s = room_state(f, room, hash, NULL); // reading goes on
    assert_int_equal(s->sequence, 2 + done);
    free_state(s);
    // Room again: so are edits, without a restart.
    limit.rlim_cur = RLIM_INFINITY;
    assert_int_equal(prlimit(d.pid, RLIMIT_FSIZE, &limit, NULL), 0);
    assert_int_equal(room_rotate(f, room, 2), 0);
    free_state(room_state(f, room, hash, NULL));
    kill(d.pid, SIGKILL);
    waitpid(d.pid, NULL, 0);
    frames_close(f);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    free_state(room_state(f, room, again, NULL));
    assert_string_equal(hash, again);
    frames_close(f);
    free(big);
    end();
}

// A copy that is made while the room is used opens as a store of its own.
static void backup(void **unused)
{
    if (getenv("RELIGHT_TEST_POSTGRES")) skip(); // pg_dump
    begin(NULL);
    struct frames *f = frames_open(&d);
    char room[33], hash[65], again[65], path[160], option[200];
    room_create(f, "backup", room);
    for (int i = 0; i < 10; i++) room_rotate(f, room, (float)i);
    free_state(room_state(f, room, hash, NULL));
    Relight__RoomBackupRequest m = RELIGHT__ROOM_BACKUP_REQUEST__INIT;
    char id[64] = "";
    snprintf(path, sizeof path, "%s/copy.sqlite", d.folder);
    FILE *out = fopen(path, "wb");
    for (uint64_t size = 1; m.offset < size;) {
        m.backup = id;
        frames_add(f, RELIGHT_TYPE_ROOM_BACKUP, 9, &m.base, NULL, 0);
        frames_send(f);
        struct reply r = reply_to(f, 9);
        if (r.code) fail_msg("ROOM_BACKUP: %s", r.text);
        const Relight__RoomBackupAnswer *a = (Relight__RoomBackupAnswer *)r.message;
        size = a->size;
        snprintf(id, sizeof id, "%s", a->backup);
        m.offset += r.n;
        assert_int_equal(fwrite(r.payload, 1, r.n, out), r.n);
        reply_free(&r);
    }
    fclose(out);
    room_rotate(f, room, 99);
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    snprintf(option, sizeof option, "sqlite:%s", path);
    daemon_start(&d, (const char *const[]){"--rooms", option, NULL});
    f = frames_open(&d);
    free_state(room_state(f, room, again, NULL));
    assert_string_equal(hash, again);
    frames_close(f);
    end();
}

// Sends TOKEN_CREATE or TOKEN_REVOKE of the token ti, with id i + 10.
static void send_token_change(struct frames *f, unsigned i, bool revoke)
{
    Relight__TokenCreateRequest create = RELIGHT__TOKEN_CREATE_REQUEST__INIT;
    Relight__TokenRevokeRequest gone = RELIGHT__TOKEN_REVOKE_REQUEST__INIT;
    char name[8], *scope = "view";
    snprintf(name, sizeof name, "t%u", i);
    create.name = gone.name = name;
    create.scopes = &scope;
    create.n_scopes = 1;
    frames_add(f, revoke ? RELIGHT_TYPE_TOKEN_REVOKE : RELIGHT_TYPE_TOKEN_CREATE, i + 10,
               revoke ? &gone.base : &create.base, NULL, 0);
    frames_send(f);
}

static unsigned count_tokens(struct frames *f)
{
    Relight__TokenListRequest list = RELIGHT__TOKEN_LIST_REQUEST__INIT;
    frames_add(f, RELIGHT_TYPE_TOKEN_LIST, 2, &list.base, NULL, 0);
    frames_send(f);
    struct reply r = reply_to(f, 2);
    assert_int_equal(r.code, 0);
    unsigned n = (unsigned)((Relight__TokenListAnswer *)r.message)->n_tokens;
    reply_free(&r);
    return n;
}

// Changes of the list of tokens that come while an earlier one is being written are done, too.
static void tokens_change_at_once(void **unused)
{
    enum { N = 6 };
    begin(NULL);
    struct frames *f = frames_open(&d);
    for (int revoke = 0; revoke < 2; revoke++) {
        for (unsigned i = 0; i < N; i++) send_token_change(f, i, revoke);
        for (unsigned i = 0; i < N; i++) {
            struct frames_answer a;
            assert_true(frames_next(f, &a, 20000, NULL) && !a.closed);
            if (a.code) fail_msg("token %d: %s", (int)a.id - 10, a.text);
        }
        assert_int_equal(count_tokens(f), revoke ? 0 : N);
    }
    frames_close(f);
    assert_int_equal(daemon_stop(&d), 0);
    daemon_start(&d, NULL);
    f = frames_open(&d);
    assert_int_equal(count_tokens(f), 0);
    frames_close(f);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(survives_a_restart, teardown),
        cmocka_unit_test_teardown(is_left_at_the_end, teardown),
        cmocka_unit_test_teardown(people_see_each_other, teardown),
        cmocka_unit_test_teardown(a_seat_has_a_name_of_bounded_length, teardown),
        cmocka_unit_test_teardown(a_seat_has_a_sane_participant, teardown),
        cmocka_unit_test_teardown(a_hand_is_seen, teardown),
        cmocka_unit_test_teardown(an_own_scene_is_seen, teardown),
        cmocka_unit_test_teardown(a_cursor_resumes, teardown),
        cmocka_unit_test_teardown(members_and_scopes, teardown),
        cmocka_unit_test_teardown(closed_while_it_leaves_its_seats, teardown),
        cmocka_unit_test_teardown(a_new_role_is_seen, teardown),
        cmocka_unit_test_teardown(guests, teardown),
        cmocka_unit_test_teardown(the_list_tells_roles, teardown),
        cmocka_unit_test_teardown(a_decision_has_one_scene, teardown),
        cmocka_unit_test_teardown(an_overtaken_edit_is_refused, teardown),
        cmocka_unit_test_teardown(a_guest_sees_the_rooms_models, teardown),
        cmocka_unit_test_teardown(rooms_are_counted, teardown),
        cmocka_unit_test_teardown(refused_rooms_do_not_count, teardown),
        cmocka_unit_test_teardown(an_event_gets_its_room, teardown),
        cmocka_unit_test_teardown(a_retry_is_done_once, teardown),
        cmocka_unit_test_teardown(a_retry_needs_no_model, teardown),
        cmocka_unit_test_teardown(a_retried_invitation_has_no_secret, teardown),
        cmocka_unit_test_teardown(a_restart_gives_other_participants, teardown),
        cmocka_unit_test_teardown(a_preview_is_drawn_alike_after_a_restart, teardown),
        cmocka_unit_test_teardown(a_full_disk_loses_nothing, teardown),
        cmocka_unit_test_teardown(tokens_change_at_once, teardown),
        cmocka_unit_test_teardown(backup, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
