// SPDX-License-Identifier: MIT
// Single scattering along -n_o (W05 eq 10-12, METHODS §3.5) with far fewer rays than texels x
// points: along the path the way out is traced at a few depths only (path_integral.c integrates
// between them). Of each tile of 4 x 4 texels one is traced, then of each block of 2 x 2, then
// all: the finer only where neighbours met something else. Beyond the surface a ray is cast
// only where the horizon (horizon.c) does not know that all is open.
#include "bake/path_integral.h"

#include <stdlib.h>
#include <string.h>

// Floats a direction takes: exits of the nodes and what compares them (value, doubt 1/4 each,
// coarse and fine 1/16), its side.
size_t single_scratch_bytes(const struct single_plan *plan)
{
    return ((SINGLE_MAX_NODES * 6 + 4) * (size_t)plan->n_direction + 64) * sizeof(float);
}

static void carve(const struct single_plan *plan, void *memory, struct scratch *s)
{
    float *at = memory;
    uint32_t n = plan->n_direction;
    for (int a = 0; a < SINGLE_MAX_NODES; a++) {
        s->node[a].way = at, at += n;
        s->node[a].open = at, at += n;
        for (int k = 0; k < 3; k++) s->node[a].dir[k] = at, at += n;
        s->value[a] = at;
        s->doubt[a] = at + n / 4;
        s->coarse[a] = at + n / 2;
        s->fine[a] = at + n / 2 + n / 4, at += n;
    }
    s->side = at, at += n;
    s->cell = (uint32_t *)at, at += n;
    s->first = (uint32_t *)at, at += n;
    s->split = (uint8_t *)at, at += n;
    s->y = at;
}

// What up to 16 rays met; way 0 and open 0: nothing.
struct lanes {
    float way[16], open[16], dir[3][16], cosine[16];
};

// The vertex normals of the triangles met.
struct corners {
    float n[3][3][16]; // [corner][axis]
};

static void gather_corners(const struct prt_mesh *mesh, const struct prt_packet *packet,
                           struct corners *c)
{
    for (int i = 0; i < 16; i++) {
        uint32_t t = packet->triangle[i];
        const uint32_t *tv = mesh->triangle[t == UINT32_MAX ? 0 : t];
        for (int j = 0; j < 3; j++)
            for (int k = 0; k < 3; k++) c->n[j][k][i] = mesh->normal[tv[j]][k];
    }
}

// Ways out (METHODS §1, s_i') and refracted directions of 16 rays; cosine 0 where the ray met
// a front face (its start lies outside) or is below the shading horizon, where F_t V is 0.
PRT_CLONES static void refract16(const struct prt_packet *packet, const struct corners *corner,
                                 float eta, struct lanes *out)
{
    float inv = 1 / eta;
    for (int i = 0; i < 16; i++) {
        float u = packet->u[i], v = packet->v[i], o = 1 - u - v;
        float dx = packet->dx[i], dy = packet->dy[i], dz = packet->dz[i];
        float x = o * corner->n[0][0][i] + u * corner->n[1][0][i] + v * corner->n[2][0][i];
        float y = o * corner->n[0][1][i] + u * corner->n[1][1][i] + v * corner->n[2][1][i];
        float z = o * corner->n[0][2][i] + u * corner->n[1][2][i] + v * corner->n[2][2][i];
        float length2 = x * x + y * y + z * z;
        float facing = packet->gx[i] * dx + packet->gy[i] * dy + packet->gz[i] * dz;
        float scale = 1 / sqrtf(length2 + 1e-30f);
        x *= scale, y *= scale, z *= scale;
        float cosine = x * dx + y * dy + z * dz;
        cosine = cosine > 1 ? 1 : cosine;
        bool out_of_body = packet->triangle[i] != UINT32_MAX && facing > 0 && cosine > 0;
        // not 1 - inv^2 (1 - cos^2), which is 0 for grazing rays at eta 1
        float root = sqrtf((1 - inv * inv) + inv * inv * cosine * cosine + 1e-20f);
        float bend = root - cosine * inv;
        out->cosine[i] = out_of_body ? cosine : 0;
        out->way[i] = out_of_body ? packet->t[i] * cosine / root : 0;
        // The refracted direction, pointing back outwards: w/eta + (root - cos/eta) n.
        out->dir[0][i] = dx * inv + bend * x;
        out->dir[1][i] = dy * inv + bend * y;
        out->dir[2][i] = dz * inv + bend * z;
    }
}

