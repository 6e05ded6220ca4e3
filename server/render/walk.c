// SPDX-License-Identifier: MIT
// The walk of one evaluation over its steps. Each step takes the cache entries it depends on;
// where some are pending the walk stops, and the last of them that ends resumes it. The last
// step (finish.c) belongs to this evaluation alone. Above 600 lines: the order of the steps
// is what the file says.
#include "render/walk.h"

#include "core/log.h"
#include "net/request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    HYBRID_SAMPLES = 900, // engine hybrid's own default
    SPECULAR_CUBE = 32,   // side of the cube that prt_specular_create() filters
    VALUES_KEY = RENDER_MAX_LIGHTS * sizeof(((struct render_light *)0)->key) + 300,
};

static void walk(struct render *r);

// ---- dependencies

static void dependency_ended(struct cache_waiter *waiter)
{
    struct render *r = ((struct dependency *)waiter)->render;
    ((struct dependency *)waiter)->waits = false;
    if (--r->n_waiting == 0 && !r->walking) walk(r);
}

// Takes the caller's reference to the entry.
static void depend(struct render *r, struct dependency *dependency, struct cache_entry *entry)
{
    dependency->render = r;
    dependency->entry = entry;
    dependency->was_ready = entry->state == CACHE_READY;
    if (entry->state != CACHE_PENDING) return;
    dependency->waiter.wake = dependency_ended;
    dependency->waits = true;
    r->n_waiting++;
    cache_wait(entry, &dependency->waiter);
}

static void release(struct cache_entry **entry)
{
    cache_release(*entry);
    *entry = NULL;
}

// Passes of the model wait for evaluations whose lights are being turned.
static void begin_turning(struct render *r)
{
    r->turning = true;
    r->model->n_turning++;
}

static void end_turning(struct render *r)
{
    if (!r->turning) return;
    r->turning = false;
    r->model->n_turning--;
    relight_pass_go_on(r->model);
}

void render_release(struct render *r)
{
    end_turning(r);
    struct dependency *one[] = {
        &r->file,       &r->shape,    &r->variant,    &r->media,  &r->screen_radiance,
        &r->visibility, &r->specular, &r->background, &r->map[0], &r->map[1],
        &r->map[2],     &r->encoded,  &r->floor,      &r->coarse};
    for (size_t i = 0; i < sizeof one / sizeof *one; i++) release(&one[i]->entry);
    release(&r->faded);
    release(&r->ratio);
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) {
        release(&r->env[i].entry);
        release(&r->light[i].entry);
        release(&r->contracted_light[i].entry);
        release(&r->vertex_values[i].entry);
        release(&r->contracted_material[i]);
        free(r->values_key[i]);
        r->values_key[i] = NULL;
    }
}

float dependency_ms(const struct dependency *dependency)
{
    return dependency->entry && !dependency->was_ready ? dependency->entry->ms : 0;
}

// Ends the evaluation with the entry's error; false where it did not fail.
static bool failed(struct render *r, const struct dependency *dependency)
{
    const struct cache_entry *entry = dependency->entry;
    if (!entry || entry->state != CACHE_FAILED) return false;
    r->result.code = entry->error_code;
    snprintf(r->result.error, sizeof r->result.error, "%s", entry->error);
    render_end(r);
    return true;
}

// True when an error was found or a dependency failed: the evaluation has ended.
static bool any_failed(struct render *r)
{
    if (r->result.code) {
        render_end(r);
        return true;
    }
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++)
        if (failed(r, &r->contracted_light[i])) return true;
    if (failed(r, &r->encoded) || failed(r, &r->file) || failed(r, &r->shape) ||
        failed(r, &r->variant) || failed(r, &r->media) || failed(r, &r->floor) ||
        failed(r, &r->coarse) || failed(r, &r->screen_radiance) || failed(r, &r->visibility) ||
        failed(r, &r->specular) || failed(r, &r->background) || failed(r, &r->map[0]) ||
        failed(r, &r->map[1]) || failed(r, &r->map[2]))
        return true;
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++)
        if (failed(r, &r->env[i]) || failed(r, &r->light[i]) || failed(r, &r->vertex_values[i]))
            return true;
    return false;
}

static void set_error(struct render *r, int code, const char *text)
{
    r->result.code = code;
    snprintf(r->result.error, sizeof r->result.error, "%s", text);
}

