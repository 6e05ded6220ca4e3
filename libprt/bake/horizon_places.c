// SPDX-License-Identifier: MIT
// Where the horizon is traced. A triangle of level L is divided into 4^L equal ones: point (i,
// j) of its grid, i + j <= m = 2^L, has the barycentric coordinates u = i/m, v = j/m. Triangles
// of the same level share the points of their edge.
#include "bake/horizon_places.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_LEVEL = 5, TOO_WIDE = UINT8_MAX };

static double longest_edge(const struct prt_mesh *mesh, uint32_t triangle)
{
    double most = 0;
    for (int j = 0; j < 3; j++) {
        const float *a = mesh->position[mesh->triangle[triangle][j]];
        const float *b = mesh->position[mesh->triangle[triangle][(j + 1) % 3]];
        const double x = (double)a[0] - b[0], y = (double)a[1] - b[1], z = (double)a[2] - b[2];
        most = fmax(most, x * x + y * y + z * z);
    }
    return sqrt(most);
}

// The least level whose parts have no edge above `fine`, or MOST_LEVEL.
static unsigned level_for(double edge, double fine)
{
    unsigned level = 0;
    while (level < MOST_LEVEL && ldexp(edge, -(int)level) > fine) level++;
    return level;
}

// Places inside a triangle and, as each edge belongs to two, on half of its edges.
static double places_of(unsigned level)
{
    const double m = (double)(1u << level);
    return (m - 1) * (m - 2) / 2 + 1.5 * (m - 1);
}

// The finest parts that need no more than `most` places.
static double affordable(const struct prt_mesh *mesh, double fine, double most)
{
    for (;; fine *= 1.25) {
        double n = 0;
        for (uint32_t t = 0; t < mesh->n_triangle; t++)
            n += places_of(level_for(longest_edge(mesh, t), fine));
        if (n <= most || fine > 1e6 * prt_mesh_diagonal(mesh)) return fine;
    }
}

// An edge of a divided triangle, named by its vertices.
struct edge {
    uint32_t low, high, at; // at: 3 * triangle + edge
    uint8_t level;
};

static int compare_edges(const void *a, const void *b)
{
    const struct edge *x = a, *y = b;
    if (x->low != y->low) return x->low < y->low ? -1 : 1;
    if (x->high != y->high) return x->high < y->high ? -1 : 1;
    if (x->level != y->level) return x->level < y->level ? -1 : 1;
    return x->at < y->at ? -1 : x->at > y->at;
}

static bool divided(const struct horizon_places *p, uint32_t triangle)
{
    return p->level[triangle] && p->level[triangle] != TOO_WIDE;
}

// Numbers the points of edges; those of equal edges of one level are the same.
static int number_edges(struct horizon_places *p, uint32_t *next)
{
    const struct prt_mesh *mesh = p->mesh;
    struct edge *edge = prt_alloc(3 * (size_t)mesh->n_triangle + 1, sizeof *edge);
    size_t n = 0;
    if (!edge) return PRT_NOMEM;
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (uint32_t k = 0; k < 3 && divided(p, t); k++) {
            const uint32_t a = mesh->triangle[t][k], b = mesh->triangle[t][(k + 1) % 3];
            edge[n++] = (struct edge){a < b ? a : b, a < b ? b : a, 3 * t + k, p->level[t]};
        }
    qsort(edge, n, sizeof *edge, compare_edges);
    for (size_t i = 0; i < n; i++) {
        const struct edge *e = &edge[i], *before = e - (i > 0);
        const bool shared =
            i && before->low == e->low && before->high == e->high && before->level == e->level;
        p->edge_first[e->at] = shared ? p->edge_first[before->at] : *next;
        if (!shared) *next += (1u << e->level) - 1;
    }
    prt_free(edge);
    return PRT_OK;
}

static void number_insides(struct horizon_places *p, uint32_t *next)
{
    for (uint32_t t = 0; t < p->mesh->n_triangle; t++) {
        const uint32_t m = divided(p, t) ? 1u << p->level[t] : 2;
        p->inner_first[t] = *next;
        *next += (m - 1) * (m - 2) / 2;
    }
}

// Point k of 1 to m - 1 from corner `from` to the next one, on edge `from`.
static uint32_t on_edge(const struct horizon_places *p, uint32_t t, uint32_t from, uint32_t k)
{
    const uint32_t *v = p->mesh->triangle[t], m = 1u << p->level[t];
    const bool forward = v[from] < v[(from + 1) % 3];
    return p->edge_first[3 * (size_t)t + from] + (forward ? k : m - k) - 1;
}

