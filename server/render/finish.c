// SPDX-License-Identifier: MIT
// The last step of an evaluation: it fills the result, encodes colours or shades and encodes a
// picture on a worker, and calls back.
#include "render/walk.h"

#include "net/request.h"

#define XXH_INLINE_ALL
#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <xxhash.h>

enum {
    MOST_ON_LOOP = 256 << 10
}; // bytes whose hash takes some 20 us: less than a worker's turn

void render_end(struct render *r)
{
    r->result.total_ms = (float)((double)(loop_now_ns() - r->start_ns) * 1e-6);
    render_uncount(r);
    render_fn done = r->done;
    void *user = r->user;
    struct render_result result = r->result;
    if (r->ended) *r->ended = true;
    if (r->transient && r->screen_radiance.entry) cache_forget_entry(r->screen_radiance.entry);
    render_release(r);
    refinement_release(r->spec.refinement);
    render_spec_finish(&r->spec);
    model_release(r->model);
    model_release(r->bakes);
    free(r);
    if (done) done(user, &result);
    else {
        if (result.payload.release) result.payload.release(result.payload.owner);
        free(result.outgoing);
        cache_release(result.values);
    }
}

void render_end_with_error(struct render *r, int code, const char *text)
{
    r->result.code = code;
    snprintf(r->result.error, sizeof r->result.error, "%s", text);
    render_end(r);
}

// ---- on a worker

static void own_payload(struct render *r, void *bytes, size_t size, void (*release)(void *))
{
    r->result.payload = (struct payload){bytes, size, bytes, release};
}

// The values that are shown: those of the entry, or mixed with the draft's, to free() then.
// Without memory NULL. Planes that the draft has not are zero in it: it has no single
// scattering.
static struct vertex_values *mixed_values(const struct render *r)
{
    const struct vertex_values *bake = r->vertex_values[0].entry->value;
    const struct vertex_values *draft = r->faded->value;
    const size_t n = (size_t)bake->n_plane * bake->n_vertex * 3;
    const size_t m =
        draft->n_vertex == bake->n_vertex ? (size_t)draft->n_plane * draft->n_vertex * 3 : 0;
    const float w = m ? r->spec.fade : 1;
    struct vertex_values *v = malloc(sizeof *v + n * sizeof *v->values);
    if (!v) return NULL;
    *v = *bake;
    for (size_t i = 0; i < n; i++)
        v->values[i] = w * bake->values[i] + (i < m ? (1 - w) * draft->values[i] : 0);
    return v;
}

static int encode_plane(const struct render *r, const struct prt_context *ctx,
                        const struct vertex_values *v, uint8_t *to)
{
    const struct cache_entry *coarse = r->coarse.entry;
    if (coarse)
        return encode_coarse(ctx, &r->spec, v, ((struct coarse_order *)coarse->value)->vertex,
                             r->result.n_coarse, to);
    encode_colors(ctx, &r->spec, v, to);
    return PRT_OK;
}

// Bytes of one plane, without padding.
static size_t own_plane_bytes(const struct render *r, const struct vertex_values *v)
{
    return r->coarse.entry
               ? (size_t)v->n_plane * r->result.n_coarse * color_bytes(r->spec.format)
               : plane_bytes(&r->spec, v);
}

static int run_colors(struct render *r, const struct prt_context *ctx)
{
    unsigned n = render_n_values(&r->spec);
    size_t plane = (size_t)r->result.plane_bytes;
    uint8_t *bytes = prt_alloc(n, plane ? plane : 1);
    if (!bytes) return PRT_NOMEM;
    double start = prt_time_s();
    struct vertex_values *mixed = r->faded ? mixed_values(r) : NULL;
    int status = PRT_OK;
    for (unsigned i = 0; i < n && !status; i++) {
        const struct vertex_values *v = mixed ? mixed : r->vertex_values[i].entry->value;
        status = encode_plane(r, ctx, v, bytes + i * plane);
        size_t used = own_plane_bytes(r, v);
        memset(bytes + i * plane + used, 0, plane - used);
    }
    free(mixed);
    r->result.encode_ms = (float)((prt_time_s() - start) * 1e3);
    if (status) prt_free(bytes); // no answer takes the payload of a failed result
    else own_payload(r, bytes, n * plane, prt_free);
    return status;
}

