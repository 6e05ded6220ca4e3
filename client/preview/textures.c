// SPDX-License-Identifier: MIT
// Textures of the model: the daemon's answer as maps and images of the raster room's mesh. Each
// number is checked, since the raster room trusts its mesh.
#include "preview.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static int fail(const char *text)
{
    fprintf(stderr, "relight-preview: %s\n", text);
    return EXIT_FAILED;
}

static void put_map(const struct relight_map *from, struct prt_texture_ref *to)
{
    if (!from->present) return;
    to->image = from->image;
    to->uv_set = (uint8_t)(from->uv_set < 255 ? from->uv_set : 255);
    to->wrap_u = (uint8_t)(from->wrap_u < 255 ? from->wrap_u : 255);
    to->wrap_v = (uint8_t)(from->wrap_v < 255 ? from->wrap_v : 255);
    to->filter = (uint8_t)(from->filter < 255 ? from->filter : 255);
    to->scale = from->scale;
    memcpy(to->transform, from->transform, sizeof to->transform);
}

// The maps of each block's surface.
static bool put_maps(struct scene *scene)
{
    const struct relight_geometry *g = &scene->geometry;
    struct prt_mesh *m = &scene->mesh;
    bool any = false;
    m->maps = prt_calloc(m->n_surface, sizeof *m->maps);
    if (!m->maps) return false;
    for (uint32_t i = 0; i < m->n_surface; i++) {
        const uint32_t at = g->block[i].surface_index;
        struct prt_surface_maps *maps = &m->maps[i];
        prt_surface_maps_default(maps);
        if (at >= g->n_look) return false;
        const struct relight_look *look = &g->look[at];
        const struct relight_map *map[PRT_N_MAP] = {&look->base, &look->normal,
                                                    &look->metallic_roughness, &look->occlusion,
                                                    &look->emission};
        for (int k = 0; k < PRT_N_MAP; k++) {
            put_map(map[k], &maps->map[k]);
            any |= map[k]->present;
        }
        memcpy(maps->emissive, look->emissive, sizeof maps->emissive);
        for (int c = 0; c < 3; c++) any |= look->emissive[c] > 0;
        maps->metallic = look->metallic;
        struct prt_surface *s = &m->surface[i];
        for (int c = 0; c < 4; c++)
            if (s->translucent) s->base_color[c] = look->base_color[c];
        s->roughness = look->roughness;
        if (!prt_surface_maps_valid(maps, m->n_image, PRT_TEXTURE_MAX_UV)) return false;
    }
    if (!any) {
        prt_free(m->maps);
        m->maps = NULL;
    }
    return true;
}

static int fetch_images(struct scene *scene)
{
    const struct relight_geometry *g = &scene->geometry;
    struct prt_mesh *m = &scene->mesh;
    uint64_t total = 0;
    for (size_t i = 0; i < g->n_image; i++) {
        const struct relight_image_info *from = &g->image[i];
        struct prt_texture_image *to = &m->image[i];
        *to = (struct prt_texture_image){.width = from->width,
                                         .height = from->height,
                                         .kind = (uint32_t)from->kind,
                                         .n_level = 0,
                                         .begin = total,
                                         .bytes = from->bytes};
        if (!from->width || !from->height || from->width > PRT_TEXTURE_MAX_SIDE ||
            from->height > PRT_TEXTURE_MAX_SIDE)
            return fail("an image of the model has an impossible size");
        to->n_level = prt_texture_levels(from->width, from->height);
        total += from->bytes;
        if (total > 4ull << 30 || !prt_texture_image_valid(to, total))
            return fail("an image of the model has an impossible size");
    }
    m->texel = prt_alloc((size_t)total + 1, 1);
    m->texel_bytes = total;
    if (!m->texel) return fail("not enough memory for the model's images");
    for (size_t i = 0; i < g->n_image; i++) {
        struct relight_error error;
        uint8_t *texels = NULL;
        if (relight_texture(scene->client, scene->options->model, &g->image[i], &texels,
                            &error))
            return report(&error);
        memcpy(m->texel + m->image[i].begin, texels, (size_t)m->image[i].bytes);
        free(texels);
    }
    return EXIT_DONE;
}

static bool all_finite(const float *x, uint64_t n)
{
    bool good = true;
    for (uint64_t i = 0; i < n; i++) good &= fabsf(x[i]) < 1e30f;
    return good;
}

int scene_textures(struct scene *scene)
{
    const struct relight_geometry *g = &scene->geometry;
    struct prt_mesh *m = &scene->mesh;
    const size_t set = 8 * (size_t)m->n_vertex;
    m->n_image = (uint32_t)g->n_image;
    m->image = prt_calloc(g->n_image + 1, sizeof *m->image);
    if (!m->image || !put_maps(scene)) return fail("the model's surfaces are damaged");
    if (g->uv && !all_finite(g->uv[0], 2ull * g->n_uv * m->n_vertex))
        return fail("the model's texture coordinates are not finite");
    // the arrays stay in the answer: the raster room does not write to them
    m->n_uv = g->n_uv;
    m->uv = (float(*)[2])(uintptr_t)g->uv;
    if (g->n_uv > 1) m->uv_more = (float(*)[2])((uintptr_t)g->uv + set);
    m->corner_uv = (float(*)[3][2])(uintptr_t)g->corner_uv;
    m->color = (float(*)[4])(uintptr_t)g->color;
    m->blocked = (int8_t(*)[16])(uintptr_t)g->blocked;
    m->texture_split = g->texture_split >= 0 && g->texture_split <= 1 ? g->texture_split : 0;
    return fetch_images(scene);
}

void scene_textures_finish(struct scene *scene)
{
    prt_free(scene->mesh.maps);
    prt_free(scene->mesh.image);
    prt_free(scene->mesh.texel);
}
