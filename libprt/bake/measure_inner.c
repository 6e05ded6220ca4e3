// SPDX-License-Identifier: MIT
// The inner loops of the bake, timed alone for prt-bench.
#include "bake/measure_inner.h"
#include "bake/stages.h"

#include "prt/reference.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

struct ray_job {
    const struct prt_scene *scene;
    const struct prt_surface_points *surface;
    const struct directions *d;
    struct fresnel_table fresnel;
    atomic_uint_fast64_t rays, open;
};

static int full_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct ray_job *j = arg;
    prt_trace_thread_init();
    float *row = prt_alloc(j->d->n_coef, sizeof *row);
    uint16_t *half = prt_alloc(j->d->n_coef, sizeof *half);
    uint64_t rays = 0;
    for (size_t i = begin; row && half && i < end; i++) {
        const struct receiver at = {j->surface->position[i], j->surface->normal[i],
                                    j->surface->face_normal[i]};
        rays += prt_irradiance_row(j->scene, j->d, (unsigned)i, &j->fresnel, &at, NULL,
                                   EVERY_RAY, row);
        prt_f32_to_f16_array(row, j->d->n_coef, half);
    }
    atomic_fetch_add(&j->rays, rays);
    prt_free(row);
    prt_free(half);
    return row && half ? PRT_OK : PRT_NOMEM;
}

// The same packets and lanes; the results are not used.
static int bare_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct ray_job *j = arg;
    prt_trace_thread_init();
    float eps = prt_scene_epsilon(j->scene);
    uint64_t open = 0;
    for (size_t i = begin; i < end; i++) {
        const float *x = j->surface->position[i], *n = j->surface->normal[i],
                    *f = j->surface->face_normal[i];
        size_t base = (size_t)(i % j->d->n_pattern) * j->d->n_packet * 16;
        struct prt_packet p;
        for (int l = 0; l < 16; l++) {
            p.ox[l] = x[0] + eps * f[0], p.oy[l] = x[1] + eps * f[1],
            p.oz[l] = x[2] + eps * f[2];
            p.tnear[l] = 0, p.tfar[l] = INFINITY;
        }
        for (uint32_t k = 0; k < j->d->n_packet; k++) {
            const float *dx = j->d->x + base + (size_t)k * 16,
                        *dy = j->d->y + base + (size_t)k * 16,
                        *dz = j->d->z + base + (size_t)k * 16;
            uint32_t mask = 0;
            for (int l = 0; l < 16; l++) {
                p.dx[l] = dx[l], p.dy[l] = dy[l], p.dz[l] = dz[l];
                bool above = n[0] * dx[l] + n[1] * dy[l] + n[2] * dz[l] > 0 &&
                             f[0] * dx[l] + f[1] * dy[l] + f[2] * dz[l] > 0;
                mask |= (uint32_t)above << l;
            }
            if (mask) open += prt_scene_occluded16(j->scene, &p, mask);
        }
    }
    atomic_fetch_add(&j->open, open);
    return PRT_OK;
}

int prt_bake_measure_rays(const struct prt_context *ctx, const struct prt_mesh *mesh,
                          uint32_t n_sample, uint32_t cube, struct prt_bake_rays *out)
{
    struct prt_scene *scene = NULL;
    struct prt_surface_points *surface = NULL;
    struct directions *d = NULL;
    int status = prt_scene_create(ctx, mesh, &scene);
    if (status == PRT_OK) status = prt_surface_create(ctx, mesh, n_sample, 1, 1, &surface);
    if (status == PRT_OK) status = prt_directions_create(ctx->cpu, cube, 8, 1, &d);
    memset(out, 0, sizeof *out);
    for (int round = 0; status == PRT_OK && round < 3;
         round++) { // alternating, because the speed of a machine drifts
        struct ray_job job = {.scene = scene, .surface = surface, .d = d};
        prt_fresnel_table_init(&job.fresnel, 1.5);
        double t0 = prt_time_s();
        status = prt_parallel_for(ctx, NULL, surface->n_sample, 32, full_range, &job);
        double t1 = prt_time_s();
        if (status == PRT_OK)
            status = prt_parallel_for(ctx, NULL, surface->n_sample, 32, bare_range, &job);
        out->seconds += t1 - t0;
        out->bare_seconds += prt_time_s() - t1;
        out->rays += atomic_load(&job.rays);
    }
    prt_directions_destroy(d);
    prt_surface_destroy(surface);
    prt_scene_destroy(scene);
    return status;
}

struct single_job {
    struct single_plan plan;
    struct fresnel_table fresnel;
    const struct prt_cube *light; // [n_light]
    uint32_t n_light, n_vertex;
    uint32_t *vertex;
    float (*color)[3]; // [n_light][n_vertex]
    atomic_uint_fast64_t rays;
};

