// SPDX-License-Identifier: MIT
// Shared by answer.c and its parts, basis_cache.c, coefficients.c, contracted_light.c,
// contracted_material.c, fold_material.c and sum_tensors.c.
#ifndef PRT_RELIGHT_ANSWER_H
#define PRT_RELIGHT_ANSWER_H

#include "prt/relight.h"

// PRT_MISMATCH unless the transport's media are free and each object's has the eta of its bake;
// PRT_ARG for media that are none.
int prt_free_media_check(const struct prt_context *ctx, const struct prt_transport *transport,
                         const struct prt_media *media);
// coef[medium][n_radial][3]: media in the radial basis of a tensor (FULL, RADIAL), the
// coefficients of R_d for multiple scattering and of e^(-sigma_t r) for single scattering
// (METHODS section 4). Logs a warning above 2 % error; PRT_ARG above prt/relight.h's limits.
// The basis comes from a cache of the process, see basis_cache.c. Thread-safe.
int prt_basis_coef(const struct prt_context *ctx, const struct prt_transport *transport,
                   const struct prt_tensor *tensor, const struct prt_media *media, float *coef);
// The object of each cluster; *out is NULL for one object. PRT_NOMEM.
int prt_cluster_objects(const struct prt_transport *transport, const struct prt_tensor *tensor,
                        uint32_t **out);
// The number of each cluster's medium; *out is NULL for one medium. PRT_NOMEM.
int prt_cluster_media(const struct prt_transport *transport, const struct prt_tensor *tensor,
                      const struct prt_media *media, uint8_t **out);

// The factor of plane k of a single-scattering tensor whose material is free: the phase
// function's a_l times sigma_s, channel by channel. Y_k comes in when the view is known.
void prt_phase_plane_factor(const struct prt_material *material,
                            const struct prt_tensor *tensor, unsigned k, float factor[3]);
// prt_rows_fold with separate coefficients for every medium and plane,
// [medium][n_phase][n_radial][3]; medium: [n_cluster], NULL: 0. The smallest entries, which
// together hold error^2 of the energy of all colours, are dropped, where every object counts
// with the same mean energy a vertex. object: [n_cluster], NULL: there is one.
int prt_rows_fold_planes(const struct prt_context *ctx, const struct prt_tensor *tensor,
                         const float *coef, const uint8_t *medium, const uint32_t *object,
                         double error, struct prt_rows *out);

// prt_relight of one tensor of lit's transport under lit's light. coef is NULL unless the
// tensor is FULL or RADIAL.
int prt_contracted_light_relight(const struct prt_context *ctx,
                                 const struct prt_contracted_light *lit,
                                 const struct prt_tensor *tensor, const float *coef, bool add,
                                 float *color);
// The result of prt_contract_light for one tensor, [prt_contracted_light_floats]; NULL for
// RADIAL.
const float *prt_contracted_light_rows(const struct prt_contracted_light *lit,
                                       const struct prt_tensor *tensor);
size_t prt_contracted_light_floats(const struct prt_tensor *tensor);
bool prt_contracted_light_is_of(const struct prt_contracted_light *lit,
                                const struct prt_transport *transport);

// prt_sum_parts for several lights, with part[].lit from prt_contract_lights.
// color[light][plane], each [n_vertex][3]. Several lights need DIAGONAL tensors.
int prt_sum_parts_lights(const struct prt_context *ctx, unsigned n_light, unsigned n_part,
                         const struct prt_term_input part[], unsigned n_plane,
                         float *const color[]);
struct prt_kernels;
// A cluster's contracted rows with the input's material and factors, [rank][n_light][planes][3]
// with planes = n_plane or the tensor's n_phase, whichever is less: in `to`, which has room for
// the tensor's n_phase planes, or in place where they need no change. part->lit is as above.
const float *prt_fold_cluster(const struct prt_kernels *kernels,
                              const struct prt_term_input *part, uint32_t cluster,
                              uint32_t rank, unsigned n_light, unsigned n_plane, float *to);

// Appends the layer of a tensor to c, whose most_rank is set. PRT_MISMATCH: the tensor is not
// FACTORED.
int prt_coefficients_add_layer(const struct prt_context *ctx,
                               const struct prt_transport *transport, uint32_t tensor,
                               unsigned n_plane, struct prt_coefficients *c);
// Fills one layer of n_light answers, which have the same layers; part->lit is as above.
int prt_coefficients_fill(const struct prt_context *ctx, const struct prt_term_input *part,
                          unsigned layer, unsigned n_light,
                          struct prt_coefficients *const out[]);

#endif
