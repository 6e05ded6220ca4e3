/* SPDX-License-Identifier: MIT */
/* prt/walk_grid.h owns the grid of media at which walks of a free medium are known, and the
 * interpolation between them (METHODS §9, free media). */
#ifndef PRT_WALK_GRID_H
#define PRT_WALK_GRID_H

#include "prt/medium.h"

#ifdef __cplusplus
extern "C" {
#endif

enum { PRT_WALK_MOST_LEVELS = 24, PRT_WALK_MOST_NODES = 16 };
/* Media of every level sigma_s' with every node sigma_a; medium number level * n_node + node.
 */
struct prt_walk_grid {
    uint32_t n_level, n_node;
    float level[PRT_WALK_MOST_LEVELS]; /* [mm^-1] ascending, positive */
    float node[PRT_WALK_MOST_NODES];   /* [mm^-1] ascending from 0 */
};
/* The grid of new bakes: 13 levels from 0.02 to 27, 10 nodes from 0 to 2.1 mm^-1. */
void prt_walk_grid_default(struct prt_walk_grid *grid);
/* The grid from its axes, [n_level] and then [n_node], as a .prt has them: the second begins
 * with the first 0. PRT_FORMAT unless both ascend and have 4 to the most above. */
int prt_walk_grid_from_axes(uint32_t n, const float *axes, struct prt_walk_grid *grid);
/* The answer of a medium of one channel is the sum of weight [n_level * n_node] times the
 * answers of the grid's media: a cubic spline over ln sigma_s' times a combination of
 * e^(-sigma_a L) over the nodes. Both coefficients are held inside the grid; the weights are
 * continuous in them. *error: the share of light that the interpolation misplaces, by the
 * dipole's profiles and exponential lengths of paths; true also for media outside. NULL: not
 * computed. */
void prt_walk_grid_weights(const struct prt_walk_grid *grid, double eta, double sigma_s_prime,
                           double sigma_a, double *weight, double *error);
/* The share of light that is scattered twice or more, up to a factor that changes slowly. */
double prt_walk_share(double sigma_s_prime, double sigma_a);

#ifdef __cplusplus
}
#endif
#endif
