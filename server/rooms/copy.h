/* SPDX-License-Identifier: MIT */
/* copy.h owns the copy of all rooms from one store to another, in either direction: relightd
 * --copy-rooms. */
#ifndef RELIGHTD_ROOMS_COPY_H
#define RELIGHTD_ROOMS_COPY_H

/* from, to: words of --rooms. Copies each room's log, event by event, and compares both logs
 * and the states that follow from them. A room that is there already with the same log is left
 * alone, so that an interrupted copy goes on. Prints what it did. The process's exit status.
 * Blocks; no daemon may use a SQLite file meanwhile. */
int rooms_copy(const char *from, const char *to);

#endif
