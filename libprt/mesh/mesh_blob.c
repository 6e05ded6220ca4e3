// SPDX-License-Identifier: MIT
// The transfer of a mesh from the child that reads it to the parent: one block of memory, which
// the parent checks.
#include "internal.h"

#include <math.h>
#include <string.h>

// The block of memory: this header, then the arrays, each at a multiple of 64 bytes.
struct block_header {
    uint64_t magic;
    uint32_t n_vertex, n_triangle, n_block, n_object, n_surface, has_uv, units_known;
    uint32_t n_uv, has_corner_uv, has_color, has_maps, n_image;
    uint64_t texel_bytes;
    uint32_t n_camera, n_animation, n_variant;
};
enum { HEADER = 128 }; // bytes kept for it
_Static_assert(sizeof(struct block_header) <= HEADER, "header");
static const uint64_t magic = 0x6873656d74727033;

enum {
    POSITION,
    NORMAL,
    UV,
    TRIANGLE,
    WELD,
    BLOCK,
    SURFACE,
    OBJECT,
    UV_MORE,
    CORNER_UV,
    COLOR,
    MAPS,
    VOLUME,
    IMAGE,
    TEXEL,
    CAMERA,
    ANIMATION,
    VARIANT,
    VARIANT_SURFACE,
    N_PART
};
struct layout {
    size_t at[N_PART + 1]; // the last is the total size
};

static struct layout layout_of(const struct block_header *h)
{
    const size_t v = h->n_vertex;
    const size_t size[N_PART] = {
        v * 12,
        v * 12,
        h->has_uv ? v * 8 : 0,
        (size_t)h->n_triangle * 12,
        v * 4,
        h->n_block * sizeof(struct prt_block),
        h->n_surface * sizeof(struct prt_surface),
        h->n_object * sizeof(struct prt_object),
        h->n_uv > 1 ? (h->n_uv - 1) * v * 8 : 0,
        h->has_corner_uv ? (size_t)h->n_triangle * 24 : 0,
        h->has_color ? v * 16 : 0,
        h->has_maps & 1 ? h->n_surface * sizeof(struct prt_surface_maps) : 0,
        h->has_maps & 2 ? h->n_surface * sizeof(struct prt_volume) : 0,
        h->n_image * sizeof(struct prt_texture_image),
        h->texel_bytes,
        h->n_camera * sizeof(struct prt_mesh_camera),
        h->n_animation * sizeof(struct prt_mesh_animation),
        h->n_variant * sizeof(struct prt_mesh_variant),
        h->n_variant ? sizeof(uint32_t) * h->n_block * (h->n_variant + 1) : 0};
    struct layout l;
    l.at[0] = HEADER;
    for (int i = 0; i < N_PART; i++) l.at[i + 1] = (l.at[i] + size[i] + 63) & ~(size_t)63;
    return l;
}

static void pack_textures(const struct prt_draft *d, const struct layout *l, char *bytes)
{
    size_t set = (size_t)d->n_vertex * 8;
    for (uint32_t k = 0; k + 1 < d->n_uv; k++)
        memcpy(bytes + l->at[UV_MORE] + k * set, d->uv_more[k], set);
    if (d->corner_uv)
        memcpy(bytes + l->at[CORNER_UV], d->corner_uv, (size_t)d->n_triangle * 24);
    if (d->has_color) memcpy(bytes + l->at[COLOR], d->color, (size_t)d->n_vertex * 16);
    struct prt_surface_maps *maps = (void *)(bytes + l->at[MAPS]);
    for (uint32_t i = 0; d->has_maps && i < d->n_surface; i++) {
        if (i < d->cap_maps) maps[i] = d->maps[i];
        else prt_surface_maps_default(&maps[i]);
    }
    uint32_t n_volume = d->n_surface < d->cap_volume ? d->n_surface : d->cap_volume;
    if (d->volume) // the others stay 0: none
        memcpy(bytes + l->at[VOLUME], d->volume, n_volume * sizeof *d->volume);
    struct prt_texture_image *image = (void *)(bytes + l->at[IMAGE]);
    uint64_t at = 0;
    for (uint32_t i = 0; i < d->n_image; i++) {
        image[i] = d->image[i];
        image[i].begin = at;
        memcpy(bytes + l->at[TEXEL] + at, d->texel[i], (size_t)image[i].bytes);
        at += image[i].bytes;
    }
}

