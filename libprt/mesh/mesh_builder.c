// SPDX-License-Identifier: MIT
// The mesh builder: growing arrays that a reader fills.
#include "internal.h"

#include <math.h>
#include <stdio.h>
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

// Further TEXCOORD sets and colours, 0 and white until they are read.
static bool grow_attributes(struct prt_draft *d, uint64_t need)
{
    for (uint32_t k = 0; k + 1 < d->n_uv; k++) {
        uint32_t cap = d->cap_vertex;
        if (!grow((void **)&d->uv_more[k], &cap, need, sizeof *d->uv_more[k])) return false;
        memset(d->uv_more[k] + d->n_vertex, 0, (need - d->n_vertex) * sizeof *d->uv_more[k]);
    }
    uint32_t cap = d->cap_vertex;
    if (!d->has_color) return true;
    if (!grow((void **)&d->color, &cap, need, sizeof *d->color)) return false;
    for (uint64_t v = d->n_vertex; v < need; v++)
        for (int c = 0; c < 4; c++) d->color[v][c] = 1;
    return true;
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
              grow((void **)&d->uv, &c, need, sizeof *d->uv) && grow_attributes(d, need);
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

uint32_t *prt_draft_variant_row(struct prt_draft *d)
{
    const uint64_t width = d->n_variant + 1ull, end = width * d->n_block;
    if (!grow((void **)&d->variant_surface, &d->cap_variant_surface, end,
              sizeof *d->variant_surface))
        return NULL;
    return d->variant_surface + (end - width);
}

int prt_draft_object(struct prt_draft *d, const char *name)
{
    if (!grow((void **)&d->object, &d->cap_object, (uint64_t)d->n_object + 1,
              sizeof *d->object))
        return no_memory(d);
    struct prt_object *object = &d->object[d->n_object++];
    *object = (struct prt_object){{0}};
    if (name) snprintf(object->name, sizeof object->name, "%.63s", name);
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

static void flip(float (*uv)[2], size_t n)
{
    for (size_t i = 0; i < n; i++) uv[i][1] = 1 - uv[i][1];
}

// A transform of the file's uv as one of the flipped uv, so that its result is flipped.
static void flip_transform(float t[6])
{
    t[2] += t[1];
    t[1] = -t[1];
    t[5] = 1 - t[4] - t[5];
    t[3] = -t[3];
}

void prt_draft_flip_v(struct prt_draft *d)
{
    if (d->has_uv) flip(d->uv, d->n_vertex);
    for (uint32_t k = 0; k + 1 < d->n_uv; k++) flip(d->uv_more[k], d->n_vertex);
    if (d->corner_uv) flip(*d->corner_uv, 3 * (size_t)d->n_triangle);
    for (uint32_t i = 0; i < d->cap_maps; i++)
        for (int k = 0; k < PRT_N_MAP; k++) flip_transform(d->maps[i].map[k].transform);
}

void prt_draft_finish(struct prt_draft *d)
{
    free(d->position);
    free(d->normal);
    free(d->uv);
    free(d->triangle);
    free(d->block);
    free(d->surface);
    free(d->object);
    for (int k = 0; k < PRT_TEXTURE_MAX_UV - 1; k++) free(d->uv_more[k]);
    free(d->color);
    free(d->corner_uv);
    free(d->maps);
    free(d->volume);
    free(d->variant_surface);
    for (uint32_t i = 0; i < d->n_image; i++) prt_free(d->texel[i]);
    free(d->texel);
    free(d->image);
}

struct prt_surface_maps *prt_draft_maps(struct prt_draft *d, uint32_t surface)
{
    uint32_t before = d->cap_maps;
    if (!grow((void **)&d->maps, &d->cap_maps, (uint64_t)surface + 1, sizeof *d->maps))
        return NULL;
    for (uint32_t i = before; i < d->cap_maps; i++) prt_surface_maps_default(&d->maps[i]);
    d->has_maps = true;
    return &d->maps[surface];
}

struct prt_volume *prt_draft_volume(struct prt_draft *d, uint32_t surface)
{
    uint32_t before = d->cap_volume;
    if (!grow((void **)&d->volume, &d->cap_volume, (uint64_t)surface + 1, sizeof *d->volume))
        return NULL;
    memset(d->volume + before, 0, (d->cap_volume - before) * sizeof *d->volume);
    return &d->volume[surface];
}

// The reason that an image is not read is a warning: the model is drawn without it.
static void as_warning(void *user, enum prt_log_level level, const char *line)
{
    const struct prt_context **ctx = user;
    prt_log(*ctx, PRT_LOG_WARNING, "%s; it is left out", line);
}

struct prt_context prt_draft_lenient(const struct prt_draft *d, const struct prt_context **user)
{
    struct prt_context ctx = {0};
    if (d->ctx) ctx = *d->ctx;
    *user = d->ctx;
    ctx.log = as_warning;
    ctx.log_user = user;
    return ctx;
}

static const uint64_t most_texels = 2ull << 30; // bytes of one model; chosen, not measured

int prt_draft_image(struct prt_draft *d, const char *name, const void *bytes, size_t n,
                    enum prt_texture_kind kind, uint32_t *index)
{
    uint64_t limit = d->max_bytes / 4 < most_texels ? d->max_bytes / 4 : most_texels;
    const struct prt_context *own;
    const struct prt_context lenient = prt_draft_lenient(d, &own);
    uint32_t width, height, cap = d->cap_image;
    uint8_t *texel;
    *index = UINT32_MAX;
    if (prt_texture_decode(&lenient, name, bytes, n, limit - d->texel_bytes, &width, &height,
                           &texel))
        return PRT_OK;
    if (!grow((void **)&d->image, &cap, d->n_image + 1ull, sizeof *d->image) ||
        !grow((void **)&d->texel, &d->cap_texel, d->n_image + 1ull, sizeof *d->texel)) {
        prt_free(texel);
        return no_memory(d);
    }
    d->cap_image = cap;
    d->texel[d->n_image] = texel;
    prt_texture_finish_levels(width, height, kind, texel, &d->image[d->n_image]);
    for (uint32_t i = 0; i < d->n_image; i++) {
        if (memcmp(d->image[i].hash, d->image[d->n_image].hash, sizeof d->image[i].hash))
            continue;
        prt_free(texel); // the same content is kept once
        *index = i;
        return PRT_OK;
    }
    d->texel_bytes += d->image[d->n_image].bytes;
    *index = d->n_image++;
    return PRT_OK;
}

void prt_surface_default(struct prt_surface *s, const char *name)
{
    memset(s, 0, sizeof *s);
    strncpy(s->name, name ? name : PRT_UNNAMED_SURFACE, sizeof s->name - 1);
    s->translucent = 1;
    for (int i = 0; i < 4; i++) s->base_color[i] = 1;
    s->roughness = 1;
    s->ior = 1.5f;
}
