/* SPDX-License-Identifier: MIT */
/* task_queue.h owns the tasks that wait for a store's thread.
 * Thread-safety: the loop's thread adds, one thread of the store takes. */
#ifndef RELIGHTD_ROOMS_TASK_QUEUE_H
#define RELIGHTD_ROOMS_TASK_QUEUE_H

#include "rooms/store.h"

#include <pthread.h>

struct task_queue {
    pthread_mutex_t lock;
    pthread_cond_t changed;
    struct room_task *first, **last;
    bool closing;
};
void task_queue_init(struct task_queue *queue);
void task_queue_finish(struct task_queue *queue);

/* Sets what a submitted task begins with: its status, an empty error, and that `done` is called
 * when its message arrives. */
void task_queue_add(struct task_queue *queue, struct room_task *task);
/* All tasks that wait, in their order, linked by `next`; blocks until there is one. NULL: the
 * queue was closed and is empty. */
struct room_task *task_queue_take_all(struct task_queue *queue);
/* Splits appends off the front of *tasks, at most `most`, else one task of another kind. Their
 * number; 0: there is none. */
size_t task_queue_next(struct room_task **tasks, struct room_task **batch, size_t most);
/* task_queue_take_all returns NULL once the queue is empty. */
void task_queue_close(struct task_queue *queue);

#endif
