// SPDX-License-Identifier: MIT
// Conservative visibility per vertex and direction bin: visible, blocked, or unknown (needs a
// ray). A bin is certain only when all eight neighbours agree with it. Most light leaves a body
// where nothing else is near, and needs no shadow ray there, nor deep in a fold.
#include "bake/stages.h"

#include "prt/light.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { WIDE = HORIZON_WIDE, BINS = 6 * WIDE * WIDE, WORDS = HORIZON_WORDS };
enum { EMPTY, TRACED };

struct horizon {
    const struct prt_scene *scene;
    // [n_vertex] filled on first use: bins that are visible with all their neighbours, and bins
    // that are blocked with them.
    _Atomic uint64_t (*visible)[WORDS], (*blocked)[WORDS];
    _Atomic uint8_t *state; // [n_vertex]
    float direction[BINS][3];
    uint16_t around[BINS][8]; // the bins that touch one
};

// Triangles longer than this share of the box may hide something between their corners. Chosen,
// not measured.
static const double widest = 0.02;

static void init_bins(struct horizon *h)
{
    for (unsigned b = 0; b < BINS; b++) {
        unsigned face = b / (WIDE * WIDE), x = b % WIDE, y = b / WIDE % WIDE, k = 0;
        for (int dy = -1; dy <= 1; dy++)
            for (int dx = -1; dx <= 1; dx++) {
                float dir[3], s, t;
                unsigned to;
                prt_cube_direction(face, 2 * ((int)x + dx + 0.5) / WIDE - 1,
                                   2 * ((int)y + dy + 0.5) / WIDE - 1, dir);
                if (!dx && !dy) {
                    memcpy(h->direction[b], dir, sizeof dir);
                    continue;
                }
                prt_cube_lookup(dir, &to, &s, &t);
                int u = (int)((s + 1) * 0.5f * WIDE), v = (int)((t + 1) * 0.5f * WIDE);
                u = u < 0 ? 0 : u >= WIDE ? WIDE - 1 : u;
                v = v < 0 ? 0 : v >= WIDE ? WIDE - 1 : v;
                h->around[b][k++] = (uint16_t)((to * WIDE + (unsigned)v) * WIDE + (unsigned)u);
            }
    }
}

// Vertices of wide triangles keep all bins unknown.
static void skip_wide(struct horizon *h, const struct prt_mesh *mesh)
{
    const double limit = pow(widest * prt_mesh_diagonal(mesh), 2);
    for (uint32_t t = 0; t < mesh->n_triangle; t++)
        for (int j = 0; j < 3; j++) {
            uint32_t a = mesh->triangle[t][j], b = mesh->triangle[t][(j + 1) % 3];
            double d = 0;
            for (int k = 0; k < 3; k++)
                d += pow((double)mesh->position[a][k] - mesh->position[b][k], 2);
            if (d <= limit) continue;
            for (int k = 0; k < 3; k++)
                atomic_store_explicit(&h->state[mesh->triangle[t][k]], TRACED,
                                      memory_order_relaxed);
        }
}

int prt_horizon_create(const struct prt_scene *scene, struct horizon **out)
{
    const struct prt_mesh *mesh = prt_scene_mesh(scene);
    struct horizon *h = calloc(1, sizeof *h);
    if (!h) return PRT_NOMEM;
    h->scene = scene;
    h->visible = prt_calloc(mesh->n_vertex, sizeof *h->visible);
    h->blocked = prt_calloc(mesh->n_vertex, sizeof *h->blocked);
    h->state = prt_calloc(mesh->n_vertex, sizeof *h->state);
    if (!h->visible || !h->blocked || !h->state) {
        prt_horizon_destroy(h);
        return PRT_NOMEM;
    }
    init_bins(h);
    skip_wide(h, mesh);
    *out = h;
    return PRT_OK;
}

void prt_horizon_destroy(struct horizon *h)
{
    if (!h) return;
    prt_free(h->visible);
    prt_free(h->blocked);
    prt_free(h->state);
    free(h);
}

static inline bool has(const uint64_t set[WORDS], unsigned bin)
{
    return set[bin / 64] >> bin % 64 & 1;
}

