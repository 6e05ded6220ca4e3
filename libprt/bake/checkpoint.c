// SPDX-License-Identifier: MIT
// The checkpoint file of a bake: one record is appended for each piece of finished work; a
// later process reads the records and skips that work.
#include "bake/checkpoint.h"
#include "bake/spill.h"
#include "bake/walks.h"

#include "prt/bake.h"

#include <errno.h>
#include <fcntl.h>
#include <limits.h>
#include <pthread.h>
#include <stdatomic.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/file.h>
#include <sys/stat.h>
#include <sys/uio.h>
#include <unistd.h>

// Slots of records that are not a cluster's.
enum { SLOT_ROWS = 1000, SLOT_ROWS_DONE, SLOT_ARRAY };
enum { LOCK_TRIES = 100, LOCK_PAUSE_US = 100000 };
static const char magic[8] = "PRTCHKP1";

struct header {
    char magic[8];
    uint64_t key;
};

struct place {
    struct record record;
    uint64_t at;
};

struct checkpoint {
    const struct prt_context *ctx;
    char path[PATH_MAX], rows_path[PATH_MAX + 8];
    int fd, rows_fd;
    uint64_t end, rows_bytes, room; // bytes of either file; room: of both together
    uint32_t slot;
    bool rows_skipped;   // the slots that read the rows were complete
    struct place *place; // found when it was opened
    size_t n_place, capacity;
    pthread_mutex_t lock; // of `end` and of the file behind it
    atomic_bool stopped;  // nothing is recorded any more
};

static void stop_recording(struct checkpoint *k, const char *why)
{
    if (!atomic_exchange(&k->stopped, true))
        prt_log(k->ctx, PRT_LOG_WARNING,
                "%s: %s; if this bake is interrupted, work from here on is repeated", k->path,
                why);
}

static const struct place *find(const struct checkpoint *k, uint32_t slot, uint32_t cluster)
{
    for (size_t i = 0; i < k->n_place; i++)
        if (k->place[i].record.slot == slot && k->place[i].record.cluster == cluster)
            return &k->place[i];
    return NULL;
}

// ---- writing

static void append(struct checkpoint *k, const struct record *r, const struct view *view,
                   unsigned n)
{
    uint64_t size = sizeof *r + (r->slot == SLOT_ROWS ? 0 : r->bytes);
    if (atomic_load(&k->stopped)) return;
    pthread_mutex_lock(&k->lock);
    uint64_t at = k->end;
    bool fits = at + k->rows_bytes + size <= k->room;
    bool ok = fits && prt_write_at(k->fd, r, sizeof *r, at);
    at += sizeof *r;
    for (unsigned i = 0; ok && i < n; i++) {
        ok = prt_write_at(k->fd, view[i].at, view[i].bytes, at);
        at += view[i].bytes;
    }
    if (ok) k->end = at;
    pthread_mutex_unlock(&k->lock);
    if (!ok) stop_recording(k, fits ? strerror(errno) : "it takes all the room it may have");
}

// ---- opening

static int add_place(struct checkpoint *k, const struct place *place)
{
    if (k->n_place == k->capacity) {
        size_t more = 2 * k->capacity + 256;
        struct place *grown = realloc(k->place, more * sizeof *grown);
        if (!grown) return PRT_NOMEM;
        k->place = grown;
        k->capacity = more;
    }
    k->place[k->n_place++] = *place;
    return PRT_OK;
}

// Stops at the first record that was not written whole. The hash of its data is checked where
// they are read.
static int scan(struct checkpoint *k, uint64_t key)
{
    struct header h;
    struct stat st;
    struct place p;
    int status = PRT_OK;
    if (fstat(k->fd, &st)) return PRT_IO;
    uint64_t size = (uint64_t)st.st_size, at = sizeof h;
    if (!prt_read_at(k->fd, &h, sizeof h, 0) || memcmp(h.magic, magic, sizeof magic) ||
        h.key != key) {
        unlink(k->rows_path);
        memcpy(h.magic, magic, sizeof magic);
        h.key = key;
        k->end = sizeof h;
        return ftruncate(k->fd, 0) || !prt_write_at(k->fd, &h, sizeof h, 0) ? PRT_IO : PRT_OK;
    }
    while (status == PRT_OK && prt_read_at(k->fd, &p.record, sizeof p.record, at) &&
           prt_record_whole(&p.record)) {
        uint64_t bytes = p.record.slot == SLOT_ROWS ? 0 : p.record.bytes;
        p.at = at + sizeof p.record;
        if (bytes > size || p.at > size - bytes) break;
        status = add_place(k, &p);
        at = p.at + bytes;
    }
    k->end = at;
    return status ? status : ftruncate(k->fd, (off_t)at) ? PRT_IO : PRT_OK;
}

