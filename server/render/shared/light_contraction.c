// SPDX-License-Identifier: MIT
// Joint transport contracted with a light, for any material. The first evaluation under a light
// uses a plain pass, which costs as much and stores nothing: lights that rotate are not reused.
// The second evaluation under the same light contracts it.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { KEY = RENDER_MAX_LIGHTS * sizeof(((struct render_light *)0)->key) + 200 };

struct light_contraction_job {
    struct cache_job job;
    struct cache_entry *file, *light;
};

static void destroy(void *value)
{
    struct light_contraction *c = value;
    prt_contracted_light_destroy(c->contracted);
    cache_release(c->file);
    free(c);
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct light_contraction_job *own = (struct light_contraction_job *)job;
    struct light_contraction *c = job->value = calloc(1, sizeof *c);
    if (!c) return PRT_NOMEM;
    int status = prt_contracted_light_create(ctx, prt_file_transport(own->file->value),
                                             own->light->value, &c->contracted);
    if (!status) job->bytes = sizeof *c + prt_contracted_light_bytes(c->contracted);
    return status;
}

static void done(struct cache_job *job)
{
    struct light_contraction *c = job->value;
    if (job->status) return;
    c->file = ((struct light_contraction_job *)job)->file;
    cache_hold(c->file);
    job->holds_file = true;
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct light_contraction_job), .run = run, .destroy = destroy, .done = done};

static bool contracts_light(const struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].storage == PRT_STORAGE_SPARSE) return false;
    return t->engine == PRT_TRANSPORT_JOINT;
}

// The contraction refers to this mapping of the file and holds it, so its address is unique.
static void contraction_key(const struct model *model, uint64_t generation,
                            const struct cache_entry *file, const struct cache_entry *light,
                            char key[KEY])
{
    snprintf(key, KEY, "%s/%llu/contracted/%llx/%s", model->key, (unsigned long long)generation,
             (unsigned long long)(uintptr_t)file->value, light->key);
}

struct cache_entry *light_contraction_find(struct model *model, uint64_t generation,
                                           const struct cache_entry *file,
                                           const struct cache_entry *light)
{
    char key[KEY];
    if (!contracts_light(prt_file_transport(file->value))) return NULL;
    contraction_key(model, generation, file, light, key);
    return cache_find(model->server->cache, key);
}

// True at the first evaluation under a light: an empty cache entry records it.
static bool first_use(struct model *model, uint64_t generation, const struct cache_entry *light)
{
    char key[KEY];
    bool fresh;
    snprintf(key, sizeof key, "%s/%llu/asked/%s", model->key, (unsigned long long)generation,
             light->key);
    struct cache_entry *used = cache_get(model->server->cache, key, &fresh);
    if (fresh) cache_fill(used, NULL, sizeof *used + strlen(key), NULL);
    cache_release(used);
    return fresh;
}

struct cache_entry *light_contraction_get(struct model *model, uint64_t generation,
                                          struct cache_entry *file, struct cache_entry *light)
{
    char key[KEY];
    struct cache_job *job;
    if (!contracts_light(prt_file_transport(file->value)) ||
        first_use(model, generation, light))
        return NULL;
    contraction_key(model, generation, file, light, key);
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    struct light_contraction_job *own = (struct light_contraction_job *)job;
    own->file = file;
    own->light = light;
    cache_job_hold(job, file);
    cache_job_hold(job, light);
    model->server->stats.contractions++;
    cache_job_submit(job);
    return entry;
}
