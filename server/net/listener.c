// SPDX-License-Identifier: MIT
// Listening sockets: resolving, binding, logging and accepting for every carrier.
#include "net/listener.h"

#include "core/access.h"
#include "core/address.h"
#include "core/log.h"
#include "net/proxy_peer.h"

#include <errno.h>
#include <fcntl.h>
#include <linux/sockios.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/file.h>
#include <sys/ioctl.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

enum {
    BACKLOG = 256,
    ACCEPT_AT_ONCE = 64, // clients; then other descriptors are served
    REFUSE_AT_ONCE = 16, // clients refused with the reserve descriptor before a pause
    PAUSE_MIN_MS = 100,
    PAUSE_MAX_MS = 1000,
    LOG_EVERY_S = 10, // seconds between two lines about missing descriptors
};

struct listener {
    struct listener *next;
    struct loop_watch watch;
    struct loop_timer pause;
    unsigned pause_ms;
    struct server *server;
    accepted_fn fn;
    bool tls;
    char path[sizeof((struct sockaddr_un *)0)->sun_path]; // unix sockets
    int lock_fd;
};

static struct listener *listeners;
static int reserve_fd =
    -1; // closed in order to accept and refuse a client without free descriptors
static uint64_t logged_ns;

void accepted_describe(int fd, struct accepted *client)
{
    struct sockaddr_storage a = {0};
    socklen_t n = sizeof a;
    struct ucred user;
    socklen_t size = sizeof user;
    char host[64];
    client->fd = fd;
    snprintf(client->peer, sizeof client->peer, "?");
    snprintf(client->who, sizeof client->who, "unknown");
    if (proxy_peer_name(fd, &a, &n)) return;
    client->local = a.ss_family == AF_UNIX;
    address_name(&a, n, client->peer, sizeof client->peer);
    if (client->local && !getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &user, &size))
        snprintf(client->who, sizeof client->who, "uid:%u", (unsigned)user.uid);
    else if (!client->local && !getnameinfo((const struct sockaddr *)&a, n, host, sizeof host,
                                            NULL, 0, NI_NUMERICHOST))
        snprintf(client->who, sizeof client->who, "addr:%s", host);
}

void accepted_tune(int fd)
{
    int one = 1, idle = 60, interval = 10, probes = 3;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    setsockopt(fd, SOL_SOCKET, SO_KEEPALIVE, &one, sizeof one);
    setsockopt(fd, IPPROTO_TCP, TCP_KEEPIDLE, &idle, sizeof idle);
    setsockopt(fd, IPPROTO_TCP, TCP_KEEPINTVL, &interval, sizeof interval);
    setsockopt(fd, IPPROTO_TCP, TCP_KEEPCNT, &probes, sizeof probes);
}

size_t socket_unsent(int fd)
{
    int n = 0;
    return ioctl(fd, SIOCOUTQ, &n) || n < 0 ? 0 : (size_t)n;
}

// ---- accepting

static void keep_reserve(void)
{
    if (reserve_fd < 0) reserve_fd = open("/dev/null", O_RDONLY | O_CLOEXEC);
}

static int accept_one(const struct listener *l)
{
    int fd;
    do fd = accept4(l->watch.fd, NULL, NULL, SOCK_NONBLOCK | SOCK_CLOEXEC);
    while (fd < 0 && (errno == EINTR || errno == ECONNABORTED));
    return fd;
}

static void hand_over(const struct listener *l, int fd, bool no_room)
{
    struct accepted client = {.no_room = no_room, .tls = l->tls};
    proxy_peer_forget(fd);
    accepted_describe(fd, &client);
    if (!client.local) accepted_tune(fd);
    if (!proxy_peer_take(l->server, &client, l->fn)) l->fn(l->server, &client);
}

// The listener is level-triggered: it would be reported without end while nothing can be
// accepted.
static void pause_accepting(struct listener *l, int fault)
{
    uint64_t now = loop_now_ns();
    if (!logged_ns || now - logged_ns >= LOG_EVERY_S * UINT64_C(1000000000)) {
        logged_ns = now;
        log_line(LOG_WARN,
                 "accept error=\"%s\" connections=%u: clients wait or are refused; raise the "
                 "limit on open files (LimitNOFILE=, ulimit -n) or lower --connections",
                 strerror(fault), l->server->n_connection);
    }
    l->pause_ms = l->pause_ms ? 2 * l->pause_ms : PAUSE_MIN_MS;
    if (l->pause_ms > PAUSE_MAX_MS) l->pause_ms = PAUSE_MAX_MS;
    loop_watch_change(l->server->loop, &l->watch, 0);
    loop_timer_set(l->server->loop, &l->pause, now + l->pause_ms * UINT64_C(1000000));
}

static void pause_over(struct loop_timer *timer)
{
    struct listener *l = (struct listener *)((char *)timer - offsetof(struct listener, pause));
    loop_watch_change(l->server->loop, &l->watch, EPOLLIN);
}

