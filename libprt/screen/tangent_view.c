// SPDX-License-Identifier: MIT
// The view as tangent-plane sampling reads it: the point that stands for each pixel, points
// whose irradiance may be read, and the running visible area that uniform samples are drawn
// from.
#include "tangent.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Smallest cosine between a pixel's ray and its plane at which the plane stands for the pixel's
// surface; chosen, not measured.
#define LEAST_COSINE 0.2f

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

// Running sum of the surface area of readable points: each is its pixel's solid angle on the
// surface.
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
        // uniform samples are drawn from readable points alone, each with all of its pixel
        bool own = view->readable[i];
        double area = own ? pixel * z * z * z / fmax(fabs(c), 0.02 * sqrt(d2)) : 0;
        cdf[i + 1] = cdf[i] + (area > 0 && isfinite(area) ? area : 0);
    }
    return cdf;
}

bool prt_tangent_alike(const struct frame *f, const struct samples *s, uint32_t i, uint32_t j,
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

// The point that stands for each pixel: the translucent one of the largest weight.
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
    // a pixel's other points on the same patch copy its light
    float pixel = prt_view_pixel_mm(f->vis);
    for (uint32_t i = 0; i < f->g.n_point; i++) {
        uint32_t own = v->point_of[f->g.pixel[i]];
        v->needed[i] = !f->g.opaque[i] &&
                       (own == i || !prt_tangent_alike(f, &v->seen, i, own, 4 * pixel * pixel));
    }
    return true;
}

// Whether irradiance may be read at point i: its pixel is covered by one smooth patch, which
// continues in the four neighbours and is not seen at a grazing angle. Surface of other pixels
// is summed from points that the light sees, so that all of it counts once.
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
        if (j == UINT32_MAX || !prt_tangent_alike(f, s, i, j, reach * reach)) return false;
    }
    return true;
}

int prt_tangent_view_get(struct frame *f, const struct tangent_job *job)
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
