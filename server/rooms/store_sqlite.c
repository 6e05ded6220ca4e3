// SPDX-License-Identifier: MIT
// The embedded store: one SQLite database, one thread. Events that wait at the same time are
// committed together: one synchronisation of the disk pays for all of them.
#include "rooms/store_sqlite.h"

#include "rooms/sqlite_schema.h"

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
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct room_task *first, **last;
    bool closing;
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

static struct room_task *take_all(struct sqlite_store *s)
{
    pthread_mutex_lock(&s->lock);
    while (!s->first && !s->closing) pthread_cond_wait(&s->changed, &s->lock);
    struct room_task *all = s->first;
    s->first = NULL;
    s->last = &s->first;
    pthread_mutex_unlock(&s->lock);
    return all;
}

static void *run(void *user)
{
    struct sqlite_store *s = user;
    struct room_task *batch[MOST_TOGETHER];
    for (struct room_task *all; (all = take_all(s));) {
        while (all) {
            size_t n = 0;
            for (; all && n < MOST_TOGETHER && all->kind == ROOM_TASK_APPEND; all = all->next)
                batch[n++] = all;
            if (n) {
                commit_appends(s, batch, n);
                continue;
            }
            struct room_task *task = all;
            all = all->next;
            sqlite_run(&s->db, task);
            loop_post(s->loop, &task->message);
        }
    }
    return NULL;
}

static void handle(struct loop_message *message)
{
    struct room_task *task =
        (struct room_task *)((char *)message - offsetof(struct room_task, message));
    task->done(task);
}

// ---- the interface

static void submit(struct room_store *store, struct room_task *task)
{
    struct sqlite_store *s = (struct sqlite_store *)store;
    task->message.handle = handle;
    task->next = NULL;
    task->status = ROOM_TASK_DONE;
    task->error[0] = 0;
    pthread_mutex_lock(&s->lock);
    *s->last = task;
    s->last = &task->next;
    pthread_cond_signal(&s->changed);
    pthread_mutex_unlock(&s->lock);
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
    s->last = &s->first;
    pthread_mutex_init(&s->lock, NULL);
    pthread_cond_init(&s->changed, NULL);
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
    pthread_mutex_lock(&s->lock);
    s->closing = true;
    pthread_cond_signal(&s->changed);
    pthread_mutex_unlock(&s->lock);
    pthread_join(s->thread, NULL);
    sqlite_close(&s->db);
    pthread_mutex_destroy(&s->lock);
    pthread_cond_destroy(&s->changed);
    free(s);
}

const struct room_store_api room_store_sqlite = {open_store, submit, close_store};
