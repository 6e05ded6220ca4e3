// SPDX-License-Identifier: MIT
// The media of a model's objects: checks, copies, hashes.
#include "prt/medium.h"

#include <string.h>

int prt_media_check(const struct prt_context *ctx, const struct prt_media *media,
                    uint32_t n_object)
{
    int status = PRT_OK;
    if (!media->n || media->n > PRT_MEDIA_MAX || !media->medium)
        return prt_fail(ctx, PRT_ARG, "a model has 1 to %d media, not %u", PRT_MEDIA_MAX,
                        media->n);
    for (uint32_t i = 0; media->of_object && i < n_object; i++)
        if (media->of_object[i] >= media->n)
            return prt_fail(ctx, PRT_ARG, "object %u has medium %u of %u", i,
                            media->of_object[i], media->n);
    for (uint32_t i = 0; i < media->n && !status; i++)
        status = prt_material_check(ctx, &media->medium[i]);
    return status;
}

struct prt_media *prt_media_copy(const struct prt_media *media, uint32_t n_object)
{
    const size_t materials = media->n * sizeof *media->medium;
    const size_t objects = media->of_object ? n_object : 0;
    struct prt_media *copy = prt_alloc(sizeof *copy + materials + objects, 1);
    if (!copy) return NULL;
    struct prt_material *medium = (struct prt_material *)(copy + 1);
    uint8_t *of_object = (uint8_t *)(medium + media->n);
    memcpy(medium, media->medium, materials);
    if (objects) memcpy(of_object, media->of_object, objects);
    *copy = (struct prt_media){media->n, medium, objects ? of_object : NULL};
    return copy;
}

uint64_t prt_media_hash(const struct prt_media *media, uint32_t n_object)
{
    uint64_t hash = prt_material_hash(&media->medium[0]), own[PRT_MEDIA_MAX];
    bool one = true;
    if (!media->of_object) return hash;
    for (uint32_t i = 0; i < media->n; i++) own[i] = prt_material_hash(&media->medium[i]);
    hash = own[media->of_object[0]];
    for (uint32_t i = 0; i < n_object; i++) one &= own[media->of_object[i]] == hash;
    for (uint32_t i = 0; i < n_object && !one; i++)
        hash = prt_hash64(&own[media->of_object[i]], sizeof *own, hash);
    return hash;
}

uint32_t prt_media_etas(const struct prt_media *media, double eta[])
{
    uint32_t n = 0;
    for (uint32_t i = 0; i < media->n; i++) {
        uint32_t k = 0;
        while (k < n && eta[k] != (double)media->medium[i].eta) k++;
        if (k == n) eta[n++] = (double)media->medium[i].eta;
    }
    return n;
}
