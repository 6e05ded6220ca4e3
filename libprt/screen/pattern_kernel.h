/* SPDX-License-Identifier: MIT */
/* C08's local pattern about one receiver as plain loops over lanes; included by pattern.c once
 * for each instruction set, in its region of base/isa.h. */

#include "radial_kernel.h"

/* sum += R_d dA times the irradiance of a light of rgb 1, over the pattern's points about a
 * receiver at (u, v, depth) of the light's view. A point is the intersection of the light's ray
 * with the plane of the texel under it. */
static void PRT_KERNEL(receive)(const struct light_map *m, const struct pattern *pat,
                                const struct radial_table *table, uint32_t object, float u,
                                float v, float depth, float sum[3])
{
    const float inv = 1 / m->step, step = m->step;
    const float nu = (float)m->nu, nv = (float)m->nv;
    const int width = (int)m->nu;
    float s0 = 0, s1 = 0, s2 = 0;
    for (uint32_t first = 0; first < pat->n; first += LANES) {
        int n = pat->n - first < LANES ? (int)(pat->n - first) : LANES;
        const float *pa = pat->a + first, *pb = pat->b + first, *area = pat->area + first;
        float r_sq[LANES], w[LANES], r0[LANES], r1[LANES], r2[LANES];
        for (int i = 0; i < n; i++) {
            float x = (u + pa[i]) * inv + 0.5f, y = (v + pb[i]) * inv + 0.5f;
            int inside = (x >= 0) & (y >= 0) & (x < nu) & (y < nv);
            x = inside ? x : 0;
            y = inside ? y : 0;
            int ix = (int)x, iy = (int)y;
            const struct light_texel *q = &m->texel[iy * width + ix];
            float da = (x - 0.5f - (float)ix) * step, db = (y - 0.5f - (float)iy) * step;
            union {
                uint32_t u;
                float f;
            } along = {q->slope & 0xffff0000u}, across = {q->slope << 16};
            float dz = q->depth + da * along.f + db * across.f - depth;
            r_sq[i] = pa[i] * pa[i] + pb[i] * pb[i] + dz * dz;
            w[i] = (inside & (q->object == object)) ? area[i] * q->e : 0;
        }
        PRT_KERNEL(radial)(table, n, r_sq, r0, r1, r2);
        for (int i = 0; i < n; i++) {
            s0 += r0[i] * w[i];
            s1 += r1[i] * w[i];
            s2 += r2[i] * w[i];
        }
    }
    sum[0] += s0;
    sum[1] += s1;
    sum[2] += s2;
}
