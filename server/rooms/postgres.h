/* SPDX-License-Identifier: MIT */
/* postgres.h owns the statements of the store in PostgreSQL and its connection: what each task
 * does with the database. It blocks; the store's threads alone call it. */
#ifndef RELIGHTD_ROOMS_POSTGRES_H
#define RELIGHTD_ROOMS_POSTGRES_H

#include "rooms/store.h"

#include <libpq-fe.h>

enum { POSTGRES_SCHEMA_VERSION = 1 };

/* What became of a statement or a transaction. */
enum pg_fault {
    PG_FINE,
    PG_AGAIN, /* a serialisation failure or deadlock: nothing was done, the same may succeed */
    PG_AWAY,  /* the connection is lost: a commit's outcome is unknown */
    PG_WRONG, /* anything else; db->error says it */
};

struct pg_db {
    PGconn *conn;       /* NULL: not connected */
    const char *where;  /* a connection string; the owner's */
    uint64_t failed_ns; /* when connecting failed last; 0: it did not */
    bool uncertain;     /* whether the last transaction was committed is not known */
    char error[200];    /* of the last fault */
};

/* Connects, within some seconds, and makes or checks the tables: for the store's own process
 * and for every later connection. */
enum pg_fault pg_connect(struct pg_db *db);
void pg_disconnect(struct pg_db *db);
/* Statements without rows or parameters. */
enum pg_fault pg_execute(struct pg_db *db, const char *sql);

/* A transaction of appends: all of them commit or none; a task that conflicts gets its status
 * and changes nothing. One whose event is in the log already, from a commit whose outcome was
 * unknown, is done. */
enum pg_fault pg_append_all(struct pg_db *db, struct room_task *const *task, size_t n);
/* Any other task. */
enum pg_fault pg_run(struct pg_db *db, struct room_task *task);

#endif
