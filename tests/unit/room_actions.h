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

// Any action; numbers of pins and notes are taken from [1, newest].
static inline void act_random(struct room_act *a, struct rnd *r, uint64_t newest)
{
    static const int often[] = {0, 0, 0, 0, 1, 1,  2,  3,  4,  4,  4, 5,
                                5, 6, 7, 8, 9, 10, 11, 12, 13, 14, 15};
    memset(a, 0, sizeof *a);
    relight__room_action__init(&a->action);
    snprintf(a->text, sizeof a->text, "note %u for @ann and @bob%u.", rnd(r, 1000), rnd(r, 3));
    uint64_t some = 1 + rnd(r, (uint32_t)newest);
    switch (RND_PICK(r, often)) {
    case 0:
        act_change(a, r);
        break;
    case 1:
        relight__nothing__init(&a->nothing);
        if (rnd_chance(r, 3)) a->action.redo = &a->nothing;
        else a->action.undo = &a->nothing;
        break;
    case 2:
        relight__save_revision__init(&a->save);
        a->action.save = &a->save;
        break;
    case 3:
        relight__put_variant__init(&a->variant);
        a->variant.name = rnd_chance(r, 2) ? "warm" : "cold";
        a->variant.material = rnd_chance(r, 4) ? "" : "milk";
        a->action.variant = &a->variant;
        break;
    case 4:
        relight__put_pin__init(&a->pin);
        relight__seen__init(&a->seen);
        act_point(&a->point[0], r);
        a->pin.text = a->text;
        a->pin.at = &a->point[0];
        a->pin.seen = &a->seen;
        a->action.pin = &a->pin;
        break;
    case 5:
    case 6:
        relight__put_note__init(&a->note);
        a->note.target = some;
        a->note.text = a->text;
        if (rnd_chance(r, 4)) a->action.change = &a->note;
        else a->action.reply = &a->note;
        break;
    case 7:
        relight__set_status__init(&a->status);
        a->status.pin = some;
        a->status.resolved = rnd_chance(r, 2);
        a->action.status = &a->status;
        break;
    case 8:
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
        break;
    case 9:
        relight__erase__init(&a->erase);
        a->erase.target = some;
        a->action.erase = &a->erase;
        break;
    case 10:
        relight__decide__init(&a->decide);
        relight__seen__init(&a->seen);
        a->decide.approve = rnd_chance(r, 2);
        a->decide.note = a->text;
        a->decide.seen = &a->seen;
        a->action.decide = &a->decide;
        break;
    case 11:
        relight__member__init(&a->member);
        a->member.by = rnd_chance(r, 2) ? "token:carl" : "*";
        a->member.role = (Relight__RoomRole)rnd(r, 4);
        a->action.member = &a->member;
        break;
    case 12:
        relight__invite__init(&a->invite);
        snprintf(a->id, sizeof a->id, "%08x", rnd(r, 20));
        memset(a->hash, '0' + (int)rnd(r, 10), 64);
        a->invite.id = a->id;
        a->invite.hash = a->hash;
        a->invite.role = (Relight__RoomRole)rnd(r, 4);
        a->invite.expires_s = rnd(r, 2);
        a->action.invite = &a->invite;
        break;
    case 13:
        snprintf(a->id, sizeof a->id, "%08x", rnd(r, 20));
        a->action.revoke = a->id;
        break;
    case 14:
        relight__room_rename__init(&a->rename);
        a->rename.name = a->text;
        a->action.rename = &a->rename;
        break;
    case 15:
        relight__room_close__init(&a->close);
        a->close.closed = rnd_chance(r, 8);
        a->action.close = &a->close;
        break;
    }
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
