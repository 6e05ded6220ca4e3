// SPDX-License-Identifier: MIT
// Rays of all depths of one vertex. Of each tile of 4 x 4 texels one ray is traced, then of
// each block of 2 x 2, then of every texel: the finer level only where neighbours differ.
// Beyond the surface the horizon (horizon.c) tells how much light arrives; a ray is cast for
// single texels whose direction it does not certify.
#include "bake/loops.h"

#include "base/isa.h"

#include <math.h>
#include <string.h>

// The texels that take a ray's result: one, the four of its block, or the sixteen of a tile of
// 2 x 2 blocks. The number of texels across.
enum share { ONE = 1, BLOCK = 2, TILE = 4 };

// Rays from one vertex's nodes. A ray's number is that of its texel in directions->texel: four
// times its block, plus one of the block's texels.
struct batch {
    struct prt_packet packet;
    uint32_t fill; // lanes that are taken
    uint32_t node[16], number[16], texel[16];
};

// What waits for one vertex: rays to exits, and shadow rays beyond them.
struct queue {
    const struct single_plan *plan;
    const struct fresnel_table *fresnel;
    struct scratch *s;
    float p[SINGLE_MAX_NODES][3];
    unsigned pattern[SINGLE_MAX_NODES];   // jitter of node a's sub-samples
    const float *slope[SINGLE_MAX_NODES]; // of these
    bool drawn;                           // triangles, on a cube around each node
    bool keep_directions, use_horizon;
    const float *rise; // of each node, see weigh_nodes
    enum share share;  // of every ray that waits
    struct batch traced, shadow;
    uint64_t rays;
};

static float out_of_reach(const struct single_plan *plan)
{
    return fminf(2 * plan->inward_mm, 1e4f);
}

// The first of the texels that take the result of texel's ray: n, and so a row, is a power
// of 2.
static uint32_t corner_of(uint32_t texel, uint32_t n, enum share wide)
{
    return texel & ~(((uint32_t)wide - 1) * (n + 1));
}

PRT_INLINE void fill_square(float *to, uint32_t n, uint32_t wide, float value)
{
    for (uint32_t y = 0; y < wide; y++)
        for (uint32_t x = 0; x < wide; x++) to[y * n + x] = value;
}

static void flush_shadows(struct queue *q)
{
    struct batch *b = &q->shadow;
    const uint32_t n = q->plan->directions->n, wide = q->share;
    if (!b->fill) return;
    uint32_t blocked = prt_blocked_lanes(q->plan, &b->packet, b->fill);
    q->rays += b->fill;
    for (uint32_t i = 0; i < b->fill; i++)
        for (uint32_t k = 0; blocked >> i & 1 && k < q->plan->n_eta; k++)
            fill_square(q->s->of_eta[k][b->node[i]].transmittance +
                            corner_of(b->texel[i], n, wide),
                        n, wide, 0);
    b->fill = 0;
}

// Writes the lanes of `done`, exits at one index, to their texels. wide: a constant.
PRT_INLINE void store(const struct queue *q, const struct batch *b, const struct lanes *lane,
                      uint32_t k, uint32_t done, enum share wide)
{
    const uint32_t n = q->plan->directions->n;
    for (; done; done &= done - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(done), at = corner_of(b->texel[i], n, wide);
        const struct exits *e = &q->s->of_eta[k][b->node[i]];
        fill_square(e->path_mm + at, n, wide, lane->path_mm[i]);
        fill_square(e->transmittance + at, n, wide, lane->transmittance[i]);
        for (int c = 0; q->keep_directions && c < 3; c++)
            fill_square(e->dir[c] + at, n, wide, lane->dir[c][i]);
    }
}

// The index whose exits decide where finer rays are cast: the middle one.
static uint32_t deciding(const struct single_plan *plan)
{
    return plan->n_eta / 2;
}

// Of light that counts for less, the share that the horizon's corners see is taken; of more, a
// shadow ray decides. Chosen: with 1 in its place a third fewer rays are cast on the bunny, and
// the error under soft boxes grows by a quarter.
static const float sure_share = 0.3f;

