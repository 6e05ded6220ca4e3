// SPDX-License-Identifier: MIT
// M03: each pixel draws points of its tangent plane in proportion to R_d, finds them in the
// eye's irradiance image, and shares the work with uniform samples by the balance heuristic.
// What the eye does not see is added from points that the light sees.
#include "internal.h"

#include "base/isa.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { LANES = 64, VARIANTS = 16 };
// A pixel that meets the surface at a more grazing angle shows too much of it to be a plane.
#define LEAST_COSINE 0.2f

double prt_screen_tangent_radius(const struct prt_diffusion d[3], double xi, double from_mm)
{
    // M03 picks one term of one channel and solves for it; the mean of the channels'
    // closed-form tails is solved here at once, so that one stratified number stratifies the
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

// One of the 4x4 interleaved sets of samples.
struct pattern {
    float *cosine, *sine;      // [n_tangent]
    float **radius, **density; // [medium][n_tangent] mm, mm^-2
    uint32_t *uniform;         // [n_uniform] G-buffer points
};

// What a sample reads of the point it lands on, in a cache line.
struct seen {
    float p[3];
    uint32_t object;
    float n[3];
    float plane; // (p - eye).n
    float e[3];
    float depth; // (p - eye) along the view
};

struct tangent_job {
    const struct seen *seen; // [n_point]
    const float *face[3];
    const uint8_t *needed, *variant, *medium; // [n_point]; medium NULL: the object's
    const uint32_t *point_of;                 // [pixel] or UINT32_MAX
    const struct radial_table *table;         // [medium]
    struct prt_diffusion (*dipole)[3];
    float (*inv_rho)[3];   // [medium] 1 / (3 rho_d)
    const float (*rho)[3]; // [n_point] rho_d of the point's own medium; NULL without maps
    uint32_t n_medium;
    struct pattern pattern[VARIANTS];
    uint32_t n_tangent, n_uniform, width, height;
    float visible_area, slack, eye[3], forward[3], right[3], up[3];
    float (*radiance)[3];
    void (*run)(const struct tangent_job *job, size_t begin, size_t end);
};

#define PRT_ISA_NAME c
#include "tangent_kernel.h"
#undef PRT_ISA_NAME
#if PRT_ISA_X86
PRT_ISA_BEGIN(PRT_ISA_AVX2)
#define PRT_ISA_NAME avx2
#include "tangent_kernel.h"
#undef PRT_ISA_NAME
PRT_ISA_END
PRT_ISA_BEGIN(PRT_ISA_AVX512)
#define PRT_ISA_NAME avx512
#define RADIAL_PERMUTE
#include "tangent_kernel.h"
#undef RADIAL_PERMUTE
#undef PRT_ISA_NAME
PRT_ISA_END
#endif

static int run_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tangent_job *job = arg;
    job->run(job, begin, end);
    return PRT_OK;
}

static void finish(struct tangent_job *job)
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

