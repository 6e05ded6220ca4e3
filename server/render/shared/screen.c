// SPDX-License-Identifier: MIT
// Radiance by an image-space engine at the points that a camera sees. An engine's state serves
// one worker at a time: evaluations of one shape and engine queue here; other shapes and
// engines run beside them.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { DEFAULT_MS = 100 }; // budget where neither engine nor budget is named; chosen

struct screen_job {
    struct cache_job job;
    struct screen_job *next; // of the slot's queue
    struct screen_slot *slot;
    struct cache_entry *shape, *visibility, *light, *map[3];
    struct screen_query query;
    unsigned n_want; // evaluations that wait for it
    bool unwanted;   // none does; read by the worker
};

// Chooses the engine with the least expected error. The last one stays unless its error or time
// is `worse` times larger: errors differ between engines, and a view's pictures would flicker.
static int choose_engine(const struct prt_context *ctx, const struct screen_job *job,
                         const struct prt_screen_input *input, double budget,
                         struct prt_screen_options *o)
{
    static const double worse = 1.5; // chosen, not measured
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

// Engine and samples: the query's, or those with the least expected error within the budget.
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

// Negative and non-finite values become 0: one of them would spoil the running mean for good.
static void clear_invalid(float (*rgb)[3], uint32_t n)
{
    for (uint32_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++)
            if (!isfinite(rgb[i][c]) || rgb[i][c] < 0) rgb[i][c] = 0;
}

static int is_unwanted(void *user, const char *stage, double fraction, double eta_s)
{
    return __atomic_load_n(&((struct screen_job *)user)->unwanted, __ATOMIC_RELAXED);
}

static int compute(struct screen_job *job, const struct prt_context *ctx,
                   struct screen_radiance *out)
{
    struct shape *shape = job->shape->value;
    const struct screen_query *q = &job->query;
    struct prt_screen_input input = {
        .visibility = job->visibility->value,
        .media = q->media ? *(const struct prt_media *)q->media->value : *shape->media,
        .cube = job->light->value};
    const struct prt_scene *scene;
    struct prt_screen_options options = {.frame = q->frame, .maps_checked = true};
    options.sigma_a_map = job->map[0] ? job->map[0]->value : NULL;
    options.normal_map = job->map[1] ? job->map[1]->value : NULL;
    options.bump_map = job->map[2] ? job->map[2]->value : NULL;
    int status = shape_scene(ctx, shape, &scene);
    if (!status && !job->slot->screen)
        status = prt_screen_create(ctx, &shape->mesh, scene, &job->slot->screen);
    if (!status) status = choose(ctx, job, &input, &options);
    if (!status) status = prt_progress(ctx, "screen", 0);
    if (!status)
        status = prt_screen_radiance(ctx, job->slot->screen, &input, &options, out->rgb,
                                     &out->report);
    if (!status) clear_invalid(out->rgb, out->n_point);
    return status;
}

static int run(struct cache_job *cache_job, const struct prt_context *shared)
{
    struct screen_job *job = (struct screen_job *)cache_job;
    struct prt_context ctx = *shared;
    struct prt_gbuffer g;
    struct screen_radiance *out;
    ctx.progress = is_unwanted; // the library cancels the work where it reports progress
    ctx.progress_user = job;
    if (prt_progress(&ctx, "screen", 0)) return PRT_CANCELLED;
    prt_visibility_gbuffer(job->visibility->value, &g);
    cache_job->value = out = malloc(sizeof *out + ((size_t)g.n_point + 1) * sizeof *out->rgb);
    if (!out) return PRT_NOMEM;
    cache_job->bytes = sizeof *out + g.n_point * sizeof *out->rgb;
    out->n_point = g.n_point;
    return compute(job, &ctx, out);
}

static void start_next(struct screen_slot *slot)
{
    struct screen_job *job = slot->first;
    if (slot->busy || !job) return;
    slot->first = job->next;
    if (!job->next) slot->last = &slot->first;
    slot->busy = job;
    cache_job_submit(&job->job);
}

static void done(struct cache_job *cache_job)
{
    struct screen_slot *slot = ((struct screen_job *)cache_job)->slot;
    slot->busy = NULL;
    start_next(slot);
}

// screen_radiance_unwant() cancels its jobs.
static const struct cache_job_kind kind = {
    .size = sizeof(struct screen_job),
    .run = run,
    .destroy = free,
    .done = done,
    .unwanted = cache_job_goes_on,
};

// The job that computes a pending entry.
static struct screen_job *find_job(struct cache_entry *shape, const struct cache_entry *entry)
{
    struct shape *s = shape->value;
    for (int i = 0; i < SHAPE_SLOTS; i++) {
        struct screen_job *job = s->slot[i].busy;
        if (job && job->job.entry == entry) return job;
        for (job = s->slot[i].first; job; job = job->next)
            if (job->job.entry == entry) return job;
    }
    return NULL;
}

// A running job is cancelled at its next progress report, a queued one when its turn comes. Its
// entry is forgotten at once, so that a later request of the same key computes another.
void screen_radiance_unwant(struct cache_entry *shape, struct cache_entry *entry)
{
    struct screen_job *job = find_job(shape, entry);
    if (!job || --job->n_want) return;
    __atomic_store_n(&job->unwanted, true, __ATOMIC_RELAXED);
    cache_forget_entry(entry);
}

// Interactive jobs go before those that refine a finished picture.
static void enqueue(struct screen_slot *slot, struct screen_job *job)
{
    struct screen_job **at = &slot->first;
    while (*at && (job->query.background || !(*at)->query.background)) at = &(*at)->next;
    job->next = *at;
    *at = job;
    if (!job->next) slot->last = &job->next;
    start_next(slot);
}

struct cache_entry *
screen_radiance_get(struct server *server, const char *key, const struct screen_query *query,
                    struct cache_entry *shape, struct cache_entry *visibility,
                    struct cache_entry *light, struct cache_entry *const map[3])
{
    struct cache_job *cache_job;
    struct cache_entry *entry = cache_compute(server, key, &kind, &cache_job);
    struct screen_job *job = (struct screen_job *)cache_job;
    if (!job) {
        job = find_job(shape, entry);
        if (job) job->n_want++;
        return entry;
    }
    job->slot = &((struct shape *)shape->value)->slot[query->slot];
    job->shape = shape;
    job->visibility = visibility;
    job->light = light;
    job->query = *query;
    job->n_want = 1;
    cache_job->work.class = query->background ? WORK_BACKGROUND : WORK_INTERACTIVE;
    cache_job_hold(cache_job, shape);
    cache_job_hold(cache_job, visibility);
    cache_job_hold(cache_job, light);
    cache_job_hold(cache_job, query->media);
    for (int k = 0; k < 3; k++) cache_job_hold(cache_job, job->map[k] = map[k]);
    enqueue(job->slot, job);
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
    if (r->principal) ledger_give(r->principal, LEDGER_PAYLOAD, r->charged);
    principal_release(r->principal);
    free(r->mean);
    free(r);
}

bool refinement_charge(struct refinement *r, struct principal *principal)
{
    const uint64_t bytes = ((uint64_t)r->n_point + 1) * sizeof *r->mean;
    char error[256];
    if (r->principal || !r->mean) return true;
    if (ledger_take(principal, LEDGER_PAYLOAD, bytes, error)) return false;
    principal_hold(r->principal = principal);
    r->charged = bytes;
    return true;
}

// The expected error of the mean falls more slowly than the -0.5 of independent errors, as part
// of an engine's error is the same in all frames; the exponent is chosen, not measured.
double refinement_error(const struct refinement *r)
{
    static const double tangent_floor = 0.01; // its error with one plane a pixel remains
    double e = r->expected_error * pow(r->n_mean > 1 ? r->n_mean : 1, -0.4);
    return r->engine == PRT_SCREEN_TANGENT ? fmax(e, fmin(tangent_floor, r->expected_error))
                                           : e;
}

// prt_screen_mean_add() gives picture k the weight k + 1, as the first ones are coarser. The
// newest changes the mean by 2 / (k + 1) of its own error; the mean's error is 2 / sqrt(3 k) of
// that.
int refinement_add(struct refinement *r, const struct screen_radiance *a)
{
    enum { LEAST = 32, MOST = 256 }; // frames in a mean; chosen, not measured
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
