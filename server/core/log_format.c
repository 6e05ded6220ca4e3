// SPDX-License-Identifier: MIT
// Log lines as logfmt and as JSON.
#include "core/log_format.h"

#include <ctype.h>
#include <stdbool.h>
#include <stdio.h>
#include <string.h>

int log_format_parse(const char *word)
{
    static const char *const words[] = {"text", "logfmt", "json"};
    for (int i = 0; i < 3; i++)
        if (!strcmp(word, words[i])) return i;
    return -1;
}

struct piece {
    const char *at;
    size_t n;
};

struct out {
    char *at;
    size_t n, room;
    bool json, full;
};

enum { TAIL = 4 }; // kept for what ends the line

static void put(struct out *o, const char *text, size_t n)
{
    if (o->full || o->n + n + TAIL > o->room) {
        o->full = true;
        return;
    }
    memcpy(o->at + o->n, text, n);
    o->n += n;
}

// Escaped text as the inside of a string: \" and \\ are the same in both formats; \xNN gets its
// backslash doubled in JSON, which has no such escape. Bare quotes end a value and do not
// occur.
static void put_inside(struct out *o, struct piece p)
{
    for (size_t i = 0; i < p.n; i++) {
        bool escape = p.at[i] == '\\' && i + 1 < p.n;
        if (escape && (p.at[i + 1] == '"' || p.at[i + 1] == '\\')) {
            put(o, p.at + i++, 2);
        } else if (p.at[i] == '\\') {
            put(o, "\\\\", 2);
        } else if (p.at[i] == '"') {
            put(o, "\\\"", 2);
        } else {
            size_t m = 1; // whole characters
            while (i + m < p.n && ((unsigned char)p.at[i + m] & 0xc0) == 0x80) m++;
            put(o, p.at + i, m);
            i += m - 1;
        }
    }
}

static void put_field(struct out *o, struct piece key, struct piece value)
{
    size_t before = o->n;
    bool quote = o->json || !value.n || memchr(value.at, ' ', value.n) ||
                 memchr(value.at, '=', value.n) || memchr(value.at, '"', value.n);
    if (o->full) return;
    if (before > o->json) put(o, o->json ? "," : " ", 1);
    if (o->json) put(o, "\"", 1);
    put(o, key.at, key.n);
    put(o, o->json ? "\":" : "=", o->json ? 2 : 1);
    if (quote) put(o, "\"", 1);
    size_t from = o->n;
    put_inside(o, value);
    if (!o->full) {
        if (quote) put(o, "\"", 1);
        if (!o->full) return;
    }
    // It does not fit: an end in the middle of a value, or the field is left out.
    if (quote && from + 8 < o->room && o->n > from + 1) {
        while (o->n > from && o->at[o->n - 1] == '\\') o->n--;
        o->at[o->n++] = '"';
    } else {
        o->n = before;
    }
}

static struct piece word(const char **at, const char *end, char stop)
{
    struct piece p = {*at, 0};
    while (*at < end && **at != stop) ++*at;
    p.n = (size_t)(*at - p.at);
    if (*at < end) ++*at;
    return p;
}

// Length of the key at `at` if key= stands there, else 0.
static size_t key_length(const char *at, const char *end)
{
    size_t n = 0;
    while (at + n < end && (islower((unsigned char)at[n]) || at[n] == '_')) n++;
    return n && at + n < end && at[n] == '=' ? n : 0;
}

static struct piece read_value(const char **at, const char *end)
{
    struct piece p;
    if (*at == end || **at != '"') return word(at, end, ' ');
    p.at = ++*at;
    while (*at < end && **at != '"') *at += **at == '\\' && *at + 1 < end ? 2 : 1;
    p.n = (size_t)(*at - p.at);
    if (*at < end) ++*at;
    if (*at < end && **at == ' ') ++*at;
    return p;
}

// The words that belong to no key, in order.
static size_t read_message(const char *at, const char *end, char *message, size_t room)
{
    size_t n = 0;
    while (at < end) {
        size_t key = key_length(at, end);
        if (key) {
            at += key + 1;
            read_value(&at, end);
            continue;
        }
        struct piece p = word(&at, end, ' ');
        if (n + p.n + 1 >= room) break;
        if (n) message[n++] = ' ';
        memcpy(message + n, p.at, p.n);
        n += p.n;
    }
    return n;
}

size_t log_reformat(enum log_format format, const char *text, size_t n, char *out, size_t room)
{
    struct out o = {.at = out, .room = room, .json = format == LOG_FORMAT_JSON};
    const char *at = text, *end = text + n;
    char message[1300];
    if (format == LOG_FORMAT_TEXT) {
        put(&o, text, n);
        return o.n;
    }
    if (o.json) put(&o, "{", 1);
    put_field(&o, (struct piece){"time", 4}, word(&at, end, ' '));
    put_field(&o, (struct piece){"level", 5}, word(&at, end, ' '));
    size_t n_message = read_message(at, end, message, sizeof message);
    if (n_message) put_field(&o, (struct piece){"msg", 3}, (struct piece){message, n_message});
    while (at < end) {
        size_t key = key_length(at, end);
        struct piece name = {at, key};
        if (!key) {
            word(&at, end, ' ');
            continue;
        }
        at += key + 1;
        put_field(&o, name, read_value(&at, end));
    }
    if (o.json) out[o.n++] = '}';
    return o.n;
}