// Traces up to 16 rays from inside the body to their exits; open: F_t, as if nothing else were
// in the way. Returns the lanes that leave the body.
static uint32_t trace_exits(const struct single_plan *plan, const struct fresnel_table *fresnel,
                            struct prt_packet *packet, uint32_t mask, struct lanes *out)
{
    struct corners corner;
    uint32_t leave = 0;
    prt_scene_intersect16(plan->scene, packet, mask, false);
    gather_corners(plan->mesh, packet, &corner);
    refract16(packet, &corner, plan->eta, out);
    for (int i = 0; i < 16; i++) {
        leave |= (uint32_t)(out->cosine[i] > 0) << i;
        float open = fresnel_table_eval(fresnel, out->cosine[i]);
        out->open[i] = out->cosine[i] > 0 ? open : 0;
    }
    return leave & mask;
}

// Lane i of `shadow` becomes the ray from lane j's exit onwards, off the triangle it met.
static void leave_body(const struct prt_packet *packet, uint32_t j, float eps,
                       struct prt_packet *shadow, uint32_t i)
{
    float x = packet->gx[j], y = packet->gy[j], z = packet->gz[j], t = packet->t[j];
    float off = eps / sqrtf(x * x + y * y + z * z + 1e-30f);
    shadow->ox[i] = packet->ox[j] + t * packet->dx[j] + off * x;
    shadow->oy[i] = packet->oy[j] + t * packet->dy[j] + off * y;
    shadow->oz[i] = packet->oz[j] + t * packet->dz[j] + off * z;
    shadow->dx[i] = packet->dx[j], shadow->dy[i] = packet->dy[j], shadow->dz[i] = packet->dz[j];
    shadow->tnear[i] = 0, shadow->tfar[i] = INFINITY;
}

// Which of the first `fill` lanes meet the surface again.
static uint32_t blocked16(const struct single_plan *plan, struct prt_packet *shadow,
                          uint32_t fill)
{
    uint32_t mask = fill == 16 ? 0xffff : (1u << fill) - 1;
    for (uint32_t i = fill; i < 16; i++) {
        shadow->ox[i] = shadow->oy[i] = shadow->oz[i] = 0;
        shadow->dx[i] = 1, shadow->dy[i] = shadow->dz[i] = 0;
        shadow->tnear[i] = 0, shadow->tfar[i] = 0;
    }
    uint32_t blocked = prt_scene_occluded16(plan->scene, shadow, mask);
    return blocked;
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
    plan->doubt = 0.05f;
    plan->lost = 6;
    if (!plan->horizon) (void)horizon_create(plan->scene, &plan->horizon); // else all are cast
    if (plan->extinction) { // any extinction may come: nodes over every scale of the body
        plan->n_node = 6;
        plan->differ = 0.05f, plan->differ_texel = 0.2f;
        plan->first_mm = 0.05f, plan->last_mm = 60;
        plan->inward_mm = (float)prt_mesh_diagonal(plan->mesh);
        plan->weakest = 0.2f; // what is weaker still is answered, with coarser shadows
        return;
    }
    plan->n_node = 9;
    plan->differ = 0.02f, plan->differ_texel = 0.05f;
    plan->weakest = smallest(plan->sigma_t);
    plan->first_mm = 0.1f / largest(plan->sigma_t);
    plan->last_mm = 4 / plan->weakest;
    plan->inward_mm = 9 / plan->weakest;
}

void single_plan_finish(struct single_plan *plan)
{
    horizon_destroy(plan->horizon);
    plan->horizon = NULL;
}

static float luminance(const float c[3])
{
    return 0.2126f * c[0] + 0.7152f * c[1] + 0.0722f * c[2];
}

// The direction that stands for texel i (0..3) of block b: one sub-sample of one jitter.
static size_t texel_ray(const struct directions *d, unsigned pattern, uint32_t block,
                        uint32_t i)
{
    return ((size_t)(pattern % d->n_pattern) * d->n_packet + block) * 16 + i * 4 +
           (((pattern >> 6) + i) & 3);
}

static void store(struct exits *e, uint32_t texel, const struct lanes *lane, uint32_t i)
{
    e->way[texel] = lane->way[i];
    e->open[texel] = lane->open[i];
}

static void store_direction(struct exits *e, uint32_t texel, const struct lanes *lane,
                            uint32_t i)
{
    for (int k = 0; k < 3; k++) e->dir[k][texel] = lane->dir[k][i];
}