const struct prt_transport *render_transport(const struct render *r)
{
    return prt_file_transport(r->file.entry->value);
}

const struct pose *render_pose(const struct render *r)
{
    return r->spec.pose ? r->spec.pose : r->model->pose;
}

struct shape *render_shape(const struct render *r)
{
    return r->shape.entry->value;
}

static const struct prt_variant *render_variant(const struct render *r)
{
    return ((const struct variant_view *)r->variant.entry->value)->variant;
}

const struct prt_mesh *render_mesh(const struct render *r)
{
    return r->screen          ? &render_shape(r)->mesh
           : r->variant.entry ? &render_variant(r)->mesh
                              : &render_transport(r)->mesh;
}

// The entry that holds what render_mesh() returns.
static struct cache_entry *mesh_entry(const struct render *r)
{
    return r->screen ? r->shape.entry : r->variant.entry ? r->variant.entry : r->file.entry;
}

static bool draws(const struct render *r)
{
    return r->spec.picture && !r->spec.values;
}

const struct prt_media *render_media(const struct render *r)
{
    return r->media.entry     ? r->media.entry->value
           : r->screen        ? render_shape(r)->media
           : r->variant.entry ? render_variant(r)->media
                              : &render_transport(r)->media;
}

unsigned render_n_values(const struct render_spec *spec)
{
    return spec->picture || spec->sum || !spec->n_light ? 1 : spec->n_light;
}

// ---- steps

static void step_model(struct render *r)
{
    int code;
    char error[300];
    r->screen = render_uses_screen(r);
    struct pose *pose = r->spec.pose;
    r->generation = !r->screen ? r->model->baked_generation
                    : pose     ? pose->generation
                               : r->model->generation;
    struct cache_entry *entry = r->screen
                                    ? shape_get(r->model, pose, r->spec.variant, &code, error)
                                    : model_open(r->model, &code, error);
    if (entry) depend(r, r->screen ? &r->shape : &r->file, entry);
    else set_error(r, code, error);
}

static int depend_on_variant(struct render *r, char error[300])
{
    int code = 0;
    struct cache_entry *entry = variant_get(r->model, &r->spec, r->file.entry, &code, error);
    if (!entry) return code;
    depend(r, &r->variant, entry);
    if (entry->state == CACHE_READY) r->spec.variant_shines = !render_variant(r)->plain;
    return 0;
}

static void step_media(struct render *r)
{
    char error[300];
    int code = check_request(r, error);
    if (!code && !r->screen && r->spec.variant[0]) code = depend_on_variant(r, error);
    if (code) {
        set_error(r, code, error);
        return;
    }
    const struct cache_entry *file = r->screen ? render_shape(r)->file : r->file.entry;
    const bool free_media = r->variant.entry && r->spec.variant_shines &&
                            render_transport(r)->engine != PRT_TRANSPORT_WAVELET;
    struct cache_entry *entry =
        media_get(r->model, &r->spec, mesh_entry(r), render_mesh(r), render_media(r),
                  prt_file_hash(file->value), free_media);
    if (entry) depend(r, &r->media, entry);
}

// Texels that a hand turns: with each of its states only the angle changes. Larger cubes are
// for the background, and by quarters a cube is turned without resampling.
static bool is_turned_cube(const struct render_light *light)
{
    return light->cube_n && light->cube_n <= ENV_TURNED_CUBE &&
           fmod(light->rotate_deg, 90) != 0;
}

static int depend_on_images(struct render *r, char error[300])
{
    int code = 0;
    for (unsigned i = 0; !code && i < r->spec.n_light; i++) {
        const struct render_light *light = &r->spec.light[i];
        struct cache_entry *entry = NULL;
        if (light->env[0]) entry = env_get(r->server, light->env, &code, error);
        else if (is_turned_cube(light)) entry = env_of_texels(r->server, &r->spec, light);
        if (entry) depend(r, &r->env[i], entry);
    }
    for (int k = 0; !code && r->screen && k < 3; k++) {
        if (!r->spec.map[k][0]) continue;
        struct cache_entry *entry =
            surface_map_get(r->server, (enum prt_screen_map_kind)k, r->spec.map[k],
                            render_media(r)->medium, r->spec.bump_mm, &code, error);
        if (entry) depend(r, &r->map[k], entry);
    }
    return code;
}

