// SPDX-License-Identifier: MIT
// W and D between the points where walks start (METHODS §6, walk ratio): weights that fall to 0
// smoothly with distance and with the angle between normals, from a grid of the points.
#include "walk_ratio.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

enum { MOST_CELLS = 128 }; // along an axis
// Of the interpolation, in spacings of the points: some ten points in reach.
static const float between_reach = 1.8f;
enum { MOST_DOUBLINGS = 40 }; // of the reach, from the spacing to beyond any box

static uint32_t cell_along(const struct ratio_grid *g, int axis, float x)
{
    const float at = (x - g->low[axis]) / g->edge_mm;
    if (!(at > 0)) return 0;
    return at < (float)g->cells[axis] ? (uint32_t)at : g->cells[axis] - 1;
}

static uint32_t cell_at(const struct ratio_grid *g, uint32_t x, uint32_t y, uint32_t z)
{
    return (z * g->cells[1] + y) * g->cells[0] + x;
}

static uint32_t cell_of(const struct ratio_grid *g, const float p[3])
{
    return cell_at(g, cell_along(g, 0, p[0]), cell_along(g, 1, p[1]), cell_along(g, 2, p[2]));
}

static void fit_cells(struct ratio_grid *g, float edge_mm)
{
    float high[3], longest = 0;
    for (int k = 0; k < 3; k++) g->low[k] = INFINITY, high[k] = -INFINITY;
    for (uint32_t i = 0; i < g->n; i++)
        for (int k = 0; k < 3; k++) {
            g->low[k] = min_f(g->low[k], g->point[i].p[k]);
            high[k] = max_f(high[k], g->point[i].p[k]);
        }
    for (int k = 0; k < 3; k++) longest = max_f(longest, high[k] - g->low[k]);
    g->edge_mm = max_f(edge_mm, longest / (MOST_CELLS - 1));
    for (int k = 0; k < 3; k++)
        g->cells[k] = (uint32_t)((high[k] - g->low[k]) / g->edge_mm) + 1;
}

int prt_ratio_grid_create(struct ratio_point *point, uint32_t n, float edge_mm,
                          struct ratio_grid *out)
{
    struct ratio_grid g = {.point = point, .n = n};
    fit_cells(&g, edge_mm);
    const size_t n_cell = (size_t)g.cells[0] * g.cells[1] * g.cells[2];
    struct ratio_point *sorted = prt_alloc(n + 1u, sizeof *sorted);
    g.begin = prt_calloc(n_cell + 2, sizeof *g.begin);
    if (!sorted || !g.begin) {
        prt_free(sorted);
        prt_free(g.begin);
        return PRT_NOMEM;
    }
    // begin[c + 1] is the next place of cell c while points are placed, in their order
    for (uint32_t i = 0; i < n; i++) g.begin[cell_of(&g, point[i].p) + 2]++;
    for (size_t c = 0; c < n_cell; c++) g.begin[c + 2] += g.begin[c + 1];
    for (uint32_t i = 0; i < n; i++) sorted[g.begin[cell_of(&g, point[i].p) + 1]++] = point[i];
    memcpy(point, sorted, n * sizeof *point);
    prt_free(sorted);
    *out = g;
    return PRT_OK;
}

void prt_ratio_grid_finish(struct ratio_grid *grid)
{
    prt_free(grid->begin);
    grid->begin = NULL;
}

static float weight_of(const struct ratio_point *q, const float p[3], const float n[3],
                       float reach2)
{
    float d2 = 0, c = 0;
    for (int k = 0; k < 3; k++) {
        const float d = q->p[k] - p[k];
        d2 += d * d;
        c += q->n[k] * n[k];
    }
    if (!(d2 < reach2)) return 0;
    const float near = 1 - d2 / reach2, alike = max_f(0.5f + 0.5f * c, 0);
    const float a2 = alike * alike, a4 = a2 * a2;
    return near * near * a4 * a4;
}

