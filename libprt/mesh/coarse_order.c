// SPDX-License-Identifier: MIT
// An order of a mesh's vertices whose prefixes are coarser sets of them: pairs of neighbours
// become one vertex, again and again.
#include "prt/mesh.h"

#include <string.h>

enum { MOST_LEVELS = 5 }; // halvings: the last set has some 1/32 of the vertices

struct coarsening {
    const struct prt_mesh *mesh;
    uint32_t n;
    uint32_t n_edge, (*edge)[2]; // between vertices of the present set; repeated
    uint32_t *begin, *neighbour; // of vertex v: [begin[v], begin[v + 1])
    uint32_t *mate;              // [n] its pair's kept vertex, itself; NONE: undecided
    uint8_t *gone;               // [n] left the set at an earlier level
    uint32_t end;                // positions from here on are taken
    struct prt_coarse_order *out;
};
#define NONE UINT32_MAX

static void link_neighbours(struct coarsening *c)
{
    memset(c->begin, 0, (c->n + 2ull) * sizeof *c->begin);
    for (uint32_t e = 0; e < c->n_edge; e++)
        for (int side = 0; side < 2; side++) c->begin[c->edge[e][side] + 2]++;
    for (uint32_t v = 2; v < c->n + 2; v++) c->begin[v] += c->begin[v - 1];
    for (uint32_t e = 0; e < c->n_edge; e++)
        for (int side = 0; side < 2; side++)
            c->neighbour[c->begin[c->edge[e][side] + 1]++] = c->edge[e][1 - side];
}

static float distance2(const float a[3], const float b[3])
{
    float sum = 0;
    for (int i = 0; i < 3; i++) sum += (a[i] - b[i]) * (a[i] - b[i]);
    return sum;
}

// Pairs each vertex with its nearest undecided neighbour, which is removed from the set.
static uint32_t pair_vertices(struct coarsening *c)
{
    const float(*position)[3] = (const float(*)[3])c->mesh->position;
    uint32_t left = 0;
    for (uint32_t v = 0; v < c->n; v++) c->mate[v] = NONE;
    for (uint32_t v = 0; v < c->n; v++) {
        uint32_t best = NONE;
        if (c->gone[v] || c->mate[v] != NONE) continue;
        c->mate[v] = v;
        for (uint32_t i = c->begin[v]; i < c->begin[v + 1]; i++) {
            const uint32_t u = c->neighbour[i];
            if (c->mate[u] == NONE &&
                (best == NONE ||
                 distance2(position[u], position[v]) < distance2(position[best], position[v])))
                best = u;
        }
        if (best == NONE) continue;
        c->mate[best] = v;
        left++;
    }
    return left;
}

// The kept neighbour that, with the mate, has its midpoint nearest to v.
static uint32_t second_parent(const struct coarsening *c, uint32_t v)
{
    const float(*position)[3] = (const float(*)[3])c->mesh->position;
    const uint32_t first = c->mate[v];
    uint32_t best = first;
    float least = distance2(position[v], position[first]);
    for (uint32_t i = c->begin[v]; i < c->begin[v + 1]; i++) {
        const uint32_t u = c->neighbour[i];
        float middle[3];
        if (c->mate[u] != u) continue;
        for (int k = 0; k < 3; k++) middle[k] = 0.5f * (position[u][k] + position[first][k]);
        const float d = distance2(position[v], middle);
        if (d < least) least = d, best = u;
    }
    return best;
}

// Puts the vertices that leave the set at the end of the order and merges their edges.
static void drop_vertices(struct coarsening *c)
{
    struct prt_coarse_order *o = c->out;
    for (uint32_t v = c->n; v-- > 0;) {
        if (c->gone[v] || c->mate[v] == v) continue;
        o->vertex[--c->end] = v;
        o->parent[c->end][0] = c->mate[v];
        o->parent[c->end][1] = second_parent(c, v);
    }
    for (uint32_t v = 0; v < c->n; v++) c->gone[v] |= c->mate[v] != v;
    uint32_t n = 0;
    for (uint32_t e = 0; e < c->n_edge; e++) {
        const uint32_t a = c->mate[c->edge[e][0]], b = c->mate[c->edge[e][1]];
        if (a == b) continue;
        c->edge[n][0] = a;
        c->edge[n++][1] = b;
    }
    c->n_edge = n;
}

static void put_roots(struct coarsening *c)
{
    struct prt_coarse_order *o = c->out;
    o->n_root = c->end;
    for (uint32_t v = c->n; v-- > 0;)
        if (!c->gone[v]) {
            o->vertex[--c->end] = v;
            o->parent[c->end][0] = o->parent[c->end][1] = v;
        }
    // Parents become positions.
    for (uint32_t i = 0; i < c->n; i++) c->mate[o->vertex[i]] = i;
    for (uint32_t i = 0; i < c->n; i++)
        for (int k = 0; k < 2; k++) o->parent[i][k] = c->mate[o->parent[i][k]];
}

static void take_edges(struct coarsening *c)
{
    const struct prt_mesh *m = c->mesh;
    for (uint32_t t = 0; t < m->n_triangle; t++)
        for (int k = 0; k < 3; k++) {
            const uint32_t a = m->triangle[t][k], b = m->triangle[t][(k + 1) % 3];
            if (a == b) continue;
            c->edge[c->n_edge][0] = a;
            c->edge[c->n_edge++][1] = b;
        }
}

int prt_coarse_order_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                            struct prt_coarse_order *out)
{
    const size_t n = mesh->n_vertex, edges = 3ull * mesh->n_triangle;
    struct prt_coarse_order order = {.n = mesh->n_vertex,
                                     .vertex = prt_alloc(n + 1, sizeof *order.vertex),
                                     .parent = prt_alloc(n + 1, sizeof *order.parent)};
    struct coarsening c = {.mesh = mesh,
                           .n = mesh->n_vertex,
                           .edge = prt_alloc(edges + 1, sizeof *c.edge),
                           .begin = prt_alloc(n + 3, sizeof *c.begin),
                           .neighbour = prt_alloc(2 * edges + 1, sizeof *c.neighbour),
                           .mate = prt_alloc(n + 1, sizeof *c.mate),
                           .gone = prt_calloc(n + 1, 1),
                           .end = mesh->n_vertex,
                           .out = &order};
    const bool good = order.vertex && order.parent && c.edge && c.begin && c.neighbour &&
                      c.mate && c.gone && edges < UINT32_MAX / 2;
    if (good) take_edges(&c);
    for (int level = 0; good && level < MOST_LEVELS; level++) {
        link_neighbours(&c);
        if (!pair_vertices(&c)) break;
        drop_vertices(&c);
    }
    if (good) put_roots(&c);
    prt_free(c.edge);
    prt_free(c.begin);
    prt_free(c.neighbour);
    prt_free(c.mate);
    prt_free(c.gone);
    if (good) *out = order;
    else prt_coarse_order_finish(&order);
    return good ? PRT_OK
                : prt_fail(ctx, PRT_NOMEM, "no memory for an order of %zu vertices", n);
}

void prt_coarse_order_finish(struct prt_coarse_order *order)
{
    prt_free(order->vertex);
    prt_free(order->parent);
    *order = (struct prt_coarse_order){0};
}
