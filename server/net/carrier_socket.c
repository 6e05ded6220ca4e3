// SPDX-License-Identifier: MIT
// TCP and unix sockets: accepting, reading into the frame decoder, writing what is queued.
#include "net/carrier.h"

#include "core/log.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/file.h>
#include <sys/socket.h>
#include <sys/stat.h>
#include <sys/un.h>
#include <unistd.h>

enum {
    READ_AT_ONCE = 4 << 20, // then others get their turn
    BUFFER = 64 << 10,
    MAX_IOV = 32,
};

struct listener {
    struct listener *next;
    struct loop_watch watch;
    struct server *server;
    char path[sizeof((struct sockaddr_un *)0)->sun_path]; // unix sockets
    int lock_fd;
};

struct stream {
    struct loop_watch watch;
    struct connection *conn;
    bool reading, writing;
};

static struct listener *listeners;
static char buffer[BUFFER];

static void update_events(struct stream *s)
{
    uint32_t events = (s->reading ? EPOLLIN : 0) | (s->writing ? EPOLLOUT : 0);
    loop_watch_change(s->conn->server->loop, &s->watch, events);
}

static void flush(struct stream *s)
{
    struct connection *conn = s->conn;
    for (int round = 0; round < 16; round++) {
        struct iovec iov[MAX_IOV];
        struct msghdr message = {.msg_iov = iov};
        message.msg_iovlen = (size_t)connection_output(conn, iov, MAX_IOV);
        if (!message.msg_iovlen) break;
        ssize_t n = sendmsg(s->watch.fd, &message, MSG_NOSIGNAL | MSG_DONTWAIT);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && errno == EAGAIN) break;
        if (n < 0) {
            connection_close(conn, strerror(errno));
            return;
        }
        connection_written(conn, (size_t)n);
        if (conn->dead) return;
    }
    bool writing = conn->out != NULL;
    if (writing != s->writing) {
        s->writing = writing;
        update_events(s);
    }
}

static void stream_want_write(struct connection *conn)
{
    struct stream *s = conn->carrier_data;
    if (!s->writing) {
        s->writing = true; // the next turn sends what this turn queued, in one call
        update_events(s);
    }
}

static void stream_set_reading(struct connection *conn, bool on)
{
    struct stream *s = conn->carrier_data;
    s->reading = on;
    update_events(s);
}

static void stream_close(struct connection *conn)
{
    struct stream *s = conn->carrier_data;
    loop_watch_remove(conn->server->loop, &s->watch);
    close(s->watch.fd);
    free(s);
}

static void receive(struct stream *s)
{
    struct connection *conn = s->conn;
    size_t total = 0;
    while (!conn->dead && conn->reading && total < READ_AT_ONCE) {
        // Large payloads go straight to where they belong, small frames share one read.
        size_t room = 0;
        uint8_t *space = relight_decoder_space(&conn->decoder, &room);
        bool direct = space && room >= BUFFER;
        size_t want = direct ? (room < READ_AT_ONCE ? room : READ_AT_ONCE) : BUFFER;
        ssize_t n = recv(s->watch.fd, direct ? (char *)space : buffer, want, MSG_DONTWAIT);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && errno == EAGAIN) return;
        if (n <= 0) {
            connection_close(conn, n ? strerror(errno) : "closed by peer");
            return;
        }
        total += (size_t)n;
        if (direct)
            connection_committed(conn, (size_t)n,
                                 relight_decoder_commit(&conn->decoder, (size_t)n));
        else connection_bytes(conn, buffer, (size_t)n);
    }
}

static void stream_ready(struct loop_watch *watch, uint32_t events)
{
    struct stream *s = (struct stream *)((char *)watch - offsetof(struct stream, watch));
    struct connection *conn = s->conn;
    if (events & EPOLLIN) receive(s);
    if (!conn->dead && events & EPOLLOUT) flush(s);
    if (!conn->dead && events & (EPOLLERR | EPOLLHUP) && !(events & EPOLLIN))
        connection_close(conn, "closed by peer");
}

static const struct carrier tcp_carrier = {"tcp", stream_want_write, stream_set_reading,
                                           stream_close};
static const struct carrier unix_carrier = {"unix", stream_want_write, stream_set_reading,
                                            stream_close};