// The lock of a process that is being killed lasts until it has gone.
static int lock_file(const struct checkpoint *k)
{
    for (int i = 0; flock(k->fd, LOCK_EX | LOCK_NB); i++) {
        if (errno != EWOULDBLOCK) return PRT_OK; // a file system without locks
        if (i == LOCK_TRIES)
            return prt_fail(k->ctx, PRT_IO, "%s: another process bakes with this checkpoint",
                            k->path);
        usleep(LOCK_PAUSE_US);
    }
    return PRT_OK;
}

int prt_checkpoint_open(struct bake *b, uint64_t key)
{
    struct stat st;
    if (!b->o.checkpoint) return PRT_OK;
    struct checkpoint *k = calloc(1, sizeof *k);
    if (!k) return PRT_NOMEM;
    b->checkpoint = k;
    *k = (struct checkpoint){.ctx = b->ctx, .fd = -1, .rows_fd = -1};
    k->room = b->o.checkpoint_room ? b->o.checkpoint_room : UINT64_MAX;
    pthread_mutex_init(&k->lock, NULL);
    if (snprintf(k->path, sizeof k->path, "%s", b->o.checkpoint) >= PATH_MAX)
        return prt_fail(b->ctx, PRT_IO, "%.80s...: the path is too long", b->o.checkpoint);
    snprintf(k->rows_path, sizeof k->rows_path, "%s.rows", k->path);
    k->fd = open(k->path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (k->fd < 0)
        return prt_fail(b->ctx, PRT_IO, "checkpoint %s: %s", k->path, strerror(errno));
    int status = lock_file(k);
    if (status) return status;
    // Results are equal bytes for equal kernels alone.
    const uint64_t more[] = {PRT_BAKE_VERSION, b->ctx ? b->ctx->cpu : 0, b->o.shard,
                             b->o.n_shard};
    status = scan(k, prt_hash64(more, sizeof more, key));
    if (status == PRT_IO)
        return prt_fail(b->ctx, PRT_IO, "checkpoint %s: %s", k->path, strerror(errno));
    if (status) return status;
    k->rows_fd = open(k->rows_path, O_RDWR | O_CREAT | O_CLOEXEC | O_NOFOLLOW, 0600);
    if (k->rows_fd >= 0 && !fstat(k->rows_fd, &st))
        k->rows_bytes = (uint64_t)st.st_blocks * 512;
    if (k->n_place)
        prt_log(b->ctx, PRT_LOG_NOTE, "going on from %zu records of %s", k->n_place, k->path);
    return PRT_OK;
}

void prt_checkpoint_close(struct bake *b, bool written)
{
    struct checkpoint *k = b->checkpoint;
    if (!k) return;
    if (written) {
        unlink(k->rows_path);
        unlink(k->path);
    }
    if (k->rows_fd >= 0) close(k->rows_fd);
    if (k->fd >= 0) close(k->fd);
    pthread_mutex_destroy(&k->lock);
    free(k->place);
    free(k);
    b->checkpoint = NULL;
}

// ---- clusters

struct remaining {
    struct bake *b;
    const struct slot *slot;
    uint32_t *cluster;
    prt_loop_fn range;
    void *arg;
};

static int remaining_range(void *arg, size_t begin, size_t end, unsigned worker)
{
    const struct remaining *r = arg;
    int status = PRT_OK;
    for (size_t i = begin; status == PRT_OK && i < end; i++) {
        struct checkpoint *k = r->b->checkpoint;
        struct record record;
        struct view view[RECORD_VIEWS];
        uint32_t c = r->cluster[i];
        status = r->range(r->arg, c, c + 1u, worker);
        if (status || !k) continue;
        unsigned n = prt_cluster_views(r->b, r->slot, c, &record, view);
        record.slot = k->slot;
        prt_record_sign(&record, view, n);
        append(k, &record, view, n);
    }
    return status;
}

// True when the cluster was read whole. Of a damaged record nothing is kept.
static bool recall(struct bake *b, const struct slot *slot, uint32_t c)
{
    const struct checkpoint *k = b->checkpoint;
    const struct place *p = k ? find(k, k->slot, c) : NULL;
    struct view view[RECORD_VIEWS];
    unsigned n = 0;
    if (!p) return false;
    if (slot->kind == SLOT_FACTORED && !p->record.bytes) return true; // without rows
    bool ok = prt_cluster_room(b, slot, &p->record, view, &n) &&
              prt_record_read(&p->record, k->fd, p->at, view, n);
    if (ok && b->walk) memcpy(b->walk->noise[c], p->record.noise, sizeof p->record.noise);
    if (ok && slot->kind == SLOT_FACTORED)
        prt_spill_factored(b->spill, &b->factored[c], slot->n_function, b->directions->n_coef);
    if (ok) b->rays_single[c] = p->record.rays;
    else if (slot->kind == SLOT_FACTORED) prt_factored_finish(&b->factored[c]);
    else
        for (unsigned i = 0; i < n; i++) memset(view[i].at, 0, view[i].bytes);
    return ok;
}

// The slots that read the rows of pass 1 come first: multiple scattering, and what crosses
// unscattered where walks are taken.
static uint32_t reading_slots(const struct bake *b)
{
    return b->walk ? 2 : 1;
}

// The rows are removed once the records of the slots that read them are on the disk.
static void end_rows(struct bake *b)
{
    struct checkpoint *k = b->checkpoint;
    struct record r = {.slot = SLOT_ROWS_DONE};
    if (!find(k, SLOT_ROWS_DONE, 0) && !atomic_load(&k->stopped)) {
        if (fdatasync(k->fd)) return;
        prt_record_sign(&r, NULL, 0);
        append(k, &r, NULL, 0);
    }
    if (k->rows_fd < 0) return;
    unlink(k->rows_path);
    close(k->rows_fd);
    k->rows_fd = -1;
    k->rows_bytes = 0;
}

int prt_checkpoint_for(struct bake *b, const char *stage, uint32_t first, uint32_t step,
                       prt_loop_fn range, void *arg, const struct slot *slot)
{
    struct checkpoint *k = b->checkpoint;
    size_t n = 0;
    uint32_t *cluster = calloc(b->clusters->n_cluster + 1u, sizeof *cluster);
    if (!cluster) return PRT_NOMEM;
    for (uint32_t c = first; c < b->clusters->n_cluster; c += step)
        if (!recall(b, slot, c)) cluster[n++] = c;
    if (n && k && k->rows_skipped && k->slot < reading_slots(b)) {
        free(cluster);
        (void)!ftruncate(k->fd, 0);
        return prt_fail(b->ctx, PRT_FORMAT,
                        "%s was damaged and is dropped: start the bake again", k->path);
    }
    struct remaining remaining = {b, slot, cluster, range, arg};
    int status =
        n ? prt_parallel_for(b->ctx, stage, n, 1, remaining_range, &remaining) : PRT_OK;
    free(cluster);
    if (k && !status && ++k->slot == reading_slots(b)) end_rows(b);
    return status;
}

// ---- pass 1

bool prt_checkpoint_skips_rows(struct bake *b)
{
    struct checkpoint *k = b->checkpoint;
    const struct place *done = k ? find(k, SLOT_ROWS_DONE, 0) : NULL;
    if (!done) return false;
    return k->rows_skipped = true;
}

static struct view rows_view(const struct half_rows *rows, size_t begin, size_t n)
{
    return (struct view){rows->half + begin * rows->n_coef, n * rows->n_coef * 2};
}

bool prt_checkpoint_read_rows(const struct checkpoint *k, const struct half_rows *rows,
                              size_t begin, size_t n)
{
    const struct place *p = k ? find(k, SLOT_ROWS, (uint32_t)begin) : NULL;
    struct view view = rows_view(rows, begin, n);
    if (!p || k->rows_fd < 0 || p->record.bytes != view.bytes ||
        !prt_record_read(&p->record, k->rows_fd, begin * rows->n_coef * 2, &view, 1))
        return false;
    return true;
}

void prt_checkpoint_write_rows(struct checkpoint *k, const struct half_rows *rows, size_t begin,
                               size_t n)
{
    struct view view = rows_view(rows, begin, n);
    struct record r = {.slot = SLOT_ROWS, .cluster = (uint32_t)begin};
    if (!k || k->rows_fd < 0 || atomic_load(&k->stopped)) return;
    pthread_mutex_lock(&k->lock);
    bool fits = k->end + k->rows_bytes + view.bytes <= k->room;
    if (fits) k->rows_bytes += view.bytes;
    pthread_mutex_unlock(&k->lock);
    if (!fits) return; // rows may be too many where clusters are not
    if (!prt_write_at(k->rows_fd, view.at, view.bytes, begin * rows->n_coef * 2)) {
        stop_recording(k, strerror(errno));
        return;
    }
    prt_record_sign(&r, &view, 1);
    append(k, &r, NULL, 0);
}

bool prt_checkpoint_read_array(const struct checkpoint *k, void *at, size_t bytes)
{
    const struct place *p = k ? find(k, SLOT_ARRAY, 0) : NULL;
    const struct view view = {at, bytes};
    return p && p->record.bytes == bytes && prt_record_read(&p->record, k->fd, p->at, &view, 1);
}

void prt_checkpoint_write_array(struct checkpoint *k, void *at, size_t bytes)
{
    const struct view view = {at, bytes};
    struct record r = {.slot = SLOT_ARRAY};
    if (!k) return;
    prt_record_sign(&r, &view, 1);
    append(k, &r, &view, 1);
}
