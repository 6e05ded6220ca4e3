// SPDX-License-Identifier: MIT
// Requests: created from a frame, in their connection's list while open, with a deadline, ended
// exactly once by an answer, an error, or the connection's end.
#include "net/request.h"

#include "core/log.h"
#include "net/dispatch.h"
#include "relight.pb-c.h"

#include <stdarg.h>
#include <assert.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void *request_state(const struct request *request, void (*abandon)(struct request *request))
{
    return request->abandon == abandon ? request->state : NULL;
}

static void measure_pace(struct server *server)
{
    uint64_t now = loop_now_ns();
    uint64_t gap = server->answered_ns ? now - server->answered_ns : 0;
    if (gap)
        server->answer_gap_ns =
            server->answer_gap_ns
                ? server->answer_gap_ns - server->answer_gap_ns / 16 + gap / 16
                : gap;
    bool others = ledger_total(server->ledger, LEDGER_REQUESTS) > 1;
    server->answered_ns = others ? now : 0;
}

// The time in which half of the open requests will be answered, at the measured pace.
static uint32_t retry_after_ms(const struct server *server)
{
    uint64_t n = ledger_total(server->ledger, LEDGER_REQUESTS);
    uint64_t ms = server->answer_gap_ns * (n + 1) / 2 / 1000000;
    if (!server->answer_gap_ns) return 50;
    return ms < 1 ? 1 : ms > 10000 ? 10000 : (uint32_t)ms;
}

static void end(struct request *request)
{
    struct server *server = request->server;
    struct connection *conn = request->conn;
    double seconds = (double)(loop_now_ns() - request->arrived_ns) * 1e-9;
    stats_ended(&server->stats, request->type, request->outcome, seconds);
    char outcome[40];
    stats_outcome(request->outcome, outcome);
    log_line((enum log_level)server->access_level,
             "access request=%s conn=%llu id=%llu op=%s outcome=%s ms=%.1f client=\"%s\"",
             request->request_id, (unsigned long long)conn->number,
             (unsigned long long)request->id, relight_type_name(request->type), outcome,
             seconds * 1e3, conn->caller.name);
    loop_timer_stop(server->loop, &request->deadline);
    *(request->prev ? &request->prev->next : &conn->requests) = request->next;
    if (request->next) request->next->prev = request->prev;
    conn->n_request--;
    server->n_request--;
    if (request->counted == LEDGER_REQUESTS && request->outcome == STATS_OK)
        measure_pace(server);
    if (request->counted == LEDGER_LONG_REQUESTS) conn->n_long--;
    if (request->message) protobuf_c_message_free_unpacked(request->message, NULL);
    request_drop_payload(request);
    cache_release(request->materials);
    ledger_give(request->principal, LEDGER_PAYLOAD, request->header_charged);
    ledger_give(request->principal, request->counted, 1);
    principal_release(request->principal);
    free(request);
}

// ---- charged bytes

int refusal_code(const struct principal *principal, enum ledger_resource resource,
                 uint64_t amount)
{
    uint64_t mine = ledger_limit_client(principal, resource);
    uint64_t all = ledger_limit_all(principal->ledger, resource);
    bool never = (mine && amount > mine) || (all && amount > all);
    return never ? RELIGHT__ERROR_CODE__ERROR_LIMIT : RELIGHT__ERROR_CODE__ERROR_BUSY;
}

void request_drop_payload(struct request *request)
{
    free(request->payload);
    ledger_give(request->principal, LEDGER_PAYLOAD, request->payload_charged);
    request->payload = NULL;
    request->payload_size = 0;
    request->payload_charged = 0;
}

struct held_bytes *request_take_payload(struct request *request)
{
    struct held_bytes *held = request->payload ? calloc(1, sizeof *held) : NULL;
    if (!held) return NULL;
    *held = (struct held_bytes){.refs = 1,
                                .bytes = request->payload,
                                .size = request->payload_size,
                                .principal = request->principal,
                                .charged = request->payload_charged};
    principal_hold(held->principal);
    request->payload = NULL;
    request->payload_size = 0;
    request->payload_charged = 0;
    return held;
}

void request_return_payload(struct request *request, struct held_bytes *held)
{
    assert(held->refs == 1 && held->principal == request->principal && !request->payload);
    request->payload = held->bytes;
    request->payload_size = held->size;
    request->payload_charged = held->charged;
    principal_release(held->principal);
    free(held);
}

