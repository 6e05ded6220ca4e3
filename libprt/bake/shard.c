// SPDX-License-Identifier: MIT
// Parts of a bake (prt bake --shard I/N). A part is a header and one record for each slot and
// own cluster: the cluster's factors, sparse rows or radial columns before packing. The
// assembled file therefore equals, byte for byte, the file of a bake in one process.
#include "bake/shard.h"
#include "bake/spill.h"
#include "bake/walks.h"

#include "bake/checkpoint.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

enum { PART_PATH = PATH_MAX + 64 };
static const uint32_t last = UINT32_MAX; // cluster of a part's last record
static const char magic[8] = "PRTPART2";

struct part_header {
    char magic[8];
    uint64_t key;
    uint32_t shard, n_shard;
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
    if (fstat(fd, &st) || !prt_read_at(fd, &h, sizeof h, 0)) return false;
    if (memcmp(h.magic, magic, sizeof magic) || h.key != s->key || h.shard != i ||
        h.n_shard != s->n)
        return false;
    uint64_t at = sizeof h, size = (uint64_t)st.st_size;
    for (;;) {
        struct place p = {.fd = fd};
        if (!prt_read_at(fd, &p.record, sizeof p.record, at) || !prt_record_whole(&p.record))
            return false;
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
        struct record end = {.slot = s->slot, .cluster = last};
        prt_record_sign(&end, NULL, 0);
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

static int write_record(struct bake *b, struct record *r, const struct view *view, unsigned n)
{
    struct shard *s = b->shard;
    r->slot = s->slot;
    prt_record_sign(r, view, n);
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

static int read_cluster(struct bake *b, const struct slot *slot, uint32_t c)
{
    const struct place *p = find(b->shard, c);
    struct view view[RECORD_VIEWS];
    unsigned n;
    // A factored cluster without rows in this slot has no record.
    if (!p) return slot->kind == SLOT_FACTORED ? PRT_OK : damaged(b, c);
    if (!prt_cluster_room(b, slot, &p->record, view, &n) ||
        !prt_record_read(&p->record, p->fd, p->at, view, n))
        return damaged(b, c);
    if (slot->kind == SLOT_FACTORED)
        prt_spill_factored(b->spill, &b->factored[c], slot->n_function, b->directions->n_coef);
    b->rays_single[c] = p->record.rays;
    if (b->walk) memcpy(b->walk->noise[c], p->record.noise, sizeof p->record.noise);
    return PRT_OK;
}

static int write_cluster(struct bake *b, const struct slot *slot, uint32_t c)
{
    struct record r;
    struct view view[RECORD_VIEWS];
    unsigned n = prt_cluster_views(b, slot, c, &r, view);
    return n ? write_record(b, &r, view, n) : PRT_OK;
}

int prt_shard_for(struct bake *b, const char *stage, prt_loop_fn range, void *arg,
                  const struct slot *slot, bool *part)
{
    struct shard *s = b->shard;
    int status = PRT_OK;
    *part = s && !s->assembling;
    if (!s) return prt_checkpoint_for(b, stage, 0, 1, range, arg, slot);
    if (!s->assembling) status = prt_checkpoint_for(b, stage, s->index, s->n, range, arg, slot);
    for (uint32_t c = 0; status == PRT_OK && c < b->clusters->n_cluster; c++) {
        if (s->assembling) status = read_cluster(b, slot, c);
        else if (c % s->n == s->index) status = write_cluster(b, slot, c);
    }
    s->slot++;
    return status;
}
