/* SPDX-License-Identifier: MIT */
/* view_state.h owns what a ViewState changes of a view: lights, shade, picture and options,
 * whole or field by field. */
#ifndef RELIGHTD_VIEW_STATE_H
#define RELIGHTD_VIEW_STATE_H

#include "net/request.h"
#include "relight.pb-c.h"
#include "render/evaluation.h"

struct model;

/* How frames are sent. */
struct view_options {
    uint64_t gap_ns, deadline_ns, window, window_bytes;
    bool skip_equal, coarse;
};

/* What a view draws after a state (NULL: an empty one) that `from` brings. *next shares texels,
 * pose and media with `before` unless others come, and is finished by the caller; *options is
 * that before and after. Returns 0; else an ErrorCode with `error`, and changes nothing. */
int view_state_next(const Relight__ViewState *state, struct request *from, struct model *model,
                    const struct render_spec *before, struct render_spec *next,
                    struct view_options *options, char error[300]);

#endif
