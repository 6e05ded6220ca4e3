// SPDX-License-Identifier: MIT
// The hash that tells meshes apart: a bake and a preview of one model have the same.
#include "internal.h"

uint64_t prt_mesh_hash(const struct prt_mesh *m)
{
    uint64_t h = prt_hash64(m->position, (size_t)m->n_vertex * 12, 1);
    h = prt_hash64(m->normal, (size_t)m->n_vertex * 12, h);
    h = prt_hash64(m->triangle, (size_t)m->n_triangle * 12, h);
    h = prt_hash64(m->block, (size_t)m->n_block * sizeof *m->block, h);
    if (!prt_mesh_has_look(m)) return h;
    if (m->uv) h = prt_hash64(m->uv, (size_t)m->n_vertex * 8, h);
    if (m->n_uv > 1) h = prt_hash64(m->uv_more, (m->n_uv - 1ull) * m->n_vertex * 8, h);
    if (m->corner_uv) h = prt_hash64(m->corner_uv, (size_t)m->n_triangle * 24, h);
    if (m->color) h = prt_hash64(m->color, (size_t)m->n_vertex * 16, h);
    if (m->maps) h = prt_hash64(m->maps, m->n_surface * sizeof *m->maps, h);
    for (uint32_t i = 0; i < m->n_image; i++)
        h = prt_hash64(m->image[i].hash, sizeof m->image[i].hash, h);
    return prt_hash64(&m->texture_split, sizeof m->texture_split, h);
}
