// SPDX-License-Identifier: MIT
// Profiles of one channel: evaluation, tails, normalised diffusion and users' curves.
#include "material.h"
#include "profile.h"
#include "radial.h"

#include <math.h>
#include <string.h>

void prt_profile_init_dipole(struct prt_profile *profile, double sigma_s_prime, double sigma_a,
                             double eta)
{
    *profile = (struct prt_profile){.kind = PRT_PROFILE_DIPOLE};
    prt_diffusion_init(&profile->dipole, sigma_s_prime, sigma_a, eta);
    profile->total = profile->dipole.rho_d;
}

int prt_profile_init_burley(const struct prt_context *ctx, struct prt_profile *profile,
                            double albedo, double mean_free_path_mm)
{
    int err;
    if ((err = material_range(ctx, "burley", "albedo", -1, albedo, 1e-4, 1, "(no unit)")) < 0 ||
        (err = material_range(ctx, "burley", "mean_free_path", -1, mean_free_path_mm, 1e-3, 1e4,
                              "mm")) < 0)
        return err;
    double s = 1.9 - albedo + 3.5 * (albedo - 0.8) * (albedo - 0.8);
    *profile = (struct prt_profile){.kind = PRT_PROFILE_BURLEY,
                                    .albedo = albedo,
                                    .shape_mm = mean_free_path_mm / s,
                                    .total = albedo};
    return PRT_OK;
}

/* A (e^(-r/d) + e^(-r/3d)) / (8 pi d r), which has no value at 0: there, of a tiny radius. */
static double burley_rd(const struct prt_profile *p, double r)
{
    double d = p->shape_mm, x = fmax(r, 1e-6 * d);
    return p->albedo * (exp(-x / d) + exp(-x / (3 * d))) / (8 * M_PI * d * x);
}

static double burley_tail(const struct prt_profile *p, double r)
{
    return p->albedo * (exp(-r / p->shape_mm) + 3 * exp(-r / (3 * p->shape_mm))) / 4;
}

/* The interval of the table that holds r, r[0] <= r < r[n-1]. */
static uint32_t table_find(const struct prt_profile *p, double r)
{
    uint32_t lo = 0, hi = p->n - 1;
    while (hi - lo > 1) {
        uint32_t mid = (lo + hi) / 2;
        if (p->r[mid] <= r) lo = mid;
        else hi = mid;
    }
    return lo;
}

static double table_rd(const struct prt_profile *p, double r)
{
    if (!p->n || r >= p->r[p->n - 1]) return 0;
    if (r <= p->r[0]) return p->rd[0];
    uint32_t i = table_find(p, r);
    double t = (r - p->r[i]) / (p->r[i + 1] - p->r[i]);
    return p->rd[i] + t * (p->rd[i + 1] - p->rd[i]);
}

/* integral of 2 pi r (line through (a,fa),(b,fb)) from a to b */
static double line_integral(double a, double fa, double b, double fb)
{
    return M_PI / 3 * (b - a) * (fa * (2 * a + b) + fb * (a + 2 * b));
}

static double table_tail(const struct prt_profile *p, double r)
{
    if (!p->n) return 0;
    if (r >= p->r[p->n - 1]) /* CURVE: 0; MULTIPOLE: as slow as any profile falls */
        return p->outside[p->n - 1] * p->r[p->n - 1] / r;
    if (r <= p->r[0]) return p->outside[0] + line_integral(r, p->rd[0], p->r[0], p->rd[0]);
    uint32_t i = table_find(p, r);
    return p->outside[i + 1] + line_integral(r, table_rd(p, r), p->r[i + 1], p->rd[i + 1]);
}

double prt_profile_rd(const struct prt_profile *profile, double r_mm)
{
    switch (profile->kind) {
    case PRT_PROFILE_DIPOLE:
        return prt_diffusion_rd(&profile->dipole, r_mm);
    case PRT_PROFILE_BURLEY:
        return burley_rd(profile, r_mm);
    case PRT_PROFILE_MULTIPOLE:
        return fmax(0, prt_diffusion_rd(&profile->dipole, r_mm) + table_rd(profile, r_mm));
    case PRT_PROFILE_CURVE:
        break;
    }
    return table_rd(profile, r_mm);
}

double prt_profile_tail(const struct prt_profile *profile, double r_mm)
{
    switch (profile->kind) {
    case PRT_PROFILE_DIPOLE:
        return prt_diffusion_tail(&profile->dipole, r_mm);
    case PRT_PROFILE_BURLEY:
        return burley_tail(profile, r_mm);
    case PRT_PROFILE_MULTIPOLE:
        return fmax(0, prt_diffusion_tail(&profile->dipole, r_mm) + table_tail(profile, r_mm));
    case PRT_PROFILE_CURVE:
        break;
    }
    return table_tail(profile, r_mm);
}

int profile_table(struct prt_profile *profile, uint32_t n)
{
    profile->n = n;
    profile->r = prt_calloc(n, sizeof(double));
    profile->rd = prt_calloc(n, sizeof(double));
    profile->outside = prt_calloc(n, sizeof(double));
    if (profile->r && profile->rd && profile->outside) return PRT_OK;
    prt_profile_finish(profile);
    return PRT_NOMEM;
}

