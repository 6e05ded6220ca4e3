/* SPDX-License-Identifier: MIT */
/* proxy_header.h owns the PROXY protocol, version 2: the header by which a proxy tells who the
 * client behind it is. Pure; any thread. */
#ifndef RELIGHTD_PROXY_HEADER_H
#define RELIGHTD_PROXY_HEADER_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <sys/socket.h>

enum { PROXY_HEADER_FIXED = 16, PROXY_HEADER_MAX = 2048 };

/* Bytes of the whole header, from its first 16; 0: they begin no header of version 2, or one
 * longer than PROXY_HEADER_MAX. */
size_t proxy_header_size(const uint8_t fixed[PROXY_HEADER_FIXED]);

enum proxy_peer {
    PROXY_BAD,
    PROXY_LOCAL,  /* the proxy itself speaks (a health check), or the family is none of ours */
    PROXY_CLIENT, /* *out is the client's address, IPv4 or IPv6 over TCP */
};
/* A whole header; n: proxy_header_size(). Values behind the addresses are skipped. */
enum proxy_peer proxy_header_parse(const uint8_t *bytes, size_t n,
                                   struct sockaddr_storage *out);

/* Whether an address is in a list: "10.0.0.0/8,192.0.2.7,::1". An IPv4 address in IPv6 form
 * counts as IPv4. */
bool proxy_list_has(const char *list, const struct sockaddr *address);
/* Whether the list can be read; else its first wrong word is in fault[128]. */
bool proxy_list_check(const char *list, char fault[128]);

#endif
