// SPDX-License-Identifier: MIT
// Tangent-plane sampling (M03): each pixel draws points of its tangent plane in proportion to
// R_d, looks their irradiance up in the picture, and combines them with uniform samples of the
// visible area by the balance heuristic. Light of surface that the picture does not hold is
// added from points that the light sees (tangent_hidden.c).
#include "tangent.h"

#include "base/isa.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

double prt_screen_tangent_radius(const struct prt_diffusion d[3], double xi, double from_mm)
{
    // M03 picks one term of one channel and solves for it. The mean of the channels'
    // closed-form tails is solved here instead, so that one stratified number stratifies the
    // radius
    double want = 1 - xi, lo = from_mm, hi = fmax(2 * from_mm, d[0].z_r), r;
    double inv[3];
    for (int c = 0; c < 3; c++) inv[c] = d[c].rho_d > 0 ? 1 / (3 * d[c].rho_d) : 0;
    for (int k = 0; k < 200; k++, hi *= 2) {
        double g = 0;
        for (int c = 0; c < 3; c++) g += inv[c] * prt_diffusion_tail(&d[c], hi);
        if (g <= want) break;
        lo = hi;
    }
    r = (lo + hi) / 2;
    for (int k = 0; k < 60; k++) {
        double g = 0, slope = 0;
        for (int c = 0; c < 3; c++) {
            g += inv[c] * prt_diffusion_tail(&d[c], r);
            slope += inv[c] * 2 * M_PI * r * prt_diffusion_rd(&d[c], r);
        }
        if (g > want) lo = r;
        else hi = r;
        double next = slope > 0 ? r + (g - want) / slope : hi;
        if (!(next > lo && next < hi)) next = (lo + hi) / 2;
        if (fabs(next - r) < 1e-6 * next) return next;
        r = next;
    }
    return r;
}

#define PRT_KERNEL_FILE "screen/tangent_kernel.h"
#include "base/isa_each.h"

static void job_finish(struct tangent_job *job)
{
    uint32_t n_object = job->n_medium;
    for (int v = 0; v < VARIANTS; v++) {
        struct pattern *p = &job->pattern[v];
        free(p->cosine);
        free(p->sine);
        free(p->uniform);
        for (uint32_t o = 0; o < n_object; o++) {
            if (p->radius) free(p->radius[o]);
            if (p->density) free(p->density[o]);
        }
        free(p->radius);
        free(p->density);
    }
    free(job->inv_rho);
}

static double radical_inverse(uint32_t base, uint32_t i)
{
    double f = 1, r = 0;
    for (; i; i /= base) {
        f /= base;
        r += f * (i % base);
    }
    return r;
}

struct radii_job {
    struct tangent_job *job;
    uint32_t frame; // of a running mean: the variants rotate from frame to frame
};

// Radii at equal steps of the mixture's distribution; the variants' steps interleave.
static int make_radii(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct tangent_job *job = ((struct radii_job *)arg)->job;
    const uint32_t frame = ((struct radii_job *)arg)->frame;
    uint32_t n = job->n_tangent * VARIANTS;
    for (size_t o = begin; o < end; o++) {
        double r = 0;
        for (uint32_t k = 0; k < n; k++) {
            struct pattern *p = &job->pattern[(k * 7 + frame * 5) % VARIANTS];
            float at[3], density = 0;
            r = prt_screen_tangent_radius(job->dipole[o], (k + 0.5) / n, r);
            prt_radial_table_eval(&job->table[o], (float)(r * r), at);
            for (int c = 0; c < 3; c++) density += job->inv_rho[o][c] * at[c];
            p->radius[o][k / VARIANTS] = (float)r;
            p->density[o][k / VARIANTS] = density;
        }
    }
    return PRT_OK;
}

