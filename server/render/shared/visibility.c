// SPDX-License-Identifier: MIT
// Visibility buffers: one for each model, camera and size, whatever light falls on it.
#include "render/evaluation.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { LARGE_PICTURE = 4 << 20 }; // pixels

struct seeing {
    struct work work;
    struct cache_entry *entry, *owner;
    const struct prt_mesh *mesh;
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
    int status = prt_visibility_create(ctx, s->mesh, &s->camera, s->width, s->height,
                                       s->samples, PRT_RASTER_AUTO, &s->visibility);
    s->ms = (float)((prt_time_s() - start) * 1e3);
    return status;
}

static void done_seeing(struct work *work)
{
    struct seeing *s = (struct seeing *)work;
    s->entry->ms = s->ms;
    if (work->status) cache_fail(s->entry, error_of_status(work->status), work->error);
    else
        cache_fill(s->entry, s->visibility, prt_visibility_bytes(s->visibility),
                   destroy_visibility);
    cache_release(s->entry);
    cache_release(s->owner);
    free(s);
}

void camera_choose(struct model *model, uint64_t generation, const struct render_spec *s,
                   const struct prt_mesh *mesh, struct prt_camera *out)
{
    float aspect = (float)s->width / (float)s->height;
    // Framing looks at every vertex, and this is the loop's thread.
    if (model->frame_generation != generation || model->frame_aspect != aspect) {
        prt_camera_frame(mesh, aspect, &model->frame);
        model->frame_generation = generation;
        model->frame_aspect = aspect;
    }
    *out = model->frame;
    out->automatic = false;
    if (!s->has_camera) return;
    memcpy(out->eye, s->camera_eye, sizeof out->eye);
    memcpy(out->target, s->camera_target, sizeof out->target);
    memcpy(out->up, s->camera_up, sizeof out->up);
    if (s->fovy_deg > 0) out->fovy_deg = s->fovy_deg;
}

enum work_class picture_class(const struct render_spec *s)
{
    return (uint64_t)s->width * s->height > LARGE_PICTURE ? WORK_BACKGROUND : WORK_INTERACTIVE;
}

struct cache_entry *visibility_get(struct model *model, uint64_t generation,
                                   struct cache_entry *owner, const struct prt_mesh *mesh,
                                   const struct render_spec *s, const struct prt_camera *c)
{
    char key[400];
    bool fresh;
    snprintf(key, sizeof key,
             "%s/%llu/seen/%ux%u/%u/%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g,%.9g,%.9g:%.9g",
             model->key, (unsigned long long)generation, s->width, s->height, s->samples,
             (double)c->eye[0], (double)c->eye[1], (double)c->eye[2], (double)c->target[0],
             (double)c->target[1], (double)c->target[2], (double)c->up[0], (double)c->up[1],
             (double)c->up[2], (double)c->fovy_deg);
    struct cache_entry *entry = cache_get(model->server->cache, key, &fresh);
    if (!fresh) return entry;
    struct seeing *seeing = calloc(1, sizeof *seeing);
    if (!seeing) {
        cache_fail(entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        return entry;
    }
    *seeing = (struct seeing){.entry = entry,
                              .owner = owner,
                              .mesh = mesh,
                              .camera = *c,
                              .width = s->width,
                              .height = s->height,
                              .samples = s->samples};
    cache_hold(entry);
    cache_hold(seeing->owner);
    seeing->work.run = run_seeing;
    seeing->work.done = done_seeing;
    seeing->work.class = picture_class(s);
    work_submit(model->server->work, &seeing->work);
    return entry;
}
