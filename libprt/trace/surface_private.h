/* SPDX-License-Identifier: MIT */
/* The steps of prt_surface_create: samples (surface_samples.c), then the fine quadrature and
 * the samples' cells (surface_cells.c). */
#ifndef PRT_TRACE_SURFACE_PRIVATE_H
#define PRT_TRACE_SURFACE_PRIVATE_H

#include "prt/surface.h"

/* The translucent triangles of one object in sampling order. */
struct piece_list {
    uint32_t n;
    uint32_t *triangle; /* [n] */
    double *end;        /* [n] running area [mm^2] */
};
/* Orders them along a Morton curve, so that systematic sampling of the running area is
 * stratified in space. The caller frees the arrays, also after a failure. */
int prt_surface_order(const struct prt_mesh *mesh, uint32_t object, struct piece_list *out);
/* Divides n_sample between the objects by area: fills object_begin, n_sample and spacing.
 * PRT_ARG when no object has area. */
int prt_surface_share(struct prt_surface_points *s, const struct piece_list *list,
                      uint32_t n_sample);
/* Places n samples on an object: position, normals, object. */
void prt_surface_place(struct prt_surface_points *s, const struct prt_mesh *mesh,
                       const struct piece_list *list, uint32_t object, uint32_t n,
                       uint64_t seed);
/* Lays the fine points, at most fine_mm apart where 16 a sample allow it, and integrates the
 * samples' cells: fine, cell_*, area, centre, spread. Reports "surface" as progress. */
int prt_surface_cells(const struct prt_context *ctx, struct prt_surface_points *s,
                      const struct prt_mesh *mesh, const struct piece_list *list,
                      float fine_mm);
bool prt_surface_translucent(const struct prt_mesh *mesh, const struct prt_block *block);

#endif
