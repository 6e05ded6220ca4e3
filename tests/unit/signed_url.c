// SPDX-License-Identifier: MIT
// The text that a link signs (PROTOCOL.md, SIGN), and links as text.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "net/signed_url.h"

static char out[SIGNED_TEXT + 16];

// The text of a link; NULL where the link is refused or too long.
static const char *text_of(const char *url)
{
    struct http_head head;
    const char *fault = signed_url_read(url, &head);
    memset(out, '#', sizeof out);
    const bool fits = !fault && signed_url_text(&head, out);
    http_head_finish(&head);
    for (size_t i = SIGNED_TEXT; i < sizeof out; i++) assert_int_equal(out[i], '#');
    return fits ? out : NULL;
}

static void expect(const char *url, const char *text)
{
    const char *got = text_of(url);
    if (!got || strcmp(got, text)) fail_msg("%s: %s", url, got ? got : "refused");
}

static void text_is_canonical(void **state)
{
    expect("/v1/models/bunny/image.jpg", "relight-url-1\n/v1/models/bunny/image.jpg\n");
    expect("/a?b=1&c=2", "relight-url-1\n/a\nb=1&c=2");
    // In the order of names, without the signature, and by value rather than by spelling.
    expect("/a?c=2&sig=xyz&b=1", "relight-url-1\n/a\nb=1&c=2");
    expect("/a?z=1&bb=2&b=3&a=4&sigh=5", "relight-url-1\n/a\na=4&b=3&bb=2&sigh=5&z=1");
    expect("/a%2fb/%C3%A4+%20?%62=1&&c", "relight-url-1\n/a/b/%C3%A4%2B%20\nb=1&c=");
    expect("/a%2Fb/%c3%a4%2b%20?c=&b=1&", "relight-url-1\n/a/b/%C3%A4%2B%20\nb=1&c=");
    expect("/a?b=x+y/z=%26", "relight-url-1\n/a\nb=x%20y%2Fz%3D%26");
    expect("/-._~?-._~=-._~", "relight-url-1\n/-._~\n-._~=-._~");
}

// Every byte but control characters passes; letters, digits and -._~ stay as they are.
static void each_byte(void **state)
{
    for (unsigned c = 1; c < 256; c++) {
        char lower[32], upper[32], text[64];
        snprintf(lower, sizeof lower, "/%%%02x?v=%%%02x", c, c);
        snprintf(upper, sizeof upper, "/%%%02X?v=%%%02X", c, c);
        const bool plain = (c >= '0' && c <= '9') || ((c | 32) >= 'a' && (c | 32) <= 'z') ||
                           c == '-' || c == '.' || c == '_' || c == '~';
        if (c < 32 || c == 127) {
            assert_null(text_of(lower));
            continue;
        }
        if (plain) snprintf(text, sizeof text, "relight-url-1\n/%c\nv=%c", (char)c, (char)c);
        else if (c == '/') snprintf(text, sizeof text, "relight-url-1\n//\nv=%%2F");
        else snprintf(text, sizeof text, "relight-url-1\n/%%%02X\nv=%%%02X", c, c);
        expect(lower, text);
        expect(upper, text);
    }
}

static void broken_links(void **state)
{
    static const char *const bad[] = {"",        "a",        "http://a/b", "/a#b",    "/a?b#",
                                      "/%",      "/%4",      "/%4g",       "/%g4",    "/a?b=%",
                                      "/a?b=%f", "/a?%zz=1", "/\n",        "/a?\t=1", "/\x7f"};
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        if (text_of(bad[i])) fail_msg("taken: %s", bad[i]);
}

// A link has as many parameters as a request, and a path as long.
static void links_are_bounded(void **state)
{
    char url[2000] = "/a?";
    size_t at = 3;
    for (int i = 0; i < HTTP_PARAMETERS; i++) at += (size_t)sprintf(url + at, "p%d&", i);
    assert_non_null(text_of(url));
    strcpy(url + at, "q");
    assert_null(text_of(url));
    memset(url, 'p', sizeof url);
    url[0] = '/', url[HTTP_PATH - 1] = 0;
    assert_non_null(text_of(url));
    url[HTTP_PATH - 1] = 'p', url[HTTP_PATH] = 0;
    assert_null(text_of(url));
}

// What does not fit is refused, and nothing is written behind the end.
static void text_is_bounded(void **state)
{
    static char url[SIGNED_TEXT + 100];
    unsigned taken = 0;
    for (size_t n = SIGNED_TEXT - 40; n < SIGNED_TEXT + 20; n++)
        for (int escaped = 0; escaped < 2; escaped++) {
            memset(url, 'v', sizeof url);
            memcpy(url, "/a?b=", 5);
            strcpy(url + 5 + n, escaped ? "+" : "v");
            const char *text = text_of(url);
            // "relight-url-1\n/a\nb=", the value, and its end.
            const size_t length = 19 + n + (escaped ? 3 : 1);
            if (length >= SIGNED_TEXT) assert_null(text);
            if (!text) continue;
            assert_int_equal(strlen(text), length);
            taken++;
        }
    assert_true(taken > 20);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(text_is_canonical), cmocka_unit_test(each_byte),
        cmocka_unit_test(broken_links),      cmocka_unit_test(links_are_bounded),
        cmocka_unit_test(text_is_bounded),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
