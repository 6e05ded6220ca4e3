/* SPDX-License-Identifier: MIT */
/* Exits of single scattering's rays along a vertex's path (single_nodes.c) and the integrals
 * over them (path_integral.c). Private to the files of single scattering. */
#ifndef PRT_BAKE_PATH_H
#define PRT_BAKE_PATH_H

#include "bake/cube_draw.h"

#include <math.h>

enum { PATH_MAX_PHASE = 9 };

/* The exits of all directions from one node (depth). */
struct exits {
    float *path_mm;       /* s_i' [mm] */
    float *transmittance; /* F_t(eta, w_i) V, 0 when blocked */
    float *dir[3];        /* w_i' outward */
};

struct scratch {
    struct exits *node; /* [SINGLE_MAX_NODES], of the index that is traced or integrated */
    struct exits of_eta[PRT_ETA_MOST_NODES][SINGLE_MAX_NODES]; /* of plan->eta */
    float *cosine; /* [n_coef] between texel or cell and vertex normal */
    /* Per node, to find where neighbours differ: */
    float *value[SINGLE_MAX_NODES];     /* [n_coef/4] light through a block of 2 x 2 texels, or
                                         * before through a tile of 2 x 2 blocks */
    float *uncertain[SINGLE_MAX_NODES]; /* [n_coef/4] most light that unknown visibility of a
                                         * block may hide; 0: visibility is certain */
    float *step[SINGLE_MAX_NODES]; /* [n_coef/4] most that a block, or before a tile, differs
                                    * from its neighbours */
    float *fine[SINGLE_MAX_NODES]; /* [n_coef/16] 1: every block of the tile was traced */
    /* Cells: directions that share the rays of every node, integrated once. */
    uint32_t *cell;  /* [n_coef] cell of each texel */
    uint32_t *first; /* [n_cell] a texel of each cell; NULL: every direction is a cell */
    uint8_t *split;  /* [n_coef/4] 1: the block's texels were traced apart at some node */
    uint32_t *list;  /* [n_coef + 16] numbers of the rays of one node */
    float *y;        /* [PATH_MAX_PHASE] SH of one direction */
    struct draw_room draw;
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

/* (e^-a - e^-b) / (b - a), the mean of an exponential between two exponents: the quotient, or
 * near a = b its series, blended around a difference of 0.1, where both hold to 1e-5. */
static inline __attribute__((always_inline)) float mean_exp(float ea, float eb, float a,
                                                            float b)
{
    float d = b - a, d2 = d * d;
    float quotient = (ea - eb) * d / (d2 + 1e-12f);
    float series = 0.5f * (ea + eb) * (1 - d2 * (1.0f / 12));
    float x = 0.5f * (100 * d2 + 4 - fabsf(100 * d2 - 4)), x2 = x * x, x4 = x2 * x2;
    float far = x4 * x4 / (1 + x4 * x4);
    return far * quotient + (1 - far) * series;
}

/* Points of the path between two nodes, directions that are integrated at a time. */
enum { PATH_SUBSTEPS = 4, PATH_TILE = 128, PATH_POINTS = SINGLE_MAX_NODES * PATH_SUBSTEPS + 1 };

/* A tile of directions along the path: s + s' and F_t V at the points of a monotone cubic
 * through the surface and the nodes. */
struct path {
    uint32_t n_point; /* 1 + n_node * substeps */
    float depth[PATH_POINTS];
    float u[PATH_POINTS][PATH_TILE];             /* s + s' [mm] */
    float transmittance[PATH_POINTS][PATH_TILE]; /* F_t V */
    float slope[PATH_TILE];                      /* of u beyond the last node */
};
struct knots {
    float depth[SINGLE_MAX_NODES + 1];
    float v[SINGLE_MAX_NODES + 1][PATH_TILE]; /* values */
};

/* Integrates the nodes of n directions at `depth` [n_node], on to the path's `end` [mm].
 * With plan->extinction: out [n_phase][n_radial][n], or with the directions' weights rgb [n][3]
 * their sum, added to out [n_phase][n_radial][3]. Else out [n_phase*3][n] and no rgb. */
struct path_job {
    const struct single_plan *plan;
    const struct fresnel_table *fresnel;
    const struct scratch *s;
    const float *depth;
    float end;
    uint32_t n;
    const float *rgb;
    float *out;
    const float *toward;      /* [3] plan->toward: the outward direction of the path */
    uint32_t n_radial, first; /* with plan->extinction: functions of out in a plane, 0: its own;
                                 the first of those that are integrated */
};
void prt_path_integrate(const struct path_job *job);
/* SH of the refracted directions w_i' at the nodes of direction t. False: no node has light. */
bool prt_path_node_sh(const struct single_plan *plan, const struct scratch *s, uint32_t t,
                      float y[SINGLE_MAX_NODES][PATH_MAX_PHASE]);

/* A tile of the path with the phase function towards job->toward: out [3][n]. */
void prt_path_toward(const struct path_job *job, const struct path *path, uint32_t first,
                     uint32_t m);

/* Index of the k-th direction or cell in the nodes' arrays. */
static inline uint32_t path_direction(const struct scratch *s, uint32_t k)
{
    return s->first ? s->first[k] : k;
}

/* The phase function's factor of w_i' in the middle of interval i of the path. */
static inline void path_middle_sh(const struct single_plan *plan, const struct path *path,
                                  uint32_t i, float y[SINGLE_MAX_NODES][PATH_MAX_PHASE],
                                  float out[PATH_MAX_PHASE])
{
    uint32_t substeps = (path->n_point - 1) / plan->n_node, a = (i - 1) / substeps;
    float x = ((float)(i - 1 - a * substeps) + 0.5f) / (float)substeps;
    const float *y0 = y[a ? a - 1 : 0], *y1 = y[a];
    for (uint32_t k = 0; k < plan->n_phase; k++) out[k] = y0[k] + x * (y1[k] - y0[k]);
}

/* Degree l of spherical harmonic k. */
static inline unsigned path_degree(uint32_t k)
{
    return k == 0 ? 0 : k < 4 ? 1 : 2;
}

#endif
