// SPDX-License-Identifier: MIT
// Messages of a model's blocks, media and cameras.
#include "ops/model_messages.h"

#include <stdlib.h>
#include <string.h>

void fill_vec3(Relight__Vec3 *out, const float v[3])
{
    relight__vec3__init(out);
    out->x = v[0];
    out->y = v[1];
    out->z = v[2];
}

struct block_text *fill_blocks(const struct prt_mesh *mesh, const struct prt_media *media,
                               const float (*gain)[3], Relight__Block ***out)
{
    struct block_text *text = calloc(mesh->n_block + 1, sizeof *text);
    *out = calloc(mesh->n_block + 1, sizeof **out);
    for (uint32_t i = 0; text && *out && i < mesh->n_block; i++) {
        const struct prt_block *b = &mesh->block[i];
        const struct prt_surface *s = &mesh->surface[b->surface];
        Relight__Block *to = &text[i].block;
        relight__block__init(to);
        to->object = b->object;
        to->surface = (char *)s->name;
        to->translucent = s->translucent;
        to->vertex_begin = b->vertex_begin;
        to->n_vertex = b->n_vertex;
        to->triangle_begin = b->triangle_begin;
        to->n_triangle = b->n_triangle;
        fill_vec3(&text[i].color, s->base_color);
        to->base_color = &text[i].color;
        to->surface_index = b->surface;
        if (gain && !s->translucent) {
            fill_vec3(&text[i].gain, gain[i]);
            to->gain = &text[i].gain;
        }
        if (s->translucent) to->medium = prt_media_index(media, b->object);
        if (mesh->object) to->node = (char *)mesh->object[b->object].name;
        (*out)[i] = to;
    }
    return text;
}

char **print_media(const struct prt_media *media)
{
    size_t size = media->n * sizeof(char *), at = size;
    char *text = malloc(PRT_MATERIAL_TEXT), *all = text ? malloc(size) : NULL;
    for (uint32_t i = 0; all && i < media->n; i++) {
        prt_material_print(&media->medium[i], text, PRT_MATERIAL_TEXT);
        const size_t n = strlen(text) + 1;
        char *more = realloc(all, size + n);
        if (!more) free(all);
        all = more;
        if (!all) break;
        memcpy(all + size, text, n);
        size += n;
    }
    free(text);
    char **out = (char **)all;
    for (uint32_t i = 0; all && i < media->n; i++) {
        out[i] = all + at;
        at += strlen(out[i]) + 1;
    }
    return out;
}

struct camera_text *fill_cameras(const struct prt_mesh *mesh, Relight__NamedCamera ***out)
{
    struct camera_text *text = calloc(mesh->n_camera + 1, sizeof *text);
    *out = calloc(mesh->n_camera + 1, sizeof **out);
    for (uint32_t i = 0; text && *out && i < mesh->n_camera; i++) {
        const struct prt_mesh_camera *c = &mesh->camera[i];
        struct camera_text *to = &text[i];
        relight__named_camera__init(&to->named);
        relight__camera__init(&to->camera);
        fill_vec3(&to->eye, c->eye);
        fill_vec3(&to->target, c->target);
        fill_vec3(&to->up, c->up);
        to->camera.eye = &to->eye;
        to->camera.target = &to->target;
        to->camera.up = &to->up;
        to->camera.fovy_deg = c->fovy_deg;
        to->named.name = (char *)c->name;
        to->named.camera = &to->camera;
        (*out)[i] = &to->named;
    }
    return text;
}
