// SPDX-License-Identifier: MIT
// Passes over a model's transport. While one runs, evaluations of the same model gather, and
// the next pass computes up to PRT_RELIGHT_MAX_LIGHTS of them: it reads the transport once for
// all their lights. Evaluations also join a pass that still waits for a worker. A second pass
// begins beside one that runs where it is full: threads that wait for the end of one's loops
// take pieces of the other's. The principals that wait take turns (render/shared/pass_share.h),
// and each principal's most urgent evaluations go first.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"
#include "render/shared/pass_share.h"
#include "render/shared/row_columns.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

// One evaluation of a pass. Its job completes with the pass and is never submitted by itself.
struct pass_item {
    struct cache_job job;
    struct pass_item *next;
    struct gathering *gathering;
    struct cache_entry *file, *light, *contracted_light, *contracted_material;
    struct vertex_query query;
    float *values; // floats: the entry's, or the pass's where the entry has encoded colours
    int status;
};

enum {
    MOST_PASSES = 2,   // of a model at a time
    SCRATCH_SHARE = 8, // a pass's scratch takes at most this part of --cache, or one item
    HOLD_NS = 1000000, // chosen, not measured: longer than 16 lights take to turn
};

struct pass {
    struct work work;
    struct gathering *gathering;
    struct pass_item *first; // the items it computes; NULL: it is free
    unsigned n;
    char payer[PRT_RELIGHT_MAX_LIGHTS][WORK_NAME]; // of the items: equal parts
    float *scratch; // of the worker: the colours of items that are encoded, [item][n_vertex][3]
    size_t n_scratch; // floats
    size_t charged;   // bytes of the scratch that the cache counts
    float ms;
};

// The passes of a model and what waits for the next one.
struct gathering {
    struct model *model;
    struct pass_item *first, **last;
    size_t n_waiting;
    size_t scratch_bytes;   // of one item
    unsigned most;          // items of a pass
    struct loop_timer hold; // while it waits for lights that are being turned
    uint64_t held_ns;       // since when; 0: it does not
    bool ending;            // the entries of a pass that has ended are being filled
    struct pass pass[MOST_PASSES];
    char before[PRT_RELIGHT_MAX_LIGHTS][WORK_NAME]; // payers of the last pass that ended
    unsigned n_before;
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

static const float (*item_gain(const struct variant_view *view))[3]
{
    return (const float(*)[3])view->variant->mesh.gain;
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
                              .gain = q->variant ? item_gain(q->variant->value) : NULL,
                              .eye = q->has_eye ? q->eye : NULL,
                              .lit = c ? c->contracted : NULL,
                              .most_apart = q->most_apart,
                              .exits = q->exits,
                              .most_rank = q->coefficients ? 0 : q->most_rank};
}

static bool is_encoded(const struct pass_item *item)
{
    return item->query.format != RELIGHT__COLOR_FORMAT__COLOR_F32;
}

// Allocates the item's values; their size depends on the transport.
static int allocate_values(const struct prt_context *ctx, struct pass_item *item)
{
    const struct prt_transport *t = file_transport(item);
    struct prt_query query = item_query(item);
    struct prt_coefficients rows = {.most_rank = item->query.most_rank,
                                    .phases = item->query.phases,
                                    .packed = item->query.packed};
    struct vertex_values *values;
    unsigned n_plane = 1;
    double error = 0;
    int status = item->query.coefficients ? prt_coefficients_plan(ctx, t, &query, &rows)
                 : item->query.planes     ? prt_answer_planes(ctx, t, &query, &n_plane, NULL)
                                          : PRT_OK;
    if (!status && query.media.n)
        status = prt_answer_material_error(ctx, t, &query.media, query.term, &error);
    if (status) return status;
    const size_t each = t->mesh.n_vertex * color_bytes(item->query.format);
    item->job.bytes =
        sizeof *values +
        (item->query.coefficients ? rows.n_half * sizeof(uint16_t) : n_plane * each);
    item->job.value = values = malloc(item->job.bytes);
    if (!values) return PRT_NOMEM;
    if (item->query.coefficients) memset(values, 0, item->job.bytes); // between layers
    values->coefficients = rows;
    values->coefficients.half = (uint16_t *)values->values;
    values->n_plane = n_plane;
    values->n_exit = query.most_apart ? prt_answer_exit_planes(t, &query) : 0;
    values->n_vertex = t->mesh.n_vertex;
    values->material_error = (float)error;
    item->values = values->values;
    return PRT_OK;
}

