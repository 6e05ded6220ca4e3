// SPDX-License-Identifier: MIT
// COLORS, IMAGE and ENV: a request's message becomes a spec, its evaluation an answer.
#include "net/dispatch.h"
#include "store/models.h"
#include "render/render.h"
#include "net/request_wait.h"
#include "prt/picture.h"
#include "prt/picture.h"

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct evaluation {
    struct request *request;
    struct render *render;
    struct render_spec spec; // for the answer's message; without what `render` owns
};

static void abandon(struct request *request)
{
    struct evaluation *e = request->state;
    if (e->render) render_cancel(e->render);
    free(e);
}

static void evaluated(void *user, struct render_result *result)
{
    struct evaluation *e = user;
    struct request *request = e->request;
    request->abandon = NULL;
    if (result->code) {
        request_fail(request, result->code, "%s", result->error);
        free(result->outgoing);
        free(e);
        return;
    }
    Relight__Cost cost;
    render_cost_message(result, &cost);
    stats_work(&request->server->stats, request->type, (double)cost.queue_ms * 1e-3,
               (double)(cost.total_ms - cost.queue_ms) * 1e-3);
    if (e->spec.picture) {
        Relight__ImageAnswer out;
        struct render_camera_message camera;
        render_image_message(result, &e->spec, &out, &camera);
        out.cost = &cost;
        request_answer(request, &out.base, &result->payload);
    } else {
        Relight__ColorsAnswer out;
        struct render_coefficients_message coefficients;
        render_colors_message(result, &e->spec, &out, &coefficients);
        out.cost = &cost;
        request_answer(request, &out.base, &result->payload);
    }
    free(result->outgoing);
    free(e);
}

// Refuses what would be answered after its deadline: work on it would be in vain, and those
// that wait already would be late, too.
static bool in_time(struct request *request, const struct model *model,
                    const struct render_spec *spec)
{
    if (!request->deadline.armed) return true;
    const uint64_t now = loop_now_ns(), at = request->deadline.at_ns;
    const double left_ns = at > now ? (double)(at - now) : 0;
    request->retry_ms = render_retry_ms(model, spec, left_ns);
    if (request->retry_ms) request->server->stats.late_refused_total++;
    return !request->retry_ms;
}

static void start(struct request *request, const char *name, const char *pose,
                  struct render_spec *spec)
{
    char error[300];
    struct model *model =
        models_find(request->server->models, request->conn->caller.name, name, error);
    int code = model ? render_spec_pose(spec, model, pose, error)
                     : RELIGHT__ERROR_CODE__ERROR_NOT_FOUND;
    if (!code && !in_time(request, model, spec)) {
        code = RELIGHT__ERROR_CODE__ERROR_BUSY;
        snprintf(error, sizeof error,
                 "requests wait, and this one would be answered after its deadline");
    }
    struct evaluation *e = code ? NULL : calloc(1, sizeof *e);
    if (!e) {
        render_spec_finish(spec);
        request_fail(request, code ? code : RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "%s",
                     code ? error : "not enough memory");
        return;
    }
    e->request = request;
    e->spec = render_spec_plain(spec);
    request->state = e;
    request->abandon = abandon;
    struct render *render = render_start(model, spec, evaluated, e);
    if (render) e->render = render; // NULL: it was answered already
}

void op_colors(struct request *request)
{
    const Relight__ColorsRequest *in = (const Relight__ColorsRequest *)request->message;
    struct render_spec spec;
    char error[300];
    int code;
    render_spec_init(&spec);
    if ((code = render_spec_lights(&spec, in->n_lights, in->lights, request, error)) ||
        (code = render_spec_shade(&spec, request, in->shade, error)) ||
        (code = render_spec_colors(&spec, (int)in->format, in->exposure_ev, in->most_rank,
                                   in->phases, in->exits, error))) {
        render_spec_finish(&spec);
        request_fail(request, code, "%s", error);
        return;
    }
    spec.sum = in->sum;
    start(request, in->model, in->pose, &spec);
}

void op_image(struct request *request)
{
    const Relight__ImageRequest *in = (const Relight__ImageRequest *)request->message;
    struct render_spec spec;
    char error[300];
    int code;
    render_spec_init(&spec);
    if ((code = render_spec_lights(&spec, in->n_lights, in->lights, request, error)) ||
        (code = render_spec_shade(&spec, request, in->shade, error)) ||
        (code = render_spec_picture(&spec, request->server, in->picture, error)) ||
        (code = render_spec_alpha(&spec, error))) {
        render_spec_finish(&spec);
        request_fail(request, code, "%s", error);
        return;
    }
    start(request, in->model, in->pose, &spec);
}

// ---- ENV: decode ahead of use

struct env_job {
    struct request_wait wait; // for the image, then for its mean
    char env[96];
    bool was_ready;
    float mean[3];
    uint32_t cube_n;    // of the texels that the client wants; 0: none
    uint32_t *texel;    // RGB9E5 [6][cube_n][cube_n]
    uint32_t thumbnail; // its width; 0: none
    struct prt_blob jpeg;
};

static void end_env_job(struct env_job *job)
{
    cache_release(job->wait.entry);
    free(job->texel);
    prt_free(job->jpeg.bytes);
    free(job);
}

// The environment as a cube in the payload's encoding.
static int encode_cube(struct env_job *job, const struct decoded_env *d,
                       const struct prt_context *ctx)
{
    struct prt_cube cube;
    size_t n = (size_t)6 * job->cube_n * job->cube_n;
    int status = prt_env_to_cube(ctx, &d->env, job->cube_n, 0, &cube);
    if (status) return status;
    job->texel = malloc(n * sizeof *job->texel);
    if (job->texel) prt_encode_rgb9e5(ctx, cube.texel, n, job->texel);
    prt_cube_finish(&cube);
    return job->texel ? PRT_OK : PRT_NOMEM;
}

