// SPDX-License-Identifier: MIT
// WebSocket: frames as binary messages on /ws.
#include "net/http.h"

#include "net/carrier.h"
#include "net/listener.h"

#include <libwebsockets.h>
#include <stddef.h>
#include <stdlib.h>
#include <string.h>

enum {
    TRY_AGAIN_LATER = 1013, // WebSocket close code
    TURN_NS = 2000000,      // of one client's messages in a turn of the loop
};

static void ws_want_write(struct connection *conn)
{
    struct websocket *s = conn->carrier_data;
    lws_callback_on_writable(s->wsi);
}

static void ws_set_reading(struct connection *conn, bool on)
{
    struct websocket *s = conn->carrier_data;
    lws_rx_flow_control(s->wsi, on && !s->paused.armed);
}

static void ws_go_on(struct loop_timer *timer)
{
    struct websocket *s =
        (struct websocket *)((char *)timer - offsetof(struct websocket, paused));
    if (s->conn && s->conn->reading) lws_rx_flow_control(s->wsi, 1);
}

// One client's messages take at most TURN_NS of a turn, as on the other carriers.
static void ws_take_turns(struct websocket *s, uint64_t begin_ns)
{
    if (s->turn != http_turns) s->spent_ns = 0;
    s->turn = http_turns;
    s->spent_ns += loop_now_ns() - begin_ns;
    if (s->spent_ns < TURN_NS || !s->conn || s->paused.armed) return;
    loop_timer_set(http_server(s->wsi)->loop, &s->paused, loop_now_ns());
    lws_rx_flow_control(s->wsi, 0);
}

static void ws_close(struct connection *conn)
{
    struct websocket *s = conn->carrier_data;
    s->conn = NULL;
    loop_timer_stop(conn->server->loop, &s->paused);
    lws_set_timeout(s->wsi, PENDING_TIMEOUT_USER_OK, LWS_TO_KILL_ASYNC);
}

static size_t ws_unsent(const struct connection *conn)
{
    const struct websocket *s = conn->carrier_data;
    return socket_unsent(lws_get_socket_fd(s->wsi));
}

static const struct carrier ws_carrier = {"websocket", ws_want_write, ws_set_reading, ws_close,
                                          ws_unsent};

static int ws_receive(struct websocket *s, struct lws *wsi, const void *bytes, size_t n)
{
    if (s->refusal) return 0;
    if (!s->conn || s->conn->closing) return s->conn ? 0 : -1;
    bool last = lws_is_final_fragment(wsi) && !lws_remaining_packet_payload(wsi);
    uint64_t begin_ns = loop_now_ns();
    lws_validity_confirmed(wsi); // in the middle of a message no pong can come
    connection_part(s->conn, bytes, n, last);
    ws_take_turns(s, begin_ns);
    return s->conn ? 0 : -1;
}

static int ws_write(struct websocket *s, struct lws *wsi)
{
    struct connection *conn = s->conn;
    if (!conn) return -1;
    const struct out_frame *f = conn->out;
    if (!f) return 0;
    struct iovec iov[2];
    const int n_iov = connection_output(conn, iov, 2); // may replace a late answer
    size_t n = 0, left = f->size - f->sent;
    for (int i = 0; i < n_iov && n < HTTP_CHUNK && n < left; i++) {
        size_t take = iov[i].iov_len < HTTP_CHUNK - n ? iov[i].iov_len : HTTP_CHUNK - n;
        if (take > left - n) take = left - n; // a message holds one frame
        memcpy(http_piece + LWS_PRE + n, iov[i].iov_base, take);
        n += take;
    }
    int how = f->sent ? LWS_WRITE_CONTINUATION : LWS_WRITE_BINARY;
    if (n < left) how |= LWS_WRITE_NO_FIN;
    if (lws_write(wsi, http_piece + LWS_PRE, n, (enum lws_write_protocol)how) < (int)n)
        return -1;
    lws_validity_confirmed(
        wsi); // a slow reader answers pings late; --write-time limits it instead
    connection_written(conn, n);
    if (s->conn && s->conn->out) lws_callback_on_writable(wsi);
    return s->conn ? 0 : -1;
}

// Opens a connection for the client; beyond the limits it gets an ERROR frame instead.
static void established(struct websocket *s)
{
    struct server *server = http_server(s->wsi);
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

static int write_refusal(struct websocket *s, struct lws *wsi)
{
    if (s->n_refusal > HTTP_CHUNK) return -1;
    memcpy(http_piece + LWS_PRE, s->refusal, s->n_refusal);
    lws_write(wsi, http_piece + LWS_PRE, s->n_refusal, LWS_WRITE_BINARY);
    lws_close_reason(wsi, (enum lws_close_status)TRY_AGAIN_LATER, NULL, 0);
    return -1;
}

bool websocket_path(struct lws *wsi)
{
    char room[160];
    const char *path = http_header(wsi, WSI_TOKEN_GET_URI, room, sizeof room);
    return path && (!strcmp(path, "/ws") || (!strncmp(path, "/ws/", 4) && path[4]));
}

int websocket_event(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                    size_t n)
{
    struct websocket *s = user;
    switch (reason) {
    case LWS_CALLBACK_FILTER_PROTOCOL_CONNECTION: {
        return websocket_path(wsi) && http_admitted(wsi, false) ? 0 : -1;
    }
    case LWS_CALLBACK_ESTABLISHED:
        *s = (struct websocket){.wsi = wsi, .paused.fire = ws_go_on};
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
