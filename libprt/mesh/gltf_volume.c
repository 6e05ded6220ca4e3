// SPDX-License-Identifier: MIT
// Reads the medium of a glTF material from its extensions KHR_materials_volume, _transmission,
// _diffuse_transmission, _volume_scatter and the draft _scatter, and KHR_materials_specular as
// an index of refraction. Numbers out of range count as absent.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdio.h>
#include <string.h>

static const cJSON *member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

static float number_in(const cJSON *object, const char *key, double lo, double hi,
                       double otherwise)
{
    const cJSON *v = member(object, key);
    bool good = cJSON_IsNumber(v) && v->valuedouble >= lo && v->valuedouble <= hi;
    return (float)(good ? v->valuedouble : otherwise);
}

static bool color_of(const cJSON *object, const char *key, float out[3])
{
    const cJSON *list = member(object, key);
    float rgb[3];
    for (int c = 0; c < 3; c++) {
        const cJSON *v = cJSON_GetArrayItem(list, c);
        if (!cJSON_IsNumber(v) || !(v->valuedouble >= 0 && v->valuedouble <= 1)) return false;
        rgb[c] = (float)v->valuedouble;
    }
    memcpy(out, rgb, sizeof rgb);
    return true;
}

// The index whose reflection at normal incidence is specularFactor times that of the
// material's own; a colour of the reflection counts by its mean.
static void apply_specular(const cJSON *specular, struct prt_surface *s)
{
    float color[3] = {1, 1, 1}, factor = number_in(specular, "specularFactor", 0, 1, 1);
    color_of(specular, "specularColorFactor", color);
    float root = (s->ior - 1) / (s->ior + 1);
    root *= sqrtf(factor * (color[0] + color[1] + color[2]) / 3);
    s->ior = (1 + root) / (1 - root);
}

// Names the extensions that neither the medium nor the surface keeps.
static void warn_lost(const struct gltf *g, const cJSON *ext, const char *name)
{
    static const char *const kept[] = {"KHR_materials_volume",
                                       "KHR_materials_transmission",
                                       "KHR_materials_ior",
                                       "KHR_materials_scatter",
                                       "KHR_materials_volume_scatter",
                                       "KHR_materials_specular",
                                       "KHR_materials_diffuse_transmission",
                                       "KHR_materials_emissive_strength"};
    char lost[256] = "";
    for (const cJSON *e = ext ? ext->child : NULL; e; e = e->next) {
        bool known = !e->string || strncmp(e->string, "KHR_materials_", 14) != 0;
        for (size_t i = 0; !known && i < sizeof kept / sizeof *kept; i++)
            known = !strcmp(e->string, kept[i]);
        size_t n = strlen(lost);
        if (!known) snprintf(lost + n, sizeof lost - n, "%s%s", n ? ", " : "", e->string + 14);
    }
    if (lost[0])
        prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: material \"%s\": a medium has no %s: left out",
                g->d->name, name, lost);
    float share =
        number_in(member(ext, "KHR_materials_transmission"), "transmissionFactor", 0, 1, 1);
    if (share < 1 && !member(ext, "KHR_materials_diffuse_transmission"))
        prt_log(g->d->ctx, PRT_LOG_WARNING,
                "%s: material \"%s\": the %.0f %% of it that do not transmit are left out",
                g->d->name, name, 100 * (1 - (double)share));
}

int prt_gltf_volume(struct gltf *g, size_t material, uint32_t surface)
{
    const cJSON *m = cJSON_GetArrayItem(member(g->json, "materials"), (int)material);
    const cJSON *ext = member(m, "extensions");
    const cJSON *volume = member(ext, "KHR_materials_volume");
    const cJSON *diffuse = member(ext, "KHR_materials_diffuse_transmission");
    const cJSON *scatter = member(ext, "KHR_materials_scatter");
    if (!scatter) scatter = member(ext, "KHR_materials_volume_scatter");
    const cJSON *specular = member(ext, "KHR_materials_specular");
    if (specular) apply_specular(specular, &g->d->surface[surface]);
    if (!volume && !diffuse && !scatter) return PRT_OK;
    if (g->d->surface[surface].translucent) warn_lost(g, ext, g->d->surface[surface].name);
    struct prt_volume *v = prt_draft_volume(g->d, surface);
    if (!v) return prt_gltf_no_memory(g);
    *v = (struct prt_volume){.kind = PRT_VOLUME_ATTENUATION, .color = {1, 1, 1}};
    memcpy(v->albedo, g->d->surface[surface].base_color, sizeof v->albedo);
    v->distance = number_in(volume, "attenuationDistance", 1e-9, 1e9, 0);
    color_of(volume, "attenuationColor", v->color);
    if (diffuse) color_of(diffuse, "diffuseTransmissionColorFactor", v->albedo);
    if (scatter) {
        v->kind = PRT_VOLUME_SCATTER;
        if (!color_of(scatter, "multiscatterColor", v->albedo)) // of the first proposal
            color_of(scatter, "multiscatterColorFactor", v->albedo);
        v->g = number_in(scatter, "scatterAnisotropy", -0.95, 0.95, 0);
    }
    return PRT_OK;
}
