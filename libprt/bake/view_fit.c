// SPDX-License-Identifier: MIT
// The fit of harmonics to radiances towards a few directions of exit. Refraction confines these
// to a cone around the normal; a ridge keeps the harmonics small outside of it, where
// neighbours with other normals are interpolated.
#include "bake/view_fit.h"

#include "prt/medium.h"

#include <math.h>

static const double outside_cosine[2] = {0.8, 0.35}; // of two rings of six directions
// 0.001 to 0.01 leave errors within a tenth of each other, without any the coefficients are
// eight times as large (METHODS §3.6).
static const double ridge = 5e-3;

void prt_view_directions(double eta, const float n[3], double turn, float out[VIEW_VALUES][3])
{
    const double nx = (double)n[0], ny = (double)n[1], nz = (double)n[2];
    const double sign = copysign(1, nz), a = -1 / (sign + nz), b = nx * ny * a;
    const double s[3] = {1 + sign * nx * nx * a, sign * b, -sign * nx},
                 t[3] = {b, sign + ny * ny * a, -ny}; // DBCH17
    for (int k = 0; k < 3; k++) out[0][k] = n[k];
    for (int i = 1; i < VIEW_VALUES; i++) {
        const int ring = (i - 1) / 6;
        const double c = outside_cosine[ring], sine = sqrt(1 - c * c) / eta;
        const double angle = 2 * M_PI * (((i - 1) % 6 + 0.5 * ring) / 6 + turn);
        for (int k = 0; k < 3; k++)
            out[i][k] = (float)(sine * (cos(angle) * s[k] + sin(angle) * t[k]) +
                                sqrt(1 - sine * sine) * (double)n[k]);
    }
}

// Solves a x = b for n right-hand sides by Gauss and Jordan; a is symmetric and positive.
static void solve(double a[VIEW_PLANES][VIEW_PLANES], double b[VIEW_PLANES][VIEW_VALUES])
{
    for (int i = 0; i < VIEW_PLANES; i++) {
        const double pivot = 1 / a[i][i];
        for (int k = 0; k < VIEW_PLANES; k++) a[i][k] *= pivot;
        for (int k = 0; k < VIEW_VALUES; k++) b[i][k] *= pivot;
        for (int j = 0; j < VIEW_PLANES; j++) {
            const double factor = a[j][i];
            if (j == i) continue;
            for (int k = 0; k < VIEW_PLANES; k++) a[j][k] -= factor * a[i][k];
            for (int k = 0; k < VIEW_VALUES; k++) b[j][k] -= factor * b[i][k];
        }
    }
}

void prt_view_fit(const float direction[VIEW_VALUES][3], float out[VIEW_PLANES][VIEW_VALUES])
{
    double gram[VIEW_PLANES][VIEW_PLANES] = {{0}}, right[VIEW_PLANES][VIEW_VALUES];
    for (int i = 0; i < VIEW_VALUES; i++) {
        float y[VIEW_PLANES];
        prt_sh_eval(3, direction[i], y);
        for (int k = 0; k < VIEW_PLANES; k++) {
            right[k][i] = (double)y[k];
            for (int l = 0; l < VIEW_PLANES; l++) gram[k][l] += (double)y[k] * (double)y[l];
        }
    }
    for (int k = 0; k < VIEW_PLANES; k++) gram[k][k] += ridge;
    solve(gram, right);
    for (int k = 0; k < VIEW_PLANES; k++)
        for (int i = 0; i < VIEW_VALUES; i++) out[k][i] = (float)right[k][i];
}
