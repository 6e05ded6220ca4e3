// SPDX-License-Identifier: MIT
// The rule by which events make a room: replicas agree, refused events change nothing, people
// undo their own changes alone.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "room_actions.h"
#include "rooms/fold.h"
#include "rooms/room_private.h"
#include "rooms/state.h"
#include "store/holds.h"

static const char room[] = "0123456789abcdef0123456789abcdef";
enum { ROUNDS = 30, EVENTS = 300 };

static Relight__RoomState *begin(struct rnd *r)
{
    struct room_act a;
    struct room_evt e;
    char error[ROOM_ERROR];
    Relight__RoomState *state = room_state_new(room);
    assert_non_null(state);
    act_start(&a, r);
    evt_make(&e, &a.action, 0, RELIGHT__ROOM_ROLE__ROLE_OWNER, 1, 1000);
    assert_int_equal(room_fold(state, &e.event, error), 0);
    return state;
}

static void same(const Relight__RoomState *a, const Relight__RoomState *b)
{
    char x[65], y[65];
    assert_true(room_state_hash(a, x) && room_state_hash(b, y));
    assert_string_equal(x, y);
}

// The same event after it was on the wire and on the disk.
static int fold_bytes(Relight__RoomState *state, const Relight__RoomEvent *event)
{
    char error[ROOM_ERROR];
    Relight__RoomEvent *copy = message_copy(event);
    int code = room_fold(state, copy, error);
    relight__room_event__free_unpacked(copy, NULL);
    return code;
}

static void refused_changes_nothing(Relight__RoomState *state, const Relight__RoomEvent *event)
{
    char before[65], after[65], error[ROOM_ERROR] = "";
    assert_true(room_state_hash(state, before));
    int code = room_fold(state, event, error);
    assert_int_not_equal(code, 0);
    assert_true(error[0] && !strchr(error, '\n'));
    assert_true(room_state_hash(state, after));
    assert_string_equal(before, after);
}

static void replicas_agree(void **unused)
{
    unsigned accepted = 0, refused = 0;
    for (uint64_t seed = 0; seed < ROUNDS; seed++) {
        struct rnd r;
        rnd_seed(&r, seed);
        Relight__RoomState *live = begin(&r), *replica = message_copy(live), *late = NULL;
        uint32_t cut = rnd(&r, EVENTS);
        for (uint32_t i = 0; i < EVENTS; i++) {
            struct room_act a;
            struct room_evt e;
            char error[ROOM_ERROR];
            act_random(&a, &r, live->sequence);
            evt_make(&e, &a.action, rnd(&r, 4), (int)rnd(&r, 4), live->sequence + 1,
                     live->changed_us + rnd(&r, 2000000));
            Relight__RoomState *copy = message_copy(live); // a trial, where it may be refused
            if (room_fold(copy, &e.event, error)) {
                refused_changes_nothing(live, &e.event);
                refused++;
            } else {
                assert_int_equal(room_fold(live, &e.event, error), 0);
                assert_int_equal(fold_bytes(replica, &e.event), 0);
                if (late) assert_int_equal(fold_bytes(late, &e.event), 0);
                accepted++;
                // Twice, and out of order, is refused.
                refused_changes_nothing(live, &e.event);
                e.stamp.sequence += 2;
                refused_changes_nothing(live, &e.event);
            }
            if (i == cut) late = message_copy(live); // one who joins with a snapshot
            room_state_free(copy);
        }
        same(live, replica);
        same(live, late);
        room_state_free(live);
        room_state_free(replica);
        room_state_free(late);
    }
    print_message("%u events accepted, %u refused\n", accepted, refused);
    assert_true(accepted > ROUNDS * EVENTS / 10 && refused > ROUNDS * EVENTS / 10);
}

// Three people who change different things: every interleaving of what they do ends the same.
static void person_acts(Relight__RoomState *state, unsigned person, unsigned step,
                        uint64_t *pin)
{
    static char *const parts[] = {"lights", "material", "camera"};
    struct rnd r;
    struct room_act a;
    struct room_evt e;
    char error[ROOM_ERROR];
    rnd_seed(&r, person * 1000 + step);
    memset(&a, 0, sizeof a);
    relight__room_action__init(&a.action);
    snprintf(a.text, sizeof a.text, "%u says %u", person, step);
    if (step % 3 == 0) {
        act_change(&a, &r);
        a.change.n_parts = 1;
        a.parts[0] = parts[person];
    } else if (!*pin) {
        relight__put_pin__init(&a.pin);
        relight__seen__init(&a.seen);
        act_point(&a.point[0], &r);
        a.pin = (Relight__PutPin){a.pin.base,         a.text, &a.point[0], NULL,
                                  a.pin.picture_hash, &a.seen};
        a.action.pin = &a.pin;
        *pin = state->sequence + 1;
    } else {
        relight__put_note__init(&a.note);
        a.note.target = *pin;
        a.note.text = a.text;
        a.action.reply = &a.note;
    }
    evt_make(&e, &a.action, person, RELIGHT__ROOM_ROLE__ROLE_REVIEWER, state->sequence + 1,
             state->changed_us + 5000000);
    assert_int_equal(room_fold(state, &e.event, error), 0);
}

