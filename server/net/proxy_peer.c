// SPDX-License-Identifier: MIT
// Sockets of proxies until their header is there, and the addresses of the clients behind them.
#include "net/proxy_peer.h"

#include "core/log.h"
#include "core/proxy_header.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <unistd.h>

struct proxied {
    struct proxied *next;
    struct loop_watch watch;
    struct loop_timer timer;
    struct server *server;
    struct accepted client;
    accepted_fn fn;
    size_t have, size; // bytes of the header; size 0: not known yet
    uint8_t bytes[PROXY_HEADER_MAX];
};
static struct proxied *waiting;

// By descriptor; ss_family 0: the socket's own.
static struct sockaddr_storage *told;
static int n_told;

static bool tell(int fd, const struct sockaddr_storage *address)
{
    if (fd >= n_told) {
        int n = fd < 256 ? 256 : 2 * fd;
        struct sockaddr_storage *more = realloc(told, (size_t)n * sizeof *more);
        if (!more) return false;
        memset(more + n_told, 0, (size_t)(n - n_told) * sizeof *more);
        told = more;
        n_told = n;
    }
    told[fd] = *address;
    return true;
}

void proxy_peer_forget(int fd)
{
    if (fd < n_told) told[fd].ss_family = 0;
}

int proxy_peer_name(int fd, struct sockaddr_storage *out, socklen_t *n)
{
    if (fd < 0 || fd >= n_told || !told[fd].ss_family)
        return getpeername(fd, (struct sockaddr *)out, n);
    *out = told[fd];
    *n = sizeof *out;
    return 0;
}

static void leave(struct proxied *p)
{
    struct proxied **at = &waiting;
    while (*at != p) at = &(*at)->next;
    *at = p->next;
    loop_timer_stop(p->server->loop, &p->timer);
    loop_watch_remove(p->server->loop, &p->watch);
}

static void refuse(struct proxied *p, const char *why)
{
    log_line(LOG_WARN, "proxy peer=%s error=\"%s\"", p->client.peer, why);
    p->server->stats.connections_refused++;
    leave(p);
    close(p->client.fd);
    free(p);
}

static void header_is_there(struct proxied *p)
{
    struct sockaddr_storage address;
    enum proxy_peer kind = proxy_header_parse(p->bytes, p->have, &address);
    if (kind == PROXY_BAD || (kind == PROXY_CLIENT && !tell(p->client.fd, &address))) {
        refuse(p, "its PROXY header is broken");
        return;
    }
    leave(p);
    accepted_describe(p->client.fd, &p->client);
    p->fn(p->server, &p->client);
    free(p);
}

// Not one byte more than the header is read.
static void readable(struct loop_watch *watch, uint32_t events)
{
    struct proxied *p = (struct proxied *)((char *)watch - offsetof(struct proxied, watch));
    for (;;) {
        size_t want = p->size ? p->size : PROXY_HEADER_FIXED;
        ssize_t n = recv(p->client.fd, p->bytes + p->have, want - p->have, 0);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && (errno == EAGAIN || errno == EWOULDBLOCK)) return;
        if (n <= 0) {
            refuse(p, n ? strerror(errno) : "it closed before its PROXY header was complete");
            return;
        }
        p->have += (size_t)n;
        if (p->have < want) continue;
        if (!p->size && !(p->size = proxy_header_size(p->bytes))) {
            refuse(p, "no PROXY header, version 2: set send-proxy-v2 there, or leave it out of "
                      "--proxies");
            return;
        }
        if (p->have == p->size) break;
    }
    header_is_there(p);
}

static void too_late(struct loop_timer *timer)
{
    refuse((struct proxied *)((char *)timer - offsetof(struct proxied, timer)),
           "no PROXY header within --handshake");
}

bool proxy_peer_take(struct server *server, const struct accepted *client, accepted_fn fn)
{
    struct sockaddr_storage a = {0};
    socklen_t n = sizeof a;
    const char *proxies = server->options.proxies;
    if (!proxies[0] || client->local || client->no_room ||
        getpeername(client->fd, (struct sockaddr *)&a, &n) ||
        !proxy_list_has(proxies, (struct sockaddr *)&a))
        return false;
    struct proxied *p = calloc(1, sizeof *p);
    if (!p) {
        close(client->fd);
        return true;
    }
    p->server = server;
    p->client = *client;
    p->fn = fn;
    p->watch = (struct loop_watch){client->fd, readable};
    p->timer.fire = too_late;
    p->next = waiting;
    waiting = p;
    double wait_s = server->options.handshake;
    loop_timer_set(server->loop, &p->timer,
                   loop_now_ns() + (uint64_t)((wait_s > 0 ? wait_s : 5) * 1e9));
    if (loop_watch_add(server->loop, &p->watch, EPOLLIN)) refuse(p, strerror(errno));
    return true;
}

void proxy_peers_close(struct server *server)
{
    while (waiting) {
        struct proxied *p = waiting;
        leave(p);
        close(p->client.fd);
        free(p);
    }
    free(told);
    told = NULL;
    n_told = 0;
}
