// SPDX-License-Identifier: MIT
// A request's life: created from a frame, on its connection's list while open, with a deadline,
// ended exactly once by an answer, an error, or its connection's end.
#include "net/request.h"

#include "core/log.h"
#include "prt/base.h"
#include "relight.pb-c.h"

#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

const char *error_hint(int code)
{
    switch (code) {
    case RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST:
        return "see PROTOCOL.md for what this operation takes";
    case RELIGHT__ERROR_CODE__ERROR_VERSION:
        return "update the client or the daemon";
    case RELIGHT__ERROR_CODE__ERROR_NOT_FOUND:
        return "the list of models shows what is there (relight models); an upload must be "
               "complete before it is used";
    case RELIGHT__ERROR_CODE__ERROR_BUSY:
        return "wait retry_after_ms and ask again";
    case RELIGHT__ERROR_CODE__ERROR_DEADLINE:
        return "give it more time, or ask for less";
    case RELIGHT__ERROR_CODE__ERROR_FORMAT:
        return "check the file with another program; prt info FILE says more";
    case RELIGHT__ERROR_CODE__ERROR_NOT_READY:
        return "watch its job until it is done";
    case RELIGHT__ERROR_CODE__ERROR_HASH:
        return "upload it again from offset 0";
    case RELIGHT__ERROR_CODE__ERROR_SHUTTING_DOWN:
        return "connect again in a moment";
    case RELIGHT__ERROR_CODE__ERROR_LIMIT:
        return "the daemon's configuration, or its machine, sets this limit";
    case RELIGHT__ERROR_CODE__ERROR_MISMATCH:
        return "bake the model with these settings, or ask with the model's own; another material "
               "needs a bake with transport joint or polynomial";
    case RELIGHT__ERROR_CODE__ERROR_JOB_FAILED:
        return "mend what the text names and load the model again";
    default:
        return "";
    }
}

int error_of_status(int status)
{
    switch (status) {
    case PRT_ARG:
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    case PRT_NOMEM:
        return RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    case PRT_IO:
        return RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    case PRT_FORMAT:
        return RELIGHT__ERROR_CODE__ERROR_FORMAT;
    case PRT_LIMIT:
        return RELIGHT__ERROR_CODE__ERROR_LIMIT;
    case PRT_CANCELLED:
        return RELIGHT__ERROR_CODE__ERROR_CANCELLED;
    case PRT_UNSUPPORTED:
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    case PRT_MISMATCH:
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    default:
        return RELIGHT__ERROR_CODE__ERROR_INTERNAL;
    }
}

void *request_state(const struct request *request, void (*abandon)(struct request *request))
{
    return request->abandon == abandon ? request->state : NULL;
}

static void end(struct request *request)
{
    struct server *server = request->server;
    struct connection *conn = request->conn;
    stats_latency(&server->stats, request->type,
                  (double)(loop_now_ns() - request->arrived_ns) * 1e-9);
    loop_timer_stop(server->loop, &request->deadline);
    *(request->prev ? &request->prev->next : &conn->requests) = request->next;
    if (request->next) request->next->prev = request->prev;
    conn->n_request--;
    server->n_request--;
    if (request->message) protobuf_c_message_free_unpacked(request->message, NULL);
    free(request->payload);
    free(request);
}

static void send_error(struct connection *conn, uint64_t id, int code, const char *text)
{
    Relight__Error error = RELIGHT__ERROR__INIT;
    error.code = code;
    error.text = (char *)text;
    error.hint = (char *)error_hint(code);
    if (code == RELIGHT__ERROR_CODE__ERROR_BUSY) {
        error.retry_after_ms = 50;
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
    request->abandon = NULL;
    connection_send(conn, type, RELIGHT_FRAME_LAST, id, message, payload);
    if (!conn->dead) end(request); // a connection that died here has ended it already
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
    blobs_name_in_text(conn->server->blobs, conn->principal->name, said, text, sizeof text);
    log_line(LOG_EVENT, "refused conn=%llu id=%llu op=%s code=%d text=\"%s\"",
             (unsigned long long)conn->number, (unsigned long long)request->id,
             relight_type_name(request->type), code, text);
    request->abandon = NULL;
    send_error(conn, request->id, code, text);
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

// Watching and viewing go on for as long as the client likes.
static bool stays_open(uint16_t type)
{
    return type == RELIGHT_TYPE_WATCH || type == RELIGHT_TYPE_VIEW_OPEN;
}

struct request *request_create(struct connection *conn, const struct relight_frame *frame,
                               uint8_t *payload)
{
    struct server *server = conn->server;
    const struct options *o = &server->options;
    struct request *request = NULL;
    const char *text = "not enough memory";
    int code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    bool quick = frame->type == RELIGHT_TYPE_CANCEL; // must get through when all is full
    if (!quick && (conn->n_request >= o->requests || server->n_request >= o->queue)) {
        code = RELIGHT__ERROR_CODE__ERROR_BUSY;
        text = conn->n_request >= o->requests ? "this connection has too many open requests"
                                              : "the daemon has too many open requests";
    } else {
        for (const struct request *r = conn->requests; r; r = r->next)
            if (r->id == frame->id) {
                code = RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
                text = "a request with this id is open already";
                goto fail;
            }
        request = calloc(1, sizeof *request);
    }
    if (!request) goto fail;
    *request = (struct request){.server = server,
                                .conn = conn,
                                .id = frame->id,
                                .type = frame->type,
                                .arrived_ns = loop_now_ns(),
                                .payload = payload,
                                .payload_size = frame->payload_size};
    request->message = relight_frame_unpack(frame);
    if (!request->message) {
        bool known = relight_type_message(frame->type) != NULL;
        code = known ? RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST
                     : RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
        text = known ? "the header does not parse as this type's message"
                     : "a request of unknown type";
        free(request);
        goto fail;
    }
    request->next = conn->requests;
    if (request->next) request->next->prev = request;
    conn->requests = request;
    conn->n_request++;
    server->n_request++;
    request->deadline.fire = deadline_fired;
    double limit = stays_open(frame->type) ? 0 : o->deadline;
    double wish = frame->deadline_ms * 1e-3;
    if (wish > 0 && (limit == 0 || wish < limit)) limit = wish;
    if (limit > 0)
        loop_timer_set(server->loop, &request->deadline,
                       request->arrived_ns + (uint64_t)(limit * 1e9));
    return request;
fail:
    free(payload);
    send_error(conn, frame->id, code, text);
    return NULL;
}
