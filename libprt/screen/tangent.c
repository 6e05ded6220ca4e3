// SPDX-License-Identifier: MIT
// M03: each pixel draws points of its tangent plane in proportion to R_d, finds them in the
// eye's irradiance image, and shares the work with uniform samples by the balance heuristic.
// What the eye does not see is added from points that the light sees.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LANES = 64, VARIANTS = 16 };

double prt_screen_tangent_radius(const struct prt_dipole d[3], double xi, double from_mm)
{
    // M03 picks one term of one channel and solves for it; the mean of the channels' closed-form
    // tails is solved here at once, so that one stratified number stratifies the radius
    double want = 1 - xi, lo = from_mm, hi = fmax(2 * from_mm, d[0].z_r), r;
    double inv[3];
    for (int c = 0; c < 3; c++) inv[c] = d[c].rho_d > 0 ? 1 / (3 * d[c].rho_d) : 0;
    for (int k = 0; k < 200; k++, hi *= 2) {
        double g = 0;
        for (int c = 0; c < 3; c++) g += inv[c] * prt_dipole_tail(&d[c], hi);
        if (g <= want) break;
        lo = hi;
    }
    r = (lo + hi) / 2;
    for (int k = 0; k < 60; k++) {
        double g = 0, slope = 0;
        for (int c = 0; c < 3; c++) {
            g += inv[c] * prt_dipole_tail(&d[c], r);
            slope += inv[c] * 2 * M_PI * r * prt_dipole_rd(&d[c], r);
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

// One of the 4x4 interleaved sets of samples.
struct pattern {
    float *cosine, *sine;      // [n_tangent]
    float **radius, **density; // [object][n_tangent] mm, mm^-2
    uint32_t *uniform;         // [n_uniform] G-buffer points
};

// What a sample reads of the point it lands on, in a cache line.
struct seen {
    float p[3];
    uint32_t object;
    float n[3];
    float plane;        // (p - eye).n
    float e[3];
    float depth;        // (p - eye) along the view
};

struct tangent_job {
    const struct seen *seen;   // [n_point]
    const float *face[3];
    const uint8_t *opaque;
    uint8_t *variant;
    uint32_t *point_of;        // [pixel] or UINT32_MAX
    const struct radial_table *table;
    float (*inv_rho)[3];       // [object] 1 / (3 rho_d)
    struct pattern pattern[VARIANTS];
    uint32_t n_tangent, n_uniform, width, height;
    float visible_area, slack, eye[3], forward[3], right[3], up[3];
    float (*radiance)[3];
    void (*run)(const struct tangent_job *job, size_t begin, size_t end);
};

#define KERNEL(name) name##_c
#define TARGET
#include "tangent_kernel.h"
#undef KERNEL
#undef TARGET
#if defined(__x86_64__)
#define KERNEL(name) name##_avx2
#define TARGET __attribute__((target("avx2,fma")))
#include "tangent_kernel.h"
#undef KERNEL
#undef TARGET
#define KERNEL(name) name##_avx512
#define TARGET __attribute__((target("avx512f,avx512bw,avx512dq,avx512vl,avx2,fma")))
#include "tangent_kernel.h"
#undef KERNEL
#undef TARGET
#endif

static int run_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tangent_job *job = arg;
    job->run(job, begin, end);
    return PRT_OK;
}

// The G-buffer as samples, so that irradiance can be computed on it.
static bool seen_samples(const struct frame *f, struct samples *s)
{
    const struct prt_gbuffer *g = &f->g;
    const struct prt_mesh *mesh = f->screen->mesh;
    if (!samples_init(s, g->n_point)) return false;
    s->n = g->n_point;
    for (uint32_t i = 0; i < g->n_point; i++) {
        const uint32_t *v = mesh->triangle[g->triangle[i]];
        float e[2][3], n[3], l = 0, facing = 0;
        for (int k = 0; k < 3; k++) {
            e[0][k] = mesh->position[v[1]][k] - mesh->position[v[0]][k];
            e[1][k] = mesh->position[v[2]][k] - mesh->position[v[0]][k];
            s->p[k][i] = g->position[k][i];
            s->normal[k][i] = g->normal[k][i];
        }
        for (int k = 0; k < 3; k++) {
            int a = (k + 1) % 3, b = (k + 2) % 3;
            n[k] = e[0][a] * e[1][b] - e[0][b] * e[1][a];
            l += n[k] * n[k];
            facing += n[k] * g->normal[k][i];
        }
        l = l > 0 ? (facing < 0 ? -1 : 1) / sqrtf(l) : 0;
        for (int k = 0; k < 3; k++) s->face[k][i] = n[k] * l;
        s->object[i] = mesh->block[g->block[i]].object;
    }
    return true;
}

static void finish(struct tangent_job *job, uint32_t n_object)
{
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
    free(job->variant);
    free(job->point_of);
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

// Radii at equal steps of the mixture's distribution on a golden-angle spiral; the variants'
// steps interleave and their spirals are turned.
static bool make_patterns(struct tangent_job *job, const struct frame *f, const double *area_cdf)
{
    uint32_t n = job->n_tangent, total = n * VARIANTS;
    struct prt_rng rng;
    prt_rng_init(&rng, f->seed, 100);
    for (uint32_t v = 0; v < VARIANTS; v++) {
        struct pattern *p = &job->pattern[v];
        p->cosine = malloc((n + 1) * sizeof(float));
        p->sine = malloc((n + 1) * sizeof(float));
        p->uniform = malloc((job->n_uniform + 1) * sizeof(uint32_t));
        p->radius = calloc(f->n_object, sizeof *p->radius);
        p->density = calloc(f->n_object, sizeof *p->density);
        if (!p->cosine || !p->sine || !p->uniform || !p->radius || !p->density) return false;
        double turn = radical_inverse(2, v) + (double)prt_rng_f32(&rng);
        for (uint32_t i = 0; i < n; i++) {
            double phi = 2 * M_PI * (i * 0.3819660112501051 + turn);
            p->cosine[i] = (float)cos(phi);
            p->sine[i] = (float)sin(phi);
        }
        for (uint32_t o = 0; o < f->n_object; o++) {
            p->radius[o] = malloc((n + 1) * sizeof(float));
            p->density[o] = malloc((n + 1) * sizeof(float));
            if (!p->radius[o] || !p->density[o]) return false;
        }
        for (uint32_t i = 0; i < job->n_uniform; i++) {
            double u = (i * VARIANTS + v + (double)prt_rng_f32(&rng)) /
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
    for (uint32_t o = 0; o < f->n_object; o++) {
        double r = 0;
        for (uint32_t k = 0; k < total; k++) {
            struct pattern *p = &job->pattern[k * 7 % VARIANTS];
            float at[3], density = 0;
            r = prt_screen_tangent_radius(f->dipole[o], (k + 0.5) / total, r);
            radial_table_eval(&f->table[o], (float)(r * r), at);
            for (int c = 0; c < 3; c++) density += job->inv_rho[o][c] * at[c];
            p->radius[o][k / VARIANTS] = (float)r;
            p->density[o][k / VARIANTS] = density;
        }
    }
    return true;
}

// Surface area behind each visible translucent point, running: its pixel's share of solid angle.
static double *visible_areas(const struct frame *f, const struct tangent_job *job,
                             const struct samples *s)
{
    double *cdf = malloc(((size_t)f->g.n_point + 1) * sizeof *cdf);
    if (!cdf) return NULL;
    double tan_x = 0, tan_y = 0;
    for (int k = 0; k < 3; k++) {
        tan_x += (double)job->right[k] * job->right[k];
        tan_y += (double)job->up[k] * job->up[k];
    }
    double pixel = 4 * sqrt(tan_x * tan_y) / ((double)f->width * f->height);
    cdf[0] = 0;
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        double z = 0, d2 = 0, c = 0;
        for (int k = 0; k < 3; k++) {
            double v = (double)s->p[k][i] - job->eye[k];
            z += v * job->forward[k];
            d2 += v * v;
            c += v * s->face[k][i];
        }
        // only the point a pixel is known by can be drawn, with all of the pixel's area
        bool own = job->point_of[f->g.pixel[i]] == i;
        double area = own ? pixel * z * z * z / fmax(fabs(c), 0.02 * sqrt(d2)) : 0;
        cdf[i + 1] = cdf[i] + (area > 0 && isfinite(area) ? area : 0);
    }
    return cdf;
}

// The point that stands for each pixel: the heaviest translucent one.
static bool map_pixels(const struct frame *f, struct tangent_job *job)
{
    size_t n = (size_t)f->width * f->height;
    job->point_of = malloc((n + 1) * sizeof *job->point_of);
    job->variant = malloc(f->g.n_point + 1);
    if (!job->point_of || !job->variant) return false;
    memset(job->point_of, 0xff, n * sizeof *job->point_of);
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        uint32_t pixel = f->g.pixel[i], *at = &job->point_of[pixel];
        job->variant[i] = (uint8_t)(pixel / f->width % 4 * 4 + pixel % f->width % 4);
        if (f->g.opaque[i]) continue;
        if (*at == UINT32_MAX || f->g.weight[i] > f->g.weight[*at]) *at = i;
    }
    return true;
}

struct filter_job {
    const struct frame *f;
    const struct tangent_job *tangent;
    const float (*in)[3];
    float reach_sq;
};

// Interleaved samples are put together again: each of the 16 variants weighs the same in a 5x5
// window whose rim counts half. Only pixels on the same patch of surface take part.
static int filter_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct filter_job *job = arg;
    const struct frame *f = job->f;
    const struct tangent_job *t = job->tangent;
    int width = (int)f->width, height = (int)f->height;
    for (size_t i = begin; i < end; i++) {
        if (f->g.opaque[i]) continue;
        int x = (int)(f->g.pixel[i] % f->width), y = (int)(f->g.pixel[i] / f->width);
        float sum[3] = {0, 0, 0}, total = 0;
        for (int dy = -2; dy <= 2; dy++) {
            if (y + dy < 0 || y + dy >= height) continue;
            for (int dx = -2; dx <= 2; dx++) {
                if (x + dx < 0 || x + dx >= width) continue;
                uint32_t j = t->point_of[(y + dy) * width + x + dx];
                if (!dx && !dy) j = (uint32_t)i;
                if (j == UINT32_MAX || t->seen[j].object != t->seen[i].object) continue;
                float d2 = 0, c = 0;
                for (int k = 0; k < 3; k++) {
                    float e = t->seen[j].p[k] - t->seen[i].p[k];
                    d2 += e * e;
                    c += f->g.normal[k][i] * f->g.normal[k][j];
                }
                if (d2 > job->reach_sq || c < 0.8f) continue;
                float w = (abs(dx) == 2 ? 0.5f : 1) * (abs(dy) == 2 ? 0.5f : 1);
                for (int k = 0; k < 3; k++) sum[k] += w * job->in[j][k];
                total += w;
            }
        }
        for (int k = 0; k < 3; k++) f->radiance[i][k] += sum[k] / total;
    }
    return PRT_OK;
}

static int sample_and_filter(struct frame *f, struct tangent_job *job)
{
    float(*own)[3] = prt_calloc((size_t)f->g.n_point + 1, sizeof *own);
    if (!own) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    job->radiance = own;
    int status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 256, run_points, job);
    float scale = smallest_mean_free_path(f);
    struct filter_job filter = {f, job, (const float(*)[3])own, scale * scale};
    if (!status) status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 1024, filter_points, &filter);
    prt_free(own);
    return status;
}

