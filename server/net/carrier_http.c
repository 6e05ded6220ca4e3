// SPDX-License-Identifier: MIT
// The HTTP port: libwebsockets with its protocols and its poll loop. The daemon's loop is
// nested in it as a single descriptor, so that one thread serves both. net/listener.c accepts
// the clients, exchange.c answers requests of the API and of the page, and websocket.c carries
// frames on /ws.
#include "net/carrier.h"

#include "core/log.h"
#include "core/tls.h"
#include "net/exchange.h"
#include "net/http.h"
#include "net/listener.h"
#include "net/page_files.h"

#include <fcntl.h>
#include <libwebsockets.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>
#include <strings.h>
#include <sys/socket.h>
#include <unistd.h>

enum {
    PING_S = 60,     // most seconds between two pings of a silent WebSocket client
    PLAIN_MAX = 128, // HTTP clients beyond --connections
    READ_AT_ONCE = 32 << 10,
    LINGER_S = 2, // time for a refused client to read its answer while it still sends
};

#define SUBPROTOCOL "relight.v1"

// What libwebsockets keeps for each HTTP client.
struct http_session {
    struct exchange *exchange; // NULL: none is under way
    bool lingers;              // answered; what it still sends is thrown away
};

static struct lws_context *context;
static struct lws_vhost *vhost, *tls_vhost; // tls_vhost NULL: no TLS
uint8_t http_piece[LWS_PRE + HTTP_CHUNK];
uint64_t http_turns;
static unsigned n_wsi; // sockets of libwebsockets: HTTP, WebSocket, and the loop's descriptor

struct server *http_server(struct lws *wsi)
{
    return lws_context_user(lws_get_context(wsi));
}

// ---- admission

// Allows an upgrade to WebSocket on /ws and /ws/MODEL with subprotocol relight.v1 only.
// libwebsockets chooses among the subprotocols that the client names; on_page and on_loop
// refuse their own.
static int confirm_upgrade(struct lws *wsi)
{
    char protocol_room[128], to_room[32];
    // Not the text that libwebsockets passes: after an upgrade that it does not know it has
    // answered already, and its headers are freed.
    const char *to = http_header(wsi, WSI_TOKEN_UPGRADE, to_room, sizeof to_room);
    if (to && !*to) return -1;
    const char *names =
        http_header(wsi, WSI_TOKEN_PROTOCOL, protocol_room, sizeof protocol_room);
    if (to && !strcasecmp(to, "websocket") && websocket_path(wsi) && names &&
        strstr(names, SUBPROTOCOL) && http_admitted(wsi, false))
        return 0;
    lws_return_http_status(wsi, HTTP_STATUS_FORBIDDEN, NULL);
    return -1;
}

// ---- plain HTTP

static int filter_request(struct lws *wsi)
{
    if (http_admitted(wsi, true)) return 0;
    lws_return_http_status(wsi, HTTP_STATUS_FORBIDDEN, NULL);
    return 1;
}

// Sends no more, and reads on until the client closes: a socket that is closed with unread
// bytes resets the connection, and the client may lose the answer.
static int linger(struct lws *wsi, struct http_session *s)
{
    s->lingers = true;
    shutdown(lws_get_socket_fd(wsi), SHUT_WR);
    lws_set_timeout(wsi, PENDING_TIMEOUT_USER_OK, LINGER_S);
    return 0;
}

static int end_exchange(struct lws *wsi, struct http_session *s, enum exchange_next next)
{
    bool more = s->exchange->body_at < s->exchange->head.body_size;
    exchange_end(s->exchange);
    s->exchange = NULL;
    lws_rx_flow_control(wsi, 1);
    if (next == EXCHANGE_DONE) return lws_http_transaction_completed(wsi) ? -1 : 0;
    return more ? linger(wsi, s) : -1;
}

static int write_exchange(struct lws *wsi, struct http_session *s)
{
    if (!s || !s->exchange) return 0;
    enum exchange_next next = exchange_write(s->exchange);
    return next == EXCHANGE_GOES_ON ? 0 : end_exchange(wsi, s, next);
}

static int begin_exchange(struct lws *wsi, struct http_session *s)
{
    if (s->exchange) exchange_end(s->exchange);
    *s = (struct http_session){0};
    s->exchange = exchange_begin(wsi, http_server(wsi));
    return s->exchange ? 0 : -1;
}

