// SPDX-License-Identifier: MIT
// Single scattering along -n_o (W05 eq 10-12, METHODS §3.5) with far fewer rays than texels x
// points: along the path, the way out towards a direction is piecewise linear in depth for any
// smooth surface, so it is traced at five depths and the exponentials between them are
// integrated in closed form. The deeper depths share one ray between 2 x 2 texels, but for
// those near the horizon.
#include "bake/stages.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_PHASE = 9 };

// What a direction meets at a node: distance out s', F_t V, and the refracted way in.
struct exits {
    float *way;      // s_i' [mm]
    float *open;     // F_t(eta, w_i) V, 0 when blocked
    float *dir[3];   // w_i' outward
};

struct scratch {
    struct exits node[SINGLE_MAX_NODES];
    float *side;     // [n_coef] cosine between texel and vertex normal
    float *y;        // [MAX_PHASE] SH of one direction
};

static size_t exits_floats(uint32_t n_coef)
{
    return 5 * (size_t)n_coef;
}

size_t single_scratch_bytes(const struct single_plan *plan)
{
    return (SINGLE_MAX_NODES * exits_floats(plan->n_direction) + plan->n_direction + 64) *
           sizeof(float);
}

static void carve(const struct single_plan *plan, void *memory, struct scratch *s)
{
    float *at = memory;
    uint32_t n = plan->n_direction;
    for (int a = 0; a < SINGLE_MAX_NODES; a++) {
        s->node[a].way = at, at += n;
        s->node[a].open = at, at += n;
        for (int k = 0; k < 3; k++) s->node[a].dir[k] = at, at += n;
    }
    s->side = at, at += n;
    s->y = at;
}

struct lane_out {
    float way, open, dir[3];
};

// Traces up to 16 directions from one point inside the body to their exits. Returns rays cast.
static unsigned trace_exits(const struct single_plan *plan, const struct fresnel_table *fresnel,
                            const float p[3], struct prt_packet *packet, uint32_t mask,
                            struct lane_out out[16])
{
    const struct prt_mesh *mesh = plan->mesh;
    float eps = prt_scene_epsilon(plan->scene);
    struct prt_packet shadow;
    float n_cos[16];
    uint32_t ask = 0;
    for (int i = 0; i < 16; i++) {
        packet->ox[i] = p[0], packet->oy[i] = p[1], packet->oz[i] = p[2];
        packet->tnear[i] = 0;
        out[i] = (struct lane_out){0};
    }
    prt_scene_intersect16(plan->scene, packet, mask, true);
    unsigned rays = (unsigned)__builtin_popcount(mask);
    for (int i = 0; i < 16; i++) {
        if (!(mask >> i & 1) || packet->triangle[i] == UINT32_MAX) continue;
        const uint32_t *tv = mesh->triangle[packet->triangle[i]];
        const float *a = mesh->position[tv[0]], *b = mesh->position[tv[1]],
                    *c = mesh->position[tv[2]];
        float e[3], f[3], g[3], w[3] = {packet->dx[i], packet->dy[i], packet->dz[i]};
        for (int k = 0; k < 3; k++) e[k] = b[k] - a[k], f[k] = c[k] - a[k];
        g[0] = e[1] * f[2] - e[2] * f[1];
        g[1] = e[2] * f[0] - e[0] * f[2];
        g[2] = e[0] * f[1] - e[1] * f[0];
        float facing = g[0] * w[0] + g[1] * w[1] + g[2] * w[2];
        float glen = sqrtf(g[0] * g[0] + g[1] * g[1] + g[2] * g[2]);
        if (facing <= 0 || glen <= 0) continue; // a front face: the point lies outside
        float n[3], len = 0, cosine = 0, u = packet->u[i], v = packet->v[i];
        for (int k = 0; k < 3; k++) {
            n[k] = (1 - u - v) * mesh->normal[tv[0]][k] + u * mesh->normal[tv[1]][k] +
                   v * mesh->normal[tv[2]][k];
            len += n[k] * n[k];
        }
        len = len > 0 ? 1 / sqrtf(len) : 0;
        for (int k = 0; k < 3; k++) n[k] *= len, cosine += n[k] * w[k];
        if (cosine <= 0) continue; // below the shading horizon: F_t V is 0
        if (cosine > 1) cosine = 1;
        float inv = 1 / plan->eta, root = sqrtf(1 - inv * inv * (1 - cosine * cosine));
        out[i].way = packet->t[i] * cosine / root; // METHODS §1, s_i'
        // The refracted direction, pointing back outwards: w/eta + (root - cos/eta) n.
        for (int k = 0; k < 3; k++) out[i].dir[k] = w[k] * inv + (root - cosine * inv) * n[k];
        n_cos[i] = cosine;
        ask |= 1u << i;
        shadow.ox[i] = p[0] + packet->t[i] * w[0] + eps * g[0] / glen;
        shadow.oy[i] = p[1] + packet->t[i] * w[1] + eps * g[1] / glen;
        shadow.oz[i] = p[2] + packet->t[i] * w[2] + eps * g[2] / glen;
        shadow.dx[i] = w[0], shadow.dy[i] = w[1], shadow.dz[i] = w[2];
        shadow.tnear[i] = 0, shadow.tfar[i] = INFINITY;
    }
    if (!ask) return rays;
    for (int i = 0; i < 16; i++)
        if (!(ask >> i & 1)) {
            shadow.ox[i] = shadow.oy[i] = shadow.oz[i] = 0;
            shadow.dx[i] = 1, shadow.dy[i] = shadow.dz[i] = 0;
            shadow.tnear[i] = 0, shadow.tfar[i] = 0;
        }
    uint32_t blocked = prt_scene_occluded16(plan->scene, &shadow, ask);
    rays += (unsigned)__builtin_popcount(ask);
    for (int i = 0; i < 16; i++)
        if ((ask & ~blocked) >> i & 1) out[i].open = fresnel_table_eval(fresnel, n_cos[i]);
    return rays;
}

