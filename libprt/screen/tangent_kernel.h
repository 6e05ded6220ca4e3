/* SPDX-License-Identifier: MIT */
/* M03's samples of one pixel as plain loops over lanes. Included by tangent.c once for each
 * instruction set, in its region of base/isa.h. */

#include "radial_kernel.h"

/* sum += R_d E / density over n lanes of samples. A ray from the eye along (x, y, z), which is
 * the sample's tangent-plane point relative to the eye, meets the plane of G-buffer point index
 * at t (x, y, z); f is the number of tangent samples times their density per area. */
static void PRT_KERNEL(gather)(const struct tangent_job *job, const struct tangent_plane *plane,
                               const struct tangent_lanes *s, int n, float sum[3])
{
    float r_sq[LANES], r0[LANES], r1[LANES], r2[LANES], k[LANES];
    const struct seen *seen = job->seen;
    const float *F = job->forward, *rel = plane->rel;
    const float slack = job->slack, height = fabsf(plane->height), uniform = plane->uniform;
    const float inv_height = 1 / (height > 1e-12f ? height : 1e-12f);
    const uint32_t object = plane->object;
    if (n <= 0) return;
    for (int i = 0; i < n; i++) {
        const struct seen *q = &seen[s->index[i]];
        float x = s->x[i], y = s->y[i], z = s->z[i];
        float along = x * q->n[0] + y * q->n[1] + z * q->n[2];
        float depth = x * F[0] + y * F[1] + z * F[2];
        float t0 = q->depth / (depth > 1e-12f ? depth : 1e-12f);
        float t = q->plane / (fabsf(along) > 1e-12f ? along : 1e-12f);
        /* a grazing plane is extended no further than about the pixel */
        t = t > t0 * (1 - slack) ? t : t0 * (1 - slack);
        t = t < t0 * (1 + slack) ? t : t0 * (1 + slack);
        float dx = t * x - rel[0], dy = t * y - rel[1], dz = t * z - rel[2];
        r_sq[i] = dx * dx + dy * dy + dz * dz;
        /* J = (cos_t / cos_s)(d_s² / d_t²) = height / |x.n| t², density per seen area f / J */
        float density = s->f[i] * fabsf(along) * inv_height / (t * t + 1e-30f) + uniform;
        int good = (q->object == object) & (density > 0);
        k[i] = good ? 1 / (density > 0 ? density : 1) : 0;
    }
    PRT_KERNEL(radial)(plane->table, n, r_sq, r0, r1, r2);
    float s0 = 0, s1 = 0, s2 = 0;
    for (int i = 0; i < n; i++) {
        const struct seen *q = &seen[s->index[i]];
        s0 += r0[i] * q->e[0] * k[i];
        s1 += r1[i] * q->e[1] * k[i];
        s2 += r2[i] * q->e[2] * k[i];
    }
    sum[0] += s0;
    sum[1] += s1;
    sum[2] += s2;
}

/* Two tangents t, b of a unit normal n, without a branch on its length (DBCH17). */
PRT_INLINE void PRT_KERNEL(frame_about)(const float n[3], float t[3], float b[3])
{
    const float sign = n[2] < 0 ? -1.0f : 1.0f, a = -1 / (sign + n[2]), m = n[0] * n[1] * a;
    t[0] = 1 + sign * n[0] * n[0] * a;
    t[1] = sign * m;
    t[2] = -sign * n[0];
    b[0] = m;
    b[1] = sign + n[1] * n[1] * a;
    b[2] = -n[1];
}

/* The tangent plane at a point of the view. */
static void PRT_KERNEL(plane_at)(const struct tangent_job *job, uint32_t point,
                                 struct tangent_plane *out)
{
    const float *eye = job->eye;
    float n[3];
    for (int k = 0; k < 3; k++) {
        n[k] = out->n[k] = job->face[k][point];
        out->rel[k] = job->seen[point].p[k] - eye[k];
    }
    PRT_KERNEL(frame_about)(n, out->t, out->b);
    out->height = out->rel[0] * n[0] + out->rel[1] * n[1] + out->rel[2] * n[2];
    out->object = job->seen[point].object;
    out->medium = job->medium ? job->medium[point] : out->object;
    out->table = &job->table[out->medium];
    out->uniform = (float)job->n_uniform / job->visible_area;
}

/* Points of the tangent plane at radius and angle of samples [first, first + n), relative to
 * the eye, and the pixel each projects to; -1: none. */
