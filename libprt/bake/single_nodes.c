// SPDX-License-Identifier: MIT
// Rays of all depths of one vertex. Of each tile of 4 x 4 texels one ray is traced, then of
// each block of 2 x 2, then of every texel: the finer level only where neighbours differ.
// Beyond the surface a ray is cast only where the horizon (horizon.c) does not certify the
// direction.
#include "bake/loops.h"

#include <math.h>
#include <string.h>

// The texels that take a ray's result: one, the four of its block, or the sixteen of a tile of
// 2 x 2 blocks.
enum share { ONE = 1, BLOCK = 4, TILE = 16 };
struct target {
    uint32_t node, block, texel;
    enum share share;
};

// Rays to exits that are being filled.
struct batch {
    struct prt_packet packet;
    uint32_t fill;
    struct target target[16];
};
// Directions of one node whose exits are to be looked for in its drawing.
struct wishes {
    uint32_t fill;
    struct target target[16];
    uint32_t ray[16]; // number in directions->x
};

// What waits for one vertex: directions to look up, rays to exits, and shadow rays beyond them.
struct queue {
    const struct single_plan *plan;
    const struct fresnel_table *fresnel;
    struct scratch *s;
    float p[SINGLE_MAX_NODES][3];
    bool keep_directions, use_horizon;
    const float *slope[SINGLE_MAX_NODES]; // of the sub-samples that node a takes
    struct wishes wishes[SINGLE_MAX_NODES];
    struct batch traced;
    struct prt_packet shadow;
    uint32_t n_shadow;
    struct target shadow_target[16];
    uint64_t rays;
};

static float out_of_reach(const struct single_plan *plan)
{
    return fminf(2 * plan->inward_mm, 1e4f);
}

// Texels of a target.
static uint32_t texels_of(const struct directions *d, const struct target *to,
                          uint32_t at[TILE])
{
    uint32_t half = d->n / 2, first = to->block;
    if (to->share == ONE) {
        at[0] = to->texel;
        return 1;
    }
    if (to->share == TILE) first = (first / half & ~1u) * half + (first % half & ~1u);
    for (uint32_t j = 0; j < (uint32_t)to->share; j++)
        at[j] = d->texel[(size_t)(first + (j >> 2 & 1) + (j >> 3) * half) * 4 + (j & 3)];
    return to->share;
}

static void flush_shadows(struct queue *q)
{
    if (!q->n_shadow) return;
    uint32_t blocked = prt_blocked_lanes(q->plan, &q->shadow, q->n_shadow);
    q->rays += q->n_shadow;
    for (uint32_t i = 0; i < q->n_shadow; i++) {
        const struct target *to = &q->shadow_target[i];
        uint32_t at[TILE], n = texels_of(q->plan->directions, to, at);
        for (uint32_t j = 0; blocked >> i & 1 && j < n; j++)
            for (uint32_t b = 0; b < q->plan->n_eta; b++)
                q->s->of_eta[b][to->node].transmittance[at[j]] = 0;
    }
    q->n_shadow = 0;
}

// Visibility beyond the exit of lane i: 1 visible, -1 blocked, 0 unknown.
static int horizon_of(const struct queue *q, const struct batch *b, uint32_t i)
{
    const struct single_plan *plan = q->plan;
    if (!q->use_horizon || !plan->horizon) return 0;
    return prt_horizon_bin(plan->horizon, b->packet.triangle[i],
                           plan->directions->bin[b->target[i].texel]);
}

// The index whose exits decide where finer rays are cast: the middle one.
static uint32_t deciding(const struct single_plan *plan)
{
    return plan->n_eta / 2;
}

