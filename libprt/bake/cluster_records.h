/* SPDX-License-Identifier: MIT */
/* The bytes of finished work in files: of a cluster in one tensor before packing, as shards and
 * checkpoints keep it. */
#ifndef PRT_BAKE_CLUSTER_RECORDS_H
#define PRT_BAKE_CLUSTER_RECORDS_H

#include "bake/run.h"

enum { RECORD_VIEWS = 8 };

/* Data of record.bytes follow; hash is prt_hash64 over its arrays, each seeded by the one
 * before. */
struct record {
    uint32_t slot, cluster;     /* slot: number of the tensor within the bake */
    uint32_t rank, n_component; /* of a factored cluster */
    uint64_t rays;              /* of single scattering */
    double noise[2];            /* of walks (struct walk_bake) */
    uint64_t bytes, hash;
    uint64_t check; /* hash of the fields above */
};
struct view {
    void *at;
    size_t bytes;
};

/* The result of one loop over the clusters. */
enum slot_kind { SLOT_FACTORED, SLOT_SPARSE, SLOT_RADIAL };
struct slot {
    enum slot_kind kind;
    uint32_t n_function;       /* FACTORED */
    struct prt_tensor *tensor; /* RADIAL */
};

/* The arrays of a finished cluster; fills the record except for its slot. Returns their number,
 * 0 for a factored cluster without rows. */
unsigned prt_cluster_views(const struct bake *b, const struct slot *slot, uint32_t cluster,
                           struct record *record, struct view view[RECORD_VIEWS]);
/* Arrays to read a record's data into: allocated for factored storage, else in place. False:
 * the record does not fit this bake, or there is no memory. */
bool prt_cluster_room(struct bake *b, const struct slot *slot, const struct record *record,
                      struct view view[RECORD_VIEWS], unsigned *n);
/* Sets bytes, hash and check; the other fields are set before. */
void prt_record_sign(struct record *record, const struct view *view, unsigned n);
/* Whether the record is as it was signed. */
bool prt_record_whole(const struct record *record);
/* Reads the record's data at `at` of the file. False: it cannot be read or has another hash. */
bool prt_record_read(const struct record *record, int fd, uint64_t at, const struct view *view,
                     unsigned n);
/* Read or write n bytes at an offset, all of them or false. */
bool prt_read_at(int fd, void *to, size_t n, uint64_t at);
bool prt_write_at(int fd, const void *bytes, size_t n, uint64_t at);

#endif
