/* SPDX-License-Identifier: MIT */
/* The places of a surface whose horizon is traced: a mesh's vertices, and points of its larger
 * triangles, so that a coarse mesh's horizon is as fine as that of a dense one. Internal to
 * bake. */
#ifndef PRT_BAKE_HORIZON_PLACES_H
#define PRT_BAKE_HORIZON_PLACES_H

#include "prt/mesh.h"

struct horizon_places {
    const struct prt_mesh *mesh;
    uint32_t n_place; /* the mesh's vertices first */
    /* log2 of the parts of a triangle's edges; UINT8_MAX: the triangle is too wide even then */
    uint8_t *level;       /* [n_triangle] */
    uint32_t *edge_first; /* [n_triangle][3] places of the edge from corner k to k + 1, from its
                             smaller vertex on */
    uint32_t *inner_first; /* [n_triangle] */
    float (*point)[3];     /* [n_place - n_vertex] */
    float (*normal)[3];
};
/* Divides triangles with edges above `widest` [mm] into parts below it, the widest ones alone
 * and into wider parts where that takes more than about most_more places. Wider ones get
 * UINT8_MAX. PRT_NOMEM: *out is empty. */
int prt_horizon_places_create(const struct prt_mesh *mesh, double widest, uint32_t most_more,
                              struct horizon_places *out);
void prt_horizon_places_finish(struct horizon_places *places);
/* The three places around barycentric (u, v) of a triangle; false where it is too wide. */
bool prt_horizon_places_around(const struct horizon_places *places, uint32_t triangle, float u,
                               float v, uint32_t corner[3]);
/* A place's position and unit normal. */
void prt_horizon_place(const struct horizon_places *places, uint32_t place,
                       const float **position, const float **normal);

#endif
