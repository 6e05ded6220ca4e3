// SPDX-License-Identifier: MIT
// Passes over a model's transport. While one runs, evaluations of the same model gather, and
// the next pass computes up to PRT_RELIGHT_MAX_LIGHTS of them: it reads the transport once for
// all their lights. The principals that wait take turns (render/shared/pass_share.h), and each
// principal's most urgent evaluations go first.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "render/shared/pass_share.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// One evaluation of a pass. Its job completes with the pass and is never submitted by itself.
struct pass_item {
    struct cache_job job;
    struct pass_item *next;
    struct pass *pass;
    struct cache_entry *file, *light, *contracted_light, *contracted_material;
    struct vertex_query query;
    int status;
};

struct pass {
    struct work work;
    struct model *model;
    struct pass_item *first, **last; // gather for the next pass
    struct pass_item *running;       // computed by the worker now
    unsigned n_running;
    char payer[PRT_RELIGHT_MAX_LIGHTS][WORK_NAME]; // of the running items: equal parts
    float ms;
};

static void item_unwanted(struct cache_job *job);
static const struct cache_job_kind kind = {
    .size = sizeof(struct pass_item), .destroy = free, .unwanted = item_unwanted};
_Static_assert((int)PRT_RELIGHT_MAX_LIGHTS <= (int)WORK_MAX_SHARE,
               "a pass has a payer for each item");

static const struct prt_transport *file_transport(const struct pass_item *item)
{
    return prt_file_transport(item->file->value);
}

// The transport to evaluate: contracted with the material, or the file's.
static const struct prt_transport *item_transport(const struct pass_item *item)
{
    if (!item->contracted_material) return file_transport(item);
    const struct material_contraction *c = item->contracted_material->value;
    return prt_contracted_transport_get(c->contracted);
}

static struct prt_query item_query(const struct pass_item *item)
{
    const struct vertex_query *q = &item->query;
    const struct light_contraction *c =
        item->contracted_light ? item->contracted_light->value : NULL;
    return (struct prt_query){.term = q->term,
                              .light = item->light ? item->light->value : NULL,
                              .media = q->media ? *(const struct prt_media *)q->media->value
                                                : (struct prt_media){0},
                              .eye = q->has_eye ? q->eye : NULL,
                              .lit = c ? c->contracted : NULL,
                              .most_apart = q->most_apart,
                              .most_rank = q->coefficients ? 0 : q->most_rank};
}

// Allocates the item's values; their size depends on the transport.
static int allocate_values(const struct prt_context *ctx, struct pass_item *item)
{
    const struct prt_transport *t = file_transport(item);
    struct prt_query query = item_query(item);
    struct prt_coefficients rows = {.most_rank = item->query.most_rank,
                                    .phases = item->query.phases};
    struct vertex_values *values;
    unsigned n_plane = 1;
    double error = 0;
    int status = item->query.coefficients ? prt_coefficients_plan(ctx, t, &query, &rows)
                 : item->query.planes     ? prt_answer_planes(ctx, t, &query, &n_plane, NULL)
                                          : PRT_OK;
    if (!status && query.media.n)
        status = prt_answer_material_error(ctx, t, &query.media, query.term, &error);
    if (status) return status;
    const size_t each = (size_t)t->mesh.n_vertex * 3 * sizeof(float);
    item->job.bytes =
        sizeof *values +
        (item->query.coefficients ? rows.n_half * sizeof(uint16_t) : n_plane * each);
    item->job.value = values = malloc(item->job.bytes);
    if (!values) return PRT_NOMEM;
    if (item->query.coefficients) memset(values, 0, item->job.bytes); // between layers
    values->coefficients = rows;
    values->coefficients.half = (uint16_t *)values->values;
    values->n_plane = n_plane;
    values->n_vertex = t->mesh.n_vertex;
    values->material_error = (float)error;
    return PRT_OK;
}

