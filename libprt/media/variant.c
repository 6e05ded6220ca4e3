// SPDX-License-Identifier: MIT
// Views of a mesh in one of its variants: other surfaces, and the media of their own.
#include "prt/variant.h"

#include <math.h>
#include <string.h>

// The baked mesh and media, and the variant that is asked for.
struct base {
    const struct prt_context *ctx;
    const char *model, *variant; // names, for messages
    const struct prt_mesh *mesh;
    const struct prt_media *media;
    enum prt_variant_of of;
};

static int needs_bake(const struct base *b, uint32_t surface, const char *why)
{
    return prt_fail(b->ctx, PRT_MISMATCH,
                    "%s: variant \"%s\" %s \"%s\", which is baked: it needs a bake of its own "
                    "(prt bake --variant, or `variant` of LOAD)",
                    b->model, b->variant, why, b->mesh->surface[surface].name);
}

static bool same_map(const struct prt_mesh *mesh, uint32_t one, uint32_t other, int map)
{
    struct prt_surface_maps none;
    prt_surface_maps_default(&none);
    const struct prt_texture_ref *a = mesh->maps ? &mesh->maps[one].map[map] : &none.map[map],
                                 *b = mesh->maps ? &mesh->maps[other].map[map] : &none.map[map];
    if (a->image == UINT32_MAX && b->image == UINT32_MAX) return true;
    return !memcmp(a, b, sizeof *a);
}

static bool same_base(const struct prt_mesh *mesh, uint32_t one, uint32_t other)
{
    return same_map(mesh, one, other, PRT_MAP_BASE) &&
           !memcmp(mesh->surface[one].base_color, mesh->surface[other].base_color,
                   sizeof mesh->surface[one].base_color);
}

// Refuses a surface that differs from the baked one in anything that was baked but its medium.
static int check_surface(const struct base *b, uint32_t baked, uint32_t wanted)
{
    const struct prt_mesh *mesh = b->mesh;
    const bool translucent = mesh->surface[baked].translucent;
    if (translucent != (bool)mesh->surface[wanted].translucent)
        return needs_bake(b, baked, translucent ? "makes opaque" : "makes translucent");
    if (!translucent) return PRT_OK;
    if (!same_map(mesh, baked, wanted, PRT_MAP_NORMAL))
        return needs_bake(b, baked, "has another normal map for");
    if (!same_map(mesh, baked, wanted, PRT_MAP_OCCLUSION))
        return needs_bake(b, baked, "has another occlusion map for");
    if (mesh->texture_split > 0 && !same_base(mesh, baked, wanted))
        return needs_bake(b, baked, "has another colour, with a texture split, for");
    return PRT_OK;
}

// The factor from an opaque surface's baked albedo to another one.
static int find_gain(const struct base *b, uint32_t baked, uint32_t wanted, float gain[3])
{
    const float *from = b->mesh->surface[baked].base_color,
                *to = b->mesh->surface[wanted].base_color;
    for (int c = 0; c < 3; c++) {
        if (!(from[c] > 0) && to[c] > 0 && b->of != PRT_VARIANT_OF_MODEL)
            return needs_bake(b, baked, "brightens a channel of the black albedo of");
        gain[c] = from[c] > 0 ? to[c] / from[c] : 1;
    }
    return PRT_OK;
}

static bool no_gain(const float gain[3])
{
    return gain[0] == 1 && gain[1] == 1 && gain[2] == 1;
}

static int view_blocks(const struct base *b, struct prt_variant *v, struct prt_block *block,
                       float (*gain)[3])
{
    const struct prt_mesh *mesh = b->mesh;
    const uint32_t width = mesh->n_variant + 1;
    bool any_gain = false;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        const uint32_t baked = mesh->block[i].surface;
        const uint32_t wanted = mesh->variant_surface[(size_t)i * width + v->index];
        int status = PRT_OK;
        block[i] = mesh->block[i];
        block[i].surface = wanted;
        for (int c = 0; c < 3; c++) gain[i][c] = 1;
        if (b->of != PRT_VARIANT_OF_MODEL) status = check_surface(b, baked, wanted);
        if (!status && !mesh->surface[baked].translucent)
            status = find_gain(b, baked, wanted, gain[i]);
        if (status) return status;
        any_gain |= !no_gain(gain[i]);
    }
    v->mesh.block = block;
    v->gain = gain;
    v->mesh.gain = any_gain && b->of != PRT_VARIANT_OF_MODEL ? gain : NULL;
    return PRT_OK;
}

