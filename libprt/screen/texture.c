// SPDX-License-Identifier: MIT
// C08: points drawn from irradiance over an area-preserving atlas, the same for all pixels;
// hybrid: what lies near a pixel is summed densely, only the rest is drawn.
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static const double K = 1.5; // mm^-1, the split's steepness

double prt_screen_local_weight(double r_mm, double r_p_mm)
{
    // METHODS §7: the printed sign of the exponent would not be continuous
    if (r_mm <= r_p_mm) return 1 - 0.5 * exp(K * (r_mm - r_p_mm));
    return 0.5 * exp(-K * (r_mm - r_p_mm));
}

double prt_screen_split_radius(const struct prt_dipole dipole[3], double bound)
{
    double last = 0;
    for (int c = 0; c < 3; c++) {
        for (int i = 1; i <= 4000; i++) {
            double r = 1e-3 * pow(1e6, i / 4000.0);
            if (2 * M_PI * r * prt_dipole_rd(&dipole[c], r) > bound) last = fmax(last, r);
        }
    }
    return last;
}

uint32_t prt_screen_mip_sample(const float *mip, uint32_t n, float u)
{
    uint32_t level = 0, size = n;
    const float *at = mip;
    while (size > 1) {
        at += size;
        size /= 4;
        level++;
    }
    double x = u * (double)at[0];
    uint32_t index = 0;
    while (level-- > 0) {
        size *= 4;
        at -= size;
        index *= 4;
        uint32_t last = index + 3;
        while (index < last && x >= at[index]) x -= at[index++];
        // rounding may step past the last texel with light
        while (index > (last & ~3u) && !(at[index] > 0)) index--;
    }
    return index;
}

// Values of texels [first, last) padded to a power of 4, then each coarser level.
static float *make_mip(const struct samples *s, uint32_t first, uint32_t last, uint32_t *n_out)
{
    uint32_t n = 1;
    while (n < last - first) n *= 4;
    float *mip = prt_calloc((size_t)n / 3 * 4 + 4, sizeof *mip), *at = mip;
    if (!mip) return NULL;
    for (uint32_t i = first; i < last; i++)
        mip[i - first] = (s->e[0][i] + s->e[1][i] + s->e[2][i]) * s->area[i];
    for (uint32_t size = n; size > 1; size /= 4) {
        float *next = at + size;
        for (uint32_t i = 0; i < size / 4; i++)
            next[i] = at[4 * i] + at[4 * i + 1] + at[4 * i + 2] + at[4 * i + 3];
        at = next;
    }
    *n_out = n;
    return mip;
}

// Radius of the disc a drawn point stands for: the lit area, evenly shared.
static double disc_radius(const struct samples *s, uint32_t object, uint32_t n)
{
    double sum = 0, square = 0;
    for (uint32_t i = 0; i < s->n; i++) {
        if (s->object[i] != object) continue;
        double e = (double)s->e[0][i] + s->e[1][i] + s->e[2][i];
        sum += e * s->area[i];
        square += e * e * s->area[i];
    }
    return square > 0 && n ? sqrt(sum * sum / square / n / M_PI) : 0;
}

// RUN neighbours along the curve make one point at their mean.
enum { RUN = 8 };
struct draw {
    float p[3], w[3];
};

static bool push_run(struct emitters *out, const struct draw *run, uint32_t n, float reach)
{
    float p[3] = {0, 0, 0}, w[3] = {0, 0, 0}, total = 0, far = 0;
    for (uint32_t i = 0; i < n; i++) {
        float power = run[i].w[0] + run[i].w[1] + run[i].w[2];
        for (int c = 0; c < 3; c++) {
            p[c] += power * run[i].p[c];
            w[c] += run[i].w[c];
        }
        total += power;
    }
    for (int c = 0; c < 3; c++) p[c] /= total;
    for (uint32_t i = 0; i < n; i++) {
        float d = 0;
        for (int c = 0; c < 3; c++) d += (run[i].p[c] - p[c]) * (run[i].p[c] - p[c]);
        far = max_f(far, d);
    }
    // the curve jumps now and then: what lies on both sides stays apart
    if (n > 1 && far > reach * reach)
        return push_run(out, run, n / 2, reach) && push_run(out, run + n / 2, n - n / 2, reach);
    if (!emitters_reserve(out, out->n + 1)) return false;
    emitters_push(out, p, w);
    return true;
}