// Evaluates items of the same transport and kind together: they share one reading of it.
static int evaluate(const struct prt_context *ctx, struct pass_item *const item[], unsigned n)
{
    struct prt_query query[PRT_RELIGHT_MAX_LIGHTS];
    bool planes[PRT_RELIGHT_MAX_LIGHTS], done[PRT_RELIGHT_MAX_LIGHTS] = {false};
    float *out[PRT_RELIGHT_MAX_LIGHTS];
    struct prt_coefficients *rows[PRT_RELIGHT_MAX_LIGHTS];
    int status = PRT_OK;
    for (unsigned first = 0; first < n && !status; first++) {
        const struct prt_transport *t = item_transport(item[first]);
        const bool coefficients = item[first]->query.coefficients;
        unsigned m = 0;
        for (unsigned i = first; i < n; i++) {
            struct vertex_values *values = item[i]->job.value;
            if (done[i] || item_transport(item[i]) != t ||
                item[i]->query.coefficients != coefficients)
                continue;
            done[i] = true;
            query[m] = item_query(item[i]);
            if (item[i]->contracted_material) query[m].media.n = 0; // they are in t already
            planes[m] = item[i]->query.planes;
            rows[m] = &values->coefficients;
            out[m++] = values->values;
        }
        if (m && coefficients) status = prt_answer_coefficients(ctx, t, m, query, rows);
        else if (m) status = prt_answer_many(ctx, t, m, query, planes, out);
    }
    return status;
}

static void fail_item(const struct work *pass, struct pass_item *item, int status)
{
    item->status = status;
    snprintf(item->job.work.error, sizeof item->job.work.error, "%s", pass->error);
}

static int run_pass(struct work *work, const struct prt_context *ctx)
{
    struct pass *pass = (struct pass *)work;
    struct pass_item *good[PRT_RELIGHT_MAX_LIGHTS];
    unsigned n = 0;
    double start = prt_time_s();
    for (struct pass_item *item = pass->running; item; item = item->next) {
        work->error[0] = 0;
        int status = allocate_values(ctx, item);
        if (status) fail_item(work, item, status);
        else good[n++] = item;
    }
    work->error[0] = 0;
    int status = n ? evaluate(ctx, good, n) : PRT_OK;
    // One item's error must not fail the others: each is evaluated alone.
    for (unsigned i = 0; status && i < n; i++) {
        if (n > 1) work->error[0] = 0;
        int alone = n > 1 ? evaluate(ctx, &good[i], 1) : status;
        if (alone) fail_item(work, good[i], alone);
    }
    pass->ms = (float)((prt_time_s() - start) * 1e3);
    return PRT_OK;
}

static void pass_done(struct work *work);

// Submits the pass for its running items: as the first one's work, of the most urgent's class.
static void submit(struct pass *pass)
{
    struct work_pool *pool = pass->model->server->work;
    struct work_actor actor = pass->running->job.actor;
    unsigned n = 0;
    for (const struct pass_item *item = pass->running; item; item = item->next) {
        if (item->job.actor.class < actor.class) actor.class = item->job.actor.class;
        snprintf(pass->payer[n++], WORK_NAME, "%s", item->job.actor.name);
    }
    pass->work.run = run_pass;
    pass->work.done = pass_done;
    pass->work.class = WORK_INTERACTIVE;
    pass->work.share = (const char(*)[WORK_NAME])pass->payer;
    pass->work.n_share = pass->n_running = n;
    struct work_actor before = work_act(pool, actor);
    work_submit(pool, &pass->work);
    work_act(pool, before);
}

// Moves the items of this class that their principals' grants cover to `running`.
static void choose_class(struct pass *pass, int class, struct pass_share *share,
                         struct pass_item ***end)
{
    for (struct pass_item **at = &pass->first; *at && share->n_granted;) {
        struct pass_item *item = *at;
        if ((int)item->job.actor.class != class ||
            !pass_share_take(share, item->job.actor.name)) {
            at = &item->next;
            continue;
        }
        *at = item->next;
        item->next = NULL;
        **end = item;
        *end = &item->next;
        pass->n_running++;
    }
}

