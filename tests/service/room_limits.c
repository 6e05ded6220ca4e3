// SPDX-License-Identifier: MIT
// What rooms and their guests may take of the daemon.
#include "room_frames.h"

#include "lone_daemon.h"

static void make_guest(struct frames *owner, const char *room, char secret[64])
{
    Relight__Invite m = RELIGHT__INVITE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    m.role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    m.name = "guest";
    action.invite = &m;
    room_add_edit(owner, 6, room, &action, "Ann", "", 0);
    frames_send(owner);
    struct reply r = reply_to(owner, 6);
    if (r.code) fail_msg("invite: %s", r.text);
    snprintf(secret, 64, "%s", ((Relight__RoomEditAnswer *)r.message)->secret);
    reply_free(&r);
}

// Guests take what their inviter may take, also after a restart: many invitations are one
// client. The log names each.
static void guests_share_their_inviters_limits(void **unused)
{
    enum { MOST = 4, GUESTS = 6 };
    static const char *const extra[] = {"--client-connections", "4", NULL};
    char room[33], ann[RELIGHT_SECRET], secret[GUESTS][64];
    begin(extra);
    make_token(&d, "ann", 2, ann);
    struct frames *owner = frames_token(&d, ann, NULL), *guest[GUESTS];
    room_create(owner, "guests", room);
    for (int i = 0; i < GUESTS; i++) make_guest(owner, room, secret[i]);
    for (int start = 0; start < 2; start++) {
        for (int i = 0, code; i < GUESTS; i++) {
            guest[i] = frames_token(&d, secret[i], &code);
            assert_int_equal(code, i + 1 < MOST ? 0 : RELIGHT__ERROR_CODE__ERROR_BUSY);
            if (code) assert_non_null(strstr(token_text, "--client-connections"));
        }
        for (int i = 0; i < GUESTS; i++) frames_close(guest[i]);
        frames_close(owner);
        assert_true(log_says(&d, " who=guest:", 5000));
        assert_int_equal(daemon_stop(&d), 0);
        daemon_start(&d, extra);
        owner = frames_token(&d, ann, NULL);
    }
    frames_close(owner);
    end();
}

// ---- memory

// A revision with a note of 8000 bytes.
static int save(struct frames *f, const char *room, float deg, char text[512])
{
    static char note[8001];
    Relight__SaveRevision m = RELIGHT__SAVE_REVISION__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    memset(note, 'n', sizeof note - 1);
    m.note = note;
    action.save = &m;
    int code = room_rotate(f, room, deg);
    if (!code) code = room_edit_now(f, room, &action, NULL, text);
    return code;
}

static int undo(struct frames *f, const char *room)
{
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    Relight__Nothing nothing = RELIGHT__NOTHING__INIT;
    action.undo = &nothing;
    return room_edit_now(f, room, &action, NULL, NULL);
}

static double room_memory(void)
{
    struct relight_client *client = client_open(d.address);
    double bytes = metric(client, "relightd_resource_held{resource=\"room_memory\"}");
    relight_close(client);
    return bytes;
}

// A room that somebody uses grows up to its owner's memory, and no further; what takes nothing
// more is accepted.
static void a_room_has_its_owners_memory(void **unused)
{
    static const char *const extra[] = {"--client-room-memory", "256k", NULL};
    char room[33], text[512] = "";
    begin(extra);
    struct frames *f = frames_open(&d);
    room_create(f, "large", room);
    room_add_subscribe(f, 20, room, 0, "Ann");
    int n = 0, code = 0;
    while (n < 100 && !(code = save(f, room, (float)n, text))) n++;
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_in_range(n, 10, 32);
    if (text[0]) assert_non_null(strstr(text, "--client-room-memory"));
    assert_int_equal(undo(f, room), 0);
    assert_true(room_memory() > 100e3 && room_memory() <= 600e3); // with its tail
    frames_close(f);
    end();
}

static double held(const char *resource)
{
    char name[100];
    struct relight_client *client = client_open(d.address);
    snprintf(name, sizeof name, "relightd_resource_held{resource=\"%s\"}", resource);
    const double value = metric(client, name);
    relight_close(client);
    assert_true(value >= 0);
    return value;
}

// An edit that is refused takes nothing of the disk and of the memory, however often it comes.
static void refused_edits_hold_nothing(void **unused)
{
    char room[33], name[3000];
    begin(NULL);
    struct frames *f = frames_open(&d);
    room_create(f, "calm", room);
    room_add_subscribe(f, 20, room, 0, "Ann");
    assert_int_equal(room_rotate(f, room, 1), 0);
    memset(name, 'n', sizeof name - 1);
    name[sizeof name - 1] = 0;
    double disk = 0, memory = 0;
    for (int i = 0; i < 60; i++) {
        // The first action frees the packed state that newcomers are sent.
        if (i == 1) disk = held("disk"), memory = room_memory();
        Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
        Relight__RoomRename rename = RELIGHT__ROOM_RENAME__INIT;
        Relight__PutVariant variant = RELIGHT__PUT_VARIANT__INIT;
        Relight__Member member = RELIGHT__MEMBER__INIT;
        rename.name = name;
        variant.name = name;
        variant.material = "marble";
        member.by = name;
        if (i % 3 == 0) action.rename = &rename;
        if (i % 3 == 1) action.variant = &variant;
        if (i % 3 == 2) action.member = &member;
        assert_int_not_equal(room_edit_now(f, room, &action, NULL, NULL), 0);
    }
    assert_true(disk > 0 && memory > 0);
    assert_true(held("disk") == disk);
    assert_true(room_memory() == memory);
    assert_int_equal(room_rotate(f, room, 2), 0);
    assert_true(held("disk") > disk);
    frames_close(f);
    end();
}

