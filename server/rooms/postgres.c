// SPDX-License-Identifier: MIT
// The statements of the store in PostgreSQL. Values are sent and received as binary: 8-byte
// integers in network order, bytes and texts as they are. Above 600 lines: a list of
// statements, each with the reader of its rows.
#include "rooms/postgres.h"

#include "core/loop.h"

#include <arpa/inet.h>
#include <endian.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// A later version adds a step; one that was released is never edited.
static const char schema[] =
    "CREATE TABLE IF NOT EXISTS relight_schema (version bigint NOT NULL);"
    "CREATE TABLE IF NOT EXISTS room (number bigserial PRIMARY KEY, id text NOT NULL UNIQUE,"
    " sequence bigint NOT NULL, created_us bigint NOT NULL, changed_us bigint NOT NULL,"
    " name text NOT NULL DEFAULT '', owner text NOT NULL DEFAULT '',"
    " closed boolean NOT NULL DEFAULT false, bytes bigint NOT NULL DEFAULT 0);"
    "CREATE INDEX IF NOT EXISTS room_changed ON room (changed_us);"
    "CREATE TABLE IF NOT EXISTS event (room bigint NOT NULL REFERENCES room ON DELETE CASCADE,"
    " sequence bigint NOT NULL, bytes bytea NOT NULL, PRIMARY KEY (room, sequence));"
    "CREATE TABLE IF NOT EXISTS snapshot (room bigint PRIMARY KEY REFERENCES room ON DELETE"
    " CASCADE, sequence bigint NOT NULL, bytes bytea NOT NULL);"
    "CREATE TABLE IF NOT EXISTS member (room bigint NOT NULL REFERENCES room ON DELETE CASCADE,"
    " by text NOT NULL, role bigint NOT NULL, PRIMARY KEY (by, room));"
    "CREATE INDEX IF NOT EXISTS member_of_room ON member (room);"
    "CREATE TABLE IF NOT EXISTS invite (room bigint NOT NULL REFERENCES room ON DELETE CASCADE,"
    " id text NOT NULL, hash text NOT NULL UNIQUE, role bigint NOT NULL,"
    " expires_s bigint NOT NULL, PRIMARY KEY (room, id));"
    "CREATE TABLE IF NOT EXISTS shared_text (name text PRIMARY KEY, version bigint NOT NULL,"
    " value bytea NOT NULL);"
    // What a room needs of the disk (store/holds.h); none: its state has to be read once.
    // Beside the room, so that a relightd that does not know it works on.
    "CREATE TABLE IF NOT EXISTS keeps (room bigint PRIMARY KEY REFERENCES room ON DELETE"
    " CASCADE, names text NOT NULL);"
    // Whose limits a guest counts to. A relightd that does not know it leaves it empty: then
    // the room's owner's.
    "ALTER TABLE invite ADD COLUMN IF NOT EXISTS inviter text NOT NULL DEFAULT '';"
    "INSERT INTO relight_schema SELECT 1 WHERE NOT EXISTS (SELECT FROM relight_schema);";
static const char settings[] =
    "SET statement_timeout = 10000; SET lock_timeout = 5000; SET synchronous_commit = on;"
    "SET client_min_messages = warning; SET default_transaction_isolation = 'read committed'";
enum { SCHEMA_LOCK = 1380733517 }; // of replicas that start at once

// ---- parameters and results

enum { MOST_PARAMETERS = 6 };
struct parameters {
    int n, size[MOST_PARAMETERS], format[MOST_PARAMETERS];
    const char *value[MOST_PARAMETERS];
    uint64_t number[MOST_PARAMETERS]; // big-endian
};

static void add_number(struct parameters *p, uint64_t number)
{
    p->number[p->n] = htobe64(number);
    p->value[p->n] = (const char *)&p->number[p->n];
    p->size[p->n] = 8;
    p->format[p->n++] = 1;
}

static void add_text(struct parameters *p, const char *text)
{
    p->value[p->n] = text;
    p->size[p->n] = (int)strlen(text);
    p->format[p->n++] = 1;
}

static void add_bytes(struct parameters *p, const uint8_t *bytes, size_t n)
{
    p->value[p->n] = n ? (const char *)bytes : "";
    p->size[p->n] = (int)n;
    p->format[p->n++] = 1;
}

