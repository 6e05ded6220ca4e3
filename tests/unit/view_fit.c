// SPDX-License-Identifier: MIT
// The directions of exit of a view's planes, and their harmonics (METHODS §3.6).
#include "bake/view_fit.h"

#include "prt/medium.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

static const float normals[][3] = {
    {0, 0, 1}, {0, 0, -1}, {1, 0, 0}, {0, -1, 0}, {0.48f, -0.6f, 0.64f}, {-0.6f, 0, -0.8f}};
enum { N_NORMAL = sizeof normals / sizeof *normals };

static double dot(const float a[3], const float b[3])
{
    return (double)a[0] * b[0] + (double)a[1] * b[1] + (double)a[2] * b[2];
}

// The angle about n from a to b in sixtieths of a circle, [0, 60).
static double turned(const float n[3], const float a[3], const float b[3])
{
    const double cross[3] = {(double)a[1] * b[2] - (double)a[2] * b[1],
                             (double)a[2] * b[0] - (double)a[0] * b[2],
                             (double)a[0] * b[1] - (double)a[1] * b[0]};
    const double along = dot(a, n) * dot(b, n);
    const double sine = cross[0] * n[0] + cross[1] * n[1] + cross[2] * n[2];
    const double part = atan2(sine, dot(a, b) - along) / (2 * M_PI) * 60;
    return part < 0 ? part + 60 : part;
}

// The normal, and two rings of six that leave at cosines of 0.8 and 0.35 after refraction, the
// outer one turned by half of a step.
static void directions_leave_at_two_angles(void **state)
{
    static const double cosine[2] = {0.8, 0.35}, etas[] = {1.05, 1.3, 1.6};
    for (int i = 0; i < N_NORMAL; i++)
        for (int e = 0; e < 3; e++) {
            float d[VIEW_VALUES][3], turn[VIEW_VALUES][3];
            const float *n = normals[i];
            prt_view_directions(etas[e], n, 0, d);
            prt_view_directions(etas[e], n, 0.15, turn);
            for (int k = 0; k < 3; k++) assert_float_equal(d[0][k], n[k], 0);
            for (int v = 1; v < VIEW_VALUES; v++) {
                const double c = dot(d[v], n), outside = etas[e] * sqrt(1 - c * c);
                assert_float_equal(dot(d[v], d[v]), 1, 1e-5);
                assert_float_equal(sqrt(1 - outside * outside), cosine[(v - 1) / 6], 1e-4);
                const double step = (v - 1) % 6 * 10 + (v > 6 ? 5 : 0);
                const double off = turned(n, d[1], d[v]) - step;
                assert_float_equal(off - 60 * rint(off / 60), 0, 1e-3);
                assert_float_equal(turned(n, d[v], turn[v]), 9, 1e-3);
            }
        }
}

// The fit solves (Y Y^T + ridge) x = Y, with Y the harmonics at the directions.
static void coefficients_solve_the_normal_equations(void **state)
{
    for (int i = 0; i < N_NORMAL; i++) {
        float d[VIEW_VALUES][3], y[VIEW_VALUES][VIEW_PLANES], x[VIEW_PLANES][VIEW_VALUES];
        prt_view_directions(1.3, normals[i], 0.37, d);
        prt_view_fit((const float(*)[3])d, x);
        for (int v = 0; v < VIEW_VALUES; v++) prt_sh_eval(3, d[v], y[v]);
        for (int k = 0; k < VIEW_PLANES; k++)
            for (int v = 0; v < VIEW_VALUES; v++) {
                double left = 5e-3 * (double)x[k][v];
                for (int l = 0; l < VIEW_PLANES; l++) {
                    double gram = 0;
                    for (int w = 0; w < VIEW_VALUES; w++)
                        gram += (double)y[w][k] * (double)y[w][l];
                    left += gram * (double)x[l][v];
                }
                assert_float_equal(left, y[v][k], 1e-4);
            }
    }
}

// What is the same towards every direction of exit is one to a few per cent.
static void even_light_stays_even(void **state)
{
    float d[VIEW_VALUES][3], x[VIEW_PLANES][VIEW_VALUES], y[VIEW_PLANES];
    prt_view_directions(1.3, normals[4], 0, d);
    prt_view_fit((const float(*)[3])d, x);
    for (int v = 0; v < VIEW_VALUES; v++) {
        double sum = 0;
        prt_sh_eval(3, d[v], y);
        for (int k = 0; k < VIEW_PLANES; k++)
            for (int w = 0; w < VIEW_VALUES; w++) sum += (double)y[k] * (double)x[k][w];
        assert_float_equal(sum, 1, 0.05);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(directions_leave_at_two_angles),
        cmocka_unit_test(coefficients_solve_the_normal_equations),
        cmocka_unit_test(even_light_stays_even),
    };
    return cmocka_run_group_tests_name("view_fit", tests, NULL, NULL);
}