// Low-discrepancy draws through the mip chain of texels [first, last), RUN to a point.
static int draw_object(struct frame *f, const float *mip, uint32_t n_mip, uint32_t first,
                       uint32_t last, uint32_t share, float shift, struct emitters *out)
{
    const struct samples *s = &f->screen->atlas;
    double own = mip[n_mip > 1 ? (size_t)(n_mip - 1) / 3 * 4 : 0];
    float reach = (float)(4 * disc_radius(s, s->object[first], share));
    struct draw run[RUN];
    uint32_t n_run = 0;
    out->n = 0;
    for (uint32_t i = 0; i < share * RUN; i++) {
        double u = (i + (double)shift) / ((double)share * RUN);
        uint32_t t = prt_screen_mip_sample(mip, n_mip, (float)u);
        float value = mip[t];
        t += first;
        if (t < last && value > 0) {
            // E'_total / N, coloured by the texel
            float k = (float)(own / share / RUN) * s->area[t] / value;
            struct draw *d = &run[n_run++];
            for (int c = 0; c < 3; c++) {
                d->p[c] = s->p[c][t];
                d->w[c] = s->e[c][t] * k;
            }
        }
        if (i % RUN != RUN - 1) continue;
        if (n_run && !push_run(out, run, n_run, reach))
            return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for %u samples", share);
        n_run = 0;
    }
    return PRT_OK;
}

// n points, shared by the objects, drawn from E' of the frame's atlas.
static int draw_emitters(struct frame *f, uint32_t n, struct emitters *list)
{
    const struct samples *s = &f->screen->atlas;
    double total = 0;
    for (uint32_t i = 0; i < s->n; i++)
        total += (double)(s->e[0][i] + s->e[1][i] + s->e[2][i]) * s->area[i];
    if (!(total > 0)) return PRT_OK;
    struct prt_rng rng;
    prt_rng_init(&rng, f->seed, 1);
    float shift = f->seed ? prt_rng_f32(&rng) : 0.5f;
    for (uint32_t first = 0, last; first < s->n; first = last) {
        uint32_t object = s->object[first], n_mip;
        last = first;
        while (last < s->n && s->object[last] == object) last++;
        float *mip = make_mip(s, first, last, &n_mip);
        if (!mip) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for mip levels");
        double own = mip[n_mip > 1 ? (size_t)(n_mip - 1) / 3 * 4 : 0];
        uint32_t share = (uint32_t)(n * (own / total) + 0.5);
        if (share < 16) share = 16;
        int status = PRT_OK;
        if (own > 0) {
            // runs that the curve's jumps split make more points than asked: ask for fewer
            status = draw_object(f, mip, n_mip, first, last, share, shift, &list[object]);
            if (!status && list[object].n > share + share / 16) {
                share = (uint32_t)((uint64_t)share * share / list[object].n) + 1;
                status = draw_object(f, mip, n_mip, first, last, share, shift, &list[object]);
            }
        }
        prt_free(mip);
        if (status) return status;
    }
    return PRT_OK;
}

// What a table is fitted to: R_d, its local or its global part, averaged over a disc.
struct split {
    profile_fn fn;   // three dipoles or a table, and its argument
    const void *profile;
    double r_p;      // < 0: no split
    bool local;
    double disc_mm;  // radius; 0: a point
};

static void split_profile(const void *arg, double r_mm, double out[3])
{
    enum { RINGS = 3, SPOKES = 5 };
    const struct split *s = arg;
    // far away a disc is a point
    int rings = s->disc_mm > 0.05 * r_mm ? RINGS : 0, n = rings ? rings * SPOKES : 1;
    for (int c = 0; c < 3; c++) out[c] = 0;
    for (int k = 0; k < n; k++) {
        double r = r_mm;
        if (rings) {
            double a = s->disc_mm * sqrt((k / SPOKES + 0.5) / RINGS);
            double phi = M_PI * (k % SPOKES + 0.5) / SPOKES; // the other half is its mirror
            r = sqrt(fmax(r * r + a * a - 2 * r * a * cos(phi), 0));
        }
        double w = 1;
        if (s->r_p >= 0) {
            w = prt_screen_local_weight(r, s->r_p);
            if (!s->local) w = 1 - w;
        }
        double rd[3];
        s->fn(s->profile, r, rd);
        for (int c = 0; c < 3; c++) out[c] += w * rd[c] / n;
    }
}