static float smallest(const float c[3])
{
    return fminf(c[0], fminf(c[1], c[2]));
}

static float largest(const float c[3])
{
    return fmaxf(c[0], fmaxf(c[1], c[2]));
}

void single_plan_depths(struct single_plan *plan)
{
    if (plan->extinction) { // any extinction may come: nodes over every scale of the body
        plan->n_node = SINGLE_MAX_NODES, plan->n_fine = 1;
        plan->first_mm = 0.05f, plan->last_mm = 60, plan->inward_mm = INFINITY;
        return;
    }
    plan->n_node = 5, plan->n_fine = 2;
    plan->first_mm = 0.1f / largest(plan->sigma_t);
    plan->last_mm = 4 / smallest(plan->sigma_t);
    plan->inward_mm = 12 / smallest(plan->sigma_t);
}

static float luminance(const float c[3])
{
    return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2];
}

// The direction that stands for texel i (0..3) of block b: one sub-sample of one jitter, the same
// at every depth, so that the way out can be followed from node to node.
static size_t texel_ray(const struct directions *d, unsigned pattern, uint32_t block, uint32_t i)
{
    return ((size_t)(pattern % d->n_pattern) * d->n_packet + block) * 16 + i * 4 +
           (((pattern >> 6) + i) & 3);
}

// The far end of the rays that leave through the bulk: nothing comes back from deeper.
static void limit_inward(const float n[3], float most, struct prt_packet *packet)
{
    for (int i = 0; i < 16; i++)
        if (n[0] * packet->dx[i] + n[1] * packet->dy[i] + n[2] * packet->dz[i] < -0.1f)
            packet->tfar[i] = most;
}