void prt_ratio_gather(const struct ratio_grid *g, const float p[3], const float n[3],
                      uint32_t object, float reach_mm,
                      void (*take)(void *arg, const struct ratio_point *point, float weight),
                      void *arg)
{
    uint32_t from[3], to[3];
    for (int k = 0; k < 3; k++) {
        from[k] = cell_along(g, k, p[k] - reach_mm);
        to[k] = cell_along(g, k, p[k] + reach_mm);
    }
    for (uint32_t z = from[2]; z <= to[2]; z++)
        for (uint32_t y = from[1]; y <= to[1]; y++) {
            const uint32_t row = cell_at(g, from[0], y, z), end = cell_at(g, to[0], y, z) + 1;
            for (uint32_t i = g->begin[row]; i < g->begin[end]; i++) {
                const struct ratio_point *q = &g->point[i];
                const float w =
                    q->object == object ? weight_of(q, p, n, reach_mm * reach_mm) : 0;
                if (w > 0) take(arg, q, w);
            }
        }
}

struct between {
    float all, dipole[3], walk[PRT_WALK_SHARES][3];
};

static void add_point(void *arg, const struct ratio_point *q, float weight)
{
    struct between *b = arg;
    b->all += weight;
    for (int c = 0; c < 3; c++) {
        b->dipole[c] += weight * q->dipole[c];
        for (int s = 0; s < PRT_WALK_SHARES; s++) b->walk[s][c] += weight * q->walk[s][c];
    }
}

void prt_ratio_between(const struct prt_walk_ratio *r, uint32_t object, const float p[3],
                       const float n[3], float out[PRT_WALK_SHARES][3])
{
    struct between b = {0};
    float reach = between_reach * r->spacing_mm;
    for (int k = 0; k < MOST_DOUBLINGS && !(b.all > 0); k++, reach *= 2)
        prt_ratio_gather(&r->grid, p, n, object, reach, add_point, &b);
    for (int s = 0; s < PRT_WALK_SHARES; s++)
        for (int c = 0; c < 3; c++)
            out[s][c] = b.dipole[c] > 0 ? b.walk[s][c] / b.dipole[c] : 1;
}

static float longest_edge(const struct prt_mesh *mesh, uint32_t t)
{
    float longest = 0;
    for (int j = 0; j < 3; j++) {
        const float *a = mesh->position[mesh->triangle[t][j]];
        const float *b = mesh->position[mesh->triangle[t][(j + 1) % 3]];
        float d2 = 0;
        for (int k = 0; k < 3; k++) d2 += (a[k] - b[k]) * (a[k] - b[k]);
        longest = max_f(longest, d2);
    }
    return sqrtf(longest);
}

struct fill {
    struct prt_walk_ratio *ratio;
    const uint32_t *object; // [n_vertex] or PRT_RATIO_NONE
};

static int fill_vertices(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct fill *job = arg;
    struct prt_walk_ratio *r = job->ratio;
    for (size_t v = begin; v < end; v++) {
        float at[PRT_WALK_SHARES][3];
        for (int s = 0; s < PRT_WALK_SHARES; s++) at[s][0] = at[s][1] = at[s][2] = 1;
        if (job->object[v] != PRT_RATIO_NONE)
            prt_ratio_between(r, job->object[v], r->position[v], r->normal[v], at);
        for (int s = 0; s < PRT_WALK_SHARES; s++) memcpy(r->vertex[s][v], at[s], sizeof at[s]);
    }
    return PRT_OK;
}

static bool copy_mesh(const struct prt_mesh *mesh, struct prt_walk_ratio *r)
{
    r->n_vertex = mesh->n_vertex;
    r->n_triangle = mesh->n_triangle;
    r->position = prt_alloc(mesh->n_vertex + 1u, sizeof *r->position);
    r->normal = prt_alloc(mesh->n_vertex + 1u, sizeof *r->normal);
    r->triangle = prt_alloc(mesh->n_triangle + 1u, sizeof *r->triangle);
    r->object = prt_alloc(mesh->n_triangle + 1u, sizeof *r->object);
    r->large = prt_alloc(mesh->n_triangle + 1u, sizeof *r->large);
    for (int s = 0; s < PRT_WALK_SHARES; s++)
        r->vertex[s] = prt_alloc(mesh->n_vertex + 1u, sizeof *r->vertex[s]);
    if (!r->position || !r->normal || !r->triangle || !r->object || !r->large ||
        !r->vertex[0] || !r->vertex[1])
        return false;
    memcpy(r->position, mesh->position, mesh->n_vertex * sizeof *r->position);
    memcpy(r->normal, mesh->normal, mesh->n_vertex * sizeof *r->normal);
    memcpy(r->triangle, mesh->triangle, mesh->n_triangle * sizeof *r->triangle);
    return true;
}

