// SPDX-License-Identifier: MIT
// Views: a state in the daemon and its frames; only the newest state is drawn.
#include "internal.h"

struct relight_view {
    struct relight_client *client;
    uint64_t id;
    pthread_mutex_t lock; // next_sequence, shown
    uint64_t next_sequence, shown;
    bool ended; // VIEW_OPEN got its last answer
};

static int put_state(struct request_parts *parts, Relight__ViewState *m, size_t n_light,
                     const struct relight_light *lights, const struct relight_shade *shade,
                     const struct relight_picture *picture, struct relight_error *error)
{
    relight__view_state__init(m);
    int status = relight_put_lights(parts, n_light, lights, error);
    if (status) return status;
    m->n_lights = n_light;
    m->lights = parts->lights;
    if (shade) {
        if ((status = relight_put_shade(parts, shade, error))) return status;
        m->shade = &parts->shade;
    }
    if (picture) {
        relight_put_picture(parts, picture);
        m->picture = &parts->picture;
    }
    return 0;
}

static void put_options(Relight__ViewOptions *m, const struct relight_view_request *request)
{
    relight__view_options__init(m);
    m->max_fps = request->max_fps;
    m->window = request->window;
    m->window_bytes = request->window_bytes;
    m->color_format = (Relight__ColorFormat)request->color_format;
    m->color_exposure_ev = request->color_exposure_ev;
    m->frame_deadline_ms = request->frame_deadline_ms;
    m->skip_equal = request->skip_equal;
    m->most_rank = request->most_rank;
    m->phases = request->phases;
    m->exits = request->exits;
    m->coarse = request->coarse;
}

int relight_view_open(struct relight_client *client, const struct relight_view_request *request,
                      struct relight_view **out, struct relight_error *error)
{
    struct request_parts parts;
    Relight__ViewState state;
    Relight__ViewOptions options;
    Relight__ViewOpenRequest m = RELIGHT__VIEW_OPEN_REQUEST__INIT;
    int status = put_state(&parts, &state, request->n_light, request->lights, &request->shade,
                           &request->picture, error);
    if (status) return status;
    m.model = relight_text(request->model);
    m.state = &state;
    m.colors = request->colors;
    m.priority = (Relight__Priority)request->priority;
    put_options(&options, request);
    state.options = &options;
    state.pose = relight_text(request->pose);
    struct relight_view *view = calloc(1, sizeof *view);
    if (!view) return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory");
    view->client = client;
    view->next_sequence = 1;
    pthread_mutex_init(&view->lock, NULL);
    status = relight_start(client, RELIGHT_TYPE_VIEW_OPEN, &m.base, parts.cube, parts.n_cube, 0,
                           false, &view->id, error);
    if (status) {
        pthread_mutex_destroy(&view->lock);
        free(view);
        return status;
    }
    *out = view;
    return 0;
}

static int send_state(struct relight_view *view, struct request_parts *parts,
                      Relight__ViewState *state, uint64_t *sequence,
                      struct relight_error *error)
{
    Relight__ViewSetRequest m = RELIGHT__VIEW_SET_REQUEST__INIT;
    // The lock is held while sending, so that states are sent in the order of their numbers.
    pthread_mutex_lock(&view->lock);
    m.view = view->id;
    m.sequence = view->next_sequence++;
    m.state = state;
    m.shown = view->shown;
    int status = relight_start(view->client, RELIGHT_TYPE_VIEW_SET, &m.base, parts->cube,
                               parts->n_cube, 0, true, NULL, error);
    if (!status && sequence) *sequence = m.sequence;
    pthread_mutex_unlock(&view->lock);
    return status;
}

int relight_view_set(struct relight_view *view, size_t n_light,
                     const struct relight_light *lights, const struct relight_shade *shade,
                     const struct relight_picture *picture, uint64_t *sequence,
                     struct relight_error *error)
{
    struct request_parts parts;
    Relight__ViewState state;
    int status = put_state(&parts, &state, n_light, lights, shade, picture, error);
    return status ? status : send_state(view, &parts, &state, sequence, error);
}

int relight_view_change(struct relight_view *view, const struct relight_view_request *values,
                        size_t n_field, const char *const *fields, uint64_t *sequence,
                        struct relight_error *error)
{
    struct request_parts parts;
    Relight__ViewState state;
    Relight__ViewOptions options;
    bool lights = false, turned = false;
    if (!n_field) return relight_fail(error, RELIGHT_E_ARGUMENT, "", "no field is named");
    for (size_t i = 0; i < n_field; i++) {
        lights |= !strcmp(fields[i], "lights");
        turned |= !strncmp(fields[i], "lights.", 7);
    }
    int status = put_state(&parts, &state, lights ? values->n_light : 0, values->lights,
                           &values->shade, &values->picture, error);
    if (!status && turned && !lights) {
        status = relight_put_turns(&parts, values->n_light, values->lights, error);
        state.n_lights = values->n_light;
    }
    if (status) return status;
    put_options(&options, values);
    state.options = &options;
    state.pose = relight_text(values->pose);
    state.n_fields = n_field;
    state.fields = (char **)(uintptr_t)fields;
    return send_state(view, &parts, &state, sequence, error);
}

