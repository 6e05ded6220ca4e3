// SPDX-License-Identifier: MIT
// Addresses: splitting and resolving them, and whether the options allow to serve them.
#include "core/address.h"

#include "core/access.h"
#include "core/options.h"

#include <ctype.h>
#include <grp.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/un.h>

bool address_split(const char *text, char host[256], char port[8])
{
    const char *colon = strrchr(text, ':');
    if (!colon || !colon[1] || strlen(colon + 1) > 5) return false;
    for (const char *c = colon + 1; *c; c++)
        if (!isdigit((unsigned char)*c)) return false;
    if (atoi(colon + 1) > 65535) return false;
    size_t n = (size_t)(colon - text);
    bool bracket = text[0] == '[' && n >= 2 && text[n - 1] == ']';
    if (bracket) {
        text++;
        n -= 2;
    }
    // An IPv6 address without brackets: its last group must not be read as the port.
    if (n >= 256 || (!bracket && memchr(text, ':', n))) return false;
    snprintf(host, 256, "%.*s", (int)n, text);
    if (!strcmp(host, "*")) host[0] = 0;
    strcpy(port, colon + 1);
    return true;
}

bool address_is_loopback(const struct sockaddr *address)
{
    if (address->sa_family == AF_UNIX) return true;
    if (address->sa_family == AF_INET)
        return ntohl(((const struct sockaddr_in *)address)->sin_addr.s_addr) >> 24 == 127;
    if (address->sa_family != AF_INET6) return false;
    const struct in6_addr *a = &((const struct sockaddr_in6 *)address)->sin6_addr;
    return IN6_IS_ADDR_LOOPBACK(a) || (IN6_IS_ADDR_V4MAPPED(a) && a->s6_addr[12] == 127);
}

void address_name(const struct sockaddr_storage *address, socklen_t n, char *out, size_t room)
{
    char host[64], port[16];
    bool six = address->ss_family == AF_INET6;
    if (address->ss_family == AF_UNIX ||
        getnameinfo((const struct sockaddr *)address, n, host, sizeof host, port, sizeof port,
                    NI_NUMERICHOST | NI_NUMERICSERV))
        snprintf(out, room, "local");
    else snprintf(out, room, "%s%s%s:%s", six ? "[" : "", host, six ? "]" : "", port);
}

int address_admit(const struct options *options, const struct sockaddr *address,
                  char fault[256])
{
    if (address_is_loopback(address) || options->accept_anyone || access_configured(options))
        return 0;
    snprintf(fault, 256,
             "other machines can reach it and no token exists: `relight token create`, "
             "--token-file, or --accept-anyone for every client");
    return -1;
}

int address_resolve(const struct options *options, const char *address, struct addrinfo **out,
                    char fault[256])
{
    char host[256], port[8];
    if (!address_split(address, host, port)) {
        snprintf(fault, 256, "expected HOST:PORT, with an IPv6 address in brackets");
        return -1;
    }
    struct addrinfo hints = {.ai_flags = AI_PASSIVE, .ai_socktype = SOCK_STREAM};
    int err = getaddrinfo(*host ? host : NULL, port, &hints, out);
    if (err) {
        snprintf(fault, 256, "%s", gai_strerror(err));
        return -1;
    }
    for (const struct addrinfo *a = *out; a; a = a->ai_next)
        if (address_admit(options, a->ai_addr, fault)) {
            freeaddrinfo(*out);
            return -1;
        }
    return 0;
}

int address_group(const char *name, gid_t *out, char fault[256])
{
    char *end;
    unsigned long number = strtoul(name, &end, 10);
    const struct group *group = *name ? getgrnam(name) : NULL;
    *out = group ? group->gr_gid : (gid_t)number;
    if (!*name) *out = (gid_t)-1;
    if (!*name || group || (!*end && number < (gid_t)-1)) return 0;
    snprintf(fault, 256, "--socket-group %s: this machine has no such group", name);
    return -1;
}

int address_check(const struct options *options, const char *address, char fault[256])
{
    struct addrinfo *list;
    gid_t group;
    if (!strncmp(address, "unix:", 5)) {
        size_t most = sizeof((struct sockaddr_un *)0)->sun_path - 1;
        if (strlen(address + 5) <= most)
            return address_group(options->socket_group, &group, fault);
        snprintf(fault, 256, "the path is longer than %zu bytes", most);
        return -1;
    }
    if (address_resolve(options, strchr(address, ':') + 1, &list, fault)) return -1;
    freeaddrinfo(list);
    return 0;
}
