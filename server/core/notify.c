// SPDX-License-Identifier: MIT
// Messages to the service manager.
#include "core/notify.h"

#include "core/server.h"

#include <stdio.h>
#include <string.h>
#include <systemd/sd-daemon.h>
#include <time.h>

static const uint64_t STATUS_NS = 1000000000u; // between two looks at the status

static struct server *server_of_timers;
static struct loop_timer status_timer, watchdog_timer;
static uint64_t watchdog_ns;
static char told[200];

static void make_status(const struct server *server, char out[200])
{
    const char *state = server->draining ? "draining: " : server->leaving ? "leaving: " : "";
    snprintf(out, 200, "%s%u connections, %u requests, %u bakes", state, server->n_connection,
             server->n_request, jobs_open(server->jobs));
}

static void tell_status(const struct server *server, const char *before)
{
    char now[200];
    make_status(server, now);
    if (!before && !strcmp(now, told)) return;
    strcpy(told, now);
    sd_notifyf(0, "%sSTATUS=%s", before ? before : "", now);
}

static void status_fired(struct loop_timer *timer)
{
    tell_status(server_of_timers, NULL);
    loop_timer_set(server_of_timers->loop, timer, loop_now_ns() + STATUS_NS);
}

static void watchdog_fired(struct loop_timer *timer)
{
    sd_notify(0, "WATCHDOG=1");
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
    clock_gettime(CLOCK_MONOTONIC, &now);
    sd_notifyf(0, "RELOADING=1\nMONOTONIC_USEC=%llu",
               (unsigned long long)now.tv_sec * 1000000 +
                   (unsigned long long)now.tv_nsec / 1000);
}

void notify_reloaded(const struct server *server)
{
    tell_status(server, "READY=1\n");
}

void notify_stopping(const struct server *server)
{
    tell_status(server, "STOPPING=1\n");
}
