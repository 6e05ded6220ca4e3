// SPDX-License-Identifier: MIT
#include "ops/view_state.h"

#include <stdio.h>
#include <string.h>

enum { MAX_FIELD = 64 };

// Reads how frames are sent; the spec takes the format of colours.
static int read_options(const Relight__ViewOptions *in, struct view_options *out,
                        struct render_spec *spec, char error[300])
{
    *out = (struct view_options){
        .gap_ns = in->max_fps ? 1000000000u / in->max_fps : 0,
        .deadline_ns = in->frame_deadline_ms * UINT64_C(1000000),
        .window = in->window ? in->window : 2,
        .window_bytes = in->window_bytes,
        .skip_equal = in->skip_equal,
        .coarse = in->coarse,
    };
    if (out->window > SERVER_MAX_WINDOW)
        return range_refuse(error, 300, in->window, 1, SERVER_MAX_WINDOW, "frames",
                            "options.window");
    return render_spec_colors(spec, (int)in->color_format, in->color_exposure_ev, in->most_rank,
                              in->phases, in->exits, error);
}

static void merge_options(struct view_options *to, struct render_spec *spec,
                          const struct view_options *from, const struct render_spec *colors,
                          size_t n, char *const *fields)
{
    if (render_fields_name(n, fields, "options.max_fps")) to->gap_ns = from->gap_ns;
    if (render_fields_name(n, fields, "options.window")) to->window = from->window;
    if (render_fields_name(n, fields, "options.window_bytes"))
        to->window_bytes = from->window_bytes;
    if (render_fields_name(n, fields, "options.frame_deadline_ms"))
        to->deadline_ns = from->deadline_ns;
    if (render_fields_name(n, fields, "options.skip_equal")) to->skip_equal = from->skip_equal;
    if (render_fields_name(n, fields, "options.coarse")) to->coarse = from->coarse;
    if (render_fields_name(n, fields, "options.color_format")) spec->format = colors->format;
    if (render_fields_name(n, fields, "options.color_exposure_ev"))
        spec->exposure_ev = colors->exposure_ev;
    if (render_fields_name(n, fields, "options.most_rank")) spec->most_rank = colors->most_rank;
    if (render_fields_name(n, fields, "options.phases")) spec->phases = colors->phases;
    if (render_fields_name(n, fields, "options.exits")) spec->exits = colors->exits;
}

// Whether the state replaces the view's `part` as a whole or in fields.
static bool changes(const Relight__ViewState *state, bool present, const char *part)
{
    size_t n = strlen(part);
    if (!state->n_fields) return present;
    for (size_t i = 0; i < state->n_fields; i++)
        if (!strncmp(state->fields[i], part, n) &&
            (!state->fields[i][n] || state->fields[i][n] == '.'))
            return true;
    return false;
}

static int apply_lights(struct render_spec *next, const Relight__ViewState *state,
                        struct request *from, char error[300])
{
    size_t n_field = state->n_fields;
    char *const *fields = state->fields;
    bool all = false;
    for (size_t i = 0; i < n_field; i++) all |= !strcmp(fields[i], "lights");
    if (all || !n_field)
        return render_spec_lights(next, state->n_lights, state->lights, from, error);
    if (from->payload_size) {
        snprintf(error, 300, "a payload was sent, and state.fields do not name \"lights\"");
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    return render_spec_turn(next, state->n_lights, state->lights,
                            render_fields_name(n_field, fields, "lights.rotate_deg"),
                            render_fields_name(n_field, fields, "lights.gain"), error);
}

// Shade, picture and options of a state, into *next and *options.
static int apply_parts(struct render_spec *next, struct view_options *options,
                       struct server *server, const Relight__ViewState *state,
                       struct request *from, char error[300])
{
    static const Relight__Shade no_shade = RELIGHT__SHADE__INIT;
    static const Relight__Picture no_picture = RELIGHT__PICTURE__INIT;
    static const Relight__ViewOptions no_options = RELIGHT__VIEW_OPTIONS__INIT;
    const size_t n = state->n_fields;
    struct view_options given = {0};
    struct render_spec values;
    int code = 0;
    render_spec_copy(next, &values);
    if (changes(state, state->shade, "shade"))
        code = render_spec_shade(&values, from, state->shade ? state->shade : &no_shade, error);
    if (!code && next->picture && changes(state, state->picture, "picture"))
        code = render_spec_picture(&values, server,
                                   state->picture ? state->picture : &no_picture, error);
    bool optional = !code && changes(state, state->options, "options");
    if (optional)
        code =
            read_options(state->options ? state->options : &no_options, &given, &values, error);
    if (!code && n) code = render_spec_copy_fields(next, &values, n, state->fields, error);
    if (!code && n && optional) merge_options(options, next, &given, &values, n, state->fields);
    if (!code && !n) {
        struct render_spec before = *next;
        *next = values;
        values = before;
        if (optional) *options = given;
    }
    render_spec_finish(&values);
    return code ? code : render_spec_alpha(next, error);
}

int view_state_next(const Relight__ViewState *state, struct request *from, struct model *model,
                    const struct render_spec *before, struct render_spec *next,
                    struct view_options *options, char error[300])
{
    static const Relight__ViewState no_state = RELIGHT__VIEW_STATE__INIT;
    if (!state) state = &no_state;
    const size_t n = state->n_fields;
    struct view_options own = *options;
    if (n > MAX_FIELD) return range_refuse(error, 300, (double)n, 0, MAX_FIELD, "", "fields");
    render_spec_copy(before, next);
    int code = apply_parts(next, &own, from->server, state, from, error);
    if (!code && changes(state, state->pose[0], "pose"))
        code = render_spec_pose(next, model, state->pose, error);
    if (!code && (from->payload_size || changes(state, state->n_lights, "lights")))
        code = apply_lights(next, state, from, error);
    if (code) render_spec_finish(next);
    else *options = own;
    return code;
}
