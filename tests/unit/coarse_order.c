// SPDX-License-Identifier: MIT
// The coarse order of a mesh, and the level of a view's colours.
#include "ops/view_pace.h"
#include "prt/mesh.h"
#include "synthetic.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { SIDE = 40, N = SIDE * SIDE };

// A sheet of SIDE x SIDE vertices, and a second block of as many that shares none with it.
static void make_sheets(struct prt_mesh *m)
{
    assert_int_equal(synthetic_mesh(2 * N, true, m), 0);
    prt_free(m->triangle);
    m->n_triangle = 4 * (SIDE - 1) * (SIDE - 1);
    m->triangle = prt_alloc(m->n_triangle, sizeof *m->triangle);
    assert_non_null(m->triangle);
    uint32_t n = 0;
    for (uint32_t sheet = 0; sheet < 2; sheet++)
        for (uint32_t y = 0; y + 1 < SIDE; y++)
            for (uint32_t x = 0; x + 1 < SIDE; x++) {
                const uint32_t a = sheet * N + y * SIDE + x;
                memcpy(m->triangle[n++], (uint32_t[3]){a, a + 1, a + SIDE}, 12);
                memcpy(m->triangle[n++], (uint32_t[3]){a + 1, a + SIDE + 1, a + SIDE}, 12);
            }
    for (uint32_t v = 0; v < 2 * N; v++)
        memcpy(m->position[v], (float[3]){(float)(v % SIDE), (float)(v / SIDE % SIDE), 0}, 12);
}

static void parents_come_first_and_are_near(void **state)
{
    struct prt_context ctx;
    struct prt_coarse_order o;
    struct prt_mesh m;
    prt_context_init(&ctx);
    make_sheets(&m);
    assert_int_equal(prt_coarse_order_create(&ctx, &m, &o), 0);
    uint8_t *seen = calloc(2 * N, 1);
    assert_int_equal(o.n, 2 * N);
    assert_in_range(o.n_root, 2, 2 * N / 16);
    double worst_half = 0;
    for (uint32_t i = 0; i < o.n; i++) {
        assert_true(o.vertex[i] < o.n && !seen[o.vertex[i]]);
        seen[o.vertex[i]] = 1;
        for (int k = 0; k < 2 && i >= o.n_root; k++) {
            const uint32_t parent = o.parent[i][k];
            assert_true(parent < i);
            assert_int_equal(o.vertex[parent] / N, o.vertex[i] / N); // of its own sheet
            if (i < o.n / 2) continue;
            const float *a = m.position[o.vertex[parent]], *b = m.position[o.vertex[i]];
            worst_half = fmax(worst_half, hypot((double)(a[0] - b[0]), (double)(a[1] - b[1])));
        }
    }
    assert_true(worst_half <= 3); // edges, most of the triangles' own
    free(seen);
    prt_coarse_order_finish(&o);
    synthetic_mesh_finish(&m);
}

// What is linear along the sheet stays, to a part of an edge.
static void half_of_the_vertices_make_the_others(void **state)
{
    struct prt_context ctx;
    struct prt_coarse_order o;
    struct prt_mesh m;
    prt_context_init(&ctx);
    make_sheets(&m);
    assert_int_equal(prt_coarse_order_create(&ctx, &m, &o), 0);
    static double at[2 * N];
    double wrong = 0;
    for (uint32_t i = 0; i < o.n; i++) {
        const double x = (double)m.position[o.vertex[i]][0];
        at[i] = i < o.n / 2 ? x : 0.5 * (at[o.parent[i][0]] + at[o.parent[i][1]]);
        wrong += (at[i] - x) * (at[i] - x);
    }
    assert_true(sqrt(wrong / o.n) < 0.25);
    prt_coarse_order_finish(&o);
    synthetic_mesh_finish(&m);
}

static double distance2(const float a[3], const float b[3])
{
    double sum = 0;
    for (int k = 0; k < 3; k++) sum += pow((double)a[k] - (double)b[k], 2);
    return sum;
}

static bool neighbours(uint32_t a, uint32_t b)
{
    // of one sheet, along an edge or the diagonal of a cell
    const int x = (int)(b % SIDE) - (int)(a % SIDE), y = (int)(b / SIDE) - (int)(a / SIDE);
    return a / N == b / N && a != b && abs(x) <= 1 && abs(y) <= 1 && x * y <= 0;
}

