/* SPDX-License-Identifier: MIT */
/* room_private.h owns a room in memory, for the files of this folder.
 *
 *   request -> with_room() reads the room from the store where it is not in memory
 *           -> room_edit() folds the event into `state`, or refuses it, and queues its write
 *   store   -> edit_done(): the event is on the disk; the request is answered and the event
 *              sent to the seats
 *
 * `state` is ahead of `committed` by the events on their way to the disk. When one of them can
 * not be written, the state is read again, without it. Seats see committed events alone. */
#ifndef RELIGHTD_ROOMS_PRIVATE_H
#define RELIGHTD_ROOMS_PRIVATE_H

#include "net/request.h"
#include "net/request_wait.h"
#include "rooms/fold.h"
#include "rooms/guests.h"
#include "rooms/hooks.h"
#include "rooms/rooms.h"
#include "rooms/store.h"

enum {
    ROOMS_HASH = 1024,
    ROOM_TAIL = 1024,            /* committed events kept for those who are behind */
    ROOM_TAIL_BYTES = 1 << 20,   /* but at least one */
    ROOM_SNAPSHOT_EVENTS = 1000, /* after as many a snapshot is written */
    ROOM_GONE = 64,              /* participants that left, for those who did not see it yet */
    ROOM_ANSWER = 4 << 20,       /* bytes of events in one answer */
};

struct rooms {
    struct server *server;
    struct room_store *store;
    struct room *hash[ROOMS_HASH];
    struct room *oldest_idle, *newest_idle; /* that nobody uses, in the order of their use */
    unsigned n_room, n_seat;
    uint64_t last_key; /* of a participant */
    struct guests guests;
    struct hooks *hooks;    /* NULL: --room-hook is not set */
    struct backup *backups; /* room_backup.c */
    struct loop_timer purge;
    bool stopping;
    bool reading_guests, guests_again, guests_missed;
    uint64_t tokens_version;         /* shared_tokens.c; 0: none is known */
    struct token_task *token_writes; /* changes of it that are not in the database yet */
    bool reading_tokens, tokens_again;
    bool reading_keeps, keeps_again;
    struct owner_charge *charges; /* room_charges.c */
    bool counting;
};

/* Waits for a room to be in memory. */
struct room_waiter {
    struct room_waiter *next;
    void (*then)(struct room_waiter *waiter, struct room *room, int code, const char *error);
};

/* Committed events, a ring. */
struct room_tail {
    unsigned first, n, most; /* most: a power of two that grows up to ROOM_TAIL */
    size_t bytes;
    struct room_event_bytes event[]; /* [most] */
};

/* Bytes that several answers share. */
struct shared_bytes {
    unsigned refs;
    size_t n;
    uint8_t bytes[];
};

/* Changes of participants that somebody knows: what they say of themselves, and who left. */
struct presence_known {
    uint64_t changes, departures; /* numbers of room->presence */
};

/* Somebody who sits in a room. */
struct seat {
    struct seat *next;
    struct request *request;
    struct room *room;
    struct loop_timer timer;
    uint64_t at; /* sequence of the last event that was sent */
    bool wants_state;
    struct shared_bytes *state; /* of `state_at`: it may have events that are not yet on the
                                 * disk */
    uint64_t state_at;
    Relight__Participant *me;
    uint64_t changed;            /* presence at the last change of `me` */
    struct presence_known knows; /* what it was sent */
    bool told;                   /* whether it was sent any */
    int role;
};

