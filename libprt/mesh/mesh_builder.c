// SPDX-License-Identifier: MIT
// The mesh builder: growing arrays that a reader fills, and their transfer from the child to
// the parent as one block of memory.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Makes room for `need` items of `size` bytes in *array.
static bool grow(void **array, uint32_t *cap, uint64_t need, size_t size)
{
    if (need <= *cap) return true;
    uint64_t want = *cap ? *cap + (uint64_t)*cap / 2 : 64;
    if (want < need) want = need;
    size_t bytes;
    if (want > UINT32_MAX || prt_mul_overflow((size_t)want, size, &bytes)) return false;
    void *p = realloc(*array, bytes);
    if (!p) return false;
    *array = p;
    *cap = (uint32_t)want;
    return true;
}

static int no_memory(const struct prt_draft *d)
{
    return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory for its geometry", d->name);
}

int prt_draft_vertices(struct prt_draft *d, uint64_t n, uint32_t *first)
{
    if (n > d->max_vertices || d->n_vertex + n > d->max_vertices)
        return prt_fail(d->ctx, PRT_LIMIT, "%s: more than %u vertices", d->name,
                        d->max_vertices);
    if ((d->n_vertex + n) * 32 > d->max_bytes)
        return prt_fail(d->ctx, PRT_LIMIT, "%s: its vertices need more than %llu MB", d->name,
                        (unsigned long long)(d->max_bytes >> 20));
    uint64_t need = d->n_vertex + n;
    *first = d->n_vertex;
    if (!n) return PRT_OK;
    uint32_t a = d->cap_vertex, b = a, c = a;
    bool ok = grow((void **)&d->position, &a, need, sizeof *d->position) &&
              grow((void **)&d->normal, &b, need, sizeof *d->normal) &&
              grow((void **)&d->uv, &c, need, sizeof *d->uv);
    if (!ok) return no_memory(d);
    d->cap_vertex = a;
    memset(d->position + d->n_vertex, 0, n * sizeof *d->position);
    memset(d->normal + d->n_vertex, 0, n * sizeof *d->normal);
    memset(d->uv + d->n_vertex, 0, n * sizeof *d->uv);
    d->n_vertex = (uint32_t)need;
    return PRT_OK;
}

int prt_draft_triangle(struct prt_draft *d, uint32_t a, uint32_t b, uint32_t c)
{
    if (d->n_triangle >= d->max_triangles)
        return prt_fail(d->ctx, PRT_LIMIT, "%s: more than %u triangles", d->name,
                        d->max_triangles);
    if (!grow((void **)&d->triangle, &d->cap_triangle, (uint64_t)d->n_triangle + 1,
              sizeof *d->triangle))
        return no_memory(d);
    uint32_t *t = d->triangle[d->n_triangle++];
    t[0] = a, t[1] = b, t[2] = c;
    return PRT_OK;
}

int prt_draft_block(struct prt_draft *d, struct prt_block block)
{
    if (!grow((void **)&d->block, &d->cap_block, (uint64_t)d->n_block + 1, sizeof *d->block))
        return no_memory(d);
    d->block[d->n_block++] = block;
    return PRT_OK;
}

int prt_draft_surface(struct prt_draft *d, const struct prt_surface *s, uint32_t *index)
{
    if (!grow((void **)&d->surface, &d->cap_surface, (uint64_t)d->n_surface + 1,
              sizeof *d->surface))
        return no_memory(d);
    d->surface[d->n_surface] = *s;
    *index = d->n_surface++;
    return PRT_OK;
}

bool prt_draft_opaque(struct prt_draft *d, const char *name)
{
    bool hit = false;
    if (!name) return false;
    for (int i = 0; d->opaque && d->opaque[i]; i++)
        if (!strcmp(d->opaque[i], name)) {
            hit = true;
            if (i < 64) d->opaque_hit |= 1ull << i;
        }
    return hit;
}

void prt_draft_finish(struct prt_draft *d)
{
    free(d->position);
    free(d->normal);
    free(d->uv);
    free(d->triangle);
    free(d->block);
    free(d->surface);
}

void prt_surface_default(struct prt_surface *s, const char *name)
{
    memset(s, 0, sizeof *s);
    strncpy(s->name, name ? name : "default", sizeof s->name - 1);
    s->translucent = 1;
    for (int i = 0; i < 4; i++) s->base_color[i] = 1;
    s->roughness = 1;
    s->ior = 1.5f;
}

// The block of memory: this header, then the arrays, each at a multiple of 64 bytes.
struct block_header {
    uint64_t magic;
    uint32_t n_vertex, n_triangle, n_block, n_object, n_surface, has_uv, units_known, n_camera;
};
static const uint64_t magic = 0x6873656d74727032;

enum { POSITION, NORMAL, UV, TRIANGLE, WELD, BLOCK, SURFACE, CAMERA, N_PART };
struct layout {
    size_t at[N_PART + 1]; // the last is the total size
};

static struct layout layout_of(const struct block_header *h)
{
    const size_t v = h->n_vertex;
    const size_t size[N_PART] = {v * 12,
                                 v * 12,
                                 h->has_uv ? v * 8 : 0,
                                 (size_t)h->n_triangle * 12,
                                 v * 4,
                                 h->n_block * sizeof(struct prt_block),
                                 h->n_surface * sizeof(struct prt_surface),
                                 h->n_camera * sizeof(struct prt_mesh_camera)};
    struct layout l;
    l.at[0] = 64;
    for (int i = 0; i < N_PART; i++) l.at[i + 1] = (l.at[i] + size[i] + 63) & ~(size_t)63;
    return l;
}