int prt_ratio_vertices(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       struct prt_walk_ratio *r)
{
    uint32_t *object = prt_alloc(mesh->n_vertex + 1u, sizeof *object);
    int status = object && copy_mesh(mesh, r) ? PRT_OK : PRT_NOMEM;
    for (uint32_t b = 0; b < mesh->n_block && !status; b++) {
        const struct prt_block *k = &mesh->block[b];
        const uint32_t own = prt_block_translucent(mesh, b) ? k->object : PRT_RATIO_NONE;
        for (uint32_t i = 0; i < k->n_vertex; i++) object[k->vertex_begin + i] = own;
        for (uint32_t t = k->triangle_begin; t < k->triangle_begin + k->n_triangle; t++) {
            r->object[t] = own;
            r->large[t] = longest_edge(mesh, t) > r->spacing_mm;
        }
    }
    struct fill job = {r, object};
    if (!status) status = prt_screen_loop(ctx, mesh->n_vertex, 256, fill_vertices, &job);
    prt_free(object);
    return status;
}

void prt_walk_ratio_at(const struct prt_walk_ratio *r, enum prt_walk_share share,
                       uint32_t triangle, float u, float v, float out[3])
{
    const float w[3] = {1 - u - v, u, v};
    const uint32_t *corner = r->triangle[triangle];
    if (!r->large[triangle] || r->object[triangle] == PRT_RATIO_NONE) {
        for (int c = 0; c < 3; c++) {
            out[c] = 0;
            for (int j = 0; j < 3; j++) out[c] += w[j] * r->vertex[share][corner[j]][c];
        }
        return;
    }
    float p[3] = {0}, n[3] = {0}, length = 0, all[PRT_WALK_SHARES][3];
    for (int k = 0; k < 3; k++) {
        for (int j = 0; j < 3; j++) {
            p[k] += w[j] * r->position[corner[j]][k];
            n[k] += w[j] * r->normal[corner[j]][k];
        }
        length += n[k] * n[k];
    }
    for (int k = 0; k < 3; k++) n[k] /= max_f(sqrtf(length), 1e-6f);
    prt_ratio_between(r, r->object[triangle], p, n, all);
    memcpy(out, all[share], sizeof all[share]);
}

struct scale_job {
    const struct prt_walk_ratio *ratio;
    enum prt_walk_share share;
    const struct prt_gbuffer *g;
    const float (*in)[3];
    float (*out)[3];
};

static int scale_points(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct scale_job *job = arg;
    const struct prt_gbuffer *g = job->g;
    for (size_t i = begin; i < end; i++) {
        float factor[3] = {1, 1, 1};
        if (g->triangle[i] >= job->ratio->n_triangle) return PRT_MISMATCH;
        if (!g->opaque[i])
            prt_walk_ratio_at(job->ratio, job->share, g->triangle[i], g->bary[0][i],
                              g->bary[1][i], factor);
        for (int c = 0; c < 3; c++) job->out[i][c] = job->in[i][c] * factor[c];
    }
    return PRT_OK;
}

// in may be out.
static int scale(const struct prt_context *ctx, struct scale_job *job)
{
    int status = prt_screen_loop(ctx, job->g->n_point, 1024, scale_points, job);
    return status == PRT_MISMATCH
               ? prt_fail(ctx, status, "the walk ratio is of another mesh: it has %u triangles",
                          job->ratio->n_triangle)
               : status;
}

int prt_walk_ratio_scale(const struct prt_context *ctx, const struct prt_walk_ratio *ratio,
                         enum prt_walk_share share, const struct prt_visibility *visibility,
                         const float (*radiance)[3], float (**out)[3])
{
    struct prt_gbuffer g;
    prt_visibility_gbuffer(visibility, &g);
    float(*scaled)[3] = prt_alloc(g.n_point + 1u, sizeof *scaled);
    if (!scaled) return prt_fail(ctx, PRT_NOMEM, "no memory for %u points", g.n_point);
    struct scale_job job = {ratio, share, &g, radiance, scaled};
    const int status = scale(ctx, &job);
    if (status) prt_free(scaled);
    else *out = scaled;
    return status;
}

int prt_ratio_apply(struct frame *f)
{
    struct scale_job job = {f->options->ratio, f->options->ratio_share, &f->g,
                            (const float(*)[3])f->radiance, f->radiance};
    return scale(f->ctx, &job);
}
