// SPDX-License-Identifier: MIT
// Textures in answers to GEOMETRY. Texels are copied on a worker.
#include "ops/geometry_textures.h"

#include "net/request_wait.h"
#include "relight.pb-c.h"
#include "render/evaluation.h"
#include "render/shared/geometry.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#define MESSAGE(type) ((const Relight__##type *)request->message)

static size_t place(size_t *size, size_t bytes)
{
    size_t at = (*size + 63) / 64 * 64;
    *size = at + bytes;
    return at;
}

static uint32_t n_uv(const struct prt_mesh *mesh)
{
    return !mesh->uv ? 0 : mesh->n_uv ? mesh->n_uv : 1;
}

size_t texture_sections_plan(const struct prt_mesh *mesh, size_t size,
                             struct texture_sections *out)
{
    memset(out, 0, sizeof *out);
    if (n_uv(mesh)) out->uv = place(&size, 8 * (size_t)n_uv(mesh) * mesh->n_vertex);
    if (mesh->corner_uv) out->corner_uv = place(&size, 24 * (size_t)mesh->n_triangle);
    if (mesh->color) out->color = place(&size, 16 * (size_t)mesh->n_vertex);
    if (mesh->blocked)
        out->blocked = place(&size, sizeof *mesh->blocked * (size_t)mesh->n_vertex);
    return size;
}

void texture_sections_copy(const struct prt_mesh *mesh, const struct texture_sections *at,
                           char *payload)
{
    size_t set = 8 * (size_t)mesh->n_vertex;
    if (at->uv) memcpy(payload + at->uv, mesh->uv, set);
    if (at->uv && n_uv(mesh) > 1)
        memcpy(payload + at->uv + set, mesh->uv_more, set * (n_uv(mesh) - 1));
    if (at->corner_uv)
        memcpy(payload + at->corner_uv, mesh->corner_uv, 24 * (size_t)mesh->n_triangle);
    if (at->color) memcpy(payload + at->color, mesh->color, 16 * (size_t)mesh->n_vertex);
    if (at->blocked)
        memcpy(payload + at->blocked, mesh->blocked,
               sizeof *mesh->blocked * (size_t)mesh->n_vertex);
}

enum { HASH = 32 };

struct surface_text {
    Relight__Surface surface;
    Relight__Vec3 emissive;
    Relight__TextureMap map[PRT_N_MAP];
    float base[4], transform[PRT_N_MAP][6];
};
struct image_text {
    Relight__TextureImage image;
    char hash[HASH + 1];
};

static void hash_text(const struct prt_texture_image *image, char out[HASH + 1])
{
    snprintf(out, HASH + 1, "%016llx%016llx", (unsigned long long)image->hash[1],
             (unsigned long long)image->hash[0]);
}

static void fill_map(const struct prt_texture_ref *ref, Relight__TextureMap *map,
                     float transform[6])
{
    relight__texture_map__init(map);
    memcpy(transform, ref->transform, sizeof ref->transform);
    map->image = ref->image;
    map->uv_set = ref->uv_set;
    map->wrap_u = ref->wrap_u;
    map->wrap_v = ref->wrap_v;
    map->filter = ref->filter;
    map->scale = ref->scale;
    map->n_transform = 6;
    map->transform = transform;
}

static void fill_surface(const struct prt_mesh *mesh, uint32_t i, struct surface_text *to)
{
    const struct prt_surface *s = &mesh->surface[i];
    Relight__Surface *out = &to->surface;
    Relight__TextureMap **field[PRT_N_MAP] = {&out->base_map, &out->normal_map,
                                              &out->roughness_map, &out->occlusion_map,
                                              &out->emissive_map};
    relight__surface__init(out);
    out->name = (char *)s->name;
    memcpy(to->base, s->base_color, sizeof to->base);
    out->base_color = to->base;
    out->n_base_color = 4;
    out->roughness = s->roughness;
    if (!mesh->maps) return;
    const struct prt_surface_maps *maps = &mesh->maps[i];
    out->metallic = maps->metallic;
    relight__vec3__init(&to->emissive);
    to->emissive.x = maps->emissive[0];
    to->emissive.y = maps->emissive[1];
    to->emissive.z = maps->emissive[2];
    out->emissive = &to->emissive;
    for (int k = 0; k < PRT_N_MAP; k++) {
        if (maps->map[k].image == UINT32_MAX) continue;
        fill_map(&maps->map[k], &to->map[k], to->transform[k]);
        *field[k] = &to->map[k];
    }
}

