// SPDX-License-Identifier: MIT
// Textures in answers to GEOMETRY: sections of the payload, messages of surfaces and images.
#ifndef RELIGHTD_OPS_GEOMETRY_TEXTURES_H
#define RELIGHTD_OPS_GEOMETRY_TEXTURES_H

#include "net/dispatch.h"
#include "prt/mesh.h"
#include "relight.pb-c.h"

struct texture_sections {
    size_t uv, corner_uv, color, blocked; // offsets; 0: left out
};
// Appends the sections of a mesh to a payload of `size` bytes; returns its new size.
size_t texture_sections_plan(const struct prt_mesh *mesh, size_t size,
                             struct texture_sections *out);
void texture_sections_copy(const struct prt_mesh *mesh, const struct texture_sections *at,
                           char *payload);
// Fills the answer's fields. Returns the memory behind them, to free() after the answer is
// packed, or NULL without memory.
void *texture_answer(const struct prt_mesh *mesh, const struct texture_sections *at,
                     Relight__GeometryAnswer *out);
// Answers a request that names an image by its hash.
void op_geometry_image(struct request *request);
// Answers a request for the coarse order.
void op_geometry_coarse(struct request *request);

#endif