// The radiance by an image-space engine, or the running mean with it added.
static int point_radiance(const struct render *r, const float (**rgb)[3])
{
    const struct screen_radiance *found = r->screen_radiance.entry->value;
    struct refinement *refinement = r->spec.refinement;
    int status = refinement ? refinement_add(refinement, found) : PRT_OK;
    *rgb = refinement ? (const float(*)[3])refinement->mean : found->rgb;
    return status;
}

// Shades the radiance of an image-space engine, scaled by the walk ratio where there is one.
static int shade_points(const struct render *r, const struct prt_context *ctx,
                        const struct prt_shade *shade, struct prt_image *image)
{
    const struct prt_visibility *visibility = r->visibility.entry->value;
    const bool total = r->spec.term == RELIGHT__TERM__TERM_TOTAL;
    const struct walk_ratio *w = r->ratio ? r->ratio->value : NULL;
    const float(*rgb)[3];
    int status = point_radiance(r, &rgb);
    if (status || r->spec.quiet) return status;
    if (!w) return prt_shade_points(ctx, visibility, rgb, shade, image);
    float(*scaled)[3] = NULL;
    status = prt_walk_ratio_scale(ctx, w->ratio, total ? PRT_WALK_ALL : PRT_WALK_MULTIPLE,
                                  visibility, rgb, &scaled);
    if (!status)
        status = prt_shade_points(ctx, visibility, (const float(*)[3])scaled, shade, image);
    prt_free(scaled);
    return status;
}

// rgb8: pixels in place of the image; or NULL.
static int shade(const struct render *r, const struct prt_context *ctx, struct prt_image *image,
                 uint8_t *rgb8)
{
    bool total = r->spec.term == RELIGHT__TERM__TERM_TOTAL;
    struct prt_shade shade = {.transparent = r->spec.transparent,
                              .media = *render_media(r),
                              .fresnel = total,
                              .specular = r->specular.entry ? r->specular.entry->value : NULL,
                              .rgb8 = rgb8,
                              .tone = (enum prt_tone)r->spec.tone,
                              .exposure_ev = r->spec.picture_ev,
                              .background =
                                  r->background.entry ? r->background.entry->value : NULL};
    if (r->floor.entry) shade.shadow = r->floor.entry->value;
    if (shade.background) shade.background_rotate_deg = (float)r->spec.light[0].rotate_deg;
    if (r->spec.n_light == 1) shade.specular_rotate_deg = (float)r->spec.light[0].rotate_deg;
    if (r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE) shade.leave_out = PRT_LOOK_ALL;
    if (*r->spec.map[0]) shade.leave_out |= PRT_LOOK_BASE; // uploaded maps replace the file's
    if (*r->spec.map[1] || *r->spec.map[2]) shade.leave_out |= PRT_LOOK_NORMAL;
    memcpy(shade.background_rgb, r->spec.background, sizeof shade.background_rgb);
    if (r->screen) return shade_points(r, ctx, &shade, image);
    struct vertex_values *mixed = r->faded ? mixed_values(r) : NULL;
    const struct vertex_values *v = mixed ? mixed : r->vertex_values[0].entry->value;
    shade.n_plane = v->n_plane;
    shade.planes = v->values;
    int status =
        prt_shade_image(ctx, r->visibility.entry->value, render_mesh(r), &shade, image);
    free(mixed);
    return status;
}