struct room {
    struct room *next;
    struct rooms *rooms;
    char id[ROOM_ID + 1], owner[96];
    Relight__RoomState *state; /* NULL: it is being read */
    uint64_t committed;        /* sequence of the last event that is on the disk */
    uint64_t snapshot;         /* sequence of the newest snapshot */
    uint64_t bytes;            /* of its log */
    bool stale;                /* the state has events that could not be written */
    bool loading;              /* until those who waited for it have been told */
    bool again_stale;          /* it is to be read once more */
    bool spoilt;               /* room_spoil was called since the last reading ended */
    unsigned n_edit;           /* events on their way to the disk */
    struct edit *again;        /* edits that start again once it is read */
    struct room_waiter *waiters, **last_waiter;
    unsigned users;         /* requests that use it now */
    struct room_tail *tail; /* NULL: nobody sits here */
    struct seat *seats;
    struct reader *readers;     /* ROOM_GETs that wait for the disk */
    struct shared_bytes *batch; /* the last piece of the tail that was sent */
    uint64_t batch_from, batch_to;
    struct shared_bytes *packed; /* `state`; NULL: not packed since it changed */
    char packed_hash[65];        /* SHA-256 of it; "": not computed */
    uint64_t presence;           /* grows with every change of a participant */
    uint64_t shown;              /* changes up to it may be sent */
    uint64_t ticked_ns;          /* when the last changes were shown */
    uint64_t presence_sent;      /* bytes, since then */
    struct room_presence {       /* the last changes that were sent */
        struct shared_bytes *packed;
        bool all;
        struct presence_known from;
        uint64_t to, of; /* of: `presence` when it was packed */
    } last_presence;
    struct {
        uint64_t key, presence;
    } gone[ROOM_GONE];
    struct room_memory {
        uint64_t state; /* bytes of `state` when they were counted */
        uint64_t since; /* that events added since, at most */
        bool less;      /* events took something out since */
        uint64_t charged;
    } memory;
    struct room *older_idle, *newer_idle;
    bool is_idle;
    unsigned n_gone; /* that left so far; the last ones are at n % ROOM_GONE */
    struct loop_timer idle, tick;
    struct room_task load;
};

/* rooms.c */
/* NULL: it is not in memory. */
struct room *room_in_memory(struct rooms *rooms, const char *id);
/* Calls then() now or once the room was read; with NULL and an error where that fails. */
void room_use(struct rooms *rooms, const char *id, struct room_waiter *waiter);
void room_hold(struct room *room);
void room_release(struct room *room); /* the last one starts the time until it leaves memory */
/* Those who are behind get the state in place of the events. */
void room_drop_tail(struct room *room);
/* One that nobody uses leaves memory; false: it is used. */
bool room_let_go(struct room *room);
/* The state has to be read again, once no event is under way. */
void room_spoil(struct room *room);
/* Begins to read it where it is stale, or somebody waits for it. */
void room_reload_if_idle(struct room *room);
/* A new room, which its first event will put into the store. NULL without memory. */
struct room *room_add(struct rooms *rooms, const char *id);
/* Puts a committed event into the tail, which takes the bytes. */
void room_keep_event(struct room *room, uint64_t sequence, uint8_t *bytes, size_t n);
/* Puts a summary together; its arrays are freed by summary_finish. False without memory. */
bool room_summarise(const Relight__RoomState *state, struct room_summary *out);
void summary_finish(struct room_summary *summary);

/* room_stored.c */
void room_write_snapshot(struct room *room);
/* The state of a snapshot, if there is one, and the events after it. 0, or ERROR_INTERNAL with
 * the damage, or ERROR_NO_MEMORY. */
int room_fold_stored(const char *room, const struct room_task *task, Relight__RoomState **out,
                     char error[ROOM_ERROR]);

/* keeps.c */
/* The models and uploads that a state needs, as holds_set takes them; NULL without memory. */
char *room_needs(const Relight__RoomState *state);
/* After the event was folded: holds what the room needs now. *out: that, to be written with the
 * event and freed; NULL: it is as before. False without memory. */
bool room_new_needs(const struct room *room, const Relight__RoomEvent *event, char **out);
/* The state was read: the room needs what it says. Written where the store has something else,
 * or always. */
void room_set_needs(struct rooms *rooms, const Relight__RoomState *state, bool write);
/* Reads what all rooms need; holds_known says later whether it could be read. */
void rooms_read_keeps(struct rooms *rooms);
/* Another replica, or this one, has changed what a room needs, or deleted it. */
void room_keeps_changed(struct rooms *rooms, const char *room);

/* room_charges.c */
/* The owner was charged for so many more bytes of its rooms. */
void room_was_charged(struct rooms *rooms, const char *owner, uint64_t bytes);
/* Gives them back, but no more than its rooms are charged here: another replica may have
 * written them. */
void room_give_back(struct rooms *rooms, const char *owner, uint64_t bytes);
/* Counts what other replicas made and deleted; of a store of one process, nothing. */
void rooms_count(struct rooms *rooms);
void room_charges_finish(struct rooms *rooms);

/* room_memory.c: LEDGER_ROOM_MEMORY of the room's owner */
/* The state was read. False: it does not fit beside the rooms in use; forced: it is charged all
 * the same, since somebody sits in the room. */
bool room_memory_state(struct room *room, bool forced, char error[ROOM_ERROR]);
/* Before an event is folded: charges what the state may grow by. False: there is no room. */
bool room_memory_grow(struct room *room, const Relight__RoomEvent *event, uint64_t *bytes,
                      char error[ROOM_ERROR]);
