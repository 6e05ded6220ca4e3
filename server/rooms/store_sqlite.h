/* SPDX-License-Identifier: MIT */
/* store_sqlite.h owns the statements of the embedded store: what each task does with the
 * database. It blocks; the store's thread alone calls it. */
#ifndef RELIGHTD_ROOMS_STORE_SQLITE_H
#define RELIGHTD_ROOMS_STORE_SQLITE_H

#include "rooms/store.h"

#include <sqlite3.h>

enum sqlite_statement {
    SQL_ROOM,
    SQL_ADD_ROOM,
    SQL_ADD_EVENT,
    SQL_GROW_ROOM,
    SQL_SET_SUMMARY,
    SQL_DROP_MEMBERS,
    SQL_ADD_MEMBER,
    SQL_DROP_INVITES,
    SQL_ADD_INVITE,
    SQL_SNAPSHOT,
    SQL_SET_SNAPSHOT,
    SQL_EVENTS,
    SQL_LIST,
    SQL_INVITES,
    SQL_OWNERS,
    SQL_KEEPS,
    SQL_SET_KEEPS,
    SQL_OLD,
    SQL_N
};
struct sqlite_db {
    sqlite3 *handle;
    sqlite3_stmt *statement[SQL_N];
    char error[200]; /* of the last fault */
};

/* Opens or creates the database, with every commit on the disk before it returns (WAL,
 * synchronous=FULL), for this process alone. 0, or -1 with the error's text. */
int sqlite_open(struct sqlite_db *db, const char *path, char error[256]);
void sqlite_close(struct sqlite_db *db);

/* A transaction of appends. Each returns 0 or a fault of the database, whose text is in
 * db->error; a task that conflicts gets its status and changes nothing. sqlite_end commits, or
 * rolls back after a fault, and returns the fault. */
int sqlite_begin(struct sqlite_db *db);
int sqlite_append(struct sqlite_db *db, struct room_task *task);
int sqlite_end(struct sqlite_db *db, int fault);

/* Any other task. */
void sqlite_run(struct sqlite_db *db, struct room_task *task);

#endif
