// SPDX-License-Identifier: MIT
// The embedded store: one SQLite database, one thread. Events that wait at the same time are
// committed together: one synchronisation of the disk pays for all of them.
#include "rooms/store_sqlite.h"

#include "rooms/sqlite_schema.h"
#include "rooms/task_queue.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_TOGETHER = 1000 }; // appends in one transaction

struct sqlite_store {
    struct room_store store; // first
    struct sqlite_db db;
    struct loop *loop;
    pthread_t thread;
    struct task_queue queue;
};

// ---- the thread

static void commit_appends(struct sqlite_store *s, struct room_task *const *task, size_t n)
{
    int fault = sqlite_begin(&s->db);
    for (size_t i = 0; i < n && !fault; i++) fault = sqlite_append(&s->db, task[i]);
    fault = sqlite_end(&s->db, fault);
    for (size_t i = 0; i < n; i++) {
        // A conflict is the task's own affair; anything else took all with it.
        if (fault) {
            task[i]->status = ROOM_TASK_FAILED;
            snprintf(task[i]->error, sizeof task[i]->error, "%s", s->db.error);
        }
        loop_post(s->loop, &task[i]->message);
    }
}

static void *run(void *user)
{
    struct sqlite_store *s = user;
    struct room_task *batch[MOST_TOGETHER];
    for (struct room_task *all; (all = task_queue_take_all(&s->queue));)
        for (size_t n; (n = task_queue_next(&all, batch, MOST_TOGETHER));) {
            if (batch[0]->kind == ROOM_TASK_APPEND) {
                commit_appends(s, batch, n);
                continue;
            }
            sqlite_run(&s->db, batch[0]);
            loop_post(s->loop, &batch[0]->message);
        }
    return NULL;
}

// ---- the interface

static void submit(struct room_store *store, struct room_task *task)
{
    task_queue_add(&((struct sqlite_store *)store)->queue, task);
}

static int open_store(const char *where, struct loop *loop, struct room_store **out,
                      char error[256])
{
    struct sqlite_store *s = calloc(1, sizeof *s);
    if (!s) {
        snprintf(error, 256, "not enough memory");
        return -1;
    }
    s->store.api = &room_store_sqlite;
    s->loop = loop;
    task_queue_init(&s->queue);
    if (sqlite_open(&s->db, where, error)) {
        free(s);
        return -1;
    }
    if (pthread_create(&s->thread, NULL, run, s)) {
        snprintf(error, 256, "no thread could be started");
        sqlite_close(&s->db);
        free(s);
        return -1;
    }
    *out = &s->store;
    return 0;
}

static void close_store(struct room_store *store)
{
    struct sqlite_store *s = (struct sqlite_store *)store;
    task_queue_close(&s->queue);
    pthread_join(s->thread, NULL);
    sqlite_close(&s->db);
    task_queue_finish(&s->queue);
    free(s);
}

const struct room_store_api room_store_sqlite = {open_store, submit, close_store};
