// SPDX-License-Identifier: MIT
// TCP and unix sockets: reading into the frame decoder, writing queued frames, refusing
// clients.
#include "net/carrier.h"

#include "core/tls.h"
#include "net/listener.h"
#include "net/request.h"
#include "relight.pb-c.h"

#include <errno.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
    READ_AT_ONCE = 4 << 20, // bytes; then other connections are served
    TURN_NS = 2000000,      // time for one connection's frames; then the same
    BUFFER = 64 << 10,
    MAX_IOV = 32,
    REFUSED_RETRY_MS = 1000,
};

struct stream {
    struct loop_watch watch;
    struct connection *conn;
    struct tls_stream *tls; // NULL: plain text
    bool reading, writing;
    char *rest; // bytes that were read and not decoded: the turn was over
    size_t rest_at, rest_size;
    struct loop_timer again; // continues with them
};

static char buffer[BUFFER];

static void update_events(struct stream *s)
{
    bool read = s->reading, write = s->writing;
    if (s->tls && !tls_stream_ready(s->tls)) read = true, write = false; // the handshake
    if (s->tls && tls_stream_wants_write(s->tls)) write = true;
    uint32_t events = (read ? EPOLLIN : 0) | (write ? EPOLLOUT : 0);
    loop_watch_change(s->conn->server->loop, &s->watch, events);
}

static const char *why_broken(const struct stream *s)
{
    const char *tls = s->tls ? tls_stream_fault(s->tls) : "";
    return tls[0] ? tls : strerror(errno);
}

static void flush(struct stream *s)
{
    struct connection *conn = s->conn;
    for (int round = 0; round < 16; round++) {
        struct iovec iov[MAX_IOV];
        struct msghdr message = {.msg_iov = iov};
        message.msg_iovlen = (size_t)connection_output(conn, iov, MAX_IOV);
        if (!message.msg_iovlen) break;
        ssize_t n = s->tls ? tls_stream_write(s->tls, iov, (int)message.msg_iovlen)
                           : sendmsg(s->watch.fd, &message, MSG_NOSIGNAL | MSG_DONTWAIT);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && errno == EAGAIN) {
            if (s->tls) connection_begun(conn, TLS_RECORD);
            break;
        }
        if (n < 0) {
            connection_close(conn, why_broken(s));
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
        s->writing = true; // the next turn sends all frames that this turn queued in one call
        update_events(s);
    }
}

static void stream_set_reading(struct connection *conn, bool on)
{
    struct stream *s = conn->carrier_data;
    s->reading = on;
    update_events(s);
    if (on && (s->rest || (s->tls && tls_stream_pending(s->tls))))
        loop_timer_set(conn->server->loop, &s->again, loop_now_ns());
}

static void stream_close(struct connection *conn)
{
    struct stream *s = conn->carrier_data;
    loop_watch_remove(conn->server->loop, &s->watch);
    loop_timer_stop(conn->server->loop, &s->again);
    if (s->tls) tls_stream_close(s->tls);
    close(s->watch.fd);
    free(s->rest);
    free(s);
}

// Keeps bytes that were read and not decoded when the turn ended.
static void keep_rest(struct stream *s, const char *bytes, size_t n)
{
    s->rest = malloc(n);
    if (!s->rest) {
        connection_close(s->conn, "not enough memory for its requests");
        return;
    }
    memcpy(s->rest, bytes, n);
    s->rest_at = 0;
    s->rest_size = n;
    loop_timer_set(s->conn->server->loop, &s->again, loop_now_ns());
}

// Returns true when no such bytes are left.
static bool decode_rest(struct stream *s, uint64_t until_ns)
{
    struct connection *conn = s->conn;
    if (!s->rest) return true;
    size_t n =
        connection_bytes(conn, s->rest + s->rest_at, s->rest_size - s->rest_at, until_ns);
    if (conn->dead) return false; // and the stream is freed
    s->rest_at += n;
    if (s->rest_at < s->rest_size && !conn->closing) {
        loop_timer_set(conn->server->loop, &s->again, loop_now_ns());
        return false;
    }
    free(s->rest);
    s->rest = NULL;
    return true;
}

static void receive(struct stream *s)
{
    struct connection *conn = s->conn;
    size_t total = 0;
    uint64_t until_ns = loop_now_ns() + TURN_NS;
    if (!conn->reading || !decode_rest(s, until_ns)) return;
    while (!conn->dead && conn->reading && total < READ_AT_ONCE && loop_now_ns() < until_ns) {
        // Large payloads are read into their own buffer, small frames share one read.
        size_t room = 0;
        uint8_t *space = relight_decoder_space(&conn->decoder, &room);
        bool direct = space && room >= BUFFER;
        size_t want = direct ? (room < READ_AT_ONCE ? room : READ_AT_ONCE) : BUFFER;
        char *to = direct ? (char *)space : buffer;
        ssize_t n = s->tls ? tls_stream_read(s->tls, to, want)
                           : recv(s->watch.fd, to, want, MSG_DONTWAIT);
        if (n < 0 && errno == EINTR) continue;
        if (n < 0 && errno == EAGAIN) {
            if (s->tls) update_events(s);
            return;
        }
        if (n <= 0) {
            connection_close(conn, n ? why_broken(s) : "closed by peer");
            return;
        }
        total += (size_t)n;
        if (direct) {
            connection_committed(conn, (size_t)n,
                                 relight_decoder_commit(&conn->decoder, (size_t)n));
            continue;
        }
        size_t done = connection_bytes(conn, buffer, (size_t)n, until_ns);
        if (conn->dead || conn->closing) return;
        if (done < (size_t)n) {
            keep_rest(s, buffer + done, (size_t)n - done);
            return;
        }
    }
    // Bytes that were taken from the socket already are not reported by it.
    if (!conn->dead && conn->reading && s->tls && tls_stream_pending(s->tls))
        loop_timer_set(conn->server->loop, &s->again, loop_now_ns());
}

