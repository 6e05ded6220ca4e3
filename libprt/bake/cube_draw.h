/* SPDX-License-Identifier: MIT */
/* The first triangle in every direction from a point: the triangles near a vertex are drawn on
 * a cube around the point, a pixel for each texel's sub-sample, in place of a ray for each. */
#ifndef PRT_BAKE_CUBE_DRAW_H
#define PRT_BAKE_CUBE_DRAW_H

#include "bake/stages.h"
#include "trace/triangle_grid.h"

/* Most triangles that are drawn around a vertex; a multiple of 16. */
enum { DRAW_MOST = 1536 };

/* The triangles about a centre, all that have a point within `reach` mm of it. */
struct nearby {
    uint32_t n; /* a multiple of 16: the last one is repeated */
    float centre[3], reach;
    uint32_t *triangle;  /* [DRAW_MOST] of the mesh */
    float *corner[3][3]; /* [corner][axis][DRAW_MOST], relative to the centre */
    float *normal[3][3]; /* [corner][axis][DRAW_MOST] of the vertices */
};
/* The triangles that are seen from one point, at each texel of the cube. s and t of a direction
 * (s, t, 1) are the coordinates on a face that prt_cube_direction takes. */
struct drawing {
    float from[3];    /* relative to the centre */
    float certain_mm; /* a hit up to this distance is the first of the whole mesh; 0: nothing
                         was drawn */
    float *nearness;  /* [n_coef] 1/r, r along the direction (s, t, 1); 0: nothing is seen */
    uint32_t *at;     /* [n_coef] number in `nearby` of the triangle that is seen */
};
/* Memory of both, one for each thread: taken from `room` (prt_draw_bytes, 64-byte aligned). */
size_t prt_draw_bytes(uint32_t n_coef, uint32_t n_drawing);
struct draw_room {
    struct nearby near;
    struct drawing drawing[SINGLE_MAX_NODES];
    float *plane[3][3]; /* [corner][axis][DRAW_MOST] */
};
void prt_draw_carve(void *room, uint32_t n_coef, uint32_t n_drawing, struct draw_room *out);

/* The triangles within `want` mm of the centre, or within less where they would be more than
 * DRAW_MOST. */
void prt_draw_gather(const struct triangle_grid *grid, const struct prt_mesh *mesh,
                     const float centre[3], float want, struct nearby *near);
/* Draws them from point p into drawing i, at the sub-samples of `pattern`. */
void prt_draw(const struct directions *d, unsigned pattern, const float p[3], uint32_t i,
              struct draw_room *room);
/* Vertex normals of the triangles that 16 rays hit. */
struct corners {
    float n[3][3][16]; /* [corner][axis] */
};
/* Reads 16 texels of a drawing: the distance t [mm] of the triangle that is seen and its number
 * `at` in `nearby`, or UINT32_MAX where no triangle is within `most` mm. length: of the texels'
 * directions (s, t, 1). Returns the lanes whose answer is certain; for the others a ray must be
 * cast. */
uint32_t prt_draw_look(unsigned cpu, const struct drawing *drawing, const uint32_t texel[16],
                       const float length[16], float most, float t[16], uint32_t at[16]);
/* Writes what rays from the drawing's point hit, as prt_scene_intersect16 does: t, u, v, g and
 * triangle of the packet, whose directions are given, and the vertex normals of the triangles.
 * at, t: of prt_draw_look. */
void prt_draw_hits(unsigned cpu, const struct nearby *near, const struct drawing *drawing,
                   const uint32_t at[16], const float t[16], struct prt_packet *packet,
                   struct corners *normals);

#endif
