// SPDX-License-Identifier: MIT
// KHR_materials_variants: their names, and the material that a primitive has in one of them.
#include "gltf.h"

#include <cjson/cJSON.h>
#include <stdio.h>
#include <string.h>

static const char extension[] = "KHR_materials_variants";

static const cJSON *member(const cJSON *object, const char *key)
{
    return cJSON_IsObject(object) ? cJSON_GetObjectItemCaseSensitive(object, key) : NULL;
}

static const cJSON *in_extension(const cJSON *object, const char *key)
{
    return member(member(member(object, "extensions"), extension), key);
}

static bool is_taken(const struct prt_draft *d, const char *name)
{
    for (uint32_t i = 0; i < d->n_variant; i++)
        if (!strcmp(d->variants[i].name, name)) return true;
    return false;
}

static void list_names(struct gltf *g)
{
    struct prt_draft *d = g->d;
    const cJSON *one;
    cJSON_ArrayForEach(one, in_extension(g->json, "variants"))
    {
        const char *name = cJSON_GetStringValue(member(one, "name"));
        if (d->n_variant == PRT_MESH_MOST_VARIANTS) break;
        struct prt_mesh_variant *to = &d->variants[d->n_variant];
        *to = (struct prt_mesh_variant){{0}};
        snprintf(to->name, sizeof to->name, "%.63s", name ? name : "");
        if (!to->name[0] || is_taken(d, to->name))
            snprintf(to->name, sizeof to->name, "variant %u", d->n_variant);
        d->n_variant++;
    }
}

static int choose(struct gltf *g)
{
    const struct prt_draft *d = g->d;
    const char *name[PRT_MESH_MOST_VARIANTS];
    char say[640];
    for (uint32_t i = 0; i < d->n_variant; i++) name[i] = d->variants[i].name;
    if (!d->n_variant)
        return prt_fail(d->ctx, PRT_ARG, "%s has no variants: leave --variant out", d->name);
    g->variant = prt_name_choose(d->variant, name, d->n_variant, say, sizeof say);
    if (g->variant >= 0) return PRT_OK;
    return prt_fail(d->ctx, PRT_ARG, "%s has no variant \"%.63s\"%s%s", d->name, d->variant,
                    *say ? "; " : "", say);
}

int prt_gltf_variants(struct gltf *g)
{
    const cJSON *mesh;
    size_t i = 0;
    g->variant = -1;
    list_names(g);
    if (!g->d->variant) return PRT_OK;
    int status = choose(g);
    if (status) return status;
    g->json_mesh = prt_gltf_own(g, g->file.n_mesh * sizeof *g->json_mesh);
    if (!g->json_mesh) return prt_gltf_no_memory(g);
    cJSON_ArrayForEach(mesh, member(g->json, "meshes"))
    {
        if (i < g->file.n_mesh) g->json_mesh[i++] = mesh;
    }
    return PRT_OK;
}

int64_t prt_gltf_variant_material(const struct gltf *g, size_t primitive, int64_t own)
{
    const cJSON *mapping, *index, *list;
    if (g->variant < 0) return own;
    const cJSON *p =
        cJSON_GetArrayItem(member(g->json_mesh[g->mesh_index], "primitives"), (int)primitive);
    cJSON_ArrayForEach(mapping, in_extension(p, "mappings"))
    {
        const cJSON *material = member(mapping, "material");
        list = member(mapping, "variants");
        cJSON_ArrayForEach(index, list)
        {
            if (!cJSON_IsNumber(index) || index->valuedouble != (double)g->variant ||
                !cJSON_IsNumber(material) || !(material->valuedouble >= 0) ||
                !(material->valuedouble < (double)g->file.n_material))
                continue;
            return (int64_t)material->valuedouble;
        }
    }
    return own;
}