// Darkens samples that the eye's image holds.
static void keep_hidden(const struct frame *f, const struct tangent_job *job,
                        const struct samples *seen, struct samples *s)
{
    float tan_x = 0, tan_y = 0;
    for (int k = 0; k < 3; k++) {
        tan_x += job->right[k] * job->right[k];
        tan_y += job->up[k] * job->up[k];
    }
    for (uint32_t i = 0; i < s->n; i++) {
        float rel[3], w = 0, u = 0, v = 0, d2 = 0, facing = 0;
        for (int k = 0; k < 3; k++) {
            rel[k] = s->p[k][i] - job->eye[k];
            w += rel[k] * job->forward[k];
            u += rel[k] * job->right[k];
            v += rel[k] * job->up[k];
            d2 += rel[k] * rel[k];
            facing += rel[k] * s->face[k][i];
        }
        if (!(w > 0)) continue;
        float px = (1 + u / (tan_x * w)) * 0.5f * (float)f->width;
        float py = (1 - v / (tan_y * w)) * 0.5f * (float)f->height;
        if (!(px >= 0 && px < (float)f->width && py >= 0 && py < (float)f->height)) continue;
        uint32_t j = job->point_of[(uint32_t)py * f->width + (uint32_t)px];
        if (j == UINT32_MAX || seen->object[j] != s->object[i]) continue;
        // on the plane that the pixel shows, or nearly
        float off = 0, far = 0, d = sqrtf(d2), pixel = 2 * sqrtf(tan_y) * w / (float)f->height;
        for (int k = 0; k < 3; k++) {
            float e = s->p[k][i] - seen->p[k][j];
            off += e * seen->face[k][j];
            far += e * e;
        }
        if (facing < 0 && fabsf(off) < pixel && far < 100 * pixel * pixel && d > 0)
            s->e[0][i] = s->e[1][i] = s->e[2][i] = 0;
    }
}

