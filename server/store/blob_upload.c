// SPDX-License-Identifier: MIT
// Uploads: chunks of one upload wait in a queue, and a worker takes one at a time, which
// writes and hashes it. The last one is also synced and named there. Room and number of uploads
// are the principal's from the first chunk on.
#include "store/blob_index.h"

#include "core/log.h"
#include "core/loop.h"
#include "relight.pb-c.h"

#include <errno.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

enum { SMALL_CHUNK = 4 << 20 }; // takes a worker some milliseconds

struct upload {
    struct work work;
    struct upload *next;
    struct blobs *blobs;
    struct principal *principal;
    char hash[BLOB_HASH + 1], stem[BLOB_STEM + 1];
    uint64_t size, received, charged, active_ns;
    struct relight_sha256 sha; // of the received bytes, when `known`
    bool known, begun;         // begun: its promise is on disk
    bool running;              // a worker has `work`
    bool unnamed, dropped;     // hash is its name until all bytes are there; nobody wants it
    struct blob_put *first, **last;
    // The chunk under way, without what is there already, and its outcome.
    struct blob_put *put;
    const char *bytes;
    size_t n;
    int err;
    bool whole, first_of_all; // all bytes are there; they got the blob's name
    char found[65];           // the hash of the whole
    enum blob_format format;
};

static void finish(struct blob_put *put, int code)
{
    put->code = code;
    put->done(put);
}

static struct upload *find(const struct blobs *blobs, const struct blob_put *put)
{
    struct upload *u = blobs->uploads;
    while (u && (u->size != put->size || u->unnamed != put->unnamed ||
                 strcmp(u->hash, put->hash) || strcmp(u->principal->name, put->principal)))
        u = u->next;
    return u;
}

static struct upload *new_upload(struct blobs *blobs, const char *hash, const char *principal,
                                 uint64_t size, bool unnamed)
{
    struct upload *u = calloc(1, sizeof *u);
    if (u) u->principal = ledger_principal(blobs->setup.ledger, principal);
    if (!u || !u->principal) {
        free(u);
        return NULL;
    }
    struct relight_sha256 sha;
    char id[65];
    relight_sha256_init(&sha);
    relight_sha256_add(&sha, principal, strlen(principal) + 1);
    relight_sha256_add(&sha, &size, sizeof size);
    if (unnamed) relight_sha256_add(&sha, "unnamed", 8); // its files are no named upload's
    relight_sha256_hex(&sha, id);
    u->unnamed = unnamed;
    u->blobs = blobs;
    u->size = size;
    u->charged = blob_charge(size);
    u->active_ns = loop_now_ns();
    u->last = &u->first;
    memcpy(u->hash, hash, BLOB_HASH);
    snprintf(u->stem, sizeof u->stem, "%s.%.16s", hash, id);
    relight_sha256_init(&u->sha);
    u->next = blobs->uploads;
    blobs->uploads = u;
    return u;
}

// Removes the upload from the list and gives its slot back. With keep_charge its charge passes
// to the caller; else it is given back.
static void free_upload(struct upload *u, bool keep_charge)
{
    struct upload **at = &u->blobs->uploads;
    while (*at != u) at = &(*at)->next;
    *at = u->next;
    ledger_give(u->principal, LEDGER_UPLOADS, 1);
    if (!keep_charge) ledger_give(u->principal, LEDGER_DISK, u->charged);
    principal_release(u->principal);
    free(u);
}

// Removes the upload and its files, and returns its chunks. Not while a worker uses it.
static struct blob_put *drop_upload(struct upload *u)
{
    struct blob_put *queue = u->first;
    char name[BLOB_STEM + 8];
    if (u->begun) {
        snprintf(name, sizeof name, "%s.upload", u->stem);
        blob_discard(u->blobs, name);
        snprintf(name, sizeof name, "%s.part", u->stem);
        blob_discard(u->blobs, name);
    }
    free_upload(u, false);
    return queue;
}

// Hands chunks whose upload was removed to blobs_put again.
static void put_again(struct blob_put *queue)
{
    for (struct blob_put *next; queue; queue = next) {
        next = queue->next;
        blobs_put(queue->blobs, queue);
    }
}

