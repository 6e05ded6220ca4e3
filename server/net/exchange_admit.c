// SPDX-License-Identifier: MIT
// Whether a request of the HTTP API may run: its route, the caller by token or signed link, the
// browser's origin, its parameters.
#include "net/exchange.h"

#include "core/log.h"
#include "net/http_problem.h"
#include "net/listener.h"
#include "net/signed_url.h"
#include "net/upload.h"
#include "net/web_caller.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

// Who it is, by the header or ?token=. The scopes of an operation are checked by dispatch; a
// page needs `view`.
static bool identify(struct exchange *x, struct caller *caller, struct http_problem *problem)
{
    struct web_refusal refusal;
    const char *said = x->head.unreadable_authorization ? NULL : x->head.authorization;
    unsigned scopes = x->route && x->route->type ? 0 : SCOPE_VIEW;
    if (web_caller(x->server, lws_get_socket_fd(x->wsi), said,
                   http_parameter(&x->head, "token"), scopes, caller, &refusal))
        return true;
    http_refuse(problem, (int)refusal.status, refusal.status == 429 ? "busy" : "forbidden",
                "%s", refusal.text);
    problem->retry_after_ms = refusal.retry_after_ms;
    if (refusal.status == 401)
        snprintf(problem->hint, sizeof problem->hint,
                 "send the header Authorization: Bearer TOKEN");
    return false;
}

// A request with a signature has the rights of its link and no others.
static bool identify_link(struct exchange *x, struct caller *caller,
                          struct http_problem *problem)
{
    const char *method = x->head.method, *expires = http_parameter(&x->head, "expires");
    struct accepted from = {0};
    uint32_t retry_ms = 0;
    bool reads = !strcmp(method, "GET") || !strcmp(method, "HEAD");
    bool fine = x->route && x->route->signable && reads;
    if (!fine) http_refuse(problem, 403, "forbidden", "signed links are for pictures alone");
    fine = fine && signed_url_caller(x->server->access, &x->head, caller, problem);
    if (fine && !access_take_request(x->server->access, caller, &retry_ms)) {
        fine = false;
        http_refuse(problem, 429, "busy",
                    "the link's token has used up its quota of requests a second (--rate)");
        problem->retry_after_ms = retry_ms;
    }
    if (fine) {
        x->link_s = strtoull(expires, NULL, 10) - (uint64_t)time(NULL);
        exchange_field(x, "cross-origin-resource-policy:", "cross-origin");
        return true;
    }
    accepted_describe(lws_get_socket_fd(x->wsi), &from);
    log_line(LOG_EVENT, "audit act=refused who=%s peer=%s link=%s http=%d text=\"%s\"",
             from.who, from.peer, x->head.path, problem->status, problem->detail);
    return false;
}

static bool unknown_parameter(const struct exchange *x, struct http_problem *problem)
{
    for (unsigned i = 0; i < x->head.n_parameter; i++) {
        const struct http_parameter *p = &x->head.parameter[i];
        if (p->used) continue;
        bool again = false;
        for (unsigned k = 0; k < i; k++) again |= !strcmp(x->head.parameter[k].name, p->name);
        http_refuse(problem, 400, "bad_request", "parameter %.60s %s", p->name,
                    again ? "was given twice" : "is not known here");
        snprintf(problem->parameter, sizeof problem->parameter, "%.63s", p->name);
        relight_utf8_cut(problem->parameter);
        snprintf(problem->hint, sizeof problem->hint,
                 "/v1/openapi.json lists the parameters of this path");
        return true;
    }
    return false;
}

static bool read_deadline(struct exchange *x, struct http_problem *problem)
{
    char *end;
    const char *text = http_parameter(&x->head, "deadline_ms");
    if (!text) return true;
    double ms = strtod(text, &end);
    if (end > text && !*end && ms >= 1 && ms <= 3.6e6) {
        x->deadline_ms = (uint32_t)ms;
        return true;
    }
    http_refuse(problem, 400, "out_of_range", "deadline_ms is outside 1 to 3600000 ms");
    snprintf(problem->parameter, sizeof problem->parameter, "deadline_ms");
    problem->ranged = true;
    problem->minimum = 1;
    problem->maximum = 3.6e6;
    return false;
}

// A page of an origin that was admitted may read the answers of the API (CORS).
static void allow_origin(struct exchange *x)
{
    char room[300];
    const char *origin = http_header(x->wsi, WSI_TOKEN_ORIGIN, room, sizeof room);
    if (strncmp(x->head.path, "/v1/", 4) || !origin || !*origin) return;
    exchange_field(x, "vary:", "origin");
    exchange_field(x, "access-control-allow-origin:", "%s", origin);
    exchange_field(x, "access-control-expose-headers:", "*");
}

// What a browser asks before a request with a token or a body.
static bool preflight(struct exchange *x)
{
    char room[8];
    const char *origin = http_header(x->wsi, WSI_TOKEN_ORIGIN, room, sizeof room);
    if (strcmp(x->head.method, "OPTIONS") || strncmp(x->head.path, "/v1/", 4) ||
        (origin && !*origin))
        return false;
    exchange_field(x, "access-control-allow-methods:", "GET, HEAD, POST, PUT, DELETE");
    exchange_field(x, "access-control-allow-headers:",
                   "authorization, content-type, if-none-match, last-event-id, x-request-id");
    exchange_field(x, "access-control-max-age:", "600");
    exchange_answer(x, 204, "text/plain", NULL, 0, NULL);
    return true;
}

bool exchange_admit(struct exchange *x, struct http_problem *problem)
{
    allow_origin(x);
    x->route = route_find(x, problem);
    struct caller caller;
    struct http_problem stranger;
    http_parameter(&x->head, "token"); // known everywhere
    if (preflight(x)) return true;
    bool link = http_parameter(&x->head, "sig") != NULL;
    if (link ? !identify_link(x, &caller, &stranger)
             : !(x->route && x->route->open) && !identify(x, &caller, &stranger)) {
        *problem = stranger;
        return false;
    }
    if (!x->route || !read_deadline(x, problem)) return false;
    if (x->head.has_body && x->route->body == BODY_NONE) {
        http_refuse(problem, 400, "bad_request", "%s %s has no body", x->head.method,
                    x->route->pattern);
        return false;
    }
    if (!x->route->type) {
        if (!x->route->any_query && unknown_parameter(x, problem)) return false;
        return x->route->prepare(x, problem);
    }
    return exchange_connect(x, &caller, problem) && x->route->prepare(x, problem) &&
           !unknown_parameter(x, problem) && upload_check(x, problem);
}
