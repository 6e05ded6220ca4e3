// SPDX-License-Identifier: MIT
// Single scattering along -n_o (W05 eq 10-12, METHODS §3.5) with far fewer rays than texels x
// points: along the path the way out is traced at a few depths only (path.c integrates between
// them). Of each 2 x 2 texels one is traced; the others only where its neighbours met something
// else.
#include "bake/path.h"

#include <stdlib.h>
#include <string.h>

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
    path_integrate(plan, fresnel, &s, depth, end, n, rgb, out);
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
                        e * (float)plan->phase[c].a[path_degree(k)] * s->y[k];
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
    path_integrate(plan, fresnel, &s, depth, end, d->n_coef, NULL, out);
    return rays;
}
