// SPDX-License-Identifier: MIT
// Which Host and Origin headers a daemon takes.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>

#include <cmocka.h>

#include "core/options.h"
#include "net/web_access.h"

struct rule {
    const char *text;
    bool allowed;
};

// Hosts are compared whole, without regard to capitals, with any port and with nothing else
// behind them.
static void hosts(void **state)
{
    static const struct options o = {.http = "relight.lan:80",
                                     .hosts = " one.example ,[2001:db8::5],2001:db8::6",
                                     .origins = ""};
    static const struct rule rules[] = {{"localhost", true},
                                        {"LocalHost:80", true},
                                        {"localhost:", true},
                                        {"127.0.0.1:7413", true},
                                        {"[::1]", true},
                                        {"[::1]:443", true},
                                        {"192.0.2.7", true},
                                        {"RELIGHT.lan:9", true},
                                        {"one.example", true},
                                        {"ONE.example:1", true},
                                        {"[2001:db8::5]:80", true},
                                        {"[2001:db8::6]", true},
                                        {"localhost.example", false},
                                        {"local", false},
                                        {"one.example.org", false},
                                        {"one", false},
                                        {"example", false},
                                        {"other.example", false},
                                        {"localhost:80x", false},
                                        {"localhost:80:80", false},
                                        {"localhost:80/", false},
                                        {"[::1", false},
                                        {"[::1]x", false},
                                        {"[::1:80", false},
                                        {"[::2]", false},
                                        {"[]", false},
                                        {":80", false},
                                        {"192.0.2.70", false},
                                        {"192.0.2.", false},
                                        {"*", false},
                                        {"127.0.0.1.example", false},
                                        {"relight.lan.example:80", false}};
    for (size_t i = 0; i < sizeof rules / sizeof *rules; i++) {
        char text[64] = ""; // zeros behind the text: reading on finds no other
        strcpy(text, rules[i].text);
        if (web_host_allowed(&o, "192.0.2.7", text) != rules[i].allowed)
            fail_msg("host %s", text);
    }
    assert_true(web_host_allowed(&o, "2001:db8::1", "[2001:db8::1]:80"));
    assert_false(web_host_allowed(&o, "2001:db8::1", "[2001:db8::2]:80"));
}

// An origin is this host's page, by either scheme, or listed as it stands.
static void origins(void **state)
{
    static const struct options o = {
        .http = "", .hosts = "", .origins = "https://shop.example,http://*.example,null"};
    static const struct rule rules[] = {{"http://relight.lan:80", true},
                                        {"https://relight.lan:80", true},
                                        {"HTTPS://Relight.LAN:80", true},
                                        {"https://shop.example", true},
                                        {"HTTPS://shop.EXAMPLE", true},
                                        {"http://*.example", true},
                                        {"null", true},
                                        {"", true},
                                        {"ftp://relight.lan:80", false},
                                        {"http://relight.lan", false},
                                        {"http://relight.lan:8", false},
                                        {"http://relight.lan:801", false},
                                        {"relight.lan:80", false},
                                        {"http://shop.example", false},
                                        {"https://shop.example.org", false},
                                        {"https://shop.exampl", false},
                                        {"https://shop.example:443", false},
                                        {"http://any.example", false},
                                        {"https://", false},
                                        {"*", false}};
    for (size_t i = 0; i < sizeof rules / sizeof *rules; i++)
        if (web_origin_allowed(&o, "relight.lan:80", rules[i].text) != rules[i].allowed)
            fail_msg("origin %s", rules[i].text);
    assert_false(web_origin_allowed(&o, NULL, "http://relight.lan:80"));
}

// A * stands for all where it is an entry, not where it begins one.
static void every_entry(void **state)
{
    struct options o = {.http = "", .hosts = "*.example", .origins = "*.example"};
    assert_false(web_host_allowed(&o, "", "any.example"));
    assert_false(web_origin_allowed(&o, "here", "http://any.example"));
    o.hosts = o.origins = "one.example, *";
    assert_true(web_host_allowed(&o, "", "any.example"));
    assert_true(web_origin_allowed(&o, "here", "http://any.example"));
    assert_false(web_host_allowed(&o, "", "any.example:x"));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(hosts),
        cmocka_unit_test(origins),
        cmocka_unit_test(every_entry),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
