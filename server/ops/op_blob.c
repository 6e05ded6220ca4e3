// SPDX-License-Identifier: MIT
// PUT_BLOB: passes a chunk to the store of uploads, and answers when a worker has written it.
#include "core/events.h"
#include "core/log.h"
#include "net/dispatch.h"
#include "net/request.h"
#include "relight.pb-c.h"
#include "render/render.h"
#include "store/eviction.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct upload_request {
    struct blob_put put; // first
    struct server *server;
    struct request *request;  // NULL: it ended
    struct held_bytes *bytes; // a worker may read them after the request ended
    bool made_room;           // models were evicted for it
};

static void abandon(struct request *request)
{
    struct upload_request *r = request->state;
    r->request = NULL;
    blobs_put_abandon(&r->put);
}

// Radiance, OpenEXR and DDS files are probably environments; others may be textures.
static void environment_arrived(struct server *server, const struct blob_put *put)
{
    struct event e = {.kind = RELIGHT__EVENT_KIND__EVENT_ENVIRONMENT_ADDED};
    snprintf(e.env, sizeof e.env, "env:%s", put->hash);
    snprintf(e.name, sizeof e.name, "%.*s", (int)sizeof e.name - 1, put->name);
    relight_utf8_cut(e.name);
    snprintf(e.visible_to, sizeof e.visible_to, "%s", put->principal);
    events_publish(server->events, &e);
    env_prefetch(server, put->hash);
}

// For an upload that begins, models make room once, after unused uploads.
static bool tries_again(struct upload_request *r)
{
    struct blob_put *put = &r->put;
    if (!put->no_room || r->made_room) return false;
    r->made_room = true;
    evict_for_upload(r->server, put->principal, put->size); // may end the request
    put->no_room = put->own_limit = false;
    blobs_put(r->server->blobs, put);
    return true;
}

static void done(struct blob_put *put)
{
    struct upload_request *r = (struct upload_request *)put;
    if (tries_again(r)) return;
    struct server *server = r->server;
    struct request *request = r->request;
    if (put->arrived) {
        log_line(LOG_EVENT, "blob hash=%.12s size=%llu owner=\"%s\"", put->hash,
                 (unsigned long long)put->size, put->principal);
        if (request) log_request_set(request->request_id);
        if (blobs_format(server->blobs, put->hash) != BLOB_OTHER)
            environment_arrived(server, put);
        log_request_set("");
    }
    if (request && put->code) {
        request->abandon = NULL;
        request->conn->own_limit = put->own_limit;
        if (put->no_room)
            evict_explain(server, put->own_limit ? put->principal : NULL, put->error);
        request_fail(request, put->code, "%s", put->error);
    } else if (request) {
        Relight__PutBlobAnswer out = RELIGHT__PUT_BLOB_ANSWER__INIT;
        out.received = put->received;
        out.complete = put->complete;
        if (put->complete) out.hash = put->hash;
        request->abandon = NULL;
        request_answer(request, &out.base, NULL);
    }
    held_bytes_release(r->bytes);
    free(r);
}

void op_put_blob(struct request *request)
{
    const Relight__PutBlobRequest *in = (const Relight__PutBlobRequest *)request->message;
    bool unnamed = in->upload[0] && !in->hash[0];
    const char *hash = unnamed ? in->upload : in->hash;
    if (!relight_hash_valid(hash) || (in->upload[0] && in->hash[0])) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST,
                     "hash, or upload in its place, is not 64 lower-case hex digits");
        return;
    }
    if (unnamed && !in->size) {
        Relight__PutBlobAnswer out = RELIGHT__PUT_BLOB_ANSWER__INIT;
        blobs_put_drop(request->server->blobs, request->principal->name, hash);
        request_answer(request, &out.base, NULL);
        return;
    }
    size_t n = request->payload_size;
    struct upload_request *r = calloc(1, sizeof *r);
    if (!r || (n && !(r->bytes = request_take_payload(request)))) {
        free(r);
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    r->server = request->server;
    r->request = request;
    struct blob_put *put = &r->put;
    memcpy(put->hash, hash, BLOB_HASH);
    put->unnamed = unnamed;
    snprintf(put->principal, sizeof put->principal, "%s", request->principal->name);
    if (strlen(in->name) <= BLOB_NAME) strcpy(put->name, in->name);
    put->size = in->size;
    put->offset = in->offset;
    put->bytes = n ? r->bytes->bytes : NULL;
    put->n = n;
    put->done = done;
    request->state = r;
    request->abandon = abandon;
    blobs_put(request->server->blobs, put);
}
