/* SPDX-License-Identifier: MIT */
/* A bake in parts: each process works on its own clusters and leaves them in a file beside the
 * output; the one that finds the parts of all others there assembles the .prt. */
#ifndef PRT_BAKE_SHARD_H
#define PRT_BAKE_SHARD_H

#include "bake/run.h"

/* For options.n_shard > 1: b->shard, NULL otherwise. `key` is equal for parts of one bake. When
 * this shard's part is there already, whole, the bake goes on with what the others left. */
int prt_shard_create(struct bake *b, const char *out_path, uint64_t key);
/* Ends this shard's part. *missing: parts that are not there yet; with 0 the parts are open and
 * the engine is run once more, to assemble. One process alone is told 0. */
int prt_shard_close(struct bake *b, uint32_t *missing);
/* Removes the parts of a bake that was `written`; frees b->shard. */
void prt_shard_destroy(struct bake *b, bool written);

/* Clusters come from the parts: nothing is traced. */
bool prt_shard_assembling(const struct bake *b);
/* The part is there already: nothing is to be done before shard_close. */
bool prt_shard_done(const struct bake *b);
/* prt_parallel_for over the clusters of this process: all of them, its own, or none. */
int prt_shard_for(struct bake *b, const char *stage, prt_loop_fn range, void *arg);

/* After a loop, for the next slot: writes what it left of the own clusters, or fills all. The
 * tensor of the slot is not complete before the parts are assembled: *part then is true. */
int prt_shard_factored(struct bake *b, uint32_t n_function, bool *part);
int prt_shard_sparse(struct bake *b, bool *part);
int prt_shard_radial(struct bake *b, struct prt_tensor *tensor);

#endif
