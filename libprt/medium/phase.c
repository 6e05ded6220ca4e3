// SPDX-License-Identifier: MIT
// Phase functions as Legendre series, and the spherical harmonics that factor them.
#include "prt/medium.h"

#include <math.h>
#include <string.h>

static int degree_of_terms(unsigned n_term, unsigned *degree)
{
    for (unsigned l = 0; l < PRT_PHASE_MAX_L; l++)
        if (n_term == (l + 1) * (l + 1)) {
            *degree = l;
            return PRT_OK;
        }
    return PRT_ARG;
}

int prt_phase_hg(struct prt_phase *phase, double g, unsigned n_term)
{
    struct prt_phase result = {0};
    if (!(g > -1 && g < 1) || degree_of_terms(n_term, &result.degree)) return PRT_ARG;
    double a = 1;
    for (unsigned l = 0; l <= result.degree; l++, a *= -g) result.a[l] = a;
    *phase = result;
    return PRT_OK;
}

static void legendre(double c, double p[PRT_PHASE_MAX_L])
{
    p[0] = 1;
    p[1] = c;
    p[2] = (3 * c * c - 1) / 2;
    p[3] = (5 * c * c - 3) * c / 2;
}

double prt_phase_eval(const struct prt_phase *phase, double cos_outward)
{
    double p[PRT_PHASE_MAX_L], sum = 0;
    legendre(cos_outward, p);
    for (unsigned l = 0; l <= phase->degree; l++) sum += (2 * l + 1) * phase->a[l] * p[l];
    return sum / (4 * M_PI);
}

double prt_hg_eval(double g, double cos_scatter)
{
    double d = 1 + g * g - 2 * g * cos_scatter;
    return (1 - g * g) / (4 * M_PI * d * sqrt(d));
}

/* a_l += 2 pi integral over [c0,c1] of the line through (c0,p0),(c1,p1) times P_l: the product
 * has degree 4, which three Gauss points integrate exactly. */
static void add_segment(double c0, double p0, double c1, double p1, double a[PRT_PHASE_MAX_L])
{
    static const double x[3] = {-0.7745966692414834, 0, 0.7745966692414834};
    static const double w[3] = {5 / 18.0, 8 / 18.0, 5 / 18.0};
    for (int k = 0; k < 3; k++) {
        double t = 0.5 + 0.5 * x[k], p[PRT_PHASE_MAX_L];
        legendre(c0 + (c1 - c0) * t, p);
        for (unsigned l = 0; l < PRT_PHASE_MAX_L; l++)
            a[l] += 2 * M_PI * w[k] * (c1 - c0) * (p0 + (p1 - p0) * t) * p[l];
    }
}

int prt_phase_tabulated(struct prt_phase *phase, unsigned n, const double *cosine,
                        const double *p, unsigned n_term)
{
    struct prt_phase result = {0};
    if (n < 2 || degree_of_terms(n_term, &result.degree)) return PRT_ARG;
    for (unsigned i = 0; i < n; i++) {
        if (!(p[i] >= 0) || !isfinite(p[i]) || !(cosine[i] >= -1 && cosine[i] <= 1))
            return PRT_ARG;
        if (i && !(cosine[i] > cosine[i - 1])) return PRT_ARG;
    }
    double a[PRT_PHASE_MAX_L] = {0};
    add_segment(-1, p[0], cosine[0], p[0], a);
    for (unsigned i = 0; i + 1 < n; i++)
        add_segment(cosine[i], p[i], cosine[i + 1], p[i + 1], a);
    add_segment(cosine[n - 1], p[n - 1], 1, p[n - 1], a);
    if (!(a[0] > 0) || !isfinite(a[0])) return PRT_ARG;
    for (unsigned l = 0; l <= result.degree; l++) result.a[l] = a[l] / a[0];
    *phase = result;
    return PRT_OK;
}

void prt_sh_eval(unsigned n_band, const float dir[3], float *out)
{
    const float x = dir[0], y = dir[1], z = dir[2];
    if (n_band < 1) return;
    out[0] = 0.28209479f;
    if (n_band < 2) return;
    out[1] = 0.48860251f * y;
    out[2] = 0.48860251f * z;
    out[3] = 0.48860251f * x;
    if (n_band < 3) return;
    out[4] = 1.09254843f * x * y;
    out[5] = 1.09254843f * y * z;
    out[6] = 0.31539157f * (3 * z * z - 1);
    out[7] = 1.09254843f * x * z;
    out[8] = 0.54627422f * (x * x - y * y);
    if (n_band < 4) return;
    out[9] = 0.59004359f * y * (3 * x * x - y * y);
    out[10] = 2.89061144f * x * y * z;
    out[11] = 0.45704580f * y * (5 * z * z - 1);
    out[12] = 0.37317633f * z * (5 * z * z - 3);
    out[13] = 0.45704580f * x * (5 * z * z - 1);
    out[14] = 1.44530572f * z * (x * x - y * y);
    out[15] = 0.59004359f * x * (x * x - 3 * y * y);
}
