// SPDX-License-Identifier: MIT
// Law: an environment filtered for highlights is the mean of its radiance under the GGX lobe
// (WMLT07) with view = normal = lobe axis, cut at 1/500 of its peak (METHODS §6).
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>

#include "expect.h"
#include "prt/raster.h"
#include "raster/cube.h"

static struct prt_context context;

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Radiance that varies over some 40 degrees, as much as the coarsest level's input can hold.
static double radiance(const double w[3], int channel)
{
    static const double axis[3][3] = {{0.36, 0.48, 0.8}, {-0.8, 0.36, 0.48}, {0, -0.6, 0.8}};
    double c = dot(axis[channel], w);
    return 0.1 + (c > 0 ? 4 * c * c * c * c * c * c : 0);
}

static void texel_direction(unsigned face, double s, double t, double d[3])
{
    const double table[6][3] = {{1, -t, -s}, {-1, -t, s}, {s, 1, t},
                                {s, -1, -t}, {s, -t, 1},  {-s, -t, -1}};
    double length = sqrt(1 + s * s + t * t);
    for (int i = 0; i < 3; i++) d[i] = table[face][i] / length;
}

static struct prt_cube smooth_light(uint32_t n)
{
    struct prt_cube cube;
    assert_int_equal(prt_cube_init(&cube, n), PRT_OK);
    for (uint32_t i = 0; i < 6 * n * n; i++) {
        double w[3];
        texel_direction(i / (n * n), 2 * (i % n + 0.5) / n - 1, 2 * (i / n % n + 0.5) / n - 1,
                        w);
        for (int c = 0; c < 3; c++) cube.texel[3 * i + (uint32_t)c] = (float)radiance(w, c);
    }
    return cube;
}

static void frame_of(const double d[3], double u[3], double v[3])
{
    int least = fabs(d[0]) < fabs(d[1]) ? 0 : 1;
    if (fabs(d[2]) < fabs(d[least])) least = 2;
    double e[3] = {least == 0, least == 1, least == 2};
    for (int i = 0; i < 3; i++)
        u[i] = d[(i + 1) % 3] * e[(i + 2) % 3] - d[(i + 2) % 3] * e[(i + 1) % 3];
    double length = sqrt(dot(u, u));
    for (int i = 0; i < 3; i++) u[i] /= length;
    for (int i = 0; i < 3; i++)
        v[i] = d[(i + 1) % 3] * u[(i + 2) % 3] - d[(i + 2) % 3] * u[(i + 1) % 3];
}

// ∫ L D(h) cos dw / ∫ D(h) cos dw over the lobe about d by the half vector's angle theta_h, at
// equal steps of which the lobe is smooth however narrow it is: the light's direction is at
// 2 theta_h from the axis, and dw = 4 cos(theta_h) sin(theta_h) 2 d(theta_h) d(phi) / 2.
static void lobe_mean(const double d[3], double roughness, double mean[3])
{
    enum { N_THETA = 200, N_PHI = 64 };
    double alpha = roughness * roughness, u[3], v[3], total = 0;
    // D falls to 1/500 where (cos² (α² - 1) + 1)² is 500 times α⁴; cos dw is not part of the
    // cut
    double tan2 = alpha * alpha * (sqrt(500.0) - 1), end = fmin(atan(sqrt(tan2)), M_PI / 4);
    frame_of(d, u, v);
    for (int c = 0; c < 3; c++) mean[c] = 0;
    for (int i = 0; i < N_THETA; i++) {
        double theta = end * (i + 0.5) / N_THETA, cos_h = cos(theta);
        double e = cos_h * cos_h * (alpha * alpha - 1) + 1, away = 2 * theta;
        double weight = cos(away) / (e * e) * sin(away);
        for (int k = 0; k < N_PHI; k++) {
            double phi = 2 * M_PI * (k + 0.5) / N_PHI, w[3];
            for (int j = 0; j < 3; j++)
                w[j] = cos(away) * d[j] + sin(away) * (cos(phi) * u[j] + sin(phi) * v[j]);
            for (int c = 0; c < 3; c++) mean[c] += weight * radiance(w, c);
            total += weight;
        }
    }
    for (int c = 0; c < 3; c++) mean[c] /= total;
}

// Law: a level of the filter is the mean under the lobe of its roughness, in each texel
// (METHODS §6)
static void levels_are_means_under_the_lobe(void **state)
{
    static const float roughness[] = {SPECULAR_ROUGH_1, SPECULAR_ROUGH_2, SPECULAR_ROUGH_3,
                                      SPECULAR_ROUGH_4, SPECULAR_ROUGH_5};
    static const uint32_t side[] = {32, 16, 16, 8, 8};
    // three times the worst; coarse texels and their few directions limit it, radiance is
    // to 4.1
    static const double bound[] = {0.025, 0.06, 0.15, 0.06, 0.015};
    struct prt_cube light = smooth_light(64);
    struct prt_specular *specular;
    assert_int_equal(prt_specular_create(&context, &light, &specular), PRT_OK);
    for (int k = 0; k < 5; k++) {
        uint32_t n = side[k];
        for (uint32_t i = 3; i < 6 * n * n; i += n * n / 13) {
            double d[3], want[3];
            float axis[3], got[3];
            texel_direction(i / (n * n), 2 * (i % n + 0.5) / n - 1,
                            2 * (i / n % n + 0.5) / n - 1, d);
            for (int j = 0; j < 3; j++) axis[j] = (float)d[j];
            prt_specular_eval(specular, axis, roughness[k], got);
            lobe_mean(d, roughness[k], want);
            for (int c = 0; c < 3; c++)
                expect_near(expect_name("mean at roughness %.2f", roughness[k]), got[c],
                            want[c], bound[k]);
        }
    }
    prt_specular_destroy(specular);
    prt_cube_finish(&light);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(levels_are_means_under_the_lobe),
    };
    return run_physics_tests(tests, NULL, NULL);
}
