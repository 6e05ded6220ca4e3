// SPDX-License-Identifier: MIT
// HTTP and WebSocket through libwebsockets: /healthz, /metrics, the page's files, and frames as
// binary messages on /ws. libwebsockets runs its own poll loop; the daemon's loop is
// nested in it as a single descriptor, so that one thread serves both. net/listener.c accepts
// the clients.
#include "net/carrier.h"

#include "core/log.h"
#include "core/tls.h"
#include "core/token.h"
#include "net/listener.h"
#include "net/web_access.h"
#include "net/web_caller.h"

#include <fcntl.h>
#include <libwebsockets.h>
#include <math.h>
#include <netdb.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <unistd.h>

enum {
    CHUNK = 64 << 10,       // largest piece of a message handed to libwebsockets
    PLAIN_MAX = 128,        // HTTP clients beyond --connections
    TRY_AGAIN_LATER = 1013, // WebSocket close code
};

#define SUBPROTOCOL "relight.v1"

// A WebSocket client; conn NULL: the daemon closed it, and the socket closes next.
struct session {
    struct connection *conn;
    struct lws *wsi;
    uint8_t *refusal; // where no connection was opened: the ERROR frame to send
    size_t n_refusal;
};

// A plain HTTP request whose answer is being sent.
struct page_session {
    char *body;
    size_t n, sent;
};

static struct lws_context *context;
static struct lws_vhost *vhost, *tls_vhost; // tls_vhost NULL: no TLS
static uint8_t piece[LWS_PRE + CHUNK];
static unsigned n_wsi; // sockets of libwebsockets: HTTP, WebSocket, and the loop's descriptor

static struct server *server_of(struct lws *wsi)
{
    return lws_context_user(lws_get_context(wsi));
}

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

static size_t ws_unsent(const struct connection *conn)
{
    const struct session *s = conn->carrier_data;
    return socket_unsent(lws_get_socket_fd(s->wsi));
}

static const struct carrier ws_carrier = {"websocket", ws_want_write, ws_set_reading, ws_close,
                                          ws_unsent};

static int ws_receive(struct session *s, struct lws *wsi, const void *bytes, size_t n)
{
    if (s->refusal) return 0;
    if (!s->conn || s->conn->closing) return s->conn ? 0 : -1;
    bool last = lws_is_final_fragment(wsi) && !lws_remaining_packet_payload(wsi);
    connection_part(s->conn, bytes, n, last);
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
        if (take > left - n) take = left - n; // a message holds one frame
        memcpy(piece + LWS_PRE + n, iov[i].iov_base, take);
        n += take;
    }
    int how = f->sent ? LWS_WRITE_CONTINUATION : LWS_WRITE_BINARY;
    if (n < left) how |= LWS_WRITE_NO_FIN;
    if (lws_write(wsi, piece + LWS_PRE, n, (enum lws_write_protocol)how) < (int)n) return -1;
    lws_validity_confirmed(
        wsi); // a slow reader answers pings late; --write-time limits it instead
    connection_written(conn, n);
    if (s->conn && s->conn->out) lws_callback_on_writable(wsi);
    return s->conn ? 0 : -1;
}

// ---- admission

