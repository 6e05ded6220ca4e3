/* SPDX-License-Identifier: MIT */
/* room_name.h declares how a program's word names a review room. */
#ifndef RELIGHT_ROOM_NAME_H
#define RELIGHT_ROOM_NAME_H

#include "relight/relight.h"

/* Whether the word is an id, of a room or of something else. */
bool room_is_id(const char *word);
/* The room that `word` names in the daemon's list: its id, a beginning of one (4 digits or
 * more), or its name. Returns 0 and the id in `out`;
 * -RELIGHT_E_NOT_FOUND; -RELIGHT_E_MISMATCH where several rooms are called so; or as
 * relight_room_list. */
int room_of_word(struct relight_client *client, const char *word, char out[RELIGHT_ROOM],
                 struct relight_error *error);

#endif
