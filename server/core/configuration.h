/* SPDX-License-Identifier: MIT */
/* configuration.h owns the options as a whole: checking them without serving (--check), and
 * reading them again while the daemon runs (SIGHUP). */
#ifndef RELIGHTD_CONFIGURATION_H
#define RELIGHTD_CONFIGURATION_H

#include "core/server.h"

/* Checks that folders and files exist, addresses resolve and words are known. 0, or -1 with the
 * error's text in fault. Binds and creates nothing. */
int configuration_check(const struct options *options, char fault[256]);
/* A warning about settings that are valid but probably not intended: a static text, or NULL. */
const char *configuration_advice(const struct options *options);

/* Reads configuration, command line and token file again, applies the options that may change,
 * and logs each change and each option that needs a restart. A faulty configuration changes
 * nothing. */
void configuration_reload(struct server *server, int argc, char **argv);

#endif