static void store(struct exits *e, uint32_t texel, const struct lane_out *lane)
{
    e->way[texel] = lane->way;
    e->open[texel] = lane->open;
    for (int k = 0; k < 3; k++) e->dir[k][texel] = lane->dir[k];
}

// Rays waiting to be traced from one point, each for one texel or for the four of its block.
struct queue {
    const struct single_plan *plan;
    const struct fresnel_table *fresnel;
    const float *p, *n;
    struct exits *out;
    struct prt_packet packet;
    uint32_t fill, texel[16];  // texel: first of four entries of directions.texel, or one
    bool shared[16];
    uint64_t rays;
};

static void flush(struct queue *q)
{
    struct lane_out lane[16], nothing = {.way = fminf(2 * q->plan->inward_mm, 1e4f)};
    uint32_t mask = q->fill == 16 ? 0xffff : (1u << q->fill) - 1;
    if (!q->fill) return;
    for (uint32_t i = 0; i < 16; i++) {
        if (i >= q->fill) q->packet.dx[i] = 1, q->packet.dy[i] = q->packet.dz[i] = 0;
        q->packet.tfar[i] = INFINITY;
    }
    limit_inward(q->n, q->plan->inward_mm, &q->packet);
    q->rays += trace_exits(q->plan, q->fresnel, q->p, &q->packet, mask, lane);
    for (uint32_t i = 0; i < q->fill; i++) {
        const struct lane_out *from = lane[i].way > 0 || lane[i].open > 0 ? &lane[i] : &nothing;
        const uint32_t *texel = q->plan->directions->texel + q->texel[i];
        for (uint32_t j = 0; j < (q->shared[i] ? 4u : 1u); j++) store(q->out, texel[j], from);
    }
    q->fill = 0;
}

static void push(struct queue *q, unsigned pattern, uint32_t block, uint32_t i, bool shared)
{
    const struct directions *d = q->plan->directions;
    size_t at = texel_ray(d, pattern, block, i);
    q->packet.dx[q->fill] = d->x[at], q->packet.dy[q->fill] = d->y[at];
    q->packet.dz[q->fill] = d->z[at];
    q->texel[q->fill] = block * 4 + (shared ? 0 : i);
    q->shared[q->fill] = shared;
    if (++q->fill == 16) flush(q);
}

static const float horizon = 0.12f; // |cosine| below which a block's texels differ too much

// Fills a node for every texel: a ray each, or, for a coarse node, one for a whole 2 x 2 block
// away from the horizon. What was too far from the surface at the shallower node stays so.
static uint64_t trace_node(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           const float p[3], const float n[3], unsigned pattern, bool fine,
                           const struct exits *shallower, float dead, const float *side,
                           struct exits *out)
{
    const struct directions *d = plan->directions;
    struct queue q = {.plan = plan, .fresnel = fresnel, .p = p, .n = n, .out = out};
    struct lane_out nothing = {.way = fminf(2 * plan->inward_mm, 1e4f)};
    for (uint32_t block = 0; block < d->n_packet; block++) {
        const uint32_t *texel = d->texel + (size_t)block * 4;
        bool alone = fine, alive = !shallower;
        for (int i = 0; i < 4; i++) {
            if (!fine && fabsf(side[texel[i]]) < horizon) alone = true;
            if (shallower && shallower->way[texel[i]] < dead) alive = true;
        }
        for (uint32_t i = 0; !alive && i < 4; i++) store(out, texel[i], &nothing);
        if (alive && !alone) push(&q, pattern, block, (block + pattern) & 3, true);
        for (uint32_t i = 0; alive && alone && i < 4; i++) push(&q, pattern, block, i, false);
    }
    flush(&q);
    return q.rays;
}

// Depths of the nodes: geometric over the channels' extinctions, inside the body.
static void place_nodes(const struct single_plan *plan, float thickness, float *depth)
{
    float first = fminf(plan->first_mm, 0.06f * thickness);
    float last = fminf(plan->last_mm, 0.85f * thickness);
    for (uint32_t a = 0; a < plan->n_node; a++)
        depth[a] = first * powf(last / first, (float)a / (float)(plan->n_node - 1));
}

