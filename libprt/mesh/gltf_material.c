// SPDX-License-Identifier: MIT
// glTF materials: which are translucent, and the reflection of the opaque ones.
#include "gltf.h"

#include <math.h>
#include <string.h>

static const char *const scattering[] = {
    "KHR_materials_transmission", "KHR_materials_diffuse_transmission",
    "KHR_materials_volume",       "KHR_materials_volume_scatter",
    "KHR_materials_scatter",      "KHR_materials_subsurface",
    "KHR_materials_sss",
};

static bool scatters(const struct prt_gltf_material *m)
{
    for (size_t k = 0; k < m->n_extension; k++)
        for (size_t i = 0; i < sizeof scattering / sizeof *scattering; i++)
            if (!strcmp(m->extension[k], scattering[i])) return true;
    return false;
}

static int read_surface(struct gltf *g, size_t index, struct prt_surface *s)
{
    const struct prt_gltf_material *m = &g->file.material[index];
    const struct prt_gltf_numbers *color = &m->base_color;
    prt_surface_default(s, m->name);
    for (size_t c = 0; c < 4 && color->n; c++) {
        if (c >= color->n || !isfinite(color->at[c]))
            return prt_gltf_bad(g, "material %zu: its base colour needs 4 numbers", index);
        double x = color->at[c];
        s->base_color[c] = x < 0 ? 0 : x > 1 ? 1 : (float)x;
    }
    double rough = m->roughness;
    s->roughness = rough < 1e-3 ? 1e-3f : rough <= 1 ? (float)rough : 1;
    s->double_sided = m->double_sided;
    // 0 means no Fresnel reflection, which is not supported
    s->ior = m->ior >= 1 ? (m->ior <= 5 ? (float)m->ior : m->ior < 1e30 ? 5 : 1.5f) : 1.5f;
    return PRT_OK;
}

int prt_gltf_surface(struct gltf *g, size_t index, bool opaque, uint32_t *out)
{
    uint32_t *known = opaque ? g->opaque_of : g->surface_of;
    if (known[index] == UINT32_MAX) {
        struct prt_surface s;
        bool given = index < g->file.n_material;
        bool extended = given && scatters(&g->file.material[index]);
        prt_surface_default(&s, NULL);
        int status = given ? read_surface(g, index, &s) : PRT_OK;
        if (status) return status;
        opaque |= prt_draft_opaque(g->d, s.name);
        // 2: translucent unless an extension makes another material so;
        // prt_gltf_settle_surfaces
        s.translucent = opaque ? 0 : extended ? 1 : 2;
        status = prt_draft_surface(g->d, &s, &known[index]);
        if (!status && given) status = prt_gltf_maps(g, index, known[index]);
        if (!status && given) status = prt_gltf_volume(g, index, known[index]);
        if (status) return status;
    }
    *out = known[index];
    return PRT_OK;
}

// The factor of a translucent surface counts with a texture or vertex colours alone. The mesh
// has colours for all vertices or none: a surface without them must not take it from another's.
static void drop_factor(const struct gltf *g, uint32_t surface)
{
    const struct prt_draft *d = g->d;
    const bool textured =
        surface < d->cap_maps && d->maps[surface].map[PRT_MAP_BASE].image != UINT32_MAX;
    struct prt_surface *s = &d->surface[surface];
    if (!d->has_color || !s->translucent || textured || g->colored[surface]) return;
    for (int c = 0; c < 4; c++) s->base_color[c] = 1;
}

void prt_gltf_settle_surfaces(struct gltf *g)
{
    bool any = false;
    for (uint32_t i = 0; i < g->d->n_surface; i++) any |= g->d->surface[i].translucent == 1;
    for (size_t i = 0; i < g->file.n_material; i++) // also those no primitive uses
        any |=
            scatters(&g->file.material[i]) && !prt_draft_opaque(g->d, g->file.material[i].name);
    for (uint32_t i = 0; i < g->d->n_surface; i++) {
        struct prt_surface *s = &g->d->surface[i];
        if (s->translucent == 2) s->translucent = !any;
        drop_factor(g, i);
    }
}
