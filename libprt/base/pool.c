// SPDX-License-Identifier: MIT
// A pool of threads that share loops. An atomic counter hands out the pieces of a loop. The
// caller works on its own loop; idle workers join any open loop while fewer threads than the
// pool has are at work: callers of several loops take the cores themselves.
#include "base/sandbox.h"
#include "prt/base.h"

#include <pthread.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <time.h>
#include <unistd.h>

struct loop {
    struct loop *next;
    size_t n, grain, n_piece;
    atomic_size_t piece; // the next one to hand out
    atomic_size_t done;  // pieces finished or skipped
    atomic_int status;
    unsigned helpers; // workers that run its pieces; guarded by the pool's lock
    prt_loop_fn fn;
    void *arg;
    uint64_t *helpers_ns; // or NULL
};

struct prt_pool {
    pthread_mutex_t lock;
    pthread_cond_t work, idle;
    struct loop *open;
    unsigned n_thread;  // workers + the caller
    unsigned n_started; // of the workers
    unsigned n_busy;    // callers and workers in loops; a caller that waits for a worker is not
    bool stopping;
    pthread_t *thread;
};

// Loops that the thread is in: of those within each other the first counts as busy.
static _Thread_local unsigned depth;

struct worker {
    struct prt_pool *pool;
    unsigned index;
};

static void run_piece(struct loop *loop, size_t piece, unsigned worker)
{
    if (atomic_load_explicit(&loop->status, memory_order_relaxed) == PRT_OK) {
        size_t begin = piece * loop->grain, end = begin + loop->grain;
        int status = loop->fn(loop->arg, begin, end < loop->n ? end : loop->n, worker);
        int ok = PRT_OK;
        if (status) atomic_compare_exchange_strong(&loop->status, &ok, status);
    }
    atomic_fetch_add(&loop->done, 1);
}

static uint64_t thread_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_THREAD_CPUTIME_ID, &t);
    return (uint64_t)t.tv_sec * 1000000000 + (uint64_t)t.tv_nsec;
}

static void help(struct loop *loop, unsigned worker)
{
    uint64_t start = loop->helpers_ns ? thread_ns() : 0;
    size_t piece;
    while ((piece = atomic_fetch_add(&loop->piece, 1)) < loop->n_piece)
        run_piece(loop, piece, worker);
    if (loop->helpers_ns)
        __atomic_fetch_add(loop->helpers_ns, thread_ns() - start, __ATOMIC_RELAXED);
}

static void *worker_main(void *arg)
{
    struct worker self = *(struct worker *)arg;
    struct prt_pool *pool = self.pool;
    free(arg);
    pthread_mutex_lock(&pool->lock);
    pool->n_started++;
    pthread_cond_broadcast(&pool->idle);
    for (;;) {
        struct loop *loop = pool->open;
        while (loop && atomic_load(&loop->piece) >= loop->n_piece) loop = loop->next;
        if (!loop || pool->n_busy >= pool->n_thread) {
            if (pool->stopping) break;
            pthread_cond_wait(&pool->work, &pool->lock);
            continue;
        }
        loop->helpers++;
        pool->n_busy++;
        pthread_mutex_unlock(&pool->lock);
        depth++;
        help(loop, self.index);
        depth--;
        pthread_mutex_lock(&pool->lock);
        pool->n_busy--;
        loop->helpers--;
        pthread_cond_broadcast(&pool->idle);
    }
    pthread_mutex_unlock(&pool->lock);
    return NULL;
}

// A thread that starts allocates. A child of fork() (isolate.c) inherits the locks that threads
// hold at that moment: libc takes its own before, AddressSanitizer's allocator does not, and
// the child would wait for one forever.
static void wait_for_workers(struct prt_pool *pool)
{
    pthread_mutex_lock(&pool->lock);
    while (pool->n_started + 1 < pool->n_thread) pthread_cond_wait(&pool->idle, &pool->lock);
    pthread_mutex_unlock(&pool->lock);
}

