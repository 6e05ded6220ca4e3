/* SPDX-License-Identifier: MIT */
/* pose_files.h owns poses on the disk. The file of a pose is an upload (store/blobs.h) of the
 * bytes that its name is the SHA-256 of: "pose", positions and normals. Rooms have the poses
 * written that their scenes name, and keep them as other uploads (store/holds.h).
 * Thread-safety: loop thread only. */
#ifndef RELIGHTD_POSE_FILES_H
#define RELIGHTD_POSE_FILES_H

#include "core/ledger.h"

struct request;
struct server;

/* Reads a pose that is on the disk and not in memory, charged to the principal, and calls
 * wake(user), now or later: poses_find says then whether it is there. */
void pose_restore(struct server *server, const char *name, struct principal *principal,
                  void (*wake)(void *user), void *user);
/* Calls run(request) once every pose that the request's message names is on the disk; where one
 * is neither there nor in memory, or cannot be written, the request is answered. */
void poses_keep_then(struct request *request, void (*run)(struct request *request));

#endif
