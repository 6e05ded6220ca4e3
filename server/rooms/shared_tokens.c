// SPDX-License-Identifier: MIT
// The list of tokens in the database of rooms: a change is written there before it is answered,
// and every replica reads it when it is told of one. DATA/tokens.json is a copy, by which a
// start without the database knows that tokens exist.
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
    char *text; // of a write
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

static void keep_copy(struct rooms *rooms, const char *text)
{
    char path[4096];
    access_path(rooms->server->access, path, sizeof path);
    file_write(rooms->server->file_queue, path, strdup(text));
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
}

void tokens_changed(struct rooms *rooms)
{
    rooms->tokens_again = rooms->reading_tokens;
    struct token_task *t =
        rooms->reading_tokens ? NULL : new_task(rooms, ROOM_TASK_TEXT, list_read);
    if (!t) return;
    rooms->reading_tokens = true;
    submit(t);
}

// ---- writing

static void list_written(struct room_task *task)
{
    struct token_task *t = (struct token_task *)task;
    int fault = task->status == ROOM_TASK_DONE ? 0 : EIO;
    if (task->status == ROOM_TASK_CONFLICT) {
        fault = EAGAIN;
        tokens_changed(t->rooms);
    } else if (fault) {
        log_line(LOG_ERR, "tokens cannot be written to the database: %s", task->error);
    } else {
        t->rooms->tokens_version++;
    }
    t->done(t->user, fault);
    free_task(t);
}

static void write_list(struct server *server, const char *text,
                       void (*done)(void *user, int fault), void *user)
{
    struct token_task *t = new_task(server->rooms, ROOM_TASK_SET_TEXT, list_written);
    if (!t || !(t->text = strdup(text))) {
        free(t);
        done(user, ENOMEM);
        return;
    }
    t->task.bytes = (const uint8_t *)t->text;
    t->task.n = strlen(text);
    t->done = done;
    t->user = user;
    submit(t);
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
