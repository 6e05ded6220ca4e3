// SPDX-License-Identifier: MIT
// Random actions of a review room, and events made of them.
#ifndef TESTS_UNIT_ROOM_ACTIONS_H
#define TESTS_UNIT_ROOM_ACTIONS_H

#include "../fuzz/random.h"
#include "relight.pb-c.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Everything an action may point to, in one place.
struct room_act {
    Relight__RoomAction action;
    Relight__RoomStart start;
    Relight__RoomRename rename;
    Relight__SceneChange change;
    Relight__SaveRevision save;
    Relight__PutVariant variant;
    Relight__PutPin pin;
    Relight__PutNote note;
    Relight__SetStatus status;
    Relight__PutStroke stroke;
    Relight__Erase erase;
    Relight__Decide decide;
    Relight__Member member;
    Relight__Invite invite;
    Relight__RoomClose close;
    Relight__Nothing nothing;
    Relight__Scene scene;
    Relight__Light light[3], *lights[3];
    Relight__Shade shade;
    Relight__ObjectMaterial medium[2], *media[2];
    Relight__Camera camera;
    Relight__Vec3 eye;
    Relight__Picture picture;
    Relight__SurfacePoint point[4], *points[4];
    Relight__Seen seen;
    char *parts[6];
    char text[80], id[40], hash[65];
};

static inline void act_scene(struct room_act *a, struct rnd *r)
{
    relight__scene__init(&a->scene);
    a->scene.model = rnd_chance(r, 2) ? "11111111111111111111111111111111"
                                      : "22222222222222222222222222222222";
    a->scene.material = rnd_chance(r, 2) ? "jade" : "skin1";
    a->scene.n_lights = rnd(r, 4);
    a->scene.lights = a->lights;
    for (size_t i = 0; i < 3; i++) {
        relight__light__init(&a->light[i]);
        a->light[i].env = "constant";
        a->light[i].rotate_deg = (float)rnd(r, 360);
        a->lights[i] = &a->light[i];
    }
    relight__shade__init(&a->shade);
    a->shade.engine = (Relight__Engine)rnd(r, 9);
    a->shade.n_materials = rnd(r, 3);
    a->shade.materials = a->media;
    for (size_t i = 0; i < 2; i++) {
        relight__object_material__init(&a->medium[i]);
        a->medium[i].object = i ? "wick" : "wax";
        a->medium[i].material = "marble";
        a->media[i] = &a->medium[i];
    }
    a->scene.shade = &a->shade;
    relight__camera__init(&a->camera);
    relight__vec3__init(&a->eye);
    a->eye.x = (float)rnd(r, 100);
    a->camera.eye = &a->eye;
    a->scene.camera = &a->camera;
    relight__picture__init(&a->picture);
    a->picture.exposure_ev = (float)rnd(r, 8);
    a->scene.picture = rnd_chance(r, 2) ? &a->picture : NULL;
}

static inline void act_point(Relight__SurfacePoint *p, struct rnd *r)
{
    relight__surface_point__init(p);
    p->triangle = rnd(r, 1000);
    p->b1 = (float)rnd(r, 100) / 200;
    p->b2 = (float)rnd(r, 100) / 200;
}

static inline void act_change(struct room_act *a, struct rnd *r)
{
    static char *const words[] = {"model", "lights", "material", "shade", "camera", "picture"};
    relight__scene_change__init(&a->change);
    act_scene(a, r);
    a->change.scene = &a->scene;
    a->change.parts = a->parts;
    for (size_t i = 0; i < 6; i++)
        if (rnd_chance(r, 3)) a->parts[a->change.n_parts++] = words[i];
    if (!a->change.n_parts) a->parts[a->change.n_parts++] = words[rnd(r, 6)];
    a->action.scene = &a->change;
}

static inline void act_pin(struct room_act *a, struct rnd *r)
{
    relight__room_action__init(&a->action);
    relight__put_pin__init(&a->pin);
    relight__seen__init(&a->seen);
    act_point(&a->point[0], r);
    a->pin.text = a->text;
    a->pin.at = &a->point[0];
    a->pin.seen = &a->seen;
    a->action.pin = &a->pin;
}

static inline void act_stroke(struct room_act *a, struct rnd *r, uint64_t some)
{
    relight__put_stroke__init(&a->stroke);
    for (size_t i = 0; i < 4; i++) {
        act_point(&a->point[i], r);
        a->points[i] = &a->point[i];
    }
    a->stroke.points = a->points;
    a->stroke.n_points = 1 + rnd(r, 4);
    a->stroke.width = 2;
    a->stroke.pin = rnd_chance(r, 2) ? some : 0;
    a->action.stroke = &a->stroke;
}

static inline void act_decide(struct room_act *a, struct rnd *r)
{
    relight__room_action__init(&a->action);
    relight__decide__init(&a->decide);
    relight__seen__init(&a->seen);
    a->decide.approve = rnd_chance(r, 2);
    a->decide.note = a->text;
    a->decide.seen = &a->seen;
    a->action.decide = &a->decide;
}

