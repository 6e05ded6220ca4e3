// SPDX-License-Identifier: MIT
// Random walks inside a model (METHODS §9): segments and rays a second, against a loop of bare
// Embree over rays of the same kind, and the share of rays that the grid of distances spares.
#include "bench.h"

#include "prt/walk.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { RAYS = 1 << 16, VERTICES_AT_ONCE = 64, WALKS_OF_A_VERTEX = 32 };

struct walks {
    const struct bench_env *env;
    struct prt_mesh *mesh;
    uint32_t *block; // [n_vertex]
    struct prt_scene *scene;
    struct prt_walk_space *space;
    struct prt_walk_medium medium;
    struct prt_packet *ray; // [RAYS / PRT_PACKET]
    unsigned turn;
    struct prt_walk_counts counts;
};

static void ignore_exit(void *arg, const struct prt_walk_exit *exit)
{
}

static int walk_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct walks *w = arg;
    struct prt_walk_counts c = {0};
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++) {
        struct prt_walk_start start;
        uint64_t at[2] = {w->turn, i};
        uint32_t v = (uint32_t)(prt_hash64(at, sizeof at, w->env->seed) % w->mesh->n_vertex);
        const struct prt_block *b = &w->mesh->block[w->block[v]];
        if (!w->mesh->surface[b->surface].translucent) continue;
        prt_walk_start_at(w->space, v, b->object, w->turn + i, &start);
        prt_walk_run(w->space, &start, &w->medium, WALKS_OF_A_VERTEX, ignore_exit, NULL, &c);
    }
    __atomic_fetch_add(&w->counts.walks, c.walks, __ATOMIC_RELAXED);
    __atomic_fetch_add(&w->counts.leaked, c.leaked + c.cut, __ATOMIC_RELAXED);
    __atomic_fetch_add(&w->counts.segments, c.segments, __ATOMIC_RELAXED);
    __atomic_fetch_add(&w->counts.rays, c.rays, __ATOMIC_RELAXED);
    return PRT_OK;
}

static int bare_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct walks *w = arg;
    prt_trace_thread_init();
    for (size_t i = begin; i < end; i++)
        prt_scene_intersect16(w->scene, &w->ray[i], 0xffff, false);
    return PRT_OK;
}

static void random_direction(struct prt_rng *rng, float d[3])
{
    float z = 2 * prt_rng_f32(rng) - 1, phi = 2 * (float)M_PI * prt_rng_f32(rng);
    float s = sqrtf(1 - z * z);
    d[0] = s * cosf(phi), d[1] = s * sinf(phi), d[2] = z;
}

// Rays as walks cast them: flights from points inside, which lie anywhere on chords from the
// vertices. Vertices from which no chord leads inside are drawn again.
static void make_rays(struct walks *w)
{
    struct prt_rng rng;
    prt_rng_init(&rng, w->env->seed, 0x7761);
    for (uint32_t i = 0, tries = 0; i < RAYS && tries < 64u * RAYS; tries++) {
        uint32_t v = prt_rng_u32(&rng) % w->mesh->n_vertex, triangle;
        const float *n = w->mesh->normal[v], *x = w->mesh->position[v];
        float o[3], d[3], t, a, b, along = prt_rng_f32(&rng);
        for (int k = 0; k < 3; k++) o[k] = x[k] - prt_scene_epsilon(w->scene) * n[k];
        random_direction(&rng, d);
        if (d[0] * n[0] + d[1] * n[1] + d[2] * n[2] >= 0 ||
            !prt_scene_intersect(w->scene, o, d, 0, INFINITY, &t, &triangle, &a, &b))
            continue;
        struct prt_packet *p = &w->ray[i / PRT_PACKET];
        uint32_t lane = i % PRT_PACKET;
        p->ox[lane] = o[0] + along * t * d[0], p->oy[lane] = o[1] + along * t * d[1];
        p->oz[lane] = o[2] + along * t * d[2];
        random_direction(&rng, d);
        p->dx[lane] = d[0], p->dy[lane] = d[1], p->dz[lane] = d[2];
        p->tfar[lane] = -logf(1 - prt_rng_f32(&rng)) / w->medium.sigma_s_prime;
        i++;
    }
}

// Time passes to walks and to the bare loop by turns, so that both see the same machine.
static int measure(struct walks *w, double *walk_s, double *bare_s, double *bare_rays)
{
    const struct prt_context *ctx = &w->env->ctx;
    int status = PRT_OK;
    *walk_s = *bare_s = *bare_rays = 0;
    w->counts = (struct prt_walk_counts){0};
    make_rays(w);
    for (w->turn = 0; !status && (!w->turn || *walk_s < w->env->seconds); w->turn++) {
        double start = prt_time_s();
        status = prt_parallel_for(ctx, NULL, VERTICES_AT_ONCE, 4, walk_range, w);
        double middle = prt_time_s();
        if (!status) status = prt_parallel_for(ctx, NULL, RAYS / PRT_PACKET, 64, bare_range, w);
        *walk_s += middle - start;
        *bare_s += prt_time_s() - middle;
        *bare_rays += RAYS;
    }
    return status;
}

static int medium(struct walks *w, const char *name)
{
    struct prt_material m;
    double walk_s, bare_s, bare_rays;
    int status = prt_material_load(&w->env->ctx, name, &m);
    if (status) return status;
    w->medium = (struct prt_walk_medium){m.sigma_s_prime[1], m.eta, 0};
    if ((status = measure(w, &walk_s, &bare_s, &bare_rays))) return status;
    const double rays = (double)w->counts.rays, segments = (double)w->counts.segments;
    bench_begin(w->env, "walk");
    bench_text("medium", name);
    bench_number("walks", (double)w->counts.walks);
    bench_number("segments_a_walk", segments / (double)w->counts.walks);
    bench_number("segments_per_s", segments / walk_s);
    bench_number("rays_per_s", rays / walk_s);
    bench_number("bare_embree_rays_per_s", bare_rays / bare_s);
    bench_number("ratio_to_bare", rays / walk_s / (bare_rays / bare_s));
    bench_number("rays_spared", 1 - rays / segments);
    bench_number("lost", (double)w->counts.leaked / (double)w->counts.walks);
    bench_end();
    return PRT_OK;
}

static int run(struct bench_env *env)
{
    static const char *const media[] = {"marble", "skin1", "skimmilk"};
    struct walks w = {.env = env};
    if (!env->mesh) {
        prt_log(&env->ctx, PRT_LOG_NOTE, "walk wants --model FILE: left out");
        return PRT_OK;
    }
    int status = prt_mesh_load(&env->ctx, env->mesh, NULL, &w.mesh);
    if (!status) status = prt_mesh_scale(&env->ctx, w.mesh, 50, 0);
    if (!status) status = prt_scene_create(&env->ctx, w.mesh, &w.scene);
    if (!status) status = prt_walk_space_create(&env->ctx, w.scene, &w.space);
    w.block = status ? NULL : prt_mesh_vertex_blocks(w.mesh);
    w.ray = prt_calloc(RAYS / PRT_PACKET, sizeof *w.ray);
    if (!status && (!w.block || !w.ray)) status = PRT_NOMEM;
    for (unsigned i = 0; !status && i < sizeof media / sizeof *media; i++)
        status = medium(&w, media[i]);
    prt_free(w.block);
    prt_free(w.ray);
    prt_walk_space_destroy(w.space);
    prt_scene_destroy(w.scene);
    prt_mesh_destroy(w.mesh);
    return status;
}
BENCH(walk, "random walks: segments and rays a second against bare Embree (--model)", run)
