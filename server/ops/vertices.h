/* SPDX-License-Identifier: MIT */
/* vertices.h owns new positions and normals of a request: their checks, and moving vertices by
 * them. UPDATE_VERTICES and PUT_POSE share them. */
#ifndef RELIGHTD_VERTICES_H
#define RELIGHTD_VERTICES_H

#include "net/request.h"
#include "render/shared/geometry.h"

/* Vertices [first, first + n): values are f32 [n][3] positions in mm or, with own_units, in the
 * model's units, then f32 [n][3] normals where has_normals. */
struct vertex_change {
    uint32_t first, n;
    bool own_units, has_normals;
    const float *values;
};

/* Whether the payload has the size that n vertices take; otherwise the request is answered. */
bool vertices_sized(struct request *request, uint32_t n, bool has_normals);
/* Whether a vertex is outside the mesh or not finite, with the error's text (OUT_OF_RANGE). Any
 * thread. */
bool vertices_bad(const struct vertex_change *change, const struct prt_mesh *mesh,
                  const char *name, char error[256]);
/* Writes the positions, and the normals: given ones normalised, others 0, which stands for
 * those of the triangles. Any thread. */
void vertices_move(const struct vertex_change *change, const struct prt_mesh *mesh,
                   struct pose *pose);

#endif