// On a full disk a room takes no more events, but can be closed, and not be opened again.
static void a_full_disk_closes_rooms(void **unused)
{
    char room[33], text[512] = "";
    begin((const char *const[]){"--disk", "32k", NULL});
    struct frames *f = frames_open(&d);
    room_create(f, "full", room);
    int code = 0;
    for (int n = 0; n < 400 && !code; n++) code = room_rotate(f, room, (float)n);
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    for (int closed = 1; closed >= 0; closed--) {
        Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
        Relight__RoomClose close = RELIGHT__ROOM_CLOSE__INIT;
        close.closed = closed;
        action.close = &close;
        assert_int_equal(room_edit_now(f, room, &action, NULL, text),
                         closed ? 0 : RELIGHT__ERROR_CODE__ERROR_LIMIT);
    }
    frames_close(f);
    end();
}

// Rooms that nobody uses leave memory for those that somebody uses, and come back.
static void unused_rooms_leave_memory(void **unused)
{
    static const char *const extra[] = {"--client-room-memory", "256k", "--room-memory", "1M",
                                        NULL};
    enum { ROOMS = 8, EACH = 4 };
    char room[ROOMS][33], text[512];
    int code;
    begin(extra);
    struct frames *f = frames_open(&d);
    for (int i = 0; i < ROOMS; i++) {
        room_create(f, "one of many", room[i]);
        for (int k = 0; k < EACH; k++) assert_int_equal(save(f, room[i], (float)k, text), 0);
        assert_true(room_memory() < 600e3);
    }
    for (int i = 0; i < ROOMS; i++) {
        Relight__RoomState *state = room_state(f, room[i], NULL, NULL);
        assert_int_equal(state->n_revisions, EACH);
        relight__room_state__free_unpacked(state, NULL);
    }
    // Those in use stay.
    struct frames *sits = frames_open(&d);
    int n = 0;
    for (code = 0; n < ROOMS && !code; n += !code) {
        room_add_subscribe(sits, 20 + (uint64_t)n, room[n], 0, "Bob");
        frames_send(sits);
        struct reply r = reply_to(sits, 20 + (uint64_t)n);
        if ((code = r.code)) assert_non_null(strstr(r.text, "--client-room-memory"));
        reply_free(&r);
    }
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    assert_in_range(n, 2, ROOMS - 1);
    assert_null(room_state(f, room[n], NULL, &code));
    assert_int_equal(code, RELIGHT__ERROR_CODE__ERROR_LIMIT);
    frames_close(sits);
    Relight__RoomState *state = NULL;
    for (int i = 0; !state && i < 100; i++, sleep_ms(20))
        state = room_state(f, room[n], NULL, &code);
    assert_non_null(state);
    relight__room_state__free_unpacked(state, NULL);
    frames_close(f);
    end();
}

// ---- presence

enum { SEATS = 20, LARGE = 15000 };

// A participant of nearly the largest size, in its color the number of its change.
static void say(struct frames *f, uint64_t subscription, uint32_t number)
{
    static char material[LARGE + 1];
    Relight__RoomPresenceRequest m = RELIGHT__ROOM_PRESENCE_REQUEST__INIT;
    Relight__Participant me = RELIGHT__PARTICIPANT__INIT;
    Relight__Scene own = RELIGHT__SCENE__INIT;
    memset(material, 'm', LARGE);
    own.material = material;
    me.own = &own;
    me.color = number;
    m.subscription = subscription;
    m.me = &me;
    frames_add(f, RELIGHT_TYPE_ROOM_PRESENCE, 0, &m.base, NULL, 0);
    frames_send(f);
}

static double now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

struct watcher {
    struct frames *f;
    unsigned n_key; // participants that it was told of
    uint64_t key[2 * SEATS];
    uint32_t newest[2 * SEATS];
    size_t bytes;
};

static void take_presence(struct watcher *w, const struct reply *r)
{
    if (((Relight__Event *)r->message)->kind != RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE)
        return;
    Relight__Presence *p = relight__presence__unpack(NULL, r->n, r->payload);
    assert_in_range(r->n, 1, 300 << 10); // one message has a bound, too
    w->bytes += r->n;
    for (size_t i = 0; i < p->n_participants; i++) {
        unsigned k = 0;
        while (k < w->n_key && w->key[k] != p->participants[i]->key) k++;
        assert_in_range(k, 0, 2 * SEATS - 1);
        w->n_key += k == w->n_key;
        w->key[k] = p->participants[i]->key;
        w->newest[k] = p->participants[i]->color;
    }
    relight__presence__free_unpacked(p, NULL);
}