/* The event was refused, and the state did not grow. */
void room_memory_shrink(struct room *room, uint64_t bytes);
/* The state, its packed form or the tail came or went. */
void room_memory_update(struct room *room);

/* room_packed.c */
/* The packed state with a reference for the caller, who calls shared_release; NULL without
 * memory. It may have events that are not on the disk yet. */
struct shared_bytes *room_packed(struct room *room);
/* SHA-256 of what room_packed gave, 64 hex digits. */
const char *room_packed_hash(struct room *room);
/* The state has changed. */
void room_packed_drop(struct room *room);
void shared_release(void *shared); /* NULL is fine */
/* A payload that takes the caller's reference. */
struct payload shared_payload(struct shared_bytes *shared);

/* room_call.c */
typedef void (*with_room_fn)(struct request *request, struct room *room);
/* Calls fn once the room is in memory, with a room that the caller may see. Else the request is
 * answered. fn may hold the room. */
void with_room(struct request *request, const char *id, with_room_fn fn);
/* The caller's role: what members, invitations and the scopes of its token allow together. */
int caller_role(const struct request *request, const struct room *room);
/* Answers without a room: an error whose text does not say whether there is one. */
void no_such_room(struct request *request, const char *id);
/* A payload of malloc()ed bytes. */
struct payload payload_of(void *bytes, size_t n);

/* room_edit.c */
/* Accepts an action or refuses it; the request is answered in the end. role: the author's.
 * seen: what the daemon found, for pins and decisions; NULL otherwise. */
void room_edit(struct request *request, struct room *room, const Relight__RoomAction *action,
               int role);
/* A retry of an edit that was done: true when it was answered. */
bool room_edit_repeated(struct request *request, const struct room *room);
/* Of a refusal for the role in a room. */
extern const char room_role_hint[];
/* Of a refusal for what the room has or has not. */
extern const char room_state_hint[];
/* Starts the edits that waited for the room to be read. */
void edits_again(struct room *room);

/* room_seen.c */
/* The engine that draws a scene of which no picture was seen: the scene's, else the bake's
 * (DEFAULT), else splats, whose pictures do not depend on the machine's speed. */
Relight__Engine engine_for(const struct server *server, const char *id,
                           const Relight__Shade *shade);
/* Calls run(request) once the model and the uploads that a scene, or a request made of one,
 * names are here: another replica may have them. */
void fetch_scene_then(struct request *request, const ProtobufCMessage *scene,
                      void (*run)(struct request *request));
/* Fills in what made the picture of a scene, then calls fn with both; else answers the request.
 * The room may show another scene by then. */
typedef void (*seen_fn)(struct request *request, struct room *room, Relight__Scene *scene,
                        const Relight__Seen *seen);
void find_seen(struct request *request, struct room *room, const Relight__Scene *scene,
               seen_fn fn);

/* room_ops.c */
/* The room's committed sequence has grown, or its state is to be read again. */
void readers_check(struct room *room);
/* The principal has one room less. */
void give_back_room(struct server *server, const char *name);

/* shared_tokens.c */
/* Where rooms are in a database that replicas share, the list of tokens is, too: reads it, or
 * writes this replica's. 0 or -1. */
int tokens_share(struct rooms *rooms);
/* Another replica, or this one, has changed the list: reads it. */
void tokens_changed(struct rooms *rooms);

/* room_seat.c */
/* Participants of a room in memory. */
unsigned seats_count(const struct room *room);
/* Events were committed, or the state was read again. */
void seats_wake(struct room *room);
/* The state is to be read again: what was packed of it for seats has events that may never be
 * on the disk. */
void seats_forget_state(struct room *room);
/* Roles may have changed: those who may not see the room any more leave it. */
void seats_check(struct room *room);
/* room_presence.c */
/* A participant has changed, come or gone: those who sit here are woken for it. */
void presence_changed(struct room *room);
/* A packed Presence of what changed since, or of everybody, as far as one message takes it: up
 * to the change *to. Shared by all who are as far; the caller adds its own reference. NULL
 * without memory. */
struct shared_bytes *presence_after(struct room *room, const struct presence_known *known,
                                    bool all, uint64_t *to);
/* Frees what was packed. */
void presence_drop(struct room *room);

/* The room was deleted: everybody leaves it. */
void seats_end(struct room *room);

#endif
