// SPDX-License-Identifier: MIT
// Single scattering along -n_o (W05 eq 10-12, METHODS §3.5) with far fewer rays than texels x
// points: along the path the way out towards a direction is nearly linear in depth, so it is
// traced at a few depths, a monotone cubic is laid through them and the exponentials between
// its points are integrated in closed form. Of each 2 x 2 texels one is traced; the others only
// where its neighbours met something else.
#include "bake/stages.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MAX_PHASE = 9, TILE = 128, SUBSTEPS = 4, RADIAL_SUBSTEPS = 2 };
enum { MAX_POINTS = SINGLE_MAX_NODES * SUBSTEPS + 1 };

// What a direction meets at a node: distance out s', F_t V, and the refracted way in.
struct exits {
    float *way;      // s_i' [mm]
    float *open;     // F_t(eta, w_i) V, 0 when blocked
    float *dir[3];   // w_i' outward
};

struct scratch {
    struct exits node[SINGLE_MAX_NODES];
    float *side;     // [n_coef] cosine between texel and vertex normal
    float *value;    // [n_coef/4] what a block's ray brings, to find where neighbours differ
    float *y;        // [MAX_PHASE] SH of one direction
};

static size_t exits_floats(uint32_t n_coef)
{
    return 5 * (size_t)n_coef;
}

size_t single_scratch_bytes(const struct single_plan *plan)
{
    return (SINGLE_MAX_NODES * exits_floats(plan->n_direction) + 2 * (size_t)plan->n_direction +
            64) * sizeof(float);
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
    s->value = at, at += n;
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
        plan->n_node = 7;
        plan->differ = 0.05f;
        plan->first_mm = 0.05f, plan->last_mm = 60, plan->inward_mm = INFINITY;
        plan->weakest = 0.05f;
        return;
    }
    plan->n_node = 7;
    plan->differ = 0.02f;
    plan->weakest = smallest(plan->sigma_t);
    plan->first_mm = 0.1f / largest(plan->sigma_t);
    plan->last_mm = 4 / plan->weakest;
    plan->inward_mm = 9 / plan->weakest;
}

static float luminance(const float c[3])
{
    return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2];
}

// The direction that stands for texel i (0..3) of block b: one sub-sample of one jitter.
static size_t texel_ray(const struct directions *d, unsigned pattern, uint32_t block, uint32_t i)
{
    return ((size_t)(pattern % d->n_pattern) * d->n_packet + block) * 16 + i * 4 +
           (((pattern >> 6) + i) & 3);
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
    const float *p;
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
        q->packet.tfar[i] = q->plan->inward_mm; // nothing comes back from deeper
    }
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

// e^-x for x >= 0, relative error 1e-5; without a branch, or a choice that the compiler makes
// one of, so that loops over it vectorise.
static inline __attribute__((always_inline)) float exp_minus(float x)
{
    float y = x * -1.44269504f;
    y = 0.5f * (y - 125 + fabsf(y + 125)); // max(y, -125)
    float whole = (float)(int)(y - 0.5f), f = (y - whole) * 0.69314718f;
    float p = 1 + f * (1 + f * (0.5f + f * (0.166666667f + f * (0.0416666667f +
              f * (0.00833333333f + f * 0.00138888889f)))));
    union {
        int32_t i;
        float f;
    } scale = {((int32_t)whole + 127) << 23};
    return p * scale.f;
}

// A ray for every texel.
static uint64_t trace_every(const struct single_plan *plan, const struct fresnel_table *fresnel,
                            const float p[3], unsigned pattern, struct exits *out)
{
    struct queue q = {.plan = plan, .fresnel = fresnel, .p = p, .out = out};
    for (uint32_t block = 0; block < plan->directions->n_packet; block++)
        for (uint32_t i = 0; i < 4; i++) push(&q, pattern, block, i, false);
    flush(&q);
    return q.rays;
}

// Whether a block's neighbours on its face met something else; value < 0: not traced.
static bool differs(const float *value, uint32_t b, uint32_t half, float most)
{
    uint32_t x = b % half, y = b / half % half;
    return (x && fabsf(value[b] - value[b - 1]) > most) ||
           (x + 1 < half && fabsf(value[b] - value[b + 1]) > most) ||
           (y && fabsf(value[b] - value[b - half]) > most) ||
           (y + 1 < half && fabsf(value[b] - value[b + half]) > most);
}

