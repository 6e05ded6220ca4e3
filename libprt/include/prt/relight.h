/* SPDX-License-Identifier: MIT */
/* prt/relight.h owns the contraction kernels: light and material meet transport. */
#ifndef PRT_RELIGHT_H
#define PRT_RELIGHT_H

#include "prt/light.h"
#include "prt/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Several lights in one call share the reading. Where the machine has VNNI, three lights or
 * more meet rows of pairs, and four phase planes or more are expanded, in 16-bit integers: a
 * bake's colours then differ from those of one light alone by some 3e-5 RMS under a sky, up to
 * 8e-5 under lamps and suns, and by about 1e-4 of the largest; rows of random signs, whose sums
 * cancel, by 2e-4 (prt-bench relight_file, relight_factored print both). Otherwise, and
 * elsewhere, by f32 rounding. */
enum { PRT_RELIGHT_MAX_LIGHTS = 16 };

/* Number of colour planes a tensor gives: its n_phase. */

/* Step 1, FACTORED only: rows . light.  out[light][n_row][P][3] with P = n_phase for DIAGONAL,
 * n_function for FULL. Lights are Haar vectors of the tensor's cube size, PRT_MISMATCH else. */
int prt_contract_light(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       unsigned n_light, const struct prt_light *const light[], float *out);
/* FULL only: folds radial functions with material coefficients, per phase plane:
 * in [n_row][n_phase][n_radial][3] (one light of step 1), coef [n_radial][3] ->
 * out [n_row][n_phase][3]. */
int prt_contract_material(const struct prt_context *ctx, const struct prt_tensor *tensor,
                          const float *in, const float *coef, float *out);
/* Material first: rows of a FULL tensor folded with coef [n_radial][3] into DIAGONAL rows of
 * f16, freshly allocated (free with prt_rows_finish). Same answers either way round. */
int prt_rows_fold(const struct prt_context *ctx, const struct prt_tensor *tensor,
                  const float *coef, struct prt_rows *out);
/* Step 2, FACTORED: colours from contracted rows b[light][n_row][n_phase][3], weighting the
 * phase planes: color[light][plane][n_vertex][3] in FILE vertex order, linear RGB. Adds to
 * color when `add`, else overwrites. */
int prt_expand(const struct prt_context *ctx, const struct prt_tensor *tensor, unsigned n_light,
               const float *b, bool add, float *color);
/* SPARSE in one step: the same output as prt_expand. */
int prt_relight_sparse(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       unsigned n_light, const struct prt_light *const light[], bool add,
                       float *color);
/* RADIAL: color[plane][v][ch] = sum_j coef[j][ch] U[plane][j][ch][v]. */
int prt_relight_radial(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       const float *coef, bool add, float *color);
/* Any of the above: the whole tensor under lights. coef NULL unless FULL/RADIAL; lights are
 * ignored by RADIAL. color[light][n_phase][n_vertex][3]. */
int prt_relight(const struct prt_context *ctx, const struct prt_tensor *tensor,
                unsigned n_light, const struct prt_light *const light[], const float *coef,
                bool add, float *color);

/* What one tensor gives to a sum of several: FACTORED or RADIAL. */
struct prt_term_input {
    const struct prt_tensor *tensor;
    const float *lit;         /* FACTORED: prt_contract_light's, of one light */
    const float *coef;        /* FULL, RADIAL: [n_radial][3]; NULL otherwise */
    const float (*factor)[3]; /* [n_phase] plane k's channels are multiplied by; NULL: 1 */
    const uint8_t *dark;      /* [n_cluster] not 0: gives nothing to this cluster; NULL: none */
};
enum { PRT_MOST_PARTS = 4 };
/* color[k][n_vertex][3] = the sum over parts of their plane k, k < n_plane, overwritten; planes
 * from n_plane on are not computed. All tensors are of one model. One pass: materials are
 * folded into a cluster's contracted rows just before its vertices. n_part in [1,
 * PRT_MOST_PARTS]. */
int prt_sum_parts(const struct prt_context *ctx, unsigned n_part,
                  const struct prt_term_input part[], unsigned n_plane, float *color);

/* What is asked of a transport, in the words of the command contract. */
enum prt_answer_term {
    PRT_ANSWER_MULTIPLE,
    PRT_ANSWER_SINGLE,
    PRT_ANSWER_TOTAL,
};
/* A transport's bases contracted with one light, shared by every edit under it: what is left of
 * a question is the material (METHODS section 5: light once, then material by request). Not for
 * sparse storage, PRT_MISMATCH. Refers to `transport`, which must outlive it; read-only after.
 */
