// SPDX-License-Identifier: MIT
// Evaluations that are open, for core/drain.h: of which kind each is, and what it cost.
#include "render/walk.h"

#include <math.h>

static unsigned bits(uint64_t x)
{
    return x ? 64 - (unsigned)__builtin_clzll(x) : 0;
}

// Evaluations of one kind cost about the same: same model, operation, and size within 2.
static uint64_t kind_of(const struct model *model, const struct render_spec *s)
{
    uint64_t kind = (uintptr_t)model;
    kind = kind * 31 + (s->picture ? bits((uint64_t)s->width * s->height * s->samples)
                                   : 64u + (unsigned)s->format);
    kind = kind * 31 + (unsigned)(s->engine + 8 * s->term);
    kind = kind * 31 + render_n_values(s);
    return kind * UINT64_C(0x9e3779b97f4a7c15) >> 8;
}

void render_count(struct render *r)
{
    if (r->spec.quiet) return; // it gives way to the others
    drain_begin(&r->server->drain, &r->drain, r->actor.name, kind_of(r->model, &r->spec),
                r->actor.class, r->start_ns);
}

// The workers' time for it: a pass is shared.
static double cost_ns(const struct render *r)
{
    const struct render_result *out = &r->result;
    const double shared = fmax(out->shared, 1), n = render_n_values(&r->spec);
    const double pass_ms = (double)out->relight_ms * fmin(n / shared, 1);
    return 1e6 * (pass_ms + (double)(out->light_ms + out->raster_ms + out->shade_ms) +
                  (double)out->encode_ms);
}

void render_uncount(struct render *r)
{
    bool answered = r->done && !r->result.code;
    drain_end(&r->server->drain, &r->drain, answered ? cost_ns(r) : -1, loop_now_ns());
}

uint32_t render_retry_ms(const struct model *model, const struct render_spec *spec,
                         double left_ns)
{
    const struct server *server = model->server;
    const struct work_actor actor = work_actor(server->work);
    return drain_retry_ms(&server->drain, actor.name, kind_of(model, spec), actor.class,
                          left_ns);
}
