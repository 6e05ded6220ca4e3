// SPDX-License-Identifier: MIT
// Light by an image-space engine on the points a camera sees. An engine's state serves one
// worker at a time: evaluations of one shape and engine queue here, those of others run beside
// them.
#include "render/evaluation.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { DEFAULT_MS = 100 }; // what the daemon's own choice may cost where no budget is named

struct screen_job {
    struct work work;
    struct screen_job *next;
    struct screen_slot *slot;
    struct server *server;
    struct cache_entry *entry, *shape, *seen, *light, *map[3];
    struct screen_query query;
    struct screen_answer *answer;
    unsigned n_want; // who asked and still wants it
    bool unwanted;   // nobody does: read by the worker
    float ms;
};

static void end_job(struct screen_job *job)
{
    cache_release(job->entry);
    cache_release(job->shape);
    cache_release(job->seen);
    cache_release(job->light);
    for (int k = 0; k < 3; k++) cache_release(job->map[k]);
    free(job);
}

// The engine with the least expected error; the one before it stays unless it does much worse:
// each has an error of its own, and pictures of one view are not to jump between them.
static int choose_engine(const struct prt_context *ctx, const struct screen_job *job,
                         const struct prt_screen_input *input, double budget,
                         struct prt_screen_options *o)
{
    static const double worse = 1.5;
    struct screen_slot *slot = job->slot;
    struct prt_screen_plan best, last;
    struct prt_screen_options own = *o;
    int status = prt_screen_choose(ctx, slot->screen, input, budget, o, &best);
    if (!status && slot->engine && (int)best.engine + 1 != slot->engine) {
        status =
            prt_screen_plan(ctx, slot->screen, input,
                            (enum prt_screen_engine)(slot->engine - 1), budget, &own, &last);
        if (!status && last.expected_error < worse * best.expected_error &&
            last.expected_ms < worse * fmax(budget, best.expected_ms))
            *o = own;
    }
    if (!status) slot->engine = (int)o->engine + 1;
    return status;
}

// Engine and samples: as they are told, or what the time buys with the least expected error.
static int choose(const struct prt_context *ctx, const struct screen_job *job,
                  const struct prt_screen_input *input, struct prt_screen_options *o)
{
    const struct screen_query *q = &job->query;
    if (q->n_sample) {
        o->engine = (enum prt_screen_engine)q->engine;
        o->n_sample = q->n_sample;
        return PRT_OK;
    }
    double budget = q->budget_ms > 0 ? (double)q->budget_ms : DEFAULT_MS;
    if (q->engine < 0) return choose_engine(ctx, job, input, budget, o);
    o->engine = (enum prt_screen_engine)q->engine;
    if (!(q->budget_ms > 0)) return PRT_OK; // the engine's own count
    return prt_screen_plan(ctx, job->slot->screen, input, o->engine, budget, o, NULL);
}

// A value that is not finite would spread over the whole running mean.
static void mend(float (*rgb)[3], uint32_t n)
{
    for (uint32_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++)
            if (!isfinite(rgb[i][c]) || rgb[i][c] < 0) rgb[i][c] = 0;
}

static int give_up(void *user, const char *stage, double fraction, double eta_s)
{
    return __atomic_load_n(&((struct screen_job *)user)->unwanted, __ATOMIC_RELAXED);
}