static int single_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct single_job *j = arg;
    const struct directions *d = j->plan.directions;
    prt_trace_thread_init();
    float *rows = prt_alloc((size_t)3 * d->n_coef, sizeof *rows);
    void *scratch = prt_alloc(prt_single_scratch_bytes(&j->plan), 1);
    for (size_t i = begin; rows && scratch && i < end; i++) {
        atomic_fetch_add(&j->rays,
                         prt_single_rows(&j->plan, &j->fresnel, j->vertex[i], rows, scratch));
        for (uint32_t k = 0; k < 3 * j->n_light; k++) {
            uint32_t c = k % 3;
            double sum = 0;
            for (uint32_t t = 0; t < d->n_coef; t++)
                sum += (double)rows[(size_t)c * d->n_coef + t] * d->solid_angle[t] *
                       j->light[k / 3].texel[t * 3 + c];
            j->color[(size_t)(k / 3) * j->n_vertex + i][c] = (float)sum;
        }
    }
    prt_free(rows);
    prt_free(scratch);
    return rows && scratch ? PRT_OK : PRT_NOMEM;
}

static int horizon_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct single_job *j = arg;
    prt_trace_thread_init();
    for (size_t t = begin; j->plan.horizon && t < end; t++)
        (void)prt_horizon_bin(j->plan.horizon, (uint32_t)t, 0);
    return PRT_OK;
}

int prt_bake_measure_single(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            const struct prt_material *m, const struct prt_cube *light,
                            uint32_t n_light, uint32_t n_vertex, struct prt_bake_single *out)
{
    struct single_job job = {.light = light, .n_light = n_light, .n_vertex = n_vertex};
    size_t n_color = (size_t)n_light * n_vertex;
    struct prt_scene *scene = NULL;
    struct directions *d = NULL;
    float(*saved)[3] = prt_alloc(n_color, sizeof *saved);
    float(*every)[3] = prt_alloc(n_color, sizeof *every);
    job.vertex = prt_alloc(n_vertex, sizeof *job.vertex);
    int status = saved && every && job.vertex ? PRT_OK : PRT_NOMEM;
    if (!n_light || n_light > PRT_BAKE_SINGLE_LIGHTS) status = PRT_ARG;
    if (status == PRT_OK) status = prt_scene_create(ctx, mesh, &scene);
    if (status == PRT_OK) status = prt_directions_create(ctx->cpu, light->n, 16, 1, &d);
    if (status == PRT_OK) {
        struct prt_rng rng;
        prt_rng_init(&rng, 5, 5);
        for (uint32_t i = 0; i < n_vertex; i++)
            job.vertex[i] = prt_rng_u32(&rng) % mesh->n_vertex;
        prt_fresnel_table_init(&job.fresnel, m->eta);
        job.plan = (struct single_plan){.cpu = ctx->cpu,
                                        .scene = scene,
                                        .mesh = mesh,
                                        .directions = d,
                                        .n_eta = 1,
                                        .eta = {m->eta},
                                        .n_phase = 1,
                                        .n_point = 16,
                                        .seed = 1,
                                        .n_direction = d->n_coef};
        for (int c = 0; c < 3; c++) {
            job.plan.sigma_s[c] = m->sigma_s_prime[c] / (1 - m->g[c]);
            job.plan.sigma_t[c] = job.plan.sigma_s[c] + m->sigma_a[c];
            (void)prt_phase_hg(&job.plan.phase[c], m->g[c], 1);
        }
        prt_single_plan_depths(&job.plan);
    }
    memset(out, 0, sizeof *out);
    if (status ==
        PRT_OK) { // timed alone: it is filled once a mesh and does not depend on n_vertex
        double t0 = prt_time_s();
        status = prt_parallel_for(ctx, NULL, mesh->n_triangle, 1024, horizon_range, &job);
        out->horizon_seconds = prt_time_s() - t0;
    }
    for (int pass = 0; status == PRT_OK && pass < 2; pass++) {
        double t0 = prt_time_s();
        job.plan.every_ray = pass;
        job.color = pass ? every : saved;
        atomic_store(&job.rays, 0);
        status = prt_parallel_for(ctx, NULL, n_vertex, 8, single_range, &job);
        *(pass ? &out->every_rays : &out->rays) = atomic_load(&job.rays);
        *(pass ? &out->every_seconds : &out->seconds) = prt_time_s() - t0;
    }
    for (uint32_t l = 0; status == PRT_OK && l < n_light; l++)
        out->error[l] = prt_relative_rmse(saved[(size_t)l * n_vertex],
                                          every[(size_t)l * n_vertex], (size_t)n_vertex * 3);
    prt_single_plan_finish(&job.plan);
    prt_directions_destroy(d);
    prt_scene_destroy(scene);
    prt_free(saved);
    prt_free(every);
    prt_free(job.vertex);
    return status;
}
