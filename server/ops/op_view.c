// SPDX-License-Identifier: MIT
// Views: a state whose changes the daemon answers with frames. A view has one evaluation at a
// time and draws the newest state next, so that fast changes skip states and do not queue. At
// most `window` frames are unacknowledged, so that a slow reader delays only itself. While the
// state does not change, a picture by an image-space engine is refined until it converges.
#include "net/dispatch.h"
#include "render/evaluation.h"
#include "core/log.h"
#include "store/models.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

static const uint64_t retry_ns = 250000000; // between two attempts while the model is baking
static const uint64_t rest_ns = 120000000;  // refinement begins when the state is this old

struct view {
    struct request *request;
    struct model *model;
    struct render_spec spec;  // the newest state
    uint64_t sequence;        // of it
    bool dirty;               // the state was not drawn yet
    struct render *render;    // of the frame that is being drawn; NULL: none
    struct render_spec drawn; // its spec, without texels
    uint64_t drawn_sequence;
    uint64_t frame, shown, dropped, window;
    uint64_t gap_ns, next_ns; // max_fps
    bool told_not_ready;
    struct loop_timer timer;
    struct model_watcher watcher;
    struct refinement *refinement; // of the state that was drawn; NULL: none
    bool refining;                 // `render` refines the state that was drawn
    uint32_t told_frames;          // pictures in the mean of the last sent frame
    uint64_t changed_ns;           // when the state last changed
};

static void draw(struct view *v);

