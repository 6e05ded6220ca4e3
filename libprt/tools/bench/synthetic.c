// SPDX-License-Identifier: MIT
// Made-up transports: random values in the shapes and orders that a bake gives.
#include "synthetic.h"

#include <math.h>
#include <stdlib.h>
#include <string.h>

static float uniform(struct prt_rng *rng, float lo, float hi)
{
    return lo + (hi - lo) * prt_rng_f32(rng);
}

static uint16_t *random_f16(struct prt_rng *rng, uint64_t n, float lo, float hi)
{
    uint16_t *out = prt_alloc(n ? n : 1, 2);
    for (uint64_t i = 0; out && i < n; i++) out[i] = prt_f32_to_f16(uniform(rng, lo, hi));
    return out;
}

static uint16_t *random_u(struct prt_rng *rng, uint64_t n)
{
    uint16_t *out = prt_alloc(n ? n : 1, 2);
    for (uint64_t i = 0; out && i < n; i++)
        out[i] = (uint16_t)(int16_t)uniform(rng, -PRT_U_MOST, PRT_U_MOST);
    return out;
}

// Vertex order in runs of neighbours, as a spatial clustering of a mesh in file order gives:
// the file's vertices are cut into runs and the runs shuffled.
static uint32_t *random_order(struct prt_rng *rng, uint32_t n, uint32_t run)
{
    uint32_t n_run = (n + run - 1) / run, at = 0;
    uint32_t *order = prt_alloc(n, 4), *runs = prt_alloc(n_run, 4);
    if (!order || !runs) {
        prt_free(order);
        order = NULL;
        goto out;
    }
    for (uint32_t i = 0; i < n_run; i++) runs[i] = i;
    for (uint32_t i = n_run - 1; i > 0; i--) {
        uint32_t k = (uint32_t)((uint64_t)prt_rng_u32(rng) * (i + 1) >> 32), swap = runs[i];
        runs[i] = runs[k];
        runs[k] = swap;
    }
    for (uint32_t i = 0; i < n_run; i++)
        for (uint32_t v = runs[i] * run; v < n && v < (runs[i] + 1) * run; v++) order[at++] = v;
out:
    prt_free(runs);
    return order;
}

// A square grid's vertices, numbered by rows, in square patches of `patch` by `patch`.
static uint32_t *grid_order(uint32_t n, uint32_t patch)
{
    uint32_t side = (uint32_t)sqrt((double)n), at = 0, *order = prt_alloc(n, 4);
    if (!order) return NULL;
    for (uint32_t y = 0; y < side; y += patch)
        for (uint32_t x = 0; x < side; x += patch)
            for (uint32_t v = y; v < y + patch && v < side; v++)
                for (uint32_t u = x; u < x + patch && u < side; u++) order[at++] = v * side + u;
    for (; at < n; at++) order[at] = at; // beyond the last whole row
    return order;
}

// Chance that a coefficient is kept: coarse ones nearly always, each finer level (of four
// times as many) six times less, as the largest coefficients of smooth transport fall.
static float keep_chance(uint32_t coef, uint32_t n, float scale)
{
    uint32_t x = coef % n, y = coef / n % n, most = x > y ? x : y;
    if (!most) return 0;
    int level = 31 - __builtin_clz(most);
    float chance = scale * powf(6, (float)-level);
    return chance < 1 ? chance : 1;
}

static float chance_scale(uint32_t n, uint32_t coefs)
{
    double lo = 0, hi = 1e9;
    for (int i = 0; i < 60; i++) {
        double mid = sqrt((lo + 1e-9) * hi), sum = 0;
        for (uint32_t k = 0; k < n * n; k++) sum += 6 * (double)keep_chance(k, n, (float)mid);
        if (sum > coefs) hi = mid;
        else lo = mid;
    }
    return coefs ? (float)lo : 0;
}

// Index sets to choose from, ascending, without scaling coefficients.
struct patterns {
    uint32_t n, *begin, *index;
};

