// SPDX-License-Identifier: MIT
// The statements of the embedded store.
#include "rooms/store_sqlite.h"

#include "rooms/sqlite_schema.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

static const char *const sql[SQL_N] = {
    [SQL_ROOM] = "SELECT number, sequence, bytes FROM room WHERE id=?1",
    [SQL_ADD_ROOM] = "INSERT INTO room (id, sequence, created_us, changed_us, bytes)"
                     " VALUES (?1, 1, ?2, ?2, ?3)",
    [SQL_ADD_EVENT] = "INSERT INTO event (room, sequence, bytes) VALUES (?1, ?2, ?3)",
    [SQL_GROW_ROOM] =
        "UPDATE room SET sequence=?2, changed_us=?3, bytes=bytes+?4 WHERE number=?1",
    [SQL_SET_SUMMARY] = "UPDATE room SET name=?2, owner=?3, closed=?4 WHERE number=?1",
    [SQL_DROP_MEMBERS] = "DELETE FROM member WHERE room=?1",
    [SQL_ADD_MEMBER] = "INSERT OR REPLACE INTO member (room, by, role) VALUES (?1, ?2, ?3)",
    [SQL_DROP_INVITES] = "DELETE FROM invite WHERE room=?1",
    [SQL_ADD_INVITE] =
        "INSERT OR REPLACE INTO invite (room, id, hash, role, expires_s, inviter)"
        " VALUES (?1, ?2, ?3, ?4, ?5, ?6)",
    [SQL_SNAPSHOT] = "SELECT sequence, bytes FROM snapshot WHERE room=?1",
    [SQL_SET_SNAPSHOT] =
        "INSERT OR REPLACE INTO snapshot (room, sequence, bytes) VALUES (?1, ?2, ?3)",
    [SQL_EVENTS] =
        "SELECT sequence, bytes FROM event WHERE room=?1 AND sequence>?2 ORDER BY sequence",
    [SQL_LIST] =
        "SELECT r.id, r.name, r.owner, coalesce(max(m.role), 0), r.sequence, r.created_us,"
        " r.changed_us, r.closed, r.bytes FROM room r LEFT JOIN member m ON m.room = r.number"
        " AND m.by IN (?1, '*') GROUP BY r.number HAVING ?1 = '' OR max(m.role) > 0"
        " ORDER BY r.changed_us DESC LIMIT ?2",
    [SQL_INVITES] = "SELECT r.id, i.id, i.hash, i.role, i.expires_s, i.inviter FROM invite i"
                    " JOIN room r ON r.number = i.room",
    [SQL_OLD] = "SELECT id, name, owner, 0, sequence, created_us, changed_us, closed, bytes"
                " FROM room WHERE closed AND changed_us < ?1",
    [SQL_OWNERS] = "SELECT owner, count(*), sum(bytes) FROM room GROUP BY owner",
    [SQL_KEEPS] = "SELECT id, keeps FROM room WHERE ?1 IN ('', id)",
    [SQL_SET_KEEPS] = "UPDATE room SET keeps=?2 WHERE number=?1",
};

// ---- opening

static int fault_of(struct sqlite_db *db, int code)
{
    if (!code || code == SQLITE_ROW || code == SQLITE_DONE) return 0;
    int kind = sqlite3_extended_errcode(db->handle) & 0xff;
    snprintf(db->error, sizeof db->error, "%s%s", sqlite3_errmsg(db->handle),
             kind == SQLITE_FULL || kind == SQLITE_IOERR ? " (is the disk full?)" : "");
    return code;
}

static int prepare(struct sqlite_db *db)
{
    for (int i = 0; i < SQL_N; i++)
        if (fault_of(db, sqlite3_prepare_v3(db->handle, sql[i], -1, SQLITE_PREPARE_PERSISTENT,
                                            &db->statement[i], NULL)))
            return -1;
    return 0;
}

// In exclusive mode a second daemon on the same file is refused; the file lock ends with the
// process.
static const char settings[] = "PRAGMA locking_mode=EXCLUSIVE; PRAGMA journal_mode=WAL;"
                               "PRAGMA synchronous=FULL; PRAGMA foreign_keys=OFF;"
                               "PRAGMA wal_autocheckpoint=1000; PRAGMA cache_size=-4096;"
                               "PRAGMA trusted_schema=OFF; PRAGMA cell_size_check=ON;";

