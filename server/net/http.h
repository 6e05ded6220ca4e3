/* SPDX-License-Identifier: MIT */
/* http.h owns what the files of the HTTP port share: carrier_http.c (libwebsockets, its loop
 * and protocols), http_head.c (a request's first part), exchange.c (one request of the API),
 * and websocket.c. Loop thread only. */
#ifndef RELIGHTD_HTTP_H
#define RELIGHTD_HTTP_H

#include "net/connection.h"

#include <libwebsockets.h>

enum { HTTP_CHUNK = 64 << 10 }; /* largest piece handed to libwebsockets, in bytes */

/* Where a piece is laid before lws_write, LWS_PRE bytes behind the start. */
/* Turns of libwebsockets' loop so far. */
extern uint64_t http_turns;
extern uint8_t http_piece[LWS_PRE + HTTP_CHUNK];

struct server *http_server(struct lws *wsi);

/* Copies a header into out and returns it: "" when it is absent, NULL when it is too long. */
const char *http_header(struct lws *wsi, enum lws_token_indexes token, char *out, size_t room);
/* The same for a header that libwebsockets has no token for; name is lower case with a colon.
 */
const char *http_custom_header(struct lws *wsi, const char *name, char *out, size_t room);
/* Checks Host and Origin (net/web_access.h), and logs a refusal. Browsers send both with every
 * request that can change something. link: a GET with a signature may come from any page; its
 * signature is checked later, whatever else would admit the request. */
bool http_admitted(struct lws *wsi, bool link);

/* A WebSocket client; conn NULL: the daemon closed it, and the socket closes next. */
struct websocket {
    struct connection *conn;
    struct lws *wsi;
    uint8_t *refusal; /* where no connection was opened: the ERROR frame to send */
    size_t n_refusal;
    uint64_t turn, spent_ns;  /* time that its messages took in this turn of the loop */
    struct loop_timer paused; /* armed: they took more, and the rest waits for the next turn */
};
/* libwebsockets' callback for the subprotocol; user is a struct websocket. */
/* Whether the request is for /ws, or for /ws/MODEL, by which a proxy chooses a replica. */
bool websocket_path(struct lws *wsi);
int websocket_event(struct lws *wsi, enum lws_callback_reasons reason, void *user, void *in,
                    size_t n);

#endif
