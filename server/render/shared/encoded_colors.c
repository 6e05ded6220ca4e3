// SPDX-License-Identifier: MIT
// Colours in a client's format. Clients that look at one light share them.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct encoding_job {
    struct cache_job job;
    struct cache_entry *values;
    struct render_spec spec; // format and exposure; nothing in it is held
};

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct encoding_job *own = (struct encoding_job *)job;
    const struct vertex_values *values = own->values->value;
    job->bytes = plane_bytes(&own->spec, values);
    job->value = prt_alloc(job->bytes ? job->bytes : 1, 1);
    if (!job->value) return PRT_NOMEM;
    encode_colors(ctx, &own->spec, values, job->value);
    return PRT_OK;
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct encoding_job), .run = run, .destroy = prt_free};

struct cache_entry *encoded_colors_get(struct server *server, const struct render_spec *spec,
                                       struct cache_entry *values)
{
    struct cache_job *job;
    size_t size = strlen(values->key) + 64;
    char *key = malloc(size);
    if (!key) return NULL;
    // Begins as that of the values: both are dropped with their model.
    snprintf(key, size, "%s/encoded/%d/%.9g", values->key, spec->format,
             (double)spec->exposure_ev);
    struct cache_entry *entry = cache_compute(server, key, &kind, &job);
    free(key);
    if (!job) return entry;
    struct encoding_job *own = (struct encoding_job *)job;
    own->values = values;
    own->spec.format = spec->format;
    own->spec.exposure_ev = spec->exposure_ev;
    cache_job_hold(job, values);
    cache_job_submit(job);
    return entry;
}
