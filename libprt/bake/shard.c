// SPDX-License-Identifier: MIT
// Parts of a bake (prt bake --shard I/N). A part is a header and one record for each slot and
// own cluster: the cluster's factors, sparse rows or radial columns before packing. The
// assembled file therefore equals, byte for byte, the file of a bake in one process.
#include "bake/shard.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { MAX_VIEW = 8, PART_PATH = PATH_MAX + 64 };
static const uint32_t last = UINT32_MAX; // cluster of a part's last record
static const char magic[8] = "PRTPART1";

struct part_header {
    char magic[8];
    uint64_t key;
    uint32_t shard, n_shard;
};

struct record {
    uint32_t slot, cluster;     // `last` ends the part
    uint32_t rank, n_component; // of a factored cluster
    uint64_t rays;              // single scattering's; of the last record: pass 1's
    uint64_t bytes, hash;       // of the data behind the record
};

struct view {
    void *at;
    size_t bytes;
};

struct place { // of a record in a part
    struct record record;
    int fd;
    uint64_t at;
};

struct shard {
    char path[PATH_MAX]; // OUT.prt
    uint64_t key;
    uint32_t index, n;
    uint32_t slot;
    bool assembling, done;
    struct prt_writer *writer;
    int *fd;             // [n] parts, open while assembling
    struct place *place; // of every record of every part
    size_t n_place, capacity;
};

static void part_path(const struct shard *s, uint32_t i, char out[PART_PATH])
{
    snprintf(out, PART_PATH, "%s.%u-of-%u.part", s->path, i, s->n);
}

// Part 0 under another name: the mark of the one process that assembles.
static void claimed_path(const struct shard *s, char out[PART_PATH])
{
    snprintf(out, PART_PATH, "%s.0-of-%u.assembling", s->path, s->n);
}

static bool read_at(int fd, void *to, size_t n, uint64_t at)
{
    for (char *p = to; n;) {
        ssize_t got = pread(fd, p, n, (off_t)at);
        if (got < 0 && errno == EINTR) continue;
        if (got <= 0) return false;
        p += got, at += (size_t)got, n -= (size_t)got;
    }
    return true;
}

static int add_place(struct shard *s, const struct place *place)
{
    if (s->n_place == s->capacity) {
        size_t more = 2 * s->capacity + 64;
        struct place *grown = realloc(s->place, more * sizeof *grown);
        if (!grown) return PRT_NOMEM;
        s->place = grown;
        s->capacity = more;
    }
    s->place[s->n_place++] = *place;
    return PRT_OK;
}

// Whether fd is part i of this bake and complete. `list`: adds its records to s->place.
static bool part_whole(struct shard *s, int fd, uint32_t i, bool list)
{
    struct part_header h;
    struct stat st;
    if (fstat(fd, &st) || !read_at(fd, &h, sizeof h, 0)) return false;
    if (memcmp(h.magic, magic, sizeof magic) || h.key != s->key || h.shard != i ||
        h.n_shard != s->n)
        return false;
    uint64_t at = sizeof h, size = (uint64_t)st.st_size;
    for (;;) {
        struct place p = {.fd = fd};
        if (!read_at(fd, &p.record, sizeof p.record, at)) return false;
        p.at = at + sizeof p.record;
        if (p.record.bytes > size - p.at) return false;
        if (list && add_place(s, &p)) return false;
        at = p.at + p.record.bytes;
        if (p.record.cluster == last) return at == size;
    }
}

int prt_shard_create(struct bake *b, const char *out_path, uint64_t key)
{
    char path[PART_PATH];
    if (b->o.n_shard < 2) return PRT_OK;
    struct shard *s = calloc(1, sizeof *s);
    if (!s) return PRT_NOMEM;
    b->shard = s;
    s->index = b->o.shard, s->n = b->o.n_shard, s->key = key;
    if (snprintf(s->path, sizeof s->path, "%s", out_path) >= PATH_MAX)
        return prt_fail(b->ctx, PRT_IO, "%.80s...: the path is too long", out_path);
    part_path(s, s->index, path);
    int fd = open(path, O_RDONLY | O_CLOEXEC);
    if (fd >= 0) {
        s->done = part_whole(s, fd, s->index, false);
        close(fd);
        if (s->done) return PRT_OK;
    }
    struct part_header h = {.key = key, .shard = s->index, .n_shard = s->n};
    memcpy(h.magic, magic, sizeof magic);
    int status = prt_writer_open(b->ctx, path, &s->writer);
    return status ? status : prt_writer_write(s->writer, &h, sizeof h);
}

static void close_parts(struct shard *s)
{
    for (uint32_t i = 0; s->fd && i < s->n; i++)
        if (s->fd[i] >= 0) close(s->fd[i]);
    free(s->fd);
    s->fd = NULL;
    s->n_place = 0;
}

