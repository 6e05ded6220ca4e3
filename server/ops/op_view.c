// SPDX-License-Identifier: MIT
// Views: a state whose changes the daemon answers with frames. A view has one evaluation at a
// time and draws the newest state next, so that fast changes skip states and do not queue. At
// most `window` frames, and about `window_bytes` of them, are unacknowledged, so that a slow
// reader delays only itself. While the state does not change, a picture by an image-space
// engine is refined until it converges. While the hand moves and whole frames do not keep the
// rate, pictures have half the width and height, and colours and coefficients are made of fewer
// rows of the transport; on a slow link colours are of fewer vertices; the state that rests is
// drawn in full. Where a bake replaces the draft that was drawn, some frames mix the two, so
// that the picture changes without a step.
#include "net/dispatch.h"
#include "ops/view_pace.h"
#include "ops/view_state.h"
#include "render/evaluation.h"
#include "core/log.h"
#include "store/models.h"
#include "store/versions.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t retry_ns = 250000000; // between two attempts while the model is baking
static const uint64_t rest_ns = 120000000;  // refinement begins when the state is this old
// Between states of a hand that moves, and between frames that it can follow: chosen, not
// measured.
static const uint64_t moving_ns = 250000000, steady_gap_ns = 66666667;

// 16 rows of a cluster leave an error of 0.5 % on a bunny in marble, and a third of the cost.
// Frames in which a bake replaces its draft, and the least time between them.
enum { FADE_FRAMES = 12 };
static const uint64_t fade_gap_ns = 40000000;
enum { REDUCED = 2, REDUCED_LEAST = 64, REDUCED_RANK = 16 };

struct view {
    struct request *request;
    struct model *model;
    char *name;               // of a folder of versions, whose newest it shows; NULL: none
    struct render_spec spec;  // the newest state
    uint64_t sequence;        // of it
    bool dirty;               // the state was not drawn yet
    struct render *render;    // of the frame that is being drawn; NULL: none
    struct render_spec drawn; // its spec, without what specs share
    uint64_t drawn_sequence;
    uint64_t frame, shown, dropped;
    struct view_options options;
    uint64_t unshown_bytes;                  // payloads of the frames after `shown`
    uint64_t frame_bytes[SERVER_MAX_WINDOW]; // of frame i at i % SERVER_MAX_WINDOW
    uint64_t frame_ns[SERVER_MAX_WINDOW];    // when it was sent; 0: its state rests
    uint8_t frame_level[SERVER_MAX_WINDOW];  // of `pace`
    uint64_t shown_ns;                       // when a frame was acknowledged last
    struct view_pace pace;                   // of colours, with options.coarse
    uint64_t last_hash;                      // of the last frame's payload; 0: it had none
    uint64_t next_ns;                        // max_fps
    struct loop_timer late;                  // frame_deadline_ms of the frame that is drawn
    bool told_not_ready;                     // by the last frame
    uint64_t told_sequence;                  // of it
    struct loop_timer timer;
    struct model_watcher watcher;
    struct refinement *refinement; // of the state that was drawn; NULL: none
    bool refining;                 // `render` refines the state that was drawn
    uint32_t told_frames;          // pictures in the mean of the last sent frame
    uint64_t changed_ns;           // when the state last changed
    struct work_actor actor;       // who opened it, and its priority
    bool moving;                   // states follow each other quickly
    bool reduced;                  // the last drawn picture is of a lower resolution
    struct model *draft;           // held: the draft that the last frames are of; NULL: none
    unsigned faded;                // frames that mixed it with the bake
    uint64_t drawn_ns,
        full_ns; // when its drawing began; what whole frames take, a running mean
};

static void draw(struct view *v);

static void free_view(struct view *v)
{
    loop_timer_stop(v->model->server->loop, &v->timer);
    loop_timer_stop(v->model->server->loop, &v->late);
    model_unwatch(v->model, &v->watcher);
    if (v->render) render_cancel(v->render);
    refinement_release(v->refinement);
    render_spec_finish(&v->spec);
    model_release(v->draft);
    free(v->name);
    v->model->server->stats.views_open--;
    model_release(v->model);
    free(v);
}

static void abandon(struct request *request)
{
    free_view(request->state);
}

static void timer_fired(struct loop_timer *timer)
{
    draw((struct view *)((char *)timer - offsetof(struct view, timer)));
}

static void retry(struct view *v, uint64_t at_ns)
{
    v->timer.fire = timer_fired;
    loop_timer_set(v->model->server->loop, &v->timer, at_ns);
}