// Gives the items whose colours are encoded room for floats, which passes use again.
static int share_scratch(struct pass *pass, struct pass_item *const item[], unsigned n)
{
    const size_t each = 3 * (size_t)file_transport(item[0])->mesh.n_vertex;
    size_t all = 0;
    for (unsigned i = 0; i < n; i++) all += is_encoded(item[i]) ? each : 0;
    if (all > pass->n_scratch) {
        prt_free(pass->scratch);
        pass->scratch = prt_alloc(all, sizeof *pass->scratch);
        pass->n_scratch = pass->scratch ? all : 0;
        if (!pass->scratch) return PRT_NOMEM;
    }
    for (unsigned i = n; i-- > 0;)
        if (is_encoded(item[i])) item[i]->values = pass->scratch + (all -= each);
    return PRT_OK;
}

// The items of one call of the library, by the number of their query.
struct asked {
    struct pass_item *item[PRT_RELIGHT_MAX_LIGHTS];
    bool encoded[PRT_RELIGHT_MAX_LIGHTS];
};

static void encode_item(void *user, const struct prt_context *ctx, unsigned i, size_t begin,
                        size_t end, const float (*color)[3])
{
    const struct pass_item *item = ((struct asked *)user)->item[i];
    const struct vertex_query *q = &item->query;
    uint8_t *to = (uint8_t *)((struct vertex_values *)item->job.value)->values;
    encode_some_colors(ctx, q->format, q->exposure_ev, color[0], end - begin,
                       to + color_bytes(q->format) * begin);
}

// Evaluates items of the same transport and kind together: they share one reading of it.
static int evaluate(const struct prt_context *ctx, struct pass_item *const item[], unsigned n)
{
    struct prt_query query[PRT_RELIGHT_MAX_LIGHTS];
    bool planes[PRT_RELIGHT_MAX_LIGHTS], done[PRT_RELIGHT_MAX_LIGHTS] = {false};
    float *out[PRT_RELIGHT_MAX_LIGHTS];
    struct prt_coefficients *rows[PRT_RELIGHT_MAX_LIGHTS];
    struct asked asked;
    const struct prt_colors_sink sink = {asked.encoded, encode_item, &asked};
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
            asked.item[m] = item[i];
            asked.encoded[m] = is_encoded(item[i]);
            out[m++] = item[i]->values;
        }
        if (m && coefficients) status = prt_answer_coefficients(ctx, t, m, query, rows);
        else if (m) status = prt_answer_many(ctx, t, m, query, planes, out, &sink);
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
    for (struct pass_item *item = pass->first; item; item = item->next) {
        work->error[0] = 0;
        int status = allocate_values(ctx, item);
        if (status) fail_item(work, item, status);
        else good[n++] = item;
    }
    work->error[0] = 0;
    int status = n ? share_scratch(pass, good, n) : PRT_OK;
    if (!status && n) status = evaluate(ctx, good, n);
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

// The scratch counts from before it is allocated until the gathering ends.
static void charge_scratch(struct pass *pass)
{
    size_t bytes = 0;
    for (const struct pass_item *item = pass->first; item; item = item->next)
        if (is_encoded(item)) bytes += pass->gathering->scratch_bytes;
    if (bytes <= pass->charged) return;
    cache_charge(pass->gathering->model->server->cache, bytes - pass->charged);
    pass->charged = bytes;
}

// Submits the pass for its items: as the first one's work, of the most urgent's class.
static void submit(struct pass *pass)
{
    struct work_pool *pool = pass->gathering->model->server->work;
    struct work_actor actor = pass->first->job.actor;
    unsigned n = 0;
    for (const struct pass_item *item = pass->first; item; item = item->next) {
        if (item->job.actor.class < actor.class) actor.class = item->job.actor.class;
        snprintf(pass->payer[n++], WORK_NAME, "%s", item->job.actor.name);
    }
    charge_scratch(pass);
    pass->work.run = run_pass;
    pass->work.done = pass_done;
    pass->work.class = WORK_INTERACTIVE;
    pass->work.share = (const char(*)[WORK_NAME])pass->payer;
    pass->work.n_share = pass->n = n;
    struct work_actor before = work_act(pool, actor);
    work_submit(pool, &pass->work);
    work_act(pool, before);
}

