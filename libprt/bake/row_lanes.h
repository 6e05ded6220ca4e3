/* SPDX-License-Identifier: MIT */
/* The rays of pass 1 as they are kept: which of a row's directions see the sky. They depend on
 * shapes and on the sampling alone, so that every material has the same. */
#ifndef PRT_BAKE_ROW_LANES_H
#define PRT_BAKE_ROW_LANES_H

#include "bake/lane_runs.h"
#include "bake/ray_store.h"
#include "bake/run.h"

/* Rows [begin, begin + n) of pass 1 from the store: open [n][n_packet] gets a bit a ray. False:
 * they are not there, or not whole. Thread-safe. */
bool prt_row_lanes_read(struct ray_store *store, size_t begin, size_t n, uint32_t n_packet,
                        uint16_t *open, uint64_t *rays);
void prt_row_lanes_write(struct ray_store *store, size_t begin, size_t n, uint32_t n_packet,
                         const uint16_t *open, uint64_t rays);

/* Opens the store of a bake's pass 1, whose key hashes all that the rays depend on; NULL
 * without options.cache. */
struct ray_store *prt_row_lanes_open(const struct bake *b);

#endif