static void refuse(int fd)
{
    // An error frame without a header tells any client at least that it was this protocol.
    uint8_t bytes[RELIGHT_FRAME_FIXED];
    struct relight_frame frame = {.type = RELIGHT_TYPE_ERROR, .flags = RELIGHT_FRAME_LAST};
    relight_frame_put_fixed(&frame, bytes);
    if (send(fd, bytes, sizeof bytes, MSG_NOSIGNAL | MSG_DONTWAIT) < 0) errno = 0;
    close(fd);
}

static void name_peer(const struct sockaddr_storage *a, socklen_t n, char *out, size_t room)
{
    char host[64], port[16];
    if (a->ss_family == AF_UNIX ||
        getnameinfo((const struct sockaddr *)a, n, host, sizeof host, port, sizeof port,
                    NI_NUMERICHOST | NI_NUMERICSERV))
        snprintf(out, room, "local");
    else snprintf(out, room, "%s:%s", host, port);
}

// The principal until HELLO names another: a local user, or an address without its port.
static void name_principal(int fd, const struct sockaddr_storage *a, socklen_t n, char who[96])
{
    char host[64];
    struct ucred peer;
    socklen_t size = sizeof peer;
    if (a->ss_family == AF_UNIX && !getsockopt(fd, SOL_SOCKET, SO_PEERCRED, &peer, &size))
        snprintf(who, 96, "uid:%u", (unsigned)peer.uid);
    else if (a->ss_family != AF_UNIX && !getnameinfo((const struct sockaddr *)a, n, host,
                                                     sizeof host, NULL, 0, NI_NUMERICHOST))
        snprintf(who, 96, "addr:%s", host);
    else snprintf(who, 96, "unknown");
}

static void accept_ready(struct loop_watch *watch, uint32_t events)
{
    struct listener *l = (struct listener *)((char *)watch - offsetof(struct listener, watch));
    struct server *server = l->server;
    for (int i = 0; i < 64; i++) {
        struct sockaddr_storage address = {0};
        socklen_t size = sizeof address;
        int fd = accept4(watch->fd, (struct sockaddr *)&address, &size,
                         SOCK_NONBLOCK | SOCK_CLOEXEC);
        if (fd < 0 && errno == EINTR) continue;
        if (fd < 0) {
            if (errno != EAGAIN) log_line(LOG_WARN, "accept error=\"%s\"", strerror(errno));
            return;
        }
        if (server->n_connection >= server->options.connections || server->draining) {
            server->stats.connections_refused++;
            refuse(fd);
            continue;
        }
        char peer[96], who[96];
        name_peer(&address, size, peer, sizeof peer);
        name_principal(fd, &address, size, who);
        bool local = address.ss_family == AF_UNIX;
        int one = 1;
        if (!local) setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
        struct stream *s = calloc(1, sizeof *s);
        if (!s) {
            close(fd);
            continue;
        }
        s->watch = (struct loop_watch){fd, stream_ready};
        s->reading = true;
        s->conn = connection_open(server, local ? &unix_carrier : &tcp_carrier, s, peer, who);
        if (!s->conn) {
            close(fd);
            free(s);
        } else if (loop_watch_add(server->loop, &s->watch, EPOLLIN)) {
            connection_close(s->conn, "cannot be watched");
        }
    }
}

static int add_listener(struct server *server, int fd, const char *path, int lock_fd)
{
    struct listener *l = calloc(1, sizeof *l);
    if (!l) return -1;
    l->watch = (struct loop_watch){fd, accept_ready};
    l->server = server;
    l->lock_fd = lock_fd;
    if (path) snprintf(l->path, sizeof l->path, "%s", path);
    l->next = listeners;
    listeners = l;
    return loop_watch_add(server->loop, &l->watch, EPOLLIN) ? -1 : 0;
}