// Moves the items of this class that their principals' grants cover to the pass.
static void choose_class(struct pass *pass, int class, struct pass_share *share,
                         struct pass_item ***end)
{
    struct gathering *g = pass->gathering;
    for (struct pass_item **at = &g->first; *at && share->n_granted;) {
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
        pass->n++;
        g->n_waiting--;
    }
}

static void set_last(struct gathering *g)
{
    for (g->last = &g->first; *g->last;) g->last = &(*g->last)->next;
}

static void share_places(const struct gathering *g, struct pass_share *share)
{
    unsigned seen = 0;
    *share = (struct pass_share){0};
    for (const struct pass_item *i = g->first; i && seen++ < PASS_SHARE_SEEN; i = i->next)
        pass_share_add(share, i->job.actor.name);
    // Clients that wait for the answers of other passes come back.
    for (unsigned i = 0; i < g->n_before; i++) pass_share_before(share, g->before[i]);
    for (unsigned k = 0; k < MOST_PASSES; k++)
        for (unsigned i = 0; g->pass[k].first && i < g->pass[k].n; i++)
            pass_share_before(share, g->pass[k].payer[i]);
    pass_share_grant(share, g->most);
}

static void start_pass(struct pass *pass, struct pass_share *share)
{
    struct pass_item **end = &pass->first;
    pass->n = 0;
    for (int class = 0; class < WORK_N_CLASS; class ++) choose_class(pass, class, share, &end);
    set_last(pass->gathering);
    submit(pass);
}

// A pass that waits for a worker is chosen anew, with the item that came since, where it has
// room and nothing else waits.
static bool rejoin(struct pass *pass)
{
    struct gathering *g = pass->gathering;
    struct pass_share share;
    if (!pass->first || pass->n >= g->most || g->n_waiting != 1 || !work_take_back(&pass->work))
        return false;
    struct pass_item *newest = g->first, **end = &pass->first;
    while (*end) end = &(*end)->next;
    *end = newest;
    g->first = pass->first;
    g->n_waiting += pass->n;
    pass->first = NULL;
    share_places(g, &share);
    start_pass(pass, &share);
    return true;
}

static void hold_ended(struct loop_timer *timer);

// Whether the next pass waits for evaluations whose lights are being turned: they come soon and
// share it. Not for long, as their turn may come after other work.
static bool holds(struct gathering *g)
{
    if (!g->model->n_turning) return false;
    const uint64_t now = loop_now_ns();
    if (!g->held_ns) g->held_ns = now;
    if (now - g->held_ns >= HOLD_NS) return false;
    g->hold.fire = hold_ended;
    if (!g->hold.armed) loop_timer_set(g->model->server->loop, &g->hold, g->held_ns + HOLD_NS);
    return true;
}

// Starts a pass with what waits: where none runs, or where it is full.
static void go_on(struct gathering *g)
{
    struct pass *idle = NULL;
    struct pass_share share;
    bool any = false;
    for (unsigned k = 0; k < MOST_PASSES; k++) {
        any |= g->pass[k].first != NULL;
        if (!g->pass[k].first) idle = &g->pass[k];
    }
    if (!g->first || !idle || (g->n_waiting < g->most && (any || holds(g)))) return;
    g->held_ns = 0;
    share_places(g, &share);
    if (!any || share.n_granted == g->most) start_pass(idle, &share);
}

static void hold_ended(struct loop_timer *timer)
{
    go_on((struct gathering *)((char *)timer - offsetof(struct gathering, hold)));
}

// Frees the gathering where nothing runs or waits, and no pass is ending.
static void end_gathering(struct gathering *g)
{
    if (g->first || g->ending) return;
    for (unsigned k = 0; k < MOST_PASSES; k++)
        if (g->pass[k].first) return;
    g->model->gathering = NULL;
    loop_timer_stop(g->model->server->loop, &g->hold);
    for (unsigned k = 0; k < MOST_PASSES; k++) {
        prt_free(g->pass[k].scratch);
        cache_discharge(g->model->server->cache, g->pass[k].charged);
    }
    model_release(g->model);
    free(g);
}

static bool unlink_item(struct pass_item **at, const struct pass_item *item)
{
    while (*at && *at != item) at = &(*at)->next;
    if (!*at) return false;
    *at = item->next;
    return true;
}

