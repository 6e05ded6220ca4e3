// SPDX-License-Identifier: MIT
// The list of tokens in the database of rooms: a change is written there before it is answered,
// and every replica reads it when it is told of one. Changes are written one after another;
// where another replica's came first, the list is read and the change is made in it. DATA/
// tokens.json is a copy, by which a start without the database knows that tokens exist.
#include "rooms/room_private.h"

#include "core/log.h"
#include "store/file_queue.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const char list_name[] = "tokens";

struct token_task {
    struct room_task task; // first
    struct rooms *rooms;
    // Of a write:
    struct token_task *next;
    char *text;
    bool under_way; // else it waits for an earlier one, or for the list to be read
    void (*apply)(void *user);
    void (*done)(void *user, int fault);
    void *user;
};

static struct token_task *new_task(struct rooms *rooms, enum room_task_kind kind,
                                   void (*done)(struct room_task *task))
{
    struct token_task *t = calloc(1, sizeof *t);
    if (!t) return NULL;
    t->rooms = rooms;
    t->task = (struct room_task){.kind = kind, .path = list_name, .done = done};
    t->task.sequence = rooms->tokens_version;
    return t;
}

static void submit(struct token_task *t)
{
    t->rooms->store->api->submit(t->rooms->store, &t->task);
}

static void free_task(struct token_task *t)
{
    room_task_finish(&t->task);
    free(t->text);
    free(t);
}

// ---- reading

static void list_is_read(struct rooms *rooms);

struct copying {
    struct file_task task; // first
    char *text, path[4096];
};

static int run_copy(struct file_task *task)
{
    const struct copying *c = (struct copying *)task;
    return tokens_write(c->path, c->text);
}

static void copied(struct file_task *task)
{
    struct copying *c = (struct copying *)task;
    if (task->status)
        log_line(LOG_WARN, "tokens: the copy %s cannot be written: %s", c->path,
                 strerror(task->status));
    free(c->text);
    free(c);
}

static void keep_copy(struct rooms *rooms, const char *text)
{
    struct copying *c = calloc(1, sizeof *c);
    if (!c || !(c->text = strdup(text))) {
        log_line(LOG_WARN, "tokens: the copy is left as it is: not enough memory");
        free(c);
        return;
    }
    access_path(rooms->server->access, c->path, sizeof c->path);
    c->task.run = run_copy;
    c->task.done = copied;
    file_queue_add(rooms->server->file_queue, &c->task);
}

static void take_list(struct rooms *rooms, const struct room_task *task)
{
    char fault[256];
    struct server *server = rooms->server;
    char *text = strndup((const char *)task->snapshot, task->n_snapshot);
    if (!text || access_replace(server->access, text, strlen(text), fault)) {
        log_line(LOG_ERR, "tokens in the database cannot be read: %s",
                 text ? fault : "not enough memory");
    } else {
        rooms->tokens_version = task->sequence;
        for (struct token_task *t = rooms->token_writes; t; t = t->next) t->apply(t->user);
        keep_copy(rooms, text);
        ledger_update_quotas(server->ledger);
        connections_recheck(server, false);
    }
    free(text);
}

static void list_read(struct room_task *task)
{
    struct token_task *t = (struct token_task *)task;
    struct rooms *rooms = t->rooms;
    rooms->reading_tokens = false;
    if (task->status == ROOM_TASK_DONE && task->sequence > rooms->tokens_version)
        take_list(rooms, task);
    free_task(t);
    if (rooms->tokens_again) tokens_changed(rooms);
    else list_is_read(rooms);
}

void tokens_changed(struct rooms *rooms)
{
    rooms->tokens_again = rooms->reading_tokens;
    bool none = rooms->reading_tokens || rooms->stopping; // the store may be closed then
    struct token_task *t = none ? NULL : new_task(rooms, ROOM_TASK_TEXT, list_read);
    if (!t) return;
    rooms->reading_tokens = true;
    submit(t);
}

// ---- writing

static void write_next(struct rooms *rooms);

