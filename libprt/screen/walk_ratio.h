/* SPDX-License-Identifier: MIT */
/* Points of the surface with the exitances W and D, and what lies between them. */
#ifndef SCREEN_WALK_RATIO_H
#define SCREEN_WALK_RATIO_H

#include "internal.h"
#include "prt/walk_ratio.h"

/* A point of the surface: place, unit normal, and exitances under irradiance 1. */
struct ratio_point {
    float p[3], n[3]; /* mm */
    uint32_t object;
    float dipole[3];
    float walk[PRT_WALK_SHARES][3];
    float variance[3]; /* of walk[PRT_WALK_ALL] by the walks' noise */
    float n_group;     /* points that it is the mean of; 0: the object keeps the dipole */
};

/* Points sorted by the cells of a grid over their box. */
struct ratio_grid {
    struct ratio_point *point; /* [n] by cell */
    uint32_t n, cells[3];
    float low[3], edge_mm;
    uint32_t *begin; /* [cells + 1] */
};
/* Sorts the points, which stay the caller's. edge_mm: of a cell, at least. PRT_NOMEM. */
int prt_ratio_grid_create(struct ratio_point *point, uint32_t n, float edge_mm,
                          struct ratio_grid *out);
void prt_ratio_grid_finish(struct ratio_grid *grid);
/* Calls `take` with every point of an object nearer than reach_mm to p and with its weight > 0:
 * (1 - (d/reach)^2)^2 ((1 + cosine of the normals)/2)^8, so that nothing steps where a point
 * comes into reach and two sides of a thin part do not mix. */
void prt_ratio_gather(const struct ratio_grid *grid, const float p[3], const float n[3],
                      uint32_t object, float reach_mm,
                      void (*take)(void *arg, const struct ratio_point *point, float weight),
                      void *arg);

struct prt_walk_ratio {
    uint32_t n_vertex, n_triangle;
    float (*vertex[PRT_WALK_SHARES])[3]; /* [n_vertex] W/D */
    struct ratio_grid grid;              /* owns its points here */
    float spacing_mm;                    /* of the points */
    /* of the mesh as it was; a triangle whose object is PRT_RATIO_NONE is opaque */
    float (*position)[3], (*normal)[3]; /* [n_vertex] */
    uint32_t (*triangle)[3];            /* [n_triangle] */
    uint32_t *object;                   /* [n_triangle] */
    uint8_t *large;                     /* [n_triangle] an edge exceeds spacing_mm */
};
#define PRT_RATIO_NONE UINT32_MAX

/* walk_ratio_field.c: W/D between the points, of all shares, nearest where none is in reach. */
void prt_ratio_between(const struct prt_walk_ratio *ratio, uint32_t object, const float p[3],
                       const float n[3], float out[PRT_WALK_SHARES][3]);
/* Copies the mesh and fills vertex, object and large from the grid. PRT_NOMEM. */
int prt_ratio_vertices(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       struct prt_walk_ratio *ratio);
/* Multiplies the frame's radiance by its options' ratio. */
int prt_ratio_apply(struct frame *f);

#endif
