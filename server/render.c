// SPDX-License-Identifier: MIT
// One evaluation as a walk over what it needs. Each step asks the memo for its results; where
// some are pending the walk stops and is resumed by the last of them. The final step, which
// belongs to this evaluation alone (colour encoding; shading, tone map, image file), runs on a
// worker.
#include "evaluation.h"

#include "log.h"
#include "request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_NEEDS = 2 * RENDER_MAX_LIGHTS + 4,
    SPECULAR_CUBE = 32,   // what the specular pre-filter reads
};

struct render;
struct need {
    struct memo_waiter waiter; // first: a waiter is its need
    struct render *render;
    struct memo_entry *entry;
    bool was_there; // costs nothing
};

enum step { STEP_FILE, STEP_ENVS, STEP_LIGHTS, STEP_ANSWERS, STEP_FINAL };

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
    bool *ended;    // told while render_start is still running
    struct need file, env[RENDER_MAX_LIGHTS], light[RENDER_MAX_LIGHTS], answer[RENDER_MAX_LIGHTS];
    struct need visibility, specular, background;
    struct prt_camera camera;
    uint64_t start_ns;
    struct render_result result;
};

static void walk(struct render *r);

// ---- needs

static void woken(struct memo_waiter *waiter)
{
    struct need *need = (struct need *)waiter;
    struct render *r = need->render;
    if (--r->n_waiting == 0 && !r->walking) walk(r);
}

static void need_entry(struct render *r, struct need *need, struct memo_entry *entry)
{
    need->render = r;
    need->entry = entry;
    need->was_there = entry->state == MEMO_READY;
    if (entry->state != MEMO_PENDING) return;
    need->waiter.wake = woken;
    r->n_waiting++;
    memo_wait(entry, &need->waiter);
}

static void release_needs(struct render *r)
{
    struct need *one[] = {&r->file, &r->visibility, &r->specular, &r->background};
    for (size_t i = 0; i < sizeof one / sizeof *one; i++) {
        memo_release(one[i]->entry);
        one[i]->entry = NULL;
    }
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) {
        memo_release(r->env[i].entry);
        memo_release(r->light[i].entry);
        memo_release(r->answer[i].entry);
        r->env[i].entry = r->light[i].entry = r->answer[i].entry = NULL;
    }
}

static const struct prt_transport *transport_of(const struct render *r)
{
    return prt_file_transport(r->file.entry->value);
}

// ---- the end

