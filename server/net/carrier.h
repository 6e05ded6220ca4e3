/* SPDX-License-Identifier: MIT */
/* carrier.h owns the ways in: byte-stream sockets here, HTTP and WebSocket beside them. */
#ifndef RELIGHTD_CARRIER_H
#define RELIGHTD_CARRIER_H

#include "net/connection.h"

/* Opens tcp:HOST:PORT or unix:PATH and accepts clients on it. Logs an error; 0 or -1. The unix
 * socket of a dead daemon is replaced, that of a running daemon is an error.
 */
int sockets_listen(struct server *server, const char *address);
/* Takes a listening socket that was handed over (systemd socket activation). */
int sockets_adopt(struct server *server, int fd);
/* Stops accepting and removes the unix sockets' files. */
void sockets_close(struct server *server);

/* The ERROR frame that a refused client gets before it is closed: BUSY with `text`, or
 * SHUTTING_DOWN. malloc()ed; 0 or a frame fault. */
int refusal_frame(const struct server *server, const char *text, uint8_t **out, size_t *n);

/* HTTP and WebSocket on HOST:PORT. While it is open, http_turn runs the loop. It
 * accepts until http_close(): a draining daemon still answers /healthz with "draining", so that
 * a proxy uses another server. */
int http_open(struct server *server, const char *address);
bool http_is_open(void);
void http_turn(struct server *server);
void http_close(void);

#endif
