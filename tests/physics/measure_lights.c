// SPDX-License-Identifier: MIT
// The synthetic lights by which bakes are measured (bake/measure.h).
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>

#include <cmocka.h>

#include "bake/measure.h"
#include "expect.h"
#include "prt/light.h"

// Law: sky, soft boxes and low sun have growing contrast, the largest radiance over the mean
// (METHODS §3, error), and each is brighter at the zenith than at the nadir.
static void contrast_grows(void **state)
{
    enum { SIDE = 32 };
    double last = 1;
    for (unsigned l = 0; l < MEASURE_LIGHTS; l++) {
        struct prt_cube cube;
        assert_int_equal(prt_measure_light(l, SIDE, &cube), PRT_OK);
        double sum = 0, weight = 0, most = 0, up[2] = {0};
        for (uint32_t i = 0; i < 6 * SIDE * SIDE; i++) {
            const double s = 2 * (i % SIDE + 0.5) / SIDE - 1,
                         t = 2 * (i / SIDE % SIDE + 0.5) / SIDE - 1;
            const double w = pow(1 + s * s + t * t, -1.5);
            const float *rgb = cube.texel + 3 * (size_t)i;
            const double mean = ((double)rgb[0] + (double)rgb[1] + (double)rgb[2]) / 3;
            float dir[3];
            prt_cube_direction(i / (SIDE * SIDE), s, t, dir);
            sum += w * mean;
            weight += w;
            most = fmax(most, mean);
            if (fabsf(dir[1]) > 0.95f) up[dir[1] > 0] += mean;
        }
        expect_above(expect_name("%s: contrast over the one before", prt_measure_light_name[l]),
                     most / (sum / weight) / last, l ? 2 : 1.2);
        expect_above(expect_name("%s: zenith over nadir", prt_measure_light_name[l]),
                     up[1] / up[0], 2);
        last = most / (sum / weight);
        prt_cube_finish(&cube);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(contrast_grows)};
    return run_physics_tests(tests, NULL, NULL);
}
