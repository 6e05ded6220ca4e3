// SPDX-License-Identifier: MIT
// A model's geometry for image-space engines: the mesh of its file, or that mesh with the
// vertices where a client has put them.
#include "render/shared/geometry.h"

#include "render/evaluation.h"
#include "relight.pb-c.h"
#include "net/request.h"

#include <stdio.h>
#include <stdlib.h>
#include <string.h>

void pose_release(struct pose *pose)
{
    if (!pose || --pose->refs) return;
    prt_free(pose->position);
    prt_free(pose->normal);
    if (pose->principal) ledger_give(pose->principal, LEDGER_PAYLOAD, pose->charged);
    principal_release(pose->principal);
    free(pose);
}

static void destroy_shape(void *value)
{
    struct shape *s = value;
    for (int i = 0; i < SHAPE_SLOTS; i++) prt_screen_destroy(s->slot[i].screen);
    if (s->scene) prt_scene_destroy(s->scene);
    pthread_mutex_destroy(&s->lock);
    prt_free(s->normal);
    pose_release(s->pose);
    cache_release(s->file);
    free(s);
}

// Mesh, scene and the engines' samples, roughly.
static size_t shape_bytes(const struct shape *s)
{
    return sizeof *s + (size_t)s->mesh.n_vertex * 24 + (size_t)s->mesh.n_triangle * 150 +
           (8 << 20);
}

// One shape being made: waits for the file, then makes normals on a worker where they are
// wanted.
struct shaping {
    struct work work;
    struct cache_waiter waiter;
    struct model *model;
    uint64_t generation;
    struct cache_entry *entry, *file;
    struct pose *pose;
    struct shape *shape;
};

static void end_shaping(struct shaping *g)
{
    cache_release(g->entry);
    cache_release(g->file);
    pose_release(g->pose);
    model_release(g->model);
    free(g);
}

static int run_normals(struct work *work, const struct prt_context *ctx)
{
    struct shape *s = ((struct shaping *)work)->shape;
    memcpy(s->normal, s->pose->normal, (size_t)s->pose->n * sizeof *s->normal);
    return prt_mesh_normals(ctx, &s->mesh);
}

static void done_normals(struct work *work)
{
    struct shaping *g = (struct shaping *)work;
    if (work->status) {
        destroy_shape(g->shape);
        cache_fail(g->entry, error_of_status(work->status), work->error);
    } else {
        if (g->generation == g->model->generation)
            prt_mesh_bounds(&g->shape->mesh, g->model->facts.box);
        g->entry->holds_file = true;
        cache_fill(g->entry, g->shape, shape_bytes(g->shape), destroy_shape);
    }
    end_shaping(g);
}

static void file_opened(struct cache_waiter *waiter)
{
    struct shaping *g = (struct shaping *)((char *)waiter - offsetof(struct shaping, waiter));
    if (g->file->state == CACHE_FAILED) {
        cache_fail(g->entry, g->file->error_code, g->file->error);
        end_shaping(g);
        return;
    }
    const struct prt_transport *t = prt_file_transport(g->file->value);
    struct shape *s = calloc(1, sizeof *s);
    bool moved = g->pose && g->pose->n == t->mesh.n_vertex;
    if (s && moved) s->normal = prt_alloc(g->pose->n, sizeof *s->normal);
    if (!s || (moved && !s->normal)) {
        free(s);
        cache_fail(g->entry, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY, "not enough memory");
        end_shaping(g);
        return;
    }
    pthread_mutex_init(&s->lock, NULL);
    for (int i = 0; i < SHAPE_SLOTS; i++) s->slot[i].last = &s->slot[i].first;
    s->file = g->file;
    cache_hold(s->file);
    s->mesh = t->mesh;
    s->material = &t->material;
    if (!moved) {
        g->entry->holds_file = true;
        cache_fill(g->entry, s, shape_bytes(s), destroy_shape);
        end_shaping(g);
        return;
    }
    s->pose = g->pose;
    s->pose->refs++;
    s->mesh.position = s->pose->position;
    s->mesh.normal = s->normal;
    g->shape = s;
    g->work.run = run_normals;
    g->work.done = done_normals;
    work_submit(g->model->server->work, &g->work);
}

struct cache_entry *shape_get(struct model *m, int *code, char error[256])
{
    char key[80];
    bool fresh;
    if (m->gone)
        return model_open(m, code, error); // who computes with it may hold its shape still
    snprintf(key, sizeof key, "%s/%llu/shape", m->key, (unsigned long long)m->generation);
    struct cache_entry *entry = cache_find(m->server->cache, key);
    if (entry) return entry;
    struct cache_entry *file = model_mesh_open(m, code, error);
    if (!file) return NULL;
    struct shaping *g = calloc(1, sizeof *g);
    if (!g) {
        cache_release(file);
        *code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
        snprintf(error, 256, "not enough memory");
        return NULL;
    }
    entry = cache_get(m->server->cache, key, &fresh);
    *g = (struct shaping){
        .model = m, .generation = m->generation, .entry = entry, .file = file, .pose = m->pose};
    model_hold(m);
    cache_hold(entry); // one for the making, one for the caller
    if (g->pose) g->pose->refs++;
    g->waiter.wake = file_opened;
    if (file->state == CACHE_PENDING) cache_wait(file, &g->waiter);
    else file_opened(&g->waiter);
    return entry;
}

int shape_scene(const struct prt_context *ctx, struct shape *s, const struct prt_scene **scene)
{
    pthread_mutex_lock(&s->lock);
    int status = s->scene ? PRT_OK : prt_scene_create(ctx, &s->mesh, &s->scene);
    *scene = s->scene;
    pthread_mutex_unlock(&s->lock);
    return status;
}

struct preparing {
    struct work work;
    struct cache_entry *entry;
};

static int run_preparing(struct work *work, const struct prt_context *ctx)
{
    const struct prt_scene *scene;
    return shape_scene(ctx, ((struct preparing *)work)->entry->value, &scene);
}

static void done_preparing(struct work *work)
{
    struct preparing *p = (struct preparing *)work;
    cache_release(p->entry); // who needs the scene hears why there is none
    free(p);
}

void shape_prepare(struct model *model, struct cache_entry *entry)
{
    struct preparing *p = calloc(1, sizeof *p);
    if (!p) return;
    p->entry = entry;
    cache_hold(entry);
    p->work.run = run_preparing;
    p->work.done = done_preparing;
    work_submit(model->server->work, &p->work);
}
