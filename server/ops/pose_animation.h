/* SPDX-License-Identifier: MIT */
/* pose_animation.h owns the way from PUT_POSE's files to vertices in a moment of an animation:
 * their uploads are checked and laid out, and the decode helper reads them. Loop thread only.
 */
#ifndef RELIGHTD_POSE_ANIMATION_H
#define RELIGHTD_POSE_ANIMATION_H

#include "jobs/decode_helper.h"
#include "net/request.h"

/* decoded NULL: the request was answered with an error, or it has ended (request NULL);
 * otherwise it is the callee's. */
typedef void (*pose_animated_fn)(void *user, struct request *request,
                                 struct decoded_pose *decoded);
/* Calls fn once, now or later. The request's message names animation, time and files. */
void pose_animate(struct request *request, pose_animated_fn fn, void *user);

#endif