static void receive_again(struct loop_timer *timer)
{
    receive((struct stream *)((char *)timer - offsetof(struct stream, again)));
}

static void stream_ready(struct loop_watch *watch, uint32_t events)
{
    struct stream *s = (struct stream *)((char *)watch - offsetof(struct stream, watch));
    struct connection *conn = s->conn;
    bool read = events & EPOLLIN || (s->tls && tls_stream_wants_write(s->tls));
    if (read) receive(s);
    if (!conn->dead && events & EPOLLOUT) flush(s);
    if (!conn->dead && events & (EPOLLERR | EPOLLHUP) && !(events & EPOLLIN))
        connection_close(conn, "closed by peer");
}

static size_t stream_unsent(const struct connection *conn)
{
    const struct stream *s = conn->carrier_data;
    return socket_unsent(s->watch.fd);
}

static const struct carrier tcp_carrier = {"tcp", stream_want_write, stream_set_reading,
                                           stream_close, stream_unsent};
static const struct carrier tls_carrier = {"tls", stream_want_write, stream_set_reading,
                                           stream_close, stream_unsent};
static const struct carrier unix_carrier = {"unix", stream_want_write, stream_set_reading,
                                            stream_close, stream_unsent};

int refusal_frame(const struct server *server, const char *text, uint8_t **out, size_t *n)
{
    Relight__Error error;
    struct error_fields fields;
    error_fill(&error,
               server->draining ? RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN
                                : RELIGHT__ERROR_CODE__ERROR_BUSY,
               server->draining ? "the daemon is stopping" : text, &fields);
    error.retry_after_ms = REFUSED_RETRY_MS;
    struct relight_frame frame = {.type = RELIGHT_TYPE_ERROR, .flags = RELIGHT_FRAME_LAST};
    return relight_frame_pack(&frame, &error.base, 0, 0, out, n);
}

// Sends the error and closes. Received bytes are read first: closing a TCP socket with unread
// bytes resets the connection, and the client may lose the error.
static void refuse(struct server *server, int fd, const char *text, bool tls)
{
    uint8_t *bytes = NULL;
    size_t n = 0;
    server->stats.connections_refused++;
    // The ERROR of a TLS client would have to wait for the handshake.
    if (!tls && !refusal_frame(server, text, &bytes, &n) &&
        send(fd, bytes, n, MSG_NOSIGNAL | MSG_DONTWAIT) >= 0) {
        shutdown(fd, SHUT_WR);
        while (recv(fd, buffer, sizeof buffer, MSG_DONTWAIT) > 0) continue;
    }
    free(bytes);
    close(fd);
}

static void accepted(struct server *server, const struct accepted *client)
{
    if (client->no_room || server->draining ||
        server->n_connection >= server->options.connections) {
        refuse(server, client->fd,
               client->no_room ? "the daemon is out of file descriptors"
                               : "the daemon is at its limit of connections (--connections)",
               client->tls);
        return;
    }
    struct stream *s = calloc(1, sizeof *s);
    const struct carrier *carrier = client->local ? &unix_carrier
                                    : client->tls ? &tls_carrier
                                                  : &tcp_carrier;
    if (s && client->tls) s->tls = tls_stream_open(server->tls, client->fd);
    if (s && (s->tls || !client->tls)) {
        s->watch = (struct loop_watch){client->fd, stream_ready};
        s->again.fire = receive_again;
        s->reading = true;
        s->conn = connection_open(server, carrier, s, client->peer, client->who);
    }
    if (!s || !s->conn) {
        if (s && s->tls) tls_stream_close(s->tls);
        free(s);
        refuse(server, client->fd, "this connection exceeds a limit", client->tls);
    } else if (loop_watch_add(server->loop, &s->watch, EPOLLIN)) {
        connection_close(s->conn, "epoll refused its descriptor");
    }
}

int sockets_listen(struct server *server, const char *address)
{
    return !strncmp(address, "unix:", 5)
               ? listener_open_unix(server, address + 5, accepted)
               : listener_open_tcp(server, !strncmp(address, "tls:", 4) ? "tls" : "tcp",
                                   address + 4, accepted);
}

int sockets_adopt(struct server *server, int fd)
{
    return listener_adopt(server, fd, accepted);
}

void sockets_close(struct server *server)
{
    listeners_close(server, accepted);
}
