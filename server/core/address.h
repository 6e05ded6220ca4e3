/* SPDX-License-Identifier: MIT */
/* address.h owns the addresses that the options name: their parts, what they resolve to, and
 * whether they may be served. Binds nothing. Functions with a `fault` return 0, or -1 with the
 * fault's words. */
#ifndef RELIGHTD_ADDRESS_H
#define RELIGHTD_ADDRESS_H

#include <netdb.h>
#include <stdbool.h>
#include <sys/socket.h>
#include <sys/types.h>

struct options;

/* Splits HOST:PORT; host is without brackets, "" for all addresses. False when it is none. */
bool address_split(const char *text, char host[256], char port[8]);
/* A unix socket counts as one. */
bool address_is_loopback(const struct sockaddr *address);
/* "192.0.2.7:80", "[::1]:80"; "local" for a unix socket. */
void address_name(const struct sockaddr_storage *address, socklen_t n, char *out, size_t room);

/* Refuses what other machines can reach, unless there is a token or --accept-anyone. */
int address_admit(const struct options *options, const struct sockaddr *address,
                  char fault[256]);
/* What HOST:PORT resolves to, all of it admitted; freeaddrinfo() it. May ask a name server. */
int address_resolve(const struct options *options, const char *address, struct addrinfo **out,
                    char fault[256]);
/* A group's name or number; "" gives -1: the daemon's own. */
int address_group(const char *name, gid_t *out, char fault[256]);
/* Whether tcp:HOST:PORT, http:HOST:PORT or unix:PATH can be served, as far as that shows
 * without binding. */
int address_check(const struct options *options, const char *address, char fault[256]);

#endif