// Whether light is transported in the same way: all but names and the roughness of reflections.
static bool same_transport(const struct prt_material *a, const struct prt_material *b)
{
    struct prt_material other = *b;
    other.roughness = a->roughness;
    return prt_material_hash(a) == prt_material_hash(&other);
}

// The medium that a block has in the variant, where it is its surface's own: *own holds it.
static const struct prt_material *medium_of(const struct base *b, uint32_t baked,
                                            uint32_t wanted, const struct prt_material *medium,
                                            struct prt_material *own)
{
    // its warnings were said when the model was loaded
    static const struct prt_context quiet = {.log = prt_log_none};
    const double scale = (double)b->mesh->mm_per_unit;
    if (baked == wanted || !b->mesh->surface[wanted].translucent) return medium;
    // an opaque surface has no medium that the user could have chosen
    if (b->mesh->surface[baked].translucent &&
        (!prt_media_of_surface(&quiet, b->mesh, baked, scale, own) ||
         prt_material_hash(own) != prt_material_hash(medium)))
        return medium;
    return prt_media_of_surface(&quiet, b->mesh, wanted, scale, own) ? own : medium;
}

static int check_medium(const struct base *b, uint32_t baked, const struct prt_material *from,
                        const struct prt_material *to)
{
    if (b->of == PRT_VARIANT_OF_MODEL || b->of == PRT_VARIANT_OF_ANY_ETA) return PRT_OK;
    if (b->of == PRT_VARIANT_OF_FIXED && !same_transport(from, to))
        return needs_bake(b, baked, "changes the medium of");
    if (fabsf(from->eta - to->eta) > 1e-6f)
        return needs_bake(b, baked, "changes the refractive index of");
    return PRT_OK;
}

static int view_media(const struct base *b, struct prt_variant *v)
{
    const struct prt_mesh *mesh = b->mesh;
    const uint32_t n = mesh->n_block;
    const struct prt_material **of_block = prt_calloc(n, sizeof *of_block);
    struct prt_material *own = prt_alloc(n, sizeof *own);
    int status =
        of_block && own ? PRT_OK : prt_fail(b->ctx, PRT_NOMEM, "%s: no memory", b->model);
    for (uint32_t i = 0; i < n && !status; i++) {
        const struct prt_material *medium = prt_media_of(b->media, mesh->block[i].object);
        const uint32_t baked = mesh->block[i].surface, wanted = v->mesh.block[i].surface;
        of_block[i] = medium_of(b, baked, wanted, medium, &own[i]);
        if (of_block[i] == medium) continue;
        v->plain = false;
        status = check_medium(b, baked, medium, of_block[i]);
    }
    if (!status && v->plain) {
        v->media = prt_media_copy(b->media, mesh->n_object);
        if (!v->media) status = prt_fail(b->ctx, PRT_NOMEM, "%s: no memory", b->model);
    } else if (!status) {
        status = prt_media_create(b->ctx, &v->mesh, of_block, &v->media);
    }
    prt_free(of_block);
    prt_free(own);
    return status;
}

int prt_variant_create(const struct prt_context *ctx, const char *model,
                       const struct prt_mesh *mesh, const struct prt_media *media,
                       enum prt_variant_of of, const char *name, struct prt_variant **out)
{
    uint32_t index;
    struct base b = {ctx, model, "default", mesh, media, of};
    int status = prt_mesh_variant_find(ctx, model, mesh, name, &index);
    if (status) return status;
    if (index < mesh->n_variant) b.variant = mesh->variant[index].name;
    const size_t n = mesh->n_block;
    struct prt_variant *v = prt_calloc(1, sizeof *v + n * (sizeof *mesh->block + 12));
    if (!v) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", model);
    struct prt_block *block = (struct prt_block *)(v + 1);
    v->index = index;
    v->plain = true;
    v->mesh = *mesh;
    v->mesh.owner = v->mesh.parts = NULL;
    v->mesh.model = NULL;
    status = view_blocks(&b, v, block, (float(*)[3])(block + n));
    if (v->mesh.gain) v->plain = false;
    if (!status) status = view_media(&b, v);
    if (status) prt_variant_destroy(v);
    else *out = v;
    return status;
}

void prt_variant_destroy(struct prt_variant *variant)
{
    if (!variant) return;
    prt_free(variant->media);
    prt_free(variant);
}
