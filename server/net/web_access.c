// SPDX-License-Identifier: MIT
// Host and Origin against the lists of the configuration.
#include "net/web_access.h"

#include "core/options.h"

#include <ctype.h>
#include <stddef.h>
#include <string.h>
#include <strings.h>

// Length of the host in HOST[:PORT], brackets of an IPv6 address included; 0 when it is none.
static size_t host_length(const char *text)
{
    size_t n = *text == '[' ? strcspn(text, "]") + 1 : strcspn(text, ":");
    if (*text == '[' && text[n - 1] != ']') return 0;
    const char *port = text + n;
    if (*port == ':') do
            port++;
        while (isdigit((unsigned char)*port));
    return *port ? 0 : n;
}

// Compares two hosts; an IPv6 address may stand in brackets or not.
static bool same_host(const char *a, size_t n, const char *b, size_t m)
{
    if (n > 1 && *a == '[') a++, n -= 2;
    if (m > 1 && *b == '[') b++, m -= 2;
    return n && n == m && !strncasecmp(a, b, n);
}

// Comma-separated, blanks around the entries are left out; * stands for every entry.
static bool in_list(const char *list, const char *text, size_t n,
                    bool (*same)(const char *, size_t, const char *, size_t))
{
    for (const char *at = list; *at;) {
        at += strspn(at, " ,");
        size_t m = strcspn(at, " ,");
        if ((m == 1 && *at == '*') || (m && same(at, m, text, n))) return true;
        at += m;
    }
    return false;
}

static bool same_text(const char *a, size_t n, const char *b, size_t m)
{
    return n == m && !strncasecmp(a, b, n);
}

bool web_host_allowed(const struct options *options, const char *local, const char *host)
{
    size_t n = host ? host_length(host) : 0;
    if (!n) return false;
    const char *http = options->http;
    return in_list("localhost,127.0.0.1,[::1]", host, n, same_host) ||
           same_host(host, n, local, strlen(local)) ||
           same_host(host, n, http, host_length(http)) ||
           in_list(options->hosts, host, n, same_host);
}

bool web_origin_allowed(const struct options *options, const char *host, const char *origin)
{
    if (!origin || !host) return false;
    if (!*origin) return true;
    const char *scheme_end = strstr(origin, "://");
    if ((!strncasecmp(origin, "http://", 7) || !strncasecmp(origin, "https://", 8)) &&
        !strcasecmp(scheme_end + 3, host))
        return true;
    return in_list(options->origins, origin, strlen(origin), same_text);
}
