// SPDX-License-Identifier: MIT
// One HTTP request of the API: admitted, its body stored piece by piece, its message
// dispatched, its answer sent.
#include "net/exchange.h"

#include "core/log.h"
#include "net/dispatch.h"
#include "net/http_problem.h"
#include "net/listener.h"
#include "message_text.h"
#include "net/upload.h"
#include "relight.pb-c.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/epoll.h>

static const uint64_t BEAT_NS = 15000000000u; // between two comments of a silent stream

static void stop_watching(struct exchange *x);

// ---- the carrier

static void want_write(struct connection *conn)
{
    struct exchange *x = conn->carrier_data;
    lws_callback_on_writable(x->wsi);
}

static void set_reading(struct connection *conn, bool on)
{
    struct exchange *x = conn->carrier_data;
    x->reading = on;
    upload_pace(x);
}

// A limit of time or room closed it; where the exchange itself is over, x->complete is set.
static void closed(struct connection *conn)
{
    struct exchange *x = conn->carrier_data;
    upload_forget(x);
    x->conn = NULL;
    stop_watching(x);
    ledger_give(conn->principal, LEDGER_PAYLOAD, x->json_charged + x->kept_charged);
    x->json_charged = x->kept_charged = 0;
    if (x->broken) return;
    x->broken = true;
    lws_set_timeout(x->wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
}

static size_t unsent(const struct connection *conn)
{
    const struct exchange *x = conn->carrier_data;
    return socket_unsent(lws_get_socket_fd(x->wsi));
}

static void drop_payload(struct payload *payload)
{
    if (payload->release) payload->release(payload->owner);
}

static void operation_answered(struct connection *conn, uint16_t type, uint8_t flags,
                               const ProtobufCMessage *message, struct payload *payload)
{
    struct exchange *x = conn->carrier_data;
    if (type == RELIGHT_TYPE_GOAWAY) {
        drop_payload(payload);
        x->close_after = true;
    } else if (x->storing && type != RELIGHT_TYPE_ERROR) {
        drop_payload(payload);
        upload_answered(x, (const Relight__PutBlobAnswer *)message);
    } else if (x->complete) {
        drop_payload(payload);
    } else if (type == RELIGHT_TYPE_ERROR) {
        struct http_problem problem;
        drop_payload(payload);
        x->storing = false;
        x->n_flying = 0;
        upload_pace(x);
        problem_of_error(conn, (const Relight__Error *)message, &problem);
        exchange_refuse(x, &problem);
    } else {
        x->route->answer(x, message, flags & RELIGHT_FRAME_LAST, payload);
    }
}

static const struct carrier http_carrier = {"http", want_write, set_reading,
                                            closed, unsent,     operation_answered};

// ---- answers

void exchange_field(struct exchange *x, const char *name, const char *fmt, ...)
{
    char value[500];
    va_list args;
    va_start(args, fmt);
    vsnprintf(value, sizeof value, fmt, args);
    va_end(args);
    for (char *c = value; *c; c++)
        if ((unsigned char)*c < 32 || (unsigned char)*c > 126) *c = '?';
    size_t n_name = strlen(name) + 1, n_value = strlen(value) + 1;
    if (x->n_fields + n_name + n_value > EXCHANGE_FIELDS) return;
    memcpy(x->fields + x->n_fields, name, n_name);
    memcpy(x->fields + x->n_fields + n_name, value, n_value);
    x->n_fields += n_name + n_value;
}

static void set_answer(struct exchange *x, int status, const char *type)
{
    x->status = status;
    snprintf(x->type, sizeof x->type, "%s", type);
    // What is left of the body would be taken for the next request.
    if (x->body_at < x->head.body_size || x->head.unframed) x->close_after = true;
    if (x->server->draining) x->close_after = true;
}

// Bytes for a client that has no connection: one buffer.
static void answer_plain(struct exchange *x, char *head, size_t n, struct payload *payload)
{
    x->plain = n ? (struct payload){head, n, head, free} : *payload;
    if (n) drop_payload(payload);
    else free(head);
    lws_callback_on_writable(x->wsi);
}

void exchange_answer(struct exchange *x, int status, const char *type, char *head, size_t n,
                     struct payload *payload)
{
    struct payload none = {0};
    if (!payload) payload = &none;
    if (x->complete || x->broken) {
        free(head);
        drop_payload(payload);
        return;
    }
    set_answer(x, status, type);
    x->length = n + payload->size;
    x->complete = true;
    if (!x->conn) answer_plain(x, head, n, payload);
    else if (x->length) connection_queue(x->conn, (uint8_t *)head, n, payload);
    else {
        free(head);
        drop_payload(payload);
        lws_callback_on_writable(x->wsi);
    }
}

void exchange_refuse(struct exchange *x, const struct http_problem *problem)
{
    if (x->complete) return;
    if (x->status) { // a stream, whose status went out already
        exchange_stream_end(x);
        return;
    }
    char *text = problem_json(problem, x->request_id);
    log_line(LOG_EVENT, "refused request=%s op=%s %s status=%d text=\"%s\"", x->request_id,
             x->head.method, x->head.path, problem->status, problem->detail);
    if (problem->retry_after_ms)
        exchange_field(x, "retry-after:", "%u", (problem->retry_after_ms - 1) / 1000 + 1);
    if (problem->status == 401)
        exchange_field(x, "www-authenticate:", "Bearer realm=\"relightd\"");
    exchange_field(x, "cache-control:", "no-store");
    exchange_answer(x, problem->status, "application/problem+json", text,
                    text ? strlen(text) : 0, NULL);
}

void exchange_text(struct exchange *x, int status, const char *type, char *text)
{
    struct http_problem problem;
    if (text) {
        exchange_answer(x, status, type, text, strlen(text), NULL);
        return;
    }
    http_refuse(&problem, 503, "no_memory", "not enough memory");
    exchange_refuse(x, &problem);
}

void exchange_json(struct exchange *x, int status, const ProtobufCMessage *message)
{
    cJSON *json = message_to_json(message);
    char *text = json ? cJSON_PrintUnformatted(json) : NULL;
    cJSON_Delete(json);
    exchange_field(x, "cache-control:", "no-store");
    exchange_text(x, status, "application/json", text);
}

static void beat(struct loop_timer *timer)
{
    struct exchange *x = (struct exchange *)((char *)timer - offsetof(struct exchange, beat));
    if (x->conn && !x->conn->out) exchange_piece(x, ": still here\n\n");
    if (x->conn) loop_timer_set(x->server->loop, &x->beat, loop_now_ns() + BEAT_NS);
}

void exchange_stream(struct exchange *x, const char *type)
{
    set_answer(x, 200, type);
    x->streaming = true;
    x->close_after = true;
    exchange_field(x, "cache-control:", "no-store");
    x->beat.fire = beat;
    loop_timer_set(x->server->loop, &x->beat, loop_now_ns() + BEAT_NS);
    lws_callback_on_writable(x->wsi);
}

void exchange_piece(struct exchange *x, const char *text)
{
    if (!x->conn || x->complete) return;
    connection_queue(x->conn, (uint8_t *)strdup(text), strlen(text), NULL);
}

void exchange_stream_end(struct exchange *x)
{
    x->complete = true;
    lws_callback_on_writable(x->wsi);
}

// ---- work on an answer

static void worked(struct work *work)
{
    struct work_of_exchange *w = (struct work_of_exchange *)work;
    struct exchange *x = w->x;
    drop_payload(&w->payload);
    if (x) x->work = NULL;
    if (x && w->bytes && !work->status) {
        exchange_answer(x, 200, w->type, w->bytes, w->n, NULL);
        w->bytes = NULL;
    } else if (x) {
        struct http_problem problem;
        http_refuse(&problem, 503, "no_memory", "%s",
                    work->error[0] ? work->error : "not enough memory for this format");
        exchange_refuse(x, &problem);
    }
    free(w->bytes);
    free(w);
}

void exchange_work(struct exchange *x, struct payload *payload, uint32_t n_vertex, int format,
                   const char *type,
                   int (*run)(struct work *work, const struct prt_context *ctx))
{
    struct work_of_exchange *w = calloc(1, sizeof *w);
    struct http_problem problem;
    if (!w) {
        drop_payload(payload);
        http_refuse(&problem, 503, "no_memory", "not enough memory");
        exchange_refuse(x, &problem);
        return;
    }
    *w = (struct work_of_exchange){.x = x,
                                   .server = x->server,
                                   .payload = *payload,
                                   .n_vertex = n_vertex,
                                   .format = format,
                                   .type = type};
    w->work.run = run;
    w->work.done = worked;
    w->work.class = WORK_INTERACTIVE;
    x->work = w;
    work_submit(x->server->work, &w->work);
}

// ---- sending

static int write_head(struct exchange *x)
{
    static uint8_t head[LWS_PRE + 4096];
    uint8_t *start = head + LWS_PRE, *at = start, *end = head + sizeof head - 1;
    bool empty = x->status == 304 || x->status == 204;
    int err = lws_add_http_header_status(x->wsi, (unsigned)x->status, &at, end);
    if (!err && !empty)
        err = lws_add_http_header_by_token(x->wsi, WSI_TOKEN_HTTP_CONTENT_TYPE,
                                           (const unsigned char *)x->type, (int)strlen(x->type),
                                           &at, end);
    if (!err && !x->streaming && !empty)
        err = lws_add_http_header_content_length(x->wsi, x->length, &at, end);
    if (!err && x->close_after)
        err = lws_add_http_header_by_token(x->wsi, WSI_TOKEN_CONNECTION,
                                           (const unsigned char *)"close", 5, &at, end);
    for (const char *f = x->fields; !err && f < x->fields + x->n_fields;) {
        const char *value = f + strlen(f) + 1;
        err = lws_add_http_header_by_name(x->wsi, (const unsigned char *)f,
                                          (const unsigned char *)value, (int)strlen(value), &at,
                                          end);
        f = value + strlen(value) + 1;
    }
    return err || lws_finalize_write_http_header(x->wsi, start, &at, end) ? -1 : 0;
}

static bool has_body(const struct exchange *x)
{
    return x->status != 304 && x->status != 204 && strcmp(x->head.method, "HEAD");
}

// The next piece into http_piece; its bytes.
static size_t next_piece(struct exchange *x)
{
    struct iovec iov[4] = {{0}};
    int n_iov = 1;
    size_t n = 0;
    if (x->conn) n_iov = connection_output(x->conn, iov, 4);
    else
        iov[0] = (struct iovec){(char *)x->plain.bytes + (x->plain.size ? x->sent : 0),
                                x->plain.size ? x->plain.size - x->sent : 0};
    for (int i = 0; i < n_iov && n < HTTP_CHUNK; i++) {
        size_t take = iov[i].iov_len < HTTP_CHUNK - n ? iov[i].iov_len : HTTP_CHUNK - n;
        memcpy(http_piece + LWS_PRE + n, iov[i].iov_base, take);
        n += take;
    }
    return n;
}

static enum exchange_next finished(struct exchange *x)
{
    log_line((enum log_level)x->server->access_level,
             "http request=%s method=%s path=%s status=%d bytes=%llu ms=%.1f", x->request_id,
             x->head.method, x->head.path, x->status, (unsigned long long)x->sent,
             (double)(loop_now_ns() - x->begun_ns) * 1e-6);
    x->broken = true; // closing its connection is in order
    return x->close_after ? EXCHANGE_CLOSE : EXCHANGE_DONE;
}

enum exchange_next exchange_write(struct exchange *x)
{
    if (x->broken) return EXCHANGE_CLOSE;
    if (!x->status) return EXCHANGE_GOES_ON;
    if (!x->head_sent) {
        x->head_sent = true;
        if (write_head(x)) return EXCHANGE_CLOSE;
        if (!has_body(x) || (x->complete && !x->length && !x->streaming)) return finished(x);
        lws_callback_on_writable(x->wsi);
        return EXCHANGE_GOES_ON;
    }
    size_t n = next_piece(x);
    bool last = x->complete &&
                (x->streaming ? x->conn && x->conn->out_bytes == n : x->sent + n == x->length);
    if (!n && !last) return EXCHANGE_GOES_ON;
    if (n && lws_write(x->wsi, http_piece + LWS_PRE, n,
                       last ? LWS_WRITE_HTTP_FINAL : LWS_WRITE_HTTP) < (int)n)
        return EXCHANGE_CLOSE;
    x->sent += n;
    if (x->conn) connection_written(x->conn, n);
    else x->server->stats.bytes_out += n;
    if (last) return finished(x);
    if (!x->conn || x->conn->out) lws_callback_on_writable(x->wsi);
    return EXCHANGE_GOES_ON;
}

// ---- the request

bool exchange_connect(struct exchange *x, const struct caller *caller,
                      struct http_problem *problem)
{
    char error[256];
    struct accepted client = {0};
    struct server *server = x->server;
    const bool room = server->n_connection < server->options.connections;
    accepted_describe(lws_get_socket_fd(x->wsi), &client);
    if (room) x->conn = connection_open(server, &http_carrier, x, client.peer, client.who);
    if (x->conn && !connection_identify(x->conn, caller, error)) {
        x->conn->own_limit = true;
        http_refuse(problem, 429, "busy", "%s", error);
        problem->retry_after_ms = 1000;
        return false;
    }
    if (x->conn) {
        x->conn->greeted = true;
        x->conn->prepaid = true;
        snprintf(x->conn->request_id, sizeof x->conn->request_id, "%s", x->request_id);
        return true;
    }
    server->stats.connections_refused += !room; // connection_open counts its own
    http_refuse(problem, room ? 429 : 503, "busy", "%s",
                room ? "your address is at its limit of connections (--client-connections)"
                     : "the daemon is at its limit of connections (--connections)");
    problem->retry_after_ms = 1000;
    return false;
}

void exchange_dispatch(struct exchange *x, uint16_t type, const ProtobufCMessage *message,
                       uint8_t *payload, size_t n)
{
    size_t size = protobuf_c_message_get_packed_size(message);
    uint8_t *header = malloc(size + 1);
    if (!header) {
        struct http_problem problem;
        free(payload);
        http_refuse(&problem, 503, "no_memory", "not enough memory");
        exchange_refuse(x, &problem);
        return;
    }
    protobuf_c_message_pack(message, header);
    struct relight_frame frame = {.flags = RELIGHT_FRAME_LAST,
                                  .type = type,
                                  .id = ++x->last_id,
                                  .deadline_ms = x->deadline_ms,
                                  .header_size = (uint32_t)size,
                                  .payload_size = n,
                                  .header = header,
                                  .payload = payload};
    dispatch_frame(x->conn, &frame, payload);
    free(header);
}

void exchange_run(struct exchange *x)
{
    if (x->blob[0] && x->route->add_file) x->route->add_file(x);
    exchange_dispatch(x, x->route->type, x->message, NULL, 0);
}

static void peer_event(struct loop_watch *watch, uint32_t events)
{
    struct exchange *x = (struct exchange *)((char *)watch - offsetof(struct exchange, peer));
    if (x->conn && events & (EPOLLRDHUP | EPOLLHUP | EPOLLERR))
        connection_close(x->conn, "closed by peer");
}

// libwebsockets repeats the end of a body for as long as bytes of a next request wait behind
// it, and serves nobody else meanwhile: a client that pipelines behind a body is closed.
bool exchange_received(struct exchange *x)
{
    if (x->received) {
        log_line(LOG_WARN,
                 "http request=%s: the next request came before the answer, behind a "
                 "body; the connection is closed",
                 x->request_id);
        return false;
    }
    x->received = true;
    upload_pace(x);
    if (!x->conn || x->peer.fd) return true;
    x->peer = (struct loop_watch){lws_get_socket_fd(x->wsi), peer_event};
    if (loop_watch_add(x->server->loop, &x->peer, EPOLLRDHUP)) x->peer.fd = 0;
    return true;
}

static void stop_watching(struct exchange *x)
{
    if (x->peer.fd) loop_watch_remove(x->server->loop, &x->peer);
    x->peer.fd = 0;
}

struct exchange *exchange_begin(struct lws *wsi, struct server *server)
{
    static uint64_t last_number;
    struct http_problem problem;
    struct exchange *x = calloc(1, sizeof *x);
    if (!x) return NULL;
    x->wsi = wsi;
    x->server = server;
    x->reading = true;
    x->begun_ns = loop_now_ns();
    lws_set_timeout(wsi, NO_PENDING_TIMEOUT, 0); // the connection's own limits hold from here
    bool fine = http_head_read(wsi, &x->head, &problem);
    if (x->head.request_id[0])
        snprintf(x->request_id, sizeof x->request_id, "%s", x->head.request_id);
    else
        snprintf(x->request_id, sizeof x->request_id, "h%.8s-%llx", server->run,
                 (unsigned long long)++last_number);
    exchange_field(x, "x-request-id:", "%s", x->request_id);
    x->close_after = !fine;
    if (!fine || !exchange_admit(x, &problem)) {
        if (!x->status) exchange_refuse(x, &problem);
    } else if (x->complete) { // a preflight
    } else if (x->route->type && x->head.has_body) {
        upload_begin(x);
    } else if (x->route->type) {
        exchange_run(x);
    }
    bool sends = !strcmp(x->head.method, "POST") || !strcmp(x->head.method, "PUT");
    if (!sends && !x->head.has_body)
        exchange_received(x); // else libwebsockets says so, even of an empty body
    // Without a connection nothing but libwebsockets limits the time of the answer.
    if (!x->conn) lws_set_timeout(wsi, PENDING_TIMEOUT_HTTP_CONTENT, 30);
    return x;
}

bool exchange_receive(struct exchange *x, const void *bytes, size_t n)
{
    if (x->broken) return false;
    if (x->head.chunked) return upload_receive_chunked(x, bytes, n);
    x->body_at += n;
    if (x->complete || x->body_at > x->head.body_size) return true; // it is being answered
    upload_receive(x, bytes, n);
    return !x->broken;
}

void exchange_end(struct exchange *x)
{
    if (x->work) x->work->x = NULL;
    x->broken = true;
    stop_watching(x);
    loop_timer_stop(x->server->loop, &x->beat);
    upload_end(x);
    if (x->conn) connection_close(x->conn, x->complete ? "done" : "closed by peer");
    if (x->message) protobuf_c_message_free_unpacked(x->message, NULL);
    drop_payload(&x->plain);
    http_head_finish(&x->head);
    free(x);
}
