// SPDX-License-Identifier: MIT
// The media that a request gives a model's objects: its map of names, shared by the copies of a
// spec, and the media by object that follow from it for one model.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "frame.h"
#include "prt/media.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void media_map_release(struct media_map *map)
{
    if (map && !--map->refs) free(map);
}

struct media_map *media_map_create(unsigned n)
{
    struct media_map *map = calloc(1, sizeof *map + n * sizeof *map->entry);
    if (!map) return NULL;
    map->refs = 1;
    map->n = n;
    return map;
}

void media_map_set_key(struct media_map *map)
{
    struct relight_sha256 sha;
    char hex[65], material[MATERIAL_KEY];
    relight_sha256_init(&sha);
    for (unsigned i = 0; i < map->n; i++) {
        material_key(&map->entry[i].material, material);
        relight_sha256_add(&sha, map->entry[i].object, strlen(map->entry[i].object) + 1);
        relight_sha256_add(&sha, material, sizeof material);
    }
    relight_sha256_hex(&sha, hex);
    snprintf(map->key, sizeof map->key, "%.32s", hex);
}

void media_key(const struct render_spec *spec, char key[MEDIA_KEY])
{
    snprintf(key, MEDIA_KEY, "%s%s%s%s%s", spec->has_material ? spec->material_key : "",
             spec->objects ? "+" : "", spec->objects ? spec->objects->key : "",
             spec->variant_shines ? "~" : "", spec->variant_shines ? spec->variant : "");
}

// ---- one medium for all objects: no model is needed

static struct cache_entry *one_medium(struct server *server, const struct render_spec *spec)
{
    char key[MATERIAL_KEY + 16];
    bool fresh;
    snprintf(key, sizeof key, "medium/%s", spec->material_key);
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    if (!fresh) return entry;
    const struct prt_media one = prt_media_one(&spec->material);
    struct prt_media *media = prt_media_copy(&one, 0);
    if (media) cache_fill(entry, media, sizeof *media + sizeof spec->material, prt_free);
    else cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    return entry;
}

// ---- media by object, on a worker: names may be many

struct media_job {
    struct cache_job job;
    const struct prt_mesh *mesh;   // of the entry that the job holds
    const struct prt_media *media; // its own
    struct media_map *map;         // held
    bool has_material;
    struct prt_material material; // of all other objects
};

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct media_job *own = (struct media_job *)job;
    struct prt_media_entry entry[PRT_MEDIA_MAX + 1];
    unsigned n = own->map ? own->map->n : 0;
    for (unsigned i = 0; i < n; i++)
        entry[i] =
            (struct prt_media_entry){own->map->entry[i].object, &own->map->entry[i].material};
    if (own->has_material) entry[n++] = (struct prt_media_entry){NULL, &own->material};
    struct prt_media *media = NULL;
    int status = prt_media_edit(ctx, own->mesh, own->media, n, entry, &media);
    if (status) return status;
    job->value = media;
    job->bytes = sizeof *media + media->n * sizeof *media->medium + (size_t)own->mesh->n_object;
    return PRT_OK;
}

static void done(struct cache_job *job)
{
    media_map_release(((struct media_job *)job)->map);
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct media_job), .run = run, .destroy = prt_free, .done = done};

struct cache_entry *media_get(const struct model *model, const struct render_spec *spec,
                              struct cache_entry *owner, const struct prt_mesh *mesh,
                              const struct prt_media *media, uint64_t file_hash, bool own_media)
{
    char key[MEDIA_KEY + VARIANT_NAME + 120], own_key[MEDIA_KEY];
    struct cache_job *job;
    if (!spec->objects && spec->has_material) return one_medium(model->server, spec);
    if (!spec->objects && !own_media) return NULL;
    media_key(spec, own_key);
    // Names and objects are those of the file and its variant, whatever its vertices.
    snprintf(key, sizeof key, "%s/media/%llx/%s/%s", model->key, (unsigned long long)file_hash,
             own_key, spec->variant);
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    struct media_job *own = (struct media_job *)job;
    own->mesh = mesh;
    own->media = media;
    own->map = spec->objects;
    if (own->map) own->map->refs++;
    own->has_material = spec->has_material;
    own->material = spec->material;
    cache_job_hold(job, owner);
    cache_job_submit(job);
    return entry;
}
