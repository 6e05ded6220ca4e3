// SPDX-License-Identifier: MIT
// The maps of a glTF's materials: texture references, samplers, KHR_texture_transform,
// emission. Numbers out of range end in a warning that names the material, and the map is left
// out.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

static const cJSON *member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

// A whole number in [0, below), or -1.
static int64_t index_in(const cJSON *object, const char *key, int64_t below)
{
    const cJSON *v = member(object, key);
    if (!cJSON_IsNumber(v) || v->valuedouble < 0 || !(v->valuedouble < (double)below))
        return -1;
    return (double)(int64_t)v->valuedouble == v->valuedouble ? (int64_t)v->valuedouble : -1;
}

static float number_or(const cJSON *object, const char *key, double otherwise)
{
    const cJSON *v = member(object, key);
    return (float)(cJSON_IsNumber(v) && fabs(v->valuedouble) <= 1e6 ? v->valuedouble
                                                                    : otherwise);
}

char *prt_gltf_textures_copy(const struct gltf *g, const char *json, size_t n)
{
    bool any = memmem(json, n, "\"materials\"", 11) || memmem(json, n, "\"COLOR_0\"", 9) ||
               memmem(json, n, "\"animations\"", 12) || memmem(json, n, "\"skins\"", 7) ||
               memmem(json, n, "\"targets\"", 9) ||
               memmem(json, n, "\"EXT_mesh_gpu_instancing\"", 25);
    if (!any || n > g->d->max_bytes / 8) return NULL;
    char *copy = malloc(n + 1);
    if (copy) {
        memcpy(copy, json, n);
        copy[n] = 0;
    }
    return copy;
}

// The largest TEXCOORD set that a map of the file names.
static uint32_t most_set(const cJSON *node)
{
    uint32_t most = 0;
    const cJSON *child;
    cJSON_ArrayForEach(child, node)
    {
        if (child->string && !strcmp(child->string, "texCoord")) {
            int64_t k = index_in(node, "texCoord", PRT_GLTF_UV_SETS);
            if (k > (int64_t)most) most = (uint32_t)k;
        }
        if (cJSON_IsObject(child) || cJSON_IsArray(child)) {
            uint32_t own = most_set(child); // the depth was checked: 200 at most
            if (own > most) most = own;
        }
    }
    return most;
}

int prt_gltf_textures_begin(struct gltf *g, char *copy, size_t n)
{
    if (!copy) return PRT_OK;
    g->instances = memmem(copy, n, "\"EXT_mesh_gpu_instancing\"", 25) != NULL;
    g->d->has_color = !g->d->no_textures && memmem(copy, n, "\"COLOR_0\"", 9) != NULL;
    g->json = cJSON_ParseWithLength(copy, n);
    free(copy);
    if (!g->json) return PRT_OK; // the parser of the whole file names the fault
    const cJSON *images = member(g->json, "images");
    size_t n_image = (size_t)cJSON_GetArraySize(images);
    if (!g->d->no_textures) g->d->n_uv = 1 + most_set(member(g->json, "materials"));
    g->image_index = prt_gltf_own(g, (n_image + 1) * PRT_TEXTURE_N_KIND * 4);
    if (!g->image_index) return prt_gltf_no_memory(g);
    memset(g->image_index, 0xff, (n_image + 1) * PRT_TEXTURE_N_KIND * 4);
    return PRT_OK;
}

void prt_gltf_textures_end(struct gltf *g)
{
    cJSON_Delete(g->json);
    g->json = NULL;
}

static uint8_t wrap_of(const cJSON *sampler, const char *key)
{
    const cJSON *v = member(sampler, key);
    int mode = cJSON_IsNumber(v) ? v->valueint : 10497;
    return mode == 33071 ? PRT_WRAP_CLAMP : mode == 33648 ? PRT_WRAP_MIRROR : PRT_WRAP_REPEAT;
}

