// SPDX-License-Identifier: MIT
// Triangles by the cell of a grid that holds their middle. Large triangles are in every answer:
// with them a search would have to look far beyond its radius.
#include "trace/triangle_grid.h"

#include "prt/base.h"

#include <math.h>
#include <string.h>

// Cells for each triangle, and the radius of a triangle, in cells, above which it is large;
// chosen.
static const double cells_for_each = 2, large = 2;

struct triangle_grid {
    const struct prt_mesh *mesh;
    float low[3], cell_mm;
    uint32_t size[3];
    uint32_t *begin;    // [cells + 1] range of `triangle`; those of the last are large
    uint32_t *triangle; // [n_triangle]
    float (*middle)[4]; // [n_triangle] of triangle[i]: the middle of its box, and its radius
    uint32_t n_small;
    float most_radius; // of those that are not large
};

// The middle of a triangle's box, and the greatest distance of a corner from it.
static void measure(const struct prt_mesh *mesh, uint32_t t, float out[4])
{
    float square = 0;
    for (int k = 0; k < 3; k++) {
        float a = mesh->position[mesh->triangle[t][0]][k];
        float b = mesh->position[mesh->triangle[t][1]][k];
        float c = mesh->position[mesh->triangle[t][2]][k];
        out[k] = 0.5f * (fminf(a, fminf(b, c)) + fmaxf(a, fmaxf(b, c)));
    }
    for (int j = 0; j < 3; j++) {
        const float *p = mesh->position[mesh->triangle[t][j]];
        float x = p[0] - out[0], y = p[1] - out[1], z = p[2] - out[2];
        square = fmaxf(square, x * x + y * y + z * z);
    }
    out[3] = sqrtf(square);
}

static uint32_t cell_along(const struct triangle_grid *g, int axis, float x)
{
    float cell = floorf((x - g->low[axis]) / g->cell_mm);
    return cell < 0 ? 0 : cell >= (float)g->size[axis] ? g->size[axis] - 1 : (uint32_t)cell;
}

// The cell of a triangle; behind the last: it is large.
static size_t cell_of(const struct triangle_grid *g, const float middle[4])
{
    size_t x = cell_along(g, 0, middle[0]), y = cell_along(g, 1, middle[1]);
    if (middle[3] > (float)large * g->cell_mm)
        return (size_t)g->size[0] * g->size[1] * g->size[2];
    return (cell_along(g, 2, middle[2]) * (size_t)g->size[1] + y) * g->size[0] + x;
}

static void choose_cells(struct triangle_grid *g)
{
    const struct prt_mesh *mesh = g->mesh;
    float high[3];
    double volume = 1, widest = 0;
    for (int k = 0; k < 3; k++) {
        g->low[k] = INFINITY, high[k] = -INFINITY;
        for (uint32_t v = 0; v < mesh->n_vertex; v++) {
            g->low[k] = fminf(g->low[k], mesh->position[v][k]);
            high[k] = fmaxf(high[k], mesh->position[v][k]);
        }
        widest = fmax(widest, (double)high[k] - g->low[k]);
    }
    for (int k = 0; k < 3; k++) volume *= fmax((double)high[k] - g->low[k], 1e-3 * widest);
    double cell = cbrt(volume / (cells_for_each * mesh->n_triangle));
    g->cell_mm = (float)fmax(cell, 1e-30);
    for (int k = 0; k < 3; k++)
        g->size[k] =
            (uint32_t)fmin(1 + floor(((double)high[k] - g->low[k]) / g->cell_mm), 1024);
}

struct triangle_grid *prt_triangle_grid_create(const struct prt_mesh *mesh)
{
    struct triangle_grid *g = prt_calloc(1, sizeof *g);
    if (!g) return NULL;
    g->mesh = mesh;
    choose_cells(g);
    size_t n_cell = (size_t)g->size[0] * g->size[1] * g->size[2];
    g->begin = prt_calloc(n_cell + 2, sizeof *g->begin);
    g->triangle = prt_alloc(mesh->n_triangle, sizeof *g->triangle);
    g->middle = prt_alloc(mesh->n_triangle, sizeof *g->middle);
    if (!g->begin || !g->triangle || !g->middle) {
        prt_triangle_grid_destroy(g);
        return NULL;
    }
    float middle[4];
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        measure(mesh, t, middle);
        g->begin[cell_of(g, middle) + 1]++;
    }
    for (size_t c = 0; c <= n_cell; c++) g->begin[c + 1] += g->begin[c];
    for (uint32_t t = mesh->n_triangle;
         t-- > 0;) { // from behind: begin [c + 1] becomes begin [c]
        measure(mesh, t, middle);
        size_t cell = cell_of(g, middle);
        uint32_t at = --g->begin[cell + 1];
        g->triangle[at] = t;
        memcpy(g->middle[at], middle, sizeof middle);
        if (cell < n_cell) g->most_radius = fmaxf(g->most_radius, middle[3]);
    }
    // begin [c + 1] is where cell c begins now: one place back.
    memmove(g->begin, g->begin + 1, (n_cell + 1) * sizeof *g->begin);
    g->begin[n_cell + 1] = mesh->n_triangle;
    g->n_small = g->begin[n_cell];
    return g;
}

void prt_triangle_grid_destroy(struct triangle_grid *g)
{
    if (!g) return;
    prt_free(g->begin);
    prt_free(g->triangle);
    prt_free(g->middle);
    prt_free(g);
}

struct search {
    const struct triangle_grid *grid;
    const float *at;
    float radius;
    uint32_t *out, most, n;
};

// Adds the triangles of a range of cells whose ball reaches into that of the search.
static void take(struct search *s, uint32_t begin, uint32_t end)
{
    for (uint32_t i = begin; i < end && s->n <= s->most; i++) {
        const float *m = s->grid->middle[i];
        float x = m[0] - s->at[0], y = m[1] - s->at[1], z = m[2] - s->at[2];
        float reach = s->radius + m[3];
        if (x * x + y * y + z * z > reach * reach) continue;
        if (s->n < s->most) s->out[s->n] = s->grid->triangle[i];
        s->n++;
    }
}

uint32_t prt_triangle_grid_near(const struct triangle_grid *g, const float at[3], float radius,
                                uint32_t *out, uint32_t most)
{
    struct search s = {g, at, radius, out, most, 0};
    uint32_t low[3], high[3];
    for (int k = 0; k < 3; k++) {
        low[k] = cell_along(g, k, at[k] - radius - g->most_radius);
        high[k] = cell_along(g, k, at[k] + radius + g->most_radius);
    }
    take(&s, g->n_small, g->mesh->n_triangle);
    for (uint32_t z = low[2]; z <= high[2]; z++)
        for (uint32_t y = low[1]; y <= high[1]; y++) {
            size_t row = ((size_t)z * g->size[1] + y) * g->size[0];
            take(&s, g->begin[row + low[0]], g->begin[row + high[0] + 1]);
            if (s.n > most) return most + 1;
        }
    return s.n;
}