int sqlite_open(struct sqlite_db *db, const char *path, char error[256])
{
    char why[256] = "";
    mode_t mask = umask(077);
    int code =
        sqlite3_open_v2(path, &db->handle,
                        SQLITE_OPEN_READWRITE | SQLITE_OPEN_CREATE | SQLITE_OPEN_NOMUTEX, NULL);
    if (!code) code = sqlite3_exec(db->handle, settings, NULL, NULL, NULL);
    if (!code) code = sqlite3_exec(db->handle, "BEGIN IMMEDIATE; COMMIT", NULL, NULL, NULL);
    umask(mask);
    if (code)
        snprintf(why, sizeof why, "%s",
                 (code & 0xff) == SQLITE_BUSY ? "another relightd uses it"
                 : db->handle                 ? sqlite3_errmsg(db->handle)
                                              : "not enough memory");
    if (!code && !sqlite_schema_update(db->handle, why) && !prepare(db)) return 0;
    snprintf(error, 256, "rooms %.120s: %.100s", path, *why ? why : db->error);
    sqlite_close(db);
    return -1;
}

void sqlite_close(struct sqlite_db *db)
{
    for (int i = 0; i < SQL_N; i++) sqlite3_finalize(db->statement[i]);
    sqlite3_close(db->handle);
    *db = (struct sqlite_db){0};
}

// ---- statements

static sqlite3_stmt *use(struct sqlite_db *db, enum sqlite_statement which)
{
    sqlite3_reset(db->statement[which]);
    sqlite3_clear_bindings(db->statement[which]);
    return db->statement[which];
}

static void bind_text(sqlite3_stmt *s, int at, const char *text)
{
    sqlite3_bind_text(s, at, text, -1, SQLITE_STATIC);
}

static void bind_number(sqlite3_stmt *s, int at, uint64_t number)
{
    sqlite3_bind_int64(s, at, (sqlite3_int64)number);
}

// Runs a statement that gives no rows.
static int execute(struct sqlite_db *db, sqlite3_stmt *s)
{
    int fault = fault_of(db, sqlite3_step(s));
    sqlite3_reset(s);
    return fault;
}

struct room_place {
    sqlite3_int64 number; // 0: there is no such room
    uint64_t sequence, bytes;
};

static int find_room(struct sqlite_db *db, const char *id, struct room_place *out)
{
    sqlite3_stmt *s = use(db, SQL_ROOM);
    *out = (struct room_place){0};
    bind_text(s, 1, id);
    int code = sqlite3_step(s);
    if (code == SQLITE_ROW) {
        out->number = sqlite3_column_int64(s, 0);
        out->sequence = (uint64_t)sqlite3_column_int64(s, 1);
        out->bytes = (uint64_t)sqlite3_column_int64(s, 2);
    }
    int fault = fault_of(db, code);
    sqlite3_reset(s);
    return fault;
}

// ---- appending

static int write_summary(struct sqlite_db *db, sqlite3_int64 room, const struct room_summary *m)
{
    sqlite3_stmt *s = use(db, SQL_SET_SUMMARY);
    sqlite3_bind_int64(s, 1, room);
    bind_text(s, 2, m->name);
    bind_text(s, 3, m->owner);
    sqlite3_bind_int(s, 4, m->closed);
    int fault = execute(db, s);
    for (int i = 0; i < 2 && !fault; i++) {
        s = use(db, i ? SQL_DROP_INVITES : SQL_DROP_MEMBERS);
        sqlite3_bind_int64(s, 1, room);
        fault = execute(db, s);
    }
    for (size_t i = 0; i < m->n_member && !fault; i++) {
        s = use(db, SQL_ADD_MEMBER);
        sqlite3_bind_int64(s, 1, room);
        bind_text(s, 2, m->member[i].by);
        sqlite3_bind_int(s, 3, m->member[i].role);
        fault = execute(db, s);
    }
    for (size_t i = 0; i < m->n_invite && !fault; i++) {
        s = use(db, SQL_ADD_INVITE);
        sqlite3_bind_int64(s, 1, room);
        bind_text(s, 2, m->invite[i].id);
        bind_text(s, 3, m->invite[i].hash);
        sqlite3_bind_int(s, 4, m->invite[i].role);
        bind_number(s, 5, m->invite[i].expires_s);
        bind_text(s, 6, m->invite[i].inviter);
        fault = execute(db, s);
    }
    return fault;
}

