// SPDX-License-Identifier: MIT
// Light of the surface that the picture does not hold, or holds at a grazing angle or beside an
// edge: summed from points that the light sees, less those whose irradiance the picture gives.
#include "tangent.h"

#include <math.h>

struct hidden_job {
    const struct frame *f;
    const struct tangent_job *job;
    const struct samples *seen;
    const uint8_t *readable;
    struct samples *s;
};

// Clears the irradiance of samples that the picture gives.
static int clear_points(void *arg, size_t begin, size_t end, unsigned worker)
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
        // within a pixel of the plane of the pixel that it projects to
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

static int clear_readable(const struct frame *f, const struct tangent_job *job,
                          const struct samples *seen, struct samples *s)
{
    struct hidden_job hidden = {f, job, seen, f->screen->tangent.readable, s};
    return prt_parallel_for(f->ctx, NULL, s->n, 1024, clear_points, &hidden);
}

int prt_tangent_hidden(struct frame *f, const struct tangent_job *job,
                       const struct samples *seen)
{
    float lu = prt_frame_mean_free_path(f), far = 4 * f->screen->diameter_mm;
    if (!prt_frame_light_views_only(f)) {
        double texels = f->screen->area_mm2 / (0.5 * (double)lu * lu);
        int status = prt_frame_atlas(f,
                                     texels < 8192    ? 8192
                                     : texels > 65536 ? 65536
                                                      : (uint32_t)texels,
                                     false);
        if (status) return status;
        status = clear_readable(f, job, seen, &f->screen->atlas);
        return status ? status : prt_scatter_discs(f, &f->screen->atlas, -1, 0.8f, far);
    }
    float spacing = max_f(lu, f->screen->diameter_mm / 300);
    struct grid grid = prt_frame_grid(f, spacing);
    for (uint32_t l = 0; l < f->n_light; l++) {
        struct samples s;
        int status = prt_frame_light_view(f, l, &grid, &s);
        if (status) return status;
        status = clear_readable(f, job, seen, &s);
        if (!status) status = prt_scatter_discs(f, &s, -1, 0.8f, far);
        prt_samples_finish(&s);
        if (status) return status;
    }
    return PRT_OK;
}
