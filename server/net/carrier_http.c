// SPDX-License-Identifier: MIT
// HTTP and WebSocket through libwebsockets: /healthz, /metrics, the page's files, and frames as
// binary messages on /ws. libwebsockets runs its own poll loop; ours is nested in it as a
// single descriptor, so that everything stays on one thread.
#include "net/carrier.h"

#include "core/log.h"

#include <libwebsockets.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>

enum {
    CHUNK = 64 << 10, // largest piece of a message handed to libwebsockets
    MESSAGE_MAX = SERVER_MAX_PAYLOAD + SERVER_MAX_HEADER + 4096,
};

// A WebSocket client; conn NULL: closed by us, the socket follows.
struct session {
    struct connection *conn;
    struct lws *wsi;
    uint8_t *message; // what came of the current one
    size_t n, room;
};

// A plain HTTP request whose answer is being sent.
struct page_session {
    char *body;
    size_t n, sent;
};

static struct lws_context *context;
static struct lws_vhost *vhost;
static struct server *the_server;
static uint8_t piece[LWS_PRE + CHUNK];

// ---- the carrier

static void ws_want_write(struct connection *conn)
{
    struct session *s = conn->carrier_data;
    lws_callback_on_writable(s->wsi);
}

static void ws_set_reading(struct connection *conn, bool on)
{
    struct session *s = conn->carrier_data;
    lws_rx_flow_control(s->wsi, on);
}

static void ws_close(struct connection *conn)
{
    struct session *s = conn->carrier_data;
    s->conn = NULL;
    lws_set_timeout(s->wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
}

static const struct carrier ws_carrier = {"websocket", ws_want_write, ws_set_reading, ws_close};

static bool gather(struct session *s, const void *bytes, size_t n)
{
    if (n > MESSAGE_MAX - s->n) return false;
    if (s->n + n > s->room) {
        size_t room = 2 * s->room > s->n + n ? 2 * s->room : s->n + n;
        uint8_t *grown = realloc(s->message, room);
        if (!grown) return false;
        s->message = grown;
        s->room = room;
    }
    memcpy(s->message + s->n, bytes, n);
    s->n += n;
    return true;
}

static int ws_receive(struct session *s, struct lws *wsi, const void *bytes, size_t n)
{
    if (!s->conn || s->conn->closing) return s->conn ? 0 : -1;
    // Before HELLO nobody may make us hold more than its frame.
    size_t limit = s->conn->greeted ? MESSAGE_MAX : SERVER_HELLO_HEADER + 64;
    if (s->n + n > limit || !gather(s, bytes, n)) {
        connection_close(s->conn, "a message is larger than the limit");
        return -1;
    }
    s->conn->heard_ns = loop_now_ns();
    if (!lws_is_final_fragment(wsi) || lws_remaining_packet_payload(wsi)) return 0;
    size_t size = s->n;
    s->n = 0;
    connection_message(s->conn, s->message, size);
    if (s->room > 1 << 20) { // one large upload does not keep its memory
        free(s->message);
        s->message = NULL;
        s->room = 0;
    }
    return s->conn ? 0 : -1;
}

static int ws_write(struct session *s, struct lws *wsi)
{
    struct connection *conn = s->conn;
    if (!conn) return -1;
    const struct out_frame *f = conn->out;
    if (!f) return 0;
    struct iovec iov[2];
    size_t n = 0, left = f->size - f->sent;
    int n_iov = connection_output(conn, iov, 2);
    for (int i = 0; i < n_iov && n < CHUNK && n < left; i++) {
        size_t take = iov[i].iov_len < CHUNK - n ? iov[i].iov_len : CHUNK - n;
        if (take > left - n) take = left - n; // a message is one frame, no more
        memcpy(piece + LWS_PRE + n, iov[i].iov_base, take);
        n += take;
    }
    int how = f->sent ? LWS_WRITE_CONTINUATION : LWS_WRITE_BINARY;
    if (n < left) how |= LWS_WRITE_NO_FIN;
    if (lws_write(wsi, piece + LWS_PRE, n, (enum lws_write_protocol)how) < (int)n) return -1;
    connection_written(conn, n);
    if (s->conn && s->conn->out) lws_callback_on_writable(wsi);
    return s->conn ? 0 : -1;
}

// A page of somebody else's may not use the visitor's way to us: browsers tell a page's origin.
static bool origin_allowed(struct lws *wsi)
{
    char origin[256] = "", host[256] = "";
    const char *list = the_server->options.origins;
    if (lws_hdr_copy(wsi, origin, sizeof origin, WSI_TOKEN_ORIGIN) <= 0) return true;
    const char *name = strstr(origin, "://");
    lws_hdr_copy(wsi, host, sizeof host, WSI_TOKEN_HOST);
    if (name && !strcasecmp(name + 3, host)) return true;
    size_t n = strlen(origin);
    for (const char *at = list; *at;) {
        size_t m = strcspn(at, ",");
        if ((m == 1 && *at == '*') || (m == n && !strncasecmp(at, origin, n))) return true;
        at += m + (at[m] == ',');
    }
    log_line(LOG_WARN, "websocket origin=\"%s\" refused; --origins allows it", origin);
    return false;
}

static int on_ws(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                 size_t n)
{
    struct session *s = user;
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION: {
        char path[16];
        if (lws_hdr_copy(wsi, path, sizeof path, WSI_TOKEN_GET_URI) < 0 ||
            strcmp(path, "/ws") || !origin_allowed(wsi))
            return -1;
        if (the_server->draining ||
            the_server->n_connection >= the_server->options.connections) {
            the_server->stats.connections_refused++;
            return -1;
        }
        return 0;
    }
    case LWS_CALLBACK_ESTABLISHED: {
        char peer[96] = "?";
        lws_get_peer_simple(wsi, peer, sizeof peer);
        *s = (struct session){.wsi = wsi};
        char who[96];
        snprintf(who, sizeof who, "addr:%.80s", peer);
        s->conn = connection_open(the_server, &ws_carrier, s, peer, who);
        return s->conn ? 0 : -1;
    }
    case LWS_CALLBACK_RECEIVE:
        return ws_receive(s, wsi, in, n);
    case LWS_CALLBACK_SERVER_WRITEABLE:
        return ws_write(s, wsi);
    case LWS_CALLBACK_CLOSED: {
        struct connection *conn = s->conn;
        if (conn) connection_close(conn, "closed by peer");
        free(s->message);
        s->message = NULL;
        return 0;
    }
    default:
        return 0;
    }
}

