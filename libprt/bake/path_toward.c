// SPDX-License-Identifier: MIT
// Integrals along a path towards one direction of exit, with the phase function's series
// (METHODS §3.6). The bake's planes over directions of exit are fitted to them.
#include "bake/path_integral.h"

// The phase function at the nodes of direction t, by channel. A node
// without light takes a neighbour's. False: no node has light.
static bool node_phases(const struct path_job *job, uint32_t t, float p[SINGLE_MAX_NODES][3])
{
    const struct single_plan *plan = job->plan;
    uint32_t seen = UINT32_MAX;
    for (uint32_t a = 0; a < plan->n_node; a++) {
        const struct exits *e = &job->s->node[a];
        if (e->transmittance[t] > 0) {
            float c = 0;
            for (int k = 0; k < 3; k++) c += e->dir[k][t] * job->toward[k];
            for (int ch = 0; ch < 3; ch++)
                p[a][ch] = (float)prt_phase_eval(&plan->phase[ch], (double)c);
            for (uint32_t b = seen == UINT32_MAX ? 0 : a; b < a; b++)
                for (int ch = 0; ch < 3; ch++) p[b][ch] = p[a][ch];
            seen = a;
        } else if (seen != UINT32_MAX) {
            for (int ch = 0; ch < 3; ch++) p[a][ch] = p[seen][ch];
        }
    }
    return seen != UINT32_MAX;
}

static float along(const struct path_job *job, const struct path *path, uint32_t t, int c,
                   float p[SINGLE_MAX_NODES][3])
{
    const struct single_plan *plan = job->plan;
    const uint32_t last = path->n_point - 1, substeps = last / plan->n_node;
    float exponent = plan->sigma_t[c] * path->u[0][t], before = exp_minus(exponent), sum = 0;
    for (uint32_t i = 1; i <= last; i++) {
        const uint32_t a = (i - 1) / substeps;
        const float x = ((float)(i - 1 - a * substeps) + 0.5f) / (float)substeps;
        const float p0 = p[a ? a - 1 : 0][c], phase = p0 + x * (p[a][c] - p0);
        const float next = plan->sigma_t[c] * path->u[i][t], e = exp_minus(next);
        sum += 0.5f * (path->transmittance[i - 1][t] + path->transmittance[i][t]) *
               (path->depth[i] - path->depth[i - 1]) * phase *
               mean_exp(before, e, exponent, next);
        exponent = next, before = e;
    }
    const float rest = job->end - path->depth[last];
    const float to = exponent + plan->sigma_t[c] * path->slope[t] * rest;
    return sum + path->transmittance[last][t] * rest * p[plan->n_node - 1][c] *
                     mean_exp(before, exp_minus(to), exponent, to);
}

void prt_path_toward(const struct path_job *job, const struct path *path, uint32_t first,
                     uint32_t m)
{
    for (uint32_t t = 0; t < m; t++) {
        float p[SINGLE_MAX_NODES][3];
        const bool any = node_phases(job, path_direction(job->s, first + t), p);
        for (int c = 0; c < 3; c++)
            job->out[(size_t)c * job->n + first + t] =
                any ? job->plan->sigma_s[c] * along(job, path, t, c, p) : 0;
    }
}
