// SPDX-License-Identifier: MIT
// The fine quadrature of the translucent surface, and the cell of each sample: the fine points
// around it with interpolation weights.
#include "trace/surface_private.h"
#include "trace/triangle.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// Chosen, not measured: fine points a sample; the cosine between normals of one sheet; the
// rings of grid cells (1.5 spacings each) that are searched.
static const uint64_t fine_per_sample = 16;
static const float same_sheet = 0.2f;
static const int most_rings = 4;

// Uniform grid over an object's samples, for the search of the nearest.
struct grid {
    float lo[3], inv_cell;
    int dim[3];
    uint32_t *begin, *item;
};

static size_t grid_cell(const struct grid *g, const float p[3], int out[3])
{
    for (int k = 0; k < 3; k++) {
        int c = (int)floorf((p[k] - g->lo[k]) * g->inv_cell);
        out[k] = c < 0 ? 0 : c >= g->dim[k] ? g->dim[k] - 1 : c;
    }
    return ((size_t)out[2] * (size_t)g->dim[1] + (size_t)out[1]) * (size_t)g->dim[0] +
           (size_t)out[0];
}

static int grid_build(const struct prt_surface_points *s, uint32_t begin, uint32_t end,
                      float cell, struct grid *g)
{
    float hi[3];
    for (int k = 0; k < 3; k++) g->lo[k] = INFINITY, hi[k] = -INFINITY;
    for (uint32_t i = begin; i < end; i++)
        for (int k = 0; k < 3; k++) {
            g->lo[k] = fminf(g->lo[k], s->position[i][k]);
            hi[k] = fmaxf(hi[k], s->position[i][k]);
        }
    for (;;) { // a thin, large object would have too many cells
        size_t n = 1;
        g->inv_cell = 1 / cell;
        for (int k = 0; k < 3; k++) {
            g->dim[k] = (int)((hi[k] - g->lo[k]) * g->inv_cell) + 1;
            n *= (size_t)g->dim[k];
        }
        if (n <= 64u << 20) break;
        cell *= 1.5f;
    }
    size_t n_cell = (size_t)g->dim[0] * (size_t)g->dim[1] * (size_t)g->dim[2];
    g->begin = prt_calloc(n_cell + 1, sizeof *g->begin);
    g->item = prt_alloc(end - begin, sizeof *g->item);
    if (!g->begin || !g->item) return PRT_NOMEM;
    int c[3];
    for (uint32_t i = begin; i < end; i++) g->begin[grid_cell(g, s->position[i], c) + 1]++;
    for (size_t i = 0; i < n_cell; i++) g->begin[i + 1] += g->begin[i];
    for (uint32_t i = end; i-- > begin;) {
        size_t at = grid_cell(g, s->position[i], c);
        g->item[--g->begin[at + 1]] = i;
    }
    // begin[at+1] now holds the start of cell `at`: shift back.
    memmove(g->begin, g->begin + 1, n_cell * sizeof *g->begin);
    g->begin[n_cell] = end - begin;
    return PRT_OK;
}

enum { NEIGHBOURS = 3 };
struct neighbour {
    uint32_t sample[NEIGHBOURS];
    float weight[NEIGHBOURS];
};

// The nearest samples found so far, by rising squared distance.
struct search {
    const struct prt_surface_points *s;
    const struct grid *grid;
    const float *p, *normal;
    bool any_sheet; // samples whose normal disagrees count, too
    int n;
    float distance2[NEIGHBOURS];
    uint32_t sample[NEIGHBOURS];
};

static void insert_sample(struct search *q, uint32_t i, float d2)
{
    int at = q->n < NEIGHBOURS ? q->n : NEIGHBOURS;
    for (; at > 0 && d2 < q->distance2[at - 1]; at--) {
        if (at == NEIGHBOURS) continue;
        q->distance2[at] = q->distance2[at - 1];
        q->sample[at] = q->sample[at - 1];
    }
    if (at == NEIGHBOURS) return;
    q->distance2[at] = d2;
    q->sample[at] = i;
    if (q->n < NEIGHBOURS) q->n++;
}

