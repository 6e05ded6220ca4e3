/* SPDX-License-Identifier: MIT */
/* Exitances of a draft by few walks, to which its dipole is scaled. Private to the bake. */
#ifndef PRT_BAKE_DRAFT_WALKS_H
#define PRT_BAKE_DRAFT_WALKS_H

#include "bake/run.h"

/* Walks from vertices that are spread over the model, into b->draft_walks; b->scene and
 * b->clusters are there. PRT_NOMEM, PRT_CANCELLED. */
int prt_draft_walks_create(struct bake *b);
void prt_draft_walks_destroy(struct draft_walks *w);
/* [n_object] 0: the object keeps the dipole; w NULL: NULL. */
const uint8_t *prt_draft_walks_objects(const struct draft_walks *w);
/* Scales the kernel of cluster c, so that its sum over the surface is what walks return there;
 * does nothing where b->draft_walks is NULL or the object keeps the dipole. PRT_NOMEM. */
int prt_draft_walks_scale(const struct bake *b, uint32_t c, struct cut *cut);

#endif