// The state differs from the drawn one: discards the running mean.
static void invalidate(struct view *v)
{
    v->dirty = true;
    v->changed_ns = loop_now_ns();
    refinement_release(v->refinement);
    v->refinement = NULL;
    if (!v->refining || !v->render) return;
    render_cancel(v->render);
    v->render = NULL;
    v->refining = false;
}

static void model_has_changed(struct model_watcher *watcher)
{
    struct view *v = (struct view *)((char *)watcher - offsetof(struct view, watcher));
    invalidate(v);
    retry(v, loop_now_ns()); // not at once: the model is still being changed
}

// Counts the frame's payload among those that the client has not acknowledged.
static void count_frame(struct view *v, uint64_t bytes)
{
    v->frame_bytes[v->frame % SERVER_MAX_WINDOW] = bytes;
    v->frame_ns[v->frame % SERVER_MAX_WINDOW] = v->moving ? loop_now_ns() : 0;
    v->unshown_bytes += bytes;
}

static void acknowledge(struct view *v, uint64_t shown)
{
    if (shown > v->frame) shown = v->frame;
    if (shown > v->shown) {
        const uint64_t sent = v->frame_ns[shown % SERVER_MAX_WINDOW];
        v->shown_ns = loop_now_ns();
        if (sent)
            view_pace_acknowledged(&v->pace, (double)(v->shown_ns - sent) * 1e-6,
                                   v->frame_level[shown % SERVER_MAX_WINDOW]);
    }
    while (v->shown < shown) v->unshown_bytes -= v->frame_bytes[++v->shown % SERVER_MAX_WINDOW];
}

static bool window_full(const struct view *v)
{
    const struct view_options *o = &v->options;
    return v->frame - v->shown >= o->window ||
           (o->window_bytes && v->unshown_bytes >= o->window_bytes);
}

static void send_frame(struct view *v, struct render_result *result)
{
    Relight__ViewFrame out = RELIGHT__VIEW_FRAME__INIT;
    Relight__ColorsAnswer colors;
    struct render_coefficients_message coefficients;
    Relight__ImageAnswer image;
    Relight__Error error;
    struct error_fields fields;
    struct render_camera_message camera;
    Relight__Cost cost;
    char text[500];
    render_cost_message(result, &cost);
    const unsigned level = v->drawn.coarse;
    cost.reduced = level ? 1u << level : v->reduced ? REDUCED : 0;
    v->request->server->stats.frames_reduced += cost.reduced > 0;
    stats_work(&v->request->server->stats, RELIGHT_TYPE_VIEW_OPEN, (double)cost.queue_ms * 1e-3,
               (double)(cost.total_ms - cost.queue_ms) * 1e-3);
    out.frame = ++v->frame;
    out.sequence = v->drawn_sequence;
    if (result->code) {
        blobs_name_in_text(v->request->server->blobs, v->request->conn->caller.name,
                           result->error, text, sizeof text);
        error_fill(&error, result->code, text, &fields);
        out.error = &error;
    } else if (v->spec.picture) {
        render_image_message(result, &v->drawn, &image, &camera);
        image.cost = &cost;
        out.image = &image;
    } else {
        render_colors_message(result, &v->drawn, &colors, &coefficients);
        colors.cost = &cost;
        out.colors = &colors;
    }
    struct payload *payload = result->code ? NULL : &result->payload;
    out.hash = payload ? result->hash : 0;
    out.equal = v->options.skip_equal && out.hash && out.hash == v->last_hash;
    v->last_hash = out.hash;
    if (out.equal) {
        if (payload->release) payload->release(payload->owner);
        payload = NULL;
    }
    count_frame(v, payload ? payload->size : 0);
    v->frame_level[v->frame % SERVER_MAX_WINDOW] = (uint8_t)level;
    v->request->server->stats.frames_sent++;
    request_part(v->request, &out.base, payload);
}

// Means of 1, 2, 4, 8, … pictures are sent, and the last.
static bool send_after(const struct view *v, uint32_t n_frame)
{
    return n_frame >= 2 * v->told_frames || v->refinement->converged;
}

// The next of the frames that mix draft and bake follows, or the bake's own.
static void count_faded(struct view *v)
{
    uint64_t gap = v->options.gap_ns > fade_gap_ns ? v->options.gap_ns : fade_gap_ns;
    v->faded++;
    v->dirty = true;
    v->next_ns = loop_now_ns() + gap;
}

static void drop_draft(struct view *v)
{
    model_release(v->draft);
    v->draft = NULL;
    v->faded = 0;
}

