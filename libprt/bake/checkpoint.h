/* SPDX-License-Identifier: MIT */
/* The checkpoint of a bake (options.checkpoint): finished work in two files, from which the
 * same bake continues after any interruption. PATH has a record for each finished cluster of a
 * tensor and for each finished piece of pass 1; PATH.rows has the rows of pass 1 until no
 * cluster needs them. Records have hashes: reading stops at the first one that was not written
 * whole. A checkpoint that cannot be written (full disk, options.checkpoint_room) costs only
 * the ability to resume. Every function may be called without a checkpoint. */
#ifndef PRT_BAKE_CHECKPOINT_H
#define PRT_BAKE_CHECKPOINT_H

#include "bake/cluster_records.h"

/* Opens options.checkpoint, where there is one, as b->checkpoint, and reads the records; those
 * of another key are dropped. PRT_IO: the file cannot be opened, or another process has it. */
int prt_checkpoint_open(struct bake *b, uint64_t key);
/* Closes the files and frees b->checkpoint; removes them when the bake was `written`. */
void prt_checkpoint_close(struct bake *b, bool written);

/* prt_parallel_for over the clusters first, first + step, ... Clusters of the checkpoint are
 * read, the others pass through `range` and are recorded. Slots are numbered by the calls. */
int prt_checkpoint_for(struct bake *b, const char *stage, uint32_t first, uint32_t step,
                       prt_loop_fn range, void *arg, const struct slot *slot);

/* Whether the checkpoint has all clusters of slot 0: rows of pass 1 are not needed. */
bool prt_checkpoint_skips_rows(struct bake *b);

/* Rows [begin, begin + n) of pass 1, one piece. read: false unless the checkpoint has them.
 * Thread-safe. checkpoint may be NULL. */
bool prt_checkpoint_read_rows(const struct checkpoint *checkpoint, const struct half_rows *rows,
                              size_t begin, size_t n);
void prt_checkpoint_write_rows(struct checkpoint *checkpoint, const struct half_rows *rows,
                               size_t begin, size_t n);

/* One array that stands for the whole of pass 1 (polynomial transport). */
bool prt_checkpoint_read_array(const struct checkpoint *checkpoint, void *at, size_t bytes);
void prt_checkpoint_write_array(struct checkpoint *checkpoint, void *at, size_t bytes);

#endif
