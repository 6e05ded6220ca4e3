// SPDX-License-Identifier: MIT
// The PROXY protocol, version 2: headers of proxies, cut and broken ones, lists of proxies.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "core/address.h"
#include "core/proxy_header.h"

#include <arpa/inet.h>
#include <netinet/in.h>

static const uint8_t fixed[12] = "\r\n\r\n\0\r\nQUIT\n";

// The header's size.
static size_t make(uint8_t *out, uint8_t command, uint8_t family, const void *body, size_t n)
{
    memcpy(out, fixed, 12);
    out[12] = command;
    out[13] = family;
    out[14] = (uint8_t)(n >> 8);
    out[15] = (uint8_t)n;
    if (n) memcpy(out + 16, body, n);
    return 16 + n;
}

static void clients_behind_a_proxy(void **state)
{
    uint8_t bytes[400], four[12] = {192, 0, 2, 7, 10, 0, 0, 1, 0x9d, 0x78, 0, 80},
                        six[36 + 40] = {0x20, 0x01, 0x0d, 0xb8};
    struct sockaddr_storage a;
    char name[96];
    six[15] = 9;
    six[32] = 1;
    size_t n = make(bytes, 0x21, 0x11, four, 12);
    assert_int_equal(proxy_header_size(bytes), n);
    assert_int_equal(proxy_header_parse(bytes, n, &a), PROXY_CLIENT);
    address_name(&a, sizeof a, name, sizeof name);
    assert_string_equal(name, "192.0.2.7:40312");
    n = make(bytes, 0x21, 0x21, six, sizeof six); // with 40 bytes of further values
    assert_int_equal(proxy_header_parse(bytes, n, &a), PROXY_CLIENT);
    address_name(&a, sizeof a, name, sizeof name);
    assert_string_equal(name, "[2001:db8::9]:256");
    assert_int_equal(proxy_header_parse(bytes, make(bytes, 0x20, 0, NULL, 0), &a), PROXY_LOCAL);
    assert_int_equal(proxy_header_parse(bytes, make(bytes, 0x21, 0x31, six, 76), &a),
                     PROXY_LOCAL); // a unix socket
}

static void broken_headers(void **state)
{
    uint8_t bytes[16 + 65535] = {0}, body[36] = {1};
    struct sockaddr_storage a;
    assert_int_equal(proxy_header_parse(bytes, make(bytes, 0x21, 0x11, body, 11), &a),
                     PROXY_BAD);
    assert_int_equal(proxy_header_parse(bytes, make(bytes, 0x21, 0x21, body, 35), &a),
                     PROXY_BAD);
    assert_int_equal(proxy_header_parse(bytes, make(bytes, 0x11, 0x11, body, 12), &a),
                     PROXY_BAD);
    assert_int_equal(proxy_header_parse(bytes, make(bytes, 0x22, 0x11, body, 12), &a),
                     PROXY_BAD);
    size_t n = make(bytes, 0x21, 0x11, body, 12);
    for (size_t k = 0; k < n; k++)
        assert_int_equal(proxy_header_parse(bytes, k, &a), PROXY_BAD);
    bytes[14] = 0xff; // longer than any that is sensible
    assert_int_equal(proxy_header_size(bytes), 0);
    memcpy(bytes, "PROXY TCP4 192.0.2.7", 20); // version 1
    assert_int_equal(proxy_header_size(bytes), 0);
    memcpy(bytes, "GET / HTTP/1.1\r\n", 16);
    assert_int_equal(proxy_header_size(bytes), 0);
}

// Law: of 300,000 headers with changed bytes none is read beyond its end (each is in a block of
// its own size, for the sanitizers), and one that is taken names an address of TCP.
static void changed_headers(void **state)
{
    unsigned seed = 1, taken = 0;
    uint8_t bytes[200], body[100];
    for (int i = 0; i < 300000; i++) {
        size_t n = make(bytes, 0x20 + rand_r(&seed) % 2, rand_r(&seed) % 3 * 0x10 + 1, body,
                        (size_t)rand_r(&seed) % sizeof body);
        for (int k = rand_r(&seed) % 3; k; k--)
            bytes[(size_t)rand_r(&seed) % n] ^= (uint8_t)(1u << rand_r(&seed) % 8);
        size_t size = proxy_header_size(bytes);
        if (!size || size > sizeof bytes) continue;
        uint8_t *own = malloc(size);
        struct sockaddr_storage a;
        memcpy(own, bytes, size);
        if (proxy_header_parse(own, size, &a) == PROXY_CLIENT) {
            assert_true(a.ss_family == AF_INET || a.ss_family == AF_INET6);
            taken++;
        }
        free(own);
    }
    print_message("%u of 300000 changed headers name a client\n", taken);
    assert_true(taken > 1000);
}

static bool has(const char *list, const char *address)
{
    struct sockaddr_in four = {.sin_family = AF_INET};
    struct sockaddr_in6 six = {.sin6_family = AF_INET6};
    if (inet_pton(AF_INET, address, &four.sin_addr) == 1)
        return proxy_list_has(list, (struct sockaddr *)&four);
    assert_int_equal(inet_pton(AF_INET6, address, &six.sin6_addr), 1);
    return proxy_list_has(list, (struct sockaddr *)&six);
}

static void lists(void **state)
{
    char fault[128];
    assert_true(has("10.0.0.0/8, ::1", "10.200.3.4"));
    assert_false(has("10.0.0.0/8, ::1", "11.0.0.1"));
    assert_true(has("10.0.0.0/8,::1", "::1"));
    assert_true(has("192.0.2.128/25", "::ffff:192.0.2.200"));
    assert_false(has("192.0.2.128/25", "192.0.2.100"));
    assert_true(has("0.0.0.0/0", "203.0.113.9"));
    assert_false(has("0.0.0.0/0", "2001:db8::1"));
    assert_true(has("2001:db8::/33", "2001:db8:7fff::"));
    assert_false(has("2001:db8::/33", "2001:db8:8000::"));
    assert_false(has("", "127.0.0.1"));
    assert_true(proxy_list_check("", fault));
    static const char *const wrong[] = {"10.0.0.0/33", "::/129", "host", "1.2.3.4/",
                                        "1.2.3.4/x"};
    for (int i = 0; i < 5; i++) assert_false(proxy_list_check(wrong[i], fault));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(clients_behind_a_proxy),
        cmocka_unit_test(broken_headers),
        cmocka_unit_test(changed_headers),
        cmocka_unit_test(lists),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
