// SPDX-License-Identifier: MIT
// Visible directions of pass 1's rows in the store of a bake, and those of a bake of a similar
// shape. Such a bake's rows are found by a hash of what each depends on.
#include "bake/row_store.h"
#include "bake/shape_change.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

// A piece has n hashes of places and n packed rows. SLOT_SKETCH comes first in a file.
enum { SLOT_LANES = 1, SLOT_SKETCH = 2, SLOT_POSITIONS = 3, SLOT_TRIANGLES = 4 };
static const char kind[] = "rows";

struct sketch {
    uint64_t sampling; // hash of the directions and settings
    uint32_t n_vertex, n_triangle, n_sample, n_piece;
    uint64_t shape[SHAPE_SKETCH];
};

// A row of another bake.
struct old_row {
    uint64_t place;
    const uint8_t *packed;
    uint32_t bytes; // at most
};

struct row_store {
    struct ray_store *own;
    uint32_t n_packet;
    uint64_t sampling;
    struct old_row *row; // [n_row] by rising place
    size_t n_row, n_piece;
    uint8_t **piece; // [n_piece] memory behind them
    struct shape_change *change;
};

static uint64_t place_hash(const struct row_store *s, const struct row_place *place)
{
    return prt_hash64(place, sizeof *place, s->sampling);
}

// ---- another bake

static int by_place(const void *a, const void *b)
{
    const uint64_t x = ((const struct old_row *)a)->place,
                   y = ((const struct old_row *)b)->place;
    return x < y ? -1 : x > y;
}

// Lists the rows of one piece.
static void list_rows(struct row_store *s, const uint8_t *data, size_t bytes)
{
    uint64_t n;
    uint16_t room[MAX_PACKETS];
    if (bytes < sizeof n) return;
    memcpy(&n, data, sizeof n);
    size_t at = sizeof n + 8 * n;
    if (n > 64 || at > bytes) return;
    for (uint64_t i = 0; i < n; i++) {
        struct old_row row = {.packed = data + at, .bytes = (uint32_t)(bytes - at)};
        memcpy(&row.place, data + sizeof n + 8 * i, sizeof row.place);
        const size_t used = prt_lanes_unpack(row.packed, row.bytes, s->n_packet, room);
        if (!used) return;
        s->row[s->n_row++] = row;
        at += used;
    }
}

static int read_rows(struct row_store *s, struct ray_store *from, const struct sketch *sketch)
{
    enum { PIECE = 64 };
    s->piece = calloc(sketch->n_piece + 1ull, sizeof *s->piece);
    s->row = calloc((size_t)PIECE * sketch->n_piece + 1, sizeof *s->row);
    if (!s->piece || !s->row) return PRT_NOMEM;
    for (uint32_t i = 0; i < sketch->n_piece; i++) {
        size_t bytes;
        uint64_t rays;
        uint8_t *data = prt_ray_store_get(from, SLOT_LANES, i * PIECE, &bytes, &rays);
        if (!data) continue;
        s->piece[s->n_piece++] = data;
        list_rows(s, data, bytes);
    }
    if (s->n_row) qsort(s->row, s->n_row, sizeof *s->row, by_place);
    return PRT_OK;
}

static bool within(const uint32_t (*triangle)[3], uint32_t n_triangle, uint32_t n_vertex)
{
    for (size_t i = 0; i < 3 * (size_t)n_triangle; i++)
        if (triangle[i / 3][i % 3] >= n_vertex) return false;
    return true;
}

// Compares its shape with the bake's.
static int find_change(struct row_store *s, const struct bake *b, struct ray_store *from,
                       const struct sketch *sketch, const struct shape *own)
{
    size_t bytes[2] = {0, 0};
    uint64_t rays;
    float(*position)[3] = prt_ray_store_get(from, SLOT_POSITIONS, 0, &bytes[0], &rays);
    uint32_t(*triangle)[3] = prt_ray_store_get(from, SLOT_TRIANGLES, 0, &bytes[1], &rays);
    int status = PRT_FORMAT;
    if (position && triangle && bytes[0] == 12 * (size_t)sketch->n_vertex &&
        bytes[1] == 12 * (size_t)sketch->n_triangle &&
        within((const uint32_t(*)[3])triangle, sketch->n_triangle, sketch->n_vertex)) {
        const struct shape old = {sketch->n_vertex, sketch->n_triangle,
                                  (const float(*)[3])position, (const uint32_t(*)[3])triangle};
        status = prt_shape_change_create(&old, own, b->directions, &s->change);
    }
    prt_free(position);
    prt_free(triangle);
    return status;
}

