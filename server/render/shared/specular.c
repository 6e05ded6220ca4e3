// SPDX-License-Identifier: MIT
// Environments filtered for reflection. A light that turns needs no other: shading turns the
// mirror directions.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct specular_job {
    struct cache_job job;
    struct cache_entry *light;
};

static void destroy(void *value)
{
    prt_specular_destroy(value);
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    const struct cache_entry *light = ((struct specular_job *)job)->light;
    struct prt_specular *specular = NULL;
    int status = prt_specular_create(ctx, light->value, &specular);
    job->value = specular;
    job->bytes = prt_specular_bytes();
    return status;
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct specular_job), .run = run, .destroy = destroy};

struct cache_entry *specular_get(struct server *server, struct cache_entry *light)
{
    struct cache_job *job;
    const size_t size = strlen(light->key) + 16;
    char *key = malloc(size);
    if (!key) return NULL;
    snprintf(key, size, "specular/%s", light->key);
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    free(key);
    if (!job) return entry;
    ((struct specular_job *)job)->light = light;
    cache_job_hold(job, light);
    cache_job_await(job, light, cache_job_submit);
    return entry;
}
