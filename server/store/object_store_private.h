/* SPDX-License-Identifier: MIT */
/* object_store_private.h owns what the files of the shared folder have in common. */
#ifndef RELIGHTD_OBJECT_STORE_PRIVATE_H
#define RELIGHTD_OBJECT_STORE_PRIVATE_H

#include "store/object_store.h"

#include <limits.h>
#include <stdatomic.h>

struct object_store {
    char folder[3800];                           /* absolute; "": one machine */
    char owner[96];                              /* HOST-PID-DIGITS: no other process has it */
    double ahead_s;                              /* this machine's clock before the folder's */
    _Atomic uint64_t last_temporary, last_count; /* of names; of texts of claims */
};

/* A name in the folder that no other process chooses. */
void object_temporary(struct object_store *store, char path[PATH_MAX]);
/* Makes a client of NFS ask the server what the folder has now. Without it a name that it
 * looked up before stands, for up to a minute, for the file that was there, or for none. False:
 * the folder is not there. */
bool object_refresh_folder(const char *folder);
/* On NFS: another machine has replaced or removed the file. ESTALE; EBADF where the server has
 * dropped the state of the open file. */
bool object_stale(int err);
/* Syncs the folder that has this file. */
int object_sync_folder(const char *path);

#endif