static int make_patterns(struct prt_rng *rng, const struct synthetic_options *o, uint32_t n_row,
                         struct patterns *p)
{
    uint32_t n_coef = 6 * o->cube * o->cube, at = 0;
    // A bake stores what an entry's bytes leave as a second entry, where that pays; low-rank
    // rows alone may have an index twice.
    bool twice = o->coupling == PRT_COUPLE_FULL && o->value == PRT_VALUE_I8;
    float scale = chance_scale(o->cube, o->coefs), *chance = prt_alloc(n_coef, 4);
    p->n = n_row < 64 ? n_row : 64;
    size_t room = (size_t)p->n * (4 * o->coefs + 64);
    p->begin = prt_alloc(p->n + 1, 4);
    p->index = prt_alloc(room, 4);
    if (!p->begin || !p->index || !chance) {
        prt_free(chance);
        return PRT_NOMEM;
    }
    for (uint32_t k = 0; k < n_coef; k++) chance[k] = keep_chance(k, o->cube, scale);
    p->begin[0] = 0;
    for (uint32_t i = 0; i < p->n; i++) {
        for (uint32_t k = 0; k < n_coef && at + 1 < room; k++) {
            if (prt_rng_f32(rng) < chance[k]) p->index[at++] = k;
            else continue;
            if (twice && k % 8 == 3) p->index[at++] = k;
        }
        p->begin[i + 1] = at;
    }
    prt_free(chance);
    return PRT_OK;
}

// Three to seven directions a row, as a bake of a dozen functions keeps, where there are as
// many.
static int random_directions(struct prt_rng *rng, uint32_t n_row, uint32_t n_function,
                             struct prt_rows *r)
{
    uint64_t n_entry = r->begin[n_row];
    uint32_t *direction = prt_alloc(n_row + 1ull, 4);
    uint64_t *value_begin = prt_alloc(n_row + 1ull, 8);
    uint8_t *shift = prt_alloc(n_entry + 1, 1);
    r->direction = direction;
    r->value_begin = value_begin;
    r->shift = shift;
    if (!direction || !value_begin || !shift) return PRT_NOMEM;
    direction[0] = 0;
    value_begin[0] = 0;
    for (uint32_t i = 0; i < n_row; i++) {
        uint32_t n = 3 + prt_rng_u32(rng) % 5;
        if (n > n_function || i % 9 == 8) n = n_function < 40 ? n_function : 40;
        direction[i + 1] = direction[i] + n;
        value_begin[i + 1] = value_begin[i] + n * (r->begin[i + 1] - r->begin[i]);
    }
    for (uint64_t i = 0; i < n_entry; i++) shift[i] = prt_rng_u32(rng) >> 29;
    r->mix = random_f16(rng, (uint64_t)direction[n_row] * n_function, -1, 1);
    return r->mix ? PRT_OK : PRT_NOMEM;
}

static int random_rows(struct prt_rng *rng, const struct synthetic_options *o, uint32_t n_row,
                       uint32_t n_function, struct prt_rows *r);

// Made as halves and turned into pairs.
static int random_pairs(struct prt_rng *rng, const struct synthetic_options *o, uint32_t n_row,
                        uint32_t n_function, struct prt_rows *r)
{
    struct synthetic_options halves = *o;
    struct prt_rows from;
    halves.value = PRT_VALUE_F16;
    int status = random_rows(rng, &halves, n_row, n_function, &from);
    if (!status) status = prt_rows_pair(&from, r);
    prt_rows_finish(&from);
    return status;
}