static void end_write(struct token_task *t, int fault)
{
    struct rooms *rooms = t->rooms;
    rooms->token_writes = t->next;
    t->done(t->user, fault);
    free_task(t);
    write_next(rooms);
}

// The first change came second to another replica's, and the list may have that now.
static void list_is_read(struct rooms *rooms)
{
    struct token_task *t = rooms->token_writes;
    if (!t || t->under_way) return;
    if (rooms->tokens_version > t->task.sequence) write_next(rooms);
    else end_write(t, EIO);
}

static void list_written(struct room_task *task)
{
    struct token_task *t = (struct token_task *)task;
    struct rooms *rooms = t->rooms;
    t->under_way = false;
    if (task->status == ROOM_TASK_DONE) {
        rooms->tokens_version = task->sequence + 1;
        end_write(t, 0);
    } else if (task->status != ROOM_TASK_CONFLICT) {
        log_line(LOG_ERR, "tokens cannot be written to the database: %s", task->error);
        end_write(t, EIO);
    } else if (rooms->tokens_version > task->sequence) { // it was read meanwhile
        write_next(rooms);
    } else {
        tokens_changed(rooms);
        if (!rooms->reading_tokens) end_write(t, ENOMEM);
    }
}

static void write_next(struct rooms *rooms)
{
    struct token_task *t = rooms->token_writes;
    if (!t || t->under_way) return;
    free(t->text);
    t->text = rooms->stopping ? NULL : tokens_print(access_store(rooms->server->access));
    if (!t->text) {
        end_write(t, rooms->stopping ? ECANCELED : ENOMEM);
        return;
    }
    t->task.bytes = (const uint8_t *)t->text;
    t->task.n = strlen(t->text);
    t->task.sequence = rooms->tokens_version;
    t->under_way = true;
    submit(t);
}

static void write_list(struct server *server, void (*apply)(void *user),
                       void (*done)(void *user, int fault), void *user)
{
    struct rooms *rooms = server->rooms;
    struct token_task *t = new_task(rooms, ROOM_TASK_SET_TEXT, list_written), **last;
    if (!t) {
        done(user, ENOMEM);
        return;
    }
    t->apply = apply;
    t->done = done;
    t->user = user;
    for (last = &rooms->token_writes; *last; last = &(*last)->next) continue;
    *last = t;
    if (rooms->token_writes == t) write_next(rooms);
}

// ---- the start

struct at_start {
    struct room_task task; // first
    bool over;
};

static void over(struct room_task *task)
{
    ((struct at_start *)task)->over = true;
}

static void wait_for(struct rooms *rooms, struct at_start *s)
{
    s->task.path = list_name;
    s->task.done = over;
    rooms->store->api->submit(rooms->store, &s->task);
    while (!s->over) loop_turn(rooms->server->loop, -1);
}

// A list that only this replica has, from before, becomes everybody's.
static int import_list(struct rooms *rooms)
{
    struct token_store *store = access_store(rooms->server->access);
    char *text = store->n ? tokens_print(store) : NULL;
    if (!text) return 0;
    struct at_start s = {.task = {.kind = ROOM_TASK_SET_TEXT,
                                  .bytes = (const uint8_t *)text,
                                  .n = strlen(text)}};
    wait_for(rooms, &s);
    free(text);
    if (s.task.status == ROOM_TASK_DONE) rooms->tokens_version = 1;
    return s.task.status == ROOM_TASK_FAILED ? -1 : 0;
}

int tokens_share(struct rooms *rooms)
{
    struct at_start s = {.task = {.kind = ROOM_TASK_TEXT}};
    if (rooms->store->api != &room_store_postgres) return 0;
    wait_for(rooms, &s);
    int failed = s.task.status == ROOM_TASK_FAILED ? -1 : 0;
    if (s.task.status == ROOM_TASK_DONE) take_list(rooms, &s.task);
    else if (!failed) failed = import_list(rooms);
    room_task_finish(&s.task);
    rooms->server->write_tokens = write_list;
    return failed;
}