// Rays that met nothing within reach: the light of their texels is lost on the way.
static void fill_lost(struct lanes *lane, float far)
{
    for (int i = 0; i < 16; i++) {
        if (lane->way[i] > 0) continue;
        lane->way[i] = far, lane->open[i] = 0;
        for (int k = 0; k < 3; k++) lane->dir[k][i] = 0;
    }
}

// Where a ray's answer goes: to a texel, to the four of its block, or to the sixteen of a tile
// of 2 x 2 blocks.
enum share { ONE = 1, BLOCK = 4, TILE = 16 };
struct target {
    uint32_t node, block, texel;
    enum share share;
};

// Rays of one vertex waiting to be traced to their exits, and those waiting to be traced on.
struct queue {
    const struct single_plan *plan;
    const struct fresnel_table *fresnel;
    struct scratch *s;
    float p[SINGLE_MAX_NODES][3];
    bool keep_directions, ask_horizon;
    struct prt_packet packet, shadow;
    uint32_t fill, n_shadow;
    struct target target[16], shadow_target[16];
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
    uint32_t blocked = blocked16(q->plan, &q->shadow, q->n_shadow);
    q->rays += q->n_shadow;
    for (uint32_t i = 0; i < q->n_shadow; i++) {
        const struct target *to = &q->shadow_target[i];
        uint32_t at[TILE], n = texels_of(q->plan->directions, to, at);
        for (uint32_t j = 0; blocked >> i & 1 && j < n; j++)
            q->s->node[to->node].open[at[j]] = 0;
    }
    q->n_shadow = 0;
}

// What the horizon knows of the ray out of lane i.
static int known(const struct queue *q, uint32_t i)
{
    const struct single_plan *plan = q->plan;
    if (!q->ask_horizon || !plan->horizon) return 0;
    return horizon_known(plan->horizon, q->packet.triangle[i],
                         plan->directions->bin[q->target[i].texel]);
}

static void flush_exits(struct queue *q)
{
    struct lanes lane;
    uint32_t mask = q->fill == 16 ? 0xffff : (1u << q->fill) - 1;
    if (!q->fill) return;
    for (uint32_t i = q->fill; i < 16; i++) {
        q->packet.ox[i] = q->packet.oy[i] = q->packet.oz[i] = 0;
        q->packet.dx[i] = 1, q->packet.dy[i] = q->packet.dz[i] = 0;
    }
    for (uint32_t i = 0; i < 16; i++) {
        q->packet.tnear[i] = 0;
        q->packet.tfar[i] = q->plan->inward_mm; // nothing comes back from deeper
    }
    uint32_t leave = trace_exits(q->plan, q->fresnel, &q->packet, mask, &lane);
    float eps = prt_scene_epsilon(q->plan->scene);
    q->rays += q->fill;
    fill_lost(&lane, out_of_reach(q->plan));
    for (uint32_t i = 0; i < q->fill; i++) {
        const struct target *to = &q->target[i];
        struct exits *e = &q->s->node[to->node];
        uint32_t at[TILE], n = texels_of(q->plan->directions, to, at);
        int sure = leave >> i & 1 ? known(q, i) : 1;
        bool cast = !sure;
        if (sure < 0) lane.open[i] = 0;
        for (uint32_t j = 0; j < n; j++) store(e, at[j], &lane, i);
        for (uint32_t j = 0; q->keep_directions && j < n; j++)
            store_direction(e, at[j], &lane, i);
        if (n > 1)
            q->s->doubt[to->node][to->block] =
                cast ? exp_minus(q->plan->weakest * lane.way[i]) : 0;
        if (!cast) continue;
        leave_body(&q->packet, i, eps, &q->shadow, q->n_shadow);
        q->shadow_target[q->n_shadow] = *to;
        if (++q->n_shadow == 16) flush_shadows(q);
    }
    q->fill = 0;
}

static void finish_rays(struct queue *q)
{
    flush_exits(q);
    flush_shadows(q);
}

// Node a's ray through texel i of a block, by the sub-sample of `pattern`.
static void push(struct queue *q, uint32_t a, unsigned pattern, uint32_t block, uint32_t i,
                 enum share share)
{
    const struct directions *d = q->plan->directions;
    size_t at = texel_ray(d, pattern, block, i);
    struct prt_packet *p = &q->packet;
    uint32_t l = q->fill;
    p->ox[l] = q->p[a][0], p->oy[l] = q->p[a][1], p->oz[l] = q->p[a][2];
    p->dx[l] = d->x[at], p->dy[l] = d->y[at], p->dz[l] = d->z[at];
    q->target[l] = (struct target){a, block, d->texel[(size_t)block * 4 + i], share};
    if (++q->fill == 16) flush_exits(q);
}

