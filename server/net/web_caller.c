// SPDX-License-Identifier: MIT
// HTTP requests and the rights of who sends them.
#include "net/web_caller.h"

#include "core/log.h"
#include "net/listener.h"

#include <stdio.h>
#include <string.h>
#include <strings.h>

enum { UNAUTHORIZED = 401, FORBIDDEN = 403, TOO_MANY = 429 };

static bool refused(struct web_refusal *refusal, unsigned status, uint32_t retry_ms,
                    const char *who, const char *peer)
{
    refusal->status = status;
    refusal->retry_after_ms = retry_ms;
    log_line(LOG_EVENT, "audit act=refused who=%s peer=%s http=%u text=\"%s\"", who, peer,
             status, refusal->text);
    return false;
}

bool web_caller(struct server *server, int fd, const char *authorization,
                const char *query_token, unsigned scopes, struct caller *out,
                struct web_refusal *refusal)
{
    struct accepted from = {0};
    uint32_t retry_ms = 0;
    char has[64];
    const char *secret = query_token ? query_token : "";
    accepted_describe(fd, &from);
    *refusal = (struct web_refusal){0};
    if (!authorization || (*authorization && strncasecmp(authorization, "Bearer ", 7))) {
        snprintf(refusal->text, sizeof refusal->text,
                 "expected `Authorization: Bearer TOKEN` with up to 255 bytes");
        return refused(refusal, UNAUTHORIZED, 0, from.who, from.peer);
    }
    if (*authorization) secret = authorization + 7 + strspn(authorization + 7, " ");
    enum access_verdict verdict =
        access_check(server->access, from.who, secret, out, refusal->text, &retry_ms);
    if (verdict != ACCESS_GRANTED)
        return refused(refusal, verdict == ACCESS_LATER ? TOO_MANY : UNAUTHORIZED, retry_ms,
                       from.who, from.peer);
    const char *missing = access_missing(out->scopes, scopes);
    if (missing) {
        scopes_print(out->scopes, has);
        snprintf(refusal->text, sizeof refusal->text, "this needs the scope %s; %s has: %s",
                 missing, out->name, has);
        return refused(refusal, FORBIDDEN, 0, out->name, from.peer);
    }
    if (access_take_request(server->access, out, &retry_ms)) return true;
    snprintf(refusal->text, sizeof refusal->text,
             "your token's quota of requests a second is used up (--rate)");
    return refused(refusal, TOO_MANY, retry_ms, out->name, from.peer);
}
