// SPDX-License-Identifier: MIT
// The queue of file operations: one piece of work at a time in the pool, the others wait.
#include "store/file_queue.h"

#include "core/log.h"

#include <dirent.h>
#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stddef.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

struct file_queue {
    struct work work; // first
    struct work_pool *pool;
    struct file_task *first, **last;
    bool running;
};

static void run_next(struct file_queue *queue)
{
    if (queue->running || !queue->first) return;
    queue->running = true;
    // The daemon's own work: who queued the first operation must not hold up the others'.
    struct work_actor before = work_act_for(queue->pool, "", WORK_INTERACTIVE);
    work_submit(queue->pool, &queue->work);
    work_act(queue->pool, before);
}

static int run_task(struct work *work, const struct prt_context *ctx)
{
    struct file_task *task = ((struct file_queue *)work)->first;
    task->status = task->run(task);
    return PRT_OK;
}

static void task_done(struct work *work)
{
    struct file_queue *queue = (struct file_queue *)work;
    struct file_task *task = queue->first;
    queue->first = task->next;
    if (!queue->first) queue->last = &queue->first;
    queue->running = false;
    run_next(queue);
    task->done(task);
}

int file_queue_create(struct work_pool *pool, struct file_queue **out)
{
    struct file_queue *queue = calloc(1, sizeof *queue);
    if (!queue) return PRT_NOMEM;
    queue->pool = pool;
    queue->last = &queue->first;
    queue->work.run = run_task;
    queue->work.done = task_done;
    queue->work.class = WORK_INTERACTIVE;
    *out = queue;
    return PRT_OK;
}

void file_queue_destroy(struct file_queue *queue)
{
    free(queue);
}

void file_queue_add(struct file_queue *queue, struct file_task *task)
{
    task->next = NULL;
    *queue->last = task;
    queue->last = &task->next;
    run_next(queue);
}

// ---- plain operations

struct plain {
    struct file_task task; // first
    char *text;
    char path[];
};

static void plain_done(struct file_task *task)
{
    struct plain *p = (struct plain *)task;
    if (task->status) log_line(LOG_WARN, "file %s cannot be written", p->path);
    free(p->text);
    free(p);
}

static void add_plain(struct file_queue *queue, const char *path, char *text,
                      int (*run)(struct file_task *task))
{
    size_t n = strlen(path) + 1;
    struct plain *p = calloc(1, sizeof *p + n);
    if (!p) {
        log_line(LOG_WARN, "file %s is left as it is: not enough memory", path);
        free(text);
        return;
    }
    p->text = text;
    memcpy(p->path, path, n);
    p->task.run = run;
    p->task.done = plain_done;
    file_queue_add(queue, &p->task);
}

void remove_tree(const char *path)
{
    if (!unlink(path) || errno != EISDIR) return;
    DIR *dir = opendir(path);
    for (struct dirent *d; dir && (d = readdir(dir));) {
        char inner[PATH_MAX];
        if (!strcmp(d->d_name, ".") || !strcmp(d->d_name, "..")) continue;
        if (snprintf(inner, sizeof inner, "%s/%s", path, d->d_name) < PATH_MAX)
            remove_tree(inner);
    }
    if (dir) closedir(dir);
    rmdir(path);
}

static int run_remove(struct file_task *task)
{
    remove_tree(((struct plain *)task)->path);
    return PRT_OK;
}

static int run_write(struct file_task *task)
{
    const struct plain *p = (struct plain *)task;
    return prt_write_file(NULL, p->path, p->text, strlen(p->text));
}

static int run_touch(struct file_task *task)
{
    utimensat(AT_FDCWD, ((struct plain *)task)->path, NULL,
              0); // fails on a read-only file system, without effect
    return PRT_OK;
}

void file_remove(struct file_queue *queue, const char *path)
{
    if (path[0]) add_plain(queue, path, NULL, run_remove);
}

void file_write(struct file_queue *queue, const char *path, char *text)
{
    if (text) add_plain(queue, path, text, run_write);
}

void file_touch(struct file_queue *queue, const char *path)
{
    add_plain(queue, path, NULL, run_touch);
}