static void describe(const Relight__RoomState *state, char scene[65], uint64_t *notes)
{
    assert_true(room_message_hash(&state->scene->base, scene));
    *notes = 0; // a sum does not depend on the order of pins
    for (size_t i = 0; i < state->n_pins; i++) {
        uint64_t chain = 0;
        for (size_t j = 0; j < state->pins[i]->n_notes; j++)
            for (const char *c = state->pins[i]->notes[j]->text; *c; c++)
                chain = chain * 1099511628211u + (unsigned char)*c;
        *notes += chain;
    }
}

static void interleavings(void **unused)
{
    char scene[65], first[65];
    uint64_t notes, first_notes;
    for (uint64_t seed = 0; seed < 200; seed++) {
        struct rnd r, same_begin;
        rnd_seed(&r, seed);
        rnd_seed(&same_begin, 1);
        Relight__RoomState *state = begin(&same_begin);
        unsigned step[3] = {0};
        uint64_t pin[3] = {0};
        for (unsigned left = 30; left;) {
            unsigned person = rnd(&r, 3);
            if (step[person] == 10) continue;
            person_acts(state, person, step[person]++, &pin[person]);
            left--;
        }
        describe(state, scene, &notes);
        if (!seed) memcpy(first, scene, sizeof first), first_notes = notes;
        assert_string_equal(scene, first);
        assert_true(notes == first_notes);
        room_state_free(state);
    }
}

// ---- undo

struct table {
    char *principal; // of everybody; NULL: each has one of their own
    Relight__RoomState *state;
    uint64_t now_us;
};

static int rotate(struct table *t, unsigned person, float deg, uint64_t pause_us,
                  uint64_t since)
{
    struct room_act a;
    struct room_evt e;
    struct rnd r;
    char error[ROOM_ERROR];
    rnd_seed(&r, 7);
    memset(&a, 0, sizeof a);
    relight__room_action__init(&a.action);
    act_change(&a, &r);
    a.change.n_parts = 1;
    a.parts[0] = "lights";
    a.change.since = since;
    a.scene.n_lights = 1;
    a.light[0].rotate_deg = deg;
    evt_make(&e, &a.action, person, 2, t->state->sequence + 1, t->now_us += pause_us);
    if (t->principal) e.stamp.by = t->principal;
    return room_fold(t->state, &e.event, error);
}

static int step_back(struct table *t, unsigned person, bool undo)
{
    Relight__Nothing nothing = RELIGHT__NOTHING__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    struct room_evt e;
    char error[ROOM_ERROR];
    if (undo) action.undo = &nothing;
    else action.redo = &nothing;
    evt_make(&e, &action, person, 2, t->state->sequence + 1, t->now_us += 5000000);
    if (t->principal) e.stamp.by = t->principal;
    return room_fold(t->state, &e.event, error);
}

static void lit(const struct table *t, float deg)
{
    assert_int_equal(t->state->scene->n_lights, 1);
    assert_float_equal(t->state->scene->lights[0]->rotate_deg, deg, 0);
}

enum { ANN, BOB };
static const uint64_t slow = 5000000, fast = 40000;

