// SPDX-License-Identifier: MIT
// Triangles near a vertex, drawn on cubes around the nodes of its path.
#include "bake/cube_draw.h"

#include "base/isa.h"

#include <math.h>
#include <string.h>

// A cube's face: direction (s, t, 1) is sign_s s along axis s, and so on (prt_cube_direction).
struct face_axes {
    unsigned s, t, m;
    float sign_s, sign_t, sign_m;
};
static const struct face_axes face_axes[6] = {{2, 1, 0, -1, -1, 1}, {2, 1, 0, 1, -1, -1},
                                              {0, 2, 1, 1, 1, 1},   {0, 2, 1, 1, -1, -1},
                                              {0, 1, 2, 1, -1, 1},  {0, 1, 2, -1, -1, -1}};

// Texels that a triangle may cover on one face, both ends among them.
struct draw_window {
    uint16_t triangle, face, low_x, high_x, low_y, high_y;
};
struct window_lanes {
    int low_x[16], high_x[16], low_y[16], high_y[16]; // high_x < 0: none
};
struct draw_loops {
    void (*project)(const struct nearby *near, uint32_t first, const float from[3], uint32_t n,
                    float *const plane[3][3], struct window_lanes out[6]);
    void (*draw)(const struct draw_window *window, uint32_t n_window, float *const plane[3][3],
                 const float *slope, uint32_t n, float *nearness, uint32_t *at);
    uint32_t (*look)(const struct drawing *drawing, const uint32_t texel[16],
                     const float length[16], float most, float t[16], uint32_t at[16]);
    void (*hits)(const struct nearby *near, const float from[3], const uint32_t at[16],
                 const float t[16], struct prt_packet *packet, struct corners *normals);
};

enum { WINDOWS = 6 * 16 }; // windows that are drawn at a time

PRT_INLINE float least3(float a, float b, float c)
{
    float d = a < b ? a : b;
    return d < c ? d : c;
}

PRT_INLINE float most3(float a, float b, float c)
{
    float d = a > b ? a : b;
    return d > c ? d : c;
}

PRT_INLINE float within(float x, float last)
{
    x = x > 0 ? x : 0;
    return x < last ? x : last;
}

#define PRT_KERNEL_FILE "bake/cube_draw_kernel.h"
#include "base/isa_each.h"

static const struct draw_loops *loops_of(unsigned cpu)
{
#if PRT_ISA_X86
    if (cpu & PRT_CPU_AVX512) return &draw_loops_avx512;
    if (cpu & PRT_CPU_AVX2) return &draw_loops_avx2;
#endif
    return &draw_loops_c;
}

size_t prt_draw_bytes(uint32_t n_coef, uint32_t n_drawing)
{
    const size_t near = 19 * DRAW_MOST, plane = 9 * DRAW_MOST;
    return (near + plane + 2 * (size_t)n_coef * n_drawing) * 4;
}

void prt_draw_carve(void *room, uint32_t n_coef, uint32_t n_drawing, struct draw_room *out)
{
    float *at = room;
    memset(out, 0, sizeof *out);
    for (int i = 0; i < 9; i++) {
        out->near.corner[i / 3][i % 3] = at, at += DRAW_MOST;
        out->near.normal[i / 3][i % 3] = at, at += DRAW_MOST;
        out->plane[i / 3][i % 3] = at, at += DRAW_MOST;
    }
    out->near.triangle = (uint32_t *)at, at += DRAW_MOST;
    for (uint32_t i = 0; i < n_drawing; i++) {
        out->drawing[i].nearness = at, at += n_coef;
        out->drawing[i].at = (uint32_t *)at, at += n_coef;
    }
}

