// SPDX-License-Identifier: MIT
// Masks of a row's rays as runs: most packets of 16 rays are wholly open or wholly dark.
#include "bake/lane_runs.h"

enum { LONGEST = 64 };
enum kind { DARK, OPEN, MIXED }; // a run's first byte: kind << 6 | length - 1

static enum kind kind_of(uint16_t open)
{
    return !open ? DARK : open == 0xffff ? OPEN : MIXED;
}

size_t prt_lanes_pack(const uint16_t *open, uint32_t n_packet, uint8_t *out)
{
    size_t used = 0;
    for (uint32_t k = 0, n; k < n_packet; k += n) {
        const enum kind kind = kind_of(open[k]);
        for (n = 1; n < LONGEST && k + n < n_packet && kind_of(open[k + n]) == kind;) n++;
        out[used++] = (uint8_t)((uint32_t)kind << 6 | (n - 1));
        for (uint32_t i = 0; kind == MIXED && i < n; i++) {
            out[used++] = (uint8_t)open[k + i];
            out[used++] = (uint8_t)(open[k + i] >> 8);
        }
    }
    return used;
}

size_t prt_lanes_unpack(const uint8_t *in, size_t n, uint32_t n_packet, uint16_t *open)
{
    size_t at = 0;
    for (uint32_t k = 0; k < n_packet;) {
        if (at >= n) return 0;
        const uint32_t kind = in[at] >> 6, length = (in[at] & 63u) + 1;
        at++;
        if (kind > MIXED || length > n_packet - k) return 0;
        if (kind == MIXED && n - at < 2 * (size_t)length) return 0;
        for (uint32_t i = 0; i < length; i++, k++) {
            open[k] = kind == OPEN ? 0xffff : 0;
            if (kind != MIXED) continue;
            open[k] = (uint16_t)(in[at] | in[at + 1] << 8);
            at += 2;
        }
    }
    return at;
}
