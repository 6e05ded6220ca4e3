/* SPDX-License-Identifier: MIT */
/* Look-up on a logarithmic grid. The bits of a positive float ascend with its value, and
 * linearly within an octave, so the bits above `shift` number the intervals of a grid with
 * 2^(23 - shift) intervals an octave: the index of a radius takes one shift, no logarithm. */
#ifndef PRT_BASE_LOG_GRID_H
#define PRT_BASE_LOG_GRID_H

#include <stdint.h>
#include <string.h>

static inline uint32_t prt_float_bits(float x)
{
    uint32_t bits;
    memcpy(&bits, &x, sizeof bits);
    return bits;
}

static inline float prt_bits_float(uint32_t bits)
{
    float x;
    memcpy(&x, &bits, sizeof x);
    return x;
}

/* Index of the interval that holds x > 0. */
static inline uint32_t prt_log_index(float x, unsigned shift)
{
    return prt_float_bits(x) >> shift;
}

/* First value of an interval. */
static inline float prt_log_node(uint32_t index, unsigned shift)
{
    return prt_bits_float(index << shift);
}

#endif
