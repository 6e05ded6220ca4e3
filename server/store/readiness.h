/* SPDX-License-Identifier: MIT */
/* readiness.h owns the answer to "may clients be sent here": the registry was read, pinned
 * models are open, and the data folder takes files. Loop thread only. */
#ifndef RELIGHTD_READINESS_H
#define RELIGHTD_READINESS_H

#include <stdbool.h>

struct server;

/* False: `why` says what is missing, in one line. The data folder was last tried at most
 * READINESS_S seconds ago, on a worker. */
enum { READINESS_S = 5 };
bool readiness(const struct server *server, char why[200]);
/* Begins to try the data folder, again and again. At the start. */
void readiness_begin(struct server *server);

#endif
