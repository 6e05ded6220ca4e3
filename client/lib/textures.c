// SPDX-License-Identifier: MIT
// Textures of a model: what GEOMETRY tells of them, and texels by their hash.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static bool section_fits(uint64_t offset, uint64_t n, uint64_t bytes, uint64_t payload_size)
{
    return offset % RELIGHT_FRAME_ALIGN == 0 && offset <= payload_size &&
           n <= (payload_size - offset) / bytes;
}

bool relight_textures_fit(const Relight__GeometryAnswer *a, const struct answer *answer)
{
    const uint64_t size = answer->payload_size, n = a->n_vertex;
    if (a->n_uv > 8 || (a->n_uv && !a->uv_offset)) return false;
    return section_fits(a->uv_offset, n * a->n_uv, 8, size) &&
           section_fits(a->color_offset, a->color_offset ? n : 0, 16, size) &&
           section_fits(a->blocked_offset, a->blocked_offset ? n : 0, 16, size) &&
           section_fits(a->corner_uv_offset, a->corner_uv_offset ? a->n_triangle : 0, 24, size);
}

static void get_map(const Relight__TextureMap *m, struct relight_map *out)
{
    if (!m || m->n_transform != 6) return;
    *out = (struct relight_map){.present = true,
                                .image = m->image,
                                .uv_set = m->uv_set,
                                .wrap_u = m->wrap_u,
                                .wrap_v = m->wrap_v,
                                .filter = m->filter,
                                .scale = m->scale};
    memcpy(out->transform, m->transform, sizeof out->transform);
}

static void get_look(const Relight__Surface *s, struct relight_look *out)
{
    for (int c = 0; c < 4; c++)
        out->base_color[c] = s->n_base_color == 4 ? s->base_color[c] : 1;
    out->roughness = s->roughness;
    out->metallic = s->metallic;
    if (s->emissive) {
        out->emissive[0] = s->emissive->x;
        out->emissive[1] = s->emissive->y;
        out->emissive[2] = s->emissive->z;
    }
    get_map(s->base_map, &out->base);
    get_map(s->normal_map, &out->normal);
    get_map(s->roughness_map, &out->metallic_roughness);
    get_map(s->occlusion_map, &out->occlusion);
    get_map(s->emissive_map, &out->emission);
}

bool relight_get_textures(struct owner *owner, const struct answer *answer,
                          struct relight_geometry *out)
{
    const Relight__GeometryAnswer *a = (const Relight__GeometryAnswer *)answer->message;
    const uint8_t *p = answer->payload;
    struct relight_look *look = relight_owner_alloc(owner, a->n_surfaces, sizeof *look);
    struct relight_image_info *image = relight_owner_alloc(owner, a->n_images, sizeof *image);
    if (!look || !image) return false;
    for (size_t i = 0; i < a->n_surfaces; i++) get_look(a->surfaces[i], look + i);
    for (size_t i = 0; i < a->n_images; i++)
        image[i] = (struct relight_image_info){
            .hash = a->images[i]->hash,
            .width = a->images[i]->width,
            .height = a->images[i]->height,
            .kind = (enum relight_texture_kind)a->images[i]->kind,
            .bytes = a->images[i]->bytes,
        };
    out->n_uv = a->n_uv;
    if (a->n_uv) out->uv = (const float(*)[2])(p + a->uv_offset);
    if (a->corner_uv_offset) out->corner_uv = (const float(*)[3][2])(p + a->corner_uv_offset);
    if (a->color_offset) out->color = (const float(*)[4])(p + a->color_offset);
    if (a->blocked_offset) out->blocked = (const int8_t(*)[16])(p + a->blocked_offset);
    out->n_look = a->n_surfaces;
    out->look = look;
    out->n_image = a->n_images;
    out->image = image;
    out->texture_split = a->texture_split;
    return true;
}

int relight_texture(struct relight_client *client, const char *model,
                    const struct relight_image_info *info, uint8_t **texels,
                    struct relight_error *error)
{
    Relight__GeometryRequest m = RELIGHT__GEOMETRY_REQUEST__INIT;
    struct answer *answer;
    m.model = relight_text(model);
    m.image = relight_text(info->hash);
    int status = relight_call(client, RELIGHT_TYPE_GEOMETRY, &m.base, &answer, error);
    if (status) return status;
    if (answer->payload_size != info->bytes) {
        status = relight_fail(
            error, RELIGHT_E_PROTOCOL, "", "image %.32s: %llu bytes, not %llu", info->hash,
            (unsigned long long)answer->payload_size, (unsigned long long)info->bytes);
    } else {
        *texels = answer->payload;
        answer->payload = NULL;
    }
    relight_answer_free(answer);
    return status;
}
