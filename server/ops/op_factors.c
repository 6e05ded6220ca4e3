// SPDX-License-Identifier: MIT
// FACTORS: clusters, order and U of a model's transport, which clients multiply coefficients
// with. Clients of one model share the bytes.
#include "net/dispatch.h"
#include "net/request_wait.h"
#include "prt/transport.h"
#include "relight.pb-c.h"
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { KEY = 200 };

struct factors {
    uint64_t hash;
    uint32_t n_vertex, n_tensor, first, most_rank;
    bool exits; // tensors of the planes of exit, too
    struct factor_sections {
        bool exit;
        uint32_t term, n_cluster;
        size_t clusters, order, u, u_bytes; // offsets; clusters and order with first 0
    } tensor[PRT_MOST_TENSORS];
    size_t size;
    uint8_t *bytes;
};

struct factors_job {
    struct cache_job job;
    struct cache_entry *file;
    uint32_t first, most_rank;
    bool exits;
};

static size_t up64(size_t n)
{
    return (n + 63) / 64 * 64;
}

// Pairs of columns of a cluster that are sent, and the first of them.
static size_t pairs_of(const struct factors *f, const struct prt_cluster *c, size_t *first)
{
    size_t end = ((size_t)c->rank + 1) / 2, begin = f->first / 2;
    if (f->most_rank && begin + f->most_rank / 2 < end) end = begin + f->most_rank / 2;
    *first = begin < end ? begin : end;
    return end - *first;
}

static size_t stride_of(const struct prt_cluster *c)
{
    return ((size_t)c->n_vertex + 15) / 16 * 16;
}

static void plan(struct factors *f, const struct prt_transport *t)
{
    size_t at = 0, skipped;
    f->n_vertex = t->mesh.n_vertex;
    f->n_tensor = t->n_tensor;
    // The planes of exit follow the other tensors, whose numbers are the same without them.
    while (!f->exits && f->n_tensor && t->tensor[f->n_tensor - 1].term == PRT_TERM_VIEW)
        f->n_tensor--;
    for (uint32_t i = 0; i < f->n_tensor; i++) {
        const struct prt_tensor *from = &t->tensor[i];
        struct factor_sections *to = &f->tensor[i];
        to->exit = from->term == PRT_TERM_VIEW;
        to->term = prt_term_is_single(from->term) ? RELIGHT__TERM__TERM_SINGLE
                                                  : RELIGHT__TERM__TERM_MULTIPLE;
        to->n_cluster = from->n_cluster;
        if (!f->first) {
            to->clusters = at;
            to->order = up64(to->clusters + 8ull * from->n_cluster);
            at = up64(to->order + 4ull * from->n_vertex);
        }
        to->u = at;
        for (uint32_t c = 0; c < from->n_cluster; c++)
            to->u_bytes +=
                4 * pairs_of(f, &from->cluster[c], &skipped) * stride_of(&from->cluster[c]);
        at = up64(to->u + to->u_bytes);
    }
    f->size = at;
}

static void copy_tensor(const struct factors *f, const struct prt_tensor *from,
                        const struct factor_sections *at)
{
    uint32_t *cluster = (uint32_t *)(f->bytes + at->clusters);
    uint32_t *order = (uint32_t *)(f->bytes + at->order);
    uint8_t *u = f->bytes + at->u;
    for (uint32_t i = 0; i < from->n_cluster; i++) {
        const struct prt_cluster *c = &from->cluster[i];
        size_t first, n = 4 * pairs_of(f, c, &first) * stride_of(c);
        // the clusters of a term may all have rank 0: it has no U then
        if (n) memcpy(u, from->u + c->u_begin + 2 * first * stride_of(c), n);
        u += n;
        if (f->first) continue;
        cluster[2 * (size_t)i] = c->n_vertex;
        cluster[2 * (size_t)i + 1] = c->rank;
        memcpy(order, from->order + c->vertex_begin, 4ull * c->n_vertex);
        order += c->n_vertex;
    }
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct factors_job *own = (struct factors_job *)job;
    const struct prt_transport *t = prt_file_transport(own->file->value);
    struct factors *f = job->value = prt_calloc(1, sizeof *f);
    if (!f) return PRT_NOMEM;
    f->hash = prt_file_hash(own->file->value);
    f->first = own->first;
    f->most_rank = own->most_rank;
    f->exits = own->exits;
    plan(f, t);
    f->bytes = prt_calloc(f->size + 1, 1);
    if (!f->bytes) return PRT_NOMEM;
    for (uint32_t i = 0; i < f->n_tensor; i++) copy_tensor(f, &t->tensor[i], &f->tensor[i]);
    job->bytes = sizeof *f + f->size;
    return PRT_OK;
}

