/* SPDX-License-Identifier: MIT */
/* What single scattering's rays met along a vertex's path (single.c), and the integrals over it
 * (path_integral.c). Private to the two. */
#ifndef PRT_BAKE_PATH_H
#define PRT_BAKE_PATH_H

#include "bake/stages.h"

#include <math.h>

enum { PATH_MAX_PHASE = 9 };

/* What a direction meets at a node: distance out s', F_t V, and the refracted way in. */
struct exits {
    float *way;    /* s_i' [mm] */
    float *open;   /* F_t(eta, w_i) V, 0 when blocked */
    float *dir[3]; /* w_i' outward */
};

struct scratch {
    struct exits node[SINGLE_MAX_NODES];
    float *side; /* [n_coef] cosine between texel and vertex normal */
    /* Per node what the rays bring, to find where neighbours differ. */
    float *value[SINGLE_MAX_NODES]; /* [n_coef/4] of a block of 2 x 2 texels */
    float *
        doubt[SINGLE_MAX_NODES]; /* [n_coef/4] most a block may hide: 0, or a ray was cast on */
    float *coarse[SINGLE_MAX_NODES]; /* [n_coef/16] of a tile of 2 x 2 blocks */
    float *fine[SINGLE_MAX_NODES];   /* [n_coef/16] 1: every block of the tile was traced */
    /* Cells: directions that share what every node met, integrated once. */
    uint32_t *cell;  /* [n_coef] cell of each texel */
    uint32_t *first; /* [n_cell] a texel of each cell; NULL: every direction is its own */
    uint8_t *split;  /* [n_coef/4] 1: texels of the block were traced apart at some node */
    float *y;        /* [PATH_MAX_PHASE] SH of one direction */
};

/* e^-x for x >= 0, relative error 1e-5; without a branch, or a choice that the compiler makes
 * one of, so that loops over it vectorise. */
static inline __attribute__((always_inline)) float exp_minus(float x)
{
    float y = x * -1.44269504f;
    y = 0.5f * (y - 125 + fabsf(y + 125)); // max(y, -125)
    float whole = (float)(int)(y - 0.5f), f = (y - whole) * 0.69314718f;
    float p = 1 + f * (1 + f * (0.5f + f * (0.166666667f +
                                            f * (0.0416666667f +
                                                 f * (0.00833333333f + f * 0.00138888889f)))));
    union {
        int32_t i;
        float f;
    } scale = {((int32_t)whole + 127) << 23};
    return p * scale.f;
}

/* Integrates the nodes of n directions at `depth` [n_node], on to the path's `end` [mm].
 * With plan->extinction: out [n_phase][n_radial][n], or with the directions' weights rgb [n][3]
 * their sum, added to out [n_phase][n_radial][3]. Else out [n_phase*3][n] and no rgb. */
void path_integrate(const struct single_plan *plan, const struct fresnel_table *fresnel,
                    const struct scratch *s, const float *depth, float end, uint32_t n,
                    const float *rgb, float *out);
/* Degree l of spherical harmonic k. */
static inline unsigned path_degree(uint32_t k)
{
    return k == 0 ? 0 : k < 4 ? 1 : 2;
}

#endif
