// SPDX-License-Identifier: MIT
// Requests that wait. Where the request ends first, its wait continues without a request.
#include "net/request_wait.h"

#include "core/log.h"
#include "core/server.h"

static void abandon(struct request *request)
{
    ((struct request_wait *)request->state)->request = NULL;
}

void request_park(struct request *request, struct request_wait *wait)
{
    wait->request = request;
    request->state = wait;
    request->abandon = abandon;
}

struct request *request_resume(struct request_wait *wait)
{
    struct request *request = wait->request;
    if (!request) return NULL;
    request->state = NULL;
    request->abandon = NULL;
    wait->request = NULL;
    return request;
}

static void go_on(struct request_wait *wait)
{
    if (wait->request) log_request_set(wait->request->request_id);
    wait->then(wait, request_resume(wait));
    log_request_set("");
}

static void wake(struct cache_waiter *waiter)
{
    struct request_wait *wait =
        (struct request_wait *)((char *)waiter - offsetof(struct request_wait, waiter));
    go_on(wait);
}

// The entry leaves the queue that it waits in when nobody else waits for it.
static void leave_entry(struct request *request)
{
    struct request_wait *wait = request->state;
    wait->request = NULL;
    cache_leave(wait->entry, &wait->waiter);
    wait->then(wait, NULL);
}

void request_await_entry(struct request *request, struct request_wait *wait,
                         struct cache_entry *entry,
                         void (*then)(struct request_wait *wait, struct request *request))
{
    wait->entry = entry;
    wait->then = then;
    wait->waiter.wake = wake;
    if (entry->state != CACHE_PENDING) {
        then(wait, request);
        return;
    }
    request_park(request, wait);
    request->abandon = leave_entry;
    cache_wait(entry, &wait->waiter);
}

static void worked(struct work *work)
{
    struct request_wait *wait = (struct request_wait *)work;
    if (wait->request)
        stats_work(&wait->request->server->stats, wait->request->type,
                   (double)(work->started_ns - work->submitted_ns) * 1e-9,
                   (double)(work->ended_ns - work->started_ns) * 1e-9);
    go_on(wait);
}

void request_await_work(struct request *request, struct request_wait *wait,
                        int (*run)(struct work *work, const struct prt_context *ctx),
                        void (*then)(struct request_wait *wait, struct request *request))
{
    wait->then = then;
    wait->work.run = run;
    wait->work.done = worked;
    request_park(request, wait);
    work_submit(request->server->work, &wait->work);
}
