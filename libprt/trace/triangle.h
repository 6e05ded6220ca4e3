/* SPDX-License-Identifier: MIT */
/* Triangles of a mesh and their order in space, for the samplers of trace and screen. Header
 * only. */
#ifndef PRT_TRACE_TRIANGLE_H
#define PRT_TRACE_TRIANGLE_H

#include "prt/mesh.h"

#include <math.h>

/* (b - a) x (c - a) [mm^2], twice the area long. */
static inline void triangle_cross(const struct prt_mesh *mesh, uint32_t t, double out[3])
{
    const float *a = mesh->position[mesh->triangle[t][0]];
    const float *b = mesh->position[mesh->triangle[t][1]];
    const float *c = mesh->position[mesh->triangle[t][2]];
    double u[3], v[3];
    for (int k = 0; k < 3; k++) u[k] = (double)b[k] - a[k], v[k] = (double)c[k] - a[k];
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

/* [mm^2] */
static inline double triangle_area(const struct prt_mesh *mesh, uint32_t t)
{
    double n[3];
    triangle_cross(mesh, t, n);
    return 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

/* Moves bit i of the lowest 21 bits to bit 3i: a Morton code is
 * morton_spread(x) | morton_spread(y) << 1 | morton_spread(z) << 2. */
static inline uint64_t morton_spread(uint64_t x)
{
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffULL;
    x = (x | x << 16) & 0x1f0000ff0000ffULL;
    x = (x | x << 8) & 0x100f00f00f00f00fULL;
    x = (x | x << 4) & 0x10c30c30c30c30c3ULL;
    return (x | x << 2) & 0x1249249249249249ULL;
}

#endif