static void undo_of(char *principal)
{
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {principal, begin(&r), 1000000};
    rotate(&t, ANN, 10, slow, 0);
    rotate(&t, ANN, 20, slow, 0);
    assert_int_equal(step_back(&t, ANN, true), 0);
    lit(&t, 10);
    assert_int_equal(step_back(&t, ANN, false), 0);
    lit(&t, 20);
    assert_int_equal(step_back(&t, ANN, false), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    // Bob has nothing to undo; after his change Ann's can not be undone, after his undo it can.
    assert_int_equal(step_back(&t, BOB, true), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    rotate(&t, BOB, 30, slow, 0);
    assert_int_equal(step_back(&t, ANN, true), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    lit(&t, 30);
    assert_int_equal(step_back(&t, BOB, true), 0);
    lit(&t, 20);
    assert_int_equal(step_back(&t, ANN, true), 0);
    assert_int_equal(step_back(&t, ANN, true), 0);
    assert_int_equal(step_back(&t, ANN, true), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_int_equal(step_back(&t, ANN, false), 0);
    lit(&t, 10);
    // A new change forgets what could be redone.
    rotate(&t, ANN, 40, slow, 0);
    assert_int_equal(step_back(&t, ANN, false), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    assert_int_equal(step_back(&t, ANN, true), 0);
    assert_int_equal(step_back(&t, ANN, false), 0);
    lit(&t, 40);
    room_state_free(t.state);
}

// Two people behind one principal are told apart by their names.
static void undo_by_person(void **unused)
{
    static char address[] = "addr:127.0.0.1";
    undo_of(NULL);
    undo_of(address);
}

static void a_drag_is_one_step(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 1000000};
    rotate(&t, ANN, 1, slow, 0);
    for (int i = 0; i < 200; i++) rotate(&t, ANN, (float)(100 + i), i ? fast : slow, 0);
    assert_int_equal(t.state->n_undo, 2);
    assert_int_equal(step_back(&t, ANN, true), 0);
    lit(&t, 1);
    // Another's change between ends the drag.
    rotate(&t, ANN, 2, slow, 0);
    rotate(&t, BOB, 3, fast, 0);
    rotate(&t, ANN, 4, fast, 0);
    assert_int_equal(step_back(&t, ANN, true), 0);
    lit(&t, 3);
    for (int i = 0; i < 3 * ROOM_MAX_UNDO; i++) rotate(&t, ANN, (float)i, slow, 0);
    assert_true(t.state->n_undo <= ROOM_MAX_UNDO + 1);
    room_state_free(t.state);
}

static int step_after(struct table *t, unsigned person, bool undo, uint64_t pause_us)
{
    const uint64_t then = t->now_us + pause_us;
    t->now_us = then - 5000000; // step_back() waits so long
    return step_back(t, person, undo);
}

// A change a second after another continues the drag, a later one does not; nor does one after
// an undo and a redo, however fast.
static void a_pause_ends_a_drag(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 10000000};
    rotate(&t, ANN, 1, slow, 0);
    rotate(&t, ANN, 2, 1000000, 0);
    rotate(&t, ANN, 3, 1000000, 0);
    assert_int_equal(t.state->n_undo, 1);
    const uint64_t last_us = t.now_us;
    rotate(&t, ANN, 4, 1000001, 0);
    assert_int_equal(t.state->n_undo, 2);
    assert_int_equal(step_after(&t, ANN, true, fast), 0);
    assert_true(t.state->parts[1]->stamp->time_us == last_us); // of the last moment of the drag
    assert_int_equal(step_after(&t, ANN, false, fast), 0);
    rotate(&t, ANN, 5, fast, 0);
    assert_int_equal(t.state->n_undo, 3);
    assert_int_equal(step_back(&t, ANN, true), 0);
    lit(&t, 4);
    assert_int_equal(step_back(&t, ANN, true), 0);
    lit(&t, 3);
    assert_int_equal(step_back(&t, ANN, true), 0);
    assert_int_equal(step_back(&t, ANN, false), 0);
    assert_true(t.state->parts[1]->stamp->time_us == last_us);
    room_state_free(t.state);
}

// A person can undo ROOM_MAX_UNDO changes, everybody together ROOM_MAX_UNDO_ALL.
static void steps_are_bounded(void **unused)
{
    static char name[] = "token:a";
    enum { PEOPLE = ROOM_MAX_UNDO_ALL / ROOM_MAX_UNDO + 2 };
    struct rnd r;
    unsigned undone = 0;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 1000000};
    for (int i = 0; i < ROOM_MAX_UNDO + 9; i++) rotate(&t, ANN, (float)i, slow, 0);
    assert_int_equal(t.state->n_undo, ROOM_MAX_UNDO);
    while (!step_back(&t, ANN, true)) undone++;
    assert_int_equal(undone, ROOM_MAX_UNDO);
    lit(&t, 8);
    t.principal = name;
    for (int p = 0; p < PEOPLE; p++) {
        name[6] = (char)('a' + p);
        for (int i = 0; i < ROOM_MAX_UNDO; i++) rotate(&t, ANN, (float)i, slow, 0);
    }
    assert_int_equal(t.state->n_undo, ROOM_MAX_UNDO_ALL);
    // The oldest went first.
    assert_int_equal(step_back(&t, ANN, true), 0);
    name[6] = 'a';
    assert_int_equal(step_back(&t, ANN, true), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    room_state_free(t.state);
}

static void conflicts_are_told(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 1000000};
    uint64_t seen = t.state->sequence;
    assert_int_equal(rotate(&t, BOB, 5, slow, 0), 0);
    // Ann was offline since `seen`.
    assert_int_equal(rotate(&t, ANN, 6, slow, seen), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    lit(&t, 5);
    assert_int_equal(rotate(&t, ANN, 6, slow, t.state->sequence), 0);
    seen = t.state->sequence;
    assert_int_equal(step_back(&t, ANN, true), 0); // an undo is a change, too
    assert_int_equal(rotate(&t, BOB, 7, slow, seen), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    room_state_free(t.state);
}

// ---- roles, mentions, revisions

static int act(struct table *t, unsigned person, int role, const Relight__RoomAction *action)
{
    struct room_evt e;
    char error[ROOM_ERROR];
    evt_make(&e, action, person, role, t->state->sequence + 1, t->now_us += slow);
    return room_fold(t->state, &e.event, error);
}

static void roles(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 9);
    struct table t = {NULL, begin(&r), 1000000};
    unsigned tried = 0;
    for (int i = 0; i < 2000; i++) {
        struct room_act a;
        act_random(&a, &r, t.state->sequence);
        bool owners = a.action.member || a.action.invite || *a.action.revoke ||
                      a.action.rename || a.action.close;
        assert_int_equal(act(&t, BOB, RELIGHT__ROOM_ROLE__ROLE_VIEWER, &a.action),
                         RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
        if (!owners) continue;
        assert_int_equal(act(&t, BOB, RELIGHT__ROOM_ROLE__ROLE_REVIEWER, &a.action),
                         RELIGHT__ERROR_CODE__ERROR_FORBIDDEN);
        tried++;
    }
    assert_true(tried > 100);
    assert_int_equal(room_role(t.state, "token:ann", 0), RELIGHT__ROOM_ROLE__ROLE_OWNER);
    assert_int_equal(room_role(t.state, "token:eve", 0), RELIGHT__ROOM_ROLE__ROLE_NONE);
    // The last owner stays.
    Relight__Member member = RELIGHT__MEMBER__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    action.member = &member;
    member.by = "token:ann";
    assert_int_equal(act(&t, ANN, 3, &action), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    member.by = "*";
    member.role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    assert_int_equal(act(&t, ANN, 3, &action), 0);
    assert_int_equal(room_role(t.state, "token:eve", 0), RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    assert_int_equal(room_role(t.state, "guest:0001", 0), RELIGHT__ROOM_ROLE__ROLE_NONE);
    Relight__Invite invite = RELIGHT__INVITE__INIT;
    Relight__RoomAction other = RELIGHT__ROOM_ACTION__INIT;
    char hash[65];
    memset(hash, 'a', 64);
    hash[64] = 0;
    other.invite = &invite;
    invite.id = "0001";
    invite.hash = hash;
    invite.role = RELIGHT__ROOM_ROLE__ROLE_REVIEWER;
    invite.expires_s = 100;
    assert_int_equal(act(&t, ANN, 3, &other), 0);
    assert_int_equal(room_role(t.state, "guest:0001", 99), RELIGHT__ROOM_ROLE__ROLE_REVIEWER);
    assert_int_equal(room_role(t.state, "guest:0001", 100), RELIGHT__ROOM_ROLE__ROLE_NONE);
    other.invite = NULL;
    other.revoke = "0001";
    assert_int_equal(act(&t, ANN, 3, &other), 0);
    assert_int_equal(room_role(t.state, "guest:0001", 50), RELIGHT__ROOM_ROLE__ROLE_NONE);
    room_state_free(t.state);
}

static int vary(struct table *t, char *name, char *material)
{
    Relight__PutVariant variant = RELIGHT__PUT_VARIANT__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    variant.name = name;
    variant.material = material;
    action.variant = &variant;
    return act(t, ANN, 2, &action);
}

// A room has one variant of a name, with its last material; one without material is removed.
static void variants(void **unused)
{
    enum { LIMIT = RELIGHT__ERROR_CODE__ERROR_LIMIT };
    static char longest[ROOM_MAX_NAME + 2], material[ROOM_MAX_MATERIAL + 2];
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 1000000};
    char name[] = "v0";
    for (int turn = 0; turn < 2; turn++)
        for (int i = 0; i < 3; i++) {
            name[1] = (char)('0' + i);
            assert_int_equal(vary(&t, name, turn ? "jade" : "skin1"), 0);
        }
    assert_int_equal(vary(&t, "v2", "marble"), 0); // the last one of the list
    assert_int_equal(t.state->n_variants, 3);
    for (int i = 0; i < 3; i++) {
        assert_int_equal(t.state->variants[i]->name[1], '0' + i);
        assert_string_equal(t.state->variants[i]->material, i < 2 ? "jade" : "marble");
    }
    for (int i = 2; i >= 0; i -= 2) {
        name[1] = (char)('0' + i);
        assert_int_equal(vary(&t, name, ""), 0);
        assert_int_equal(vary(&t, name, ""), RELIGHT__ERROR_CODE__ERROR_NOT_FOUND);
    }
    assert_int_equal(t.state->n_variants, 1);
    assert_string_equal(t.state->variants[0]->name, "v1");
    memset(longest, 'n', ROOM_MAX_NAME);
    memset(material, 'm', ROOM_MAX_MATERIAL);
    assert_int_equal(vary(&t, longest, material), 0);
    longest[ROOM_MAX_NAME] = 'n';
    assert_int_equal(vary(&t, longest, "jade"), LIMIT);
    assert_int_equal(vary(&t, "", "jade"), LIMIT);
    longest[ROOM_MAX_NAME] = 0;
    assert_int_equal(vary(&t, longest, ""), 0);
    for (int i = 1; i < ROOM_MAX_VARIANTS; i++) {
        snprintf(longest, sizeof longest, "variant %d", i);
        assert_int_equal(vary(&t, longest, "jade"), 0);
    }
    assert_int_equal(vary(&t, "one more", "jade"), LIMIT);
    assert_int_equal(vary(&t, "v1", "marble"), 0); // a new material needs no place
    assert_int_equal(t.state->n_variants, ROOM_MAX_VARIANTS);
    room_state_free(t.state);
}

static int paint(struct table *t, char *material, char *pose)
{
    static char *parts[] = {"material", "model"};
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    Relight__SceneChange change = RELIGHT__SCENE_CHANGE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    scene.material = material;
    scene.pose = pose;
    change.scene = &scene;
    change.parts = parts;
    change.n_parts = 2;
    action.scene = &change;
    return act(t, ANN, 2, &action);
}

static int save_scene(struct table *t)
{
    Relight__SaveRevision save = RELIGHT__SAVE_REVISION__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    action.save = &save;
    return act(t, ANN, 2, &action);
}

// Revisions count materials by themselves: each new one has the next number, one that was there
// has its own. A pose belongs to the model, also when it is undone.
static void materials_are_numbered(void **unused)
{
    static char *const material[] = {"jade", "jade", "skin1", "jade", "marble", "skin1"};
    static const uint32_t number[] = {1, 1, 2, 1, 3, 2};
    enum { N = sizeof number / sizeof *number };
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 1000000};
    char pose[] = "pose 0";
    const size_t first = t.state->n_revisions;
    for (int i = 0; i < N; i++) {
        pose[5] = (char)('0' + i);
        assert_int_equal(paint(&t, material[i], pose), 0);
        assert_string_equal(t.state->scene->pose, pose);
        assert_int_equal(save_scene(&t), 0);
        assert_int_equal(save_scene(&t), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
        assert_int_equal(t.state->revisions[first + i]->number, first + i + 1);
        assert_int_equal(t.state->revisions[first + i]->material, number[i]);
    }
    assert_int_equal(step_back(&t, ANN, true), 0);
    assert_string_equal(t.state->scene->pose, "pose 4");
    assert_string_equal(t.state->scene->material, "marble");
    room_state_free(t.state);
}

// The last of ROOM_MAX_REVISIONS is kept, and no more.
static void revisions_are_bounded(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 3);
    struct table t = {NULL, begin(&r), 1000000};
    Relight__Revision one = RELIGHT__REVISION__INIT;
    Relight__Scene scene = RELIGHT__SCENE__INIT;
    one.scene = &scene;
    assert_int_equal(t.state->n_revisions, 0);
    for (int i = 0; i < ROOM_MAX_REVISIONS - 1; i++)
        assert_non_null(list_add(&t.state->revisions, &t.state->n_revisions, &one));
    assert_int_equal(save_scene(&t), 0);
    assert_int_equal(t.state->n_revisions, ROOM_MAX_REVISIONS);
    rotate(&t, ANN, 50, slow, 0);
    assert_int_equal(save_scene(&t), RELIGHT__ERROR_CODE__ERROR_LIMIT);
    t.state->revisions[0] = t.state->revisions[ROOM_MAX_REVISIONS - 1];
    t.state->n_revisions = 1; // the others are `one`
    room_state_free(t.state);
}

// What a scene may hold at all.
static void scenes_that_are_refused(void **unused)
{
    enum { GOOD, SIXTEEN, LIGHTS, TEXELS, ID, SHORT, LONG, UPPER, SHADE, MEDIA, CAMERA, N };
    for (int fault = 0; fault < N; fault++) {
        char error[ROOM_ERROR] = "", id[] = "0123456789abcdef0123456789abcdef0";
        Relight__Scene s = RELIGHT__SCENE__INIT;
        Relight__Light light = RELIGHT__LIGHT__INIT, *lights[17];
        Relight__Shade shade = RELIGHT__SHADE__INIT;
        Relight__Camera camera = RELIGHT__CAMERA__INIT;
        Relight__Picture picture = RELIGHT__PICTURE__INIT;
        Relight__ObjectMaterial media[65], *list[65];
        for (int i = 0; i < 17; i++) lights[i] = &light;
        for (int i = 0; i < 65; i++) {
            relight__object_material__init(list[i] = &media[i]);
            media[i].object = "wax", media[i].material = "marble";
        }
        id[32] = 0;
        s.model = id, s.lights = lights, s.camera = &camera;
        s.shade = &shade, s.picture = &picture;
        s.n_lights = fault == SIXTEEN ? 16 : fault == LIGHTS ? 17 : 1;
        shade.materials = list, shade.n_materials = fault == MEDIA ? 65 : 64;
        if (fault == TEXELS) light.cube_n = 16;
        if (fault == ID) id[31] = 'g';
        if (fault == SHORT) id[31] = 0;
        if (fault == LONG) id[32] = '0';
        if (fault == UPPER) id[10] = 'A';
        if (fault == SHADE) shade.material = "jade";
        if (fault == CAMERA) picture.camera = &camera;
        const int code = room_scene_check(&s, error);
        assert_int_equal(code, fault == GOOD || fault == SIXTEEN ? 0
                               : fault == LIGHTS || fault == MEDIA
                                   ? RELIGHT__ERROR_CODE__ERROR_LIMIT
                                   : RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
        assert_int_equal(error[0] != 0, code != 0);
    }
}

// Numbers are finite and texts bounded, at every depth and in every entry of a list.
static void messages_that_are_no_use(void **unused)
{
    static char text[ROOM_MAX_MATERIAL + 2];
    static const float numbers[] = {0, -3e38f, 0.0f / 0.0f, 1.0f / 0.0f, -1.0f / 0.0f};
    char error[ROOM_ERROR];
    Relight__Scene s = RELIGHT__SCENE__INIT;
    Relight__Light light[3], *lights[3];
    for (int i = 0; i < 3; i++) relight__light__init(lights[i] = &light[i]);
    s.lights = lights, s.n_lights = 3;
    for (size_t i = 0; i < sizeof numbers / sizeof *numbers; i++)
        for (int j = 0; j < 3; j++) {
            light[j].rotate_deg = numbers[i];
            assert_int_equal(room_message_sane(&s.base, error), i < 2);
            if (i >= 2) assert_non_null(strstr(error, "rotate_deg: not a finite number"));
            light[j].rotate_deg = 0;
        }
    memset(text, 't', ROOM_MAX_MATERIAL);
    s.material = text;
    assert_true(room_message_sane(&s.base, error));
    text[ROOM_MAX_MATERIAL] = 't';
    assert_false(room_message_sane(&s.base, error));
    s.material = "";
    light[2].env = text;
    assert_false(room_message_sane(&s.base, error));
    light[2].env = "";
    light[1].base.n_unknown_fields = 1;
    assert_false(room_message_sane(&s.base, error));
}

// Invitations that are over take no place of those in force.
static void invitations_that_are_over(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 10);
    struct table t = {NULL, begin(&r), 1000000};
    Relight__Invite invite = RELIGHT__INVITE__INIT;
    Relight__RoomAction more = RELIGHT__ROOM_ACTION__INIT, revoke = more;
    char hash[65] = "", id[16];
    memset(hash, 'a', 64);
    more.invite = &invite;
    invite.id = id;
    invite.hash = hash;
    invite.role = RELIGHT__ROOM_ROLE__ROLE_VIEWER;
    for (int i = 0; i < ROOM_MAX_INVITES; i++) {
        snprintf(id, sizeof id, "%04d", i);
        // One ends after the others were made.
        invite.expires_s = i == 500 ? (t.now_us + 1200 * slow) / 1000000 : 0;
        assert_int_equal(act(&t, ANN, 3, &more), 0);
    }
    invite.expires_s = 0;
    strcpy(id, "new1");
    assert_int_equal(act(&t, ANN, 3, &more), RELIGHT__ERROR_CODE__ERROR_LIMIT);
    revoke.revoke = "0007";
    assert_int_equal(act(&t, ANN, 3, &revoke), 0);
    assert_int_equal(act(&t, ANN, 3, &more), 0);
    assert_int_equal(t.state->n_invites, ROOM_MAX_INVITES);
    strcpy(id, "new2");
    assert_int_equal(act(&t, ANN, 3, &more), RELIGHT__ERROR_CODE__ERROR_LIMIT);
    t.now_us += 1200 * slow;
    assert_int_equal(act(&t, ANN, 3, &more), 0);
    assert_int_equal(room_role(t.state, "guest:new2", 0), RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    assert_int_equal(room_role(t.state, "guest:0008", 0), RELIGHT__ROOM_ROLE__ROLE_VIEWER);
    room_state_free(t.state);
}

static void notes_and_revisions(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 11);
    struct table t = {NULL, begin(&r), 1000000};
    struct room_act a;
    memset(&a, 0, sizeof a);
    relight__room_action__init(&a.action);
    relight__put_pin__init(&a.pin);
    relight__seen__init(&a.seen);
    act_point(&a.point[0], &r);
    a.pin.at = &a.point[0];
    a.pin.seen = &a.seen;
    a.pin.text = "@Ann: too red, ask @bob.k. mail@x.org @Ann";
    a.action.pin = &a.pin;
    assert_int_equal(act(&t, BOB, 2, &a.action), 0);
    const Relight__Pin *pin = t.state->pins[0];
    assert_int_equal(pin->notes[0]->n_mentions, 2);
    assert_string_equal(pin->notes[0]->mentions[0], "Ann");
    assert_string_equal(pin->notes[0]->mentions[1], "bob.k");
    assert_int_equal(pin->seen->revision, 1);
    // The same scene is the same revision; another light is another one.
    assert_int_equal(act(&t, ANN, 2, &a.action), 0);
    assert_int_equal(t.state->n_revisions, 1);
    rotate(&t, ANN, 77, slow, 0);
    assert_int_equal(act(&t, ANN, 2, &a.action), 0);
    assert_int_equal(t.state->n_revisions, 2);
    assert_int_equal(t.state->revisions[1]->material, 1);
    assert_int_equal(step_back(&t, ANN, true), 0);
    assert_int_equal(act(&t, ANN, 2, &a.action), 0);
    assert_int_equal(t.state->pins[3]->seen->revision, 1);
    // A decision is bound to what was seen.
    Relight__RoomAction decide = RELIGHT__ROOM_ACTION__INIT;
    relight__decide__init(&a.decide);
    a.decide.seen = &a.seen;
    a.seen.bake_hash = "0011223344556677";
    decide.decide = &a.decide;
    assert_int_equal(act(&t, ANN, 2, &decide), 0);
    a.seen.bake_hash = "0011223344556678";
    assert_int_equal(act(&t, ANN, 2, &decide), 0);
    assert_string_not_equal(t.state->decisions[0]->hash, t.state->decisions[1]->hash);
    // It is refused where the picture was made from another file.
    Relight__Drawn drawn = RELIGHT__DRAWN__INIT;
    a.decide.drawn = &drawn;
    drawn.mesh_hash = a.seen.mesh_hash;
    drawn.bake_hash = "0011223344556677";
    assert_int_equal(act(&t, ANN, 2, &decide), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    drawn.bake_hash = a.seen.bake_hash;
    assert_int_equal(act(&t, ANN, 2, &decide), 0);
    drawn.mesh_hash = "8899aabbccddeeff";
    assert_int_equal(act(&t, ANN, 2, &decide), RELIGHT__ERROR_CODE__ERROR_MISMATCH);
    a.decide.drawn = NULL;
    assert_int_equal(t.state->n_decisions, 3);
    // Numbers that are none, and points beside their triangle.
    a.point[0].b1 = 0.9f;
    a.point[0].b2 = 0.9f;
    assert_int_equal(act(&t, ANN, 2, &a.action), RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE);
    a.point[0].b1 = 0.0f / 0.0f;
    assert_int_equal(act(&t, ANN, 2, &a.action), RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    room_state_free(t.state);
}

// Whoever takes the id of another's client, which all can see, does not use up its numbers.
static void numbers_are_of_their_principal(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 17);
    struct table t = {NULL, begin(&r), 1000000};
    struct room_act pin = {0};
    struct room_evt e;
    char error[ROOM_ERROR];
    act_pin(&pin, &r);
    pin.pin.text = "here";
    evt_make(&e, &pin.action, ANN, 2, t.state->sequence + 1, t.now_us += slow);
    char copy[17];
    strcpy(copy, e.client);
    assert_int_equal(room_fold(t.state, &e.event, error), 0);
    evt_make(&e, &pin.action, BOB, 2, t.state->sequence + 1, t.now_us += slow);
    e.event.client = copy;
    e.event.number = UINT64_MAX;
    assert_int_equal(room_fold(t.state, &e.event, error), 0);
    assert_int_equal(room_done_before(t.state, copy, "token:bob", 1), t.state->sequence);
    assert_int_equal(room_done_before(t.state, copy, "token:ann", UINT64_MAX), 0);
    assert_int_equal(act(&t, ANN, 2, &pin.action), 0);
    assert_int_equal(act(&t, BOB, 2, &pin.action), 0); // his own id
    assert_int_equal(t.state->n_pins, 4);
    room_state_free(t.state);
}

// Strokes of other pins, and those of none, stay.
static void an_erased_pin_takes_its_strokes(void **unused)
{
    struct rnd r;
    rnd_seed(&r, 13);
    struct table t = {NULL, begin(&r), 1000000};
    struct room_act pin = {0}, stroke = {0};
    Relight__Erase erase = RELIGHT__ERASE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    act_pin(&pin, &r);
    pin.pin.text = "here";
    relight__room_action__init(&stroke.action);
    act_stroke(&stroke, &r, 0);
    stroke.stroke.n_points = 2;
    for (int i = 0; i < 2; i++) assert_int_equal(act(&t, ANN, 2, &pin.action), 0);
    const uint64_t pins[] = {t.state->pins[0]->stamp->sequence,
                             t.state->pins[1]->stamp->sequence, 0};
    for (int i = 0; i < 6; i++) {
        stroke.stroke.pin = pins[i % 3];
        assert_int_equal(act(&t, BOB, 2, &stroke.action), 0);
    }
    erase.target = pins[0];
    action.erase = &erase;
    assert_int_equal(act(&t, ANN, 2, &action), 0);
    assert_int_equal(t.state->n_pins, 1);
    assert_int_equal(t.state->n_strokes, 4);
    for (int i = 0; i < 4; i++)
        assert_int_equal(t.state->strokes[i]->line->pin, pins[1 + i % 2]);
    room_state_free(t.state);
}

// Whether the room needs this upload on the disk.
static bool needs(const Relight__RoomState *state, const char *hash)
{
    char *names = room_needs(state);
    assert_non_null(names);
    bool has = holds_among(names, hash);
    free(names);
    return has;
}

// A light that was replaced is needed while it can come back: not in a closed room.
static void what_can_be_undone_is_needed(void **unused)
{
    static char env[] = "env:bce0aff19cf5aa6a7469a30d61d04e4376e4bbf6381052ee9e7f33925c954d52";
    struct rnd r;
    rnd_seed(&r, 17);
    struct table t = {NULL, begin(&r), 1000000};
    struct room_act a;
    Relight__RoomClose close = RELIGHT__ROOM_CLOSE__INIT;
    Relight__RoomAction action = RELIGHT__ROOM_ACTION__INIT;
    memset(&a, 0, sizeof a);
    relight__room_action__init(&a.action);
    act_change(&a, &r);
    a.change.n_parts = 1;
    a.parts[0] = "lights";
    a.scene.n_lights = 1;
    a.light[0].env = env;
    assert_false(needs(t.state, env + 4));
    assert_int_equal(act(&t, ANN, 3, &a.action), 0);
    assert_true(needs(t.state, env + 4));
    assert_int_equal(rotate(&t, ANN, 10, slow, 0), 0);
    assert_true(needs(t.state, env + 4));
    action.close = &close;
    close.closed = true;
    assert_int_equal(act(&t, ANN, 3, &action), 0);
    assert_false(needs(t.state, env + 4));
    room_state_free(t.state);
}

// A scene's map of media is kept as it is; an entry without object or medium is refused.
static void media_by_object(void **unused)
{
    (void)unused;
    for (int fault = 0; fault < 3; fault++) {
        struct rnd r;
        struct room_act a;
        struct room_evt e;
        char error[ROOM_ERROR];
        rnd_seed(&r, 7);
        Relight__RoomState *state = begin(&r);
        memset(&a, 0, sizeof a);
        relight__room_action__init(&a.action);
        act_change(&a, &r);
        a.change.n_parts = 1;
        a.parts[0] = "shade";
        a.shade.n_materials = 2;
        if (fault == 1) a.medium[1].material = "";
        if (fault == 2) a.medium[0].object = "";
        evt_make(&e, &a.action, 0, RELIGHT__ROOM_ROLE__ROLE_OWNER, state->sequence + 1,
                 state->changed_us + 1);
        int code = room_fold(state, &e.event, error);
        assert_int_equal(code, fault ? RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST : 0);
        if (fault) assert_non_null(strstr(error, "shade.materials"));
        else assert_string_equal(state->scene->shade->materials[1]->object, "wick");
        room_state_free(state);
    }
}

// The picture that a pin or a decision names is a SHA-256 in hex; none is named by "".
static void pictures_are_named_by_their_hash(void **unused)
{
    static char hash[] = "bce0aff19cf5aa6a7469a30d61d04e4376e4bbf6381052ee9e7f33925c954d52";
    static char upper[] = "BCE0AFF19CF5AA6A7469A30D61D04E4376E4BBF6381052EE9E7F33925C954D52";
    static char *const bad[] = {"sky.png", hash + 1, upper, "../../../etc/passwd"};
    struct rnd r;
    rnd_seed(&r, 5);
    struct table t = {NULL, begin(&r), 1000000};
    struct room_act pin = {0}, decision = {0};
    act_pin(&pin, &r);
    act_decide(&decision, &r);
    pin.pin.text = decision.decide.note = "seen";
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        pin.pin.picture_hash = decision.decide.picture_hash = bad[i];
        assert_int_equal(act(&t, ANN, RELIGHT__ROOM_ROLE__ROLE_OWNER, &pin.action),
                         RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
        assert_int_equal(act(&t, ANN, RELIGHT__ROOM_ROLE__ROLE_OWNER, &decision.action),
                         RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST);
    }
    for (int named = 0; named < 2; named++) {
        pin.pin.picture_hash = decision.decide.picture_hash = named ? hash : "";
        assert_int_equal(act(&t, ANN, RELIGHT__ROOM_ROLE__ROLE_OWNER, &pin.action), 0);
        assert_int_equal(act(&t, ANN, RELIGHT__ROOM_ROLE__ROLE_OWNER, &decision.action), 0);
    }
    room_state_free(t.state);
}

// A room needs the models of its pins, decisions and revisions; while it is open, also those of
// its scene and of what can be undone. Each is named once.
static void a_closed_room_needs_less(void **unused)
{
    Relight__RoomState s = RELIGHT__ROOM_STATE__INIT;
    Relight__Scene saved = RELIGHT__SCENE__INIT, now = saved, before = saved;
    Relight__Revision revision = RELIGHT__REVISION__INIT, *revisions[] = {&revision, &revision};
    Relight__Pin pin = RELIGHT__PIN__INIT, *pins[] = {&pin};
    Relight__Decision decision = RELIGHT__DECISION__INIT, *decisions[] = {&decision};
    Relight__Seen of_pin = RELIGHT__SEEN__INIT, of_decision = of_pin;
    Relight__UndoStep step = RELIGHT__UNDO_STEP__INIT, *undo[] = {&step};
    saved.model = "saved", now.model = "now", before.model = "before";
    of_pin.model = "pinned", of_decision.model = "decided";
    revision.scene = &saved, pin.seen = &of_pin, decision.seen = &of_decision;
    step.other = &before;
    for (int closed = 0; closed < 2; closed++) {
        s.closed = closed;
        s.scene = &now;
        s.revisions = revisions, s.n_revisions = 2;
        s.pins = pins, s.n_pins = 1;
        s.decisions = decisions, s.n_decisions = 1;
        s.undo = undo, s.n_undo = 1;
        char *needs = room_needs(&s);
        assert_string_equal(needs, closed ? "\ndecided\npinned\nsaved\n"
                                          : "\nbefore\ndecided\nnow\npinned\nsaved\n");
        free(needs);
    }
    s = (Relight__RoomState)RELIGHT__ROOM_STATE__INIT;
    char *none = room_needs(&s);
    assert_string_equal(none, "");
    free(none);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(replicas_agree),
        cmocka_unit_test(interleavings),
        cmocka_unit_test(undo_by_person),
        cmocka_unit_test(a_drag_is_one_step),
        cmocka_unit_test(a_pause_ends_a_drag),
        cmocka_unit_test(steps_are_bounded),
        cmocka_unit_test(conflicts_are_told),
        cmocka_unit_test(variants),
        cmocka_unit_test(materials_are_numbered),
        cmocka_unit_test(revisions_are_bounded),
        cmocka_unit_test(scenes_that_are_refused),
        cmocka_unit_test(messages_that_are_no_use),
        cmocka_unit_test(roles),
        cmocka_unit_test(invitations_that_are_over),
        cmocka_unit_test(notes_and_revisions),
        cmocka_unit_test(an_erased_pin_takes_its_strokes),
        cmocka_unit_test(numbers_are_of_their_principal),
        cmocka_unit_test(what_can_be_undone_is_needed),
        cmocka_unit_test(media_by_object),
        cmocka_unit_test(pictures_are_named_by_their_hash),
        cmocka_unit_test(a_closed_room_needs_less),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
