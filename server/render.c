// SPDX-License-Identifier: MIT
// One evaluation as a walk over what it needs. Each step asks the memo for its results; where
// some are pending the walk stops and is resumed by the last of them. The final step, which
// belongs to this evaluation alone (colour encoding; shading, tone map, image file), runs on a
// worker.
#include "render.h"

#include "log.h"
#include "request.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum {
    MAX_NEEDS = 2 * RENDER_MAX_LIGHTS + 4,
    SPECULAR_CUBE = 32,   // what the specular pre-filter reads
    BACKGROUND_CUBE = 256,
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

// ---- lights: the cubes of several environments, turned, weighted and summed

struct summand {
    const struct prt_env *env;
    struct prt_cube texels; // of an inline cube
    double rotate_deg;
    float gain[3];
};
struct lighting {
    struct work work;
    struct memo_entry *entry;
    struct memo_entry *env[RENDER_MAX_LIGHTS];
    unsigned n;
    struct summand part[RENDER_MAX_LIGHTS];
    float *texels;
    uint32_t cube_n;
    struct prt_cube *cube;
    float ms;
};

static void destroy_cube(void *value)
{
    prt_cube_finish(value);
    free(value);
}

static int add_summand(const struct prt_context *ctx, const struct lighting *l,
                       const struct summand *s, bool first)
{
    struct prt_cube cube = {0};
    struct prt_env inline_env = {.kind = PRT_ENV_CUBE, .cube = s->texels};
    const struct prt_env *env = s->env ? s->env : &inline_env;
    bool as_it_is = !s->env && s->texels.n == l->cube_n && s->rotate_deg == 0;
    int status = as_it_is ? PRT_OK
                          : prt_env_to_cube(ctx, env, l->cube_n, s->rotate_deg, &cube);
    if (status) return status;
    const float *from = as_it_is ? s->texels.texel : cube.texel;
    size_t n = (size_t)6 * l->cube_n * l->cube_n;
    for (size_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) {
            float x = from[3 * i + (size_t)c] * s->gain[c];
            float *to = &l->cube->texel[3 * i + (size_t)c];
            *to = first ? x : *to + x;
        }
    prt_cube_finish(&cube);
    return PRT_OK;
}