int prt_blob_pack(const struct prt_draft *d, struct prt_blob *out)
{
    struct block_header h = {.magic = magic,
                             .n_vertex = d->n_vertex,
                             .n_triangle = d->n_triangle,
                             .n_block = d->n_block,
                             .n_object = d->n_object,
                             .n_surface = d->n_surface,
                             .has_uv = d->has_uv,
                             .units_known = d->units_known,
                             .n_uv = d->n_uv,
                             .has_corner_uv = d->corner_uv != NULL,
                             .has_color = d->has_color,
                             .has_maps = (d->has_maps ? 1u : 0) | (d->volume ? 2u : 0),
                             .n_image = d->n_image,
                             .texel_bytes = d->texel_bytes,
                             .n_camera = d->n_camera,
                             .n_animation = d->n_animation,
                             .n_variant = d->n_variant};
    struct layout l = layout_of(&h);
    char *bytes = l.at[N_PART] <= d->max_bytes ? prt_calloc(l.at[N_PART], 1) : NULL;
    if (!bytes) return prt_fail(d->ctx, PRT_NOMEM, "%s: no memory for its geometry", d->name);
    memcpy(bytes, &h, sizeof h);
    memcpy(bytes + l.at[POSITION], d->position, (size_t)d->n_vertex * 12);
    memcpy(bytes + l.at[NORMAL], d->normal, (size_t)d->n_vertex * 12);
    if (d->has_uv) memcpy(bytes + l.at[UV], d->uv, (size_t)d->n_vertex * 8);
    memcpy(bytes + l.at[TRIANGLE], d->triangle, (size_t)d->n_triangle * 12);
    memcpy(bytes + l.at[BLOCK], d->block, d->n_block * sizeof *d->block);
    memcpy(bytes + l.at[SURFACE], d->surface, d->n_surface * sizeof *d->surface);
    memcpy(bytes + l.at[OBJECT], d->object, d->n_object * sizeof *d->object);
    memcpy(bytes + l.at[CAMERA], d->camera, d->n_camera * sizeof *d->camera);
    memcpy(bytes + l.at[ANIMATION], d->animations, d->n_animation * sizeof *d->animations);
    memcpy(bytes + l.at[VARIANT], d->variants, d->n_variant * sizeof *d->variants);
    if (d->n_variant)
        memcpy(bytes + l.at[VARIANT_SURFACE], d->variant_surface,
               sizeof *d->variant_surface * d->n_block * (d->n_variant + 1));
    pack_textures(d, &l, bytes);
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
    for (uint32_t i = 0; m->object && i < m->n_object; i++)
        if (!memchr(m->object[i].name, 0, sizeof m->object[i].name)) return false;
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

static bool animations_ok(const struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_animation; i++)
        if (!memchr(m->animation[i].name, 0, sizeof m->animation[i].name) ||
            !(m->animation[i].duration_s >= 0 && m->animation[i].duration_s <= 1e9f))
            return false;
    return true;
}

bool prt_mesh_variants_ok(const struct prt_mesh *m)
{
    for (uint32_t i = 0; i < m->n_variant; i++)
        if (!memchr(m->variant[i].name, 0, sizeof m->variant[i].name)) return false;
    const uint64_t n = m->n_variant ? (uint64_t)m->n_block * (m->n_variant + 1) : 0;
    for (uint64_t i = 0; i < n; i++)
        if (m->variant_surface[i] >= m->n_surface) return false;
    return m->n_variant <= PRT_MESH_MOST_VARIANTS;
}

