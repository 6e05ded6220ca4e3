// SPDX-License-Identifier: MIT
// The result of an evaluation, as messages.
#include "render/evaluation.h"

#include <math.h>

void render_cost_message(const struct render_result *r, Relight__Cost *cost)
{
    relight__cost__init(cost);
    float known = r->light_ms + r->relight_ms + r->raster_ms + r->shade_ms + r->encode_ms;
    cost->queue_ms = fmaxf(0, r->total_ms - known);
    cost->light_ms = r->light_ms;
    cost->relight_ms = r->relight_ms;
    cost->raster_ms = r->raster_ms;
    cost->shade_ms = r->shade_ms;
    cost->encode_ms = r->encode_ms;
    cost->total_ms = r->total_ms;
    cost->shared = r->shared;
    cost->error_bound = r->error_bound;
    cost->engine = r->engine;
    cost->samples = r->samples;
    cost->frames = r->frames;
    cost->converged = r->converged;
    cost->note = (char *)r->note;
    cost->draft = r->draft;
    cost->bake_fraction = r->bake_fraction;
}

static void coefficients_message(const struct render_result *r, const struct render_spec *spec,
                                 struct render_coefficients_message *m)
{
    relight__coefficients__init(&m->coefficients);
    m->coefficients.factors = r->factors;
    m->coefficients.most_rank = spec->most_rank;
    m->coefficients.n_layers = r->n_layer;
    m->coefficients.layers = m->layers;
    for (uint32_t i = 0; i < r->n_layer; i++) {
        const struct prt_coefficient_layer *from = &r->layer[i];
        Relight__CoefficientLayer *to = m->layers[i] = &m->layer[i];
        relight__coefficient_layer__init(to);
        to->tensor = from->tensor;
        to->n_phase = from->n_plane;
        to->n_row = from->n_row;
        to->offset = from->begin * sizeof(uint16_t);
        to->n_scales = r->n_plane;
        to->scales = (float *)(uintptr_t)r->scale[i];
    }
    m->coefficients.n_outgoing = r->n_outgoing;
    m->coefficients.outgoing = r->outgoing;
}

void render_colors_message(const struct render_result *r, const struct render_spec *spec,
                           Relight__ColorsAnswer *out,
                           struct render_coefficients_message *coefficients)
{
    relight__colors_answer__init(out);
    out->n_vertex = r->n_vertex;
    out->n_plane = r->n_plane;
    out->plane_bytes = r->plane_bytes;
    out->format = spec->format;
    out->generation = r->generation;
    out->n_part = r->n_part;
    out->n_exit = r->n_exit;
    out->n_coarse = r->n_coarse;
    out->coarse_order = r->coarse_order;
    if (r->n_part) {
        out->n_outgoing = r->n_outgoing;
        out->outgoing = r->outgoing;
    }
    if (!is_coefficients(spec)) return;
    coefficients_message(r, spec, coefficients);
    out->coefficients = &coefficients->coefficients;
}

static void vec3_message(const float v[3], Relight__Vec3 *out)
{
    relight__vec3__init(out);
    out->x = v[0];
    out->y = v[1];
    out->z = v[2];
}

void render_image_message(const struct render_result *r, const struct render_spec *spec,
                          Relight__ImageAnswer *out, struct render_camera_message *camera)
{
    relight__image_answer__init(out);
    relight__camera__init(&camera->camera);
    vec3_message(r->camera.eye, &camera->eye);
    vec3_message(r->camera.target, &camera->target);
    vec3_message(r->camera.up, &camera->up);
    camera->camera.eye = &camera->eye;
    camera->camera.target = &camera->target;
    camera->camera.up = &camera->up;
    camera->camera.fovy_deg = r->camera.fovy_deg;
    out->width = r->width;
    out->height = r->height;
    out->format = spec->image_format;
    out->camera = &camera->camera;
    relight__drawn__init(&camera->drawn);
    camera->drawn.mesh_hash = (char *)(uintptr_t)r->drawn.mesh;
    camera->drawn.bake_hash = (char *)(uintptr_t)r->drawn.bake;
    out->drawn = &camera->drawn;
    out->generation = r->generation;
}
