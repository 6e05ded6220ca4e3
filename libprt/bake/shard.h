/* SPDX-License-Identifier: MIT */
/* A bake in parts: each process works on its own clusters and writes them to a file beside the
 * output; the process that finds the parts of all others complete assembles the .prt. */
#ifndef PRT_BAKE_SHARD_H
#define PRT_BAKE_SHARD_H

#include "bake/cluster_records.h"

/* Sets b->shard for options.n_shard > 1, and leaves it NULL otherwise. `key` is equal for all
 * parts of one bake. If this shard's part exists and is complete, prt_shard_done holds. */
int prt_shard_create(struct bake *b, const char *out_path, uint64_t key);
/* Ends this shard's part. *missing: the number of parts that are incomplete; UINT32_MAX:
 * another process assembles. With 0 the parts are open, and the engine is to be run once more
 * to assemble them; a bake in one process gets 0, too. */
int prt_shard_close(struct bake *b, uint32_t *missing);
/* Removes the parts of a bake that was `written`; frees b->shard. */
void prt_shard_destroy(struct bake *b, bool written);

/* Clusters are read from the parts: nothing is traced. */
bool prt_shard_assembling(const struct bake *b);
/* The part is complete: nothing is to be done before prt_shard_close. */
bool prt_shard_done(const struct bake *b);
/* prt_parallel_for over the clusters of this process that its checkpoint does not have: all,
 * its own, or none while assembling. Then, for a shard, writes the results of its own clusters
 * to its part, or reads those of all clusters while assembling. `slot` names the results of
 * `range`. *part: the tensor of this process is incomplete, because the other parts are not
 * assembled yet. */
int prt_shard_for(struct bake *b, const char *stage, prt_loop_fn range, void *arg,
                  const struct slot *slot, bool *part);

#endif
