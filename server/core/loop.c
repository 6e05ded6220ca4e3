// SPDX-License-Identifier: MIT
// The event loop on epoll. Timers live in a pairing heap behind one timerfd and messages behind
// one eventfd, so that the epoll descriptor is readable whenever there is work. The heap links
// the timers themselves: arming one needs no memory and cannot fail.
#include "core/loop.h"

#include <errno.h>
#include <fcntl.h>
#include <pthread.h>
#include <signal.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/eventfd.h>
#include <sys/timerfd.h>
#include <time.h>
#include <unistd.h>

enum { BATCH = 64 };

struct loop {
    int epoll_fd;
    struct loop_watch wake, clock, signal;
    struct loop_timer *first_timer; // the heap's root
    uint64_t armed_ns;              // expiry of the timerfd; 0: none
    pthread_mutex_t lock;           // guards the message list
    struct loop_message *first, **last;
    struct epoll_event batch[BATCH];
    int n_batch, next_batch;
    void (*on_signal)(void *user, int signal);
    void *signal_user;
};

// The loop of one of its own watches.
#define LOOP_OF(watch, member) ((struct loop *)((char *)(watch)-offsetof(struct loop, member)))

uint64_t loop_now_ns(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (uint64_t)t.tv_sec * 1000000000u + (uint64_t)t.tv_nsec;
}

int loop_watch_add(struct loop *loop, struct loop_watch *watch, uint32_t events)
{
    struct epoll_event e = {.events = events, .data.ptr = watch};
    return epoll_ctl(loop->epoll_fd, EPOLL_CTL_ADD, watch->fd, &e) ? -errno : 0;
}

void loop_watch_change(struct loop *loop, struct loop_watch *watch, uint32_t events)
{
    struct epoll_event e = {.events = events, .data.ptr = watch};
    epoll_ctl(loop->epoll_fd, EPOLL_CTL_MOD, watch->fd, &e);
}

void loop_watch_remove(struct loop *loop, struct loop_watch *watch)
{
    epoll_ctl(loop->epoll_fd, EPOLL_CTL_DEL, watch->fd, NULL);
    // The batch that is being handled may still refer to it.
    for (int i = loop->next_batch; i < loop->n_batch; i++)
        if (loop->batch[i].data.ptr == watch) loop->batch[i].data.ptr = NULL;
}

// Both without siblings; NULL is an empty heap.
static struct loop_timer *meld(struct loop_timer *a, struct loop_timer *b)
{
    if (!a || !b) return a ? a : b;
    struct loop_timer *low = b->at_ns < a->at_ns ? b : a, *high = low == a ? b : a;
    high->next = low->child;
    if (high->next) high->next->prev = high;
    high->prev = low;
    low->child = high;
    return low;
}

// The heap of a list of siblings: pairs from the left, then all from the right.
static struct loop_timer *meld_all(struct loop_timer *list)
{
    struct loop_timer *pairs = NULL, *heap = NULL;
    while (list) {
        struct loop_timer *a = list, *b = a->next, *rest = b ? b->next : NULL;
        a->next = a->prev = NULL;
        if (b) b->next = b->prev = NULL;
        a = meld(a, b);
        a->next = pairs;
        pairs = a;
        list = rest;
    }
    while (pairs) {
        struct loop_timer *rest = pairs->next;
        pairs->next = NULL;
        heap = meld(heap, pairs);
        pairs = rest;
    }
    return heap;
}

static void arm_clock(struct loop *loop)
{
    uint64_t at = loop->first_timer ? loop->first_timer->at_ns : 0;
    if (at == loop->armed_ns) return;
    loop->armed_ns = at;
    struct itimerspec spec = {
        .it_value = {(time_t)(at / 1000000000u), (long)(at % 1000000000u)}};
    timerfd_settime(loop->clock.fd, TFD_TIMER_ABSTIME, &spec, NULL);
}

static void take_out(struct loop *loop, struct loop_timer *timer)
{
    struct loop_timer *below = meld_all(timer->child);
    if (timer == loop->first_timer) {
        loop->first_timer = below;
    } else {
        bool oldest = timer->prev->child == timer; // prev is its parent
        *(oldest ? &timer->prev->child : &timer->prev->next) = timer->next;
        if (timer->next) timer->next->prev = timer->prev;
        loop->first_timer = meld(loop->first_timer, below);
    }
    timer->child = timer->next = timer->prev = NULL;
    timer->armed = false;
}

void loop_timer_stop(struct loop *loop, struct loop_timer *timer)
{
    if (!timer->armed) return;
    take_out(loop, timer);
    arm_clock(loop);
}

void loop_timer_set(struct loop *loop, struct loop_timer *timer, uint64_t at_ns)
{
    if (timer->armed) take_out(loop, timer);
    timer->at_ns = at_ns ? at_ns : 1;
    timer->armed = true;
    loop->first_timer = meld(loop->first_timer, timer);
    arm_clock(loop);
}

