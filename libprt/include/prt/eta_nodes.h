/* SPDX-License-Identifier: MIT */
/* prt/eta_nodes.h owns transport at a free refractive index (METHODS §5, any index): it is
 * known at a few nodes of eta, and a medium's is a weighted sum of these. Thread-safe. */
#ifndef PRT_ETA_NODES_H
#define PRT_ETA_NODES_H

#include "prt/radial.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { PRT_ETA_MOST_NODES = 4 };
struct prt_eta_nodes {
    uint32_t n;
    float low, high;                /* indices that the nodes serve */
    float node[PRT_ETA_MOST_NODES]; /* ascending */
};
/* The nodes that bakes have, for eta from 1.2 to 1.6: two of multiple scattering, three of
 * single scattering. */
void prt_eta_nodes_default(enum prt_radial_family family, struct prt_eta_nodes *out);
/* The nodes as a file stores them: low, high and the nodes, axis [n]. PRT_FORMAT: they are not
 * nodes of one range. */
int prt_eta_nodes_from_axis(uint32_t n, const float *axis, struct prt_eta_nodes *out);
/* Weights [n] of the nodes for a medium of index eta, which lies in the range. *error gets the
 * light that they misplace, a share; NULL: it is not wanted. PRT_INTERNAL: the nodes are so
 * close that no weights follow from them. */
int prt_eta_weights(enum prt_radial_family family, const struct prt_eta_nodes *nodes,
                    double eta, double *weight, double *error);

#ifdef __cplusplus
}
#endif
#endif