static void step_environments(struct render *r)
{
    char error[300];
    int code = check_media(r, error);
    if (!code) code = depend_on_images(r, error);
    struct prt_camera camera;
    if (!code && draws(r)) code = camera_choose(&r->spec, render_mesh(r), &camera, error);
    if (code) set_error(r, code, error);
    if (code || !draws(r)) return;
    depend(r, &r->visibility,
           visibility_get(r->model, r->generation, mesh_entry(r), render_mesh(r), &r->spec,
                          &camera));
    if (r->screen && !r->visibility.was_ready) shape_prepare(r->model, r->shape.entry);
}

// A single light is filtered as it was before its turn: shading turns the look-up.
static void depend_on_specular(struct render *r, struct cache_entry *const env[])
{
    const struct render_spec *s = &r->spec;
    struct cache_entry *light =
        light_get(r->server, s, env, 0, s->n_light, SPECULAR_CUBE, s->n_light > 1);
    struct cache_entry *entry = specular_get(r->server, light);
    cache_release(light);
    if (entry) depend(r, &r->specular, entry);
    else set_error(r, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
}

static void step_lights(struct render *r)
{
    uint32_t cube = r->screen ? SPECULAR_CUBE : render_transport(r)->cube;
    if (!cube) cube = SPECULAR_CUBE; // polynomial transport has no cube of its own
    const struct render_spec *s = &r->spec;
    unsigned each = render_n_values(s) == 1 ? s->n_light : 1;
    struct cache_entry *env[RENDER_MAX_LIGHTS];
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) env[i] = r->env[i].entry;
    for (unsigned i = 0; i < render_n_values(s) && !render_light_is_baked(r); i++)
        depend(r, &r->light[i], light_get(r->server, s, env, i, each, cube, true));
    if (r->n_waiting && !r->screen) begin_turning(r);
    if (!draws(r)) return;
    if (s->n_light && !s->no_specular && s->term == RELIGHT__TERM__TERM_TOTAL)
        depend_on_specular(r, env);
    if (s->n_light && !s->plain_background && !s->transparent)
        depend(r, &r->background, background_get(r->server, s, env));
}

static void vertex_query(const struct render *r, struct vertex_query *query)
{
    static const int term[] = {PRT_ANSWER_TOTAL, PRT_ANSWER_TOTAL, PRT_ANSWER_MULTIPLE,
                               PRT_ANSWER_SINGLE};
    const struct render_spec *s = &r->spec;
    *query = (struct vertex_query){
        .term = term[s->term],
        .planes = s->picture || most_parts(s),
        .most_apart = most_parts(s),
        .coefficients = is_coefficients(s),
        .most_rank = is_coefficients(s) ? s->most_rank
                     : s->picture       ? 0
                                        : s->color_rank,
        .phases = is_coefficients(s) && s->phases,
        .packed =
            is_coefficients(s) && s->format == RELIGHT__COLOR_FORMAT__COLOR_COEFFICIENTS_PACKED,
        .exits = sends_exits(s),
        .format = r->encodes ? s->format : (int)RELIGHT__COLOR_FORMAT__COLOR_F32,
        .exposure_ev = s->exposure_ev,
        .media = r->media.entry,
        .variant = r->variant.entry,
        .has_eye = s->has_eye && !s->picture};
    for (int c = 0; c < 3; c++)
        query->eye[c] = s->eye[c] * render_transport(r)->mesh.mm_per_unit;
}

