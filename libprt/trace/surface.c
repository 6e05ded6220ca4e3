// SPDX-License-Identifier: MIT
// Stratified area samples of the translucent surface, and the fine quadrature behind each.
#include "prt/surface.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

struct piece_list { // triangles in sampling order, with their running area
    uint32_t n;
    uint32_t *triangle;
    double *end;
};

static void cross_edges(const struct prt_mesh *mesh, uint32_t t, double out[3])
{
    const float *a = mesh->position[mesh->triangle[t][0]];
    const float *b = mesh->position[mesh->triangle[t][1]];
    const float *c = mesh->position[mesh->triangle[t][2]];
    double u[3], v[3];
    for (int k = 0; k < 3; k++) u[k] = (double)b[k] - a[k], v[k] = (double)c[k] - a[k];
    out[0] = u[1] * v[2] - u[2] * v[1];
    out[1] = u[2] * v[0] - u[0] * v[2];
    out[2] = u[0] * v[1] - u[1] * v[0];
}

static double triangle_area(const struct prt_mesh *mesh, uint32_t t)
{
    double n[3];
    cross_edges(mesh, t, n);
    return 0.5 * sqrt(n[0] * n[0] + n[1] * n[1] + n[2] * n[2]);
}

static bool translucent(const struct prt_mesh *mesh, const struct prt_block *block)
{
    return mesh->surface[block->surface].translucent != 0;
}

double prt_surface_area(const struct prt_mesh *mesh)
{
    double area = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (!translucent(mesh, block)) continue;
        for (uint32_t t = 0; t < block->n_triangle; t++)
            area += triangle_area(mesh, block->triangle_begin + t);
    }
    return area;
}

static uint64_t spread3(uint64_t x)
{
    x &= 0x1fffff;
    x = (x | x << 32) & 0x1f00000000ffffULL;
    x = (x | x << 16) & 0x1f0000ff0000ffULL;
    x = (x | x << 8) & 0x100f00f00f00f00fULL;
    x = (x | x << 4) & 0x10c30c30c30c30c3ULL;
    return (x | x << 2) & 0x1249249249249249ULL;
}

struct key {
    uint64_t code;
    uint32_t triangle;
};

static int key_order(const void *a, const void *b)
{
    const struct key *x = a, *y = b;
    if (x->code != y->code) return x->code < y->code ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

// The translucent triangles of one object along a Morton curve, so that systematic sampling of
// the running area is stratified in space.
static int order_triangles(const struct prt_mesh *mesh, uint32_t object, struct piece_list *out)
{
    size_t n = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++)
        if (mesh->block[b].object == object && translucent(mesh, &mesh->block[b]))
            n += mesh->block[b].n_triangle;
    memset(out, 0, sizeof *out);
    if (!n) return PRT_OK;
    struct key *key = prt_alloc(n, sizeof *key);
    out->triangle = prt_alloc(n, sizeof *out->triangle);
    out->end = prt_alloc(n, sizeof *out->end);
    if (!key || !out->triangle || !out->end) {
        prt_free(key);
        return PRT_NOMEM;
    }
    float box[2][3];
    prt_mesh_bounds(mesh, box);
    double edge = 1e-30;
    for (int k = 0; k < 3; k++) edge = fmax(edge, (double)box[1][k] - box[0][k]);
    size_t i = 0;
    for (uint32_t b = 0; b < mesh->n_block; b++) {
        const struct prt_block *block = &mesh->block[b];
        if (block->object != object || !translucent(mesh, block)) continue;
        for (uint32_t t = block->triangle_begin; t < block->triangle_begin + block->n_triangle;
             t++, i++) {
            uint64_t code = 0;
            for (int k = 0; k < 3; k++) {
                double c = 0;
                for (int j = 0; j < 3; j++) c += mesh->position[mesh->triangle[t][j]][k] / 3.0;
                double f = (c - box[0][k]) / edge;
                code |= spread3((uint64_t)(fmin(fmax(f, 0), 1) * 2097151.0)) << k;
            }
            key[i] = (struct key){code, t};
        }
    }
    qsort(key, n, sizeof *key, key_order);
    double sum = 0;
    for (i = 0; i < n; i++) {
        sum += triangle_area(mesh, key[i].triangle);
        out->triangle[i] = key[i].triangle;
        out->end[i] = sum;
    }
    out->n = (uint32_t)n;
    prt_free(key);
    return PRT_OK;
}

