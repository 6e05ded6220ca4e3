// SPDX-License-Identifier: MIT
// Integrals along a vertex's path (W05 eq 10-12, X07 eq 15). The path length to the exit is
// nearly linear in depth: a monotone cubic interpolates the traced nodes, and the exponentials
// between its points are integrated in closed form.
#include "bake/loops.h"

#include <string.h>

enum { RADIAL_SUBSTEPS = 2 };

// A node without light has no exit path of its own, but its path length weighs the intervals to
// its neighbours: it is interpolated from theirs.
static void interpolate_hidden(const struct knots *ft_v, uint32_t n_node, struct knots *u)
{
    float own[SINGLE_MAX_NODES + 1][PATH_TILE];
    memcpy(own, u->v, sizeof own);
    for (uint32_t a = 1; a <= n_node; a++)
        for (int t = 0; t < PATH_TILE; t++) {
            bool before = a > 1 && ft_v->v[a - 1][t] > 0;
            bool after = a < n_node && ft_v->v[a + 1][t] > 0;
            if (ft_v->v[a][t] > 0 || (!before && !after)) continue;
            float l = before ? own[a - 1][t] - u->depth[a - 1] : 0;
            float r = after ? own[a + 1][t] - u->depth[a + 1] : 0;
            u->v[a][t] = u->depth[a] + (l + r) * (before && after ? 0.5f : 1.0f);
        }
}

// Directions [first, first + PATH_TILE) of the path; those from n on carry no light.
static void follow_path(const struct path_job *job, uint32_t first, struct path *path)
{
    struct knots u, ft_v;
    const struct scratch *s = job->s;
    const struct bake_loops *loops = prt_bake_loops(job->plan->cpu);
    const float *depth = job->depth;
    uint32_t substeps = job->plan->extinction ? RADIAL_SUBSTEPS : PATH_SUBSTEPS;
    uint32_t N = job->plan->n_node, n = job->n,
             m = n - first < PATH_TILE ? n - first : PATH_TILE;
    memset(&u, 0, sizeof u);
    memset(&ft_v, 0, sizeof ft_v);
    for (uint32_t a = 0; a < N; a++) {
        u.depth[a + 1] = ft_v.depth[a + 1] = depth[a];
        for (uint32_t t = 0; t < m; t++) {
            u.v[a + 1][t] = depth[a] + s->node[a].path_mm[path_direction(s, first + t)];
            ft_v.v[a + 1][t] = s->node[a].transmittance[path_direction(s, first + t)];
        }
    }
    interpolate_hidden(&ft_v, N, &u);
    for (uint32_t t = 0; t < m; t++) {
        float cosine = s->cosine[path_direction(s, first + t)];
        if (cosine > 0) { // at depth 0 the exit is the tangent plane of the vertex
            u.v[0][t] = 0;
            ft_v.v[0][t] =
                ft_v.v[1][t] > 0 ? fresnel_table_eval(job->fresnel, fminf(cosine, 1)) : 0;
        } else {
            float rise = (u.v[2][t] - u.v[1][t]) / (depth[1] - depth[0]);
            u.v[0][t] = fmaxf(u.v[1][t] - rise * depth[0], 0);
            ft_v.v[0][t] = ft_v.v[1][t];
        }
    }
    loops->subdivide(&u, N, substeps, path->u);
    loops->subdivide(&ft_v, N, substeps, path->transmittance);
    path->n_point = N * substeps + 1;
    for (uint32_t i = 0; i < path->n_point; i++) {
        uint32_t a = i / substeps < N ? i / substeps : N - 1;
        float x = (float)(i - a * substeps) / (float)substeps;
        path->depth[i] = u.depth[a] + x * (u.depth[a + 1] - u.depth[a]);
    }
    float inv = 1 / (u.depth[N] - u.depth[N - 1]);
    for (int t = 0; t < PATH_TILE; t++)
        path->slope[t] = fmaxf((u.v[N][t] - u.v[N - 1][t]) * inv, 0.3f);
}