static int random_rows(struct prt_rng *rng, const struct synthetic_options *o, uint32_t n_row,
                       uint32_t n_function, struct prt_rows *r)
{
    if (o->value == PRT_VALUE_PAIR) return random_pairs(rng, o, n_row, n_function, r);
    uint32_t n_coef = 6 * o->cube * o->cube;
    struct patterns p = {0};
    uint64_t *begin = prt_alloc(n_row + 1ull, 8);
    int status = make_patterns(rng, o, n_row, &p);
    *r = (struct prt_rows){.n_row = n_row,
                           .n_function = n_function,
                           .n_coef = n_coef,
                           .value = o->value,
                           .index_bytes = n_coef > 65536 ? 4 : 2,
                           .begin = begin};
    if (!begin || status) goto out;
    begin[0] = 0;
    for (uint32_t i = 0; i < n_row; i++) {
        uint32_t k = (uint32_t)(i * 2654435761ull >> 20) % p.n;
        begin[i + 1] = begin[i] + p.begin[k + 1] - p.begin[k];
    }
    const bool mixed = o->value == PRT_VALUE_I8 && o->coupling == PRT_COUPLE_FULL;
    uint64_t n_entry = begin[n_row], n_value = n_entry * n_function, n_scale;
    char *index = prt_alloc(n_entry + 1, r->index_bytes);
    r->index = index;
    r->scaling = random_f16(rng, 6ull * n_row * n_function, 0, 0.02f);
    status = index && r->scaling ? PRT_OK : PRT_NOMEM;
    for (uint32_t i = 0; i < n_row && !status; i++) {
        uint32_t k = (uint32_t)(i * 2654435761ull >> 20) % p.n;
        for (uint64_t e = begin[i]; e < begin[i + 1]; e++) {
            uint32_t x = p.index[p.begin[k] + (e - begin[i])];
            if (r->index_bytes == 2) memcpy(index + 2 * e, &(uint16_t){(uint16_t)x}, 2);
            else memcpy(index + 4 * e, &x, 4);
        }
    }
    if (!status && o->value == PRT_VALUE_F16) {
        r->entry = random_f16(rng, n_value, -0.02f, 0.02f);
        status = r->entry ? PRT_OK : PRT_NOMEM;
    } else if (!status) {
        if (mixed) status = random_directions(rng, n_row, n_function, r);
        n_scale = mixed && !status ? r->direction[n_row] : (uint64_t)n_row * n_function;
        if (mixed && !status) n_value = r->value_begin[n_row];
        int8_t *entry = prt_alloc(n_value + 1, 1);
        float *scale = prt_alloc(n_scale + 1, 4);
        r->entry = entry;
        r->scale = scale;
        if (!entry || !scale) status = PRT_NOMEM;
        for (uint64_t i = 0; i < n_value && !status; i++)
            entry[i] = (int8_t)(prt_rng_u32(rng) >> 24);
        for (uint64_t i = 0; i < n_scale && !status; i++) scale[i] = uniform(rng, 1e-5f, 2e-4f);
    }
out:
    prt_free(p.begin);
    prt_free(p.index);
    return status;
}