static void free_pieces(struct piece_list *list)
{
    prt_free(list->triangle);
    prt_free(list->end);
}

// A point of the unit triangle from f in [0,1): the 4-way split of the triangle walked in a
// fixed order, so that nearby f are nearby points and equal steps are equal areas.
static void walk_triangle(double f, float jitter_u, float jitter_v, unsigned levels, double *bu,
                          double *bv)
{
    double a[3][2] = {{0, 0}, {1, 0}, {0, 1}};
    for (unsigned level = 0; level < levels; level++) {
        f *= 4;
        int child = (int)f;
        if (child > 3) child = 3;
        f -= child;
        double m01[2], m12[2], m20[2];
        for (int k = 0; k < 2; k++) {
            m01[k] = (a[0][k] + a[1][k]) / 2;
            m12[k] = (a[1][k] + a[2][k]) / 2;
            m20[k] = (a[2][k] + a[0][k]) / 2;
        }
        for (int k = 0; k < 2; k++) {
            double c[4][3] = {{a[0][k], m01[k], m20[k]},
                              {m01[k], m12[k], m20[k]},
                              {m01[k], a[1][k], m12[k]},
                              {m20[k], m12[k], a[2][k]}};
            for (int j = 0; j < 3; j++) a[j][k] = c[child][j];
        }
    }
    double u = jitter_u, v = jitter_v;
    if (u + v > 1) u = 1 - u, v = 1 - v;
    *bu = a[0][0] + u * (a[1][0] - a[0][0]) + v * (a[2][0] - a[0][0]);
    *bv = a[0][1] + u * (a[1][1] - a[0][1]) + v * (a[2][1] - a[0][1]);
}

static void place_sample(struct prt_surface_points *s, const struct prt_mesh *mesh, uint32_t i,
                         uint32_t t, double bu, double bv)
{
    const uint32_t *v = mesh->triangle[t];
    double w[3] = {1 - bu - bv, bu, bv}, n[3] = {0, 0, 0}, length = 0, face[3], fl = 0;
    cross_edges(mesh, t, face);
    for (int k = 0; k < 3; k++) {
        double p = 0;
        for (int j = 0; j < 3; j++) {
            p += w[j] * mesh->position[v[j]][k];
            n[k] += w[j] * mesh->normal[v[j]][k];
        }
        s->position[i][k] = (float)p;
        length += n[k] * n[k];
        fl += face[k] * face[k];
    }
    length = sqrt(length), fl = sqrt(fl);
    for (int k = 0; k < 3; k++) {
        s->face_normal[i][k] = (float)(fl > 0 ? face[k] / fl : 0);
        s->normal[i][k] = (float)(length > 1e-12 ? n[k] / length : s->face_normal[i][k]);
    }
}

static void sample_object(struct prt_surface_points *s, const struct prt_mesh *mesh,
                          const struct piece_list *list, uint32_t object, uint32_t n,
                          uint64_t seed)
{
    double total = list->end[list->n - 1], step = total / n, before = 0;
    uint32_t at = 0, first = s->object_begin[object];
    struct prt_rng rng;
    prt_rng_init(&rng, seed, object);
    for (uint32_t i = 0; i < n; i++) {
        double a = (i + 0.5) * step;
        while (at + 1 < list->n && list->end[at] <= a) before = list->end[at++];
        double own = list->end[at] - before;
        unsigned levels = 0;
        for (double piece = own; piece > step && levels < 14; piece /= 4) levels++;
        float ju = prt_rng_f32(&rng), jv = prt_rng_f32(&rng);
        double bu, bv, f = own > 0 ? (a - before) / own : 0;
        walk_triangle(fmin(fmax(f, 0), 1), ju, jv, levels, &bu, &bv);
        place_sample(s, mesh, first + i, list->triangle[at], bu, bv);
        s->object[first + i] = object;
    }
}

