/* SPDX-License-Identifier: MIT */
/* room_backup.h owns copies of the store on their way to a client. */
#ifndef RELIGHTD_ROOMS_BACKUP_H
#define RELIGHTD_ROOMS_BACKUP_H

struct rooms;

/* Deletes the copies that are left. */
void backups_drop(struct rooms *rooms);

#endif
