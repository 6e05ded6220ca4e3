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
    // [n_place][words] filled on first use: of 32 bins, from bit 0 those that are open, from
    // bit 32 those that agree with all their neighbours. One word, so that another thread sees
    // both or neither.
    _Atomic uint64_t *sight;
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

// A place casts some 1800 rays. A sample without a horizon casts some 3000, one for each texel
// above its plane: so many places take a sixth of the rays that they may spare. Beyond
// most_fine_places all bins would be coarse.
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
    h->sight = status ? NULL : prt_calloc(n, h->words * sizeof *h->sight);
    h->state = status ? NULL : prt_calloc(n, sizeof *h->state);
    if (!h->sight || !h->state) {
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
    prt_free(h->sight);
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

// A row of bins, from bit 0; wide is 16 or 32.
static inline uint32_t row_of(const uint64_t *set, unsigned wide, unsigned row)
{
    return (uint32_t)(set[row * wide / 64] >> row * wide % 64) & (UINT32_MAX >> (32 - wide));
}

// Rays of one place that are cast together.
struct centre_rays {
    struct prt_packet packet;
    uint16_t bin[16];
    uint32_t fill;
};

static void cast(const struct horizon *h, struct centre_rays *r, struct sight *out)
{
    const uint32_t mask = r->fill == 16 ? 0xffff : (1u << r->fill) - 1;
    const uint32_t lanes = r->fill ? prt_scene_model_occluded16(h->scene, &r->packet, mask) : 0;
    for (uint32_t i = 0; i < r->fill; i++)
        add(lanes >> i & 1 ? out->hit : out->open, r->bin[i], 1);
    r->fill = 0;
}

// Casts a ray through the centre of each bin of `wanted` above the tangent plane.
static void cast_centres(const struct horizon *h, const struct bins *bins, uint32_t place,
                         const uint64_t *wanted, struct sight *out)
{
    const float *p, *n;
    prt_horizon_place(&h->places, place, &p, &n);
    const unsigned wide = bins->wide;
    const float eps = prt_scene_model_epsilon(h->scene);
    struct centre_rays r = {.fill = 0};
    for (int i = 0; i < 16; i++) {
        r.packet.ox[i] = p[0] + eps * n[0], r.packet.oy[i] = p[1] + eps * n[1];
        r.packet.oz[i] = p[2] + eps * n[2];
        r.packet.tnear[i] = 0, r.packet.tfar[i] = INFINITY;
        r.packet.dx[i] = 1, r.packet.dy[i] = r.packet.dz[i] = 0;
    }
    // Squares of 4 x 4 bins, so that the rays of a packet have similar directions.
    for (unsigned tile = 0; tile < bins->n / 16; tile++) {
        const unsigned row = tile / (wide / 4) * 4, x = tile % (wide / 4) * 4;
        for (unsigned y = row; y < row + 4; y++)
            for (uint32_t four = row_of(wanted, wide, y) >> x & 15; four; four &= four - 1) {
                const unsigned at = y * wide + x + (unsigned)__builtin_ctz(four);
                const float *d = bins->direction[at];
                if (n[0] * d[0] + n[1] * d[1] + n[2] * d[2] <= 0) continue;
                r.packet.dx[r.fill] = d[0], r.packet.dy[r.fill] = d[1];
                r.packet.dz[r.fill] = d[2];
                r.bin[r.fill++] = (uint16_t)at;
                if (r.fill == 16) cast(h, &r, out);
            }
    }
    cast(h, &r, out);
}

// A bin at the edge of a face, whose neighbours are on other faces, too.
static void agree_at_edge(const struct bins *bins, unsigned b, struct sight *s)
{
    bool all_open = has(s->open, b), none_open = has(s->hit, b);
    for (int k = 0; k < 8; k++) {
        all_open &= has(s->open, bins->around[b][k]);
        none_open &= !has(s->open, bins->around[b][k]);
    }
    add(s->visible, b, all_open);
    add(s->blocked, b, none_open);
}

// A bin below the tangent plane carries no light and agrees with blocked neighbours. A gap
// below the centres of the lowest bins, less than half a bin above the plane, is therefore
// missed; its light arrives at a cosine below 0.07 where bins are coarse.
static void agree(const struct bins *bins, const uint64_t *wanted, struct sight *s)
{
    const unsigned wide = bins->wide, last = wide - 1;
    for (unsigned row = 0; row < 6 * wide; row++) {
        const uint32_t edge = 1u | 1u << last, own = row_of(wanted, wide, row);
        const bool inside = row % wide && row % wide != last;
        for (uint32_t m = inside ? own & edge : own; m; m &= m - 1)
            agree_at_edge(bins, row * wide + (unsigned)__builtin_ctz(m), s);
        if (!inside || !(own & ~edge)) continue;
        // Of three rows: all open, which no bin at an edge is, and any open.
        uint32_t all = UINT32_MAX, any = 0;
        for (unsigned y = row - 1; y <= row + 1; y++) {
            const uint32_t open = row_of(s->open, wide, y);
            all &= open & open << 1 & open >> 1;
            any |= open | open << 1 | open >> 1;
        }
        const unsigned at = row * wide;
        s->visible[at / 64] |= (uint64_t)(all & own) << at % 64;
        s->blocked[at / 64] |= (uint64_t)(row_of(s->hit, wide, row) & ~any & own & ~edge)
                               << at % 64;
    }
}

// Row `row` of coarse bins as two rows of fine ones.
static inline uint64_t twice(const uint64_t *set, unsigned row)
{
    uint64_t x = row_of(set, COARSE_WIDE, row);
    x = (x | x << 8) & 0x00ff00ff, x = (x | x << 4) & 0x0f0f0f0f;
    x = (x | x << 2) & 0x33333333, x = (x | x << 1) & 0x55555555;
    x |= x << 1;
    return x | x << 32;
}

// The fine bins of coarse ones that are not certain are cast, the others taken as they are.
static void refine(const struct horizon *h, uint32_t place, const struct sight *coarse,
                   struct sight *out)
{
    uint64_t wanted[HORIZON_WORDS];
    _Static_assert(HORIZON_WIDE == 32, "two rows of fine bins are a word");
    for (unsigned row = 0; row < HORIZON_WORDS; row++) {
        out->visible[row] = out->open[row] = twice(coarse->visible, row);
        out->blocked[row] = out->hit[row] = twice(coarse->blocked, row);
        wanted[row] = ~(out->visible[row] | out->blocked[row]);
    }
    cast_centres(h, &h->fine, place, wanted, out);
    agree(&h->fine, wanted, out);
}

// Two threads may trace one place at the same time: both write the same bits.
static void trace_place(struct horizon *h, uint32_t place)
{
    struct sight coarse = {0}, fine;
    const struct sight *found = &coarse;
    uint64_t every[COARSE_WORDS];
    memset(every, 0xff, sizeof every);
    cast_centres(h, &h->coarse, place, every, &coarse);
    agree(&h->coarse, every, &coarse);
    if (h->words == FINE_PAIRS) {
        refine(h, place, &coarse, &fine);
        found = &fine;
    }
    const size_t at = (size_t)place * h->words;
    for (unsigned k = 0; k < h->words; k++) {
        const uint64_t open = found->open[k / 2] >> k % 2 * 32 & UINT32_MAX;
        const uint64_t certain = (found->visible[k / 2] | found->blocked[k / 2]) >> k % 2 * 32;
        atomic_store_explicit(&h->sight[at + k], open | certain << 32, memory_order_relaxed);
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
    // 32 bins that are not open and uncertain, or not traced yet
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
    for (uint32_t m = mask; m; m &= m - 1) { // prefetches what the second loop reads
        const uint32_t i = (uint32_t)__builtin_ctz(m), *corner = mesh->triangle[triangle[i]];
        bin[i] = bins[texel[i]];
        if (h->words != FINE_PAIRS) bin[i] = h->parent[bin[i]];
        for (int k = 0; k < 3; k++) {
            at[i][k] = &h->sight[(size_t)corner[k] * h->words + bin[i] / 32];
            __builtin_prefetch((const void *)at[i][k]);
        }
    }
    for (uint32_t m = mask; m; m &= m - 1) {
        const uint32_t i = (uint32_t)__builtin_ctz(m);
        if (h->places.level[triangle[i]]) continue;
        uint64_t certain = (uint64_t)1 << 32, all = 1, any = 0;
        for (int k = 0; k < 3 && certain; k++) {
            const uint64_t pair = corner_pair(h, triangle[i], k, at[i][k]) >> bin[i] % 32;
            certain &= pair, all &= pair, any |= pair;
        }
        certain >>= 32;
        *visible |= (uint32_t)(certain & all) << i;
        *blocked |= (uint32_t)(certain & ~any) << i;
    }
}

// The open bins of a square of wide x wide, aligned to its width, at a vertex.
static unsigned open_bins(struct horizon *h, uint32_t vertex, unsigned bin, unsigned wide)
{
    const unsigned x = bin % HORIZON_WIDE & ~(wide - 1);
    const unsigned row = bin / HORIZON_WIDE & ~(wide - 1);
    const uint32_t mask = wide < 32 ? (1u << wide) - 1 : UINT32_MAX;
    unsigned open = 0;
    want_place(h, vertex);
    for (unsigned y = row; y < row + wide; y++) {
        const uint64_t bins = atomic_load_explicit(&h->sight[(size_t)vertex * h->words + y],
                                                   memory_order_relaxed);
        open += (unsigned)__builtin_popcount((uint32_t)bins >> x & mask);
    }
    return open;
}

float prt_horizon_share(struct horizon *h, uint32_t triangle, float u, float v, unsigned bin,
                        unsigned wide)
{
    const uint32_t *corner = prt_scene_mesh(h->scene)->triangle[triangle];
    if (h->words != FINE_PAIRS || h->places.level[triangle]) return -1;
    const float open = (1 - u - v) * (float)open_bins(h, corner[0], bin, wide) +
                       u * (float)open_bins(h, corner[1], bin, wide) +
                       v * (float)open_bins(h, corner[2], bin, wide);
    return fminf(fmaxf(open / (float)(wide * wide), 0), 1);
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
static void spread(uint64_t set[HORIZON_WORDS])
{
    uint64_t coarse[COARSE_WORDS];
    memcpy(coarse, set, sizeof coarse);
    for (unsigned row = 0; row < HORIZON_WORDS; row++) set[row] = twice(coarse, row);
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
            const uint64_t pair = atomic_load_explicit(&h->sight[at + w], memory_order_relaxed);
            const uint64_t other = w % 2 ? UINT32_MAX : (uint64_t)UINT32_MAX << 32;
            const uint64_t open = pair & UINT32_MAX, certain = pair >> 32;
            view->visible[w / 2] &= (certain & open) << w % 2 * 32 | other;
            view->blocked[w / 2] &= (certain & ~open) << w % 2 * 32 | other;
        }
    }
    if (h->words == FINE_PAIRS) return;
    spread(view->visible);
    spread(view->blocked);
}
