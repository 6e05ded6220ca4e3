// SPDX-License-Identifier: MIT
// Readiness. A worker writes and removes a small file every few seconds, so that a full disk, a
// read-only remount or a lost network folder is seen before a client sees it.
#include "store/readiness.h"

#include "core/log.h"
#include "relight.pb-c.h"
#include "store/models.h"

#include <errno.h>
#include <fcntl.h>
#include <stdio.h>
#include <string.h>
#include <unistd.h>

static struct {
    struct work work;
    struct loop_timer timer;
    struct server *server;
    int fault, found; // errno of the last attempt; of the one under way
} probe;

static int try_write(const char *folder)
{
    static const char text[] = "relightd can write here\n";
    char path[4200];
    snprintf(path, sizeof path, "%s/work/.probe", folder);
    int fd = open(path, O_WRONLY | O_CREAT | O_TRUNC | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (fd < 0) return errno;
    ssize_t n = write(fd, text, sizeof text - 1);
    int fault = n == (ssize_t)sizeof text - 1 ? 0 : n < 0 ? errno : ENOSPC;
    if (close(fd) && !fault) fault = errno;
    if (unlink(path) && !fault) fault = errno;
    return fault;
}

static int run_probe(struct work *work, const struct prt_context *ctx)
{
    probe.found = try_write(probe.server->data);
    return PRT_OK;
}

static void probed(struct work *work)
{
    if (probe.found && probe.found != probe.fault)
        log_line(LOG_ERR, "data folder %s cannot be written: %s", probe.server->data,
                 strerror(probe.found));
    if (!probe.found && probe.fault)
        log_line(LOG_EVENT, "data folder %s can be written again", probe.server->data);
    probe.fault = probe.found;
    if (!probe.server->draining)
        loop_timer_set(probe.server->loop, &probe.timer,
                       loop_now_ns() + READINESS_S * UINT64_C(1000000000));
}

static void probe_again(struct loop_timer *timer)
{
    work_submit(probe.server->work, &probe.work);
}

bool readiness(const struct server *server, char why[200])
{
    if (!server->models) {
        snprintf(why, 200, "the registry is being read");
        return false;
    }
    if (probe.fault) {
        snprintf(why, 200, "the data folder cannot be written: %s", strerror(probe.fault));
        return false;
    }
    for (const struct model *m = NULL; (m = models_next(server->models, m));)
        if (m->pinned && m->state == RELIGHT__MODEL_STATE__MODEL_READY && !m->pin) {
            snprintf(why, 200, "the pinned model %.16s is being opened", m->id);
            return false;
        }
    return true;
}

void readiness_begin(struct server *server)
{
    probe.server = server;
    probe.timer.fire = probe_again;
    probe.work.run = run_probe;
    probe.work.done = probed;
    probe.work.class = WORK_INTERACTIVE;
    server->is_ready = readiness;
    probe.fault = try_write(server->data); // before there are clients
    loop_timer_set(server->loop, &probe.timer,
                   loop_now_ns() + READINESS_S * UINT64_C(1000000000));
}
