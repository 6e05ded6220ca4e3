// SPDX-License-Identifier: MIT
// Conservative visibility per place and direction bin: visible, blocked, or unknown (needs a
// ray), in the model's units. A bin is certain only when all eight neighbours agree with it.
// Most light leaves a body where nothing else is near, and needs no shadow ray there, nor deep
// in a fold.
#include "bake/horizon_places.h"
#include "bake/stages.h"

#include "prt/light.h"

#include <math.h>
#include <stdatomic.h>
#include <stdlib.h>
#include <string.h>

enum { EMPTY, TRACED };
// The bins of a large mesh are 2 x 2 of a small one's.
enum { COARSE_WIDE = HORIZON_WIDE / 2, COARSE_WORDS = HORIZON_WORDS / 4 };
enum { FINE_PAIRS = 2 * HORIZON_WORDS, COARSE_PAIRS = 2 * COARSE_WORDS };
static const uint32_t most_fine_places = 150000; // 230 MB of fine bins

// Bins of a cubemap's faces, wide x wide each.
struct bins {
    unsigned wide, n;
    float direction[6 * HORIZON_WIDE * HORIZON_WIDE][3];
    uint16_t around[6 * HORIZON_WIDE * HORIZON_WIDE][8]; // the bins that touch one
};
struct horizon {
    const struct prt_scene *scene;
    struct horizon_places places;
    unsigned words; // of a place: 32 bins in each
    // [n_place][words] filled on first use: of 32 bins, from bit 0 those that are visible with
    // all their neighbours, from bit 32 those that are blocked with them. One word, so that
    // another thread sees both or neither.
    _Atomic uint64_t *certain;
    _Atomic uint8_t *state; // [n_place]
    struct bins fine, coarse;
    uint16_t parent[6 * HORIZON_WIDE * HORIZON_WIDE]; // the coarse bin that holds a fine one
};

// Triangles longer than this share of the box may hide something between their corners. Chosen,
// not measured. They are divided.
static const double widest = 0.02;

static void init_bins(struct bins *bins, unsigned wide)
{
    bins->wide = wide, bins->n = 6 * wide * wide;
    for (unsigned b = 0; b < bins->n; b++) {
        unsigned face = b / (wide * wide), x = b % wide, y = b / wide % wide, k = 0;
        for (int dy = -1; dy <= 1; dy++)
            for (int dx = -1; dx <= 1; dx++) {
                float dir[3], s, t;
                unsigned to;
                prt_cube_direction(face, 2 * ((int)x + dx + 0.5) / wide - 1,
                                   2 * ((int)y + dy + 0.5) / wide - 1, dir);
                if (!dx && !dy) {
                    memcpy(bins->direction[b], dir, sizeof dir);
                    continue;
                }
                prt_cube_lookup(dir, &to, &s, &t);
                int last = (int)wide - 1;
                int u = (int)((s + 1) * 0.5f * (float)wide);
                int v = (int)((t + 1) * 0.5f * (float)wide);
                u = u < 0 ? 0 : u > last ? last : u;
                v = v < 0 ? 0 : v > last ? last : v;
                bins->around[b][k++] =
                    (uint16_t)((to * wide + (unsigned)v) * wide + (unsigned)u);
            }
    }
}

uint32_t prt_horizon_words(uint32_t n_place)
{
    return n_place > most_fine_places ? COARSE_PAIRS : FINE_PAIRS;
}

// A place casts some 1800 rays. A sample without a horizon casts up to 24,576, four a texel: so
// many places take a few percent of the rays that they spare. Beyond most_fine_places all bins
// would be coarse.
uint32_t prt_horizon_more(uint32_t n_vertex, uint32_t n_sample)
{
    const uint32_t paid = n_sample / 4,
                   most = paid < most_fine_places ? paid : most_fine_places;
    return n_vertex >= most ? 0 : most - n_vertex;
}

int prt_horizon_create(const struct prt_scene *scene, uint32_t most_more, struct horizon **out)
{
    const struct prt_mesh *mesh = prt_scene_model(scene);
    struct horizon *h = calloc(1, sizeof *h);
    if (!h) return PRT_NOMEM;
    h->scene = scene;
    int status = prt_horizon_places_create(mesh, widest * prt_mesh_diagonal(mesh), most_more,
                                           &h->places);
    const uint32_t n = h->places.n_place;
    h->words = prt_horizon_words(n);
    h->certain = status ? NULL : prt_calloc(n, h->words * sizeof *h->certain);
    h->state = status ? NULL : prt_calloc(n, sizeof *h->state);
    if (!h->certain || !h->state) {
        prt_horizon_destroy(h);
        return PRT_NOMEM;
    }
    init_bins(&h->fine, HORIZON_WIDE);
    init_bins(&h->coarse, COARSE_WIDE);
    for (unsigned b = 0; b < h->fine.n; b++) {
        unsigned x = b % HORIZON_WIDE / 2, row = b / HORIZON_WIDE / 2;
        h->parent[b] = (uint16_t)(row * COARSE_WIDE + x);
    }
    *out = h;
    return PRT_OK;
}

