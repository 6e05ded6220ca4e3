// SPDX-License-Identifier: MIT
// The point of a surface that is nearest to another point: a pin's place on another model.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>
#include <math.h>

#include "room.h"

// ---- of the command itself, which is not run here

cJSON *room_state(struct room_call *c)
{
    return NULL;
}

int relight_geometry(struct relight_client *client, const char *model, bool own_units,
                     struct relight_geometry *out, struct relight_error *error)
{
    return -RELIGHT_E_NOT_FOUND;
}

void relight_geometry_finish(struct relight_geometry *geometry)
{
}

int report_usage(const struct options *options, const char *fmt, ...)
{
    return 1;
}

int room_failed(struct room_call *c)
{
    return 1;
}

double number_of(const cJSON *json, const char *field)
{
    return 0;
}

const cJSON *list_of(const cJSON *json, const char *field)
{
    return NULL;
}

const char *text_of(const cJSON *json, const char *field)
{
    return "";
}

void add_float(cJSON *json, const char *key, double x)
{
}

void print_json(cJSON *json)
{
}

// ---- triangles and points by chance

static uint32_t seed = 1;

static double chance(void)
{
    seed = seed * 1664525 + 1013904223;
    return (double)(seed >> 8) / (1 << 24) * 2 - 1;
}

static double dot_of_differences(const double a[3], const double from_a[3], const float b[3],
                                 const double from_b[3])
{
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += (a[k] - from_a[k]) * (b[k] - from_b[k]);
    return sum;
}

// A point q of a triangle is the nearest one to p where no corner lies on p's side of the plane
// through q that is perpendicular to p - q, since a triangle is convex.
static void nearest_of_a_triangle(void **state)
{
    enum { FACE, EDGE_AB, EDGE_AC, EDGE_BC, CORNER, N_REGION };
    static const uint32_t triangle[1][3] = {{0, 1, 2}};
    float corner[3][3];
    const struct relight_geometry g = {
        .n_vertex = 3, .n_triangle = 1, .position = corner, .triangle = triangle};
    unsigned seen[N_REGION] = {0};
    double worst = 0;
    for (int i = 0; i < 20000; i++) {
        struct room_point q;
        double p[3];
        for (int k = 0; k < 9; k++) corner[k / 3][k % 3] = (float)chance();
        for (int k = 0; k < 3; k++) p[k] = 2 * chance();
        room_nearest(&g, p, &q);
        const double b = q.weight[0], c = q.weight[1], a = 1 - b - c;
        assert_true(a >= -1e-9 && b >= -1e-9 && c >= -1e-9);
        const bool no_a = a < 1e-9, no_b = b < 1e-9, no_c = c < 1e-9;
        seen[no_a + no_b + no_c == 2 ? CORNER
             : no_a                  ? EDGE_BC
             : no_b                  ? EDGE_AC
             : no_c                  ? EDGE_AB
                                     : FACE]++;
        double apart = 0;
        for (int k = 0; k < 3; k++) {
            const double at = a * corner[0][k] + b * corner[1][k] + c * corner[2][k];
            assert_true(fabs(q.position[k] - at) < 1e-12);
            apart += (p[k] - at) * (p[k] - at);
        }
        assert_true(fabs(q.distance - sqrt(apart)) < 1e-12);
        for (int j = 0; j < 3; j++)
            worst = fmax(worst, dot_of_differences(p, q.position, corner[j], q.position));
    }
    print_message("a corner is nearer by %.1e at most (bound 1e-9)\n", worst);
    assert_true(worst < 1e-9);
    for (int i = 0; i < N_REGION; i++) assert_true(seen[i] > 100);
}

// Of several triangles the nearest one has the point, and its block the object.
static void nearest_of_several(void **state)
{
    static const float position[6][3] = {{0, 0, 0}, {1, 0, 0}, {0, 1, 0},
                                         {0, 0, 2}, {1, 0, 2}, {0, 1, 2}};
    static const uint32_t triangle[2][3] = {{0, 1, 2}, {3, 4, 5}};
    static const struct relight_block block[2] = {
        {.object = 5, .n_triangle = 1}, {.object = 7, .triangle_begin = 1, .n_triangle = 1}};
    const struct relight_geometry g = {.n_vertex = 6,
                                       .n_triangle = 2,
                                       .position = position,
                                       .triangle = triangle,
                                       .n_block = 2,
                                       .block = block};
    for (int i = 0; i < 2; i++) {
        struct room_point q;
        room_nearest(&g, (double[3]){.25, .25, i ? 1.25 : .75}, &q);
        assert_int_equal(q.triangle, i);
        assert_int_equal(q.object, i ? 7 : 5);
        assert_true(q.distance == .75 && q.position[2] == 2 * i);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(nearest_of_a_triangle),
                                       cmocka_unit_test(nearest_of_several)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
