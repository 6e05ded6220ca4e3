/* SPDX-License-Identifier: MIT */
/* proxy_peer.h owns clients that come by a proxy of --proxies: it reads the proxy's header
 * before a carrier gets the socket, and keeps the client's address, which is not the socket's.
 * Loop thread only. */
#ifndef RELIGHTD_PROXY_PEER_H
#define RELIGHTD_PROXY_PEER_H

#include "net/listener.h"

/* Takes an accepted socket whose peer is a proxy, and hands it on to fn once the header is
 * there; closes it where none comes within --handshake. False: the peer is no proxy, and the
 * socket still the caller's. */
bool proxy_peer_take(struct server *server, const struct accepted *client, accepted_fn fn);

/* As getpeername(), with the address that a proxy told. */
int proxy_peer_name(int fd, struct sockaddr_storage *out, socklen_t *n);
/* The number is another socket's from now on. */
void proxy_peer_forget(int fd);
/* Closes those whose header has not come. */
void proxy_peers_close(struct server *server);

#endif
