// SPDX-License-Identifier: MIT
// Addresses: tcp:HOST:PORT, tls:HOST:PORT, unix:PATH, the default, and sockets connected to
// them.
#include "internal.h"

#include <errno.h>
#include <fcntl.h>
#include <netdb.h>
#include <netinet/in.h>
#include <netinet/tcp.h>
#include <poll.h>
#include <stdio.h>
#include <sys/socket.h>
#include <sys/un.h>
#include <time.h>
#include <unistd.h>

static const char start_hint[] = "start the daemon (relightd) or name another one with -s";

double relight_now_s(void)
{
    struct timespec t;
    clock_gettime(CLOCK_MONOTONIC, &t);
    return (double)t.tv_sec + 1e-9 * (double)t.tv_nsec;
}

const char *relight_default_address(char *buf, size_t n)
{
    const char *named = getenv("RELIGHT_SERVER"), *folder = getenv("XDG_RUNTIME_DIR");
    if (named && *named) return named;
    if (folder && *folder) {
        int size = snprintf(buf, n, "unix:%s/relightd.sock", folder);
        if (size > 0 && (size_t)size < n && access(buf + 5, F_OK) == 0) return buf;
    }
    snprintf(buf, n, "tcp:127.0.0.1:%d", RELIGHT_DEFAULT_PORT);
    return buf;
}

// 0 or an errno. The socket stays non-blocking.
static int connect_within(int fd, const struct sockaddr *to, socklen_t size, double timeout_s)
{
    if (connect(fd, to, size) == 0) return 0;
    if (errno != EINPROGRESS && errno != EINTR) return errno;
    double end = relight_now_s() + timeout_s;
    for (;;) {
        struct pollfd p = {.fd = fd, .events = POLLOUT};
        double left = end - relight_now_s();
        if (left <= 0) return ETIMEDOUT;
        int n = poll(&p, 1, (int)(left * 1e3) + 1);
        if (n < 0 && errno != EINTR) return errno;
        if (n > 0) break;
    }
    int fault = 0;
    socklen_t length = sizeof fault;
    if (getsockopt(fd, SOL_SOCKET, SO_ERROR, &fault, &length)) return errno;
    return fault;
}

static int connect_unix(const char *path, double timeout_s, struct relight_error *error)
{
    struct sockaddr_un to = {.sun_family = AF_UNIX};
    if (!*path || strlen(path) >= sizeof to.sun_path)
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "unix:%s: path of 1 to %zu bytes",
                            path, sizeof to.sun_path - 1);
    memcpy(to.sun_path, path, strlen(path));
    int fd = socket(AF_UNIX, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
    int fault =
        fd < 0 ? errno : connect_within(fd, (struct sockaddr *)&to, sizeof to, timeout_s);
    if (!fault) return fd;
    if (fd >= 0) close(fd);
    return relight_fail(error, RELIGHT_E_UNREACHABLE, start_hint, "unix:%s: %s", path,
                        strerror(fault));
}

// "HOST:PORT", "[V6]:PORT", either without ":PORT".
static int split_host(const char *text, char *host, size_t n, char *port, size_t n_port)
{
    const char *end, *colon;
    snprintf(port, n_port, "%d", RELIGHT_DEFAULT_PORT);
    if (*text == '[') {
        if (!(end = strchr(++text, ']'))) return -1;
        colon = end[1] ? end + 1 : NULL;
        if (colon && *colon != ':') return -1;
    } else {
        colon = strchr(text, ':');
        end = colon ? colon : text + strlen(text);
    }
    if (end == text || (size_t)(end - text) >= n) return -1;
    memcpy(host, text, (size_t)(end - text));
    host[end - text] = 0;
    if (!colon) return 0;
    size_t digits = strspn(colon + 1, "0123456789");
    if (!digits || digits > 5 || colon[1 + digits] || atoi(colon + 1) > 65535) return -1;
    snprintf(port, n_port, "%s", colon + 1);
    return 0;
}

// kind: "tcp" or "tls".
static int connect_tcp(const char *kind, const char *text, double timeout_s, char host[256],
                       struct relight_error *error)
{
    char port[8];
    if (split_host(text, host, 256, port, sizeof port))
        return relight_fail(error, RELIGHT_E_ARGUMENT, "", "%s:%s: expected %s:HOST:PORT", kind,
                            text, kind);
    struct addrinfo want = {.ai_socktype = SOCK_STREAM}, *found;
    int code = getaddrinfo(host, port, &want, &found);
    if (code)
        return relight_fail(error, RELIGHT_E_UNREACHABLE, start_hint, "%s:%s: %s", kind, text,
                            gai_strerror(code));
    int fd = -1, fault = 0;
    for (struct addrinfo *a = found; a && fd < 0; a = a->ai_next) {
        fd = socket(a->ai_family, SOCK_STREAM | SOCK_CLOEXEC | SOCK_NONBLOCK, 0);
        fault = fd < 0 ? errno : connect_within(fd, a->ai_addr, a->ai_addrlen, timeout_s);
        if (fault && fd >= 0) {
            close(fd);
            fd = -1;
        }
    }
    freeaddrinfo(found);
    if (fd < 0)
        return relight_fail(error, RELIGHT_E_UNREACHABLE, start_hint, "%s:%s: %s", kind, text,
                            strerror(fault));
    int on = 1;
    setsockopt(fd, IPPROTO_TCP, TCP_NODELAY, &on, sizeof on);
    return fd;
}

int relight_socket(const char *address, double timeout_s, char host[256],
                   struct relight_error *error)
{
    char ignored[256];
    *host = 0;
    if (!strncmp(address, "unix:", 5)) return connect_unix(address + 5, timeout_s, error);
    if (!strncmp(address, "tcp:", 4))
        return connect_tcp("tcp", address + 4, timeout_s, ignored, error);
    if (!strncmp(address, "tls:", 4))
        return connect_tcp("tls", address + 4, timeout_s, host, error);
    return relight_fail(error, RELIGHT_E_ARGUMENT, "",
                        "%s: expected tcp:HOST:PORT, tls:HOST:PORT or unix:PATH", address);
}
