/* SPDX-License-Identifier: MIT */
/* guesses.h owns the delay after wrong tokens, by address. The first GUESSES_FREE wrong tokens
 * of an address cost nothing; each further one doubles the time during which tokens from there
 * are not looked at, from one second to a minute. An address without a wrong token for ten
 * minutes is forgotten. The table has a fixed size; where it is full, the address whose last
 * wrong token is the oldest of its bucket is removed. Loop thread only. */
#ifndef RELIGHTD_GUESSES_H
#define RELIGHTD_GUESSES_H

#include <stdbool.h>
#include <stdint.h>

enum { GUESSES_FREE = 5, GUESSES_BUCKETS = 512, GUESSES_WAYS = 8 };

struct guesses {
    uint8_t seed[16]; /* random: which addresses share a bucket is not foreseeable */
    struct guess {
        uint64_t address; /* its hash; 0: empty */
        uint64_t last_ns, until_ns;
        uint64_t secret; /* hash of the last wrong token */
        uint32_t wrong;
    } at[GUESSES_BUCKETS][GUESSES_WAYS];
};

void guesses_init(struct guesses *guesses);
/* who: a principal's name; addresses of one IPv6 /64 count as one. Milliseconds until a token
 * from there is looked at again; 0: now. */
uint32_t guesses_wait_ms(const struct guesses *guesses, const char *who, uint64_t now_ns);
/* A wrong token came from there. The same one again is no further guess: a program that goes on
 * with a revoked token does not lock out others behind its address. */
void guesses_count(struct guesses *guesses, const char *who, const char *secret,
                   uint64_t now_ns);

#endif
