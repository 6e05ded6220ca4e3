// SPDX-License-Identifier: MIT
// The arrays of one finished cluster, by storage, and their records.
#include "bake/cluster_records.h"
#include "bake/walks.h"

#include <errno.h>
#include <stdlib.h>
#include <string.h>
#include <unistd.h>

bool prt_read_at(int fd, void *to, size_t n, uint64_t at)
{
    for (char *p = to; n;) {
        ssize_t got = pread(fd, p, n, (off_t)at);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return false;
        p += got, at += (size_t)got, n -= (size_t)got;
    }
    return true;
}

bool prt_write_at(int fd, const void *bytes, size_t n, uint64_t at)
{
    for (const char *p = bytes; n;) {
        ssize_t put = pwrite(fd, p, n, (off_t)at);
        if (put < 0 && errno == EINTR) continue;
        if (put <= 0) return false;
        p += put, at += (size_t)put, n -= (size_t)put;
    }
    return true;
}

// The arrays of a factored cluster that packing reads, by its rank.
static unsigned factored_views(const struct bake *b, const struct factored *f, uint32_t J,
                               struct view v[RECORD_VIEWS])
{
    size_t rank = f->rank, n_coef = b->directions->n_coef;
    size_t wide = f->n_component ? f->n_component : J;
    unsigned n = 0;
    v[n++] = (struct view){f->u, rank * f->n_vertex * sizeof *f->u};
    v[n++] = (struct view){f->b, rank * wide * n_coef * sizeof *f->b};
    v[n++] = (struct view){f->scale, rank * wide * sizeof *f->scale};
    v[n++] = (struct view){f->energy, rank * n_coef * sizeof *f->energy};
    v[n++] = (struct view){f->tail, (rank + 1) * sizeof *f->tail};
    if (f->n_component) {
        v[n++] = (struct view){f->component, rank * wide * J * sizeof *f->component};
        v[n++] = (struct view){f->scaling, rank * 6 * J * sizeof *f->scaling};
    }
    return n;
}

static bool allocate_factored(const struct bake *b, uint32_t J, struct factored *f)
{
    size_t rank = f->rank, n_coef = b->directions->n_coef;
    size_t wide = f->n_component ? f->n_component : J;
    f->u = prt_alloc(rank * f->n_vertex + 1, sizeof *f->u);
    f->b = prt_alloc(rank * wide * n_coef + 1, sizeof *f->b);
    f->scale = prt_alloc(rank * wide + 1, sizeof *f->scale);
    f->energy = prt_alloc(rank * n_coef + 1, sizeof *f->energy);
    f->tail = calloc(rank + 1, sizeof *f->tail);
    if (!f->u || !f->b || !f->scale || !f->energy || !f->tail) return false;
    if (!f->n_component) return true;
    f->component = prt_alloc(rank * wide * J + 1, sizeof *f->component);
    f->scaling = prt_alloc(rank * 6 * J + 1, sizeof *f->scaling);
    f->width = calloc(rank + 1, 1);
    f->limit = calloc(rank + 1, sizeof *f->limit);
    f->count = calloc(rank + 1, sizeof *f->count);
    return f->component && f->scaling && f->width && f->limit && f->count;
}

static unsigned sparse_views(const struct bake *b, uint32_t cluster, struct view v[4])
{
    struct sparse_rows rows[4];
    prt_sparse_builder_rows(b->sparse, cluster, rows);
    for (int i = 0; i < 4; i++) v[i] = (struct view){rows[i].at, rows[i].bytes};
    return 4;
}

static unsigned radial_views(const struct prt_tensor *t, uint32_t c, struct view v[2])
{
    const struct prt_cluster *cluster = &t->cluster[c];
    uint16_t *u = (uint16_t *)(uintptr_t)t->u + cluster->u_begin;
    size_t padded = (cluster->n_vertex + 15) / 16 * 16;
    float *scale = (float *)(uintptr_t)t->u_scale + (size_t)c * t->n_function * 3;
    v[0] = (struct view){u, (size_t)cluster->rank * 3 * padded * sizeof *u};
    v[1] = (struct view){scale, (size_t)cluster->rank * 3 * sizeof *scale};
    return 2;
}

unsigned prt_cluster_views(const struct bake *b, const struct slot *slot, uint32_t c,
                           struct record *r, struct view v[RECORD_VIEWS])
{
    *r = (struct record){.cluster = c, .rays = b->rays_single[c]};
    if (b->walk) memcpy(r->noise, b->walk->noise[c], sizeof r->noise);
    if (slot->kind == SLOT_SPARSE) return sparse_views(b, c, v);
    if (slot->kind == SLOT_RADIAL) return radial_views(slot->tensor, c, v);
    const struct factored *f = &b->factored[c];
    r->rank = f->rank, r->n_component = f->n_component;
    return f->tail ? factored_views(b, f, slot->n_function, v) : 0;
}

bool prt_cluster_room(struct bake *b, const struct slot *slot, const struct record *r,
                      struct view v[RECORD_VIEWS], unsigned *n)
{
    uint32_t c = r->cluster, J = slot->n_function;
    size_t bytes = 0;
    if (c >= b->clusters->n_cluster) return false;
    if (slot->kind == SLOT_FACTORED) {
        struct factored *f = &b->factored[c];
        uint32_t n_vertex = b->clusters->cluster[c].n_vertex;
        uint32_t most = J < MAX_COMPONENTS ? J : MAX_COMPONENTS;
        if (r->rank > n_vertex || r->n_component > most) return false;
        prt_factored_finish(f);
        f->n_vertex = n_vertex, f->rank = r->rank, f->n_component = r->n_component;
        if (!allocate_factored(b, J, f)) return false;
        *n = factored_views(b, f, J, v);
    } else {
        *n = slot->kind == SLOT_SPARSE ? sparse_views(b, c, v)
                                       : radial_views(slot->tensor, c, v);
    }
    for (unsigned i = 0; i < *n; i++) bytes += v[i].bytes;
    return bytes == r->bytes;
}

void prt_record_sign(struct record *r, const struct view *view, unsigned n)
{
    r->bytes = r->hash = 0;
    for (unsigned i = 0; i < n; i++) {
        r->bytes += view[i].bytes;
        r->hash = prt_hash64(view[i].at, view[i].bytes, r->hash);
    }
    r->check = prt_hash64(r, offsetof(struct record, check), 1);
}

bool prt_record_whole(const struct record *r)
{
    return r->check == prt_hash64(r, offsetof(struct record, check), 1);
}

bool prt_record_read(const struct record *r, int fd, uint64_t at, const struct view *view,
                     unsigned n)
{
    uint64_t hash = 0;
    for (unsigned i = 0; i < n; i++) {
        if (!prt_read_at(fd, view[i].at, view[i].bytes, at)) return false;
        at += view[i].bytes;
        hash = prt_hash64(view[i].at, view[i].bytes, hash);
    }
    return hash == r->hash;
}
