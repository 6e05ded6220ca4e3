// SPDX-License-Identifier: MIT
// Writes colours of up to 16 positions to their vertices. Red and green are stored as 8 bytes
// and blue as 4, so that no store touches another vertex.
#ifndef PRT_RELIGHT_SCATTER_H
#define PRT_RELIGHT_SCATTER_H

#include "base/isa.h"

#include <string.h>

PRT_INLINE void scatter_store(const float *rg, const float *b, const uint32_t *order,
                              uint32_t n, float *color)
{
    for (uint32_t i = 0; i < n; i++) {
        float *out = color + 3ull * order[i];
        memcpy(out, rg + 2 * i, 8);
        memcpy(out + 2, b + i, 4);
    }
}

PRT_INLINE void scatter_add(const float *rg, const float *b, const uint32_t *order, uint32_t n,
                            float *color)
{
    for (uint32_t i = 0; i < n; i++) {
        float *out = color + 3ull * order[i];
        out[0] += rg[2 * i];
        out[1] += rg[2 * i + 1];
        out[2] += b[i];
    }
}

PRT_INLINE void scatter(const float *rg, const float *b, const uint32_t *order, uint32_t n,
                        float *color, bool add)
{
    if (add) scatter_add(rg, b, order, n, color);
    else scatter_store(rg, b, order, n, color);
}

#endif