// A bin below the tangent plane carries no light and agrees with blocked neighbours. A gap
// below the centres of the lowest bins, less than 4 degrees above the plane, is therefore
// missed; its light arrives at a cosine below 0.07. Two threads may trace one vertex at the
// same time: both write the same bits.
static void trace_vertex(struct horizon *h, uint32_t vertex)
{
    const struct prt_mesh *mesh = prt_scene_mesh(h->scene);
    const float *p = mesh->position[vertex], *n = mesh->normal[vertex];
    float eps = prt_scene_epsilon(h->scene);
    uint64_t open[WORDS] = {0}, hit[WORDS] = {0}; // by the ray through the bin's centre
    uint64_t visible[WORDS] = {0}, blocked[WORDS] = {0};
    uint16_t bin[16];
    struct prt_packet packet;
    uint32_t fill = 0;
    for (int i = 0; i < 16; i++) {
        packet.ox[i] = p[0] + eps * n[0], packet.oy[i] = p[1] + eps * n[1];
        packet.oz[i] = p[2] + eps * n[2];
        packet.tnear[i] = 0, packet.tfar[i] = INFINITY;
        packet.dx[i] = 1, packet.dy[i] = packet.dz[i] = 0;
    }
    for (unsigned b = 0; b <= BINS; b++) {
        if (b < BINS) {
            // Squares of 4 x 4 bins, so that the rays of a packet have similar directions.
            unsigned i = b % 16, tile = b / 16 % (WIDE * WIDE / 16);
            unsigned x = tile % (WIDE / 4) * 4 + (i & 3), y = tile / (WIDE / 4) * 4 + (i >> 2);
            unsigned at = (b / (WIDE * WIDE) * WIDE + y) * WIDE + x;
            const float *d = h->direction[at];
            if (n[0] * d[0] + n[1] * d[1] + n[2] * d[2] <= 0) continue;
            packet.dx[fill] = d[0], packet.dy[fill] = d[1], packet.dz[fill] = d[2];
            bin[fill++] = (uint16_t)at;
        }
        if (!fill || (fill < 16 && b < BINS)) continue;
        uint32_t mask = fill == 16 ? 0xffff : (1u << fill) - 1;
        uint32_t lanes = prt_scene_occluded16(h->scene, &packet, mask);
        for (uint32_t i = 0; i < fill; i++) {
            uint64_t bit = 1ull << bin[i] % 64;
            if (lanes >> i & 1) hit[bin[i] / 64] |= bit;
            else open[bin[i] / 64] |= bit;
        }
        fill = 0;
    }
    for (unsigned b = 0; b < BINS; b++) {
        bool all_open = has(open, b), none_open = has(hit, b);
        for (int k = 0; k < 8; k++) {
            all_open &= has(open, h->around[b][k]);
            none_open &= !has(open, h->around[b][k]);
        }
        visible[b / 64] |= (uint64_t)all_open << b % 64;
        blocked[b / 64] |= (uint64_t)none_open << b % 64;
    }
    for (int k = 0; k < WORDS; k++) {
        atomic_store_explicit(&h->visible[vertex][k], visible[k], memory_order_relaxed);
        atomic_store_explicit(&h->blocked[vertex][k], blocked[k], memory_order_relaxed);
    }
    atomic_store_explicit(&h->state[vertex], TRACED, memory_order_release);
}

int prt_horizon_bin(struct horizon *h, uint32_t triangle, uint32_t bin)
{
    const uint32_t *v = prt_scene_mesh(h->scene)->triangle[triangle];
    uint64_t visible = 1, blocked = 1;
    for (int k = 0; k < 3; k++) {
        if (atomic_load_explicit(&h->state[v[k]], memory_order_acquire) == EMPTY)
            trace_vertex(h, v[k]);
        visible &=
            atomic_load_explicit(&h->visible[v[k]][bin / 64], memory_order_relaxed) >> bin % 64;
        blocked &=
            atomic_load_explicit(&h->blocked[v[k]][bin / 64], memory_order_relaxed) >> bin % 64;
    }
    return (int)visible - (int)blocked;
}

void prt_horizon_view(struct horizon *h, uint32_t triangle, struct horizon_view *view)
{
    const uint32_t *v = prt_scene_mesh(h->scene)->triangle[triangle];
    memset(view, 0xff, sizeof *view);
    for (int k = 0; k < 3; k++) {
        if (atomic_load_explicit(&h->state[v[k]], memory_order_acquire) == EMPTY)
            trace_vertex(h, v[k]);
        for (int w = 0; w < WORDS; w++) {
            view->visible[w] &=
                atomic_load_explicit(&h->visible[v[k]][w], memory_order_relaxed);
            view->blocked[w] &=
                atomic_load_explicit(&h->blocked[v[k]][w], memory_order_relaxed);
        }
    }
}