// Stores the exit of lane i at every index, lane [n_eta], and queues its shadow ray where
// visibility is unknown.
static void take_exit(struct queue *q, const struct batch *from, const struct lanes *lane,
                      uint32_t i, bool leaves)
{
    const struct target *to = &from->target[i];
    uint32_t at[TILE], n = texels_of(q->plan->directions, to, at);
    int certain = leaves ? horizon_of(q, from, i) : 1;
    for (uint32_t b = 0; b < q->plan->n_eta; b++) {
        struct exits *e = &q->s->of_eta[b][to->node];
        for (uint32_t j = 0; j < n; j++) {
            prt_store_exit(e, at[j], &lane[b], i);
            if (certain < 0) e->transmittance[at[j]] = 0;
            if (q->keep_directions) prt_store_direction(e, at[j], &lane[b], i);
        }
    }
    const float path_mm = lane[deciding(q->plan)].path_mm[i];
    if (n > 1)
        q->s->uncertain[to->node][to->block] =
            certain ? 0 : exp_minus(q->plan->weakest * path_mm);
    if (certain) return;
    prt_leave_body(&from->packet, i, prt_scene_epsilon(q->plan->scene), &q->shadow,
                   q->n_shadow);
    q->shadow_target[q->n_shadow] = *to;
    if (++q->n_shadow == 16) flush_shadows(q);
}

// Stores the exits of a batch's rays.
static void take_batch(struct queue *q, struct batch *b, struct lanes lane[PRT_ETA_MOST_NODES],
                       uint32_t leave)
{
    for (uint32_t i = 0; i < q->plan->n_eta; i++)
        prt_fill_missed(&lane[i], out_of_reach(q->plan));
    for (uint32_t i = 0; q->use_horizon && q->plan->horizon && i < b->fill; i++)
        if (leave >> i & 1)
            prt_horizon_prefetch(q->plan->horizon, b->packet.triangle[i],
                                 q->plan->directions->bin[b->target[i].texel]);
    for (uint32_t i = 0; i < b->fill; i++) take_exit(q, b, lane, i, leave >> i & 1);
    b->fill = 0;
}

static void flush_traced(struct queue *q)
{
    struct lanes lane[PRT_ETA_MOST_NODES];
    struct batch *b = &q->traced;
    struct prt_packet *p = &b->packet;
    uint32_t mask = b->fill == 16 ? 0xffff : (1u << b->fill) - 1;
    if (!b->fill) return;
    for (uint32_t i = 0; i < 16; i++) p->tnear[i] = 0, p->tfar[i] = q->plan->inward_mm;
    for (uint32_t i = b->fill; i < 16; i++) {
        p->ox[i] = p->oy[i] = p->oz[i] = 0;
        p->dx[i] = 1, p->dy[i] = p->dz[i] = 0;
    }
    q->rays += b->fill;
    take_batch(q, b, lane, prt_trace_exits(q->plan, q->fresnel, p, mask, lane));
}

// Adds node a's ray `ray` of the directions to a batch.
static void add_ray(const struct queue *q, uint32_t a, uint32_t ray,
                    const struct target *target, struct batch *b)
{
    const struct directions *d = q->plan->directions;
    struct prt_packet *p = &b->packet;
    const uint32_t l = b->fill++;
    p->ox[l] = q->p[a][0], p->oy[l] = q->p[a][1], p->oz[l] = q->p[a][2];
    p->dx[l] = d->x[ray], p->dy[l] = d->y[ray], p->dz[l] = d->z[ray];
    b->target[l] = *target;
}

static void trace_ray(struct queue *q, uint32_t a, uint32_t ray, const struct target *target)
{
    add_ray(q, a, ray, target, &q->traced);
    if (q->traced.fill == 16) flush_traced(q);
}

