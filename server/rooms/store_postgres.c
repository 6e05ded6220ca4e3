// SPDX-License-Identifier: MIT
// The store in PostgreSQL: one thread for tasks, one that listens for what other replicas
// wrote. Events that wait at the same time are committed together. While the database is away
// tasks fail at once; nothing is acknowledged that it has not committed.
#include "rooms/postgres.h"

#include "core/log.h"
#include "rooms/task_queue.h"

#include <errno.h>
#include <poll.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/eventfd.h>
#include <unistd.h>

enum { MOST_TOGETHER = 200, MOST_TRIES = 6 };
static const uint64_t again_ns = 300000000; // after a connection failed

struct pg_store {
    struct room_store store; // first
    struct pg_db db;         // of the thread of tasks
    struct loop *loop;
    char *where;
    pthread_t tasks, listener;
    struct task_queue queue;
    int stop; // eventfd of the listener
};

struct change {
    struct loop_message message; // first
    struct pg_store *store;
    struct room_change change;
};

// ---- tasks

// The listener notices first, in the middle of no task, and says when it is back.
static void say_away(struct pg_store *s, const char *error)
{
    if (!atomic_exchange(&s->store.away, true))
        log_line(LOG_ERR, "rooms: the database is away: %.*s", (int)strcspn(error, "\n"),
                 error);
}

// False: the database is away; db.error says so.
static bool connected(struct pg_store *s)
{
    struct pg_db *db = &s->db;
    if (db->conn) return true;
    // Where the listener is connected, so will this one be.
    if (db->failed_ns && s->store.away && loop_now_ns() - db->failed_ns < again_ns)
        return false;
    bool good = !pg_connect(db);
    if (!good) say_away(s, db->error);
    return good;
}

// Calls `run` until it succeeds, fails for good, or the database is away. A connection that was
// lost is tried once more: a server that restarted is back by then, perhaps.
static enum pg_fault try_again(struct pg_store *s, struct room_task *const *task, size_t n)
{
    enum pg_fault fault = PG_AWAY;
    for (int i = 0; i < MOST_TRIES; i++) {
        if (!connected(s)) return PG_AWAY;
        bool append = task[0]->kind == ROOM_TASK_APPEND;
        task[0]->status = ROOM_TASK_DONE; // it may have been begun before
        fault = append ? pg_append_all(&s->db, task, n) : pg_run(&s->db, task[0]);
        s->db.uncertain = append && fault == PG_AWAY;
        if (fault == PG_FINE || fault == PG_WRONG) return fault;
        if (!append) room_task_finish(task[0]);
        if (fault == PG_AWAY) pg_disconnect(&s->db);
    }
    return fault;
}

static void run_tasks(struct pg_store *s, struct room_task *const *task, size_t n)
{
    enum pg_fault fault = try_again(s, task, n);
    for (size_t i = 0; i < n; i++) {
        struct room_task *t = task[i];
        if (fault) {
            room_task_finish(t);
            t->status = ROOM_TASK_FAILED;
            snprintf(t->error, sizeof t->error, "%s%.150s",
                     fault == PG_AWAY ? "the database of rooms is away: " : "", s->db.error);
        }
        loop_post(s->loop, &t->message);
    }
}

static void *run(void *user)
{
    struct pg_store *s = user;
    struct room_task *batch[MOST_TOGETHER];
    for (struct room_task *all; (all = task_queue_take_all(&s->queue));)
        for (size_t n; (n = task_queue_next(&all, batch, MOST_TOGETHER));)
            run_tasks(s, batch, n);
    return NULL;
}

// ---- what other replicas wrote

static void tell(struct loop_message *message)
{
    struct change *c = (struct change *)message;
    struct room_store *store = &c->store->store;
    if (store->changed) store->changed(store->user, &c->change);
    free(c);
}

static void post(struct pg_store *s, const struct room_change *change)
{
    struct change *c = calloc(1, sizeof *c);
    if (!c) return; // the next one of the room says as much
    c->message.handle = tell;
    c->store = s;
    c->change = *change;
    loop_post(s->loop, &c->message);
}