// e^-x for x >= 0, relative error 2e-6; unlike expf the compiler vectorises it.
static inline float exp_minus(float x)
{
    float y = x * -1.44269504f;
    y = y > -125.0f ? y : -125.0f;
    float whole = (float)(int)(y - 0.5f), f = (y - whole) * 0.69314718f;
    float p = 1 + f * (1 + f * (0.5f + f * (0.166666667f + f * (0.0416666667f +
              f * (0.00833333333f + f * 0.00138888889f)))));
    union {
        int32_t i;
        float f;
    } scale = {((int32_t)whole + 127) << 23};
    return p * scale.f;
}

// (e^-a - e^-b) / (b - a), the mean of an exponential between two exponents.
static inline float mean_exp(float ea, float eb, float a, float b)
{
    float d = b - a;
    return fabsf(d) > 1e-2f ? (ea - eb) / d : 0.5f * (ea + eb) * (1 - d * d / 12);
}

// Everything along the path for isotropic phase: three channels of every texel.
PRT_CLONES static void integrate_isotropic(uint32_t n_coef, const float sigma_t[3],
                                           const float factor[3], uint32_t n_node,
                                           const float *depth, float end,
                                           const float *const *way, const float *const *open,
                                           const float *outer, float *out)
{
    for (int c = 0; c < 3; c++) {
        float s = sigma_t[c], *row = out + (size_t)c * n_coef;
        for (uint32_t t = 0; t < n_coef; t++) {
            // At the surface itself: directions above it leave at once.
            float way0 = outer[t] > 0 ? 0
                                      : fmaxf(way[0][t] - (way[1][t] - way[0][t]) * depth[0] /
                                                              (depth[1] - depth[0]),
                                              0);
            float open_before = open[0][t], exponent = s * way0, before = exp_minus(exponent);
            float sum = 0, depth_before = 0, slope = 0;
            for (uint32_t a = 0; a < n_node; a++) {
                float next = s * (depth[a] + way[a][t]), e = exp_minus(next);
                float step = depth[a] - depth_before;
                sum += step * mean_exp(before, e, exponent, next) * 0.5f *
                       (open_before + open[a][t]);
                slope = (next - exponent) / step;
                exponent = next, before = e;
                depth_before = depth[a], open_before = open[a][t];
            }
            // Beyond the last node: the last slope goes on to the end of the path.
            float rest = end - depth_before, last = exponent + fmaxf(slope, 0.3f * s) * rest;
            sum += open_before * rest * mean_exp(before, exp_minus(last), exponent, last);
            row[t] = factor[c] * sum;
        }
    }
}