bool prt_mesh_volumes_ok(const struct prt_mesh *m)
{
    for (uint32_t i = 0; m->volume && i < m->n_surface; i++) {
        const struct prt_volume *v = &m->volume[i];
        if (v->kind > PRT_VOLUME_SCATTER || !(v->distance >= 0 && v->distance <= 1e9f) ||
            !finite_within(v->color, 3, 1) || !finite_within(v->albedo, 3, 1) ||
            !(fabsf(v->g) <= 0.951f))
            return false;
    }
    return true;
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

static void open_textures(struct prt_mesh *m, const struct block_header *h,
                          const struct layout *l, char *b)
{
    m->n_uv = h->n_uv;
    m->n_image = h->n_image;
    m->texel_bytes = h->texel_bytes;
    if (h->n_uv > 1) m->uv_more = (void *)(b + l->at[UV_MORE]);
    if (h->has_corner_uv) m->corner_uv = (void *)(b + l->at[CORNER_UV]);
    if (h->has_color) m->color = (void *)(b + l->at[COLOR]);
    if (h->has_maps & 2) m->volume = (void *)(b + l->at[VOLUME]);
    if (h->has_maps & 1) m->maps = (void *)(b + l->at[MAPS]);
    if (h->n_image) m->image = (void *)(b + l->at[IMAGE]);
    if (h->texel_bytes) m->texel = (void *)(b + l->at[TEXEL]);
}

static bool textures_ok(const struct prt_mesh *m)
{
    bool ok = true;
    if (m->n_uv > 1)
        ok &= finite_within(m->uv_more[0], 2ull * (m->n_uv - 1) * m->n_vertex, 3e38f);
    if (m->corner_uv) ok &= finite_within(&m->corner_uv[0][0][0], 6ull * m->n_triangle, 3e38f);
    if (m->color) ok &= finite_within(m->color[0], 4ull * m->n_vertex, 1);
    for (uint32_t i = 0; i < m->n_image; i++)
        ok &= prt_texture_image_valid(&m->image[i], m->texel_bytes);
    for (uint32_t i = 0; m->maps && i < m->n_surface; i++)
        ok &= prt_surface_maps_valid(&m->maps[i], m->n_image, PRT_TEXTURE_MAX_UV);
    return ok;
}

int prt_blob_open(const struct prt_context *ctx, const char *name, const struct prt_blob *blob,
                  struct prt_mesh **out)
{
    struct block_header h;
    if (!blob->bytes || blob->size < HEADER)
        return prt_fail(ctx, PRT_FORMAT, "%s: the reader process returned no mesh", name);
    memcpy(&h, blob->bytes, sizeof h);
    struct layout l = layout_of(&h);
    if (h.magic != magic || h.n_vertex >> 30 || h.n_triangle >> 30 || !h.n_triangle ||
        h.n_uv > PRT_TEXTURE_MAX_UV || h.n_image >> 20 || h.texel_bytes > blob->size ||
        h.n_camera > PRT_MESH_MOST_CAMERAS || h.n_animation > PRT_MESH_MOST_ANIMATIONS ||
        h.n_variant > PRT_MESH_MOST_VARIANTS || l.at[N_PART] != blob->size)
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
                           .object = h.n_object ? (void *)(b + l.at[OBJECT]) : NULL,
                           .camera = h.n_camera ? (void *)(b + l.at[CAMERA]) : NULL,
                           .n_camera = h.n_camera,
                           .animation = h.n_animation ? (void *)(b + l.at[ANIMATION]) : NULL,
                           .n_animation = h.n_animation,
                           .variant = h.n_variant ? (void *)(b + l.at[VARIANT]) : NULL,
                           .variant_surface =
                               h.n_variant ? (void *)(b + l.at[VARIANT_SURFACE]) : NULL,
                           .n_variant = h.n_variant};
    open_textures(m, &h, &l, b);
    bool ok = finite_within(m->position[0], (size_t)m->n_vertex * 3, 1e15f) &&
              finite_within(m->normal[0], (size_t)m->n_vertex * 3, 1.001f) &&
              (!m->uv || finite_within(m->uv[0], (size_t)m->n_vertex * 2, 3e38f)) &&
              surfaces_ok(m) && blocks_ok(m) && textures_ok(m) && prt_mesh_cameras_ok(m) &&
              animations_ok(m) && prt_mesh_variants_ok(m) && prt_mesh_volumes_ok(m);
    if (!ok) {
        prt_free(m);
        return prt_fail(ctx, PRT_FORMAT, "%s: the reader process returned a damaged mesh",
                        name);
    }
    m->owner = blob->bytes;
    *out = m;
    return PRT_OK;
}