static void take_notification(struct pg_store *s, const PGnotify *n)
{
    struct room_change change = {0};
    unsigned long long sequence = 0;
    char what[2] = {0};
    if (!strcmp(n->relname, "relight_tokens")) {
        change.tokens = true;
    } else if (sscanf(n->extra, "%39s %llu %c %c", change.room, &sequence, &what[0],
                      &what[1]) >= 2) {
        change.sequence = sequence;
        change.summary = what[0] == 's';
        change.keeps = what[0] == 'k' || what[1] == 'k';
    } else {
        return;
    }
    post(s, &change);
}

// Until `seconds` have passed or the store closes; false: it closes.
static bool pause_for(const struct pg_store *s, int milliseconds)
{
    struct pollfd fd = {s->stop, POLLIN, 0};
    return poll(&fd, 1, milliseconds) == 0;
}

static void listen_on(struct pg_store *s, struct pg_db *db)
{
    for (;;) {
        struct pollfd fds[2] = {{PQsocket(db->conn), POLLIN, 0}, {s->stop, POLLIN, 0}};
        if (poll(fds, 2, -1) < 0 && errno != EINTR) return;
        if (fds[1].revents || !PQconsumeInput(db->conn)) return;
        for (PGnotify *n; (n = PQnotifies(db->conn)); PQfreemem(n)) take_notification(s, n);
        if (PQstatus(db->conn) != CONNECTION_OK) return;
    }
}

static void *listen_always(void *user)
{
    struct pg_store *s = user;
    struct pg_db db = {.where = s->where};
    static const struct room_change all = {.all = true, .tokens = true};
    for (bool first = true; pause_for(s, first ? 0 : 200); first = false) {
        if (pg_connect(&db) || pg_execute(&db, "LISTEN relight_room; LISTEN relight_tokens")) {
            say_away(s, db.error);
            continue;
        }
        if (atomic_exchange(&s->store.away, false))
            log_line(LOG_EVENT, "rooms: the database is back");
        if (!first) post(s, &all); // what happened meanwhile was not heard
        listen_on(s, &db);
        if (pause_for(s, 0)) say_away(s, PQerrorMessage(db.conn));
    }
    pg_disconnect(&db);
    return NULL;
}

// ---- the interface

static void submit(struct room_store *store, struct room_task *task)
{
    task_queue_add(&((struct pg_store *)store)->queue, task);
}

static void free_store(struct pg_store *s)
{
    pg_disconnect(&s->db);
    if (s->stop >= 0) close(s->stop);
    task_queue_finish(&s->queue);
    free(s->where);
    free(s);
}

static int open_store(const char *where, struct loop *loop, struct room_store **out,
                      char error[256])
{
    struct pg_store *s = calloc(1, sizeof *s);
    snprintf(error, 256, "not enough memory");
    if (!s) return -1;
    s->store.api = &room_store_postgres;
    s->store.shared = true;
    s->loop = loop;
    s->stop = eventfd(0, EFD_CLOEXEC);
    s->where = strdup(where);
    s->db.where = s->where;
    task_queue_init(&s->queue);
    if (s->where && pg_connect(&s->db)) snprintf(error, 256, "rooms: %.200s", s->db.error);
    if (!s->db.conn || s->stop < 0) {
        free_store(s);
        return -1;
    }
    snprintf(error, 256, "no thread could be started");
    if (pthread_create(&s->tasks, NULL, run, s)) {
        free_store(s);
        return -1;
    }
    if (pthread_create(&s->listener, NULL, listen_always, s)) abort();
    *out = &s->store;
    return 0;
}

static void close_store(struct room_store *store)
{
    struct pg_store *s = (struct pg_store *)store;
    uint64_t one = 1;
    task_queue_close(&s->queue);
    if (write(s->stop, &one, sizeof one) != sizeof one) abort();
    pthread_join(s->tasks, NULL);
    pthread_join(s->listener, NULL);
    s->store.changed = NULL;
    loop_turn(s->loop, 0); // changes that were posted
    free_store(s);
}

const struct room_store_api room_store_postgres = {open_store, submit, close_store};
