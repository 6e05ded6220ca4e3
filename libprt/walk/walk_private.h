/* SPDX-License-Identifier: MIT */
/* The bodies of a scene as walks read them. */
#ifndef PRT_WALK_PRIVATE_H
#define PRT_WALK_PRIVATE_H

#include "prt/walk.h"

enum { WALK_OPAQUE = UINT32_MAX }; /* the object of a triangle where walks end */

struct prt_walk_space {
    const struct prt_scene *scene;
    uint32_t n_object;
    uint32_t *triangle_object; /* [n_triangle] or WALK_OPAQUE */
    double *volume, *area;     /* [n_object] mm^3, mm^2 */
    float (*inward)[3];        /* [n_weld] unit, away from all faces of a vertex; or 0 */
    float low[3], high[3];     /* mm, box of all triangles */
    float epsilon;             /* mm by which a walk keeps off the surface */
    /* A cell's value times quantum_mm is a lower bound on the distance of each of its points to
     * every triangle. */
    uint32_t n[3];
    float cell_mm, quantum_mm;
    uint8_t *bound; /* [n[2]][n[1]][n[0]] */
};

/* The lower bound at a point [mm]; 0 outside the grid. */
static inline float walk_bound(const struct prt_walk_space *s, const float p[3])
{
    float x = (p[0] - s->low[0]) / s->cell_mm, y = (p[1] - s->low[1]) / s->cell_mm,
          z = (p[2] - s->low[2]) / s->cell_mm;
    if (!(x >= 0 && y >= 0 && z >= 0 && x < (float)s->n[0] && y < (float)s->n[1] &&
          z < (float)s->n[2]))
        return 0;
    size_t cell = ((size_t)z * s->n[1] + (size_t)y) * s->n[0] + (size_t)x;
    return s->quantum_mm * s->bound[cell];
}

/* First directions of walks: cosines outside at equal shares of F_t cos, and a frame about the
 * normal. */
enum { WALK_ANGLES = 256 };
void prt_walk_first_cosines(float eta, float cosine[WALK_ANGLES + 1]);
void prt_walk_frame(const float n[3], float tangent[3], float bitangent[3]);
/* Exact unpolarised reflectance of the boundary for light inside at this cosine. */
float prt_walk_inner_reflectance(float eta, float cosine);

/* Fills the grid: n, cell_mm, quantum_mm, bound. PRT_NOMEM. */
int prt_walk_grid(struct prt_walk_space *space, const struct prt_mesh *mesh);

#endif