// Takes what is there.
static void drain(struct watcher *w)
{
    struct reply r;
    while (reply_next(w->f, 20, 0, &r, NULL)) {
        assert_false(r.closed);
        assert_int_equal(r.code, 0);
        take_presence(w, &r);
        reply_free(&r);
    }
}

// Each of many who say much as often as they can is told of all others, and what the daemon
// sends for it has a bound: the newest is sent, and less often.
static void presence_has_a_bound(void **unused)
{
    static struct watcher w[SEATS + 1];
    char room[33];
    begin(NULL);
    memset(w, 0, sizeof w);
    for (int i = 0; i < SEATS; i++) w[i].f = frames_open(&d);
    room_create(w[0].f, "crowd", room);
    for (int i = 0; i < SEATS; i++) {
        room_add_subscribe(w[i].f, 20, room, 0, "");
        frames_send(w[i].f);
    }
    double begun = now_s(), last = begun;
    uint32_t number = 0;
    while (last < begun + 3) {
        number++;
        for (int i = 0; i < SEATS; i++) say(w[i].f, 20, number);
        for (int i = 0; i < SEATS; i++) drain(&w[i]);
        last = now_s();
    }
    size_t bytes = 0;
    for (int i = 0; i < SEATS; i++) bytes += w[i].bytes;
    double rate = (double)bytes / (last - begun);
    print_message("%u changes of %d, %.1f MB a second\n", number, SEATS, rate * 1e-6);
    assert_true(rate < 25e6); // one round beside 16 MB a second
    // In the end everybody knows the newest of all, as does one who comes now.
    w[SEATS].f = frames_open(&d);
    room_add_subscribe(w[SEATS].f, 20, room, 0, "");
    frames_send(w[SEATS].f);
    for (int i = 0; i <= SEATS; i++) {
        unsigned known = 0;
        for (int k = 0; k < 1000 && known < SEATS; k++, sleep_ms(10)) {
            drain(&w[i]);
            known = 0;
            for (unsigned q = 0; q < w[i].n_key; q++) known += w[i].newest[q] == number;
        }
        assert_int_equal(known, SEATS);
    }
    for (int i = 0; i <= SEATS; i++) frames_close(w[i].f);
    end();
}

// A participant is told of everybody who leaves. When more leave at once than the room
// remembers, the participant is sent the list of those who are still there.
static void a_crowd_leaves_at_once(void **unused)
{
    enum { CROWD = 150 };
    static uint64_t key[4 * CROWD];
    unsigned n = 0;
    char room[33];
    begin(NULL);
    struct frames *ann = frames_open(&d), *crowd = frames_open(&d);
    room_create(ann, "crowd", room);
    room_add_subscribe(ann, 20, room, 0, "Ann");
    frames_send(ann);
    for (uint64_t i = 0; i < CROWD; i++) room_add_subscribe(crowd, 30 + i, room, 0, "one");
    frames_send(crowd);
    for (int gone = 0; gone < 2; gone++) {
        const double end = now_s() + 20;
        while (n != (gone ? 1 : CROWD + 1) && now_s() < end) {
            struct reply r;
            if (!reply_next(ann, 20, 100, &r, NULL)) continue;
            assert_false(r.closed);
            const Relight__Event *e = (Relight__Event *)r.message;
            if (e->kind == RELIGHT__EVENT_KIND__EVENT_ROOM_PRESENCE) {
                Relight__Presence *p = relight__presence__unpack(NULL, r.n, r.payload);
                if (e->lost) n = 0;
                for (size_t i = 0; i < p->n_participants; i++) {
                    unsigned k = 0;
                    while (k < n && key[k] != p->participants[i]->key) k++;
                    if (k < n && p->participants[i]->gone) key[k] = key[--n];
                    else if (k == n && !p->participants[i]->gone)
                        key[n++] = p->participants[i]->key;
                }
                relight__presence__free_unpacked(p, NULL);
            }
            reply_free(&r);
        }
        assert_int_equal(n, gone ? 1 : CROWD + 1);
        if (!gone) frames_close(crowd);
    }
    frames_close(ann);
    end();
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(guests_share_their_inviters_limits, teardown),
        cmocka_unit_test_teardown(a_room_has_its_owners_memory, teardown),
        cmocka_unit_test_teardown(refused_edits_hold_nothing, teardown),
        cmocka_unit_test_teardown(a_full_disk_closes_rooms, teardown),
        cmocka_unit_test_teardown(unused_rooms_leave_memory, teardown),
        cmocka_unit_test_teardown(presence_has_a_bound, teardown),
        cmocka_unit_test_teardown(a_crowd_leaves_at_once, teardown),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
