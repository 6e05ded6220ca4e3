/* SPDX-License-Identifier: MIT */
/* web_access.h owns the checks of a browser's request: its Host header must name this daemon,
 * against DNS rebinding, and its Origin must be this daemon's page or be listed.
 * Pure functions; thread-safe. */
#ifndef RELIGHTD_WEB_ACCESS_H
#define RELIGHTD_WEB_ACCESS_H

#include <stdbool.h>

struct options;

/* host: the Host header, NULL when it is absent or unreadable. Allowed are loopback
 * names, the host of --http, the address the client connected to (`local`, numeric, "" for
 * unknown), and the names in --hosts; each with any port. */
bool web_host_allowed(const struct options *options, const char *local, const char *host);
/* origin: the Origin header, NULL when it is unreadable, "" when it is absent (no browser).
 * Allowed are http:// and https:// followed by the Host header, and --origins. */
bool web_origin_allowed(const struct options *options, const char *host, const char *origin);

#endif