static enum pg_fault keep_fault(struct pg_db *db, const PGresult *result)
{
    const char *state = result ? PQresultErrorField(result, PG_DIAG_SQLSTATE) : NULL;
    const char *text = result ? PQresultErrorMessage(result) : PQerrorMessage(db->conn);
    snprintf(db->error, sizeof db->error, "%s", *text ? text : "not enough memory");
    db->error[strcspn(db->error, "\n")] = 0;
    if (PQstatus(db->conn) != CONNECTION_OK || (state && !strncmp(state, "57P", 3)))
        return PG_AWAY;
    bool again = state && (!strcmp(state, "40001") || !strcmp(state, "40P01") ||
                           !strcmp(state, "55P03"));
    return again ? PG_AGAIN : PG_WRONG;
}

// *out: the rows, for PQclear; NULL: they are not wanted.
static enum pg_fault ask(struct pg_db *db, const char *sql, const struct parameters *p,
                         PGresult **out)
{
    PGresult *r = PQexecParams(db->conn, sql, p ? p->n : 0, NULL, p ? p->value : NULL,
                               p ? p->size : NULL, p ? p->format : NULL, 1);
    ExecStatusType status = PQresultStatus(r);
    enum pg_fault fault =
        status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK ? PG_FINE : keep_fault(db, r);
    if (fault || !out) PQclear(r);
    if (out) *out = fault ? NULL : r;
    return fault;
}

enum pg_fault pg_execute(struct pg_db *db, const char *sql)
{
    PGresult *r = PQexec(db->conn, sql);
    ExecStatusType status = PQresultStatus(r);
    enum pg_fault fault =
        status == PGRES_COMMAND_OK || status == PGRES_TUPLES_OK ? PG_FINE : keep_fault(db, r);
    PQclear(r);
    return fault;
}

static uint64_t number_at(const PGresult *r, int row, int column)
{
    uint64_t x = 0;
    if (PQgetlength(r, row, column) == 8) memcpy(&x, PQgetvalue(r, row, column), 8);
    return be64toh(x);
}

static void text_at(const PGresult *r, int row, int column, char *out, size_t n)
{
    int size = PQgetlength(r, row, column);
    if ((size_t)size >= n) size = (int)n - 1;
    memcpy(out, PQgetvalue(r, row, column), (size_t)size);
    out[size] = 0;
}

// ---- the connection

static enum pg_fault check_schema(struct pg_db *db)
{
    char sql[sizeof schema + 100];
    PGresult *r = NULL;
    snprintf(sql, sizeof sql, "BEGIN; SELECT pg_advisory_xact_lock(%d); %s COMMIT", SCHEMA_LOCK,
             schema);
    enum pg_fault fault = pg_execute(db, sql);
    if (!fault) fault = ask(db, "SELECT max(version) FROM relight_schema", NULL, &r);
    if (fault) return fault;
    uint64_t version = PQntuples(r) ? number_at(r, 0, 0) : 0;
    PQclear(r);
    if (version <= POSTGRES_SCHEMA_VERSION) return PG_FINE;
    snprintf(db->error, sizeof db->error,
             "its tables have version %llu, of a later relightd; this one reads up to %d",
             (unsigned long long)version, POSTGRES_SCHEMA_VERSION);
    return PG_WRONG;
}

static void ignore_notice(void *user, const char *text)
{
}

enum pg_fault pg_connect(struct pg_db *db)
{
    // A database that takes connections and does not answer counts as away, too.
    static const char *const keys[] = {"dbname",           "connect_timeout",
                                       "tcp_user_timeout", "client_encoding",
                                       "application_name", NULL};
    const char *values[] = {db->where, "3", "5000", "UTF8", "relightd", NULL};
    pg_disconnect(db);
    db->conn = PQconnectdbParams(keys, values, 1);
    enum pg_fault fault = PG_FINE;
    if (PQstatus(db->conn) != CONNECTION_OK) {
        (void)keep_fault(db, NULL);
        fault = PG_AWAY;
    } else {
        PQsetNoticeProcessor(db->conn, ignore_notice, NULL);
        fault = pg_execute(db, settings);
        if (!fault) fault = check_schema(db);
    }
    if (fault) pg_disconnect(db);
    db->failed_ns = fault ? loop_now_ns() : 0;
    return fault;
}

void pg_disconnect(struct pg_db *db)
{
    if (db->conn) PQfinish(db->conn);
    db->conn = NULL;
}

// ---- appending

struct place {
    uint64_t number, sequence, bytes; // number 0: there is no such room
};