// The k-th block in tiles of 4 x 4 blocks, so that rays traced together stay together.
static uint32_t tiled(uint32_t k, uint32_t half)
{
    if (half % 4) return k;
    uint32_t face = k / (half * half), in = k % (half * half), tile = in / 16, i = in % 16;
    uint32_t x = tile % (half / 4) * 4 + (i & 3), y = tile / (half / 4) * 4 + (i >> 2);
    return (face * half + y) * half + x;
}

// Fills a node for every texel: a ray for each 2 x 2 block, and for each texel of the blocks
// whose neighbours differ. What was too far from the surface at the shallower node stays so.
static uint64_t trace_node(const struct single_plan *plan, const struct fresnel_table *fresnel,
                           const float p[3], unsigned pattern, float depth,
                           const struct exits *shallower, float *value, struct exits *out)
{
    const struct directions *d = plan->directions;
    struct queue q = {.plan = plan, .fresnel = fresnel, .p = p, .out = out};
    struct lane_out nothing = {.way = fminf(2 * plan->inward_mm, 1e4f)};
    float dead = 0.8f * plan->inward_mm - depth;
    for (uint32_t k = 0; k < d->n_packet; k++) {
        uint32_t b = tiled(k, d->n / 2);
        const uint32_t *texel = d->texel + (size_t)b * 4;
        bool alive = !shallower;
        for (int i = 0; !alive && i < 4; i++) alive = shallower->way[texel[i]] < dead;
        for (uint32_t i = 0; !alive && i < 4; i++) store(out, texel[i], &nothing);
        value[b] = alive ? 0 : -1;
        if (alive) push(&q, pattern, b, (b + pattern) & 3, true);
    }
    flush(&q);
    float most = plan->differ * expf(plan->weakest * depth);
    for (uint32_t b = 0; b < d->n_packet; b++) {
        uint32_t t = d->texel[(size_t)b * 4];
        if (value[b] >= 0) value[b] = out->open[t] * exp_minus(plan->weakest * out->way[t]);
    }
    for (uint32_t k = 0; k < d->n_packet; k++) {
        uint32_t b = tiled(k, d->n / 2);
        if (value[b] < 0 || !differs(value, b, d->n / 2, most)) continue;
        for (uint32_t i = 0; i < 4; i++)
            if (i != ((b + pattern) & 3)) push(&q, pattern, b, i, false);
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

// (e^-a - e^-b) / (b - a), the mean of an exponential between two exponents: the quotient, or
// near a = b its series, blended around a difference of 0.1, where both hold to 1e-5.
static inline __attribute__((always_inline)) float mean_exp(float ea, float eb, float a, float b)
{
    float d = b - a, d2 = d * d;
    float quotient = (ea - eb) * d / (d2 + 1e-12f);
    float series = 0.5f * (ea + eb) * (1 - d2 * (1.0f / 12));
    float x = 0.5f * (100 * d2 + 4 - fabsf(100 * d2 - 4)), x2 = x * x, x4 = x2 * x2;
    float far = x4 * x4 / (1 + x4 * x4);
    return far * quotient + (1 - far) * series;
}

// A tile of directions along the path: depth + way out and F_t V at the points of a monotone
// cubic through surface and nodes.
struct path {
    uint32_t n_point;                       // 1 + n_node * substeps
    float depth[MAX_POINTS];
    float u[MAX_POINTS][TILE];              // s + s' [mm]
    float open[MAX_POINTS][TILE];
    float slope[TILE];                      // of u beyond the last node
};

// Slope at a point between two chords (Fritsch and Carlson's monotone cubic).
static inline __attribute__((always_inline)) float pchip(float h0, float h1, float m0, float m1)
{
    float w0 = 2 * h1 + h0, w1 = h1 + 2 * h0, low = w0 * m1 + w1 * m0;
    return m0 * m1 > 0 ? (w0 + w1) * m0 * m1 / low : 0;
}

struct knots {
    float depth[SINGLE_MAX_NODES + 1];
    float v[SINGLE_MAX_NODES + 1][TILE];    // values
};

// Lays `substeps` points into every interval of the knots.
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

// A hidden node brings no light, but the way out at its depth weighs what lies between it and
// its neighbours: it takes theirs.
static void borrow_ways(const struct knots *open, uint32_t n_node, struct knots *u)
{
    float own[SINGLE_MAX_NODES + 1][TILE];
    memcpy(own, u->v, sizeof own);
    for (uint32_t a = 1; a <= n_node; a++)
        for (int t = 0; t < TILE; t++) {
            bool before = a > 1 && open->v[a - 1][t] > 0;
            bool after = a < n_node && open->v[a + 1][t] > 0;
            if (open->v[a][t] > 0 || (!before && !after)) continue;
            float l = before ? own[a - 1][t] - u->depth[a - 1] : 0;
            float r = after ? own[a + 1][t] - u->depth[a + 1] : 0;
            u->v[a][t] = u->depth[a] + (l + r) * (before && after ? 0.5f : 1.0f);
        }
}

// Directions [first, first+TILE) of the path; beyond n they are dark.
static void follow_path(const struct single_plan *plan, const struct fresnel_table *fresnel,
                        const struct scratch *s, const float *depth, uint32_t first, uint32_t n,
                        uint32_t substeps, struct path *path)
{
    struct knots u, open;
    uint32_t N = plan->n_node, m = n - first < TILE ? n - first : TILE;
    memset(&u, 0, sizeof u);
    memset(&open, 0, sizeof open);
    for (uint32_t a = 0; a < N; a++) {
        u.depth[a + 1] = open.depth[a + 1] = depth[a];
        for (uint32_t t = 0; t < m; t++) {
            u.v[a + 1][t] = depth[a] + s->node[a].way[first + t];
            open.v[a + 1][t] = s->node[a].open[first + t];
        }
    }
    borrow_ways(&open, N, &u);
    for (uint32_t t = 0; t < m; t++) {
        float side = s->side[first + t];
        if (side > 0) { // leaves at once, through the vertex's own tangent plane
            u.v[0][t] = 0;
            open.v[0][t] = open.v[1][t] > 0 ? fresnel_table_eval(fresnel, fminf(side, 1)) : 0;
        } else {
            float rise = (u.v[2][t] - u.v[1][t]) / (depth[1] - depth[0]);
            u.v[0][t] = fmaxf(u.v[1][t] - rise * depth[0], 0);
            open.v[0][t] = open.v[1][t];
        }
    }
    subdivide(&u, N, substeps, path->u);
    subdivide(&open, N, substeps, path->open);
    path->n_point = N * substeps + 1;
    for (uint32_t i = 0; i < path->n_point; i++) {
        uint32_t a = i / substeps < N ? i / substeps : N - 1;
        float x = (float)(i - a * substeps) / (float)substeps;
        path->depth[i] = u.depth[a] + x * (u.depth[a + 1] - u.depth[a]);
    }
    float inv = 1 / (u.depth[N] - u.depth[N - 1]);
    for (int t = 0; t < TILE; t++) path->slope[t] = fmaxf((u.v[N][t] - u.v[N - 1][t]) * inv, 0.3f);
}

// Everything along the path for isotropic phase: one channel of a tile, to multiply by factor.
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
        const float *u = path->u[i], *o0 = path->open[i - 1], *o1 = path->open[i];
        for (int t = 0; t < TILE; t++) {
            float next = sigma_t * u[t], e = exp_minus(next);
            sum[t] += step * mean_exp(before[t], e, exponent[t], next) * (o0[t] + o1[t]);
            exponent[t] = next, before[t] = e;
        }
    }
    // Beyond the last node the last slope goes on to the end of the path.
    float rest = end - path->depth[n - 1];
    for (int t = 0; t < TILE; t++) {
        float last = exponent[t] + sigma_t * path->slope[t] * rest;
        sum[t] += path->open[n - 1][t] * rest *
                  mean_exp(before[t], exp_minus(last), exponent[t], last);
        sum[t] *= factor;
    }
}