static int run_picture(struct render *r, const struct prt_context *ctx)
{
    struct prt_image image = {0};
    struct prt_blob blob = {0};
    double start = prt_time_s();
    int status = PRT_OK;
    bool in_8_bits = draws_rgb8(&r->spec) && !r->spec.quiet;
    uint8_t *rgb8 = in_8_bits ? prt_alloc((size_t)r->spec.width * r->spec.height, 3) : NULL;
    if (in_8_bits && !rgb8) status = PRT_NOMEM;
    if (!status) status = shade(r, ctx, &image, rgb8);
    double shaded = prt_time_s();
    if (status) prt_free(rgb8);
    else if (rgb8) status = encode_rgb8(ctx, &r->spec, rgb8, &blob);
    else if (!r->spec.quiet) status = encode_image(ctx, &r->spec, &image, &blob);
    if (!status && !r->spec.quiet) own_payload(r, blob.bytes, blob.size, prt_free);
    r->result.shade_ms = (float)((shaded - start) * 1e3);
    r->result.encode_ms = (float)((prt_time_s() - shaded) * 1e3);
    prt_image_finish(&image);
    return status;
}

static void hash_payload(struct render *r)
{
    r->result.hash = XXH3_64bits(r->result.payload.bytes, r->result.payload.size);
}

static int run_finish(struct work *work, const struct prt_context *ctx)
{
    struct render *r = (struct render *)work;
    if (!__atomic_load_n(&r->done, __ATOMIC_RELAXED)) return PRT_CANCELLED;
    int status = r->result.payload.bytes ? PRT_OK // of a cache entry
                 : r->spec.picture       ? run_picture(r, ctx)
                                         : run_colors(r, ctx);
    if (!status && r->spec.hash && r->result.payload.bytes) hash_payload(r);
    return status;
}

// ---- on the loop

// Updates the running mean of shading and encoding time a pixel: light_budget() subtracts it.
static void update_finish_time(struct render *r)
{
    static const float weight = 0.2f; // of the newest picture; chosen, not measured
    float *mean_ns = &r->server->stats.finish_ns_a_pixel;
    float ns = (r->result.shade_ms + r->result.encode_ms) * 1e6f /
               (float)(r->spec.width * r->spec.height);
    *mean_ns = *mean_ns > 0 ? (1 - weight) * *mean_ns + weight * ns : ns;
}

static void finish_done(struct work *work)
{
    struct render *r = (struct render *)work;
    if (r->spec.picture && !r->spec.quiet && !work->status) update_finish_time(r);
    const struct refinement *refinement = r->screen ? r->spec.refinement : NULL;
    if (refinement) {
        r->result.frames = refinement->n_frame;
        r->result.converged = refinement->converged;
        r->result.error_bound = (float)refinement_error(refinement);
    }
    if (work->status) render_end_with_error(r, error_of_status(work->status), work->error);
    else render_end(r);
}

static void preview_note(const struct render *r, char note[120])
{
    const struct model *m = r->model;
    note[0] = 0;
    if (render_pose(r))
        snprintf(note, 120, "preview: vertices moved%s",
                 m->state == RELIGHT__MODEL_STATE__MODEL_READY
                     ? ", the bake is of another shape"
                     : "");
    else if (m->state == RELIGHT__MODEL_STATE__MODEL_BAKING)
        snprintf(note, 120, "preview: the bake is at %.0f %%",
                 m->job ? 100 * job_fraction(m->job) : 0.0);
    else if (m->state == RELIGHT__MODEL_STATE__MODEL_FAILED)
        snprintf(note, 120, "preview: the bake failed");
    else if (m->state != RELIGHT__MODEL_STATE__MODEL_READY)
        snprintf(note, 120, "preview: no bake was ordered");
}

// What the walk ratio is and how well it is known.
static void note_ratio(const struct render *r, char note[120])
{
    const struct walk_ratio *w = r->ratio ? r->ratio->value : NULL;
    const size_t n = strlen(note);
    if (!w) return;
    snprintf(note + n, 120 - n, "%sscaled to walks%s: %.2g to %.2g, error %.1f %%",
             n ? "; " : "", r->ratio_of_other ? " of the medium before" : "", w->report.least,
             w->report.most, 100 * w->report.standard_error);
}

static void set_screen_result(struct render *r)
{
    const struct screen_radiance *found = r->screen_radiance.entry->value;
    struct render_result *out = &r->result;
    out->preview = true;
    out->engine = RELIGHT__ENGINE__ENGINE_SPLAT + (int)found->report.engine;
    out->samples = found->report.n_asked;
    out->frames = 1;
    out->error_bound = (float)found->report.expected_error;
    out->shared = 1;
    preview_note(r, out->note);
    note_ratio(r, out->note);
}

