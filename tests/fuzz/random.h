// SPDX-License-Identifier: MIT
// Random numbers that a seed repeats.
#ifndef TESTS_FUZZ_RANDOM_H
#define TESTS_FUZZ_RANDOM_H

#include <stdbool.h>
#include <stdint.h>

struct rnd {
    uint64_t state;
};

static inline void rnd_seed(struct rnd *r, uint64_t seed)
{
    uint64_t z = seed + 0x9e3779b97f4a7c15u; // splitmix64: near seeds give far states
    z = (z ^ (z >> 30)) * 0xbf58476d1ce4e5b9u;
    z = (z ^ (z >> 27)) * 0x94d049bb133111ebu;
    r->state = (z ^ (z >> 31)) | 1;
}

static inline uint64_t rnd_bits(struct rnd *r)
{
    r->state ^= r->state << 13, r->state ^= r->state >> 7, r->state ^= r->state << 17;
    return r->state * 0x2545f4914f6cdd1du;
}

// [0, below), 0 where below is 0.
static inline uint32_t rnd(struct rnd *r, uint32_t below)
{
    return (uint32_t)((rnd_bits(r) >> 32) * below >> 32);
}

static inline bool rnd_chance(struct rnd *r, uint32_t in)
{
    return !rnd(r, in);
}

#define RND_PICK(r, list) ((list)[rnd((r), sizeof(list) / sizeof *(list))])

#endif
