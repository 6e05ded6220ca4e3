// SPDX-License-Identifier: MIT
// The PROXY protocol, version 2 (proxy-protocol.txt, section 2.2), and lists of proxies.
#include "core/proxy_header.h"

#include <arpa/inet.h>
#include <netinet/in.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint8_t signature[12] = {0x0d, 0x0a, 0x0d, 0x0a, 0x00, 0x0d,
                                      0x0a, 0x51, 0x55, 0x49, 0x54, 0x0a};
enum { COMMAND_LOCAL = 0x20, COMMAND_PROXY = 0x21, TCP4 = 0x11, TCP6 = 0x21 };

size_t proxy_header_size(const uint8_t fixed[PROXY_HEADER_FIXED])
{
    size_t n = PROXY_HEADER_FIXED + ((size_t)fixed[14] << 8 | fixed[15]);
    bool good = !memcmp(fixed, signature, sizeof signature) &&
                (fixed[12] == COMMAND_LOCAL || fixed[12] == COMMAND_PROXY);
    return good && n <= PROXY_HEADER_MAX ? n : 0;
}

enum proxy_peer proxy_header_parse(const uint8_t *bytes, size_t n, struct sockaddr_storage *out)
{
    struct sockaddr_in *four = (struct sockaddr_in *)out;
    struct sockaddr_in6 *six = (struct sockaddr_in6 *)out;
    const uint8_t *at = bytes + PROXY_HEADER_FIXED;
    if (n < PROXY_HEADER_FIXED || proxy_header_size(bytes) != n) return PROXY_BAD;
    size_t left = n - PROXY_HEADER_FIXED;
    if (bytes[12] == COMMAND_LOCAL) return PROXY_LOCAL;
    *out = (struct sockaddr_storage){0};
    if (bytes[13] == TCP4) { // addresses of source and target, then their ports
        if (left < 12) return PROXY_BAD;
        four->sin_family = AF_INET;
        memcpy(&four->sin_addr, at, 4);
        memcpy(&four->sin_port, at + 8, 2);
        return PROXY_CLIENT;
    }
    if (bytes[13] == TCP6) {
        if (left < 36) return PROXY_BAD;
        six->sin6_family = AF_INET6;
        memcpy(&six->sin6_addr, at, 16);
        memcpy(&six->sin6_port, at + 32, 2);
        return PROXY_CLIENT;
    }
    return PROXY_LOCAL;
}

// ---- lists

struct prefix {
    uint8_t bytes[16];
    unsigned bits; // of 128; IPv4 as ::ffff:a.b.c.d
};

static void map_four(const void *four, uint8_t out[16])
{
    static const uint8_t head[12] = {0, 0, 0, 0, 0, 0, 0, 0, 0, 0, 0xff, 0xff};
    memcpy(out, head, 12);
    memcpy(out + 12, four, 4);
}

static bool read_prefix(const char *word, size_t n, struct prefix *out)
{
    char text[64], *slash, *end;
    struct in_addr four;
    if (n >= sizeof text) return false;
    memcpy(text, word, n);
    text[n] = 0;
    if ((slash = strchr(text, '/'))) *slash = 0;
    bool is_four = inet_pton(AF_INET, text, &four) == 1;
    if (is_four) map_four(&four, out->bytes);
    else if (inet_pton(AF_INET6, text, out->bytes) != 1) return false;
    unsigned most = is_four ? 32 : 128;
    unsigned long bits = slash ? strtoul(slash + 1, &end, 10) : most;
    if (slash && (end == slash + 1 || *end || bits > most)) return false;
    out->bits = (unsigned)bits + (is_four ? 96 : 0);
    return true;
}

static bool matches(const struct prefix *p, const uint8_t address[16])
{
    unsigned whole = p->bits / 8, rest = p->bits % 8;
    if (memcmp(p->bytes, address, whole)) return false;
    return !rest || !((p->bytes[whole] ^ address[whole]) >> (8 - rest));
}

// The next word of a list, or NULL; *n: its length.
static const char *next_word(const char **at, size_t *n)
{
    *at += strspn(*at, ", ");
    const char *word = *at;
    *n = strcspn(word, ", ");
    *at += *n;
    return *n ? word : NULL;
}

bool proxy_list_has(const char *list, const struct sockaddr *address)
{
    uint8_t bytes[16];
    struct prefix p;
    size_t n;
    if (address->sa_family == AF_INET)
        map_four(&((const struct sockaddr_in *)address)->sin_addr, bytes);
    else if (address->sa_family == AF_INET6)
        memcpy(bytes, &((const struct sockaddr_in6 *)address)->sin6_addr, 16);
    else return false;
    for (const char *word; (word = next_word(&list, &n));)
        if (read_prefix(word, n, &p) && matches(&p, bytes)) return true;
    return false;
}

bool proxy_list_check(const char *list, char fault[128])
{
    struct prefix p;
    size_t n;
    for (const char *word; (word = next_word(&list, &n));)
        if (!read_prefix(word, n, &p)) {
            snprintf(fault, 128, "%.*s is no address or prefix", n < 60 ? (int)n : 60, word);
            return false;
        }
    return true;
}