// Golden-angle spirals, each variant's rotated; uniform points at equal steps of visible area.
static bool make_patterns(struct tangent_job *job, const struct frame *f,
                          const double *area_cdf)
{
    uint32_t n = job->n_tangent;
    struct prt_rng rng;
    // frames of a running mean continue one low-discrepancy sequence: angles and uniform
    // samples fill the gaps of earlier frames. New random numbers left a noise of 1.3 % in the
    // mean
    const uint32_t frame = f->options->frame;
    const double turned = frame * 0.6180339887498949, moved = frame * 0.7548776662466927;
    prt_rng_init(&rng, f->options->seed, 100);
    for (uint32_t v = 0; v < VARIANTS; v++) {
        struct pattern *p = &job->pattern[v];
        p->cosine = malloc((n + 1) * sizeof(float));
        p->sine = malloc((n + 1) * sizeof(float));
        p->uniform = malloc((job->n_uniform + 1) * sizeof(uint32_t));
        p->radius = calloc(job->n_medium + 1, sizeof *p->radius);
        p->density = calloc(job->n_medium + 1, sizeof *p->density);
        if (!p->cosine || !p->sine || !p->uniform || !p->radius || !p->density) return false;
        double turn = radical_inverse(2, v) + (double)prt_rng_f32(&rng) + turned;
        for (uint32_t i = 0; i < n; i++) {
            double phi = 2 * M_PI * (i * 0.3819660112501051 + turn);
            p->cosine[i] = (float)cos(phi);
            p->sine[i] = (float)sin(phi);
        }
        for (uint32_t o = 0; o < job->n_medium; o++) {
            p->radius[o] = malloc((n + 1) * sizeof(float));
            p->density[o] = malloc((n + 1) * sizeof(float));
            if (!p->radius[o] || !p->density[o]) return false;
        }
        for (uint32_t i = 0; i < job->n_uniform; i++) {
            double within = fmod((double)prt_rng_f32(&rng) + moved, 1);
            double u = (i * VARIANTS + (v + frame * 5) % VARIANTS + within) /
                       ((double)job->n_uniform * VARIANTS) * area_cdf[f->g.n_point];
            uint32_t lo = 0, hi = f->g.n_point;
            while (hi - lo > 1) {
                uint32_t mid = lo + (hi - lo) / 2;
                if (area_cdf[mid] <= u) lo = mid;
                else hi = mid;
            }
            p->uniform[i] = lo;
        }
    }
    struct radii_job radii = {job, f->options->frame};
    return prt_parallel_for(f->ctx, NULL, job->n_medium, 1, make_radii, &radii) == PRT_OK;
}

struct pack_job {
    const struct tangent_view *view;
    const struct tangent_job *job;
    struct seen *out;
};

static int pack_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct pack_job *pack = arg;
    const struct samples *s = &pack->view->seen;
    for (size_t i = begin; i < end; i++) {
        struct seen *q = &pack->out[i];
        bool readable = pack->view->readable[i];
        q->plane = q->depth = 0;
        for (int k = 0; k < 3; k++) {
            float v = s->p[k][i] - pack->job->eye[k];
            q->p[k] = s->p[k][i];
            q->e[k] = readable ? s->e[k][i] : 0;
            q->n[k] = s->face[k][i];
            q->plane += v * s->face[k][i];
            q->depth += v * pack->job->forward[k];
        }
        q->object = s->object[i];
    }
    return PRT_OK;
}

// The media of the pixels: one for each object, or with maps one for each class of factors.
struct pixel_media {
    struct media classes;
    struct prt_diffusion (*dipole)[3];
    struct radial_table *table;
};

// R_d of each class of factors that maps make.
static int make_classes(struct frame *f, struct pixel_media *media, struct tangent_job *job)
{
    int status = prt_map_media(f, &media->classes);
    if (status) return status;
    const struct media *class = &media->classes;
    media->dipole = calloc(class->n + 1, sizeof *media->dipole);
    media->table = prt_calloc(class->n + 1, sizeof *media->table);
    if (!media->dipole || !media->table)
        return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t k = 0; k < class->n; k++) {
        const struct prt_diffusion *base = f->dipole[class->object[k]];
        double scale = INFINITY;
        for (int c = 0; c < 3; c++) {
            prt_map_medium(&base[c], class->factor[k], c, &media->dipole[k][c]);
            scale = fmin(scale, media->dipole[k][c].z_r);
        }
        prt_radial_table_fit(&media->table[k], prt_dipole_profile, media->dipole[k], scale,
                             (double)f->screen->diameter_mm);
    }
    job->medium = class->of;
    job->rho = (const float(*)[3]) class->rho;
    job->n_medium = f->report->n_medium = class->n;
    job->dipole = media->dipole;
    job->table = media->table;
    return PRT_OK;
}

