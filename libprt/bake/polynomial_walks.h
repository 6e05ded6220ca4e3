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
/* Column (j, channel) of a cluster in a RADIAL tensor that is being made. */
static inline uint16_t *prt_radial_column(const struct prt_tensor *t,
                                          const struct prt_cluster *cluster, uint32_t j,
                                          int channel)
{
    const uint32_t padded = (cluster->n_vertex + 15) / 16 * 16;
    return (uint16_t *)(uintptr_t)t->u + cluster->u_begin +
           ((size_t)j * 3 + (size_t)channel) * padded;
}
/* Ranges over the clusters (struct polynomial_walks): multiple scattering by the pool's
 * functions, and unscattered light by the extinction's. */
int prt_polynomial_walks_multiple(void *walks, size_t begin, size_t end, unsigned worker);
int prt_polynomial_walks_unscattered(void *walks, size_t begin, size_t end, unsigned worker);

#endif