static void search_cell(struct search *q, size_t cell)
{
    const float *p = q->p, *n = q->normal;
    for (uint32_t k = q->grid->begin[cell]; k < q->grid->begin[cell + 1]; k++) {
        uint32_t i = q->grid->item[k];
        const float *at = q->s->position[i], *m = q->s->face_normal[i];
        if (!q->any_sheet && m[0] * n[0] + m[1] * n[1] + m[2] * n[2] < same_sheet) continue;
        float d[3] = {at[0] - p[0], at[1] - p[1], at[2] - p[2]};
        insert_sample(q, i, d[0] * d[0] + d[1] * d[1] + d[2] * d[2]);
    }
}

// All cells at most `ring` cells from c.
static void search_cube(struct search *q, const int c[3], int ring)
{
    const int *dim = q->grid->dim;
    int lo[3], hi[3];
    for (int k = 0; k < 3; k++) {
        lo[k] = c[k] - ring < 0 ? 0 : c[k] - ring;
        hi[k] = c[k] + ring >= dim[k] ? dim[k] - 1 : c[k] + ring;
    }
    for (int z = lo[2]; z <= hi[2]; z++)
        for (int y = lo[1]; y <= hi[1]; y++)
            for (int x = lo[0]; x <= hi[0]; x++)
                search_cell(q, ((size_t)z * (size_t)dim[1] + (size_t)y) * (size_t)dim[0] +
                                   (size_t)x);
}

// The nearest samples on the same sheet of the surface, or on any where that has none, with
// inverse-square weights.
static void nearest(const struct prt_surface_points *s, const struct grid *g, const float p[3],
                    const float normal[3], struct neighbour *out)
{
    struct search q = {.s = s, .grid = g, .p = p, .normal = normal};
    int c[3];
    grid_cell(g, p, c);
    for (int pass = 0; pass < 2 && q.n == 0; pass++) {
        q.any_sheet = pass;
        for (int ring = 1; q.n < NEIGHBOURS && ring <= most_rings; ring++) {
            q.n = 0;
            search_cube(&q, c, ring);
        }
    }
    float sum = 0, soft = 0.05f * s->spacing * s->spacing; // bounds the weight at distance 0
    for (int k = 0; k < NEIGHBOURS; k++) {
        out->weight[k] = k < q.n ? 1 / (q.distance2[k] + soft) : 0;
        out->sample[k] = k < q.n ? q.sample[k] : UINT32_MAX;
        sum += out->weight[k];
    }
    for (int k = 0; k < q.n; k++) out->weight[k] /= sum;
}

// Number of fine points of a triangle: m*m congruent pieces no wider than fine_mm.
static uint32_t fine_cuts(const struct prt_mesh *mesh, uint32_t t, double fine_mm)
{
    double longest = 0;
    for (int j = 0; j < 3; j++) {
        const float *a = mesh->position[mesh->triangle[t][j]];
        const float *b = mesh->position[mesh->triangle[t][(j + 1) % 3]];
        double d = 0;
        for (int k = 0; k < 3; k++) d += ((double)a[k] - b[k]) * ((double)a[k] - b[k]);
        longest = fmax(longest, sqrt(d));
    }
    double m = ceil(longest / (1.4 * fine_mm));
    return m < 1 ? 1 : m > 2000 ? 2000 : (uint32_t)m;
}

struct fine_job {
    struct prt_surface_points *s;
    const struct prt_mesh *mesh;
    const struct piece_list *list;
    const struct grid *grid;
    const uint64_t *start; // first fine point of each listed triangle
    double fine_mm;
    struct neighbour *neighbour;
    float *area; // [n_fine]
};