static int random_clusters(struct prt_rng *rng, const struct synthetic_options *o,
                           struct prt_tensor *t)
{
    uint32_t rank = o->storage == PRT_STORAGE_RADIAL ? t->n_function : o->rank;
    uint64_t wide = o->storage == PRT_STORAGE_RADIAL ? 3 : 1;
    struct prt_cluster *cluster = prt_calloc(o->n_cluster, sizeof *cluster);
    t->cluster = cluster;
    t->n_cluster = o->n_cluster;
    if (!cluster) return PRT_NOMEM;
    uint32_t at = 0, row = 0;
    for (uint32_t i = 0; i < o->n_cluster; i++) {
        uint32_t end = i + 1 == o->n_cluster
                           ? o->n_vertex
                           : (uint32_t)((uint64_t)o->n_vertex * (i + 1) / o->n_cluster) - i % 7;
        cluster[i] = (struct prt_cluster){.vertex_begin = at,
                                          .n_vertex = end - at,
                                          .row_begin = wide == 1 ? row : 0,
                                          .rank = rank,
                                          .u_begin = t->u_count};
        t->u_count += (((uint64_t)cluster[i].n_vertex + 15) & ~15ull) *
                      (wide == 1 ? (rank + 1ull) & ~1ull : rank * wide);
        at = end;
        row += rank;
    }
    uint16_t *u = wide == 1 ? random_u(rng, t->u_count) : random_f16(rng, t->u_count, 0, 1);
    t->u = u;
    if (!u) return PRT_NOMEM;
    if (wide == 3) {
        float *scale = prt_alloc(3ull * o->n_cluster * rank, sizeof *scale);
        t->u_scale = scale;
        if (!scale) return PRT_NOMEM;
        for (uint64_t k = 0; k < 3ull * o->n_cluster * rank; k++)
            scale[k] = ldexpf(1, (int)(k % 5) - 2);
    }
    for (uint32_t i = 0; i < o->n_cluster; i++) {
        const struct prt_cluster *c = &cluster[i];
        const uint64_t padded = (c->n_vertex + 15ull) & ~15ull, side = wide == 1 ? 2 : 1;
        const uint64_t there = side * c->n_vertex, all = side * padded;
        const uint64_t rows = wide == 1 ? (rank + 1) / 2 : rank * wide;
        for (uint64_t k = 0; k < rows; k++)
            memset(u + c->u_begin + k * all + there, 0, 2 * (all - there));
        for (uint64_t v = 0; wide == 1 && rank % 2 && v < padded; v++)
            u[c->u_begin + (rows - 1) * all + 2 * v + 1] = 0;
    }
    return wide == 1 ? random_rows(rng, o, row, t->n_function, &t->rows) : PRT_OK;
}

int synthetic_tensor(const struct synthetic_options *o, struct prt_tensor *out)
{
    struct prt_rng rng;
    struct prt_tensor t = {.term = o->term,
                           .storage = o->storage,
                           .coupling = o->coupling,
                           .n_vertex = o->n_vertex,
                           .n_phase = o->n_phase};
    bool full = o->coupling == PRT_COUPLE_FULL || o->storage == PRT_STORAGE_RADIAL;
    int status = PRT_NOMEM;
    prt_rng_init(&rng, o->seed, 1);
    t.n_radial = full ? o->n_radial : 0;
    t.n_function = full ? o->n_radial * o->n_phase : 3 * o->n_phase;
    t.order = o->patch ? grid_order(o->n_vertex, o->patch)
                       : random_order(&rng, o->n_vertex, o->run ? o->run : 16);
    if (t.order && o->storage == PRT_STORAGE_SPARSE)
        status = random_rows(&rng, o, o->n_vertex, t.n_function, &t.rows);
    else if (t.order) status = random_clusters(&rng, o, &t);
    if (status) synthetic_tensor_finish(&t);
    else *out = t;
    return status;
}

static void drop(const void *p)
{
    prt_free((void *)(uintptr_t)p);
}

void synthetic_tensor_finish(struct prt_tensor *t)
{
    drop(t->order);
    drop(t->cluster);
    drop(t->u);
    drop(t->u_scale);
    drop(t->rows.begin);
    drop(t->rows.index);
    drop(t->rows.entry);
    drop(t->rows.scale);
    drop(t->rows.shift);
    drop(t->rows.direction);
    drop(t->rows.value_begin);
    drop(t->rows.mix);
    drop(t->rows.scaling);
    drop(t->knot);
    drop(t->basis);
    drop(t->eta);
    *t = (struct prt_tensor){0};
}

