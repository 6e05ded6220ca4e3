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
static float *make_mip(const struct samples *s, const uint8_t *keep, uint32_t first,
                       uint32_t last, uint32_t *n_out)
{
    uint32_t n = 1;
    while (n < last - first) n *= 4;
    float *mip = prt_calloc((size_t)n / 3 * 4 + 4, sizeof *mip), *at = mip;
    if (!mip) return NULL;
    for (uint32_t i = first; i < last; i++)
        if (!keep || keep[i])
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

int draw_emitters(struct frame *f, uint32_t n, const uint8_t *keep, struct emitters *list)
{
    const struct samples *s = &f->screen->atlas;
    double total = 0;
    for (uint32_t i = 0; i < s->n; i++)
        if (!keep || keep[i])
            total += (double)(s->e[0][i] + s->e[1][i] + s->e[2][i]) * s->area[i];
    if (!(total > 0)) return PRT_OK;
    struct prt_rng rng;
    prt_rng_init(&rng, f->options->seed, 1);
    float shift = f->options->seed ? prt_rng_f32(&rng) : 0.5f;
    for (uint32_t first = 0, last; first < s->n; first = last) {
        uint32_t object = s->object[first], n_mip;
        last = first;
        while (last < s->n && s->object[last] == object) last++;
        float *mip = make_mip(s, keep, first, last, &n_mip);
        if (!mip) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for mip levels");
        double own = mip[n_mip > 1 ? (size_t)(n_mip - 1) / 3 * 4 : 0];
        uint32_t share = (uint32_t)(n * (own / total) + 0.5);
        if (share < 16) share = 16;
        if (own > 0 && !emitters_reserve(&list[object], list[object].n + share)) {
            prt_free(mip);
            return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory for %u samples", share);
        }
        for (uint32_t i = 0; own > 0 && i < share; i++) {
            uint32_t t = prt_screen_mip_sample(mip, n_mip, (float)((i + (double)shift) / share));
            float value = mip[t];
            t += first;
            if (t >= last || !(value > 0)) continue;
            // E'_total / N, coloured by the texel
            float k = (float)(own / share) * s->area[t] / value;
            float p[3] = {s->p[0][t], s->p[1][t], s->p[2][t]};
            float w[3] = {s->e[0][t] * k, s->e[1][t] * k, s->e[2][t] * k};
            emitters_push(&list[object], p, w);
        }
        prt_free(mip);
    }
    return PRT_OK;
}

struct split {
    const struct prt_dipole *dipole;
    double r_p;
    bool local;
};

static void split_profile(const void *arg, double r_mm, double out[3])
{
    const struct split *s = arg;
    double w = prt_screen_local_weight(r_mm, s->r_p);
    if (!s->local) w = 1 - w;
    for (int c = 0; c < 3; c++) out[c] = w * prt_dipole_rd(&s->dipole[c], r_mm);
}

static int hybrid_scatter(struct frame *f, const struct emitters *list)
{
    double bound = f->options->bound > 0 ? f->options->bound : 0.05, r_p = 0;
    struct radial_table *table = prt_alloc(2 * (size_t)f->n_object, sizeof *table);
    if (!table) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    for (uint32_t o = 0; o < f->n_object; o++)
        r_p = fmax(r_p, prt_screen_split_radius(f->dipole[o], bound));
    float reach = (float)(r_p + 5 / K);
    for (uint32_t o = 0; o < f->n_object; o++) {
        double scale = f->dipole[o][0].z_r;
        for (int c = 1; c < 3; c++) scale = fmin(scale, f->dipole[o][c].z_r);
        struct split near = {f->dipole[o], r_p, true}, far = {f->dipole[o], r_p, false};
        radial_table_fit(&table[o], split_profile, &near, scale, reach);
        radial_table_fit(&table[f->n_object + o], split_profile, &far, scale,
                         f->screen->diameter_mm);
    }
    f->report->r_p_mm = (float)r_p;
    int status = scatter_all(f, table + f->n_object, list);
    if (!status) status = scatter_tree(f, table, &f->screen->atlas, 0.25f, reach);
    prt_free(table);
    return status;
}

int engine_texture(struct frame *f, bool hybrid)
{
    struct prt_screen *screen = f->screen;
    uint32_t n = f->options->n_sample;
    if (!n && f->options->budget_ms > 0) {
        double pairs = f->options->budget_ms * 1e-3 * screen->pair_rate * (hybrid ? 0.5 : 0.8);
        double fit = pairs / (f->g.n_point + 1.0);
        n = fit < 64 ? 64 : fit > 16384 ? 16384 : (uint32_t)fit;
    }
    if (!n) n = hybrid ? 900 : 2500;
    // the near part wants texels under a mean free path apart
    double texels = 16384;
    if (hybrid) {
        double spacing = 0.7 * (double)smallest_mean_free_path(f);
        texels = screen->area_mm2 / (spacing * spacing);
    }
    if (texels < 4.0 * n) texels = 4.0 * n;
    uint32_t size = texels < 16384 ? 16384 : texels > 131072 ? 131072 : (uint32_t)texels;
    double t0 = prt_time_s();
    int status = frame_atlas(f, size);
    double t1 = prt_time_s();
    struct emitters *list = calloc(f->n_object ? f->n_object : 1, sizeof *list);
    if (!status && !list) status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (!status) status = draw_emitters(f, n, NULL, list);
    for (uint32_t o = 0; !status && o < f->n_object; o++) f->report->n_sample += list[o].n;
    if (!status) status = hybrid ? hybrid_scatter(f, list) : scatter_all(f, f->table, list);
    for (uint32_t o = 0; list && o < f->n_object; o++) emitters_finish(&list[o]);
    free(list);
    f->report->irradiance_s = t1 - t0;
    f->report->scatter_s = prt_time_s() - t1;
    return status;
}