static int write_keeps(struct sqlite_db *db, sqlite3_int64 room, const char *keeps)
{
    sqlite3_stmt *s = use(db, SQL_SET_KEEPS);
    sqlite3_bind_int64(s, 1, room);
    bind_text(s, 2, keeps);
    return execute(db, s);
}

static int add_room(struct sqlite_db *db, const struct room_task *task, sqlite3_int64 *number)
{
    sqlite3_stmt *s = use(db, SQL_ADD_ROOM);
    bind_text(s, 1, task->room);
    bind_number(s, 2, task->time_us);
    bind_number(s, 3, task->n + ROOM_EVENT_CHARGE);
    int fault = execute(db, s);
    *number = sqlite3_last_insert_rowid(db->handle);
    return fault;
}

static int grow_room(struct sqlite_db *db, const struct room_task *task, sqlite3_int64 number)
{
    sqlite3_stmt *s = use(db, SQL_GROW_ROOM);
    sqlite3_bind_int64(s, 1, number);
    bind_number(s, 2, task->sequence);
    bind_number(s, 3, task->time_us);
    bind_number(s, 4, task->n + ROOM_EVENT_CHARGE);
    return execute(db, s);
}

int sqlite_begin(struct sqlite_db *db)
{
    return fault_of(db, sqlite3_exec(db->handle, "BEGIN IMMEDIATE", NULL, NULL, NULL));
}

int sqlite_append(struct sqlite_db *db, struct room_task *task)
{
    struct room_place place;
    int fault = find_room(db, task->room, &place);
    if (fault) return fault;
    if (place.sequence + 1 != task->sequence) {
        task->status = place.number ? ROOM_TASK_CONFLICT : ROOM_TASK_MISSING;
        return 0;
    }
    fault =
        place.number ? grow_room(db, task, place.number) : add_room(db, task, &place.number);
    if (fault) return fault;
    sqlite3_stmt *s = use(db, SQL_ADD_EVENT);
    sqlite3_bind_int64(s, 1, place.number);
    bind_number(s, 2, task->sequence);
    sqlite3_bind_blob64(s, 3, task->bytes, task->n, SQLITE_STATIC);
    fault = execute(db, s);
    if (!fault && task->summary) fault = write_summary(db, place.number, task->summary);
    if (!fault && task->keeps) fault = write_keeps(db, place.number, task->keeps);
    return fault;
}

int sqlite_end(struct sqlite_db *db, int fault)
{
    if (!fault) fault = fault_of(db, sqlite3_exec(db->handle, "COMMIT", NULL, NULL, NULL));
    if (fault && !sqlite3_get_autocommit(db->handle))
        sqlite3_exec(db->handle, "ROLLBACK", NULL, NULL, NULL);
    return fault;
}

// ---- reading

static int no_memory(struct sqlite_db *db)
{
    snprintf(db->error, sizeof db->error, "not enough memory");
    return SQLITE_NOMEM;
}

static int copy_blob(struct sqlite_db *db, sqlite3_stmt *s, int column, uint8_t **bytes,
                     size_t *n)
{
    *n = (size_t)sqlite3_column_bytes(s, column);
    const void *from = sqlite3_column_blob(s, column);
    if (*n && !from) return no_memory(db);
    if (!(*bytes = malloc(*n + 1))) return no_memory(db);
    if (*n) memcpy(*bytes, from, *n);
    return 0;
}

static int read_events(struct sqlite_db *db, struct room_task *task, sqlite3_int64 room,
                       uint64_t after)
{
    sqlite3_stmt *s = use(db, SQL_EVENTS);
    size_t bytes = 0, room_for = 0;
    int code, fault = 0;
    sqlite3_bind_int64(s, 1, room);
    bind_number(s, 2, after);
    while ((code = sqlite3_step(s)) == SQLITE_ROW && !fault) {
        size_t n = (size_t)sqlite3_column_bytes(s, 1);
        if (task->most && task->n_event && bytes + n > task->most) break;
        bytes += n;
        if (task->n_event == room_for) {
            room_for = room_for ? room_for * 2 : 16;
            void *more = realloc(task->event, room_for * sizeof *task->event);
            if (!more) {
                fault = no_memory(db);
                break;
            }
            task->event = more;
        }
        struct room_event_bytes *e = &task->event[task->n_event];
        e->sequence = (uint64_t)sqlite3_column_int64(s, 0);
        fault = copy_blob(db, s, 1, &e->bytes, &e->n);
        if (!fault) task->n_event++;
    }
    if (!fault) fault = fault_of(db, code);
    sqlite3_reset(s);
    return fault;
}

