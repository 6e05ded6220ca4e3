/* SPDX-License-Identifier: MIT */
/* web_caller.h owns who an HTTP request comes from: its token, else its address, with the same
 * rules as HELLO, and the answer where it is refused. Loop thread only. */
#ifndef RELIGHTD_WEB_CALLER_H
#define RELIGHTD_WEB_CALLER_H

#include "core/access.h"
#include "core/server.h"

/* An HTTP answer that refuses. 401 comes with `WWW-Authenticate: Bearer`, 429 with
 * Retry-After. */
struct web_refusal {
    unsigned status;         /* 401 no or wrong token, 403 missing scope, 429 too many */
    uint32_t retry_after_ms; /* with 429 */
    char text[256];          /* one line for the body */
};

/* Checks a request of the socket fd. authorization: the Authorization header ("Bearer TOKEN"),
 * "" for none, NULL when it is unreadable. query_token: the value of ?token=, decoded, for
 * clients that cannot send headers (EventSource); the header has precedence. scopes: those that
 * the endpoint needs (enum access_scope), 0 for any known caller.
 * True: *out is the caller; charge ledger_principal(server->ledger, out->name). One request is
 * taken from its quota of requests a second. False: *refusal is filled and one line of the
 * audit is logged. For an answer that stays open (events), call
 * access_is_current(server->access, out) at each event and end it when it is false. */
bool web_caller(struct server *server, int fd, const char *authorization,
                const char *query_token, unsigned scopes, struct caller *out,
                struct web_refusal *refusal);

#endif