void prt_tangent_view_finish(struct tangent_view *v)
{
    prt_samples_finish(&v->seen);
    free(v->point_of);
    free(v->variant);
    free(v->needed);
    free(v->readable);
    free(v->area_cdf);
    memset(v, 0, sizeof *v);
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
    uint32_t frame; // of a running mean: each pixel gets every variant in turn
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

// Golden-angle spirals, each variant's turned; uniform points at equal steps of visible area.
static bool make_patterns(struct tangent_job *job, const struct frame *f,
                          const double *area_cdf)
{
    uint32_t n = job->n_tangent;
    struct prt_rng rng;
    // frames of a running mean go on with one sequence: a pixel's angles and uniform samples
    // fill the gaps that those before left, where new random ones would leave their noise in
    // the mean
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

// Surface area behind each visible translucent point, running: its pixel's share of solid
// angle.
static double *visible_areas(const struct frame *f, const struct tangent_job *job,
                             const struct tangent_view *view)
{
    const struct samples *s = &view->seen;
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
        // only what can be read is drawn, with all of the pixel's area
        bool own = view->readable[i];
        double area = own ? pixel * z * z * z / fmax(fabs(c), 0.02 * sqrt(d2)) : 0;
        cdf[i + 1] = cdf[i] + (area > 0 && isfinite(area) ? area : 0);
    }
    return cdf;
}

// Close enough on one patch of surface to share light.
static bool alike(const struct frame *f, const struct samples *s, uint32_t i, uint32_t j,
                  float reach_sq)
{
    float d2 = 0, c = 0;
    if (s->object[i] != s->object[j]) return false;
    for (int k = 0; k < 3; k++) {
        float e = s->p[k][j] - s->p[k][i];
        d2 += e * e;
        c += f->g.normal[k][i] * f->g.normal[k][j];
    }
    return d2 <= reach_sq && c >= 0.8f;
}

// The point that stands for each pixel: the heaviest translucent one.
static bool map_pixels(const struct frame *f, struct tangent_view *v)
{
    size_t n = (size_t)f->width * f->height;
    v->point_of = malloc((n + 1) * sizeof *v->point_of);
    v->variant = malloc(f->g.n_point + 1);
    v->needed = malloc(f->g.n_point + 1);
    if (!v->point_of || !v->variant || !v->needed) return false;
    memset(v->point_of, 0xff, n * sizeof *v->point_of);
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        uint32_t pixel = f->g.pixel[i], *at = &v->point_of[pixel];
        v->variant[i] = (uint8_t)(pixel / f->width % 4 * 4 + pixel % f->width % 4);
        if (f->g.opaque[i]) continue;
        if (*at == UINT32_MAX || f->g.weight[i] > f->g.weight[*at]) *at = i;
    }
    // a pixel's other points take its light where they lie on the same patch
    float pixel = prt_view_pixel_mm(f->vis);
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        uint32_t own = v->point_of[f->g.pixel[i]];
        v->needed[i] =
            !f->g.opaque[i] && (own == i || !alike(f, &v->seen, i, own, 4 * pixel * pixel));
    }
    return true;
}

struct filter_job {
    const struct frame *f;
    const struct tangent_job *tangent;
    const struct samples *seen;
    const float (*in)[3];
    float reach_sq;
    int half;
};

// Interleaved samples are put together again: each of the 16 variants weighs the same in a 5x5
// window whose rim counts half. Only pixels on the same patch of surface take part. Later
// frames of a running mean need less of it.
static int filter_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct filter_job *job = arg;
    const struct frame *f = job->f;
    const struct tangent_job *t = job->tangent;
    const struct samples *s = job->seen;
    int width = (int)f->width, height = (int)f->height, half = job->half;
    for (size_t i = begin; i < end; i++) {
        if (f->g.opaque[i]) continue;
        int x = (int)(f->g.pixel[i] % f->width), y = (int)(f->g.pixel[i] / f->width);
        uint32_t own = t->needed[i] ? (uint32_t)i : t->point_of[f->g.pixel[i]];
        float sum[3] = {0, 0, 0}, total = 0;
        for (int dy = -half; dy <= half; dy++) {
            if (y + dy < 0 || y + dy >= height) continue;
            for (int dx = -half; dx <= half; dx++) {
                if (x + dx < 0 || x + dx >= width) continue;
                uint32_t j = t->point_of[(y + dy) * width + x + dx];
                if (!dx && !dy) j = own;
                if (j == UINT32_MAX) continue;
                if (j != own) {
                    if (!alike(f, s, (uint32_t)i, j, job->reach_sq)) continue;
                }
                float w = (abs(dx) == 2 ? 0.5f : 1) * (abs(dy) == 2 ? 0.5f : 1);
                for (int k = 0; k < 3; k++) sum[k] += w * job->in[j][k];
                total += w;
            }
        }
        for (int k = 0; k < 3; k++)
            f->radiance[i][k] = sum[k] / total * (t->rho ? t->rho[i][k] : 1);
    }
    return PRT_OK;
}

