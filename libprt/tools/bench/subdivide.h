// SPDX-License-Identifier: MIT
// A baked transport on a finer mesh of its model, for sizes that take too long to bake.
#ifndef PRT_BENCH_SUBDIVIDE_H
#define PRT_BENCH_SUBDIVIDE_H

#include "prt/transport.h"

// A FACTORED tensor of a mesh (not RADIAL) on n_vertex vertices: edges get vertices in their
// middles, level by level, the last level up to n_vertex; they lie behind the mesh's
// own vertices in the file, as subdivisions write them. A new vertex is of its first parent's
// cluster and has its parents' mean U where they share that. Rows are the given tensor's, which
// must outlive it. PRT_NOMEM at worst; free with subdivided_finish.
int subdivided_tensor(const struct prt_mesh *mesh, const struct prt_tensor *tensor,
                      uint32_t n_vertex, struct prt_tensor *out);
void subdivided_finish(struct prt_tensor *tensor);

#endif
