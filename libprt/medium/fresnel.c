// SPDX-License-Identifier: MIT
// The smooth dielectric boundary: transmittance, its mean, refraction into the body.
#include "prt/medium.h"

#include <math.h>

double prt_fresnel_transmittance(double eta, double cos_theta)
{
    if (!(cos_theta > 0)) return 0;
    double ci = cos_theta > 1 ? 1 : cos_theta;
    double ct2 = 1 - (1 - ci * ci) / (eta * eta);
    if (ct2 <= 0) return 0;
    double ct = sqrt(ct2);
    double parallel = (eta * ci - ct) / (eta * ci + ct);
    double perpendicular = (ci - eta * ct) / (ci + eta * ct);
    return 1 - (parallel * parallel + perpendicular * perpendicular) / 2;
}

/* 2 integral_0^1 F_t mu dmu by composite Gauss of five points; F_t is smooth on [0,1]. */
double prt_fresnel_mean_transmittance(double eta)
{
    static const double x[5] = {0, 0.5384693101056831, -0.5384693101056831, 0.9061798459386640,
                                -0.9061798459386640};
    static const double w[5] = {0.5688888888888889, 0.4786286704993665, 0.4786286704993665,
                                0.2369268850561891, 0.2369268850561891};
    /* near eta = 1 F_t rises within mu ~ sqrt(eta^2 - 1) at grazing angles; the substitution mu
     * = t^2 resolves it */
    enum { N_PIECE = 16 };
    double sum = 0;
    for (int i = 0; i < N_PIECE; i++)
        for (int k = 0; k < 5; k++) {
            double t = (i + 0.5 + 0.5 * x[k]) / N_PIECE, mu = t * t;
            sum += w[k] / (2 * N_PIECE) * prt_fresnel_transmittance(eta, mu) * mu * 2 * t;
        }
    return 2 * sum;
}

void prt_refract_in(double eta, const float n[3], const float w[3], float out[3])
{
    double c = (double)n[0] * w[0] + (double)n[1] * w[1] + (double)n[2] * w[2];
    double c2 = 1 - (1 - c * c) / (eta * eta);
    double along_n = c / eta - sqrt(c2 > 0 ? c2 : 0);
    for (int i = 0; i < 3; i++) out[i] = (float)(along_n * n[i] - w[i] / eta);
}

double prt_exit_divisor(double eta, enum prt_exit exit)
{
    return exit == PRT_EXIT_PAPERS ? 1 : prt_fresnel_mean_transmittance(eta);
}
