// SPDX-License-Identifier: MIT
// Non-blocking sockets on one epoll descriptor.
#include "serve_client.h"

#include <arpa/inet.h>
#include <errno.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <unistd.h>

enum { BUFFER = 256 << 10, EVENTS = 64 };

static int connect_unix(const char *path)
{
    struct sockaddr_un a = {.sun_family = AF_UNIX};
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC, 0);
    snprintf(a.sun_path, sizeof a.sun_path, "%s", path);
    if (fd >= 0 && !connect(fd, (struct sockaddr *)&a, sizeof a)) return fd;
    if (fd >= 0) close(fd);
    return -1;
}

static int connect_tcp(const char *address, const char *from)
{
    struct sockaddr_in to = {.sin_family = AF_INET}, own = {.sin_family = AF_INET};
    char host[64];
    const char *colon = strrchr(address, ':');
    int one = 1, fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (fd < 0 || !colon) return -1;
    snprintf(host, sizeof host, "%.*s", (int)(colon - address), address);
    to.sin_port = htons((uint16_t)atoi(colon + 1));
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &one, sizeof one);
    bool bound = !from || (inet_pton(AF_INET, from, &own.sin_addr) == 1 &&
                           !bind(fd, (struct sockaddr *)&own, sizeof own));
    if (bound && inet_pton(AF_INET, host, &to.sin_addr) == 1 &&
        !connect(fd, (struct sockaddr *)&to, sizeof to))
        return fd;
    close(fd);
    return -1;
}

static int open_one(struct serve_crowd *crowd, struct serve_client *c, const char *address,
                    const char *from)
{
    static const struct relight_frame_limits limits = {1 << 24, UINT64_C(1) << 32, false};
    c->fd = strncmp(address, "unix:", 5) ? connect_tcp(address + 4, from)
                                         : connect_unix(address + 5);
    if (c->fd < 0)
        return prt_fail(&crowd->env->ctx, PRT_IO, "%s: %s", address, strerror(errno));
    relight_decoder_init(&c->decoder, &limits);
    struct epoll_event e = {.events = EPOLLIN, .data.ptr = c};
    if (epoll_ctl(crowd->epoll_fd, EPOLL_CTL_ADD, c->fd, &e))
        return prt_fail(&crowd->env->ctx, PRT_IO, "epoll: %s", strerror(errno));
    Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
    hello.client = (char *)"prt-bench";
    hello.version_min = hello.version_max = RELIGHT_PROTOCOL_VERSION;
    serve_send(c, RELIGHT_TYPE_HELLO, &hello.base, NULL, 0, 0);
    return PRT_OK;
}

int serve_open(struct bench_env *env, const char *address, const char *from, unsigned n,
               serve_fn answer, void *user, struct serve_crowd *out)
{
    *out = (struct serve_crowd){.env = env, .user = user, .epoll_fd = -1};
    out->client = calloc(n, sizeof *out->client);
    out->epoll_fd = epoll_create1(EPOLL_CLOEXEC);
    if (!out->client || out->epoll_fd < 0)
        return prt_fail(&env->ctx, PRT_NOMEM, "no memory for %u clients", n);
    for (unsigned i = 0; i < n; i++) {
        struct serve_client *c = &out->client[out->n];
        *c = (struct serve_client){.crowd = out, .number = i, .fd = -1};
        out->n++;
        int status = open_one(out, c, address, from);
        if (!status && (i + 1 == n || i % 64 == 63)) status = serve_settle(out, 30);
        if (status) return status;
    }
    out->answer = answer;
    return out->n_gone ? prt_fail(&env->ctx, PRT_IO, "the daemon closed %u of %u connections",
                                  out->n_gone, n)
                       : PRT_OK;
}

void serve_close(struct serve_crowd *crowd)
{
    for (unsigned i = 0; i < crowd->n; i++) {
        struct serve_client *c = &crowd->client[i];
        if (c->fd >= 0) close(c->fd);
        relight_decoder_finish(&c->decoder);
        free(c->out);
    }
    if (crowd->epoll_fd >= 0) close(crowd->epoll_fd);
    free(crowd->client);
    *crowd = (struct serve_crowd){.epoll_fd = -1};
}

static void drop(struct serve_client *c)
{
    if (c->gone) return;
    c->gone = true;
    c->open = 0;
    c->crowd->n_gone++;
    epoll_ctl(c->crowd->epoll_fd, EPOLL_CTL_DEL, c->fd, NULL);
}

static bool make_room(struct serve_client *c, size_t n)
{
    if (c->out_sent == c->out_size) c->out_sent = c->out_size = 0;
    size_t room = c->out_room ? c->out_room : 4096;
    while (room < c->out_size + n) room *= 2;
    uint8_t *out = room > c->out_room ? realloc(c->out, room) : c->out;
    if (!out) return false;
    c->out = out;
    c->out_room = room;
    return true;
}

