// SPDX-License-Identifier: MIT
// SIGN: a link to a picture that expires and needs no token.
#include "core/log.h"
#include "net/dispatch.h"
#include "net/request.h"
#include "net/routes.h"
#include "net/signed_url.h"
#include "relight.pb-c.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

enum { DAY_S = 86400, LINK = SIGNED_TEXT + 100 };

// Adds who signed and until when. `by` and `expires` point to the caller's text.
static const char *add_terms(struct http_head *head, char *by, char *expires)
{
    static char by_name[] = "by", expires_name[] = "expires";
    for (unsigned i = 0; i < head->n_parameter; i++) {
        const char *name = head->parameter[i].name;
        if (!strcmp(name, "sig") || !strcmp(name, by_name) || !strcmp(name, expires_name))
            return "it is signed already: leave by, expires and sig out";
        if (!strcmp(name, "token")) return "a token does not belong into a link";
    }
    if (head->n_parameter + 2 > HTTP_PARAMETERS) return "it has too many parameters";
    head->parameter[head->n_parameter++] = (struct http_parameter){by_name, by, false};
    head->parameter[head->n_parameter++] =
        (struct http_parameter){expires_name, expires, false};
    return NULL;
}

static void sign(struct request *request, struct http_head *head, uint64_t lifetime_s)
{
    const struct caller *caller = &request->conn->caller;
    char by[96], expires[32], signature[SIGNATURE], *text = malloc(LINK);
    uint64_t until = (uint64_t)time(NULL) + lifetime_s;
    snprintf(by, sizeof by, "%s", strchr(caller->name, ':') + 1);
    snprintf(expires, sizeof expires, "%llu", (unsigned long long)until);
    const char *fault = text ? add_terms(head, by, expires) : "not enough memory";
    if (!fault && !signed_url_text(head, text)) fault = "it is too long";
    if (fault) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "url: %s", fault);
    } else if (!access_sign(request->server->access, caller, text, signature)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_FORBIDDEN,
                     "links are signed with a token, and %s has none: create one with `relight "
                     "token create --scope view`, and sign with it",
                     caller->name);
    } else {
        Relight__SignAnswer out = RELIGHT__SIGN_ANSWER__INIT;
        // The text without its first line, its second line end as '?': the link.
        char *link = strchr(text, '\n') + 1, *query = strchr(link, '\n');
        *query = '?';
        size_t n = strlen(link);
        snprintf(link + n, LINK - (size_t)(link - text) - n, "&sig=%s", signature);
        out.url = link;
        out.expires_s = until;
        log_line(LOG_EVENT, "audit act=sign who=%s path=%s expires=%s", caller->name,
                 head->path, expires);
        request_answer(request, &out.base, NULL);
    }
    free(text);
}

void op_sign(struct request *request)
{
    const Relight__SignRequest *in = (const Relight__SignRequest *)request->message;
    struct http_head head;
    char error[300];
    const char *fault = signed_url_read(in->url, &head);
    if (!fault && !route_is_signable(head.path))
        fault = "links are for pictures, /v1/models/MODEL/image.ENDING or "
                "/v1/environments/ENV/image.jpg";
    uint64_t lifetime_s = in->lifetime_s ? in->lifetime_s : DAY_S;
    if (fault) request_fail(request, RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST, "url: %s", fault);
    else if (lifetime_s > SIGNED_MOST_S)
        request_fail(request,
                     range_refuse(error, sizeof error, (double)lifetime_s, 1, SIGNED_MOST_S,
                                  "s", "lifetime_s"),
                     "%s", error);
    else sign(request, &head, lifetime_s);
    free(head.query);
}
