// SPDX-License-Identifier: MIT
// One evaluation as a walk over what it needs. Each step asks the cache for its results; where
// some are pending the walk stops and is resumed by the last of them. The final step, which
// belongs to this evaluation alone (colour encoding; shading, tone map, image file), runs on a
// worker.
#include "render/evaluation.h"

#include "core/log.h"
#include "net/request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    HYBRID_SAMPLES = 900, // its own default
    SPECULAR_CUBE = 32,   // what the specular pre-filter reads
};

struct render;
struct need {
    struct cache_waiter waiter; // first: a waiter is its need
    struct render *render;
    struct cache_entry *entry;
    bool was_there; // costs nothing
};

enum step { STEP_FILE, STEP_ENVS, STEP_LIGHTS, STEP_CONTRACTED, STEP_ANSWERS, STEP_FINAL };

struct render {
    struct work work;
    struct server *server;
    struct model *model;
    struct render_spec spec;
    render_fn done; // NULL: cancelled
    void *user;
    enum step step;
    unsigned n_waiting;
    bool walking;
    bool *ended; // told while render_start is still running
    bool screen; // an image-space engine answers, on the shape as it is now
    uint64_t generation;
    bool passing; // one of many frames: nobody will ask for its light again
    struct need shape, screen_answer;
    struct need file, env[RENDER_MAX_LIGHTS], light[RENDER_MAX_LIGHTS],
        answer[RENDER_MAX_LIGHTS];
    struct need contracted[RENDER_MAX_LIGHTS];
    struct cache_entry *fixed[RENDER_MAX_LIGHTS]; // held, ready; NULL: the file does
    struct need visibility, specular, background, map[3];
    struct prt_camera camera;
    uint64_t start_ns;
    struct render_result result;
};

static void walk(struct render *r);

// ---- needs

static void woken(struct cache_waiter *waiter)
{
    struct need *need = (struct need *)waiter;
    struct render *r = need->render;
    if (--r->n_waiting == 0 && !r->walking) walk(r);
}

static void need_entry(struct render *r, struct need *need, struct cache_entry *entry)
{
    need->render = r;
    need->entry = entry;
    need->was_there = entry->state == CACHE_READY;
    if (entry->state != CACHE_PENDING) return;
    need->waiter.wake = woken;
    r->n_waiting++;
    cache_wait(entry, &need->waiter);
}

static void release_needs(struct render *r)
{
    struct need *one[] = {&r->file,       &r->shape,    &r->screen_answer,
                          &r->visibility, &r->specular, &r->background};
    for (size_t i = 0; i < sizeof one / sizeof *one; i++) {
        cache_release(one[i]->entry);
        one[i]->entry = NULL;
    }
    for (int k = 0; k < 3; k++) {
        cache_release(r->map[k].entry);
        r->map[k].entry = NULL;
    }
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) {
        cache_release(r->env[i].entry);
        cache_release(r->light[i].entry);
        cache_release(r->contracted[i].entry);
        cache_release(r->answer[i].entry);
        r->env[i].entry = r->light[i].entry = r->answer[i].entry = NULL;
        r->contracted[i].entry = NULL;
        cache_release(r->fixed[i]);
        r->fixed[i] = NULL;
    }
}

static const struct prt_transport *transport_of(const struct render *r)
{
    return prt_file_transport(r->file.entry->value);
}

static struct shape *shape_of(const struct render *r)
{
    return r->shape.entry->value;
}

static const struct prt_mesh *mesh_of(const struct render *r)
{
    return r->screen ? &shape_of(r)->mesh : &transport_of(r)->mesh;
}

// ---- the end

static void finish(struct render *r)
{
    r->result.total_ms = (float)((double)(loop_now_ns() - r->start_ns) * 1e-6);
    render_fn done = r->done;
    void *user = r->user;
    struct render_result result = r->result;
    if (r->ended) *r->ended = true;
    if (r->passing && r->screen_answer.entry) cache_forget_entry(r->screen_answer.entry);
    release_needs(r);
    refinement_release(r->spec.refinement);
    render_spec_finish(&r->spec);
    model_release(r->model);
    free(r);
    if (done) done(user, &result);
    else if (result.payload.release) result.payload.release(result.payload.owner);
}

