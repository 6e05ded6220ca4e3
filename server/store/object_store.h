/* SPDX-License-Identifier: MIT */
/* object_store.h owns what replicas share: a folder (--store DIR; NFS, Lustre, CephFS or a
 * local disk) of uploads, bakes and records of models. With one machine there is none: get
 * finds nothing, put and claim succeed at once, and DATA is all there is.
 *
 *     DIR/store    "relight store 1": another version is refused
 *     DIR/blobs/HH/HASH, HASH.owner, DIR/bakes/HH/ID.prt    never modified
 *     DIR/records/ID.json                                   replaced by rename
 *     DIR/claims/ID.NNNNNN                                  see object_claim_take
 *     DIR/tmp/     files under way, with names that no other process chooses
 *
 * An object is written under a unique name, synced, and linked to its name: it is there as a
 * whole or not at all. It is copied to a private file before anybody maps it. A bake's id has
 * the versions of the baker and of the format in it, so replicas of several releases may use
 * one folder. Times of files are compared with each other only, and claims by their changes:
 * clocks of replicas need not agree. All of it may block: call it on a worker. Errors are
 * -errno. Thread-safety: safe. */
#ifndef RELIGHTD_OBJECT_STORE_H
#define RELIGHTD_OBJECT_STORE_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

struct object_store;

enum object_kind { OBJECT_BLOB, OBJECT_OWNER, OBJECT_BAKE, OBJECT_RECORD, OBJECT_N };
/* Hex digits; bytes of a record, which has a LOAD of at most 1 MiB twice, in hex digits. */
enum { OBJECT_ID = 64, OBJECT_TEXT = 8 << 20 };

/* folder "": one machine. Makes the folder's parts where they are missing. 0, or -errno with
 * the error's text. */
int object_store_open(const char *folder, struct object_store **out, char error[256]);
void object_store_close(struct object_store *store);
/* Seconds by which this machine's clock is ahead of the folder's, as its opening found; 0: one
 * machine, or none that matters. Claims and the age of objects do not depend on it; ends of
 * tokens, links and invitations do. */
double object_store_clock(const struct object_store *store);
bool object_store_shared(const struct object_store *store);

/* Copies an object to a private file, which appears whole; a blob's hash is checked. -ENOENT:
 * there is none; -EBADMSG: a blob has other bytes; -EIO: the folder is away. */
int object_get(struct object_store *store, enum object_kind kind, const char *id,
               const char *path);
/* Puts a copy of the file, on the disk for good when this returns 0; one that is there stays
 * and counts as used now. */
int object_put(struct object_store *store, enum object_kind kind, const char *id,
               const char *path);
/* Bytes of the object; -ENOENT: there is none. Counts as a use. */
int object_find(struct object_store *store, enum object_kind kind, const char *id,
                uint64_t *bytes);

/* A record's text, to free(). tag: of this version of the record; equal tags, equal texts. */
int object_read(struct object_store *store, const char *id, char **text);
int object_write(struct object_store *store, const char *id, const char *text);
int object_remove(struct object_store *store, enum object_kind kind, const char *id);

/* Calls fn for each object; ends with the first value other than 0 that it returns. tag changes
 * whenever a record is written anew. */
typedef int (*object_fn)(void *user, const char *id, uint64_t tag);
int object_list(struct object_store *store, enum object_kind kind, object_fn fn, void *user);

/* Removes files under way that nobody writes any more, and objects that have no record and were
 * not used for keep_s, measured by the folder's own clock; 0: no objects. An object that is
 * used meanwhile stays. *n: how many went. */
int object_collect(struct object_store *store, double keep_s, uint64_t *n);

/* ---- claims: one replica at a time does the work for an id */

struct object_claim;
/* What a caller saw of another's claim; zero before the first call. */
struct object_watch {
    unsigned generation;
    char text[200]; /* "OWNER COUNT NOTE" */
    uint64_t since_ns;
};
/* 0: the caller has the claim. -EBUSY: another replica has it, and watch->text says who. A
 * claim without a change for stale_s, by the caller's own clock and over calls with one watch,
 * is taken over. Claims are numbered: the highest number holds, O_EXCL decides who gets the
 * next, and the one before is never removed under its owner. */
int object_claim_take(struct object_store *store, const char *id, double stale_s,
                      struct object_watch *watch, struct object_claim **out);
/* Says that the owner lives; note: one line for others. -ESTALE: another took it over. */
int object_claim_beat(struct object_claim *claim, const char *note);
/* Ends it; the claim is freed. */
void object_claim_release(struct object_claim *claim);
/* "OWNER COUNT NOTE" of the claim that holds; -ENOENT: none does. */
int object_claim_look(struct object_store *store, const char *id, unsigned *generation,
                      char text[200]);

#endif