static enum pg_fault find_room(struct pg_db *db, const char *id, bool lock, struct place *out)
{
    struct parameters p = {0};
    PGresult *r;
    *out = (struct place){0};
    add_text(&p, id);
    enum pg_fault fault =
        ask(db,
            lock ? "SELECT number, sequence, bytes FROM room WHERE id=$1 FOR UPDATE"
                 : "SELECT number, sequence, bytes FROM room WHERE id=$1",
            &p, &r);
    if (fault) return fault;
    if (PQntuples(r))
        *out = (struct place){number_at(r, 0, 0), number_at(r, 0, 1), number_at(r, 0, 2)};
    PQclear(r);
    return PG_FINE;
}

static enum pg_fault write_summary(struct pg_db *db, uint64_t room,
                                   const struct room_summary *m)
{
    struct parameters p = {0};
    add_number(&p, room);
    add_text(&p, m->name);
    add_text(&p, m->owner);
    add_text(&p, m->closed ? "\1" : "");
    p.value[3] = m->closed ? "\1" : "\0";
    p.size[3] = 1;
    enum pg_fault fault =
        ask(db, "UPDATE room SET name=$2, owner=$3, closed=$4::bool WHERE number=$1", &p, NULL);
    p.n = 1;
    if (!fault) fault = ask(db, "DELETE FROM member WHERE room=$1", &p, NULL);
    if (!fault) fault = ask(db, "DELETE FROM invite WHERE room=$1", &p, NULL);
    for (size_t i = 0; i < m->n_member && !fault; i++) {
        p.n = 1;
        add_text(&p, m->member[i].by);
        add_number(&p, (uint64_t)m->member[i].role);
        fault = ask(db,
                    "INSERT INTO member (room, by, role) VALUES ($1, $2, $3)"
                    " ON CONFLICT (by, room) DO UPDATE SET role=excluded.role",
                    &p, NULL);
    }
    for (size_t i = 0; i < m->n_invite && !fault; i++) {
        p.n = 1;
        add_text(&p, m->invite[i].id);
        add_text(&p, m->invite[i].hash);
        add_number(&p, (uint64_t)m->invite[i].role);
        add_number(&p, m->invite[i].expires_s);
        add_text(&p, m->invite[i].inviter);
        fault = ask(db,
                    "INSERT INTO invite (room, id, hash, role, expires_s, inviter)"
                    " VALUES ($1, $2, $3, $4, $5, $6) ON CONFLICT (room, id) DO NOTHING",
                    &p, NULL);
    }
    return fault;
}

static enum pg_fault write_keeps(struct pg_db *db, uint64_t room, const char *keeps)
{
    struct parameters p = {0};
    add_number(&p, room);
    add_text(&p, keeps);
    return ask(db,
               "INSERT INTO keeps (room, names) VALUES ($1, $2)"
               " ON CONFLICT (room) DO UPDATE SET names=excluded.names",
               &p, NULL);
}

// *number 0: another replica was first.
static enum pg_fault add_room(struct pg_db *db, const struct room_task *task, uint64_t *number)
{
    struct parameters p = {0};
    PGresult *r;
    add_text(&p, task->room);
    add_number(&p, task->time_us);
    add_number(&p, task->n + ROOM_EVENT_CHARGE);
    enum pg_fault fault =
        ask(db,
            "INSERT INTO room (id, sequence, created_us, changed_us, bytes)"
            " VALUES ($1, 1, $2, $2, $3) ON CONFLICT (id) DO NOTHING RETURNING number",
            &p, &r);
    if (fault) return fault;
    *number = PQntuples(r) ? number_at(r, 0, 0) : 0;
    PQclear(r);
    return PG_FINE;
}

static enum pg_fault grow_room(struct pg_db *db, const struct room_task *task, uint64_t number)
{
    struct parameters p = {0};
    add_number(&p, number);
    add_number(&p, task->sequence);
    add_number(&p, task->time_us);
    add_number(&p, task->n + ROOM_EVENT_CHARGE);
    return ask(db, "UPDATE room SET sequence=$2, changed_us=$3, bytes=bytes+$4 WHERE number=$1",
               &p, NULL);
}

// The log has this very event: its commit was not heard of.
static enum pg_fault is_there(struct pg_db *db, const struct room_task *task, uint64_t number,
                              bool *there)
{
    struct parameters p = {0};
    PGresult *r;
    add_number(&p, number);
    add_number(&p, task->sequence);
    add_bytes(&p, task->bytes, task->n);
    enum pg_fault fault =
        ask(db, "SELECT 1 FROM event WHERE room=$1 AND sequence=$2 AND bytes=$3", &p, &r);
    if (fault) return fault;
    *there = PQntuples(r) > 0;
    PQclear(r);
    return PG_FINE;
}

