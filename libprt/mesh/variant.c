// SPDX-License-Identifier: MIT
// Variants of a mesh by name.
#include "internal.h"

static const char own_materials[] = "default";

int prt_mesh_variant_find(const struct prt_context *ctx, const char *model,
                          const struct prt_mesh *mesh, const char *name, uint32_t *out)
{
    const char *names[PRT_MESH_MOST_VARIANTS + 1];
    char say[640];
    const uint32_t n = mesh->n_variant;
    if (!n) return prt_fail(ctx, PRT_ARG, "%s has no variants: leave the variant out", model);
    for (uint32_t i = 0; i < n; i++) names[i] = mesh->variant[i].name;
    names[n] = own_materials;
    // "default" is a variant's name where a variant has it
    int found = prt_name_choose(name, names, n, say, sizeof say);
    if (found < 0) found = prt_name_choose(name, names, n + 1, say, sizeof say);
    if (found < 0)
        return prt_fail(ctx, PRT_ARG, "%s has no variant \"%.63s\"%s%s", model, name,
                        *say ? "; " : "", say);
    *out = (uint32_t)found;
    return PRT_OK;
}