void profile_table_integrate(struct prt_profile *profile)
{
    const double *r = profile->r, *rd = profile->rd;
    profile->outside[profile->n - 1] = 0;
    for (uint32_t i = profile->n - 1; i-- > 0;)
        profile->outside[i] =
            profile->outside[i + 1] + line_integral(r[i], rd[i], r[i + 1], rd[i + 1]);
}

int prt_profile_init_curve(const struct prt_context *ctx, const char *what,
                           struct prt_profile *profile, unsigned n, const double *r_mm,
                           const double *rd)
{
    struct prt_profile p = {.kind = PRT_PROFILE_CURVE};
    if (n < 2 || n > PRT_PROFILE_MAX_POINT)
        return prt_fail(ctx, PRT_ARG, "%s: a curve of %u points, allowed range 2 to %d", what,
                        n, PRT_PROFILE_MAX_POINT);
    for (unsigned i = 0; i < n; i++) {
        if (!(r_mm[i] >= 0 && r_mm[i] <= 1e5) || (i && !(r_mm[i] > r_mm[i - 1])))
            return prt_fail(ctx, PRT_ARG,
                            "%s: radius %u is %g mm; radii ascend within 0 to 100000 mm", what,
                            i, r_mm[i]);
        if (!(rd[i] >= 0 && rd[i] <= 1e9))
            return prt_fail(ctx, PRT_ARG, "%s: R_d %u is %g, allowed range 0 to 1e9 mm^-2",
                            what, i, rd[i]);
    }
    if (profile_table(&p, n) < 0) return prt_fail(ctx, PRT_NOMEM, "%s: no memory", what);
    memcpy(p.r, r_mm, n * sizeof(double));
    memcpy(p.rd, rd, n * sizeof(double));
    profile_table_integrate(&p);
    p.total = table_tail(&p, 0);
    if (!(p.total > 0 && p.total <= 1.0001)) {
        double total = p.total;
        prt_profile_finish(&p);
        return prt_fail(ctx, PRT_ARG,
                        "%s: the curve reflects %g of the light (2 pi r R_d dr), allowed range "
                        "0 (excluded) to 1",
                        what, total);
    }
    *profile = p;
    return PRT_OK;
}

void prt_profile_finish(struct prt_profile *profile)
{
    prt_free(profile->r);
    prt_free(profile->rd);
    prt_free(profile->outside);
    profile->r = profile->rd = profile->outside = NULL;
    profile->n = 0;
}

/* The profile at quadrature points; returns its integral over the grid. */
static double sample_profile(const struct radial *radial, const struct prt_profile *p, float *f)
{
    for (uint32_t q = 0; q < radial->n_quad; q++)
        f[q] = (float)prt_profile_rd(p, radial->quad_r[q]);
    return p->total - prt_profile_tail(p, radial->pub.r[radial->pub.n_grid - 1]);
}

double radial_remainder(const struct radial *radial, const struct prt_profile *profile,
                        double *out)
{
    float f[1][RADIAL_MAX_QUAD], coef[RADIAL_MAX_FUNCTION];
    const uint32_t ng = radial->pub.n_grid;
    double inside = sample_profile(radial, profile, f[0]);
    if (!(inside > 0)) return 0;
    double error = radial_project(radial, 1, f, &inside, coef);
    for (uint32_t i = 0; i < ng; i++) {
        out[i] = prt_profile_rd(profile, radial->pub.r[i]);
        /* normalised diffusion has no value at 0: the one that keeps the first cell's integral
         */
        if (!i && profile->kind == PRT_PROFILE_BURLEY) {
            double r1 = radial->pub.r[1];
            out[0] =
                6 * ((profile->total - prt_profile_tail(profile, r1)) / (2 * M_PI * r1 * r1) -
                     prt_profile_rd(profile, r1) / 3);
        }
        for (uint32_t j = 0; j < radial->pub.n_function; j++)
            out[i] -= (double)coef[j] * radial->pub.value[(size_t)j * ng + i];
    }
    return error;
}

int prt_optics_fit(const struct prt_radial *radial, const struct prt_optics *optics,
                   float *coef, double *error)
{
    const struct radial *self = (const struct radial *)radial;
    float f[3][RADIAL_MAX_QUAD];
    double inside[3];
    if (optics->kind == PRT_PROFILE_DIPOLE)
        return prt_radial_fit_material(radial, &optics->material, coef, error);
    if (radial->family != PRT_FAMILY_DIPOLE) return PRT_UNSUPPORTED;
    if (!(fabs(radial->eta - optics->material.eta) < 1e-4)) return PRT_MISMATCH;
    for (int c = 0; c < 3; c++) {
        inside[c] = sample_profile(self, &optics->channel[c], f[c]);
        if (!(inside[c] > 0)) return PRT_ARG;
    }
    double e = radial_project(self, 3, f, inside, coef);
    if (error) *error = e;
    return PRT_OK;
}

double prt_profile_radius(const struct prt_profile *profile, double share)
{
    double lo = log(1e-6), hi = log(1e6);
    for (int i = 0; i < 60; i++) {
        double mid = (lo + hi) / 2;
        if (prt_profile_tail(profile, exp(mid)) > share * profile->total) lo = mid;
        else hi = mid;
    }
    return exp(lo);
}
