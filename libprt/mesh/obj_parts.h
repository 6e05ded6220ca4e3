// SPDX-License-Identifier: MIT
// The parts of an OBJ: faces of one object or group and one material.
#ifndef PRT_MESH_OBJ_PARTS_H
#define PRT_MESH_OBJ_PARTS_H

#include "internal.h"

enum { OBJ_MOST_PARTS = 256 }; // of which there are more, the file is one part

struct obj_part {
    char object[64], surface[64]; // of `o` or `g`, and of `usemtl`; "": none
    bool opaque, begins_object;
    uint32_t vertex_begin, n_vertex, triangle_begin, n_triangle;
};
struct obj_parts {
    struct obj_part part[OBJ_MOST_PARTS]; // once settled: in the order of their vertices
    uint32_t n;
    char object[64], group[64], surface[64]; // of the lines so far
    bool has_objects, too_many;
    uint16_t *of_triangle; // [cap]
    uint32_t cap;
    uint32_t now; // the part of the next face; UINT32_MAX: a name has changed
};

// A line `o` (kind 'o'), `g` or `usemtl` ('m') with its name.
void prt_obj_parts_name(struct obj_parts *parts, char kind, const char *name);
// The newest triangle belongs to the part of the lines so far. PRT_NOMEM.
int prt_obj_parts_triangle(const struct prt_draft *d, struct obj_parts *parts);
// Once all is read: parts with vertices of their own in one piece, and triangles in their
// order; one part where faces of several share vertices. Objects of `o` are bodies; groups of a
// file without `o` are bodies where none has a point in common with another. PRT_NOMEM.
int prt_obj_parts_settle(struct prt_draft *d, struct obj_parts *parts);
void prt_obj_parts_finish(struct obj_parts *parts);

#endif