// Light from what the eye does not see, through the light's view or the atlas.
static int hidden_part(struct frame *f, const struct tangent_job *job, const struct samples *seen)
{
    float lu = smallest_mean_free_path(f), far = 4 * f->screen->diameter_mm;
    if (!only_light_views(f)) {
        double texels = f->screen->area_mm2 / (0.5 * (double)lu * lu);
        int status = frame_atlas(f, texels < 8192 ? 8192 : texels > 65536 ? 65536 : (uint32_t)texels);
        if (status) return status;
        keep_hidden(f, job, seen, &f->screen->atlas);
        return scatter_discs(f, &f->screen->atlas, -1, 0.8f, far);
    }
    float spacing = max_f(lu, f->screen->diameter_mm / 300);
    struct grid grid = frame_grid(f, spacing);
    for (uint32_t l = 0; l < f->n_light; l++) {
        struct samples s;
        uint32_t n_grid;
        int status = samples_light_view(f->ctx, f->screen->scene, &f->light[l], &grid, f->eta, &s,
                                        &n_grid, &f->report->n_ray);
        if (status) return status;
        keep_hidden(f, job, seen, &s);
        status = scatter_discs(f, &s, -1, 0.8f, far);
        samples_finish(&s);
        if (status) return status;
    }
    return PRT_OK;
}