// The largest reach, in steps of an eighth or less, within which there are few enough
// triangles.
static uint32_t find(const struct triangle_grid *grid, struct nearby *near)
{
    const float want = near->reach;
    float fits = want, fails = 0;
    uint32_t n = DRAW_MOST + 1;
    for (int round = 0; round < 32 && n > DRAW_MOST; round++) {
        if (round) fails = fits, fits *= 0.6f;
        n = prt_triangle_grid_near(grid, near->centre, fits, near->triangle, DRAW_MOST);
    }
    for (int round = 0; round < 2 && fails > 0; round++) {
        const float between = sqrtf(fits * fails);
        n = prt_triangle_grid_near(grid, near->centre, between, near->triangle, DRAW_MOST);
        if (n > DRAW_MOST) fails = between;
        else fits = between;
    }
    near->reach = fits;
    if (fails == 0) return n;
    n = prt_triangle_grid_near(grid, near->centre, fits, near->triangle, DRAW_MOST);
    if (n <= DRAW_MOST) return n;
    near->reach = 0; // large triangles everywhere
    return 0;
}

void prt_draw_gather(const struct triangle_grid *grid, const struct prt_mesh *mesh,
                     const float centre[3], float want, struct nearby *near)
{
    memcpy(near->centre, centre, sizeof near->centre);
    near->reach = want;
    uint32_t n = find(grid, near);
    near->n = (n + 15) / 16 * 16;
    for (uint32_t i = n; i < near->n; i++) near->triangle[i] = near->triangle[n - 1];
    for (uint32_t i = 0; i < near->n; i++) {
        const uint32_t *corner = mesh->triangle[near->triangle[i]];
        for (int c = 0; c < 3; c++)
            for (int k = 0; k < 3; k++)
                near->corner[c][k][i] = mesh->position[corner[c]][k] - centre[k],
                near->normal[c][k][i] = mesh->normal[corner[c]][k];
    }
}

// The windows of 16 triangles, in order of face and lane.
static uint32_t windows_of(const struct window_lanes lanes[6], uint32_t first,
                           struct draw_window *out)
{
    uint32_t n = 0;
    for (uint16_t f = 0; f < 6; f++)
        for (uint32_t i = 0; i < 16; i++) {
            if (lanes[f].high_x[i] < 0) continue;
            out[n++] =
                (struct draw_window){(uint16_t)(first + i),       f,
                                     (uint16_t)lanes[f].low_x[i], (uint16_t)lanes[f].high_x[i],
                                     (uint16_t)lanes[f].low_y[i], (uint16_t)lanes[f].high_y[i]};
        }
    return n;
}

void prt_draw(const struct directions *d, unsigned pattern, const float p[3], uint32_t i,
              struct draw_room *room)
{
    const struct nearby *near = &room->near;
    const struct draw_loops *loops = loops_of(d->cpu);
    struct drawing *out = &room->drawing[i];
    float square = 0;
    for (int k = 0; k < 3; k++) {
        out->from[k] = p[k] - near->centre[k];
        square += out->from[k] * out->from[k];
    }
    out->certain_mm = fmaxf(near->reach - sqrtf(square), 0);
    memset(out->nearness, 0, d->n_coef * sizeof *out->nearness);
    if (out->certain_mm == 0) return;
    struct window_lanes lanes[6];
    struct draw_window window[WINDOWS];
    for (uint32_t first = 0; first < near->n; first += 16) {
        loops->project(near, first, out->from, d->n, room->plane, lanes);
        uint32_t n = windows_of(lanes, first, window);
        loops->draw(window, n, room->plane, prt_direction_slopes(d, pattern), d->n,
                    out->nearness, out->at);
    }
}

uint32_t prt_draw_look(unsigned cpu, const struct drawing *drawing, const uint32_t texel[16],
                       const float length[16], float most, float t[16], uint32_t at[16])
{
    return loops_of(cpu)->look(drawing, texel, length, most, t, at);
}

void prt_draw_hits(unsigned cpu, const struct nearby *near, const struct drawing *drawing,
                   const uint32_t at[16], const float t[16], struct prt_packet *packet,
                   struct corners *normals)
{
    loops_of(cpu)->hits(near, drawing->from, at, t, packet, normals);
}