void prt_horizon_destroy(struct horizon *h)
{
    if (!h) return;
    prt_free(h->certain);
    prt_free(h->state);
    prt_horizon_places_finish(&h->places);
    free(h);
}

static inline bool has(const uint64_t *set, unsigned bin)
{
    return set[bin / 64] >> bin % 64 & 1;
}

static inline void add(uint64_t *set, unsigned bin, bool value)
{
    set[bin / 64] |= (uint64_t)value << bin % 64;
}

// The bins of one place, coarse or fine: what their rays met, and which are certain.
struct sight {
    uint64_t open[HORIZON_WORDS], hit[HORIZON_WORDS]; // by the ray through the bin's centre
    uint64_t visible[HORIZON_WORDS], blocked[HORIZON_WORDS];
};

// Casts a ray through the centre of each bin of `wanted` (NULL: all) above the tangent plane.
static void cast_centres(const struct horizon *h, const struct bins *bins, uint32_t place,
                         const uint64_t *wanted, struct sight *out)
{
    const float *p, *n;
    prt_horizon_place(&h->places, place, &p, &n);
    const unsigned wide = bins->wide;
    float eps = prt_scene_model_epsilon(h->scene);
    uint16_t bin[16];
    struct prt_packet packet;
    uint32_t fill = 0;
    for (int i = 0; i < 16; i++) {
        packet.ox[i] = p[0] + eps * n[0], packet.oy[i] = p[1] + eps * n[1];
        packet.oz[i] = p[2] + eps * n[2];
        packet.tnear[i] = 0, packet.tfar[i] = INFINITY;
        packet.dx[i] = 1, packet.dy[i] = packet.dz[i] = 0;
    }
    for (unsigned b = 0; b <= bins->n; b++) {
        if (b < bins->n) {
            // Squares of 4 x 4 bins, so that the rays of a packet have similar directions.
            unsigned i = b % 16, tile = b / 16 % (wide * wide / 16);
            unsigned x = tile % (wide / 4) * 4 + (i & 3), y = tile / (wide / 4) * 4 + (i >> 2);
            unsigned at = (b / (wide * wide) * wide + y) * wide + x;
            const float *d = bins->direction[at];
            if (wanted && !has(wanted, at)) continue;
            if (n[0] * d[0] + n[1] * d[1] + n[2] * d[2] <= 0) continue;
            packet.dx[fill] = d[0], packet.dy[fill] = d[1], packet.dz[fill] = d[2];
            bin[fill++] = (uint16_t)at;
        }
        if (!fill || (fill < 16 && b < bins->n)) continue;
        uint32_t mask = fill == 16 ? 0xffff : (1u << fill) - 1;
        uint32_t lanes = prt_scene_model_occluded16(h->scene, &packet, mask);
        for (uint32_t i = 0; i < fill; i++)
            add(lanes >> i & 1 ? out->hit : out->open, bin[i], 1);
        fill = 0;
    }
}

// A bin below the tangent plane carries no light and agrees with blocked neighbours. A gap
// below the centres of the lowest bins, less than half a bin above the plane, is therefore
// missed; its light arrives at a cosine below 0.07 where bins are coarse.
static void agree(const struct bins *bins, const uint64_t *wanted, struct sight *s)
{
    for (unsigned b = 0; b < bins->n; b++) {
        if (wanted && !has(wanted, b)) continue;
        bool all_open = has(s->open, b), none_open = has(s->hit, b);
        for (int k = 0; k < 8; k++) {
            all_open &= has(s->open, bins->around[b][k]);
            none_open &= !has(s->open, bins->around[b][k]);
        }
        add(s->visible, b, all_open);
        add(s->blocked, b, none_open);
    }
}

// The fine bins of coarse ones that are not certain are cast, the others taken as they are.
static void refine(const struct horizon *h, uint32_t place, const struct sight *coarse,
                   struct sight *out)
{
    uint64_t wanted[HORIZON_WORDS] = {0};
    memset(out, 0, sizeof *out);
    for (unsigned b = 0; b < h->fine.n; b++) {
        bool visible = has(coarse->visible, h->parent[b]);
        bool blocked = has(coarse->blocked, h->parent[b]);
        add(out->visible, b, visible), add(out->open, b, visible);
        add(out->blocked, b, blocked), add(out->hit, b, blocked);
        add(wanted, b, !visible && !blocked);
    }
    cast_centres(h, &h->fine, place, wanted, out);
    agree(&h->fine, wanted, out);
}

// Two threads may trace one place at the same time: both write the same bits.
static void trace_place(struct horizon *h, uint32_t place)
{
    struct sight coarse = {0}, fine;
    const struct sight *found = &coarse;
    cast_centres(h, &h->coarse, place, NULL, &coarse);
    agree(&h->coarse, NULL, &coarse);
    if (h->words == FINE_PAIRS) {
        refine(h, place, &coarse, &fine);
        found = &fine;
    }
    const size_t at = (size_t)place * h->words;
    for (unsigned k = 0; k < h->words; k++) {
        const uint64_t visible = found->visible[k / 2] >> k % 2 * 32 & UINT32_MAX;
        const uint64_t blocked = found->blocked[k / 2] >> k % 2 * 32 & UINT32_MAX;
        atomic_store_explicit(&h->certain[at + k], visible | blocked << 32,
                              memory_order_relaxed);
    }
    atomic_store_explicit(&h->state[place], TRACED, memory_order_release);
}