static void choose_items(struct pass *pass)
{
    struct pass_share share = {0};
    struct pass_item **end = &pass->running;
    unsigned seen = 0;
    for (const struct pass_item *i = pass->first; i && seen++ < PASS_SHARE_SEEN; i = i->next)
        pass_share_add(&share, i->job.actor.name);
    // `payer` has the principals of the pass before: clients that wait for its answers come
    // back.
    for (unsigned i = 0; i < pass->n_running; i++) pass_share_before(&share, pass->payer[i]);
    pass_share_grant(&share, PRT_RELIGHT_MAX_LIGHTS);
    pass->running = NULL;
    pass->n_running = 0;
    for (int class = 0; class < WORK_N_CLASS; class ++) choose_class(pass, class, &share, &end);
    for (pass->last = &pass->first; *pass->last;) pass->last = &(*pass->last)->next;
}

static void start_pass(struct pass *pass)
{
    struct stats *stats = &pass->model->server->stats;
    choose_items(pass);
    unsigned n = pass->n_running;
    stats->passes++;
    stats->relights += n;
    stats_batch(stats, n);
    if (n > 1) stats->shared += n;
    submit(pass);
}

// The next pass, or none.
static void go_on(struct pass *pass)
{
    if (pass->first) {
        start_pass(pass);
        return;
    }
    pass->model->pass = NULL;
    model_release(pass->model);
    free(pass);
}

static bool unlink_item(struct pass_item **at, const struct pass_item *item)
{
    while (*at && *at != item) at = &(*at)->next;
    if (!*at) return false;
    *at = item->next;
    return true;
}

// Taken out of the next pass, or of one that waits for a worker; a running pass continues.
static void item_unwanted(struct cache_job *job)
{
    struct pass_item *item = (struct pass_item *)job;
    struct pass *pass = item->pass;
    if (unlink_item(&pass->first, item)) {
        pass->last = &pass->first;
        while (*pass->last) pass->last = &(*pass->last)->next;
        pass->model->server->stats.items_withdrawn++;
    } else if (work_dequeue(&pass->work)) {
        unlink_item(&pass->running, item);
        if (pass->running) submit(pass);
        else go_on(pass);
    } else {
        cache_forget_entry(job->entry);
        return;
    }
    snprintf(job->work.error, sizeof job->work.error, "nobody waits for it any more");
    cache_job_complete(job, PRT_CANCELLED);
}

static void pass_done(struct work *work)
{
    struct pass *pass = (struct pass *)work;
    struct pass_item *item = pass->running;
    pass->running = NULL;
    float ms = pass->ms;
    unsigned n = pass->n_running;
    // Before the entries are filled: their waiters may call relight_pass_get().
    go_on(pass);
    while (item) {
        struct pass_item *next = item->next;
        item->job.ms = ms;
        if (!item->status) ((struct vertex_values *)item->job.value)->shared = n;
        cache_job_complete(&item->job, item->status);
        item = next;
    }
}

static struct pass *create_pass(struct model *model)
{
    struct pass *pass = calloc(1, sizeof *pass);
    if (!pass) return NULL;
    pass->model = model;
    pass->last = &pass->first;
    model->pass = pass;
    model_hold(model);
    return pass;
}

struct cache_entry *relight_pass_get(struct model *model, const char *key,
                                     const struct vertex_query *query, struct cache_entry *file,
                                     struct cache_entry *light,
                                     struct cache_entry *contracted_light,
                                     struct cache_entry *contracted_material)
{
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    bool idle = !model->pass;
    struct pass *pass = idle ? create_pass(model) : model->pass;
    if (!pass) {
        cache_job_complete(job, PRT_NOMEM);
        return entry;
    }
    struct pass_item *item = (struct pass_item *)job;
    item->query = *query;
    item->pass = pass;
    cache_job_hold(job, query->media);
    cache_job_hold(job, item->file = file);
    cache_job_hold(job, item->light = light);
    cache_job_hold(job, item->contracted_light = contracted_light);
    cache_job_hold(job, item->contracted_material = contracted_material);
    if (contracted_light) model->server->stats.edits++;
    if (contracted_material) model->server->stats.fixed_used++;
    *pass->last = item;
    pass->last = &item->next;
    if (idle) start_pass(pass);
    return entry;
}