static void free_view(struct view *v)
{
    loop_timer_stop(v->model->server->loop, &v->timer);
    model_unwatch(v->model, &v->watcher);
    if (v->render) render_cancel(v->render);
    refinement_release(v->refinement);
    render_spec_finish(&v->spec);
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

static void send_frame(struct view *v, struct render_result *result)
{
    Relight__ViewFrame out = RELIGHT__VIEW_FRAME__INIT;
    Relight__ColorsAnswer colors;
    Relight__ImageAnswer image;
    Relight__Error error;
    struct error_fields fields;
    struct render_camera_message camera;
    Relight__Cost cost;
    char text[500];
    render_cost_message(result, &cost);
    stats_work(&v->request->server->stats, RELIGHT_TYPE_VIEW_OPEN, (double)cost.queue_ms * 1e-3,
               (double)(cost.total_ms - cost.queue_ms) * 1e-3);
    out.frame = ++v->frame;
    out.sequence = v->drawn_sequence;
    if (result->code) {
        blobs_name_in_text(v->request->server->blobs, v->request->conn->principal->name,
                           result->error, text, sizeof text);
        error_fill(&error, result->code, text, &fields);
        out.error = &error;
    } else if (v->spec.picture) {
        render_image_message(result, &v->drawn, &image, &camera);
        image.cost = &cost;
        out.image = &image;
    } else {
        render_colors_message(result, &v->drawn, &colors);
        colors.cost = &cost;
        out.colors = &colors;
    }
    v->request->server->stats.frames_sent++;
    request_part(v->request, &out.base, result->code ? NULL : &result->payload);
}

// Means of 1, 2, 4, 8, … pictures are sent, and the last.
static bool send_after(const struct view *v, uint32_t n_frame)
{
    return n_frame >= 2 * v->told_frames || v->refinement->converged;
}

static void drawn(void *user, struct render_result *result)
{
    struct view *v = user;
    struct connection *conn = v->request->conn;
    bool finer = v->refining;
    v->render = NULL;
    v->refining = false;
    bool not_ready = result->code == RELIGHT__ERROR_CODE__ERROR_NOT_READY;
    bool silent = not_ready && v->told_not_ready;
    v->told_not_ready = not_ready;
    if (finer && result->code) { // the last picture remains
        refinement_release(v->refinement);
        v->refinement = NULL;
        silent = true;
    }
    if (finer && !result->payload.bytes) silent = true;
    if (!silent) {
        v->told_frames = result->frames;
        send_frame(v, result);
        if (conn->dead) return; // the view was freed with it
    } else if (result->payload.release) {
        result->payload.release(result->payload.owner);
    }
    // Pictures by baked transport are not refined.
    if (!finer && (result->code || !result->preview)) {
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

static void draw(struct view *v)
{
    uint64_t now = loop_now_ns();
    if (v->render || v->frame - v->shown >= v->window) return;
    bool finer = should_refine(v, now);
    if (!v->dirty && !finer) return;
    if (now < v->next_ns && !finer) {
        retry(v, v->next_ns);
        return;
    }
    struct render_spec spec;
    render_spec_copy(&v->spec, &spec);
    if (!finer) {
        v->dirty = false;
        v->next_ns = now + v->gap_ns;
        refinement_release(v->refinement);
        v->refinement = v->spec.picture ? refinement_create() : NULL;
    }
    spec.refinement = v->refinement;
    spec.quiet = finer && !send_after(v, v->refinement->n_frame + 1);
    v->drawn = spec;
    v->drawn.texels = NULL;
    v->drawn_sequence = v->sequence;
    v->refining = finer;
    struct request *request = v->request;
    struct connection *conn = request->conn;
    struct render *render = render_start(v->model, &spec, drawn, v);
    if (render && !conn->dead) v->render = render;
}

// Applies a state; a refused one changes nothing.
static int apply(struct view *v, struct server *server, const Relight__ViewState *state,
                 struct request *from, char error[300])
{
    struct render_spec next = v->spec; // with its texels, unless the new state has others
    int code = 0;
    if (state && (code = render_spec_shade(&next, from, state->shade, error))) return code;
    if (state && state->picture && v->spec.picture &&
        (code = render_spec_picture(&next, server, state->picture, error)))
        return code;
    size_t n = state ? state->n_lights : 0;
    if (n || from->payload_size)
        code = render_spec_lights(&next, n, n ? state->lights : NULL, from, error);
    if (!code) v->spec = next;
    return code;
}

void op_view_open(struct request *request)
{
    const Relight__ViewOpenRequest *in = (const Relight__ViewOpenRequest *)request->message;
    char error[300];
    struct model *model =
        models_find(request->server->models, request->conn->principal->name, in->model, error);
    struct view *v = model ? calloc(1, sizeof *v) : NULL;
    if (!v) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_NOT_FOUND, "%s",
                     model ? "not enough memory" : error);
        return;
    }
    v->request = request;
    v->model = model;
    request->server->stats.views_open++;
    model_hold(model);
    v->watcher.changed = model_has_changed;
    model_watch(model, &v->watcher);
    v->window = in->window ? in->window : 2;
    v->gap_ns = in->max_fps ? 1000000000u / in->max_fps : 0;
    render_spec_init(&v->spec);
    v->spec.sum = true;
    v->spec.picture = !in->colors;
    int code = in->colors ? render_spec_colors(&v->spec, (int)in->color_format,
                                               in->color_exposure_ev, error)
                          : 0;
    if (!code) code = apply(v, request->server, in->state, request, error);
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
static struct view *find_view(struct request *request, uint64_t id)
{
    for (struct request *r = request->conn->requests; r; r = r->next) {
        struct view *v = r->id == id ? request_state(r, abandon) : NULL;
        if (v) return v;
    }
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
    int code = apply(v, request->server, in->state, request, error);
    if (code) {
        request_fail(request, code, "%s", error);
        return;
    }
    if (in->shown > v->shown) v->shown = in->shown < v->frame ? in->shown : v->frame;
    if (in->state) {
        if (v->dirty) {
            v->dropped++;
            request->server->stats.frames_dropped++;
        }
        invalidate(v);
        v->sequence = in->sequence;
    }
    Relight__ViewSetAnswer out = RELIGHT__VIEW_SET_ANSWER__INIT;
    out.sequence = in->sequence;
    request_answer(request, &out.base, NULL);
    if (!conn->dead) draw(v);
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
