/* SPDX-License-Identifier: MIT */
/* row_columns.h owns the decision to store a wavelet model's rows by column (prt/columns.h),
 * with which a light alone takes a fifth to two thirds of the time. It takes some 0.2 s of a
 * background worker and three quarters of the file's size, so that it is done for a model that
 * many lights were asked of, where --memory has room. Loop thread. */
#ifndef RELIGHTD_ROW_COLUMNS_H
#define RELIGHTD_ROW_COLUMNS_H

#include "store/models.h"

/* So many more lights were contracted with the model's file, whose entry the caller holds. */
void row_columns_count(struct model *model, struct cache_entry *file, unsigned n_light);

#endif
