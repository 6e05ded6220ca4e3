// SPDX-License-Identifier: MIT
// Between answer.c, basis_cache.c and contracted_light.c.
#ifndef PRT_RELIGHT_ANSWER_H
#define PRT_RELIGHT_ANSWER_H

#include "prt/relight.h"

// PRT_MISMATCH unless the material may be given to this transport: it is free and of its eta.
int prt_free_material_check(const struct prt_context *ctx,
                            const struct prt_transport *transport,
                            const struct prt_material *material);
// coef[n_radial][3] of a material in a tensor's own radial basis (FULL, RADIAL): R_d for
// multiple, e^(-sigma_t r) for single scattering. Warns when the basis does not cover it.
int prt_basis_coef(const struct prt_context *ctx, const struct prt_transport *transport,
                   const struct prt_tensor *tensor, const struct prt_material *material,
                   float *coef);

// What plane k of a single-scattering tensor of a free material is multiplied by, beside Y_k:
// the phase function's a_l and sigma_s.
void prt_phase_plane_factor(const struct prt_material *material,
                            const struct prt_tensor *tensor, unsigned k, float factor[3]);
// prt_rows_fold with coefficients [n_phase][n_radial][3] of each plane its own; entries worth
// up to error^2 of the energy of all colours are dropped.
int prt_rows_fold_planes(const struct prt_context *ctx, const struct prt_tensor *tensor,
                         const float *coef, double error, struct prt_rows *out);

// A tensor of lit's transport under its light. coef NULL unless FULL, RADIAL.
int prt_contracted_light_relight(const struct prt_context *ctx,
                                 const struct prt_contracted_light *lit,
                                 const struct prt_tensor *tensor, const float *coef, bool add,
                                 float *color);
// What the light was contracted to: [prt_contracted_light_floats] of prt_contract_light; NULL
// for RADIAL.
const float *prt_contracted_light_rows(const struct prt_contracted_light *lit,
                                       const struct prt_tensor *tensor);
size_t prt_contracted_light_floats(const struct prt_tensor *tensor);
bool prt_contracted_light_is_of(const struct prt_contracted_light *lit,
                                const struct prt_transport *transport);

// prt_sum_parts for several lights, part[].lit of prt_contract_lights: color[light][plane],
// each [n_vertex][3]. More than one light: DIAGONAL tensors alone.
int prt_sum_parts_lights(const struct prt_context *ctx, unsigned n_light, unsigned n_part,
                         const struct prt_term_input part[], unsigned n_plane,
                         float *const color[]);

#endif
