/* SPDX-License-Identifier: MIT */
/* The difference of two shapes, and the directions of a sample in which it can matter. Internal
 * to bake. */
#ifndef PRT_BAKE_SHAPE_CHANGE_H
#define PRT_BAKE_SHAPE_CHANGE_H

#include "bake/stages.h"

/* Triangles in the model's own units; borrowed. */
struct shape {
    uint32_t n_vertex, n_triangle;
    const float (*position)[3];
    const uint32_t (*triangle)[3];
};
/* A few hashes of a shape's triangles: two shapes that share some share as large a part of
 * these, about. */
enum { SHAPE_SKETCH = 64 };
void prt_shape_sketch(const struct shape *shape, uint64_t out[SHAPE_SKETCH]);

/* Triangles that one of the shapes has and the other has not, in a tree of boxes. Immutable,
 * refers to the directions. PRT_NOMEM. *out NULL: the shapes have the same triangles. */
struct shape_change;
int prt_shape_change_create(const struct shape *before, const struct shape *now,
                            const struct directions *directions, struct shape_change **out);
void prt_shape_change_destroy(struct shape_change *change);
/* Adds to the set `fresh` [(n_packet + 63) / 64] the packets of a row whose rays may meet a
 * changed triangle. These rays start within `apart` of `at` (model units); none goes below the
 * face. change NULL: adds none. */
void prt_shape_change_mark(const struct shape_change *change, const float at[3],
                           const float face_normal[3], float apart, uint64_t *fresh);

#endif