// SH of the ways in at the nodes of direction t; a hidden node takes a neighbour's. Returns
// whether any is open.
static bool node_sh(const struct single_plan *plan, const struct scratch *s, uint32_t t,
                    float y[SINGLE_MAX_NODES][MAX_PHASE])
{
    uint32_t K = plan->n_phase, seen = UINT32_MAX;
    for (uint32_t a = 0; a < plan->n_node; a++) {
        float w[3] = {s->node[a].dir[0][t], s->node[a].dir[1][t], s->node[a].dir[2][t]};
        if (s->node[a].open[t] > 0) {
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

// Light part of the phase in the middle of interval i of the path.
static void middle_sh(const struct single_plan *plan, const struct path *path, uint32_t i,
                      float y[SINGLE_MAX_NODES][MAX_PHASE], float out[MAX_PHASE])
{
    uint32_t substeps = (path->n_point - 1) / plan->n_node, a = (i - 1) / substeps;
    float x = ((float)(i - 1 - a * substeps) + 0.5f) / (float)substeps;
    const float *y0 = y[a ? a - 1 : 0], *y1 = y[a];
    for (uint32_t k = 0; k < plan->n_phase; k++) out[k] = y0[k] + x * (y1[k] - y0[k]);
}

static unsigned degree(uint32_t k)
{
    return k == 0 ? 0 : k < 4 ? 1 : 2;
}

// A tile with the phase function's light part: plane k gets a_l Y_k(w_i').
static void integrate_phase(const struct single_plan *plan, const struct path *path, float end,
                            const struct scratch *s, uint32_t first, uint32_t m, float *out)
{
    uint32_t n = plan->directions->n_coef, K = plan->n_phase, last = path->n_point - 1;
    for (uint32_t t = 0; t < m; t++) {
        float y[SINGLE_MAX_NODES][MAX_PHASE], sum[3][MAX_PHASE] = {{0}}, mid[MAX_PHASE];
        float exponent[3], before[3];
        if (!node_sh(plan, s, first + t, y)) goto write;
        for (int c = 0; c < 3; c++) {
            exponent[c] = plan->sigma_t[c] * path->u[0][t];
            before[c] = exp_minus(exponent[c]);
        }
        for (uint32_t i = 1; i <= last; i++) {
            float open = 0.5f * (path->open[i - 1][t] + path->open[i][t]);
            float step = open * (path->depth[i] - path->depth[i - 1]);
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
            float w = path->open[last][t] * rest *
                      mean_exp(before[c], exp_minus(to), exponent[c], to);
            for (uint32_t k = 0; k < K; k++) sum[c][k] += w * y[plan->n_node - 1][k];
        }
    write:
        for (uint32_t c = 0; c < 3; c++)
            for (uint32_t k = 0; k < K; k++)
                out[((size_t)k * 3 + c) * n + first + t] =
                    (float)plan->phase[c].a[degree(k)] * plan->sigma_s[c] * sum[c][k];
    }
}

// Integrals of every function of a radial basis over a tile, X07 eq 14: with s + s'(s)
// piecewise linear they are differences of the functions' running integrals. Without `rgb` out
// is [n_phase][n_radial][n] per direction; with it (X07: the light is fixed) the directions are
// summed into out [n_phase][n_radial][3].
static void integrate_radial(const struct single_plan *plan, const struct path *path, float end,
                             const struct scratch *s, uint32_t first, uint32_t m, uint32_t n,
                             const float *rgb, float *out)
{
    const struct extinction_table *table = plan->extinction;
    uint32_t K = plan->n_phase, J = table->n_function, points = path->n_point;
    enum { WIDE = EXTINCTION_WIDE };
    for (uint32_t t = 0; t < m; t++) {
        float sum[MAX_PHASE][WIDE], y[SINGLE_MAX_NODES][MAX_PHASE], mid[MAX_PHASE];
        float before[WIDE], after[WIDE], u = path->u[0][t];
        bool any = node_sh(plan, s, first + t, y);
        memset(sum, 0, sizeof sum);
        if (any) extinction_integral(table, u, before);
        for (uint32_t i = 1; any && i <= points; i++) {
            // The last step goes on to the end of the path with the last slope.
            bool last = i == points;
            float step = (last ? end : path->depth[i]) - path->depth[i - 1];
            if (step <= 0) break;
            float next = last ? u + path->slope[t] * step : path->u[i][t];
            float open = 0.5f * (path->open[i - 1][t] + path->open[last ? i - 1 : i][t]);
            if (fabsf(next - u) < 1e-3f * step) next = u + 1e-3f * step;
            if (open <= 0 && i + 1 < points && path->open[i + 1][t] <= 0) { // dark on both sides
                u = next, extinction_integral(table, u, before);
                continue;
            }
            extinction_integral(table, next, after);
            if (last) memcpy(mid, y[plan->n_node - 1], sizeof mid);
            else middle_sh(plan, path, i, y, mid);
            for (uint32_t k = 0; k < K; k++) {
                float w = open * mid[k] * step / (next - u);
                for (int j = 0; j < WIDE; j++) sum[k][j] += w * (after[j] - before[j]);
            }
            memcpy(before, after, sizeof before);
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
    float end = fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm);
    for (uint32_t first = 0; first < n; first += TILE) {
        struct path path;
        follow_path(plan, fresnel, &s, depth, first, n, RADIAL_SUBSTEPS, &path);
        integrate_radial(plan, &path, end, &s, first, n - first < TILE ? n - first : TILE, n, rgb,
                         out);
    }
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
        rays += trace_every(plan, fresnel, p, pattern + i * 0x51, &s->node[0]);
        for (uint32_t t = 0; t < d->n_coef; t++) {
            float open = s->node[0].open[t];
            if (open <= 0) continue;
            float w[3] = {s->node[0].dir[0][t], s->node[0].dir[1][t], s->node[0].dir[2][t]};
            prt_sh_eval(K == 9 ? 3 : K == 4 ? 2 : 1, w, s->y);
            for (int c = 0; c < 3; c++) {
                float e = open * weight * plan->sigma_s[c] *
                          exp_minus(plan->sigma_t[c] * (depth + s->node[0].way[t]));
                for (uint32_t k = 0; k < K; k++) {
                    out[((size_t)k * 3 + (unsigned)c) * d->n_coef + t] +=
                        e * (float)plan->phase[c].a[degree(k)] * s->y[k];
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
    place_nodes(plan, thickness, depth);
    for (uint32_t k = 0; k < d->n_packet * 4; k++) {
        size_t at = texel_ray(d, pattern, k / 4, k % 4);
        s.side[d->texel[k]] = n[0] * d->x[at] + n[1] * d->y[at] + n[2] * d->z[at];
    }
    for (uint32_t a = 0; a < plan->n_node; a++) {
        float p[3];
        for (int k = 0; k < 3; k++) p[k] = x[k] - depth[a] * n[k];
        // Another sub-sample at each depth: a texel half in shadow is half lit along the path.
        rays += trace_node(plan, fresnel, p, pattern + 65 * a, depth[a],
                           a ? &s.node[a - 1] : NULL, s.value, &s.node[a]);
    }
    end = fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm);
    for (uint32_t first = 0; first < d->n_coef; first += TILE) {
        struct path path;
        uint32_t m = d->n_coef - first < TILE ? d->n_coef - first : TILE;
        follow_path(plan, fresnel, &s, depth, first, d->n_coef,
                    plan->extinction ? RADIAL_SUBSTEPS : SUBSTEPS, &path);
        if (plan->extinction) {
            integrate_radial(plan, &path, end, &s, first, m, d->n_coef, NULL, out);
        } else if (plan->n_phase > 1) {
            integrate_phase(plan, &path, end, &s, first, m, out);
        } else {
            for (uint32_t c = 0; c < 3; c++) {
                float sum[TILE], factor = plan->sigma_s[c] * (float)(0.5 / sqrt(M_PI));
                integrate_isotropic(&path, plan->sigma_t[c], factor, end, sum);
                memcpy(out + (size_t)c * d->n_coef + first, sum, m * sizeof *sum);
            }
        }
    }
    return rays;
}