// Each vertex in turn takes its nearest neighbour that is still free along; such a one lies
// nearest to the middle between its taker and another neighbour that stays.
static void the_nearest_are_taken(void **state)
{
    static uint32_t taker[2 * N];
    struct prt_context ctx;
    struct prt_coarse_order o;
    struct prt_mesh m;
    prt_context_init(&ctx);
    make_sheets(&m);
    for (uint32_t v = 0; v < 2 * N; v++)
        for (uint32_t k = 0; k < 3; k++)
            m.position[v][k] += (float)((v * 2654435761u + k * 97) >> 7 & 255) / 600;
    assert_int_equal(prt_coarse_order_create(&ctx, &m, &o), 0);
    uint32_t first = o.n - 1, n = 0; // of those that left first, in the file's order
    while (o.vertex[first - 1] < o.vertex[first]) first--;
    memset(taker, 0xff, sizeof taker);
    for (uint32_t v = 0; v < 2 * N; v++) {
        uint32_t best = UINT32_MAX;
        if (taker[v] != UINT32_MAX) continue;
        taker[v] = v;
        for (uint32_t u = v > SIDE ? v - SIDE - 1 : 0; u < 2 * N && u <= v + SIDE + 1; u++)
            if (neighbours(v, u) && taker[u] == UINT32_MAX &&
                (best == UINT32_MAX || distance2(m.position[u], m.position[v]) <
                                           distance2(m.position[best], m.position[v])))
                best = u;
        if (best != UINT32_MAX) taker[best] = v, n++;
    }
    assert_int_equal(o.n - first, n);
    for (uint32_t i = first; i < o.n; i++) {
        const uint32_t v = o.vertex[i], a = o.vertex[o.parent[i][0]];
        const uint32_t b = o.vertex[o.parent[i][1]];
        double least = INFINITY, got = 0;
        assert_int_equal(a, taker[v]);
        for (uint32_t u = v > SIDE ? v - SIDE - 1 : 0; u < 2 * N && u <= v + SIDE + 1; u++) {
            double d = 0;
            if (!neighbours(v, u) || taker[u] != u) continue;
            for (int k = 0; k < 3; k++)
                d += pow((double)(m.position[u][k] + m.position[a][k]) / 2 -
                             (double)m.position[v][k],
                         2);
            least = fmin(least, d);
            if (u == b) got = d;
        }
        assert_true(neighbours(v, b));
        assert_float_equal(got, least, 1e-5);
    }
    prt_coarse_order_finish(&o);
    synthetic_mesh_finish(&m);
}

static void a_mesh_without_triangles_has_roots_alone(void **state)
{
    struct prt_context ctx;
    struct prt_coarse_order o;
    struct prt_mesh m;
    prt_context_init(&ctx);
    assert_int_equal(synthetic_mesh(2, false, &m), 0);
    assert_int_equal(prt_coarse_order_create(&ctx, &m, &o), 0);
    assert_int_equal(o.n_root, 2);
    prt_coarse_order_finish(&o);
    synthetic_mesh_finish(&m);
}

static void late_frames_make_the_next_coarser(void **state)
{
    struct view_pace p = {0};
    for (unsigned level = 0; level < VIEW_PACE_LEVELS; level++) {
        assert_int_equal(p.level, level);
        for (int i = 0; i < 3; i++) view_pace_acknowledged(&p, 300, level);
    }
    assert_int_equal(p.level, VIEW_PACE_LEVELS - 1);
}

static void prompt_frames_make_the_next_finer(void **state)
{
    struct view_pace p = {.level = 2};
    unsigned n = 0;
    while (p.level == 2 && n++ < 1000) view_pace_acknowledged(&p, 20, 2);
    assert_in_range(n, 2, 200);
    assert_int_equal(p.level, 1);
    for (int i = 0; i < 3; i++) view_pace_acknowledged(&p, 300, 1); // it did not hold
    assert_int_equal(p.level, 2);
    unsigned again = 0;
    while (p.level == 2 && again++ < 1000) view_pace_acknowledged(&p, 20, 2);
    assert_true(again > n);
}

// Frames must agree one after another: late ones with prompt ones between them change nothing,
// and neither do prompt ones with a slow one between.
static void frames_agree_in_a_row(void **state)
{
    struct view_pace p = {.level = 1};
    for (int i = 0; i < 60; i++)
        for (int k = 0; k < 12; k++) view_pace_acknowledged(&p, k == 6 ? 300 : 150, 1);
    assert_int_equal(p.level, 1);
    for (int i = 0; i < 60; i++)
        for (int k = 0; k < 20; k++) view_pace_acknowledged(&p, k ? 60 : 250, 1);
    assert_int_equal(p.level, 1);
}

static void frames_of_other_levels_and_between_change_nothing(void **state)
{
    struct view_pace p = {.level = 1};
    for (int i = 0; i < 500; i++) view_pace_acknowledged(&p, 900, 0);
    for (int i = 0; i < 500; i++) view_pace_acknowledged(&p, 150, 1);
    assert_int_equal(p.level, 1);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(parents_come_first_and_are_near),
        cmocka_unit_test(half_of_the_vertices_make_the_others),
        cmocka_unit_test(the_nearest_are_taken),
        cmocka_unit_test(a_mesh_without_triangles_has_roots_alone),
        cmocka_unit_test(late_frames_make_the_next_coarser),
        cmocka_unit_test(prompt_frames_make_the_next_finer),
        cmocka_unit_test(frames_agree_in_a_row),
        cmocka_unit_test(frames_of_other_levels_and_between_change_nothing),
    };
    return cmocka_run_group_tests_name("coarse_order", tests, NULL, NULL);
}