static void destroy(void *value)
{
    struct factors *f = value;
    prt_free(f->bytes);
    prt_free(f);
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct factors_job), .run = run, .destroy = destroy};

static void release_entry(void *entry)
{
    cache_release(entry);
}

static void factors_ready(struct request_wait *wait, struct request *request)
{
    struct cache_entry *entry = wait->entry;
    if (request && entry->state == CACHE_READY) {
        const struct factors *f = entry->value;
        Relight__FactorsAnswer out = RELIGHT__FACTORS_ANSWER__INIT;
        Relight__FactorTensor tensor[PRT_MOST_TENSORS], *list[PRT_MOST_TENSORS];
        for (uint32_t i = 0; i < f->n_tensor; i++) {
            const struct factor_sections *s = &f->tensor[i];
            relight__factor_tensor__init(list[i] = &tensor[i]);
            tensor[i].term = (Relight__Term)s->term;
            tensor[i].exit = s->exit;
            tensor[i].n_cluster = s->n_cluster;
            tensor[i].clusters_offset = s->clusters;
            tensor[i].order_offset = s->order;
            tensor[i].u_offset = s->u;
            tensor[i].u_bytes = s->u_bytes;
        }
        out.factors = f->hash;
        out.n_vertex = f->n_vertex;
        out.n_tensors = f->n_tensor;
        out.tensors = list;
        struct payload payload = {f->bytes, f->size, entry, release_entry};
        cache_hold(entry);
        request_answer(request, &out.base, &payload);
    } else if (request) {
        request_fail(request, entry->error_code, "%s", entry->error);
    }
    cache_release(entry);
    free(wait);
}

static struct cache_entry *factors_get(struct model *m, struct cache_entry *file,
                                       const Relight__FactorsRequest *in)
{
    char key[KEY];
    struct cache_job *job;
    // With the file's hash: a draft may have been replaced since it was opened.
    snprintf(key, sizeof key, "%s/%llu/factors/%llx/%u/%u/%d", m->key,
             (unsigned long long)m->baked_generation,
             (unsigned long long)prt_file_hash(file->value), in->first, in->most_rank,
             in->exits);
    struct cache_entry *entry = cache_compute(m->server, key, &kind, &job);
    if (!job) return entry;
    struct factors_job *own = (struct factors_job *)job;
    own->first = in->first;
    own->most_rank = in->most_rank;
    own->exits = in->exits;
    own->file = file;
    cache_job_hold(job, file);
    cache_job_submit(job);
    return entry;
}

static void file_ready(struct request *request, struct model *m, struct cache_entry *file)
{
    const Relight__FactorsRequest *in = (const Relight__FactorsRequest *)request->message;
    const struct prt_transport *t = prt_file_transport(file->value);
    char error[300];
    int code = check_factored(m, t, error);
    struct request_wait *wait = code ? NULL : calloc(1, sizeof *wait);
    if (!wait) {
        request_fail(request, code ? code : RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "%s",
                     code ? error : "not enough memory");
        return;
    }
    request_await_entry(request, wait, factors_get(m, file, in), factors_ready);
}

void op_factors(struct request *request)
{
    const Relight__FactorsRequest *in = (const Relight__FactorsRequest *)request->message;
    if (in->first % 2 || in->most_rank % 2)
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "factors.%s is %u: expected an even number of columns",
                     in->first % 2 ? "first" : "most_rank",
                     in->first % 2 ? in->first : in->most_rank);
    else with_model(request, in->model, file_ready);
}
