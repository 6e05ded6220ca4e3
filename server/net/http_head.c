// SPDX-License-Identifier: MIT
// The first part of an HTTP request, from libwebsockets' tables.
#include "net/http_head.h"

#include "core/log.h"
#include "frame.h"
#include "net/web_access.h"

#include <ctype.h>
#include <netdb.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

static const struct {
    enum lws_token_indexes token;
    const char *method;
} methods[] = {
    {WSI_TOKEN_GET_URI, "GET"},         {WSI_TOKEN_HEAD_URI, "HEAD"},
    {WSI_TOKEN_POST_URI, "POST"},       {WSI_TOKEN_PUT_URI, "PUT"},
    {WSI_TOKEN_DELETE_URI, "DELETE"},   {WSI_TOKEN_PATCH_URI, "PATCH"},
    {WSI_TOKEN_OPTIONS_URI, "OPTIONS"},
};
enum { N_METHOD = sizeof methods / sizeof *methods };

void http_refuse(struct http_problem *problem, int status, const char *code, const char *fmt,
                 ...)
{
    va_list args;
    *problem = (struct http_problem){.status = status};
    snprintf(problem->code, sizeof problem->code, "%s", code);
    va_start(args, fmt);
    vsnprintf(problem->detail, sizeof problem->detail, fmt, args);
    va_end(args);
    relight_utf8_cut(problem->detail);
}

const char *http_header(struct lws *wsi, enum lws_token_indexes token, char *out, size_t room)
{
    *out = 0;
    if (!lws_hdr_total_length(wsi, token)) return out;
    return lws_hdr_copy(wsi, out, (int)room, token) < 0 ? NULL : out;
}

const char *http_custom_header(struct lws *wsi, const char *name, char *out, size_t room)
{
    int n = (int)strlen(name);
    *out = 0;
    if (lws_hdr_custom_length(wsi, name, n) <= 0) return out;
    return lws_hdr_custom_copy(wsi, out, (int)room, name, n) < 0 ? NULL : out;
}

// The numeric address that the client connected to, "" when it is unknown.
static void local_address(struct lws *wsi, char *out, size_t room)
{
    struct sockaddr_storage a = {0};
    socklen_t n = sizeof a;
    if (getsockname(lws_get_socket_fd(wsi), (struct sockaddr *)&a, &n) ||
        getnameinfo((const struct sockaddr *)&a, n, out, (socklen_t)room, NULL, 0,
                    NI_NUMERICHOST))
        *out = 0;
}

static bool has_signature(struct lws *wsi)
{
    char room[64];
    return (lws_hdr_total_length(wsi, WSI_TOKEN_GET_URI) ||
            lws_hdr_total_length(wsi, WSI_TOKEN_HEAD_URI)) &&
           lws_get_urlarg_by_name(wsi, "sig=", room, sizeof room);
}

bool http_admitted(struct lws *wsi, bool link)
{
    char host_room[300], origin_room[300], site[32], mode[32], local[64];
    const char *host = http_header(wsi, WSI_TOKEN_HOST, host_room, sizeof host_room);
    const char *origin = http_header(wsi, WSI_TOKEN_ORIGIN, origin_room, sizeof origin_room);
    const struct options *o = &http_server(wsi)->options;
    local_address(wsi, local, sizeof local);
    bool host_fine = web_host_allowed(o, local, host);
    bool origin_fine = host_fine && web_origin_allowed(o, host, origin);
    // A foreign page's <img> has no Origin; browsers mark it in these headers.
    const char *from = http_custom_header(wsi, "sec-fetch-site:", site, sizeof site);
    const char *how = http_custom_header(wsi, "sec-fetch-mode:", mode, sizeof mode);
    if (origin_fine && origin && !*origin && from && !strcmp(from, "cross-site") &&
        (!how || strcmp(how, "navigate")))
        origin_fine = false;
    origin_fine |= host_fine && link && has_signature(wsi);
    if (host_fine && origin_fine) return true;
    log_line(LOG_WARN, "http refused host=\"%.100s\" origin=\"%.100s\"; --%s allows it",
             host ? host : "(unreadable)", origin ? origin : "(unreadable)",
             host_fine ? "origins" : "hosts");
    return false;
}

// ---- method, path and query

static int method_index(struct lws *wsi)
{
    for (int i = 0; i < N_METHOD; i++)
        if (lws_hdr_total_length(wsi, methods[i].token)) return i;
    return -1;
}

void http_path(struct lws *wsi, char *out, size_t room)
{
    int i = method_index(wsi);
    if (i < 0 || !http_header(wsi, methods[i].token, out, room)) *out = 0;
}

static bool is_text(const char *text)
{
    size_t n = strlen(text);
    for (size_t i = 0; i < n;) {
        size_t m = relight_utf8_next((const uint8_t *)text + i, n - i);
        unsigned char c = (unsigned char)text[i];
        if (!m || c < 32 || c == 127) return false;
        i += m;
    }
    return true;
}

