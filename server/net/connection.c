// SPDX-License-Identifier: MIT
// A client's frames. Input beyond the limits is refused before it is stored: the frame's fixed
// part has its sizes. Output is bounded: above --send-buffer the client is not read any more,
// and above four times that it is disconnected.
#include "net/connection.h"

#include "net/dispatch.h"
#include "core/log.h"
#include "render/shared/materials.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

static uint64_t plus_seconds(uint64_t ns, double seconds)
{
    return ns + (uint64_t)(seconds * 1e9);
}

// The time limit of this connection that expires next, and its text for the log.
static uint64_t next_limit(const struct connection *conn, const char **why)
{
    const struct options *o = &conn->server->options;
    uint64_t active = conn->heard_ns > conn->sent_ns ? conn->heard_ns : conn->sent_ns;
    const struct {
        bool applies;
        uint64_t at;
        const char *why;
    } limits[] = {
        {true, plus_seconds(active, o->idle), "idle"},
        {conn->frame_ns, plus_seconds(conn->frame_ns, o->frame_time),
         "a frame was begun and not finished in time (--frame-time)"},
        {!conn->greeted, plus_seconds(conn->opened_ns, o->handshake),
         "no HELLO in time (--handshake)"},
        // One that has read nothing recently is covered by the next row.
        {conn->full_ns && conn->sent_ns > plus_seconds(conn->full_ns, o->write_time / 2),
         plus_seconds(conn->full_ns, o->write_time),
         "its answers have passed --send-buffer for longer than --write-time"},
        {conn->out, plus_seconds(conn->sent_ns, o->write_time),
         "it does not read its waiting answers (--write-time)"},
        {conn->end_ns, conn->end_ns, "its token is not valid any more"},
    };
    uint64_t first = UINT64_MAX;
    for (size_t i = 0; i < sizeof limits / sizeof *limits; i++)
        if (limits[i].applies && limits[i].at < first) {
            first = limits[i].at;
            *why = limits[i].why;
        }
    return first;
}

// A socket becomes writable again only when a third of its buffer is free: a slow reader of a
// large buffer may take longer than --write-time for that. The bytes in the
// kernel's buffer show that it reads.
static void sample_output(struct connection *conn, uint64_t now)
{
    bool known = conn->out && conn->carrier->unsent;
    size_t unsent = known ? conn->carrier->unsent(conn) : 0;
    if (unsent < conn->unsent) conn->sent_ns = now;
    conn->unsent = unsent;
}

// The timer is not moved when a limit moves into the future: it checks again when it fires.
static void watch_clock(struct connection *conn)
{
    const char *why;
    uint64_t at = next_limit(conn, &why);
    uint64_t sample = plus_seconds(loop_now_ns(), conn->server->options.write_time / 4);
    if (conn->out && sample < at) at = sample;
    if (!conn->timer.armed || at < conn->timer.at_ns)
        loop_timer_set(conn->server->loop, &conn->timer, at);
}

static void dismiss(struct connection *conn);

static void clock_fired(struct loop_timer *timer)
{
    struct connection *conn =
        (struct connection *)((char *)timer - offsetof(struct connection, timer));
    uint64_t now = loop_now_ns();
    const char *why;
    sample_output(conn, now);
    if (conn->n_request) conn->heard_ns = now; // it is waiting for an answer or watching a job
    if (conn->end_ns && conn->end_ns <= now && !conn->closing) dismiss(conn);
    else if (next_limit(conn, &why) <= now) connection_close(conn, why);
    else watch_clock(conn);
}

static bool admit(void *user, const struct relight_frame *frame)
{
    return request_admit(user, frame);
}