static void finish_error(struct render *r, int code, const char *text)
{
    r->result.code = code;
    snprintf(r->result.error, sizeof r->result.error, "%s", text);
    finish(r);
}

// The first need that failed, told; false when none did.
static bool failed(struct render *r, const struct need *need)
{
    if (!need->entry || need->entry->state != CACHE_FAILED) return false;
    char text[320];
    snprintf(text, sizeof text, "%s", need->entry->error);
    finish_error(r, need->entry->error_code, text);
    return true;
}

static unsigned n_answer(const struct render_spec *spec)
{
    return spec->picture || spec->sum || !spec->n_light ? 1 : spec->n_light;
}

static void own_payload(struct render *r, void *bytes, size_t size, void (*release)(void *))
{
    r->result.payload = (struct payload){bytes, size, bytes, release};
}

static int run_colors(struct render *r, const struct prt_context *ctx)
{
    unsigned n = n_answer(&r->spec);
    size_t plane = (size_t)r->result.plane_bytes;
    uint8_t *bytes = prt_alloc(n, plane ? plane : 1);
    if (!bytes) return PRT_NOMEM;
    double start = prt_time_s();
    for (unsigned i = 0; i < n; i++) {
        const struct answer *a = r->answer[i].entry->value;
        encode_colors(ctx, &r->spec, a, bytes + i * plane);
        size_t used = a->n_vertex * color_bytes(r->spec.format);
        memset(bytes + i * plane + used, 0, plane - used);
    }
    r->result.encode_ms = (float)((prt_time_s() - start) * 1e3);
    own_payload(r, bytes, n * plane, prt_free);
    return PRT_OK;
}

// What an image-space engine found, or the mean of it and what it found before.
static int screen_radiance(const struct render *r, const float (**rgb)[3])
{
    const struct screen_answer *a = r->screen_answer.entry->value;
    struct refinement *refinement = r->spec.refinement;
    int status = refinement ? refinement_add(refinement, a) : PRT_OK;
    *rgb = refinement ? (const float(*)[3])refinement->mean : a->rgb;
    return status;
}

static int compose(const struct render *r, const struct prt_context *ctx,
                   const struct prt_specular *specular, struct prt_image *image)
{
    const struct prt_material *material = r->spec.has_material ? &r->spec.material
                                          : r->screen          ? shape_of(r)->material
                                                               : &transport_of(r)->material;
    bool total = r->spec.term == RELIGHT__TERM__TERM_TOTAL;
    struct prt_shade shade = {.eta = material->eta,
                              .roughness = material->roughness,
                              .fresnel = total,
                              .specular = specular,
                              .background =
                                  r->background.entry ? r->background.entry->value : NULL};
    if (shade.background) shade.background_rotate_deg = (float)r->spec.light[0].rotate_deg;
    memcpy(shade.background_rgb, r->spec.background, sizeof shade.background_rgb);
    if (r->screen) {
        const float(*rgb)[3];
        int status = screen_radiance(r, &rgb);
        if (status || r->spec.quiet) return status;
        return prt_shade_points(ctx, r->visibility.entry->value, rgb, &shade, image);
    }
    const struct answer *a = r->answer[0].entry->value;
    shade.n_plane = a->n_plane;
    shade.planes = a->values;
    return prt_shade_image(ctx, r->visibility.entry->value, &transport_of(r)->mesh, &shade,
                           image);
}

