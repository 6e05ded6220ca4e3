/* SPDX-License-Identifier: MIT */
/* evict.h owns the room that bakes take under --data: beyond the budget the longest unused go,
 * and a later LOAD of the same makes them anew. Loop thread only. */
#ifndef RELIGHTD_EVICT_H
#define RELIGHTD_EVICT_H

#include <stdint.h>

struct server;
struct model;

uint64_t bakes_bytes(const struct server *server);
/* Drops bakes until they fit --bakes-disk and, with the uploads, --disk. Kept are pinned
 * models, those of --models, and `newest` (may be NULL). */
void bakes_make_room(struct server *server, const struct model *newest);
/* The bake was opened: it is the last to go. */
void bakes_touch(const struct model *model);

#endif