static int listen_unix(struct server *server, const char *path)
{
    struct sockaddr_un address = {.sun_family = AF_UNIX};
    if (strlen(path) >= sizeof address.sun_path) {
        log_line(LOG_ERR, "listen unix:%s: the path is longer than %zu bytes", path,
                 sizeof address.sun_path - 1);
        return -1;
    }
    strcpy(address.sun_path, path);
    // Who holds the lock owns the socket file; a dead daemon holds none.
    char lock_path[sizeof address.sun_path + 8];
    snprintf(lock_path, sizeof lock_path, "%s.lock", path);
    int lock_fd = open(lock_path, O_CREAT | O_RDWR | O_CLOEXEC, 0600);
    if (lock_fd < 0) {
        log_line(LOG_ERR, "listen unix:%s: %s: %s", path, lock_path, strerror(errno));
        return -1;
    }
    if (flock(lock_fd, LOCK_EX | LOCK_NB)) {
        log_line(LOG_ERR, "listen unix:%s: another relightd serves this socket", path);
        close(lock_fd);
        return -1;
    }
    struct stat st;
    if (!lstat(path, &st) && !S_ISSOCK(st.st_mode)) {
        log_line(LOG_ERR, "listen unix:%s: there is a file of this name and it is no socket",
                 path);
        close(lock_fd);
        return -1;
    }
    unlink(path);
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
    if (fd < 0 || bind(fd, (struct sockaddr *)&address, sizeof address) || listen(fd, 256)) {
        log_line(LOG_ERR, "listen unix:%s: %s", path, strerror(errno));
        if (fd >= 0) close(fd);
        close(lock_fd);
        return -1;
    }
    log_line(LOG_EVENT, "listen address=unix:%s", path);
    return add_listener(server, fd, path, lock_fd);
}

static int listen_tcp(struct server *server, const char *text)
{
    char host[256];
    const char *colon = strrchr(text, ':');
    size_t n = (size_t)(colon - text);
    if (text[0] == '[' && n >= 2 && text[n - 1] == ']') // [::1]:7413
        snprintf(host, sizeof host, "%.*s", (int)n - 2, text + 1);
    else snprintf(host, sizeof host, "%.*s", (int)n, text);
    struct addrinfo hints = {.ai_flags = AI_PASSIVE, .ai_socktype = SOCK_STREAM}, *list;
    int err = getaddrinfo(*host && strcmp(host, "*") ? host : NULL, colon + 1, &hints, &list);
    if (err) {
        log_line(LOG_ERR, "listen tcp:%s: %s", text, gai_strerror(err));
        return -1;
    }
    int n_open = 0, fault = 0;
    for (struct addrinfo *a = list; a; a = a->ai_next) {
        int one = 1, fd = socket(a->ai_family, SOCK_STREAM | SOCK_NONBLOCK | SOCK_CLOEXEC, 0);
        if (fd < 0) {
            fault = errno;
            continue;
        }
        setsockopt(fd, SOL_SOCKET, SO_REUSEADDR, &one, sizeof one);
        if (a->ai_family == AF_INET6)
            setsockopt(fd, IPPROTO_IPV6, IPV6_V6ONLY, &one, sizeof one);
        if (bind(fd, a->ai_addr, a->ai_addrlen) || listen(fd, 256)) {
            fault = errno;
            close(fd);
            continue;
        }
        // Port 0 asks for any: the log says which it became.
        struct sockaddr_storage bound;
        socklen_t size = sizeof bound;
        char name[96] = "?";
        if (!getsockname(fd, (struct sockaddr *)&bound, &size))
            name_peer(&bound, size, name, sizeof name);
        log_line(LOG_EVENT, "listen address=tcp:%s", name);
        if (!add_listener(server, fd, NULL, -1)) n_open++;
    }
    freeaddrinfo(list);
    if (!n_open) log_line(LOG_ERR, "listen tcp:%s: %s", text, strerror(fault));
    return n_open ? 0 : -1;
}

int sockets_listen(struct server *server, const char *address)
{
    return !strncmp(address, "unix:", 5) ? listen_unix(server, address + 5)
                                         : listen_tcp(server, address + 4);
}

int sockets_adopt(struct server *server, int fd)
{
    fcntl(fd, F_SETFL, fcntl(fd, F_GETFL) | O_NONBLOCK);
    fcntl(fd, F_SETFD, FD_CLOEXEC);
    log_line(LOG_EVENT, "listen address=inherited:%d", fd);
    return add_listener(server, fd, NULL, -1);
}

void sockets_close(struct server *server)
{
    while (listeners) {
        struct listener *l = listeners;
        listeners = l->next;
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
}
