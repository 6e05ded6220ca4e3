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

// The workers' time for it: a pass is shared. The file and the environments are left out, as
// other processes and the disk make them.
static double cost_ns(const struct render *r)
{
    const struct render_result *out = &r->result;
    const unsigned n = render_n_values(&r->spec);
    double ms = (double)(out->raster_ms + out->shade_ms + out->encode_ms);
    ms += (double)out->relight_ms * fmin(n / fmax(out->shared, 1), 1);
    ms += (double)(dependency_ms(&r->specular) + dependency_ms(&r->background) +
                   dependency_ms(&r->floor));
    for (unsigned i = 0; i < n; i++)
        ms += (double)(dependency_ms(&r->light[i]) + dependency_ms(&r->contracted_light[i]));
    return 1e6 * ms;
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
