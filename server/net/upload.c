// SPDX-License-Identifier: MIT
// Bodies of HTTP requests: files into the store of uploads, JSON into the operation's message.
#include "net/upload.h"

#include "net/dispatch.h"
#include "net/http_problem.h"
#include "message_text.h"
#include "net/routes.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/random.h>

enum { MOST_FLYING = 2, BUSY_RETRY_MS = 1000 };

static bool is_type(const struct exchange *x, const char *type)
{
    const char *said = x->head.content_type;
    size_t n = strlen(type);
    return !strncasecmp(said, type, n) && (!said[n] || said[n] == ';' || said[n] == ' ');
}

static void problem_as(struct exchange *x, int code, const char *text,
                       struct http_problem *problem)
{
    Relight__Error error = RELIGHT__ERROR__INIT;
    error.code = code;
    error.text = (char *)text;
    error.hint = (char *)error_hint(code);
    if (code == RELIGHT__ERROR_CODE__ERROR_BUSY) error.retry_after_ms = BUSY_RETRY_MS;
    problem_of_error(x->conn, &error, problem);
}

static void refuse_as(struct exchange *x, int code, const char *text)
{
    struct http_problem problem;
    problem_as(x, code, text, &problem);
    exchange_refuse(x, &problem);
}

// Charges `more` bytes of a body that then holds `all`. False: *problem says whose limit that
// passes, and whether it ever fits.
static bool charge_body(struct exchange *x, uint64_t more, uint64_t all,
                        struct http_problem *problem)
{
    struct principal *payer = x->conn->principal;
    char error[256];
    enum ledger_refusal refusal = ledger_take(payer, LEDGER_PAYLOAD, more, error);
    if (refusal == LEDGER_GRANTED) return true;
    x->conn->own_limit = refusal == LEDGER_CLIENT_FULL;
    problem_as(x, refusal_code(payer, LEDGER_PAYLOAD, all), error, problem);
    return false;
}