// Undo, redo, a revision or a variant.
static inline void act_history(struct room_act *a, struct rnd *r, int which)
{
    relight__nothing__init(&a->nothing);
    relight__save_revision__init(&a->save);
    relight__put_variant__init(&a->variant);
    a->variant.name = "cold";
    a->variant.material = "milk";
    if (which == 0 && rnd_chance(r, 3)) a->action.redo = &a->nothing;
    else if (which == 0) a->action.undo = &a->nothing;
    if (which == 1) a->action.save = &a->save;
    if (which != 2) return;
    if (rnd_chance(r, 2)) a->variant.name = "warm";
    if (!rnd_chance(r, 4)) a->variant.material = "";
    a->action.variant = &a->variant;
}

// What is said about pin or note `some`: a reply, a change of its text, its status, its end.
static inline void act_about(struct room_act *a, struct rnd *r, uint64_t some, int which)
{
    relight__put_note__init(&a->note);
    relight__set_status__init(&a->status);
    relight__erase__init(&a->erase);
    a->note.target = a->status.pin = a->erase.target = some;
    a->note.text = a->text;
    if (which == 0 && rnd_chance(r, 4)) a->action.change = &a->note;
    else if (which == 0) a->action.reply = &a->note;
    if (which == 1) a->status.resolved = rnd_chance(r, 2);
    if (which == 1) a->action.status = &a->status;
    if (which == 2) a->action.erase = &a->erase;
}

// Who may do what: members, links, the room's name and its end.
static inline void act_access(struct room_act *a, struct rnd *r, int which)
{
    switch (which) {
    case 0:
        relight__member__init(&a->member);
        a->member.by = rnd_chance(r, 2) ? "token:carl" : "*";
        a->member.role = (Relight__RoomRole)rnd(r, 4);
        a->action.member = &a->member;
        break;
    case 1:
        relight__invite__init(&a->invite);
        snprintf(a->id, sizeof a->id, "%08x", rnd(r, 20));
        memset(a->hash, '0' + (int)rnd(r, 10), 64);
        a->invite.id = a->id;
        a->invite.hash = a->hash;
        a->invite.role = (Relight__RoomRole)rnd(r, 4);
        a->invite.expires_s = rnd(r, 2);
        a->action.invite = &a->invite;
        break;
    case 2:
        snprintf(a->id, sizeof a->id, "%08x", rnd(r, 20));
        a->action.revoke = a->id;
        break;
    case 3:
        relight__room_rename__init(&a->rename);
        a->rename.name = a->text;
        a->action.rename = &a->rename;
        break;
    default:
        relight__room_close__init(&a->close);
        a->close.closed = rnd_chance(r, 8);
        a->action.close = &a->close;
    }
}

// Any action; numbers of pins and notes are taken from [1, newest].
static inline void act_random(struct room_act *a, struct rnd *r, uint64_t newest)
{
    enum { CHANGE, HISTORY, PIN = HISTORY + 3, ABOUT, STROKE = ABOUT + 3, DECIDE, ACCESS };
    static const int often[] = {
        CHANGE,    CHANGE, CHANGE, CHANGE,     HISTORY,    HISTORY,    HISTORY + 1, HISTORY + 2,
        PIN,       PIN,    PIN,    ABOUT,      ABOUT,      ABOUT,      ABOUT + 1,   STROKE,
        ABOUT + 2, DECIDE, ACCESS, ACCESS + 1, ACCESS + 2, ACCESS + 3, ACCESS + 4};
    memset(a, 0, sizeof *a);
    relight__room_action__init(&a->action);
    snprintf(a->text, sizeof a->text, "note %u for @ann and @bob%u.", rnd(r, 1000), rnd(r, 3));
    uint64_t some = 1 + rnd(r, (uint32_t)newest);
    int which = RND_PICK(r, often);
    if (which == CHANGE) act_change(a, r);
    else if (which < PIN) act_history(a, r, which - HISTORY);
    else if (which == PIN) act_pin(a, r);
    else if (which < STROKE) act_about(a, r, some, which - ABOUT);
    else if (which == STROKE) act_stroke(a, r, some);
    else if (which == DECIDE) act_decide(a, r);
    else act_access(a, r, which - ACCESS);
}

static inline void act_start(struct room_act *a, struct rnd *r)
{
    memset(a, 0, sizeof *a);
    relight__room_action__init(&a->action);
    relight__room_start__init(&a->start);
    act_scene(a, r);
    a->start.name = "review";
    a->start.scene = &a->scene;
    a->action.start = &a->start;
}

// An event of one of four people.
struct room_evt {
    Relight__RoomEvent event;
    Relight__Stamp stamp;
    char client[17];
};

static inline void evt_make(struct room_evt *e, const Relight__RoomAction *action,
                            unsigned person, int role, uint64_t sequence, uint64_t time_us)
{
    static char *const by[] = {"token:ann", "token:bob", "guest:0123", "addr:127.0.0.1"};
    static char *const names[] = {"Ann", "Bob", "Carl", ""};
    relight__room_event__init(&e->event);
    relight__stamp__init(&e->stamp);
    e->stamp.sequence = sequence;
    e->stamp.time_us = time_us;
    e->stamp.by = by[person & 3];
    e->stamp.name = names[person & 3];
    e->event.stamp = &e->stamp;
    e->event.role = (Relight__RoomRole)role;
    e->event.action = (Relight__RoomAction *)(uintptr_t)action;
    snprintf(e->client, sizeof e->client, "%016x", person & 3);
    e->event.client = e->client;
    e->event.number = sequence;
}

#endif
