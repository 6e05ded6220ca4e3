// SPDX-License-Identifier: MIT
// Contraction of rows by their columns.
#ifndef PRT_RELIGHT_CONTRACT_COLUMNS_H
#define PRT_RELIGHT_CONTRACT_COLUMNS_H

#include "kernels.h"
#include "prt/columns.h"

// Rows of up to PRT_RELIGHT_MAX_LIGHTS lights: out[l * light_pitch + row * row_pitch ...][3
// n_plane]. taken[l]: whether light l was contracted; false where so many columns matter that
// rows are faster, or a coefficient is not finite. PRT_NOMEM.
int prt_contract_columns(const struct prt_context *ctx, const struct prt_tensor *tensor,
                         unsigned n_light, const struct prt_light *const light[],
                         size_t light_pitch, size_t row_pitch, float *out, bool taken[]);

#endif
