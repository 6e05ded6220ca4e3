// SPDX-License-Identifier: MIT
// Integrals along a vertex's path (W05 eq 10-12, X07 eq 15). The path length to the exit is
// nearly linear in depth: a monotone cubic interpolates the traced nodes, and the exponentials
// between its points are integrated in closed form.
#include "bake/path_integral.h"
#include "base/log_grid.h"

#include <string.h>

enum { TILE = 128, SUBSTEPS = 4, RADIAL_SUBSTEPS = 2 };
enum { MAX_POINTS = SINGLE_MAX_NODES * SUBSTEPS + 1 };

// (e^-a - e^-b) / (b - a), the mean of an exponential between two exponents: the quotient, or
// near a = b its series, blended around a difference of 0.1, where both hold to 1e-5.
static inline __attribute__((always_inline)) float mean_exp(float ea, float eb, float a,
                                                            float b)
{
    float d = b - a, d2 = d * d;
    float quotient = (ea - eb) * d / (d2 + 1e-12f);
    float series = 0.5f * (ea + eb) * (1 - d2 * (1.0f / 12));
    float x = 0.5f * (100 * d2 + 4 - fabsf(100 * d2 - 4)), x2 = x * x, x4 = x2 * x2;
    float far = x4 * x4 / (1 + x4 * x4);
    return far * quotient + (1 - far) * series;
}

// A tile of directions along the path: s + s' and F_t V at the points of a monotone cubic
// through the surface and the nodes.
struct path {
    uint32_t n_point; // 1 + n_node * substeps
    float depth[MAX_POINTS];
    float u[MAX_POINTS][TILE];             // s + s' [mm]
    float transmittance[MAX_POINTS][TILE]; // F_t V
    float slope[TILE];                     // of u beyond the last node
};

// Slope at a point between two chords of a monotone cubic (FC80).
static inline __attribute__((always_inline)) float pchip(float h0, float h1, float m0, float m1)
{
    float w0 = 2 * h1 + h0, w1 = h1 + 2 * h0, low = w0 * m1 + w1 * m0;
    return m0 * m1 > 0 ? (w0 + w1) * m0 * m1 / low : 0;
}

struct knots {
    float depth[SINGLE_MAX_NODES + 1];
    float v[SINGLE_MAX_NODES + 1][TILE]; // values
};

// Evaluates the cubic at `substeps` points of every interval between the knots.
PRT_CLONES static void subdivide(const struct knots *k, uint32_t n_node, uint32_t substeps,
                                 float out[MAX_POINTS][TILE])
{
    float chord[SINGLE_MAX_NODES][TILE], from[TILE], to[TILE];
    for (uint32_t a = 0; a < n_node; a++) {
        float inv = 1 / (k->depth[a + 1] - k->depth[a]);
        for (int t = 0; t < TILE; t++) chord[a][t] = (k->v[a + 1][t] - k->v[a][t]) * inv;
    }
    memcpy(from, chord[0], sizeof from);
    memcpy(out[0], k->v[0], sizeof out[0]);
    for (uint32_t a = 0; a < n_node; a++) {
        float h = k->depth[a + 1] - k->depth[a];
        float h1 = a + 1 < n_node ? k->depth[a + 2] - k->depth[a + 1] : h;
        const float *next = chord[a + 1 < n_node ? a + 1 : a];
        for (int t = 0; t < TILE; t++) to[t] = pchip(h, h1, chord[a][t], next[t]);
        for (uint32_t i = 1; i <= substeps; i++) {
            float x = (float)i / (float)substeps, x2 = x * x, x3 = x2 * x;
            float h00 = 2 * x3 - 3 * x2 + 1, h01 = 3 * x2 - 2 * x3;
            float h10 = (x3 - 2 * x2 + x) * h, h11 = (x3 - x2) * h;
            float *at = out[a * substeps + i];
            for (int t = 0; t < TILE; t++)
                at[t] = h00 * k->v[a][t] + h10 * from[t] + h01 * k->v[a + 1][t] + h11 * to[t];
        }
        memcpy(from, to, sizeof from);
    }
}

// A node without light has no exit path of its own, but its path length weighs the intervals to
// its neighbours: it is interpolated from theirs.
static void interpolate_hidden(const struct knots *ft_v, uint32_t n_node, struct knots *u)
{
    float own[SINGLE_MAX_NODES + 1][TILE];
    memcpy(own, u->v, sizeof own);
    for (uint32_t a = 1; a <= n_node; a++)
        for (int t = 0; t < TILE; t++) {
            bool before = a > 1 && ft_v->v[a - 1][t] > 0;
            bool after = a < n_node && ft_v->v[a + 1][t] > 0;
            if (ft_v->v[a][t] > 0 || (!before && !after)) continue;
            float l = before ? own[a - 1][t] - u->depth[a - 1] : 0;
            float r = after ? own[a + 1][t] - u->depth[a + 1] : 0;
            u->v[a][t] = u->depth[a] + (l + r) * (before && after ? 0.5f : 1.0f);
        }
}

