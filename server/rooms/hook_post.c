// SPDX-License-Identifier: MIT
// One HTTPS POST: connect, verify, send, read the status.
#include "rooms/hook_post.h"

#include <errno.h>
#include <netdb.h>
#include <openssl/err.h>
#include <openssl/x509v3.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/socket.h>
#include <unistd.h>

enum { STEP_S = 5 };

int hook_target_parse(const char *url, struct hook_target *out, char fault[256])
{
    static const char scheme[] = "https://";
    const char *at = url + sizeof scheme - 1;
    *out = (struct hook_target){.port = "443"};
    bool good = !strncmp(url, scheme, sizeof scheme - 1);
    const bool six = good && *at == '['; // IPv6
    const char *host = at + six;
    size_t n = good ? strcspn(host, six ? "]" : ":/") : 0;
    good = good && n && n < sizeof out->host && !strpbrk(url, " \t\r\n#@") &&
           (!six || host[n] == ']');
    if (good) snprintf(out->host, sizeof out->host, "%.*s", (int)n, host);
    const char *end = good ? host + n + six : at;
    if (good && *end == ':') {
        n = strspn(end + 1, "0123456789");
        good = n && n < 6;
        snprintf(out->port, sizeof out->port, "%.*s", (int)n, end + 1);
        end += n + 1;
    }
    snprintf(out->authority, sizeof out->authority, "%.*s", (int)(end - at), at);
    at = end;
    good = good && (!*at || *at == '/') && strlen(at) < sizeof out->path;
    if (good) snprintf(out->path, sizeof out->path, "%s", *at ? at : "/");
    if (!good) {
        snprintf(fault, 256, "--room-hook %.120s: expected https://HOST[:PORT][/PATH]", url);
        return -1;
    }
    out->tls = SSL_CTX_new(TLS_client_method());
    if (out->tls && SSL_CTX_set_default_verify_paths(out->tls) == 1) {
        SSL_CTX_set_min_proto_version(out->tls, TLS1_2_VERSION);
        SSL_CTX_set_verify(out->tls, SSL_VERIFY_PEER, NULL);
        return 0;
    }
    snprintf(fault, 256, "--room-hook: TLS can not be used");
    return -1;
}

void hook_target_finish(struct hook_target *target)
{
    SSL_CTX_free(target->tls);
    target->tls = NULL;
}

// A connected socket whose reads and writes end after STEP_S; -1 with the fault.
static int connect_one(const struct addrinfo *a, char fault[160])
{
    struct timeval step = {STEP_S, 0};
    int fd = socket(a->ai_family, SOCK_STREAM | SOCK_CLOEXEC, 0);
    if (fd < 0) return -1;
    // Linux ends connect() after the time for writing.
    setsockopt(fd, SOL_SOCKET, SO_SNDTIMEO, &step, sizeof step);
    setsockopt(fd, SOL_SOCKET, SO_RCVTIMEO, &step, sizeof step);
    if (!connect(fd, a->ai_addr, a->ai_addrlen)) return fd;
    snprintf(fault, 160, "connect: %s", strerror(errno));
    close(fd);
    return -1;
}

static int connect_any(const struct hook_target *t, char fault[160])
{
    struct addrinfo hints = {.ai_socktype = SOCK_STREAM}, *all;
    int status = getaddrinfo(t->host, t->port, &hints, &all), fd = -1;
    if (status) {
        snprintf(fault, 160, "%.80s: %s", t->host, gai_strerror(status));
        return -1;
    }
    for (const struct addrinfo *a = all; a && fd < 0; a = a->ai_next)
        fd = connect_one(a, fault);
    freeaddrinfo(all);
    return fd;
}

static bool shake_hands(const struct hook_target *t, SSL *tls, int fd, char fault[160])
{
    SSL_set_hostflags(tls, X509_CHECK_FLAG_NO_PARTIAL_WILDCARDS);
    bool named = X509_VERIFY_PARAM_set1_ip_asc(SSL_get0_param(tls), t->host);
    if (!named) named = SSL_set1_host(tls, t->host) && SSL_set_tlsext_host_name(tls, t->host);
    if (named && SSL_set_fd(tls, fd) && SSL_connect(tls) == 1) return true;
    long why = SSL_get_verify_result(tls);
    snprintf(fault, 160, "TLS: %s",
             why != X509_V_OK ? X509_verify_cert_error_string(why) : "the handshake failed");
    return false;
}

static bool send_all(SSL *tls, const char *text)
{
    size_t n = strlen(text), done = 0;
    return !n || (SSL_write_ex(tls, text, n, &done) == 1 && done == n);
}

static enum hook_result exchange(const struct hook_target *t, SSL *tls, const char *headers,
                                 const char *body, char fault[160])
{
    char head[2048], answer[64] = "";
    int status = 0;
    size_t n = 0, more;
    snprintf(
        head, sizeof head,
        "POST %s HTTP/1.1\r\nHost: %s\r\nUser-Agent: relightd/" RELIGHT_VERSION
        "\r\nContent-Type: application/json\r\nContent-Length: %zu\r\n%sConnection: close\r\n\r\n",
        t->path, t->authority, strlen(body), headers);
    snprintf(fault, 160, "no answer");
    if (!send_all(tls, head) || !send_all(tls, body)) return HOOK_LATER;
    while (n < 12 && SSL_read_ex(tls, answer + n, sizeof answer - 1 - n, &more) == 1) n += more;
    answer[n] = 0;
    if (sscanf(answer, "HTTP/%*d.%*d %3d", &status) != 1) return HOOK_LATER;
    if (status >= 200 && status < 300) return HOOK_TAKEN;
    snprintf(fault, 160, "the server answers with status %d", status);
    return status == 408 || status == 429 || status >= 500 ? HOOK_LATER : HOOK_REFUSED;
}

enum hook_result hook_post(const struct hook_target *t, const char *headers, const char *body,
                           char fault[160], const atomic_bool *closing)
{
    enum hook_result result = HOOK_LATER;
    ERR_clear_error();
    int fd = connect_any(t, fault);
    SSL *tls = fd >= 0 && !*closing ? SSL_new(t->tls) : NULL;
    if (tls && shake_hands(t, tls, fd, fault)) result = exchange(t, tls, headers, body, fault);
    if (tls && result == HOOK_TAKEN) SSL_shutdown(tls);
    SSL_free(tls);
    if (fd >= 0) close(fd);
    return result;
}