static int run_lighting(struct work *work, const struct prt_context *ctx)
{
    struct lighting *l = (struct lighting *)work;
    double start = prt_time_s();
    l->cube = calloc(1, sizeof *l->cube);
    int status = l->cube ? prt_cube_init(l->cube, l->cube_n) : PRT_NOMEM;
    for (unsigned i = 0; !status && i < l->n; i++)
        status = add_summand(ctx, l, &l->part[i], i == 0);
    l->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_lighting(struct work *work)
{
    struct lighting *l = (struct lighting *)work;
    l->entry->ms = l->ms;
    if (work->status) {
        if (l->cube) destroy_cube(l->cube);
        memo_fail(l->entry, error_of_status(work->status), work->error);
    } else {
        memo_fill(l->entry, l->cube, (size_t)72 * l->cube_n * l->cube_n, destroy_cube);
    }
    for (unsigned i = 0; i < l->n; i++) memo_release(l->env[i]);
    memo_release(l->entry);
    free(l->texels);
    free(l);
}

// The cube of lights [first, first + n) at cube_n, as they are turned or unturned; the
// environments are decoded already.
static struct memo_entry *light_get(struct server *server, const struct render_spec *spec,
                                    const struct need env[], unsigned first, unsigned n,
                                    uint32_t cube_n, bool turned)
{
    char key[RENDER_MAX_LIGHTS * sizeof spec->light->key + 64];
    size_t at = (size_t)snprintf(key, sizeof key, "light/%u", cube_n);
    for (unsigned i = first; i < first + n; i++)
        at += (size_t)snprintf(key + at, sizeof key - at, "+%s",
                               turned ? spec->light[i].key : spec->light[i].still_key);
    bool fresh;
    struct memo_entry *entry = memo_get(server->memo, key, &fresh);
    if (!fresh) return entry;
    struct lighting *l = calloc(1, sizeof *l);
    size_t floats = 0;
    for (unsigned i = first; i < first + n; i++)
        floats += (size_t)18 * spec->light[i].cube_n * spec->light[i].cube_n;
    if (!l || (floats && !(l->texels = malloc(floats * sizeof(float))))) {
        free(l);
        memo_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    size_t put = 0;
    for (unsigned i = 0; i < n; i++) {
        const struct render_light *light = &spec->light[first + i];
        struct summand *s = &l->part[i];
        s->rotate_deg = turned ? light->rotate_deg : 0;
        memcpy(s->gain, light->gain, sizeof s->gain);
        if (light->cube_n) {
            size_t m = (size_t)18 * light->cube_n * light->cube_n;
            memcpy(l->texels + put, spec->texels + light->texel, m * sizeof(float));
            s->texels = (struct prt_cube){light->cube_n, l->texels + put};
            put += m;
        } else {
            l->env[i] = env[first + i].entry;
            memo_hold(l->env[i]);
            s->env = &((struct decoded_env *)l->env[i]->value)->env;
        }
    }
    l->n = n;
    l->cube_n = cube_n;
    l->entry = entry;
    memo_hold(entry);
    l->work.run = run_lighting;
    l->work.done = done_lighting;
    work_submit(server->work, &l->work);
    return entry;
}

static struct memo_entry *sky_get(struct server *server, const struct render_spec *spec,
                                  const struct need env[])
{
    uint32_t n = spec->light[0].cube_n;
    if (!n) n = prt_env_full_cube(&((struct decoded_env *)env[0].entry->value)->env);
    return light_get(server, spec, env, 0, 1, n < BACKGROUND_CUBE ? n : BACKGROUND_CUBE, false);
}

struct prefetch {
    struct memo_waiter waiter;
    struct server *server;
    struct memo_entry *entry;
    char env[96];
};

static void prefetched(struct memo_waiter *waiter)
{
    struct prefetch *p = (struct prefetch *)waiter;
    struct render_spec spec = {.n_light = 1, .light[0] = {.gain = {1, 1, 1}}};
    if (p->entry->state == MEMO_READY) {
        struct need env = {.entry = p->entry};
        snprintf(spec.light[0].env, sizeof spec.light[0].env, "%s", p->env);
        render_light_name(&spec.light[0], NULL);
        memo_release(sky_get(p->server, &spec, &env));
    }
    memo_release(p->entry);
    free(p);
}

void env_prefetch(struct server *server, const char *hash)
{
    struct prefetch *p = calloc(1, sizeof *p);
    int code;
    char error[300];
    if (!p) return;
    snprintf(p->env, sizeof p->env, "env:%s", hash);
    p->server = server;
    p->waiter.wake = prefetched;
    p->entry = env_get(server, p->env, &code, error);
    if (p->entry && p->entry->state == MEMO_PENDING) memo_wait(p->entry, &p->waiter);
    else if (p->entry) prefetched(&p->waiter);
    else free(p);
}

// ---- visibility

struct seeing {
    struct work work;
    struct memo_entry *entry, *file;
    struct prt_camera camera;
    uint32_t width, height, samples;
    struct prt_visibility *visibility;
    float ms;
};

static void destroy_visibility(void *value)
{
    prt_visibility_destroy(value);
}

static int run_seeing(struct work *work, const struct prt_context *ctx)
{
    struct seeing *s = (struct seeing *)work;
    double start = prt_time_s();
    const struct prt_transport *t = prt_file_transport(s->file->value);
    int status = prt_visibility_create(ctx, &t->mesh, &s->camera, s->width, s->height, s->samples,
                                       PRT_RASTER_AUTO, &s->visibility);
    s->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_seeing(struct work *work)
{
    struct seeing *s = (struct seeing *)work;
    s->entry->ms = s->ms;
    if (work->status)
        memo_fail(s->entry, error_of_status(work->status), work->error);
    else
        memo_fill(s->entry, s->visibility, prt_visibility_bytes(s->visibility),
                  destroy_visibility);
    memo_release(s->entry);
    memo_release(s->file);
    free(s);
}

static void choose_camera(struct render *r)
{
    const struct render_spec *s = &r->spec;
    const struct prt_mesh *mesh = &transport_of(r)->mesh;
    prt_camera_frame(mesh, (float)s->width / (float)s->height, &r->camera);
    r->camera.automatic = false;
    if (!s->has_camera) return;
    memcpy(r->camera.eye, s->camera_eye, sizeof r->camera.eye);
    memcpy(r->camera.target, s->camera_target, sizeof r->camera.target);
    memcpy(r->camera.up, s->camera_up, sizeof r->camera.up);
    if (s->fovy_deg > 0) r->camera.fovy_deg = s->fovy_deg;
}

static struct memo_entry *visibility_get(struct render *r)
{
    const struct render_spec *s = &r->spec;
    const struct prt_camera *c = &r->camera;
    char key[400];
    bool fresh;
    snprintf(key, sizeof key,
             "%s/%llu/seen/%ux%u/%u/%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g",
             r->model->id, (unsigned long long)r->model->generation, s->width, s->height,
             s->samples, (double)c->eye[0], (double)c->eye[1], (double)c->eye[2],
             (double)c->target[0], (double)c->target[1], (double)c->target[2], (double)c->up[0],
             (double)c->up[1], (double)c->up[2], (double)c->fovy_deg);
    struct memo_entry *entry = memo_get(r->server->memo, key, &fresh);
    if (!fresh) return entry;
    struct seeing *seeing = calloc(1, sizeof *seeing);
    if (!seeing) {
        memo_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    *seeing = (struct seeing){.entry = entry, .file = r->file.entry, .camera = *c,
                              .width = s->width, .height = s->height, .samples = s->samples};
    memo_hold(entry);
    memo_hold(seeing->file);
    seeing->work.run = run_seeing;
    seeing->work.done = done_seeing;
    work_submit(r->server->work, &seeing->work);
    return entry;
}

// ---- the final step

static float srgb(float x)
{
    if (!(x > 0)) return 0;
    if (x >= 1) return 255;
    x = x <= 0.0031308f ? 12.92f * x : 1.055f * powf(x, 1 / 2.4f) - 0.055f;
    return x * 255 + 0.5f;
}

static uint32_t rgb9e5(const float c[3])
{
    // EXT_texture_shared_exponent: 9 bits of mantissa, exponent bias 15
    const float top = 65408;
    float v[3], high = 0;
    for (int i = 0; i < 3; i++) {
        v[i] = c[i] > 0 ? fminf(c[i], top) : 0;
        high = fmaxf(high, v[i]);
    }
    int e;
    frexpf(high, &e); // high = m 2^e, m in [0.5, 1)
    int exponent = (e > -15 ? e : -15) + 15;
    if ((int)floorf(ldexpf(high, 15 + 9 - exponent) + 0.5f) == 512) exponent++;
    uint32_t out = (uint32_t)exponent << 27;
    for (int i = 0; i < 3; i++)
        out |= (uint32_t)floorf(ldexpf(v[i], 15 + 9 - exponent) + 0.5f) << 9 * i;
    return out;
}

static size_t color_bytes(int format)
{
    return format == RELIGHT__COLOR_FORMAT__COLOR_F32   ? 12
           : format == RELIGHT__COLOR_FORMAT__COLOR_F16 ? 6
                                                        : 4;
}

struct encoding {
    const float *from;
    uint8_t *to;
    int format;
    float scale;
};

static int encode_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct encoding *e = arg;
    for (size_t v = begin; v < end; v++) {
        const float *c = e->from + 3 * v;
        if (e->format == RELIGHT__COLOR_FORMAT__COLOR_RGB9E5) {
            ((uint32_t *)e->to)[v] = rgb9e5(c);
        } else {
            for (int i = 0; i < 3; i++) e->to[4 * v + (size_t)i] = (uint8_t)srgb(c[i] * e->scale);
            e->to[4 * v + 3] = 255;
        }
    }
    return PRT_OK;
}

static void encode_colors(const struct prt_context *ctx, const struct render_spec *spec,
                          const struct answer *answer, uint8_t *to)
{
    size_t n = (size_t)answer->n_vertex * 3;
    if (spec->format == RELIGHT__COLOR_FORMAT__COLOR_F32) {
        memcpy(to, answer->values, n * sizeof(float));
    } else if (spec->format == RELIGHT__COLOR_FORMAT__COLOR_F16) {
        prt_f32_to_f16_array(answer->values, n, (uint16_t *)to);
    } else {
        struct encoding e = {answer->values, to, spec->format, exp2f(spec->exposure_ev)};
        prt_parallel_for(ctx, NULL, answer->n_vertex, 4096, encode_range, &e);
    }
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

static int encode_image(struct render *r, const struct prt_context *ctx,
                        const struct prt_image *image)
{
    const struct render_spec *s = &r->spec;
    size_t n = (size_t)image->width * image->height;
    struct prt_blob blob = {0};
    int status = PRT_OK;
    if (s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_EXR
        || s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT) {
        status = prt_encode_exr(ctx, image, s->image_format
                                                == RELIGHT__IMAGE_FORMAT__IMAGE_EXR_FLOAT, &blob);
    } else if (s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_F16) {
        blob = (struct prt_blob){prt_alloc(n, 6), n * 6};
        if (!blob.bytes) return PRT_NOMEM;
        prt_f32_to_f16_array(image->rgb, n * 3, blob.bytes);
    } else {
        uint8_t *rgb8 = prt_alloc(n, 3);
        if (!rgb8) return PRT_NOMEM;
        status = prt_tone_map(ctx, image, (enum prt_tone)s->tone, s->picture_ev, rgb8);
        if (!status && s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_PNG)
            status = prt_encode_png(ctx, rgb8, image->width, image->height, 3, &blob);
        else if (!status && s->image_format == RELIGHT__IMAGE_FORMAT__IMAGE_JPEG)
            status = prt_encode_jpeg(ctx, rgb8, image->width, image->height, (int)s->quality,
                                     &blob);
        else if (!status) {
            blob = (struct prt_blob){rgb8, n * 3};
            rgb8 = NULL;
        }
        prt_free(rgb8);
    }
    if (!status) own_payload(r, blob.bytes, blob.size, prt_free);
    return status;
}

static int run_picture(struct render *r, const struct prt_context *ctx)
{
    const struct prt_transport *t = transport_of(r);
    const struct answer *a = r->answer[0].entry->value;
    const struct prt_cube *lobes = r->specular.entry ? r->specular.entry->value : NULL;
    struct prt_specular *specular = NULL;
    struct prt_image image = {0};
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
    if (!status) status = encode_image(r, ctx, &image);
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
    out->error_bound = error_bound(r);
    out->engine = RELIGHT__ENGINE__ENGINE_WAVELET + (int)t->engine;
    for (unsigned i = 0; i < s->n_light; i++)
        out->light_ms += cost_of(&r->env[i]) + cost_of(&r->light[i]);
    out->light_ms += cost_of(&r->specular) + cost_of(&r->background);
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
    r->work.class = WORK_INTERACTIVE;
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
    choose_camera(r);
    need_entry(r, &r->visibility, visibility_get(r));
}

static void ask_lights(struct render *r)
{
    uint32_t cube = transport_of(r)->cube;
    const struct render_spec *s = &r->spec;
    unsigned each = n_answer(s) == 1 ? s->n_light : 1;
    for (unsigned i = 0; i < n_answer(s) && !fixed_light(r); i++)
        need_entry(r, &r->light[i], light_get(r->server, s, r->env, i, each, cube, true));
    if (!s->picture) return;
    if (s->n_light && !s->no_specular && s->term == RELIGHT__TERM__TERM_TOTAL)
        need_entry(r, &r->specular, light_get(r->server, s, r->env, 0, s->n_light,
                                              SPECULAR_CUBE, true));
    if (s->n_light && !s->plain_background)
        need_entry(r, &r->background, sky_get(r->server, s, r->env));
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

// ---- messages

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
    cost->note = (char *)r->note;
}

void render_colors_message(const struct render_result *r, const struct render_spec *spec,
                           Relight__ColorsAnswer *out)
{
    relight__colors_answer__init(out);
    out->n_vertex = r->n_vertex;
    out->n_plane = r->n_plane;
    out->plane_bytes = r->plane_bytes;
    out->format = spec->format;
    out->generation = r->generation;
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
    out->generation = r->generation;
}