static uint32_t place_of(const struct horizon_places *p, uint32_t t, uint32_t i, uint32_t j)
{
    const uint32_t *v = p->mesh->triangle[t], m = 1u << p->level[t];
    if (!i && !j) return v[0];
    if (i == m) return v[1];
    if (j == m) return v[2];
    if (!j) return on_edge(p, t, 0, i);
    if (i + j == m) return on_edge(p, t, 1, j);
    if (!i) return on_edge(p, t, 2, m - j);
    // row j of the inside has m - 1 - j points; rows 1 to j - 1 are before it
    return p->inner_first[t] + (j - 1) * (m - 1) - j * (j - 1) / 2 + i - 1;
}

static void mix(const float (*corner)[3], const uint32_t *v, float u, float w, float out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = (1 - u - w) * corner[v[0]][k] + u * corner[v[1]][k] + w * corner[v[2]][k];
}

static void find_points(struct horizon_places *p)
{
    const struct prt_mesh *mesh = p->mesh;
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        const uint32_t m = divided(p, t) ? 1u << p->level[t] : 0;
        for (uint32_t j = 0; m && j <= m; j++)
            for (uint32_t i = 0; i + j <= m; i++) {
                const uint32_t at = place_of(p, t, i, j);
                if (at < mesh->n_vertex) continue;
                float *n = p->normal[at - mesh->n_vertex], length = 0;
                const float u = (float)i / (float)m, w = (float)j / (float)m;
                mix((const float(*)[3])mesh->position, mesh->triangle[t], u, w,
                    p->point[at - mesh->n_vertex]);
                mix((const float(*)[3])mesh->normal, mesh->triangle[t], u, w, n);
                for (int k = 0; k < 3; k++) length += n[k] * n[k];
                for (int k = 0; k < 3 && length > 0; k++) n[k] /= sqrtf(length);
            }
    }
}

int prt_horizon_places_create(const struct prt_mesh *mesh, double widest, uint32_t most_more,
                              struct horizon_places *out)
{
    const uint32_t n = mesh->n_triangle;
    struct horizon_places p = {.mesh = mesh, .n_place = mesh->n_vertex};
    memset(out, 0, sizeof *out);
    p.level = prt_calloc(n + 1ull, sizeof *p.level);
    p.edge_first = prt_calloc(3ull * n + 1, sizeof *p.edge_first);
    p.inner_first = prt_calloc(n + 1ull, sizeof *p.inner_first);
    int status = p.level && p.edge_first && p.inner_first ? PRT_OK : PRT_NOMEM;
    const double fine = !status && most_more ? affordable(mesh, widest, most_more) : INFINITY;
    for (uint32_t t = 0; t < n && !status; t++) {
        const double edge = longest_edge(mesh, t);
        const unsigned level = level_for(edge, fine);
        p.level[t] = ldexp(edge, -(int)level) > widest ? TOO_WIDE : (uint8_t)level;
    }
    if (!status) status = number_edges(&p, &p.n_place);
    if (!status) number_insides(&p, &p.n_place);
    const size_t more = status ? 0 : p.n_place - mesh->n_vertex;
    p.point = prt_alloc(more + 1, sizeof *p.point);
    p.normal = prt_alloc(more + 1, sizeof *p.normal);
    if (!p.point || !p.normal) status = PRT_NOMEM;
    if (status) {
        prt_horizon_places_finish(&p);
        return status;
    }
    find_points(&p);
    *out = p;
    return PRT_OK;
}

void prt_horizon_places_finish(struct horizon_places *p)
{
    prt_free(p->level);
    prt_free(p->edge_first);
    prt_free(p->inner_first);
    prt_free(p->point);
    prt_free(p->normal);
    memset(p, 0, sizeof *p);
}

bool prt_horizon_places_around(const struct horizon_places *p, uint32_t triangle, float u,
                               float v, uint32_t corner[3])
{
    const unsigned level = p->level[triangle];
    if (!level) {
        memcpy(corner, p->mesh->triangle[triangle], 12);
        return true;
    }
    if (level == TOO_WIDE) return false;
    const int m = 1 << level;
    const float x = fminf(fmaxf(u, 0), 1) * (float)m, y = fminf(fmaxf(v, 0), 1) * (float)m;
    int i = x < (float)m ? (int)x : m - 1, j = y < (float)m ? (int)y : m - 1;
    if (i + j > m - 1) j = m - 1 - i; // rounding
    const bool upper = x - (float)i + (y - (float)j) > 1 && i + j + 2 <= m;
    const uint32_t a = (uint32_t)i, b = (uint32_t)j;
    corner[0] = upper ? place_of(p, triangle, a + 1, b + 1) : place_of(p, triangle, a, b);
    corner[1] = place_of(p, triangle, a + 1, b);
    corner[2] = place_of(p, triangle, a, b + 1);
    return true;
}

void prt_horizon_place(const struct horizon_places *p, uint32_t place, const float **position,
                       const float **normal)
{
    const uint32_t n = p->mesh->n_vertex;
    *position = place < n ? p->mesh->position[place] : p->point[place - n];
    *normal = place < n ? p->mesh->normal[place] : p->normal[place - n];
}
