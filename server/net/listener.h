/* SPDX-License-Identifier: MIT */
/* listener.h owns the listening sockets of all carriers: resolving and binding addresses,
 * accepting, and pausing while the process is out of descriptors. Loop thread only. */
#ifndef RELIGHTD_LISTENER_H
#define RELIGHTD_LISTENER_H

#include "core/server.h"

#include <sys/socket.h>

/* A client that was accepted. */
struct accepted {
    int fd;
    bool local;    /* a unix socket */
    bool tls;      /* its bytes are encrypted */
    bool no_room;  /* descriptors ran out: the carrier refuses the client and closes fd */
    char peer[96]; /* "192.0.2.7:40312", "[::1]:40312" or "local" */
    char who[96];  /* the principal until HELLO names another: "uid:1000" or "addr:192.0.2.7" */
};

/* The carrier takes the descriptor, which is non-blocking and closed on exec. */
typedef void (*accepted_fn)(struct server *server, const struct accepted *client);

/* Binds every address that HOST:PORT resolves to. HOST is a name, an address,
 * [an IPv6 address], or * for all; port 0: a free one. With --tls-cert its clients speak TLS,
 * on loopback unless --tls-loopback is no and kind is not "tls". `kind` ("tcp", "tls" or
 * "http") appears in the log. Logs each bound address, or the error; 0 or -1. */
int listener_open_tcp(struct server *server, const char *kind, const char *address,
                      accepted_fn fn);
/* A unix socket with --socket-mode and --socket-group. A socket file that a dead daemon left is
 * replaced; one that a living daemon serves is an error. */
int listener_open_unix(struct server *server, const char *path, accepted_fn fn);
/* Takes a listening socket that was handed over (systemd socket activation). */
int listener_adopt(struct server *server, int fd, accepted_fn fn);
/* Closes the listeners that hand their clients to fn, and removes unix sockets' files. */
void listeners_close(struct server *server, accepted_fn fn);

/* Fills local, peer and who from a connected socket. */
void accepted_describe(int fd, struct accepted *client);
/* TCP_NODELAY, and keepalive probes that find a dead peer in 90 s. */
void accepted_tune(int fd);

/* Bytes in the socket's send buffer that the peer has not taken. */
size_t socket_unsent(int fd);

#endif