static int fine_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    struct fine_job *job = arg;
    const struct prt_mesh *mesh = job->mesh;
    for (size_t i = begin; i < end; i++) {
        uint32_t t = job->list->triangle[i], m = fine_cuts(mesh, t, job->fine_mm);
        double area = triangle_area(mesh, t) / ((double)m * m), face[3], length = 0;
        float normal[3];
        triangle_cross(mesh, t, face);
        for (int k = 0; k < 3; k++) length += face[k] * face[k];
        length = length > 0 ? sqrt(length) : 1;
        for (int k = 0; k < 3; k++) normal[k] = (float)(face[k] / length);
        uint64_t at = job->start[i];
        for (uint32_t y = 0; y < m; y++)
            for (uint32_t x = 0; x < 2 * (m - y) - 1; x++, at++) {
                // Upward pieces at even x, downward ones between them.
                double third = x & 1 ? 2.0 / 3 : 1.0 / 3;
                double bu = (x / 2 + third) / m, bv = (y + third) / m;
                float *p = job->s->fine[at];
                for (int k = 0; k < 3; k++) {
                    double a = mesh->position[mesh->triangle[t][0]][k];
                    double b = mesh->position[mesh->triangle[t][1]][k];
                    double c = mesh->position[mesh->triangle[t][2]][k];
                    p[k] = (float)(a + bu * (b - a) + bv * (c - a));
                }
                job->area[at] = (float)area;
                nearest(job->s, job->grid, p, normal, &job->neighbour[at]);
            }
    }
    return PRT_OK;
}

// Area, centre and standard deviation of a sample's cell.
static void integrate_cell(struct prt_surface_points *s, uint32_t i)
{
    double sum = 0, mean[3] = {0, 0, 0};
    for (uint64_t k = s->cell_begin[i]; k < s->cell_begin[i + 1]; k++) {
        double w = (double)s->cell_weight[k];
        sum += w;
        for (int d = 0; d < 3; d++) mean[d] += w * (double)s->fine[s->cell_fine[k]][d];
    }
    s->area[i] = (float)sum;
    for (int d = 0; d < 3; d++)
        s->centre[i][d] = sum > 0 ? (float)(mean[d] / sum) : s->position[i][d];
    double spread = 0;
    for (uint64_t k = s->cell_begin[i]; k < s->cell_begin[i + 1]; k++)
        for (int d = 0; d < 3; d++) {
            double off = (double)s->fine[s->cell_fine[k]][d] - (double)s->centre[i][d];
            spread += 0.5 * (double)s->cell_weight[k] * off * off;
        }
    s->spread[i] = sum > 0 ? (float)sqrt(spread / sum) : 0;
}

// Inverts "samples around a fine point" to "fine points of a sample", and integrates the cells.
static int gather_cells(struct prt_surface_points *s, const struct neighbour *neighbour,
                        const float *area)
{
    s->cell_begin = prt_calloc(s->n_sample + 2u, sizeof *s->cell_begin);
    if (!s->cell_begin) return PRT_NOMEM;
    for (uint32_t q = 0; q < s->n_fine; q++)
        for (int k = 0; k < NEIGHBOURS; k++)
            if (neighbour[q].sample[k] != UINT32_MAX)
                s->cell_begin[neighbour[q].sample[k] + 2]++;
    for (uint32_t i = 0; i < s->n_sample; i++) s->cell_begin[i + 2] += s->cell_begin[i + 1];
    uint64_t n = s->cell_begin[s->n_sample + 1];
    s->cell_fine = prt_alloc(n + 1, sizeof *s->cell_fine);
    s->cell_weight = prt_alloc(n + 1, sizeof *s->cell_weight);
    if (!s->cell_fine || !s->cell_weight) return PRT_NOMEM;
    for (uint32_t q = 0; q < s->n_fine; q++)
        for (int k = 0; k < NEIGHBOURS; k++) {
            uint32_t i = neighbour[q].sample[k];
            if (i == UINT32_MAX) continue;
            uint64_t at = s->cell_begin[i + 1]++;
            s->cell_fine[at] = q;
            s->cell_weight[at] = neighbour[q].weight[k] * area[q];
        }
    for (uint32_t i = 0; i < s->n_sample; i++) integrate_cell(s, i);
    return PRT_OK;
}

// Total of fine points at a distance.
static uint64_t count_fine(const struct prt_mesh *mesh, double fine_mm)
{
    uint64_t total = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (!prt_surface_translucent(mesh, block)) continue;
        for (uint32_t t = 0; t < block->n_triangle; t++) {
            uint64_t m = fine_cuts(mesh, block->triangle_begin + t, fine_mm);
            total += m * m;
        }
    }
    return total;
}

