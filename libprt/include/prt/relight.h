/* SPDX-License-Identifier: MIT */
/* prt/relight.h owns the contraction of transport with light and material (METHODS section 5).
 *
 * All functions block until they are done, divide their work among ctx->pool, use the
 * instruction sets that ctx->cpu allows, and are thread-safe: transports, contracted lights and
 * contracted transports are read-only, and outputs belong to the caller. They return PRT_OK or
 * a negative status and log one line for an error. After an error, arrays that were to be
 * filled hold nothing of meaning and *out of a create function is NULL. PRT_NOMEM and, with a
 * progress callback, PRT_CANCELLED are possible everywhere and not repeated below.
 *
 * Accuracy. Results agree with the definition to f32 rounding: each colour to 1e-5 of the sum
 * of the absolute values of its terms. Where ctx->cpu has AVX-512 VNNI, or AVX2 and no
 * AVX-512, rows of pairs and expansions use 16-bit integers, with the same results on both: the
 * colours of a bake then differ from those in f32 by some 3e-5 RMS under a sky, up to 8e-5
 * under lamps and suns, and by about 1e-4 of the largest; for rows of random signs, whose sums
 * cancel, by 2e-4 (prt-bench relight_file and relight_factored print both). In integers a
 * light's colours do not depend on the lights beside it. */
#ifndef PRT_RELIGHT_H
#define PRT_RELIGHT_H

#include "prt/light.h"
#include "prt/transport.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Lights of one call share one pass over the transport. */
enum { PRT_RELIGHT_MAX_LIGHTS = 16 };

/* Whether calls with this mask of enum prt_cpu contract rows of pairs and expand in 16-bit
 * integers. Thread-safe. */
bool prt_relight_in_integers(unsigned cpu);

/* ---- one tensor -------------------------------------------------------------------------- */

/* Step 1: FACTORED rows times lights.
 * light: [n_light] Haar vectors of the tensor's cube, n_light in [1, PRT_RELIGHT_MAX_LIGHTS].
 * out: [n_light][n_row][P][3] with P = n_phase for DIAGONAL, n_function for FULL; linear RGB.
 * PRT_MISMATCH: a light of another cube; PRT_ARG: other storage, other n_light. */
int prt_contract_light(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       unsigned n_light, const struct prt_light *const light[], float *out);

/* Step 1b, FULL only: folds the radial functions with a material's coefficients.
 * in: [n_row][n_phase][n_radial][3], one light of step 1. coef: [n_radial][3].
 * out: [n_row][n_phase][3]. PRT_ARG: the tensor is not FULL and FACTORED. */
int prt_contract_material(const struct prt_context *ctx, const struct prt_tensor *tensor,
                          const float *in, const float *coef, float *out);

/* The other order: folds a material (coef [n_radial][3]) into the rows of a FULL, FACTORED
 * tensor. *out gets DIAGONAL rows of halves [n_row] over [n_phase][3] in arrays of its own,
 * which the caller frees with prt_rows_finish. Light then gives the colours of the order above,
 * but for the rounding of the rows to halves. PRT_ARG: another tensor, or one without rows. */
int prt_rows_fold(const struct prt_context *ctx, const struct prt_tensor *tensor,
                  const float *coef, struct prt_rows *out);

/* Step 2, FACTORED: colour[v] = sum_r U[v][r] b[r].
 * b: [n_light][n_row][n_phase][3], contracted rows. color: [n_light][n_phase][n_vertex][3],
 * vertices in the file's order, linear RGB radiance. add: adds to color; false: overwrites it.
 * PRT_ARG: other storage, more than PRT_RELIGHT_MAX_LIGHTS * 16 planes. */
int prt_expand(const struct prt_context *ctx, const struct prt_tensor *tensor, unsigned n_light,
               const float *b, bool add, float *color);

/* Both steps for SPARSE storage, DIAGONAL: color as prt_expand gives it. PRT_MISMATCH: a light
 * of another cube; PRT_ARG: other storage, other n_light. */
int prt_relight_sparse(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       unsigned n_light, const struct prt_light *const light[], bool add,
                       float *color);

/* RADIAL storage (polynomial transport): color[plane][v][ch] = sum_j coef[j][ch]
 * U[plane][j][ch][v], coef: [n_radial][3]. PRT_ARG: other storage. */
int prt_relight_radial(const struct prt_context *ctx, const struct prt_tensor *tensor,
                       const float *coef, bool add, float *color);