// A ray for every texel into node 0.
static uint64_t trace_every(const struct single_plan *plan, const struct fresnel_table *fresnel,
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

// Whether a cell's neighbours on its face of `wide` cells met something else; value < 0: not
// traced.
static bool differs(const float *value, uint32_t b, uint32_t wide, float most)
{
    uint32_t x = b % wide, y = b / wide % wide;
    return (x && fabsf(value[b] - value[b - 1]) > most) ||
           (x + 1 < wide && fabsf(value[b] - value[b + 1]) > most) ||
           (y && fabsf(value[b] - value[b - wide]) > most) ||
           (y + 1 < wide && fabsf(value[b] - value[b + wide]) > most);
}

// The k-th cell in squares of 4 x 4, so that rays traced together stay together.
static uint32_t tiled(uint32_t k, uint32_t wide)
{
    if (wide % 4) return k;
    uint32_t face = k / (wide * wide), in = k % (wide * wide), tile = in / 16, i = in % 16;
    uint32_t x = tile % (wide / 4) * 4 + (i & 3), y = tile / (wide / 4) * 4 + (i >> 2);
    return (face * wide + y) * wide + x;
}

// The j-th block (0..3) of tile t.
static uint32_t block_of(uint32_t t, uint32_t j, uint32_t wide)
{
    return (t / wide * 2 + (j >> 1)) * 2 * wide + t % wide * 2 + (j & 1);
}

// What the ray of block b brings, to compare with its neighbours. A medium that is given has
// weighed the nodes (weigh_nodes); where it is free the way in weakens what is deep.
static float brings(const struct single_plan *plan, const struct exits *e, uint32_t b,
                    float depth)
{
    uint32_t t = plan->directions->texel[(size_t)b * 4];
    float u = e->way[t] + (plan->extinction ? depth : 0);
    return e->open[t] * exp_minus(plan->weakest * u);
}

static void copy_tile(const struct directions *d, uint32_t t, uint32_t wide,
                      const struct exits *from, struct exits *to, bool directions)
{
    for (uint32_t j = 0; j < 16; j++) {
        uint32_t at = d->texel[(size_t)block_of(t, j >> 2, wide) * 4 + (j & 3)];
        to->way[at] = from->way[at], to->open[at] = from->open[at];
        for (int k = 0; directions && k < 3; k++) to->dir[k][at] = from->dir[k][at];
    }
}

// What differences at a node must exceed to matter, beside those at the node that weighs most:
// the light of node a stands for the path halfway to its neighbours.
static void weigh_nodes(const struct single_plan *plan, const float *depth, float *rise)
{
    float weight[SINGLE_MAX_NODES], most = 0;
    uint32_t N = plan->n_node;
    for (uint32_t a = 0; a < N; a++) {
        float width = (a + 1 < N ? depth[a + 1] : 2 * depth[a]) - (a ? depth[a - 1] : 0);
        weight[a] = plan->extinction ? 1 : 0; // any extinction: some medium's light is there
        for (int c = 0; !plan->extinction && c < 3; c++)
            weight[a] += plan->sigma_t[c] * width * expf(-plan->sigma_t[c] * depth[a]);
        most = fmaxf(most, weight[a]);
    }
    for (uint32_t a = 0; a < N; a++) rise[a] = fminf(most / fmaxf(weight[a], 1e-6f), 1e3f);
}

// How a vertex's rays are laid out: tiles of 2 x 2 blocks of 2 x 2 texels, `half` blocks and
// `wide` tiles across a face; each node takes another sub-sample, so that a texel half in
// shadow is half lit along the path.
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

// A ray for each tile at each node. Towards tiles from where no light comes back one node's
// ray serves for all.
static void trace_tiles(struct queue *q, const struct layout *l, const float *depth)
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
        float u = q->s->node[mid].way[first] + depth[mid];
        for (uint32_t a = 0; a < l->n_node; a++) {
            if (a == mid) continue;
            if (plan->weakest * u < plan->lost) {
                push_block(q, l, a, chosen(l, t, a), TILE);
                continue;
            }
            copy_tile(d, t, l->wide, &q->s->node[mid], &q->s->node[a], q->keep_directions);
            q->s->doubt[a][chosen(l, t, a)] = 0;
        }
    }
    finish_rays(q);
}