int prt_pool_create(unsigned n_thread, struct prt_pool **out)
{
    if (!n_thread) {
        long cores = sysconf(_SC_NPROCESSORS_ONLN);
        n_thread = cores > 0 ? (unsigned)cores : 1;
    }
    struct prt_pool *pool = calloc(1, sizeof *pool);
    if (!pool) return PRT_NOMEM;
    pool->thread = calloc(n_thread, sizeof *pool->thread);
    if (!pool->thread) {
        free(pool);
        return PRT_NOMEM;
    }
    pthread_mutex_init(&pool->lock, NULL);
    pthread_cond_init(&pool->work, NULL);
    pthread_cond_init(&pool->idle, NULL);
    pool->n_thread = 1;
    for (unsigned i = 1; i < n_thread; i++) {
        struct worker *w = malloc(sizeof *w);
        if (!w) break;
        *w = (struct worker){pool, i};
        if (pthread_create(&pool->thread[i], NULL, worker_main, w)) {
            free(w);
            break;
        }
        pool->n_thread++;
    }
    if (SANITIZED) wait_for_workers(pool);
    *out = pool;
    return PRT_OK;
}

void prt_pool_destroy(struct prt_pool *pool)
{
    if (!pool) return;
    pthread_mutex_lock(&pool->lock);
    pool->stopping = true;
    pthread_cond_broadcast(&pool->work);
    pthread_mutex_unlock(&pool->lock);
    for (unsigned i = 1; i < pool->n_thread; i++) pthread_join(pool->thread[i], NULL);
    pthread_mutex_destroy(&pool->lock);
    pthread_cond_destroy(&pool->work);
    pthread_cond_destroy(&pool->idle);
    free(pool->thread);
    free(pool);
}

unsigned prt_pool_size(const struct prt_pool *pool)
{
    return pool ? pool->n_thread : 1;
}

// Calls the progress callback, at most ten times a second.
static int report(const struct prt_context *ctx, const char *stage, const struct loop *loop,
                  double started, double *last)
{
    if (!stage || !ctx->progress) return PRT_OK;
    double now = prt_time_s();
    if (now - *last < 0.1) return PRT_OK;
    *last = now;
    double f = (double)atomic_load(&loop->done) / (double)loop->n_piece;
    double eta = f > 0 ? (now - started) * (1 - f) / f : -1;
    return ctx->progress(ctx->progress_user, stage, f, eta) ? PRT_CANCELLED : PRT_OK;
}

int prt_parallel_for(const struct prt_context *ctx, const char *stage, size_t n, size_t grain,
                     prt_loop_fn fn, void *arg)
{
    if (!n) return PRT_OK;
    if (!grain) grain = 1;
    struct prt_pool *pool = ctx ? ctx->pool : NULL;
    struct loop loop = {.n = n,
                        .grain = grain,
                        .n_piece = (n + grain - 1) / grain,
                        .fn = fn,
                        .arg = arg,
                        .helpers_ns = ctx ? ctx->helpers_ns : NULL};
    bool shared = pool && pool->n_thread > 1 && loop.n_piece > 1;
    if (shared) {
        pthread_mutex_lock(&pool->lock);
        loop.next = pool->open;
        pool->open = &loop;
        pool->n_busy += !depth;
        if (pool->n_busy < pool->n_thread) pthread_cond_broadcast(&pool->work);
        pthread_mutex_unlock(&pool->lock);
        depth++;
    }
    double started = prt_time_s(), last = started;
    size_t piece;
    while ((piece = atomic_fetch_add(&loop.piece, 1)) < loop.n_piece) {
        run_piece(&loop, piece, 0);
        int ok = PRT_OK, status = ctx ? report(ctx, stage, &loop, started, &last) : PRT_OK;
        if (status) atomic_compare_exchange_strong(&loop.status, &ok, status);
    }
    if (shared) {
        depth--;
        pthread_mutex_lock(&pool->lock);
        pool->n_busy -= !depth;
        if (loop.next || pool->open != &loop) pthread_cond_signal(&pool->work);
        while (loop.helpers || atomic_load(&loop.done) < loop.n_piece)
            pthread_cond_wait(&pool->idle, &pool->lock);
        struct loop **at = &pool->open;
        while (*at != &loop) at = &(*at)->next;
        *at = loop.next;
        pthread_mutex_unlock(&pool->lock);
    }
    return atomic_load(&loop.status);
}