/* Any tensor under lights: the steps that its storage needs. coef: [n_radial][3] for FULL and
 * RADIAL, NULL otherwise. light is ignored for RADIAL, which gives the planes once. color:
 * [n_light][n_phase][n_vertex][3]. PRT_ARG: coef missing or not wanted. */
int prt_relight(const struct prt_context *ctx, const struct prt_tensor *tensor,
                unsigned n_light, const struct prt_light *const light[], const float *coef,
                bool add, float *color);

/* One tensor of a sum: FACTORED or RADIAL. The arrays are borrowed for the call. */
struct prt_term_input {
    const struct prt_tensor *tensor;
    const float *lit;         /* FACTORED: prt_contract_light's output for one light */
    const float *coef;        /* FULL, RADIAL: [medium][n_radial][3]; NULL otherwise */
    const float (*factor)[3]; /* [medium][n_phase] factors of plane k's channels; NULL: 1 */
    const uint8_t *medium;    /* [n_cluster] number of each cluster's medium; NULL: 0 */
    const uint8_t *dark;      /* [n_cluster] not 0: adds nothing to this cluster; NULL: none */
    uint32_t most_rank;       /* FACTORED: only the first rows of each cluster; 0: all */
};
enum { PRT_MOST_PARTS = PRT_MOST_TENSORS };

/* color[k][n_vertex][3] = the sum over the inputs of their plane k, k < n_plane in [1,16],
 * overwritten; further planes are not computed. All tensors are of one model. Materials are
 * folded into a cluster's contracted rows just before its vertices are computed, so one pass
 * suffices. PRT_ARG: n_part outside [1, PRT_MOST_PARTS], n_plane, or an input without what it
 * needs. */
int prt_sum_parts(const struct prt_context *ctx, unsigned n_part,
                  const struct prt_term_input part[], unsigned n_plane, float *color);

struct prt_radial; /* prt/radial.h */
/* The radial basis of a FULL or RADIAL tensor, made from the table in the file. The caller
 * destroys *out with prt_radial_destroy. PRT_ARG: the tensor has no basis. */
int prt_tensor_radial(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_tensor *tensor, struct prt_radial **out);

/* ---- a transport contracted with one of its two free quantities
 * -------------------------------- */

/* A transport's bases contracted with one light, for many materials under it (METHODS section
 * 5: light once, then one material per query). Read-only; refers to `transport`, which must
 * outlive it.
 */
struct prt_contracted_light;
/* light: of the transport's cube size. PRT_MISMATCH: sparse storage, or another cube size. */
int prt_contracted_light_create(const struct prt_context *ctx,
                                const struct prt_transport *transport,
                                const struct prt_cube *light,
                                struct prt_contracted_light **out);
void prt_contracted_light_destroy(struct prt_contracted_light *lit); /* NULL: nothing */
size_t prt_contracted_light_bytes(const struct prt_contracted_light *lit);

/* A joint transport contracted with its objects' media, for many lights (METHODS section 5, the
 * other order). It behaves as a wavelet transport: queries give no media. The smallest entries
 * are dropped, up to PRT_FIXED_ERROR of the colours (RMS over lights). Read-only; refers to
 * `transport`, which must outlive it. */
#define PRT_FIXED_ERROR 3e-3
struct prt_contracted_transport;
/* Takes some tenths of a second; copies the media. PRT_MISMATCH: the transport is not joint, or
 * a medium has another eta than its object's bake; PRT_ARG: the radial basis does not cover a
 * medium. */
int prt_contracted_transport_create(const struct prt_context *ctx,
                                    const struct prt_transport *transport,
                                    const struct prt_media *media,
                                    struct prt_contracted_transport **out);
void prt_contracted_transport_destroy(
    struct prt_contracted_transport *fixed); /* NULL: nothing */
/* Makes the columns (prt/columns.h) of its folded rows: a light then takes less time.
 * Takes some tenths of a second; no other thread may use `fixed` meanwhile. PRT_NOMEM:
 * it keeps those that were made. */
int prt_contracted_transport_columns(const struct prt_context *ctx,
                                     struct prt_contracted_transport *fixed);
/* Lives as long as `fixed`. */
const struct prt_transport *
prt_contracted_transport_get(const struct prt_contracted_transport *fixed);
size_t prt_contracted_transport_bytes(const struct prt_contracted_transport *fixed);

/* ---- queries ------------------------------------------------------------------------------
 */

