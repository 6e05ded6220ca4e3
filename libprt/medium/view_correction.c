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

// The values of up to SOME vertices one behind the other, channel by channel: plain loops over
// them become vector instructions.
enum { SOME = 32, VALUES = 3 * SOME };

struct normals {
    float along[3][VALUES]; // x, y, z of each value's vertex
};

static void spread_normals(const float (*normal)[3], size_t n, struct normals *out)
{
    for (size_t i = 0; i < n; i++)
        for (int axis = 0; axis < 3; axis++)
            for (size_t ch = 0; ch < 3; ch++) out->along[axis][3 * i + ch] = normal[i][axis];
}

// Even light: planes 0 to 3 from plane 0.
static void correct_even(const struct correction *k, const struct normals *normals, size_t n,
                         float *p[4])
{
    static const int axis[3] = {1, 2, 0}; // of planes 1 to 3
    const float s = k->slope;
    for (int plane = 0; plane < 3; plane++) {
        const float *restrict normal = normals->along[axis[plane]], *restrict c = p[0];
        float *restrict out = p[plane + 1];
        for (size_t i = 0; i < n; i++) out[i] = -(s * c[i] * normal[i]) / C1;
    }
    for (size_t i = 0; i < n; i++) p[0][i] *= 1 + s;
}

// Planes 0 to 3: c + d.w becomes (1 + s - s n.w)(c + d.w), where (n.w)^2 is taken as linear in
// n.w and the tangential part of d keeps the mean of n.w.
static void correct(const struct correction *k, const struct normals *normals, size_t n,
                    float *p[4])
{
    const float s = k->slope, lowest = k->lowest, mean = 0.5f * (1 + lowest);
    const float *restrict nx = normals->along[0], *restrict ny = normals->along[1],
                          *restrict nz = normals->along[2];
    float *restrict p0 = p[0], *restrict py = p[1], *restrict pz = p[2], *restrict px = p[3];
    for (size_t i = 0; i < n; i++) {
        const float c = p0[i], y = C1 * py[i], z = C1 * pz[i], x = C1 * px[i];
        const float along = y * ny[i] + z * nz[i] + x * nx[i];
        const float by_normal = s * c, by_along = s * (1 + lowest) * along;
        p0[i] = (1 + s) * c + s * lowest * along;
        py[i] = ((1 + s) * y - by_normal * ny[i] - by_along * ny[i] -
                 s * mean * (y - along * ny[i])) /
                C1;
        pz[i] = ((1 + s) * z - by_normal * nz[i] - by_along * nz[i] -
                 s * mean * (z - along * nz[i])) /
                C1;
        px[i] = ((1 + s) * x - by_normal * nx[i] - by_along * nx[i] -
                 s * mean * (x - along * nx[i])) /
                C1;
    }
}

static int correct_range(void *arg, size_t from, size_t to, unsigned worker)
{
    const struct correction *k = arg;
    const size_t size = (size_t)3 * k->n_vertex;
    const float rest = 1 + k->slope * (1 - k->lowest) / 2; // of higher degrees
    struct normals normals;
    for (size_t v = k->begin + from, n; v < k->begin + to; v += n) {
        float *p[4];
        n = k->begin + to - v < SOME ? k->begin + to - v : SOME;
        for (size_t i = 0; i < 4; i++) p[i] = k->planes + i * size + 3 * v;
        spread_normals(k->normal + v, n, &normals);
        (k->n_phase > 1 ? correct : correct_even)(k, &normals, 3 * n, p);
        for (size_t plane = 4; plane < k->n_plane; plane++)
            for (size_t i = 0; i < 3 * n; i++) k->planes[plane * size + 3 * v + i] *= rest;
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
