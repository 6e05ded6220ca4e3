// SPDX-License-Identifier: MIT
// The near part of the hybrid engine by C08's pattern: rings of points about a receiver in the
// light's view, at radii drawn from the local part of R_d, and one point in the centre.
#include "internal.h"

#include "base/isa.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { KNOTS = 512 }; // of the radius's distribution; chosen, not measured

// Points at equal steps of the running integral of 2 pi r R_d W_l, the mean of three channels.
struct pattern {
    uint32_t n;
    float *a, *b; // [n] offsets in the light's plane [mm]
    float *area;  // [n] area across the light [mm^2]
};

static void pattern_finish(struct pattern *p)
{
    free(p->a);
    free(p->b);
    free(p->area);
}

// 2 pi r W_l times the sum of R_d / rho_d over channels [mm^-1].
static double density(const struct frame *f, uint32_t object, double r_p, double r)
{
    double sum = 0;
    for (int c = 0; c < 3; c++) {
        const struct prt_diffusion *d = &f->dipole[object][c];
        if (d->rho_d > 0) sum += prt_diffusion_rd(d, r) / d->rho_d;
    }
    return 2 * M_PI * r * sum * prt_screen_local_weight(r, r_p);
}

static bool make_pattern(const struct frame *f, uint32_t object, double r_p, double reach,
                         struct pattern *out)
{
    uint32_t rings = f->options->rings, spokes = f->options->spokes;
    double cdf[KNOTS + 1], radius[KNOTS + 1], phase = 0.5;
    out->n = rings * spokes + 1;
    out->a = malloc(out->n * sizeof(float));
    out->b = malloc(out->n * sizeof(float));
    out->area = malloc(out->n * sizeof(float));
    if (!out->a || !out->b || !out->area) return false;
    if (f->seed) {
        struct prt_rng rng;
        prt_rng_init(&rng, f->seed, 11);
        phase = (double)prt_rng_f32(&rng);
    }
    cdf[0] = radius[0] = 0;
    for (int k = 1; k <= KNOTS; k++) {
        // knots are finer near the centre
        double x = (double)k / KNOTS, mid;
        radius[k] = reach * x * x;
        mid = (radius[k] + radius[k - 1]) / 2;
        cdf[k] = cdf[k - 1] + density(f, object, r_p, mid) * (radius[k] - radius[k - 1]);
    }
    // the centre stands for the first of rings * spokes + 1 equal shares, each ring for the
    // next `spokes` of them; a point's area is its share over the density there, like M03's
    // weights
    double share = cdf[KNOTS] / out->n;
    int at = 1;
    out->a[0] = out->b[0] = 0;
    out->area[0] = (float)(share / (density(f, object, r_p, 1e-6) / (2 * M_PI * 1e-6)));
    for (uint32_t l = 0; l < rings; l++) {
        double want = share * (1 + ((double)l + 0.5) * spokes);
        while (at < KNOTS && cdf[at] < want) at++;
        double step = cdf[at] - cdf[at - 1];
        double r = radius[at - 1] +
                   (step > 0 ? (want - cdf[at - 1]) / step : 0) * (radius[at] - radius[at - 1]);
        double area = share / (density(f, object, r_p, r) / (2 * M_PI * r));
        for (uint32_t s = 0; s < spokes; s++) {
            double phi = 2 * M_PI * ((s + phase) / spokes + 0.381966011250105 * l);
            uint32_t i = 1 + l * spokes + s;
            out->a[i] = (float)(r * cos(phi));
            out->b[i] = (float)(r * sin(phi));
            out->area[i] = (float)area;
        }
    }
    return true;
}

enum { LANES = 64 };
#define PRT_KERNEL_FILE "screen/pattern_kernel.h"
#include "base/isa_each.h"

typedef void (*receive_fn)(const struct light_map *m, const struct pattern *pat,
                           const struct radial_table *table, uint32_t object, float u, float v,
                           float depth, float sum[3]);

struct job {
    struct frame *f;
    const struct light_map *map;
    const struct pattern *pattern;    // [object]
    const struct radial_table *table; // [object]
    receive_fn receive;
    const float *rgb; // of the light
    atomic_uint_fast64_t n_pair;
};

static void receive(const struct job *job, uint32_t object, uint32_t column)
{
    const struct light_map *m = job->map;
    float u = 0, v = 0, depth = 0, sum[3] = {0, 0, 0};
    for (int k = 0; k < 3; k++) {
        float d = job->f->view->p[k][column] - m->origin[k];
        u += d * m->u[k];
        v += d * m->v[k];
        depth += d * m->d[k];
    }
    job->receive(m, &job->pattern[object], &job->table[object], object, u, v, depth, sum);
    for (int k = 0; k < 3; k++) job->f->sum[k][column] += sum[k] * job->rgb[k];
}

static int run(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct job *job = arg;
    const struct view_cache *v = job->f->view;
    uint64_t pairs = 0;
    for (size_t tile = begin; tile < end; tile++) {
        uint32_t object = v->object[tile];
        for (uint32_t i = v->begin[tile]; i < v->begin[tile + 1]; i++) receive(job, object, i);
        pairs += (uint64_t)(v->begin[tile + 1] - v->begin[tile]) * job->pattern[object].n;
    }
    atomic_fetch_add(&job->n_pair, pairs);
    return PRT_OK;
}

int prt_scatter_pattern(struct frame *f, double r_p, float spacing, float reach)
{
    struct grid grid = prt_frame_grid(f, spacing);
    uint32_t n_object = f->n_object ? f->n_object : 1;
    struct pattern *pattern = calloc(n_object, sizeof *pattern);
    struct radial_table *table = prt_calloc(n_object, sizeof *table);
    int status = pattern && table ? PRT_OK : prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t o = 0; o < f->n_object && !status; o++) {
        // a point is a disc of one step of the light's view, which resolves nothing finer
        prt_split_table(f, o, r_p, 0, true, (double)spacing / sqrt(M_PI), reach, &table[o]);
        if (!make_pattern(f, o, r_p, (double)reach, &pattern[o]))
            status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for a pattern");
    }
    for (uint32_t l = 0; l < f->n_light && !status; l++) {
        struct light_map map;
        double t0 = prt_time_s();
        status = prt_light_map_make(f->ctx, f->screen->scene, &f->light[l], &grid, f->eta, &map,
                                    &f->report->n_ray);
        double t1 = prt_time_s();
        struct job job = {.f = f,
                          .map = &map,
                          .pattern = pattern,
                          .table = table,
                          .receive = receive_c,
                          .rgb = f->light[l].rgb};
#if PRT_ISA_X86
        unsigned cpu = f->ctx ? f->ctx->cpu : prt_cpu_detect();
        if (cpu & PRT_CPU_AVX2) job.receive = receive_avx2;
        if (cpu & PRT_CPU_AVX512) job.receive = receive_avx512;
#endif
        if (!status) status = prt_screen_loop(f->ctx, f->view->n_tile, 4, run, &job);
        f->report->irradiance_s += t1 - t0;
        f->report->scatter_s += prt_time_s() - t1;
        f->report->n_pair += atomic_load(&job.n_pair);
        prt_light_map_finish(&map);
    }
    for (uint32_t o = 0; pattern && o < f->n_object; o++) pattern_finish(&pattern[o]);
    free(pattern);
    prt_free(table);
    return status;
}