/* The command contract's --term. */
enum prt_answer_term {
    PRT_ANSWER_MULTIPLE, /* (1/pi) B, without outgoing Fresnel transmittance */
    PRT_ANSWER_SINGLE,   /* L^(1), without outgoing Fresnel transmittance */
    PRT_ANSWER_TOTAL,    /* F_t(eta, w_o) [multiple/T + single], METHODS §1 (exit); unscattered
                          * light is added to multiple */
    PRT_ANSWER_UNSCATTERED, /* of walks, as B/pi; 0 of the dipole */
};

/* Pointers are borrowed for the call. */
struct prt_query {
    enum prt_answer_term term;
    const struct prt_cube *light; /* of the transport's cube size; NULL for polynomial */
    struct prt_media media;       /* zeroed: the baked ones; zeroed for wavelet transport */
    const float *eye;             /* [3] mm, world; NULL: mean Fresnel, l = 0 phase */
    const struct prt_contracted_light *lit; /* instead of light, when not NULL */
    enum prt_exit exit;                     /* of PRT_ANSWER_TOTAL */
    uint32_t most_rank; /* colours and planes: rows of a cluster, 0: all; an odd number is one
                         * more. Later rows matter less. All are used with lit, and of tensors
                         * that are sparse or have opaque and translucent vertices in a cluster
                         */
    /* Not 0: prt_answer_planes and planes of prt_answer_many keep the terms apart, and have at
     * most so many planes: multiple scattering, then single scattering's plane 0 times Y_00 and
     * its planes to be multiplied by Y_k(w_o'), before prt_view_correct. Media that scatter
     * evenly have no plane behind the second, and PRT_ANSWER_MULTIPLE has the first alone. */
    unsigned most_apart;
    /* Planes that are kept apart, and coefficients: with the planes of exit (METHODS §3.6) of a
     * bake that has them, behind the others. Plane 0 of them is times Y_00. Colours with an eye
     * and planes that are not kept apart always have them. */
    bool exits;
    const float (*gain)[3]; /* [n_block] factors of the opaque blocks' colours (prt/variant.h);
                             * NULL: 1. Planes that are not kept apart, and coefficients, are
                             * without them; prt_answer_many alone has them in planes */
};

/* Colours color[n_vertex][3] in the file's vertex order, linear RGB radiance, clamped at 0.
 * Without an eye F_t is its cosine-weighted mean and the phase function its l = 0 part. Opaque
 * vertices have albedo/pi E for every term but single, which is 0. PRT_MISMATCH: a light of
 * another cube, media for a wavelet transport or of another eta than an object's bake; PRT_ARG:
 * no light where one is needed, another transport's lit, an eye that is not finite, a material
 * that the radial basis does not cover. */
int prt_answer_colors(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, float (*color)[3]);

/* What a renderer shades each pixel from: planes[n_plane][n_vertex][3], before outgoing Fresnel
 * transmittance and clamping. Plane 0 does not depend on the view: multiple + Y_00 single.
 * Planes 1 and on are to be multiplied by Y_k(w_o'); everything else is in them. In planes of
 * PRT_ANSWER_TOTAL single scattering has the factor d = prt_exit_divisor, and F_t/d times their
 * sum is the radiance of a translucent surface (prt_shade does so). planes NULL:
 * only *n_plane is set. Statuses as prt_answer_colors; *n_plane is set last. */
int prt_answer_planes(const struct prt_context *ctx, const struct prt_transport *transport,
                      const struct prt_query *query, unsigned *n_plane, float *planes);

/* Takes the colours of the queries i with takes[i], while they are in the cache: put() is
 * called with vertices [begin, end) of query i, color[0] being vertex begin's, on any thread of
 * the call, for several ranges at once. out[i] of such a query is room for the call's own use.
 */
struct prt_colors_sink {
    const bool *takes;
    void (*put)(void *user, const struct prt_context *ctx, unsigned i, size_t begin, size_t end,
                const float (*color)[3]);
    void *user;
};

/* Planes of exit of a query that sets `exits`: 9, or 0 where the bake, the term or the media
 * have none. Thread-safe. */
unsigned prt_answer_exit_planes(const struct prt_transport *transport,
                                const struct prt_query *query);

/* n queries, n in [1, PRT_RELIGHT_MAX_LIGHTS], in one pass over the transport where they differ
 * only in their lights. out[i]: colours [n_vertex][3], or, where planes[i], prt_answer_planes'
 * output. sink: of the colours; NULL: none. Statuses as prt_answer_colors; the first query that
 * fails fails the call. */
int prt_answer_many(const struct prt_context *ctx, const struct prt_transport *transport,
                    unsigned n, const struct prt_query query[], const bool planes[],
                    float *const out[], const struct prt_colors_sink *sink);

/* ---- coefficients: contractions that a viewer expands itself
 * -------------------------------------------------------------------------------- */