// Of the lanes whose visibility is not certain, the light of a tile or a block, and weak light
// of a texel, is taken by the share of its bins that are open. Returns these lanes. doubt: of
// each of them, 1 where half is open, 0 where all or none is.
static uint32_t take_shares(const struct queue *q, const struct batch *b, uint32_t unknown,
                            struct lanes *lane, float doubt[16])
{
    const struct single_plan *plan = q->plan;
    const struct directions *d = plan->directions;
    const unsigned wide = (unsigned)q->share * HORIZON_WIDE / d->n;
    const struct prt_packet *p = &b->packet;
    uint32_t taken = 0;
    for (uint32_t m = unknown; m; m &= m - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(m);
        const float path_mm = lane[deciding(plan)].path_mm[i];
        const float most = sure_share * q->rise[b->node[i]];
        if (q->share == ONE && exp_minus(plan->weakest * path_mm) > most) continue;
        const float share = prt_horizon_share(plan->horizon, p->triangle[i], p->u[i], p->v[i],
                                              d->bin[b->texel[i]], wide ? wide : 1);
        if (share < 0) continue;
        for (uint32_t k = 0; k < plan->n_eta; k++) lane[k].transmittance[i] *= share;
        doubt[i] = 4 * share * (1 - share);
        taken |= 1u << i;
    }
    return taken;
}

// Stores the exits of the lanes `done` at every index, lane [n_eta]. Where the horizon does not
// tell how much light reaches the exit, a shadow ray is queued. leave: the lanes that leave the
// body.
static void take_exits(struct queue *q, const struct batch *b, struct lanes *lane,
                       uint32_t done, uint32_t leave)
{
    const struct single_plan *plan = q->plan;
    uint32_t visible = 0, blocked = 0;
    if (q->use_horizon && plan->horizon)
        prt_horizon_bins(plan->horizon, leave, b->packet.triangle, plan->directions->bin,
                         b->texel, &visible, &blocked);
    uint32_t unknown = leave & ~visible & ~blocked, shared = 0;
    float doubt[16];
    if (q->use_horizon && plan->horizon) shared = take_shares(q, b, unknown, lane, doubt);
    unknown &= ~shared;
    for (uint32_t k = 0; k < plan->n_eta; k++) {
        for (uint32_t m = blocked; m; m &= m - 1) lane[k].transmittance[__builtin_ctz(m)] = 0;
        if (q->share == TILE) store(q, b, &lane[k], k, done, TILE);
        else if (q->share == BLOCK) store(q, b, &lane[k], k, done, BLOCK);
        else store(q, b, &lane[k], k, done, ONE);
    }
    // Negative: a ray of its own decides, whose answer stays that of the finer ray.
    const float *path_mm = lane[deciding(plan)].path_mm;
    for (uint32_t m = q->share == ONE ? 0 : done; m; m &= m - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(m);
        const float most = shared >> i & 1 ? doubt[i] : unknown >> i & 1 ? -1 : 0;
        q->s->uncertain[b->node[i]][b->number[i] / 4] =
            most * exp_minus(plan->weakest * path_mm[i]);
    }
    for (uint32_t m = unknown; m; m &= m - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(m), to = q->shadow.fill++;
        prt_leave_body(&b->packet, i, prt_scene_epsilon(plan->scene), &q->shadow.packet, to);
        q->shadow.node[to] = b->node[i], q->shadow.texel[to] = b->texel[i];
        if (q->shadow.fill == 16) flush_shadows(q);
    }
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
    uint32_t leave = prt_trace_exits(q->plan, q->fresnel, p, mask, out_of_reach(q->plan), lane);
    take_exits(q, b, lane, mask, leave);
    b->fill = 0;
}

