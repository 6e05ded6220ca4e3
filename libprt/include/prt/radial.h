/* SPDX-License-Identifier: MIT */
/* prt/radial.h owns bases over radius: R_d(r) or e^(-sigma_t r) as sum_j c_j B_j(r) (METHODS
 * §4, X07 eq 8, X07 eq 13). A basis is read-only: threads may share it. */
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
    PRT_RADIAL_X07,  /* POLYNOMIAL by the unweighted least squares of X07: for comparison */
    PRT_RADIAL_WALK, /* of files only: walks of a grid of media (prt/walk_grid.h) */
};
enum { PRT_RADIAL_MORE_ETA = 7 };
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
    /* Dipole family: the indices that it covers; eta_more[n_eta_more] beside eta. */
    double eta, eta_more[PRT_RADIAL_MORE_ETA];
    uint32_t n_eta_more;
    bool eta_between;   /* it covers every index between the least and the greatest of them */
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
    double eta;                           /* dipole only */
    double eta_more[PRT_RADIAL_MORE_ETA]; /* further indices that one basis serves */
    uint32_t n_eta_more;
    bool eta_between;          /* and every index between the least and the greatest */
    double sigma_lo, sigma_hi; /* sigma_s' (or sigma_t) range; 0: METHODS' whole range */
    double sigma_a_lo, sigma_a_hi;
    double radius_mm;    /* largest distance needed (object diameter); 0: 60 */
    uint32_t n_function; /* 0: fewest that keep max_error; splines: at most this many
                          * (pieces have degree+1 each, hats one more than intervals) */
    double max_error;    /* worst over the range; 0: 0.001 */
    uint32_t degree;     /* POLYNOMIAL: 1 linear, 2 quadratic */
    /* REDUCED, dipole family: profiles to hold exactly (a user's curve, a slab), at most 8.
     * The residual of each in the n_function others becomes one more function, unless its
     * relative error is below 5e-4. */
    const struct prt_profile *extra;
    uint32_t n_extra;
};
/* Makes the basis with the fewest functions that keep max_error. A target
 * that no size keeps is a warning. The caller destroys *out, which is written on success only.
 * Thread-safe; blocks. PRT_ARG, PRT_LIMIT (radii span more than 24 octaves), PRT_NOMEM. */
int prt_radial_create(const struct prt_context *ctx, const struct prt_radial_options *options,
                      struct prt_radial **out);
void prt_radial_destroy(struct prt_radial *radial);
/* out[i*n_function + j] = B_j(r[i]), r in mm, >= 0; 0 from the last grid radius on. */
void prt_radial_eval(const struct prt_radial *radial, size_t n, const float *r, float *out);
/* The basis from a table that a .prt file stores: options give kind, family, eta and range; the
 * error is measured again. r [n_grid], value [n_function][n_grid], both copied. PRT_FORMAT for
 * a table that prt_radial_create did not make, PRT_NOMEM. */
int prt_radial_from_table(const struct prt_context *ctx,
                          const struct prt_radial_options *options, uint32_t n_function,
                          uint32_t n_grid, const float *r, const float *value,
                          struct prt_radial **out);
/* coef[n_function][3] of a material, from its dipole (or e^(-sigma_t r)); *error gets the
 * largest relative error over channels, true also for materials outside the range. <= 0.2 ms.
 * PRT_MISMATCH for an eta that the basis does not have, PRT_ARG for coefficients out of range
 * or a profile that is 0 inside the grid. Allocates nothing; error may be NULL.
 */
int prt_radial_fit_material(const struct prt_radial *radial,
                            const struct prt_material *material, float *coef, double *error);
#ifdef __cplusplus
}
#endif
#endif
