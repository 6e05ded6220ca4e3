// SPDX-License-Identifier: MIT
// Uploads that another replica took: each is copied from the shared folder into this one's
// before a request uses it, and then it is a blob like any other.
#include "store/blob_index.h"

#include "core/log.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/stat.h>
#include <unistd.h>

struct blob_fetch {
    struct work work; // first
    struct blob_fetch *next;
    struct blobs *blobs;
    struct blob_waiter *waiters;
    char hash[BLOB_HASH + 1];
    uint64_t size;
    int err;
};

static int run_fetch(struct work *work, const struct prt_context *ctx)
{
    struct blob_fetch *f = (struct blob_fetch *)work;
    char path[4096], owner[4096 + 8];
    struct stat st;
    blobs_path(f->blobs, f->hash, path, sizeof path);
    snprintf(owner, sizeof owner, "%s.owner", path);
    struct object_store *objects = f->blobs->setup.objects;
    f->err = object_get(objects, OBJECT_BLOB, f->hash, path);
    if (f->err) return PRT_OK;
    // Without its owner's name the blob serves all the same.
    (void)object_get(objects, OBJECT_OWNER, f->hash, owner);
    if (stat(path, &st)) f->err = -errno;
    else f->size = (uint64_t)st.st_size;
    return PRT_OK;
}

static bool is_full(const struct ledger *ledger)
{
    uint64_t most = ledger_limit_all(ledger, LEDGER_DISK);
    return most && ledger_total(ledger, LEDGER_DISK) > most;
}

// The limit of all holds for what comes from other replicas, too: others go first, as for an
// upload of its owner. If they are not enough, it is not kept.
static int make_room(struct blobs *blobs, const char *hash)
{
    const struct ledger *ledger = blobs->setup.ledger;
    struct blob *b = blob_find(blobs, hash);
    char owner[sizeof b->owner->name];
    snprintf(owner, sizeof owner, "%s", b->owner->name);
    while (is_full(ledger) && blob_evict_for(blobs, owner, 0)) continue;
    if (is_full(ledger) && blobs->setup.make_room)
        blobs->setup.make_room(blobs->setup.user, owner);
    if (!is_full(ledger)) return 0;
    if ((b = blob_find(blobs, hash))) blob_remove(blobs, b);
    return -ENOSPC;
}

static void fetched(struct work *work)
{
    struct blob_fetch *f = (struct blob_fetch *)work, **at = &f->blobs->fetches;
    while (*at != f) at = &(*at)->next;
    *at = f->next;
    if (!f->err && !blob_find(f->blobs, f->hash)) {
        f->err = blob_adopt(f->blobs, f->hash, f->size);
        if (!f->err) f->err = make_room(f->blobs, f->hash);
    }
    if (f->err && f->err != -ENOENT)
        log_line(LOG_WARN, "blob hash=%.12s cannot be fetched from --store: %s", f->hash,
                 f->err == -EBADMSG ? "its bytes are damaged there" : strerror(-f->err));
    for (struct blob_waiter *w = f->waiters, *next; w; w = next) {
        next = w->next;
        w->wake(w);
    }
    free(f);
}

void blobs_fetch(struct blobs *blobs, const char *hash, struct blob_waiter *waiter)
{
    struct blob_fetch *f = blobs->fetches;
    while (f && strcmp(f->hash, hash)) f = f->next;
    bool fresh = !f && object_store_shared(blobs->setup.objects) && relight_hash_valid(hash) &&
                 !blob_find(blobs, hash);
    if (fresh) f = calloc(1, sizeof *f);
    if (!f) {
        waiter->wake(waiter);
        return;
    }
    waiter->next = f->waiters;
    f->waiters = waiter;
    if (!fresh) return;
    f->blobs = blobs;
    snprintf(f->hash, sizeof f->hash, "%s", hash);
    f->next = blobs->fetches;
    blobs->fetches = f;
    f->work.run = run_fetch;
    f->work.done = fetched;
    f->work.class = WORK_STILL;
    work_submit(blobs->setup.work, &f->work);
}
