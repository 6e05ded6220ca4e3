/* SPDX-License-Identifier: MIT */
/* Triangles of a mesh by their place: those within a distance of a point. */
#ifndef PRT_TRACE_TRIANGLE_GRID_H
#define PRT_TRACE_TRIANGLE_GRID_H

#include "prt/mesh.h"

struct triangle_grid;

/* NULL: no memory. The mesh must outlive the grid. Many threads may search it at once. */
struct triangle_grid *prt_triangle_grid_create(const struct prt_mesh *mesh);
void prt_triangle_grid_destroy(struct triangle_grid *grid);
/* Every triangle with a point within `radius` mm of `at`, and perhaps some that are farther, in
 * out [most], the same order each time. Returns their number, or most + 1 when they are more.
 */
uint32_t prt_triangle_grid_near(const struct triangle_grid *grid, const float at[3],
                                float radius, uint32_t *out, uint32_t most);

#endif