static int make_media(struct frame *f, struct pixel_media *media, struct tangent_job *job)
{
    memset(media, 0, sizeof *media);
    job->n_medium = f->n_object ? f->n_object : 1;
    job->dipole = f->dipole;
    job->table = f->table;
    int status = maps_tint(f->options) ? make_classes(f, media, job) : PRT_OK;
    if (status) return status;
    job->inv_rho = calloc(job->n_medium + 1, sizeof *job->inv_rho);
    if (!job->inv_rho) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t o = 0; o < job->n_medium; o++)
        for (int c = 0; c < 3; c++)
            job->inv_rho[o][c] = (float)(1 / (3 * fmax(job->dipole[o][c].rho_d, 1e-9)));
    return PRT_OK;
}

static void pixel_media_finish(struct pixel_media *media)
{
    prt_media_finish(&media->classes);
    free(media->dipole);
    prt_free(media->table);
}

static void set_kernel(const struct frame *f, struct tangent_job *job)
{
    job->run = run_c;
#if PRT_ISA_X86
    unsigned cpu = f->ctx ? f->ctx->cpu : prt_cpu_detect();
    if (cpu & PRT_CPU_AVX2) job->run = run_avx2;
    if (cpu & PRT_CPU_AVX512) job->run = run_avx512;
#endif
    // scaled so that a dot product with right and up gives image coordinates
    float tx = 0, ty = 0;
    for (int k = 0; k < 3; k++) {
        tx += job->right[k] * job->right[k];
        ty += job->up[k] * job->up[k];
    }
    for (int k = 0; k < 3; k++) {
        job->right[k] /= tx;
        job->up[k] /= ty;
    }
    job->slack = 8 * sqrtf(ty) / (float)f->height;
}

// Adds hidden surface, then the samples of every point; view and media are complete.
static int sample_view(struct frame *f, struct tangent_job *job)
{
    struct tangent_view *view = &f->screen->tangent;
    struct seen *record = prt_alloc((size_t)f->g.n_point + 1, sizeof *record);
    if (!record) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    struct pack_job pack = {view, job, record};
    job->seen = record;
    int status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 2048, pack_points, &pack);
    if (!status && !make_patterns(job, f, view->area_cdf))
        status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for samples");
    if (!status) status = prt_receivers_begin(f, (double)prt_frame_mean_free_path(f));
    if (!status) status = prt_tangent_hidden(f, job, &view->seen);
    if (!status) status = prt_receivers_resolve(f);
    if (!status) {
        struct tangent_job projected = *job;
        set_kernel(f, &projected);
        status = prt_tangent_sample(f, &projected, &view->seen);
    }
    prt_free(record);
    return status;
}

int prt_engine_tangent(struct frame *f)
{
    enum { DEFAULT_SAMPLES = 64, MOST_SAMPLES = 4096 }; // a pixel; chosen, not measured
    struct tangent_job job = {.width = f->width, .height = f->height, .radiance = f->radiance};
    uint32_t n = f->report->n_asked = prt_frame_samples(f, DEFAULT_SAMPLES, MOST_SAMPLES);
    job.n_uniform = n / 4;
    job.n_tangent = n - job.n_uniform;
    prt_visibility_frame(f->vis, job.eye, job.forward, job.right, job.up);
    double t0 = prt_time_s();
    int status = prt_tangent_view_get(f, &job);
    if (status) return status;
    struct tangent_view *view = &f->screen->tangent;
    struct pixel_media media = {.dipole = NULL};
    job.variant = view->variant;
    job.needed = view->needed;
    job.point_of = view->point_of;
    job.visible_area = (float)view->area_cdf[f->g.n_point];
    for (int k = 0; k < 3; k++) job.face[k] = view->seen.face[k];
    status = prt_frame_irradiance(f, &view->seen);
    double t1 = prt_time_s();
    if (!status) status = make_media(f, &media, &job);
    if (!status && job.visible_area > 0) {
        status = sample_view(f, &job);
        f->report->n_pair += (uint64_t)f->g.n_point * n;
    }
    job_finish(&job);
    pixel_media_finish(&media);
    f->report->irradiance_s = t1 - t0;
    f->report->scatter_s = prt_time_s() - t1;
    f->report->n_sample = n;
    return status;
}
