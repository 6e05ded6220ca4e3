// SPDX-License-Identifier: MIT
// An event into a room's state: what every event has, then what it does.
#include "rooms/state.h"

#include "frame.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *room_role_word(int role)
{
    static const char *const words[] = {"none", "viewer", "reviewer", "owner"};
    return role >= 0 && role < (int)(sizeof words / sizeof *words) ? words[role] : "unknown";
}

int room_role(const Relight__RoomState *state, const char *by, int64_t now_s)
{
    int role = RELIGHT__ROOM_ROLE__ROLE_NONE, all = role;
    if (!strncmp(by, "guest:", 6)) {
        for (size_t i = 0; i < state->n_invites; i++) {
            const Relight__Invite *invite = state->invites[i];
            bool over = invite->expires_s && now_s >= (int64_t)invite->expires_s;
            if (!strcmp(invite->id, by + 6) && !invite->revoked && !over)
                return (int)invite->role;
        }
        return role;
    }
    for (size_t i = 0; i < state->n_members; i++) {
        const Relight__Member *member = state->members[i];
        if (!strcmp(member->by, by)) role = (int)member->role;
        if (!strcmp(member->by, "*")) all = (int)member->role;
    }
    return role > all ? role : all;
}

// Everybody in the room sees the clients of all: another principal's of the same id is another.
static bool is_client(const Relight__RoomClient *c, const char *client, const char *by)
{
    return !strcmp(c->client, client) && (!*c->by || !strcmp(c->by, by));
}

uint64_t room_done_before(const Relight__RoomState *state, const char *client, const char *by,
                          uint64_t number)
{
    for (size_t i = 0; *client && i < state->n_clients; i++)
        if (is_client(state->clients[i], client, by) && number <= state->clients[i]->number)
            return state->clients[i]->sequence;
    return 0;
}

// ---- members, invitations, the room itself

static int fold_start(struct folding *f)
{
    const Relight__RoomStart *in = f->action->start;
    Relight__Member owner = RELIGHT__MEMBER__INIT;
    Relight__RoomState *s = f->state;
    int code = room_scene_check(in->scene, f->error);
    if (code) return code;
    if (!*in->name || strlen(in->name) > ROOM_MAX_NAME)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "a room's name has 1 to %d bytes",
                         ROOM_MAX_NAME);
    owner.by = f->event->stamp->by;
    owner.name = f->event->stamp->name;
    owner.role = RELIGHT__ROOM_ROLE__ROLE_OWNER;
    if (text_set(&s->name, in->name) || !(s->created = message_copy(f->event->stamp)) ||
        !list_add(&s->members, &s->n_members, message_copy(&owner)))
        return fold_no_memory(f);
    return scene_begin(f, in->scene);
}

static int fold_rename(struct folding *f)
{
    const char *name = f->action->rename->name;
    if (!*name || strlen(name) > ROOM_MAX_NAME)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "a room's name has 1 to %d bytes",
                         ROOM_MAX_NAME);
    return text_set(&f->state->name, name) ? fold_no_memory(f) : 0;
}

static bool other_owner(const Relight__RoomState *s, const char *by)
{
    for (size_t i = 0; i < s->n_members; i++)
        if (s->members[i]->role == RELIGHT__ROOM_ROLE__ROLE_OWNER &&
            strcmp(s->members[i]->by, by) && strcmp(s->members[i]->by, "*"))
            return true;
    return false;
}

static int check_member(struct folding *f, const Relight__Member *in)
{
    if (!*in->by || strlen(in->by) > 95 || !strncmp(in->by, "guest:", 6))
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "a member is a principal, as token:ann or uid:1000, or * for "
                         "everyone; guests have invitations");
    if ((unsigned)in->role > RELIGHT__ROOM_ROLE__ROLE_OWNER)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                         "role: expected none, viewer, reviewer or owner");
    if (!strcmp(in->by, "*") && in->role == RELIGHT__ROOM_ROLE__ROLE_OWNER)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                         "everyone can be viewer or reviewer, but not owner");
    if (strlen(in->name) > ROOM_MAX_PERSON)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                         "a person's name has at most %d "
                         "bytes",
                         ROOM_MAX_PERSON);
    if (in->role != RELIGHT__ROOM_ROLE__ROLE_OWNER && !other_owner(f->state, in->by))
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                         "%s is the room's only owner: name another first", in->by);
    return 0;
}

