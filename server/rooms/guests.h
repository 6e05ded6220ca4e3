/* SPDX-License-Identifier: MIT */
/* guests.h owns the invitations that are in force, of all rooms: a guest's HELLO is decided
 * without reading a room. Thread-safety: loop thread only. */
#ifndef RELIGHTD_ROOMS_GUESTS_H
#define RELIGHTD_ROOMS_GUESTS_H

#include "core/access.h"
#include "rooms/store.h"

struct guest {
    char id[40], room[40], inviter[96];
    uint8_t hash[32];
    int64_t expires_s; /* 0: never */
};
struct guests {
    struct guest *guest;
    size_t n, room_for;
};

enum { GUEST_SECRET = 64, GUEST_ID = 16 };
/* A new invitation's id and secret, and the secret's hash as 64 hex digits. */
void guest_generate(char id[GUEST_ID + 1], char secret[GUEST_SECRET], char hash[65]);

/* One more; false without memory. */
bool guests_add(struct guests *guests, const char *room, const struct room_invite *invite);
/* Replaces the room's invitations. False without memory. */
bool guests_replace(struct guests *guests, const char *room, const struct room_invite *invite,
                    size_t n);
void guests_finish(struct guests *guests);

/* For access_set_guests(); user: the struct guests. */
enum access_verdict guests_check(void *user, const char *secret, struct caller *out,
                                 char error[256]);
bool guests_current(void *user, const char *principal);
/* The room that a guest's principal was invited to; NULL: none. */
const char *guests_room(const struct guests *guests, const char *principal);

#endif
