/* SPDX-License-Identifier: MIT */
/* replicas.h owns the choice of a replica by a connection's route, where no proxy makes it.
 * Pure; any thread. */
#ifndef RELIGHTD_REPLICAS_H
#define RELIGHTD_REPLICAS_H

#include <stddef.h>

/* The address in a comma-separated list that serves this route: the one whose hash together
 * with the route is the highest, so that a replica that comes or goes moves its own share of
 * routes alone. `without`: an address that is not chosen, "" for none. False: the list has no
 * other, or an address takes more than n - 1 bytes. */
int replica_choose(const char *list, const char *route, const char *without, char *out,
                   size_t n);

#endif
