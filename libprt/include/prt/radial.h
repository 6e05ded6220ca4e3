/* SPDX-License-Identifier: MIT */
/* prt/radial.h owns bases over radius: any R_d(r) or e^(-sigma_t r) as sum_j c_j B_j(r). */
#ifndef PRT_RADIAL_H
#define PRT_RADIAL_H

#include "prt/medium.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_radial_kind {
    PRT_RADIAL_REDUCED = 0, /* leading singular vectors of the weighted family (METHODS §4) */
    PRT_RADIAL_POLYNOMIAL,  /* X07: degree d pieces on DP knots, C^(d-1) constrained LSQ */
    PRT_RADIAL_HAT,         /* C0 linear spline on the same knots */
    PRT_RADIAL_X07,         /* POLYNOMIAL by X07's own plain least squares: for comparison */
};
enum prt_radial_family {
    PRT_FAMILY_DIPOLE = 0, /* R_d, weight 2 pi r dr, conserves the integral */
    PRT_FAMILY_EXTINCTION, /* e^(-sigma_t r), for single scattering */
};
/* Functions are scaled to integral |B_j| 2 pi r dr = 1 (dr for extinction), so that
 * coefficients are at most of the order of rho_d (1/sigma_t) and nothing cancels by orders of
 * magnitude. B_j on a shared grid, linear in between (dense enough that this is far below the
 * fit error); 0 beyond the last grid point. */
struct prt_radial {
    enum prt_radial_kind kind;
    enum prt_radial_family family;
    uint32_t n_function, n_grid;
    double eta;         /* dipole family */
    double range[2][2]; /* covered [sigma_s'|sigma_t, sigma_a][lo,hi] mm^-1 */
    float *r;           /* [n_grid] mm, ascending, r[0] = 0 */
    float *value;       /* [n_function][n_grid] */
    /* Measured on materials off the fit grid: integral |dR| 2 pi r dr over that of R, both up
     * to the last radius (dr for extinction). */
    double mean_error, worst_error;
};
struct prt_profile; /* prt/profile.h */
struct prt_radial_options {
    enum prt_radial_kind kind;
    enum prt_radial_family family;
    double eta;                /* dipole only */
    double sigma_lo, sigma_hi; /* sigma_s' (or sigma_t) range; 0: METHODS' whole range */
    double sigma_a_lo, sigma_a_hi;
    double radius_mm;    /* largest distance needed (object diameter); 0: 60 */
    uint32_t n_function; /* 0: smallest that meets max_error; splines: at most this many
                          * (pieces have degree+1 each, hats one more than intervals) */
    double max_error;    /* worst over the range; 0: 0.001 */
    uint32_t degree;     /* POLYNOMIAL: 1 linear, 2 quadratic */
    /* REDUCED, dipole family: profiles to hold exactly (a user's curve, a slab), at most 8.
     * What the n_function others leave of each becomes a function more, unless that is < 5e-4.
     */
    const struct prt_profile *extra;
    uint32_t n_extra;
};
int prt_radial_create(const struct prt_context *ctx, const struct prt_radial_options *options,
                      struct prt_radial **out);
void prt_radial_destroy(struct prt_radial *radial);
/* out[i*n_function + j] = B_j(r[i]). */
void prt_radial_eval(const struct prt_radial *radial, size_t n, const float *r, float *out);
/* The basis back from a .prt's table: options give kind, family, eta and range; the error is
 * measured anew. PRT_FORMAT for tables this module did not make. */
int prt_radial_from_table(const struct prt_context *ctx,
                          const struct prt_radial_options *options, uint32_t n_function,
                          uint32_t n_grid, const float *r, const float *value,
                          struct prt_radial **out);
/* coef[n_function][3] of a material, from its dipole (or e^(-sigma_t r)); *error gets the
 * largest relative error over channels, true also for materials outside the range. <= 0.2 ms.
 * PRT_MISMATCH when eta is not the basis'. Thread-safe, allocates nothing; error may be NULL.
 */
int prt_radial_fit_material(const struct prt_radial *radial,
                            const struct prt_material *material, float *coef, double *error);
#ifdef __cplusplus
}
#endif
#endif