/* The contracted rows of one tensor: b[row][n_plane][3] = half * scale. Packed,
 * b[row][n_plane] is a u32: two's complement mantissas of 10 bits, R in bits 0-9, G 10-19, B
 * 20-29. Two of them in turn, the first at an even place, share an exponent e of 4 bits, its
 * low ones in bits 30-31 of the first and its high ones there in the second: a coefficient is
 * mantissa * 2^(e - 9) * scale. The last of an odd number has a u32 of zeros, but for e, beside
 * it. Rows are those of the clusters in their order, of each the first `rank`, or most_rank
 * where that is less. */
struct prt_coefficient_layer {
    uint32_t tensor, n_plane; /* index into the transport's tensors; planes 0 to n_plane - 1 */
    uint32_t n_row;
    float scale;  /* a power of two */
    size_t begin; /* of its first half in `half`, a multiple of 32 */
};
struct prt_coefficients {
    /* Set by the caller. */
    uint32_t most_rank; /* rows of a cluster; 0: all. Later rows matter less, and rows that are
                         * left out are not computed */
    bool phases;        /* the planes of a phase function that is not even */
    bool packed;    /* a u32 for r, g and b: two thirds of the bytes, colours some 0.1 % off */
    uint16_t *half; /* [n_half], 4-byte aligned; packed: two for each u32 */
    /* Set by prt_coefficients_plan, the scales by prt_answer_coefficients. */
    uint32_t n_layer;
    struct prt_coefficient_layer layer[PRT_MOST_PARTS];
    size_t n_half;
};
/* Finds the layers of a query and the number of halves; out->half is not read. Layers of
 * multiple scattering have one plane. query->eye is ignored: the viewer applies what depends on
 * the view. PRT_MISMATCH: sparse or polynomial storage. */
int prt_coefficients_plan(const struct prt_context *ctx, const struct prt_transport *transport,
                          const struct prt_query *query, struct prt_coefficients *out);
/* Fills the halves and scales of n planned answers, n in [1, PRT_RELIGHT_MAX_LIGHTS], in one
 * pass over the rows where they differ only in their lights. With U of each layer's tensor,
 *     value[k][v] = sum over layers with a plane k of sum_r U[v][r] b[r][k],
 * plane 0 of the layers of all terms together is prt_answer_planes' plane 0 of a view-less
 * query, and planes k > 0 are single scattering's, to be multiplied by Y_k(w_o'); both before
 * prt_view_correct, which the viewer replaces by the factor of prt_view_slope. Layers of
 * PRT_TERM_VIEW (query->exits) are added behind that factor, each plane times its Y_k. */
int prt_answer_coefficients(const struct prt_context *ctx,
                            const struct prt_transport *transport, unsigned n,
                            const struct prt_query query[],
                            struct prt_coefficients *const out[]);

/* What turns the sum of the layers into radiance at translucent vertices of one medium: without
 * an eye colour = max(0, mean * value), towards an eye max(0, F_t(eta, w_o) / divisor * value).
 * For terms other than the total both factors are 1. */
struct prt_outgoing {
    float eta, roughness;
    float mean;       /* of F_t over the hemisphere, over divisor; 1 for a part of the total */
    float divisor;    /* of F_t */
    float view_slope; /* of single scattering: prt_view_slope */
};
/* At vertices of an object that has this material; term and exit: of the query. */
void prt_outgoing_of(const struct prt_material *material, enum prt_answer_term term,
                     enum prt_exit exit, struct prt_outgoing *out);

/* The largest part of R_d (of e^(-sigma_t r)) that a radial basis may lose of a material. */
#define PRT_MATERIAL_MOST_ERROR 0.10
/* The same for X07's own bases, polynomials and hats, which serve for comparison. */
#define PRT_MATERIAL_MOST_ERROR_X07 0.30

/* *error: what a joint or polynomial transport loses of media, of the worst of them, beside the
 * bake's own measured error. The largest integral of |dR| over that of R among the tensors of
 *`term`; multiple scattering adds 4 % for each sample spacing that a mean free path is short of
 *. Takes at most 0.5 ms once the basis is cached. PRT_ARG, with the
 * parameter and its range in the log: the error exceeds the limits above, as queries refuse it;
 * PRT_MISMATCH: another eta or a fixed material. *error is set in every case. */
int prt_answer_material_error(const struct prt_context *ctx,
                              const struct prt_transport *transport,
                              const struct prt_media *media, enum prt_answer_term term,
                              double *error);

#ifdef __cplusplus
}
#endif
#endif