uint64_t serve_send(struct serve_client *c, uint16_t type, const ProtobufCMessage *message,
                    const void *payload, size_t n_payload, uint32_t deadline_ms)
{
    size_t header = message ? protobuf_c_message_get_packed_size(message) : 0;
    size_t prefix = relight_frame_prefix_size((uint32_t)header, n_payload);
    if (c->gone || !make_room(c, prefix + n_payload)) return 0;
    struct relight_frame frame = {.flags = RELIGHT_FRAME_LAST,
                                  .type = type,
                                  .id = ++c->last_id,
                                  .deadline_ms = deadline_ms,
                                  .header_size = (uint32_t)header,
                                  .payload_size = n_payload};
    uint8_t *at = c->out + c->out_size;
    relight_frame_put_fixed(&frame, at);
    if (header) protobuf_c_message_pack(message, at + RELIGHT_FRAME_FIXED);
    memset(at + RELIGHT_FRAME_FIXED + header, 0, prefix - RELIGHT_FRAME_FIXED - header);
    if (n_payload) memcpy(at + prefix, payload, n_payload);
    c->out_size += prefix + n_payload;
    c->open++;
    c->sent_s[frame.id % SERVE_DEPTH] = prt_time_s();
    return frame.id;
}

static void flush(struct serve_client *c)
{
    while (c->out_sent < c->out_size && !c->gone) {
        ssize_t n = send(c->fd, c->out + c->out_sent, c->out_size - c->out_sent,
                         MSG_NOSIGNAL | MSG_DONTWAIT);
        if (n < 0 && errno != EAGAIN && errno != EINTR) drop(c);
        if (n <= 0) break;
        c->out_sent += (size_t)n;
    }
    bool writing = !c->gone && c->out_sent < c->out_size;
    if (writing == c->writing || c->gone) return;
    struct epoll_event e = {.events = EPOLLIN | (writing ? EPOLLOUT : 0), .data.ptr = c};
    epoll_ctl(c->crowd->epoll_fd, EPOLL_CTL_MOD, c->fd, &e);
    c->writing = writing;
}

static void take_frame(struct serve_client *c)
{
    const struct relight_frame *frame = &c->decoder.frame;
    if (frame->flags & RELIGHT_FRAME_LAST && c->open) c->open--;
    if (c->crowd->answer) c->crowd->answer(c, frame);
}

static void decode(struct serve_client *c, const uint8_t *bytes, size_t n)
{
    for (size_t at = 0; at < n && !c->gone;) {
        size_t used = 0;
        int status = relight_decoder_feed(&c->decoder, bytes + at, n - at, &used);
        at += used;
        if (status < 0) drop(c);
        if (status > 0) take_frame(c);
    }
}

static void receive(struct serve_client *c)
{
    static uint8_t buffer[BUFFER];
    size_t room = 0;
    // Large payloads go to their place without a copy, as in librelight.
    uint8_t *space = relight_decoder_space(&c->decoder, &room);
    bool direct = space && room >= 16 << 10;
    ssize_t n = recv(c->fd, direct ? space : buffer, direct ? room : BUFFER, MSG_DONTWAIT);
    if (n == 0 || (n < 0 && errno != EAGAIN && errno != EINTR)) drop(c);
    if (n <= 0) return;
    if (!direct) {
        decode(c, buffer, (size_t)n);
        return;
    }
    int status = relight_decoder_commit(&c->decoder, (size_t)n);
    if (status < 0) drop(c);
    if (status > 0) take_frame(c);
}

void serve_turn(struct serve_crowd *crowd, int timeout_ms)
{
    struct epoll_event event[EVENTS];
    for (unsigned i = 0; i < crowd->n; i++)
        if (crowd->client[i].out_sent < crowd->client[i].out_size && !crowd->client[i].writing)
            flush(&crowd->client[i]);
    int n = epoll_wait(crowd->epoll_fd, event, EVENTS, timeout_ms);
    for (int i = 0; i < n; i++) {
        struct serve_client *c = event[i].data.ptr;
        if (event[i].events & (EPOLLIN | EPOLLHUP | EPOLLERR) && !c->gone) receive(c);
        if (event[i].events & EPOLLOUT && !c->gone) flush(c);
    }
}

static unsigned n_open(const struct serve_crowd *crowd)
{
    unsigned n = 0;
    for (unsigned i = 0; i < crowd->n; i++) n += crowd->client[i].open;
    return n;
}

int serve_settle(struct serve_crowd *crowd, double seconds)
{
    double begin = prt_time_s();
    while (n_open(crowd) && prt_time_s() - begin < seconds) serve_turn(crowd, 20);
    return n_open(crowd)
               ? prt_fail(&crowd->env->ctx, PRT_IO, "%u requests were not answered in %.0f s",
                          n_open(crowd), seconds)
               : PRT_OK;
}
