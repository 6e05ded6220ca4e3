// SPDX-License-Identifier: MIT
// Passes over a model's transport. While one runs, evaluations of the same model gather, and
// the next pass takes all of them at once: their lights share one reading of the transport.
#include "render/evaluation.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// One evaluation that a pass makes.
struct want {
    struct want *next;
    struct cache_entry *entry, *file, *light, *contracted, *fixed;
    struct answer_query query;
    struct answer *answer;
    int status;
    char error[300];
};

struct pass {
    struct work work;
    struct model *model;
    struct want *first, **last; // gather for the next pass
    struct want *running;       // what the worker makes now
    unsigned n_running;
    float ms;
};

static const struct prt_transport *transport_of(const struct want *w)
{
    return prt_file_transport(w->file->value);
}

// The transport with the material put in has no question of material left.
static const struct prt_transport *asked_of(const struct want *w)
{
    return w->fixed ? prt_contracted_transport_get(((struct fixed *)w->fixed->value)->fixed)
                    : transport_of(w);
}

static struct prt_query query_of(const struct want *w)
{
    const struct answer_query *q = &w->query;
    return (struct prt_query){
        .term = q->term,
        .light = w->light ? w->light->value : NULL,
        .material = q->has_material ? &q->material : NULL,
        .eye = q->has_eye ? q->eye : NULL,
        .lit = w->contracted ? ((struct contracted *)w->contracted->value)->lit : NULL};
}

// Room for one answer; its size is known from the transport.
static int make_room(const struct prt_context *ctx, struct want *w)
{
    const struct prt_transport *t = transport_of(w);
    struct prt_query query = query_of(w);
    unsigned n_plane = 1;
    int status = w->query.planes ? prt_answer_planes(ctx, t, &query, &n_plane, NULL) : PRT_OK;
    if (status) return status;
    double lost = 0;
    if (query.material &&
        (status = prt_answer_material_error(ctx, t, query.material, query.term, &lost)))
        return status;
    size_t n = (size_t)n_plane * t->mesh.n_vertex * 3;
    w->answer = malloc(sizeof *w->answer + n * sizeof(float));
    if (!w->answer) return PRT_NOMEM;
    w->answer->n_plane = n_plane;
    w->answer->n_vertex = t->mesh.n_vertex;
    w->answer->material_error = (float)lost;
    return PRT_OK;
}

// Those of one transport share a reading of it.
static int answer_together(const struct prt_context *ctx, struct want *const want[], unsigned n)
{
    struct prt_query query[PRT_RELIGHT_MAX_LIGHTS];
    bool planes[PRT_RELIGHT_MAX_LIGHTS], done[PRT_RELIGHT_MAX_LIGHTS] = {false};
    float *out[PRT_RELIGHT_MAX_LIGHTS];
    int status = PRT_OK;
    for (unsigned first = 0; first < n && !status; first++) {
        const struct prt_transport *t = asked_of(want[first]);
        unsigned m = 0;
        for (unsigned i = first; i < n; i++) {
            if (done[i] || asked_of(want[i]) != t) continue;
            done[i] = true;
            query[m] = query_of(want[i]);
            if (want[i]->fixed) query[m].material = NULL;
            planes[m] = want[i]->query.planes;
            out[m++] = want[i]->answer->values;
        }
        if (m) status = prt_answer_many(ctx, t, m, query, planes, out);
    }
    return status;
}

static void fail_want(struct work *work, struct want *w, int status)
{
    w->status = status;
    snprintf(w->error, sizeof w->error, "%s",
             work->error[0] ? work->error : prt_status_text(status));
}

static int run_pass(struct work *work, const struct prt_context *ctx)
{
    struct pass *pass = (struct pass *)work;
    struct want *good[PRT_RELIGHT_MAX_LIGHTS];
    unsigned n = 0;
    double start = prt_time_s();
    for (struct want *w = pass->running; w; w = w->next) {
        work->error[0] = 0;
        int status = make_room(ctx, w);
        if (status) fail_want(work, w, status);
        else good[n++] = w;
    }
    work->error[0] = 0;
    int status = n ? answer_together(ctx, good, n) : PRT_OK;
    // One that cannot be answered is not to take the others with it.
    for (unsigned i = 0; status && i < n; i++) {
        if (n > 1) work->error[0] = 0;
        int alone = n > 1 ? answer_together(ctx, &good[i], 1) : status;
        if (alone) fail_want(work, good[i], alone);
    }
    pass->ms = (float)((prt_time_s() - start) * 1e3);
    return PRT_OK;
}

static void done_pass(struct work *work);

static void start_pass(struct pass *pass)
{
    struct stats *stats = &pass->model->server->stats;
    struct want **end = &pass->first;
    unsigned n = 0;
    while (*end && n < PRT_RELIGHT_MAX_LIGHTS) {
        end = &(*end)->next;
        n++;
    }
    pass->running = pass->first;
    pass->n_running = n;
    pass->first = *end;
    *end = NULL;
    if (!pass->first) pass->last = &pass->first;
    stats->passes++;
    stats->relights += n;
    if (n > 1) stats->shared += n;
    pass->work.run = run_pass;
    pass->work.done = done_pass;
    pass->work.class = WORK_INTERACTIVE;
    work_submit(pass->model->server->work, &pass->work);
}

static void done_pass(struct work *work)
{
    struct pass *pass = (struct pass *)work;
    struct want *w = pass->running;
    pass->running = NULL;
    float ms = pass->ms;
    unsigned n = pass->n_running;
    // Whoever is woken may ask for more: the pass is either going on already, or gone.
    if (pass->first) {
        start_pass(pass);
    } else {
        pass->model->pass = NULL;
        model_release(pass->model);
        free(pass);
    }
    while (w) {
        struct want *next = w->next;
        w->entry->ms = ms;
        if (w->status) {
            cache_fail(w->entry, error_of_status(w->status), w->error);
            free(w->answer);
        } else {
            w->answer->shared = n;
            size_t bytes =
                sizeof *w->answer + (size_t)w->answer->n_plane * w->answer->n_vertex * 12;
            cache_fill(w->entry, w->answer, bytes, free);
        }
        cache_release(w->entry);
        cache_release(w->file);
        cache_release(w->light);
        cache_release(w->contracted);
        cache_release(w->fixed);
        free(w);
        w = next;
    }
}

struct cache_entry *answer_get(struct model *model, const char *key,
                               const struct answer_query *query, struct cache_entry *file,
                               struct cache_entry *light, struct cache_entry *contracted,
                               struct cache_entry *fixed)
{
    bool fresh;
    struct cache_entry *entry = cache_get(model->server->cache, key, &fresh);
    if (!fresh) return entry;
    struct want *w = calloc(1, sizeof *w);
    struct pass *pass = model->pass;
    bool idle = !pass;
    if (w && !pass && (pass = calloc(1, sizeof *pass))) {
        pass->model = model;
        pass->last = &pass->first;
        model->pass = pass;
        model_hold(model);
    }
    if (!w || !pass) {
        free(w);
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    *w = (struct want){.entry = entry,
                       .file = file,
                       .light = light,
                       .contracted = contracted,
                       .fixed = fixed,
                       .query = *query};
    if (contracted) {
        cache_hold(contracted);
        model->server->stats.edits++;
    }
    if (fixed) {
        cache_hold(fixed);
        model->server->stats.fixed_used++;
    }
    cache_hold(entry);
    cache_hold(file);
    if (light) cache_hold(light);
    *pass->last = w;
    pass->last = &w->next;
    if (idle) start_pass(pass);
    return entry;
}