static int fold_member(struct folding *f)
{
    const Relight__Member *in = f->action->member;
    Relight__RoomState *s = f->state;
    int code = check_member(f, in);
    size_t at = 0;
    if (code) return code;
    while (at < s->n_members && strcmp(s->members[at]->by, in->by)) at++;
    if (at == s->n_members && at >= ROOM_MAX_MEMBERS)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT, "the room has %d members",
                         ROOM_MAX_MEMBERS);
    if (!in->role && at == s->n_members)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                         "%.95s is no member of this room", in->by);
    if (in->role && !list_add(&s->members, &s->n_members, message_copy(in)))
        return fold_no_memory(f);
    if (!in->role || at + 1 < s->n_members) list_remove(&s->members, &s->n_members, at);
    return 0;
}

// In a full list one that is over makes room: it was revoked, or has expired.
static bool invites_full(const struct folding *f)
{
    Relight__RoomState *s = f->state;
    const uint64_t now_s = f->event->stamp->time_us / 1000000;
    if (s->n_invites < ROOM_MAX_INVITES) return false;
    for (size_t i = 0; i < s->n_invites; i++) {
        const Relight__Invite *m = s->invites[i];
        if (!m->revoked && !(m->expires_s && now_s >= m->expires_s)) continue;
        list_remove(&s->invites, &s->n_invites, i);
        return false;
    }
    return true;
}

static int fold_invite(struct folding *f)
{
    const Relight__Invite *in = f->action->invite;
    Relight__RoomState *s = f->state;
    Relight__Invite m = *in;
    if (in->role != RELIGHT__ROOM_ROLE__ROLE_VIEWER &&
        in->role != RELIGHT__ROOM_ROLE__ROLE_REVIEWER)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                         "role: a guest is viewer or reviewer");
    if (!*in->id || strlen(in->id) > 32 || !relight_hash_valid(in->hash) ||
        strlen(in->name) > ROOM_MAX_PERSON)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "an invitation has an id, a secret's hash, and a name of at most %d "
                         "bytes",
                         ROOM_MAX_PERSON);
    if (in->expires_s >> 41)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                         "expires_s: expected seconds since 1970, below 2^41");
    for (size_t i = 0; i < s->n_invites; i++)
        if (!strcmp(s->invites[i]->id, in->id))
            return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                             "an invitation %s is there already", in->id);
    if (invites_full(f))
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                         "the room has %d invitations in force: revoke one", ROOM_MAX_INVITES);
    m.stamp = f->event->stamp;
    m.revoked = false;
    return list_add(&s->invites, &s->n_invites, message_copy(&m)) ? 0 : fold_no_memory(f);
}

static int fold_revoke(struct folding *f)
{
    for (size_t i = 0; i < f->state->n_invites; i++) {
        Relight__Invite *invite = f->state->invites[i];
        if (strcmp(invite->id, f->action->revoke)) continue;
        if (invite->revoked)
            return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                             "invitation %s was revoked already", invite->id);
        invite->revoked = true;
        return 0;
    }
    return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "the room has no invitation %.40s", f->action->revoke);
}

static int fold_close(struct folding *f)
{
    bool closed = f->action->close->closed;
    if (closed == f->state->closed)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH, "the room is %s already",
                         closed ? "closed" : "open");
    f->state->closed = closed;
    return 0;
}

static int fold_own_undo(struct folding *f)
{
    return fold_undo(f, true);
}

static int fold_own_redo(struct folding *f)
{
    return fold_undo(f, false);
}

// ---- the table of actions

