// SPDX-License-Identifier: MIT
// Joint transport contracted with media, for any light: each new light then costs as much
// as with wavelet transport. It is made once so many lights were used with the material, on a
// background worker; no evaluation waits for it, and a plain pass serves until it is ready.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// Lights that a material was used with before it is contracted; chosen, not measured.
enum { LIGHTS_BEFORE = 8, PREFIX = 300 };

struct material_contraction_job {
    struct cache_job job;
    struct cache_entry *file;
    struct cache_entry *media; // NULL: the bake's
    size_t most;               // bytes with columns (prt/columns.h)
};

static void destroy(void *value)
{
    struct material_contraction *c = value;
    prt_contracted_transport_destroy(c->contracted);
    cache_release(c->file);
    free(c);
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct material_contraction_job *own = (struct material_contraction_job *)job;
    struct material_contraction *c = job->value = calloc(1, sizeof *c);
    struct prt_context one_thread = *ctx; // the other workers serve requests meanwhile
    if (!c) return PRT_NOMEM;
    one_thread.pool = NULL;
    const struct prt_transport *t = prt_file_transport(own->file->value);
    int status = prt_contracted_transport_create(
        &one_thread, t, own->media ? own->media->value : &t->media, &c->contracted);
    // Rows take less than twice their bytes with columns.
    if (!status && prt_contracted_transport_bytes(c->contracted) <= own->most / 2)
        status = prt_contracted_transport_columns(&one_thread, c->contracted);
    if (!status) job->bytes = sizeof *c + prt_contracted_transport_bytes(c->contracted);
    return status;
}

static void done(struct cache_job *job)
{
    struct material_contraction *c = job->value;
    if (job->status) return;
    c->file = ((struct material_contraction_job *)job)->file;
    cache_hold(c->file);
    job->holds_file = true;
}

static const struct cache_job_kind kind = {.size = sizeof(struct material_contraction_job),
                                           .class = WORK_BACKGROUND,
                                           .run = run,
                                           .destroy = destroy,
                                           .done = done};

static struct cache_entry *compute(struct server *server, const char *key,
                                   struct cache_entry *file, struct cache_entry *media)
{
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    if (!job) return entry;
    struct material_contraction_job *own = (struct material_contraction_job *)job;
    own->file = file;
    own->media = media;
    own->most = server->options.cache / 4;
    cache_job_hold(job, media);
    cache_job_hold(job, file);
    server->stats.materials_fixed++;
    cache_job_submit(job);
    return entry;
}

// True for joint transport whose rows fit a quarter of the cache (chosen, not measured).
static bool contracts_material(const struct server *server, const struct prt_transport *t)
{
    uint64_t bytes = 0;
    if (t->engine != PRT_TRANSPORT_JOINT) return false;
    for (uint32_t i = 0; i < t->n_tensor; i++) {
        const struct prt_tensor *x = &t->tensor[i];
        if (x->coupling != PRT_COUPLE_FULL || !x->rows.n_row) continue;
        bytes += x->rows.begin[x->rows.n_row] * (x->rows.index_bytes + 6ull * x->n_phase);
    }
    return bytes && bytes <= server->options.cache / 4;
}

// Counts the lights that the material was used with, this one included.
static unsigned count_lights(struct cache *cache, const char *prefix, const char *light)
{
    char key[RENDER_MAX_LIGHTS * sizeof(((struct render_light *)0)->key) + PREFIX];
    bool fresh, first;
    unsigned n = 0;
    snprintf(key, sizeof key, "%s/lights", prefix);
    struct cache_entry *count = cache_get(cache, key, &first);
    if (first) {
        unsigned *zero = calloc(1, sizeof *zero);
        if (zero) cache_fill(count, zero, sizeof *count + strlen(key), free);
        else cache_fail(count, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
    }
    snprintf(key, sizeof key, "%s/under/%s", prefix, light);
    struct cache_entry *mark = cache_get(cache, key, &fresh);
    if (fresh) cache_fill(mark, NULL, sizeof *mark + strlen(key), NULL);
    cache_release(mark);
    if (count->state == CACHE_READY) n = *(unsigned *)count->value += fresh;
    cache_release(count);
    return n;
}

struct cache_entry *material_contraction_get(struct model *model, uint64_t generation,
                                             struct cache_entry *file,
                                             const struct cache_entry *light,
                                             struct cache_entry *media, const char *media_key)
{
    const struct prt_transport *t = prt_file_transport(file->value);
    struct cache *cache = model->server->cache;
    char prefix[PREFIX], key[PREFIX + 100];
    if (!contracts_material(model->server, t)) return NULL;
    snprintf(prefix, sizeof prefix, "%s/%llu/material/%s", model->key,
             (unsigned long long)generation, media_key);
    // The contraction refers to this mapping of the file and holds it: its address is unique.
    snprintf(key, sizeof key, "%s/fixed/%llx", prefix,
             (unsigned long long)(uintptr_t)file->value);
    struct cache_entry *entry = cache_find(cache, key);
    if (!entry && count_lights(cache, prefix, light->key) > LIGHTS_BEFORE)
        entry = compute(model->server, key, file, media);
    if (entry && entry->state == CACHE_READY) return entry;
    cache_release(entry);
    return NULL;
}