static int run_picture(struct render *r, const struct prt_context *ctx)
{
    const struct prt_cube *lobes = r->specular.entry ? r->specular.entry->value : NULL;
    struct prt_specular *specular = NULL;
    struct prt_image image = {0};
    struct prt_blob blob = {0};
    double start = prt_time_s();
    int status = lobes && !r->spec.quiet ? prt_specular_create(ctx, lobes, &specular) : PRT_OK;
    if (!status) status = compose(r, ctx, specular, &image);
    double shaded = prt_time_s();
    if (!status && !r->spec.quiet) status = encode_image(ctx, &r->spec, &image, &blob);
    if (!status && !r->spec.quiet) own_payload(r, blob.bytes, blob.size, prt_free);
    r->result.shade_ms = (float)((shaded - start) * 1e3);
    r->result.encode_ms = (float)((prt_time_s() - shaded) * 1e3);
    prt_image_finish(&image);
    prt_specular_destroy(specular);
    return status;
}

static int run_final(struct work *work, const struct prt_context *ctx)
{
    struct render *r = (struct render *)work;
    if (!__atomic_load_n(&r->done, __ATOMIC_RELAXED)) return PRT_CANCELLED;
    return r->spec.picture ? run_picture(r, ctx) : run_colors(r, ctx);
}

// What the daemon remembers of how long a picture takes after its light is known.
static void learn_finish_time(struct render *r)
{
    float *ns = &r->server->stats.finish_ns_a_pixel;
    float seen = (r->result.shade_ms + r->result.encode_ms) * 1e6f /
                 (float)(r->spec.width * r->spec.height);
    *ns = *ns > 0 ? 0.8f * *ns + 0.2f * seen : seen;
}

static void done_final(struct work *work)
{
    struct render *r = (struct render *)work;
    if (r->spec.picture && !r->spec.quiet && !work->status) learn_finish_time(r);
    const struct refinement *refinement = r->screen ? r->spec.refinement : NULL;
    if (refinement) {
        r->result.frames = refinement->n_frame;
        r->result.converged = refinement->converged;
        r->result.error_bound = (float)refinement_error(refinement);
    }
    if (work->status) finish_error(r, error_of_status(work->status), work->error);
    else finish(r);
}

// Radiance that a half-space under even light sends out, without the outgoing Fresnel factor:
// rho_d by many events, and by one 0.2046 of the albedo for isotropic scattering, the mean over
// cosine of albedo/2 [1 - mu ln((1 + mu) / mu)]. RMS over channels.
static void parts_of_total(const struct prt_material *m, double *multiple, double *single)
{
    struct prt_diffusion dipole[3];
    prt_material_dipoles(m, dipole);
    *multiple = *single = 0;
    for (int c = 0; c < 3; c++) {
        double s = (double)m->sigma_s_prime[c] / (1 - (double)m->g[c]);
        double one = m->profile ? 0 : 0.2046 * s / (s + (double)m->sigma_a[c]);
        double many = prt_diffusion_tail(&dipole[c], 0);
        *multiple += many * many / 3;
        *single += one * one / 3;
    }
    *multiple = sqrt(*multiple);
    *single = sqrt(*single);
}

// Of the sum of two parts: |e_m + e_s| <= |e_m| + |e_s|, and as no radiance is negative
// |M + S|^2 >= |M|^2 + |S|^2. Never more than the worse part's, which it is where both are
// alike.
static float total_error(const struct render *r)
{
    const struct model_facts *f = &r->model->facts;
    const struct prt_material *m =
        r->spec.has_material ? &r->spec.material : &transport_of(r)->material;
    double multiple, single;
    if (f->error_total > 0) return f->error_total;
    if (!(f->error_single > 0)) return f->error_multiple; // no single scattering was baked
    parts_of_total(m, &multiple, &single);
    double sum = (double)f->error_multiple * multiple + (double)f->error_single * single;
    double worst = fmax((double)f->error_multiple, (double)f->error_single);
    return (float)fmin(worst, sum / fmax(hypot(multiple, single), 1e-30));
}

// What the bake measured for the term asked for.
static float error_bound(const struct render *r)
{
    const struct model_facts *f = &r->model->facts;
    switch (r->spec.term) {
    case RELIGHT__TERM__TERM_IRRADIANCE:
        return 0; // brute force, no bake
    case RELIGHT__TERM__TERM_MULTIPLE:
        return f->error_multiple;
    case RELIGHT__TERM__TERM_SINGLE:
        return f->error_single;
    default:
        return total_error(r);
    }
}

