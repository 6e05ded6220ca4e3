// SPDX-License-Identifier: MIT
// What the store keeps about a room beside its log: name, members, invitations in force.
#include "rooms/room_private.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void summary_finish(struct room_summary *summary)
{
    free(summary->member);
    free(summary->invite);
    *summary = (struct room_summary){0};
}

static void add_invite(struct room_summary *out, const Relight__Invite *from)
{
    struct room_invite *to = &out->invite[out->n_invite++];
    snprintf(to->id, sizeof to->id, "%s", from->id);
    snprintf(to->hash, sizeof to->hash, "%s", from->hash);
    snprintf(to->inviter, sizeof to->inviter, "%s", from->stamp->by);
    to->role = (int)from->role;
    to->expires_s = from->expires_s;
}

bool room_summarise(const Relight__RoomState *state, struct room_summary *out)
{
    *out =
        (struct room_summary){.created_us = state->created->time_us, .closed = state->closed};
    snprintf(out->name, sizeof out->name, "%s", state->name);
    snprintf(out->owner, sizeof out->owner, "%s", state->created->by);
    out->member = calloc(state->n_members + 1, sizeof *out->member);
    out->invite = calloc(state->n_invites + 1, sizeof *out->invite);
    if (!out->member || !out->invite) {
        summary_finish(out);
        return false;
    }
    for (size_t i = 0; i < state->n_members; i++) {
        struct room_member *to = &out->member[out->n_member++];
        snprintf(to->by, sizeof to->by, "%s", state->members[i]->by);
        to->role = (int)state->members[i]->role;
    }
    for (size_t i = 0; i < state->n_invites; i++)
        if (!state->invites[i]->revoked) add_invite(out, state->invites[i]);
    return true;
}
