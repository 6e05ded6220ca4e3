// SPDX-License-Identifier: MIT
// The error of a frame: the relative RMS difference from a sum over many texels at some 160
// points. The ratio of this to the predicted error corrects the predictions for later frames
// (METHODS §6).
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Points compared; texels of the sum, as many as keep shadow rays near CHECK_RAYS. Chosen, not
// measured.
enum { CHECK_POINTS = 160, CHECK_LEAST = 16384, CHECK_MOST = 65536, CHECK_RAYS = 1 << 20 };

// Points of the picture, object by object, each object's padded to a multiple of 16 by its
// last.
struct spots {
    struct samples at;
    uint32_t *point; // [at.n] of the G-buffer; UINT32_MAX: padding
    uint32_t *begin; // [n_object+1]
    float *sum[3];   // [at.n]
};

static void spots_finish(struct spots *s)
{
    prt_samples_finish(&s->at);
    free(s->point);
    free(s->begin);
    for (int k = 0; k < 3; k++) prt_free(s->sum[k]);
}

static bool spots_init(const struct frame *f, struct spots *s)
{
    uint32_t n = 0, stride = f->g.n_point / CHECK_POINTS + 1;
    size_t most = CHECK_POINTS + 16 * ((size_t)f->n_object + 1);
    uint32_t *index = malloc(most * sizeof *index);
    memset(s, 0, sizeof *s);
    s->point = malloc(most * sizeof *s->point);
    s->begin = calloc((size_t)f->n_object + 2, sizeof *s->begin);
    bool good = index && s->point && s->begin;
    for (uint32_t o = 0; o < f->n_object && good; o++) {
        s->begin[o] = n;
        for (uint32_t i = stride / 2; i < f->g.n_point; i += stride)
            if (!f->g.opaque[i] && f->screen->mesh->block[f->g.block[i]].object == o)
                s->point[n] = i, index[n++] = i;
        for (; n % 16; n++) {
            index[n] = index[n - 1];
            s->point[n] = UINT32_MAX;
        }
        s->begin[o + 1] = n;
    }
    good = good && n && prt_visible_samples(f, n, index, &s->at);
    for (int k = 0; k < 3 && good; k++)
        good = (s->sum[k] = prt_calloc((size_t)n + 16, sizeof(float))) != NULL;
    free(index);
    return good || !n;
}

// Adds texels [first, last) of one object to its points.
static bool sum_object(const struct frame *f, const struct samples *texels, uint32_t first,
                       uint32_t last, struct spots *s)
{
    const uint32_t object = texels->object[first], from = s->begin[object];
    const uint32_t n = s->begin[object + 1] - from;
    struct texel_sum sum;
    if (!n) return true;
    if (!prt_texel_sum_init(f, texels, first, last, &sum)) return false;
    const float *const p[3] = {s->at.p[0] + from, s->at.p[1] + from, s->at.p[2] + from};
    const float *const e[3] = {s->at.e[0] + from, s->at.e[1] + from, s->at.e[2] + from};
    float *const out[3] = {s->sum[0] + from, s->sum[1] + from, s->sum[2] + from};
    prt_texel_sum_add(f->ctx, &sum, n, p, e, out);
    prt_texel_sum_finish(&sum);
    return true;
}

static double difference(const struct frame *f, const struct spots *s)
{
    double num = 0, den = 0;
    for (uint32_t i = 0; i < s->at.n; i++) {
        for (int c = 0; c < 3 && s->point[i] != UINT32_MAX; c++) {
            double want = (double)s->sum[c][i] / M_PI;
            double d = (double)f->radiance[s->point[i]][c] - want;
            num += d * d;
            den += want * want;
        }
    }
    return den > 0 ? sqrt(num / den) : 0;
}

int prt_frame_check(struct frame *f, double *error)
{
    struct prt_screen *screen = f->screen;
    uint32_t n = CHECK_RAYS / (f->n_light ? f->n_light : 1);
    n = n < CHECK_LEAST ? CHECK_LEAST : n > CHECK_MOST ? CHECK_MOST : n;
    int status = PRT_OK;
    if (screen->check_size != n) {
        prt_samples_finish(&screen->check);
        screen->check_size = 0;
        if ((status = prt_samples_atlas(f->ctx, screen->mesh, n, &screen->check)))
            return status;
        screen->check_size = n;
    }
    const struct samples *texels = &screen->check;
    struct spots spots;
    if (!spots_init(f, &spots)) status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (!status) status = prt_frame_irradiance(f, &screen->check);
    if (!status && spots.at.n) status = prt_frame_irradiance(f, &spots.at);
    for (uint32_t first = 0, last; first < texels->n && spots.at.n && !status; first = last) {
        for (last = first; last < texels->n && texels->object[last] == texels->object[first];)
            last++;
        if (!sum_object(f, texels, first, last, &spots))
            status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    }
    *error = status ? 0 : difference(f, &spots);
    spots_finish(&spots);
    return status;
}
