// SPDX-License-Identifier: MIT
// The sum of R_d E over many texels of an object at some points, as texture sampling makes it
// when it draws every texel. The near part is that of a plane with the point's own irradiance.
#include "internal.h"

#include <math.h>
#include <string.h>

bool prt_texel_sum_init(const struct frame *f, const struct samples *texels, uint32_t first,
                        uint32_t last, struct texel_sum *out)
{
    const uint32_t object = texels->object[first];
    double area = 0; // a texel is no disc: one of 1.5 times its radius smooths the sum
    memset(out, 0, sizeof *out);
    for (uint32_t i = first; i < last; i++) area += (double)texels->area[i];
    const double disc = 1.5 * sqrt(area / (last - first) / M_PI);
    if (!prt_emitters_reserve(&out->list, last - first + 16)) return false;
    for (uint32_t i = first; i < last; i++) {
        float w[3], p[3] = {texels->p[0][i], texels->p[1][i], texels->p[2][i]};
        for (int c = 0; c < 3; c++) w[c] = texels->e[c][i] * texels->area[i];
        if (w[0] + w[1] + w[2] > 0) emitters_push(&out->list, p, w);
    }
    prt_split_table(f, object, -1, disc, false, disc, f->screen->diameter_mm, &out->table);
    prt_near_share(f, object, disc, out->share);
    return true;
}

void prt_texel_sum_add(const struct prt_context *ctx, const struct texel_sum *s, uint32_t n,
                       const float *const p[3], const float *const e[3], float *const sum[3])
{
    pair_fn pairs = prt_pair_kernel(ctx ? ctx->cpu : prt_cpu_detect());
    for (uint32_t k = 0; k < s->list.n; k += 512)
        pairs(&s->table, &s->list, k, min_u(k + 512, s->list.n), n, p, sum);
    for (uint32_t i = 0; i < n; i++)
        for (int c = 0; c < 3; c++) sum[c][i] += e[c][i] * (float)s->share[c];
}

void prt_texel_sum_finish(struct texel_sum *s)
{
    prt_emitters_finish(&s->list);
}
