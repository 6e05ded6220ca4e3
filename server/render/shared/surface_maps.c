// SPDX-License-Identifier: MIT
// Uploaded images as maps over a model's uv: decoded by the helper process, then converted on a
// worker for the image-space engines. The cache keeps the decoded image and the map.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAP_SIDE = 1024 }; // texels a side at most; chosen, not measured

static void decoded(void *user, struct decoded_env *image, int status, const char *error)
{
    struct cache_entry *entry = user;
    if (image) cache_fill(entry, image, image->map_bytes, decoded_env_destroy);
    else cache_fail(entry, error_of_status(status), error);
    cache_release(entry);
}

// The decoded pixels, with a reference for the caller.
static struct cache_entry *image_get(struct server *server, const char *hash)
{
    char key[80];
    bool fresh;
    snprintf(key, sizeof key, "image:%s", hash);
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    if (!fresh) return entry;
    cache_hold(entry); // for the decoder
    upload_decode(server, hash, entry, decoder_image, decoded);
    return entry;
}

struct surface_map_job {
    struct cache_job job;
    struct cache_entry *image;
    enum prt_screen_map_kind kind;
    struct prt_material material;
    float bump_mm;
    char hash[BLOB_HASH + 1];
    bool linear; // texels are linear values; otherwise they are sRGB
};

static void destroy(void *value)
{
    prt_screen_map_finish(value);
    free(value);
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct surface_map_job *own = (struct surface_map_job *)job;
    const struct decoded_env *image = own->image->value;
    struct prt_screen_map *map = job->value = calloc(1, sizeof *map);
    if (!map) return PRT_NOMEM;
    int status = prt_screen_map_make(ctx, own->kind, &image->env.latlong, own->linear, MAP_SIDE,
                                     &own->material, own->bump_mm, map);
    job->bytes = sizeof *map + (size_t)map->width * map->height * sizeof *map->rgb;
    return status;
}

static const struct cache_job_kind kind_of_job = {
    .size = sizeof(struct surface_map_job), .run = run, .destroy = destroy};

static void image_ready(struct cache_job *job)
{
    struct surface_map_job *own = (struct surface_map_job *)job;
    // By the file's content: its name differs between those who upload it.
    own->linear = blobs_format(job->server->blobs, own->hash) == BLOB_FLOATS;
    cache_job_submit(job);
}

struct cache_entry *surface_map_get(struct server *server, enum prt_screen_map_kind kind,
                                    const char *hash, const struct prt_material *material,
                                    float bump_mm, int *code, char error[300])
{
    char key[160], medium[MATERIAL_KEY] = "";
    bool albedo = kind == PRT_SCREEN_MAP_ALBEDO, height = kind == PRT_SCREEN_MAP_HEIGHT;
    if (albedo) material_key(material, medium);
    snprintf(key, sizeof key, "map/%d/%s/%s/%.9g", (int)kind, hash, medium,
             height ? (double)bump_mm : 0);
    struct cache_entry *entry = cache_find(server->cache, key);
    if (entry) return entry;
    if (!blobs_has(server->blobs, hash)) {
        static const char *const word[] = {"albedo", "normal", "bump"};
        *code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        snprintf(error, 300, "shade.%s_map %.16s…: no such upload", word[kind], hash);
        return NULL;
    }
    struct cache_job *job;
    entry = cache_compute(server, key, &kind_of_job, &job);
    if (!job) return entry;
    struct surface_map_job *own = (struct surface_map_job *)job;
    own->image = image_get(server, hash);
    own->kind = kind;
    own->material = *material;
    own->bump_mm = bump_mm;
    memcpy(own->hash, hash, BLOB_HASH);
    cache_job_hold(job, own->image);
    cache_release(own->image); // the job holds it
    cache_job_await(job, own->image, image_ready);
    return entry;
}