static void PRT_KERNEL(project)(const struct tangent_job *job,
                                const struct tangent_plane *plane, const struct pattern *pat,
                                uint32_t first, int n, struct tangent_lanes *s, int *pixel)
{
    const float *F = job->forward, *R = job->right, *U = job->up, *rel = plane->rel;
    const float *t = plane->t, *b = plane->b, *radius = pat->radius[plane->medium] + first;
    const float *cosine = pat->cosine + first, *sine = pat->sine + first;
    const float half_w = 0.5f * (float)job->width, half_h = 0.5f * (float)job->height;
    for (int i = 0; i < n; i++) {
        float cr = radius[i] * cosine[i], sr = radius[i] * sine[i];
        float px, py, xx = rel[0] + cr * t[0] + sr * b[0];
        float yy = rel[1] + cr * t[1] + sr * b[1], zz = rel[2] + cr * t[2] + sr * b[2];
        float w = xx * F[0] + yy * F[1] + zz * F[2], iw = 1 / (w > 1e-12f ? w : 1e-12f);
        float u = (xx * R[0] + yy * R[1] + zz * R[2]) * iw;
        float v = (xx * U[0] + yy * U[1] + zz * U[2]) * iw;
        s->x[i] = xx;
        s->y[i] = yy;
        s->z[i] = zz;
        px = (1 + u) * half_w;
        py = (1 - v) * half_h;
        int inside = (w > 0) & (px >= 0) & (px < (float)job->width) & (py >= 0) &
                     (py < (float)job->height);
        px = inside ? px : 0;
        py = inside ? py : 0;
        pixel[i] = inside ? (int)py * (int)job->width + (int)px : -1;
    }
}

/* Samples of the tangent plane by R_d (M03 eq 8). */
static void PRT_KERNEL(tangent_samples)(const struct tangent_job *job,
                                        const struct tangent_plane *plane,
                                        const struct pattern *pat, float sum[3])
{
    const float n_t = (float)job->n_tangent, *density = pat->density[plane->medium];
    for (uint32_t first = 0; first < job->n_tangent; first += LANES) {
        int lanes = job->n_tangent - first < LANES ? (int)(job->n_tangent - first) : LANES;
        int pixel[LANES], hit = 0;
        struct tangent_lanes s;
        PRT_KERNEL(project)(job, plane, pat, first, lanes, &s, pixel);
        for (int i = 0; i < lanes; i++) {
            uint32_t j = pixel[i] >= 0 ? job->point_of[pixel[i]] : UINT32_MAX;
            s.index[hit] = j;
            s.x[hit] = s.x[i];
            s.y[hit] = s.y[i];
            s.z[hit] = s.z[i];
            s.f[hit] = n_t * density[first + (uint32_t)i];
            hit += j != UINT32_MAX;
        }
        PRT_KERNEL(gather)(job, plane, &s, hit, sum);
    }
}

/* Samples of the visible area, weighed against the others by the balance heuristic (M03 eq 9).
 */
static void PRT_KERNEL(uniform_samples)(const struct tangent_job *job,
                                        const struct tangent_plane *plane,
                                        const struct pattern *pat, float sum[3])
{
    const float n_t = (float)job->n_tangent, *eye = job->eye, *n = plane->n;
    const float *rel = plane->rel, *inv = job->inv_rho[plane->medium];
    for (uint32_t first = 0; first < job->n_uniform; first += LANES) {
        int lanes = job->n_uniform - first < LANES ? (int)(job->n_uniform - first) : LANES;
        float r_sq[LANES], r0[LANES], r1[LANES], r2[LANES];
        struct tangent_lanes s;
        for (int i = 0; i < lanes; i++) {
            s.index[i] = pat->uniform[first + (uint32_t)i];
            const float *q = job->seen[s.index[i]].p;
            float qx = q[0] - eye[0], qy = q[1] - eye[1], qz = q[2] - eye[2];
            float along = qx * n[0] + qy * n[1] + qz * n[2];
            /* the line of sight's intersection with the tangent plane; behind the eye: none */
            float k = plane->height / (fabsf(along) > 1e-12f ? along : 1e-12f);
            s.f[i] = k > 0 ? n_t : 0;
            k = k > 1e-6f ? k : 1;
            s.x[i] = k * qx;
            s.y[i] = k * qy;
            s.z[i] = k * qz;
            float dx = s.x[i] - rel[0], dy = s.y[i] - rel[1], dz = s.z[i] - rel[2];
            r_sq[i] = dx * dx + dy * dy + dz * dz;
        }
        PRT_KERNEL(radial)(plane->table, lanes, r_sq, r0, r1, r2);
        for (int i = 0; i < lanes; i++)
            s.f[i] *= inv[0] * r0[i] + inv[1] * r1[i] + inv[2] * r2[i];
        PRT_KERNEL(gather)(job, plane, &s, lanes, sum);
    }
}

static void PRT_KERNEL(pixel)(const struct tangent_job *job, uint32_t point, float sum[3])
{
    const struct pattern *pat = &job->pattern[job->variant[point]];
    struct tangent_plane plane;
    PRT_KERNEL(plane_at)(job, point, &plane);
    PRT_KERNEL(tangent_samples)(job, &plane, pat, sum);
    PRT_KERNEL(uniform_samples)(job, &plane, pat, sum);
}

static void PRT_KERNEL(run)(const struct tangent_job *job, size_t begin, size_t end)
{
    for (size_t i = begin; i < end; i++) {
        if (!job->needed[i]) continue;
        float sum[3] = {0, 0, 0};
        PRT_KERNEL(pixel)(job, (uint32_t)i, sum);
        for (int k = 0; k < 3; k++) job->radiance[i][k] += sum[k] * (float)(1 / M_PI);
    }
}
