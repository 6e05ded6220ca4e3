// SPDX-License-Identifier: MIT
// The embedded store's tables. A version that was released is never edited: a later one
// follows.
#include "rooms/sqlite_schema.h"

#include <stdio.h>

static const char *const steps[] = {
    // 1: rooms and their logs
    "CREATE TABLE room (number INTEGER PRIMARY KEY, id TEXT NOT NULL UNIQUE,"
    " sequence INTEGER NOT NULL, created_us INTEGER NOT NULL, changed_us INTEGER NOT NULL);"
    "CREATE TABLE event (room INTEGER NOT NULL, sequence INTEGER NOT NULL, bytes BLOB NOT NULL,"
    " PRIMARY KEY (room, sequence)) WITHOUT ROWID;"
    "CREATE TABLE snapshot (room INTEGER PRIMARY KEY, sequence INTEGER NOT NULL,"
    " bytes BLOB NOT NULL);",
    // 2: what lists, guests and the ledger need without the state
    "ALTER TABLE room ADD COLUMN name TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE room ADD COLUMN owner TEXT NOT NULL DEFAULT '';"
    "ALTER TABLE room ADD COLUMN closed INTEGER NOT NULL DEFAULT 0;"
    "ALTER TABLE room ADD COLUMN bytes INTEGER NOT NULL DEFAULT 0;"
    "CREATE TABLE member (room INTEGER NOT NULL, by TEXT NOT NULL, role INTEGER NOT NULL,"
    " PRIMARY KEY (by, room)) WITHOUT ROWID;"
    "CREATE INDEX member_of_room ON member (room);"
    "CREATE TABLE invite (room INTEGER NOT NULL, id TEXT NOT NULL, hash TEXT NOT NULL UNIQUE,"
    " role INTEGER NOT NULL, expires_s INTEGER NOT NULL, PRIMARY KEY (room, id)) WITHOUT ROWID;"
    "UPDATE room SET bytes = (SELECT coalesce(sum(length(bytes)), 0) FROM event"
    " WHERE event.room = room.number);",
    // 3: what a room needs of the disk (store/holds.h); NULL: its state has to be read once
    "ALTER TABLE room ADD COLUMN keeps TEXT;",
    // 4: whose limits a guest counts to; of earlier invitations the room's owner's
    "ALTER TABLE invite ADD COLUMN inviter TEXT NOT NULL DEFAULT '';"
    "UPDATE invite SET inviter = (SELECT owner FROM room WHERE room.number = invite.room);",
};
_Static_assert(sizeof steps / sizeof *steps == SQLITE_SCHEMA_VERSION, "a step a version");

const char *sqlite_schema_step(int version)
{
    return version >= 1 && version <= SQLITE_SCHEMA_VERSION ? steps[version - 1] : NULL;
}

static int read_number(sqlite3 *db, const char *sql, int *out)
{
    sqlite3_stmt *s = NULL;
    int failed = sqlite3_prepare_v2(db, sql, -1, &s, NULL) || sqlite3_step(s) != SQLITE_ROW;
    if (!failed) *out = sqlite3_column_int(s, 0);
    sqlite3_finalize(s);
    return failed;
}

static int take_step(sqlite3 *db, int version)
{
    char mark[120];
    snprintf(mark, sizeof mark, "PRAGMA user_version=%d; PRAGMA application_id=%d;", version,
             SQLITE_SCHEMA_ID);
    if (!sqlite3_exec(db, "BEGIN IMMEDIATE", NULL, NULL, NULL) &&
        !sqlite3_exec(db, steps[version - 1], NULL, NULL, NULL) &&
        !sqlite3_exec(db, mark, NULL, NULL, NULL) &&
        !sqlite3_exec(db, "COMMIT", NULL, NULL, NULL))
        return 0;
    return -1;
}

int sqlite_schema_update(sqlite3 *db, char error[256])
{
    int version = 0, id = 0, tables = 0;
    if (read_number(db, "PRAGMA user_version", &version) ||
        read_number(db, "PRAGMA application_id", &id) ||
        read_number(db, "SELECT count(*) FROM sqlite_master", &tables)) {
        snprintf(error, 256, "%s", sqlite3_errmsg(db));
        return -1;
    }
    if (tables && id != SQLITE_SCHEMA_ID) {
        snprintf(error, 256, "it is another program's database: name another file");
        return -1;
    }
    if (version > SQLITE_SCHEMA_VERSION) {
        snprintf(error, 256,
                 "it has version %d, written by a later relightd; this one reads up "
                 "to %d",
                 version, SQLITE_SCHEMA_VERSION);
        return -1;
    }
    while (version < SQLITE_SCHEMA_VERSION)
        if (take_step(db, ++version)) {
            snprintf(error, 256, "its tables could not be brought to version %d: %s", version,
                     sqlite3_errmsg(db));
            sqlite3_exec(db, "ROLLBACK", NULL, NULL, NULL);
            return -1;
        }
    return 0;
}
