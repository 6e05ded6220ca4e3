// SPDX-License-Identifier: MIT
// Joint transport under lights that are asked for again: contracted with the light once, for
// every material and every user to come. The first question under a light is answered by a
// plain pass, which costs as much and keeps nothing: a light that is being turned is not seen
// again.
#include "render/evaluation.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct contracting {
    struct work work;
    struct cache_entry *entry, *file, *light;
    struct contracted *made;
    float ms;
};

static void destroy_contracted(void *value)
{
    struct contracted *c = value;
    prt_contracted_light_destroy(c->lit);
    cache_release(c->file);
    free(c);
}

static int run_contracting(struct work *work, const struct prt_context *ctx)
{
    struct contracting *c = (struct contracting *)work;
    double start = prt_time_s();
    int status = prt_contracted_light_create(ctx, prt_file_transport(c->file->value),
                                             c->light->value, &c->made->lit);
    c->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_contracting(struct work *work)
{
    struct contracting *c = (struct contracting *)work;
    c->entry->ms = c->ms;
    if (work->status) {
        free(c->made);
        cache_fail(c->entry, error_of_status(work->status), work->error);
    } else {
        c->made->file = c->file;
        cache_hold(c->file);
        c->entry->holds_file = true;
        cache_fill(c->entry, c->made,
                   sizeof *c->made + prt_contracted_light_bytes(c->made->lit),
                   destroy_contracted);
    }
    cache_release(c->entry);
    cache_release(c->file);
    cache_release(c->light);
    free(c);
}

static void start(struct server *server, struct cache_entry *entry, struct cache_entry *file,
                  struct cache_entry *light)
{
    struct contracting *c = calloc(1, sizeof *c);
    if (c) c->made = calloc(1, sizeof *c->made);
    if (!c || !c->made) {
        free(c);
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    server->stats.contractions++;
    c->entry = entry;
    c->file = file;
    c->light = light;
    cache_hold(entry);
    cache_hold(file);
    cache_hold(light);
    c->work.run = run_contracting;
    c->work.done = done_contracting;
    work_submit(server->work, &c->work);
}

static bool takes_light_first(const struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].storage == PRT_STORAGE_SPARSE) return false;
    return t->engine == PRT_TRANSPORT_JOINT;
}

struct cache_entry *contracted_get(struct model *model, uint64_t generation,
                                   struct cache_entry *file, struct cache_entry *light,
                                   bool make)
{
    char key[RENDER_MAX_LIGHTS * 200 + 200];
    struct cache *cache = model->server->cache;
    bool fresh;
    if (!takes_light_first(prt_file_transport(file->value))) return NULL;
    // It refers to this very map of the file, which it holds: no other has its address
    // meanwhile.
    snprintf(key, sizeof key, "%s/%llu/contracted/%llx/%s", model->key,
             (unsigned long long)generation, (unsigned long long)(uintptr_t)file->value,
             light->key);
    struct cache_entry *entry = cache_find(cache, key);
    if (entry || !make) return entry;
    char mark[sizeof key];
    snprintf(mark, sizeof mark, "%s/%llu/asked/%s", model->key, (unsigned long long)generation,
             light->key);
    struct cache_entry *asked = cache_get(cache, mark, &fresh);
    if (fresh) cache_fill(asked, NULL, sizeof *asked + strlen(mark), NULL);
    cache_release(asked);
    if (fresh) return NULL;
    entry = cache_get(cache, key, &fresh);
    start(model->server, entry, file, light);
    return entry;
}
