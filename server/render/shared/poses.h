/* SPDX-License-Identifier: MIT */
/* poses.h owns named poses: vertices that requests name by their content, so that clients never
 * move each other's. A pose belongs to one model and is charged to the principal that sent it
 * (--client-poses, --poses). Beyond these limits the poses go that were unused longest and that
 * nothing draws; a request with one that has gone is NOT_FOUND, unless a room keeps it on the
 * disk (pose_files.h). Thread-safety: loop thread only. */
#ifndef RELIGHTD_POSES_H
#define RELIGHTD_POSES_H

#include "render/shared/geometry.h"

struct poses;

int poses_create(struct server *server, struct poses **out); /* 0 or -1 without memory */
void poses_destroy(struct poses *poses);

/* Bytes that a pose of n vertices is charged with. */
uint64_t poses_bytes(uint32_t n);

/* The pose of this name (SHA-256, 64 hex digits), with a reference for the caller; it counts as
 * used now. NULL with *code and error. */
struct pose *poses_find(struct poses *poses, const struct model *model, const char *name,
                        int *code, char error[256]);
/* Takes over a pose with its name, vertices and one reference, and charges it to the principal.
 * *out: the pose of this name, which may be an older one, with a reference for the caller.
 * Returns 0, or an error code with its text. */
int poses_add(struct poses *poses, struct model *model, struct pose *pose,
              struct principal *principal, struct pose **out, char error[256]);
/* A pose of this name in memory, of any model; NULL: there is none. */
const struct pose *poses_known(const struct poses *poses, const char *name);
/* Takes over a pose that was read from the disk, charged to the principal: poses_find gives it
 * to the first model that it is asked for with. 0, or an error code with its text. */
int poses_restore(struct poses *poses, struct pose *pose, struct principal *principal,
                  char error[256]);
/* The model is forgotten, and with it what the caches have of it: its poses go. */
void poses_forget(struct poses *poses, const struct model *model);

#endif
