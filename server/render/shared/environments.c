// SPDX-License-Identifier: MIT
// Environments by name: uploaded images through the decode helper, and constant ones.
#include "render/render.h"

#include "core/log.h"
#include "render/shared/cache_compute.h"
#include "prt/base.h"
#include "net/request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { CONSTANT_CUBE = 4 };

int env_canonical(const char *env, char out[96], char error[300])
{
    float c[3] = {1, 1, 1};
    char tail;
    if (!strncmp(env, "env:", 4) && relight_hash_valid(env + 4)) {
        snprintf(out, 96, "%s", env);
        return 0;
    }
    bool plain = !strcmp(env, "constant");
    if (!plain && (strncmp(env, "constant:", 9) ||
                   sscanf(env + 9, "%f,%f,%f%c", &c[0], &c[1], &c[2], &tail) != 3)) {
        snprintf(error, 300, "light.env %.60s: neither env:HASH nor constant[:R,G,B]", env);
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    for (int i = 0; i < 3; i++)
        if (!(c[i] >= 0 && c[i] <= 1e6f)) {
            return range_refuse(error, 300, (double)c[i], 0, 1e6, "", "light.env");
        }
    snprintf(out, 96, "constant:%.9g,%.9g,%.9g", (double)c[0], (double)c[1], (double)c[2]);
    return 0;
}

int env_of_request(const struct request *request, const char *env, char out[96],
                   char error[300])
{
    if (strncmp(env, "name:", 5)) return env_canonical(env, out, error);
    const char *hash =
        blobs_image_named(request->server->blobs, request->conn->caller.name, env + 5);
    if (hash) snprintf(out, 96, "env:%s", hash);
    else
        snprintf(error, 300,
                 "light.env %.100s: this client uploaded no image of this name; LIST has the "
                 "names",
                 env);
    return hash ? 0 : RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
}

static void fill_constant(struct cache_entry *entry, const char *env)
{
    size_t n = (size_t)6 * CONSTANT_CUBE * CONSTANT_CUBE;
    float c[3] = {0};
    struct decoded_env *d = calloc(1, sizeof *d + n * 3 * sizeof(float));
    if (!d) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    sscanf(env, "constant:%f,%f,%f", &c[0], &c[1], &c[2]);
    float *texel = (float *)(d + 1);
    for (size_t i = 0; i < 3 * n; i++) texel[i] = c[i % 3];
    d->env.kind = PRT_ENV_CUBE;
    d->env.cube = (struct prt_cube){CONSTANT_CUBE, texel};
    cache_fill(entry, d, sizeof *d + n * 12, decoded_env_destroy);
}

static void decoded(void *user, struct decoded_env *env, int status, const char *error)
{
    struct cache_entry *entry = user;
    if (env) {
        log_line(LOG_EVENT, "environment env=%s ms=%.1f", entry->key, (double)env->decode_ms);
        entry->ms = env->decode_ms;
        entry->any_thread = true;
        cache_fill(entry, env, env->map_bytes + env->cache_bytes, decoded_env_destroy);
    } else {
        cache_fail(entry, error_of_status(status), error);
    }
    cache_release(entry);
}

// An upload on its way to its entry: it is checked, then decoded.
struct upload_wait {
    struct blob_waiter waiter; // first
    struct server *server;
    struct cache_entry *entry;
    upload_decoder_fn decode;
    decode_fn fn;
    bool decoding;
    char hash[BLOB_HASH + 1];
};

static void upload_decoded(void *user, struct decoded_env *env, int status, const char *error)
{
    struct upload_wait *w = user;
    w->entry->unwanted = NULL;
    w->fn(w->entry, env, status, error);
    free(w);
}

static void upload_checked(struct blob_waiter *waiter)
{
    struct upload_wait *w = (struct upload_wait *)waiter;
    struct server *server = w->server;
    char path[4096], name[300];
    blobs_name(server->blobs, NULL, w->hash, name, sizeof name);
    if (server->decoder && blobs_has(server->blobs, w->hash)) {
        blobs_path(server->blobs, w->hash, path, sizeof path);
        w->decoding = true;
        w->decode(server->decoder, path, name, upload_decoded, w);
        return;
    }
    snprintf(path, sizeof path, "%s was damaged on the daemon's disk: upload it again", name);
    w->entry->unwanted = NULL;
    cache_fail(w->entry, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, path);
    cache_release(w->entry);
    free(w);
}

// Nobody waits for the entry any more: it leaves the queue that it is in.
static void upload_unwanted(struct cache_entry *entry)
{
    struct upload_wait *w = entry->job;
    if (w->decoding) {
        if (w->server->decoder) decoder_withdraw(w->server->decoder, w);
        return;
    }
    blobs_check_leave(w->server->blobs, w->hash, &w->waiter);
    upload_decoded(w, NULL, PRT_CANCELLED, "nobody waits for it any more");
}

void upload_decode(struct server *server, const char *hash, struct cache_entry *entry,
                   upload_decoder_fn decode, decode_fn fn)
{
    struct upload_wait *w = calloc(1, sizeof *w);
    if (!w) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        cache_release(entry);
        return;
    }
    *w = (struct upload_wait){.waiter.wake = upload_checked,
                              .server = server,
                              .entry = entry,
                              .decode = decode,
                              .fn = fn};
    memcpy(w->hash, hash, BLOB_HASH);
    entry->job = w;
    entry->unwanted = upload_unwanted;
    blobs_touch(server->blobs,
                hash); // marks it as used: it must not be evicted before it is read
    blobs_check(server->blobs, hash, &w->waiter);
}