// Others read what the room and the sequence say; `s`: who may enter has changed; `k`: what it
// needs of the disk has.
static enum pg_fault notify(struct pg_db *db, const struct room_task *task)
{
    struct parameters p = {0};
    char text[100];
    snprintf(text, sizeof text, "%s %llu%s%s", task->room, (unsigned long long)task->sequence,
             task->summary ? " s" : "", task->keeps ? " k" : "");
    add_text(&p, text);
    return ask(db, "SELECT pg_notify('relight_room', $1)", &p, NULL);
}

static enum pg_fault append(struct pg_db *db, struct room_task *task)
{
    struct place place;
    bool there = false;
    enum pg_fault fault = find_room(db, task->room, true, &place);
    if (fault) return fault;
    if (place.sequence + 1 != task->sequence) {
        if (db->uncertain && place.sequence >= task->sequence)
            fault = is_there(db, task, place.number, &there);
        if (!there) task->status = place.number ? ROOM_TASK_CONFLICT : ROOM_TASK_MISSING;
        return fault;
    }
    fault =
        place.number ? grow_room(db, task, place.number) : add_room(db, task, &place.number);
    if (fault) return fault;
    if (!place.number) {
        task->status = ROOM_TASK_CONFLICT;
        return PG_FINE;
    }
    struct parameters p = {0};
    add_number(&p, place.number);
    add_number(&p, task->sequence);
    add_bytes(&p, task->bytes, task->n);
    fault = ask(db, "INSERT INTO event (room, sequence, bytes) VALUES ($1, $2, $3)", &p, NULL);
    if (!fault && task->summary) fault = write_summary(db, place.number, task->summary);
    if (!fault && task->keeps) fault = write_keeps(db, place.number, task->keeps);
    return fault ? fault : notify(db, task);
}

enum pg_fault pg_append_all(struct pg_db *db, struct room_task *const *task, size_t n)
{
    enum pg_fault fault = pg_execute(db, "BEGIN");
    for (size_t i = 0; i < n && !fault; i++) {
        task[i]->status = ROOM_TASK_DONE;
        fault = append(db, task[i]);
    }
    if (!fault) fault = pg_execute(db, "COMMIT");
    char error[sizeof db->error];
    memcpy(error, db->error, sizeof error);
    if (fault && fault != PG_AWAY && pg_execute(db, "ROLLBACK")) fault = PG_AWAY;
    memcpy(db->error, error, sizeof error);
    return fault;
}

// ---- reading

static enum pg_fault no_memory(struct pg_db *db)
{
    snprintf(db->error, sizeof db->error, "not enough memory");
    return PG_WRONG;
}

static bool copy_at(const PGresult *r, int row, int column, uint8_t **bytes, size_t *n)
{
    *n = (size_t)PQgetlength(r, row, column);
    if (!(*bytes = malloc(*n + 1))) return false;
    memcpy(*bytes, PQgetvalue(r, row, column), *n);
    return true;
}

// Pieces of some MiB: a log may be long.
static enum pg_fault read_events(struct pg_db *db, struct room_task *task, uint64_t room,
                                 uint64_t after)
{
    enum { PIECE = 1000 };
    size_t bytes = 0;
    for (int got = PIECE; got == PIECE;) {
        struct parameters p = {0};
        PGresult *r;
        add_number(&p, room);
        add_number(&p, after);
        enum pg_fault fault = ask(db,
                                  "SELECT sequence, bytes FROM event WHERE room=$1 AND"
                                  " sequence>$2 ORDER BY sequence LIMIT 1000",
                                  &p, &r);
        if (fault) return fault;
        got = PQntuples(r);
        struct room_event_bytes *more =
            realloc(task->event, (task->n_event + (size_t)got + 1) * sizeof *more);
        if (more) task->event = more;
        for (int i = 0; more && i < got; i++) {
            struct room_event_bytes *e = &more[task->n_event];
            bytes += (size_t)PQgetlength(r, i, 1);
            bool full = task->most && task->n_event && bytes > task->most;
            if (full) got = 0;
            else if (copy_at(r, i, 1, &e->bytes, &e->n))
                after = e->sequence = number_at(r, i, 0), task->n_event++;
            else more = NULL;
        }
        PQclear(r);
        if (!more) return no_memory(db);
    }
    return PG_FINE;
}

