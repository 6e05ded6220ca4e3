// SPDX-License-Identifier: MIT
// The media that a model's own materials give.
#include "prt/media.h"

#include <string.h>

bool prt_media_of_surface(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          uint32_t i, double mm_per_unit, struct prt_material *out)
{
    const struct prt_surface *s = &mesh->surface[i];
    if (!mesh->volume || !mesh->volume[i].kind) return false;
    const struct prt_volume *v = &mesh->volume[i];
    struct prt_attenuation in = {.distance_mm = (float)((double)v->distance * mm_per_unit),
                                 .g = v->g,
                                 .eta = s->ior,
                                 .roughness = s->roughness,
                                 .scatters = v->kind == PRT_VOLUME_SCATTER};
    if (!(v->distance > 0)) {
        prt_log(ctx, PRT_LOG_WARNING,
                "material \"%s\" has no attenuation distance and gives no medium", s->name);
        return false;
    }
    memcpy(in.name, s->name, sizeof in.name - 1);
    memcpy(in.color, v->color, sizeof in.color);
    memcpy(in.albedo, v->albedo, sizeof in.albedo);
    const unsigned lowered = prt_material_from_attenuation(&in, out);
    if (lowered & PRT_LOWERED_ALBEDO)
        prt_log(ctx, PRT_LOG_WARNING,
                "material \"%s\": an albedo above 0.98 is lowered to it; a medium that absorbs "
                "nothing has no finite coefficients",
                s->name);
    if (lowered & PRT_LOWERED_RATE)
        prt_log(ctx, PRT_LOG_WARNING,
                "material \"%s\": its attenuation is beyond what prt takes, mean free paths of "
                "about 0.001 to 100000 mm, and was moved there",
                s->name);
    return true;
}

// Whether a translucent block of this surface has no medium yet.
static bool is_wanted(const struct prt_mesh *mesh, uint32_t surface,
                      const struct prt_material *const of_block[])
{
    for (uint32_t b = 0; b < mesh->n_block; b++)
        if (mesh->block[b].surface == surface && !of_block[b]) return true;
    return false;
}

void prt_media_own(const struct prt_context *ctx, const struct prt_mesh *mesh,
                   struct prt_material own[], const struct prt_material *of_block[])
{
    for (uint32_t i = 0; i < mesh->n_surface; i++) {
        char text[PRT_MATERIAL_SUMMARY];
        if (!mesh->surface[i].translucent || !is_wanted(mesh, i, of_block) ||
            !prt_media_of_surface(ctx, mesh, i, (double)mesh->mm_per_unit, &own[i]))
            continue;
        for (uint32_t b = 0; b < mesh->n_block; b++)
            if (mesh->block[b].surface == i && !of_block[b]) of_block[b] = &own[i];
        prt_material_summary(&own[i], text, sizeof text);
        prt_log(ctx, PRT_LOG_NOTE, "the file's own material: %s", text);
    }
}
