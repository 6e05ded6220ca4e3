// SPDX-License-Identifier: MIT
// Tangent-plane sampling over all points of the view: the kernel, then a filter that puts the
// interleaved sets of samples together.
#include "tangent.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static int run_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct tangent_job *job = arg;
    job->run(job, begin, end);
    return PRT_OK;
}

struct filter_job {
    const struct frame *f;
    const struct tangent_job *tangent;
    const struct samples *seen;
    const float (*in)[3];
    float reach_sq;
    int half;
};

// The weighted sum over the window about point i; `own` is the point that stands for it.
// Returns the sum of the weights.
static float sum_window(const struct filter_job *job, uint32_t i, uint32_t own, float sum[3])
{
    const struct frame *f = job->f;
    const int width = (int)f->width, height = (int)f->height, half = job->half;
    const int x = (int)(f->g.pixel[i] % f->width), y = (int)(f->g.pixel[i] / f->width);
    float total = 0;
    for (int k = 0; k < (2 * half + 1) * (2 * half + 1); k++) {
        int dx = k % (2 * half + 1) - half, dy = k / (2 * half + 1) - half;
        if (x + dx < 0 || x + dx >= width || y + dy < 0 || y + dy >= height) continue;
        uint32_t j = dx || dy ? job->tangent->point_of[(y + dy) * width + x + dx] : own;
        if (j == UINT32_MAX) continue;
        if (j != own && !prt_tangent_alike(f, job->seen, i, j, job->reach_sq)) continue;
        float w = (abs(dx) == 2 ? 0.5f : 1) * (abs(dy) == 2 ? 0.5f : 1);
        for (int c = 0; c < 3; c++) sum[c] += w * job->in[j][c];
        total += w;
    }
    return total;
}

// Combines the interleaved sets: in a window of 5x5 pixels whose rim weighs half, each of the
// 16 variants has the same weight. Only pixels on the same patch of surface are read. Later
// frames of a running mean have smaller windows.
static int filter_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct filter_job *job = arg;
    const struct frame *f = job->f;
    const struct tangent_job *t = job->tangent;
    for (size_t i = begin; i < end; i++) {
        if (f->g.opaque[i]) continue;
        uint32_t own = t->needed[i] ? (uint32_t)i : t->point_of[f->g.pixel[i]];
        float sum[3] = {0, 0, 0}, total = sum_window(job, (uint32_t)i, own, sum);
        for (int k = 0; k < 3; k++)
            f->radiance[i][k] = sum[k] / total * (t->rho ? t->rho[i][k] : 1);
    }
    return PRT_OK;
}

// With maps light is divided by total reflectance before the filter and multiplied by the
// point's own after it, so that the filter does not blur the media's colours. `plain`: light
// that was summed with the object's plain medium, scaled to the class of the point.
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

int prt_tangent_sample(struct frame *f, struct tangent_job *job, const struct samples *seen)
{
    float(*own)[3] = prt_alloc((size_t)f->g.n_point + 1, sizeof *own);
    if (!own) return prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    // light of hidden surface is filtered too: its edges are those of the readable surface
    memcpy(own, f->radiance, f->g.n_point * sizeof *own);
    if (job->rho) per_reflectance(f, job, seen, true, own);
    job->radiance = own;
    int status = prt_screen_loop(f->ctx, f->g.n_point, 256, run_points, job);
    if (job->rho) per_reflectance(f, job, seen, false, own);
    float scale = prt_frame_mean_free_path(f);
    uint64_t n = (uint64_t)(job->n_tangent + job->n_uniform) * (f->options->frame + 1);
    int half = n < 256 ? 2 : n < 1024 ? 1 : 0;
    // the pattern repeats after four pixels, however short the mean free path
    float least = max_f(scale, 3 * prt_view_pixel_mm(f->vis));
    struct filter_job filter = {f, job, seen, (const float(*)[3])own, least * least, half};
    if (!status)
        status = prt_parallel_for(f->ctx, NULL, f->g.n_point, 1024, filter_points, &filter);
    prt_free(own);
    return status;
}
