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

/* An event is on the disk, and `state` includes it. hooks may be NULL: nobody is told. */
void hooks_event(struct hooks *hooks, const Relight__RoomState *state,
                 const Relight__RoomEvent *event);

/* The value of the header X-Relight-Signature: "sha256=" and the HMAC-SHA256 of the body under
 * the key, 64 hex digits. */
void hook_sign(const char *key, const void *body, size_t n, char out[72]);

#endif
