/* SPDX-License-Identifier: MIT */
/* holds.h owns what review rooms need of the disk: ids of models and hashes of uploads, by
 * room. A held file is not removed to make room for others (eviction.h, blob_evict) and not
 * collected in the folder that replicas share, and a model goes with its file in --models or by
 * UNLOAD only where nobody holds it, or by force: what somebody said about a picture can be
 * drawn again. Rooms say what they need; until all of them have said it everything is held.
 * Thread-safety: loop thread only. */
#ifndef RELIGHTD_HOLDS_H
#define RELIGHTD_HOLDS_H

#include <stdbool.h>
#include <stddef.h>

struct holds;

struct holds *holds_create(void); /* NULL without memory */
void holds_destroy(struct holds *holds);

/* What a room needs, in place of what it needed before. names: "\nNAME\nNAME…\n"; "" for
 * nothing, with which the room is forgotten. Without memory everything is held from here on. */
void holds_set(struct holds *holds, const char *room, const char *names);
/* The room's names as they were set; "": none. */
const char *holds_of(const struct holds *holds, const char *room);
/* Forgets the rooms that are not there any more. */
void holds_retain(struct holds *holds, bool (*is_there)(void *user, const char *room),
                  void *user);
/* Whether the names, as holds_set takes them, have this one. */
bool holds_among(const char *names, const char *name);
/* All rooms have said what they need, or (false) some have to say it again. */
void holds_know(struct holds *holds, bool known);
bool holds_known(const struct holds *holds);
/* Whether a room needs it; true as long as that is not known. NULL holds: never. */
bool holds_has(const struct holds *holds, const char *name);
/* Names that no room needed at the last call and some room does now, or did meanwhile, as
 * lines, to free(); NULL: there are none. Without memory some may be missing: holds_list has
 * them. */
char *holds_take_fresh(struct holds *holds);
/* The number of rooms that need it, and the ids of the first of them in ids, with commas. */
unsigned holds_rooms(const struct holds *holds, const char *name, char *ids, size_t n_ids);
/* Each name once, as lines, to free(); NULL as long as they are not known, or without memory.
 */
char *holds_list(const struct holds *holds);

#endif
