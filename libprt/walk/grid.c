// SPDX-License-Identifier: MIT
// Lower bounds on the distance to the surface, one a cell of a grid: a flight that is shorter
// than the bound at its start needs no ray.
#include "walk/walk_private.h"

#include <math.h>
#include <string.h>

enum { CELLS = 96, QUANTA = 4 }; // along the longest edge; quanta of a bound in one cell

static uint32_t clamp_cell(float x, uint32_t n)
{
    if (!(x > 0)) return 0;
    return x >= (float)n ? n - 1 : (uint32_t)x;
}

// Marks every cell that the triangle's box touches, after splitting the triangle until its box
// covers few cells.
static void mark(struct prt_walk_space *s, const float p[3][3], unsigned depth)
{
    uint32_t lo[3], hi[3], widest = 0;
    for (int k = 0; k < 3; k++) {
        float a = fminf(p[0][k], fminf(p[1][k], p[2][k])),
              b = fmaxf(p[0][k], fmaxf(p[1][k], p[2][k]));
        // Rounding of a point's cell is less than this part of a cell.
        lo[k] = clamp_cell((a - s->low[k]) / s->cell_mm - 1e-3f, s->n[k]);
        hi[k] = clamp_cell((b - s->low[k]) / s->cell_mm + 1e-3f, s->n[k]);
        if (hi[k] - lo[k] > widest) widest = hi[k] - lo[k];
    }
    if (widest > 1 && depth < 24) {
        int longest = 0;
        float most = -1;
        for (int e = 0; e < 3; e++) {
            float length = 0;
            for (int k = 0; k < 3; k++) {
                float d = p[e][k] - p[(e + 1) % 3][k];
                length += d * d;
            }
            if (length > most) most = length, longest = e;
        }
        float middle[3], half[3][3];
        int a = longest, b = (longest + 1) % 3;
        for (int k = 0; k < 3; k++) middle[k] = 0.5f * (p[a][k] + p[b][k]);
        memcpy(half, p, sizeof half);
        memcpy(half[a], middle, sizeof middle);
        mark(s, half, depth + 1);
        memcpy(half, p, sizeof half);
        memcpy(half[b], middle, sizeof middle);
        mark(s, half, depth + 1);
        return;
    }
    for (uint32_t z = lo[2]; z <= hi[2]; z++)
        for (uint32_t y = lo[1]; y <= hi[1]; y++)
            for (uint32_t x = lo[0]; x <= hi[0]; x++)
                s->bound[((size_t)z * s->n[1] + y) * s->n[0] + x] = 0;
}

// Squared distance in cells between two cells' boxes along one axis.
static uint32_t gap2(uint32_t i)
{
    return i > 1 ? (i - 1) * (i - 1) : 0;
}

// d[i] = min over j of d[j] + gap2(|i-j|) along one line of n cells `step` apart.
static void line(uint32_t *d, size_t step, uint32_t n)
{
    uint32_t in[CELLS + 2], out[CELLS + 2];
    for (uint32_t i = 0; i < n; i++) in[i] = d[i * step];
    memcpy(out, in, n * sizeof *out);
    for (uint32_t shift = 1; shift < n; shift++) {
        uint32_t g = gap2(shift);
        for (uint32_t i = 0; i + shift < n; i++) {
            uint32_t a = in[i + shift] + g, b = in[i] + g;
            out[i] = a < out[i] ? a : out[i];
            out[i + shift] = b < out[i + shift] ? b : out[i + shift];
        }
    }
    for (uint32_t i = 0; i < n; i++) d[i * step] = out[i];
}

// The squared distance between boxes of cells is a sum over axes, so that three passes of
// minima over lines give it exactly.
static int spread(struct prt_walk_space *s)
{
    size_t nx = s->n[0], ny = s->n[1], nz = s->n[2], n = nx * ny * nz;
    uint32_t *d = prt_alloc(n, sizeof *d);
    if (!d) return PRT_NOMEM;
    for (size_t i = 0; i < n; i++) d[i] = s->bound[i] ? 1u << 20 : 0;
    for (size_t row = 0; row < ny * nz; row++) line(d + row * nx, 1, s->n[0]);
    for (size_t z = 0; z < nz; z++)
        for (size_t x = 0; x < nx; x++) line(d + z * nx * ny + x, nx, s->n[1]);
    for (size_t i = 0; i < nx * ny; i++) line(d + i, nx * ny, s->n[2]);
    for (size_t i = 0; i < n; i++)
        s->bound[i] = (uint8_t)fmin(255, floor(QUANTA * sqrt((double)d[i]) * (1 - 1e-6)));
    prt_free(d);
    return PRT_OK;
}

int prt_walk_grid(struct prt_walk_space *s, const struct prt_mesh *mesh)
{
    float longest = 0;
    for (int k = 0; k < 3; k++) longest = fmaxf(longest, s->high[k] - s->low[k]);
    s->cell_mm = longest > 0 ? longest / CELLS : 1;
    s->quantum_mm = s->cell_mm / QUANTA;
    size_t n = 1;
    for (int k = 0; k < 3; k++) {
        s->n[k] = (uint32_t)((s->high[k] - s->low[k]) / s->cell_mm) + 1;
        n *= s->n[k];
    }
    s->bound = prt_alloc(n, 1);
    if (!s->bound) return PRT_NOMEM;
    memset(s->bound, 1, n);
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        float p[3][3];
        for (int j = 0; j < 3; j++)
            memcpy(p[j], mesh->position[mesh->triangle[t][j]], sizeof p[j]);
        mark(s, p, 0);
    }
    return spread(s);
}
