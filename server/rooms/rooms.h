/* SPDX-License-Identifier: MIT */
/* rooms.h owns review rooms as the rest of the daemon uses them: opening and closing the store,
 * and guests who come with an invitation. The operations are in net/dispatch.h. Thread-safety:
 * loop thread only. */
#ifndef RELIGHTD_ROOMS_H
#define RELIGHTD_ROOMS_H

#include "core/server.h"

struct rooms;

/* Opens the store of --rooms, and reads who is invited. Blocks. 0, or -1 after logging why. */
int rooms_create(struct server *server, struct rooms **out);
/* The loop must run until every request has ended. What was acknowledged is on the disk. NULL
 * is fine. */
void rooms_destroy(struct rooms *rooms);

/* Deletes rooms that were closed longer ago than --rooms-keep; once a minute. */
void rooms_maintain(struct rooms *rooms);

#endif
