// SPDX-License-Identifier: MIT
// Counters of a bake's work, and the rates of the machine beside which they are printed.
#include "bake/work.h"

#include "prt/surface.h"
#include "prt/trace.h"

#include <cblas.h>
#include <math.h>
#include <string.h>
#include <time.h>

static const char *const work_name[N_BAKE_WORK] = {
#define X(id, name) name,
    BAKE_WORK_LIST(X)
#undef X
};

static uint64_t clock_ns(clockid_t clock)
{
    struct timespec t;
    clock_gettime(clock, &t);
    return (uint64_t)t.tv_sec * UINT64_C(1000000000) + (uint64_t)t.tv_nsec;
}

uint64_t prt_work_begin(void)
{
    return clock_ns(CLOCK_THREAD_CPUTIME_ID);
}

uint64_t prt_work_begin_all(void)
{
    return clock_ns(CLOCK_PROCESS_CPUTIME_ID);
}

static void add(struct work_meter *m, uint64_t ns, uint64_t rays, double flop)
{
    atomic_fetch_add_explicit(&m->cpu_ns, ns, memory_order_relaxed);
    atomic_fetch_add_explicit(&m->rays, rays, memory_order_relaxed);
    atomic_fetch_add_explicit(&m->flop, (uint64_t)flop, memory_order_relaxed);
}

void prt_work_end(struct work_meters *meters, enum bake_work kind, uint64_t begin,
                  uint64_t rays, double flop)
{
    if (meters) add(&meters->kind[kind], clock_ns(CLOCK_THREAD_CPUTIME_ID) - begin, rays, flop);
}

void prt_work_count(struct work_meters *meters, enum bake_work kind, uint64_t rays, double flop)
{
    if (meters) add(&meters->kind[kind], 0, rays, flop);
}

void prt_work_reuse(struct work_meters *meters, uint64_t reused, uint64_t asked)
{
    if (!meters) return;
    atomic_fetch_add_explicit(&meters->reused, reused, memory_order_relaxed);
    atomic_fetch_add_explicit(&meters->asked, asked, memory_order_relaxed);
}

void prt_work_end_all(struct work_meters *meters, enum bake_work kind, uint64_t begin)
{
    add(&meters->kind[kind], clock_ns(CLOCK_PROCESS_CPUTIME_ID) - begin, 0, 0);
}

void prt_work_report(const struct work_meters *meters, struct prt_bake_profile *out)
{
    memset(out, 0, sizeof *out);
    out->cached = meters->asked != 0;
    if (out->cached) out->reused = (double)meters->reused / (double)meters->asked;
    for (int i = 0; i < N_BAKE_WORK; i++) {
        const struct work_meter *m = &meters->kind[i];
        if (!m->cpu_ns) continue;
        out->work[out->n_work++] = (struct prt_bake_work){
            work_name[i], 1e-9 * (double)m->cpu_ns, m->rays, (double)m->flop};
    }
}

// ---- the machine's own rates

struct limit_job {
    const struct prt_scene *scene;
    const struct prt_surface_points *surface;
    atomic_uint_fast64_t rays;
};

enum { PACKETS = 4096, SIDE = 768 };

// Packets of 16 rays from one sample each, over the hemisphere above it.
static int trace_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct limit_job *job = arg;
    const struct prt_surface_points *s = job->surface;
    struct prt_rng rng;
    prt_trace_thread_init();
    prt_rng_init(&rng, 1, begin);
    float eps = prt_scene_epsilon(job->scene);
    for (size_t k = begin; k < end; k++) {
        uint32_t at = prt_rng_u32(&rng) % s->n_sample;
        struct prt_packet p;
        for (int i = 0; i < 16; i++) {
            float z = 2 * prt_rng_f32(&rng) - 1, turn = 6.2831853f * prt_rng_f32(&rng);
            float r = sqrtf(1 - z * z), d[3] = {r * cosf(turn), z, r * sinf(turn)}, up = 0;
            for (int c = 0; c < 3; c++) up += d[c] * s->face_normal[at][c];
            float sign = up < 0 ? -1 : 1;
            p.ox[i] = s->position[at][0] + eps * s->face_normal[at][0];
            p.oy[i] = s->position[at][1] + eps * s->face_normal[at][1];
            p.oz[i] = s->position[at][2] + eps * s->face_normal[at][2];
            p.dx[i] = sign * d[0], p.dy[i] = sign * d[1], p.dz[i] = sign * d[2];
            p.tnear[i] = 0, p.tfar[i] = INFINITY;
        }
        (void)prt_scene_occluded16(job->scene, &p, 0xffff);
        atomic_fetch_add(&job->rays, 16);
    }
    return PRT_OK;
}

static int product_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    size_t n = (size_t)SIDE * SIDE;
    float *a = prt_calloc(3 * n, sizeof *a);
    if (!a) return PRT_NOMEM;
    for (size_t k = begin; k < end; k++)
        cblas_sgemm(CblasRowMajor, CblasNoTrans, CblasNoTrans, SIDE, SIDE, SIDE, 1, a, SIDE,
                    a + n, SIDE, 0, a + 2 * n, SIDE);
    prt_free(a);
    return PRT_OK;
}

int prt_work_measure_limits(const struct prt_context *ctx, const struct prt_scene *scene,
                            const struct prt_surface_points *surface,
                            struct prt_bake_profile *out)
{
    struct limit_job job = {.scene = scene, .surface = surface};
    struct prt_context quiet = *ctx;
    quiet.progress = NULL;
    const double threads =
        prt_pool_size(ctx->pool); // rates by CPU time: other programs may run
    uint64_t started = prt_work_begin_all();
    int status = prt_parallel_for(&quiet, "limits", PACKETS, 64, trace_range, &job);
    uint64_t traced = prt_work_begin_all();
    out->rays_s = threads * (double)job.rays / (1e-9 * (double)(traced - started));
    if (status) return status;
    enum { PRODUCTS = 48 };
    status = prt_parallel_for(&quiet, "limits", PRODUCTS, 4, product_range, NULL);
    out->flop_s = threads * PRODUCTS * 2.0 * SIDE * SIDE * SIDE /
                  (1e-9 * (double)(prt_work_begin_all() - traced));
    return status;
}