struct cache_entry *env_get(struct server *server, const char *env, int *code, char error[300])
{
    bool fresh, uploaded = !strncmp(env, "env:", 4);
    struct cache_entry *entry = cache_find(server->cache, env);
    if (entry) return entry;
    if (uploaded && !blobs_has(server->blobs, env + 4)) {
        *code = RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
        snprintf(error, 300, "light.env %.16s…: no such upload", env);
        return NULL;
    }
    entry = cache_get(server->cache, env, &fresh);
    if (!fresh) return entry; // no memory
    if (!uploaded) {
        fill_constant(entry, env);
        return entry;
    }
    cache_hold(entry); // for the decoder
    upload_decode(server, env + 4, entry, decoder_env, decoded);
    return entry;
}

// ---- texels of a request that are turned

struct texels_job {
    struct cache_job job;
    struct held_bytes *held;
    struct prt_cube texels; // in held
};

static void destroy_texels(void *value)
{
    struct decoded_env *d = value;
    prt_cube_finish(&d->env.cube);
    decoded_env_destroy(d);
}

static int copy_texels(struct cache_job *job, const struct prt_context *ctx)
{
    (void)ctx;
    const struct prt_cube *from = &((struct texels_job *)job)->texels;
    const size_t bytes = (size_t)72 * from->n * from->n;
    struct decoded_env *d = job->value = calloc(1, sizeof *d);
    if (!d) return PRT_NOMEM;
    d->env.kind = PRT_ENV_CUBE;
    int status = prt_cube_init(&d->env.cube, from->n);
    if (!status) memcpy(d->env.cube.texel, from->texel, bytes);
    if (!status) status = prt_env_cache_create(&d->env);
    d->cache_bytes =
        PRT_ENV_TURNED_BYTES(32) + PRT_ENV_TURNED_BYTES(16) + (size_t)384 * from->n * from->n;
    job->bytes = sizeof *d + bytes + d->cache_bytes;
    return status;
}

static void texels_copied(struct cache_job *job)
{
    held_bytes_release(((struct texels_job *)job)->held);
}

// Whether the same texels were turned before, by another angle: the cache remembers the first
// one.
static bool turned_before(struct server *server, const char *source, double rotate_deg)
{
    enum { COUNTED = 400 }; // bytes of an entry that has a number
    char key[sizeof(((struct render_light *)0)->key) + 8];
    bool fresh;
    snprintf(key, sizeof key, "turn/%s", source);
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    double *angle = fresh ? malloc(sizeof *angle) : NULL;
    if (angle) {
        *angle = rotate_deg;
        cache_fill(entry, angle, COUNTED, free);
    } else if (fresh) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    }
    const bool before =
        !fresh && entry->state == CACHE_READY && *(double *)entry->value != rotate_deg;
    cache_release(entry);
    return before;
}

struct cache_entry *env_of_texels(struct server *server, const struct render_spec *spec,
                                  const struct render_light *light)
{
    static const struct cache_job_kind kind = {.size = sizeof(struct texels_job),
                                               .run = copy_texels,
                                               .destroy = destroy_texels,
                                               .done = texels_copied};
    struct cache_job *job;
    char source[sizeof light->key], key[sizeof light->key + 8];
    snprintf(source, sizeof source, "%.*s", (int)strcspn(light->key, "@"), light->key);
    snprintf(key, sizeof key, "env/%s", source);
    struct cache_entry *entry = cache_find(server->cache, key);
    if (entry || !turned_before(server, source, light->rotate_deg)) return entry;
    entry = cache_compute(server, key, &kind, &job);
    if (!job) return entry;
    struct texels_job *t = (struct texels_job *)job;
    t->held = spec->texels;
    held_bytes_hold(t->held);
    // copy_texels() reads them only; struct prt_cube has no const texels.
    t->texels =
        (struct prt_cube){light->cube_n, (float *)(uintptr_t)render_texels(spec, light)};
    cache_job_submit(job);
    return entry;
}