static int run_job(struct work *work, const struct prt_context *shared)
{
    struct screen_job *job = (struct screen_job *)work;
    struct prt_context own = *shared, *ctx = &own;
    own.progress = give_up; // wherever the library asks
    own.progress_user = job;
    struct shape *shape = job->shape->value;
    const struct screen_query *q = &job->query;
    struct prt_screen_input input = {.visibility = job->seen->value,
                                     .material =
                                         q->has_material ? &q->material : shape->material,
                                     .cube = job->light->value};
    const struct prt_scene *scene;
    struct prt_gbuffer g;
    double start = prt_time_s();
    if (prt_progress(ctx, "screen", 0)) return PRT_CANCELLED;
    prt_visibility_gbuffer(job->seen->value, &g);
    job->answer =
        malloc(sizeof *job->answer + ((size_t)g.n_point + 1) * sizeof *job->answer->rgb);
    if (!job->answer) return PRT_NOMEM;
    job->answer->n_point = g.n_point;
    int status = shape_scene(ctx, shape, &scene);
    if (!status && !job->slot->screen)
        status = prt_screen_create(ctx, &shape->mesh, scene, &job->slot->screen);
    struct prt_screen_options options = {.frame = q->frame, .maps_checked = true};
    options.sigma_a_map = job->map[0] ? job->map[0]->value : NULL;
    options.normal_map = job->map[1] ? job->map[1]->value : NULL;
    options.bump_map = job->map[2] ? job->map[2]->value : NULL;
    if (!status) status = choose(ctx, job, &input, &options);
    if (!status) status = prt_progress(ctx, "screen", 0);
    if (!status)
        status = prt_screen_radiance(ctx, job->slot->screen, &input, &options, job->answer->rgb,
                                     &job->answer->report);
    if (!status) mend(job->answer->rgb, g.n_point);
    job->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void start_next(struct screen_slot *slot);

static void done_job(struct work *work)
{
    struct screen_job *job = (struct screen_job *)work;
    struct cache_entry *shape = job->shape;
    struct screen_slot *slot = job->slot;
    cache_hold(shape); // the slot is its
    job->entry->ms = job->ms;
    slot->busy = NULL;
    start_next(slot);
    if (work->status) {
        free(job->answer);
        cache_fail(job->entry, error_of_status(work->status), work->error);
    } else {
        cache_fill(job->entry, job->answer,
                   sizeof *job->answer + job->answer->n_point * sizeof *job->answer->rgb, free);
    }
    end_job(job);
    cache_release(shape);
}

static void start_next(struct screen_slot *slot)
{
    struct screen_job *job = slot->first;
    if (slot->busy || !job) return;
    slot->first = job->next;
    if (!job->next) slot->last = &slot->first;
    slot->busy = job;
    job->work.run = run_job;
    job->work.done = done_job;
    job->work.class = job->query.background ? WORK_BACKGROUND : WORK_INTERACTIVE;
    work_submit(job->server->work, &job->work);
}

// The job that makes a pending entry.
static struct screen_job *find_job(struct cache_entry *shape, const struct cache_entry *entry)
{
    struct shape *s = shape->value;
    for (int i = 0; i < SHAPE_SLOTS; i++) {
        struct screen_job *job = s->slot[i].busy;
        if (job && job->entry == entry) return job;
        for (job = s->slot[i].first; job; job = job->next)
            if (job->entry == entry) return job;
    }
    return NULL;
}

// It stops where it can, and one that waits for its turn ends when that comes; whoever asks the
// same from now on gets another.
void screen_unwant(struct cache_entry *shape, struct cache_entry *entry)
{
    struct screen_job *job = find_job(shape, entry);
    if (!job || --job->n_want) return;
    __atomic_store_n(&job->unwanted, true, __ATOMIC_RELAXED);
    cache_forget_entry(entry);
}

struct cache_entry *screen_get(struct server *server, const char *key,
                               const struct screen_query *query, struct cache_entry *shape,
                               struct cache_entry *seen, struct cache_entry *light,
                               struct cache_entry *const map[3])
{
    bool fresh;
    struct cache_entry *entry = cache_get(server->cache, key, &fresh);
    struct screen_job *job = fresh ? calloc(1, sizeof *job) : find_job(shape, entry);
    if (!fresh) {
        if (job) job->n_want++;
        return entry;
    }
    if (!job) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    struct screen_slot *slot = &((struct shape *)shape->value)->slot[query->slot];
    *job = (struct screen_job){.slot = slot,
                               .server = server,
                               .entry = entry,
                               .shape = shape,
                               .seen = seen,
                               .light = light,
                               .query = *query,
                               .n_want = 1};
    cache_hold(entry);
    cache_hold(shape);
    cache_hold(seen);
    cache_hold(light);
    for (int k = 0; k < 3; k++) {
        if ((job->map[k] = map[k])) cache_hold(map[k]);
    }
    // What somebody looks at goes before what refines a picture that is there.
    struct screen_job **at = &slot->first;
    while (*at && (query->background || !(*at)->query.background)) at = &(*at)->next;
    job->next = *at;
    *at = job;
    if (!job->next) slot->last = &job->next;
    start_next(slot);
    return entry;
}

// ---- running means

struct refinement *refinement_create(void)
{
    struct refinement *r = calloc(1, sizeof *r);
    if (r) r->refs = 1;
    return r;
}

void refinement_release(struct refinement *r)
{
    if (!r || --r->refs) return;
    free(r->mean);
    free(r);
}

// What the daemon foresees of the mean: engines have part of their error in common to all
// frames.
double refinement_error(const struct refinement *r)
{
    static const double tangent_floor = 0.01; // one irradiance and one plane for a pixel
    double e = r->expected_error * pow(r->n_mean > 1 ? r->n_mean : 1, -0.4);
    return r->engine == PRT_SCREEN_TANGENT ? fmax(e, fmin(tangent_floor, r->expected_error))
                                           : e;
}

// The newest picture k moves the mean by 2 / (k + 1) of its own error, and the mean is off by
// 2 / sqrt(3 k) of that.
int refinement_add(struct refinement *r, const struct screen_answer *a)
{
    enum { LEAST = 32, MOST = 256 }; // engines take finer steps at the first few
    static const double close_enough = 0.001;
    if (r->mean && r->n_point != a->n_point) return PRT_INTERNAL;
    if (!r->mean && !(r->mean = malloc(((size_t)a->n_point + 1) * sizeof *r->mean)))
        return PRT_NOMEM;
    bool first = !r->n_mean || r->engine != (int)a->report.engine;
    if (first) {
        r->n_mean = 0;
        r->engine = (int)a->report.engine;
        r->n_sample = a->report.n_asked;
        r->expected_error = a->report.expected_error;
    }
    double change =
        prt_screen_mean_add(r->n_mean, a->n_point, (const float(*)[3])a->rgb, r->mean);
    r->n_point = a->n_point;
    r->n_frame++;
    r->n_mean++;
    double left = change * sqrt(r->n_mean / 3.0);
    bool black = change < 0;
    r->converged = black || r->n_mean >= MOST || (r->n_mean >= LEAST && left < close_enough);
    return PRT_OK;
}