// The best of the folder's other files.
struct choice {
    const struct sketch *own;
    uint64_t own_key, key;
    uint32_t shared, n_sample;
};

static void compare(void *user, uint64_t key, uint32_t slot, const void *data, size_t bytes)
{
    struct choice *c = user;
    struct sketch s;
    uint32_t shared = 0;
    if (key == c->own_key || slot != SLOT_SKETCH || bytes != sizeof s) return;
    memcpy(&s, data, sizeof s);
    if (s.sampling != c->own->sampling) return;
    for (int i = 0; i < SHAPE_SKETCH; i++)
        shared += s.shape[i] == c->own->shape[i] && s.shape[i] != UINT64_MAX;
    if (shared < c->shared || (shared == c->shared && s.n_sample <= c->n_sample)) return;
    c->key = key, c->shared = shared, c->n_sample = s.n_sample;
}

static void take_similar(struct row_store *s, const struct bake *b, uint64_t key,
                         const struct sketch *own, const struct shape *shape)
{
    struct choice c = {.own = own, .own_key = key};
    struct sketch sketch;
    size_t bytes = 0;
    uint64_t rays;
    prt_ray_store_each(b->o.cache, kind, sizeof sketch, compare, &c);
    if (!c.shared) return;
    struct ray_store *from = prt_ray_store_reopen(b->ctx, b->o.cache, kind, c.key);
    void *data = prt_ray_store_get(from, SLOT_SKETCH, 0, &bytes, &rays);
    if (data && bytes == sizeof sketch) {
        memcpy(&sketch, data, sizeof sketch);
        if (find_change(s, b, from, &sketch, shape) || read_rows(s, from, &sketch))
            s->n_row = 0;
    }
    prt_free(data);
    prt_ray_store_close(from);
}

// ---- opening

static uint64_t hash_sampling(const struct bake *b)
{
    const struct directions *d = b->directions;
    const uint64_t more[] = {PRT_BAKE_VERSION, b->ctx ? b->ctx->cpu : 0, b->o.seed, d->n,
                             d->n_pattern};
    return prt_hash64(more, sizeof more, 4);
}

static uint64_t hash_all(const struct bake *b, const struct shape *shape, uint64_t sampling)
{
    const struct prt_surface_points *s = b->surface;
    const uint64_t more[] = {s->n_sample, shape->n_vertex, shape->n_triangle, !!b->horizon};
    uint64_t h = prt_hash64(more, sizeof more, sampling);
    h = prt_hash64(shape->position, (size_t)shape->n_vertex * 12, h);
    h = prt_hash64(shape->triangle, (size_t)shape->n_triangle * 12, h);
    h = prt_hash64(s->triangle, (size_t)s->n_sample * 4, h);
    h = prt_hash64(s->inside, (size_t)s->n_sample * 8, h);
    return prt_hash64(s->normal, (size_t)s->n_sample * 12, h);
}

static void write_shape(struct row_store *s, const struct sketch *sketch,
                        const struct shape *shape)
{
    if (prt_ray_store_has(s->own, SLOT_TRIANGLES, 0)) return;
    prt_ray_store_put(s->own, SLOT_SKETCH, 0, sketch, sizeof *sketch, 0);
    prt_ray_store_put(s->own, SLOT_POSITIONS, 0, shape->position, (size_t)shape->n_vertex * 12,
                      0);
    prt_ray_store_put(s->own, SLOT_TRIANGLES, 0, shape->triangle,
                      (size_t)shape->n_triangle * 12, 0);
}

struct row_store *prt_row_store_open(const struct bake *b)
{
    struct row_store *s = b->o.cache && b->surface ? calloc(1, sizeof *s) : NULL;
    if (!s) return NULL;
    const struct prt_mesh *m = prt_scene_model(b->scene);
    const struct shape shape = {m->n_vertex, m->n_triangle, (const float(*)[3])m->position,
                                (const uint32_t(*)[3])m->triangle};
    struct sketch sketch = {.n_vertex = m->n_vertex,
                            .n_triangle = m->n_triangle,
                            .n_sample = b->surface->n_sample,
                            .n_piece = (b->surface->n_sample + 63) / 64};
    s->n_packet = b->directions->n_packet;
    s->sampling = sketch.sampling = hash_sampling(b);
    prt_shape_sketch(&shape, sketch.shape);
    const uint64_t key = hash_all(b, &shape, s->sampling);
    s->own = prt_ray_store_open(b->ctx, b->o.cache, kind, key, b->o.cache_room);
    if (!s->own) {
        prt_row_store_close(s);
        return NULL;
    }
    if (!prt_ray_store_has(s->own, SLOT_LANES, (sketch.n_piece - 1) * 64))
        take_similar(s, b, key, &sketch, &shape);
    write_shape(s, &sketch, &shape);
    return s;
}