static void cancel_all(struct blob_put *queue)
{
    for (struct blob_put *next; queue; queue = next) {
        next = queue->next;
        snprintf(queue->error, sizeof queue->error, "the upload was dropped");
        finish(queue, RELIGHT__ERROR_CODE__ERROR_CANCELLED);
    }
}

void blobs_put_drop(struct blobs *blobs, const char *principal, const char *name)
{
    struct upload *u = blobs->uploads;
    while (u && (!u->unnamed || strcmp(u->hash, name) || strcmp(u->principal->name, principal)))
        u = u->next;
    if (!u) return;
    u->dropped = true;
    if (!u->running) cancel_all(drop_upload(u));
}

// ---- room

static bool is_idle(const struct upload *u, double seconds)
{
    return !u->running && !u->first && (double)(loop_now_ns() - u->active_ns) >= seconds * 1e9;
}

void uploads_expire(struct blobs *blobs)
{
    for (struct upload *u = blobs->uploads, *next; u; u = next) {
        next = u->next;
        if (is_idle(u, blobs->setup.idle_s)) drop_upload(u);
    }
}

// Drops the upload that is idle longest, of this principal (NULL: of any).
static bool drop_idle(struct blobs *blobs, const struct principal *whose)
{
    struct upload *oldest = NULL;
    for (struct upload *u = blobs->uploads; u; u = u->next)
        if ((!whose || u->principal == whose) && is_idle(u, blobs->setup.wanted_s) &&
            (!oldest || u->active_ns < oldest->active_ns))
            oldest = u;
    if (!oldest) return false;
    log_line(LOG_EVENT, "upload hash=%.12s owner=\"%s\" dropped for room", oldest->hash,
             oldest->principal->name);
    drop_upload(oldest);
    return true;
}

static bool never_fits(const struct principal *principal, enum ledger_resource resource,
                       uint64_t amount)
{
    uint64_t client = ledger_limit_client(principal, resource);
    uint64_t all = ledger_limit_all(principal->ledger, resource);
    return (client && amount > client) || (all && amount > all);
}

static bool take(struct blobs *blobs, struct principal *principal,
                 enum ledger_resource resource, uint64_t amount, struct blob_put *put)
{
    for (;;) {
        enum ledger_refusal refusal = ledger_take(principal, resource, amount, put->error);
        if (refusal == LEDGER_GRANTED) return true;
        put->own_limit = refusal == LEDGER_CLIENT_FULL;
        if (never_fits(principal, resource, amount)) return false;
        struct principal *whose = refusal == LEDGER_CLIENT_FULL ? principal : NULL;
        if (drop_idle(blobs, whose)) continue;
        if (resource == LEDGER_DISK && (whose ? blob_evict(blobs, whose->name)
                                              : blob_evict_for(blobs, principal->name, amount)))
            continue;
        put->no_room = resource == LEDGER_DISK;
        return false;
    }
}

// The upload of this chunk, with its slot and its room. NULL: put->error says why not.
static struct upload *begin(struct blobs *blobs, struct blob_put *put, int *code)
{
    struct principal *p = ledger_principal(blobs->setup.ledger, put->principal);
    struct upload *u = NULL;
    *code = RELIGHT__ERROR_CODE__ERROR_NO_MEMORY;
    snprintf(put->error, sizeof put->error, "not enough memory");
    if (!p) return NULL;
    if (!take(blobs, p, LEDGER_UPLOADS, 1, put)) {
        *code = RELIGHT__ERROR_CODE__ERROR_BUSY;
    } else if (!take(blobs, p, LEDGER_DISK, blob_charge(put->size), put)) {
        ledger_give(p, LEDGER_UPLOADS, 1);
        *code = RELIGHT__ERROR_CODE__ERROR_LIMIT;
    } else if (!(u = new_upload(blobs, put->hash, put->principal, put->size, put->unnamed))) {
        ledger_give(p, LEDGER_UPLOADS, 1);
        ledger_give(p, LEDGER_DISK, blob_charge(put->size));
    } else {
        u->known = true; // nothing is there
    }
    principal_release(p);
    return u;
}

// ---- on a worker

