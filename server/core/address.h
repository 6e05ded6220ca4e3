/* SPDX-License-Identifier: MIT */
/* address.h owns the addresses that the options name: it splits and resolves them and checks
 * whether they may be served. Binds nothing. Functions with a `fault` return 0, or -1 with the
 * error's text in it. */
#ifndef RELIGHTD_ADDRESS_H
#define RELIGHTD_ADDRESS_H

#include <netdb.h>
#include <stdbool.h>
#include <sys/socket.h>
#include <sys/types.h>

struct options;

/* Splits HOST:PORT; host is without brackets, "" for all addresses. False for other text. */
bool address_split(const char *text, char host[256], char port[8]);
/* True for a unix socket, too. */
bool address_is_loopback(const struct sockaddr *address);
/* "192.0.2.7:80", "[::1]:80"; "local" for a unix socket. */
void address_name(const struct sockaddr_storage *address, socklen_t n, char *out, size_t room);

/* Refuses addresses that other machines can reach, unless a token or --accept-anyone is set. */
int address_admit(const struct options *options, const struct sockaddr *address,
                  char fault[256]);
/* Resolves HOST:PORT and checks each address; free with freeaddrinfo(). May query a name server
 * and block. */
int address_resolve(const struct options *options, const char *address, struct addrinfo **out,
                    char fault[256]);
/* A group's name or number; "" gives -1, the daemon's own group. */
int address_group(const char *name, gid_t *out, char fault[256]);
/* Checks tcp:HOST:PORT, http:HOST:PORT or unix:PATH as far as possible without binding. */
int address_check(const struct options *options, const char *address, char fault[256]);

#endif
