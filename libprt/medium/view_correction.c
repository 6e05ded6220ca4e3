// SPDX-License-Identifier: MIT
// Single scattering towards an eye from single scattering along -n_o (METHODS §3.6).
//
// Inside, the path to the eye has the direction w_o'. Under a flat surface it is 1/mu_o' times
// as long as the path along -n_o to the same depth. On a half-space lit from w_i' the single
// scattering toward the eye is therefore
//     rho = (1 + 1/mu_i') / (1 + mu_o'/mu_i')
// times the baked one. Refracted directions have mu_o' in [mu_c, 1]; over that range rho is
// linear in mu_o' to 1 %. The product of rho and the planes is then a sum of planes times
// Y_k(w_o'), k < 4, which renderers evaluate already.
#include "prt/medium.h"

#include <math.h>

static const float C1 = 0.48860251f; // Y_1m is C1 times y, z, x

struct correction {
    uint32_t n_vertex, begin;
    const float (*normal)[3];
    unsigned n_phase, n_plane;
    float slope;  // rho = 1 + slope (1 - mu_o')
    float lowest; // mu_c
    float *planes;
};

// 1/mu_i' under even light: mu_i' = sqrt(1 - (1 - mu^2)/eta^2) averaged over mu.
static double mean_inverse(double eta)
{
    double sum = 0;
    for (int i = 0; i < 32; i++) {
        double mu = (i + 0.5) / 32;
        sum += sqrt(1 - (1 - mu * mu) / (eta * eta)) / 32;
    }
    return 1 / sum;
}

// The slope that fits rho best over mu_o' in [lowest, 1] and is exact at 1.
static float slope_of(double eta, float *lowest)
{
    double b = mean_inverse(eta), low = sqrt(1 - 1 / (eta * eta)), above = 0, below = 0;
    *lowest = (float)low;
    for (int i = 0; i < 32; i++) {
        double x = (1 - low) * (i + 0.5) / 32, rho = (1 + b) / (1 + b * (1 - x));
        above += (rho - 1) * x;
        below += x * x;
    }
    return below > 0 ? (float)(above / below) : 0;
}

float prt_view_slope(double eta)
{
    float lowest;
    return slope_of(eta, &lowest);
}

// Planes 0 to 3 of one vertex and channel: c + d.w becomes (1 + s - s n.w)(c + d.w), where
// (n.w)^2 is taken as linear in n.w and the tangential part of d keeps the mean of n.w.
static void correct(const struct correction *k, const float n[3], float *p[4])
{
    static const int axis[3] = {1, 2, 0}; // of planes 1 to 3
    const float s = k->slope, mean = 0.5f * (1 + k->lowest);
    float c = *p[0], d[3] = {0}, along = 0;
    for (int i = 0; i < 3 && k->n_phase > 1; i++) {
        d[axis[i]] = C1 * *p[i + 1];
        along += d[axis[i]] * n[axis[i]];
    }
    *p[0] = (1 + s) * c + s * k->lowest * along;
    for (int i = 0; i < 3; i++) {
        const int a = axis[i];
        const float tangent = d[a] - along * n[a];
        const float v = (1 + s) * d[a] - s * c * n[a] - s * (1 + k->lowest) * along * n[a] -
                        s * mean * tangent;
        *p[i + 1] = v / C1;
    }
}

static int correct_range(void *arg, size_t from, size_t to, unsigned worker)
{
    const struct correction *k = arg;
    const size_t size = (size_t)3 * k->n_vertex;
    const float rest = 1 + k->slope * (1 - k->lowest) / 2; // of higher degrees
    for (size_t v = k->begin + from; v < k->begin + to; v++)
        for (size_t ch = 0; ch < 3; ch++) {
            float *p[4];
            for (size_t i = 0; i < 4; i++) p[i] = k->planes + i * size + 3 * v + ch;
            correct(k, k->normal[v], p);
            for (size_t i = 4; i < k->n_plane; i++) k->planes[i * size + 3 * v + ch] *= rest;
        }
    return PRT_OK;
}

int prt_view_correct(const struct prt_context *ctx, uint32_t n_vertex, uint32_t begin,
                     uint32_t end, const float (*normal)[3], double eta, unsigned n_phase,
                     unsigned n_plane, float *planes)
{
    struct correction k = {n_vertex, begin, normal, n_phase, n_plane, 0, 0, planes};
    k.slope = slope_of(eta, &k.lowest);
    return prt_parallel_for(ctx, NULL, end - begin, 2048, correct_range, &k);
}
