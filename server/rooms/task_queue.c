// SPDX-License-Identifier: MIT
// Tasks between the loop and a store's thread.
#include "rooms/task_queue.h"

void task_queue_init(struct task_queue *queue)
{
    pthread_mutex_init(&queue->lock, NULL);
    pthread_cond_init(&queue->changed, NULL);
    queue->first = NULL;
    queue->last = &queue->first;
    queue->closing = false;
}

void task_queue_finish(struct task_queue *queue)
{
    pthread_mutex_destroy(&queue->lock);
    pthread_cond_destroy(&queue->changed);
}

static void call_done(struct loop_message *message)
{
    struct room_task *task =
        (struct room_task *)((char *)message - offsetof(struct room_task, message));
    task->done(task);
}

void task_queue_add(struct task_queue *queue, struct room_task *task)
{
    task->message.handle = call_done;
    task->next = NULL;
    task->status = ROOM_TASK_DONE;
    task->error[0] = 0;
    pthread_mutex_lock(&queue->lock);
    *queue->last = task;
    queue->last = &task->next;
    pthread_cond_signal(&queue->changed);
    pthread_mutex_unlock(&queue->lock);
}

struct room_task *task_queue_take_all(struct task_queue *queue)
{
    pthread_mutex_lock(&queue->lock);
    while (!queue->first && !queue->closing) pthread_cond_wait(&queue->changed, &queue->lock);
    struct room_task *all = queue->first;
    queue->first = NULL;
    queue->last = &queue->first;
    pthread_mutex_unlock(&queue->lock);
    return all;
}

size_t task_queue_next(struct room_task **tasks, struct room_task **batch, size_t most)
{
    size_t n = 0;
    for (struct room_task *t; (t = *tasks) && n < most; *tasks = t->next) {
        if (t->kind != ROOM_TASK_APPEND && n) break;
        batch[n++] = t;
        if (t->kind != ROOM_TASK_APPEND) {
            *tasks = t->next;
            break;
        }
    }
    return n;
}

void task_queue_close(struct task_queue *queue)
{
    pthread_mutex_lock(&queue->lock);
    queue->closing = true;
    pthread_cond_signal(&queue->changed);
    pthread_mutex_unlock(&queue->lock);
}