static void read_sampler(const cJSON *sampler, struct prt_texture_ref *ref)
{
    const cJSON *mag = member(sampler, "magFilter"), *min = member(sampler, "minFilter");
    ref->wrap_u = wrap_of(sampler, "wrapS");
    ref->wrap_v = wrap_of(sampler, "wrapT");
    if (cJSON_IsNumber(mag) && mag->valueint == 9728) ref->filter |= PRT_FILTER_MAG_NEAREST;
    switch (cJSON_IsNumber(min) ? min->valueint : 9987) {
    case 9728:
        ref->filter |= PRT_FILTER_MIN_NEAREST | PRT_FILTER_NO_LEVELS;
        break;
    case 9729:
        ref->filter |= PRT_FILTER_NO_LEVELS;
        break;
    case 9984:
        ref->filter |= PRT_FILTER_MIN_NEAREST | PRT_FILTER_LEVEL_NEAREST;
        break;
    case 9985:
        ref->filter |= PRT_FILTER_LEVEL_NEAREST;
        break;
    case 9986:
        ref->filter |= PRT_FILTER_MIN_NEAREST;
        break;
    default:
        break;
    }
}

// KHR_texture_transform: scale, then rotation, then offset. False for numbers out of range.
static bool read_transform(const cJSON *info, struct prt_texture_ref *ref)
{
    const cJSON *t = member(member(info, "extensions"), "KHR_texture_transform");
    const cJSON *offset = member(t, "offset"), *scale = member(t, "scale");
    const cJSON *turn = member(t, "rotation"), *v;
    double o[2] = {0, 0}, s[2] = {1, 1}, angle = 0;
    if (!t) return true;
    for (int k = 0; k < 2; k++) {
        if (offset && !cJSON_IsNumber(v = cJSON_GetArrayItem(offset, k))) return false;
        if (offset) o[k] = v->valuedouble;
        if (scale && !cJSON_IsNumber(v = cJSON_GetArrayItem(scale, k))) return false;
        if (scale) s[k] = v->valuedouble;
    }
    if (turn && !cJSON_IsNumber(turn)) return false;
    if (turn) angle = turn->valuedouble;
    const double m[6] = {cos(angle) * s[0],  sin(angle) * s[1], o[0],
                         -sin(angle) * s[0], cos(angle) * s[1], o[1]};
    for (int k = 0; k < 6; k++) {
        if (!(fabs(m[k]) <= 1e6)) return false;
        ref->transform[k] = (float)m[k];
    }
    int64_t set = index_in(t, "texCoord", PRT_GLTF_UV_SETS);
    if (set >= 0) ref->uv_set = (uint8_t)set;
    return true;
}

static int leave_out(const struct gltf *g, size_t material, const char *map, const char *why)
{
    prt_log(g->d->ctx, PRT_LOG_WARNING, "%s: material %zu: its %s is left out: %s", g->d->name,
            material, map, why);
    return PRT_OK;
}

// The image that a texture takes: WebP where the extension names one; KTX2 and others, which
// are not read, only where there is no other.
static int64_t source_of(const cJSON *texture, int64_t n_image)
{
    static const char *const extension[] = {"EXT_texture_webp", "KHR_texture_basisu",
                                            "EXT_texture_avif", "MSFT_texture_dds"};
    const cJSON *ext = member(texture, "extensions");
    int64_t webp = index_in(member(ext, extension[0]), "source", n_image);
    int64_t plain = webp >= 0 ? webp : index_in(texture, "source", n_image);
    for (int k = 1; k < 4 && plain < 0; k++)
        plain = index_in(member(ext, extension[k]), "source", n_image);
    return plain;
}

static int read_map(struct gltf *g, size_t material, const char *name, const cJSON *info,
                    enum prt_texture_kind kind, struct prt_texture_ref *ref)
{
    const cJSON *textures = member(g->json, "textures"),
                *samplers = member(g->json, "samplers");
    int64_t n_image = cJSON_GetArraySize(member(g->json, "images"));
    struct prt_texture_ref own = *ref;
    if (!cJSON_IsObject(info)) return PRT_OK;
    int64_t texture = index_in(info, "index", cJSON_GetArraySize(textures));
    if (texture < 0)
        return leave_out(g, material, name, "it names a texture that is not there");
    const cJSON *t = cJSON_GetArrayItem(textures, (int)texture);
    int64_t set = index_in(info, "texCoord", PRT_GLTF_UV_SETS);
    if (set < 0 && member(info, "texCoord"))
        return leave_out(g, material, name, "its texCoord is out of range");
    own.uv_set = (uint8_t)(set < 0 ? 0 : set);
    int64_t sampler = index_in(t, "sampler", cJSON_GetArraySize(samplers));
    read_sampler(sampler < 0 ? NULL : cJSON_GetArrayItem(samplers, (int)sampler), &own);
    if (!read_transform(info, &own))
        return leave_out(g, material, name, "its KHR_texture_transform is out of range");
    int64_t image = source_of(t, n_image);
    if (image < 0)
        return leave_out(g, material, name, "its texture names no image of the file");
    int status = prt_gltf_image(g, (size_t)image, kind, &own.image);
    if (!status && own.image != UINT32_MAX) *ref = own;
    return status;
}

