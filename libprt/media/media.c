// SPDX-License-Identifier: MIT
// The map from a model's objects to their media, by the names of materials and nodes.
#include "prt/media.h"

#include <stdlib.h>
#include <string.h>

size_t prt_media_name_length(const char *argument)
{
    size_t n = strcspn(argument, "={/");
    return argument[n] == '=' ? n : 0;
}

static const char *surface_name(const struct prt_mesh *mesh, uint32_t block)
{
    return mesh->surface[mesh->block[block].surface].name;
}

static const char *object_name(const struct prt_mesh *mesh, uint32_t block)
{
    return mesh->object ? mesh->object[mesh->block[block].object].name : "";
}

static bool translucent(const struct prt_mesh *mesh, uint32_t block)
{
    return mesh->surface[mesh->block[block].surface].translucent != 0;
}

static bool has_name(const struct prt_mesh *mesh, uint32_t block, const char *name)
{
    return !strcmp(surface_name(mesh, block), name) || !strcmp(object_name(mesh, block), name);
}

static int compare(const void *a, const void *b)
{
    return strcmp(*(const char *const *)a, *(const char *const *)b);
}

// The distinct names of translucent blocks' materials and nodes, to prt_free(); NULL without
// memory.
static const char **list_names(const struct prt_mesh *mesh, unsigned *n)
{
    const char **name = prt_alloc(2 * (size_t)mesh->n_block, sizeof *name);
    unsigned all = 0;
    *n = 0;
    for (uint32_t i = 0; name && i < mesh->n_block; i++) {
        if (!translucent(mesh, i)) continue;
        if (*surface_name(mesh, i)) name[all++] = surface_name(mesh, i);
        if (*object_name(mesh, i)) name[all++] = object_name(mesh, i);
    }
    if (name) qsort(name, all, sizeof *name, compare);
    for (unsigned i = 0; i < all; i++)
        if (!*n || strcmp(name[*n - 1], name[i])) name[(*n)++] = name[i];
    return name;
}

static int unknown_name(const struct prt_context *ctx, const struct prt_mesh *mesh,
                        const char *text, const char *say)
{
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (has_name(mesh, i, text))
            return prt_fail(ctx, PRT_ARG,
                            "material of \"%.63s\": it is opaque, and has no medium", text);
    return prt_fail(ctx, PRT_ARG,
                    "material of \"%.63s\": the model has no translucent material or node of "
                    "this name%s%s",
                    text, *say ? "; " : "", say);
}

// Names a part of the blocks; named[i] is set where an entry did.
static int assign_named(const struct prt_context *ctx, const struct prt_mesh *mesh,
                        const struct prt_media_entry *entry, const char *const *name,
                        unsigned n_name, uint8_t *named, const struct prt_material *of_block[])
{
    char say[640];
    int found = prt_name_choose(entry->object, name, n_name, say, sizeof say);
    if (found < 0) return unknown_name(ctx, mesh, entry->object, say);
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        if (!translucent(mesh, i) || !has_name(mesh, i, name[found])) continue;
        if (named[i])
            return prt_fail(ctx, PRT_ARG,
                            "material of \"%.63s\": another entry gives it a material, too",
                            entry->object);
        named[i] = 1;
        of_block[i] = entry->material;
    }
    return PRT_OK;
}

static bool of_others(const struct prt_media_entry *entry)
{
    return !entry->object || !*entry->object;
}

int prt_media_assign(const struct prt_context *ctx, const struct prt_mesh *mesh, unsigned n,
                     const struct prt_media_entry entry[],
                     const struct prt_material *of_block[])
{
    const struct prt_material *others = NULL;
    unsigned n_name = 0;
    if (n > PRT_MEDIA_MAX + 1)
        return prt_fail(ctx, PRT_ARG, "%u materials by object: at most %d", n, PRT_MEDIA_MAX);
    const char **name = list_names(mesh, &n_name);
    uint8_t *named = prt_calloc(mesh->n_block, 1);
    int status = name && named ? PRT_OK : prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    for (unsigned i = 0; i < n && !status; i++) {
        if (of_others(&entry[i]) && others)
            status = prt_fail(ctx, PRT_ARG,
                              "two materials are for all objects: name the object of one");
        else if (of_others(&entry[i])) others = entry[i].material;
        else status = assign_named(ctx, mesh, &entry[i], name, n_name, named, of_block);
    }
    for (uint32_t i = 0; i < mesh->n_block && others && !status; i++)
        if (translucent(mesh, i) && !named[i]) of_block[i] = others;
    prt_free(name);
    prt_free(named);
    return status;
}

// Distinct media among the translucent blocks.
struct distinct {
    uint32_t n;
    const struct prt_material *medium[PRT_MEDIA_MAX];
    uint64_t hash[PRT_MEDIA_MAX];
};

// The number of a medium, PRT_MEDIA_MAX when there are too many.
static uint32_t number_of(struct distinct *d, const struct prt_material *material)
{
    uint32_t i = 0;
    while (i < d->n && d->medium[i] != material) i++;
    if (i < d->n) return i;
    const uint64_t hash = prt_material_hash(material);
    for (i = 0; i < d->n; i++)
        if (d->hash[i] == hash && !strcmp(d->medium[i]->name, material->name)) return i;
    if (d->n == PRT_MEDIA_MAX) return PRT_MEDIA_MAX;
    d->medium[d->n] = material;
    d->hash[d->n] = hash;
    return d->n++;
}

