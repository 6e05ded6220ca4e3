// SPDX-License-Identifier: MIT
// Reflectance profiles other than the dipole's: one slab by the multipole, and tables in
// general.
#include "internal.h"

#include <math.h>

enum { IMAGES = 24 }; // pairs of sources to either side

int prt_screen_multipole(const struct prt_context *ctx, const struct prt_material *material,
                         double thickness_mm, uint32_t n, const float *r_mm, float (*rd)[3],
                         double rho[3])
{
    int status = prt_material_check(ctx, material);
    if (status) return status;
    if (!(thickness_mm > 0) || !isfinite(thickness_mm))
        return prt_fail(ctx, PRT_ARG, "multipole: thickness %g mm must be positive and finite",
                        thickness_mm);
    for (int c = 0; c < 3; c++) {
        struct prt_diffusion d;
        prt_diffusion_init(&d, material->sigma_s_prime[c], material->sigma_a[c], material->eta);
        // mirror images in the extrapolated boundaries z_b outside both faces (2 z_b = z_v -
        // z_r)
        double z_b = (d.z_v - d.z_r) / 2, period = 2 * (thickness_mm + 2 * z_b), s = d.sigma_tr;
        if (rho) rho[c] = 0;
        for (uint32_t k = 0; k < n; k++) rd[k][c] = 0;
        for (int i = -IMAGES; i <= IMAGES; i++) {
            double z[2] = {i * period + d.z_r, i * period - d.z_v};
            for (int j = 0; j < 2; j++) {
                double sign = j ? -1 : 1;
                if (rho)
                    rho[c] += sign * d.albedo_prime / 2 * copysign(exp(-s * fabs(z[j])), z[j]);
                for (uint32_t k = 0; k < n; k++) {
                    double e = sqrt((double)r_mm[k] * r_mm[k] + z[j] * z[j]);
                    rd[k][c] += (float)(sign * d.albedo_prime / (4 * M_PI) * z[j] *
                                        (1 + s * e) * exp(-s * e) / (e * e * e));
                }
            }
        }
        for (uint32_t k = 0; k < n; k++) rd[k][c] = max_f(rd[k][c], 0);
    }
    return PRT_OK;
}

int prt_screen_profile_check(const struct prt_context *ctx, const struct prt_screen_profile *p)
{
    bool good = p->n >= 2 && p->r_mm && p->rd && p->r_mm[0] == 0;
    for (uint32_t k = 0; good && k < p->n; k++) {
        good = isfinite(p->r_mm[k]) && (!k || p->r_mm[k] > p->r_mm[k - 1]);
        for (int c = 0; c < 3; c++) good &= isfinite(p->rd[k][c]) && p->rd[k][c] >= 0;
    }
    if (good) return PRT_OK;
    return prt_fail(ctx, PRT_ARG,
                    "screen: a profile needs radii ascending from 0 and finite "
                    "reflectances >= 0");
}

void prt_screen_table_profile(const void *arg, double r_mm, double out[3])
{
    const struct prt_screen_profile *p = arg;
    uint32_t lo = 0, hi = p->n - 1;
    for (int c = 0; c < 3; c++) out[c] = 0;
    if (!(r_mm <= p->r_mm[hi])) return;
    while (hi - lo > 1) {
        uint32_t mid = lo + (hi - lo) / 2;
        if (p->r_mm[mid] <= r_mm) lo = mid;
        else hi = mid;
    }
    double f = (r_mm - p->r_mm[lo]) / ((double)p->r_mm[hi] - p->r_mm[lo]);
    for (int c = 0; c < 3; c++)
        out[c] = p->rd[lo][c] + f * ((double)p->rd[hi][c] - p->rd[lo][c]);
}
