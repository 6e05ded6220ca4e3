/* SPDX-License-Identifier: MIT */
/* store.h owns where rooms are kept: the interface of the embedded store (store_sqlite.c) and
 * of those to come. A store keeps each room's events, its newest snapshot, and what lists and
 * guests need without the room's state. Every operation is a task that ends on the loop's
 * thread; nothing blocks it.
 * Thread-safety: loop thread only. */
#ifndef RELIGHTD_ROOMS_STORE_H
#define RELIGHTD_ROOMS_STORE_H

#include "core/loop.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct room_store;

enum { ROOM_EVENT_CHARGE = 64 }; /* bytes that an event takes on the disk beside its own */

enum room_task_status {
    ROOM_TASK_DONE,     /* it is on the disk */
    ROOM_TASK_MISSING,  /* there is no such room */
    ROOM_TASK_CONFLICT, /* the room has other events than the task supposes: read it again */
    ROOM_TASK_FAILED,   /* nothing was changed; `error` has the reason */
};

enum room_task_kind {
    ROOM_TASK_LOAD,      /* out: snapshot, its sequence, the events after it, bytes */
    ROOM_TASK_APPEND,    /* one event, and the summary where it changed */
    ROOM_TASK_SNAPSHOT,  /* replaces the room's snapshot; ignored when it is not of the log */
    ROOM_TASK_EVENTS,    /* out: events after `sequence`, up to `most` bytes */
    ROOM_TASK_LIST,      /* out: rooms of a principal, or all of them */
    ROOM_TASK_INVITES,   /* out: the invitations in force of all rooms */
    ROOM_TASK_OWNERS,    /* out: owners and what their rooms take, for the ledger */
    ROOM_TASK_KEEPS,     /* out: what each room needs of the disk; `room` not "": of that one */
    ROOM_TASK_SET_KEEPS, /* CONFLICT unless `sequence` is the room's */
    ROOM_TASK_PURGE,     /* deletes rooms that were closed before `time_us`; out: them */
    ROOM_TASK_BACKUP,    /* copies the store to `path` while it is used */
    /* A text that replicas share, by its name `path`; a store of one process has none. */
    ROOM_TASK_TEXT, /* out: snapshot, and its version in `sequence`; MISSING: there is none */
    ROOM_TASK_SET_TEXT, /* CONFLICT unless `sequence` is the version (0: none), which grows by 1
                         */
};

struct room_event_bytes {
    uint64_t sequence;
    uint8_t *bytes; /* a packed RoomEvent */
    size_t n;
};
/* What lists and guests need; written with the event that changes it. */
struct room_summary {
    char name[128], owner[96];
    uint64_t created_us;
    bool closed;
    size_t n_member, n_invite;
    struct room_member {
        char by[96];
        int role;
    } * member;
    struct room_invite {
        char id[40], hash[65], inviter[96];
        int role;
        uint64_t expires_s;
    } * invite; /* those that were not revoked */
};
/* A row of LIST, INVITES, KEEPS, OWNERS (by: owner, sequence: number of rooms) or PURGE. */
struct room_row {
    /* by: of OWNERS the owner, of INVITES the id; name: of INVITES the inviter */
    char room[40], name[128], by[96], hash[65];
    int role;
    bool closed;
    uint64_t sequence, created_us, changed_us, bytes, expires_s;
    char
        *keeps; /* of KEEPS, as holds_set takes them; NULL: an earlier version wrote the room */
};

/* An operation, embedded in its owner, which keeps it and what it points to until `done`. */
struct room_task {
    struct loop_message message;
    struct room_task *next;
    enum room_task_kind kind;
    char room[40], by[96]; /* by: LIST: "": all rooms */
    const char *path;
    uint64_t sequence, time_us; /* APPEND: of the event; LOAD: out, of the snapshot */
    size_t most;                /* EVENTS: bytes; LIST: rows */
    const uint8_t *bytes;       /* APPEND, SNAPSHOT */
    size_t n;
    const struct room_summary *summary; /* APPEND; NULL: as it was */
    const char *keeps;                  /* APPEND, SET_KEEPS: see holds_set; NULL: as it was */
    /* Out, freed by room_task_finish. */
    uint8_t *snapshot;
    size_t n_snapshot;
    struct room_event_bytes *event;
    size_t n_event;
    struct room_row *row;
    size_t n_row;
    uint64_t stored_bytes;
    enum room_task_status status;
    char error[200];
    void (*done)(struct room_task *task); /* on the loop's thread */
};
void room_task_finish(struct room_task *task); /* frees what came out */

struct room_store_api {
    /* 0, or -1 with the error's text. May block: it is called at the start. */
    int (*open)(const char *where, struct loop *loop, struct room_store **out, char error[256]);
    /* Tasks of one room are done in their order. */
    void (*submit)(struct room_store *store, struct room_task *task);
    /* Waits for tasks that were submitted; their `done` was posted to the loop. */
    void (*close)(struct room_store *store);
};
/* What another process wrote, or perhaps this one. */
struct room_change {
    char room[40];
    uint64_t sequence;
    bool summary; /* who may enter it has changed, too */
    bool keeps;   /* what it needs has changed, or the room is gone */
    bool all;     /* changes were missed: any room, any summary */
    bool tokens;  /* the list of tokens */
};
struct room_store {
    const struct room_store_api *api;
    /* Called on the loop's thread. Set by the owner; NULL: it does not care. A store of one
     * process never calls it. */
    void (*changed)(void *user, const struct room_change *change);
    void *user;
    bool shared;       /* other processes may write to it, too */
    _Atomic bool away; /* nothing can be read or written now; it comes back by itself */
};
extern const struct room_store_api room_store_sqlite;
extern const struct room_store_api room_store_postgres; /* several relightd may share it */

/* --rooms: "sqlite:FILE" or "postgresql://…". NULL for another kind, with the error's text.
 * *where is the file, or the whole text. */
const struct room_store_api *room_store_parse(const char *option, const char **where,
                                              char error[256]);

#endif