static double finest_scale(const struct prt_dipole *d)
{
    return fmin(d[0].z_r, fmin(d[1].z_r, d[2].z_r));
}

static struct radial_table *disc_tables(const struct frame *f, const struct emitters *list,
                                        double r_p)
{
    struct radial_table *table = prt_alloc(f->n_object ? f->n_object : 1, sizeof *table);
    for (uint32_t o = 0; table && o < f->n_object; o++) {
        double disc = disc_radius(&f->screen->atlas, o, list[o].n);
        struct split split = {prt_screen_dipole_profile, f->dipole[o], r_p, false, disc};
        if (f->options->profile) {
            split.fn = prt_screen_table_profile;
            split.profile = &f->options->profile[o];
        }
        radial_table_fit(&table[o], split_profile, &split, fmax(finest_scale(f->dipole[o]), disc),
                         f->screen->diameter_mm);
    }
    return table;
}

// The near part: every light-view point or texel within reach.
static int local_scatter(struct frame *f, double r_p, float spacing)
{
    struct radial_table *table = prt_alloc(f->n_object ? f->n_object : 1, sizeof *table);
    if (!table) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    float reach = (float)(r_p + 5 / K);
    for (uint32_t o = 0; o < f->n_object; o++) {
        struct split near = {prt_screen_dipole_profile, f->dipole[o], r_p, true, 0};
        radial_table_fit(&table[o], split_profile, &near, finest_scale(f->dipole[o]), reach);
    }
    int status = only_light_views(f) ? scatter_light_views(f, table, spacing, 0.7f, reach)
                                     : scatter_tree(f, table, &f->screen->atlas, 0.7f, reach);
    prt_free(table);
    return status;
}

int engine_texture(struct frame *f, bool hybrid)
{
    struct prt_screen *screen = f->screen;
    uint32_t n = f->report->n_asked = frame_samples(f, hybrid ? 900 : 2500, 16384);
    double texels = 16384, spacing = smallest_mean_free_path(f), r_p = -1;
    if (hybrid) {
        double bound = f->options->bound > 0 ? f->options->bound : 0.1;
        for (uint32_t o = 0; o < f->n_object; o++)
            r_p = fmax(r_p, prt_screen_split_radius(f->dipole[o], bound));
        // the near part wants points under a mean free path apart
        spacing = fmax(0.8 * spacing, (double)screen->diameter_mm / 300);
        spacing *= exp2(-0.25 * min_u(f->options->refine, 8));
        if (!only_light_views(f)) texels = screen->area_mm2 / (0.4 * spacing * spacing);
    }
    if (texels < 16.0 * n) texels = 16.0 * n;
    uint32_t size = texels < 16384 ? 16384 : texels > 262144 ? 262144 : (uint32_t)texels;
    double t0 = prt_time_s();
    int status = frame_atlas(f, size);
    f->report->irradiance_s = prt_time_s() - t0;
    t0 = prt_time_s();
    struct emitters *list = calloc(f->n_object ? f->n_object : 1, sizeof *list);
    struct radial_table *table = NULL;
    if (!status && !list) status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (!status) status = draw_emitters(f, n, list);
    for (uint32_t o = 0; !status && o < f->n_object; o++) f->report->n_sample += list[o].n;
    if (!status && !(table = disc_tables(f, list, r_p)))
        status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (!status) status = scatter_all(f, table, list);
    f->report->scatter_s = prt_time_s() - t0;
    if (!status && hybrid) {
        t0 = prt_time_s();
        double other = f->report->irradiance_s + f->report->scatter_s;
        status = local_scatter(f, r_p, (float)spacing);
        double own = f->report->irradiance_s + f->report->scatter_s - other;
        f->report->scatter_s += prt_time_s() - t0 - own;
        f->report->r_p_mm = (float)r_p;
    }
    prt_free(table);
    for (uint32_t o = 0; list && o < f->n_object; o++) emitters_finish(&list[o]);
    free(list);
    return status;
}
