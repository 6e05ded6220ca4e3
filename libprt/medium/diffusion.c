// SPDX-License-Identifier: MIT
// The classical dipole of one channel, its closed-form tail, and scalar evaluation.
#include "material.h"

#include <math.h>

double prt_fresnel_dr(double eta)
{
    return -1.440 / (eta * eta) + 0.710 / eta + 0.668 + 0.0636 * eta;
}

void prt_diffusion_init(struct prt_diffusion *dipole, double sigma_s_prime, double sigma_a,
                        double eta)
{
    double f_dr = prt_fresnel_dr(eta), boundary = (1 + f_dr) / (1 - f_dr);
    double sigma_t_prime = sigma_s_prime + sigma_a;
    double sigma_tr = sqrt(3 * sigma_a * sigma_t_prime);
    double z_r = 1 / sigma_t_prime, z_v = z_r * (1 + 4 * boundary / 3);
    double albedo = sigma_s_prime / sigma_t_prime;
    *dipole = (struct prt_diffusion){
        .sigma_s_prime = sigma_s_prime,
        .sigma_a = sigma_a,
        .sigma_t_prime = sigma_t_prime,
        .sigma_tr = sigma_tr,
        .albedo_prime = albedo,
        .eta = eta,
        .z_r = z_r,
        .z_v = z_v,
        .rho_d = albedo / 2 * (exp(-sigma_tr * z_r) + exp(-sigma_tr * z_v)),
    };
}

/* z (sigma + 1/d) e^(-sigma d) / d^2 of one pole */
static double pole_rd(double sigma, double z, double r)
{
    double d = hypot(r, z);
    return z * (sigma + 1 / d) * exp(-sigma * d) / (d * d);
}

double prt_diffusion_rd(const struct prt_diffusion *dipole, double r_mm)
{
    if (dipole->n_point) return prt_material_table_rd(dipole, r_mm);
    return dipole->albedo_prime / (4 * M_PI) *
           (pole_rd(dipole->sigma_tr, dipole->z_r, r_mm) +
            pole_rd(dipole->sigma_tr, dipole->z_v, r_mm));
}

double prt_diffusion_tail(const struct prt_diffusion *dipole, double r_mm)
{
    if (dipole->n_point) return prt_material_table_tail(dipole, r_mm);
    double d_r = hypot(r_mm, dipole->z_r), d_v = hypot(r_mm, dipole->z_v);
    return dipole->albedo_prime / 2 *
           (dipole->z_r * exp(-dipole->sigma_tr * d_r) / d_r +
            dipole->z_v * exp(-dipole->sigma_tr * d_v) / d_v);
}
