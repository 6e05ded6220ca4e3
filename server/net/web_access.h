/* SPDX-License-Identifier: MIT */
/* web_access.h owns the rules by which a browser's request is admitted: its Host header names
 * this daemon (DNS rebinding is refused), and its Origin is this daemon's page or is listed.
 * Pure functions; thread-safe. */
#ifndef RELIGHTD_WEB_ACCESS_H
#define RELIGHTD_WEB_ACCESS_H

#include <stdbool.h>

struct options;

/* host: the Host header, NULL when there is none or it could not be read. Allowed are loopback
 * names, the host of --http, the address the client connected to (`local`, numeric, "" for
 * unknown), and the names in --hosts; each with any port. */
bool web_host_allowed(const struct options *options, const char *local, const char *host);
/* origin: the Origin header, NULL when it could not be read, "" when there is none (no browser
 * sends that). Allowed are http:// and https:// followed by the Host header, and --origins. */
bool web_origin_allowed(const struct options *options, const char *host, const char *origin);

#endif