void held_bytes_hold(struct held_bytes *held)
{
    held->refs++;
}

void held_bytes_release(struct held_bytes *held)
{
    if (!held || --held->refs) return;
    free(held->bytes);
    ledger_give(held->principal, LEDGER_PAYLOAD, held->charged);
    principal_release(held->principal);
    free(held);
}

static bool refuse(struct connection *conn, int code, const char *fmt, ...)
    __attribute__((format(printf, 3, 4)));
static bool refuse(struct connection *conn, int code, const char *fmt, ...)
{
    va_list args;
    va_start(args, fmt);
    conn->refusal.code = code;
    vsnprintf(conn->refusal.text, sizeof conn->refusal.text, fmt, args);
    va_end(args);
    return false;
}

// Charges the principal; operations with OPERATION_ALWAYS are charged beyond its limits.
static bool charge(struct connection *conn, const struct operation *operation,
                   enum ledger_resource resource, uint64_t amount)
{
    char error[256];
    if (operation->flags & OPERATION_ALWAYS) {
        ledger_force(conn->principal, resource, amount);
        return true;
    }
    enum ledger_refusal refusal = ledger_take(conn->principal, resource, amount, error);
    if (refusal == LEDGER_GRANTED) return true;
    conn->own_limit = refusal == LEDGER_CLIENT_FULL;
    return refuse(conn, refusal_code(conn->principal, resource, amount), "%s", error);
}

bool request_admit(struct connection *conn, const struct relight_frame *frame)
{
    const struct operation *operation = operation_of(frame->type);
    uint64_t n = frame->payload_size;
    if (!operation)
        return refuse(conn, RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED, "type %u is unknown",
                      frame->type);
    if (!operation->max_payload)
        return refuse(conn, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                      "%s has no payload, and %llu bytes were sent",
                      relight_type_name(frame->type), (unsigned long long)n);
    if (n > operation->max_payload)
        return refuse(conn, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                      "the payload of %s is limited to %zu bytes",
                      relight_type_name(frame->type), operation->max_payload);
    if (!charge(conn, operation, LEDGER_PAYLOAD, n)) return false;
    conn->payload_charged = n;
    return true;
}

// A refusal for access is a line of the audit, from a call site of its own: others' lines do
// not use up its rate.
static void log_refusal(const struct connection *conn, const char *request_id, uint16_t type,
                        uint64_t id, int code, const char *text)
{
    if (code == RELIGHT__ERROR_CODE__ERROR_FORBIDDEN)
        log_line(LOG_EVENT,
                 "audit act=refused who=%s peer=%s request=%s conn=%llu id=%llu op=%s "
                 "text=\"%s\"",
                 conn->caller.name, conn->peer, request_id, (unsigned long long)conn->number,
                 (unsigned long long)id, relight_type_name(type), text);
    else
        log_line(LOG_EVENT, "refused request=%s conn=%llu id=%llu op=%s code=%d text=\"%s\"",
                 request_id, (unsigned long long)conn->number, (unsigned long long)id,
                 relight_type_name(type), code, text);
}

// retry_ms: for BUSY, when to repeat the request; 0: unknown.
static void send_error(struct connection *conn, uint64_t id, int code, const char *text,
                       uint32_t retry_ms, uint64_t generation, const char *moved,
                       const char *hint)
{
    Relight__Error error;
    struct error_fields fields;
    error_fill(&error, code, text, &fields);
    error.generation = generation;
    if (moved) error.address = (char *)moved;
    if (hint) error.hint = (char *)hint;
    if (code == RELIGHT__ERROR_CODE__ERROR_BUSY) {
        error.retry_after_ms = retry_ms ? retry_ms : retry_after_ms(conn->server);
        conn->server->stats.busy_total++;
    }
    conn->server->stats.errors_total++;
    connection_send(conn, RELIGHT_TYPE_ERROR, RELIGHT_FRAME_LAST, id, &error.base, NULL);
}

