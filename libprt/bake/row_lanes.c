// SPDX-License-Identifier: MIT
// Visible directions of pass 1's rows in the store of a bake.
#include "bake/row_lanes.h"

#include <string.h>

enum { SLOT_LANES = 1 };

bool prt_row_lanes_read(struct ray_store *store, size_t begin, size_t n, uint32_t n_packet,
                        uint16_t *open, uint64_t *rays)
{
    size_t bytes = 0, at = 0;
    uint8_t *data = prt_ray_store_get(store, SLOT_LANES, (uint32_t)begin, &bytes, rays);
    bool ok = data != NULL;
    for (size_t i = 0; ok && i < n; i++) {
        size_t used = prt_lanes_unpack(data + at, bytes - at, n_packet, open + i * n_packet);
        ok = used > 0;
        at += used;
    }
    prt_free(data);
    return ok && at == bytes;
}

void prt_row_lanes_write(struct ray_store *store, size_t begin, size_t n, uint32_t n_packet,
                         const uint16_t *open, uint64_t rays)
{
    uint8_t *data = store ? prt_alloc(n * prt_lanes_most(n_packet), 1) : NULL;
    size_t used = 0;
    if (!data) return;
    for (size_t i = 0; i < n; i++)
        used += prt_lanes_pack(open + i * n_packet, n_packet, data + used);
    prt_ray_store_put(store, SLOT_LANES, (uint32_t)begin, data, used, rays);
    prt_free(data);
}

// Shapes, samples, directions, and the kernels that round; not the material.
static uint64_t rows_key(const struct bake *b)
{
    const struct prt_mesh *m = b->mesh;
    const struct prt_surface_points *s = b->surface;
    const struct directions *d = b->directions;
    const uint64_t more[] = {PRT_BAKE_VERSION, b->ctx ? b->ctx->cpu : 0,
                             b->o.seed,        d->n,
                             d->n_pattern,     s->n_sample,
                             m->n_vertex,      m->n_triangle};
    uint64_t h = prt_hash64(more, sizeof more, 3);
    h = prt_hash64(&d->faint, sizeof d->faint, h);
    h = prt_hash64(m->position, (size_t)m->n_vertex * 12, h);
    h = prt_hash64(m->normal, (size_t)m->n_vertex * 12, h);
    h = prt_hash64(m->triangle, (size_t)m->n_triangle * 12, h);
    h = prt_hash64(s->position, (size_t)s->n_sample * 12, h);
    h = prt_hash64(s->normal, (size_t)s->n_sample * 12, h);
    return prt_hash64(s->face_normal, (size_t)s->n_sample * 12, h);
}

struct ray_store *prt_row_lanes_open(const struct bake *b)
{
    if (!b->o.cache || !b->surface) return NULL;
    return prt_ray_store_open(b->ctx, b->o.cache, "rows", rows_key(b), b->o.cache_room);
}