static void read_emission(const cJSON *material, struct prt_surface_maps *maps)
{
    const cJSON *factor = member(material, "emissiveFactor");
    const cJSON *strong =
        member(member(material, "extensions"), "KHR_materials_emissive_strength");
    float strength = number_or(strong, "emissiveStrength", 1);
    for (int c = 0; c < 3; c++) {
        const cJSON *v = cJSON_GetArrayItem(factor, c);
        double x = cJSON_IsNumber(v) ? v->valuedouble : 0;
        x *= (double)(strength > 0 ? strength : 0);
        maps->emissive[c] = x > 0 ? (float)fmin(x, 1e6) : 0;
    }
}

static bool any_map(const struct prt_surface_maps *maps)
{
    bool any = false;
    for (int k = 0; k < PRT_N_MAP; k++) any |= maps->map[k].image != UINT32_MAX;
    for (int c = 0; c < 3; c++) any |= maps->emissive[c] > 0;
    return any;
}

int prt_gltf_maps(struct gltf *g, size_t material, uint32_t surface)
{
    const cJSON *m = cJSON_GetArrayItem(member(g->json, "materials"), (int)material);
    const cJSON *pbr = member(m, "pbrMetallicRoughness"), *base;
    const cJSON *older = member(member(m, "extensions"), "KHR_materials_pbrSpecularGlossiness");
    const cJSON *normal = member(m, "normalTexture"),
                *occlusion = member(m, "occlusionTexture");
    struct prt_surface_maps maps;
    if (!cJSON_IsObject(m) || g->d->no_textures) return PRT_OK;
    prt_surface_maps_default(&maps);
    base = member(pbr, "baseColorTexture");
    if (!base) base = member(older, "diffuseTexture");
    float metallic = number_or(pbr, "metallicFactor", older ? 0 : 1);
    maps.metallic = metallic > 0 ? metallic < 1 ? metallic : 1 : 0;
    const struct {
        enum prt_map map;
        const cJSON *info;
        enum prt_texture_kind kind;
        const char *name;
    } part[] = {
        {PRT_MAP_BASE, base, PRT_TEXTURE_COLOR, "base colour texture"},
        {PRT_MAP_NORMAL, normal, PRT_TEXTURE_NORMAL, "normal texture"},
        {PRT_MAP_ROUGHNESS, member(pbr, "metallicRoughnessTexture"), PRT_TEXTURE_DATA,
         "metallic-roughness texture"},
        {PRT_MAP_OCCLUSION, occlusion, PRT_TEXTURE_DATA, "occlusion texture"},
        {PRT_MAP_EMISSIVE, member(m, "emissiveTexture"), PRT_TEXTURE_COLOR, "emissive texture"},
    };
    for (int k = 0; k < PRT_N_MAP; k++) {
        int status = read_map(g, material, part[k].name, part[k].info, part[k].kind,
                              &maps.map[part[k].map]);
        if (status) return status;
    }
    maps.map[PRT_MAP_NORMAL].scale = number_or(normal, "scale", 1);
    maps.map[PRT_MAP_OCCLUSION].scale = number_or(occlusion, "strength", 1);
    read_emission(m, &maps);
    if (!any_map(&maps)) return PRT_OK;
    struct prt_surface_maps *own = prt_draft_maps(g->d, surface);
    if (!own) return prt_gltf_no_memory(g);
    *own = maps;
    return PRT_OK;
}
