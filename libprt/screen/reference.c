// SPDX-License-Identifier: MIT
// The sum that the other engines are measured against: every texel, R_d itself instead of
// tables. R_d varies much over the texel nearest to a point. The weight w = e^(-(r/near)^2)
// takes that texel out: w R_d is integrated with the point's own irradiance, texels stand for
// (1-w) R_d, and the sum does not jump where the nearest texel changes (METHODS §6).
#include "internal.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { CHUNK = 1024 }; // texels at a time: their distances and R_d stay in the L1 cache

struct job {
    struct frame *f;
    const struct samples *s;
    uint32_t *object_begin; // [n_object+1] texels
    const uint32_t *point;
    const struct samples *own; // the points with their irradiance
    double near_mm;
    double (*share)[3]; // [n_object] of R_d exp(-(r / near_mm)^2)
    float (*out)[3];
    unsigned cpu;
};

// Integral of w R_d over a plane: the response to the point's own irradiance.
static void near_share(const struct prt_diffusion d[3], double near_mm, double share[3])
{
    enum { STEPS = 256 };
    for (int c = 0; c < 3; c++) {
        // midpoints at equal steps of log r; the weight is 1e-7 at 4 near_mm
        double top = 4 * near_mm, ratio = top / (1e-3 * fmin(near_mm, d[c].z_r));
        share[c] = 0;
        for (int k = 0; k < STEPS; k++) {
            double r = top * pow(ratio, -(k + 0.5) / STEPS);
            share[c] += 2 * M_PI * r * r * prt_diffusion_rd(&d[c], r) *
                        exp(-(r / near_mm) * (r / near_mm)) * log(ratio) / STEPS;
        }
    }
}

static int run(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct job *job = arg;
    const struct samples *s = job->s;
    const bool maps = maps_tint(job->f->options);
    const float inv_near = (float)(1 / (job->near_mm * job->near_mm)), reach = 16 / inv_near;
    float *r = prt_alloc(4 * CHUNK, sizeof *r);
    if (!r) return PRT_NOMEM;
    for (size_t i = begin; i < end; i++) {
        uint32_t point = job->point[i];
        uint32_t object = job->f->screen->mesh->block[job->f->g.block[point]].object;
        double sum[3] = {0};
        float o[3], factor[6];
        struct prt_diffusion own[3], *dipole = job->f->dipole[object];
        double scale[3] = {1, 1, 1}, share[3];
        memcpy(share, job->share[object], sizeof share);
        if (maps) { // R_d of the medium where light leaves, as in M03
            prt_map_point_factor(job->f, point, factor);
            for (int c = 0; c < 3; c++) {
                prt_map_medium(&dipole[c], factor, c, &own[c]);
                scale[c] =
                    prt_map_reflectance(&dipole[c], factor, c) / fmax(own[c].rho_d, 1e-12);
            }
            dipole = own;
            near_share(own, job->near_mm, share);
        }
        for (int k = 0; k < 3; k++) o[k] = job->f->g.position[k][point];
        uint32_t last = job->object_begin[object + 1];
        for (uint32_t at = job->object_begin[object]; at < last; at += CHUNK) {
            uint32_t n = last - at < CHUNK ? last - at : CHUNK;
            float part[3] = {0};
            for (uint32_t j = 0; j < n; j++) {
                float x = s->p[0][at + j] - o[0], y = s->p[1][at + j] - o[1];
                float z = s->p[2][at + j] - o[2];
                r[j] = x * x + y * y + z * z;
            }
            prt_diffusion_rd3_array(dipole, job->cpu, n, r, r + CHUNK, r + 2 * CHUNK,
                                    r + 3 * CHUNK);
            for (uint32_t j = 0; j < n; j++) {
                if (!(r[j] < reach)) continue;
                float far = 1 - expf(-r[j] * inv_near);
                for (int c = 1; c < 4; c++) r[(size_t)c * CHUNK + j] *= far;
            }
            for (int c = 0; c < 3; c++)
                for (uint32_t j = 0; j < n; j++)
                    part[c] +=
                        r[(size_t)(c + 1) * CHUNK + j] * s->e[c][at + j] * s->area[at + j];
            for (int c = 0; c < 3; c++) sum[c] += part[c];
        }
        for (int c = 0; c < 3; c++)
            job->out[i][c] =
                (float)(scale[c] * (sum[c] + share[c] * (double)job->own->e[c][i]) / M_PI);
    }
    prt_free(r);
    return PRT_OK;
}

int prt_engine_reference(struct frame *f, uint32_t n_texel, uint32_t stride, double *error)
{
    double t0 = prt_time_s();
    int status = prt_frame_atlas(f, n_texel, true);
    if (status) return status;
    double t1 = prt_time_s();
    const struct samples *s = &f->screen->atlas;
    uint32_t n = 0, skip = 0;
    uint32_t *point = malloc(((size_t)f->g.n_point + 1) * sizeof *point);
    uint32_t *begin = calloc((size_t)f->n_object + 2, sizeof *begin);
    float(*out)[3] = malloc(((size_t)f->g.n_point / stride + 2) * sizeof *out);
    double(*share)[3] = calloc((size_t)f->n_object + 1, sizeof *share);
    // 2.5 radii of a texel's disc: (1-w) R_d is smooth from texel to texel
    double near_mm = s->n ? 2.5 * sqrt(f->screen->area_mm2 / s->n / M_PI) : 1;
    struct samples own = {0};
    struct job job = {
        f, s, begin, point, &own, near_mm, share, out, f->ctx ? f->ctx->cpu : prt_cpu_detect()};
    if (!point || !begin || !out || !share)
        status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
    if (!status) {
        for (uint32_t i = 0; i < f->g.n_point; i++)
            if (!f->g.opaque[i] && skip++ % stride == 0) point[n++] = i;
        for (uint32_t i = 0; i < s->n; i++) begin[s->object[i] + 1]++;
        for (uint32_t o = 0; o < f->n_object; o++) begin[o + 1] += begin[o];
        for (uint32_t o = 0; o < f->n_object; o++) near_share(f->dipole[o], near_mm, share[o]);
        if (!prt_visible_samples(f, n, point, &own))
            status = prt_fail(f->ctx, PRT_NOMEM, "screen: no memory");
        if (!status) status = prt_frame_irradiance(f, &own);
        if (!status) status = prt_screen_loop(f->ctx, n, 16, run, &job);
    }
    if (!status && error) {
        double num = 0, den = 0;
        for (uint32_t i = 0; i < n; i++) {
            for (int c = 0; c < 3; c++) {
                double e = (double)f->radiance[point[i]][c] - out[i][c];
                num += e * e;
                den += (double)out[i][c] * out[i][c];
            }
        }
        *error = den > 0 ? sqrt(num / den) : 0;
    } else if (!status) {
        for (uint32_t i = 0; i < n; i++) memcpy(f->radiance[point[i]], out[i], sizeof out[i]);
        f->report->n_sample = s->n;
        f->report->irradiance_s = t1 - t0;
        f->report->scatter_s = prt_time_s() - t1;
    }
    f->report->n_pair += (uint64_t)n * s->n / (f->n_object ? f->n_object : 1);
    prt_samples_finish(&own);
    free(share);
    free(point);
    free(begin);
    free(out);
    return status;
}