static enum pg_fault load(struct pg_db *db, struct room_task *task)
{
    struct place place;
    struct parameters p = {0};
    PGresult *r;
    enum pg_fault fault = find_room(db, task->room, false, &place);
    if (!place.number) task->status = ROOM_TASK_MISSING;
    if (fault || !place.number) return fault;
    task->stored_bytes = place.bytes;
    if (task->kind == ROOM_TASK_EVENTS)
        return read_events(db, task, place.number, task->sequence);
    add_number(&p, place.number);
    fault = ask(db, "SELECT sequence, bytes FROM snapshot WHERE room=$1", &p, &r);
    if (fault) return fault;
    bool good = true;
    task->sequence = 0;
    if (PQntuples(r)) {
        task->sequence = number_at(r, 0, 0);
        good = copy_at(r, 0, 1, &task->snapshot, &task->n_snapshot);
    }
    PQclear(r);
    task->most = 0;
    return good ? read_events(db, task, place.number, task->sequence) : no_memory(db);
}

// One that another replica wrote and that is newer stays.
static enum pg_fault set_snapshot(struct pg_db *db, struct room_task *task)
{
    struct place place;
    struct parameters p = {0};
    enum pg_fault fault = find_room(db, task->room, false, &place);
    bool known = !fault && place.number && place.sequence >= task->sequence;
    if (!known) task->status = ROOM_TASK_CONFLICT;
    if (!known) return fault;
    add_number(&p, place.number);
    add_number(&p, task->sequence);
    add_bytes(&p, task->bytes, task->n);
    return ask(db,
               "INSERT INTO snapshot AS s (room, sequence, bytes) VALUES ($1, $2, $3)"
               " ON CONFLICT (room) DO UPDATE SET sequence=excluded.sequence,"
               " bytes=excluded.bytes WHERE s.sequence < excluded.sequence",
               &p, NULL);
}

// One statement: nobody can write between the look at the sequence and the change.
static enum pg_fault set_keeps(struct pg_db *db, struct room_task *task)
{
    struct parameters p = {0};
    PGresult *r;
    add_text(&p, task->room);
    add_number(&p, task->sequence);
    add_text(&p, task->keeps);
    enum pg_fault fault =
        ask(db,
            "INSERT INTO keeps (room, names) SELECT number, $3::text FROM room WHERE id=$1 AND"
            " sequence=$2 FOR UPDATE ON CONFLICT (room) DO UPDATE SET names=excluded.names"
            " RETURNING room",
            &p, &r);
    if (fault) return fault;
    if (!PQntuples(r)) task->status = ROOM_TASK_CONFLICT;
    PQclear(r);
    return task->status == ROOM_TASK_CONFLICT ? PG_FINE : notify(db, task);
}

// False without memory.
static bool fill_row(const struct room_task *task, const PGresult *r, int i,
                     struct room_row *row)
{
    *row = (struct room_row){0};
    if (task->kind == ROOM_TASK_OWNERS) {
        text_at(r, i, 0, row->by, sizeof row->by);
        row->sequence = number_at(r, i, 1); // number of rooms
        row->bytes = number_at(r, i, 2);
        return true;
    }
    text_at(r, i, 0, row->room, sizeof row->room);
    if (task->kind == ROOM_TASK_KEEPS)
        return PQgetisnull(r, i, 1) ||
               (row->keeps = strndup(PQgetvalue(r, i, 1), (size_t)PQgetlength(r, i, 1)));
    if (task->kind == ROOM_TASK_INVITES) {
        text_at(r, i, 1, row->by, sizeof row->by);
        text_at(r, i, 2, row->hash, sizeof row->hash);
        row->role = (int)number_at(r, i, 3);
        row->expires_s = number_at(r, i, 4);
        text_at(r, i, 5, row->name, sizeof row->name);
        return true;
    }
    text_at(r, i, 1, row->name, sizeof row->name);
    text_at(r, i, 2, row->by, sizeof row->by);
    row->role = (int)number_at(r, i, 3);
    row->sequence = number_at(r, i, 4);
    row->created_us = number_at(r, i, 5);
    row->changed_us = number_at(r, i, 6);
    row->closed = number_at(r, i, 7) != 0;
    row->bytes = number_at(r, i, 8);
    return true;
}