// The same with the phase function's light part: plane k gets a_l Y_k(w_i').
static void integrate_phase(const struct single_plan *plan, const float *depth, float end,
                            const struct scratch *s, const float *outer, float *out)
{
    uint32_t n = plan->directions->n_coef, K = plan->n_phase, n_node = plan->n_node;
    for (uint32_t t = 0; t < n; t++) {
        float y[SINGLE_MAX_NODES][MAX_PHASE];
        for (uint32_t a = 0; a < n_node; a++) {
            float w[3] = {s->node[a].dir[0][t], s->node[a].dir[1][t], s->node[a].dir[2][t]};
            memset(y[a], 0, sizeof y[a]);
            if (s->node[a].open[t] > 0) prt_sh_eval(K == 9 ? 3 : 2, w, y[a]);
            for (uint32_t k = 0; k < K; k++) y[a][k] *= s->node[a].open[t];
        }
        for (int c = 0; c < 3; c++) {
            float st = plan->sigma_t[c], sum[MAX_PHASE] = {0};
            float way0 = outer[t] > 0 ? 0
                                      : fmaxf(s->node[0].way[t] -
                                                  (s->node[1].way[t] - s->node[0].way[t]) *
                                                      depth[0] / (depth[1] - depth[0]),
                                              0);
            float exponent = st * way0, before = exp_minus(exponent), depth_before = 0, slope = 0;
            for (uint32_t a = 0; a < n_node; a++) {
                float next = st * (depth[a] + s->node[a].way[t]), e = exp_minus(next);
                float step = depth[a] - depth_before;
                float w = step * mean_exp(before, e, exponent, next) * 0.5f;
                for (uint32_t k = 0; k < K; k++) sum[k] += w * (y[a ? a - 1 : 0][k] + y[a][k]);
                slope = (next - exponent) / step;
                exponent = next, before = e, depth_before = depth[a];
            }
            float left = end - depth_before, last = exponent + fmaxf(slope, 0.3f * st) * left;
            float rest = left * mean_exp(before, exp_minus(last), exponent, last);
            for (uint32_t k = 0; k < K; k++) {
                unsigned l = k == 0 ? 0 : k < 4 ? 1 : 2;
                out[((size_t)k * 3 + (unsigned)c) * n + t] =
                    (float)plan->phase[c].a[l] * plan->sigma_s[c] *
                    (sum[k] + rest * y[n_node - 1][k]);
            }
        }
    }
}

static float surface_way(const struct scratch *s, const float *depth, uint32_t t)
{
    if (s->side[t] > 0) return 0;
    float rise = (s->node[1].way[t] - s->node[0].way[t]) / (depth[1] - depth[0]);
    return fmaxf(s->node[0].way[t] - rise * depth[0], 0);
}

// Integrals of every function of a radial basis over the path, X07 eq 14: with s + s'(s)
// piecewise linear they are differences of the functions' running integrals. Without `rgb` out
// is [n_phase][n_radial][n] per direction; with it (X07: the light is fixed) the directions are
// summed into out [n_phase][n_radial][3].
static void integrate_radial(const struct single_plan *plan, const float *depth, float end,
                             const struct scratch *s, uint32_t n, const float *rgb, float *out)
{
    const struct extinction_table *table = plan->extinction;
    uint32_t K = plan->n_phase, J = table->n_function;
    enum { WIDE = EXTINCTION_WIDE };
    for (uint32_t t = 0; t < n; t++) {
        float sum[MAX_PHASE][WIDE], y[SINGLE_MAX_NODES][MAX_PHASE], before[WIDE], after[WIDE];
        bool any = false;
        for (uint32_t a = 0; a < plan->n_node; a++) {
            float w[3] = {s->node[a].dir[0][t], s->node[a].dir[1][t], s->node[a].dir[2][t]};
            float open = s->node[a].open[t];
            memset(y[a], 0, sizeof y[a]);
            if (open <= 0) continue;
            any = true;
            prt_sh_eval(K == 9 ? 3 : K == 4 ? 2 : 1, w, y[a]);
            for (uint32_t k = 0; k < K; k++) y[a][k] *= open;
        }
        memset(sum, 0, sizeof sum);
        float u = surface_way(s, depth, t), depth_before = 0, slope = 1;
        if (any) extinction_integral(table, u, before);
        for (uint32_t a = 0; any && a <= plan->n_node; a++) {
            // The last step goes on to the end of the path with the last slope.
            bool last = a == plan->n_node;
            float at = last ? end : depth[a], step = at - depth_before;
            if (step <= 0) break;
            float next = last ? u + fmaxf(slope, 0.25f) * step : at + s->node[a].way[t];
            if (fabsf(next - u) < 1e-3f * step) next = u + 1e-3f * step;
            extinction_integral(table, next, after);
            slope = (next - u) / step;
            const float *y0 = y[a ? a - 1 : 0], *y1 = y[last ? a - 1 : a];
            for (uint32_t k = 0; k < K; k++) {
                float w = 0.5f * (y0[k] + y1[k]) / slope;
                for (int j = 0; j < WIDE; j++) sum[k][j] += w * (after[j] - before[j]);
            }
            memcpy(before, after, sizeof before);
            u = next, depth_before = at;
        }
        for (uint32_t k = 0; k < K; k++)
            for (uint32_t j = 0; j < J; j++) {
                if (!rgb)
                    out[((size_t)k * J + j) * n + t] = sum[k][j];
                else if (any)
                    for (int c = 0; c < 3; c++)
                        out[(k * J + j) * 3 + (uint32_t)c] += sum[k][j] * rgb[t * 3 + (uint32_t)c];
            }
    }
}