// libwebsockets has decoded %XX and divided the query at & already.
static bool read_query(struct lws *wsi, struct http_head *head, struct http_problem *problem)
{
    size_t room =
        (size_t)lws_hdr_total_length(wsi, WSI_TOKEN_HTTP_URI_ARGS) + HTTP_PARAMETERS + 2;
    char *at = head->query = malloc(room), *end = at + room;
    if (!at) {
        http_refuse(problem, 503, "no_memory", "not enough memory");
        return false;
    }
    for (int i = 0;; i++) {
        int n = lws_hdr_copy_fragment(wsi, at, (int)(end - at), WSI_TOKEN_HTTP_URI_ARGS, i);
        if (n < 0) return true;
        // libwebsockets makes a slash of the empty query in "/v1/models?".
        if (!n || (n == 1 && *at == '/')) continue;
        if (head->n_parameter == HTTP_PARAMETERS) {
            http_refuse(problem, 400, "bad_request", "more than %d parameters",
                        HTTP_PARAMETERS);
            return false;
        }
        at[n] = 0;
        struct http_parameter *p = &head->parameter[head->n_parameter++];
        p->name = at;
        p->value = strchr(at, '=');
        if (p->value) *p->value++ = 0;
        else p->value = at + n;
        if (!is_text(p->name) || !is_text(p->value) || strlen(p->value) > HTTP_VALUE) {
            http_refuse(problem, 400, "bad_request",
                        "a parameter is longer than %d bytes, or holds control characters or "
                        "bytes that are not UTF-8",
                        HTTP_VALUE);
            return false;
        }
        at += n + 1;
    }
}

const char *http_parameter(struct http_head *head, const char *name)
{
    for (unsigned i = 0; i < head->n_parameter; i++)
        if (!strcmp(head->parameter[i].name, name)) {
            head->parameter[i].used = true;
            return head->parameter[i].value;
        }
    return NULL;
}

// ---- headers

// Both lengths at once are how requests are smuggled past a proxy.
static bool read_chunked(struct lws *wsi, struct http_head *head, const char *length,
                         struct http_problem *problem)
{
    char coding[24];
    const char *said =
        http_header(wsi, WSI_TOKEN_HTTP_TRANSFER_ENCODING, coding, sizeof coding);
    if (*length) {
        http_refuse(problem, 400, "bad_request",
                    "a body has Content-Length or Transfer-Encoding, not both");
        return false;
    }
    if (!said || strcasecmp(said, "chunked")) {
        http_refuse(problem, 501, "unsupported", "Transfer-Encoding: only chunked is taken");
        return false;
    }
    head->chunked = head->unframed = head->has_body = true;
    head->body_size = UINT64_MAX;
    return true;
}

static bool read_length(struct lws *wsi, struct http_head *head, struct http_problem *problem)
{
    char text[24];
    const char *length = http_header(wsi, WSI_TOKEN_HTTP_CONTENT_LENGTH, text, sizeof text);
    bool chunked = lws_hdr_total_length(wsi, WSI_TOKEN_HTTP_TRANSFER_ENCODING) > 0;
    bool sends = !strcmp(head->method, "POST") || !strcmp(head->method, "PUT");
    if (!length || strspn(text, "0123456789") != strlen(text) || strlen(text) > 15) {
        http_refuse(problem, 400, "bad_request", "Content-Length is not a number of bytes");
        return false;
    }
    if (chunked && !read_chunked(wsi, head, text, problem)) return false;
    if (!chunked) {
        // Without a length there is no body, but libwebsockets waits for one.
        head->unframed = sends && !*text;
        head->body_size = strtoull(text, NULL, 10);
        head->has_body = head->body_size > 0;
    }
    if (!head->has_body || sends) return true;
    http_refuse(problem, 400, "bad_request", "%s has no body", head->method);
    return false;
}

static bool read_request_id(struct lws *wsi, struct http_head *head,
                            struct http_problem *problem)
{
    char *id = head->request_id;
    const char *said = http_custom_header(wsi, "x-request-id:", id, HTTP_REQUEST_ID + 1);
    bool fine = said != NULL;
    for (const char *c = id; fine && *c; c++)
        fine = isalnum((unsigned char)*c) || strchr("-_.:", *c);
    if (fine) return true;
    *id = 0;
    http_refuse(problem, 400, "bad_request",
                "X-Request-Id is not 1 to %d letters, digits and - _ . :", HTTP_REQUEST_ID);
    return false;
}

bool http_head_read(struct lws *wsi, struct http_head *head, struct http_problem *problem)
{
    char expect[32];
    int i = method_index(wsi);
    *head = (struct http_head){.method = ""};
    *problem = (struct http_problem){0};
    if (i >= 0) snprintf(head->method, sizeof head->method, "%s", methods[i].method);
    http_path(wsi, head->path, sizeof head->path);
    if (!http_header(wsi, WSI_TOKEN_HTTP_CONTENT_TYPE, head->content_type,
                     sizeof head->content_type))
        *head->content_type = 0;
    http_header(wsi, WSI_TOKEN_HTTP_IF_NONE_MATCH, head->none_match, sizeof head->none_match);
    http_custom_header(wsi, "last-event-id:", head->last_event, sizeof head->last_event);
    const char *said = http_header(wsi, WSI_TOKEN_HTTP_AUTHORIZATION, head->authorization,
                                   sizeof head->authorization);
    head->unreadable_authorization = !said;
    const char *expects = http_header(wsi, WSI_TOKEN_HTTP_EXPECT, expect, sizeof expect);
    head->expects_continue = expects && !strcasecmp(expects, "100-continue");
    if (!read_request_id(wsi, head, problem)) return false;
    if (i < 0 || !*head->path || !is_text(head->path)) {
        http_refuse(problem, 400, "bad_request",
                    "the path is longer than %d bytes or is no text", HTTP_PATH - 1);
        return false;
    }
    return read_length(wsi, head, problem) && read_query(wsi, head, problem);
}

void http_head_finish(struct http_head *head)
{
    free(head->query);
    head->query = NULL;
    head->n_parameter = 0;
}
