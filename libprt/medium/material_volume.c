// SPDX-License-Identifier: MIT
// A medium from an artist's parameters: a diffuse albedo, inverted against the dipole's own
// total reflectance, and attenuation (METHODS §10).
#include "material.h"

#include <math.h>

// rho_d of a reduced albedo: it depends on nothing else but eta.
static double reflectance(double albedo_prime, double eta)
{
    struct prt_diffusion d;
    prt_diffusion_init(&d, albedo_prime, 1 - albedo_prime, eta);
    return d.rho_d;
}

double prt_albedo_invert(double reflectance_wanted, double eta)
{
    double lo = 0, hi = 1;
    for (int i = 0; i < 60; i++) {
        double mid = (lo + hi) / 2;
        if (reflectance(mid, eta) < reflectance_wanted) lo = mid;
        else hi = mid;
    }
    return (lo + hi) / 2;
}

// Diffuse albedos that have finite coefficients: at 0.98 a path scatters some 1000 times.
#define LEAST_ALBEDO 0.002
#define MOST_ALBEDO 0.98

static double clamp(double x, double lo, double hi)
{
    return x >= lo ? x <= hi ? x : hi : lo;
}

// Channel c of a reduced albedo and an extinction or absorption in mm^-1; false where a bound
// moved it, which keeps the albedo.
static bool set_channel(struct prt_material *m, int c, double prime, double rate, bool scatters)
{
    double g = (double)m->g[c], s, a;
    if (scatters) { // the rate is sigma_t: alpha = alpha' / (1 - g + g alpha')
        double alpha = prime / (1 - g + g * prime);
        s = alpha * rate * (1 - g);
        a = (1 - alpha) * rate;
    } else { // the rate is sigma_a
        a = rate;
        s = prime / (1 - prime) * rate;
    }
    double scaled = clamp(s, 1.001e-5, fmin(900, 4000 * (1 - g)));
    double kept = a * scaled / s, absorbed = clamp(kept, 0, 900);
    m->sigma_s_prime[c] = (float)scaled;
    m->sigma_a[c] = (float)absorbed;
    return scaled == s && absorbed == kept;
}

unsigned prt_material_from_attenuation(const struct prt_attenuation *in,
                                       struct prt_material *out)
{
    struct prt_material m = {
        .eta = (float)clamp((double)in->eta, 1, 3),
        .roughness = (float)clamp((double)in->roughness, MEDIUM_LEAST_ROUGHNESS, 1)};
    unsigned lowered = 0;
    for (int c = 0; c < 3; c++) {
        // attenuation of a colour of 1 is none, and of 0 without end
        double color = clamp((double)in->color[c], 1e-4, 0.9999);
        double wanted = clamp((double)in->albedo[c], LEAST_ALBEDO, MOST_ALBEDO);
        if ((double)in->albedo[c] > MOST_ALBEDO) lowered |= PRT_LOWERED_ALBEDO;
        m.g[c] = in->g;
        if (!set_channel(&m, c, prt_albedo_invert(wanted, (double)m.eta),
                         -log(color) / (double)in->distance_mm, in->scatters))
            lowered |= PRT_LOWERED_RATE;
    }
    memcpy(m.name, in->name, sizeof m.name);
    m.name[sizeof m.name - 1] = 0;
    *out = m;
    return lowered;
}

unsigned prt_material_from_dense(const struct prt_dense *in, struct prt_material *out)
{
    struct prt_material m = {
        .eta = (float)clamp((double)in->eta, 1, 3),
        .roughness = (float)clamp((double)in->roughness, MEDIUM_LEAST_ROUGHNESS, 1)};
    unsigned lowered = 0;
    for (int c = 0; c < 3; c++) {
        double wanted = clamp((double)in->albedo[c], LEAST_ALBEDO, MOST_ALBEDO);
        if ((double)in->albedo[c] > MOST_ALBEDO) lowered |= PRT_LOWERED_ALBEDO;
        m.g[c] = in->g;
        if (!set_channel(&m, c, prt_albedo_invert(wanted, (double)m.eta),
                         1 / (double)in->free_path_mm[c], true))
            lowered |= PRT_LOWERED_RATE;
    }
    memcpy(m.name, in->name, sizeof m.name);
    m.name[sizeof m.name - 1] = 0;
    *out = m;
    return lowered;
}
