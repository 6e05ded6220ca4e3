// SPDX-License-Identifier: MIT
// Answers of operations as HTTP, and the pages that need none.
#include "net/routes.h"
#include "core/image_format.h"

#include "message_text.h"
#include "net/openapi.h"
#include "relight.pb-c.h"
#include "vertex_file.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#define XXH_INLINE_ALL
#include <xxhash.h>

static void drop_payload(struct payload *payload)
{
    if (payload && payload->release) payload->release(payload->owner);
}

void answer_json(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload)
{
    drop_payload(payload);
    exchange_json(x, 200, message);
}

void answer_load(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload)
{
    const Relight__LoadAnswer *in = (const Relight__LoadAnswer *)message;
    drop_payload(payload);
    exchange_field(x, "location:", "/v1/models/%s", in->model);
    if (in->job[0]) // the bake continues
        exchange_field(x, "link:", "</v1/jobs/%s/events>; rel=\"monitor\"", in->job);
    exchange_json(x, in->job[0] ? 202 : 200, message);
}

enum { LINK_CACHED_S = 300 }; // that a signed picture is kept without asking

// An entity tag is of the bytes: it holds for as long as the answer is the same.
static bool is_known(struct exchange *x, const struct payload *payload)
{
    char tag[40];
    XXH128_hash_t hash = XXH3_128bits(payload->bytes, payload->size);
    snprintf(tag, sizeof tag, "\"%016llx%016llx\"", (unsigned long long)hash.high64,
             (unsigned long long)hash.low64);
    exchange_field(x, "etag:", "%s", tag);
    // The same link is the same picture until the model changes.
    if (x->link_s)
        exchange_field(x, "cache-control:", "public, max-age=%u",
                       (unsigned)(x->link_s < LINK_CACHED_S ? x->link_s : LINK_CACHED_S));
    else exchange_field(x, "cache-control:", "private, no-cache");
    return strstr(x->head.none_match, tag) || !strcmp(x->head.none_match, "*");
}

static void add_cost(struct exchange *x, const Relight__Cost *cost, uint64_t generation)
{
    char engine[40];
    if (!cost) return;
    message_enum_word(&relight__engine__descriptor, cost->engine, engine);
    exchange_field(x, "server-timing:",
                   "queue;dur=%.2f, light;dur=%.2f, relight;dur=%.2f, raster;dur=%.2f, "
                   "shade;dur=%.2f, encode;dur=%.2f, total;dur=%.2f",
                   (double)cost->queue_ms, (double)cost->light_ms, (double)cost->relight_ms,
                   (double)cost->raster_ms, (double)cost->shade_ms, (double)cost->encode_ms,
                   (double)cost->total_ms);
    exchange_field(x, "x-relight-engine:", "%s", engine);
    exchange_field(x, "x-relight-error-bound:", "%.4g", (double)cost->error_bound);
    exchange_field(x, "x-relight-generation:", "%llu", (unsigned long long)generation);
    if (cost->note[0]) exchange_field(x, "x-relight-note:", "%s", cost->note);
}

static void answer_bytes(struct exchange *x, const char *type, struct payload *payload)
{
    if (is_known(x, payload)) {
        drop_payload(payload);
        exchange_answer(x, 304, type, NULL, 0, NULL);
    } else {
        exchange_answer(x, 200, type, NULL, 0, payload);
    }
}

// The payload is a packed message: the room's state, or its events.
void answer_room(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload)
{
    bool events = ((const Relight__RoomGetRequest *)x->message)->events;
    const ProtobufCMessageDescriptor *d =
        events ? &relight__room_events__descriptor : &relight__room_state__descriptor;
    ProtobufCMessage *room = protobuf_c_message_unpack(d, NULL, payload->size, payload->bytes);
    ProtobufCMessage *shown = room ? room : message_new(d); // without memory: an empty one
    drop_payload(payload);
    exchange_json(x, room ? 200 : 503, shown);
    if (shown) protobuf_c_message_free_unpacked(shown, NULL);
}

void answer_image(struct exchange *x, const ProtobufCMessage *message, bool last,
                  struct payload *payload)
{
    const Relight__ImageAnswer *in = (const Relight__ImageAnswer *)message;
    add_cost(x, in->cost, in->generation);
    exchange_field(x, "x-relight-size:", "%ux%u", in->width, in->height);
    const struct image_format *format = image_format_of(in->format);
    answer_bytes(x, format ? format->media_type : "application/octet-stream", payload);
}

void answer_environment(struct exchange *x, const ProtobufCMessage *message, bool last,
                        struct payload *payload)
{
    answer_bytes(x, "image/jpeg", payload);
}

static int run_file(struct work *work, const struct prt_context *ctx)
{
    struct work_of_exchange *w = (struct work_of_exchange *)work;
    FILE *out = open_memstream(&w->bytes, &w->n);
    struct prt_vertex_data data = {.n_vertex = w->n_vertex,
                                   .color = (const float(*)[3])w->payload.bytes};
    if (!out) return PRT_NOMEM;
    int err = prt_vertex_file_write(
        out, w->format == COLORS_CSV ? PRT_VERTEX_CSV : PRT_VERTEX_NPY, &data);
    bool failed = ferror(out);
    failed |= fclose(out) != 0;
    return err || failed ? PRT_NOMEM : PRT_OK;
}

