// SPDX-License-Identifier: MIT
// Hostile records of a ray store: packed rows of pass 1. The first byte chooses their length.
#include "bake/lane_runs.h"

#include <stdlib.h>

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size);

int LLVMFuzzerTestOneInput(const uint8_t *data, size_t size)
{
    if (!size) return 0;
    const uint32_t n_packet = 1 + data[0] * 6u;
    uint16_t *open = malloc(n_packet * sizeof *open);
    uint8_t *again = malloc(prt_lanes_most(n_packet));
    size_t used = open && again ? prt_lanes_unpack(data + 1, size - 1, n_packet, open) : 0;
    if (used > size - 1) abort();
    if (used && prt_lanes_pack(open, n_packet, again) > prt_lanes_most(n_packet)) abort();
    free(open);
    free(again);
    return 0;
}
