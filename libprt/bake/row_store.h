/* SPDX-License-Identifier: MIT */
/* The rays of pass 1 as they are kept: which of a row's directions see the sky. They depend on
 * shapes and on the sampling alone, so that every material has the same; and a row of another
 * shape is taken, too, where it has the same sample, but for the directions in which the shapes
 * differ. Internal to bake. */
#ifndef PRT_BAKE_ROW_STORE_H
#define PRT_BAKE_ROW_STORE_H

#include "bake/lane_runs.h"
#include "bake/ray_store.h"
#include "bake/run.h"

/* What decides the rays of a row, apart from the triangles that they meet. In model units. */
struct row_place {
    float position[3], face_normal[3], normal[3], epsilon;
    uint32_t pattern;
    uint32_t words;                  /* prt_horizon_around; 0: no horizon, and no corners */
    struct horizon_corner corner[3]; /* zeroed where there are none */
};

/* Opens the store of a bake's pass 1, and of the bakes that the folder has rays of the one
 * whose shape has most triangles in common. NULL without options.cache, or without memory. */
struct row_store *prt_row_store_open(const struct bake *b);
void prt_row_store_close(struct row_store *store);

/* The rows of n places, piece number `begin` of pass 1: open [n][n_packet] gets a bit a ray,
 * and fresh [n][(n_packet + 63) / 64] the packets that the store does not know. *kept: the
 * store has this very piece, and need not be given it. Returns the number of packets that it
 * knows. Thread-safe. */
uint64_t prt_row_store_read(struct row_store *store, uint32_t begin, uint32_t n,
                            const struct row_place *place, uint16_t *open, uint64_t *fresh,
                            bool *kept);
/* Keeps a piece, all of whose packets are known. Thread-safe. */
void prt_row_store_write(struct row_store *store, uint32_t begin, uint32_t n,
                         const struct row_place *place, const uint16_t *open);

#endif
