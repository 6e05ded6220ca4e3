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
    struct prt_camera camera; // automatic: where the orbit places it
    struct prt_orbit orbit;
    bool has_orbit;
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
    if (v->camera.automatic) { // which reads every vertex
        float aspect = (float)v->width / (float)v->height;
        if (v->has_orbit) prt_camera_frame_from(v->mesh, aspect, &v->orbit, &v->camera);
        else prt_camera_frame(v->mesh, aspect, &v->camera);
        v->camera.automatic = false;
    }
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

int camera_choose(const struct render_spec *s, const struct prt_mesh *mesh,
                  struct prt_camera *out, char error[300])
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    ctx.log = keep_error, ctx.log_user = error;
    if (s->camera_name[0])
        return prt_camera_named(&ctx, mesh, s->camera_name, out)
                   ? RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE
                   : 0;
    *out = (struct prt_camera){.automatic = !s->has_camera || s->has_orbit};
    if (out->automatic) return 0;
    out->fovy_deg = s->fovy_deg > 0 ? s->fovy_deg : FOVY_DEG;
    memcpy(out->eye, s->camera_eye, sizeof out->eye);
    memcpy(out->target, s->camera_target, sizeof out->target);
    memcpy(out->up, s->camera_up, sizeof out->up);
    return 0;
}

enum work_class picture_class(const struct render_spec *s)
{
    return (uint64_t)s->width * s->height > LARGE_PICTURE ? WORK_BACKGROUND : WORK_INTERACTIVE;
}

// The camera's numbers, or what places it: with size and variant, that decides the picture.
static void camera_key(const struct render_spec *s, const struct prt_camera *c, char key[256])
{
    if (c->automatic && s->has_orbit)
        snprintf(key, 256, "orbit:%.9g,%.9g,%.9g", (double)s->orbit.azimuth_deg,
                 (double)s->orbit.elevation_deg, (double)s->orbit.zoom);
    else if (c->automatic) snprintf(key, 256, "all");
    else
        snprintf(key, 256, "%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g",
                 (double)c->eye[0], (double)c->eye[1], (double)c->eye[2], (double)c->target[0],
                 (double)c->target[1], (double)c->target[2], (double)c->up[0], (double)c->up[1],
                 (double)c->up[2], (double)c->fovy_deg);
}

struct cache_entry *visibility_get(struct model *model, uint64_t generation,
                                   struct cache_entry *owner, const struct prt_mesh *mesh,
                                   const struct render_spec *s, const struct prt_camera *c)
{
    char camera[256], key[400 + VARIANT_NAME];
    camera_key(s, c, camera);
    snprintf(key, sizeof key, "%s/%llu/seen/%s/%ux%u/%u/%s", model->key,
             (unsigned long long)generation, s->variant, s->width, s->height, s->samples,
             camera);
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    if (!job) return entry;
    struct visibility_job *v = (struct visibility_job *)job;
    v->mesh = mesh;
    v->camera = *c;
    v->orbit = s->orbit;
    v->has_orbit = s->has_orbit;
    v->width = s->width;
    v->height = s->height;
    v->samples = s->samples;
    job->work.class = picture_class(s);
    cache_job_hold(job, owner);
    cache_job_submit(job);
    return entry;
}
