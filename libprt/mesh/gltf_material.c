// SPDX-License-Identifier: MIT
// glTF materials: which are translucent, and what light does on the others.
#include "gltf.h"

#include <math.h>
#include <string.h>

static const char *const scattering[] = {
    "KHR_materials_transmission", "KHR_materials_diffuse_transmission",
    "KHR_materials_volume",       "KHR_materials_volume_scatter",
    "KHR_materials_scatter",      "KHR_materials_subsurface",
    "KHR_materials_sss",
};

static double clamped(const struct gltf *g, const cJSON *o, const char *key, double missing,
                      double low, double high)
{
    const cJSON *item = gltf_member(o, key);
    if (!cJSON_IsNumber(item) || !(fabs(item->valuedouble) < 1e30)) return missing;
    double x = item->valuedouble;
    return x < low ? low : x > high ? high : x;
}

static int read_surface(struct gltf *g, size_t index, struct prt_surface *s, bool *extended)
{
    const cJSON *o = g->material.item[index], *ext = gltf_member(o, "extensions");
    const cJSON *pbr = gltf_member(o, "pbrMetallicRoughness");
    const cJSON *old = gltf_member(ext, "KHR_materials_pbrSpecularGlossiness");
    double color[4] = {1, 1, 1, 1};
    bool have = false;
    prt_surface_default(s, gltf_text(o, "name") ? gltf_text(o, "name") : "");
    int status = gltf_numbers(g, "material", index, pbr, "baseColorFactor", 4, color, &have);
    if (!status && !have)
        status = gltf_numbers(g, "material", index, old, "diffuseFactor", 4, color, &have);
    if (status) return status;
    for (int c = 0; c < 4; c++)
        s->base_color[c] = color[c] < 0 ? 0 : color[c] > 1 ? 1 : (float)color[c];
    s->roughness = (float)clamped(g, pbr, "roughnessFactor", 1, 1e-3, 1);
    s->double_sided = cJSON_IsTrue(gltf_member(o, "doubleSided"));
    double ior = clamped(g, gltf_member(ext, "KHR_materials_ior"), "ior", 1.5, 0, 5);
    s->ior = ior < 1 ? 1.5f : (float)ior; // 0 means "no Fresnel", which we do not know
    *extended = false;
    for (size_t i = 0; i < sizeof scattering / sizeof *scattering; i++)
        *extended |= gltf_member(ext, scattering[i]) != NULL;
    if (gltf_member(pbr, "baseColorTexture") || gltf_member(old, "diffuseTexture"))
        s->reserved[0] = 1; // for the note about textures; cleared before packing
    return PRT_OK;
}

// The surface of material `index` (material.n: none given), made on first use.
int gltf_surface(struct gltf *g, size_t index, bool opaque, uint32_t *out)
{
    uint32_t *known = opaque ? g->opaque_of : g->surface_of;
    if (known[index] == UINT32_MAX) {
        struct prt_surface s;
        bool extended = false;
        prt_surface_default(&s, NULL);
        int status = index < g->material.n ? read_surface(g, index, &s, &extended) : PRT_OK;
        if (status) return status;
        opaque |= prt_draft_opaque(g->d, s.name);
        // 2: translucent unless another material is so by its extensions; see settle_surfaces
        s.translucent = opaque ? 0 : extended ? 1 : 2;
        status = prt_draft_surface(g->d, &s, &known[index]);
        if (status) return status;
    }
    *out = known[index];
    return PRT_OK;
}

void gltf_settle_surfaces(struct gltf *g)
{
    bool any = false;
    uint32_t textured = 0;
    for (uint32_t i = 0; i < g->d->n_surface; i++) any |= g->d->surface[i].translucent == 1;
    for (size_t i = 0; i < g->material.n; i++) { // also those no primitive uses
        const cJSON *ext = gltf_member(g->material.item[i], "extensions");
        for (size_t k = 0; k < sizeof scattering / sizeof *scattering; k++)
            any |= gltf_member(ext, scattering[k]) != NULL &&
                   !prt_draft_opaque(g->d, gltf_text(g->material.item[i], "name"));
    }
    for (uint32_t i = 0; i < g->d->n_surface; i++) {
        struct prt_surface *s = &g->d->surface[i];
        if (s->translucent == 2) s->translucent = !any;
        textured += s->reserved[0] && !s->translucent;
        s->reserved[0] = 0;
    }
    if (textured)
        prt_log(g->d->ctx, PRT_LOG_NOTE,
                "%s: textures are not read; %u opaque materials keep their base colour factor",
                g->d->name, textured);
}