// The cache key of vertex_values i, malloc()ed; NULL without memory.
static char *values_key(const struct render *r, unsigned i, const struct vertex_query *query)
{
    const struct render_spec *s = &r->spec;
    const struct cache_entry *light = r->light[i].entry;
    char key[VALUES_KEY], eye[64] = "", media[MEDIA_KEY], format[32] = "";
    media_key(s, media);
    if (query->format != RELIGHT__COLOR_FORMAT__COLOR_F32)
        snprintf(format, sizeof format, "/%d,%.9g", query->format, (double)query->exposure_ev);
    if (query->has_eye)
        snprintf(eye, sizeof eye, "%.9g,%.9g,%.9g", (double)query->eye[0],
                 (double)query->eye[1], (double)query->eye[2]);
    if (s->term == RELIGHT__TERM__TERM_IRRADIANCE)
        snprintf(key, sizeof key, "%s/%llu/irradiance/%s/%s", r->model->key,
                 (unsigned long long)r->generation, media, light->key);
    else
        snprintf(key, sizeof key, "%s/%llu/%s%s%s%u,%u/%d/%s/%s/%s%s", r->model->key,
                 (unsigned long long)r->generation, query->exits ? "exits," : "",
                 s->picture             ? "planes"
                 : query->most_apart    ? "parts"
                 : !query->coefficients ? "colors"
                 : query->phases        ? "phases"
                                        : "rows",
                 query->packed ? "packed," : "", query->most_apart, query->most_rank,
                 query->term, media, eye, light ? light->key : "fixed", format);
    return strdup(key);
}

static bool is_cached(const struct render *r, const char *key)
{
    struct cache_entry *entry = cache_find(r->server->cache, key);
    const bool found = entry && entry->state != CACHE_FAILED;
    cache_release(entry);
    return found;
}

// Colours of one light are encoded by the pass that computes them, but where their floats are
// in the cache.
static void choose_encoding(struct render *r)
{
    const struct render_spec *s = &r->spec;
    struct vertex_query query;
    if (s->picture || s->values || s->fade_from || s->coarse || is_coefficients(s) ||
        most_parts(s) || render_n_values(s) > 1 || s->term == RELIGHT__TERM__TERM_IRRADIANCE ||
        s->format == RELIGHT__COLOR_FORMAT__COLOR_F32)
        return;
    vertex_query(r, &query);
    char *floats = values_key(r, 0, &query);
    r->encodes = floats && !is_cached(r, floats);
    free(floats);
}

// Joint transport, where the values are not in the cache: contracted with the light if that is
// there already, else with the material, else with the light.
static void depend_on_contraction(struct render *r, unsigned i)
{
    char media[MEDIA_KEY];
    struct cache_entry *light = r->light[i].entry, *file = r->file.entry;
    struct cache_entry *entry = light_contraction_find(r->model, r->generation, file, light);
    if (!entry) {
        media_key(&r->spec, media);
        r->contracted_material[i] = material_contraction_get(r->model, r->generation, file,
                                                             light, r->media.entry, media);
        if (r->contracted_material[i]) return;
        entry = light_contraction_get(r->model, r->generation, file, light);
    }
    if (entry) depend(r, &r->contracted_light[i], entry);
}

