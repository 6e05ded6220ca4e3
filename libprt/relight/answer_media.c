// SPDX-License-Identifier: MIT
// The media of a transport whose material is free: what they must agree with, which clusters
// are of which, and what a medium multiplies the planes of single scattering with.
#include "answer_parts.h"

#include <math.h>

bool prt_tensor_is_free(const struct prt_tensor *t)
{
    return t->coupling == PRT_COUPLE_FULL || t->storage == PRT_STORAGE_RADIAL;
}

// Whether an object has a translucent surface, which its medium is behind.
static bool has_inside(const struct prt_mesh *mesh, uint32_t object)
{
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (mesh->block[i].object == object &&
            mesh->surface[mesh->block[i].surface].translucent)
            return true;
    return false;
}

static int check_eta(const struct prt_context *ctx, const struct prt_material *m,
                     const float range[2])
{
    if (m->eta >= range[0] - 1e-4f && m->eta <= range[1] + 1e-4f) return PRT_OK;
    return prt_fail(ctx, PRT_MISMATCH,
                    "%s: eta is %g, this bake covers %g to %g (relative refractive index, no "
                    "unit): bake again without --any-eta for another",
                    m->name[0] ? m->name : "material", (double)m->eta, (double)range[0],
                    (double)range[1]);
}

int prt_free_media_check(const struct prt_context *ctx, const struct prt_transport *t,
                         const struct prt_media *media)
{
    bool any_free = false;
    for (uint32_t i = 0; i < t->n_tensor; i++) any_free |= prt_tensor_is_free(&t->tensor[i]);
    if (!any_free)
        return prt_fail(ctx, PRT_MISMATCH,
                        "a wavelet transport's material is fixed when it is baked: omit the "
                        "material, or bake a joint or polynomial transport");
    int status = prt_media_check(ctx, media, t->mesh.n_object);
    float range[2];
    const bool any_eta = prt_transport_any_eta(t, range);
    for (uint32_t i = 0; i < t->mesh.n_object && !status; i++) {
        const struct prt_material *m = prt_media_of(media, i),
                                  *baked = prt_media_of(&t->media, i);
        if (!has_inside(&t->mesh, i)) continue;
        if (any_eta) {
            status = check_eta(ctx, m, range);
            continue;
        }
        if (fabsf(m->eta - baked->eta) <= 1e-6f) continue;
        const char *name = t->media.n > 1 && t->mesh.object ? t->mesh.object[i].name : "";
        status = prt_fail(
            ctx, PRT_MISMATCH,
            "%s: eta is %g, this bake%s%s is for %g (relative refractive index, no "
            "unit): bake again for another%s",
            m->name[0] ? m->name : "material", (double)m->eta, *name ? " of " : "", name,
            (double)baked->eta,
            t->engine == PRT_TRANSPORT_JOINT ? ", or --any-eta for all from 1.2 to 1.6" : "");
    }
    return status;
}

// The object of a vertex, by bisection: blocks partition the vertices in order.
static uint32_t object_of(const struct prt_mesh *mesh, uint32_t vertex)
{
    uint32_t low = 0, high = mesh->n_block;
    while (high - low > 1) {
        const uint32_t middle = low + (high - low) / 2;
        if (mesh->block[middle].vertex_begin <= vertex) low = middle;
        else high = middle;
    }
    return mesh->block[low].object;
}

int prt_cluster_objects(const struct prt_transport *transport, const struct prt_tensor *tensor,
                        uint32_t **out)
{
    *out = NULL;
    if (transport->mesh.n_object < 2) return PRT_OK;
    uint32_t *object = prt_calloc(tensor->n_cluster + 1ull, sizeof *object);
    for (uint32_t c = 0; object && c < tensor->n_cluster; c++)
        if (tensor->cluster[c].n_vertex)
            object[c] =
                object_of(&transport->mesh, tensor->order[tensor->cluster[c].vertex_begin]);
    *out = object;
    return object ? PRT_OK : PRT_NOMEM;
}

int prt_cluster_media(const struct prt_transport *transport, const struct prt_tensor *tensor,
                      const struct prt_media *media, uint8_t **out)
{
    *out = NULL;
    if (media->n == 1) return PRT_OK;
    uint8_t *medium = prt_calloc(tensor->n_cluster + 1ull, 1);
    for (uint32_t c = 0; medium && c < tensor->n_cluster; c++) {
        if (!tensor->cluster[c].n_vertex) continue;
        const uint32_t first = tensor->order[tensor->cluster[c].vertex_begin];
        medium[c] = (uint8_t)prt_media_index(media, object_of(&transport->mesh, first));
    }
    *out = medium;
    return medium ? PRT_OK : PRT_NOMEM;
}

void prt_phase_plane_factor(const struct prt_material *material,
                            const struct prt_tensor *tensor, unsigned k, float factor[3])
{
    unsigned l = k == 0 ? 0 : k < 4 ? 1 : k < 9 ? 2 : 3;
    for (int ch = 0; ch < 3; ch++) {
        struct prt_phase phase;
        float g = material->g[ch];
        factor[ch] = tensor->term == PRT_TERM_VIEW ? material->sigma_s_prime[ch] / (1 - g) : 1;
        if (tensor->term == PRT_TERM_VIEW) continue; // planes of the exit, for an even phase
        if (!prt_phase_hg(&phase, (double)g, tensor->n_phase))
            factor[ch] = (float)phase.a[l] * material->sigma_s_prime[ch] / (1 - g);
    }
}

// Whether some medium scatters singly.
bool prt_media_scatter_singly(const struct prt_media *media)
{
    bool any = false;
    for (uint32_t i = 0; i < media->n; i++) any |= !media->medium[i].profile;
    return any;
}

// Media scatter evenly unless some g is not 0: their planes from 1 on are 0.
bool prt_media_scatter_evenly(const struct prt_media *media)
{
    bool even = true;
    for (uint32_t i = 0; i < media->n; i++) {
        const struct prt_material *m = &media->medium[i];
        even &= !m->profile && m->g[0] == 0 && m->g[1] == 0 && m->g[2] == 0;
    }
    return even;
}