static int receive_body(struct http_session *s, const void *bytes, size_t n)
{
    if (!s || s->lingers) return 0;
    return s->exchange && exchange_receive(s->exchange, bytes, n) ? 0 : -1;
}

static int on_page(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                   size_t n)
{
    struct http_session *s = user;
    switch (reason) {
    case LWS_CALLBACK_WSI_CREATE:
        n_wsi++;
        return 0;
    case LWS_CALLBACK_WSI_DESTROY:
        n_wsi--;
        return 0;
    case LWS_CALLBACK_OPENSSL_LOAD_EXTRA_SERVER_VERIFY_CERTS:
        tls_attach(http_server(wsi)->tls, user);
        return 0;
    case LWS_CALLBACK_FILTER_HTTP_CONNECTION:
        return filter_request(wsi);
    case LWS_CALLBACK_HTTP_CONFIRM_UPGRADE:
        return confirm_upgrade(wsi);
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION:
        return -1; // a WebSocket without subprotocol relight.v1
    case LWS_CALLBACK_HTTP:
        return begin_exchange(wsi, s);
    case LWS_CALLBACK_HTTP_BODY:
        return receive_body(s, in, n);
    case LWS_CALLBACK_HTTP_BODY_COMPLETION:
        return s && s->exchange && !exchange_received(s->exchange) ? -1 : 0;
    case LWS_CALLBACK_HTTP_WRITEABLE:
        return write_exchange(wsi, s);
    case LWS_CALLBACK_CLOSED_HTTP:
    case LWS_CALLBACK_HTTP_DROP_PROTOCOL:
        if (s && s->exchange) exchange_end(s->exchange);
        if (s) s->exchange = NULL;
        return 0;
    default:
        return lws_callback_http_dummy(wsi, reason, user, in, n);
    }
}

// ---- the daemon's loop inside libwebsockets' loop

static int on_loop(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                   size_t n)
{
    if (reason == LWS_CALLBACK_RAW_RX_FILE) loop_turn(http_server(wsi)->loop, 0);
    return reason == LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION ? -1 : 0;
}

static const struct lws_protocols protocols[] = {
    {"http", on_page, sizeof(struct http_session), READ_AT_ONCE, 0, NULL, 0},
    {SUBPROTOCOL, websocket_event, sizeof(struct websocket), HTTP_CHUNK, 0, NULL, 0},
    {"loop", on_loop, 0, 0, 0, NULL, 0},
    {NULL, NULL, 0, 0, 0, NULL, 0},
};

static const struct lws_http_mount mount = {.mountpoint = "/",
                                            .mountpoint_len = 1,
                                            .origin = "http",
                                            .protocol = "http",
                                            .origin_protocol = LWSMPRO_CALLBACK};

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

// A silent WebSocket peer is pinged and closed without a pong. One that began a WebSocket
// frame's header and does not finish it cannot answer either. libwebsockets reports nothing of
// it, so both have twice --frame-time, at most 90 s.
static lws_retry_bo_t pings;

static void set_pings(const struct options *o)
{
    double hangup = fmin(ceil(o->frame_time * 2) + 4, PING_S * 1.5);
    pings.secs_since_valid_hangup = (uint16_t)hangup;
    pings.secs_since_valid_ping = (uint16_t)fmin(hangup / 2, PING_S);
}

static bool create_context(struct server *server)
{
    struct lws_context_creation_info info = {0};
    info.port = CONTEXT_PORT_NO_LISTEN_SERVER;
    info.user = server;
    info.protocols = protocols;
    info.mounts = &mount;
    info.gid = info.uid = (gid_t)-1;
    info.keepalive_timeout = 15;
    info.max_http_header_data = HTTP_HEADER_ROOM;
    info.pt_serv_buf_size = READ_AT_ONCE;
    // A client has to begin a request within --handshake; lws's other timeout restarts with
    // each fragment of an answer.
    info.timeout_secs = 30;
    info.timeout_secs_ah_idle = (unsigned)ceil(fmax(server->options.handshake, 1));
    set_pings(&server->options);
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
    page_files_read(server);
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
    http_turns++;
    lws_service(context, 0);
}

void http_close(void)
{
    if (context) listeners_close(lws_context_user(context), http_accepted);
    if (context) lws_context_destroy(context);
    context = NULL;
    page_files_free();
}
