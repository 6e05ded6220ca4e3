// SPDX-License-Identifier: MIT
// Subdivision of a mesh by the middles of its edges, and of the transport on it.
#include "subdivide.h"

#include <stdlib.h>
#include <string.h>

struct fine {
    uint32_t n, n_triangle;
    uint32_t (*parent)[2]; // [n], of vertices with parents
    uint32_t (*triangle)[3];
};

static int by_value(const void *a, const void *b)
{
    const uint64_t x = *(const uint64_t *)a, y = *(const uint64_t *)b;
    return x < y ? -1 : x > y;
}

static uint64_t edge_of(const uint32_t triangle[3], int i)
{
    const uint32_t a = triangle[i], b = triangle[(i + 1) % 3];
    return a < b ? (uint64_t)a << 32 | b : (uint64_t)b << 32 | a;
}

// Every edge once, in order of its vertices.
static uint64_t *all_edges(const struct fine *f, size_t *n_edge)
{
    uint64_t *edge = prt_alloc(3 * (size_t)f->n_triangle, sizeof *edge);
    size_t n = 0;
    if (!edge) return NULL;
    for (size_t i = 0; i < f->n_triangle; i++)
        for (int k = 0; k < 3; k++) edge[3 * i + (size_t)k] = edge_of(f->triangle[i], k);
    qsort(edge, 3 * (size_t)f->n_triangle, sizeof *edge, by_value);
    for (size_t i = 0; i < 3 * (size_t)f->n_triangle; i++)
        if (!i || edge[i] != edge[i - 1]) edge[n++] = edge[i];
    *n_edge = n;
    return edge;
}

// Midpoints of a triangle's edges, if any; a triangle without one of them is not divided.
static size_t split(const struct fine *f, const uint64_t *edge, size_t n_edge,
                    const uint32_t corner[3], uint32_t (*out)[3])
{
    uint32_t mid[3];
    for (int k = 0; k < 3; k++) {
        const uint64_t key = edge_of(corner, k);
        const uint64_t *at = bsearch(&key, edge, n_edge, sizeof key, by_value);
        if (!at) {
            memcpy(out[0], corner, sizeof *out);
            return 1;
        }
        mid[k] = f->n + (uint32_t)(at - edge);
    }
    const uint32_t four[4][3] = {{corner[0], mid[0], mid[2]},
                                 {corner[1], mid[1], mid[0]},
                                 {corner[2], mid[2], mid[1]},
                                 {mid[0], mid[1], mid[2]}};
    memcpy(out, four, sizeof four);
    return 4;
}

static int refine(struct fine *f, uint32_t most)
{
    size_t n_edge = 0, n = 0;
    uint64_t *edge = all_edges(f, &n_edge);
    uint32_t(*triangle)[3] = prt_alloc(4 * (size_t)f->n_triangle, sizeof *triangle);
    int status = edge && triangle && n_edge ? PRT_OK : PRT_NOMEM;
    if (n_edge > most - f->n) n_edge = most - f->n;
    for (uint32_t i = 0; i < f->n_triangle && !status; i++)
        n += split(f, edge, n_edge, f->triangle[i], triangle + n);
    for (size_t i = 0; i < n_edge && !status; i++) {
        f->parent[f->n + i][0] = (uint32_t)(edge[i] >> 32);
        f->parent[f->n + i][1] = (uint32_t)edge[i];
    }
    prt_free(edge);
    if (status) {
        prt_free(triangle);
        return status;
    }
    prt_free(f->triangle);
    f->triangle = triangle;
    f->n_triangle = (uint32_t)n;
    f->n += (uint32_t)n_edge;
    return PRT_OK;
}

static int16_t *u_at(const struct prt_tensor *t, const struct prt_cluster *c, uint32_t r,
                     uint32_t position)
{
    const size_t padded = ((size_t)c->n_vertex + 15) & ~(size_t)15;
    return (int16_t *)(uintptr_t)t->u + c->u_begin + 2 * (r / 2 * padded + position) + r % 2;
}

// Where each vertex is.
struct places {
    uint32_t *cluster, *position; // [n_vertex]
};

static void place_coarse(const struct prt_tensor *from, struct places *p)
{
    for (uint32_t c = 0; c < from->n_cluster; c++)
        for (uint32_t v = 0; v < from->cluster[c].n_vertex; v++)
            p->cluster[from->order[from->cluster[c].vertex_begin + v]] = c;
}