// Index of the k-th direction or cell in the nodes' arrays.
static inline uint32_t direction_of(const struct scratch *s, uint32_t k)
{
    return s->first ? s->first[k] : k;
}

// Directions [first, first+TILE) of the path; those from n on carry no light.
static void follow_path(const struct single_plan *plan, const struct fresnel_table *fresnel,
                        const struct scratch *s, const float *depth, uint32_t first, uint32_t n,
                        uint32_t substeps, struct path *path)
{
    struct knots u, ft_v;
    uint32_t N = plan->n_node, m = n - first < TILE ? n - first : TILE;
    memset(&u, 0, sizeof u);
    memset(&ft_v, 0, sizeof ft_v);
    for (uint32_t a = 0; a < N; a++) {
        u.depth[a + 1] = ft_v.depth[a + 1] = depth[a];
        for (uint32_t t = 0; t < m; t++) {
            u.v[a + 1][t] = depth[a] + s->node[a].path_mm[direction_of(s, first + t)];
            ft_v.v[a + 1][t] = s->node[a].transmittance[direction_of(s, first + t)];
        }
    }
    interpolate_hidden(&ft_v, N, &u);
    for (uint32_t t = 0; t < m; t++) {
        float cosine = s->cosine[direction_of(s, first + t)];
        if (cosine > 0) { // at depth 0 the exit is the tangent plane of the vertex
            u.v[0][t] = 0;
            ft_v.v[0][t] = ft_v.v[1][t] > 0 ? fresnel_table_eval(fresnel, fminf(cosine, 1)) : 0;
        } else {
            float rise = (u.v[2][t] - u.v[1][t]) / (depth[1] - depth[0]);
            u.v[0][t] = fmaxf(u.v[1][t] - rise * depth[0], 0);
            ft_v.v[0][t] = ft_v.v[1][t];
        }
    }
    subdivide(&u, N, substeps, path->u);
    subdivide(&ft_v, N, substeps, path->transmittance);
    path->n_point = N * substeps + 1;
    for (uint32_t i = 0; i < path->n_point; i++) {
        uint32_t a = i / substeps < N ? i / substeps : N - 1;
        float x = (float)(i - a * substeps) / (float)substeps;
        path->depth[i] = u.depth[a] + x * (u.depth[a + 1] - u.depth[a]);
    }
    float inv = 1 / (u.depth[N] - u.depth[N - 1]);
    for (int t = 0; t < TILE; t++)
        path->slope[t] = fmaxf((u.v[N][t] - u.v[N - 1][t]) * inv, 0.3f);
}

// The integral along the path for isotropic phase: one channel of a tile, times factor.
PRT_CLONES static void integrate_isotropic(const struct path *path, float sigma_t, float factor,
                                           float end, float sum[TILE])
{
    float exponent[TILE], before[TILE];
    uint32_t n = path->n_point;
    for (int t = 0; t < TILE; t++) {
        exponent[t] = sigma_t * path->u[0][t];
        before[t] = exp_minus(exponent[t]);
        sum[t] = 0;
    }
    for (uint32_t i = 1; i < n; i++) {
        float step = 0.5f * (path->depth[i] - path->depth[i - 1]);
        const float *u = path->u[i], *o0 = path->transmittance[i - 1],
                    *o1 = path->transmittance[i];
        for (int t = 0; t < TILE; t++) {
            float next = sigma_t * u[t], e = exp_minus(next);
            sum[t] += step * mean_exp(before[t], e, exponent[t], next) * (o0[t] + o1[t]);
            exponent[t] = next, before[t] = e;
        }
    }
    // From the last node to the end of the path the last slope continues.
    float rest = end - path->depth[n - 1];
    for (int t = 0; t < TILE; t++) {
        float last = exponent[t] + sigma_t * path->slope[t] * rest;
        sum[t] += path->transmittance[n - 1][t] * rest *
                  mean_exp(before[t], exp_minus(last), exponent[t], last);
        sum[t] *= factor;
    }
}