static int run_rehash(struct work *work, const struct prt_context *ctx)
{
    struct upload *u = (struct upload *)work;
    u->err = blob_part_hash(u->blobs->folder, u->stem, u->size, &u->sha, &u->received);
    return PRT_OK;
}

// ending: of the upload's file; NULL: the owner's name, beside the blob.
static int share(const struct upload *u, const char *ending, enum object_kind kind)
{
    char path[4096];
    snprintf(path, sizeof path, "%s/%s%s", u->blobs->folder, ending ? u->stem : u->found,
             ending ? ending : ".owner");
    return object_put(u->blobs->setup.objects, kind, u->found, path);
}

static int run_write(struct work *work, const struct prt_context *ctx)
{
    struct upload *u = (struct upload *)work;
    const char *folder = u->blobs->folder;
    u->err = u->begun ? 0 : blob_promise_write(folder, u->stem, u->size, u->principal->name);
    if (!u->err) u->err = blob_part_write(folder, u->stem, u->received, u->bytes, u->n);
    if (u->err) return PRT_OK;
    u->begun = true;
    relight_sha256_add(&u->sha, u->bytes, u->n);
    u->whole = u->received + u->n == u->size;
    if (!u->whole) return PRT_OK;
    relight_sha256_hex(&u->sha, u->found);
    if (!u->unnamed && strcmp(u->found, u->hash)) return PRT_OK;
    // Where replicas share a folder, it is there before anybody hears that it is complete.
    u->err = share(u, ".part", OBJECT_BLOB);
    if (!u->err)
        u->err = blob_part_finish(folder, u->stem, u->found, u->principal->name, u->put->name,
                                  &u->first_of_all, &u->format);
    if (!u->err) (void)share(u, NULL, OBJECT_OWNER);
    return PRT_OK;
}

// ---- the queue

static void advance(struct upload *u);

static struct blob_put *pop(struct upload *u)
{
    struct blob_put *put = u->first;
    u->first = put->next;
    if (!u->first) u->last = &u->first;
    put->next = NULL;
    return put;
}

// The blob is stored: other principals' uploads of it end.
static void drop_others(struct blobs *blobs, const char *hash)
{
    struct blob_put *queue = NULL, **last = &queue;
    for (struct upload *u = blobs->uploads, *next; u; u = next) {
        next = u->next;
        if (u->running || u->unnamed || strcmp(u->hash, hash)) continue;
        *last = drop_upload(u);
        while (*last) last = &(*last)->next;
    }
    put_again(queue);
}

// Where another upload of the same blob named the file and its worker's result has yet to be
// taken: the chunk waits there, and the blob is that one's. False if there is none.
static bool waits_for_first(struct upload *u, struct blob_put *put)
{
    struct upload *other =
        u->first_of_all || blob_find(u->blobs, u->hash) ? NULL : u->blobs->uploads;
    while (other && (!other->running || other->unnamed || strcmp(other->hash, u->hash) ||
                     other->size != u->size || other->received + other->n != u->size))
        other = other->next;
    if (!other) return false;
    put->next = u->first;
    *other->last = put;
    while (*other->last) other->last = &(*other->last)->next;
    free_upload(u, false);
    return true;
}

static void arrived(struct upload *u, struct blob_put *put)
{
    struct blobs *blobs = u->blobs;
    struct blob_put *queue = u->first;
    uint64_t size = u->size;
    char hash[BLOB_HASH + 1];
    if (u->unnamed) {
        strcpy(u->hash, u->found);
        strcpy(put->hash, u->found);
        put->unnamed = false;
    }
    if (waits_for_first(u, put)) return;
    strcpy(hash, u->hash); // the answer frees the put
    struct blob *b = NULL;
    if (!blob_find(blobs, u->hash))
        b = blob_add(blobs, u->hash, size, u->charged, u->principal->name, blob_clock_ns());
    if (b) {
        b->touched = true; // its file's time is of now: in one run with those used since
        b->checked = u->first_of_all; // else something had this name before: check it
        b->format = u->format;
        blob_add_name(blobs, b, u->principal->name, put->name, b->used_ns, false);
    }
    bool first = b && u->first_of_all;
    free_upload(u, b != NULL);
    if (first) {
        put->received = size;
        put->complete = put->arrived = true;
        finish(put, 0);
    } else {
        blobs_put(blobs, put);
    }
    put_again(queue);
    drop_others(blobs, hash);
}