// Clusters of *out, their vertices in the file's order, and room for U.
static int lay_clusters(const struct prt_tensor *from, uint32_t n, struct places *p,
                        struct prt_tensor *out)
{
    struct prt_cluster *cluster = prt_calloc(from->n_cluster + 1ull, sizeof *cluster);
    uint32_t *order = prt_alloc(n, sizeof *order), at = 0;
    out->cluster = cluster;
    out->order = order;
    out->u_count = 0;
    out->u = NULL;
    if (!cluster || !order) return PRT_NOMEM;
    for (uint32_t v = 0; v < n; v++) p->position[v] = cluster[p->cluster[v]].n_vertex++;
    for (uint32_t c = 0; c < from->n_cluster; c++) {
        cluster[c].vertex_begin = at;
        cluster[c].row_begin = from->cluster[c].row_begin;
        cluster[c].rank = from->cluster[c].rank;
        cluster[c].u_begin = out->u_count;
        at += cluster[c].n_vertex;
        out->u_count += (((uint64_t)cluster[c].n_vertex + 15) & ~15ull) *
                        ((cluster[c].rank + 1ull) & ~1ull);
    }
    for (uint32_t v = 0; v < n; v++)
        order[cluster[p->cluster[v]].vertex_begin + p->position[v]] = v;
    out->u = prt_calloc(out->u_count + 1, sizeof *out->u);
    return out->u ? PRT_OK : PRT_NOMEM;
}

static void fill_u(const struct prt_tensor *from, const struct fine *f, const struct places *p,
                   struct prt_tensor *out)
{
    for (uint32_t c = 0; c < from->n_cluster; c++)
        for (uint32_t v = 0; v < from->cluster[c].n_vertex; v++) {
            const uint32_t file = from->order[from->cluster[c].vertex_begin + v];
            for (uint32_t r = 0; r < from->cluster[c].rank; r++)
                *u_at(out, &out->cluster[c], r, p->position[file]) =
                    *u_at(from, &from->cluster[c], r, v);
        }
    for (uint32_t v = from->n_vertex; v < f->n; v++) {
        const struct prt_cluster *c = &out->cluster[p->cluster[v]];
        uint32_t a = f->parent[v][0], b = f->parent[v][1];
        if (p->cluster[b] != p->cluster[v]) b = a;
        for (uint32_t r = 0; r < c->rank; r++)
            *u_at(out, c, r, p->position[v]) = (int16_t)((*u_at(out, c, r, p->position[a]) +
                                                          *u_at(out, c, r, p->position[b])) /
                                                         2);
    }
}

int subdivided_tensor(const struct prt_mesh *mesh, const struct prt_tensor *tensor,
                      uint32_t n_vertex, struct prt_tensor *out)
{
    struct fine f = {mesh->n_vertex, mesh->n_triangle, prt_alloc(n_vertex, sizeof *f.parent),
                     prt_alloc(mesh->n_triangle, sizeof *f.triangle)};
    struct places p = {prt_calloc(n_vertex, sizeof *p.cluster),
                       prt_alloc(n_vertex, sizeof *p.position)};
    int status = f.parent && f.triangle && p.cluster && p.position ? PRT_OK : PRT_NOMEM;
    *out = *tensor;
    out->order = NULL;
    out->cluster = NULL;
    out->u = NULL;
    if (!status) memcpy(f.triangle, mesh->triangle, mesh->n_triangle * sizeof *f.triangle);
    while (!status && f.n < n_vertex) status = refine(&f, n_vertex);
    if (!status) place_coarse(tensor, &p);
    for (uint32_t v = tensor->n_vertex; v < f.n && !status; v++)
        p.cluster[v] = p.cluster[f.parent[v][0]];
    out->n_vertex = f.n;
    if (!status) status = lay_clusters(tensor, f.n, &p, out);
    if (!status) fill_u(tensor, &f, &p, out);
    prt_free(f.parent);
    prt_free(f.triangle);
    prt_free(p.cluster);
    prt_free(p.position);
    if (status) subdivided_finish(out);
    return status;
}

void subdivided_finish(struct prt_tensor *t)
{
    prt_free((void *)(uintptr_t)t->order);
    prt_free((void *)(uintptr_t)t->cluster);
    prt_free((void *)(uintptr_t)t->u);
    memset(t, 0, sizeof *t);
}
