/* SPDX-License-Identifier: MIT */
/* prt/profile.h owns diffuse reflectance profiles beyond the dipole: layered slabs, normalised
 * diffusion, and users' own curves. Polynomial and joint transport take any of them. */
#ifndef PRT_PROFILE_H
#define PRT_PROFILE_H

#include "prt/radial.h"

#ifdef __cplusplus
extern "C" {
#endif

enum prt_profile_kind {
    PRT_PROFILE_DIPOLE = 0, /* JMLH01 */
    PRT_PROFILE_BURLEY,     /* Christensen & Burley 2015, eq 3 and 6: normalised diffusion */
    PRT_PROFILE_MULTIPOLE,  /* Donner & Jensen 2005: layered slabs of one refractive index */
    PRT_PROFILE_CURVE,      /* points (r, R_d), linear in between, 0 beyond the last */
    PRT_PROFILE_N_KIND      /* new kinds go before it: .prt files store the numbers */
};
enum { PRT_PROFILE_MAX_LAYER = 8, PRT_PROFILE_MAX_POINT = 4096 };

/* R_d of one channel. Owns its table: finish it. Read-only, so free to share between threads.
 */
struct prt_profile {
    enum prt_profile_kind kind;
    struct prt_diffusion dipole; /* DIPOLE; MULTIPOLE: the top layer as if it had no bottom */
    double albedo, shape_mm;     /* BURLEY: A and d = mean free path / s(A) */
    double total;                /* integral 2 pi r R_d dr over all r, [0,1] */
    uint32_t n;      /* points of the table: CURVE all, MULTIPOLE what adds to dipole */
    double *r, *rd;  /* [n] mm ascending, mm^-2 */
    double *outside; /* [n] integral of the table's 2 pi r R_d beyond r[i] */
};
struct prt_layer {
    double thickness_mm; /* >= 1/sigma_t'; INFINITY for the last: no bottom */
    double sigma_s_prime, sigma_a;
};

void prt_profile_init_dipole(struct prt_profile *profile, double sigma_s_prime, double sigma_a,
                             double eta);
/* albedo (0,1], mean free path [mm] of the volume; s = 1.9 - A + 3.5 (A - 0.8)^2. */
int prt_profile_init_burley(const struct prt_context *ctx, struct prt_profile *profile,
                            double albedo, double mean_free_path_mm);
/* Layers from the lit side down, joined in the Hankel domain: R = R1 + T1 R2 T1 / (1 - R1 R2),
 * each slab's infinite series of poles summed in closed form. Takes about 0.1 s. */
int prt_profile_init_multipole(const struct prt_context *ctx, struct prt_profile *profile,
                               unsigned n_layer, const struct prt_layer *layer, double eta);
/* n >= 2 points, r ascending from >= 0, R_d finite and >= 0, total at most 1. Copies. */
int prt_profile_init_curve(const struct prt_context *ctx, const char *what,
                           struct prt_profile *profile, unsigned n, const double *r_mm,
                           const double *rd);
void prt_profile_finish(struct prt_profile *profile);

double prt_profile_rd(const struct prt_profile *profile, double r_mm);   /* mm^-2 */
double prt_profile_tail(const struct prt_profile *profile, double r_mm); /* beyond r */
/* The radius [mm] beyond which a share (0 to 1) of the light leaves; 1e-6 to 1e6. */
double prt_profile_radius(const struct prt_profile *profile, double share);

#ifdef __cplusplus
}
#endif
#endif
