// SPDX-License-Identifier: MIT
// Irradiance at the vertices: no bake holds it, so it is traced when it is asked for, behind
// every request that has its answer at hand.
#include "render/evaluation.h"
#include "prt/reference.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdlib.h>

struct tracing {
    struct work work;
    struct cache_entry *entry, *file, *light;
    bool has_material;
    struct prt_material material;
    struct answer *answer;
    float ms;
};

static int run_tracing(struct work *work, const struct prt_context *ctx)
{
    struct tracing *t = (struct tracing *)work;
    const struct prt_transport *transport = prt_file_transport(t->file->value);
    const struct prt_mesh *mesh = &transport->mesh;
    const struct prt_reference_options options = {.term = PRT_REFERENCE_IRRADIANCE};
    double start = prt_time_s();
    t->answer = malloc(sizeof *t->answer + (size_t)mesh->n_vertex * 12);
    if (!t->answer) return PRT_NOMEM;
    *t->answer = (struct answer){.n_plane = 1, .n_vertex = mesh->n_vertex, .shared = 1};
    int status =
        prt_reference_colors(ctx, mesh, t->has_material ? &t->material : &transport->material,
                             t->light->value, &options, (float(*)[3])t->answer->values);
    t->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_tracing(struct work *work)
{
    struct tracing *t = (struct tracing *)work;
    t->entry->ms = t->ms;
    if (work->status) {
        free(t->answer);
        cache_fail(t->entry, error_of_status(work->status), work->error);
    } else {
        cache_fill(t->entry, t->answer, sizeof *t->answer + (size_t)t->answer->n_vertex * 12,
                   free);
    }
    cache_release(t->entry);
    cache_release(t->file);
    cache_release(t->light);
    free(t);
}

struct cache_entry *irradiance_get(struct server *server, const char *key,
                                   const struct answer_query *query, struct cache_entry *file,
                                   struct cache_entry *light)
{
    bool fresh;
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    if (!fresh) return entry;
    struct tracing *t = calloc(1, sizeof *t);
    if (!t) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    *t = (struct tracing){.entry = entry,
                          .file = file,
                          .light = light,
                          .has_material = query->has_material,
                          .material = query->material};
    cache_hold(entry);
    cache_hold(file);
    cache_hold(light);
    t->work.run = run_tracing;
    t->work.done = done_tracing;
    t->work.class = WORK_BACKGROUND;
    work_submit(server->work, &t->work);
    return entry;
}