struct connection *connection_open(struct server *server, const struct carrier *carrier,
                                   void *carrier_data, const char *peer, const char *who)
{
    struct connection *conn = calloc(1, sizeof *conn);
    struct principal *principal = conn ? ledger_principal(server->ledger, who) : NULL;
    char error[256] = "not enough memory";
    if (!principal || ledger_take(principal, LEDGER_CONNECTIONS, 1, error)) {
        server->stats.connections_refused++;
        log_line(LOG_WARN, "connection refused carrier=%s peer=%s text=\"%s\"", carrier->name,
                 peer, error);
        principal_release(principal);
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
    conn->opened_ns = conn->heard_ns = conn->sent_ns = loop_now_ns();
    snprintf(conn->peer, sizeof conn->peer, "%s", peer);
    snprintf(conn->caller.name, sizeof conn->caller.name, "%s", who);
    struct relight_frame_limits limits = {SERVER_HELLO_HEADER, 0, true}; // before HELLO
    relight_decoder_init(&conn->decoder, &limits);
    conn->decoder.admit = admit;
    conn->decoder.admit_user = conn;
    conn->next = server->connections;
    if (conn->next) conn->next->prev = conn;
    server->connections = conn;
    server->n_connection++;
    server->stats.connections_total++;
    stats_connection(&server->stats, carrier->name, 1);
    conn->timer.fire = clock_fired;
    watch_clock(conn);
    log_line(carrier->answer ? LOG_TRACE : LOG_EVENT, "connect conn=%llu carrier=%s peer=%s",
             (unsigned long long)conn->number, carrier->name, conn->peer);
    return conn;
}

// The time of the monotonic clock at which the token expires; 0: never.
static uint64_t expiry_ns(const struct caller *caller)
{
    struct timespec now;
    if (!caller->expires_s) return 0;
    clock_gettime(CLOCK_REALTIME, &now);
    double left_s = (double)(caller->expires_s - now.tv_sec) - 1e-9 * (double)now.tv_nsec;
    left_s = left_s < 0 ? 0 : left_s > 1e9 ? 1e9 : left_s;
    return plus_seconds(loop_now_ns(), left_s);
}

bool connection_identify(struct connection *conn, const struct caller *caller, char error[256])
{
    struct principal *from = conn->principal;
    struct principal *to = ledger_principal(conn->server->ledger, caller_payer(caller));
    snprintf(error, 256, "not enough memory");
    if (!to) return false;
    if (to != from) {
        if (ledger_take(to, LEDGER_CONNECTIONS, 1, error)) {
            principal_release(to);
            return false;
        }
        // Returns what was charged for the connection; an open request keeps its own charge.
        ledger_force(to, LEDGER_OUTPUT, conn->out_charged);
        ledger_force(to, LEDGER_PAYLOAD, conn->payload_charged);
        ledger_give(from, LEDGER_OUTPUT, conn->out_charged);
        ledger_give(from, LEDGER_PAYLOAD, conn->payload_charged);
        ledger_give(from, LEDGER_CONNECTIONS, 1);
        conn->principal = to;
        principal_release(from);
    } else {
        principal_release(to);
    }
    conn->caller = *caller;
    conn->end_ns = expiry_ns(caller);
    watch_clock(conn);
    return true;
}

static void dismiss(struct connection *conn)
{
    Relight__Error error = RELIGHT__ERROR__INIT;
    error.code = RELIGHT__ERROR_CODE__ERROR_FORBIDDEN;
    error.text = "the token of this connection is not valid any more";
    error.hint = (char *)error_hint(error.code);
    log_line(LOG_EVENT, "audit act=dismiss who=%s conn=%llu", conn->caller.name,
             (unsigned long long)conn->number);
    conn->end_ns = plus_seconds(loop_now_ns(), 0.5);
    watch_clock(conn);
    connection_send(conn, RELIGHT_TYPE_ERROR, RELIGHT_FRAME_LAST, 0, &error.base, NULL);
    while (!conn->dead && conn->requests) request_abandon(conn->requests);
    if (!conn->dead) connection_finish(conn, error.text);
}

void connections_recheck(struct server *server, bool anonymous)
{
    for (struct connection *c = server->connections, *next; c; c = next) {
        next = c->next;
        if (!c->greeted || c->closing) continue;
        bool address = !strncmp(c->caller.name, "addr:", 5);
        if ((!anonymous || !address) && access_is_current(server->access, &c->caller)) continue;
        const struct connection *closed = server->closed;
        dismiss(c);
        if (server->closed != closed) next = server->connections; // c, or others for its answer
    }
}

static void free_frame(struct connection *conn, struct out_frame *frame)
{
    ledger_give(conn->principal, LEDGER_OUTPUT, frame->size);
    conn->out_charged -= frame->size;
    if (frame->payload.release) frame->payload.release(frame->payload.owner);
    free(frame->head);
    free(frame);
}

void connection_close(struct connection *conn, const char *why)
{
    if (conn->dead) return;
    struct server *server = conn->server;
    conn->dead = true;
    log_line(conn->carrier->answer ? LOG_TRACE : LOG_EVENT, "disconnect conn=%llu why=\"%s\"",
             (unsigned long long)conn->number, why);
    loop_timer_stop(server->loop, &conn->timer);
    while (conn->requests) request_abandon(conn->requests);
    materials_drop(conn);
    if (conn->server->fetch_drop) conn->server->fetch_drop(conn);
    conn->carrier->close(conn);
    for (struct out_frame *f = conn->out, *next; f; f = next) {
        next = f->next;
        free_frame(conn, f);
    }
    conn->out = NULL;
    relight_decoder_finish(&conn->decoder);
    ledger_give(conn->principal, LEDGER_PAYLOAD, conn->payload_charged);
    ledger_give(conn->principal, LEDGER_CONNECTIONS, 1);
    conn->payload_charged = 0;
    *(conn->prev ? &conn->prev->next : &server->connections) = conn->next;
    if (conn->next) conn->next->prev = conn->prev;
    server->n_connection--;
    stats_connection(&server->stats, conn->carrier->name, -1);
    conn->next = server->closed; // callers up the stack still read `dead`
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

static struct connection *holds_most(const struct server *server,
                                     const struct principal *principal)
{
    struct connection *most = NULL;
    for (struct connection *c = server->connections; c; c = c->next)
        if ((!principal || c->principal == principal) &&
            (!most || c->out_bytes > most->out_bytes))
            most = c;
    return most && most->out_bytes ? most : NULL;
}

void connections_shed(struct server *server)
{
    uint64_t all = ledger_limit_all(server->ledger, LEDGER_OUTPUT);
    struct connection *c;
    while (all && ledger_total(server->ledger, LEDGER_OUTPUT) > all &&
           (c = holds_most(server, NULL)))
        connection_close(c, "all unread answers exceed --output-memory, and it holds the most");
    uint64_t least = ledger_limit_least(server->ledger, LEDGER_OUTPUT);
    if (!least || ledger_total(server->ledger, LEDGER_OUTPUT) <= least) return;
    for (c = server->connections; c;) {
        uint64_t mine = ledger_limit_client(c->principal, LEDGER_OUTPUT);
        bool over = mine && c->principal->held[LEDGER_OUTPUT] > mine;
        struct connection *next = c->next;
        struct connection *most = over ? holds_most(server, c->principal) : NULL;
        if (!most) {
            c = next;
            continue;
        }
        connection_close(most, "its client's unread answers exceed --client-output");
        c = server->connections;
    }
}

void connections_goaway(struct server *server, double seconds, const char *address,
                        const char *text)
{
    Relight__Goaway out = RELIGHT__GOAWAY__INIT;
    out.drain_ms = seconds < 4e6 ? (uint32_t)(seconds * 1e3) : UINT32_MAX;
    out.address = (char *)address;
    out.text = (char *)text;
    for (struct connection *c = server->connections; c; c = c->next)
        c->owes_goaway = c->greeted;
    for (struct connection *c = server->connections, *next; c; c = next) {
        const struct connection *closed = server->closed;
        next = c->next;
        if (!c->owes_goaway) continue;
        c->owes_goaway = false;
        connection_send(c, RELIGHT_TYPE_GOAWAY, RELIGHT_FRAME_LAST, 0, &out.base, NULL);
        if (server->closed != closed) next = server->connections; // c, or others for its frame
    }
}

static void bad_frame(struct connection *conn, int fault)
{
    conn->server->stats.frames_bad++;
    Relight__Error error;
    struct error_fields fields;
    error_fill(&error, RELIGHT__ERROR_CODE__ERROR_BAD_FRAME, relight_frame_fault_text(fault),
               &fields);
    error.hint = "the connection is closed: the start of its next frame is unknown";
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
    if (!conn->dead) relight_decoder_commit(&conn->decoder, 0); // frees its buffers
}

size_t connection_bytes(struct connection *conn, const void *bytes, size_t n, uint64_t until_ns)
{
    size_t done = 0;
    bool late = false;
    while (done < n && !late && !conn->dead && !conn->closing) {
        size_t used = 0;
        int status =
            relight_decoder_feed(&conn->decoder, (const char *)bytes + done, n - done, &used);
        done += used;
        connection_committed(conn, used, status);
        late = loop_now_ns() >= until_ns;
    }
    return done;
}

// The clock of --frame-time runs until the message ends, whether its frame is complete or not.
void connection_part(struct connection *conn, const void *bytes, size_t n, bool last)
{
    const char *at = bytes;
    while (n && !conn->dead && !conn->closing) {
        if (conn->message_full) {
            bad_frame(conn, RELIGHT_FAULT_LONG);
            return;
        }
        size_t used = 0;
        int status = relight_decoder_feed(&conn->decoder, at, n, &used);
        at += used;
        n -= used;
        conn->message_full = status > 0;
        connection_committed(conn, used, status);
    }
    if (conn->dead || conn->closing) return;
    if (last) {
        if (!conn->message_full) bad_frame(conn, RELIGHT_FAULT_SHORT);
        conn->message_full = false;
    } else if (!conn->frame_ns) {
        conn->frame_ns = loop_now_ns();
        watch_clock(conn);
    }
}

// DEADLINE in place of an answer that waits for its reader. Without memory the answer stays.
static void replace_late(struct connection *conn, struct out_frame *f)
{
    struct relight_frame frame = {
        .flags = RELIGHT_FRAME_LAST, .type = RELIGHT_TYPE_ERROR, .id = f->id};
    Relight__Error error;
    struct error_fields fields;
    uint8_t *head;
    size_t n;
    error_fill(&error, RELIGHT__ERROR_CODE__ERROR_DEADLINE,
               "the deadline passed while the answer waited to be read", &fields);
    f->late_ns = 0;
    if (relight_frame_pack(&frame, &error.base, 0, 0, &head, &n)) return;
    if (f->payload.release) f->payload.release(f->payload.owner);
    free(f->head);
    ledger_give(conn->principal, LEDGER_OUTPUT, f->size);
    ledger_force(conn->principal, LEDGER_OUTPUT, n);
    conn->out_charged += n - f->size;
    conn->out_bytes += n - f->size;
    f->head = head;
    f->head_size = f->size = n;
    f->payload = (struct payload){0};
    if (f == conn->out) conn->message_left = n;
    conn->server->stats.deadline_total++;
}

void connection_begun(struct connection *conn, size_t n)
{
    for (struct out_frame *f = conn->out; f && n; f = f->next) {
        size_t left = f->size - f->sent;
        f->late_ns = 0;
        n -= n < left ? n : left;
    }
}

int connection_output(struct connection *conn, struct iovec *iov, int max)
{
    const uint64_t now = loop_now_ns();
    for (struct out_frame *f = conn->out; f; f = f->next)
        if (f->late_ns && !f->sent && now >= f->late_ns) replace_late(conn, f);
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

// Bytes of the message at the head of the queue.
static size_t first_message(const struct connection *conn)
{
    size_t n = 0;
    for (const struct out_frame *f = conn->out; f; f = f->next) {
        n += f->size;
        if (!f->more) break;
    }
    return n;
}

void connection_written(struct connection *conn, size_t n)
{
    conn->server->stats.bytes_out += n;
    conn->out_bytes -= n;
    conn->sent_ns = loop_now_ns();
    conn->unsent = SIZE_MAX;
    while (conn->out) {
        struct out_frame *f = conn->out;
        size_t left = f->size - f->sent;
        size_t done = n < left ? n : left;
        f->sent += done;
        conn->message_left -= done;
        if (done < left) break;
        n -= done;
        conn->out = f->next;
        if (!conn->out) conn->out_last = &conn->out;
        if (!f->more) conn->message_left = first_message(conn);
        free_frame(conn, f);
    }
    if (conn->out_bytes - conn->message_left <= conn->server->options.send_buffer)
        conn->full_ns = 0;
    if (conn->closing) {
        if (!conn->out) connection_close(conn, "done");
    } else if (!conn->reading && conn->out_bytes <= conn->server->options.send_buffer / 2) {
        conn->reading = true;
        conn->carrier->set_reading(conn, true);
    }
}

static void enqueue(struct connection *conn, struct out_frame *out)
{
    out->size = out->head_size + out->payload.size;
    ledger_force(conn->principal, LEDGER_OUTPUT, out->size);
    conn->out_charged += out->size;
    bool waited = conn->out != NULL;
    *conn->out_last = out;
    conn->out_last = &out->next;
    conn->out_bytes += out->size;
    if (!waited) {
        conn->sent_ns = loop_now_ns();
        watch_clock(conn);
    }
}

// One frame; its payload is a part of a shared one when the client limits the size of frames.
static bool queue_frame(struct connection *conn, struct relight_frame *frame,
                        const ProtobufCMessage *message, const struct payload *payload)
{
    struct out_frame *out = calloc(1, sizeof *out);
    if (!out || relight_frame_pack(frame, message, 0, 0, &out->head, &out->head_size)) {
        free(out);
        if (payload && payload->release) payload->release(payload->owner);
        return false;
    }
    if (message)
        relight_header_repair(frame->type, out->head + RELIGHT_FRAME_FIXED, frame->header_size);
    if (payload) out->payload = *payload;
    out->more = frame->flags & RELIGHT_FRAME_MORE;
    out->id = frame->id;
    out->late_ns = conn->late_ns;
    enqueue(conn, out);
    return true;
}

// Reacts to how much of the output is unread, now that there is more of it. `first`: nothing
// was queued before.
static void output_grew(struct connection *conn, bool first)
{
    uint64_t limit = conn->server->options.send_buffer;
    if (first) conn->message_left = conn->out_bytes;
    // A single answer may exceed that: its reader takes it at its own pace.
    size_t behind = conn->out_bytes - conn->message_left;
    if (behind > 4 * limit) {
        connection_close(conn, "it reads too slowly: its answers exceed the send buffer");
        return;
    }
    if (behind > limit && !conn->full_ns) conn->full_ns = loop_now_ns();
    if (conn->out_bytes > limit && conn->reading) {
        conn->reading = false;
        conn->carrier->set_reading(conn, false);
    }
    conn->carrier->want_write(conn);
}

bool connection_queue(struct connection *conn, uint8_t *head, size_t n, struct payload *payload)
{
    struct out_frame *out = calloc(1, sizeof *out);
    bool first = !conn->out;
    if (!out || (!head && n)) {
        free(out);
        free(head);
        if (payload && payload->release) payload->release(payload->owner);
        connection_close(conn, "not enough memory for an answer");
        return false;
    }
    out->head = head;
    out->head_size = n;
    if (payload) out->payload = *payload;
    enqueue(conn, out);
    output_grew(conn, first);
    return !conn->dead;
}

void connection_part_begins(struct connection *conn)
{
    conn->heard_ns = conn->frame_ns = loop_now_ns();
    watch_clock(conn);
}

void connection_part_ends(struct connection *conn, size_t n)
{
    conn->server->stats.bytes_in += n;
    conn->heard_ns = loop_now_ns();
    conn->frame_ns = 0;
}

void connection_send(struct connection *conn, uint16_t type, uint8_t flags, uint64_t id,
                     const ProtobufCMessage *message, const struct payload *payload)
{
    if (conn->dead || conn->closing) {
        if (payload && payload->release) payload->release(payload->owner);
        return;
    }
    if (conn->carrier->answer) {
        struct payload own = payload ? *payload : (struct payload){0};
        conn->carrier->answer(conn, type, flags, message, &own);
        return;
    }
    size_t size = payload ? payload->size : 0;
    size_t piece =
        conn->max_payload && conn->max_payload < size ? conn->max_payload / 64 * 64 : size;
    bool ok = true, first = !conn->out;
    if (piece < size) conn->late_ns = 0; // one in several frames is sent whole
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
    if (ok) output_grew(conn, first);
    else connection_close(conn, "not enough memory for an answer");
}
