// SPDX-License-Identifier: MIT
// The kinds of stores, and memory of tasks.
#include "rooms/store.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void room_task_finish(struct room_task *task)
{
    for (size_t i = 0; i < task->n_event; i++) free(task->event[i].bytes);
    for (size_t i = 0; i < task->n_row; i++) free(task->row[i].keeps);
    free(task->event);
    free(task->snapshot);
    free(task->row);
    task->event = NULL;
    task->snapshot = NULL;
    task->row = NULL;
    task->n_event = task->n_snapshot = task->n_row = 0;
}

const struct room_store_api *room_store_parse(const char *option, const char **where,
                                              char error[256])
{
    static const char sqlite[] = "sqlite:";
    if (!strncmp(option, sqlite, sizeof sqlite - 1) && option[sizeof sqlite - 1]) {
        *where = option + sizeof sqlite - 1;
        return &room_store_sqlite;
    }
    if (!strncmp(option, "postgresql://", 13) || !strncmp(option, "postgres://", 11)) {
        *where = option;
        return &room_store_postgres;
    }
    snprintf(error, 256,
             "--rooms %.100s: expected sqlite:FILE or postgresql://[USER@]HOST/DATABASE",
             option);
    return NULL;
}
