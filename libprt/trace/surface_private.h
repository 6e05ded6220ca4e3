/* SPDX-License-Identifier: MIT */
/* The steps of prt_surface_create: samples (surface_samples.c), then the fine quadrature and
 * the samples' cells (surface_cells.c). */
#ifndef PRT_TRACE_SURFACE_PRIVATE_H
#define PRT_TRACE_SURFACE_PRIVATE_H

#include "prt/surface.h"

#include <math.h>

/* One piece of the running area, and where its sample lies in it. */
struct surface_stratum {
    double begin, sample;
};
/* The translucent triangles of one object in sampling order. Areas are of the model in its own
 * units, so that another scale changes nothing. */
struct piece_list {
    uint32_t n, n_stratum;
    uint32_t *triangle;              /* [n] */
    uint64_t *block;                 /* [n] its cell of a grid through the origin */
    double *end;                     /* [n] running area */
    double edge;                     /* of the cells */
    struct surface_stratum *stratum; /* [n_stratum] */
};
enum { SURFACE_LEVELS = 16 }; /* fourfold splits of a triangle down to a sample's point */
/* Orders them by blocks and, in each, along a Morton curve, so that strata of the running area
 * are compact. n_sample: of all objects. prt_surface_pieces_finish frees the arrays, also after
 * a failure. */
int prt_surface_order(const struct prt_mesh *mesh, uint32_t object, uint32_t n_sample,
                      struct piece_list *out);
void prt_surface_pieces_finish(struct piece_list *list);
/* The strata of about n_sample samples (surface_draw.c). PRT_NOMEM. */
int prt_surface_draw(struct piece_list *list, double n_sample, uint64_t seed);
/* Divides n_sample between the objects by area and draws their strata: fills object_begin and
 * n_sample. PRT_ARG when no object has area. */
int prt_surface_share(struct prt_surface_points *s, struct piece_list *list, uint32_t n_sample,
                      uint64_t seed);
/* Places an object's samples: position, normals, object, triangle, inside, stratum. */
void prt_surface_place(struct prt_surface_points *s, const struct prt_mesh *mesh,
                       const struct piece_list *list, uint32_t object);
/* Lays the fine points, at most fine_mm apart where 16 a sample allow it, and integrates the
 * samples' cells: fine, cell_*, area, centre, spread. Reports "surface" as progress. */
int prt_surface_cells(const struct prt_context *ctx, struct prt_surface_points *s,
                      const struct prt_mesh *mesh, const struct piece_list *list,
                      float fine_mm);
/* Area of a triangle in the model's own units. */
static inline double model_area(const struct prt_mesh *mesh, uint32_t t)
{
    const float(*at)[3] = prt_mesh_model_positions(mesh);
    const float *a = at[mesh->triangle[t][0]], *b = at[mesh->triangle[t][1]];
    const float *c = at[mesh->triangle[t][2]];
    double u[3], v[3], square = 0;
    for (int k = 0; k < 3; k++) u[k] = (double)b[k] - a[k], v[k] = (double)c[k] - a[k];
    for (int k = 0; k < 3; k++) {
        const int p = (k + 1) % 3, q = (k + 2) % 3;
        square += (u[p] * v[q] - u[q] * v[p]) * (u[p] * v[q] - u[q] * v[p]);
    }
    return 0.5 * sqrt(square);
}
bool prt_surface_translucent(const struct prt_mesh *mesh, const struct prt_block *block);

#endif