// Queues lane i of a batch for tracing.
static void trace_lane(struct queue *q, const struct batch *from, uint32_t i)
{
    struct batch *b = &q->traced;
    const uint32_t l = b->fill++;
    b->packet.ox[l] = from->packet.ox[i], b->packet.dx[l] = from->packet.dx[i];
    b->packet.oy[l] = from->packet.oy[i], b->packet.dy[l] = from->packet.dy[i];
    b->packet.oz[l] = from->packet.oz[i], b->packet.dz[l] = from->packet.dz[i];
    b->node[l] = from->node[i], b->number[l] = from->number[i], b->texel[l] = from->texel[i];
    if (b->fill == 16) flush_traced(q);
}

static void finish_rays(struct queue *q)
{
    flush_traced(q);
    flush_shadows(q);
}

// Takes exits from node a's drawing. Returns the lanes of `mask` that it shows for certain.
static uint32_t look_up(struct queue *q, uint32_t a, struct batch *b, const float length[16],
                        uint32_t mask)
{
    const struct single_plan *plan = q->plan;
    const struct draw_room *room = &q->s->draw;
    struct lanes lane[PRT_ETA_MOST_NODES];
    struct corners normals;
    float t[16];
    uint32_t at[16];
    if (!q->drawn) return 0;
    uint32_t known = mask & prt_draw_look(plan->cpu, &room->drawing[a], b->texel, length,
                                          plan->inward_mm, t, at);
    if (!known) return 0;
    prt_draw_hits(plan->cpu, &room->near, &room->drawing[a], at, t, &b->packet, &normals);
    uint32_t leave = prt_exits_of_hits(plan, q->fresnel, &b->packet, &normals, known,
                                       out_of_reach(plan), lane);
    take_exits(q, b, lane, known, leave);
    return known;
}

// Exits of the first n rays of s->list, from node a: from its drawing, or else traced.
static void find_exits(struct queue *q, uint32_t a, uint32_t n)
{
    const struct directions *d = q->plan->directions;
    const struct bake_loops *loops = prt_bake_loops(q->plan->cpu);
    uint32_t *list = q->s->list;
    struct batch b = {.fill = 16};
    float length[16];
    for (uint32_t i = 0; i < 16; i++) {
        b.packet.ox[i] = q->p[a][0], b.packet.oy[i] = q->p[a][1], b.packet.oz[i] = q->p[a][2];
        b.node[i] = a;
        list[n + i] = n ? list[n - 1] : 0; // the last batch is filled up
    }
    for (uint32_t first = 0; first < n; first += 16) {
        const uint32_t mask = n - first < 16 ? (1u << (n - first)) - 1 : 0xffff;
        memcpy(b.number, list + first, sizeof b.number);
        loops->aim(d, q->slope[a], b.number, &b.packet, b.texel, length);
        const uint32_t known = look_up(q, a, &b, length, mask);
        for (uint32_t m = mask & ~known; m; m &= m - 1)
            trace_lane(q, &b, (uint32_t)__builtin_ctz(m));
    }
}

uint64_t prt_trace_every(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         const float p[3], unsigned pattern, struct scratch *s)
{
    struct queue q = {.plan = plan,
                      .fresnel = fresnel,
                      .s = s,
                      .p = {{p[0], p[1], p[2]}},
                      .slope = {prt_direction_slopes(plan->directions, pattern)},
                      .share = ONE,
                      .keep_directions = plan->n_phase > 1};
    for (uint32_t i = 0; i < plan->directions->n_coef; i++) s->list[i] = i;
    find_exits(&q, 0, plan->directions->n_coef);
    finish_rays(&q);
    return q.rays;
}

// The k-th cell in squares of 4 x 4, so that the rays of a packet have similar directions;
// faces are 2^log_wide cells across.
static uint32_t tiled(uint32_t k, unsigned log_wide)
{
    uint32_t face = k >> 2 * log_wide, tile = (k & ((1u << 2 * log_wide) - 1)) / 16, i = k % 16;
    uint32_t x = (tile & ((1u << (log_wide - 2)) - 1)) * 4 + (i & 3);
    uint32_t y = (tile >> (log_wide - 2)) * 4 + (i >> 2);
    return (((face << log_wide) + y) << log_wide) + x;
}

