/* SPDX-License-Identifier: MIT */
/* Arrays of a bake in an unlinked temporary file, for bakes that need more memory than they may
 * take (options.memory): the rows of factored clusters, which all wait for the packing. Pages
 * of the file leave the process when they are not in use. */
#ifndef PRT_BAKE_SPILL_H
#define PRT_BAKE_SPILL_H

#include "bake/stages.h"

/* Room for `bytes` in TMPDIR, else /var/tmp; the disk is taken as arrays arrive. NULL, with a
 * warning: no file can be made, and the arrays stay in memory. */
struct spill *prt_spill_create(const struct prt_context *ctx, uint64_t bytes);
void prt_spill_destroy(struct spill *spill);
/* Moves the rows and energies of a factored cluster to the file; those that find no room stay.
 * spill NULL: nothing. Thread-safe for distinct clusters. */
void prt_spill_factored(struct spill *spill, struct factored *f, uint32_t n_function,
                        uint32_t n_coef);
/* The cluster is not read for a while: its pages need not stay in memory. Any factored one. */
void prt_spill_rest(const struct factored *f);
/* Forgets all arrays; their clusters are finished. */
void prt_spill_clear(struct spill *spill);

#endif