// SH of the refracted directions w_i' at the nodes of direction t. A node without light takes a
// neighbour's.
bool prt_path_node_sh(const struct single_plan *plan, const struct scratch *s, uint32_t t,
                      float y[SINGLE_MAX_NODES][PATH_MAX_PHASE])
{
    uint32_t K = plan->n_phase, seen = UINT32_MAX;
    for (uint32_t a = 0; a < plan->n_node; a++) {
        float w[3] = {s->node[a].dir[0][t], s->node[a].dir[1][t], s->node[a].dir[2][t]};
        if (s->node[a].transmittance[t] > 0) {
            prt_sh_eval(K == 9 ? 3 : K == 4 ? 2 : 1, w, y[a]);
            for (uint32_t b = seen == UINT32_MAX ? 0 : a; b < a; b++)
                memcpy(y[b], y[a], sizeof y[a]);
            seen = a;
        } else if (seen != UINT32_MAX) {
            memcpy(y[a], y[seen], sizeof y[a]);
        }
    }
    return seen != UINT32_MAX;
}

// A tile with the phase function's factor of w_i': plane k gets a_l Y_k(w_i').
static void integrate_phase(const struct path_job *job, const struct path *path, uint32_t first,
                            uint32_t m)
{
    const struct single_plan *plan = job->plan;
    const struct scratch *s = job->s;
    uint32_t K = plan->n_phase, last = path->n_point - 1;
    for (uint32_t t = 0; t < m; t++) {
        float y[SINGLE_MAX_NODES][PATH_MAX_PHASE], mid[PATH_MAX_PHASE];
        float sum[3][PATH_MAX_PHASE] = {{0}};
        float exponent[3], before[3];
        if (!prt_path_node_sh(plan, s, path_direction(s, first + t), y)) goto write;
        for (int c = 0; c < 3; c++) {
            exponent[c] = plan->sigma_t[c] * path->u[0][t];
            before[c] = exp_minus(exponent[c]);
        }
        for (uint32_t i = 1; i <= last; i++) {
            float ft_v = 0.5f * (path->transmittance[i - 1][t] + path->transmittance[i][t]);
            float step = ft_v * (path->depth[i] - path->depth[i - 1]);
            path_middle_sh(plan, path, i, y, mid);
            for (int c = 0; c < 3; c++) {
                float next = plan->sigma_t[c] * path->u[i][t], e = exp_minus(next);
                float w = step * mean_exp(before[c], e, exponent[c], next);
                for (uint32_t k = 0; k < K; k++) sum[c][k] += w * mid[k];
                exponent[c] = next, before[c] = e;
            }
        }
        float rest = job->end - path->depth[last];
        for (int c = 0; c < 3; c++) {
            float to = exponent[c] + plan->sigma_t[c] * path->slope[t] * rest;
            float w = path->transmittance[last][t] * rest *
                      mean_exp(before[c], exp_minus(to), exponent[c], to);
            for (uint32_t k = 0; k < K; k++) sum[c][k] += w * y[plan->n_node - 1][k];
        }
    write:
        for (uint32_t c = 0; c < 3; c++)
            for (uint32_t k = 0; k < K; k++)
                job->out[((size_t)k * 3 + c) * job->n + first + t] =
                    (float)plan->phase[c].a[path_degree(k)] * plan->sigma_s[c] * sum[c][k];
    }
}

void prt_path_integrate(const struct path_job *job)
{
    const struct single_plan *plan = job->plan;
    const struct bake_loops *loops = prt_bake_loops(plan->cpu);
    for (uint32_t first = 0; first < job->n; first += PATH_TILE) {
        struct path path;
        uint32_t m = job->n - first < PATH_TILE ? job->n - first : PATH_TILE;
        follow_path(job, first, &path);
        if (plan->extinction) {
            loops->integrate_radial(job, &path, first, m);
        } else if (plan->toward && !plan->isotropic) {
            prt_path_toward(job, &path, first, m);
        } else if (plan->n_phase > 1) {
            integrate_phase(job, &path, first, m);
        } else {
            for (uint32_t c = 0; c < 3; c++) {
                float sum[PATH_TILE], factor = plan->sigma_s[c] * (float)(0.5 / sqrt(M_PI));
                if (plan->toward) factor *= (float)(0.5 / sqrt(M_PI));
                loops->integrate_isotropic(&path, plan->sigma_t[c], factor, job->end, sum);
                memcpy(job->out + (size_t)c * job->n + first, sum, m * sizeof *sum);
            }
        }
    }
}