void *texture_answer(const struct prt_mesh *mesh, const struct texture_sections *at,
                     Relight__GeometryAnswer *out)
{
    size_t pointers = ((size_t)mesh->n_surface + mesh->n_image) * sizeof(void *);
    size_t surfaces = mesh->n_surface * sizeof(struct surface_text);
    char *memory =
        calloc(1, pointers + surfaces + mesh->n_image * sizeof(struct image_text) + 1);
    if (!memory) return NULL;
    out->surfaces = (Relight__Surface **)memory;
    out->images = (Relight__TextureImage **)(memory + mesh->n_surface * sizeof(void *));
    struct surface_text *surface = (struct surface_text *)(memory + pointers);
    struct image_text *image = (struct image_text *)(memory + pointers + surfaces);
    for (uint32_t i = 0; i < mesh->n_surface; i++) {
        fill_surface(mesh, i, &surface[i]);
        out->surfaces[i] = &surface[i].surface;
    }
    for (uint32_t i = 0; i < mesh->n_image; i++) {
        relight__texture_image__init(&image[i].image);
        hash_text(&mesh->image[i], image[i].hash);
        image[i].image.hash = image[i].hash;
        image[i].image.width = mesh->image[i].width;
        image[i].image.height = mesh->image[i].height;
        image[i].image.kind = (Relight__TextureKind)mesh->image[i].kind;
        image[i].image.bytes = mesh->image[i].bytes;
        out->images[i] = &image[i].image;
    }
    out->n_surfaces = mesh->n_surface;
    out->n_images = mesh->n_image;
    out->n_uv = n_uv(mesh);
    out->uv_offset = at->uv;
    out->corner_uv_offset = at->corner_uv;
    out->color_offset = at->color;
    out->texture_split = mesh->texture_split;
    out->blocked_offset = at->blocked;
    return memory;
}

struct image_wait {
    struct request_wait wait;
    struct cache_entry *shape;
    uint32_t image;
    char *bytes;
};

static const struct prt_mesh *mesh_of(const struct cache_entry *shape)
{
    return &((struct shape *)shape->value)->mesh;
}

static int copy_image(struct work *work, const struct prt_context *ctx)
{
    struct image_wait *w = (struct image_wait *)work;
    const struct prt_mesh *mesh = mesh_of(w->shape);
    const struct prt_texture_image *image = &mesh->image[w->image];
    w->bytes = prt_alloc((size_t)image->bytes, 1);
    if (!w->bytes) return PRT_NOMEM;
    memcpy(w->bytes, mesh->texel + image->begin, (size_t)image->bytes);
    return PRT_OK;
}

// What an answer with one image tells of it.
struct image_answer {
    Relight__GeometryAnswer answer;
    Relight__TextureImage *list[1];
    struct image_text text;
};

static void describe_image(const struct prt_texture_image *image, struct image_answer *out)
{
    relight__geometry_answer__init(&out->answer);
    relight__texture_image__init(&out->text.image);
    hash_text(image, out->text.hash);
    out->text.image.hash = out->text.hash;
    out->text.image.width = image->width;
    out->text.image.height = image->height;
    out->text.image.kind = (Relight__TextureKind)image->kind;
    out->text.image.bytes = image->bytes;
    out->list[0] = &out->text.image;
    out->answer.images = out->list;
    out->answer.n_images = 1;
}

static void image_copied(struct request_wait *wait, struct request *request)
{
    struct image_wait *w = (struct image_wait *)wait;
    const struct prt_texture_image *image = &mesh_of(w->shape)->image[w->image];
    if (request && wait->work.status) {
        request_fail(request, error_of_status(wait->work.status), "%s", wait->work.error);
    } else if (request) {
        struct image_answer out;
        struct payload payload = {w->bytes, (size_t)image->bytes, w->bytes, prt_free};
        describe_image(image, &out);
        w->bytes = NULL;
        request_answer(request, &out.answer.base, &payload);
    }
    prt_free(w->bytes);
    cache_release(w->shape);
    free(w);
}

static void release_entry(void *entry)
{
    cache_release(entry);
}

static void files_made(struct request_wait *wait, struct request *request)
{
    struct image_wait *w = (struct image_wait *)wait;
    struct cache_entry *entry = wait->entry;
    if (request && entry->state == CACHE_READY) {
        struct image_answer out;
        struct texture_files *f = entry->value;
        struct payload payload = {f->bytes, f->size, entry, release_entry};
        describe_image(&mesh_of(w->shape)->image[w->image], &out);
        out.text.image.n_png_bytes = f->n_level;
        out.text.image.png_bytes = f->level;
        cache_hold(entry);
        request_answer(request, &out.answer.base, &payload);
    } else if (request) {
        request_fail(request, entry->error_code, "%s", entry->error);
    }
    cache_release(entry);
    cache_release(w->shape);
    free(w);
}

static void image_ready(struct request *request, struct model *m, struct cache_entry *shape)
{
    const char *want = MESSAGE(GeometryRequest)->image;
    const struct prt_mesh *mesh = mesh_of(shape);
    char hash[HASH + 1] = "";
    uint32_t i = 0;
    for (; i < mesh->n_image; i++) {
        hash_text(&mesh->image[i], hash);
        if (!strcmp(hash, want)) break;
    }
    if (i == mesh->n_image) {
        request_fail(
            request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
            "geometry.image %.32s: the model has no such image; GEOMETRY with textures "
            "lists them",
            want);
        return;
    }
    struct image_wait *w = calloc(1, sizeof *w);
    if (!w) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    w->shape = shape;
    w->image = i;
    cache_hold(shape);
    if (MESSAGE(GeometryRequest)->png)
        request_await_entry(request, &w->wait, texture_files_get(m, shape, i), files_made);
    else request_await_work(request, &w->wait, copy_image, image_copied);
}

void op_geometry_image(struct request *request)
{
    with_shape(request, MESSAGE(GeometryRequest)->model, "", "", image_ready);
}