static void failed(struct upload *u, struct blob_put *put)
{
    int code = RELIGHT__ERROR_CODE__ERROR_LIMIT;
    if (u->err) {
        snprintf(put->error, sizeof put->error, "the upload cannot be stored: %s",
                 strerror(-u->err));
    } else {
        code = RELIGHT__ERROR_CODE__ERROR_HASH;
        snprintf(put->error, sizeof put->error,
                 "the bytes have hash %.12s…, not the promised %.12s…", u->found, u->hash);
    }
    u->begun = true; // whatever is there of it
    struct blob_put *queue = drop_upload(u);
    finish(put, code);
    put_again(queue);
}

static void done_write(struct work *work)
{
    struct upload *u = (struct upload *)work;
    struct blob_put *put = pop(u);
    bool right = !u->whole || u->unnamed || !strcmp(u->found, u->hash);
    u->running = false;
    u->active_ns = loop_now_ns();
    if (u->dropped && !u->whole) {
        struct blob_put *queue = drop_upload(u);
        finish(put, RELIGHT__ERROR_CODE__ERROR_CANCELLED);
        cancel_all(queue);
    } else if (u->err || !right) {
        failed(u, put);
    } else if (u->whole) {
        arrived(u, put);
    } else {
        u->received += u->n;
        if (!u->unnamed && blob_find(u->blobs, u->hash)) { // another upload of it was faster
            struct blob_put *queue = drop_upload(u);
            blobs_put(put->blobs, put);
            put_again(queue);
            return;
        }
        put->received = u->received;
        finish(put, 0);
        advance(u);
    }
}

static void done_rehash(struct work *work)
{
    struct upload *u = (struct upload *)work;
    u->running = false;
    u->known = true;
    if (u->err) put_again(drop_upload(u));
    else advance(u);
}

static void start(struct upload *u, int (*run)(struct work *, const struct prt_context *),
                  void (*done)(struct work *), bool quick)
{
    u->work.run = run;
    u->work.done = done;
    u->work.class = quick ? WORK_INTERACTIVE : WORK_BACKGROUND;
    u->running = true;
    work_submit(u->blobs->setup.work, &u->work);
}

static int gap(struct blob_put *put, uint64_t received)
{
    snprintf(put->error, sizeof put->error,
             "the chunk starts at %llu, past the %llu bytes that are there",
             (unsigned long long)put->offset, (unsigned long long)received);
    return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
}

// Answers what can be answered at once, and hands the next chunk to a worker.
static void advance(struct upload *u)
{
    while (!u->running && u->first) {
        struct blob_put *put = u->first;
        if (!u->known) {
            start(u, run_rehash, done_rehash, false);
            return;
        }
        put->received = u->received;
        uint64_t end = put->offset + put->n;
        if (put->n && put->offset > u->received) {
            pop(u);
            finish(put, gap(put, u->received));
        } else if (!put->n || end <= u->received) {
            // All bytes and no blob: the last step was cut short by a restart. Do it again.
            if (u->received == u->size) {
                u->put = put;
                u->n = 0;
                start(u, run_write, done_write, false);
                return;
            }
            pop(u);
            finish(put, 0);
        } else {
            uint64_t known = u->received - put->offset; // an overlap is skipped
            u->put = put;
            u->bytes = (const char *)put->bytes + known;
            u->n = put->n - known;
            // The last chunk also brings the whole file to the disk and to the other replicas.
            bool ends = end == u->size;
            bool small = u->size <= BLOB_SMALL && !u->blobs->setup.objects;
            start(u, run_write, done_write, u->n <= SMALL_CHUNK && (!ends || small));
        }
    }
}