// Keeps the draft that answers from now on, or has the spec fade from the one that did.
static void use_draft(struct view *v, struct render_spec *spec)
{
    struct model *answering = model_answering(v->model);
    if (answering != v->model) {
        if (v->draft == answering) return;
        drop_draft(v);
        model_hold(v->draft = answering);
    } else if (v->draft && v->faded + 1 < FADE_FRAMES) {
        spec->fade_from = v->draft;
        spec->fade = (float)(v->faded + 1) / FADE_FRAMES;
    } else {
        drop_draft(v);
    }
}

// A frame of a quarter of the pixels tells whether whole ones would keep the rate again: it
// stands for twice its time, because light and transport do not shrink.
static void measure_frame(struct view *v)
{
    uint64_t took = (loop_now_ns() - v->drawn_ns) * (v->reduced ? 2 : 1);
    v->full_ns = v->full_ns ? v->full_ns - v->full_ns / 4 + took / 4 : took;
}

static void drawn(void *user, struct render_result *result)
{
    struct view *v = user;
    struct connection *conn = v->request->conn;
    bool finer = v->refining;
    // One that missed its deadline took at least so long: the next may be reduced.
    if (!finer && (!result->code || result->code == RELIGHT__ERROR_CODE__ERROR_DEADLINE))
        measure_frame(v);
    if (!finer && !result->draft) drop_draft(v);
    else if (!finer && v->drawn.fade_from) count_faded(v);
    loop_timer_stop(v->model->server->loop, &v->late);
    v->render = NULL;
    v->refining = false;
    bool not_ready = result->code == RELIGHT__ERROR_CODE__ERROR_NOT_READY;
    // Each state has one such frame.
    bool silent = not_ready && v->told_not_ready && v->told_sequence == v->drawn_sequence;
    v->told_not_ready = not_ready;
    v->told_sequence = v->drawn_sequence;
    if (finer && result->code) { // the last picture remains
        refinement_release(v->refinement);
        v->refinement = NULL;
        silent = true;
    }
    if (finer && !result->payload.bytes) silent = true;
    if (!silent) {
        v->told_frames = result->frames;
        send_frame(v, result);
    } else if (result->payload.release) {
        result->payload.release(result->payload.owner);
    }
    free(result->outgoing);
    result->outgoing = NULL;
    if (conn->dead) return; // the view was freed with it
    // Pictures by baked transport are not refined, nor one whose mean is beyond the limits.
    if (!finer &&
        (result->code || !result->preview ||
         (v->refinement && !refinement_charge(v->refinement, v->request->principal)))) {
        refinement_release(v->refinement);
        v->refinement = NULL;
    }
    if (not_ready) {
        v->dirty = true;
        retry(v, loop_now_ns() + retry_ns);
    } else {
        draw(v);
    }
}

// The frame took longer than frame_deadline_ms.
static void frame_late(struct loop_timer *timer)
{
    struct view *v = (struct view *)((char *)timer - offsetof(struct view, late));
    struct render_result result = {.code = RELIGHT__ERROR_CODE__ERROR_DEADLINE};
    if (!v->render) return;
    render_cancel(v->render);
    snprintf(result.error, sizeof result.error,
             "the frame was not ready after %llu ms (frame_deadline_ms)",
             (unsigned long long)(v->options.deadline_ns / 1000000));
    v->request->server->stats.deadline_total++;
    drawn(v, &result);
}

// True when the last picture should be refined now; sets the timer where it should be later.
static bool should_refine(struct view *v, uint64_t now)
{
    const struct refinement *mean = v->refinement;
    // A converged mean is still sent once.
    if (v->dirty || !mean || (mean->converged && v->told_frames >= mean->n_frame)) return false;
    if (now >= v->changed_ns + rest_ns) return true;
    retry(v, v->changed_ns + rest_ns);
    return false;
}

// Whether the model's colours are computed faster from fewer rows.
static bool has_rows(const struct view *v)
{
    const struct model_facts *f = &model_answering(v->model)->facts;
    return f->baked && f->storage == PRT_STORAGE_FACTORED &&
           f->engine != PRT_TRANSPORT_POLYNOMIAL &&
           v->spec.term != RELIGHT__TERM__TERM_IRRADIANCE;
}

// Whether the picture of a state that moves is to have half the width and height, or its
// colours or coefficients fewer rows.
static bool should_reduce(const struct view *v)
{
    uint64_t gap = v->options.gap_ns > steady_gap_ns ? v->options.gap_ns : steady_gap_ns;
    const struct render_spec *s = &v->spec;
    bool picture = s->picture && s->width >= REDUCED_LEAST && s->height >= REDUCED_LEAST;
    bool rows = is_coefficients(s) ? !s->most_rank || s->most_rank > REDUCED_RANK
                                   : !s->picture && has_rows(v);
    return (picture || rows) && v->moving && v->full_ns > gap;
}