static void set_draft_result(struct render *r)
{
    struct render_result *out = &r->result;
    const struct model *m = r->bakes;
    out->draft = true;
    out->converged = false; // the bake's answer follows
    out->bake_fraction = m->state == RELIGHT__MODEL_STATE__MODEL_READY ? 1
                         : m->job ? (float)job_fraction(m->job)
                                  : 0;
    snprintf(out->note, sizeof out->note, "draft: the bake is at %.0f %%",
             100 * (double)out->bake_fraction);
}

// |(1 - w) d + w b - x| <= (1 - w) |d - x| + w |b - x|.
static void set_faded_result(struct render *r)
{
    struct render_result *out = &r->result;
    const float w = r->spec.fade;
    out->draft = true;
    out->converged = false;
    out->bake_fraction = 1;
    out->error_bound = (1 - w) * r->faded_error + w * out->error_bound;
    snprintf(out->note, sizeof out->note, "the bake replaces the draft: %.0f %%",
             100 * (double)w);
}

static void set_baked_result(struct render *r)
{
    struct render_result *out = &r->result;
    out->shared = ((struct vertex_values *)r->vertex_values[0].entry->value)->shared;
    out->error_bound = bake_error(r) + material_error(r);
    out->engine = RELIGHT__ENGINE__ENGINE_WAVELET + (int)render_transport(r)->engine;
    out->converged = true;
    if (r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE) {
        out->engine = RELIGHT__ENGINE__ENGINE_REFERENCE;
        snprintf(out->note, sizeof out->note, "irradiance is traced, not baked");
    }
    if (r->bakes) set_draft_result(r);
    if (r->faded) set_faded_result(r);
    if (r->spec.pose || (r->bakes ? r->bakes : r->model)->pose)
        snprintf(out->note, sizeof out->note, "of the shape before its vertices moved");
}

// What turns coefficients, or the parts of colours, into radiance: one for all blocks of a
// model of one medium, else one of each block.
static void set_outgoing(struct render *r)
{
    static const enum prt_answer_term terms[] = {PRT_ANSWER_TOTAL, PRT_ANSWER_TOTAL,
                                                 PRT_ANSWER_MULTIPLE, PRT_ANSWER_SINGLE};
    const enum prt_answer_term term = terms[r->spec.term];
    const struct prt_transport *t = render_transport(r);
    const struct prt_media *media = render_media(r);
    const uint32_t n = media->n > 1 ? t->mesh.n_block : 1;
    Relight__Outgoing **list = malloc(n * (sizeof *list + sizeof **list));
    Relight__Outgoing *message = (Relight__Outgoing *)(list + n);
    struct prt_outgoing of_medium[PRT_MEDIA_MAX];
    if (!list) return; // the client finds none and refuses the answer
    for (uint32_t i = 0; i < media->n; i++)
        prt_outgoing_of(&media->medium[i], term, PRT_EXIT_NORMALISED, &of_medium[i]);
    for (uint32_t i = 0; i < n; i++) {
        const struct prt_outgoing *o =
            &of_medium[n > 1 ? prt_media_index(media, t->mesh.block[i].object) : 0];
        relight__outgoing__init(list[i] = &message[i]);
        message[i].eta = o->eta;
        message[i].roughness = o->roughness;
        message[i].mean = o->mean;
        message[i].divisor = o->divisor;
        message[i].view_slope = o->view_slope;
    }
    r->result.outgoing = list;
    r->result.n_outgoing = n;
}

// The layers of all planes are the same; each plane has scales of its own.
static void set_coefficients(struct render *r)
{
    struct render_result *out = &r->result;
    for (unsigned i = 0; i < out->n_plane; i++) {
        const struct vertex_values *v = r->vertex_values[i].entry->value;
        const struct prt_coefficients *c = &v->coefficients;
        out->n_layer = c->n_layer;
        memcpy(out->layer, c->layer, sizeof out->layer);
        for (uint32_t k = 0; k < c->n_layer; k++) out->scale[k][i] = c->layer[k].scale;
    }
    out->factors = prt_file_hash(r->file.entry->value);
}