bool upload_check(struct exchange *x, struct http_problem *problem)
{
    enum exchange_body body = x->route->body;
    bool json = is_type(x, "application/json");
    uint64_t size = x->head.body_size, most = x->server->options.max_blob;
    if (!x->head.has_body) return true;
    if ((json && body != BODY_FILE_OR_JSON) || is_type(x, "multipart/form-data") ||
        is_type(x, "text/html")) {
        http_refuse(problem, 415, "unsupported", "a body of type %.80s is not taken here",
                    x->head.content_type);
        snprintf(problem->hint, sizeof problem->hint,
                 "send the file's bytes alone: curl --data-binary @FILE, not -F");
        return false;
    }
    if (json) most = EXCHANGE_JSON;
    if (x->head.chunked) {
        if (json) size = most;
    } else if (size > most) {
        http_refuse(problem, 413, "limit",
                    "the body has %llu bytes, and at most %llu are taken",
                    (unsigned long long)size, (unsigned long long)most);
        problem->ranged = true;
        problem->maximum = (double)most;
        return false;
    }
    if (!json) return true;
    if (!charge_body(x, size, size, problem)) return false;
    x->json_charged = size;
    x->json = malloc(size + 1);
    if (!x->json)
        problem_as(x, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory", problem);
    return x->json != NULL;
}

void upload_begin(struct exchange *x)
{
    static const char go_on[] = "HTTP/1.1 100 Continue\r\n\r\n";
    unsigned char random[32];
    x->storing = !x->json_charged;
    if (x->storing && !x->blob[0]) {
        if (getrandom(random, sizeof random, 0) != sizeof random)
            memset(random, (int)x->conn->number, sizeof random);
        for (int i = 0; i < 32; i++) sprintf(x->upload + 2 * i, "%02x", random[i]);
    }
    if (!x->head.expects_continue) return;
    memcpy(http_piece + LWS_PRE, go_on, sizeof go_on - 1);
    if (lws_write(x->wsi, http_piece + LWS_PRE, sizeof go_on - 1, LWS_WRITE_HTTP_HEADERS) < 0)
        x->broken = true;
}

// Only while the body comes: libwebsockets writes nothing to a socket that is not read.
void upload_pace(struct exchange *x)
{
    bool stored = x->reading && x->n_flying < MOST_FLYING;
    lws_rx_flow_control(x->wsi, x->complete || x->received || stored);
}

// ---- files

// Charges and allocates the next chunk.
static bool begin_chunk(struct exchange *x, uint64_t at)
{
    uint64_t left = x->head.body_size - at;
    size_t size = left < SERVER_CHUNK ? (size_t)left : SERVER_CHUNK;
    struct relight_frame frame = {.type = RELIGHT_TYPE_PUT_BLOB, .payload_size = size};
    if (!request_admit(x->conn, &frame)) {
        int code = x->conn->refusal.code;
        x->conn->refusal.code = 0;
        refuse_as(x, code, x->conn->refusal.text);
        return false;
    }
    x->chunk =
        aligned_alloc(RELIGHT_FRAME_ALIGN, (size + RELIGHT_FRAME_ALIGN - 1) /
                                               RELIGHT_FRAME_ALIGN * RELIGHT_FRAME_ALIGN);
    if (!x->chunk) {
        refuse_as(x, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return false;
    }
    x->chunk_at = 0;
    x->chunk_size = size;
    connection_part_begins(x->conn);
    return true;
}

static void send_chunk(struct exchange *x, uint64_t end)
{
    Relight__PutBlobRequest put = RELIGHT__PUT_BLOB_REQUEST__INIT;
    uint8_t *chunk = x->chunk;
    put.hash = x->blob;
    put.upload = x->upload;
    put.size = x->blob_size ? x->blob_size : x->head.body_size;
    put.offset = x->blob_offset + end - x->chunk_size;
    put.name = x->file_name;
    x->chunk = NULL;
    x->n_flying++;
    connection_part_ends(x->conn, x->chunk_size);
    upload_pace(x);
    exchange_dispatch(x, RELIGHT_TYPE_PUT_BLOB, &put.base, chunk, x->chunk_size);
}

static void receive_file(struct exchange *x, const char *bytes, size_t n)
{
    uint64_t at = x->body_at - n; // of the first byte in the body
    while (n && !x->complete && !x->broken && x->conn) {
        if (!x->chunk && !begin_chunk(x, at)) return;
        size_t room = x->chunk_size - x->chunk_at, take = n < room ? n : room;
        memcpy(x->chunk + x->chunk_at, bytes, take);
        x->chunk_at += take;
        bytes += take;
        at += take;
        n -= take;
        if (x->chunk_at == x->chunk_size) send_chunk(x, at);
    }
}

void upload_answered(struct exchange *x, const Relight__PutBlobAnswer *answer)
{
    x->n_flying--;
    upload_pace(x);
    if (x->complete || x->n_flying || x->body_at < x->head.body_size) return;
    x->storing = false;
    if (answer->complete) {
        snprintf(x->blob, sizeof x->blob, "%s", answer->hash);
        x->upload[0] = 0;
    }
    if (x->route->type == RELIGHT_TYPE_PUT_BLOB) x->route->answer(x, &answer->base, true, NULL);
    else exchange_run(x);
}

// ---- JSON

static void run_json(struct exchange *x)
{
    char error[MESSAGE_TEXT_ERROR] = "the body is not JSON";
    struct http_problem problem;
    x->json[x->body_at] = 0;
    cJSON *json = cJSON_ParseWithLength(x->json, (size_t)x->body_at);
    bool good = json && route_body_agrees(x, json, &problem);
    if (!json || (good && message_from_json(x->message, json, error))) {
        http_refuse(&problem, 400, "bad_request", "%s", error);
        snprintf(problem.parameter, sizeof problem.parameter, "body");
        good = false;
    }
    cJSON_Delete(json);
    if (good) exchange_run(x);
    else exchange_refuse(x, &problem);
}

// ---- chunked bodies

static void give_kept(struct exchange *x)
{
    if (x->conn) ledger_give(x->conn->principal, LEDGER_PAYLOAD, x->kept_charged);
    x->kept_charged = 0;
}

static void refuse_long(struct exchange *x, uint64_t most)
{
    struct http_problem problem;
    http_refuse(&problem, 413, "limit", "a chunked body has at most %llu bytes here",
                (unsigned long long)most);
    snprintf(problem.hint, sizeof problem.hint,
             "send a longer one with Content-Length: curl -T FILE, or --data-binary @FILE");
    problem.ranged = true;
    problem.maximum = (double)most;
    exchange_refuse(x, &problem);
}

// Doubles the room for the body, which is charged before it is allocated.
static bool more_room(struct exchange *x, size_t wanted)
{
    uint64_t most = x->server->options.max_blob;
    size_t room = x->chunk_size ? x->chunk_size : 64 << 10;
    struct http_problem problem;
    if (most > UPLOAD_KEPT) most = UPLOAD_KEPT;
    if (wanted > most) {
        refuse_long(x, most);
        return false;
    }
    while (room < wanted) room *= 2;
    if (!charge_body(x, room - x->kept_charged, room, &problem)) {
        exchange_refuse(x, &problem);
        return false;
    }
    x->kept_charged = room;
    uint8_t *fresh = aligned_alloc(RELIGHT_FRAME_ALIGN, room);
    if (!fresh) {
        refuse_as(x, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return false;
    }
    if (x->chunk_at) memcpy(fresh, x->chunk, x->chunk_at);
    free(x->chunk);
    x->chunk = fresh;
    x->chunk_size = room;
    return true;
}

static bool keep_data(struct exchange *x, const char *data, size_t n)
{
    if (x->json && x->body_at + n > EXCHANGE_JSON) {
        refuse_long(x, EXCHANGE_JSON);
        return false;
    }
    if (x->json) memcpy(x->json + x->body_at, data, n);
    else if (x->chunk_at + n > x->chunk_size && !more_room(x, x->chunk_at + n)) return false;
    else memcpy(x->chunk + x->chunk_at, data, n);
    if (!x->json) x->chunk_at += n;
    // Each part of this size has --frame-time.
    if (x->body_at / SERVER_CHUNK < (x->body_at + n) / SERVER_CHUNK)
        connection_part_begins(x->conn);
    x->body_at += n;
    return true;
}

// The size is known: from here the body is treated as one with a Content-Length.
static void run_chunked(struct exchange *x)
{
    size_t n = x->chunk_at;
    x->head.body_size = x->body_at;
    connection_part_ends(x->conn, x->json ? (size_t)x->body_at : 0); // send_chunk counts a file
    if (x->json) {
        run_json(x);
    } else if (!n) {
        refuse_as(x, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "the body is empty");
    } else {
        struct relight_frame frame = {.type = RELIGHT_TYPE_PUT_BLOB, .payload_size = n};
        give_kept(x);
        if (!request_admit(x->conn, &frame)) {
            int code = x->conn->refusal.code;
            x->conn->refusal.code = 0;
            refuse_as(x, code, x->conn->refusal.text);
            return;
        }
        x->chunk_size = n;
        send_chunk(x, n);
    }
}

bool upload_receive_chunked(struct exchange *x, const char *bytes, size_t n)
{
    const char *data;
    struct http_problem problem;
    if (x->complete || x->framing.done || !x->conn) return true; // it is being answered
    if (!x->conn->frame_ns) connection_part_begins(x->conn);
    for (size_t k; (k = chunked_next(&x->framing, &bytes, &n, &data));)
        if (!keep_data(x, data, k)) return !x->broken;
    if (x->framing.wrong) {
        http_refuse(&problem, 400, "bad_request", "the body's chunks are not well-formed");
        exchange_refuse(x, &problem);
    } else if (x->framing.done) {
        run_chunked(x);
        // libwebsockets knows no end of it.
        if (!x->broken && !x->received) return exchange_received(x);
    }
    return !x->broken;
}

// ---- bytes, and the end

void upload_receive(struct exchange *x, const void *bytes, size_t n)
{
    if (x->storing) {
        receive_file(x, bytes, n);
    } else if (x->json) {
        if (x->body_at == n) connection_part_begins(x->conn);
        memcpy(x->json + x->body_at - n, bytes, n);
        if (x->body_at < x->head.body_size) return;
        connection_part_ends(x->conn, (size_t)x->body_at);
        run_json(x);
    }
}

void upload_forget(struct exchange *x)
{
    if (!x->upload[0]) return;
    x->complete = true;
    blobs_put_drop(x->server->blobs, x->conn->principal->name, x->upload);
    x->upload[0] = 0;
}

void upload_end(struct exchange *x)
{
    bool chunk = x->chunk != NULL && !x->head.chunked;
    give_kept(x);
    free(x->chunk);
    free(x->json);
    x->chunk = NULL;
    x->json = NULL;
    if (!x->conn) return;
    if (chunk) {
        ledger_give(x->conn->principal, LEDGER_PAYLOAD, x->conn->payload_charged);
        x->conn->payload_charged = 0;
    }
    ledger_give(x->conn->principal, LEDGER_PAYLOAD, x->json_charged);
    x->json_charged = 0;
    upload_forget(x);
}
