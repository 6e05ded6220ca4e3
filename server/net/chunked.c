// SPDX-License-Identifier: MIT
// A chunked body: SIZE[;extension] CRLF data CRLF … 0 CRLF trailers CRLF.
#include "net/chunked.h"

#include <ctype.h>

enum { MOST_DIGITS = 8 };
enum state {
    SIZE,
    EXTENSION,
    SIZE_LF,
    DATA,
    DATA_CR,
    DATA_LF,
    TRAILER_BEGIN,
    TRAILER,
    TRAILER_LF,
    END_LF
};

static bool wrong(struct chunked *c)
{
    c->wrong = true;
    return false;
}

static bool skip(struct chunked *c, int next)
{
    c->state = next;
    return ++c->skipped <= CHUNKED_SKIPPED || wrong(c);
}

static bool take_size(struct chunked *c, char byte)
{
    if (isxdigit((unsigned char)byte)) {
        int digit = isdigit((unsigned char)byte) ? byte - '0' : (byte | 32) - 'a' + 10;
        c->left = c->left * 16 + (uint64_t)digit;
        return ++c->digits <= MOST_DIGITS || wrong(c);
    }
    if (!c->digits) return wrong(c);
    if (byte == '\r') c->state = SIZE_LF;
    else if (byte == ';' || byte == ' ' || byte == '\t') c->state = EXTENSION;
    else return wrong(c);
    return true;
}

static bool expect_byte(struct chunked *c, char byte, char wanted, int next)
{
    if (byte != wanted) return wrong(c);
    c->state = next;
    return true;
}

// One byte that is no data.
static bool take(struct chunked *c, char byte)
{
    switch ((enum state)c->state) {
    case SIZE:
        return take_size(c, byte);
    case EXTENSION:
        if (byte == '\n') return wrong(c);
        return byte == '\r' ? expect_byte(c, byte, '\r', SIZE_LF) : skip(c, EXTENSION);
    case SIZE_LF:
        c->digits = 0;
        return expect_byte(c, byte, '\n', c->left ? DATA : TRAILER_BEGIN);
    case DATA_CR:
        return expect_byte(c, byte, '\r', DATA_LF);
    case DATA_LF:
        return expect_byte(c, byte, '\n', SIZE);
    case TRAILER_BEGIN:
        return byte == '\r' ? expect_byte(c, byte, '\r', END_LF) : skip(c, TRAILER);
    case TRAILER:
        return skip(c, byte == '\r' ? TRAILER_LF : TRAILER);
    case TRAILER_LF:
        return expect_byte(c, byte, '\n', TRAILER_BEGIN);
    case END_LF:
        c->done = byte == '\n';
        return c->done || wrong(c);
    case DATA:
        break;
    }
    return true;
}

size_t chunked_next(struct chunked *c, const char **bytes, size_t *n, const char **data)
{
    while (*n && !c->done && !c->wrong && c->state != DATA) {
        take(c, **bytes);
        ++*bytes;
        --*n;
    }
    if (!*n || c->done || c->wrong) return 0;
    size_t take_now = *n < c->left ? *n : (size_t)c->left;
    *data = *bytes;
    *bytes += take_now;
    *n -= take_now;
    c->left -= take_now;
    if (!c->left) c->state = DATA_CR;
    return take_now;
}
