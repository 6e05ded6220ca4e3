/* SPDX-License-Identifier: MIT */
/* Internals of a radial basis: grid, quadrature, projection operator, builders. */
#ifndef MEDIUM_RADIAL_H
#define MEDIUM_RADIAL_H

#include "prt/radial.h"

enum {
    RADIAL_OCTAVE_SHIFT = 17, /* 64 grid intervals an octave: index = float bits >> 17 */
    RADIAL_MAX_FUNCTION = 64,
    RADIAL_MAX_EXTRA = 8,
    RADIAL_MAX_GRID = 24 * 64 + 2,
    RADIAL_MAX_QUAD = 2 * RADIAL_MAX_GRID,
};

/* One member of a family: a dipole, or e^(-sigma_t r). */
struct radial_member {
    enum prt_radial_family family;
    struct prt_diffusion dipole;
    double sigma_t;
};
void prt_radial_member_init(struct radial_member *member, enum prt_radial_family family,
                            double eta, double sigma, double sigma_a);
double prt_radial_member_eval(const struct radial_member *member, double r);
/* integral over [0, radius] of the member: 2 pi r dr (dipole) or dr (extinction) */
double prt_radial_member_inside(const struct radial_member *member, double radius);

/* A basis with its quadrature: two Gauss points for each interval of the grid. `measure`
 * integrates d mu = 2 pi r dr or dr. `weight` is that of the least squares: (d mu / d log r)^2
 * d log r, under which every scale has the same weight and which bounds the L1 error of METHODS
 * §4; dr for the plain kind. */
struct radial {
    struct prt_radial pub; /* first: a struct prt_radial * is a struct radial * */
    unsigned cpu;
    uint32_t degree; /* of spline kinds */
    uint32_t n_quad; /* 2 (n_grid - 1) */
    uint32_t stride; /* n_function rounded up to 8 */
    uint32_t base;   /* bits of r[1] >> RADIAL_OCTAVE_SHIFT */
    float *quad_r2;  /* [n_quad] */
    double *quad_r, *measure, *weight;
    float *measure32; /* [n_quad] */
    float *phi;       /* [n_function][n_quad]: B_j at the points */
    float *project;   /* [n_quad][stride]: coef = project^T f + moment * inside */
    float *moment;    /* [stride] */
    float *table;     /* [n_grid][stride]: value, transposed */
    float *inv_step;  /* [n_grid] */
};

/* Number of indices that the family covers, and index i. */
static inline uint32_t radial_n_eta(const struct prt_radial *radial)
{
    return 1 + radial->n_eta_more;
}
static inline double radial_eta(const struct prt_radial *radial, uint32_t i)
{
    return i ? radial->eta_more[i - 1] : radial->eta;
}
/* The least and the greatest index that the family covers. */
static inline void radial_eta_range(const struct prt_radial *radial, double range[2])
{
    range[0] = range[1] = radial->eta;
    for (uint32_t i = 0; i < radial->n_eta_more; i++) {
        if (radial->eta_more[i] < range[0]) range[0] = radial->eta_more[i];
        if (radial->eta_more[i] > range[1]) range[1] = radial->eta_more[i];
    }
}

int prt_radial_grid_init(struct radial *radial, double r_lo, double radius);
bool prt_radial_is_plain(const struct radial *radial);
bool prt_radial_is_spline(const struct radial *radial);
void prt_radial_free_functions(struct radial *radial);

/* Functions of a fit: fit[n_fit][n_grid] at the grid, and the stored functions made from them:
 * stored coef = map[n_function][n_fit] fit coef (NULL: the same functions). */
struct radial_functions {
    uint32_t n_fit, n_function;
    double *fit, *map, *stored; /* stored [n_function][n_grid]; NULL when map is */
};
void prt_radial_functions_finish(struct radial_functions *f);

/* Scales functions to integral |B| d mu = 1, fills pub.value and the projection operator. */
int prt_radial_build(struct radial *radial, struct radial_functions *functions);
/* Measures pub.mean_error and worst_error over materials between the family's own. */
int prt_radial_measure(struct radial *radial);

/* Fits up to three profiles given at the quadrature points (overwritten by the residual), whose
 * integrals over the grid are inside[c] > 0; coef[n_function][n_channel]; returns the error. */
double prt_radial_project(const struct radial *radial, unsigned n_channel,
                          float (*f)[RADIAL_MAX_QUAD], const double *inside, float *coef);
/* The leading singular functions [n][n_grid] of the family, at most n_max; *n: how many have a
 * singular value above 1e-11 of the first. */
int prt_radial_reduced(const struct radial *radial, uint32_t n_max, double *out, uint32_t *n);
/* The residual of `profile` in the basis, at the grid, into out[n_grid]; returns its error. */
double prt_radial_remainder(const struct radial *radial, const struct prt_profile *profile,
                            double *out);
/* Knots (grid indices, m+1 of them, ascending) that split the representative function into m
 * pieces at least cost, for every m <= m_max: knot[m*(m_max+1) + k]. */
int prt_radial_knots(const struct radial *radial, uint32_t m_max, uint32_t *knot);
/* Spline functions of radial->degree on knots. */
int prt_radial_spline(const struct radial *radial, uint32_t m, const uint32_t *knot,
                      struct radial_functions *out);

#endif
