// SPDX-License-Identifier: MIT
// Framing of chunked bodies (RFC 9112 section 7.1), against an encoder of its own.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "../fuzz/random.h"
#include "net/chunked.h"

enum { BODY = 4000, FRAMED = 40000 };

struct body {
    char data[BODY];
    size_t n;
};

// Decodes n bytes that arrive in pieces of `piece` bytes; returns how many were taken.
static size_t decode(struct chunked *c, const char *bytes, size_t n, size_t piece,
                     struct body *out)
{
    size_t at = 0;
    *c = (struct chunked){0};
    out->n = 0;
    while (at < n && !c->done && !c->wrong) {
        const char *next = bytes + at, *data;
        size_t left = n - at < piece ? n - at : piece, size;
        while ((size = chunked_next(c, &next, &left, &data))) {
            assert_true(out->n + size <= sizeof out->data);
            memcpy(out->data + out->n, data, size);
            out->n += size;
        }
        at = (size_t)(next - bytes);
    }
    return at;
}

static size_t put_lines(char *to, struct rnd *r)
{
    size_t at = 0;
    for (uint32_t i = rnd(r, 4); i > 0; i--)
        at += (size_t)sprintf(to + at, "Field-%u: %u\r\n", i, rnd(r, 1000));
    return at;
}

static size_t encode(const struct body *body, char *to, struct rnd *r)
{
    static const char *const form[] = {"%x", "%X", "0%x", "%08X"};
    static const char *const extension[] = {"", ";a=b", " ; name=\"x;y\"", "\t"};
    size_t at = 0;
    for (size_t from = 0; from < body->n;) {
        size_t most = body->n - from, size = 1 + rnd(r, 300);
        if (size > most) size = most;
        at += (size_t)sprintf(to + at, RND_PICK(r, form), (unsigned)size);
        at += (size_t)sprintf(to + at, "%s\r\n", RND_PICK(r, extension));
        memcpy(to + at, body->data + from, size);
        at += size;
        at += (size_t)sprintf(to + at, "\r\n");
        from += size;
    }
    at += (size_t)sprintf(to + at, "0%s\r\n", RND_PICK(r, extension));
    at += put_lines(to + at, r);
    return at + (size_t)sprintf(to + at, "\r\n");
}

// However a body is divided into chunks and into reads, the same bytes come out, and the bytes
// behind its end are left to the next request.
static void a_body_comes_out_whole(void **state)
{
    static char framed[FRAMED];
    static struct body body, out;
    struct chunked c;
    for (uint64_t seed = 0; seed < 400; seed++) {
        struct rnd r;
        rnd_seed(&r, seed);
        body.n = rnd(&r, BODY);
        for (size_t i = 0; i < body.n; i++) body.data[i] = (char)rnd(&r, 256);
        const size_t n = encode(&body, framed, &r);
        memcpy(framed + n, "GET /", 5);
        assert_int_equal(decode(&c, framed, n + 5, 1 + rnd(&r, 700), &out), n);
        assert_true(c.done && !c.wrong);
        assert_int_equal(out.n, body.n);
        assert_memory_equal(out.data, body.data, body.n);
        assert_int_equal(decode(&c, framed, n - 1, 1 + rnd(&r, 700), &out), n - 1);
        assert_false(c.done || c.wrong);
    }
}

static void broken_framing_is_wrong(void **state)
{
    static const char *const bodies[] = {
        "\r\n",      "\n",        "g\r\n",         ";x\r\n",         " 5\r\nabcde\r\n",
        "-1\r\n",    "0x5\r\n",   "1\n",           "1\rx",           "1;a\nb\r\n",
        "1;a\rb",    "1\r\nab",   "1\r\na\n",      "1\r\na\rb",      "0\r\n\rX",
        "0\r\na\rX", "1,\r\na",   "000000001\r\n", "1\r\na\r\n\r\n", "0\r\na: b\r\n\rX",
        "1\t;\nx",   "1 \rx\r\n", "/\r\n",         ":\r\n",          "@\r\n",
        "`\r\n",     "G\r\n"};
    for (size_t i = 0; i < sizeof bodies / sizeof *bodies; i++)
        for (size_t piece = 1; piece < 12; piece += 5) {
            struct chunked c;
            struct body out;
            decode(&c, bodies[i], strlen(bodies[i]), piece, &out);
            if (!c.wrong || c.done) fail_msg("taken: body %zu", i);
        }
}

// n bytes of extensions, or of trailers, in one body; wrong above the bound.
static bool skips(bool trailers, size_t n)
{
    static char bytes[3 * CHUNKED_SKIPPED];
    struct chunked c;
    struct body out;
    size_t at = 0;
    if (trailers) {
        at += (size_t)sprintf(bytes, "0\r\n");
        memset(bytes + at, 'a', n - 1); // and the carriage return
        at += n - 1;
        at += (size_t)sprintf(bytes + at, "\r\n\r\n");
    } else {
        for (size_t i = 0; i < 2; i++) { // in two chunks
            const size_t part = i ? n / 2 : n - n / 2;
            at += (size_t)sprintf(bytes + at, i ? "0;" : "1;");
            memset(bytes + at, 'a', part);
            at += part;
            at += (size_t)sprintf(bytes + at, i ? "\r\n\r\n" : "\r\nx\r\n");
        }
    }
    decode(&c, bytes, at, at, &out);
    assert_true(c.done != c.wrong);
    return c.done;
}

static void extensions_and_trailers_are_bounded(void **state)
{
    for (int trailers = 0; trailers < 2; trailers++) {
        assert_true(skips(trailers, CHUNKED_SKIPPED));
        assert_false(skips(trailers, CHUNKED_SKIPPED + 1));
    }
}

// A size of eight digits is taken, and its digits have their values.
static void sizes(void **state)
{
    static const struct {
        const char *text;
        uint64_t size;
    } cases[] = {{"ffffffff\r\n", 0xffffffff}, {"ABCDEF01\r\n", 0xabcdef01},
                 {"23456789\r\n", 0x23456789}, {"abcdef\r\n", 0xabcdef},
                 {"00000009\r\n", 9},          {"10;x\r\n", 16}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        struct chunked c;
        struct body out;
        decode(&c, cases[i].text, strlen(cases[i].text), 3, &out);
        assert_false(c.done || c.wrong);
        assert_true(c.left == cases[i].size);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(a_body_comes_out_whole),
        cmocka_unit_test(broken_framing_is_wrong),
        cmocka_unit_test(extensions_and_trailers_are_bounded),
        cmocka_unit_test(sizes),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
