// SPDX-License-Identifier: MIT
// Joint transport under lights that are asked for again: contracted with the light once, for
// every material and every user to come. The first question under a light is answered by a
// plain pass, which costs as much and keeps nothing: a light that is being turned is not seen
// again.
#include "evaluation.h"
#include "relight.pb-c.h"
#include "request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct contracting {
    struct work work;
    struct memo_entry *entry, *file, *light;
    struct contracted *made;
    float ms;
};

static void destroy_contracted(void *value)
{
    struct contracted *c = value;
    prt_lit_destroy(c->lit);
    memo_release(c->file);
    free(c);
}

static int run_contracting(struct work *work, const struct prt_context *ctx)
{
    struct contracting *c = (struct contracting *)work;
    double start = prt_time_s();
    int status =
        prt_lit_create(ctx, prt_file_transport(c->file->value), c->light->value, &c->made->lit);
    c->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_contracting(struct work *work)
{
    struct contracting *c = (struct contracting *)work;
    c->entry->ms = c->ms;
    if (work->status) {
        free(c->made);
        memo_fail(c->entry, error_of_status(work->status), work->error);
    } else {
        c->made->file = c->file;
        memo_hold(c->file);
        c->entry->holds_file = true;
        memo_fill(c->entry, c->made, sizeof *c->made + prt_lit_bytes(c->made->lit),
                  destroy_contracted);
    }
    memo_release(c->entry);
    memo_release(c->file);
    memo_release(c->light);
    free(c);
}

static void start(struct server *server, struct memo_entry *entry, struct memo_entry *file,
                  struct memo_entry *light)
{
    struct contracting *c = calloc(1, sizeof *c);
    if (c) c->made = calloc(1, sizeof *c->made);
    if (!c || !c->made) {
        free(c);
        memo_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    server->stats.contractions++;
    c->entry = entry;
    c->file = file;
    c->light = light;
    memo_hold(entry);
    memo_hold(file);
    memo_hold(light);
    c->work.run = run_contracting;
    c->work.done = done_contracting;
    work_submit(server->work, &c->work);
}

static bool takes_light_first(const struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++)
        if (t->tensor[i].storage == PRT_STORAGE_SPARSE) return false;
    return t->engine == PRT_ENGINE_JOINT;
}

struct memo_entry *contracted_get(struct model *model, uint64_t generation,
                                  struct memo_entry *file, struct memo_entry *light, bool make)
{
    char key[RENDER_MAX_LIGHTS * 200 + 200];
    struct memo *memo = model->server->memo;
    bool fresh;
    if (!takes_light_first(prt_file_transport(file->value))) return NULL;
    // It refers to this very map of the file, which it holds: no other has its address
    // meanwhile.
    snprintf(key, sizeof key, "%s/%llu/contracted/%llx/%s", model->key,
             (unsigned long long)generation, (unsigned long long)(uintptr_t)file->value,
             light->key);
    struct memo_entry *entry = memo_find(memo, key);
    if (entry || !make) return entry;
    char mark[sizeof key];
    snprintf(mark, sizeof mark, "%s/%llu/asked/%s", model->key, (unsigned long long)generation,
             light->key);
    struct memo_entry *asked = memo_get(memo, mark, &fresh);
    if (fresh) memo_fill(asked, NULL, sizeof *asked + strlen(mark), NULL);
    memo_release(asked);
    if (fresh) return NULL;
    entry = memo_get(memo, key, &fresh);
    start(model->server, entry, file, light);
    return entry;
}
