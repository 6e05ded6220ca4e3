// SPDX-License-Identifier: MIT
// KHR_materials_variants: their names, and the surface that a primitive has in each of them.
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
        for (uint32_t k = d->n_variant; !to->name[0] || is_taken(d, to->name); k++)
            snprintf(to->name, sizeof to->name, "variant %u", k);
        d->n_variant++;
    }
}

static int choose(struct gltf *g)
{
    struct prt_draft *d = g->d;
    const struct prt_mesh names = {.variant = d->variants, .n_variant = d->n_variant};
    g->variant = d->n_variant;
    if (!d->variant) return PRT_OK;
    return prt_mesh_variant_find(d->ctx, d->name, &names, d->variant, &g->variant);
}

int prt_gltf_variants(struct gltf *g)
{
    const cJSON *mesh;
    size_t i = 0;
    list_names(g);
    int status = choose(g);
    if (status || !g->d->n_variant) return status;
    g->json_mesh = prt_gltf_own(g, g->file.n_mesh * sizeof *g->json_mesh);
    if (!g->json_mesh) return prt_gltf_no_memory(g);
    cJSON_ArrayForEach(mesh, member(g->json, "meshes"))
    {
        if (i < g->file.n_mesh) g->json_mesh[i++] = mesh;
    }
    return PRT_OK;
}

// Whether a mapping of a primitive is for the variant, and to a material that exists.
static bool maps_to(const struct gltf *g, const cJSON *mapping, uint32_t variant)
{
    const cJSON *index, *material = member(mapping, "material");
    if (!cJSON_IsNumber(material) || !(material->valuedouble >= 0) ||
        !(material->valuedouble < (double)g->file.n_material))
        return false;
    cJSON_ArrayForEach(index, member(mapping, "variants"))
    {
        if (cJSON_IsNumber(index) && index->valuedouble == (double)variant) return true;
    }
    return false;
}

static size_t material_in(const struct gltf *g, const cJSON *primitive, uint32_t variant,
                          size_t own)
{
    const cJSON *mapping;
    cJSON_ArrayForEach(mapping, in_extension(primitive, "mappings"))
    {
        if (maps_to(g, mapping, variant))
            return (size_t)member(mapping, "material")->valuedouble;
    }
    return own;
}

int prt_gltf_variant_surfaces(struct gltf *g, size_t primitive, size_t own, bool opaque)
{
    struct prt_draft *d = g->d;
    if (!d->n_variant) return PRT_OK;
    const cJSON *p =
        cJSON_GetArrayItem(member(g->json_mesh[g->mesh_index], "primitives"), (int)primitive);
    uint32_t *row = prt_draft_variant_row(d);
    if (!row) return prt_gltf_no_memory(g);
    for (uint32_t i = 0; i <= d->n_variant; i++) {
        const size_t material = i < d->n_variant ? material_in(g, p, i, own) : own;
        int status = prt_gltf_surface(g, material, opaque, &row[i]);
        if (status) return status;
    }
    d->block[d->n_block - 1].surface = row[g->variant];
    return PRT_OK;
}