// Looks for exits where node a's drawing shows them; the other rays are traced.
static void flush_wishes(struct queue *q, uint32_t a)
{
    struct wishes *w = &q->wishes[a];
    const struct single_plan *plan = q->plan;
    const struct draw_room *room = &q->s->draw;
    struct lanes lane[PRT_ETA_MOST_NODES];
    struct corners normals;
    struct batch drawn = {.fill = 0};
    float all_t[16], t[16];
    uint32_t texel[16], all_at[16], at[16], hit = 0;
    if (!w->fill) return;
    for (uint32_t i = 0; i < 16; i++) texel[i] = w->target[i < w->fill ? i : 0].texel;
    uint32_t known =
        prt_draw_look(plan->cpu, &room->drawing[a], q->slope[a], plan->directions->n_coef,
                      texel, plan->inward_mm, all_t, all_at);
    for (uint32_t i = 0; i < w->fill; i++) {
        if (!(known >> i & 1)) {
            trace_ray(q, a, w->ray[i], &w->target[i]);
            continue;
        }
        const uint32_t l = drawn.fill;
        t[l] = all_t[i], at[l] = all_at[i];
        hit |= (uint32_t)(at[l] != UINT32_MAX) << l;
        add_ray(q, a, w->ray[i], &w->target[i], &drawn);
    }
    w->fill = 0;
    if (!drawn.fill) return;
    for (uint32_t i = drawn.fill; i < 16; i++) {
        at[i] = UINT32_MAX, t[i] = 0;
        drawn.packet.dx[i] = 1, drawn.packet.dy[i] = drawn.packet.dz[i] = 0;
        drawn.packet.ox[i] = drawn.packet.oy[i] = drawn.packet.oz[i] = 0;
    }
    prt_draw_hits(plan->cpu, &room->near, &room->drawing[a], at, t, &drawn.packet, &normals);
    take_batch(q, &drawn, lane,
               prt_exits_of_hits(plan, q->fresnel, &drawn.packet, &normals, hit, lane));
}

static void finish_rays(struct queue *q)
{
    for (uint32_t a = 0; a < q->plan->n_node; a++) flush_wishes(q, a);
    flush_traced(q);
    flush_shadows(q);
}

// Node a's ray through texel i of a block, by the sub-sample of `pattern`.
static void push(struct queue *q, uint32_t a, unsigned pattern, uint32_t block, uint32_t i,
                 enum share share)
{
    const struct directions *d = q->plan->directions;
    const uint32_t ray = (uint32_t)texel_ray(d, pattern, block, i);
    const struct target target = {a, block, d->texel[(size_t)block * 4 + i], share};
    struct wishes *w = &q->wishes[a];
    if (!q->slope[a]) {
        trace_ray(q, a, ray, &target);
        return;
    }
    // flush_wishes reads them: one direction of a line of 16
    __builtin_prefetch(d->x + ray), __builtin_prefetch(d->y + ray);
    __builtin_prefetch(d->z + ray);
    w->ray[w->fill] = ray;
    w->target[w->fill] = target;
    if (++w->fill == 16) flush_wishes(q, a);
}

uint64_t prt_trace_every(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         const float p[3], unsigned pattern, struct scratch *s)
{
    struct queue q = {.plan = plan,
                      .fresnel = fresnel,
                      .s = s,
                      .p = {{p[0], p[1], p[2]}},
                      .keep_directions = plan->n_phase > 1};
    for (uint32_t block = 0; block < plan->directions->n_packet; block++)
        for (uint32_t i = 0; i < 4; i++) push(&q, 0, pattern, block, i, ONE);
    finish_rays(&q);
    return q.rays;
}

// The k-th cell in squares of 4 x 4, so that the rays of a packet have similar directions.
static uint32_t tiled(uint32_t k, uint32_t wide)
{
    if (wide % 4) return k;
    uint32_t face = k / (wide * wide), in = k % (wide * wide), tile = in / 16, i = in % 16;
    uint32_t x = tile % (wide / 4) * 4 + (i & 3), y = tile / (wide / 4) * 4 + (i >> 2);
    return (face * wide + y) * wide + x;
}

// Transmittance times attenuation of block b's ray, for comparison with its neighbours. A fixed
// medium weighs the nodes by their depth in weigh_nodes; a free one is attenuated along the
// depth here.
static float attenuated(const struct single_plan *plan, const struct exits *e, uint32_t b,
                        float depth)
{
    uint32_t t = plan->directions->texel[(size_t)b * 4];
    float u = e->path_mm[t] + (plan->extinction ? depth : 0);
    return e->transmittance[t] * exp_minus(plan->weakest * u);
}

