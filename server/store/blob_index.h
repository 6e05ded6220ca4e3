/* SPDX-License-Identifier: MIT */
/* blob_index.h owns what the files of the blob store share: the index of blobs, the list of
 * uploads, and the file operations that run on workers. */
#ifndef RELIGHTD_BLOB_INDEX_H
#define RELIGHTD_BLOB_INDEX_H

#include "frame.h"
#include "store/blobs.h"
#include "store/disk.h"

#include <limits.h>

/* A worker hashes so many bytes, and has them on the disk, in some 50 ms: they do not wait for
 * background work, one piece of which may take ten seconds. */
enum { BLOB_SMALL = 16 << 20 };
enum { BLOB_FOLDER = 3900, BLOB_OWNER_FILE = 4096, BLOB_STEM = BLOB_HASH + 17 };

struct blob_name {
    struct blob_name *next; /* of the names of one principal the newest is first */
    uint64_t named_ns;      /* wall clock */
    char *name;
    char principal[]; /* and the name behind it */
};

/* The blobs of one owner, and all of them, in the order of their last use. */
enum { LRU_ALL, LRU_OWNER, LRU_N };
struct blob_lru {
    struct blob *oldest, *newest;
};
struct blob_owner {
    struct blob_owner *next;
    struct blob_lru lru;
    char name[96];
};

struct check;
struct blob {
    struct blob *chain;
    struct {
        struct blob *older, *newer;
    } link[LRU_N];
    char hash[BLOB_HASH + 1];
    uint64_t size, charged, used_ns; /* wall clock */
    struct blob_owner *owner;
    struct blob_name *names;
    size_t names_bytes; /* of the owner file */
    enum blob_format format;
    bool touched; /* used_ns is newer than the file's time */
    bool checked, checking;
    struct check *check; /* while `checking`: its work */
    struct blob_waiter *waiters;
};

struct upload;
struct blob_fetch;

struct blobs {
    struct blobs_setup setup;
    char folder[BLOB_FOLDER];
    struct blob **bucket;
    size_t n_bucket, n_blob;
    uint64_t seed;
    struct blob_lru lru;
    struct blob_owner *owners;
    struct upload *uploads;
    struct blob_waiter *woken;  /* of the check that has just ended */
    struct blob_fetch *fetches; /* copies from the shared folder under way */
    uint64_t last_trash;
};

/* NULL where there is none. */
struct blob *blob_find(const struct blobs *blobs, const char *hash);
/* Adds a blob as the newest, or by its time where used_ns is older; NULL without memory.
 * `charged` was charged to the owner already. */
struct blob *blob_add(struct blobs *blobs, const char *hash, uint64_t size, uint64_t charged,
                      const char *owner, uint64_t used_ns);
/* Takes it out of the index, gives its charge back and removes its files. */
void blob_remove(struct blobs *blobs, struct blob *blob);
/* Adds one whose file was put in place by blob_fetch.c, with the names in its owner file: 0 or
 * -ENOMEM. */
int blob_adopt(struct blobs *blobs, const char *hash, uint64_t size);
/* Remembers a principal's name for it, given at this time; `write`: on disk, too. */
void blob_add_name(struct blobs *blobs, struct blob *blob, const char *principal,
                   const char *name, uint64_t named_ns, bool write);
/* Removes the blob that was unused longest, of this owner, unless it was used in the last
 * keep_s or a room needs it. False when there is none. */
bool blob_evict(struct blobs *blobs, const char *owner);
/* The same for an asker that wants `more` bytes. First goes a blob of an owner that holds more
 * than its share of the disk, or of no owner. If there is none, any blob goes, but only while
 * the asker stays within its own share. */
bool blob_evict_for(struct blobs *blobs, const char *asker, uint64_t more);
/* Takes a file of the store its name at once; a worker removes it. */
void blob_discard(struct blobs *blobs, const char *name);
uint64_t blob_clock_ns(void); /* wall clock */
/* Blocks that a blob takes on disk: itself and its owner file. */
uint64_t blob_charge(uint64_t size);

/* Uploads found at start: stem is HASH.ID. */
void upload_recover(struct blobs *blobs, const char *stem);
void uploads_close(struct blobs *blobs);
void uploads_expire(struct blobs *blobs);

/* ---- file operations, any thread. Errors are -errno. */

/* The promised size and owner of a stem's upload, from STEM.upload. */
int blob_promise_read(const char *folder, const char *stem, uint64_t *size, char principal[96]);
int blob_promise_write(const char *folder, const char *stem, uint64_t size,
                       const char *principal);
/* Hashes the bytes of STEM.part into *sha; *received is their number. More than
 * `size` counts as nothing. */
int blob_part_hash(const char *folder, const char *stem, uint64_t size,
                   struct relight_sha256 *sha, uint64_t *received);
int blob_part_write(const char *folder, const char *stem, uint64_t offset, const void *bytes,
                    size_t n);
/* Gives a whole part its final name, on disk for good when this returns; *first is false when
 * the name was taken. */
int blob_part_finish(const char *folder, const char *stem, const char *hash,
                     const char *principal, const char *name, bool *first,
                     enum blob_format *format);
/* Removes STEM.part and STEM.upload. */
void blob_part_remove(const char *folder, const char *stem);
enum blob_format blob_format_of(const void *bytes, size_t n);
/* Whether a file name may be kept: not empty, no path, no control characters. */
bool blob_name_valid(const char *name);

#endif
