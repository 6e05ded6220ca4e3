/* SPDX-License-Identifier: MIT */
/* notify.h owns messages to the service manager (sd_notify(3)): ready, reloading, stopping, a
 * line of status, and the watchdog. Without $NOTIFY_SOCKET they go nowhere. None waits
 * for the manager to read: states are sent again until it takes them. Loop thread only. */
#ifndef RELIGHTD_NOTIFY_H
#define RELIGHTD_NOTIFY_H

struct server;

/* READY=1 with a first STATUS; begins to send the status when it has changed, and WATCHDOG=1
 * twice in each interval of $WATCHDOG_USEC, from the loop: the manager restarts the daemon when
 * the loop hangs. */
void notify_ready(struct server *server);
/* RELOADING=1 with MONOTONIC_USEC, and READY=1 after it. */
void notify_reloading(void);
void notify_reloaded(const struct server *server);
/* STOPPING=1: SIGTERM came. */
void notify_stopping(const struct server *server);

#endif