// The nodes of a list of directions, one ray each (a fixed light's own directions).
static uint64_t trace_list(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           const float p[3], uint32_t n, const float *x, const float *y,
                           const float *z, struct exits *out)
{
    struct prt_packet packet;
    struct lane_out lane[16];
    uint64_t rays = 0;
    for (uint32_t first = 0; first < n; first += 16) {
        uint32_t m = n - first < 16 ? n - first : 16, mask = m < 16 ? (1u << m) - 1 : 0xffff;
        for (uint32_t i = 0; i < 16; i++) {
            uint32_t k = first + (i < m ? i : 0);
            packet.dx[i] = x[k], packet.dy[i] = y[k], packet.dz[i] = z[k];
            packet.tfar[i] = INFINITY;
        }
        rays += trace_exits(plan, fresnel, p, &packet, mask, lane);
        struct lane_out nothing = {.way = 1e4f};
        for (uint32_t i = 0; i < m; i++)
            store(out, first + i, lane[i].way > 0 || lane[i].open > 0 ? &lane[i] : &nothing);
    }
    return rays;
}

static float thickness_at(const struct single_plan *plan, const float x[3], const float n[3])
{
    float eps = prt_scene_epsilon(plan->scene), down[3], start[3], t, u, v;
    uint32_t triangle;
    float deep = fminf(3 * plan->inward_mm, 1e5f);
    for (int k = 0; k < 3; k++) down[k] = -n[k], start[k] = x[k] - eps * n[k];
    if (prt_scene_intersect(plan->scene, start, down, eps, deep, &t, &triangle, &u, &v))
        return fmaxf(t, 4 * eps);
    return deep;
}

uint64_t single_light(const struct single_plan *plan, const struct fresnel_table *fresnel,
                      uint32_t vertex, uint32_t n, const float *x, const float *y,
                      const float *z, const float *rgb, float *out, void *memory)
{
    const float *p = plan->mesh->position[vertex], *normal = plan->mesh->normal[vertex];
    struct scratch s = {0};
    float depth[SINGLE_MAX_NODES], thickness = thickness_at(plan, p, normal);
    uint64_t rays = 1;
    carve(plan, memory, &s);
    place_nodes(plan, thickness, depth);
    for (uint32_t a = 0; a < plan->n_node; a++) {
        float at[3];
        for (int k = 0; k < 3; k++) at[k] = p[k] - depth[a] * normal[k];
        rays += trace_list(plan, fresnel, at, n, x, y, z, &s.node[a]);
    }
    for (uint32_t t = 0; t < n; t++)
        s.side[t] = normal[0] * x[t] + normal[1] * y[t] + normal[2] * z[t];
    memset(out, 0, (size_t)plan->n_phase * plan->extinction->n_function * 3 * sizeof *out);
    integrate_radial(plan, depth, fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm), &s,
                     n, rgb, out);
    return rays;
}

