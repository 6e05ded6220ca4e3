// SPDX-License-Identifier: MIT
// Triangles that were moved, added or removed, in a tree of boxes. Seen from a sample, a box
// covers a cone; packets beside the cones keep their rays.
#include "bake/shape_change.h"

#include "prt/light.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// A sample that sees MOST_CONES wide cones has the change all around it: its row is found anew,
// which takes less time than more of them.
enum {
    MOST_CONES = 32,
    MOST_PARTS = 1 << 20,
    MOST_DEPTH = 64,
    TILE_WIDE = 16,
    TILES = 6 * 16 * 16
};
// A part of a triangle is no wider than this share of both shapes' box: the cone about a wide
// triangle is much wider than the triangle. A box whose cone is narrower than `narrow` [rad] is
// not divided. Chosen, not measured.
static const float widest = 1.0f / 64, narrow = 0.08f;

struct box {
    float low[3], high[3];
};
struct change_node {
    struct box box;
    uint32_t child[2]; // 0: one part
};
struct shape_change {
    const struct directions *directions;
    float *x, *y, *z; // [n_packet] directions of the packets' centres
    float half;       // from there to its farthest ray [rad]
    uint64_t *around; // [TILES][words] packets about a narrow cone whose axis is in the tile
    struct change_node *node;
    uint32_t n_node, n_part, capacity;
    struct box *part;
    float fine;
};

// ---- the difference

struct own_hash {
    uint64_t hash;
    uint32_t triangle;
};

static uint64_t hash_of(const struct shape *s, uint32_t t)
{
    float corner[3][3];
    for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++) corner[j][k] = s->position[s->triangle[t][j]][k] + 0.0f;
    return prt_hash64(corner, sizeof corner, 11);
}

static int by_hash(const void *a, const void *b)
{
    const struct own_hash *x = a, *y = b;
    if (x->hash != y->hash) return x->hash < y->hash ? -1 : 1;
    return x->triangle < y->triangle ? -1 : x->triangle > y->triangle;
}

static struct own_hash *hashes_of(const struct shape *s)
{
    struct own_hash *list = prt_alloc(s->n_triangle + 1ull, sizeof *list);
    for (uint32_t t = 0; list && t < s->n_triangle; t++)
        list[t] = (struct own_hash){hash_of(s, t), t};
    if (list) qsort(list, s->n_triangle, sizeof *list, by_hash);
    return list;
}

void prt_shape_sketch(const struct shape *s, uint64_t out[SHAPE_SKETCH])
{
    memset(out, 0xff, SHAPE_SKETCH * sizeof *out);
    for (uint32_t t = 0; t < s->n_triangle; t++) {
        const uint64_t hash = hash_of(s, t);
        uint64_t *least = &out[hash % SHAPE_SKETCH];
        if (hash < *least) *least = hash;
    }
}

static float width(const float c[3][3])
{
    float most = 0;
    for (int k = 0; k < 3; k++) {
        const float low = fminf(c[0][k], fminf(c[1][k], c[2][k]));
        most = fmaxf(most, fmaxf(c[0][k], fmaxf(c[1][k], c[2][k])) - low);
    }
    return most;
}

static int add_part(struct shape_change *c, const float corner[3][3])
{
    if (c->n_part == c->capacity) {
        const uint32_t more = 2 * c->capacity + 256;
        struct box *grown = realloc(c->part, more * sizeof *grown);
        if (!grown) return PRT_NOMEM;
        c->part = grown;
        c->capacity = more;
    }
    struct box *b = &c->part[c->n_part++];
    for (int k = 0; k < 3; k++) {
        b->low[k] = fminf(corner[0][k], fminf(corner[1][k], corner[2][k]));
        b->high[k] = fmaxf(corner[0][k], fmaxf(corner[1][k], corner[2][k]));
    }
    return PRT_OK;
}

// Divides a triangle into parts no wider than c->fine.
static int add_triangle(struct shape_change *c, const float corner[3][3], unsigned depth)
{
    if (depth == 8 || width(corner) <= c->fine || c->n_part > MOST_PARTS)
        return add_part(c, corner);
    float middle[3][3]; // of the edge from corner j to the next one
    int status = PRT_OK;
    for (int j = 0; j < 3; j++)
        for (int k = 0; k < 3; k++)
            middle[j][k] = 0.5f * (corner[j][k] + corner[(j + 1) % 3][k]);
    for (int j = 0; j < 3 && !status; j++) {
        float part[3][3];
        memcpy(part[0], corner[j], sizeof part[0]);
        memcpy(part[1], middle[j], sizeof part[1]);
        memcpy(part[2], middle[(j + 2) % 3], sizeof part[2]);
        status = add_triangle(c, (const float(*)[3])part, depth + 1);
    }
    return status ? status : add_triangle(c, (const float(*)[3])middle, depth + 1);
}

static int add_of(struct shape_change *c, const struct shape *s, uint32_t triangle)
{
    float corner[3][3];
    for (int j = 0; j < 3; j++)
        memcpy(corner[j], s->position[s->triangle[triangle][j]], sizeof corner[j]);
    return add_triangle(c, (const float(*)[3])corner, 0);
}

