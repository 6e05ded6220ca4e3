// SPDX-License-Identifier: MIT
// The ratio of walks to the dipole by which previews are scaled: computed once for a model and
// its media, on the thread for work aside. Pictures do not wait for it.
#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

struct ratio_job {
    struct cache_job job;
    struct model *model; // held
    struct cache_entry *shape, *media;
};

static void destroy(void *value)
{
    struct walk_ratio *w = value;
    prt_walk_ratio_destroy(w->ratio);
    free(w);
}

// Nobody waits for the result: it ends with the model and with the daemon.
static int is_unwanted(void *user, const char *stage, double fraction, double eta_s)
{
    const struct ratio_job *own = user;
    return __atomic_load_n(&own->model->server->draining, __ATOMIC_RELAXED) ||
           __atomic_load_n(&own->model->gone, __ATOMIC_RELAXED);
}

static int run(struct cache_job *job, const struct prt_context *shared)
{
    struct ratio_job *own = (struct ratio_job *)job;
    struct shape *shape = own->shape->value;
    struct prt_context ctx = *shared;
    const struct prt_scene *scene;
    struct walk_ratio *w = job->value = calloc(1, sizeof *w);
    if (!w) return PRT_NOMEM;
    ctx.progress = is_unwanted;
    ctx.progress_user = own;
    int status = shape_scene(&ctx, shape, &scene);
    if (!status)
        status =
            prt_walk_ratio_create(&ctx, scene, own->media ? own->media->value : shape->media, 0,
                                  0, &w->ratio, &w->report);
    if (!status) job->bytes = sizeof *w + prt_walk_ratio_bytes(w->ratio);
    return status;
}

// Views draw their picture again.
static void done(struct cache_job *job)
{
    struct ratio_job *own = (struct ratio_job *)job;
    struct shape *shape = own->shape->value;
    shape->ratio_runs = false;
    shape->ratio_failed |= job->status && job->status != PRT_CANCELLED;
    if (!job->status) {
        cache_release(shape->ratio);
        cache_hold(shape->ratio = job->entry);
        model_wake(own->model);
    }
    model_release(own->model);
}

static const struct cache_job_kind kind = {.size = sizeof(struct ratio_job),
                                           .class = WORK_ASIDE,
                                           .run = run,
                                           .destroy = destroy,
                                           .done = done,
                                           .unwanted = cache_job_goes_on};

static void start(struct model *model, const char *key, struct cache_entry *shape,
                  struct cache_entry *media)
{
    struct cache_job *job;
    struct cache_entry *entry = cache_compute(model->server, key, &kind, &job);
    cache_release(entry); // the job holds it
    if (!job) return;
    struct ratio_job *own = (struct ratio_job *)job;
    own->model = model;
    model_hold(model);
    own->shape = shape;
    own->media = media;
    ((struct shape *)shape->value)->ratio_runs = true;
    cache_job_hold(job, shape);
    cache_job_hold(job, media);
    cache_job_submit(job);
}

struct cache_entry *walk_ratio_get(struct model *model, const struct render_spec *spec,
                                   struct cache_entry *shape, struct cache_entry *media,
                                   bool *other)
{
    struct shape *s = shape->value;
    char key[MEDIA_KEY + VARIANT_NAME + 120], own[MEDIA_KEY];
    if (!model->server->options.preview_walks || model->gone) return NULL;
    media_key(spec, own);
    // Triangles and media, whatever the vertices: those that moved keep their ratio.
    snprintf(key, sizeof key, "%s/ratio/%llx/%s/%s", model->key,
             (unsigned long long)prt_file_hash(s->file->value), spec->variant, own);
    struct cache_entry *entry = cache_find(model->server->cache, key);
    if (entry && entry->state == CACHE_READY) return entry;
    if (!entry && !s->ratio_runs && !s->ratio_failed) start(model, key, shape, media);
    cache_release(entry);
    *other = s->ratio != NULL;
    if (s->ratio) cache_hold(s->ratio);
    return s->ratio;
}