static void finish(struct render *r)
{
    r->result.total_ms = (float)((double)(loop_now_ns() - r->start_ns) * 1e-6);
    render_fn done = r->done;
    void *user = r->user;
    struct render_result result = r->result;
    if (r->ended) *r->ended = true;
    release_needs(r);
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
    if (!need->entry || need->entry->state != MEMO_FAILED) return false;
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

static int run_picture(struct render *r, const struct prt_context *ctx)
{
    const struct prt_transport *t = transport_of(r);
    const struct answer *a = r->answer[0].entry->value;
    const struct prt_cube *lobes = r->specular.entry ? r->specular.entry->value : NULL;
    struct prt_specular *specular = NULL;
    struct prt_image image = {0};
    struct prt_blob blob = {0};
    const struct prt_material *material = r->spec.has_material ? &r->spec.material : &t->material;
    double start = prt_time_s();
    int status = lobes ? prt_specular_create(ctx, lobes, &specular) : PRT_OK;
    bool total = r->spec.term == RELIGHT__TERM__TERM_TOTAL;
    struct prt_shade shade = {.n_plane = a->n_plane, .planes = a->values, .eta = material->eta,
                              .roughness = material->roughness, .fresnel = total,
                              .specular = specular,
                              .background = r->background.entry ? r->background.entry->value
                                                                : NULL};
    if (shade.background) shade.background_rotate_deg = (float)r->spec.light[0].rotate_deg;
    memcpy(shade.background_rgb, r->spec.background, sizeof shade.background_rgb);
    if (!status)
        status = prt_shade_image(ctx, r->visibility.entry->value, &t->mesh, &shade, &image);
    double shaded = prt_time_s();
    if (!status) status = encode_image(ctx, &r->spec, &image, &blob);
    if (!status) own_payload(r, blob.bytes, blob.size, prt_free);
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

static void done_final(struct work *work)
{
    struct render *r = (struct render *)work;
    if (work->status) finish_error(r, error_of_status(work->status), work->error);
    else finish(r);
}

// What the bake measured for the term asked for.
static float error_bound(const struct render *r)
{
    const struct model_facts *f = &r->model->facts;
    switch (r->spec.term) {
    case RELIGHT__TERM__TERM_MULTIPLE: return f->error_multiple;
    case RELIGHT__TERM__TERM_SINGLE: return f->error_single;
    default: return fmaxf(f->error_multiple, f->error_single);
    }
}

// What the bake's bases leave of the material, beside what the bake measured.
static float material_error(const struct render *r)
{
    float error = 0;
    for (unsigned i = 0; i < n_answer(&r->spec); i++)
        error = fmaxf(error, ((const struct answer *)r->answer[i].entry->value)->material_error);
    return error;
}

static float cost_of(const struct need *need)
{
    return need->entry && !need->was_there ? need->entry->ms : 0;
}

static void release_entry(void *entry)
{
    memo_release(entry);
}

static void final(struct render *r)
{
    const struct prt_transport *t = transport_of(r);
    struct render_result *out = &r->result;
    const struct render_spec *s = &r->spec;
    out->n_vertex = t->mesh.n_vertex;
    out->n_plane = n_answer(s);
    out->generation = r->model->generation;
    out->width = s->width;
    out->height = s->height;
    out->camera = r->camera;
    out->shared = ((struct answer *)r->answer[0].entry->value)->shared;
    out->error_bound = error_bound(r) + material_error(r);
    out->engine = RELIGHT__ENGINE__ENGINE_WAVELET + (int)t->engine;
    if (s->has_material && s->max_error > 0 && out->error_bound > s->max_error) {
        char text[120];
        snprintf(text, sizeof text, "the error bound %.3g of this material is above max_error %.3g",
                 (double)out->error_bound, (double)s->max_error);
        finish_error(r, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE, text);
        return;
    }
    for (unsigned i = 0; i < s->n_light; i++)
        out->light_ms += cost_of(&r->env[i]) + cost_of(&r->light[i]);
    if (r->specular.entry != r->light[0].entry) out->light_ms += cost_of(&r->specular);
    out->light_ms += cost_of(&r->background);
    for (unsigned i = 0; i < n_answer(s); i++)
        out->relight_ms = fmaxf(out->relight_ms, cost_of(&r->answer[i]));
    out->raster_ms = cost_of(&r->visibility);
    size_t plane = out->n_vertex * color_bytes(s->format);
    out->plane_bytes = out->n_plane > 1 ? (plane + 63) / 64 * 64 : plane;
    if (!s->picture && s->format == RELIGHT__COLOR_FORMAT__COLOR_F32 && out->n_plane == 1) {
        // The shared result itself is sent.
        struct memo_entry *entry = r->answer[0].entry;
        memo_hold(entry);
        out->payload = (struct payload){((struct answer *)entry->value)->values, plane, entry,
                                        release_entry};
        finish(r);
        return;
    }
    r->work.run = run_final;
    r->work.done = done_final;
    r->work.class = s->picture ? picture_class(s) : WORK_INTERACTIVE;
    work_submit(r->server->work, &r->work);
}

// ---- the walk

// Asks that only an open model can judge. Returns 0 or an error code.
static int judge(const struct render *r, char error[300])
{
    const struct prt_transport *t = transport_of(r);
    const struct render_spec *s = &r->spec;
    static const char *const names[] = {"the default", "reference", "wavelet", "polynomial",
                                        "joint", "splat", "tangent", "texture", "hybrid"};
    if (s->engine && s->engine != RELIGHT__ENGINE__ENGINE_WAVELET + (int)t->engine) {
        snprintf(error, 300, "%.100s was baked for engine %s, not %s", r->model->name,
                 names[RELIGHT__ENGINE__ENGINE_WAVELET + (int)t->engine], names[s->engine]);
        return s->engine == RELIGHT__ENGINE__ENGINE_WAVELET
                       || s->engine == RELIGHT__ENGINE__ENGINE_POLYNOMIAL
                       || s->engine == RELIGHT__ENGINE__ENGINE_JOINT
                   ? RELIGHT__ERROR_CODE__ERROR_MISMATCH
                   : RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (s->term == RELIGHT__TERM__TERM_IRRADIANCE) {
        snprintf(error, 300, "term irradiance is not part of a bake: prt colors computes it");
        return RELIGHT__ERROR_CODE__ERROR_UNSUPPORTED;
    }
    if (t->engine == PRT_ENGINE_POLYNOMIAL && s->n_light) {
        snprintf(error, 300, "%.100s keeps the light of its bake: leave lights out",
                 r->model->name);
        return RELIGHT__ERROR_CODE__ERROR_MISMATCH;
    }
    if (t->engine != PRT_ENGINE_POLYNOMIAL && !s->n_light) {
        snprintf(error, 300, "0 lights: 1 to %d are wanted", RENDER_MAX_LIGHTS);
        return RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    if (s->has_material && t->engine == PRT_ENGINE_WAVELET) {
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
    return transport_of(r)->engine == PRT_ENGINE_POLYNOMIAL;
}

static void ask_file(struct render *r)
{
    int code;
    char error[300];
    struct memo_entry *entry = model_open(r->model, &code, error);
    if (entry) need_entry(r, &r->file, entry);
    else {
        r->result.code = code;
        snprintf(r->result.error, sizeof r->result.error, "%s", error);
    }
}

static void ask_envs(struct render *r)
{
    char error[300];
    r->result.code = judge(r, error);
    for (unsigned i = 0; !r->result.code && i < r->spec.n_light; i++) {
        if (!r->spec.light[i].env[0]) continue;
        struct memo_entry *entry = env_get(r->server, r->spec.light[i].env, &r->result.code, error);
        if (entry) need_entry(r, &r->env[i], entry);
    }
    if (r->result.code) snprintf(r->result.error, sizeof r->result.error, "%s", error);
    if (r->result.code || !r->spec.picture) return;
    camera_choose(&r->spec, &transport_of(r)->mesh, &r->camera);
    need_entry(r, &r->visibility,
               visibility_get(r->model, r->file.entry, &r->spec, &r->camera));
}

static void ask_lights(struct render *r)
{
    uint32_t cube = transport_of(r)->cube;
    const struct render_spec *s = &r->spec;
    unsigned each = n_answer(s) == 1 ? s->n_light : 1;
    struct memo_entry *env[RENDER_MAX_LIGHTS];
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) env[i] = r->env[i].entry;
    for (unsigned i = 0; i < n_answer(s) && !fixed_light(r); i++)
        need_entry(r, &r->light[i], light_get(r->server, s, env, i, each, cube, true));
    if (!s->picture) return;
    if (s->n_light && !s->no_specular && s->term == RELIGHT__TERM__TERM_TOTAL)
        need_entry(r, &r->specular, light_get(r->server, s, env, 0, s->n_light,
                                              SPECULAR_CUBE, true));
    if (s->n_light && !s->plain_background)
        need_entry(r, &r->background, sky_get(r->server, s, env));
}

static void ask_answers(struct render *r)
{
    static const int term[] = {PRT_ANSWER_TOTAL, PRT_ANSWER_TOTAL, PRT_ANSWER_MULTIPLE,
                               PRT_ANSWER_SINGLE};
    const struct render_spec *s = &r->spec;
    const struct prt_transport *t = transport_of(r);
    struct answer_query query = {.term = term[s->term], .planes = s->picture,
                                 .has_material = s->has_material, .material = s->material,
                                 .has_eye = s->has_eye && !s->picture};
    for (int i = 0; i < 3; i++) query.eye[i] = s->eye[i] * t->mesh.mm_per_unit;
    char eye[64] = "", key[RENDER_MAX_LIGHTS * sizeof s->light->key + 200];
    if (query.has_eye)
        snprintf(eye, sizeof eye, "%.9g,%.9g,%.9g", (double)query.eye[0], (double)query.eye[1],
                 (double)query.eye[2]);
    for (unsigned i = 0; i < n_answer(s); i++) {
        struct memo_entry *light = r->light[i].entry;
        snprintf(key, sizeof key, "%s/%llu/%s/%d/%s/%s/%s", r->model->id,
                 (unsigned long long)r->model->generation, s->picture ? "planes" : "colors",
                 query.term, s->material_key, eye, light ? light->key : "fixed");
        need_entry(r, &r->answer[i], answer_get(r->model, key, &query, r->file.entry, light));
    }
}

// True when something needed has failed (and r is gone).
static bool any_failed(struct render *r)
{
    if (r->result.code) {
        finish(r);
        return true;
    }
    if (failed(r, &r->file) || failed(r, &r->visibility) || failed(r, &r->specular)
        || failed(r, &r->background))
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
        case STEP_FILE: ask_file(r); break;
        case STEP_ENVS: ask_envs(r); break;
        case STEP_LIGHTS: ask_lights(r); break;
        case STEP_ANSWERS: ask_answers(r); break;
        case STEP_FINAL: final(r); return;
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
}