// What share of its pixel the object of point i covers: a sample that lands elsewhere in the
// pixel misses it.
static float coverage(const struct frame *f, const struct samples *s, uint32_t i)
{
    float sum = f->g.weight[i];
    for (uint32_t j = i; j-- > 0 && f->g.pixel[j] == f->g.pixel[i];)
        if (s->object[j] == s->object[i] && !f->g.opaque[j]) sum += f->g.weight[j];
    for (uint32_t j = i + 1; j < s->n && f->g.pixel[j] == f->g.pixel[i]; j++)
        if (s->object[j] == s->object[i] && !f->g.opaque[j]) sum += f->g.weight[j];
    return sum < 1 ? sum : 1;
}

static struct seen *pack_seen(const struct frame *f, const struct samples *s,
                              const struct tangent_job *job)
{
    struct seen *out = prt_alloc((size_t)s->n + 1, sizeof *out);
    for (uint32_t i = 0; out && i < s->n; i++) {
        struct seen *q = &out[i];
        float share = coverage(f, s, i);
        q->plane = q->depth = 0;
        for (int k = 0; k < 3; k++) {
            float v = s->p[k][i] - job->eye[k];
            q->p[k] = s->p[k][i];
            q->e[k] = s->e[k][i] * share;
            q->n[k] = s->face[k][i];
            q->plane += v * s->face[k][i];
            q->depth += v * job->forward[k];
        }
        q->object = s->object[i];
    }
    return out;
}