void request_answer(struct request *request, const ProtobufCMessage *message,
                    const struct payload *payload)
{
    struct connection *conn = request->conn;
    uint16_t type = request->type | RELIGHT_TYPE_ANSWER;
    uint64_t id = request->id;
    // The timer's turn comes after the answers of this turn of the loop.
    if (request->deadline.armed && loop_now_ns() >= request->deadline.at_ns) {
        if (payload && payload->release) payload->release(payload->owner);
        request->server->stats.deadline_total++;
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_DEADLINE, "the deadline passed");
        return;
    }
    size_t header = protobuf_c_message_get_packed_size(message);
    if (header > SERVER_MAX_ANSWER_HEADER) {
        if (payload && payload->release) payload->release(payload->owner);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_LIMIT,
                     "the answer's header is %zu, allowed range 0 to %d bytes", header,
                     SERVER_MAX_ANSWER_HEADER);
        return;
    }
    request->abandon = NULL;
    request->outcome = STATS_OK;
    conn->late_ns = request->deadline.armed ? request->deadline.at_ns : 0;
    connection_send(conn, type, RELIGHT_FRAME_LAST, id, message, payload);
    conn->late_ns = 0;
    if (!conn->dead) end(request); // a connection that closed here has ended it already
}

void request_part(struct request *request, const ProtobufCMessage *message,
                  const struct payload *payload)
{
    connection_send(request->conn, request->type | RELIGHT_TYPE_ANSWER, 0, request->id, message,
                    payload);
}

void request_fail(struct request *request, int code, const char *fmt, ...)
{
    char said[500], text[500];
    va_list args;
    va_start(args, fmt);
    vsnprintf(said, sizeof said, fmt, args);
    va_end(args);
    struct connection *conn = request->conn;
    blobs_name_in_text(conn->server->blobs, conn->caller.name, said, text, sizeof text);
    log_refusal(conn, request->request_id, request->type, request->id, code, text);
    request->abandon = NULL;
    request->outcome = code;
    send_error(conn, request->id, code, text, request->retry_ms, request->generation,
               request->moved, request->hint);
    if (!conn->dead) end(request);
}

void request_abandon(struct request *request)
{
    if (request->abandon) request->abandon(request);
    end(request);
}

void request_stop(struct request *request, int code, const char *text)
{
    if (request->abandon) request->abandon(request);
    request_fail(request, code, "%s", text);
}

static void deadline_fired(struct loop_timer *timer)
{
    struct request *request =
        (struct request *)((char *)timer - offsetof(struct request, deadline));
    request->server->stats.deadline_total++;
    request_stop(request, RELIGHT__ERROR_CODE__ERROR_DEADLINE, "the deadline passed");
}

// Whether the connection may open one more request of this kind.
static bool may_open(struct connection *conn, const struct relight_frame *frame,
                     const struct operation *operation)
{
    const struct options *o = &conn->server->options;
    unsigned quick = conn->n_request - conn->n_long;
    if (!frame->id)
        return refuse(conn, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                      "request id 0 is not used: ids begin at 1");
    for (const struct request *r = conn->requests; r; r = r->next)
        if (r->id == frame->id)
            return refuse(conn, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                          "a request with this id is open already");
    // Operations with OPERATION_ALWAYS are answered at once, except closes, which keep their
    // order.
    if (operation->flags & OPERATION_ALWAYS) {
        if (quick < 2 * o->requests + 64) return true;
    } else if (operation->flags & OPERATION_LONG || quick < o->requests) {
        return true;
    }
    return refuse(conn, RELIGHT__ERROR_CODE__ERROR_BUSY,
                  "this connection has too many open requests (--requests)");
}

// Whether its token's requests a second allow another one.
static bool within_rate(struct connection *conn, const struct relight_frame *frame,
                        const struct operation *operation)
{
    enum { CHUNK = 64 << 10 };
    uint32_t retry_ms;
    // The chunks of an upload are limited by their bytes.
    bool chunk = frame->type == RELIGHT_TYPE_PUT_BLOB && frame->payload_size >= CHUNK;
    if (operation->flags & OPERATION_ALWAYS || !conn->greeted || conn->prepaid || chunk ||
        access_take_request(conn->server->access, &conn->caller, &retry_ms))
        return true;
    conn->refusal.retry_ms = retry_ms;
    return refuse(conn, RELIGHT__ERROR_CODE__ERROR_BUSY,
                  "your token's quota of requests a second is used up (--rate)");
}

