// SPDX-License-Identifier: MIT
// Joint transport under a material that stays while lights move: once so many lights have been
// asked for with it, it is put into the transport, on a worker, and new lights cost what they
// cost a wavelet transport. Nobody waits for that; meanwhile, and for fewer lights, a plain
// pass does.
#include "render/evaluation.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LIGHTS_BEFORE = 8 };

struct fixing {
    struct work work;
    struct cache_entry *entry, *file;
    struct prt_material material;
    struct fixed *made;
    float ms;
};

static void destroy_fixed(void *value)
{
    struct fixed *f = value;
    prt_contracted_transport_destroy(f->fixed);
    cache_release(f->file);
    free(f);
}

static int run_fixing(struct work *work, const struct prt_context *ctx)
{
    struct fixing *f = (struct fixing *)work;
    struct prt_context alone = *ctx; // the other workers answer meanwhile
    double start = prt_time_s();
    alone.pool = NULL;
    int status = prt_contracted_transport_create(&alone, prt_file_transport(f->file->value),
                                                 &f->material, &f->made->fixed);
    f->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_fixing(struct work *work)
{
    struct fixing *f = (struct fixing *)work;
    f->entry->ms = f->ms;
    if (work->status) {
        free(f->made);
        cache_fail(f->entry, error_of_status(work->status), work->error);
    } else {
        f->made->file = f->file;
        cache_hold(f->file);
        f->entry->holds_file = true;
        cache_fill(f->entry, f->made,
                   sizeof *f->made + prt_contracted_transport_bytes(f->made->fixed),
                   destroy_fixed);
    }
    cache_release(f->entry);
    cache_release(f->file);
    free(f);
}

static void start(struct server *server, struct cache_entry *entry, struct cache_entry *file,
                  const struct prt_material *material)
{
    struct fixing *f = calloc(1, sizeof *f);
    if (f) f->made = calloc(1, sizeof *f->made);
    if (!f || !f->made) {
        free(f);
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    server->stats.materials_fixed++;
    f->entry = entry;
    f->file = file;
    f->material = *material;
    cache_hold(entry);
    cache_hold(file);
    f->work.run = run_fixing;
    f->work.done = done_fixing;
    f->work.class = WORK_BACKGROUND;
    work_submit(server->work, &f->work);
}

// Worth it where both move, and a quarter of the cache is room for it.
static bool takes_material_first(const struct server *server, const struct prt_transport *t)
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

// How many lights this material was asked for under, this one included.
static unsigned lights_of(struct cache *cache, const char *prefix, const char *light)
{
    char key[RENDER_MAX_LIGHTS * 200 + 300];
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

struct cache_entry *fixed_get(struct model *model, uint64_t generation,
                              struct cache_entry *file, const struct cache_entry *light,
                              const struct prt_material *material, const char *material_key)
{
    const struct prt_transport *t = prt_file_transport(file->value);
    struct cache *cache = model->server->cache;
    char prefix[300], key[400];
    bool fresh;
    if (!takes_material_first(model->server, t)) return NULL;
    snprintf(prefix, sizeof prefix, "%s/%llu/material/%s", model->key,
             (unsigned long long)generation, material_key);
    // It refers to this very map of the file, which it holds: no other has its address
    // meanwhile.
    snprintf(key, sizeof key, "%s/fixed/%llx", prefix,
             (unsigned long long)(uintptr_t)file->value);
    struct cache_entry *entry = cache_find(cache, key);
    if (!entry && lights_of(cache, prefix, light->key) > LIGHTS_BEFORE) {
        entry = cache_get(cache, key, &fresh);
        start(model->server, entry, file, material ? material : &t->material);
    }
    if (entry && entry->state == CACHE_READY) return entry;
    cache_release(entry);
    return NULL;
}