static void clock_ready(struct loop_watch *watch, uint32_t events)
{
    struct loop *loop = LOOP_OF(watch, clock);
    uint64_t n;
    if (read(watch->fd, &n, sizeof n) < 0) n = 0;
    loop->armed_ns = 0;
    uint64_t now = loop_now_ns();
    while (loop->first_timer && loop->first_timer->at_ns <= now) {
        struct loop_timer *timer = loop->first_timer;
        take_out(loop, timer);
        timer->fire(timer);
    }
    arm_clock(loop);
}

void loop_post(struct loop *loop, struct loop_message *message)
{
    message->next = NULL;
    pthread_mutex_lock(&loop->lock);
    bool first = !loop->first;
    *loop->last = message;
    loop->last = &message->next;
    pthread_mutex_unlock(&loop->lock);
    uint64_t one = 1;
    if (first && write(loop->wake.fd, &one, sizeof one) < 0)
        return; // the counter is full: the loop wakes anyway
}

static void wake_ready(struct loop_watch *watch, uint32_t events)
{
    struct loop *loop = LOOP_OF(watch, wake);
    uint64_t n;
    if (read(watch->fd, &n, sizeof n) < 0) n = 0;
    pthread_mutex_lock(&loop->lock);
    struct loop_message *message = loop->first;
    loop->first = NULL;
    loop->last = &loop->first;
    pthread_mutex_unlock(&loop->lock);
    while (message) {
        struct loop_message *next = message->next;
        message->handle(message);
        message = next;
    }
}

static int signal_pipe_in = -1; // global: a signal handler has no argument

static void note_signal(int number)
{
    int saved = errno;
    unsigned char byte = (unsigned char)number;
    // A full pipe loses nothing: handling one SIGCHLD waits for every child that ended.
    if (write(signal_pipe_in, &byte, 1) < 0) errno = 0;
    errno = saved;
}

static void signal_ready(struct loop_watch *watch, uint32_t events)
{
    struct loop *loop = LOOP_OF(watch, signal);
    unsigned char bytes[64];
    for (ssize_t n; (n = read(watch->fd, bytes, sizeof bytes)) > 0;)
        for (ssize_t i = 0; i < n; i++) loop->on_signal(loop->signal_user, bytes[i]);
}

// A pipe and a handler, as signalfd did not work in the loop without HTTP.
int loop_signals(struct loop *loop, const int *signals, size_t n,
                 void (*fn)(void *user, int signal), void *user)
{
    int pipe_fd[2];
    if (pipe2(pipe_fd, O_NONBLOCK | O_CLOEXEC)) return -errno;
    loop->on_signal = fn;
    loop->signal_user = user;
    loop->signal = (struct loop_watch){pipe_fd[0], signal_ready};
    signal_pipe_in = pipe_fd[1];
    struct sigaction act = {.sa_handler = note_signal, .sa_flags = SA_RESTART};
    for (size_t i = 0; i < n; i++) sigaction(signals[i], &act, NULL);
    return loop_watch_add(loop, &loop->signal, EPOLLIN);
}

int loop_create(struct loop **out)
{
    struct loop *loop = calloc(1, sizeof *loop);
    if (!loop) return -ENOMEM;
    loop->last = &loop->first;
    pthread_mutex_init(&loop->lock, NULL);
    loop->signal.fd = -1;
    loop->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    loop->wake = (struct loop_watch){eventfd(0, EFD_NONBLOCK | EFD_CLOEXEC), wake_ready};
    loop->clock = (struct loop_watch){
        timerfd_create(CLOCK_MONOTONIC, TFD_NONBLOCK | TFD_CLOEXEC), clock_ready};
    if (loop->epoll_fd < 0 || loop->wake.fd < 0 || loop->clock.fd < 0 ||
        loop_watch_add(loop, &loop->wake, EPOLLIN) ||
        loop_watch_add(loop, &loop->clock, EPOLLIN)) {
        int err = -errno;
        loop_destroy(loop);
        return err;
    }
    *out = loop;
    return 0;
}

void loop_destroy(struct loop *loop)
{
    if (!loop) return;
    if (loop->signal.fd >= 0)
        close(loop->signal.fd); // the write end stays open for the handler
    if (loop->clock.fd >= 0) close(loop->clock.fd);
    if (loop->wake.fd >= 0) close(loop->wake.fd);
    if (loop->epoll_fd >= 0) close(loop->epoll_fd);
    pthread_mutex_destroy(&loop->lock);
    free(loop);
}

void loop_turn(struct loop *loop, int timeout_ms)
{
    loop->next_batch = 0;
    loop->n_batch = epoll_wait(loop->epoll_fd, loop->batch, BATCH, timeout_ms);
    while (loop->next_batch < loop->n_batch) {
        struct epoll_event *e = &loop->batch[loop->next_batch++];
        struct loop_watch *watch = e->data.ptr;
        if (watch) watch->ready(watch, e->events);
    }
    loop->n_batch = 0;
}

int loop_fd(const struct loop *loop)
{
    return loop->epoll_fd;
}