// Uniform grid over an object's samples for nearest-neighbour search.
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
    for (;;) { // a thin, huge object would ask for too many cells
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

// The nearest samples on the same sheet of the surface (normals agree), inverse-square weights.
static void nearest(const struct prt_surface_points *s, const struct grid *g, const float p[3],
                    const float normal[3], struct neighbour *out)
{
    float best[NEIGHBOURS];
    int c[3], n = 0;
    grid_cell(g, p, c);
    for (int pass = 0; pass < 2 && n == 0; pass++) { // second pass: any sheet
        for (int ring = 1; n < NEIGHBOURS && ring < 5; ring++) {
            n = 0;
            for (int z = c[2] - ring; z <= c[2] + ring; z++)
                for (int y = c[1] - ring; y <= c[1] + ring; y++)
                    for (int x = c[0] - ring; x <= c[0] + ring; x++) {
                        if (x < 0 || y < 0 || z < 0 || x >= g->dim[0] || y >= g->dim[1] ||
                            z >= g->dim[2])
                            continue;
                        size_t cell =
                            ((size_t)z * (size_t)g->dim[1] + (size_t)y) * (size_t)g->dim[0] +
                            (size_t)x;
                        for (uint32_t k = g->begin[cell]; k < g->begin[cell + 1]; k++) {
                            uint32_t i = g->item[k];
                            const float *q = s->position[i], *m = s->face_normal[i];
                            if (!pass &&
                                m[0] * normal[0] + m[1] * normal[1] + m[2] * normal[2] < 0.2f)
                                continue;
                            float d[3] = {q[0] - p[0], q[1] - p[1], q[2] - p[2]};
                            float d2 = d[0] * d[0] + d[1] * d[1] + d[2] * d[2];
                            int at = n < NEIGHBOURS ? n : NEIGHBOURS;
                            while (at > 0 && d2 < best[at - 1]) {
                                if (at < NEIGHBOURS) {
                                    best[at] = best[at - 1];
                                    out->sample[at] = out->sample[at - 1];
                                }
                                at--;
                            }
                            if (at < NEIGHBOURS) {
                                best[at] = d2;
                                out->sample[at] = i;
                                if (n < NEIGHBOURS) n++;
                            }
                        }
                    }
        }
    }
    float sum = 0, soft = 0.05f * s->spacing * s->spacing;
    for (int k = 0; k < NEIGHBOURS; k++) {
        out->weight[k] = k < n ? 1 / (best[k] + soft) : 0;
        if (k >= n) out->sample[k] = UINT32_MAX;
        sum += out->weight[k];
    }
    for (int k = 0; k < n; k++) out->weight[k] /= sum;
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
        cross_edges(mesh, t, face);
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

// Turns fine point -> samples around into sample -> fine points, and sums cell areas.
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
    for (uint32_t i = 0; i < s->n_sample; i++) {
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
    return PRT_OK;
}

static int alloc_samples(struct prt_surface_points *s, uint32_t n)
{
    s->position = prt_alloc(n, sizeof *s->position);
    s->normal = prt_alloc(n, sizeof *s->normal);
    s->face_normal = prt_alloc(n, sizeof *s->face_normal);
    s->area = prt_calloc(n, sizeof *s->area);
    s->centre = prt_calloc(n, sizeof *s->centre);
    s->spread = prt_calloc(n, sizeof *s->spread);
    s->object = prt_alloc(n, sizeof *s->object);
    bool all = s->position && s->normal && s->face_normal && s->area && s->centre &&
               s->spread && s->object;
    return all ? PRT_OK : PRT_NOMEM;
}

// Shares n_sample between objects by area, at least 16 each that has any.
static int share_samples(struct prt_surface_points *s, const struct piece_list *list,
                         uint32_t n_sample)
{
    double total = 0;
    uint64_t n = 0;
    for (uint32_t o = 0; o < s->n_object; o++)
        if (list[o].n) total += list[o].end[list[o].n - 1];
    for (uint32_t o = 0; o < s->n_object; o++) {
        s->object_begin[o] = (uint32_t)n;
        double area = list[o].n ? list[o].end[list[o].n - 1] : 0;
        if (area <= 0) continue;
        uint64_t own = (uint64_t)(n_sample * (area / total) + 0.5);
        if (own < 16) own = 16;
        s->spacing = fmaxf(s->spacing, (float)sqrt(area / (double)own));
        n += own;
    }
    s->object_begin[s->n_object] = (uint32_t)n;
    s->n_sample = (uint32_t)n;
    return n ? PRT_OK : PRT_ARG;
}

// Fine points of all translucent triangles: as fine as asked for, or as the bound of 16 a
// sample allows.
static uint64_t count_fine(const struct prt_mesh *mesh, uint32_t n_sample, double *fine_mm)
{
    for (;; *fine_mm *= 1.15) { // ends: at the latest when every triangle is one point
        uint64_t total = 0, n_triangle = 0;
        for (uint32_t b = 0; b < mesh->n_block; b++) {
            const struct prt_block *block = &mesh->block[b];
            if (!translucent(mesh, block)) continue;
            n_triangle += block->n_triangle;
            for (uint32_t t = 0; t < block->n_triangle; t++) {
                uint64_t m = fine_cuts(mesh, block->triangle_begin + t, *fine_mm);
                total += m * m;
            }
        }
        if (total <= 16ull * n_sample + n_triangle) return total;
    }
}

static int build_fine(const struct prt_context *ctx, struct prt_surface_points *s,
                      const struct prt_mesh *mesh, const struct piece_list *list, float fine_mm)
{
    uint64_t **start = calloc(s->n_object, sizeof *start), total = 0;
    struct neighbour *neighbour = NULL;
    float *area = NULL;
    int status = start ? PRT_OK : PRT_NOMEM;
    double fine = fine_mm;
    if (status == PRT_OK) total = count_fine(mesh, s->n_sample, &fine);
    if (status == PRT_OK && total > UINT32_MAX / 4)
        status = prt_fail(ctx, PRT_LIMIT,
                          "%llu surface points are too many: at most %u samples and triangles",
                          (unsigned long long)total, UINT32_MAX / 4);
    if (status == PRT_OK) {
        s->n_fine = (uint32_t)total;
        s->fine = prt_alloc(total, sizeof *s->fine);
        neighbour = prt_alloc(total, sizeof *neighbour);
        area = prt_alloc(total, sizeof *area);
        if (!s->fine || !neighbour || !area) status = PRT_NOMEM;
    }
    uint64_t at = 0;
    for (uint32_t o = 0; status == PRT_OK && o < s->n_object; o++) {
        uint32_t begin = s->object_begin[o], end = s->object_begin[o + 1];
        if (begin == end) continue;
        struct grid grid = {0};
        start[o] = prt_alloc(list[o].n, sizeof **start);
        status = start[o] ? grid_build(s, begin, end, 1.5f * s->spacing, &grid) : PRT_NOMEM;
        for (uint32_t i = 0; status == PRT_OK && i < list[o].n; i++) {
            uint64_t m = fine_cuts(mesh, list[o].triangle[i], fine);
            start[o][i] = at;
            at += m * m;
        }
        struct fine_job job = {s, mesh, &list[o], &grid, start[o], fine, neighbour, area};
        if (status == PRT_OK)
            status = prt_parallel_for(ctx, "surface", list[o].n, 256, fine_range, &job);
        prt_free(grid.begin);
        prt_free(grid.item);
    }
    if (status == PRT_OK) status = gather_cells(s, neighbour, area);
    for (uint32_t o = 0; start && o < s->n_object; o++) prt_free(start[o]);
    free(start);
    prt_free(neighbour);
    prt_free(area);
    return status;
}

void prt_surface_memory(const struct prt_mesh *mesh, uint32_t n_sample, float fine_mm,
                        uint64_t *making, uint64_t *kept)
{
    double fine = fine_mm;
    uint64_t n_fine = count_fine(mesh, n_sample, &fine), n = n_sample;
    const struct prt_surface_points *s = NULL;
    uint64_t a_sample = sizeof *s->position + sizeof *s->normal + sizeof *s->face_normal +
                        sizeof *s->area + sizeof *s->centre + sizeof *s->spread +
                        sizeof *s->object + sizeof *s->cell_begin;
    uint64_t a_cell = sizeof *s->cell_fine + sizeof *s->cell_weight;
    *kept = n * a_sample + n_fine * (sizeof *s->fine + NEIGHBOURS * a_cell);
    *making = *kept + n_fine * (sizeof(struct neighbour) + sizeof(float)) +
              (uint64_t)mesh->n_triangle * (sizeof(struct key) + 24);
}

int prt_surface_create(const struct prt_context *ctx, const struct prt_mesh *mesh,
                       uint32_t n_sample, float fine_mm, uint64_t seed,
                       struct prt_surface_points **out)
{
    struct prt_surface_points *s = calloc(1, sizeof *s);
    struct piece_list *list = calloc(mesh->n_object + 1u, sizeof *list);
    int status = s && list ? PRT_OK : PRT_NOMEM;
    if (s) {
        s->n_object = mesh->n_object;
        s->object_begin = prt_calloc(mesh->n_object + 1u, sizeof *s->object_begin);
        if (!s->object_begin) status = PRT_NOMEM;
    }
    for (uint32_t o = 0; status == PRT_OK && o < mesh->n_object; o++)
        status = order_triangles(mesh, o, &list[o]);
    if (status == PRT_OK && share_samples(s, list, n_sample))
        status = prt_fail(ctx, PRT_ARG, "nothing to sample: no translucent triangle has area");
    if (status == PRT_OK) status = alloc_samples(s, s->n_sample);
    for (uint32_t o = 0; status == PRT_OK && o < mesh->n_object; o++)
        if (s->object_begin[o] < s->object_begin[o + 1])
            sample_object(s, mesh, &list[o], o, s->object_begin[o + 1] - s->object_begin[o],
                          seed);
    if (status == PRT_OK) status = build_fine(ctx, s, mesh, list, fine_mm);
    for (uint32_t o = 0; list && o < mesh->n_object; o++) free_pieces(&list[o]);
    free(list);
    if (status == PRT_OK) *out = s;
    else prt_surface_destroy(s);
    if (status == PRT_NOMEM)
        prt_fail(ctx, status, "no memory for %u surface samples", n_sample);
    return status;
}

int prt_surface_check(const struct prt_context *ctx, const struct prt_surface_points *s,
                      const struct prt_mesh *mesh, double mean_free_path_mm, bool chosen)
{
    static const double most = 256, many = 16;
    double paths = s->spacing / mean_free_path_mm, over = paths / most;
    double size = prt_mesh_diagonal(mesh);
    if (over > 1)
        return prt_fail(
            ctx, PRT_ARG,
            "a mean free path of %.3g mm on a model of %.5g mm, with samples %.3g mm "
            "apart: at most %.0f mean free paths are allowed; scale it to %.3g mm or "
            "less (--size-mm) or give --samples %.0f",
            mean_free_path_mm, size, s->spacing, most, size / over,
            ceil(s->n_sample * over * over));
    if (paths > many && chosen)
        prt_log(ctx, PRT_LOG_WARNING,
                "samples are %.3g mm apart, the mean free path is %.3g mm: expect errors of "
                "percents; --samples %.0f would leave none of it",
                s->spacing, mean_free_path_mm, ceil(s->n_sample * paths * paths));
    return PRT_OK;
}

void prt_surface_destroy(struct prt_surface_points *s)
{
    if (!s) return;
    prt_free(s->position);
    prt_free(s->normal);
    prt_free(s->face_normal);
    prt_free(s->area);
    prt_free(s->centre);
    prt_free(s->spread);
    prt_free(s->object);
    prt_free(s->object_begin);
    prt_free(s->fine);
    prt_free(s->cell_begin);
    prt_free(s->cell_fine);
    prt_free(s->cell_weight);
    free(s);
}

void prt_surface_kernel(const struct prt_surface_points *s, const struct prt_diffusion d[3],
                        unsigned cpu, const float x[3], uint32_t i, float near_mm, float out[3])
{
    enum { CHUNK = 64 };
    float r2[CHUNK], weight[CHUNK], rd[CHUNK];
    const float *p = s->centre[i];
    float dx = p[0] - x[0], dy = p[1] - x[1], dz = p[2] - x[2];
    float d2 = dx * dx + dy * dy + dz * dz;
    if (d2 > near_mm * near_mm) {
        prt_surface_afar(d2, s->spread[i], &r2[0], &r2[1]);
        for (int c = 0; c < 3; c++) {
            prt_diffusion_rd_array(&d[c], cpu, 2, r2, rd);
            out[c] = 0.5f * (rd[0] + rd[1]) * s->area[i];
        }
        return;
    }
    out[0] = out[1] = out[2] = 0;
    for (uint64_t begin = s->cell_begin[i], end = s->cell_begin[i + 1]; begin < end;
         begin += CHUNK) {
        size_t n = end - begin < CHUNK ? (size_t)(end - begin) : CHUNK;
        for (size_t k = 0; k < n; k++) {
            const float *q = s->fine[s->cell_fine[begin + k]];
            float a = q[0] - x[0], b = q[1] - x[1], c = q[2] - x[2];
            r2[k] = a * a + b * b + c * c;
            weight[k] = s->cell_weight[begin + k];
        }
        for (int c = 0; c < 3; c++) {
            prt_diffusion_rd_array(&d[c], cpu, n, r2, rd);
            float sum = 0;
            for (size_t k = 0; k < n; k++) sum += rd[k] * weight[k];
            out[c] += sum;
        }
    }
}
