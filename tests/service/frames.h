// SPDX-License-Identifier: MIT
// A connection by hand: any sequence of frames in one write, and whatever comes back. The
// client library would refuse to send most of it.
#ifndef TESTS_SERVICE_FRAMES_H
#define TESTS_SERVICE_FRAMES_H

#include "daemon.h"
#include "frame.h"
#include "relight.pb-c.h"

struct frames {
    int fd;
    uint8_t *bytes; // to be sent
    size_t n;
    struct relight_decoder decoder;
    uint8_t in[1 << 16];
    size_t at, end;
};

static inline void frames_add(struct frames *f, uint16_t type, uint64_t id,
                              const ProtobufCMessage *message, const void *payload, size_t n)
{
    struct relight_frame frame = {
        .flags = RELIGHT_FRAME_LAST, .type = type, .id = id, .payload_size = n};
    uint8_t *head;
    size_t size;
    assert_int_equal(relight_frame_pack(&frame, message, 0, 0, &head, &size), 0);
    f->bytes = realloc(f->bytes, f->n + size + n);
    assert_non_null(f->bytes);
    memcpy(f->bytes + f->n, head, size);
    if (n) memcpy(f->bytes + f->n + size, payload, n);
    f->n += size + n;
    free(head);
}

// The same with a header as it stands.
static inline void frames_add_raw(struct frames *f, uint16_t type, uint64_t id,
                                  const void *header, size_t n)
{
    struct relight_frame frame = {
        .flags = RELIGHT_FRAME_LAST, .type = type, .id = id, .header_size = (uint32_t)n};
    f->bytes = realloc(f->bytes, f->n + RELIGHT_FRAME_FIXED + n);
    assert_non_null(f->bytes);
    relight_frame_put_fixed(&frame, f->bytes + f->n);
    if (n) memcpy(f->bytes + f->n + RELIGHT_FRAME_FIXED, header, n);
    f->n += RELIGHT_FRAME_FIXED + n;
}

// All that was added, in one write where the socket takes it. False when the peer closed.
static inline bool frames_try_send(struct frames *f)
{
    size_t at = 0;
    while (at < f->n) {
        ssize_t n = send(f->fd, f->bytes + at, f->n - at, MSG_NOSIGNAL);
        if (n <= 0) break;
        at += (size_t)n;
    }
    bool all = at == f->n;
    f->n = 0;
    return all;
}

static inline void frames_send(struct frames *f)
{
    if (!frames_try_send(f)) fail_msg("send: %s", strerror(errno));
}

// One answer's type, id, code (of an ERROR, else 0), text and size of its payload, whose bytes
// stand in frames.decoder.frame.payload until the next one.
struct frames_answer {
    uint16_t type;
    uint64_t id, payload;
    int code;
    char text[512];
    bool last, closed; // closed: no answer came, the connection ended
};

// False when nothing came in time; its message is kept for the caller where `message` is not
// NULL.
static inline bool frames_next(struct frames *f, struct frames_answer *out, int ms,
                               ProtobufCMessage **message)
{
    memset(out, 0, sizeof *out);
    for (;;) {
        size_t used = 0;
        int status = relight_decoder_feed(&f->decoder, f->in + f->at, f->end - f->at, &used);
        f->at += used;
        assert_true(status >= 0);
        if (status) break;
        struct pollfd p = {f->fd, POLLIN, 0};
        if (poll(&p, 1, ms) <= 0) return false;
        ssize_t n = recv(f->fd, f->in, sizeof f->in, 0);
        f->at = 0;
        f->end = n > 0 ? (size_t)n : 0;
        if (n <= 0) {
            out->closed = true;
            return true;
        }
    }
    const struct relight_frame *frame = &f->decoder.frame;
    out->type = frame->type;
    out->id = frame->id;
    out->payload = frame->payload_size;
    out->last = frame->flags & RELIGHT_FRAME_LAST;
    ProtobufCMessage *m = relight_frame_unpack(frame);
    assert_non_null(m);
    if (frame->type == RELIGHT_TYPE_ERROR) {
        out->code = (int)((Relight__Error *)m)->code;
        snprintf(out->text, sizeof out->text, "%s", ((Relight__Error *)m)->text);
    }
    if (message) *message = m;
    else protobuf_c_message_free_unpacked(m, NULL);
    return true;
}

// The last answer of this id; answers of other ids before it are dropped.
static inline struct frames_answer frames_wait(struct frames *f, uint64_t id)
{
    struct frames_answer a;
    do {
        if (!frames_next(f, &a, 20000, NULL))
            fail_msg("no answer to %llu", (unsigned long long)id);
        if (a.closed) fail_msg("closed before %llu was answered", (unsigned long long)id);
    } while (a.id != id || !a.last);
    return a;
}

// token: its text; NULL: the user of the socket.
static inline void frames_add_hello_as(struct frames *f, const char *client, const char *token)
{
    Relight__HelloRequest hello = RELIGHT__HELLO_REQUEST__INIT;
    hello.client = (char *)client;
    if (token) hello.token = (char *)token;
    hello.version_min = hello.version_max = RELIGHT_PROTOCOL_VERSION;
    frames_add(f, RELIGHT_TYPE_HELLO, 1, &hello.base, NULL, 0);
}

static inline void frames_add_hello(struct frames *f, const char *client)
{
    frames_add_hello_as(f, client, NULL);
}

// Connected, without HELLO.
static inline struct frames *frames_connect(const struct daemon *d)
{
    struct frames *f = calloc(1, sizeof *f);
    struct relight_frame_limits limits = {1 << 24, UINT64_C(1) << 32, false};
    assert_non_null(f);
    relight_decoder_init(&f->decoder, &limits);
    f->fd = raw_connect(d);
    return f;
}

static inline struct frames *frames_open_as(const struct daemon *d, const char *token)
{
    struct frames *f = frames_connect(d);
    frames_add_hello_as(f, "frames", token);
    frames_send(f);
    assert_int_equal(frames_wait(f, 1).code, 0);
    return f;
}

static inline struct frames *frames_open(const struct daemon *d)
{
    return frames_open_as(d, NULL);
}

static inline void frames_close(struct frames *f)
{
    close(f->fd);
    relight_decoder_finish(&f->decoder);
    free(f->bytes);
    free(f);
}

#endif
