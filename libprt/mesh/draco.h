// SPDX-License-Identifier: MIT
// The door to libdraco, which is C++ only.
#ifndef PRT_MESH_DRACO_H
#define PRT_MESH_DRACO_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct prt_draco {
    uint32_t n_vertex, n_triangle;
    float *position, *normal, *uv; // [n_vertex][3], [3], [2]; normal and uv may be NULL
    uint32_t *triangle;            // [n_triangle][3] < n_vertex
};
// id: the attributes' unique ids (position, normal, uv), -1 for none. 0, or a reason as text in
// *why. The arrays are malloc-ed; free with prt_draco_free in either case.
int prt_draco_decode(const void *bytes, size_t n, const int64_t id[3], uint32_t max_vertices,
                     uint32_t max_triangles, struct prt_draco *out, const char **why);
void prt_draco_free(struct prt_draco *d);

#ifdef __cplusplus
}
#endif
#endif