struct prt_contracted_light;
int prt_contracted_light_create(const struct prt_context *ctx,
                                const struct prt_transport *transport,
                                const struct prt_cube *light,
                                struct prt_contracted_light **out);
void prt_contracted_light_destroy(struct prt_contracted_light *lit);
size_t prt_contracted_light_bytes(const struct prt_contracted_light *lit);

/* A joint transport with one material put in, contracted by the material first (METHODS
 * section 5, the other way round): what is left is a wavelet transport, for lights that move
 * while the material stays. A question's material is NULL then. The least entries,
 * PRT_FIXED_ERROR of what colours are made of (RMS over lights), are dropped.
 * Takes some tenths of a second. PRT_MISMATCH unless both light and material are free; refers
 * to `transport`, which must outlive it; read-only after. */
#define PRT_FIXED_ERROR 3e-3
struct prt_contracted_transport;
int prt_contracted_transport_create(const struct prt_context *ctx,
                                    const struct prt_transport *transport,
                                    const struct prt_material *material,
                                    struct prt_contracted_transport **out);
void prt_contracted_transport_destroy(struct prt_contracted_transport *fixed);
const struct prt_transport *
prt_contracted_transport_get(const struct prt_contracted_transport *fixed);
size_t prt_contracted_transport_bytes(const struct prt_contracted_transport *fixed);

struct prt_query {
    enum prt_answer_term term;
    const struct prt_cube *light;        /* of the transport's cube size; NULL for polynomial */
    const struct prt_material *material; /* NULL: the baked one; a wavelet transport refuses */
    const float *eye;                    /* [3] mm, world; NULL: mean Fresnel, l = 0 phase */
    const struct prt_contracted_light *lit; /* instead of light, when not NULL */
};
/* Per-vertex colours [n_vertex][3] in file order (DESIGN, command contract):
 * multiple (1/pi) B; single L1; total F_t(eta, w_o) [..] with the eye, else the cosine-weighted
 * mean transmittance and the phase function's l = 0 part; opaque vertices albedo/pi E. Final
 * radiance is clamped at 0. Nothing in color[] is meant when it fails. */
int prt_answer_colors(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, float (*color)[3]);
/* The parts a renderer needs per pixel: plane 0 holds multiple + h_0 single (view-free part),
 * planes 1.. the other phase planes, before outgoing Fresnel and clamping.
 * planes[n_plane][n_vertex][3]; call with planes NULL to learn *n_plane. phase coefficients
 * needed to weight plane k by are already in the planes: multiply by Y_k(w_o'). */
int prt_answer_planes(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, unsigned *n_plane, float *planes);
/* The largest share of R_d (of e^(-sigma_t r)) that a free material may lose to the basis. */
#define PRT_MATERIAL_MOST_ERROR 0.10
/* To a basis of X07's kinds, polynomials and hats, which are there to be compared with. */
#define PRT_MATERIAL_MOST_ERROR_X07 0.30
/* What the radial bases of a joint or polynomial transport leave of a material: the largest
 * integral |dR| over that of R of the tensors that `term` asks, and for multiple scattering 4 %
 * for each sample spacing that a mean free path is short of: what the answer may lose beside
 * the bake's own measured error. <= 0.5 ms. PRT_ARG, naming the parameter and its range, above
 * these (as answers do); PRT_MISMATCH for another eta or a fixed medium. */
int prt_answer_material_error(const struct prt_context *ctx,
                              const struct prt_transport *transport,
                              const struct prt_material *material, enum prt_answer_term term,
                              double *error);
struct prt_radial; /* prt/radial.h */
/* The radial basis of a FULL or RADIAL tensor, made from its table; caller
 * prt_radial_destroy()s. */
int prt_tensor_radial(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_tensor *tensor, struct prt_radial **out);
/* Several questions with one reading of the transport: question i goes to out[i], colours
 * [n_vertex][3], or planes as prt_answer_planes gives them where planes[i]. n in
 * [1, PRT_RELIGHT_MAX_LIGHTS]. Nothing in out[] is meant when it fails. */
int prt_answer_many(const struct prt_context *ctx, const struct prt_transport *transport,
                    unsigned n, const struct prt_query query[], const bool planes[],
                    float *const out[]);

#ifdef __cplusplus
}
#endif
#endif
