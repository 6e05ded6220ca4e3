// SPDX-License-Identifier: MIT
// How the entries of a unit (prt/columns.h), which lie together, are moved to the lanes of
// their rows: a shuffle of bytes for each half of a chunk, for every mask of rows.
#ifndef PRT_RELIGHT_SPREAD_H
#define PRT_RELIGHT_SPREAD_H

#include <stdint.h>

// Of a mask m of rows: how many of the first ones are there; whether row r is; the word of the
// packed entries that goes to a lane; its bytes.
#define ROWS2(m) (((m)&1) + ((m) >> 1 & 1))
#define ROWS3(m) (ROWS2(m) + ((m) >> 2 & 1))
#define ROWS4(m) (ROWS3(m) + ((m) >> 3 & 1))
#define BEFORE(m, r) \
    ((r) == 0 ? 0 : (r) == 1 ? ((m)&1) : (r) == 2 ? ROWS2(m) : (r) == 3 ? ROWS3(m) : ROWS4(m))
// words before lane 8, the third row's b
#define FIRST_HALF(m) (3 * ROWS2(m) + 2 * ((m) >> 2 & 1))
#define WORD(m, lane) \
    (3 * BEFORE(m, (lane) / 3) + (lane) % 3 - ((lane) < 8 ? 0 : FIRST_HALF(m)))
#define HAS(m, lane) ((lane) < 15 && ((m) >> (lane) / 3 & 1))
#define BYTES(m, lane)                               \
    (char)(HAS(m, lane) ? 2 * WORD(m, lane) : -128), \
        (char)(HAS(m, lane) ? 2 * WORD(m, lane) + 1 : -128)
#define HALF(m, a)                                                                           \
    BYTES(m, a), BYTES(m, (a) + 1), BYTES(m, (a) + 2), BYTES(m, (a) + 3), BYTES(m, (a) + 4), \
        BYTES(m, (a) + 5), BYTES(m, (a) + 6), BYTES(m, (a) + 7)
#define MASK(m)                                                                        \
    {                                                                                  \
        {HALF(m, 0), HALF(m, 8)}, FIRST_HALF(m), 3 * BEFORE(m, 4) + 3 * ((m) >> 4 & 1) \
    }
#define MASKS4(m) MASK(m), MASK((m) + 1), MASK((m) + 2), MASK((m) + 3)
#define MASKS16(m) MASKS4(m), MASKS4((m) + 4), MASKS4((m) + 8), MASKS4((m) + 12)

static const struct spread {
    char shuffle[32];
    uint32_t half, n; // words of the first half, and of all
} spreads[32] __attribute__((aligned(64))) = {MASKS16(0), MASKS16(16)};

#endif