// Copies a header. NULL when it is too long or broken, "" when it is absent.
static const char *header(struct lws *wsi, enum lws_token_indexes token, char *out, size_t room)
{
    *out = 0;
    if (!lws_hdr_total_length(wsi, token)) return out;
    return lws_hdr_copy(wsi, out, (int)room, token) < 0 ? NULL : out;
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

// Checks Host and Origin. Browsers send both with every request that can change something.
static bool admitted(struct lws *wsi)
{
    char host_room[300], origin_room[300], local[64];
    const char *host = header(wsi, WSI_TOKEN_HOST, host_room, sizeof host_room);
    const char *origin = header(wsi, WSI_TOKEN_ORIGIN, origin_room, sizeof origin_room);
    const struct options *o = &server_of(wsi)->options;
    local_address(wsi, local, sizeof local);
    bool host_fine = web_host_allowed(o, local, host);
    if (host_fine && web_origin_allowed(o, host, origin)) return true;
    log_line(LOG_WARN, "http refused host=\"%.100s\" origin=\"%.100s\"; --%s allows it",
             host ? host : "(unreadable)", origin ? origin : "(unreadable)",
             host_fine ? "origins" : "hosts");
    return false;
}

// Allows an upgrade to WebSocket on /ws with subprotocol relight.v1 only. libwebsockets chooses
// among the subprotocols that the client names; on_page and on_loop refuse their own.
static int confirm_upgrade(struct lws *wsi, const char *to)
{
    char path_room[16], protocol_room[128];
    const char *path = header(wsi, WSI_TOKEN_GET_URI, path_room, sizeof path_room);
    const char *names = header(wsi, WSI_TOKEN_PROTOCOL, protocol_room, sizeof protocol_room);
    if (!strcmp(to, "websocket") && path && !strcmp(path, "/ws") && names &&
        strstr(names, SUBPROTOCOL) && admitted(wsi))
        return 0;
    lws_return_http_status(wsi, HTTP_STATUS_FORBIDDEN, NULL);
    return -1;
}

// Requests with a body are refused: libwebsockets would wait for it.
static bool plain_get(struct lws *wsi)
{
    char room[8];
    const char *length = header(wsi, WSI_TOKEN_HTTP_CONTENT_LENGTH, room, sizeof room);
    return (lws_hdr_total_length(wsi, WSI_TOKEN_GET_URI) ||
            lws_hdr_total_length(wsi, WSI_TOKEN_HEAD_URI)) &&
           !lws_hdr_total_length(wsi, WSI_TOKEN_HTTP_TRANSFER_ENCODING) && length &&
           (!*length || !strcmp(length, "0"));
}

static int filter_request(struct lws *wsi)
{
    unsigned status = !plain_get(wsi)  ? HTTP_STATUS_METHOD_NOT_ALLOWED
                      : !admitted(wsi) ? HTTP_STATUS_FORBIDDEN
                                       : 0;
    if (status) lws_return_http_status(wsi, status, NULL);
    return status != 0;
}

// Opens a connection for the client; beyond the limits it gets an ERROR frame instead.
static void established(struct session *s)
{
    struct server *server = server_of(s->wsi);
    const char *full = "the daemon is at its limit of connections (--connections)";
    struct accepted client = {0};
    accepted_describe(lws_get_socket_fd(s->wsi), &client);
    if (!server->draining && server->n_connection < server->options.connections) {
        full = "this connection exceeds a limit";
        s->conn = connection_open(server, &ws_carrier, s, client.peer, client.who);
    }
    if (s->conn) return;
    server->stats.connections_refused++;
    if (!refusal_frame(server, full, &s->refusal, &s->n_refusal))
        lws_callback_on_writable(s->wsi);
}

static int write_refusal(struct session *s, struct lws *wsi)
{
    if (s->n_refusal > CHUNK) return -1;
    memcpy(piece + LWS_PRE, s->refusal, s->n_refusal);
    lws_write(wsi, piece + LWS_PRE, s->n_refusal, LWS_WRITE_BINARY);
    lws_close_reason(wsi, (enum lws_close_status)TRY_AGAIN_LATER, NULL, 0);
    return -1;
}

static int on_ws(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                 size_t n)
{
    struct session *s = user;
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION: {
        char room[16];
        const char *path = header(wsi, WSI_TOKEN_GET_URI, room, sizeof room);
        return path && !strcmp(path, "/ws") && admitted(wsi) ? 0 : -1;
    }
    case LWS_CALLBACK_ESTABLISHED:
        *s = (struct session){.wsi = wsi};
        established(s);
        return s->conn || s->refusal ? 0 : -1;
    case LWS_CALLBACK_RECEIVE:
        return ws_receive(s, wsi, in, n);
    case LWS_CALLBACK_SERVER_WRITEABLE:
        return s->refusal ? write_refusal(s, wsi) : ws_write(s, wsi);
    case LWS_CALLBACK_CLOSED: {
        struct connection *conn = s->conn;
        if (conn) connection_close(conn, "closed by peer");
        free(s->refusal);
        s->refusal = NULL;
        return 0;
    }
    default:
        return 0;
    }
}

// ---- plain HTTP