int prt_blob_pack(const struct prt_draft *d, struct prt_blob *out)
{
    struct block_header h = {magic,        d->n_vertex, d->n_triangle,  d->n_block, d->n_object,
                             d->n_surface, d->has_uv,   d->units_known, d->n_camera};
    struct layout l = layout_of(&h);
    char *bytes = l.at[N_PART] <= d->max_bytes ? prt_calloc(l.at[N_PART], 1) : NULL;
    if (!bytes) return no_memory(d);
    memcpy(bytes, &h, sizeof h);
    memcpy(bytes + l.at[POSITION], d->position, (size_t)d->n_vertex * 12);
    memcpy(bytes + l.at[NORMAL], d->normal, (size_t)d->n_vertex * 12);
    if (d->has_uv) memcpy(bytes + l.at[UV], d->uv, (size_t)d->n_vertex * 8);
    memcpy(bytes + l.at[TRIANGLE], d->triangle, (size_t)d->n_triangle * 12);
    memcpy(bytes + l.at[BLOCK], d->block, d->n_block * sizeof *d->block);
    memcpy(bytes + l.at[SURFACE], d->surface, d->n_surface * sizeof *d->surface);
    memcpy(bytes + l.at[CAMERA], d->camera, d->n_camera * sizeof *d->camera);
    *out = (struct prt_blob){bytes, l.at[N_PART]};
    return PRT_OK;
}

static bool finite_within(const float *x, size_t n, float bound)
{
    bool ok = true;
    for (size_t i = 0; i < n; i++) ok &= fabsf(x[i]) <= bound; // false for NaN
    return ok;
}

static bool surfaces_ok(const struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_surface; i++) {
        const struct prt_surface *s = &m->surface[i];
        if (s->name[sizeof s->name - 1] || s->translucent > 1) return false;
        if (!finite_within(s->base_color, 4, 1) || !(s->roughness > 0 && s->roughness <= 1) ||
            !(s->ior >= 1 && s->ior <= 10))
            return false;
    }
    return true;
}

bool prt_mesh_cameras_ok(const struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_camera; i++) {
        const struct prt_mesh_camera *c = &m->camera[i];
        if (!memchr(c->name, 0, sizeof c->name) || !(c->fovy_deg > 0 && c->fovy_deg < 170) ||
            !finite_within(c->eye, 3, 1e15f) || !finite_within(c->target, 3, 1e15f) ||
            !finite_within(c->up, 3, 1e15f))
            return false;
    }
    return m->n_camera <= PRT_MESH_MOST_CAMERAS;
}

// Blocks cover vertices and triangles in order; objects ascend without gaps.
static bool blocks_ok(const struct prt_mesh *m)
{
    uint64_t v = 0, t = 0;
    uint32_t object = 0;
    for (uint32_t i = 0; i < m->n_block; i++) {
        const struct prt_block *b = &m->block[i];
        if (b->vertex_begin != v || b->triangle_begin != t || b->surface >= m->n_surface)
            return false;
        if (b->object != object && (i == 0 || b->object != object + 1)) return false;
        object = b->object;
        v += b->n_vertex;
        t += b->n_triangle;
        if (v > m->n_vertex || t > m->n_triangle) return false;
        for (uint64_t k = b->triangle_begin; k < t; k++)
            for (int c = 0; c < 3; c++)
                if (m->triangle[k][c] - b->vertex_begin >= b->n_vertex) return false;
    }
    return v == m->n_vertex && t == m->n_triangle && m->n_object == object + 1;
}

int prt_blob_open(const struct prt_context *ctx, const char *name, const struct prt_blob *blob,
                  struct prt_mesh **out)
{
    struct block_header h;
    if (!blob->bytes || blob->size < 64)
        return prt_fail(ctx, PRT_FORMAT, "%s: the reader process returned no mesh", name);
    memcpy(&h, blob->bytes, sizeof h);
    struct layout l = layout_of(&h);
    if (h.magic != magic || h.n_vertex >> 30 || h.n_triangle >> 30 || !h.n_triangle ||
        h.n_camera > PRT_MESH_MOST_CAMERAS || l.at[N_PART] != blob->size)
        return prt_fail(ctx, PRT_FORMAT, "%s: the reader process returned a damaged mesh",
                        name);
    struct prt_mesh *m = prt_calloc(1, sizeof *m);
    if (!m) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", name);
    char *b = blob->bytes;
    *m = (struct prt_mesh){.n_vertex = h.n_vertex,
                           .n_triangle = h.n_triangle,
                           .n_block = h.n_block,
                           .n_object = h.n_object,
                           .n_surface = h.n_surface,
                           .units_known = h.units_known != 0,
                           .position = (void *)(b + l.at[POSITION]),
                           .normal = (void *)(b + l.at[NORMAL]),
                           .uv = h.has_uv ? (void *)(b + l.at[UV]) : NULL,
                           .triangle = (void *)(b + l.at[TRIANGLE]),
                           .weld = (void *)(b + l.at[WELD]),
                           .block = (void *)(b + l.at[BLOCK]),
                           .surface = (void *)(b + l.at[SURFACE]),
                           .camera = h.n_camera ? (void *)(b + l.at[CAMERA]) : NULL,
                           .n_camera = h.n_camera};
    bool ok = finite_within(m->position[0], (size_t)m->n_vertex * 3, 1e15f) &&
              finite_within(m->normal[0], (size_t)m->n_vertex * 3, 1.001f) &&
              (!m->uv || finite_within(m->uv[0], (size_t)m->n_vertex * 2, 3e38f)) &&
              surfaces_ok(m) && blocks_ok(m) && prt_mesh_cameras_ok(m);
    if (!ok) {
        prt_free(m);
        return prt_fail(ctx, PRT_FORMAT, "%s: the reader process returned a damaged mesh",
                        name);
    }
    m->owner = blob->bytes;
    *out = m;
    return PRT_OK;
}
