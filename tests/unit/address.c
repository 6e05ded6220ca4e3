// SPDX-License-Identifier: MIT
// Addresses of options: how they are divided, named and checked.
#include <arpa/inet.h>
#include <grp.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>
#include <sys/un.h>

#include <cmocka.h>

#include "core/address.h"
#include "core/options.h"

static void split(void **state)
{
    static const struct {
        const char *text, *host, *port;
    } good[] = {{"192.0.2.7:80", "192.0.2.7", "80"},
                {"[::1]:7413", "::1", "7413"},
                {"relight.lan:0", "relight.lan", "0"},
                {"*:65535", "", "65535"},
                {":00080", "", "00080"},
                {"[]:1", "", "1"},
                {"[a]:1", "a", "1"}};
    static const char *const bad[] = {
        "",        "80",         "host",       "host:",       "host:80x", "host: 80",
        "host:-1", "host:65536", "host:99999", "host:000080", "::1",      "2001:db8::1:80",
        "[::1]80", "[::1",       "::1]:80",    "host:80:"};
    char host[256], port[8];
    for (size_t i = 0; i < sizeof good / sizeof *good; i++) {
        assert_true(address_split(good[i].text, host, port));
        assert_string_equal(host, good[i].host);
        assert_string_equal(port, good[i].port);
    }
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        if (address_split(bad[i], host, port)) fail_msg("taken: %s", bad[i]);
    char longest[300];
    memset(longest, 'h', sizeof longest);
    strcpy(longest + 255, ":1");
    assert_true(address_split(longest, host, port));
    assert_int_equal(strlen(host), 255);
    strcpy(longest + 255, "h:1");
    assert_false(address_split(longest, host, port));
}

static struct sockaddr_storage make(const char *text, socklen_t *n)
{
    struct sockaddr_storage a = {0};
    struct sockaddr_in6 *six = (struct sockaddr_in6 *)&a;
    struct sockaddr_in *four = (struct sockaddr_in *)&a;
    a.ss_family = strchr(text, '/') ? AF_UNIX : strchr(text, ':') ? AF_INET6 : AF_INET;
    *n = a.ss_family == AF_INET6 ? sizeof *six : sizeof *four;
    if (a.ss_family == AF_INET6) {
        assert_int_equal(inet_pton(AF_INET6, text, &six->sin6_addr), 1);
        six->sin6_port = htons(7413);
    } else if (a.ss_family == AF_INET) {
        assert_int_equal(inet_pton(AF_INET, text, &four->sin_addr), 1);
        four->sin_port = htons(80);
    }
    return a;
}

// Without a token only this machine's own addresses may be served; each has its name.
static void loopback_and_names(void **state)
{
    static const struct {
        const char *text, *name;
        bool own;
    } cases[] = {{"127.0.0.1", "127.0.0.1:80", true},
                 {"127.255.0.9", "127.255.0.9:80", true},
                 {"126.0.0.1", "126.0.0.1:80", false},
                 {"1.0.0.127", "1.0.0.127:80", false},
                 {"0.0.0.0", "0.0.0.0:80", false},
                 {"192.0.2.7", "192.0.2.7:80", false},
                 {"::1", "[::1]:7413", true},
                 {"::", "[::]:7413", false},
                 {"::2", "[::2]:7413", false},
                 {"2001:db8::1", "[2001:db8::1]:7413", false},
                 {"::ffff:127.0.0.1", "[::ffff:127.0.0.1]:7413", true},
                 {"::ffff:192.0.2.7", "[::ffff:192.0.2.7]:7413", false},
                 {"/", "local", true}};
    static const struct options none = {.token_file = "", .data = ""},
                                anyone = {.token_file = "", .data = "", .accept_anyone = true};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        socklen_t n;
        char name[96], fault[256] = "";
        const struct sockaddr_storage a = make(cases[i].text, &n);
        const struct sockaddr *address = (const struct sockaddr *)&a;
        if (address_is_loopback(address) != cases[i].own) fail_msg("%s", cases[i].text);
        assert_int_equal(address_admit(&none, address, fault), cases[i].own ? 0 : -1);
        assert_int_equal(!fault[0], cases[i].own);
        assert_int_equal(address_admit(&anyone, address, fault), 0);
        address_name(&a, n, name, sizeof name);
        assert_string_equal(name, cases[i].name);
    }
    const struct sockaddr other = {.sa_family = AF_APPLETALK};
    assert_false(address_is_loopback(&other));
}

// A socket's path fits its structure with the end, and no byte is wasted.
static void paths(void **state)
{
    enum { MOST = sizeof((struct sockaddr_un *)0)->sun_path - 1 };
    static const struct options o = {.socket_group = ""};
    char address[MOST + 16], fault[256] = "";
    strcpy(address, "unix:");
    memset(address + 5, 'p', MOST + 1);
    address[5 + MOST] = 0;
    assert_int_equal(address_check(&o, address, fault), 0);
    strcpy(address + 5 + MOST, "p");
    assert_int_equal(address_check(&o, address, fault), -1);
    assert_non_null(strstr(fault, "longer than 107"));
}

static void groups(void **state)
{
    static const char *const bad[] = {"no such group", "4294967295", "99999999999", "1x", "-1"};
    const struct group *known = getgrgid(0);
    char fault[256];
    gid_t out = 7;
    assert_non_null(known);
    assert_int_equal(address_group("", &out, fault), 0);
    assert_true(out == (gid_t)-1);
    assert_int_equal(address_group(known->gr_name, &out, fault), 0);
    assert_int_equal(out, 0);
    assert_int_equal(address_group("4294967294", &out, fault), 0);
    assert_true(out == (gid_t)-2);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++) {
        fault[0] = 0;
        assert_int_equal(address_group(bad[i], &out, fault), -1);
        assert_non_null(strstr(fault, bad[i]));
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(split),
        cmocka_unit_test(loopback_and_names),
        cmocka_unit_test(paths),
        cmocka_unit_test(groups),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