// A lat-long picture whose mean luminance becomes a middle grey.
static int encode_thumbnail(struct env_job *job, const struct decoded_env *d,
                            const struct prt_context *ctx)
{
    const float *m = job->mean, luminance = 0.2126f * m[0] + 0.7152f * m[1] + 0.0722f * m[2];
    struct prt_picture_options options = {.tone = PRT_TONE_FILMIC, .quality = 85};
    struct prt_cube cube;
    struct prt_image image = {0};
    uint32_t n = 16;
    while (n < 256 && 4 * n < job->thumbnail) n *= 2;
    if (luminance > 1e-9f)
        options.exposure_ev = fminf(20, fmaxf(-20, log2f(0.25f / luminance)));
    int status = prt_env_to_cube(ctx, &d->env, n, 0, &cube);
    if (status) return status;
    status = prt_cube_to_latlong(ctx, &cube, job->thumbnail, job->thumbnail / 2, &image);
    if (!status)
        status =
            prt_picture_encode(ctx, prt_picture_format(".jpg"), &image, &options, &job->jpeg);
    prt_image_finish(&image);
    prt_cube_finish(&cube);
    return status;
}

static int run_mean(struct work *work, const struct prt_context *ctx)
{
    struct env_job *job = (struct env_job *)work;
    const struct decoded_env *d = job->wait.entry->value;
    struct prt_cube cube;
    double sum[3] = {0}, weight = 0;
    enum { N = 16 };
    int status = prt_env_to_cube(ctx, &d->env, N, 0, &cube);
    if (status) return status;
    for (uint32_t i = 0; i < 6 * N * N; i++) {
        double w = prt_cube_solid_angle(N, i % N, i / N % N);
        weight += w;
        for (uint32_t c = 0; c < 3; c++) sum[c] += w * (double)cube.texel[3 * i + c];
    }
    for (int c = 0; c < 3; c++) job->mean[c] = (float)(sum[c] / weight);
    prt_cube_finish(&cube);
    if (job->thumbnail) return encode_thumbnail(job, d, ctx);
    return job->cube_n ? encode_cube(job, d, ctx) : PRT_OK;
}

static void mean_known(struct request_wait *wait, struct request *request)
{
    struct env_job *job = (struct env_job *)wait;
    const struct decoded_env *d = wait->entry->value;
    if (request && wait->work.status) {
        request_fail(request, error_of_status(wait->work.status), "%s", wait->work.error);
    } else if (request) {
        Relight__EnvAnswer out = RELIGHT__ENV_ANSWER__INIT;
        Relight__Vec3 mean = RELIGHT__VEC3__INIT;
        out.env = job->env;
        out.cube = d->env.kind == PRT_ENV_CUBE;
        out.width = out.cube ? d->env.cube.n : d->env.latlong.width;
        out.height = out.cube ? d->env.cube.n : d->env.latlong.height;
        out.full_cube = prt_env_full_cube(&d->env);
        out.n_mended = d->env.n_negative + d->env.n_nonfinite;
        out.decode_ms = job->was_ready ? 0 : d->decode_ms;
        mean.x = job->mean[0];
        mean.y = job->mean[1];
        mean.z = job->mean[2];
        out.mean = &mean;
        out.cube_n = job->cube_n;
        struct payload texels = {job->texel, (size_t)24 * job->cube_n * job->cube_n, job->texel,
                                 free};
        struct payload jpeg = {job->jpeg.bytes, job->jpeg.size, job->jpeg.bytes, prt_free};
        job->texel = NULL;
        job->jpeg.bytes = NULL;
        request_answer(request, &out.base, jpeg.bytes ? &jpeg : out.cube_n ? &texels : NULL);
    }
    end_env_job(job);
}

static void env_ready(struct request_wait *wait, struct request *request)
{
    struct env_job *job = (struct env_job *)wait;
    if (request && wait->entry->state == CACHE_READY) {
        request_await_work(request, wait, run_mean, mean_known);
        return;
    }
    if (request) request_fail(request, wait->entry->error_code, "%s", wait->entry->error);
    end_env_job(job);
}

void op_env(struct request *request)
{
    const Relight__EnvRequest *in = (const Relight__EnvRequest *)request->message;
    char error[300], env[96];
    if (in->cube_n && (in->cube_n < 16 || in->cube_n > 256 || in->cube_n & (in->cube_n - 1))) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "cube_n %u is not 16, 32, 64, 128 or 256", in->cube_n);
        return;
    }
    if (in->thumbnail &&
        (in->thumbnail < 32 || in->thumbnail > 1024 || in->thumbnail % 2 || in->cube_n)) {
        request_fail(request, RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE,
                     "thumbnail %u is not an even width of 32 to 1024, without cube_n",
                     in->thumbnail);
        return;
    }
    struct env_job *job = calloc(1, sizeof *job);
    int code = job ? env_of_request(request, in->env, env, error)
                   : RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    struct cache_entry *entry = NULL;
    if (job && !code) entry = env_get(request->server, env, &code, error);
    if (!job || !entry) {
        request_fail(request, code, "%s", job ? error : "not enough memory");
        free(job);
        return;
    }
    snprintf(job->env, sizeof job->env, "%s", env);
    job->cube_n = in->cube_n;
    job->thumbnail = in->thumbnail;
    job->was_ready = entry->state == CACHE_READY;
    request_await_entry(request, &job->wait, entry, env_ready);
}