// With maps light is filtered per total reflectance: media differ from point to point, and each
// has its own colour. What came from elsewhere was summed with the object's plain medium.
static void per_reflectance(const struct frame *f, const struct tangent_job *job,
                            const struct samples *seen, bool plain, float (*rgb)[3])
{
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        if (f->g.opaque[i]) continue;
        for (int c = 0; c < 3; c++) {
            float class_rho = 1 / (3 * job->inv_rho[job->medium[i]][c]);
            float rho = (float)f->dipole[seen->object[i]][c].rho_d;
            rgb[i][c] *= plain ? class_rho / max_f(rho, 1e-9f) : 1 / max_f(class_rho, 1e-9f);
        }
    }
}

static int sample_and_filter(struct frame *f, struct tangent_job *job,
                             const struct samples *seen)
{
    float(*own)[3] = prt_alloc((size_t)f->g.n_point + 1, sizeof *own);
    if (!own) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    // filtered with what comes from elsewhere: where one begins the other ends
    memcpy(own, f->radiance, f->g.n_point * sizeof *own);
    if (job->rho) per_reflectance(f, job, seen, true, own);
    job->radiance = own;
    int status = prt_screen_loop(f->ctx, f->g.n_point, 256, run_points, job);
    if (job->rho) per_reflectance(f, job, seen, false, own);
    float scale = prt_frame_mean_free_path(f);
    uint64_t n = (uint64_t)(job->n_tangent + job->n_uniform) * (f->options->frame + 1);
    int half = n < 256 ? 2 : n < 1024 ? 1 : 0;
    // the pattern repeats after four pixels, however short light's way is
    float least = max_f(scale, 3 * prt_view_pixel_mm(f->vis));
    struct filter_job filter = {f, job, seen, (const float(*)[3])own, least * least, half};
    if (!status)
        status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 1024, filter_points, &filter);
    prt_free(own);
    return status;
}

struct hidden_job {
    const struct frame *f;
    const struct tangent_job *job;
    const struct samples *seen;
    const uint8_t *readable;
    struct samples *s;
};

