/* SPDX-License-Identifier: MIT */
/* blobs.h owns the content-addressed store of uploads: DATA/blobs/HASH, named by SHA-256. */
#ifndef RELIGHTD_BLOBS_H
#define RELIGHTD_BLOBS_H

#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>

enum { BLOB_HASH = 64 };

struct blobs;
/* Opens (and makes) folder; uploads that a crash left half done are removed. 0 or -errno. */
int blobs_open(const char *folder, uint64_t max_blob, uint64_t disk, struct blobs **out);
void blobs_close(struct blobs *blobs);

bool blobs_has(struct blobs *blobs, const char *hash);
/* Path of a blob that is there; n >= 4096. */
void blobs_path(const struct blobs *blobs, const char *hash, char *path, size_t n);
/* The file name it was uploaded under, else the beginning of its hash. */
void blobs_name(const struct blobs *blobs, const char *hash, char *name, size_t n);
void blobs_set_name(struct blobs *blobs, const char *hash, const char *name);
uint64_t blobs_bytes(const struct blobs *blobs);
/* Space for a file of ours that is not a blob (bakes) counts against the same disk budget. */
void blobs_charge(struct blobs *blobs, int64_t bytes);

/* One chunk of an upload; n 0 only asks. *received says how much is there, *complete whether
 * the whole is and its hash is right. A chunk past what is there is an error, one that overlaps
 * is taken from there on. Returns 0, or the protocol's error code with its text. */
int blobs_put(struct blobs *blobs, const char *hash, uint64_t size, uint64_t offset,
              const void *bytes, size_t n, uint64_t *received, bool *complete, char error[256]);
/* Marks a blob as used now: the longest unused go first when the disk budget is spent. */
void blobs_touch(const struct blobs *blobs, const char *hash);
/* Uploads nobody went on with for `seconds` are dropped. */
void blobs_expire(struct blobs *blobs, double seconds);

/* Hex SHA-256 of a file into out[65]; 0 or -errno. Any thread. */
int blobs_hash_file(const char *path, char out[65]);

#endif