// Takes the item out of the pass that has it, where that waits for a worker.
static bool leave_pass(struct gathering *g, struct pass_item *item)
{
    for (unsigned k = 0; k < MOST_PASSES; k++) {
        struct pass *pass = &g->pass[k];
        const struct pass_item *own = pass->first;
        while (own && own != item) own = own->next;
        if (!own) continue;
        if (!work_dequeue(&pass->work)) return false;
        unlink_item(&pass->first, item);
        if (pass->first) submit(pass);
        return true;
    }
    return false;
}

// Taken out of the next pass, or of one that waits for a worker; a running pass continues.
static void item_unwanted(struct cache_job *job)
{
    struct pass_item *item = (struct pass_item *)job;
    struct gathering *g = item->gathering;
    if (unlink_item(&g->first, item)) {
        g->n_waiting--;
        set_last(g);
        g->model->server->stats.items_withdrawn++;
    } else if (leave_pass(g, item)) {
        go_on(g);
        end_gathering(g);
    } else {
        cache_forget_entry(job->entry);
        return;
    }
    snprintf(job->work.error, sizeof job->work.error, "nobody waits for it any more");
    cache_job_complete(job, PRT_CANCELLED);
}

static void count_pass(struct stats *stats, unsigned n)
{
    stats->passes++;
    stats->relights += n;
    stats_batch(stats, n);
    if (n > 1) stats->shared += n;
}

static void pass_done(struct work *work)
{
    struct pass *pass = (struct pass *)work;
    struct gathering *g = pass->gathering;
    struct pass_item *item = pass->first;
    const float ms = pass->ms;
    const unsigned n = g->n_before = pass->n;
    memcpy(g->before, pass->payer, sizeof g->before);
    count_pass(&g->model->server->stats, n);
    pass->first = NULL;
    // Before the entries are filled: their waiters may call relight_pass_get(), and leave the
    // entries that are filled after theirs.
    g->ending = true;
    go_on(g);
    while (item) {
        struct pass_item *next = item->next;
        item->job.ms = ms;
        if (item->light && !item->contracted_material)
            row_columns_count(g->model, item->file, 1);
        if (!item->status) ((struct vertex_values *)item->job.value)->shared = n;
        cache_job_complete(&item->job, item->status);
        item = next;
    }
    g->ending = false;
    end_gathering(g);
}

static struct gathering *create_gathering(struct model *model, const struct prt_file *file)
{
    struct gathering *g = calloc(1, sizeof *g);
    if (!g) return NULL;
    const size_t share = cache_budget(model->server->cache) / SCRATCH_SHARE;
    g->model = model;
    g->scratch_bytes = 3 * (size_t)prt_file_transport(file)->mesh.n_vertex * sizeof(float);
    g->most = g->scratch_bytes >= share ? 1 : (unsigned)(share / (g->scratch_bytes + 1));
    if (g->most > PRT_RELIGHT_MAX_LIGHTS) g->most = PRT_RELIGHT_MAX_LIGHTS;
    g->last = &g->first;
    for (unsigned k = 0; k < MOST_PASSES; k++) g->pass[k].gathering = g;
    model->gathering = g;
    model_hold(model);
    return g;
}

// The newest of the items that wait.
static void add_item(struct gathering *g, struct pass_item *item)
{
    *g->last = item;
    g->last = &item->next;
    g->n_waiting++;
    for (unsigned k = 0; k < MOST_PASSES; k++)
        if (rejoin(&g->pass[k])) return;
    go_on(g);
}

void relight_pass_go_on(struct model *model)
{
    if (model->gathering) go_on(model->gathering);
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
    struct gathering *g =
        model->gathering ? model->gathering : create_gathering(model, file->value);
    if (!g) {
        cache_job_complete(job, PRT_NOMEM);
        return entry;
    }
    struct pass_item *item = (struct pass_item *)job;
    item->query = *query;
    item->gathering = g;
    cache_job_hold(job, query->media);
    cache_job_hold(job, query->variant);
    cache_job_hold(job, item->file = file);
    cache_job_hold(job, item->light = light);
    cache_job_hold(job, item->contracted_light = contracted_light);
    cache_job_hold(job, item->contracted_material = contracted_material);
    if (contracted_light) model->server->stats.edits++;
    if (contracted_material) model->server->stats.fixed_used++;
    add_item(g, item);
    return entry;
}