// What the bake's bases leave of the material, beside what the bake measured.
static float material_error(const struct render *r)
{
    float error = 0;
    for (unsigned i = 0; i < n_answer(&r->spec); i++)
        error =
            fmaxf(error, ((const struct answer *)r->answer[i].entry->value)->material_error);
    return error;
}

static float cost_of(const struct need *need)
{
    return need->entry && !need->was_there ? need->entry->ms : 0;
}

static void release_entry(void *entry)
{
    cache_release(entry);
}

static const char *preview_note(const struct render *r, char note[120])
{
    const struct model *m = r->model;
    note[0] = 0;
    if (m->pose)
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
    return note;
}

static void screen_facts(struct render *r)
{
    const struct screen_answer *a = r->screen_answer.entry->value;
    struct render_result *out = &r->result;
    out->preview = true;
    out->engine = RELIGHT__ENGINE__ENGINE_SPLAT + (int)a->report.engine;
    out->samples = a->report.n_asked;
    out->frames = 1;
    out->error_bound = (float)a->report.expected_error;
    out->shared = 1;
    preview_note(r, out->note);
}

static void baked_facts(struct render *r)
{
    struct render_result *out = &r->result;
    out->shared = ((struct answer *)r->answer[0].entry->value)->shared;
    out->error_bound = error_bound(r) + material_error(r);
    out->engine = RELIGHT__ENGINE__ENGINE_WAVELET + (int)transport_of(r)->engine;
    out->converged = true;
    if (r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE) {
        out->engine = RELIGHT__ENGINE__ENGINE_REFERENCE;
        snprintf(out->note, sizeof out->note, "irradiance is traced, not baked");
    }
    if (r->model->pose)
        snprintf(out->note, sizeof out->note, "of the shape before its vertices moved");
}

static void final(struct render *r)
{
    struct render_result *out = &r->result;
    const struct render_spec *s = &r->spec;
    out->n_vertex = mesh_of(r)->n_vertex;
    out->n_plane = n_answer(s);
    out->generation = r->generation;
    out->width = s->width;
    out->height = s->height;
    out->camera = r->camera;
    if (r->screen) screen_facts(r);
    else baked_facts(r);
    if (r->screen && s->max_error > 0 && out->error_bound > s->max_error) {
        char text[120];
        snprintf(text, sizeof text, "the preview's expected error %.3g is above max_error %.3g",
                 (double)out->error_bound, (double)s->max_error);
        finish_error(r, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, text);
        return;
    }
    if (s->has_material && s->max_error > 0 && out->error_bound > s->max_error) {
        char text[120];
        snprintf(text, sizeof text,
                 "the error bound %.3g of this material is above max_error %.3g",
                 (double)out->error_bound, (double)s->max_error);
        finish_error(r, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, text);
        return;
    }
    for (unsigned i = 0; i < s->n_light; i++)
        out->light_ms +=
            cost_of(&r->env[i]) + cost_of(&r->light[i]) + cost_of(&r->contracted[i]);
    if (r->specular.entry != r->light[0].entry) out->light_ms += cost_of(&r->specular);
    out->light_ms += cost_of(&r->background);
    for (unsigned i = 0; i < n_answer(s); i++)
        out->relight_ms = fmaxf(out->relight_ms, cost_of(&r->answer[i]));
    if (r->screen) out->relight_ms = cost_of(&r->screen_answer);
    out->raster_ms = cost_of(&r->visibility);
    size_t plane = out->n_vertex * color_bytes(s->format);
    out->plane_bytes = out->n_plane > 1 ? (plane + 63) / 64 * 64 : plane;
    if (!s->picture && s->format == RELIGHT__COLOR_FORMAT__COLOR_F32 && out->n_plane == 1) {
        // The shared result itself is sent.
        struct cache_entry *entry = r->answer[0].entry;
        cache_hold(entry);
        out->payload = (struct payload){((struct answer *)entry->value)->values, plane, entry,
                                        release_entry};
        finish(r);
        return;
    }
    r->work.run = run_final;
    r->work.done = done_final;
    r->work.class = s->quiet     ? WORK_BACKGROUND
                    : s->picture ? picture_class(s)
                                 : WORK_INTERACTIVE;
    work_submit(r->server->work, &r->work);
}

