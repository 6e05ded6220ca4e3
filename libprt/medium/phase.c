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