// The least distance from fine_mm on that keeps within fine_per_sample points a sample. Ends at
// the latest when every triangle is one point.
static double fine_distance(const struct prt_mesh *mesh, uint32_t n_sample, double fine_mm,
                            uint64_t *total)
{
    uint64_t n_triangle = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        if (prt_surface_translucent(mesh, &mesh->block[b]))
            n_triangle += mesh->block[b].n_triangle;
    for (;; fine_mm *= 1.15) {
        *total = count_fine(mesh, fine_mm);
        if (*total <= fine_per_sample * n_sample + n_triangle) return fine_mm;
    }
}

void prt_surface_memory(const struct prt_mesh *mesh, uint32_t n_sample, float fine_mm,
                        uint64_t *making, uint64_t *kept)
{
    enum { A_TRIANGLE = 64 }; // its key while it is sorted, its index, block, running area
    uint64_t n_fine, n = n_sample;
    fine_distance(mesh, n_sample, (double)fine_mm, &n_fine);
    const struct prt_surface_points *s = NULL;
    uint64_t a_sample = sizeof *s->position + sizeof *s->normal + sizeof *s->face_normal +
                        sizeof *s->area + sizeof *s->centre + sizeof *s->spread +
                        sizeof *s->object + sizeof *s->cell_begin + sizeof *s->triangle +
                        sizeof *s->inside + sizeof *s->stratum;
    uint64_t a_cell = sizeof *s->cell_fine + sizeof *s->cell_weight;
    *kept = n * a_sample + n_fine * (sizeof *s->fine + NEIGHBOURS * a_cell);
    *making = *kept + n_fine * (sizeof(struct neighbour) + sizeof(float)) +
              (uint64_t)mesh->n_triangle * A_TRIANGLE;
}

// The fine points of one object from *at on, which is advanced behind them.
static int object_fine(const struct prt_context *ctx, const struct fine_job *all,
                       uint32_t object, uint64_t *at)
{
    struct prt_surface_points *s = all->s;
    uint32_t begin = s->object_begin[object], end = s->object_begin[object + 1];
    if (begin == end) return PRT_OK;
    struct grid grid = {0};
    const struct piece_list *list = &all->list[object];
    uint64_t *start = prt_alloc(list->n, sizeof *start);
    int status = start ? grid_build(s, begin, end, 1.5f * s->spacing, &grid) : PRT_NOMEM;
    for (uint32_t i = 0; status == PRT_OK && i < list->n; i++) {
        uint64_t m = fine_cuts(all->mesh, list->triangle[i], all->fine_mm);
        start[i] = *at;
        *at += m * m;
    }
    struct fine_job job = *all;
    job.list = list, job.grid = &grid, job.start = start;
    if (status == PRT_OK)
        status = prt_parallel_for(ctx, "surface", list->n, 256, fine_range, &job);
    prt_free(start);
    prt_free(grid.begin);
    prt_free(grid.item);
    return status;
}

int prt_surface_cells(const struct prt_context *ctx, struct prt_surface_points *s,
                      const struct prt_mesh *mesh, const struct piece_list *list, float fine_mm)
{
    uint64_t total, at = 0;
    double fine = fine_distance(mesh, s->n_sample, (double)fine_mm, &total);
    if (total > UINT32_MAX / 4)
        return prt_fail(ctx, PRT_LIMIT,
                        "%llu surface points are too many: at most %u samples and triangles",
                        (unsigned long long)total, UINT32_MAX / 4);
    s->n_fine = (uint32_t)total;
    s->fine = prt_alloc(total, sizeof *s->fine);
    struct fine_job job = {.s = s, .mesh = mesh, .list = list, .fine_mm = fine};
    job.neighbour = prt_alloc(total, sizeof *job.neighbour);
    job.area = prt_alloc(total, sizeof *job.area);
    int status = s->fine && job.neighbour && job.area ? PRT_OK : PRT_NOMEM;
    for (uint32_t o = 0; status == PRT_OK && o < s->n_object; o++)
        status = object_fine(ctx, &job, o, &at);
    if (status == PRT_OK) status = gather_cells(s, job.neighbour, job.area);
    prt_free(job.neighbour);
    prt_free(job.area);
    return status;
}
