// SPDX-License-Identifier: MIT
// Visibility buffers: one for each model, camera and size, independent of light and material.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include "relight.pb-c.h"

#include <stdio.h>
#include <string.h>

enum { LARGE_PICTURE = 4 << 20 }; // pixels; chosen, not measured
enum { FOVY_DEG = 36 };           // of a camera that names none, as of prt_camera_frame

struct visibility_job {
    struct cache_job job;
    const struct prt_mesh *mesh;
    struct prt_camera camera;
    uint32_t width, height, samples;
};

static void destroy(void *value)
{
    prt_visibility_destroy(value);
}

static int run(struct cache_job *job, const struct prt_context *ctx)
{
    struct visibility_job *v = (struct visibility_job *)job;
    struct prt_visibility *visibility = NULL;
    struct prt_raster raster = {v->width, v->height, v->samples, PRT_RASTER_AUTO};
    int status = prt_visibility_create(ctx, v->mesh, &v->camera, &raster, &visibility);
    if (status) return status;
    job->value = visibility;
    job->bytes = prt_visibility_bytes(visibility);
    return PRT_OK;
}

static const struct cache_job_kind kind = {
    .size = sizeof(struct visibility_job), .run = run, .destroy = destroy};

static void keep_error(void *user, enum prt_log_level level, const char *line)
{
    snprintf(user, 300, "%s", line);
}

int camera_choose(struct model *model, uint64_t generation, const struct render_spec *s,
                  const struct prt_mesh *mesh, struct prt_camera *out, char error[300])
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_error, ctx.log_user = error;
    if (s->camera_name[0])
        return prt_camera_named(&ctx, mesh, s->camera_name, out)
                   ? RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE
                   : 0;
    float aspect = (float)s->width / (float)s->height;
    if (s->has_camera && !s->has_orbit) {
        *out = (struct prt_camera){.fovy_deg = s->fovy_deg > 0 ? s->fovy_deg : FOVY_DEG};
        memcpy(out->eye, s->camera_eye, sizeof out->eye);
        memcpy(out->target, s->camera_target, sizeof out->target);
        memcpy(out->up, s->camera_up, sizeof out->up);
        return 0;
    }
    if (s->has_orbit) {
        prt_camera_frame_from(mesh, aspect, &s->orbit, out);
        return 0;
    }
    // Framing reads every vertex and runs on the loop's thread: it is done once a generation
    // and variant. The frame fits the translucent parts, which differ between variants.
    if (model->frame_generation != generation || model->frame_aspect != aspect ||
        strcmp(model->frame_variant, s->variant)) {
        prt_camera_frame(mesh, aspect, &model->frame);
        model->frame_generation = generation;
        memcpy(model->frame_variant, s->variant, sizeof model->frame_variant);
        model->frame_aspect = aspect;
    }
    *out = model->frame;
    out->automatic = false;
    return 0;
}

enum work_class picture_class(const struct render_spec *s)
{
    return (uint64_t)s->width * s->height > LARGE_PICTURE ? WORK_BACKGROUND : WORK_INTERACTIVE;
}

struct cache_entry *visibility_get(struct model *model, uint64_t generation,
                                   struct cache_entry *owner, const struct prt_mesh *mesh,
                                   const struct render_spec *s, const struct prt_camera *c)
{
    char key[400 + VARIANT_NAME];
    snprintf(key, sizeof key,
             "%s/%llu/seen/%s/%ux%u/%u/%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g",
             model->key, (unsigned long long)generation, s->variant, s->width, s->height,
             s->samples, (double)c->eye[0], (double)c->eye[1], (double)c->eye[2],
             (double)c->target[0], (double)c->target[1], (double)c->target[2], (double)c->up[0],
             (double)c->up[1], (double)c->up[2], (double)c->fovy_deg);
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    struct visibility_job *v = (struct visibility_job *)job;
    v->mesh = mesh;
    v->camera = *c;
    v->width = s->width;
    v->height = s->height;
    v->samples = s->samples;
    job->work.class = picture_class(s);
    cache_job_hold(job, owner);
    cache_job_submit(job);
    return entry;
}
