/* SPDX-License-Identifier: MIT */
/* blobs.h owns the content-addressed store of uploads: DATA/blobs/HASH, named by SHA-256. An
 * index in memory lists every blob; hashing, writing and fsync happen on workers. An upload
 * belongs to a principal, a hash and a size: no principal can be in another's way. Bytes are
 * charged to the principal when they are promised (store/disk.h).
 * Thread-safety: loop thread only, but for blobs_hash_file. */
#ifndef RELIGHTD_BLOBS_H
#define RELIGHTD_BLOBS_H

#include "core/ledger.h"
#include "core/work.h"
#include "store/holds.h"
#include "store/object_store.h"

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { BLOB_HASH = 64, BLOB_NAME = 200 };

struct blobs;

struct blobs_setup {
    const char *folder;           /* made where there is none */
    uint64_t max_blob;            /* bytes of the largest upload */
    struct ledger *ledger;        /* must outlive the store, as must the pool */
    struct object_store *objects; /* what replicas share: must outlive it; NULL: nothing */
    struct holds *holds;          /* what rooms need; NULL: nothing */
    struct work_pool *work;       /* nothing of the store may be under way when it is closed */
    /* Removes files that are no blobs while the disk is above its limit, for a blob of this
     * owner that was fetched; NULL: there are none. */
    void (*make_room)(void *user, const char *owner);
    void *user;      /* of make_room */
    double keep_s;   /* a blob that was used so recently is not evicted */
    double idle_s;   /* an upload that got no byte for so long is dropped */
    double wanted_s; /* the same while another upload needs its room */
};
/* Reads the folder: blobs, and uploads that a restart interrupted. 0 or -errno. */
int blobs_open(const struct blobs_setup *setup, struct blobs **out);
/* Parts of uploads stay on disk, to be resumed. */
void blobs_close(struct blobs *blobs);

/* Whether a blob of this name is there. Its bytes may not have been checked since the start. */
bool blobs_has(const struct blobs *blobs, const char *hash);

/* Bytes on the disk of blobs that rooms need, of this owner or (NULL) of all. */
uint64_t blobs_held(const struct blobs *blobs, const char *owner);

/* A blob that was there at the start is hashed before its first use. blobs_check calls `wake`
 * when that is done, at once when it was done before; blobs_has then says whether the blob is
 * there. A blob whose bytes do not have its hash is removed; one that could not be read for
 * lack of memory or descriptors stays, unchecked. */
struct blob_waiter {
    struct blob_waiter *next;
    void (*wake)(struct blob_waiter *waiter);
};
void blobs_check(struct blobs *blobs, const char *hash, struct blob_waiter *waiter);
/* A waiter whose wake was not called stops waiting; a check that nobody waits for leaves the
 * queue of workers. */
void blobs_check_leave(struct blobs *blobs, const char *hash, struct blob_waiter *waiter);

/* Copies a blob that is not here from the folder that replicas share, and calls `wake` when
 * that is done or there is none, perhaps before it returns. The waiter must live until then. */
void blobs_fetch(struct blobs *blobs, const char *hash, struct blob_waiter *waiter);

/* Path of a blob that is there; n >= 4096. */
void blobs_path(const struct blobs *blobs, const char *hash, char *path, size_t n);
/* Marks a blob as used now: the longest unused go first when the disk budget is spent. */
void blobs_touch(struct blobs *blobs, const char *hash);

/* Format of a checked blob, from its first bytes. */
enum blob_format {
    BLOB_OTHER,
    BLOB_DDS,
    BLOB_FLOATS /* Radiance, OpenEXR, PFM, Softimage PIC */
};
enum blob_format blobs_format(const struct blobs *blobs, const char *hash);

/* The file name under which this principal uploaded the blob last; for others, and for
 * principal NULL, the beginning of its hash: 12 digits and "…". */
void blobs_name(const struct blobs *blobs, const char *principal, const char *hash, char *name,
                size_t n);
/* Copies a message, with "123456789abc…" replaced by this principal's name of that blob;
 * a longer text is cut between two characters. */
void blobs_name_in_text(const struct blobs *blobs, const char *principal, const char *text,
                        char *out, size_t n);

/* An upload that is an image, for LIST. The texts live until the next change of the store. */
struct blob_listed {
    const char *hash, *name; /* name: this principal's, "" where it gave none */
    uint64_t bytes;
};
/* The images that this principal uploaded, most recently used first. */
size_t blobs_images(const struct blobs *blobs, const char *principal, struct blob_listed *out,
                    size_t most);
/* The image that this principal uploaded under a file name, which may lack its ending; of
 * several the one that was uploaded last. NULL: none. */
const char *blobs_image_named(const struct blobs *blobs, const char *principal,
                              const char *name);
/* Whether the blob is there and this principal sent its bytes (NULL: whoever did). A principal
 * that only asked for its hash did not. */
bool blobs_owned(const struct blobs *blobs, const char *principal, const char *hash,
                 uint64_t *size);

/* One chunk of an upload, or with n 0 a question. The owner fills the first part and leaves it
 * alone until `done`, which is called once, perhaps before blobs_put returns, and frees it. */
struct blob_put {
    char principal[96];       /* charged for it */
    char hash[BLOB_HASH + 1]; /* must be valid (relight_hash_valid) */
    bool unnamed; /* hash is a random name of this upload: the blob gets its own hash,
                     which is here when it is complete */
    char name[BLOB_NAME + 1]; /* "" where the name is not worth keeping */
    uint64_t size, offset;    /* of the whole blob, of this chunk */
    void *bytes;              /* [n], freed by the owner in `done` */
    size_t n;
    void (*done)(struct blob_put *put);

    int code;       /* the protocol's error code, 0: none; error is its text */
    bool own_limit; /* the limit is the principal's, not that of all */
    bool no_room;   /* what is on the disk stays there */
    char error[256];
    uint64_t received; /* bytes that are there, from the start */
    bool complete;     /* the blob is there and has its hash */
    bool arrived;      /* this chunk completed it */

    struct blob_waiter waiter; /* private to the store from here */
    struct blob_put *next;
    struct blobs *blobs;
    bool abandoned;
};
/* A chunk past the received bytes is an error; of one that overlaps the new bytes are taken.
 * Chunks of one upload are taken in the order they came. */
void blobs_put(struct blobs *blobs, struct blob_put *put);
/* The request has ended: a chunk that waits its turn is dropped and done is
 * called at once, else as soon as the worker is done with it. */
void blobs_put_abandon(struct blob_put *put);

/* Drops an unnamed upload, as soon as no worker writes it. */
void blobs_put_drop(struct blobs *blobs, const char *principal, const char *name);

/* Once a minute: drops abandoned uploads and writes times of use to disk. */
void blobs_maintain(struct blobs *blobs);

/* Hex SHA-256 of a file into out[65]; 0 or -errno. Any thread. */
int blobs_hash_file(const char *path, char out[65]);

/* Charges bytes under --data to no principal: see store/disk.h. */
void blobs_charge(struct blobs *blobs, int64_t bytes);

#endif
