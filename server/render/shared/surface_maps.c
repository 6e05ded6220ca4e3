// SPDX-License-Identifier: MIT
// Uploaded images as maps over a model's uv: decoded by the helper process, then made into what
// image-space engines read, on a worker; both are kept in the cache.
#include "render/evaluation.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { MAP_SIDE = 1024 };

static void decoded(void *user, struct decoded_env *image, int status, const char *error)
{
    struct cache_entry *entry = user;
    entry->any_thread = true;
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

struct making {
    struct work work;
    struct cache_waiter waiter;
    struct server *server;
    struct cache_entry *entry, *image;
    enum prt_screen_map_kind kind;
    struct prt_material material;
    float bump_mm;
    char hash[BLOB_HASH + 1];
    bool linear; // numbers as they are meant; others are sRGB
    struct prt_screen_map *map;
};

static void destroy_map(void *value)
{
    prt_screen_map_finish(value);
    free(value);
}

static void end_making(struct making *m)
{
    cache_release(m->entry);
    cache_release(m->image);
    free(m);
}

static int run_making(struct work *work, const struct prt_context *ctx)
{
    struct making *m = (struct making *)work;
    const struct decoded_env *image = m->image->value;
    m->map = calloc(1, sizeof *m->map);
    if (!m->map) return PRT_NOMEM;
    return prt_screen_map_make(ctx, m->kind, &image->env.latlong, m->linear, MAP_SIDE,
                               &m->material, m->bump_mm, m->map);
}

static void done_making(struct work *work)
{
    struct making *m = (struct making *)work;
    if (work->status) {
        if (m->map) destroy_map(m->map);
        cache_fail(m->entry, error_of_status(work->status), work->error);
    } else {
        size_t bytes = (size_t)m->map->width * m->map->height * sizeof *m->map->rgb;
        cache_fill(m->entry, m->map, sizeof *m->map + bytes, destroy_map);
    }
    end_making(m);
}

static void image_ready(struct cache_waiter *waiter)
{
    struct making *m = (struct making *)((char *)waiter - offsetof(struct making, waiter));
    if (m->image->state == CACHE_FAILED) {
        cache_fail(m->entry, m->image->error_code, m->image->error);
        end_making(m);
        return;
    }
    // By its content: names differ between those who upload it.
    m->linear = blobs_format(m->server->blobs, m->hash) == BLOB_FLOATS;
    m->work.run = run_making;
    m->work.done = done_making;
    work_submit(m->server->work, &m->work);
}

struct cache_entry *surface_map_get(struct server *server, enum prt_screen_map_kind kind,
                                    const char *hash, const struct prt_material *material,
                                    float bump_mm, int *code, char error[300])
{
    char key[160], medium[MATERIAL_KEY] = "";
    bool fresh;
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
    struct making *m = calloc(1, sizeof *m);
    if (!m) {
        *code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
        snprintf(error, 300, "not enough memory");
        return NULL;
    }
    entry = cache_get(server->cache, key, &fresh);
    *m = (struct making){.server = server,
                         .entry = entry,
                         .image = image_get(server, hash),
                         .kind = kind,
                         .material = *material,
                         .bump_mm = bump_mm};
    memcpy(m->hash, hash, BLOB_HASH);
    cache_hold(entry); // one for the making, one for the caller
    m->waiter.wake = image_ready;
    if (m->image->state == CACHE_PENDING) cache_wait(m->image, &m->waiter);
    else image_ready(&m->waiter);
    return entry;
}