// Opens every part; returns the number that is missing, incomplete or of another bake.
static uint32_t open_parts(const struct bake *b, struct shard *s)
{
    char path[PART_PATH];
    uint32_t missing = 0;
    for (uint32_t i = 0; i < s->n; i++) {
        part_path(s, i, path);
        s->fd[i] = open(path, O_RDONLY | O_CLOEXEC);
        if (s->fd[i] >= 0 && part_whole(s, s->fd[i], i, true)) continue;
        if (s->fd[i] >= 0)
            prt_log(
                b->ctx, PRT_LOG_WARNING,
                "%s is damaged or belongs to a bake with other settings: run that shard again",
                path);
        missing++;
    }
    return missing;
}

int prt_shard_close(struct bake *b, uint32_t *missing)
{
    struct shard *s = b->shard;
    char path[PART_PATH], claimed[PART_PATH];
    *missing = 0;
    if (!s) return PRT_OK;
    if (s->writer) {
        struct record end = {.slot = s->slot, .cluster = last, .rays = b->rays_irradiance};
        int status = prt_writer_write(s->writer, &end, sizeof end);
        if (status) prt_writer_abandon(s->writer);
        else status = prt_writer_finish(s->writer);
        s->writer = NULL;
        if (status) return status;
    }
    if (!(s->fd = malloc(s->n * sizeof *s->fd))) return PRT_NOMEM;
    *missing = open_parts(b, s);
    if (*missing) {
        close_parts(s);
        return PRT_OK;
    }
    part_path(s, 0, path);
    claimed_path(s, claimed);
    if (rename(path, claimed)) {
        close_parts(s);
        *missing = UINT32_MAX; // another process was faster and assembles
        return PRT_OK;
    }
    s->assembling = true, s->done = false, s->slot = 0;
    for (size_t i = 0; i < s->n_place; i++)
        if (s->place[i].record.cluster == last) b->rays_irradiance = s->place[i].record.rays;
    return PRT_OK;
}

void prt_shard_destroy(struct bake *b, bool written)
{
    struct shard *s = b->shard;
    char path[PART_PATH], claimed[PART_PATH];
    if (!s) return;
    if (s->writer) prt_writer_abandon(s->writer);
    close_parts(s);
    if (s->assembling) {
        part_path(s, 0, path);
        claimed_path(s, claimed);
        if (written) unlink(claimed);
        else if (rename(claimed, path)) // kept for the next to try
            prt_log(b->ctx, PRT_LOG_WARNING, "%s: %s", claimed, strerror(errno));
        for (uint32_t i = 1; written && i < s->n; i++) {
            part_path(s, i, path);
            unlink(path);
        }
    }
    free(s->place);
    free(s);
    b->shard = NULL;
}

bool prt_shard_assembling(const struct bake *b)
{
    return b->shard && b->shard->assembling;
}

bool prt_shard_done(const struct bake *b)
{
    return b->shard && b->shard->done;
}

struct own {
    const struct shard *s;
    prt_loop_fn range;
    void *arg;
};

static int own_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct own *own = arg;
    int status = PRT_OK;
    for (size_t i = begin; status == PRT_OK && i < end; i++) {
        size_t c = i * own->s->n + own->s->index;
        status = own->range(own->arg, c, c + 1, worker);
    }
    return status;
}

int prt_shard_for(struct bake *b, const char *stage, prt_loop_fn range, void *arg)
{
    const struct shard *s = b->shard;
    size_t n = b->clusters->n_cluster;
    if (!s) return prt_parallel_for(b->ctx, stage, n, 1, range, arg);
    if (s->assembling) return PRT_OK;
    struct own own = {s, range, arg};
    n = n > s->index ? (n - s->index - 1) / s->n + 1 : 0;
    return n ? prt_parallel_for(b->ctx, stage, n, 1, own_range, &own) : PRT_OK;
}

static int write_record(struct bake *b, struct record *r, const struct view *view, unsigned n)
{
    struct shard *s = b->shard;
    r->slot = s->slot;
    r->rays = b->rays_single[r->cluster];
    r->bytes = r->hash = 0;
    for (unsigned i = 0; i < n; i++) {
        r->bytes += view[i].bytes;
        r->hash = prt_hash64(view[i].at, view[i].bytes, r->hash);
    }
    int status = prt_writer_write(s->writer, r, sizeof *r);
    for (unsigned i = 0; status == PRT_OK && i < n; i++)
        status = prt_writer_write(s->writer, view[i].at, view[i].bytes);
    return status;
}

static int damaged(const struct bake *b, uint32_t cluster)
{
    char path[PART_PATH];
    part_path(b->shard, cluster % b->shard->n, path);
    return prt_fail(b->ctx, PRT_FORMAT, "%s is damaged: run shard %u/%u again", path,
                    cluster % b->shard->n, b->shard->n);
}

static const struct place *find(const struct shard *s, uint32_t cluster)
{
    for (size_t i = 0; i < s->n_place; i++)
        if (s->place[i].record.slot == s->slot && s->place[i].record.cluster == cluster)
            return &s->place[i];
    return NULL;
}