// Darkens samples that the eye's image holds.
static int hide_seen(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct hidden_job *h = arg;
    const struct frame *f = h->f;
    const struct tangent_job *job = h->job;
    const struct samples *seen = h->seen;
    struct samples *s = h->s;
    float tan_x = 0, tan_y = 0;
    for (int k = 0; k < 3; k++) {
        tan_x += job->right[k] * job->right[k];
        tan_y += job->up[k] * job->up[k];
    }
    for (size_t i = begin; i < end; i++) {
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
        if (j == UINT32_MAX || !h->readable[j] || seen->object[j] != s->object[i]) continue;
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
    return PRT_OK;
}

static int keep_hidden(const struct frame *f, const struct tangent_job *job,
                       const struct samples *seen, struct samples *s)
{
    struct hidden_job hidden = {f, job, seen, f->screen->tangent.readable, s};
    return prt_parallel_for(f->ctx, NULL, s->n, 1024, hide_seen, &hidden);
}

// Light from what the eye does not see, through the light's view or the atlas.
static int hidden_part(struct frame *f, const struct tangent_job *job,
                       const struct samples *seen)
{
    float lu = prt_frame_mean_free_path(f), far = 4 * f->screen->diameter_mm;
    if (!prt_frame_light_views_only(f)) {
        double texels = f->screen->area_mm2 / (0.5 * (double)lu * lu);
        int status = prt_frame_atlas(f, texels < 8192    ? 8192
                                        : texels > 65536 ? 65536
                                                         : (uint32_t)texels);
        if (status) return status;
        status = keep_hidden(f, job, seen, &f->screen->atlas);
        return status ? status : prt_scatter_discs(f, &f->screen->atlas, -1, 0.8f, far);
    }
    float spacing = max_f(lu, f->screen->diameter_mm / 300);
    struct grid grid = prt_frame_grid(f, spacing);
    for (uint32_t l = 0; l < f->n_light; l++) {
        struct samples s;
        int status = prt_frame_light_view(f, l, &grid, &s);
        if (status) return status;
        status = keep_hidden(f, job, seen, &s);
        if (!status) status = prt_scatter_discs(f, &s, -1, 0.8f, far);
        prt_samples_finish(&s);
        if (status) return status;
    }
    return PRT_OK;
}

// Whether the plane of point i is all that its pixel shows of the surface: the pixel is full of
// one smooth patch that goes on in its neighbours and does not graze the view. Light on the
// surface of other pixels comes from points that the light sees, so that none counts twice or
// not at all.
static bool readable(const struct frame *f, const struct tangent_job *job,
                     const struct tangent_view *v, uint32_t i)
{
    const struct samples *s = &v->seen;
    uint32_t pixel = f->g.pixel[i], x = pixel % f->width, y = pixel / f->width;
    if (f->g.opaque[i] || v->point_of[pixel] != i || f->g.weight[i] < 0.99f) return false;
    float along = 0, far = 0, depth = 0, tan_y = 0;
    for (int k = 0; k < 3; k++) {
        float d = s->p[k][i] - job->eye[k];
        along += d * s->face[k][i];
        far += d * d;
        depth += d * job->forward[k];
        tan_y += job->up[k] * job->up[k];
    }
    if (!(fabsf(along) > LEAST_COSINE * sqrtf(far))) return false;
    float reach = 8 * 2 * sqrtf(tan_y) * depth / (float)f->height;
    for (int k = 0; k < 4; k++) {
        uint32_t nx = x + (k == 0) - (k == 1), ny = y + (k == 2) - (k == 3);
        if (nx >= f->width || ny >= f->height) continue;
        uint32_t j = v->point_of[ny * f->width + nx];
        if (j == UINT32_MAX || !alike(f, s, i, j, reach * reach)) return false;
    }
    return true;
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

// What stays while the view stays.
static int tangent_view_get(struct frame *f, const struct tangent_job *job)
{
    struct tangent_view *v = &f->screen->tangent;
    if (v->key == f->view_key && v->area_cdf) return PRT_OK;
    prt_tangent_view_finish(v);
    bool good = prt_visible_samples(f, f->g.n_point, NULL, &v->seen) && map_pixels(f, v);
    good = good && (v->readable = malloc((size_t)f->g.n_point + 1));
    for (uint32_t i = 0; good && i < f->g.n_point; i++) v->readable[i] = readable(f, job, v, i);
    good = good && (v->area_cdf = visible_areas(f, job, v));
    if (!good) {
        prt_tangent_view_finish(v);
        return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for a view");
    }
    v->key = f->view_key;
    return PRT_OK;
}

// A medium for each object, or with maps for each set of like factors.
struct mix {
    struct media media;
    struct prt_diffusion (*dipole)[3];
    struct radial_table *table;
};

static int make_mix(struct frame *f, struct mix *mix, struct tangent_job *job)
{
    memset(mix, 0, sizeof *mix);
    job->n_medium = f->n_object ? f->n_object : 1;
    job->dipole = f->dipole;
    job->table = f->table;
    if (maps_tint(f->options)) {
        int status = prt_map_media(f, &mix->media);
        if (status) return status;
        uint32_t n = mix->media.n ? mix->media.n : 1;
        mix->dipole = calloc(n, sizeof *mix->dipole);
        mix->table = prt_calloc(n, sizeof *mix->table);
        if (!mix->dipole || !mix->table)
            return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
        for (uint32_t k = 0; k < mix->media.n; k++) {
            const struct prt_diffusion *base = f->dipole[mix->media.object[k]];
            const float *factor = mix->media.factor[k];
            double scale = INFINITY;
            for (int c = 0; c < 3; c++) {
                prt_map_medium(&base[c], factor, c, &mix->dipole[k][c]);
                scale = fmin(scale, mix->dipole[k][c].z_r);
            }
            prt_radial_table_fit(&mix->table[k], prt_dipole_profile, mix->dipole[k], scale,
                                 (double)f->screen->diameter_mm);
        }
        job->medium = mix->media.of;
        job->rho = (const float(*)[3])mix->media.rho;
        job->n_medium = mix->media.n;
        job->dipole = mix->dipole;
        job->table = mix->table;
        f->report->n_medium = mix->media.n;
    }
    job->inv_rho = calloc(job->n_medium + 1, sizeof *job->inv_rho);
    if (!job->inv_rho) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t o = 0; o < job->n_medium; o++)
        for (int c = 0; c < 3; c++)
            job->inv_rho[o][c] = (float)(1 / (3 * fmax(job->dipole[o][c].rho_d, 1e-9)));
    return PRT_OK;
}

static void mix_finish(struct mix *mix)
{
    prt_media_finish(&mix->media);
    free(mix->dipole);
    prt_free(mix->table);
}

static int pick_kernel(const struct frame *f, struct tangent_job *job)
{
    job->run = run_c;
#if PRT_ISA_X86
    unsigned cpu = f->ctx ? f->ctx->cpu : prt_cpu_detect();
    if (cpu & PRT_CPU_AVX2) job->run = run_avx2;
    if (cpu & PRT_CPU_AVX512) job->run = run_avx512;
#endif
    // right and up give the image's coordinates by a plain dot product
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
    return PRT_OK;
}

int prt_engine_tangent(struct frame *f)
{
    struct tangent_job job = {.width = f->width, .height = f->height, .radiance = f->radiance};
    uint32_t n = f->report->n_asked = prt_frame_samples(f, 64, 4096);
    job.n_uniform = n / 4;
    job.n_tangent = n - job.n_uniform;
    prt_visibility_frame(f->vis, job.eye, job.forward, job.right, job.up);
    double t0 = prt_time_s(), t1 = t0;
    struct tangent_view *view = &f->screen->tangent;
    struct mix mix;
    int status = tangent_view_get(f, &job);
    if (status) return status;
    struct samples *seen = &view->seen;
    job.variant = view->variant;
    job.needed = view->needed;
    job.point_of = view->point_of;
    for (int k = 0; k < 3; k++) job.face[k] = seen->face[k];
    status = prt_frame_irradiance(f, seen);
    t1 = prt_time_s();
    struct seen *record = status ? NULL : prt_alloc((size_t)f->g.n_point + 1, sizeof *record);
    if (!status && !record) status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    int made = make_mix(f, &mix, &job);
    if (!status) status = made;
    double area = view->area_cdf[f->g.n_point];
    if (!status && area > 0) {
        struct pack_job pack = {view, &job, record};
        job.seen = record;
        job.visible_area = (float)area;
        status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 2048, pack_points, &pack);
        if (!status && !make_patterns(&job, f, view->area_cdf))
            status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for samples");
        if (!status) status = prt_receivers_begin(f, (double)prt_frame_mean_free_path(f));
        if (!status) status = hidden_part(f, &job, seen);
        if (!status) status = prt_receivers_resolve(f);
        struct tangent_job projected = job;
        if (!status) status = pick_kernel(f, &projected);
        if (!status) status = sample_and_filter(f, &projected, seen);
        f->report->n_pair += (uint64_t)f->g.n_point * n;
    }
    prt_free(record);
    finish(&job);
    mix_finish(&mix);
    f->report->irradiance_s = t1 - t0;
    f->report->scatter_s = prt_time_s() - t1;
    f->report->n_sample = n;
    return status;
}