int synthetic_mesh(uint32_t n, bool two_surfaces, struct prt_mesh *out)
{
    struct prt_mesh m = {.n_vertex = n,
                         .n_weld = n,
                         .n_block = 1,
                         .n_object = 1,
                         .n_surface = 1,
                         .mm_per_unit = 1};
    uint32_t side = (uint32_t)sqrt((double)n), first = two_surfaces ? n - n / 4 : n;
    m.n_triangle = n < 3 ? 0 : n - 2;
    m.n_block = m.n_surface = two_surfaces ? 2 : 1;
    m.position = prt_calloc(n, sizeof *m.position);
    m.normal = prt_calloc(n, sizeof *m.normal);
    m.weld = prt_calloc(n, sizeof *m.weld);
    m.triangle = prt_calloc(m.n_triangle + 1, sizeof *m.triangle);
    m.block = prt_calloc(m.n_block, sizeof *m.block);
    m.surface = prt_calloc(m.n_surface, sizeof *m.surface);
    if (!m.position || !m.normal || !m.weld || !m.triangle || !m.block || !m.surface) {
        synthetic_mesh_finish(&m);
        return PRT_NOMEM;
    }
    for (uint32_t v = 0; v < n; v++) {
        float x = (float)(v % (side ? side : 1)), y = (float)(v / (side ? side : 1));
        float a = 0.3f * sinf(x), b = 0.3f * cosf(y), l = sqrtf(1 + a * a + b * b);
        memcpy(m.position[v], (float[3]){x, a + b, y}, 12);
        memcpy(m.normal[v], (float[3]){a / l, 1 / l, b / l}, 12);
        m.weld[v] = v;
    }
    for (uint32_t i = 0; i < m.n_triangle; i++)
        memcpy(m.triangle[i], (uint32_t[3]){i, i + 1, i + 2}, 12);
    for (uint32_t i = 0; i < m.n_block; i++) {
        struct prt_surface *s = &m.surface[i];
        *s = (struct prt_surface){.name = "made up",
                                  .translucent = !i,
                                  .roughness = 0.5f,
                                  .base_color = {0.8f, 0.6f, 0.4f, 1},
                                  .ior = 1.5f};
        m.block[i] = (struct prt_block){.surface = i,
                                        .vertex_begin = i ? first : 0,
                                        .n_vertex = i ? n - first : first,
                                        .triangle_begin = i ? m.n_triangle : 0,
                                        .n_triangle = i ? 0 : m.n_triangle};
    }
    *out = m;
    return PRT_OK;
}

void synthetic_mesh_finish(struct prt_mesh *m)
{
    prt_free(m->position);
    prt_free(m->normal);
    prt_free(m->weld);
    prt_free(m->triangle);
    prt_free(m->block);
    prt_free(m->surface);
    *m = (struct prt_mesh){0};
}

int synthetic_light(uint32_t cube, uint64_t seed, struct prt_light *out)
{
    struct prt_rng rng;
    uint32_t n_coef = 6 * cube * cube;
    float *coef = prt_calloc(4ull * n_coef, sizeof *coef);
    if (!coef) return PRT_NOMEM;
    prt_rng_init(&rng, seed, 2);
    for (uint32_t i = 0; i < n_coef; i++)
        for (int c = 0; c < 3; c++)
            coef[4ull * i + c] =
                i % (cube * cube) ? uniform(&rng, -1, 1) : uniform(&rng, 10, 90);
    *out = (struct prt_light){cube, coef};
    return PRT_OK;
}

int synthetic_bunny(const struct prt_context *ctx, const char *path, bool quick, uint64_t seed)
{
    struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                  .value = PRT_VALUE_PAIR,
                                  .n_vertex = quick ? 3000 : 34835,
                                  .n_cluster = 64,
                                  .rank = 40,
                                  .n_phase = 1,
                                  .cube = 32,
                                  .coefs = 512,
                                  .seed = seed};
    const struct prt_material material = {.eta = 1.3f};
    struct prt_transport t = {.cube = 32, .n_tensor = 1, .media = prt_media_one(&material)};
    int status = synthetic_mesh(o.n_vertex, false, &t.mesh);
    if (!status) status = synthetic_tensor(&o, &t.tensor[0]);
    if (!status) status = prt_file_write(ctx, path, &t);
    synthetic_tensor_finish(&t.tensor[0]);
    synthetic_mesh_finish(&t.mesh);
    return status;
}
