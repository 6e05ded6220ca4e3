// SPDX-License-Identifier: MIT
// A client's frames. Input is refused before it is stored (limits in the frame's fixed part);
// output is bounded: above --send-buffer nothing more is read from the client, so that it
// cannot ask for more, and above four times that it is disconnected.
#include "net/connection.h"

#include "net/dispatch.h"
#include "core/log.h"
#include "render/shared/materials.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static void watch_clock(struct connection *conn)
{
    const struct options *o = &conn->server->options;
    uint64_t at = conn->heard_ns + (uint64_t)(o->idle * 1e9);
    uint64_t frame = conn->frame_ns + (uint64_t)(o->frame_time * 1e9);
    if (conn->frame_ns && frame < at) at = frame;
    loop_timer_set(conn->server->loop, &conn->timer, at);
}

static void clock_fired(struct loop_timer *timer)
{
    struct connection *conn =
        (struct connection *)((char *)timer - offsetof(struct connection, timer));
    const struct options *o = &conn->server->options;
    uint64_t now = loop_now_ns();
    if (conn->frame_ns && (double)(now - conn->frame_ns) >= o->frame_time * 1e9) {
        connection_close(conn, "a frame was begun and not finished in time");
        return;
    }
    // Who waits for an answer, or watches a job, is not idle.
    if (conn->n_request || conn->out) conn->heard_ns = now;
    if ((double)(now - conn->heard_ns) >= o->idle * 1e9) connection_close(conn, "idle");
    else watch_clock(conn);
}

struct connection *connection_open(struct server *server, const struct carrier *carrier,
                                   void *carrier_data, const char *peer, const char *who)
{
    struct connection *conn = calloc(1, sizeof *conn);
    struct principal *principal = conn ? ledger_principal(server->ledger, who) : NULL;
    if (!principal) {
        free(conn);
        return NULL;
    }
    conn->principal = principal;
    conn->server = server;
    conn->carrier = carrier;
    conn->carrier_data = carrier_data;
    conn->number = ++server->last_connection;
    conn->out_last = &conn->out;
    conn->reading = true;
    conn->heard_ns = loop_now_ns();
    snprintf(conn->peer, sizeof conn->peer, "%s", peer);
    struct relight_frame_limits limits = {SERVER_HELLO_HEADER, 0, true}; // until it said hello
    relight_decoder_init(&conn->decoder, &limits);
    conn->next = server->connections;
    if (conn->next) conn->next->prev = conn;
    server->connections = conn;
    server->n_connection++;
    server->stats.connections_total++;
    conn->timer.fire = clock_fired;
    watch_clock(conn);
    log_line(LOG_EVENT, "connect conn=%llu carrier=%s peer=%s",
             (unsigned long long)conn->number, carrier->name, conn->peer);
    return conn;
}

static void free_frame(struct out_frame *frame)
{
    if (frame->payload.release) frame->payload.release(frame->payload.owner);
    free(frame->head);
    free(frame);
}

void connection_close(struct connection *conn, const char *why)
{
    if (conn->dead) return;
    struct server *server = conn->server;
    conn->dead = true;
    log_line(LOG_EVENT, "disconnect conn=%llu why=\"%s\"", (unsigned long long)conn->number,
             why);
    loop_timer_stop(server->loop, &conn->timer);
    while (conn->requests) request_abandon(conn->requests);
    materials_drop(conn);
    conn->carrier->close(conn);
    for (struct out_frame *f = conn->out, *next; f; f = next) {
        next = f->next;
        free_frame(f);
    }
    conn->out = NULL;
    relight_decoder_finish(&conn->decoder);
    *(conn->prev ? &conn->prev->next : &server->connections) = conn->next;
    if (conn->next) conn->next->prev = conn->prev;
    server->n_connection--;
    conn->next = server->closed; // callers up the stack still look at `dead`
    server->closed = conn;
}

void connections_free_closed(struct server *server)
{
    for (struct connection *c = server->closed, *next; c; c = next) {
        next = c->next;
        principal_release(c->principal);
        free(c);
    }
    server->closed = NULL;
}

void connection_finish(struct connection *conn, const char *why)
{
    conn->closing = true;
    if (conn->reading) conn->carrier->set_reading(conn, false);
    conn->reading = false;
    if (!conn->out) connection_close(conn, why);
}

static void bad_frame(struct connection *conn, int fault)
{
    conn->server->stats.frames_bad++;
    Relight__Error error = RELIGHT__ERROR__INIT;
    error.code = RELIGHT__ERROR_CODE__ERROR_BAD_FRAME;
    error.text = (char *)relight_frame_fault_text(fault);
    error.hint = "the connection is closed: its frames cannot be told apart any more";
    log_line(LOG_WARN, "bad-frame conn=%llu fault=\"%s\"", (unsigned long long)conn->number,
             error.text);
    connection_send(conn, RELIGHT_TYPE_ERROR, RELIGHT_FRAME_LAST, 0, &error.base, NULL);
    if (!conn->dead) connection_finish(conn, "bad frame");
}