static void refuse_some(struct listener *l)
{
    for (int i = 0; i < REFUSE_AT_ONCE && reserve_fd >= 0; i++) {
        close(reserve_fd);
        reserve_fd = -1;
        int fd = accept_one(l);
        if (fd >= 0) hand_over(l, fd, true);
        keep_reserve();
        if (fd < 0) return;
    }
}

static void accept_ready(struct loop_watch *watch, uint32_t events)
{
    struct listener *l = (struct listener *)((char *)watch - offsetof(struct listener, watch));
    keep_reserve();
    for (int i = 0; i < ACCEPT_AT_ONCE; i++) {
        int fd = accept_one(l), fault = errno;
        if (fd >= 0) {
            l->pause_ms = 0;
            hand_over(l, fd, false);
        } else if (fault == EMFILE || fault == ENFILE || fault == ENOBUFS || fault == ENOMEM) {
            if (fault == EMFILE || fault == ENFILE) refuse_some(l);
            pause_accepting(l, fault);
            return;
        } else {
            if (fault != EAGAIN) log_line(LOG_WARN, "accept error=\"%s\"", strerror(fault));
            return;
        }
    }
}

static int add_listener(struct server *server, int fd, const char *path, int lock_fd, bool tls,
                        accepted_fn fn)
{
    struct listener *l = calloc(1, sizeof *l);
    if (!l) return -1;
    l->watch = (struct loop_watch){fd, accept_ready};
    l->pause.fire = pause_over;
    l->server = server;
    l->fn = fn;
    l->lock_fd = lock_fd;
    l->tls = tls;
    if (path) snprintf(l->path, sizeof l->path, "%s", path);
    l->next = listeners;
    listeners = l;
    keep_reserve();
    return loop_watch_add(server->loop, &l->watch, EPOLLIN) ? -1 : 0;
}

// ---- opening

// Binds one address; the descriptor, or -1 with errno set.
static int bind_one(const struct addrinfo *a)
{
    int one = 1, fd = socket(a->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd < 0) return -1;
    setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
    if (a->ai_family == AF_INET6) setsockopt(fd, IPPROTO_IPV6, IPV6_V6ONLY, &one, sizeof one);
    if (!bind(fd, a->ai_addr, a->ai_addrlen) && !listen(fd, BACKLOG)) return fd;
    int fault = errno;
    close(fd);
    errno = fault;
    return -1;
}

static in_port_t port_of(const struct sockaddr_storage *a)
{
    return a->ss_family == AF_INET6 ? ((const struct sockaddr_in6 *)a)->sin6_port
                                    : ((const struct sockaddr_in *)a)->sin_port;
}

static void set_port(struct sockaddr *a, in_port_t port)
{
    if (a->sa_family == AF_INET6) ((struct sockaddr_in6 *)a)->sin6_port = port;
    else ((struct sockaddr_in *)a)->sin_port = port;
}

static void warn_of_anyone(const struct options *options, const struct sockaddr *address,
                           const char *name)
{
    if (!access_configured(options) && !address_is_loopback(address))
        log_line(LOG_WARN,
                 "listen %s: every machine that reaches this address may use this "
                 "daemon (--accept-anyone)",
                 name);
}

static bool speaks_tls(const struct server *server, const struct sockaddr *address,
                       const char *kind)
{
    return server->tls && (server->options.tls_loopback || !strcmp(kind, "tls") ||
                           !address_is_loopback(address));
}

static const char *tls_kind(const char *kind, bool tls)
{
    if (!tls) return kind;
    return strcmp(kind, "http") ? "tls" : "https";
}

int listener_open_tcp(struct server *server, const char *kind, const char *address,
                      accepted_fn fn)
{
    struct addrinfo *list;
    char why[256];
    if (address_resolve(&server->options, address, &list, why)) {
        log_line(LOG_ERR, "listen %s:%s: %s", kind, address, why);
        return -1;
    }
    int n_open = 0, fault = 0;
    in_port_t chosen = 0; // port 0: a free one, the same for every address of the host
    for (struct addrinfo *a = list; a; a = a->ai_next) {
        if (chosen) set_port(a->ai_addr, chosen);
        int fd = bind_one(a);
        if (fd < 0) {
            fault = errno;
            // A host without IPv6 has no ::1, which is no error; an address in use is one.
            if (fault == EAFNOSUPPORT || fault == EADDRNOTAVAIL) continue;
            n_open = 0;
            break;
        }
        struct sockaddr_storage bound;
        socklen_t size = sizeof bound;
        char name[96] = "?";
        if (!getsockname(fd, (struct sockaddr *)&bound, &size)) {
            address_name(&bound, size, name, sizeof name);
            chosen = port_of(&bound);
        }
        bool tls = speaks_tls(server, a->ai_addr, kind);
        log_line(LOG_EVENT, "listen address=%s:%s", tls_kind(kind, tls), name);
        warn_of_anyone(&server->options, a->ai_addr, name);
        if (!add_listener(server, fd, NULL, -1, tls, fn)) n_open++;
    }
    freeaddrinfo(list);
    if (!n_open) log_line(LOG_ERR, "listen %s:%s: %s", kind, address, strerror(fault));
    return n_open ? 0 : -1;
}