// A ray for each block of the tiles that differ from their neighbours, or where the horizon
// leaves it open what more rays would meet.
static void trace_blocks(struct queue *q, const struct layout *l)
{
    const struct single_plan *plan = q->plan;
    struct scratch *s = q->s;
    for (uint32_t a = 0; a < l->n_node; a++)
        for (uint32_t t = 0; t < l->n_tile; t++)
            s->coarse[a][t] = brings(plan, &s->node[a], block_of(t, 0, l->wide), l->depth[a]);
    for (uint32_t k = 0; k < l->n_tile; k++) {
        uint32_t t = tiled(k, l->wide);
        for (uint32_t a = 0; a < l->n_node; a++) {
            uint32_t own = chosen(l, t, a);
            bool fine = differs(s->coarse[a], t, l->wide, plan->differ * l->rise[a]) ||
                        s->doubt[a][own] > plan->doubt * l->rise[a];
            s->fine[a][t] = fine;
            for (uint32_t j = 0; j < 4; j++) {
                uint32_t b = block_of(t, j, l->wide);
                s->value[a][b] = s->coarse[a][t];
                if (fine && b != own) push_block(q, l, a, b, BLOCK);
            }
        }
    }
    finish_rays(q);
    for (uint32_t a = 0; a < l->n_node; a++)
        for (uint32_t t = 0; t < l->n_tile; t++)
            for (uint32_t j = 0; s->fine[a][t] > 0 && j < 4; j++) {
                uint32_t b = block_of(t, j, l->wide);
                s->value[a][b] = brings(plan, &s->node[a], b, l->depth[a]);
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
            if (!(s->fine[a][t] > 0) || !differs(s->value[a], b, l->half, most)) continue;
            s->split[b] = 1;
            for (uint32_t i = 0; i < 4; i++)
                if (i != ((b + l->pattern[a]) & 3)) push(q, a, l->pattern[a], b, i, ONE);
        }
    }
    finish_rays(q);
}

// Fills the nodes for every texel. Rays of all depths towards one tile are traced together:
// they meet the same triangles.
static uint64_t trace_nodes(const struct single_plan *plan, const struct fresnel_table *fresnel,
                            const float x[3], const float n[3], unsigned pattern,
                            const float *depth, struct scratch *s)
{
    uint32_t half = plan->directions->n / 2;
    struct layout l = {.half = half,
                       .wide = half / 2,
                       .n_tile = 6 * (half / 2) * (half / 2),
                       .n_node = plan->n_node,
                       .depth = depth};
    struct queue q = {.plan = plan,
                      .fresnel = fresnel,
                      .s = s,
                      .ask_horizon = true,
                      .keep_directions = plan->n_phase > 1};
    weigh_nodes(plan, depth, l.rise);
    for (uint32_t a = 0; a < l.n_node; a++) {
        l.pattern[a] = pattern + 65 * a;
        for (int k = 0; k < 3; k++) q.p[a][k] = x[k] - depth[a] * n[k];
    }
    trace_tiles(&q, &l, depth);
    trace_blocks(&q, &l);
    trace_texels(&q, &l);
    return q.rays;
}

// The texels of n cells: gathers their mean cosine with the normal where they share one.
static void add_cell(struct scratch *s, const uint32_t *texel, uint32_t n, uint32_t *n_cell)
{
    float side = 0;
    for (uint32_t i = 0; i < n; i++) side += s->side[texel[i]], s->cell[texel[i]] = *n_cell;
    s->first[*n_cell] = texel[0];
    s->side[texel[0]] = side / (float)n;
    ++*n_cell;
}

