// SPDX-License-Identifier: MIT
// Worker threads that take the next work of the fair queue, measure what it costs on this and
// on helping threads, and charge that.
#include "core/work.h"

#include "core/log.h"

#include <pthread.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/resource.h>
#include <time.h>
#include <unistd.h>

struct work_pool {
    struct loop *loop;
    struct prt_pool *cores;
    unsigned cpu;
    pthread_mutex_t lock;
    pthread_cond_t more, more_aside;
    struct fair_queue queue;
    uint64_t all_ns, n_withdrawn;
    struct work_actor actor;         // loop thread only
    size_t n_open;                   // loop thread only
    unsigned n_thread, n_background; // running background work
    bool stopping, has_aside;
    pthread_t aside; // runs WORK_ASIDE
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

static struct work *take(struct work_pool *pool, bool aside)
{
    bool full = pool->n_thread > 1 && pool->n_background + 1 >= pool->n_thread;
    struct fair_item *item =
        aside ? fair_pop_aside(&pool->queue) : fair_pop(&pool->queue, full);
    return item ? (struct work *)((char *)item - offsetof(struct work, item)) : NULL;
}

static uint64_t thread_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

static int poll_unwanted(void *user, const char *stage, double fraction, double eta_s)
{
    return __atomic_load_n(&((struct work *)user)->unwanted, __ATOMIC_RELAXED);
}

// Returns the thread-nanoseconds that it took, of other threads, too.
static uint64_t run(struct work_pool *pool, struct work *work)
{
    struct prt_context ctx;
    uint64_t helpers_ns = 0, start = thread_ns();
    prt_context_init(&ctx);
    ctx.log = work_keep_error;
    ctx.log_user = work;
    ctx.progress = poll_unwanted;
    ctx.progress_user = work;
    ctx.pool = work->item.class == WORK_ASIDE ? NULL : pool->cores;
    ctx.helpers_ns = &helpers_ns;
    ctx.cpu = pool->cpu;
    work->error[0] = 0;
    work->started_ns = loop_now_ns();
    work->status = work->run(work, &ctx);
    work->ended_ns = loop_now_ns();
    if (work->status && !work->error[0])
        snprintf(work->error, sizeof work->error, "%s", prt_status_text(work->status));
    return thread_ns() - start + __atomic_load_n(&helpers_ns, __ATOMIC_RELAXED);
}

static void charge(struct work_pool *pool, struct work *work, uint64_t cost_ns)
{
    struct fair_flow *share[WORK_MAX_SHARE];
    unsigned n = 0;
    for (unsigned i = 0; work->share && i < work->n_share && i < WORK_MAX_SHARE; i++)
        if ((share[n] = fair_flow(&pool->queue, work->share[i]))) n++;
    fair_ended(&pool->queue, &work->item, cost_ns, n ? share : NULL, n);
}

static void serve(struct work_pool *pool, bool aside)
{
    pthread_mutex_lock(&pool->lock);
    while (!pool->stopping) {
        struct work *work = take(pool, aside);
        if (!work) {
            pthread_cond_wait(aside ? &pool->more_aside : &pool->more, &pool->lock);
            continue;
        }
        bool background = work->item.class == WORK_BACKGROUND;
        pool->n_background += background;
        pthread_mutex_unlock(&pool->lock);
        uint64_t cost_ns = run(pool, work);
        pthread_mutex_lock(&pool->lock);
        pool->n_background -= background;
        pool->all_ns += cost_ns;
        charge(pool, work, cost_ns);
        if (background && pool->queue.n_waiting) pthread_cond_signal(&pool->more);
        loop_post(pool->loop, &work->message); // the work is its owner's from here on
    }
    pthread_mutex_unlock(&pool->lock);
}

static void *worker(void *arg)
{
    serve(arg, false);
    return NULL;
}

// Where the workers keep every core busy, this priority still gets about a tenth of one.
static void *aside(void *arg)
{
    enum { ASIDE_NICE = 10, MOST_NICE = 19 };
    int nice = getpriority(PRIO_PROCESS, 0) + ASIDE_NICE;
    setpriority(PRIO_PROCESS, (id_t)gettid(), nice < MOST_NICE ? nice : MOST_NICE);
    serve(arg, true);
    return NULL;
}

int work_pool_create(struct loop *loop, unsigned n_thread, unsigned cpu, struct work_pool **out)
{
    struct work_pool *pool = calloc(1, sizeof *pool + n_thread * sizeof *pool->thread);
    if (!pool) return PRT_NOMEM;
    *pool = (struct work_pool){.loop = loop, .cpu = cpu};
    pthread_mutex_init(&pool->lock, NULL);
    pthread_cond_init(&pool->more, NULL);
    pthread_cond_init(&pool->more_aside, NULL);
    int status = prt_pool_create(n_thread, &pool->cores);
    if (status) {
        free(pool);
        return status;
    }
    pthread_mutex_lock(&pool->lock);
    for (; pool->n_thread < n_thread; pool->n_thread++)
        if (pthread_create(&pool->thread[pool->n_thread], NULL, worker, pool)) break;
    pthread_mutex_unlock(&pool->lock);
    pool->has_aside = !pthread_create(&pool->aside, NULL, aside, pool);
    if (!pool->n_thread || !pool->has_aside) {
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
    pthread_cond_broadcast(&pool->more_aside);
    pthread_mutex_unlock(&pool->lock);
    if (pool->has_aside) pthread_join(pool->aside, NULL);
    for (unsigned i = 0; i < pool->n_thread; i++) pthread_join(pool->thread[i], NULL);
    prt_pool_destroy(pool->cores);
    fair_finish(&pool->queue);
    pthread_mutex_destroy(&pool->lock);
    pthread_cond_destroy(&pool->more);
    pthread_cond_destroy(&pool->more_aside);
    free(pool);
}

static void handle_done(struct loop_message *message)
{
    struct work *work = (struct work *)((char *)message - offsetof(struct work, message));
    work->pool->n_open--;
    work->done(work);
}

struct work_actor work_actor(const struct work_pool *pool)
{
    return pool->actor;
}

struct work_actor work_act(struct work_pool *pool, struct work_actor actor)
{
    struct work_actor before = pool->actor;
    pool->actor = actor;
    return before;
}

struct work_actor work_act_for(struct work_pool *pool, const char *name, enum work_class class)
{
    struct work_actor actor = {.class = class};
    snprintf(actor.name, sizeof actor.name, "%s", name);
    return work_act(pool, actor);
}

void work_submit(struct work_pool *pool, struct work *work)
{
    const struct work_actor *actor = &pool->actor;
    work->message.handle = handle_done;
    work->submitted_ns = loop_now_ns();
    work->pool = pool;
    work->unwanted = 0;
    work->item.class =
        actor->name[0] && actor->class > work->class ? actor->class : work->class;
    work->item.begun_ns = actor->begun_ns ? actor->begun_ns : work->submitted_ns;
    pool->n_open++;
    pthread_mutex_lock(&pool->lock);
    struct fair_flow *flow = fair_flow(&pool->queue, actor->name);
    if (!flow) flow = fair_flow(&pool->queue, "");
    if (!flow) abort(); // the process is out of memory at its start
    fair_push(&pool->queue, flow, &work->item);
    pthread_cond_signal(work->item.class == WORK_ASIDE ? &pool->more_aside : &pool->more);
    pthread_mutex_unlock(&pool->lock);
}

static bool dequeue(struct work *work, bool withdrawn)
{
    struct work_pool *pool = work->pool;
    if (!pool) return false;
    pthread_mutex_lock(&pool->lock);
    bool waited = fair_remove(&pool->queue, &work->item);
    pool->n_withdrawn += waited && withdrawn;
    pthread_mutex_unlock(&pool->lock);
    if (waited) pool->n_open--;
    return waited;
}

bool work_dequeue(struct work *work)
{
    return dequeue(work, true);
}

bool work_take_back(struct work *work)
{
    return dequeue(work, false);
}

bool work_withdraw(struct work *work)
{
    bool waited = work_dequeue(work);
    if (!waited) __atomic_store_n(&work->unwanted, 1, __ATOMIC_RELAXED);
    return waited;
}

size_t work_waiting(struct work_pool *pool)
{
    pthread_mutex_lock(&pool->lock);
    size_t n = pool->queue.n_waiting;
    pthread_mutex_unlock(&pool->lock);
    return n;
}

void work_count(struct work_pool *pool, const char *name, struct work_counts *out)
{
    pthread_mutex_lock(&pool->lock);
    const struct fair_flow *f = pool->queue.flow;
    while (f && strcmp(f->name, name)) f = f->next;
    *out = (struct work_counts){pool->all_ns, f ? f->used_ns : 0, pool->n_withdrawn};
    pthread_mutex_unlock(&pool->lock);
}

bool work_busy(const struct work_pool *pool)
{
    return pool->n_open > 0;
}