// ---- the walk

static bool has_maps(const struct render_spec *s)
{
    return s->map[0][0] || s->map[1][0] || s->map[2][0];
}

// What image-space engines cannot do. Returns 0 or an error code.
static int judge_screen(const struct render *r, char error[300])
{
    const struct render_spec *s = &r->spec;
    if (has_maps(s) && !shape_of(r)->mesh.uv) {
        snprintf(error, 300, "%.100s has no texture coordinates for a map to lie on",
                 r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (s->term != RELIGHT__TERM__TERM_TOTAL && s->term != RELIGHT__TERM__TERM_MULTIPLE) {
        snprintf(error, 300, "image-space engines give terms total and multiple, not %s",
                 s->term == RELIGHT__TERM__TERM_SINGLE ? "single" : "irradiance");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (!s->n_light) {
        bool later = !s->engine && r->model->state == RELIGHT__MODEL_STATE__MODEL_BAKING;
        snprintf(error, 300, "0 lights: 1 to %d are wanted%s", RENDER_MAX_LIGHTS,
                 later ? " until the bake, which may keep one, is ready" : "");
        return later ? RELIGHT__ERROR_CODE__ERROR_NOT_READY
                     : RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    return 0;
}

// Asks that only an open model can check_request. Returns 0 or an error code.
static int check_request(const struct render *r, char error[300])
{
    const struct prt_transport *t = transport_of(r);
    const struct render_spec *s = &r->spec;
    static const char *const names[] = {"the default", "reference", "wavelet",
                                        "polynomial",  "joint",     "splat",
                                        "tangent",     "texture",   "hybrid"};
    bool traced = s->term == RELIGHT__TERM__TERM_IRRADIANCE;
    if (has_maps(s)) {
        snprintf(error, 300, "maps are for pictures by image-space engines");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (traced && s->engine > RELIGHT__ENGINE__ENGINE_REFERENCE) {
        snprintf(error, 300, "term irradiance is traced by engine reference, not %s",
                 names[s->engine]);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (!traced && s->engine && s->engine != RELIGHT__ENGINE__ENGINE_WAVELET + (int)t->engine) {
        snprintf(error, 300, "%.100s was baked for engine %s, not %s", r->model->name,
                 names[RELIGHT__ENGINE__ENGINE_WAVELET + (int)t->engine], names[s->engine]);
        return s->engine == RELIGHT__ENGINE__ENGINE_WAVELET ||
                       s->engine == RELIGHT__ENGINE__ENGINE_POLYNOMIAL ||
                       s->engine == RELIGHT__ENGINE__ENGINE_JOINT
                   ? RELIGHT__ERROR_CODE__ERROR_MISMATCH
                   : RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (!traced && t->engine == PRT_TRANSPORT_POLYNOMIAL && s->n_light) {
        snprintf(error, 300, "%.100s keeps the light of its bake: leave lights out",
                 r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if ((traced || t->engine != PRT_TRANSPORT_POLYNOMIAL) && !s->n_light) {
        snprintf(error, 300, "0 lights: 1 to %d are wanted", RENDER_MAX_LIGHTS);
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    if (!traced && s->has_material && t->engine == PRT_TRANSPORT_WAVELET) {
        snprintf(error, 300, "%.100s has its material baked in (wavelet transport)",
                 r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (s->max_error > 0 && error_bound(r) > s->max_error) {
        snprintf(error, 300, "the bake's measured error %.3g is above max_error %.3g",
                 (double)error_bound(r), (double)s->max_error);
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    return 0;
}

static bool fixed_light(const struct render *r)
{
    return !r->screen && transport_of(r)->engine == PRT_TRANSPORT_POLYNOMIAL &&
           r->spec.term != RELIGHT__TERM__TERM_IRRADIANCE;
}

// Pictures of a model without a bake, or whose vertices left it, or by an engine that is named.
static bool wants_screen(const struct render *r)
{
    const struct model *m = r->model;
    if (!r->spec.picture) return false;
    if (!r->spec.engine && has_maps(&r->spec)) return true; // no bake knows them
    if (r->spec.engine) return r->spec.engine >= RELIGHT__ENGINE__ENGINE_SPLAT;
    return m->pose ||
           (m->state != RELIGHT__MODEL_STATE__MODEL_READY && m->mesh != MESH_NONE &&
            !(m->state == RELIGHT__MODEL_STATE__MODEL_FAILED && m->mesh == MESH_FAILED));
}

static void ask_file(struct render *r)
{
    int code;
    char error[300];
    r->screen = wants_screen(r);
    r->generation = r->screen ? r->model->generation : r->model->baked_generation;
    struct cache_entry *entry =
        r->screen ? shape_get(r->model, &code, error) : model_open(r->model, &code, error);
    if (entry) need_entry(r, r->screen ? &r->shape : &r->file, entry);
    else {
        r->result.code = code;
        snprintf(r->result.error, sizeof r->result.error, "%s", error);
    }
}

static void ask_envs(struct render *r)
{
    char error[300];
    r->result.code = r->screen ? judge_screen(r, error) : check_request(r, error);
    for (unsigned i = 0; !r->result.code && i < r->spec.n_light; i++) {
        if (!r->spec.light[i].env[0]) continue;
        struct cache_entry *entry =
            env_get(r->server, r->spec.light[i].env, &r->result.code, error);
        if (entry) need_entry(r, &r->env[i], entry);
    }
    for (int k = 0; !r->result.code && r->screen && k < 3; k++) {
        if (!r->spec.map[k][0]) continue;
        const struct prt_material *material =
            r->spec.has_material ? &r->spec.material : shape_of(r)->material;
        struct cache_entry *entry =
            surface_map_get(r->server, (enum prt_screen_map_kind)k, r->spec.map[k], material,
                            r->spec.bump_mm, &r->result.code, error);
        if (entry) need_entry(r, &r->map[k], entry);
    }
    if (r->result.code) snprintf(r->result.error, sizeof r->result.error, "%s", error);
    if (r->result.code || !r->spec.picture) return;
    camera_choose(r->model, r->generation, &r->spec, mesh_of(r), &r->camera);
    need_entry(r, &r->visibility,
               visibility_get(r->model, r->generation,
                              r->screen ? r->shape.entry : r->file.entry, mesh_of(r), &r->spec,
                              &r->camera));
    if (r->screen && !r->visibility.was_there) shape_prepare(r->model, r->shape.entry);
}

static void ask_lights(struct render *r)
{
    uint32_t cube = r->screen ? SPECULAR_CUBE : transport_of(r)->cube;
    if (!cube) cube = SPECULAR_CUBE; // a polynomial bake has no cube of its own
    const struct render_spec *s = &r->spec;
    unsigned each = n_answer(s) == 1 ? s->n_light : 1;
    struct cache_entry *env[RENDER_MAX_LIGHTS];
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) env[i] = r->env[i].entry;
    for (unsigned i = 0; i < n_answer(s) && !fixed_light(r); i++)
        need_entry(r, &r->light[i], light_get(r->server, s, env, i, each, cube, true));
    if (!s->picture) return;
    if (s->n_light && !s->no_specular && s->term == RELIGHT__TERM__TERM_TOTAL)
        need_entry(r, &r->specular,
                   light_get(r->server, s, env, 0, s->n_light, SPECULAR_CUBE, true));
    if (s->n_light && !s->plain_background)
        need_entry(r, &r->background, sky_get(r->server, s, env));
}

// The part of a picture's budget that is left for its light.
static float light_budget(const struct render *r)
{
    float budget = (float)r->spec.budget_ms;
    if (!(budget > 0)) return 0;
    float rest =
        r->server->stats.finish_ns_a_pixel * 1e-6f * (float)(r->spec.width * r->spec.height);
    return fmaxf(budget - rest - cost_of(&r->visibility), 0.25f * budget);
}

static void ask_screen(struct render *r)
{
    const struct render_spec *s = &r->spec;
    const struct refinement *mean = s->refinement;
    const char *seen = r->visibility.entry->key, *light = r->light[0].entry->key;
    struct screen_query query = {.engine = -1,
                                 .budget_ms = light_budget(r),
                                 .has_material = s->has_material,
                                 .material = s->material,
                                 .background = picture_class(s) == WORK_BACKGROUND};
    if (s->engine) {
        query.engine = s->engine - RELIGHT__ENGINE__ENGINE_SPLAT;
        query.slot = (unsigned)query.engine + 1;
    }
    if (mean && mean->n_frame) {
        // A mean by tangent planes would not go to the exact sum.
        bool other = !s->engine && mean->engine == PRT_SCREEN_TANGENT;
        query.engine = other ? (int)PRT_SCREEN_HYBRID : mean->engine;
        query.n_sample = other ? HYBRID_SAMPLES : mean->n_sample;
        query.frame = mean->n_frame;
        query.background = true;
    }
    size_t size = strlen(seen) + strlen(light) + 420;
    char *key = malloc(size);
    if (!key) {
        r->result.code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
        snprintf(r->result.error, sizeof r->result.error, "not enough memory");
        return;
    }
    snprintf(key, size, "%s/%llu/screen/%u/%d/%u/%u/%.0f/%s/%s/%s/%s/%.9g/%s/%s", r->model->key,
             (unsigned long long)r->generation, query.slot, query.engine, query.n_sample,
             query.frame, (double)s->budget_ms, s->material_key, s->map[0], s->map[1],
             s->map[2], (double)s->bump_mm, seen, light);
    struct cache_entry *map[3] = {r->map[0].entry, r->map[1].entry, r->map[2].entry};
    need_entry(r, &r->screen_answer,
               screen_get(r->server, key, &query, r->shape.entry, r->visibility.entry,
                          r->light[0].entry, map));
    r->passing = query.frame != 0;
    free(key);
}

enum { ANSWER_KEY = RENDER_MAX_LIGHTS * sizeof(((struct render_light *)0)->key) + 200 };

// What is asked for answer i, and the key it is shared by.
static void answer_query(const struct render *r, unsigned i, struct answer_query *query,
                         char key[ANSWER_KEY])
{
    static const int term[] = {PRT_ANSWER_TOTAL, PRT_ANSWER_TOTAL, PRT_ANSWER_MULTIPLE,
                               PRT_ANSWER_SINGLE};
    const struct render_spec *s = &r->spec;
    const struct cache_entry *light = r->light[i].entry;
    *query = (struct answer_query){.term = term[s->term],
                                   .planes = s->picture,
                                   .has_material = s->has_material,
                                   .material = s->material,
                                   .has_eye = s->has_eye && !s->picture};
    for (int c = 0; c < 3; c++) query->eye[c] = s->eye[c] * transport_of(r)->mesh.mm_per_unit;
    char eye[64] = "";
    if (query->has_eye)
        snprintf(eye, sizeof eye, "%.9g,%.9g,%.9g", (double)query->eye[0],
                 (double)query->eye[1], (double)query->eye[2]);
    if (s->term == RELIGHT__TERM__TERM_IRRADIANCE)
        snprintf(key, ANSWER_KEY, "%s/%llu/irradiance/%s/%s", r->model->key,
                 (unsigned long long)r->generation, s->material_key, light->key);
    else
        snprintf(key, ANSWER_KEY, "%s/%llu/%s/%d/%s/%s/%s", r->model->key,
                 (unsigned long long)r->generation, s->picture ? "planes" : "colors",
                 query->term, s->material_key, eye, light ? light->key : "fixed");
}

// Materials that stay and lights that somebody has asked for before: their part of the answer
// is made once.
static void ask_contracted(struct render *r)
{
    if (r->screen || fixed_light(r) || r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE) return;
    for (unsigned i = 0; i < n_answer(&r->spec); i++) {
        struct answer_query query;
        char key[ANSWER_KEY];
        answer_query(r, i, &query, key);
        struct cache_entry *answer = cache_find(r->server->cache, key);
        cache_release(answer);
        if (answer) continue; // or is on its way
        struct cache_entry *light = r->light[i].entry;
        struct cache_entry *entry =
            contracted_get(r->model, r->generation, r->file.entry, light, false);
        if (!entry)
            r->fixed[i] =
                fixed_get(r->model, r->generation, r->file.entry, light,
                          query.has_material ? &query.material : NULL, r->spec.material_key);
        if (!entry && !r->fixed[i])
            entry = contracted_get(r->model, r->generation, r->file.entry, light, true);
        if (entry) need_entry(r, &r->contracted[i], entry);
    }
}

static void ask_answers(struct render *r)
{
    if (r->screen) {
        ask_screen(r);
        return;
    }
    for (unsigned i = 0; i < n_answer(&r->spec); i++) {
        struct cache_entry *light = r->light[i].entry;
        struct answer_query query;
        char key[ANSWER_KEY];
        answer_query(r, i, &query, key);
        need_entry(r, &r->answer[i],
                   r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE
                       ? irradiance_get(r->server, key, &query, r->file.entry, light)
                       : answer_get(r->model, key, &query, r->file.entry, light,
                                    r->contracted[i].entry, r->fixed[i]));
    }
}

// True when something needed has failed (and r is gone).
static bool any_failed(struct render *r)
{
    if (r->result.code) {
        finish(r);
        return true;
    }
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++)
        if (failed(r, &r->contracted[i])) return true;
    if (failed(r, &r->file) || failed(r, &r->shape) || failed(r, &r->screen_answer) ||
        failed(r, &r->visibility) || failed(r, &r->specular) || failed(r, &r->background) ||
        failed(r, &r->map[0]) || failed(r, &r->map[1]) || failed(r, &r->map[2]))
        return true;
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++)
        if (failed(r, &r->env[i]) || failed(r, &r->light[i]) || failed(r, &r->answer[i]))
            return true;
    return false;
}

static void walk(struct render *r)
{
    r->walking = true;
    while (!r->n_waiting) {
        if (!r->done) r->result.code = RELIGHT__ERROR_CODE__ERROR_CANCELLED;
        if (any_failed(r)) return;
        switch (r->step++) {
        case STEP_FILE:
            ask_file(r);
            break;
        case STEP_ENVS:
            ask_envs(r);
            break;
        case STEP_LIGHTS:
            ask_lights(r);
            break;
        case STEP_CONTRACTED:
            ask_contracted(r);
            break;
        case STEP_ANSWERS:
            ask_answers(r);
            break;
        case STEP_FINAL:
            final(r);
            return;
        }
        // An error found while others were asked for already: they come back first.
    }
    r->walking = false;
}

struct render *render_start(struct model *model, struct render_spec *spec, render_fn done,
                            void *user)
{
    struct render *r = calloc(1, sizeof *r);
    if (!r) {
        struct render_result result = {.code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY,
                                       .error = "not enough memory"};
        render_spec_finish(spec);
        done(user, &result);
        return NULL;
    }
    r->server = model->server;
    r->model = model;
    model_hold(model);
    r->spec = *spec;
    spec->texels = NULL;
    if (r->spec.refinement) r->spec.refinement->refs++;
    r->done = done;
    r->user = user;
    r->start_ns = loop_now_ns();
    bool ended = false;
    r->ended = &ended;
    walk(r);
    if (ended) return NULL;
    r->ended = NULL;
    return r;
}

void render_cancel(struct render *r)
{
    __atomic_store_n(&r->done, NULL, __ATOMIC_RELAXED);
    struct cache_entry *e = r->screen_answer.entry;
    if (e && e->state == CACHE_PENDING) screen_unwant(r->shape.entry, e);
}
