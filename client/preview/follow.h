/* SPDX-License-Identifier: MIT */
/* follow.h declares --follow: pictures of a review room while people work in it. */
#ifndef RELIGHT_PREVIEW_FOLLOW_H
#define RELIGHT_PREVIEW_FOLLOW_H

#include "preview.h"

/* Takes a seat in the room options->follow, and writes a picture of its scene now and after
 * every change, those included that a hand makes and has not let go of. The daemon draws.
 * Changes that come while a picture is drawn are in the next one. Ends after options->n_frame
 * pictures (0: no limit), or at SIGINT or SIGTERM. Returns an exit status; errors are reported.
 * The connection is in use until the program ends. */
int follow_room(struct relight_client *client, const struct options *options);

#endif