// ---- plain HTTP

static int answer_text(struct lws *wsi, struct page_session *p, unsigned status,
                       const char *type, char *body, size_t n)
{
    uint8_t head[LWS_PRE + 1024], *start = head + LWS_PRE, *at = start,
                                  *end = head + sizeof head - 1;
    p->body = body;
    p->n = n;
    p->sent = 0;
    if (!body || lws_add_http_common_headers(wsi, status, type, n, &at, end) ||
        lws_finalize_write_http_header(wsi, start, &at, end))
        return -1;
    lws_callback_on_writable(wsi);
    return 0;
}

static int page_write(struct lws *wsi, struct page_session *p)
{
    if (!p->body) return 0;
    size_t n = p->n - p->sent < CHUNK ? p->n - p->sent : CHUNK;
    bool last = p->sent + n == p->n;
    memcpy(piece + LWS_PRE, p->body + p->sent, n);
    if (lws_write(wsi, piece + LWS_PRE, n, last ? LWS_WRITE_HTTP_FINAL : LWS_WRITE_HTTP) <
        (int)n)
        return -1;
    p->sent += n;
    if (!last) {
        lws_callback_on_writable(wsi);
        return 0;
    }
    free(p->body);
    p->body = NULL;
    return lws_http_transaction_completed(wsi) ? -1 : 0;
}

static int page_request(struct lws *wsi, struct page_session *p)
{
    char path[64] = "";
    lws_hdr_copy(wsi, path, sizeof path, WSI_TOKEN_GET_URI);
    if (!strcmp(path, "/healthz")) {
        bool well = !the_server->draining;
        char *text = strdup(well ? "ok\n" : "draining\n");
        return answer_text(wsi, p, well ? HTTP_STATUS_OK : HTTP_STATUS_SERVICE_UNAVAILABLE,
                           "text/plain", text, text ? strlen(text) : 0);
    }
    if (!strcmp(path, "/metrics")) {
        size_t n = 0;
        char *text = stats_prometheus(the_server, &n);
        return answer_text(wsi, p, HTTP_STATUS_OK, "text/plain; version=0.0.4", text, n);
    }
    if (lws_return_http_status(wsi, HTTP_STATUS_NOT_FOUND, NULL)) return -1;
    return lws_http_transaction_completed(wsi) ? -1 : 0;
}

static int on_page(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                   size_t n)
{
    struct page_session *p = user;
    switch (reason) {
    case LWS_CALLBACK_HTTP:
        return page_request(wsi, p);
    case LWS_CALLBACK_HTTP_WRITEABLE:
        return page_write(wsi, p);
    case LWS_CALLBACK_CLOSED_HTTP:
        if (p) {
            free(p->body);
            p->body = NULL;
        }
        return 0;
    case LWS_CALLBACK_HTTP_FILE_COMPLETION:
        return lws_http_transaction_completed(wsi) ? -1 : 0;
    default:
        return lws_callback_http_dummy(wsi, reason, user, in, n);
    }
}