// Acknowledges a frame, so that the daemon may send the next.
static int acknowledge(struct relight_view *view, uint64_t frame, struct relight_error *error)
{
    Relight__ViewAck m = RELIGHT__VIEW_ACK__INIT;
    pthread_mutex_lock(&view->lock);
    view->shown = frame;
    m.view = view->id;
    m.shown = frame;
    int status = relight_start(view->client, RELIGHT_TYPE_VIEW_ACK, &m.base, NULL, 0, 0, true,
                               NULL, error);
    pthread_mutex_unlock(&view->lock);
    return status;
}

static int read_frame(struct answer *answer, struct relight_frame_out *out,
                      struct relight_error *error)
{
    const Relight__ViewFrame *m = (Relight__ViewFrame *)answer->message;
    int status;
    *out = (struct relight_frame_out){
        .frame = m->frame, .sequence = m->sequence, .hash = m->hash, .equal = m->equal};
    if (m->error) return relight_fail_message(error, m->error);
    if (m->equal) return 0;
    if (m->colors) {
        status = relight_get_colors(m->colors, answer->payload, answer->payload_size,
                                    &out->colors, error);
        out->has_colors = true;
    } else if (m->image) {
        status = relight_get_image(m->image, answer->payload, answer->payload_size, &out->image,
                                   error);
        out->has_image = true;
    } else {
        status = relight_fail(error, RELIGHT_E_PROTOCOL, "", "an empty frame");
    }
    return status;
}

int relight_view_next(struct relight_view *view, double timeout_s,
                      struct relight_frame_out *out, struct relight_error *error)
{
    struct answer *newest = NULL;
    uint64_t skipped = 0;
    int status;
    if (view->ended) return relight_fail(error, RELIGHT_E_CANCELLED, "", "the view has ended");
    do {
        struct answer *answer;
        status = relight_next(view->client, view->id,
                              newest          ? 0
                              : timeout_s < 0 ? 1e9
                                              : timeout_s,
                              &answer, error);
        if (status == -RELIGHT_E_TIMEOUT && newest) break;
        if (status) {
            view->ended = status != -RELIGHT_E_TIMEOUT;
            relight_answer_free(newest);
            return status;
        }
        if (answer->type != (RELIGHT_TYPE_VIEW_OPEN | RELIGHT_TYPE_ANSWER) || answer->last) {
            view->ended = answer->last;
            relight_answer_free(answer);
            if (newest) break;
            return relight_fail(error, RELIGHT_E_CANCELLED, "", "the view has ended");
        }
        skipped += newest != NULL;
        relight_answer_free(newest);
        newest = answer;
    } while (relight_pending(view->client, view->id));
    status = acknowledge(view, ((Relight__ViewFrame *)newest->message)->frame, error);
    if (!status) status = read_frame(newest, out, error);
    if (status) {
        relight_answer_free(newest);
        return status;
    }
    out->skipped = skipped;
    if (!(out->owner = relight_owner(newest)))
        return relight_fail(error, RELIGHT_E_NO_MEMORY, "", "not enough memory for a frame");
    return 0;
}

void relight_frame_out_finish(struct relight_frame_out *frame)
{
    relight_owner_free(frame->owner);
    *frame = (struct relight_frame_out){0};
}

int relight_view_close(struct relight_view *view, uint64_t *frames, uint64_t *dropped,
                       struct relight_error *error)
{
    Relight__ViewCloseRequest m = RELIGHT__VIEW_CLOSE_REQUEST__INIT;
    struct answer *answer;
    m.view = view->id;
    int status = 0;
    if (!view->ended) {
        status = relight_call(view->client, RELIGHT_TYPE_VIEW_CLOSE, &m.base, &answer, error);
        relight_forget(view->client, view->id);
    }
    if (!status && !view->ended) {
        const Relight__ViewCloseAnswer *a = (Relight__ViewCloseAnswer *)answer->message;
        if (frames) *frames = a->frames;
        if (dropped) *dropped = a->dropped;
        relight_answer_free(answer);
    } else {
        if (frames) *frames = 0;
        if (dropped) *dropped = 0;
    }
    pthread_mutex_destroy(&view->lock);
    free(view);
    return status;
}
