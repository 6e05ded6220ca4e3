/* SPDX-License-Identifier: MIT */
/* Polynomial transport by random walks (METHODS §9, free media): columns under a fixed light.
 */
#ifndef PRT_BAKE_POLYNOMIAL_WALKS_H
#define PRT_BAKE_POLYNOMIAL_WALKS_H

#include "bake/free_walks.h"
#include "bake/sources.h"

struct polynomial_walks {
    struct bake *b;
    const struct bases *bases;
    struct walk_pool pool;
    struct lit_rows lit; /* the irradiance in three channels */
    struct prt_tensor *tensor;
};
/* Stores columns [j][channel][n_vertex] of a cluster in a RADIAL tensor that is being made.
 * Each gets the power of two as a factor that makes its largest number 2^14 to 2^15, so that
 * its halves keep their digits under any light. The columns are overwritten. */
void prt_radial_store(const struct prt_tensor *tensor, uint32_t cluster, float *columns);
/* Ranges over the clusters (struct polynomial_walks): multiple scattering by the pool's
 * functions, and unscattered light by the extinction's. */
int prt_polynomial_walks_multiple(void *walks, size_t begin, size_t end, unsigned worker);
int prt_polynomial_walks_unscattered(void *walks, size_t begin, size_t end, unsigned worker);

#endif
