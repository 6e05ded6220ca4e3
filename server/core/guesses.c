// SPDX-License-Identifier: MIT
// Wrong tokens by address.
#include "core/guesses.h"

#include <arpa/inet.h>
#include <sodium.h>
#include <stdio.h>
#include <string.h>

static const uint64_t second_ns = 1000000000, forget_ns = 600 * UINT64_C(1000000000);
enum { MOST_S = 60 };

void guesses_init(struct guesses *guesses)
{
    memset(guesses, 0, sizeof *guesses);
    randombytes_buf(guesses->seed, sizeof guesses->seed);
}

static uint64_t address_hash(const struct guesses *guesses, const char *who)
{
    uint8_t key[128] = {0}, hash[8];
    struct in6_addr six;
    size_t n = strnlen(who, sizeof key);
    uint64_t out;
    memcpy(key, who, n);
    if (!strncmp(who, "addr:", 5) && inet_pton(AF_INET6, who + 5, &six) == 1) {
        n = 8; // one customer has a /64
        memcpy(key, six.s6_addr, n);
    }
    _Static_assert(crypto_shorthash_KEYBYTES == sizeof guesses->seed, "the seed is the key");
    crypto_shorthash(hash, key, n, guesses->seed);
    memcpy(&out, hash, sizeof out);
    return out ? out : 1;
}

static struct guess *find(const struct guesses *guesses, uint64_t address, uint64_t now_ns)
{
    const struct guess *row = guesses->at[address % GUESSES_BUCKETS];
    for (int i = 0; i < GUESSES_WAYS; i++)
        if (row[i].address == address && now_ns - row[i].last_ns < forget_ns)
            return (struct guess *)&row[i];
    return NULL;
}

uint32_t guesses_wait_ms(const struct guesses *guesses, const char *who, uint64_t now_ns)
{
    const struct guess *g = find(guesses, address_hash(guesses, who), now_ns);
    if (!g || g->until_ns <= now_ns) return 0;
    return (uint32_t)((g->until_ns - now_ns + 999999) / 1000000);
}

void guesses_count(struct guesses *guesses, const char *who, const char *secret,
                   uint64_t now_ns)
{
    uint8_t hash[8];
    uint64_t said;
    crypto_shorthash(hash, (const uint8_t *)secret, strlen(secret), guesses->seed);
    memcpy(&said, hash, sizeof said);
    uint64_t address = address_hash(guesses, who);
    struct guess *row = guesses->at[address % GUESSES_BUCKETS];
    struct guess *g = find(guesses, address, now_ns);
    if (!g) {
        g = row; // the empty or oldest entry
        for (int i = 1; i < GUESSES_WAYS; i++)
            if (row[i].last_ns < g->last_ns) g = &row[i];
        *g = (struct guess){.address = address};
    }
    g->last_ns = now_ns;
    if (g->wrong && g->secret == said) return;
    g->secret = said;
    g->wrong++;
    if (g->wrong < GUESSES_FREE) return;
    uint32_t doubled = g->wrong - GUESSES_FREE;
    uint64_t wait_s = doubled < 6 ? UINT64_C(1) << doubled : MOST_S;
    g->until_ns = now_ns + (wait_s < MOST_S ? wait_s : MOST_S) * second_ns;
}
