/* SPDX-License-Identifier: MIT */
/* M03's samples of one pixel as plain loops over lanes. Included by tangent.c once for each
 * instruction set, in its region of base/isa.h. */

#include "radial_kernel.h"

/* sum += R_d E / density over lanes. Lane i looks along x (tangent-plane point relative to the
 * eye) at G-buffer point index[i], whose plane it meets at t x; f is the number of tangent
 * samples times their density per area, uniform the other technique's density. */
static void PRT_KERNEL(gather)(const struct tangent_job *job, const struct radial_table *table,
                               int n, const float rel[3], uint32_t object, float height,
                               const uint32_t *index, const float *x, const float *y,
                               const float *z, const float *f, float uniform, float sum[3])
{
    float r_sq[LANES], r0[LANES], r1[LANES], r2[LANES], k[LANES];
    const struct seen *seen = job->seen;
    const float *F = job->forward;
    const float slack = job->slack, inv_height = 1 / (height > 1e-12f ? height : 1e-12f);
    if (n <= 0) return;
    for (int i = 0; i < n; i++) {
        const struct seen *q = &seen[index[i]];
        float along = x[i] * q->n[0] + y[i] * q->n[1] + z[i] * q->n[2];
        float depth = x[i] * F[0] + y[i] * F[1] + z[i] * F[2];
        float t0 = q->depth / (depth > 1e-12f ? depth : 1e-12f);
        float t = q->plane / (fabsf(along) > 1e-12f ? along : 1e-12f);
        /* a grazing plane is not followed further than about the pixel */
        t = t > t0 * (1 - slack) ? t : t0 * (1 - slack);
        t = t < t0 * (1 + slack) ? t : t0 * (1 + slack);
        float dx = t * x[i] - rel[0], dy = t * y[i] - rel[1], dz = t * z[i] - rel[2];
        r_sq[i] = dx * dx + dy * dy + dz * dz;
        /* J = (cos_t / cos_s)(d_s² / d_t²) = height / |x.n| t², density per seen area f / J */
        float density = f[i] * fabsf(along) * inv_height / (t * t + 1e-30f) + uniform;
        int good = (q->object == object) & (density > 0);
        k[i] = good ? 1 / (density > 0 ? density : 1) : 0;
    }
    PRT_KERNEL(radial)(table, n, r_sq, r0, r1, r2);
    float s0 = 0, s1 = 0, s2 = 0;
    for (int i = 0; i < n; i++) {
        const struct seen *q = &seen[index[i]];
        s0 += r0[i] * q->e[0] * k[i];
        s1 += r1[i] * q->e[1] * k[i];
        s2 += r2[i] * q->e[2] * k[i];
    }
    sum[0] += s0;
    sum[1] += s1;
    sum[2] += s2;
}

/* Two tangents t, b of a unit normal n, without a branch on its length (Duff et al. 2017). */
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

static void PRT_KERNEL(pixel)(const struct tangent_job *job, uint32_t point, float sum[3])
{
    const struct pattern *pat = &job->pattern[job->variant[point]];
    const uint32_t object = job->seen[point].object;
    const uint32_t medium = job->medium ? job->medium[point] : object;
    const struct radial_table *table = &job->table[medium];
    const float *F = job->forward, *R = job->right, *U = job->up, *eye = job->eye;
    float o[3], n[3], t[3], b[3];
    for (int k = 0; k < 3; k++) {
        o[k] = job->seen[point].p[k];
        n[k] = job->face[k][point];
    }
    PRT_KERNEL(frame_about)(n, t, b);
    float rel[3] = {o[0] - eye[0], o[1] - eye[1], o[2] - eye[2]};
    float height = rel[0] * n[0] + rel[1] * n[1] + rel[2] * n[2];
    const float n_t = (float)job->n_tangent, n_u = (float)job->n_uniform;
    const float uniform = n_u / job->visible_area;
    const float *radius = pat->radius[medium], *density = pat->density[medium];
    const float half_w = 0.5f * (float)job->width, half_h = 0.5f * (float)job->height;
    for (uint32_t first = 0; first < job->n_tangent; first += LANES) {
        int lanes = job->n_tangent - first < LANES ? (int)(job->n_tangent - first) : LANES;
        int pixel[LANES], hit = 0;
        float x[LANES], y[LANES], z[LANES], f[LANES];
        uint32_t index[LANES];
        for (int i = 0; i < lanes; i++) {
            float r = radius[first + (uint32_t)i];
            float cr = r * pat->cosine[first + (uint32_t)i],
                  sr = r * pat->sine[first + (uint32_t)i];
            float px, py, xx = rel[0] + cr * t[0] + sr * b[0];
            float yy = rel[1] + cr * t[1] + sr * b[1], zz = rel[2] + cr * t[2] + sr * b[2];
            float w = xx * F[0] + yy * F[1] + zz * F[2], iw = 1 / (w > 1e-12f ? w : 1e-12f);
            float u = (xx * R[0] + yy * R[1] + zz * R[2]) * iw;
            float v = (xx * U[0] + yy * U[1] + zz * U[2]) * iw;
            x[i] = xx;
            y[i] = yy;
            z[i] = zz;
            px = (1 + u) * half_w;
            py = (1 - v) * half_h;
            int inside = (w > 0) & (px >= 0) & (px < (float)job->width) & (py >= 0) &
                         (py < (float)job->height);
            px = inside ? px : 0;
            py = inside ? py : 0;
            pixel[i] = inside ? (int)py * (int)job->width + (int)px : -1;
        }
        for (int i = 0; i < lanes; i++) {
            uint32_t j = pixel[i] >= 0 ? job->point_of[pixel[i]] : UINT32_MAX;
            index[hit] = j;
            x[hit] = x[i];
            y[hit] = y[i];
            z[hit] = z[i];
            f[hit] = n_t * density[first + (uint32_t)i];
            hit += j != UINT32_MAX;
        }
        PRT_KERNEL(gather)
        (job, table, hit, rel, object, fabsf(height), index, x, y, z, f, uniform, sum);
    }
    for (uint32_t first = 0; first < job->n_uniform; first += LANES) {
        int lanes = job->n_uniform - first < LANES ? (int)(job->n_uniform - first) : LANES;
        float r_sq[LANES], r0[LANES], r1[LANES], r2[LANES], f[LANES];
        float x[LANES], y[LANES], z[LANES];
        const uint32_t *index = pat->uniform + first;
        for (int i = 0; i < lanes; i++) {
            const float *q = job->seen[index[i]].p;
            float qx = q[0] - eye[0], qy = q[1] - eye[1], qz = q[2] - eye[2];
            float along = qx * n[0] + qy * n[1] + qz * n[2];
            /* where the line of sight meets the tangent plane; behind the eye: not at all */
            float s = height / (fabsf(along) > 1e-12f ? along : 1e-12f);
            f[i] = s > 0 ? n_t : 0;
            s = s > 1e-6f ? s : 1;
            x[i] = s * qx;
            y[i] = s * qy;
            z[i] = s * qz;
            float dx = x[i] - rel[0], dy = y[i] - rel[1], dz = z[i] - rel[2];
            r_sq[i] = dx * dx + dy * dy + dz * dz;
        }
        PRT_KERNEL(radial)(table, lanes, r_sq, r0, r1, r2);
        const float *inv = job->inv_rho[medium];
        for (int i = 0; i < lanes; i++)
            f[i] *= inv[0] * r0[i] + inv[1] * r1[i] + inv[2] * r2[i];
        PRT_KERNEL(gather)
        (job, table, lanes, rel, object, fabsf(height), index, x, y, z, f, uniform, sum);
    }
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