// SH of the refracted directions w_i' at the nodes of direction t. A node without light takes a
// neighbour's. Returns whether any node has light.
static bool node_sh(const struct single_plan *plan, const struct scratch *s, uint32_t t,
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

// The phase function's factor of w_i' in the middle of interval i of the path.
static void middle_sh(const struct single_plan *plan, const struct path *path, uint32_t i,
                      float y[SINGLE_MAX_NODES][PATH_MAX_PHASE], float out[PATH_MAX_PHASE])
{
    uint32_t substeps = (path->n_point - 1) / plan->n_node, a = (i - 1) / substeps;
    float x = ((float)(i - 1 - a * substeps) + 0.5f) / (float)substeps;
    const float *y0 = y[a ? a - 1 : 0], *y1 = y[a];
    for (uint32_t k = 0; k < plan->n_phase; k++) out[k] = y0[k] + x * (y1[k] - y0[k]);
}

// A tile with the phase function's factor of w_i': plane k gets a_l Y_k(w_i').
static void integrate_phase(const struct single_plan *plan, const struct path *path, float end,
                            const struct scratch *s, uint32_t first, uint32_t m, uint32_t n,
                            float *out)
{
    uint32_t K = plan->n_phase, last = path->n_point - 1;
    for (uint32_t t = 0; t < m; t++) {
        float y[SINGLE_MAX_NODES][PATH_MAX_PHASE], mid[PATH_MAX_PHASE];
        float sum[3][PATH_MAX_PHASE] = {{0}};
        float exponent[3], before[3];
        if (!node_sh(plan, s, direction_of(s, first + t), y)) goto write;
        for (int c = 0; c < 3; c++) {
            exponent[c] = plan->sigma_t[c] * path->u[0][t];
            before[c] = exp_minus(exponent[c]);
        }
        for (uint32_t i = 1; i <= last; i++) {
            float ft_v = 0.5f * (path->transmittance[i - 1][t] + path->transmittance[i][t]);
            float step = ft_v * (path->depth[i] - path->depth[i - 1]);
            middle_sh(plan, path, i, y, mid);
            for (int c = 0; c < 3; c++) {
                float next = plan->sigma_t[c] * path->u[i][t], e = exp_minus(next);
                float w = step * mean_exp(before[c], e, exponent[c], next);
                for (uint32_t k = 0; k < K; k++) sum[c][k] += w * mid[k];
                exponent[c] = next, before[c] = e;
            }
        }
        float rest = end - path->depth[last];
        for (int c = 0; c < 3; c++) {
            float to = exponent[c] + plan->sigma_t[c] * path->slope[t] * rest;
            float w = path->transmittance[last][t] * rest *
                      mean_exp(before[c], exp_minus(to), exponent[c], to);
            for (uint32_t k = 0; k < K; k++) sum[c][k] += w * y[plan->n_node - 1][k];
        }
    write:
        for (uint32_t c = 0; c < 3; c++)
            for (uint32_t k = 0; k < K; k++)
                out[((size_t)k * 3 + c) * n + first + t] =
                    (float)plan->phase[c].a[path_degree(k)] * plan->sigma_s[c] * sum[c][k];
    }
}

static inline __attribute__((always_inline)) uint32_t grid_of(float r)
{
    return prt_log_index(r > 0 ? r : 0, EXTINCTION_SHIFT);
}

// out[j] = integral of B_j over [0, r], linear between the table's points.
static inline __attribute__((always_inline)) void
extinction_integral(const struct extinction_table *table, int wide, float r, float *out)
{
    uint32_t b = grid_of(r), i = b < table->base ? 0 : b - table->base;
    if (i > table->n_grid - 2) i = table->n_grid - 2;
    const float *lo = table->integral + (size_t)i * EXTINCTION_WIDE, *hi = lo + EXTINCTION_WIDE;
    float width = table->r[i + 1] - table->r[i], f = width > 0 ? (r - table->r[i]) / width : 0;
    f = f < 1 ? f : 1;
    if (b < table->base) { // the functions are constant below the first point
        f = r / table->r[0];
        for (int j = 0; j < wide; j++) out[j] = f * lo[j];
        return;
    }
    for (int j = 0; j < wide; j++) out[j] = lo[j] + f * (hi[j] - lo[j]);
}

// Least change of s + s' over a step: as a share of the step, and of s + s' itself, of which
// rounding must leave some digits. Only the mean over the change is used; the table is linear
// over changes of a thousandth in most places.
static const float least_slope = 1e-3f, least_ratio = 1e-3f;

// Integrals of every function of a radial basis over a tile, X07 eq 15: with s + s'(s)
// piecewise linear they are differences of the functions' running integrals. Without `rgb` out
// is [n_phase][n_radial][n] per direction; with it (X07: the light is fixed) the directions are
// summed into out [n_phase][n_radial][3]. wide: a constant, at least the number of functions.
static inline __attribute__((always_inline)) void
radial_sums(const struct single_plan *plan, const struct path *path, float end,
            const struct scratch *s, uint32_t first, uint32_t m, uint32_t n, const float *rgb,
            int wide, float *out)
{
    const struct extinction_table *table = plan->extinction;
    uint32_t K = plan->n_phase, J = table->n_function, points = path->n_point;
    enum { WIDE = EXTINCTION_WIDE };
    for (uint32_t t = 0; t < m; t++) {
        float sum[PATH_MAX_PHASE][WIDE], y[SINGLE_MAX_NODES][PATH_MAX_PHASE],
            mid[PATH_MAX_PHASE];
        float before[WIDE], after[WIDE], u = path->u[0][t];
        bool any = node_sh(plan, s, direction_of(s, first + t), y);
        memset(sum, 0, K * sizeof *sum);
        if (any) extinction_integral(table, wide, u, before);
        for (uint32_t i = 1; any && i <= points; i++) {
            // The last step continues with the last slope to the end of the path.
            bool last = i == points;
            float step = (last ? end : path->depth[i]) - path->depth[i - 1];
            if (step <= 0) break;
            float next = last ? fmaxf(u + path->slope[t] * step, 0) : path->u[i][t];
            float ft_v = 0.5f * (path->transmittance[i - 1][t] +
                                 path->transmittance[last ? i - 1 : i][t]);
            float least = fmaxf(least_slope * step, least_ratio * u);
            if (fabsf(next - u) < least) next = u + least;
            if (ft_v <= 0 && i + 1 < points &&
                path->transmittance[i + 1][t] <= 0) { // dark on both sides
                u = next, extinction_integral(table, wide, u, before);
                continue;
            }
            extinction_integral(table, wide, next, after);
            if (last) memcpy(mid, y[plan->n_node - 1], sizeof mid);
            else middle_sh(plan, path, i, y, mid);
            for (uint32_t k = 0; k < K; k++) {
                float w = ft_v * mid[k] * step / (next - u);
                for (int j = 0; j < wide; j++) sum[k][j] += w * (after[j] - before[j]);
            }
            memcpy(before, after, (size_t)wide * sizeof *before);
            u = next;
        }
        for (uint32_t k = 0; k < K; k++)
            for (uint32_t j = 0; j < J; j++) {
                const float *light = rgb ? rgb + (size_t)(first + t) * 3 : NULL;
                if (!rgb) out[((size_t)k * J + j) * n + first + t] = sum[k][j];
                for (int c = 0; rgb && any && c < 3; c++)
                    out[(k * J + j) * 3 + (uint32_t)c] += sum[k][j] * light[c];
            }
    }
}

PRT_CLONES static void integrate_radial(const struct single_plan *plan, const struct path *path,
                                        float end, const struct scratch *s, uint32_t first,
                                        uint32_t m, uint32_t n, const float *rgb, float *out)
{
    if (plan->extinction->n_function <= EXTINCTION_WIDE / 2)
        radial_sums(plan, path, end, s, first, m, n, rgb, EXTINCTION_WIDE / 2, out);
    else radial_sums(plan, path, end, s, first, m, n, rgb, EXTINCTION_WIDE, out);
}

void prt_path_integrate(const struct single_plan *plan, const struct fresnel_table *fresnel,
                        const struct scratch *s, const float *depth, float end, uint32_t n,
                        const float *rgb, float *out)
{
    uint32_t substeps = plan->extinction ? RADIAL_SUBSTEPS : SUBSTEPS;
    for (uint32_t first = 0; first < n; first += TILE) {
        struct path path;
        uint32_t m = n - first < TILE ? n - first : TILE;
        follow_path(plan, fresnel, s, depth, first, n, substeps, &path);
        if (plan->extinction) {
            integrate_radial(plan, &path, end, s, first, m, n, rgb, out);
        } else if (plan->n_phase > 1) {
            integrate_phase(plan, &path, end, s, first, m, n, out);
        } else {
            for (uint32_t c = 0; c < 3; c++) {
                float sum[TILE], factor = plan->sigma_s[c] * (float)(0.5 / sqrt(M_PI));
                integrate_isotropic(&path, plan->sigma_t[c], factor, end, sum);
                memcpy(out + (size_t)c * n + first, sum, m * sizeof *sum);
            }
        }
    }
}
