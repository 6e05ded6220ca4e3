// SPDX-License-Identifier: MIT
// Who gets in: the addresses that listen, the Host and Origin that HTTP admits, WebSocket
// upgrades, and connections that do not say HELLO, do not read, or are too many.
#include "daemon.h"

#include "core/options.h"
#include "net/web_access.h"

#include <arpa/inet.h>
#include <netinet/in.h>

static struct daemon d;

static int setup(void **state)
{
    daemon_folder(&d);
    return 0;
}

static int teardown(void **state)
{
    daemon_remove(&d);
    return 0;
}

// ---- raw HTTP and WebSocket

static int port_of(const char *address)
{
    return atoi(strrchr(address, ':') + 1);
}

// Connected, or -1.
static int tcp_connect(const char *host, int port)
{
    bool six = strchr(host, ':') != NULL;
    struct sockaddr_in a4 = {.sin_family = AF_INET, .sin_port = htons((uint16_t)port)};
    struct sockaddr_in6 a6 = {.sin6_family = AF_INET6, .sin6_port = htons((uint16_t)port)};
    if (six) inet_pton(AF_INET6, host, &a6.sin6_addr);
    else inet_pton(AF_INET, host, &a4.sin_addr);
    int fd = socket(six ? AF_INET6 : AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    const struct sockaddr *a = six ? (struct sockaddr *)&a6 : (struct sockaddr *)&a4;
    if (fd >= 0 && !connect(fd, a, six ? sizeof a6 : sizeof a4)) return fd;
    if (fd >= 0) close(fd);
    return -1;
}

// Sends a request's lines; the answer's status, 0 when it closed without one.
static int http_ask(int fd, const char *request, char *answer, size_t room)
{
    bool closed;
    assert_true(write(fd, request, strlen(request)) > 0);
    // An upgraded connection stays open: its answer ends with the header.
    size_t n = 0;
    do {
        struct pollfd p = {fd, POLLIN, 0};
        if (poll(&p, 1, 3000) <= 0) break;
        ssize_t k = read(fd, answer + n, room - 1 - n);
        closed = k <= 0;
        if (!closed) n += (size_t)k;
        answer[n] = 0;
    } while (!closed && n < room - 1 &&
             (strncmp(answer, "HTTP/1.1 101", 12) || !strstr(answer, "\r\n\r\n")));
    answer[n] = 0;
    return n > 12 ? atoi(answer + 9) : 0;
}

// GET; `header` has further lines, each with \r\n.
static int get(const char *path, const char *host, const char *header)
{
    static char answer[65536];
    char request[2048];
    snprintf(request, sizeof request,
             "GET %s HTTP/1.1\r\nHost: %s\r\nConnection: close\r\n%s\r\n", path, host, header);
    int fd = tcp_connect("127.0.0.1", port_of(d.http));
    assert_true(fd >= 0);
    int status = http_ask(fd, request, answer, sizeof answer);
    close(fd);
    return status;
}

static int upgrade_to(const char *path, const char *host, const char *origin,
                      const char *protocol, int *out)
{
    char request[2048], answer[4096], origin_line[1024] = "", protocol_line[128] = "";
    if (origin) snprintf(origin_line, sizeof origin_line, "Origin: %s\r\n", origin);
    if (protocol)
        snprintf(protocol_line, sizeof protocol_line, "Sec-WebSocket-Protocol: %s\r\n",
                 protocol);
    snprintf(
        request, sizeof request,
        "GET %s HTTP/1.1\r\nHost: %s\r\nUpgrade: websocket\r\nConnection: Upgrade\r\n"
        "Sec-WebSocket-Key: dGhlIHNhbXBsZSBub25jZQ==\r\nSec-WebSocket-Version: 13\r\n%s%s\r\n",
        path, host, origin_line, protocol_line);
    int fd = tcp_connect("127.0.0.1", port_of(d.http));
    assert_true(fd >= 0);
    int status = http_ask(fd, request, answer, sizeof answer);
    if (out && status == 101) *out = fd;
    else close(fd);
    return status;
}

static int upgrade(const char *host, const char *origin)
{
    return upgrade_to("/ws", host, origin, "relight.v1", NULL);
}

// ---- addresses

// Local addresses, in the hexadecimal of /proc, that listen on this port; how many.
static int listening(int port, char out[8][40])
{
    int n = 0;
    static const char *const tables[] = {"/proc/net/tcp", "/proc/net/tcp6"};
    for (int i = 0; i < 2; i++) {
        FILE *file = fopen(tables[i], "r");
        char line[512], address[40];
        unsigned at, state;
        while (file && fgets(line, sizeof line, file))
            if (sscanf(line, " %*d: %39[0-9A-F]:%x %*[0-9A-F]:%*x %x", address, &at, &state) ==
                    3 &&
                (int)at == port && state == 0x0a && n < 8)
                strcpy(out[n++], address);
        if (file) fclose(file);
    }
    return n;
}

static bool has_ipv6(void)
{
    struct sockaddr_in6 a = {.sin6_family = AF_INET6, .sin6_addr = IN6ADDR_LOOPBACK_INIT};
    int fd = socket(AF_INET6, SOCK_STREAM | SOCK_CLOEXEC, 0);
    bool has = fd >= 0 && !bind(fd, (struct sockaddr *)&a, sizeof a);
    if (fd >= 0) close(fd);
    return has;
}

// Only the address that --http names listens.
static void test_http_listens_where_it_is_told(void **state)
{
    char at[8][40];
    const char *const four[] = {"--http", "127.0.0.1:0", NULL};
    daemon_start(&d, four);
    assert_memory_equal(d.http, "127.0.0.1:", 10);
    int port = port_of(d.http), fd;
    assert_true(port > 0);
    assert_int_equal(listening(port, at), 1);
    assert_string_equal(at[0], "0100007F");
    assert_int_equal(tcp_connect("127.0.0.2", port), -1);
    assert_int_equal(tcp_connect("::1", port), -1);
    fd = tcp_connect("127.0.0.1", port);
    assert_true(fd >= 0);
    close(fd);
    assert_int_equal(daemon_stop(&d), 0);
    if (!has_ipv6()) return;
    const char *const six[] = {"--http", "[::1]:0", NULL};
    daemon_start(&d, six);
    assert_memory_equal(d.http, "[::1]:", 6);
    port = port_of(d.http);
    assert_int_equal(listening(port, at), 1);
    assert_string_equal(at[0], "00000000000000000000000001000000");
    assert_int_equal(tcp_connect("127.0.0.1", port), -1);
    fd = tcp_connect("::1", port);
    assert_true(fd >= 0);
    char answer[2048];
    assert_int_equal(http_ask(fd,
                              "GET /healthz HTTP/1.1\r\nHost: [::1]:99\r\nConnection: close\r\n"
                              "\r\n",
                              answer, sizeof answer),
                     200);
    close(fd);
    assert_int_equal(daemon_stop(&d), 0);
}

// ---- Host and Origin

static void test_host_and_origin(void **state)
{
    const char *const extra[] = {"--http",    "127.0.0.1:0",
                                 "--hosts",   "relight.example, other.example",
                                 "--origins", "https://review.example",
                                 NULL};
    char longest[320] = "http://", same[64];
    memset(longest + 7, 'a', 249);
    strcpy(longest + 256, ".example:8080");
    daemon_start(&d, extra);
    static const char *const good[] = {"localhost",    "LOCALHOST:1", "127.0.0.1:8080",
                                       "[::1]:80",     "[::1]",       "relight.example:443",
                                       "other.example"};
    static const char *const bad[] = {
        "evil.example",   "evil.example:8080",    "",
        "127.0.0.2",      "localhost.evil",       "localhost:80:80",
        "localhost@evil", "relight.example.evil", "[::1].evil:80",
        "[::1",           "relight.example,",     "*"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        assert_int_equal(get("/healthz", good[i], ""), 200);
        assert_int_equal(upgrade(good[i], NULL), 101);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        assert_int_equal(get("/healthz", bad[i], ""), 403);
        assert_int_equal(get("/metrics", bad[i], ""), 403);
        assert_int_equal(upgrade(bad[i], NULL), 403);
    }
    assert_int_equal(get("/healthz", longest + 7, ""), 403);
    // DNS rebinding: the page's own name was made to point here.
    assert_int_equal(upgrade("evil.example:8080", "http://evil.example:8080"), 403);
    snprintf(same, sizeof same, "http://%s", d.http);
    assert_int_equal(upgrade(d.http, same), 101);
    assert_int_equal(upgrade("relight.example", "https://relight.example"), 101);
    assert_int_equal(upgrade("relight.example", "https://review.example"), 101);
    static const char *const foreign[] = {"http://evil.example",
                                          "http://e",
                                          "null",
                                          "https://review.example.evil",
                                          "http://review.example",
                                          "http://localhost:3000",
                                          "ftp://relight.example",
                                          "://relight.example"};
    for (size_t i = 0; i < sizeof foreign / sizeof *foreign; i++)
        assert_int_equal(upgrade("relight.example", foreign[i]), 403);
    assert_int_equal(upgrade(d.http, longest), 403);
    assert_int_equal(get("/metrics", "localhost", "Origin: http://evil.example\r\n"), 403);
    // No Host at all.
    char answer[2048];
    int fd = tcp_connect("127.0.0.1", port_of(d.http));
    assert_int_equal(http_ask(fd, "GET /healthz HTTP/1.1\r\nConnection: close\r\n\r\n", answer,
                              sizeof answer),
                     403);
    close(fd);
    assert_int_equal(daemon_stop(&d), 0);
}

static void test_web_access_rules(void **state)
{
    struct options o = {.http = "relight.lan:80", .hosts = "", .origins = ""};
    assert_true(web_host_allowed(&o, "192.0.2.7", "relight.lan:8443"));
    assert_true(web_host_allowed(&o, "192.0.2.7", "192.0.2.7:80"));
    assert_true(web_host_allowed(&o, "2001:db8::1", "[2001:db8::1]:80"));
    assert_false(web_host_allowed(&o, "192.0.2.7", "192.0.2.8"));
    assert_false(web_host_allowed(&o, "", ""));
    assert_false(web_host_allowed(&o, "", NULL));
    assert_false(web_origin_allowed(&o, "localhost", NULL));
    assert_true(web_origin_allowed(&o, "localhost", ""));
    o.hosts = o.origins = "*";
    assert_true(web_host_allowed(&o, "", "any.example"));
    assert_true(web_origin_allowed(&o, "any.example", "http://other.example"));
    assert_false(web_host_allowed(&o, "", NULL));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(test_http_listens_where_it_is_told),
        cmocka_unit_test(test_host_and_origin),
        cmocka_unit_test(test_web_access_rules),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("door", tests, setup, teardown);
}
