// SPDX-License-Identifier: MIT
// Who may do what: tokens, scopes, quotas, local users, and the delay after wrong tokens.
#include "ask.h"
#include "frames.h"

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

static int after_each(void **state)
{
    if (d.pid) daemon_stop(&d);
    return 0;
}

static int http_connect(void)
{
    struct sockaddr_in a = {.sin_family = AF_INET};
    a.sin_port = htons((uint16_t)atoi(strrchr(d.http, ':') + 1));
    inet_pton(AF_INET, "127.0.0.1", &a.sin_addr);
    int fd = socket(AF_INET, SOCK_STREAM | SOCK_CLOEXEC, 0);
    assert_int_equal(connect(fd, (struct sockaddr *)&a, sizeof a), 0);
    return fd;
}

// The status of a GET; its answer's beginning is in text.
static int get(const char *path, const char *headers, char *text, size_t room)
{
    char ask[1024];
    bool closed;
    int fd = http_connect();
    int n = snprintf(ask, sizeof ask, "GET %s HTTP/1.1\r\nHost: localhost\r\n%s\r\n", path,
                     headers);
    assert_int_equal(write(fd, ask, (size_t)n), n);
    size_t have = raw_read(fd, text, room - 1, 300, &closed);
    text[have] = 0;
    close(fd);
    return have > 12 ? atoi(text + 9) : 0;
}

// The token of --token-file in HTTP: as a header, as ?token=, and refused with its reason.
static void test_http_takes_tokens(void **state)
{
    char path[128], text[2048];
    snprintf(path, sizeof path, "%s/token", d.folder);
    write_text(path, "open sesame\n");
    const char *const extra[] = {"--http", "127.0.0.1:0", "--token-file", path, NULL};
    daemon_start(&d, extra);
    assert_int_equal(get("/metrics", "", text, sizeof text), 401);
    assert_non_null(strcasestr(text, "www-authenticate: Bearer"));
    assert_non_null(strstr(text, "the token is missing"));
    assert_int_equal(get("/metrics?token=open%20sesame", "", text, sizeof text), 200);
    assert_int_equal(get("/metrics?token=open", "", text, sizeof text), 401);
    assert_non_null(strstr(text, "the token is wrong"));
    assert_int_equal(
        get("/metrics", "Authorization: Bearer open sesame\r\n", text, sizeof text), 200);
    assert_true(log_says(&d, "audit act=refused who=addr:127.0.0.1", 1000));
    assert_false(log_says(&d, "sesame", 0));
    assert_int_equal(daemon_stop(&d), 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test_teardown(test_http_takes_tokens, after_each),
    };
    signal(SIGPIPE, SIG_IGN);
    return cmocka_run_group_tests_name("access", tests, setup, teardown);
}