int engine_tangent(struct frame *f)
{
    struct tangent_job job = {.width = f->width, .height = f->height, .table = f->table,
                              .opaque = f->g.opaque, .radiance = f->radiance};
    uint32_t n = f->report->n_asked = frame_samples(f, 64, 4096);
    job.n_uniform = n / 4;
    job.n_tangent = n - job.n_uniform;
    prt_visibility_frame(f->vis, job.eye, job.forward, job.right, job.up);
    struct samples seen;
    double t0 = prt_time_s(), t1 = t0;
    double *cdf = NULL;
    struct seen *record = NULL;
    if (!seen_samples(f, &seen)) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    int status = irradiance_traced(f->ctx, f->screen->scene, f->n_light, f->light, f->eta, &seen,
                                   &f->report->n_ray);
    t1 = prt_time_s();
    job.inv_rho = calloc(f->n_object ? f->n_object : 1, sizeof *job.inv_rho);
    bool good = !status && job.inv_rho && map_pixels(f, &job);
    if (good) {
        for (uint32_t o = 0; o < f->n_object; o++)
            for (int c = 0; c < 3; c++) job.inv_rho[o][c] = (float)(1 / (3 * f->dipole[o][c].rho_d));
        for (int k = 0; k < 3; k++) job.face[k] = seen.face[k];
        job.seen = record = pack_seen(f, &seen, &job);
        cdf = record ? visible_areas(f, &job, &seen) : NULL;
        good = cdf != NULL;
    }
    if (good && cdf[f->g.n_point] > 0) {
        job.visible_area = (float)cdf[f->g.n_point];
        good = make_patterns(&job, f, cdf);
        // right and up give the image's coordinates by a plain dot product
        struct tangent_job projected = job;
        float tx = 0, ty = 0;
        for (int k = 0; k < 3; k++) {
            tx += job.right[k] * job.right[k];
            ty += job.up[k] * job.up[k];
        }
        for (int k = 0; k < 3; k++) {
            projected.right[k] = job.right[k] / tx;
            projected.up[k] = job.up[k] / ty;
        }
        projected.slack = 8 * sqrtf(ty) / (float)f->height;
        projected.run = run_c;
#if defined(__x86_64__)
        unsigned cpu = f->ctx ? f->ctx->cpu : prt_cpu_detect();
        if (cpu & PRT_CPU_AVX2) projected.run = run_avx2;
        if (cpu & PRT_CPU_AVX512) projected.run = run_avx512;
#endif
        if (good) status = sample_and_filter(f, &projected);
        f->report->n_pair += (uint64_t)f->g.n_point * n;
        if (good && !status) status = receive_begin(f, (double)smallest_mean_free_path(f));
        if (good && !status) status = hidden_part(f, &job, &seen);
        if (good && !status) status = receive_end(f);
    }
    if (!good && !status) status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for samples");
    free(cdf);
    prt_free(record);
    finish(&job, f->n_object);
    samples_finish(&seen);
    f->report->irradiance_s = t1 - t0;
    f->report->scatter_s = prt_time_s() - t1;
    f->report->n_sample = n;
    return status;
}