// Unpacks the header after checking its size and that its strings are UTF-8.
static ProtobufCMessage *unpack(struct connection *conn, const struct relight_frame *frame,
                                const struct operation *operation, uint64_t *charged)
{
    static const struct relight_header_limits limits = {SERVER_MAX_ITEMS, SERVER_MAX_UNPACKED};
    struct relight_header_cost cost;
    char error[RELIGHT_HEADER_ERROR];
    static const uint8_t empty[1];
    const uint8_t *header = frame->header ? frame->header : empty;
    if (!relight_header_check(frame->type, header, frame->header_size, &limits, &cost, error)) {
        refuse(conn, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "%s", error);
        return NULL;
    }
    if (!charge(conn, operation, LEDGER_PAYLOAD, cost.bytes)) return NULL;
    ProtobufCMessage *message = relight_frame_unpack(frame);
    if (message) {
        *charged = cost.bytes;
        return message;
    }
    ledger_give(conn->principal, LEDGER_PAYLOAD, cost.bytes);
    refuse(conn, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
           "the header is not a valid message of this type");
    return NULL;
}

static void set_deadline(struct request *request, unsigned flags, uint32_t deadline_ms)
{
    struct server *server = request->server;
    double limit = flags & OPERATION_LONG ? 0 : server->options.deadline;
    double wish = deadline_ms * 1e-3;
    request->deadline.fire = deadline_fired;
    if (wish > 0 && (limit == 0 || wish < limit)) limit = wish;
    if (limit > 0)
        loop_timer_set(server->loop, &request->deadline,
                       request->arrived_ns + (uint64_t)(limit * 1e9));
}

static void enlist(struct request *request)
{
    struct connection *conn = request->conn;
    request->next = conn->requests;
    if (request->next) request->next->prev = request;
    conn->requests = request;
    conn->n_request++;
    conn->server->n_request++;
    if (request->counted == LEDGER_LONG_REQUESTS) conn->n_long++;
    principal_hold(request->principal);
}

// The client's own id (HTTP), or one that no other request has.
static void name_request(struct request *request)
{
    static uint64_t last_number;
    const char *given = request->conn->request_id;
    if (*given) snprintf(request->request_id, sizeof request->request_id, "%s", given);
    else
        snprintf(request->request_id, sizeof request->request_id, "r%.8s-%llx",
                 request->server->run, (unsigned long long)++last_number);
}

struct request *request_create(struct connection *conn, const struct relight_frame *frame,
                               uint8_t *payload)
{
    const struct operation *operation = operation_of(frame->type);
    uint64_t payload_charged = conn->payload_charged, header_charged = 0;
    bool refused = conn->refusal.code != 0, counted = false;
    enum ledger_resource resource = LEDGER_REQUESTS;
    ProtobufCMessage *message = NULL;
    struct request *request = NULL;
    conn->payload_charged = 0;
    if (!refused && !operation)
        refused = !refuse(conn, RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED, "type %u is unknown",
                          frame->type);
    if (!refused) {
        if (operation->flags & OPERATION_LONG) resource = LEDGER_LONG_REQUESTS;
        counted = within_rate(conn, frame, operation) && may_open(conn, frame, operation) &&
                  charge(conn, operation, resource, 1);
        if (counted) message = unpack(conn, frame, operation, &header_charged);
        if (message) request = calloc(1, sizeof *request);
    }
    if (request) {
        *request = (struct request){.server = conn->server,
                                    .conn = conn,
                                    .id = frame->id,
                                    .type = frame->type,
                                    .arrived_ns = loop_now_ns(),
                                    .outcome = STATS_GONE,
                                    .message = message,
                                    .payload = payload,
                                    .payload_size = frame->payload_size,
                                    .principal = conn->principal,
                                    .counted = resource,
                                    .payload_charged = payload_charged,
                                    .header_charged = header_charged};
        enlist(request);
        name_request(request);
        set_deadline(request, operation->flags, frame->deadline_ms);
        return request;
    }
    if (message) {
        protobuf_c_message_free_unpacked(message, NULL);
        refuse(conn, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    }
    free(payload);
    ledger_give(conn->principal, LEDGER_PAYLOAD, payload_charged + header_charged);
    if (counted) ledger_give(conn->principal, resource, 1);
    int code = conn->refusal.code;
    conn->refusal.code = 0;
    stats_ended(&conn->server->stats, frame->type, code, 0);
    log_refusal(conn, conn->request_id, frame->type, frame->id, code, conn->refusal.text);
    send_error(conn, frame->id, code, conn->refusal.text, conn->refusal.retry_ms, 0, NULL,
               NULL);
    conn->refusal.retry_ms = 0;
    return NULL;
}