// W05 as printed: n_point points, every texel's ray at each; the yardstick of the above.
static uint64_t every_ray(const struct single_plan *plan, const struct fresnel_table *fresnel,
                          const float x[3], const float n[3], float thickness, unsigned pattern,
                          struct scratch *s, float *out)
{
    const struct directions *d = plan->directions;
    uint32_t K = plan->n_phase;
    float sigma = luminance(plan->sigma_t), lambda = 1 - expf(-sigma * thickness);
    uint64_t rays = 0;
    memset(out, 0, (size_t)K * 3 * d->n_coef * sizeof *out);
    for (uint32_t i = 0; i < plan->n_point; i++) {
        float xi = ((float)i + 0.5f) / (float)plan->n_point;
        float depth = -logf(1 - xi * lambda) / sigma, p[3];
        float weight = lambda / ((float)plan->n_point * sigma * expf(-sigma * depth));
        for (int k = 0; k < 3; k++) p[k] = x[k] - depth * n[k];
        rays += trace_node(plan, fresnel, p, n, pattern + i * 0x51, true, NULL, 0, NULL,
                           &s->node[0]);
        for (uint32_t t = 0; t < d->n_coef; t++) {
            float open = s->node[0].open[t];
            if (open <= 0) continue;
            float w[3] = {s->node[0].dir[0][t], s->node[0].dir[1][t], s->node[0].dir[2][t]};
            prt_sh_eval(K == 9 ? 3 : K == 4 ? 2 : 1, w, s->y);
            for (int c = 0; c < 3; c++) {
                float e = open * weight * plan->sigma_s[c] *
                          exp_minus(plan->sigma_t[c] * (depth + s->node[0].way[t]));
                for (uint32_t k = 0; k < K; k++) {
                    unsigned l = k == 0 ? 0 : k < 4 ? 1 : 2;
                    out[((size_t)k * 3 + (unsigned)c) * d->n_coef + t] +=
                        e * (float)plan->phase[c].a[l] * s->y[k];
                }
            }
        }
    }
    return rays;
}

uint64_t single_rows(const struct single_plan *plan, const struct fresnel_table *fresnel,
                     uint32_t vertex, float *out, void *memory)
{
    const struct directions *d = plan->directions;
    const float *x = plan->mesh->position[vertex], *n = plan->mesh->normal[vertex];
    struct scratch s = {0};
    carve(plan, memory, &s);
    uint64_t rays = 1;
    float thickness = thickness_at(plan, x, n);
    unsigned pattern = (unsigned)(prt_hash64(&vertex, sizeof vertex, plan->seed) >> 20);
    if (plan->every_ray)
        return rays + every_ray(plan, fresnel, x, n, thickness, pattern, &s, out);
    float depth[SINGLE_MAX_NODES], end;
    const float *way[SINGLE_MAX_NODES], *open[SINGLE_MAX_NODES];
    place_nodes(plan, thickness, depth);
    for (uint32_t k = 0; k < d->n_packet * 4; k++) {
        size_t at = texel_ray(d, pattern, k / 4, k % 4);
        s.side[d->texel[k]] = n[0] * d->x[at] + n[1] * d->y[at] + n[2] * d->z[at];
    }
    for (uint32_t a = 0; a < plan->n_node && a < SINGLE_MAX_NODES; a++) {
        float p[3];
        for (int k = 0; k < 3; k++) p[k] = x[k] - depth[a] * n[k];
        float dead = 0.6f * plan->inward_mm - depth[a];
        rays += trace_node(plan, fresnel, p, n, pattern, a < plan->n_fine,
                           a ? &s.node[a - 1] : NULL, dead, s.side, &s.node[a]);
        way[a] = s.node[a].way, open[a] = s.node[a].open;
    }
    end = fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm);
    if (plan->extinction) {
        integrate_radial(plan, depth, end, &s, d->n_coef, NULL, out);
    } else if (plan->n_phase == 1) {
        float factor[3];
        for (int c = 0; c < 3; c++) factor[c] = plan->sigma_s[c] * (float)(0.5 / sqrt(M_PI));
        integrate_isotropic(d->n_coef, plan->sigma_t, factor, plan->n_node, depth, end, way,
                            open, s.side, out);
    } else {
        integrate_phase(plan, depth, end, &s, s.side, out);
    }
    return rays;
}