void prt_row_store_close(struct row_store *s)
{
    if (!s) return;
    prt_ray_store_close(s->own);
    prt_shape_change_destroy(s->change);
    for (size_t i = 0; i < s->n_piece; i++) prt_free(s->piece[i]);
    free(s->piece);
    free(s->row);
    free(s);
}

// ---- rows

static const struct old_row *find_row(const struct row_store *s, uint64_t place)
{
    const struct old_row key = {.place = place};
    return s->n_row ? bsearch(&key, s->row, s->n_row, sizeof key, by_place) : NULL;
}

static float distance(const float a[3], const float b[3])
{
    float square = 0;
    for (int k = 0; k < 3; k++) square += (a[k] - b[k]) * (a[k] - b[k]);
    return sqrtf(square);
}

static size_t count_set(const uint64_t *set, uint32_t n)
{
    size_t count = 0;
    for (uint32_t k = 0; k < n; k++) count += set[k / 64] >> k % 64 & 1;
    return count;
}

// Takes a row of the other bake, but for the packets that the change may reach.
static bool take_row(const struct row_store *s, const struct row_place *at, uint64_t place,
                     uint16_t *open, uint64_t *fresh)
{
    const struct old_row *old = find_row(s, place);
    float apart = 0;
    if (!old || !prt_lanes_unpack(old->packed, old->bytes, s->n_packet, open)) return false;
    for (int k = 0; k < 3 && at->words; k++)
        apart = fmaxf(apart, distance(at->position, at->corner[k].position));
    memset(fresh, 0, ((size_t)s->n_packet + 63) / 64 * sizeof *fresh);
    prt_shape_change_mark(s->change, at->position, at->face_normal, apart + 2 * at->epsilon,
                          fresh);
    return true;
}

// A whole piece of this very bake.
static bool read_piece(struct row_store *s, uint32_t begin, uint32_t n,
                       const struct row_place *place, uint16_t *open)
{
    size_t bytes = 0, at = 8 + 8 * (size_t)n;
    uint64_t rays, count = 0;
    uint8_t *data = prt_ray_store_get(s->own, SLOT_LANES, begin, &bytes, &rays);
    bool ok = data && bytes >= at;
    if (ok) memcpy(&count, data, sizeof count);
    ok = ok && count == n;
    for (uint32_t i = 0; ok && i < n; i++) {
        uint64_t hash;
        memcpy(&hash, data + 8 + 8 * (size_t)i, sizeof hash);
        const size_t used = prt_lanes_unpack(data + at, bytes - at, s->n_packet,
                                             open + (size_t)i * s->n_packet);
        ok = used && hash == place_hash(s, &place[i]);
        at += used;
    }
    prt_free(data);
    return ok && at == bytes;
}

uint64_t prt_row_store_read(struct row_store *s, uint32_t begin, uint32_t n,
                            const struct row_place *place, uint16_t *open, uint64_t *fresh,
                            bool *kept)
{
    const size_t words = ((size_t)s->n_packet + 63) / 64;
    uint64_t known = 0;
    *kept = read_piece(s, begin, n, place, open);
    if (*kept) {
        memset(fresh, 0, n * words * sizeof *fresh);
        return (uint64_t)n * s->n_packet;
    }
    for (uint32_t i = 0; i < n; i++) {
        uint64_t *set = fresh + i * words;
        uint16_t *row = open + (size_t)i * s->n_packet;
        if (!take_row(s, &place[i], place_hash(s, &place[i]), row, set))
            memset(set, 0xff, words * sizeof *set);
        known += s->n_packet - count_set(set, s->n_packet);
    }
    return known;
}

void prt_row_store_write(struct row_store *s, uint32_t begin, uint32_t n,
                         const struct row_place *place, const uint16_t *open)
{
    const uint64_t count = n;
    uint8_t *data = prt_alloc(8 + n * (8 + prt_lanes_most(s->n_packet)), 1);
    size_t used = 8 + 8 * (size_t)n;
    if (!data) return;
    memcpy(data, &count, sizeof count);
    for (uint32_t i = 0; i < n; i++) {
        const uint64_t hash = place_hash(s, &place[i]);
        memcpy(data + 8 + 8 * (size_t)i, &hash, sizeof hash);
        used += prt_lanes_pack(open + (size_t)i * s->n_packet, s->n_packet, data + used);
    }
    prt_ray_store_put(s->own, SLOT_LANES, begin, data, used, 0);
    prt_free(data);
}
