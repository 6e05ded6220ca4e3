/* SPDX-License-Identifier: MIT */
/* prt/profile.h owns diffuse reflectance profiles R_d(r) of one channel (METHODS §1). A
 * material carries a profile as a table (prt/medium.h); its JSON is in proto/PROTOCOL.md.
 *
 * prt_profile_init_* write *profile on success only and return PRT_OK, PRT_ARG (a log line
 * names parameter, value, range and unit) or PRT_NOMEM. A profile is read-only: threads may
 * share it. */
#ifndef PRT_PROFILE_H
#define PRT_PROFILE_H

#include "prt/radial.h"

#ifdef __cplusplus
extern "C" {
#endif

/* Every kind, X(KIND, name). .prt files store the numbers: new kinds come last. The file that
 * holds a kind's functions defines its row (medium/profile.h) as prt_profile_type_name. DIPOLE:
 * JMLH01. BURLEY: Christensen & Burley 2015, eq 3 and 6, normalised diffusion. MULTIPOLE:
 * Donner & Jensen 2005, layered slabs of one refractive index. CURVE: points (r, R_d), linear
 * in between, 0 beyond the last. */
#define PRT_PROFILE_LIST(X) \
    X(DIPOLE, dipole)       \
    X(BURLEY, burley)       \
    X(MULTIPOLE, multipole) \
    X(CURVE, curve)

enum prt_profile_kind {
#define X(KIND, name) PRT_PROFILE_##KIND,
    PRT_PROFILE_LIST(X)
#undef X
        PRT_PROFILE_N_KIND
};
enum { PRT_PROFILE_MAX_LAYER = 8, PRT_PROFILE_MAX_POINT = 4096 };

/* R_d of one channel. Owns its table: call prt_profile_finish. */
struct prt_profile {
    enum prt_profile_kind kind;
    struct prt_diffusion dipole; /* DIPOLE; MULTIPOLE: the top layer as if it had no bottom */
    double albedo, shape_mm; /* parameters of other kinds; profile_KIND.c says what they are */
    double total;            /* integral 2 pi r R_d dr over all r, [0,1] */
    uint32_t n;      /* points of the table: CURVE: R_d; MULTIPOLE: R_d minus the dipole */
    double *r, *rd;  /* [n] mm ascending, mm^-2 */
    double *outside; /* [n] integral of the table's 2 pi r R_d beyond r[i] */
};
struct prt_layer {
    double thickness_mm; /* [1/sigma_t', 1e4]; INFINITY for the last: no bottom */
    double sigma_s_prime, sigma_a;
};

void prt_profile_init_dipole(struct prt_profile *profile, double sigma_s_prime, double sigma_a,
                             double eta);
/* CB15 eq 3: albedo A in [1e-4,1], volume mean free path in [1e-3,1e4] mm; s = 1.9 - A + 3.5 (A
 * - 0.8)^2 (CB15 eq 6). */
int prt_profile_init_burley(const struct prt_context *ctx, struct prt_profile *profile,
                            double albedo, double mean_free_path_mm);
/* DJ05 eq 4: 1 to PRT_PROFILE_MAX_LAYER layers from the lit side down, joined in the Hankel
 * domain by R = R1 + T1 R2 T1' / (1 - R1' R2), ' the lower side; each slab's infinite series of
 * poles is summed in closed form. eta in [1,3]. Takes about 0.1 s. */
int prt_profile_init_multipole(const struct prt_context *ctx, struct prt_profile *profile,
                               unsigned n_layer, const struct prt_layer *layer, double eta);
/* n in [2, PRT_PROFILE_MAX_POINT] points, copied: r ascends within [0,1e5] mm, rd in [0,1e9]
 * mm^-2, total in (0,1]. `what` stands in messages. */
int prt_profile_init_curve(const struct prt_context *ctx, const char *what,
                           struct prt_profile *profile, unsigned n, const double *r_mm,
                           const double *rd);
void prt_profile_finish(struct prt_profile *profile); /* frees the table */

double prt_profile_rd(const struct prt_profile *profile, double r_mm); /* mm^-2 */
/* Integral of 2 pi r R_d from r_mm to infinity, [0,1]. */
double prt_profile_tail(const struct prt_profile *profile, double r_mm);
/* The radius [mm], in [1e-6,1e6], beyond which the given share (0 to 1) of the light leaves. */
double prt_profile_radius(const struct prt_profile *profile, double share);

#ifdef __cplusplus
}
#endif
#endif