// Gathers texels that share their rays at every node into cells. Returns their number.
static uint32_t make_cells(const struct single_plan *plan, struct scratch *s)
{
    const struct directions *d = plan->directions;
    uint32_t wide = d->n / 4, n_cell = 0, at[16];
    for (uint32_t t = 0; t < 6 * wide * wide; t++) {
        bool fine = false;
        for (uint32_t a = 0; a < plan->n_node; a++) fine |= s->fine[a][t] > 0;
        for (uint32_t j = 0; j < 4; j++) {
            uint32_t b = block_of(t, j, wide);
            memcpy(at + j * 4, d->texel + (size_t)b * 4, 4 * sizeof *at);
            if (!fine) continue;
            if (!s->split[b]) add_cell(s, at + j * 4, 4, &n_cell);
            for (uint32_t i = 0; s->split[b] && i < 4; i++)
                add_cell(s, at + j * 4 + i, 1, &n_cell);
        }
        if (!fine) add_cell(s, at, 16, &n_cell);
    }
    return n_cell;
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
    struct prt_packet packet, shadow;
    struct lanes lane;
    uint64_t rays = 0;
    float eps = prt_scene_epsilon(plan->scene);
    for (uint32_t first = 0; first < n; first += 16) {
        uint32_t m = n - first < 16 ? n - first : 16, mask = m < 16 ? (1u << m) - 1 : 0xffff;
        for (uint32_t i = 0; i < 16; i++) {
            uint32_t k = first + (i < m ? i : 0);
            packet.dx[i] = x[k], packet.dy[i] = y[k], packet.dz[i] = z[k];
            packet.ox[i] = p[0], packet.oy[i] = p[1], packet.oz[i] = p[2];
            packet.tnear[i] = 0, packet.tfar[i] = INFINITY;
        }
        uint32_t leave = trace_exits(plan, fresnel, &packet, mask, &lane), fill = 0, of[16];
        fill_lost(&lane, 1e4f);
        for (uint32_t i = 0; i < m; i++)
            if (leave >> i & 1) leave_body(&packet, i, eps, &shadow, fill), of[fill++] = i;
        uint32_t blocked = fill ? blocked16(plan, &shadow, fill) : 0;
        for (uint32_t i = 0; i < fill; i++)
            if (blocked >> i & 1) lane.open[of[i]] = 0;
        rays += m + fill;
        for (uint32_t i = 0; i < m; i++) {
            store(out, first + i, &lane, i);
            store_direction(out, first + i, &lane, i);
        }
    }
    return rays;
}

static float thickness_at(const struct single_plan *plan, const float x[3], const float n[3])
{
    float eps = prt_scene_epsilon(plan->scene), down[3], start[3], t, u, v;
    uint32_t triangle;
    float deep = plan->extinction ? plan->inward_mm : fminf(3 * plan->inward_mm, 1e5f);
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
    s.first = NULL;
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
        rays += trace_every(plan, fresnel, p, pattern + i * 0x51, s);
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

uint64_t single_cells(const struct single_plan *plan, const struct fresnel_table *fresnel,
                      uint32_t vertex, float *value, struct single_cells *out, void *memory)
{
    const struct directions *d = plan->directions;
    const float *x = plan->mesh->position[vertex], *n = plan->mesh->normal[vertex];
    struct scratch s = {0};
    carve(plan, memory, &s);
    uint64_t rays = 1;
    float thickness = thickness_at(plan, x, n);
    unsigned pattern = (unsigned)(prt_hash64(&vertex, sizeof vertex, plan->seed) >> 20);
    *out = (struct single_cells){d->n_coef, s.cell, value};
    if (plan->every_ray) {
        for (uint32_t t = 0; t < d->n_coef; t++) s.cell[t] = t;
        return rays + every_ray(plan, fresnel, x, n, thickness, pattern, &s, value);
    }
    float depth[SINGLE_MAX_NODES], end;
    place_nodes(plan, thickness, depth);
    for (uint32_t k = 0; k < d->n_packet * 4; k++) {
        size_t at = texel_ray(d, pattern, k / 4, k % 4);
        s.side[d->texel[k]] = n[0] * d->x[at] + n[1] * d->y[at] + n[2] * d->z[at];
    }
    rays += trace_nodes(plan, fresnel, x, n, pattern, depth, &s);
    end = fminf(thickness, depth[plan->n_node - 1] + plan->inward_mm);
    out->n_cell = make_cells(plan, &s);
    path_integrate(plan, fresnel, &s, depth, end, out->n_cell, NULL, value);
    return rays;
}

uint64_t single_rows(const struct single_plan *plan, const struct fresnel_table *fresnel,
                     uint32_t vertex, float *out, void *memory)
{
    uint32_t n = plan->directions->n_coef;
    uint32_t n_plane = plan->n_phase * (plan->extinction ? plan->extinction->n_function : 3);
    struct single_cells c;
    struct scratch s = {0};
    uint64_t rays = single_cells(plan, fresnel, vertex, out, &c, memory);
    carve(plan, memory, &s);
    float *row = s.node[0].way;            // no longer wanted
    for (uint32_t p = n_plane; p-- > 0;) { // in place, the last plane first
        float *to = out + (size_t)p * n;
        memcpy(row, out + (size_t)p * c.n_cell, c.n_cell * sizeof *row);
        for (uint32_t t = 0; t < n; t++) to[t] = row[c.cell[t]];
    }
    return rays;
}
