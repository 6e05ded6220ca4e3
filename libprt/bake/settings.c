// SPDX-License-Identifier: MIT
// The settings of a bake as JSON: provenance in the .prt and part of the key of shards.
#include "bake/view_fit.h"
#include "bake/walks.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <stdlib.h>

// A number with six significant digits, as people read it.
static void add_rounded(cJSON *to, const char *name, double value)
{
    char text[32];
    snprintf(text, sizeof text, "%g", value);
    cJSON_AddRawToObject(to, name, text);
}

// Not as a double, which holds 53 bits.
static void add_u64(cJSON *to, const char *name, uint64_t value)
{
    char text[24];
    snprintf(text, sizeof text, "%llu", (unsigned long long)value);
    cJSON_AddRawToObject(to, name, text);
}

// The media after the first, and the number of each object's medium.
static void add_media(cJSON *to, const struct prt_media *media, uint32_t n_object)
{
    char text[PRT_MATERIAL_SUMMARY];
    if (media->n == 1) return;
    cJSON *all = cJSON_AddArrayToObject(to, "media");
    for (uint32_t i = 0; i < media->n; i++) {
        prt_material_summary(&media->medium[i], text, sizeof text);
        cJSON_AddItemToArray(all, cJSON_CreateRaw(text));
    }
    cJSON *of = cJSON_AddArrayToObject(to, "medium_of_object");
    for (uint32_t i = 0; i < n_object; i++)
        cJSON_AddItemToArray(of, cJSON_CreateNumber(prt_media_index(media, i)));
}

char *prt_bake_describe(const struct bake *b)
{
    static const char *const engine[] = {"wavelet", "polynomial", "joint"};
    uint64_t rays = 0;
    char material[512];
    cJSON *json = cJSON_CreateObject();
    if (!json) return NULL;
    for (uint32_t c = 0; b->rays_single && c < b->clusters->n_cluster; c++)
        rays += b->rays_single[c];
    prt_material_summary(&b->o.media.medium[0], material, sizeof material);
    cJSON_AddStringToObject(json, "engine", engine[b->o.engine]);
    cJSON_AddStringToObject(json, "storage",
                            b->o.storage == PRT_STORAGE_SPARSE ? "sparse" : "factored");
    cJSON_AddStringToObject(json, "scattering", b->walk ? "walk" : "dipole");
    if (b->o.draft) cJSON_AddBoolToObject(json, "draft", true);
    if (b->o.any_eta) cJSON_AddBoolToObject(json, "any_eta", true);
    add_u64(json, "cube", b->o.cube);
    add_u64(json, "samples", b->surface ? b->surface->n_sample : 0);
    add_rounded(json, "spacing_mm", b->surface ? (double)b->surface->spacing : 0);
    add_u64(json, "phase_terms", b->o.n_phase);
    if (prt_bake_has_view(b)) add_u64(json, "exit_planes", VIEW_PLANES);
    add_u64(json, "single_points", b->o.n_single);
    add_u64(json, "coeffs", b->o.n_coef);
    add_rounded(json, "max_error", b->o.max_error);
    add_u64(json, "seed", b->o.seed);
    if (b->mesh->texture_split > 0)
        add_rounded(json, "texture_split", (double)b->mesh->texture_split);
    if (b->walk) {
        add_u64(json, "walks", b->walk->n_walk);
        add_rounded(json, "walk_leaks", b->walk->leaked);
    }
    add_u64(json, "clusters", b->clusters->n_cluster);
    add_u64(json, "rays_single", rays);
    cJSON_AddRawToObject(json, "material", material);
    add_media(json, &b->o.media, b->mesh->n_object);
    if (b->o.settings_json) cJSON_AddRawToObject(json, "source", b->o.settings_json);
    char *text = cJSON_PrintUnformatted(json);
    cJSON_Delete(json);
    return text;
}
