// SPDX-License-Identifier: MIT
// Invitations in force.
#include "rooms/guests.h"

#include "core/token_store.h"

#include <sodium.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static const char prefix[] = "relight_guest_", principal_prefix[] = "guest:";

void guest_generate(char id[GUEST_ID + 1], char secret[GUEST_SECRET], char hash[65])
{
    uint8_t random[32], number[GUEST_ID / 2], digest[TOKEN_HASH];
    randombytes_buf(random, sizeof random);
    randombytes_buf(number, sizeof number);
    sodium_bin2hex(id, GUEST_ID + 1, number, sizeof number);
    size_t n = (size_t)snprintf(secret, GUEST_SECRET, "%s", prefix);
    sodium_bin2base64(secret + n, GUEST_SECRET - n, random, sizeof random,
                      sodium_base64_VARIANT_URLSAFE_NO_PADDING);
    token_hash(secret, digest);
    sodium_bin2hex(hash, 65, digest, sizeof digest);
    sodium_memzero(random, sizeof random);
}

bool guests_add(struct guests *guests, const char *room, const struct room_invite *invite)
{
    if (guests->n == guests->room_for) {
        size_t most = guests->room_for ? guests->room_for * 2 : 16;
        struct guest *more = realloc(guests->guest, most * sizeof *more);
        if (!more) return false;
        guests->guest = more;
        guests->room_for = most;
    }
    struct guest *g = &guests->guest[guests->n];
    size_t size;
    snprintf(g->id, sizeof g->id, "%s", invite->id);
    snprintf(g->room, sizeof g->room, "%s", room);
    snprintf(g->inviter, sizeof g->inviter, "%s", invite->inviter);
    g->expires_s = (int64_t)invite->expires_s;
    if (sodium_hex2bin(g->hash, sizeof g->hash, invite->hash, strlen(invite->hash), NULL, &size,
                       NULL) ||
        size != sizeof g->hash)
        return true; // a damaged row invites nobody
    guests->n++;
    return true;
}

bool guests_replace(struct guests *guests, const char *room, const struct room_invite *invite,
                    size_t n)
{
    for (size_t i = guests->n; i-- > 0;)
        if (!strcmp(guests->guest[i].room, room)) guests->guest[i] = guests->guest[--guests->n];
    for (size_t i = 0; i < n; i++)
        if (!guests_add(guests, room, &invite[i])) return false;
    return true;
}

void guests_finish(struct guests *guests)
{
    free(guests->guest);
    *guests = (struct guests){0};
}

static bool over(const struct guest *g)
{
    return g->expires_s && time(NULL) >= g->expires_s;
}

// Every entry is compared, each in constant time.
static const struct guest *by_secret(const struct guests *guests, const char *secret)
{
    uint8_t hash[TOKEN_HASH];
    const struct guest *found = NULL;
    token_hash(secret, hash);
    for (size_t i = 0; i < guests->n; i++)
        if (!sodium_memcmp(guests->guest[i].hash, hash, sizeof hash)) found = &guests->guest[i];
    return found;
}

enum access_verdict guests_check(void *user, const char *secret, struct caller *out,
                                 char error[256])
{
    if (strncmp(secret, prefix, sizeof prefix - 1)) return ACCESS_NO_TOKEN;
    const struct guest *g = by_secret(user, secret);
    if (!g || over(g)) {
        snprintf(error, 256,
                 g ? "this invitation has expired: ask the room's owner for another"
                   : "this invitation is not valid: it was revoked, or its link is incomplete");
        return g ? ACCESS_EXPIRED : ACCESS_WRONG;
    }
    snprintf(out->name, sizeof out->name, "%s%s", principal_prefix, g->id);
    snprintf(out->inviter, sizeof out->inviter, "%s", g->inviter);
    out->scopes = SCOPE_VIEW;
    out->expires_s = g->expires_s;
    return ACCESS_GRANTED;
}

static const struct guest *by_principal(const struct guests *guests, const char *principal)
{
    size_t n = sizeof principal_prefix - 1;
    if (strncmp(principal, principal_prefix, n)) return NULL;
    for (size_t i = 0; i < guests->n; i++)
        if (!strcmp(guests->guest[i].id, principal + n)) return &guests->guest[i];
    return NULL;
}

bool guests_current(void *user, const char *principal)
{
    const struct guest *g = by_principal(user, principal);
    return g && !over(g);
}

const char *guests_room(const struct guests *guests, const char *principal)
{
    const struct guest *g = by_principal(guests, principal);
    return g ? g->room : NULL;
}
