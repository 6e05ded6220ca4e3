// SPDX-License-Identifier: MIT
// C interface of libdraco, which has a C++ one only. Called in the isolated child.
#ifndef PRT_MESH_DRACO_H
#define PRT_MESH_DRACO_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

struct prt_draco {
    uint32_t n_vertex, n_triangle;
    float *position, *normal; // [n_vertex][3]; normal may be NULL
    float *color;             // [n_vertex][4], or NULL
    float *uv[8];             // [n_vertex][2], or NULL
    uint32_t *triangle;       // [n_triangle][3] < n_vertex
};
// Decodes a mesh. id: the unique ids of position, normal, colour and uv sets; -1: absent.
// Returns 0, or -1 with the reason in *why, a constant text. The arrays are malloc-ed; free
// with prt_draco_free in either case.
int prt_draco_decode(const void *bytes, size_t n, const int64_t id[11], uint32_t max_vertices,
                     uint32_t max_triangles, struct prt_draco *out, const char **why);
void prt_draco_free(struct prt_draco *d);

#ifdef __cplusplus
}
#endif
#endif