static int bad_sizes(const struct blobs *blobs, struct blob_put *put)
{
    uint64_t size = put->size, most = blobs->setup.max_blob;
    if (!size || size > most) {
        snprintf(put->error, sizeof put->error, "size is %llu, allowed range 1 to %llu bytes",
                 (unsigned long long)size, (unsigned long long)most);
        return size ? RELIGHT__ERROR_CODE__ERROR_LIMIT
                    : RELIGHT__ERROR_CODE__ERROR_OUT_OF_RANGE;
    }
    if (put->n && (put->offset > size || put->n > size - put->offset)) {
        snprintf(put->error, sizeof put->error,
                 "the chunk reaches beyond the promised %llu bytes", (unsigned long long)size);
        return RELIGHT__ERROR_CODE__ERROR_BAD_REQUEST;
    }
    return 0;
}

static void was_checked(struct blob_waiter *waiter)
{
    struct blob_put *put =
        (struct blob_put *)((char *)waiter - offsetof(struct blob_put, waiter));
    const struct blob *b = blob_find(put->blobs, put->hash);
    if (!b || b->checked || b->checking || put->abandoned) {
        blobs_put(put->blobs, put);
        return;
    }
    snprintf(put->error, sizeof put->error,
             "the bytes are there and cannot be checked: memory or descriptors are short");
    finish(put, RELIGHT__ERROR_CODE__ERROR_NO_MEMORY);
}

static void is_there(struct blobs *blobs, struct blob *b, struct blob_put *put)
{
    blob_add_name(blobs, b, put->principal, put->name, blob_clock_ns(), true);
    blobs_touch(blobs, put->hash); // it is about to be used
    put->received = b->size;
    put->complete = true;
    finish(put, 0);
}

void blobs_put(struct blobs *blobs, struct blob_put *put)
{
    put->blobs = blobs;
    put->next = NULL;
    put->received = 0;
    struct blob *b = put->unnamed ? NULL : blob_find(blobs, put->hash);
    if (b && !b->checked && !put->abandoned) {
        put->waiter.wake = was_checked;
        blobs_check(blobs, put->hash, &put->waiter);
        return;
    }
    if (b || put->abandoned) {
        if (b) is_there(blobs, b, put);
        else finish(put, RELIGHT__ERROR_CODE__ERROR_CANCELLED);
        return;
    }
    int code = bad_sizes(blobs, put);
    struct upload *u = find(blobs, put);
    if (!u && !code && put->offset && put->n) code = gap(put, 0);
    if (code || (!u && !put->n)) {
        finish(put, code);
        return;
    }
    if (!u && !(u = begin(blobs, put, &code))) {
        finish(put, code);
        return;
    }
    *u->last = put;
    u->last = &put->next;
    if (u->first == put) advance(u);
}

void blobs_put_abandon(struct blob_put *put)
{
    put->abandoned = true;
    for (struct upload *u = put->blobs->uploads; u; u = u->next) {
        struct blob_put **at = &u->first;
        if (u->running && u->first) at = &u->first->next; // a worker has the first
        while (*at && *at != put) at = &(*at)->next;
        if (!*at) continue;
        *at = put->next;
        if (!*at) u->last = at;
        finish(put, RELIGHT__ERROR_CODE__ERROR_CANCELLED);
        return;
    }
}

// ---- restarts

void upload_recover(struct blobs *blobs, const char *stem)
{
    uint64_t size = 0;
    char principal[96], hash[BLOB_HASH + 1];
    struct upload *u = NULL;
    snprintf(hash, sizeof hash, "%.*s", BLOB_HASH, stem);
    if (!blob_promise_read(blobs->folder, stem, &size, principal) && size &&
        size <= blobs->setup.max_blob)
        u = new_upload(blobs, hash, principal, size, false);
    if (u && strcmp(u->stem, stem)) { // its contents belong to another name
        blobs->uploads = u->next;
        principal_release(u->principal);
        free(u);
        u = NULL;
    }
    if (!u) {
        blob_part_remove(blobs->folder, stem);
        return;
    }
    u->begun = true; // and hashed when its principal sends the next chunk
    ledger_force(u->principal, LEDGER_UPLOADS, 1);
    ledger_force(u->principal, LEDGER_DISK, u->charged);
}

void uploads_close(struct blobs *blobs)
{
    while (blobs->uploads) free_upload(blobs->uploads, false);
}
