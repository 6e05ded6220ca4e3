// SPDX-License-Identifier: MIT
// The coarse order of an open file's mesh, for views of colours on slow links and their
// clients.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#define XXH_INLINE_ALL
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

struct coarse_job {
    struct cache_job job;
    struct cache_entry *file;
};

static void destroy(void *value)
{
    struct coarse_order *c = value;
    prt_free(c->bytes);
    free(c);
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    const struct cache_entry *file = ((struct coarse_job *)job)->file;
    struct coarse_order *c = job->value = calloc(1, sizeof *c);
    if (!c) return PRT_NOMEM;
    struct prt_coarse_order made = {0};
    int status = prt_coarse_order_create(ctx, &prt_file_transport(file->value)->mesh, &made);
    if (status) return status;
    const size_t n = made.n;
    c->parents = (4 * n + 63) / 64 * 64;
    c->size = c->parents + 8 * n;
    c->bytes = prt_calloc(c->size + 1, 1);
    if (c->bytes) {
        memcpy(c->bytes, made.vertex, 4 * n);
        memcpy(c->bytes + c->parents, made.parent, 8 * n);
        c->n = made.n;
        c->n_root = made.n_root;
        c->vertex = (const uint32_t *)(const void *)c->bytes;
        c->hash = XXH3_64bits(c->bytes, c->size);
        job->bytes = sizeof *c + c->size;
    }
    prt_coarse_order_finish(&made);
    return c->bytes ? PRT_OK : PRT_NOMEM;
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct coarse_job), .run = run, .destroy = destroy};

struct cache_entry *coarse_order_get(struct model *model, struct cache_entry *file)
{
    char key[sizeof model->key + 60];
    struct cache_job *job;
    snprintf(key, sizeof key, "%s/coarse/%llx", model->key,
             (unsigned long long)prt_file_hash(file->value));
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    ((struct coarse_job *)job)->file = file;
    cache_job_hold(job, file);
    cache_job_submit(job);
    return entry;
}

uint32_t coarse_count(const struct coarse_order *coarse, unsigned level)
{
    const uint32_t n = coarse->n;
    const uint32_t wanted = (uint32_t)(((uint64_t)n + (1u << level) - 1) >> level);
    return wanted < coarse->n_root ? coarse->n_root : wanted;
}