static int read_record(struct bake *b, const struct place *p, const struct view *view,
                       unsigned n)
{
    uint64_t at = p->at, bytes = 0, hash = 0;
    for (unsigned i = 0; i < n; i++) bytes += view[i].bytes;
    if (bytes != p->record.bytes) return damaged(b, p->record.cluster);
    for (unsigned i = 0; i < n; i++) {
        if (!read_at(p->fd, view[i].at, view[i].bytes, at))
            return damaged(b, p->record.cluster);
        at += view[i].bytes;
        hash = prt_hash64(view[i].at, view[i].bytes, hash);
    }
    if (hash != p->record.hash) return damaged(b, p->record.cluster);
    b->rays_single[p->record.cluster] = p->record.rays;
    return PRT_OK;
}

// The arrays of a factored cluster that packing reads, by its rank.
static unsigned factored_views(const struct bake *b, const struct factored *f, uint32_t J,
                               struct view v[MAX_VIEW])
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

static int allocate_factored(const struct bake *b, uint32_t J, struct factored *f)
{
    size_t rank = f->rank, n_coef = b->directions->n_coef;
    size_t wide = f->n_component ? f->n_component : J;
    f->u = prt_alloc(rank * f->n_vertex + 1, sizeof *f->u);
    f->b = prt_alloc(rank * wide * n_coef + 1, sizeof *f->b);
    f->scale = prt_alloc(rank * wide + 1, sizeof *f->scale);
    f->energy = prt_alloc(rank * n_coef + 1, sizeof *f->energy);
    f->tail = calloc(rank + 1, sizeof *f->tail);
    if (!f->u || !f->b || !f->scale || !f->energy || !f->tail) return PRT_NOMEM;
    if (!f->n_component) return PRT_OK;
    f->component = prt_alloc(rank * wide * J + 1, sizeof *f->component);
    f->scaling = prt_alloc(rank * 6 * J + 1, sizeof *f->scaling);
    f->width = calloc(rank + 1, 1);
    f->limit = calloc(rank + 1, sizeof *f->limit);
    f->count = calloc(rank + 1, sizeof *f->count);
    return f->component && f->scaling && f->width && f->limit && f->count ? PRT_OK : PRT_NOMEM;
}

static int read_factored(struct bake *b, uint32_t c, uint32_t J)
{
    const struct place *p = find(b->shard, c);
    struct factored *f = &b->factored[c];
    struct view view[MAX_VIEW];
    if (!p) return PRT_OK; // a cluster without rows in this slot
    uint32_t n_vertex = b->clusters->cluster[c].n_vertex;
    uint32_t most = J < MAX_COMPONENTS ? J : MAX_COMPONENTS;
    if (p->record.rank > n_vertex || p->record.n_component > most) return damaged(b, c);
    prt_factored_finish(f);
    f->n_vertex = n_vertex, f->rank = p->record.rank, f->n_component = p->record.n_component;
    int status = allocate_factored(b, J, f);
    return status ? status : read_record(b, p, view, factored_views(b, f, J, view));
}

int prt_shard_factored(struct bake *b, uint32_t n_function, bool *part)
{
    struct shard *s = b->shard;
    struct view view[MAX_VIEW];
    int status = PRT_OK;
    *part = s && !s->assembling;
    if (!s) return PRT_OK;
    for (uint32_t c = 0; status == PRT_OK && c < b->clusters->n_cluster; c++) {
        const struct factored *f = &b->factored[c];
        struct record r = {.cluster = c, .rank = f->rank, .n_component = f->n_component};
        if (s->assembling) status = read_factored(b, c, n_function);
        else if (f->tail)
            status = write_record(b, &r, view, factored_views(b, f, n_function, view));
    }
    s->slot++;
    return status;
}

int prt_shard_sparse(struct bake *b, bool *part)
{
    struct shard *s = b->shard;
    int status = PRT_OK;
    *part = s && !s->assembling;
    if (!s) return PRT_OK;
    for (uint32_t c = 0; status == PRT_OK && c < b->clusters->n_cluster; c++) {
        struct sparse_rows rows[4];
        struct view view[4];
        const struct place *p = find(s, c);
        struct record r = {.cluster = c};
        prt_sparse_builder_rows(b->sparse, c, rows);
        for (int i = 0; i < 4; i++) view[i] = (struct view){rows[i].at, rows[i].bytes};
        if (s->assembling) status = p ? read_record(b, p, view, 4) : damaged(b, c);
        else if (c % s->n == s->index) status = write_record(b, &r, view, 4);
    }
    s->slot++;
    return status;
}

int prt_shard_radial(struct bake *b, struct prt_tensor *t)
{
    struct shard *s = b->shard;
    int status = PRT_OK;
    if (!s) return PRT_OK;
    for (uint32_t c = 0; status == PRT_OK && c < t->n_cluster; c++) {
        const struct prt_cluster *cluster = &t->cluster[c];
        uint16_t *u = (uint16_t *)(uintptr_t)t->u + cluster->u_begin;
        size_t padded = (cluster->n_vertex + 15) / 16 * 16;
        struct view view = {u, (size_t)cluster->rank * 3 * padded * sizeof *u};
        const struct place *p = find(s, c);
        struct record r = {.cluster = c};
        if (s->assembling) status = p ? read_record(b, p, &view, 1) : damaged(b, c);
        else if (c % s->n == s->index) status = write_record(b, &r, &view, 1);
    }
    s->slot++;
    return status;
}