// number[n_block] of each block's medium; an opaque block has that of its object, or 0.
static int number_blocks(const struct prt_context *ctx, const struct prt_mesh *mesh,
                         const struct prt_material *const of_block[], struct distinct *d,
                         uint32_t *number)
{
    d->n = 0;
    for (uint32_t i = 0; i < mesh->n_block; i++) {
        number[i] = UINT32_MAX;
        if (!translucent(mesh, i)) continue;
        if (!of_block[i])
            return prt_fail(ctx, PRT_ARG,
                            "\"%.63s\" has no material: give it one by name, or one for all "
                            "others",
                            *surface_name(mesh, i) ? surface_name(mesh, i)
                                                   : object_name(mesh, i));
        if ((number[i] = number_of(d, of_block[i])) == PRT_MEDIA_MAX)
            return prt_fail(ctx, PRT_ARG, "the model has more than %d different materials",
                            PRT_MEDIA_MAX);
    }
    uint32_t *first = prt_alloc(mesh->n_object, sizeof *first);
    if (!first) return prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    memset(first, 0, mesh->n_object * sizeof *first);
    for (uint32_t i = mesh->n_block; i-- > 0;)
        if (number[i] != UINT32_MAX) first[mesh->block[i].object] = number[i];
    for (uint32_t i = 0; i < mesh->n_block; i++)
        if (number[i] == UINT32_MAX) number[i] = first[mesh->block[i].object];
    prt_free(first);
    return PRT_OK;
}

int prt_media_divide(const struct prt_context *ctx, struct prt_mesh *mesh,
                     const struct prt_material *const of_block[])
{
    struct distinct d;
    uint32_t *number = prt_alloc(mesh->n_block, sizeof *number), before = mesh->n_object;
    int status = number ? number_blocks(ctx, mesh, of_block, &d, number)
                        : prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    if (!status) status = prt_mesh_divide(ctx, mesh, number);
    if (!status && mesh->n_object != before)
        prt_log(ctx, PRT_LOG_NOTE,
                "%u objects of several media are divided: there are %u bodies, and light does "
                "not scatter from one into another",
                before, mesh->n_object);
    prt_free(number);
    return status;
}

// number[] by block to of_object[]; PRT_ARG where blocks of one object differ.
static int by_object(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const uint32_t *number, uint8_t *of_object)
{
    uint32_t *first = prt_alloc(mesh->n_object, sizeof *first);
    int status = first ? PRT_OK : prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    if (first) memset(first, 0xff, mesh->n_object * sizeof *first);
    for (uint32_t i = 0; i < mesh->n_block && !status; i++) {
        const uint32_t object = mesh->block[i].object;
        if (first[object] == UINT32_MAX) first[object] = i;
        of_object[object] = (uint8_t)number[i];
        if (number[first[object]] != number[i])
            status =
                prt_fail(ctx, PRT_ARG,
                         "\"%.63s\" and \"%.63s\" are one body, which has one medium: name "
                         "both, or load the model with different materials for them",
                         surface_name(mesh, first[object]), surface_name(mesh, i));
    }
    prt_free(first);
    return status;
}

int prt_media_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                     const struct prt_material *const of_block[], struct prt_media **out)
{
    struct distinct d;
    uint32_t *number = prt_alloc(mesh->n_block, sizeof *number);
    uint8_t *of_object = prt_calloc(mesh->n_object, 1);
    struct prt_material *medium = NULL;
    struct prt_media *made = NULL;
    int status = number && of_object ? number_blocks(ctx, mesh, of_block, &d, number)
                                     : prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    if (!status) status = by_object(ctx, mesh, number, of_object);
    if (!status && !d.n) status = prt_fail(ctx, PRT_ARG, "nothing is translucent");
    if (!status) {
        medium = prt_alloc(d.n, sizeof *medium);
        for (uint32_t i = 0; medium && i < d.n; i++) medium[i] = *d.medium[i];
        const struct prt_media view = {d.n, medium, d.n > 1 ? of_object : NULL};
        made = medium ? prt_media_copy(&view, mesh->n_object) : NULL;
        if (!made) status = prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    }
    if (!status) *out = made;
    prt_free(medium);
    prt_free(number);
    prt_free(of_object);
    return status;
}

int prt_media_edit(const struct prt_context *ctx, const struct prt_mesh *mesh,
                   const struct prt_media *base, unsigned n,
                   const struct prt_media_entry entry[], struct prt_media **out)
{
    const struct prt_material **of_block = prt_alloc(mesh->n_block, sizeof *of_block);
    if (!of_block) return prt_fail(ctx, PRT_NOMEM, "no memory for the media");
    for (uint32_t i = 0; i < mesh->n_block; i++)
        of_block[i] = prt_media_of(base, mesh->block[i].object);
    int status = prt_media_assign(ctx, mesh, n, entry, of_block);
    if (!status) status = prt_media_create(ctx, mesh, of_block, out);
    prt_free(of_block);
    return status;
}