static int load(struct sqlite_db *db, struct room_task *task)
{
    struct room_place place;
    int fault = find_room(db, task->room, &place);
    if (fault || !place.number) {
        task->status = ROOM_TASK_MISSING;
        return fault;
    }
    task->stored_bytes = place.bytes;
    if (task->kind == ROOM_TASK_EVENTS)
        return read_events(db, task, place.number, task->sequence);
    sqlite3_stmt *s = use(db, SQL_SNAPSHOT);
    sqlite3_bind_int64(s, 1, place.number);
    int code = sqlite3_step(s);
    task->sequence = 0;
    if (code == SQLITE_ROW) {
        task->sequence = (uint64_t)sqlite3_column_int64(s, 0);
        fault = copy_blob(db, s, 1, &task->snapshot, &task->n_snapshot);
    }
    if (!fault) fault = fault_of(db, code);
    sqlite3_reset(s);
    task->most = 0;
    return fault ? fault : read_events(db, task, place.number, task->sequence);
}

static int set_snapshot(struct sqlite_db *db, struct room_task *task)
{
    struct room_place place;
    int fault = find_room(db, task->room, &place);
    if (fault || !place.number || place.sequence < task->sequence) {
        task->status = ROOM_TASK_CONFLICT;
        return fault;
    }
    sqlite3_stmt *s = use(db, SQL_SET_SNAPSHOT);
    sqlite3_bind_int64(s, 1, place.number);
    bind_number(s, 2, task->sequence);
    sqlite3_bind_blob64(s, 3, task->bytes, task->n, SQLITE_STATIC);
    return execute(db, s);
}

static int set_keeps(struct sqlite_db *db, struct room_task *task)
{
    struct room_place place;
    int fault = find_room(db, task->room, &place);
    if (!fault && place.number && place.sequence == task->sequence)
        return write_keeps(db, place.number, task->keeps);
    task->status = ROOM_TASK_CONFLICT;
    return fault;
}

// ---- rows

static void copy_column(sqlite3_stmt *s, int column, char *out, size_t n)
{
    const char *text = (const char *)sqlite3_column_text(s, column);
    snprintf(out, n, "%s", text ? text : "");
}

static uint64_t number_column(sqlite3_stmt *s, int column)
{
    return (uint64_t)sqlite3_column_int64(s, column);
}

// False without memory.
static bool fill_row(const struct room_task *task, sqlite3_stmt *s, struct room_row *row)
{
    *row = (struct room_row){0};
    if (task->kind == ROOM_TASK_OWNERS) {
        copy_column(s, 0, row->by, sizeof row->by);
        row->sequence = number_column(s, 1); // number of rooms
        row->bytes = number_column(s, 2);
        return true;
    }
    copy_column(s, 0, row->room, sizeof row->room);
    if (task->kind == ROOM_TASK_KEEPS) {
        const char *text = (const char *)sqlite3_column_text(s, 1);
        return !text || (row->keeps = strdup(text));
    }
    if (task->kind == ROOM_TASK_INVITES) {
        copy_column(s, 1, row->by, sizeof row->by);
        copy_column(s, 2, row->hash, sizeof row->hash);
        row->role = sqlite3_column_int(s, 3);
        row->expires_s = number_column(s, 4);
        copy_column(s, 5, row->name, sizeof row->name);
        return true;
    }
    copy_column(s, 1, row->name, sizeof row->name);
    copy_column(s, 2, row->by, sizeof row->by);
    row->role = sqlite3_column_int(s, 3);
    row->sequence = number_column(s, 4);
    row->created_us = number_column(s, 5);
    row->changed_us = number_column(s, 6);
    row->closed = sqlite3_column_int(s, 7);
    row->bytes = number_column(s, 8);
    return true;
}