// ---- our loop inside theirs

static int on_loop(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                   size_t n)
{
    if (reason == LWS_CALLBACK_RAW_RX_FILE) loop_turn(the_server->loop, 0);
    return 0;
}

static const struct lws_protocols protocols[] = {
    {"http", on_page, sizeof(struct page_session), 0, 0, NULL, 0},
    {"relight.v1", on_ws, sizeof(struct session), CHUNK, 0, NULL, 0},
    {"loop", on_loop, 0, 0, 0, NULL, 0},
    {NULL, NULL, 0, 0, 0, NULL, 0},
};

// Types that libwebsockets does not know are answered 415.
static const struct lws_protocol_vhost_options mimetypes[] = {
    {&mimetypes[1], NULL, ".wasm", "application/wasm"},
    {&mimetypes[2], NULL, ".mjs", "text/javascript"},
    {&mimetypes[3], NULL, ".map", "application/json"},
    {&mimetypes[4], NULL, ".glb", "model/gltf-binary"},
    {&mimetypes[5], NULL, ".hdr", "image/vnd.radiance"},
    {&mimetypes[6], NULL, ".exr", "image/x-exr"},
    {NULL, NULL, ".webp", "image/webp"},
};

static struct lws_http_mount mount[3] = {
    {.mountpoint = "/healthz",
     .mountpoint_len = 8,
     .origin = "http",
     .protocol = "http",
     .origin_protocol = LWSMPRO_CALLBACK},
    {.mountpoint = "/metrics",
     .mountpoint_len = 8,
     .origin = "http",
     .protocol = "http",
     .origin_protocol = LWSMPRO_CALLBACK},
    {.mountpoint = "/",
     .mountpoint_len = 1,
     .def = "index.html",
     .extra_mimetypes = mimetypes,
     .origin_protocol = LWSMPRO_FILE,
     .cache_max_age = 60,
     .cache_revalidate = 1},
};

static void on_lws_log(int level, const char *line)
{
    log_line(level & LLL_ERR ? LOG_ERR : LOG_WARN, "http %.*s", (int)strcspn(line, "\n"), line);
}

int http_open(struct server *server, const char *address)
{
    static char host[256];
    const char *colon = strrchr(address, ':');
    char *end = NULL;
    long port = colon ? strtol(colon + 1, &end, 10) : 0;
    if (!colon || *end || port < 1 || port > 65535) {
        log_line(LOG_ERR, "http %s: HOST:PORT is wanted", address);
        return -1;
    }
    snprintf(host, sizeof host, "%.*s", (int)(colon - address), address);
    the_server = server;
    lws_set_log_level(LLL_ERR | LLL_WARN, on_lws_log);
    mount[0].mount_next = &mount[1];
    if (server->options.page[0]) {
        mount[1].mount_next = &mount[2];
        mount[2].origin = server->options.page;
    }
    struct lws_context_creation_info info = {0};
    info.port = (int)port;
    info.iface = host[0] && strcmp(host, "*") && strcmp(host, "0.0.0.0") ? host : NULL;
    info.protocols = protocols;
    info.mounts = mount;
    info.gid = info.uid = (gid_t)-1;
    info.fd_limit_per_thread = server->options.connections + 64;
    info.keepalive_timeout = 30;
    info.timeout_secs = 15;
    info.options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS |
                   LWS_SERVER_OPTION_HTTP_HEADERS_SECURITY_BEST_PRACTICES_ENFORCE;
    if (!info.iface) info.options |= LWS_SERVER_OPTION_DISABLE_IPV6;
    context = lws_create_context(&info);
    vhost = context ? lws_create_vhost(context, &info) : NULL;
    lws_sock_file_fd_type fd;
    fd.filefd = dup(loop_fd(server->loop)); // closed by libwebsockets
    if (!vhost || fd.filefd < 0 ||
        !lws_adopt_descriptor_vhost(vhost, LWS_ADOPT_RAW_FILE_DESC, fd, "loop", NULL)) {
        log_line(LOG_ERR, "http %s: cannot be served (in use?)", address);
        return -1;
    }
    log_line(LOG_EVENT, "listen address=http:%s page=%s", address, server->options.page);
    return 0;
}

bool http_is_open(void)
{
    return context != NULL;
}

void http_turn(struct server *server)
{
    lws_service(context, 0);
}

void http_drain(void)
{
    // /healthz goes on saying "draining" until the end, so that a proxy looks elsewhere.
}

void http_close(void)
{
    if (context) lws_context_destroy(context);
    context = NULL;
}
