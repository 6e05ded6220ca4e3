/* SPDX-License-Identifier: MIT */
/* Packed masks of the rays of one row of pass 1. Thread-safe. */
#ifndef PRT_BAKE_LANE_RUNS_H
#define PRT_BAKE_LANE_RUNS_H

#include <stddef.h>
#include <stdint.h>

/* One row of n_packet masks as bytes, at most prt_lanes_most(n_packet) of them. Returns their
 * number. */
size_t prt_lanes_pack(const uint16_t *open, uint32_t n_packet, uint8_t *out);
static inline size_t prt_lanes_most(uint32_t n_packet)
{
    return (size_t)n_packet * 3;
}
/* The opposite: bytes of `in` that were read, or 0 where they are not a row of n_packet. */
size_t prt_lanes_unpack(const uint8_t *in, size_t n, uint32_t n_packet, uint16_t *open);

#endif