static int read_rows(struct sqlite_db *db, struct room_task *task, enum sqlite_statement which)
{
    sqlite3_stmt *s = use(db, which);
    size_t room_for = 0;
    int code, fault = 0;
    if (which == SQL_LIST) {
        bind_text(s, 1, task->by);
        bind_number(s, 2, task->most);
    } else if (which == SQL_OLD) {
        bind_number(s, 1, task->time_us);
    } else if (which == SQL_KEEPS) {
        bind_text(s, 1, task->room);
    }
    while ((code = sqlite3_step(s)) == SQLITE_ROW) {
        if (task->n_row == room_for) {
            room_for = room_for ? room_for * 2 : 16;
            void *more = realloc(task->row, room_for * sizeof *task->row);
            if (!more) {
                fault = no_memory(db);
                break;
            }
            task->row = more;
        }
        if (fill_row(task, s, &task->row[task->n_row++])) continue;
        fault = no_memory(db);
        break;
    }
    if (!fault) fault = fault_of(db, code);
    sqlite3_reset(s);
    return fault;
}

// ---- the whole store

// Rooms that were closed long ago go with everything about them.
static int purge(struct sqlite_db *db, struct room_task *task)
{
    static const char old[] = "(SELECT number FROM room WHERE closed AND changed_us < %llu)";
    static const char *const tables[] = {"event", "snapshot", "member", "invite"};
    char rooms[120], text[300];
    snprintf(rooms, sizeof rooms, old, (unsigned long long)task->time_us);
    int fault = sqlite_begin(db);
    if (!fault) fault = read_rows(db, task, SQL_OLD);
    for (int i = 0; task->n_row && i < 4 && !fault; i++) {
        snprintf(text, sizeof text, "DELETE FROM %s WHERE room IN %s", tables[i], rooms);
        fault = fault_of(db, sqlite3_exec(db->handle, text, NULL, NULL, NULL));
    }
    snprintf(text, sizeof text, "DELETE FROM room WHERE number IN %s", rooms);
    if (!fault && task->n_row)
        fault = fault_of(db, sqlite3_exec(db->handle, text, NULL, NULL, NULL));
    return sqlite_end(db, fault);
}

static int backup(struct sqlite_db *db, struct room_task *task)
{
    struct stat st;
    sqlite3_stmt *s = NULL;
    unlink(task->path); // of a daemon that was killed in the middle
    int fault = fault_of(db, sqlite3_prepare_v2(db->handle, "VACUUM INTO ?1", -1, &s, NULL));
    if (!fault) {
        bind_text(s, 1, task->path);
        fault = fault_of(db, sqlite3_step(s));
    }
    sqlite3_finalize(s);
    if (!fault && !stat(task->path, &st)) task->stored_bytes = (uint64_t)st.st_size;
    if (fault) unlink(task->path);
    return fault;
}

void sqlite_run(struct sqlite_db *db, struct room_task *task)
{
    int fault = 0;
    switch (task->kind) {
    case ROOM_TASK_LOAD:
    case ROOM_TASK_EVENTS:
        fault = load(db, task);
        break;
    case ROOM_TASK_SNAPSHOT:
        fault = set_snapshot(db, task);
        break;
    case ROOM_TASK_LIST:
        fault = read_rows(db, task, SQL_LIST);
        break;
    case ROOM_TASK_INVITES:
        fault = read_rows(db, task, SQL_INVITES);
        break;
    case ROOM_TASK_OWNERS:
        fault = read_rows(db, task, SQL_OWNERS);
        break;
    case ROOM_TASK_KEEPS:
        fault = read_rows(db, task, SQL_KEEPS);
        break;
    case ROOM_TASK_SET_KEEPS:
        fault = set_keeps(db, task);
        break;
    case ROOM_TASK_PURGE:
        fault = purge(db, task);
        break;
    case ROOM_TASK_BACKUP:
        fault = backup(db, task);
        break;
    case ROOM_TASK_TEXT:
    case ROOM_TASK_SET_TEXT:
        task->status = ROOM_TASK_MISSING;
        break;
    case ROOM_TASK_APPEND:
        break; // in a transaction of many: sqlite_append
    }
    if (!fault) return;
    room_task_finish(task);
    task->status = ROOM_TASK_FAILED;
    snprintf(task->error, sizeof task->error, "%s", db->error);
}
