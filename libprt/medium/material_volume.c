// SPDX-License-Identifier: MIT
// A medium from an artist's parameters: a diffuse albedo, inverted against the dipole's own
// total reflectance, and attenuation (METHODS §10).
#include "prt/medium.h"

#include <math.h>
#include <string.h>

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

static double clamp(double x, double lo, double hi)
{
    return x >= lo ? x <= hi ? x : hi : lo;
}

bool prt_material_from_attenuation(const struct prt_attenuation *in, struct prt_material *out)
{
    struct prt_material m = {.eta = (float)clamp((double)in->eta, 1, 3),
                             .roughness = (float)clamp((double)in->roughness, 0.01, 1)};
    bool exact = true;
    for (int c = 0; c < 3; c++) {
        // attenuation of a colour of 1 is none, and of 0 without end
        double color = clamp((double)in->color[c], 1e-4, 0.9999);
        double rate = -log(color) / (double)in->distance_mm;
        double wanted = clamp((double)in->albedo[c], 0.002, 0.98), g = (double)in->g;
        double prime = prt_albedo_invert(wanted, (double)m.eta), s, a;
        exact &= (double)in->albedo[c] == wanted || (double)in->albedo[c] < 0.002;
        if (in->scatters) { // the rate is sigma_t: alpha = alpha' / (1 - g + g alpha')
            double alpha = prime / (1 - g + g * prime);
            s = alpha * rate * (1 - g);
            a = (1 - alpha) * rate;
        } else { // the rate is sigma_a
            a = rate;
            s = prime / (1 - prime) * rate;
        }
        double scaled = clamp(s, 1e-5, 900);
        a = clamp(a * scaled / s, 0, 900); // keeps the albedo where a bound is met
        m.sigma_s_prime[c] = (float)scaled;
        m.sigma_a[c] = (float)a;
        m.g[c] = (float)g;
    }
    memcpy(m.name, in->name, sizeof m.name);
    m.name[sizeof m.name - 1] = 0;
    *out = m;
    return exact;
}