// Whether colours may be of fewer vertices: a client that can expand them, on any link.
static bool may_be_coarse(const struct view *v)
{
    return v->options.coarse && v->moving && !v->spec.picture && !is_coefficients(&v->spec);
}

static void reduce(struct render_spec *spec)
{
    spec->width = (spec->width + REDUCED - 1) / REDUCED;
    spec->height = (spec->height + REDUCED - 1) / REDUCED;
    spec->most_rank = spec->color_rank = REDUCED_RANK;
}

// The state that rests is drawn once more, as it was asked for.
static void draw_exact_at_rest(struct view *v, uint64_t now)
{
    uint64_t rests_ns = v->changed_ns + moving_ns;
    if (v->dirty || !(v->reduced || v->drawn.coarse)) return;
    if (v->drawn.coarse) { // the client's next state may wait for this frame
        if (v->frame > v->shown) return;
        if (v->shown_ns + moving_ns > rests_ns) rests_ns = v->shown_ns + moving_ns;
    }
    if (now < rests_ns) {
        retry(v, rests_ns);
    } else {
        v->moving = false;
        v->dirty = true;
    }
}

// The model that the view is to show from here on; NULL: still the same.
static struct model *replacement(const struct view *v)
{
    const struct server *server = v->model->server;
    struct model *next = v->model->replaced ? model_successor(v->model) : NULL;
    const char *newest = v->name ? versions_find(server->versions, v->name) : "";
    if (newest[0]) next = models_get(server->models, newest);
    return next == v->model ? NULL : next;
}

// A pose is of one model: where the next has none of this name, its vertices are the file's.
static void keep_pose(struct view *v, const struct model *next)
{
    char error[300], name[65] = "";
    if (v->spec.pose) snprintf(name, sizeof name, "%s", v->spec.pose->name);
    if (render_spec_pose(&v->spec, next, name, error))
        render_spec_pose(&v->spec, next, "", error);
}

static void follow_replacement(struct view *v)
{
    struct model *next = replacement(v);
    if (!next) return;
    keep_pose(v, next);
    model_hold(next);
    model_unwatch(v->model, &v->watcher);
    model_release(v->model);
    v->model = next;
    drop_draft(v);
    model_watch(next, &v->watcher);
    invalidate(v);
}

static void draw(struct view *v)
{
    uint64_t now = loop_now_ns();
    if (v->render || window_full(v)) return;
    follow_replacement(v);
    draw_exact_at_rest(v, now);
    bool finer = !v->reduced && should_refine(v, now);
    if (!v->dirty && !finer) return;
    if (now < v->next_ns && !finer) {
        retry(v, v->next_ns);
        return;
    }
    struct render_spec spec;
    render_spec_copy(&v->spec, &spec);
    if (!finer) {
        v->dirty = false;
        v->next_ns = now + v->options.gap_ns;
        refinement_release(v->refinement);
        v->reduced = should_reduce(v);
        v->refinement = v->spec.picture && !v->reduced ? refinement_create() : NULL;
        v->drawn_ns = now;
    }
    if (v->reduced) reduce(&spec);
    spec.coarse = may_be_coarse(v) ? v->pace.level : 0;
    spec.hash = true;
    spec.refinement = v->refinement;
    if (!finer) use_draft(v, &spec);
    spec.quiet = finer && !send_after(v, v->refinement->n_frame + 1);
    v->drawn = render_spec_plain(&spec);
    v->drawn_sequence = v->sequence;
    v->refining = finer;
    struct request *request = v->request;
    struct connection *conn = request->conn;
    struct work_actor before = work_act(request->server->work, v->actor);
    struct work_pool *work = request->server->work;
    struct render *render = render_start(v->model, &spec, drawn, v); // may free v
    work_act(work, before);
    if (!render || conn->dead) return;
    v->render = render;
    v->late.fire = frame_late;
    if (!finer && v->options.deadline_ns)
        loop_timer_set(request->server->loop, &v->late, now + v->options.deadline_ns);
}

// Applies a state; a refused one changes nothing.
static int apply(struct view *v, const Relight__ViewState *state, struct request *from,
                 char error[300])
{
    struct render_spec next;
    struct view_options options = v->options;
    int code = view_state_next(state, from, v->model, &v->spec, &next, &options, error);
    if (code) return code;
    render_spec_finish(&v->spec);
    v->spec = next;
    if (options.gap_ns < v->options.gap_ns && v->drawn_ns + options.gap_ns < v->next_ns)
        v->next_ns = v->drawn_ns + options.gap_ns;
    v->options = options;
    return 0;
}

