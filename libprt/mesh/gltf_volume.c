// SPDX-License-Identifier: MIT
// Reads the medium of a glTF material from its extensions KHR_materials_volume, _transmission,
// _diffuse_transmission, _volume_scatter and the draft _scatter. Numbers out of range count as
// absent.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <math.h>
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
    for (int c = 0; c < 3; c++) {
        const cJSON *v = cJSON_GetArrayItem(list, c);
        if (!cJSON_IsNumber(v) || !(v->valuedouble >= 0 && v->valuedouble <= 1)) return false;
        out[c] = (float)v->valuedouble;
    }
    return true;
}

int prt_gltf_volume(struct gltf *g, size_t material, uint32_t surface)
{
    const cJSON *m = cJSON_GetArrayItem(member(g->json, "materials"), (int)material);
    const cJSON *ext = member(m, "extensions");
    const cJSON *volume = member(ext, "KHR_materials_volume");
    const cJSON *diffuse = member(ext, "KHR_materials_diffuse_transmission");
    const cJSON *scatter = member(ext, "KHR_materials_scatter");
    if (!scatter) scatter = member(ext, "KHR_materials_volume_scatter");
    if (!volume && !diffuse && !scatter) return PRT_OK;
    struct prt_volume *v = prt_draft_volume(g->d, surface);
    if (!v) return prt_gltf_no_memory(g);
    *v = (struct prt_volume){.kind = PRT_VOLUME_ATTENUATION, .color = {1, 1, 1}};
    memcpy(v->albedo, g->d->surface[surface].base_color, sizeof v->albedo);
    v->distance = number_in(volume, "attenuationDistance", 1e-9, 1e9, 0);
    color_of(volume, "attenuationColor", v->color);
    if (diffuse) color_of(diffuse, "diffuseTransmissionColorFactor", v->albedo);
    if (scatter) {
        v->kind = PRT_VOLUME_SCATTER;
        color_of(scatter, "multiscatterColor", v->albedo);
        v->g = number_in(scatter, "scatterAnisotropy", -0.95, 0.95, 0);
    }
    return PRT_OK;
}