// Tile t of node `from` becomes that of node `to` as well.
static void copy_tile(const struct queue *q, uint32_t t, uint32_t wide, uint32_t from,
                      uint32_t to)
{
    const struct directions *d = q->plan->directions;
    for (uint32_t i = 0; i < 16 * q->plan->n_eta; i++) {
        const uint32_t j = i % 16;
        const uint32_t at = d->texel[(size_t)block_of(t, j >> 2, wide) * 4 + (j & 3)];
        const struct exits *e = q->s->of_eta[i / 16];
        e[to].path_mm[at] = e[from].path_mm[at];
        e[to].transmittance[at] = e[from].transmittance[at];
        for (int k = 0; q->keep_directions && k < 3; k++) e[to].dir[k][at] = e[from].dir[k][at];
    }
}

// Factors of the thresholds at each node: 1 at the node that contributes most, larger at the
// others. The light of node a stands for the path halfway to its neighbours.
static void weigh_nodes(const struct single_plan *plan, const float *depth, float *rise)
{
    float weight[SINGLE_MAX_NODES], most = 0;
    uint32_t N = plan->n_node;
    for (uint32_t a = 0; a < N; a++) {
        float width = (a + 1 < N ? depth[a + 1] : 2 * depth[a]) - (a ? depth[a - 1] : 0);
        weight[a] = plan->extinction ? 1 : 0; // a free medium: every node may contribute most
        for (int c = 0; !plan->extinction && c < 3; c++)
            weight[a] += plan->sigma_t[c] * width * expf(-plan->sigma_t[c] * depth[a]);
        most = fmaxf(most, weight[a]);
    }
    for (uint32_t a = 0; a < N; a++) rise[a] = fminf(most / fmaxf(weight[a], 1e-6f), 1e3f);
}

// Tiles of 2 x 2 blocks of 2 x 2 texels, `half` blocks and `wide` tiles across a face. Each
// node uses another sub-sample, so that a texel half in shadow is half lit along the path.
struct layout {
    uint32_t half, wide, n_tile, n_node;
    const float *depth; // [n_node]
    unsigned pattern[SINGLE_MAX_NODES];
    float rise[SINGLE_MAX_NODES];
};

// The block whose ray stands for tile t at node a.
static uint32_t chosen(const struct layout *l, uint32_t t, uint32_t a)
{
    return block_of(t, (t + 3 * l->pattern[a] + (l->pattern[a] >> 2)) & 3, l->wide);
}

static void push_block(struct queue *q, const struct layout *l, uint32_t a, uint32_t b,
                       enum share share)
{
    push(q, a, l->pattern[a], b, (b + l->pattern[a]) & 3, share);
}

// A ray for each tile at each node. Towards tiles beyond max_optical_depth the middle node's
// ray is used for all nodes.
static void trace_tiles(struct queue *q, const struct layout *l)
{
    const struct single_plan *plan = q->plan;
    const struct directions *d = plan->directions;
    uint32_t mid = l->n_node / 2;
    for (uint32_t k = 0; k < l->n_tile; k++) {
        uint32_t t = tiled(k, l->wide);
        push_block(q, l, mid, chosen(l, t, mid), TILE);
    }
    finish_rays(q);
    for (uint32_t k = 0; k < l->n_tile; k++) {
        uint32_t t = tiled(k, l->wide), first = d->texel[(size_t)block_of(t, 0, l->wide) * 4];
        float u = q->s->node[mid].path_mm[first] + l->depth[mid];
        for (uint32_t a = 0; a < l->n_node; a++) {
            if (a == mid) continue;
            if (plan->weakest * u < plan->max_optical_depth) {
                push_block(q, l, a, chosen(l, t, a), TILE);
                continue;
            }
            copy_tile(q, t, l->wide, mid, a);
            q->s->uncertain[a][chosen(l, t, a)] = 0;
        }
    }
    finish_rays(q);
}

