/* SPDX-License-Identifier: MIT */
/* file_queue.h owns file operations that may block: links, removals, writes with fsync. They
 * run on a worker thread one after another in the order they came, so that each finds the
 * folders as those before it left them.
 * Thread-safety: loop thread only, except where stated. */
#ifndef RELIGHTD_FILE_QUEUE_H
#define RELIGHTD_FILE_QUEUE_H

#include "core/work.h"

struct file_queue;

/* One operation, embedded in its owner, which keeps it until `done`. */
struct file_task {
    struct file_task *next;
    int status;                           /* returned by run */
    int (*run)(struct file_task *task);   /* on a worker */
    void (*done)(struct file_task *task); /* on the loop's thread afterwards */
};

int file_queue_create(struct work_pool *pool, struct file_queue **out);
/* Nothing may be under way. */
void file_queue_destroy(struct file_queue *queue);
void file_queue_add(struct file_queue *queue, struct file_task *task);

/* Removes a file, or a folder with all that is in it. A path that is not there is fine. */
void file_remove(struct file_queue *queue, const char *path);
/* Replaces a file by this text, which is taken (malloc). A failure is logged. */
void file_write(struct file_queue *queue, const char *path, char *text);
/* Marks a file as used now. */
void file_touch(struct file_queue *queue, const char *path);

/* The same as file_remove, at once. Any thread. */
void remove_tree(const char *path);

#endif