// Adds the triangles that are in one list alone.
static int add_difference(struct shape_change *c, const struct shape *before,
                          const struct shape *now)
{
    struct own_hash *a = hashes_of(before), *b = hashes_of(now);
    int status = a && b ? PRT_OK : PRT_NOMEM;
    uint32_t i = 0, j = 0;
    while (!status && (i < before->n_triangle || j < now->n_triangle)) {
        const bool left = i < before->n_triangle, right = j < now->n_triangle;
        if (left && right && a[i].hash == b[j].hash) {
            i++, j++;
        } else if (left && (!right || a[i].hash < b[j].hash)) {
            status = add_of(c, before, a[i++].triangle);
        } else {
            status = add_of(c, now, b[j++].triangle);
        }
    }
    prt_free(a);
    prt_free(b);
    return status;
}

// ---- the tree

static void include(struct box *b, const float low[3], const float high[3])
{
    for (int k = 0; k < 3; k++)
        b->low[k] = fminf(b->low[k], low[k]), b->high[k] = fmaxf(b->high[k], high[k]);
}

static const struct box nothing = {{INFINITY, INFINITY, INFINITY},
                                   {-INFINITY, -INFINITY, -INFINITY}};

static float along(const struct box *b, int axis)
{
    return b->low[axis] + b->high[axis];
}

#define COMPARE(axis)                                       \
    static int by_axis_##axis(const void *a, const void *b) \
    {                                                       \
        const float x = along(a, axis), y = along(b, axis); \
        return x < y ? -1 : x > y;                          \
    }
COMPARE(0)
COMPARE(1)
COMPARE(2)

static uint32_t build(struct shape_change *c, uint32_t begin, uint32_t n)
{
    static int (*const compare[3])(const void *, const void *) = {by_axis_0, by_axis_1,
                                                                  by_axis_2};
    const uint32_t at = c->n_node++;
    struct box all = nothing;
    for (uint32_t i = begin; i < begin + n; i++) include(&all, c->part[i].low, c->part[i].high);
    c->node[at] = (struct change_node){.box = all};
    if (n == 1) return at;
    int axis = 0;
    for (int k = 1; k < 3; k++)
        if (all.high[k] - all.low[k] > all.high[axis] - all.low[axis]) axis = k;
    qsort(c->part + begin, n, sizeof *c->part, compare[axis]);
    const uint32_t left = build(c, begin, n / 2);
    const uint32_t right = build(c, begin + n / 2, n - n / 2);
    c->node[at].child[0] = left, c->node[at].child[1] = right;
    return at;
}

static int list_packets(struct shape_change *c)
{
    const struct directions *d = c->directions;
    c->x = prt_alloc(d->n_packet, sizeof *c->x);
    c->y = prt_alloc(d->n_packet, sizeof *c->y);
    c->z = prt_alloc(d->n_packet, sizeof *c->z);
    if (!c->x || !c->y || !c->z) return PRT_NOMEM;
    for (uint32_t k = 0; k < d->n_packet; k++) {
        const uint32_t t = d->texel[(size_t)k * 4], in = t % (d->n * d->n);
        float w[3];
        prt_cube_direction(t / (d->n * d->n), 2.0 * (in % d->n + 1) / d->n - 1,
                           2.0 * (in / d->n + 1) / d->n - 1, w);
        c->x[k] = w[0], c->y[k] = w[1], c->z[k] = w[2];
    }
    c->half = 2 * sqrtf(2) / (float)d->n; // an angle is less than the distance on a face
    return PRT_OK;
}

static size_t words_of(const struct shape_change *c)
{
    return ((size_t)c->directions->n_packet + 63) / 64;
}

// Packets at most `angle` from a unit direction.
static void mark_cone(const struct shape_change *c, const float w[3], float angle,
                      uint64_t *fresh)
{
    const uint32_t n = c->directions->n_packet;
    const float least = angle < 3 ? cosf(angle) : -2; // -2: all of them
    for (uint32_t first = 0; first < n; first += 64) {
        uint8_t in[64];
        const uint32_t m = n - first < 64 ? n - first : 64;
        for (uint32_t i = 0; i < m; i++)
            in[i] = w[0] * c->x[first + i] + w[1] * c->y[first + i] + w[2] * c->z[first + i] >=
                    least;
        for (uint32_t i = 0; i < m; i++) fresh[first / 64] |= (uint64_t)in[i] << i;
    }
}

static float margin_of(const struct shape_change *c)
{
    return prt_horizon_reach + c->half;
}

static int list_tiles(struct shape_change *c)
{
    const float tile = sqrtf(2) / TILE_WIDE; // from its centre to its corner
    c->around = prt_calloc(TILES * words_of(c), sizeof *c->around);
    if (!c->around) return PRT_NOMEM;
    for (unsigned t = 0; t < TILES; t++) {
        const unsigned in = t % (TILE_WIDE * TILE_WIDE);
        float w[3];
        prt_cube_direction(t / (TILE_WIDE * TILE_WIDE),
                           (2.0 * (in % TILE_WIDE) + 1) / TILE_WIDE - 1,
                           (2.0 * (in / TILE_WIDE) + 1) / TILE_WIDE - 1, w);
        mark_cone(c, w, margin_of(c) + tile + narrow, c->around + t * words_of(c));
    }
    return PRT_OK;
}