static enum pg_fault read_rows(struct pg_db *db, struct room_task *task)
{
    struct parameters p = {0};
    PGresult *r;
    const char *sql = "SELECT r.id, i.id, i.hash, i.role, i.expires_s,"
                      " coalesce(nullif(i.inviter, ''), r.owner) FROM invite i"
                      " JOIN room r ON r.number = i.room";
    if (task->kind == ROOM_TASK_LIST) {
        sql = "SELECT r.id, r.name, r.owner, coalesce(max(m.role), 0), r.sequence,"
              " r.created_us, r.changed_us, r.closed::int::bigint, r.bytes FROM room r"
              " LEFT JOIN member m ON m.room = r.number AND m.by IN ($1, '*')"
              " GROUP BY r.number HAVING $1 = '' OR max(m.role) > 0"
              " ORDER BY r.changed_us DESC LIMIT $2";
        add_text(&p, task->by);
        add_number(&p, task->most);
    } else if (task->kind == ROOM_TASK_OWNERS) {
        sql = "SELECT owner, count(*), sum(bytes)::bigint FROM room GROUP BY owner";
    } else if (task->kind == ROOM_TASK_KEEPS) {
        sql = "SELECT r.id, k.names FROM room r LEFT JOIN keeps k ON k.room = r.number"
              " WHERE $1 IN ('', r.id)";
        add_text(&p, task->room);
    } else if (task->kind == ROOM_TASK_PURGE) {
        sql = "WITH gone AS (DELETE FROM room WHERE closed AND changed_us < $1 RETURNING *)"
              " SELECT id, name, owner, 0::bigint, sequence, created_us, changed_us,"
              " closed::int::bigint, bytes, pg_notify('relight_room', id || ' 0 k') FROM gone";
        add_number(&p, task->time_us);
    }
    enum pg_fault fault = ask(db, sql, &p, &r);
    if (fault) return fault;
    int n = PQntuples(r);
    task->row = calloc((size_t)n + 1, sizeof *task->row);
    bool good = task->row;
    for (int i = 0; good && i < n; i++) good = fill_row(task, r, i, &task->row[task->n_row++]);
    PQclear(r);
    return good ? PG_FINE : no_memory(db);
}

// ---- texts that replicas share

static enum pg_fault read_text(struct pg_db *db, struct room_task *task)
{
    struct parameters p = {0};
    PGresult *r;
    add_text(&p, task->path);
    enum pg_fault fault =
        ask(db, "SELECT version, value FROM shared_text WHERE name=$1", &p, &r);
    if (fault) return fault;
    bool good = true;
    if (!PQntuples(r)) {
        task->status = ROOM_TASK_MISSING;
    } else {
        task->sequence = number_at(r, 0, 0);
        good = copy_at(r, 0, 1, &task->snapshot, &task->n_snapshot);
    }
    PQclear(r);
    return good ? PG_FINE : no_memory(db);
}

// One whose outcome was unknown and which was done after all conflicts: it is read again.
static enum pg_fault write_text(struct pg_db *db, struct room_task *task)
{
    struct parameters p = {0};
    PGresult *r;
    add_text(&p, task->path);
    add_bytes(&p, task->bytes, task->n);
    if (task->sequence) add_number(&p, task->sequence);
    enum pg_fault fault =
        ask(db,
            task->sequence
                ? "WITH w AS (UPDATE shared_text SET value=$2, version=version+1 WHERE name=$1"
                  " AND version=$3 RETURNING 1) SELECT pg_notify('relight_tokens', '') FROM w"
                : "WITH w AS (INSERT INTO shared_text VALUES ($1, 1, $2) ON CONFLICT DO NOTHING"
                  " RETURNING 1) SELECT pg_notify('relight_tokens', '') FROM w",
            &p, &r);
    if (fault) return fault;
    if (!PQntuples(r)) task->status = ROOM_TASK_CONFLICT;
    PQclear(r);
    return PG_FINE;
}

enum pg_fault pg_run(struct pg_db *db, struct room_task *task)
{
    switch (task->kind) {
    case ROOM_TASK_TEXT:
        return read_text(db, task);
    case ROOM_TASK_SET_TEXT:
        return write_text(db, task);
    case ROOM_TASK_LOAD:
    case ROOM_TASK_EVENTS:
        return load(db, task);
    case ROOM_TASK_SNAPSHOT:
        return set_snapshot(db, task);
    case ROOM_TASK_SET_KEEPS:
        return set_keeps(db, task);
    case ROOM_TASK_BACKUP:
        snprintf(db->error, sizeof db->error,
                 "rooms in PostgreSQL are backed up with pg_dump, by its administrator");
        return PG_WRONG;
    default:
        return read_rows(db, task);
    }
}
