// SPDX-License-Identifier: MIT
// Messages to the service manager.
#include "core/notify.h"

#include "core/server.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <systemd/sd-daemon.h>
#include <time.h>
#include <unistd.h>

static const uint64_t STATUS_NS = 1000000000u; // between two looks at the status
static const uint64_t RETRY_NS = 100000000u;   // while the manager's queue is full
enum { N_UNSENT = 8, MESSAGE = 300 };

static struct server *server_of_timers;
static struct loop_timer status_timer, watchdog_timer, retry_timer;
static uint64_t watchdog_ns;
static char told[200];
static char unsent[N_UNSENT][MESSAGE]; // states, oldest first
static unsigned n_unsent;

// False: the manager's queue is full. sd_notify(3) would wait there, and the loop with it.
static bool send_now(const char *message)
{
    const char *path = getenv("NOTIFY_SOCKET");
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    size_t n = path ? strlen(path) : 0;
    if (!n || n >= sizeof to.sun_path || (*path != '/' && *path != '@')) return true;
    memcpy(to.sun_path, path, n);
    if (*path == '@') to.sun_path[0] = 0; // a name, not a file
    int fd = socket(AF_UNIX, SOCK_DGRAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    if (fd < 0) return true;
    socklen_t n_to = (socklen_t)(offsetof(struct sockaddr_un, sun_path) + n);
    ssize_t sent =
        sendto(fd, message, strlen(message), MSG_NOSIGNAL, (struct sockaddr *)&to, n_to);
    bool full = sent < 0 && (errno == EAGAIN || errno == ENOBUFS);
    close(fd);
    return !full;
}

static void retry(struct loop_timer *timer)
{
    unsigned n = 0;
    while (n < n_unsent && send_now(unsent[n])) n++;
    n_unsent -= n;
    memmove(unsent, unsent + n, n_unsent * sizeof *unsent);
    if (n_unsent) loop_timer_set(server_of_timers->loop, timer, loop_now_ns() + RETRY_NS);
}

// Sends it when the manager takes it, after those of before. Of many the last ones count.
static void send_state(const char *message)
{
    if (!n_unsent && send_now(message)) return;
    if (n_unsent == N_UNSENT) memmove(unsent, unsent + 1, --n_unsent * sizeof *unsent);
    snprintf(unsent[n_unsent++], MESSAGE, "%s", message);
    retry_timer.fire = retry;
    if (server_of_timers)
        loop_timer_set(server_of_timers->loop, &retry_timer, loop_now_ns() + RETRY_NS);
}

static void make_status(const struct server *server, char out[200])
{
    const char *state = server->draining ? "draining: " : server->leaving ? "leaving: " : "";
    snprintf(out, 200, "%s%u connections, %u requests, %u bakes", state, server->n_connection,
             server->n_request, jobs_open(server->jobs));
}

static void tell_status(const struct server *server, const char *before)
{
    char now[200], message[MESSAGE];
    make_status(server, now);
    if (!before && !strcmp(now, told)) return;
    snprintf(message, sizeof message, "%sSTATUS=%s", before ? before : "", now);
    if (before) send_state(message);
    else if (n_unsent || !send_now(message)) return; // the next look tries again
    strcpy(told, now);
}

static void status_fired(struct loop_timer *timer)
{
    tell_status(server_of_timers, NULL);
    loop_timer_set(server_of_timers->loop, timer, loop_now_ns() + STATUS_NS);
}

static void watchdog_fired(struct loop_timer *timer)
{
    send_now("WATCHDOG=1");
    loop_timer_set(server_of_timers->loop, timer, loop_now_ns() + watchdog_ns / 2);
}

void notify_ready(struct server *server)
{
    uint64_t watchdog_us;
    server_of_timers = server;
    tell_status(server, "READY=1\n");
    status_timer.fire = status_fired;
    loop_timer_set(server->loop, &status_timer, loop_now_ns() + STATUS_NS);
    if (sd_watchdog_enabled(0, &watchdog_us) > 0) {
        watchdog_ns = watchdog_us * 1000;
        watchdog_timer.fire = watchdog_fired;
        watchdog_fired(&watchdog_timer);
    }
}

void notify_reloading(void)
{
    struct timespec now;
    char message[MESSAGE];
    clock_gettime(CLOCK_MONOTONIC, &now);
    snprintf(message, sizeof message, "RELOADING=1\nMONOTONIC_USEC=%llu",
             (unsigned long long)now.tv_sec * 1000000 + (unsigned long long)now.tv_nsec / 1000);
    send_state(message);
}

void notify_reloaded(const struct server *server)
{
    tell_status(server, "READY=1\n");
}

void notify_stopping(const struct server *server)
{
    tell_status(server, "STOPPING=1\n");
}
