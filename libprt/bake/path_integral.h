/* SPDX-License-Identifier: MIT */
/* Exits of single scattering's rays along a vertex's path (single_nodes.c) and the integrals
 * over them (path_integral.c). Private to the files of single scattering. */
#ifndef PRT_BAKE_PATH_H
#define PRT_BAKE_PATH_H

#include "bake/stages.h"

#include <math.h>

enum { PATH_MAX_PHASE = 9 };

/* The exits of all directions from one node (depth). */
struct exits {
    float *path_mm;       /* s_i' [mm] */
    float *transmittance; /* F_t(eta, w_i) V, 0 when blocked */
    float *dir[3];        /* w_i' outward */
};

struct scratch {
    struct exits node[SINGLE_MAX_NODES];
    float *cosine; /* [n_coef] between texel or cell and vertex normal */
    /* Per node, to find where neighbours differ: */
    float *value[SINGLE_MAX_NODES];     /* [n_coef/4] light through a block of 2 x 2 texels */
    float *uncertain[SINGLE_MAX_NODES]; /* [n_coef/4] most light that unknown visibility of a
                                         * block may hide; 0: visibility is certain */
    float *coarse[SINGLE_MAX_NODES];    /* [n_coef/16] light through a tile of 2 x 2 blocks */
    float *fine[SINGLE_MAX_NODES];      /* [n_coef/16] 1: every block of the tile was traced */
    /* Cells: directions that share the rays of every node, integrated once. */
    uint32_t *cell;  /* [n_coef] cell of each texel */
    uint32_t *first; /* [n_cell] a texel of each cell; NULL: every direction is a cell */
    uint8_t *split;  /* [n_coef/4] 1: the block's texels were traced apart at some node */
    float *y;        /* [PATH_MAX_PHASE] SH of one direction */
};

/* e^-x for x >= 0, relative error 1e-5. It has no branch, nor a choice that the compiler turns
 * into one, so that loops over it vectorise. */
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
void prt_path_integrate(const struct single_plan *plan, const struct fresnel_table *fresnel,
                        const struct scratch *s, const float *depth, float end, uint32_t n,
                        const float *rgb, float *out);
/* Degree l of spherical harmonic k. */
static inline unsigned path_degree(uint32_t k)
{
    return k == 0 ? 0 : k < 4 ? 1 : 2;
}

#endif