// A JSON body may name a format whose colours are not the floats that a file of numbers is made
// of.
static void refuse_numbers(struct exchange *x, struct payload *payload)
{
    struct http_problem problem;
    drop_payload(payload);
    http_refuse(&problem, 400, "bad_request",
                "format: csv and npy are made of f32, and the body names another format");
    snprintf(problem.parameter, sizeof problem.parameter, "format");
    exchange_refuse(x, &problem);
}

void answer_colors(struct exchange *x, const ProtobufCMessage *message, bool last,
                   struct payload *payload)
{
    const Relight__ColorsAnswer *in = (const Relight__ColorsAnswer *)message;
    if (x->format >= COLORS_CSV && in->format != RELIGHT__COLOR_FORMAT__COLOR_F32) {
        refuse_numbers(x, payload);
        return;
    }
    add_cost(x, in->cost, in->generation);
    exchange_field(x, "x-relight-vertices:", "%u", in->n_vertex);
    exchange_field(x, "x-relight-planes:", "%u", in->n_plane);
    exchange_field(x, "x-relight-plane-bytes:", "%llu", (unsigned long long)in->plane_bytes);
    // A JSON body may ask for several planes; a file has the first.
    if (x->format == COLORS_CSV)
        exchange_work(x, payload, in->n_vertex, x->format, "text/csv", run_file);
    else if (x->format == COLORS_NPY)
        exchange_work(x, payload, in->n_vertex, x->format, "application/x-npy", run_file);
    else answer_bytes(x, "application/octet-stream", payload);
}

// ---- jobs as server-sent events

void answer_events(struct exchange *x, const ProtobufCMessage *message, bool last,
                   struct payload *payload)
{
    const Relight__Progress *in = (const Relight__Progress *)message;
    static const char *const ends[] = {[RELIGHT__JOB_STATE__JOB_DONE] = "done",
                                       [RELIGHT__JOB_STATE__JOB_FAILED] = "failed",
                                       [RELIGHT__JOB_STATE__JOB_CANCELLED] = "cancelled"};
    drop_payload(payload);
    // EventSource connects again when a stream ends; 204 tells it that there is nothing more.
    if (!x->status && last && x->head.last_event[0]) {
        exchange_answer(x, 204, "text/event-stream", NULL, 0, NULL);
        return;
    }
    if (!x->status) exchange_stream(x, "text/event-stream");
    cJSON *json = message_to_json(message);
    char *data = json ? cJSON_PrintUnformatted(json) : NULL, *text = NULL;
    const char *event =
        last && (size_t)in->state < sizeof ends / sizeof *ends && ends[in->state]
            ? ends[in->state]
            : "progress";
    if (data &&
        asprintf(&text, "event: %s\nid: %u\ndata: %s\n\n", event, ++x->n_event, data) < 0)
        text = NULL;
    if (text) exchange_piece(x, text);
    else if (x->conn) connection_close(x->conn, "not enough memory for an answer");
    free(text);
    cJSON_free(data);
    cJSON_Delete(json);
    if (last) exchange_stream_end(x);
}

// ---- uploads

void answer_blob(struct exchange *x, const ProtobufCMessage *message, bool last,
                 struct payload *payload)
{
    const Relight__PutBlobAnswer *in = (const Relight__PutBlobAnswer *)message;
    struct http_problem problem;
    char *text = NULL;
    const char *hash = in->complete ? in->hash : x->id;
    drop_payload(payload);
    bool asks = !x->head.has_body;
    if (asks && !in->complete && !in->received) {
        http_refuse(&problem, 404, "not_found", "this blob was not uploaded");
        exchange_refuse(x, &problem);
        return;
    }
    if (in->complete) exchange_field(x, "location:", "/v1/blobs/%s", hash);
    exchange_field(x, "upload-offset:", "%llu", (unsigned long long)in->received);
    exchange_field(x, "cache-control:", "no-store");
    if (asprintf(&text, "{\"hash\":\"%s\",\"complete\":%s,\"received\":%llu}", hash,
                 in->complete ? "true" : "false", (unsigned long long)in->received) < 0)
        text = NULL;
    int status = asks ? 200 : in->complete ? 201 : 202;
    exchange_text(x, status, "application/json", text);
}

// ---- pages

static bool answer_text(struct exchange *x, int status, const char *type, const char *text)
{
    exchange_field(x, "cache-control:", "no-store");
    exchange_text(x, status, type, strdup(text));
    return true;
}

bool page_health(struct exchange *x, struct http_problem *problem)
{
    bool well = !x->server->draining;
    return answer_text(x, well ? 200 : 503, "text/plain", well ? "ok\n" : "draining\n");
}

// 404 and no 503 while the daemon leaves: a proxy then takes it out of rotation without cutting
// what it has (HAProxy's http-check disable-on-404).
bool page_ready(struct exchange *x, struct http_problem *problem)
{
    char why[200], text[220];
    const struct server *server = x->server;
    if (server->leaving || server->draining)
        return answer_text(x, 404, "text/plain", "leaving: this daemon takes no new clients\n");
    bool ready = server->is_ready(server, why);
    snprintf(text, sizeof text, ready ? "ready\n" : "not ready: %s\n", why);
    return answer_text(x, ready ? 200 : 503, "text/plain", text);
}

bool page_metrics(struct exchange *x, struct http_problem *problem)
{
    size_t n = 0;
    char *text = stats_prometheus(x->server, &n);
    exchange_text(x, 200, "text/plain; version=0.0.4; charset=utf-8", text);
    return true;
}

bool page_openapi(struct exchange *x, struct http_problem *problem)
{
    struct payload whole = {openapi_json, openapi_json_size, NULL, NULL};
    answer_bytes(x, "application/json", &whole);
    return true;
}
