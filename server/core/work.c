// SPDX-License-Identifier: MIT
// Worker threads with two classes of work: interactive work always runs before
// background work, which never occupies every thread.
#include "core/work.h"

#include "core/log.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct work_pool {
    struct loop *loop;
    struct prt_pool *cores;
    unsigned cpu;
    pthread_mutex_t lock;
    pthread_cond_t more;
    struct work *first[WORK_N_CLASS], **last[WORK_N_CLASS];
    size_t n_waiting;
    size_t n_open;                   // loop thread only
    unsigned n_thread, n_background; // running background work
    bool stopping;
    pthread_t thread[];
};

void work_keep_error(void *user, enum prt_log_level level, const char *line)
{
    struct work *work = user;
    if (level == PRT_LOG_ERROR) {
        if (!work->error[0]) snprintf(work->error, sizeof work->error, "%s", line);
    } else {
        log_line(level == PRT_LOG_WARNING ? LOG_WARN : LOG_TRACE, "library %s", line);
    }
}

static struct work *take(struct work_pool *pool)
{
    for (int c = 0; c < WORK_N_CLASS; c++) {
        struct work *work = pool->first[c];
        if (!work) continue;
        if (c == WORK_BACKGROUND && pool->n_thread > 1 &&
            pool->n_background + 1 >= pool->n_thread)
            continue;
        pool->first[c] = work->next;
        if (!work->next) pool->last[c] = &pool->first[c];
        pool->n_waiting--;
        return work;
    }
    return NULL;
}

static void *worker(void *arg)
{
    struct work_pool *pool = arg;
    pthread_mutex_lock(&pool->lock);
    while (!pool->stopping) {
        struct work *work = take(pool);
        if (!work) {
            pthread_cond_wait(&pool->more, &pool->lock);
            continue;
        }
        bool background = work->class == WORK_BACKGROUND;
        pool->n_background += background;
        pthread_mutex_unlock(&pool->lock);
        struct prt_context ctx;
        prt_context_init(&ctx);
        ctx.log = work_keep_error;
        ctx.log_user = work;
        ctx.pool = pool->cores;
        ctx.cpu = pool->cpu;
        work->error[0] = 0;
        work->started_ns = loop_now_ns();
        work->status = work->run(work, &ctx);
        work->ended_ns = loop_now_ns();
        if (work->status && !work->error[0])
            snprintf(work->error, sizeof work->error, "%s", prt_status_text(work->status));
        loop_post(pool->loop, &work->message);
        pthread_mutex_lock(&pool->lock);
        pool->n_background -= background;
    }
    pthread_mutex_unlock(&pool->lock);
    return NULL;
}

int work_pool_create(struct loop *loop, unsigned n_thread, unsigned cpu, struct work_pool **out)
{
    struct work_pool *pool = calloc(1, sizeof *pool + n_thread * sizeof *pool->thread);
    if (!pool) return PRT_NOMEM;
    *pool = (struct work_pool){.loop = loop, .cpu = cpu};
    for (int c = 0; c < WORK_N_CLASS; c++) pool->last[c] = &pool->first[c];
    pthread_mutex_init(&pool->lock, NULL);
    pthread_cond_init(&pool->more, NULL);
    int status = prt_pool_create(n_thread, &pool->cores);
    if (status) {
        free(pool);
        return status;
    }
    pthread_mutex_lock(&pool->lock);
    for (; pool->n_thread < n_thread; pool->n_thread++)
        if (pthread_create(&pool->thread[pool->n_thread], NULL, worker, pool)) break;
    pthread_mutex_unlock(&pool->lock);
    if (!pool->n_thread) {
        work_pool_destroy(pool);
        return PRT_NOMEM;
    }
    *out = pool;
    return PRT_OK;
}

void work_pool_destroy(struct work_pool *pool)
{
    if (!pool) return;
    pthread_mutex_lock(&pool->lock);
    pool->stopping = true;
    pthread_cond_broadcast(&pool->more);
    pthread_mutex_unlock(&pool->lock);
    for (unsigned i = 0; i < pool->n_thread; i++) pthread_join(pool->thread[i], NULL);
    prt_pool_destroy(pool->cores);
    pthread_mutex_destroy(&pool->lock);
    pthread_cond_destroy(&pool->more);
    free(pool);
}

static void handle_done(struct loop_message *message)
{
    struct work *work = (struct work *)((char *)message - offsetof(struct work, message));
    work->pool->n_open--;
    work->done(work);
}

void work_submit(struct work_pool *pool, struct work *work)
{
    work->message.handle = handle_done;
    work->submitted_ns = loop_now_ns();
    work->next = NULL;
    work->pool = pool;
    pool->n_open++;
    pthread_mutex_lock(&pool->lock);
    *pool->last[work->class] = work;
    pool->last[work->class] = &work->next;
    pool->n_waiting++;
    pthread_cond_signal(&pool->more);
    pthread_mutex_unlock(&pool->lock);
}

size_t work_waiting(struct work_pool *pool)
{
    pthread_mutex_lock(&pool->lock);
    size_t n = pool->n_waiting;
    pthread_mutex_unlock(&pool->lock);
    return n;
}

bool work_busy(const struct work_pool *pool)
{
    return pool->n_open > 0;
}
