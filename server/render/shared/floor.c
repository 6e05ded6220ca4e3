// SPDX-License-Identifier: MIT
// The shadow of a model on the floor under it, for one camera and light: traced on a worker.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "prt/screen.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct floor_job {
    struct cache_job job;
    const struct prt_mesh *mesh; // of an entry that the job holds
    struct cache_entry *visibility, *light;
    size_t pixels;
};

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct floor_job *own = (struct floor_job *)job;
    float *shadow = NULL;
    int status =
        prt_floor_shadow(ctx, own->mesh, own->visibility->value, own->light->value, &shadow);
    job->value = shadow;
    job->bytes = own->pixels * 3 * sizeof *shadow;
    return status;
}

static const struct cache_job_kind kind = {.size = sizeof(struct floor_job),
                                           .class = WORK_BACKGROUND,
                                           .run = run,
                                           .destroy = prt_free};

struct cache_entry *floor_get(struct server *server, struct cache_entry *owner,
                              const struct prt_mesh *mesh, struct cache_entry *visibility,
                              struct cache_entry *light, size_t pixels)
{
    struct cache_job *job;
    const size_t size = strlen(visibility->key) + strlen(light->key) + 16;
    char *key = malloc(size);
    if (!key) return NULL;
    snprintf(key, size, "%s/floor/%s", visibility->key, light->key);
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    free(key);
    if (!job) return entry;
    struct floor_job *own = (struct floor_job *)job;
    own->mesh = mesh;
    own->visibility = visibility;
    own->light = light;
    own->pixels = pixels;
    cache_job_hold(job, owner);
    cache_job_hold(job, visibility);
    cache_job_hold(job, light);
    cache_job_submit(job);
    return entry;
}