// The holder of the lock owns the socket file; the lock of a dead daemon is free. The lock file
// is next to the socket, possibly in /tmp: links are not followed, and the daemon's user must
// own it.
static int lock_socket(const char *path, char fault[256])
{
    char lock_path[sizeof((struct sockaddr_un *)0)->sun_path + 8];
    struct stat st;
    snprintf(lock_path, sizeof lock_path, "%s.lock", path);
    int fd = open(lock_path, O_CREAT | O_RDWR | O_CLOEXEC | O_NOFOLLOW | O_NONBLOCK, 0600);
    if (fd < 0) {
        snprintf(fault, 256, "%s: %s", lock_path,
                 errno == ELOOP ? "a link, which is not followed: remove it" : strerror(errno));
        return -1;
    }
    if (fstat(fd, &st) || !S_ISREG(st.st_mode) || st.st_uid != geteuid())
        snprintf(fault, 256,
                 "%s: this file belongs to another user: remove it, or choose a folder "
                 "that others cannot write to",
                 lock_path);
    else if (flock(fd, LOCK_EX | LOCK_NB) || fstat(fd, &st) || !st.st_nlink)
        snprintf(fault, 256, "another relightd serves this socket");
    else return fd;
    close(fd);
    return -1;
}

// The socket's descriptor, or -1. Clients cannot connect before its mode and group are set.
static int bind_unix(const struct options *options, const char *path, char fault[256])
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    struct stat st;
    gid_t group;
    strcpy(address.sun_path, path);
    if (address_group(options->socket_group, &group, fault)) return -1;
    if (!lstat(path, &st) && !S_ISSOCK(st.st_mode)) {
        snprintf(fault, 256, "a file of this name exists and is not a socket");
        return -1;
    }
    unlink(path);
    mode_t mode = (mode_t)strtoul(options->socket_mode, NULL, 8);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd >= 0 && !fchmod(fd, 0) && !bind(fd, (struct sockaddr *)&address, sizeof address) &&
        (group == (gid_t)-1 || !chown(path, (uid_t)-1, group)) && !chmod(path, mode) &&
        !listen(fd, BACKLOG))
        return fd;
    snprintf(fault, 256, "%s", strerror(errno));
    if (fd >= 0) close(fd);
    return -1;
}

int listener_open_unix(struct server *server, const char *path, accepted_fn fn)
{
    char address[300], fault[256];
    snprintf(address, sizeof address, "unix:%s", path);
    int lock_fd = -1, fd = -1;
    if (!address_check(&server->options, address, fault) &&
        (lock_fd = lock_socket(path, fault)) >= 0)
        fd = bind_unix(&server->options, path, fault);
    if (fd < 0) {
        log_line(LOG_ERR, "listen unix:%s: %s", path, fault);
        if (lock_fd >= 0) close(lock_fd);
        return -1;
    }
    log_line(LOG_EVENT, "listen address=unix:%s", path);
    return add_listener(server, fd, path, lock_fd, false, fn);
}

int listener_adopt(struct server *server, int fd, accepted_fn fn)
{
    struct sockaddr_storage a = {0};
    socklen_t n = sizeof a;
    const struct options *o = &server->options;
    if (getsockname(fd, (struct sockaddr *)&a, &n)) {
        log_line(LOG_ERR, "listen inherited:%d: %s", fd, strerror(errno));
        return -1;
    }
    char fault[256];
    if (address_admit(o, (struct sockaddr *)&a, fault)) {
        log_line(LOG_ERR, "listen inherited:%d: %s", fd, fault);
        return -1;
    }
    warn_of_anyone(o, (struct sockaddr *)&a, "inherited");
    fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
    fcntl(fd, F_SETFD, FD_CLOEXEC);
    bool tls = a.ss_family != AF_UNIX && speaks_tls(server, (struct sockaddr *)&a, "tcp");
    log_line(LOG_EVENT, "listen address=inherited:%d%s", fd, tls ? " tls" : "");
    return add_listener(server, fd, NULL, -1, tls, fn);
}

void listeners_close(struct server *server, accepted_fn fn)
{
    for (struct listener **at = &listeners, *l; (l = *at);) {
        if (l->fn != fn) {
            at = &l->next;
            continue;
        }
        *at = l->next;
        loop_timer_stop(server->loop, &l->pause);
        loop_watch_remove(server->loop, &l->watch);
        close(l->watch.fd);
        if (l->path[0]) {
            char lock_path[sizeof l->path + 8];
            snprintf(lock_path, sizeof lock_path, "%s.lock", l->path);
            unlink(l->path);
            unlink(lock_path);
            close(l->lock_fd);
        }
        free(l);
    }
    if (!listeners && reserve_fd >= 0) {
        close(reserve_fd);
        reserve_fd = -1;
    }
}
