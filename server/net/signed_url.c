// SPDX-License-Identifier: MIT
// Links that expire: what is signed, and the check of a request's signature.
#include "net/signed_url.h"

#include "frame.h"

#include <ctype.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <time.h>

// ---- the text that is signed

static bool add(char *out, size_t *at, const char *text, const char *plain)
{
    static const char hex[] = "0123456789ABCDEF";
    for (; *text; text++) {
        const unsigned char c = (unsigned char)*text;
        if (*at + 4 > SIGNED_TEXT) return false;
        if (isalnum(c) || strchr(plain, c)) {
            out[(*at)++] = (char)c;
        } else {
            out[(*at)++] = '%';
            out[(*at)++] = hex[c >> 4];
            out[(*at)++] = hex[c & 15];
        }
    }
    out[*at] = 0;
    return true;
}

static int by_name(const void *a, const void *b)
{
    const struct http_parameter *const *x = a, *const *y = b;
    return strcmp((*x)->name, (*y)->name);
}

bool signed_url_text(const struct http_head *head, char out[SIGNED_TEXT])
{
    static const char unreserved[] = "-._~", in_path[] = "-._~/";
    const struct http_parameter *sorted[HTTP_PARAMETERS];
    size_t at = 0, n = 0;
    for (unsigned i = 0; i < head->n_parameter; i++)
        if (strcmp(head->parameter[i].name, "sig")) sorted[n++] = &head->parameter[i];
    qsort(sorted, n, sizeof *sorted, by_name);
    bool fits = add(out, &at, "relight-url-1\n", "-\n") && add(out, &at, head->path, in_path) &&
                add(out, &at, "\n", "\n");
    for (size_t i = 0; i < n && fits; i++)
        fits = (!i || add(out, &at, "&", "&")) && add(out, &at, sorted[i]->name, unreserved) &&
               add(out, &at, "=", "=") && add(out, &at, sorted[i]->value, unreserved);
    return fits;
}

// ---- a link as text

static int digit(char c)
{
    return isdigit((unsigned char)c) ? c - '0' : tolower((unsigned char)c) - 'a' + 10;
}

// %XX and, in a query, + for a blank. False: a bad escape, or a control character.
static bool decode(char *text, bool query)
{
    char *to = text;
    for (const char *from = text; *from; from++) {
        unsigned char c = (unsigned char)*from;
        if (c == '%') {
            if (!isxdigit((unsigned char)from[1]) || !isxdigit((unsigned char)from[2]))
                return false;
            c = (unsigned char)(digit(from[1]) << 4 | digit(from[2]));
            from += 2;
        } else if (c == '+' && query) {
            c = ' ';
        }
        if (c < 32 || c == 127) return false;
        *to++ = (char)c;
    }
    *to = 0;
    return true;
}

const char *signed_url_read(const char *url, struct http_head *head)
{
    const char *mark = strchr(url, '?');
    size_t n = mark ? (size_t)(mark - url) : strlen(url);
    *head = (struct http_head){.method = "GET"};
    if (url[0] != '/' || n >= sizeof head->path || strchr(url, '#'))
        return "expected a path of this daemon, such as /v1/models/bunny/image.jpg?rotate=30";
    snprintf(head->path, sizeof head->path, "%.*s", (int)n, url);
    if (!(head->query = strdup(mark ? mark + 1 : ""))) return "not enough memory";
    if (!decode(head->path, false)) return "the path has a broken %XX";
    char *at = head->query;
    for (char *word; at && (word = strsep(&at, "&"));) {
        if (!*word) continue;
        if (head->n_parameter == HTTP_PARAMETERS)
            return "more parameters than a request may have";
        struct http_parameter *p = &head->parameter[head->n_parameter++];
        p->name = word;
        p->value = strchr(word, '=');
        if (p->value) *p->value++ = 0;
        else p->value = word + strlen(word);
        if (!decode(p->name, true) || !decode(p->value, true))
            return "a parameter has a broken %XX";
    }
    return NULL;
}

// ---- checking

static bool refuse(struct http_problem *problem, const char *why)
{
    http_refuse(problem, 403, "forbidden", "%s", why);
    snprintf(problem->hint, sizeof problem->hint,
             "ask whoever gave you the link for a new one");
    return false;
}

bool signed_url_caller(struct access *access, struct http_head *head, struct caller *out,
                       struct http_problem *problem)
{
    char text[SIGNED_TEXT];
    const char *by = http_parameter(head, "by"), *expires = http_parameter(head, "expires");
    const char *signature = http_parameter(head, "sig");
    char *end = NULL;
    const long long until = expires ? strtoll(expires, &end, 10) : 0;
    const bool whole = by && signature && end && end > expires && !*end && until > 0;
    if (!whole || !signed_url_text(head, text) ||
        !access_signature_is(access, by, text, signature, out))
        return refuse(problem, "the link's signature is wrong, or its token was revoked");
    struct timespec now;
    clock_gettime(CLOCK_REALTIME, &now);
    if (now.tv_sec >= until) return refuse(problem, "the link has expired");
    if (!out->scopes) return refuse(problem, "the link's token may not view");
    return true;
}
