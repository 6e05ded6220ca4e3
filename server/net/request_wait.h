/* SPDX-License-Identifier: MIT */
/* request_wait.h owns requests that wait: for a cache entry, or for a job of their own on a
 * worker. The waiting operation's state begins with a struct request_wait. */
#ifndef RELIGHTD_REQUEST_WAIT_H
#define RELIGHTD_REQUEST_WAIT_H

#include "core/work.h"
#include "net/request.h"
#include "store/cache.h"

struct request_wait {
    struct work work; /* first: run() is given it */
    struct cache_waiter waiter;
    struct cache_entry *entry;
    struct request *request; /* NULL: abandoned meanwhile */
    void (*then)(struct request_wait *wait, struct request *request);
};

/* Each calls then(wait, request) once, now or later, and frees nothing: then() frees the wait
 * and its contents. request is NULL if it ended meanwhile (cancelled, past its deadline, its
 * connection closed); otherwise then() answers it or lets it wait again. */

/* Until the entry is ready or failed. The caller's reference stays in wait->entry. */
void request_await_entry(struct request *request, struct request_wait *wait,
                         struct cache_entry *entry,
                         void (*then)(struct request_wait *wait, struct request *request));
/* Until run() was called on a worker; its status and error are in wait->work. */
void request_await_work(struct request *request, struct request_wait *wait,
                        int (*run)(struct work *work, const struct prt_context *ctx),
                        void (*then)(struct request_wait *wait, struct request *request));

/* The two halves, for waits that end in another way. resume returns the request, or NULL if it
 * ended. */
void request_park(struct request *request, struct request_wait *wait);
struct request *request_resume(struct request_wait *wait);

#endif