// A tile of node `from`, whose first texel is `at`, becomes that of node `to` as well.
static void copy_tile(const struct queue *q, uint32_t at, uint32_t from, uint32_t to)
{
    const uint32_t n = q->plan->directions->n;
    for (uint32_t i = 0; i < 4 * q->plan->n_eta; i++) {
        const size_t row = at + i % 4 * n, bytes = 4 * sizeof(float);
        const struct exits *e = q->s->of_eta[i / 4];
        memcpy(e[to].path_mm + row, e[from].path_mm + row, bytes);
        memcpy(e[to].transmittance + row, e[from].transmittance + row, bytes);
        for (int k = 0; q->keep_directions && k < 3; k++)
            memcpy(e[to].dir[k] + row, e[from].dir[k] + row, bytes);
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

// Tiles of 2 x 2 blocks of 2 x 2 texels, 2^log_wide tiles across a face. Each node uses another
// sub-sample, so that a texel half in shadow is half lit along the path.
struct layout {
    unsigned log_wide;
    uint32_t n_tile, n_node;
    const float *depth; // [n_node]
    float rise[SINGLE_MAX_NODES];
};

// The block whose ray stands for tile t at node a.
static uint32_t chosen(const struct queue *q, const struct layout *l, uint32_t t, uint32_t a)
{
    return block_of(t, (t + 3 * q->pattern[a] + (q->pattern[a] >> 2)) & 3, l->log_wide);
}

// The ray that stands for block b at node a.
static uint32_t ray_of_block(const struct queue *q, uint32_t a, uint32_t b)
{
    return b * 4 + ((b + q->pattern[a]) & 3);
}

// A ray for each tile at each node. Towards tiles beyond max_optical_depth the middle node's
// ray is used for all nodes.
static void trace_tiles(struct queue *q, const struct layout *l)
{
    const struct single_plan *plan = q->plan;
    const struct directions *d = plan->directions;
    uint32_t mid = l->n_node / 2, *list = q->s->list;
    q->share = TILE;
    for (uint32_t k = 0; k < l->n_tile; k++)
        list[k] = ray_of_block(q, mid, chosen(q, l, tiled(k, l->log_wide), mid));
    find_exits(q, mid, l->n_tile);
    finish_rays(q);
    const float *path_mm = q->s->node[mid].path_mm;
    for (uint32_t a = 0; a < l->n_node; a++) {
        uint32_t n = 0;
        for (uint32_t k = 0; a != mid && k < l->n_tile; k++) {
            uint32_t t = tiled(k, l->log_wide), own = chosen(q, l, t, a);
            uint32_t first = d->texel[(size_t)block_of(t, 0, l->log_wide) * 4];
            if (plan->weakest * (path_mm[first] + l->depth[mid]) < plan->max_optical_depth) {
                list[n++] = ray_of_block(q, a, own);
                continue;
            }
            copy_tile(q, first, mid, a);
            q->s->uncertain[a][own] = 0;
        }
        find_exits(q, a, n);
    }
    finish_rays(q);
}

// Light through the first texel of squares `stride` texels across, for comparison with its
// neighbours. A fixed medium weighs the nodes by their depth in weigh_nodes; a free one is
// attenuated along the depth here.
static void attenuate(const struct queue *q, uint32_t a, float depth, uint32_t stride,
                      float *out)
{
    const struct single_plan *plan = q->plan;
    prt_bake_loops(plan->cpu)->attenuate(&q->s->node[a], plan->directions->n, stride,
                                         plan->weakest, plan->extinction ? depth : 0, out);
}

// A ray for each block of the tiles that differ from their neighbours or that may be partly in
// shadow. A block's own ray is cast once more where its shadow was the tile's.
static void trace_blocks(struct queue *q, const struct layout *l)
{
    const struct single_plan *plan = q->plan;
    const struct bake_loops *loops = prt_bake_loops(plan->cpu);
    struct scratch *s = q->s;
    q->share = BLOCK;
    for (uint32_t a = 0; a < l->n_node; a++) {
        const float differ = plan->differ * l->rise[a];
        const float uncertain = plan->uncertain * l->rise[a];
        uint32_t n = 0;
        attenuate(q, a, l->depth[a], TILE, s->value[a]);
        loops->steps(s->value[a], 1u << l->log_wide, s->step[a]);
        for (uint32_t k = 0; k < l->n_tile; k++) {
            uint32_t t = tiled(k, l->log_wide), own = chosen(q, l, t, a);
            const float doubt = s->uncertain[a][own];
            bool fine = s->step[a][t] > differ || fabsf(doubt) > uncertain;
            s->fine[a][t] = fine;
            for (uint32_t j = 0; fine && j < 4; j++) {
                uint32_t b = block_of(t, j, l->log_wide);
                if (b != own || doubt > 0) s->list[n++] = ray_of_block(q, a, b);
            }
        }
        find_exits(q, a, n);
    }
    finish_rays(q);
    for (uint32_t a = 0; a < l->n_node; a++) {
        attenuate(q, a, l->depth[a], BLOCK, s->value[a]);
        loops->steps(s->value[a], 2u << l->log_wide, s->step[a]);
    }
}

// A ray for each texel of the blocks that differ from their neighbours or that may be partly
// in shadow.
static void trace_texels(struct queue *q, const struct layout *l)
{
    struct scratch *s = q->s;
    memset(s->split, 0, (size_t)l->n_tile * 4);
    q->share = ONE;
    for (uint32_t a = 0; a < l->n_node; a++) {
        const float most = q->plan->differ_texel * l->rise[a];
        const float uncertain = q->plan->uncertain_texel * l->rise[a];
        uint32_t n = 0;
        for (uint32_t k = 0; k < l->n_tile; k++) {
            const uint32_t t = tiled(k, l->log_wide);
            for (uint32_t j = 0; s->fine[a][t] > 0 && j < 4; j++) {
                const uint32_t b = block_of(t, j, l->log_wide), own = ray_of_block(q, a, b);
                const float doubt = s->uncertain[a][b];
                if (!(s->step[a][b] > most || fabsf(doubt) > uncertain)) continue;
                s->split[b] = 1;
                for (uint32_t i = b * 4; i < b * 4 + 4; i++)
                    if (i != own || doubt > 0) s->list[n++] = i;
            }
        }
        find_exits(q, a, n);
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
    for (uint32_t a = 0; a < l->n_node; a++)
        prt_draw(plan->directions, q->pattern[a], q->p[a], a, room);
    q->drawn = true;
}

uint64_t prt_trace_nodes(const struct single_plan *plan, const struct fresnel_table *fresnel,
                         const struct vertex_path *path, struct scratch *s)
{
    const uint32_t wide = plan->directions->n / 4;
    struct layout l = {.log_wide = (unsigned)__builtin_ctz(wide),
                       .n_tile = 6 * wide * wide,
                       .n_node = plan->n_node,
                       .depth = path->depth};
    struct queue q = {.plan = plan,
                      .fresnel = fresnel,
                      .s = s,
                      .use_horizon = true,
                      .keep_directions = prt_single_keeps_directions(plan)};
    s->node = s->of_eta[deciding(plan)];
    weigh_nodes(plan, l.depth, l.rise);
    q.rise = l.rise;
    for (uint32_t a = 0; a < l.n_node; a++) {
        q.pattern[a] = path->pattern + 65 * a; // 65: another jitter and another sub-sample
        q.slope[a] = prt_direction_slopes(plan->directions, q.pattern[a]);
        for (int k = 0; k < 3; k++) q.p[a][k] = path->x[k] - l.depth[a] * path->out[k];
    }
    draw_near(&q, &l);
    trace_tiles(&q, &l);
    trace_blocks(&q, &l);
    trace_texels(&q, &l);
    return q.rays;
}
