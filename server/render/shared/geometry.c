// SPDX-License-Identifier: MIT
// A model's geometry for image-space engines: the mesh of its file, or that mesh with vertices
// that a client moved.
#include "render/shared/geometry.h"

#include "render/evaluation.h"
#include "render/shared/cache_compute.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void pose_release(struct pose *pose)
{
    if (!pose || --pose->refs) return;
    prt_free(pose->position);
    prt_free(pose->normal);
    if (pose->principal) ledger_give(pose->principal, pose->resource, pose->charged);
    principal_release(pose->principal);
    free(pose);
}

static void destroy_shape(void *value)
{
    struct shape *s = value;
    for (int i = 0; i < SHAPE_SLOTS; i++) prt_screen_destroy(s->slot[i].screen);
    if (s->scene) prt_scene_destroy(s->scene);
    cache_release(s->ratio);
    pthread_mutex_destroy(&s->lock);
    prt_free(s->normal);
    prt_variant_destroy(s->variant);
    pose_release(s->pose);
    cache_release(s->file);
    free(s);
}

// Mesh, scene and the engines' samples; an estimate.
static size_t shape_bytes(const struct shape *s)
{
    return sizeof *s + (size_t)s->mesh.n_vertex * 24 + (size_t)s->mesh.n_triangle * 150 +
           (8 << 20);
}

struct shape_job {
    struct cache_job job;
    struct model *model;
    uint64_t generation;
    struct cache_entry *file;
    struct pose *pose;
    char variant[VARIANT_NAME]; // "": none
};

// Copies the normals that were given, and computes the others.
static int run_normals(struct cache_job *job, const struct prt_context *ctx)
{
    struct shape *s = job->value;
    memcpy(s->normal, s->pose->normal, (size_t)s->pose->n * sizeof *s->normal);
    return prt_mesh_normals(ctx, &s->mesh);
}

static void shape_done(struct cache_job *job)
{
    struct shape_job *own = (struct shape_job *)job;
    pose_release(own->pose);
    model_release(own->model);
}

static const struct cache_job_kind kind = {.size = sizeof(struct shape_job),
                                           .run = run_normals,
                                           .destroy = destroy_shape,
                                           .done = shape_done};

// A shape of the file's mesh; NULL without memory.
static struct shape *create_shape(struct cache_entry *file)
{
    struct shape *s = calloc(1, sizeof *s);
    if (!s) return NULL;
    const struct prt_transport *t = prt_file_transport(file->value);
    pthread_mutex_init(&s->lock, NULL);
    for (int i = 0; i < SHAPE_SLOTS; i++) s->slot[i].last = &s->slot[i].first;
    s->file = file;
    cache_hold(s->file);
    s->mesh = t->mesh;
    s->media = &t->media;
    return s;
}

static bool set_pose(struct shape *s, struct pose *pose)
{
    s->normal = prt_alloc(pose->n, sizeof *s->normal);
    if (!s->normal) return false;
    s->pose = pose;
    s->pose->refs++;
    s->mesh.position = s->pose->position;
    s->mesh.model = NULL; // the file's
    s->mesh.normal = s->normal;
    return true;
}

static int set_variant(struct shape *s, const struct shape_job *own, char error[300])
{
    if (!own->variant[0]) return PRT_OK;
    const struct prt_context ctx = {.log = variant_keep_error, .log_user = error};
    int status = prt_variant_create(&ctx, own->model->name, &s->mesh, s->media,
                                    PRT_VARIANT_OF_MODEL, own->variant, &s->variant);
    if (status) return status;
    s->mesh = s->variant->mesh;
    s->media = s->variant->media;
    return PRT_OK;
}

static void file_opened(struct cache_job *job)
{
    struct shape_job *own = (struct shape_job *)job;
    struct shape *s = job->value = create_shape(own->file);
    if (s) s->generation = own->generation;
    int status = s ? set_variant(s, own, job->work.error) : PRT_NOMEM;
    if (status) {
        cache_job_complete(job, status);
        return;
    }
    bool moved = own->pose && own->pose->n == s->mesh.n_vertex;
    if (own->pose && own->pose->name[0] && !moved) { // it was read from the disk
        snprintf(job->work.error, sizeof job->work.error,
                 "the pose has %u vertices, the model has %u: it is of another model",
                 own->pose->n, s->mesh.n_vertex);
        cache_job_complete(job, PRT_MISMATCH);
        return;
    }
    if (moved && !set_pose(s, own->pose)) {
        cache_job_complete(job, PRT_NOMEM);
        return;
    }
    job->bytes = shape_bytes(s);
    job->holds_file = true;
    if (moved) cache_job_submit(job);
    else cache_job_complete(job, PRT_OK);
}

// pose: NULL where the vertices are the file's.
static struct cache_entry *get(struct model *m, struct pose *pose, uint64_t generation,
                               const char *variant, int *code, char error[256])
{
    char key[80 + VARIANT_NAME];
    struct cache_job *job;
    if (m->gone)
        return model_open(m, code, error); // its shape may still be in use under the same key
    snprintf(key, sizeof key, "%s/%llu/shape/%s", m->key, (unsigned long long)generation,
             variant);
    struct cache_entry *entry = cache_find(m->server->cache, key);
    if (entry) return entry;
    struct cache_entry *file = model_mesh_open(m, code, error);
    if (!file) return NULL;
    entry = cache_compute(m->server, key, &kind, &job);
    if (job) {
        struct shape_job *own = (struct shape_job *)job;
        own->model = m;
        model_hold(m);
        own->generation = generation;
        own->file = file;
        cache_job_hold(job, file);
        own->pose = pose;
        if (own->pose) own->pose->refs++;
        snprintf(own->variant, sizeof own->variant, "%s", variant);
        cache_job_await(job, file, file_opened);
    }
    cache_release(file);
    return entry;
}

struct cache_entry *shape_get(struct model *m, struct pose *pose, const char *variant,
                              int *code, char error[256])
{
    return get(m, pose ? pose : m->pose, pose ? pose->generation : m->generation, variant, code,
               error);
}

int shape_scene(const struct prt_context *ctx, struct shape *s, const struct prt_scene **scene)
{
    pthread_mutex_lock(&s->lock);
    int status = s->scene ? PRT_OK : prt_scene_create(ctx, &s->mesh, &s->scene);
    *scene = s->scene;
    pthread_mutex_unlock(&s->lock);
    return status;
}

struct scene_job {
    struct work work;
    struct cache_entry *entry;
};

static int run_scene(struct work *work, const struct prt_context *ctx)
{
    const struct prt_scene *scene;
    return shape_scene(ctx, ((struct scene_job *)work)->entry->value, &scene);
}

static void scene_done(struct work *work)
{
    struct scene_job *p = (struct scene_job *)work;
    cache_release(p->entry); // shape_scene() reports the error again to the job that needs it
    free(p);
}

void shape_prepare(struct model *model, struct cache_entry *entry)
{
    struct scene_job *p = calloc(1, sizeof *p);
    if (!p) return;
    p->entry = entry;
    cache_hold(entry);
    p->work.run = run_scene;
    p->work.done = scene_done;
    work_submit(model->server->work, &p->work);
}