void op_view_open(struct request *request)
{
    const Relight__ViewOpenRequest *in = (const Relight__ViewOpenRequest *)request->message;
    char error[300];
    struct model *model =
        models_find(request->server->models, request->conn->caller.name, in->model, error);
    struct view *v = model ? calloc(1, sizeof *v) : NULL;
    if (!v) {
        request_fail(request,
                     model ? RELIGHT__ERROR_CODE__ERROR_NO_MEMORY
                           : RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                     "%s", model ? "not enough memory" : error);
        return;
    }
    v->request = request;
    v->model = model;
    const struct versions *versions = request->server->versions;
    const bool by_name = versions_is_name(versions, in->model) &&
                         !strcmp(versions_find(versions, in->model), model->id);
    if (by_name) v->name = strdup(in->model);
    request->server->stats.views_open++;
    model_hold(model);
    v->watcher.changed = model_has_changed;
    model_watch(model, &v->watcher);
    v->options.window = 2;
    v->actor = work_actor(request->server->work);
    render_spec_init(&v->spec);
    v->spec.sum = true;
    v->spec.picture = !in->colors;
    int code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    snprintf(error, sizeof error, "not enough memory");
    if (v->name || !by_name) code = apply(v, in->state, request, error);
    if (code) {
        free_view(v);
        request_fail(request, code, "%s", error);
        return;
    }
    request->state = v;
    request->abandon = abandon;
    invalidate(v);
    draw(v);
}

// A VIEW_OPEN that still waits for its material is later in the connection's order than this
// request, which would otherwise have waited behind it: it has no view yet.
static struct view *view_of(const struct connection *conn, uint64_t id)
{
    for (struct request *r = conn->requests; r; r = r->next) {
        struct view *v = r->id == id ? request_state(r, abandon) : NULL;
        if (v) return v;
    }
    return NULL;
}

static struct view *find_view(struct request *request, uint64_t id)
{
    struct view *v = view_of(request->conn, id);
    if (v) return v;
    request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND,
                 "no view was opened by request %llu", (unsigned long long)id);
    return NULL;
}

void op_view_set(struct request *request)
{
    const Relight__ViewSetRequest *in = (const Relight__ViewSetRequest *)request->message;
    struct connection *conn = request->conn;
    struct view *v = find_view(request, in->view);
    char error[300];
    if (!v) return;
    // The frame was received, also where the state is refused.
    acknowledge(v, in->shown);
    int code = apply(v, in->state, request, error);
    if (code) {
        request_fail(request, code, "%s", error);
        if (!conn->dead) draw(v);
        return;
    }
    if (in->state) {
        if (v->dirty) {
            v->dropped++;
            request->server->stats.frames_dropped++;
        }
        const uint64_t now = loop_now_ns();
        // A client that waits for each frame sends its states as slowly as its link is.
        v->moving = now - v->changed_ns < moving_ns ||
                    (v->options.coarse && now - v->shown_ns < moving_ns);
        invalidate(v);
        v->sequence = in->sequence;
    }
    Relight__ViewSetAnswer out = RELIGHT__VIEW_SET_ANSWER__INIT;
    out.sequence = in->sequence;
    request_answer(request, &out.base, NULL);
    if (!conn->dead) draw(v);
}

// One for a view that has ended is late, not wrong: it is ignored.
void take_view_ack(struct connection *conn, const ProtobufCMessage *message)
{
    const Relight__ViewAck *in = (const Relight__ViewAck *)message;
    struct view *v = view_of(conn, in->view);
    if (!v) return;
    acknowledge(v, in->shown);
    draw(v);
}

void op_view_close(struct request *request)
{
    const Relight__ViewCloseRequest *in = (const Relight__ViewCloseRequest *)request->message;
    struct connection *conn = request->conn;
    struct view *v = find_view(request, in->view);
    if (!v) return;
    Relight__ViewCloseAnswer out = RELIGHT__VIEW_CLOSE_ANSWER__INIT;
    Relight__ViewFrame last = RELIGHT__VIEW_FRAME__INIT;
    out.frames = v->frame;
    out.dropped = v->dropped;
    last.frame = v->frame;
    last.sequence = v->drawn_sequence;
    struct request *opened = v->request;
    opened->abandon = NULL;
    free_view(v);
    request_answer(opened, &last.base, NULL);
    if (!conn->dead) request_answer(request, &out.base, NULL);
}
