// SPDX-License-Identifier: MIT
// Irradiance at the vertices. No bake stores it: it is traced on a background worker.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "prt/reference.h"

#include <stdlib.h>

struct irradiance_job {
    struct cache_job job;
    struct cache_entry *file, *light, *media;
};

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct irradiance_job *own = (struct irradiance_job *)job;
    const struct prt_transport *transport = prt_file_transport(own->file->value);
    const struct prt_mesh *mesh = &transport->mesh;
    const struct prt_reference_options options = {.term = PRT_REFERENCE_IRRADIANCE};
    struct vertex_values *out;
    job->bytes = sizeof *out + (size_t)mesh->n_vertex * 12;
    job->value = out = malloc(job->bytes);
    if (!out) return PRT_NOMEM;
    *out = (struct vertex_values){.n_plane = 1, .n_vertex = mesh->n_vertex, .shared = 1};
    return prt_reference_colors(ctx, mesh, own->media ? own->media->value : &transport->media,
                                own->light->value, &options, (float(*)[3])out->values);
}

static const struct cache_job_kind kind = {.size = sizeof(struct irradiance_job),
                                           .class = WORK_BACKGROUND,
                                           .run = run,
                                           .destroy = free};

struct cache_entry *irradiance_get(struct server *server, const char *key,
                                   const struct vertex_query *query, struct cache_entry *file,
                                   struct cache_entry *light)
{
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    if (!job) return entry;
    struct irradiance_job *own = (struct irradiance_job *)job;
    own->file = file;
    own->light = light;
    own->media = query->media;
    cache_job_hold(job, own->media);
    cache_job_hold(job, file);
    cache_job_hold(job, light);
    cache_job_submit(job);
    return entry;
}
