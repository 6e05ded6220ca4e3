/* SPDX-License-Identifier: MIT */
/* hooks.h owns messages to another web server about pins and decisions (--room-hook): HTTPS
 * POST of JSON, signed. They are sent one after another by a thread of their own; one that the
 * server does not take is tried again for about half a minute. What waits when the daemon ends
 * is not sent: the rooms' logs have it.
 * Thread-safety: loop thread only. */
#ifndef RELIGHTD_ROOMS_HOOKS_H
#define RELIGHTD_ROOMS_HOOKS_H

#include "core/server.h"
#include "relight.pb-c.h"

struct hooks;

/* *out is NULL without --room-hook. 0, or -1 with the fault's text. */
int hooks_create(struct server *server, struct hooks **out, char fault[256]);
/* Ends what is being sent; NULL is fine. */
void hooks_destroy(struct hooks *hooks);

/* What is told of an event that `state` has just taken, for hooks_event; to be freed. NULL
 * without memory, or where nobody is told: hooks is NULL, or the event is neither a pin nor a
 * decision. */
char *hooks_describe(const struct hooks *hooks, const Relight__RoomState *state,
                     const Relight__RoomEvent *event);
/* The event is on the disk: sends what hooks_describe gave for it, which it takes. hooks may be
 * NULL. */
void hooks_event(struct hooks *hooks, const char *room, const Relight__RoomEvent *event,
                 char *body);

/* The value of the header X-Relight-Signature: "sha256=" and the HMAC-SHA256 of the body under
 * the key, 64 hex digits. */
void hook_sign(const char *key, const void *body, size_t n, char out[72]);

#endif
