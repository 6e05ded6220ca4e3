/* SPDX-License-Identifier: MIT */
/* prt/radial.h owns bases over radius: any R_d(r) or e^(-sigma_t r) as sum_j c_j B_j(r). */
#ifndef PRT_RADIAL_H
#define PRT_RADIAL_H

#include "prt/medium.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_radial_kind {
    PRT_RADIAL_REDUCED = 0,  /* leading singular vectors of the weighted family (METHODS §4) */
    PRT_RADIAL_POLYNOMIAL,   /* X07: degree d pieces on DP knots, C^(d-1) constrained LSQ */
    PRT_RADIAL_HAT,          /* C0 linear spline on the same knots */
};
enum prt_radial_family {
    PRT_FAMILY_DIPOLE = 0,   /* R_d, weight 2 pi r dr, conserves the integral */
    PRT_FAMILY_EXTINCTION,   /* e^(-sigma_t r), for single scattering */
};
/* B_j on a shared grid, linear in between (dense enough that this is far below the fit error);
 * 0 beyond the last grid point. */
struct prt_radial {
    enum prt_radial_kind kind;
    enum prt_radial_family family;
    uint32_t n_function, n_grid;
    double eta;                    /* dipole family */
    double range[2][2];            /* covered [sigma_s'|sigma_t, sigma_a][lo,hi] mm^-1 */
    float *r;                      /* [n_grid] mm, ascending, r[0] = 0 */
    float *value;                  /* [n_function][n_grid] */
    double mean_error, worst_error;/* measured on materials off the fit grid: ∫|ΔR|2πr dr/ρ_d */
};
struct prt_radial_options {
    enum prt_radial_kind kind;
    enum prt_radial_family family;
    double eta;                 /* dipole only */
    double sigma_lo, sigma_hi;  /* sigma_s' (or sigma_t) range; 0: METHODS' whole range */
    double sigma_a_lo, sigma_a_hi;
    double radius_mm;           /* largest distance needed (object diameter); 0: 60 */
    uint32_t n_function;        /* 0: smallest that meets max_error */
    double max_error;           /* worst over the range; 0: 0.001 */
    uint32_t degree;            /* POLYNOMIAL: 1 linear, 2 quadratic */
};
int prt_radial_create(const struct prt_context *ctx, const struct prt_radial_options *options,
                      struct prt_radial **out);
void prt_radial_destroy(struct prt_radial *radial);
/* out[i*n_function + j] = B_j(r[i]). */
void prt_radial_eval(const struct prt_radial *radial, size_t n, const float *r, float *out);
/* coef[n_function][3] of a material, from its dipole (or e^(-sigma_t r)); *error gets the
 * largest relative error over channels. <= 0.2 ms. Thread-safe, allocates nothing large. */
int prt_radial_fit_material(const struct prt_radial *radial, const struct prt_material *material,
                            float *coef, double *error);
/* coef of any profile given as values on the radial's own grid, weighted the same way. */
int prt_radial_fit_profile(const struct prt_radial *radial, const double *profile, float *coef,
                           double *error);

#ifdef __cplusplus
}
#endif
#endif
