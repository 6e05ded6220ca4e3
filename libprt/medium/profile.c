// SPDX-License-Identifier: MIT
// The table of profile kinds, and the evaluation of a channel's profile through it.
#include "profile.h"

#include <math.h>

#define DECLARE(KIND, name) extern const struct prt_profile_type prt_profile_type_##name;
PRT_PROFILE_LIST(DECLARE)
#undef DECLARE

#define ROW(KIND, name) [PRT_PROFILE_##KIND] = &prt_profile_type_##name,
static const struct prt_profile_type *const types[] = {PRT_PROFILE_LIST(ROW)};
#undef ROW

const struct prt_profile_type *prt_profile_type(uint32_t kind)
{
    return kind < PRT_PROFILE_N_KIND ? types[kind] : NULL;
}

double prt_profile_rd(const struct prt_profile *profile, double r_mm)
{
    return types[profile->kind]->rd(profile, r_mm);
}

double prt_profile_tail(const struct prt_profile *profile, double r_mm)
{
    return types[profile->kind]->tail(profile, r_mm);
}

double prt_profile_radius(const struct prt_profile *profile, double share)
{
    double lo = log(1e-6), hi = log(1e6);
    for (int i = 0; i < 60; i++) { /* 27.6 / 2^60: the bisection ends at rounding */
        double mid = (lo + hi) / 2;
        if (prt_profile_tail(profile, exp(mid)) > share * profile->total) lo = mid;
        else hi = mid;
    }
    return exp(lo);
}

void prt_profile_finish(struct prt_profile *profile)
{
    prt_free(profile->r);
    prt_free(profile->rd);
    prt_free(profile->outside);
    profile->r = profile->rd = profile->outside = NULL;
    profile->n = 0;
}

/* ---- the dipole's row ---- */

void prt_profile_init_dipole(struct prt_profile *profile, double sigma_s_prime, double sigma_a,
                             double eta)
{
    *profile = (struct prt_profile){.kind = PRT_PROFILE_DIPOLE};
    prt_diffusion_init(&profile->dipole, sigma_s_prime, sigma_a, eta);
    profile->total = profile->dipole.rho_d;
}

static double dipole_rd(const struct prt_profile *profile, double r)
{
    return prt_diffusion_rd(&profile->dipole, r);
}

static double dipole_tail(const struct prt_profile *profile, double r)
{
    return prt_diffusion_tail(&profile->dipole, r);
}

const struct prt_profile_type prt_profile_type_dipole = {
    .word = "dipole", .rd = dipole_rd, .tail = dipole_tail};