static unsigned tile_of(const float w[3])
{
    float s, t;
    unsigned face;
    prt_cube_lookup(w, &face, &s, &t);
    const int x = (int)((s + 1) * 0.5f * TILE_WIDE), y = (int)((t + 1) * 0.5f * TILE_WIDE);
    const int last = TILE_WIDE - 1;
    return (face * TILE_WIDE + (unsigned)(y < 0      ? 0
                                          : y > last ? last
                                                     : y)) *
               TILE_WIDE +
           (unsigned)(x < 0      ? 0
                      : x > last ? last
                                 : x);
}

static float widest_part(const struct shape *a, const struct shape *b)
{
    struct box all = nothing;
    float most = 0;
    for (uint32_t v = 0; v < a->n_vertex; v++) include(&all, a->position[v], a->position[v]);
    for (uint32_t v = 0; v < b->n_vertex; v++) include(&all, b->position[v], b->position[v]);
    for (int k = 0; k < 3; k++) most = fmaxf(most, all.high[k] - all.low[k]);
    return widest * most;
}

int prt_shape_change_create(const struct shape *before, const struct shape *now,
                            const struct directions *d, struct shape_change **out)
{
    struct shape_change *c = calloc(1, sizeof *c);
    if (!c) return PRT_NOMEM;
    c->directions = d;
    c->fine = widest_part(before, now);
    int status = add_difference(c, before, now);
    if (!status) status = list_packets(c);
    if (!status) status = list_tiles(c);
    c->node = status ? NULL : prt_alloc(2ull * c->n_part + 1, sizeof *c->node);
    if (!c->node) status = PRT_NOMEM;
    if (!status && c->n_part) (void)build(c, 0, c->n_part);
    if (status || !c->n_part) {
        prt_shape_change_destroy(c);
        c = NULL;
    }
    if (!status) *out = c;
    return status;
}

void prt_shape_change_destroy(struct shape_change *c)
{
    if (!c) return;
    prt_free(c->x);
    prt_free(c->y);
    prt_free(c->z);
    prt_free(c->around);
    prt_free(c->node);
    free(c->part);
    free(c);
}

// ---- packets

// A box as a sample sees it.
struct seen {
    float w[3], far; // towards its centre
    float sine;      // of the half angle of the cone about it; 1: the sample is in it
    float up;        // of w above the face
};

static void look(const struct box *box, const float at[3], const float face_normal[3],
                 float apart, struct seen *out)
{
    float far2 = 1e-30f, radius2 = 0;
    for (int k = 0; k < 3; k++) {
        const float half = 0.5f * (box->high[k] - box->low[k]);
        out->w[k] = box->low[k] + half - at[k];
        far2 += out->w[k] * out->w[k], radius2 += half * half;
    }
    out->far = sqrtf(far2), out->up = 0;
    for (int k = 0; k < 3; k++) {
        out->w[k] /= out->far;
        out->up += out->w[k] * face_normal[k];
    }
    const float radius = 1.0001f * (sqrtf(radius2) + apart) + 1e-6f * out->far;
    out->sine = radius < out->far ? radius / out->far : 1;
}

void prt_shape_change_mark(const struct shape_change *c, const float at[3],
                           const float face_normal[3], float apart, uint64_t *fresh)
{
    uint32_t stack[MOST_DEPTH], n = 0, wide = 0;
    uint64_t done[TILES / 64] = {0};
    if (!c) return;
    const float margin = margin_of(c), narrow_sine = sinf(narrow);
    const float narrow_below = -sinf(margin + narrow);
    stack[n++] = 0;
    while (n) {
        const struct change_node *node = &c->node[stack[--n]];
        struct seen seen;
        look(&node->box, at, face_normal, apart, &seen);
        if (seen.sine < narrow_sine) {
            const unsigned tile = tile_of(seen.w);
            if (seen.up < narrow_below || done[tile / 64] >> tile % 64 & 1) continue;
            done[tile / 64] |= UINT64_C(1) << tile % 64;
            const uint64_t *around = c->around + tile * words_of(c);
            for (size_t k = 0; k < words_of(c); k++) fresh[k] |= around[k];
            continue;
        }
        const float angle = asinf(seen.sine) + margin;
        if (seen.sine < 1 && angle < (float)M_PI_2 && seen.up < -sinf(angle)) continue;
        if (node->child[0]) {
            stack[n++] = node->child[0], stack[n++] = node->child[1];
            continue;
        }
        if (seen.sine == 1 || ++wide > MOST_CONES) {
            mark_cone(c, seen.w, (float)M_PI, fresh);
            return;
        }
        mark_cone(c, seen.w, angle, fresh);
    }
}