enum { VIEWER = 1, REVIEWER = 2, OWNER = 3 };
#define FIELD(name) offsetof(Relight__RoomAction, name)
static const struct action {
    size_t field;
    int role; // that its author needs
    int (*fold)(struct folding *f);
} actions[] = {
    {FIELD(start), OWNER, fold_start},        {FIELD(rename), OWNER, fold_rename},
    {FIELD(scene), REVIEWER, fold_scene},     {FIELD(undo), REVIEWER, fold_own_undo},
    {FIELD(redo), REVIEWER, fold_own_redo},   {FIELD(save), REVIEWER, fold_save},
    {FIELD(variant), REVIEWER, fold_variant}, {FIELD(pin), REVIEWER, fold_pin},
    {FIELD(reply), REVIEWER, fold_reply},     {FIELD(change), REVIEWER, fold_change},
    {FIELD(status), REVIEWER, fold_status},   {FIELD(stroke), REVIEWER, fold_stroke},
    {FIELD(erase), REVIEWER, fold_erase},     {FIELD(decide), REVIEWER, fold_decide},
    {FIELD(member), OWNER, fold_member},      {FIELD(invite), OWNER, fold_invite},
    {FIELD(close), OWNER, fold_close},        {FIELD(revoke), OWNER, fold_revoke},
};
enum { N_ACTION = sizeof actions / sizeof *actions };

static bool is_set(const Relight__RoomAction *action, const struct action *row)
{
    if (row->field == FIELD(revoke)) return *action->revoke;
    return *(void *const *)((const char *)action + row->field) != NULL;
}

// The one action that is set, or NULL.
static const struct action *find_action(const Relight__RoomAction *action)
{
    const struct action *found = NULL;
    for (int i = 0; action && i < N_ACTION; i++) {
        if (!is_set(action, &actions[i])) continue;
        if (found) return NULL;
        found = &actions[i];
    }
    return found;
}

static int check_event(struct folding *f, const struct action *row)
{
    const Relight__RoomEvent *e = f->event;
    const Relight__RoomState *s = f->state;
    if (!row)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         "the event has not exactly one action that this daemon supports");
    if ((row->fold == fold_start) != !s->sequence)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                         s->sequence ? "the room has begun already" : "the room has not begun");
    if (!*e->stamp->by || strlen(e->stamp->by) > 95 || strlen(e->stamp->name) > ROOM_MAX_PERSON)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                         "a person's name has at most %d bytes", ROOM_MAX_PERSON);
    if ((int)e->role < row->role || (unsigned)e->role > OWNER)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                         "this needs the role %s in the room; %.95s has: %s",
                         room_role_word(row->role), e->stamp->by, room_role_word((int)e->role));
    if (s->closed && row->fold != fold_close)
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                         "the room is closed: an owner can open it again");
    if (*e->client &&
        (strlen(e->client) != 16 || room_done_before(s, e->client, e->stamp->by, e->number)))
        return fold_fail(f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                         "client and number are not those of a new event");
    return 0;
}

// The newest number of each client, at the end of the list; the oldest is dropped.
static int remember_client(struct folding *f)
{
    Relight__RoomClient m = RELIGHT__ROOM_CLIENT__INIT;
    Relight__RoomState *s = f->state;
    if (!*f->event->client) return 0;
    for (size_t i = 0; i < s->n_clients; i++)
        if (is_client(s->clients[i], f->event->client, f->event->stamp->by)) {
            list_remove(&s->clients, &s->n_clients, i);
            break;
        }
    if (s->n_clients >= ROOM_MAX_CLIENTS) list_remove(&s->clients, &s->n_clients, 0);
    m.client = f->event->client;
    m.by = f->event->stamp->by;
    m.number = f->event->number;
    m.sequence = f->event->stamp->sequence;
    return list_add(&s->clients, &s->n_clients, message_copy(&m)) ? 0 : fold_no_memory(f);
}

int room_fold(Relight__RoomState *state, const Relight__RoomEvent *event,
              char error[ROOM_ERROR])
{
    struct folding f = {state, event, event->action, error};
    if (!event->stamp || event->stamp->sequence != state->sequence + 1)
        return fold_fail(&f, RELIGHT__ERROR_CODE__ERROR_MISMATCH,
                         "event %llu does not follow event %llu",
                         event->stamp ? (unsigned long long)event->stamp->sequence : 0,
                         (unsigned long long)state->sequence);
    const struct action *row = find_action(event->action);
    int code = room_message_sane(&event->base, error) ? check_event(&f, row)
                                                      : RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    if (!code) code = row->fold(&f);
    if (!code) code = remember_client(&f);
    if (code) return code;
    state->sequence = event->stamp->sequence;
    state->changed_us = event->stamp->time_us;
    return 0;
}
