/* SPDX-License-Identifier: MIT */
/* vertex_glb.h: the part of the writers that makes a GLB. */
#ifndef PRT_VERTEX_GLB_H
#define PRT_VERTEX_GLB_H

#include "vertex_file.h"

/* As prt_vertex_file_write. */
int prt_vertex_write_glb(FILE *out, const struct prt_vertex_data *data);
/* Position of a vertex in the file's unit. */
void prt_vertex_position(const struct prt_vertex_data *data, uint32_t vertex, float out[3]);

#endif