static void step_contractions(struct render *r)
{
    if (r->screen) return;
    struct vertex_query query;
    choose_encoding(r);
    vertex_query(r, &query);
    bool baked_alone =
        render_light_is_baked(r) || r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE;
    for (unsigned i = 0; i < render_n_values(&r->spec); i++) {
        r->values_key[i] = values_key(r, i, &query);
        if (!r->values_key[i]) {
            set_error(r, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
            return;
        }
        if (baked_alone) continue;
        if (!is_cached(r, r->values_key[i])) depend_on_contraction(r, i);
    }
}

// Milliseconds of the request's budget that remain for the radiance; 0: no budget was named.
static float light_budget(const struct render *r)
{
    static const float least = 0.25f; // share of the budget; chosen, not measured
    float budget = (float)r->spec.budget_ms;
    if (!(budget > 0)) return 0;
    float rest =
        r->server->stats.finish_ns_a_pixel * 1e-6f * (float)(r->spec.width * r->spec.height);
    return fmaxf(budget - rest - dependency_ms(&r->visibility), least * budget);
}

static void screen_query(const struct render *r, struct screen_query *query)
{
    const struct render_spec *s = &r->spec;
    const struct refinement *mean = s->refinement;
    *query = (struct screen_query){.engine = -1,
                                   .budget_ms = light_budget(r),
                                   .media = r->media.entry,
                                   .background = picture_class(s) == WORK_BACKGROUND};
    if (s->engine) {
        query->engine = s->engine - RELIGHT__ENGINE__ENGINE_SPLAT;
        query->slot = (unsigned)query->engine + 1;
    }
    if (!mean || !mean->n_frame) return;
    // A mean by tangent planes does not converge to the exact sum: hybrid continues it.
    bool other = !s->engine && mean->engine == PRT_SCREEN_TANGENT;
    query->engine = other ? (int)PRT_SCREEN_HYBRID : mean->engine;
    query->n_sample = other ? HYBRID_SAMPLES : mean->n_sample;
    query->frame = mean->n_frame;
    query->background = true;
}

static void depend_on_screen(struct render *r)
{
    const struct render_spec *s = &r->spec;
    const char *visibility = r->visibility.entry->key, *light = r->light[0].entry->key;
    struct screen_query query;
    char media[MEDIA_KEY];
    screen_query(r, &query);
    media_key(s, media);
    size_t size = strlen(visibility) + strlen(light) + 420 + MEDIA_KEY;
    char *key = malloc(size);
    if (!key) {
        set_error(r, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return;
    }
    snprintf(key, size, "%s/%llu/screen/%u/%d/%u/%u/%.0f/%s/%s/%s/%s/%.9g/%s/%s", r->model->key,
             (unsigned long long)r->generation, query.slot, query.engine, query.n_sample,
             query.frame, (double)s->budget_ms, media, s->map[0], s->map[1], s->map[2],
             (double)s->bump_mm, visibility, light);
    struct cache_entry *map[3] = {r->map[0].entry, r->map[1].entry, r->map[2].entry};
    depend(r, &r->screen_radiance,
           screen_radiance_get(r->server, key, &query, r->shape.entry, r->visibility.entry,
                               r->light[0].entry, map));
    r->transient = query.frame != 0;
    free(key);
}

static void depend_on_floor(struct render *r)
{
    const struct render_spec *s = &r->spec;
    struct cache_entry *entry =
        floor_get(r->server, mesh_entry(r), render_mesh(r), r->visibility.entry,
                  r->light[0].entry, (size_t)s->width * s->height);
    if (entry) depend(r, &r->floor, entry);
    else set_error(r, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
}

// The draft's values are there, or could not be computed: then the bake's are shown alone.
static void faded(void *user, struct render_result *result)
{
    struct render *r = user;
    r->fading = NULL;
    r->faded = result->values;
    r->faded_error = result->error_bound;
    if (--r->n_waiting == 0 && !r->walking) walk(r);
}

static void fade(struct render *r)
{
    struct render_spec spec;
    if (!r->spec.fade_from || is_coefficients(&r->spec) || render_n_values(&r->spec) > 1)
        return;
    render_spec_copy(&r->spec, &spec);
    spec.fade_from = NULL;
    spec.refinement = NULL;
    spec.values = true;
    spec.hash = spec.floor = false;
    spec.max_error = 0;
    r->n_waiting++;
    r->fading = render_start(r->spec.fade_from, &spec, faded, r);
}

static void step_radiance(struct render *r)
{
    if (r->spec.picture && r->spec.floor) depend_on_floor(r);
    if (r->screen) {
        depend_on_screen(r);
        if (r->spec.term != RELIGHT__TERM__TERM_IRRADIANCE)
            r->ratio = walk_ratio_get(r->model, &r->spec, r->shape.entry, r->media.entry,
                                      &r->ratio_of_other);
        return;
    }
    fade(r);
    if (r->spec.coarse && !r->spec.picture && !r->spec.values && !is_coefficients(&r->spec))
        depend(r, &r->coarse, coarse_order_get(r->model, r->file.entry));
    struct vertex_query query;
    vertex_query(r, &query);
    for (unsigned i = 0; i < render_n_values(&r->spec); i++) {
        struct cache_entry *file = r->file.entry, *light = r->light[i].entry;
        const char *key = r->values_key[i];
        depend(r, &r->vertex_values[i],
               r->spec.term == RELIGHT__TERM__TERM_IRRADIANCE
                   ? irradiance_get(r->server, key, &query, file, light)
                   : relight_pass_get(r->model, key, &query, file, light,
                                      r->contracted_light[i].entry, r->contracted_material[i]));
    }
}

// Of floats that are in the cache. Colours of several planes are encoded with their answer.
static void step_encoding(struct render *r)
{
    if (r->encodes || r->spec.picture || r->spec.values || r->faded || r->coarse.entry ||
        render_n_values(&r->spec) > 1 || r->spec.format == RELIGHT__COLOR_FORMAT__COLOR_F32 ||
        is_coefficients(&r->spec))
        return;
    struct cache_entry *entry =
        encoded_colors_get(r->server, &r->spec, r->vertex_values[0].entry);
    if (entry) depend(r, &r->encoded, entry);
    else set_error(r, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
}

static void take_steps(struct render *r)
{
    static void (*const run_step[])(struct render *) = {[STEP_MODEL] = step_model,
                                                        [STEP_MEDIA] = step_media,
                                                        [STEP_ENVIRONMENTS] = step_environments,
                                                        [STEP_LIGHTS] = step_lights,
                                                        [STEP_CONTRACTIONS] = step_contractions,
                                                        [STEP_RADIANCE] = step_radiance,
                                                        [STEP_ENCODING] = step_encoding};
    r->walking = true;
    while (!r->n_waiting) { // a step that found an error may have dependencies: they end first
        if (!r->done) r->result.code = RELIGHT__ERROR_CODE__ERROR_CANCELLED;
        if (any_failed(r)) return;
        if (r->step == STEP_FINISH) {
            render_finish(r);
            return;
        }
        run_step[r->step++](r);
        // It joined a pass, or waits for a contraction, which may take long.
        if (r->step > STEP_RADIANCE || (r->step == STEP_RADIANCE && r->n_waiting))
            end_turning(r);
    }
    r->walking = false;
}

static void walk(struct render *r)
{
    struct work_pool *work = r->server->work;
    struct work_actor before = work_act(work, r->actor);
    take_steps(r); // may free r
    work_act(work, before);
}

// A draft of the bake under way answers in its place, where baked transport can.
static void choose_draft(struct render *r)
{
    struct model *draft = model_answering(r->model);
    if (draft == r->model || render_uses_screen(r)) return;
    model_hold(r->bakes = r->model);
    r->model = draft;
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
    r->spec = *spec;
    choose_draft(r);
    model_hold(r->model);
    spec->texels = NULL;
    spec->pose = NULL;
    spec->objects = NULL;
    if (r->spec.refinement) r->spec.refinement->refs++;
    r->done = done;
    r->user = user;
    r->start_ns = loop_now_ns();
    r->actor = work_actor(r->server->work);
    r->actor.begun_ns = r->start_ns;
    render_count(r);
    bool ended = false;
    r->ended = &ended;
    walk(r);
    if (ended) return NULL;
    r->ended = NULL;
    return r;
}

// Stops waiting for what is pending; entries that nobody else waits for leave their queues.
static void leave(struct render *r, struct dependency *dependency)
{
    if (!dependency->waits || dependency->entry->state != CACHE_PENDING) return;
    dependency->waits = false;
    r->n_waiting--;
    cache_leave(dependency->entry, &dependency->waiter);
}

static void leave_all(struct render *r)
{
    struct dependency *one[] = {&r->file,     &r->shape,      &r->media,  &r->visibility,
                                &r->specular, &r->background, &r->map[0], &r->map[1],
                                &r->map[2],   &r->encoded,    &r->floor,  &r->coarse};
    if (r->fading) {
        render_cancel(r->fading);
        r->fading = NULL;
        r->n_waiting--;
    }
    for (size_t i = 0; i < sizeof one / sizeof *one; i++) leave(r, one[i]);
    for (unsigned i = 0; i < RENDER_MAX_LIGHTS; i++) {
        leave(r, &r->env[i]);
        leave(r, &r->light[i]);
        leave(r, &r->contracted_light[i]);
        leave(r, &r->vertex_values[i]);
    }
}

void render_cancel(struct render *r)
{
    __atomic_store_n(&r->done, NULL, __ATOMIC_RELAXED);
    struct cache_entry *e = r->screen_radiance.entry;
    if (e && e->state == CACHE_PENDING) { // may end the evaluation
        screen_radiance_unwant(r->shape.entry, e);
        return;
    }
    if (r->walking && !r->finishing) return;
    if (r->finishing) { // otherwise finish_done follows
        if (work_withdraw(&r->work))
            render_end_with_error(r, RELIGHT__ERROR_CODE__ERROR_CANCELLED, "cancelled");
        return;
    }
    r->walking = true;
    leave_all(r);
    r->walking = false;
    // What has just been filled still wakes it.
    if (!r->n_waiting)
        render_end_with_error(r, RELIGHT__ERROR_CODE__ERROR_CANCELLED, "cancelled");
}