static void want_place(struct horizon *h, uint32_t place)
{
    if (atomic_load_explicit(&h->state[place], memory_order_acquire) == EMPTY)
        trace_place(h, place);
}

// The pair of 32 bins of a triangle's corner k that lies at `at`; traces it if it is not yet.
static inline uint64_t corner_pair(struct horizon *h, uint32_t triangle, int k,
                                   const _Atomic uint64_t *at)
{
    uint64_t pair = atomic_load_explicit(at, memory_order_relaxed);
    if (pair) return pair;
    // 32 uncertain bins, or not traced yet
    want_place(h, prt_scene_mesh(h->scene)->triangle[triangle][k]);
    return atomic_load_explicit(at, memory_order_relaxed);
}

void prt_horizon_bins(struct horizon *h, uint32_t mask, const uint32_t triangle[16],
                      const uint16_t *bins, const uint32_t texel[16], uint32_t *visible,
                      uint32_t *blocked)
{
    const struct prt_mesh *mesh = prt_scene_mesh(h->scene);
    const _Atomic uint64_t *at[16][3];
    uint32_t bin[16];
    *visible = *blocked = 0;
    for (uint32_t m = mask; m; m &= m - 1) { // asks for the memory that will be read
        const uint32_t i = (uint32_t)__builtin_ctz(m), *corner = mesh->triangle[triangle[i]];
        bin[i] = bins[texel[i]];
        if (h->words != FINE_PAIRS) bin[i] = h->parent[bin[i]];
        for (int k = 0; k < 3; k++) {
            at[i][k] = &h->certain[(size_t)corner[k] * h->words + bin[i] / 32];
            __builtin_prefetch((const void *)at[i][k]);
        }
    }
    for (uint32_t m = mask; m; m &= m - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(m);
        if (h->places.level[triangle[i]]) continue;
        const uint64_t either = (uint64_t)1 << bin[i] % 32 | (uint64_t)1 << 32 << bin[i] % 32;
        uint64_t pair = either;
        for (int k = 0; k < 3 && pair; k++) pair &= corner_pair(h, triangle[i], k, at[i][k]);
        *visible |= (uint32_t)(pair >> bin[i] % 32 & 1) << i;
        *blocked |= (uint32_t)(pair >> 32 >> bin[i] % 32 & 1) << i;
    }
}

int prt_horizon_bin(struct horizon *h, uint32_t triangle, uint32_t bin)
{
    const uint32_t triangles[16] = {triangle}, texel[16] = {0};
    const uint16_t bins[1] = {(uint16_t)bin};
    uint32_t visible, blocked;
    prt_horizon_bins(h, 1, triangles, bins, texel, &visible, &blocked);
    return (int)visible - (int)blocked;
}

unsigned prt_horizon_around(const struct horizon *h, uint32_t triangle, float u, float v,
                            struct horizon_corner out[3])
{
    uint32_t corner[3];
    if (!prt_horizon_places_around(&h->places, triangle, u, v, corner)) return 0;
    for (int k = 0; k < 3; k++) {
        const float *p, *n;
        prt_horizon_place(&h->places, corner[k], &p, &n);
        memcpy(out[k].position, p, sizeof out[k].position);
        memcpy(out[k].normal, n, sizeof out[k].normal);
    }
    return h->words;
}

// Coarse bins as fine ones.
static void spread(const struct horizon *h, uint64_t set[HORIZON_WORDS])
{
    uint64_t coarse[COARSE_WORDS];
    memcpy(coarse, set, sizeof coarse);
    memset(set, 0, HORIZON_WORDS * sizeof *set);
    for (unsigned b = 0; b < h->fine.n; b++) add(set, b, has(coarse, h->parent[b]));
}

void prt_horizon_view(struct horizon *h, uint32_t triangle, float u, float v,
                      struct horizon_view *view)
{
    uint32_t corner[3];
    const bool found = prt_horizon_places_around(&h->places, triangle, u, v, corner);
    memset(view, found ? 0xff : 0, sizeof *view);
    for (int k = 0; k < 3 && found; k++) {
        want_place(h, corner[k]);
        const size_t at = (size_t)corner[k] * h->words;
        for (unsigned w = 0; w < h->words; w++) {
            const uint64_t pair =
                atomic_load_explicit(&h->certain[at + w], memory_order_relaxed);
            const uint64_t other = w % 2 ? UINT32_MAX : (uint64_t)UINT32_MAX << 32;
            view->visible[w / 2] &= (pair & UINT32_MAX) << w % 2 * 32 | other;
            view->blocked[w / 2] &= pair >> 32 << w % 2 * 32 | other;
        }
    }
    if (h->words == FINE_PAIRS) return;
    spread(h, view->visible);
    spread(h, view->blocked);
}