static void set_planes(struct render *r)
{
    struct render_result *out = &r->result;
    if (r->coarse.entry) {
        const struct coarse_order *coarse = r->coarse.entry->value;
        out->n_coarse = coarse_count(coarse, r->spec.coarse);
        out->coarse_order = coarse->hash;
    }
    size_t plane = own_plane_bytes(r, r->vertex_values[0].entry->value);
    out->plane_bytes = out->n_plane > 1 ? (plane + 63) / 64 * 64 : plane;
    if (is_coefficients(&r->spec)) set_coefficients(r);
    if (most_parts(&r->spec)) {
        const struct vertex_values *v = r->vertex_values[0].entry->value;
        out->n_part = v->n_plane;
        out->n_exit = v->n_exit;
    }
    if (is_coefficients(&r->spec) || out->n_part) set_outgoing(r);
}

static void set_result(struct render *r)
{
    struct render_result *out = &r->result;
    const struct render_spec *s = &r->spec;
    out->n_vertex = render_mesh(r)->n_vertex;
    out->n_plane = render_n_values(s);
    out->generation = r->generation;
    out->width = s->width;
    out->height = s->height;
    if (r->visibility.entry)
        prt_visibility_camera(r->visibility.entry->value, &out->camera, NULL, NULL, NULL);
    if (!s->picture) set_planes(r);
    else out->drawn = model_hashes((r->screen ? render_shape(r)->file : r->file.entry)->value);
    if (r->bakes) out->drawn.bake[0] = 0; // a draft is no bake, as find_seen has it
    if (r->screen) set_screen_result(r);
    else set_baked_result(r);
}

static void set_cost(struct render *r)
{
    struct render_result *out = &r->result;
    const struct render_spec *s = &r->spec;
    for (unsigned i = 0; i < s->n_light; i++)
        out->light_ms += dependency_ms(&r->env[i]) + dependency_ms(&r->light[i]) +
                         dependency_ms(&r->contracted_light[i]);
    out->light_ms +=
        dependency_ms(&r->specular) + dependency_ms(&r->background) + dependency_ms(&r->floor);
    for (unsigned i = 0; i < render_n_values(s); i++)
        out->relight_ms = fmaxf(out->relight_ms, dependency_ms(&r->vertex_values[i]));
    if (r->screen) out->relight_ms = dependency_ms(&r->screen_radiance);
    out->raster_ms = dependency_ms(&r->visibility);
}

static void release_entry(void *entry)
{
    cache_release(entry);
}

// Colours of one plane are sent from the cache entry itself.
static void take_entry(struct render *r)
{
    struct cache_entry *entry = r->encoded.entry ? r->encoded.entry : r->vertex_values[0].entry;
    const void *bytes =
        r->encoded.entry ? entry->value : ((struct vertex_values *)entry->value)->values;
    cache_hold(entry);
    r->result.encode_ms = dependency_ms(&r->encoded);
    r->result.payload = (struct payload){bytes, r->result.plane_bytes, entry, release_entry};
}

void render_finish(struct render *r)
{
    const struct render_spec *s = &r->spec;
    char error[300];
    set_result(r);
    if (s->values) {
        cache_hold(r->result.values = r->vertex_values[0].entry);
        render_end(r);
        return;
    }
    int code = check_error_bound(r, error);
    if (code) {
        render_end_with_error(r, code, error);
        return;
    }
    set_cost(r);
    if (!s->picture && r->result.n_plane == 1 && !r->faded && !r->coarse.entry) {
        take_entry(r);
        bool small = r->result.payload.size <= MOST_ON_LOOP;
        if (small && s->hash) hash_payload(r);
        if (small || !s->hash) {
            render_end(r);
            return;
        }
    }
    r->work.run = run_finish;
    r->work.done = finish_done;
    r->work.class = s->quiet     ? WORK_BACKGROUND
                    : s->picture ? picture_class(s)
                                 : WORK_INTERACTIVE;
    r->finishing = true;
    work_submit(r->server->work, &r->work);
}