// A ray for each block of the tiles that differ from their neighbours or whose visibility is
// unknown.
static void trace_blocks(struct queue *q, const struct layout *l)
{
    const struct single_plan *plan = q->plan;
    struct scratch *s = q->s;
    for (uint32_t a = 0; a < l->n_node; a++) {
        for (uint32_t t = 0; t < l->n_tile; t++)
            s->coarse[a][t] =
                attenuated(plan, &s->node[a], block_of(t, 0, l->wide), l->depth[a]);
        prt_bake_loops(plan->cpu)->steps(s->coarse[a], l->wide, s->step[a]);
    }
    for (uint32_t k = 0; k < l->n_tile; k++) {
        uint32_t t = tiled(k, l->wide);
        for (uint32_t a = 0; a < l->n_node; a++) {
            uint32_t own = chosen(l, t, a);
            bool fine = s->step[a][t] > plan->differ * l->rise[a] ||
                        s->uncertain[a][own] > plan->uncertain * l->rise[a];
            s->fine[a][t] = fine;
            for (uint32_t j = 0; j < 4; j++) {
                uint32_t b = block_of(t, j, l->wide);
                s->value[a][b] = s->coarse[a][t];
                if (fine && b != own) push_block(q, l, a, b, BLOCK);
            }
        }
    }
    finish_rays(q);
    for (uint32_t a = 0; a < l->n_node; a++) {
        for (uint32_t t = 0; t < l->n_tile; t++)
            for (uint32_t j = 0; s->fine[a][t] > 0 && j < 4; j++) {
                uint32_t b = block_of(t, j, l->wide);
                s->value[a][b] = attenuated(plan, &s->node[a], b, l->depth[a]);
            }
        prt_bake_loops(plan->cpu)->steps(s->value[a], l->half, s->step[a]);
    }
}

// A ray for each texel of the blocks that differ from their neighbours.
static void trace_texels(struct queue *q, const struct layout *l)
{
    struct scratch *s = q->s;
    uint32_t n_block = l->n_tile * 4;
    memset(s->split, 0, n_block);
    for (uint32_t k = 0; k < n_block; k++) {
        uint32_t b = tiled(k, l->half), t = b / l->half / 2 * l->wide + b % l->half / 2;
        for (uint32_t a = 0; a < l->n_node; a++) {
            float most = q->plan->differ_texel * l->rise[a];
            if (!(s->fine[a][t] > 0) || !(s->step[a][b] > most)) continue;
            s->split[b] = 1;
            for (uint32_t i = 0; i < 4; i++)
                if (i != ((b + l->pattern[a]) & 3)) push(q, a, l->pattern[a], b, i, ONE);
        }
    }
    finish_rays(q);
}

// Draws the triangles about the vertex on a cube around each node.
static void draw_near(struct queue *q, const struct layout *l)
{
    const struct single_plan *plan = q->plan;
    struct draw_room *room = &q->s->draw;
    if (!plan->grid) return;
    const float *middle = q->p[l->n_node / 2];
    float deep = 0.5f * (l->depth[l->n_node - 1] - l->depth[0]);
    prt_draw_gather(plan->grid, plan->mesh, middle, plan->inward_mm + 2 * deep, &room->near);
    for (uint32_t a = 0; a < l->n_node; a++) {
        prt_draw(plan->directions, l->pattern[a], q->p[a], a, room);
        q->slope[a] = prt_direction_slopes(plan->directions, l->pattern[a]);
    }
}

// Rays of all depths towards one tile are traced together: they hit the same triangles.
uint64_t prt_trace_nodes(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         const struct vertex_path *path, struct scratch *s)
{
    uint32_t half = plan->directions->n / 2;
    struct layout l = {.half = half,
                       .wide = half / 2,
                       .n_tile = 6 * (half / 2) * (half / 2),
                       .n_node = plan->n_node,
                       .depth = path->depth};
    struct queue q = {.plan = plan,
                      .fresnel = fresnel,
                      .s = s,
                      .use_horizon = true,
                      .keep_directions = prt_single_keeps_directions(plan)};
    s->node = s->of_eta[deciding(plan)];
    weigh_nodes(plan, l.depth, l.rise);
    for (uint32_t a = 0; a < l.n_node; a++) {
        l.pattern[a] = path->pattern + 65 * a; // 65: another jitter and another sub-sample
        for (int k = 0; k < 3; k++) q.p[a][k] = path->x[k] - l.depth[a] * path->out[k];
    }
    draw_near(&q, &l);
    trace_tiles(&q, &l);
    trace_blocks(&q, &l);
    trace_texels(&q, &l);
    return q.rays;
}
