// SPDX-License-Identifier: MIT
// The medium that a model's own materials give, where --material is not there.
#include "tool.h"

#include <string.h>

bool surface_material(const struct tool *tool, const struct prt_mesh *mesh, uint32_t i,
                      double mm_per_unit, struct prt_material *out)
{
    const struct prt_surface *s = &mesh->surface[i];
    const struct prt_volume *v = &mesh->volume[i];
    struct prt_attenuation in = {.distance_mm = (float)((double)v->distance * mm_per_unit),
                                 .g = v->g,
                                 .eta = s->ior,
                                 .roughness = s->roughness,
                                 .scatters = v->kind == PRT_VOLUME_SCATTER};
    if (!(v->distance > 0)) return false;
    memcpy(in.name, s->name, sizeof in.name - 1);
    memcpy(in.color, v->color, sizeof in.color);
    memcpy(in.albedo, v->albedo, sizeof in.albedo);
    if (!prt_material_from_attenuation(&in, out))
        prt_log(&tool->ctx, PRT_LOG_WARNING,
                "material \"%s\": an albedo above 0.98 is lowered to it; a medium that absorbs "
                "nothing has no finite coefficients",
                s->name);
    return true;
}

bool file_material(const struct tool *tool, const struct prt_mesh *mesh, double mm_per_unit,
                   struct prt_material *out)
{
    uint32_t found = 0;
    const char *name = "";
    for (uint32_t i = 0; mesh->volume && i < mesh->n_surface; i++) {
        struct prt_material own;
        if (!mesh->surface[i].translucent || !mesh->volume[i].kind) continue;
        if (!surface_material(tool, mesh, i, mm_per_unit, &own)) {
            prt_log(&tool->ctx, PRT_LOG_WARNING,
                    "material \"%s\" has no attenuation distance and gives no medium",
                    mesh->surface[i].name);
            continue;
        }
        if (!found++) {
            *out = own;
            name = mesh->surface[i].name;
        }
    }
    if (found > 1)
        prt_log(&tool->ctx, PRT_LOG_WARNING, "the file has %u media; \"%s\" is used for all",
                found, name);
    return found > 0;
}