// retry_after_s: 0 for no such header.
static int answer_text(struct lws *wsi, struct page_session *p, unsigned status,
                       const char *type, char *body, size_t n, unsigned retry_after_s)
{
    uint8_t head[LWS_PRE + 1024], *start = head + LWS_PRE, *at = start,
                                  *end = head + sizeof head - 1;
    p->body = body;
    p->n = n;
    p->sent = 0;
    char seconds[16];
    int length = snprintf(seconds, sizeof seconds, "%u", retry_after_s);
    if (!body || lws_add_http_common_headers(wsi, status, type, n, &at, end) ||
        (retry_after_s && lws_add_http_header_by_token(wsi, WSI_TOKEN_HTTP_RETRY_AFTER,
                                                       (uint8_t *)seconds, length, &at, end)) ||
        (status == HTTP_STATUS_UNAUTHORIZED &&
         lws_add_http_header_by_token(wsi, WSI_TOKEN_HTTP_WWW_AUTHENTICATE,
                                      (const uint8_t *)"Bearer", 6, &at, end)) ||
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

// The status that refuses this request, 0 when its caller has the scopes. *caller is filled
// then.
static unsigned refusal_of(struct lws *wsi, unsigned scopes, struct caller *caller,
                           struct web_refusal *refusal)
{
    char room[TOKEN_ROOM + 16], query[TOKEN_ROOM + 16];
    const char *said = header(wsi, WSI_TOKEN_HTTP_AUTHORIZATION, room, sizeof room);
    const char *token = lws_get_urlarg_by_name(wsi, "token=", query, sizeof query);
    return web_caller(server_of(wsi), lws_get_socket_fd(wsi), said, token, scopes, caller,
                      refusal)
               ? 0
               : refusal->status;
}

// Answers a refused request; what its caller returns to libwebsockets.
static int answer_refusal(struct lws *wsi, struct page_session *p,
                          const struct web_refusal *refusal)
{
    char *text = NULL;
    int n = asprintf(&text, "%s\n", refusal->text);
    return answer_text(wsi, p, refusal->status, "text/plain", n < 0 ? NULL : text,
                       n < 0 ? 0 : (size_t)n, refusal->retry_after_s);
}

static int page_request(struct lws *wsi, struct page_session *p)
{
    char room[16];
    const char *path = header(wsi, WSI_TOKEN_GET_URI, room, sizeof room);
    if (!path) path = ""; // longer than any path that is served
    if (!strcmp(path, "/healthz")) {
        bool well = !server_of(wsi)->draining;
        char *text = strdup(well ? "ok\n" : "draining\n");
        return answer_text(wsi, p, well ? HTTP_STATUS_OK : HTTP_STATUS_SERVICE_UNAVAILABLE,
                           "text/plain", text, text ? strlen(text) : 0, 0);
    }
    if (!strcmp(path, "/metrics")) {
        struct caller caller;
        struct web_refusal refusal;
        if (refusal_of(wsi, SCOPE_VIEW, &caller, &refusal))
            return answer_refusal(wsi, p, &refusal);
        size_t n = 0;
        char *text = stats_prometheus(server_of(wsi), &n);
        return answer_text(wsi, p, HTTP_STATUS_OK, "text/plain; version=0.0.4", text, n, 0);
    }
    if (lws_return_http_status(wsi, HTTP_STATUS_NOT_FOUND, NULL)) return -1;
    return lws_http_transaction_completed(wsi) ? -1 : 0;
}

static int on_page(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                   size_t n)
{
    struct page_session *p = user;
    switch (reason) {
    case LWS_CALLBACK_WSI_CREATE:
        n_wsi++;
        return 0;
    case LWS_CALLBACK_WSI_DESTROY:
        n_wsi--;
        return 0;
    case LWS_CALLBACK_OPENSSL_LOAD_EXTRA_SERVER_VERIFY_CERTS:
        tls_attach(server_of(wsi)->tls, user);
        return 0;
    case LWS_CALLBACK_FILTER_HTTP_CONNECTION:
        return filter_request(wsi);
    case LWS_CALLBACK_HTTP_CONFIRM_UPGRADE:
        return confirm_upgrade(wsi, in);
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION:
        return -1; // a WebSocket without subprotocol relight.v1
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

// ---- the daemon's loop inside libwebsockets' loop

static int on_loop(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                   size_t n)
{
    if (reason == LWS_CALLBACK_RAW_RX_FILE) loop_turn(server_of(wsi)->loop, 0);
    return reason == LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION ? -1 : 0;
}

static const struct lws_protocols protocols[] = {
    {"http", on_page, sizeof(struct page_session), 0, 0, NULL, 0},
    {SUBPROTOCOL, on_ws, sizeof(struct session), CHUNK, 0, NULL, 0},
    {"loop", on_loop, 0, 0, 0, NULL, 0},
    {NULL, NULL, 0, 0, 0, NULL, 0},
};

// libwebsockets answers 415 for endings without a type.
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

// Hands each accepted client to libwebsockets, which binds nothing itself.
static void http_accepted(struct server *server, const struct accepted *client)
{
    if (client->no_room || n_wsi >= server->options.connections + PLAIN_MAX) {
        server->stats.connections_refused++;
        close(client->fd);
        return;
    }
    unsigned before = n_wsi;
    // On failure it closes the descriptor, and may not call LWS_CALLBACK_WSI_DESTROY.
    struct lws *wsi = lws_adopt_socket_vhost(client->tls ? tls_vhost : vhost, client->fd);
    if (!wsi) n_wsi = before;
    // libwebsockets gives a TLS handshake its other timeout.
    else if (client->tls)
        lws_set_timeout(wsi, PENDING_TIMEOUT_SSL_ACCEPT,
                        (int)ceil(fmax(server->options.handshake, 1)));
}

// A WebSocket peer that is silent is pinged after 60 s and closed after 90 s.
static const lws_retry_bo_t pings = {.secs_since_valid_ping = 60,
                                     .secs_since_valid_hangup = 90};

static bool create_context(struct server *server)
{
    mount[0].mount_next = &mount[1];
    if (server->options.page[0]) {
        mount[1].mount_next = &mount[2];
        mount[2].origin = server->options.page;
    }
    struct lws_context_creation_info info = {0};
    info.port = CONTEXT_PORT_NO_LISTEN_SERVER;
    info.user = server;
    info.protocols = protocols;
    info.mounts = mount;
    info.gid = info.uid = (gid_t)-1;
    info.keepalive_timeout = 15;
    // A client has to begin a request within --handshake; lws's other timeout restarts with
    // each fragment of an answer.
    info.timeout_secs = 30;
    info.timeout_secs_ah_idle = (unsigned)ceil(fmax(server->options.handshake, 1));
    info.retry_and_idle_policy = &pings;
    info.options = LWS_SERVER_OPTION_EXPLICIT_VHOSTS |
                   LWS_SERVER_OPTION_HTTP_HEADERS_SECURITY_BEST_PRACTICES_ENFORCE;
    // Without it a TLS vhost serves plain text, and says nothing.
    if (server->tls) info.options |= LWS_SERVER_OPTION_DO_SSL_GLOBAL_INIT;
    context = lws_create_context(&info);
    vhost = context ? lws_create_vhost(context, &info) : NULL;
    if (!vhost || !server->tls) return vhost != NULL;
    info.vhost_name = "tls";
    info.options |= LWS_SERVER_OPTION_CREATE_VHOST_SSL_CTX;
    info.alpn = "http/1.1"; // WebSocket over HTTP/2 is another protocol
    tls_vhost = lws_create_vhost(context, &info);
    return tls_vhost != NULL;
}

int http_open(struct server *server, const char *address)
{
    lws_set_log_level(LLL_ERR | LLL_WARN, on_lws_log);
    lws_sock_file_fd_type fd;
    fd.filefd = fcntl(loop_fd(server->loop), F_DUPFD_CLOEXEC, 3); // closed by libwebsockets
    if (fd.filefd < 0 || !create_context(server) ||
        !lws_adopt_descriptor_vhost(vhost, LWS_ADOPT_RAW_FILE_DESC, fd, "loop", NULL)) {
        log_line(LOG_ERR, "http %s: libwebsockets could not be initialised", address);
        return -1;
    }
    return listener_open_tcp(server, "http", address, http_accepted);
}

bool http_is_open(void)
{
    return context != NULL;
}

void http_turn(struct server *server)
{
    lws_service(context, 0);
}

void http_close(void)
{
    if (context) listeners_close(lws_context_user(context), http_accepted);
    if (context) lws_context_destroy(context);
    context = NULL;
}