void connection_committed(struct connection *conn, size_t n, int status)
{
    conn->server->stats.bytes_in += n;
    conn->heard_ns = loop_now_ns();
    if (status < 0) {
        bad_frame(conn, status);
        return;
    }
    if (!status) {
        if (!conn->frame_ns) {
            conn->frame_ns = conn->heard_ns;
            watch_clock(conn);
        }
        return;
    }
    conn->frame_ns = 0;
    dispatch_frame(conn, &conn->decoder.frame, relight_decoder_take(&conn->decoder));
}

void connection_bytes(struct connection *conn, const void *bytes, size_t n)
{
    const char *at = bytes;
    while (n && !conn->dead && !conn->closing) {
        size_t used = 0;
        int status = relight_decoder_feed(&conn->decoder, at, n, &used);
        at += used;
        n -= used;
        connection_committed(conn, used, status);
    }
}

void connection_message(struct connection *conn, const void *bytes, size_t n)
{
    struct relight_frame frame;
    int status = relight_frame_parse(bytes, n, &conn->decoder.limits, &frame);
    conn->server->stats.bytes_in += n;
    conn->heard_ns = loop_now_ns();
    uint8_t *payload = NULL;
    if (!status && frame.payload_size) {
        payload = aligned_alloc(64, (frame.payload_size + 63) / 64 * 64);
        if (!payload) status = RELIGHT_FAULT_MEMORY;
        else memcpy(payload, frame.payload, frame.payload_size);
    }
    if (status) bad_frame(conn, status);
    else dispatch_frame(conn, &frame, payload);
}

int connection_output(const struct connection *conn, struct iovec *iov, int max)
{
    int n = 0;
    for (const struct out_frame *f = conn->out; f && n < max; f = f->next) {
        if (f->sent < f->head_size)
            iov[n++] = (struct iovec){f->head + f->sent, f->head_size - f->sent};
        size_t from = f->sent > f->head_size ? f->sent - f->head_size : 0;
        if (n < max && from < f->payload.size)
            iov[n++] = (struct iovec){(char *)f->payload.bytes + from, f->payload.size - from};
    }
    return n;
}

void connection_written(struct connection *conn, size_t n)
{
    conn->server->stats.bytes_out += n;
    conn->out_bytes -= n;
    while (conn->out) {
        struct out_frame *f = conn->out;
        size_t left = f->size - f->sent;
        if (n < left) {
            f->sent += n;
            break;
        }
        n -= left;
        conn->out = f->next;
        if (!conn->out) conn->out_last = &conn->out;
        free_frame(f);
    }
    if (conn->closing) {
        if (!conn->out) connection_close(conn, "done");
    } else if (!conn->reading && conn->out_bytes <= conn->server->options.send_buffer / 2) {
        conn->reading = true;
        conn->carrier->set_reading(conn, true);
    }
}

// One frame; its payload is a piece of a shared one when the client wants small frames.
static bool queue_frame(struct connection *conn, struct relight_frame *frame,
                        const ProtobufCMessage *message, const struct payload *payload)
{
    struct out_frame *out = calloc(1, sizeof *out);
    if (!out || relight_frame_pack(frame, message, 0, 0, &out->head, &out->head_size)) {
        free(out);
        if (payload && payload->release) payload->release(payload->owner);
        return false;
    }
    if (payload) out->payload = *payload;
    out->size = out->head_size + out->payload.size;
    *conn->out_last = out;
    conn->out_last = &out->next;
    conn->out_bytes += out->size;
    return true;
}

void connection_send(struct connection *conn, uint16_t type, uint8_t flags, uint64_t id,
                     const ProtobufCMessage *message, const struct payload *payload)
{
    if (conn->dead || conn->closing) {
        if (payload && payload->release) payload->release(payload->owner);
        return;
    }
    size_t size = payload ? payload->size : 0;
    size_t piece =
        conn->max_payload && conn->max_payload < size ? conn->max_payload / 64 * 64 : size;
    bool ok = true;
    for (size_t at = 0; ok && (at < size || at == 0); at += piece) {
        size_t n = size - at < piece ? size - at : piece;
        bool last = at + n == size;
        struct relight_frame frame = {
            .flags =
                last ? flags : (uint8_t)((flags & ~RELIGHT_FRAME_LAST) | RELIGHT_FRAME_MORE),
            .type = type,
            .id = id,
            .payload_size = n};
        struct payload part = {payload ? (const char *)payload->bytes + at : NULL, n, NULL,
                               NULL};
        if (last && payload) {
            part.owner = payload->owner;
            part.release = payload->release;
        }
        ok = queue_frame(conn, &frame, at ? NULL : message, &part);
        if (!size) break;
    }
    uint64_t limit = conn->server->options.send_buffer;
    if (!ok) {
        connection_close(conn, "not enough memory for an answer");
    } else if (conn->out_bytes > 4 * limit) {
        connection_close(conn, "reads too slowly: its answers do not fit the send buffer");
    } else {
        if (conn->out_bytes > limit && conn->reading) {
            conn->reading = false;
            conn->carrier->set_reading(conn, false);
        }
        conn->carrier->want_write(conn);
    }
}
