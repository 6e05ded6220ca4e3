// SPDX-License-Identifier: MIT
// Triangles drawn on a cube around a point, held against rays; the grid that finds them.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"
#include "bake/cube_draw.h"
#include "bake/loops.h"
#include "bake/single.h"
#include "prt/light.h"

static struct prt_context context;

static struct prt_mesh *flutes(void)
{
    struct model m;
    model_init(&m, 160 * 81, 160 * 80 * 2);
    add_ball(&m, 160, 80, 80, fluted_ball);
    return body_mesh(&context, &m, false);
}

// A cube of 12 triangles beside a fine ball: large triangles and small ones in one mesh.
static struct prt_mesh *large_and_small(void)
{
    struct model m;
    model_init(&m, 64 * 33 + 24, 64 * 32 * 2 + 12);
    add_round_ball(&m, 64, 32, 3);
    add_box(&m, (float[]){9, 0, 0}, (float[]){5, 5, 5}, 1);
    return body_mesh(&context, &m, false);
}

// The distance of a point from a triangle, from a fine lattice of its points: never too small.
static float distance_to(const struct prt_mesh *mesh, uint32_t t, const float at[3])
{
    const uint32_t *v = mesh->triangle[t];
    float least = INFINITY;
    enum { STEPS = 6 };
    for (int i = 0; i <= STEPS; i++)
        for (int j = 0; i + j <= STEPS; j++) {
            float square = 0, a = (float)i / STEPS, b = (float)j / STEPS;
            for (int k = 0; k < 3; k++) {
                float p = (1 - a - b) * mesh->position[v[0]][k] + a * mesh->position[v[1]][k] +
                          b * mesh->position[v[2]][k];
                square += (p - at[k]) * (p - at[k]);
            }
            least = fminf(least, square);
        }
    return sqrtf(least);
}

static void check_grid(struct prt_mesh *mesh)
{
    struct triangle_grid *grid = prt_triangle_grid_create(mesh);
    uint32_t *near = calloc(mesh->n_triangle + 1, sizeof *near);
    uint8_t *is_near = calloc(mesh->n_triangle, 1);
    struct prt_rng rng;
    double found = 0, needed = 0;
    assert_true(grid && near && is_near);
    prt_rng_init(&rng, 4, 0);
    for (int i = 0; i < 40; i++) {
        const float *vertex = mesh->position[prt_rng_u32(&rng) % mesh->n_vertex];
        float at[3], radius = 4 * prt_rng_f32(&rng);
        for (int k = 0; k < 3; k++) at[k] = vertex[k] + 4 * (prt_rng_f32(&rng) - 0.5f);
        uint32_t n = prt_triangle_grid_near(grid, at, radius, near, mesh->n_triangle);
        assert_in_range(n, 0, mesh->n_triangle);
        memset(is_near, 0, mesh->n_triangle);
        for (uint32_t j = 0; j < n; j++) {
            assert_in_range(near[j], 0, mesh->n_triangle - 1);
            assert_int_equal(is_near[near[j]], 0); // each once
            is_near[near[j]] = 1;
        }
        found += n;
        for (uint32_t t = 0; t < mesh->n_triangle; t++) {
            if (distance_to(mesh, t, at) > radius) continue;
            needed++;
            assert_int_equal(is_near[t], 1);
        }
        if (!n) continue;
        assert_int_equal(prt_triangle_grid_near(grid, at, radius, near, n), n);
        assert_int_equal(prt_triangle_grid_near(grid, at, radius, near, n - 1), n);
    }
    expect_above("triangles that were near", needed, 100);
    expect_below("triangles found for each that is near", found / needed, 6);
    prt_triangle_grid_destroy(grid);
    free(near);
    free(is_near);
    prt_mesh_destroy(mesh);
}

// Contract of prt_triangle_grid_near: every triangle within the radius, each once, and a number
// above the most where there is no room.
static void near_triangles_are_found(void **state)
{
    check_grid(flutes());
    check_grid(large_and_small());
}

// Drawings from points below vertices, and rays in the same directions.
struct comparison {
    double looks, certain, none, other_triangle, far, corners;
};

static void compare(const struct prt_scene *scene, const struct directions *d, unsigned cpu,
                    uint32_t vertex, float depth, const float reach[2], struct draw_room *room,
                    const struct triangle_grid *grid, struct comparison *sum)
{
    const struct prt_mesh *mesh = prt_scene_mesh(scene);
    const float *x = mesh->position[vertex], *n = mesh->normal[vertex];
    const unsigned pattern = vertex * 37;
    float p[3], centre[3];
    for (int k = 0; k < 3; k++) p[k] = x[k] - depth * n[k], centre[k] = x[k] - 0.3f * n[k];
    const float want = reach[0];
    prt_draw_gather(grid, mesh, centre, reach[1], &room->near);
    prt_draw(d, pattern, p, 0, room);
    for (uint32_t first = 0; first < d->n_coef; first += 16) {
        uint32_t number[16], texel[16], at[16], known;
        float t[16], length[16];
        struct prt_packet ray = {0}, drawn = {0};
        struct corners normals;
        for (uint32_t i = 0; i < 16; i++) number[i] = first + i;
        prt_bake_loops(cpu)->aim(d, prt_direction_slopes(d, pattern), number, &drawn, texel,
                                 length);
        for (uint32_t i = 0; i < 16; i++) {
            const size_t from = texel_ray(d, pattern, (first + i) / 4, (first + i) % 4);
            assert_int_equal(texel[i], d->texel[first + i]);
            assert_true(fabsf(drawn.dx[i] - d->x[from]) < 3e-7f);
            assert_true(fabsf(drawn.dy[i] - d->y[from]) < 3e-7f);
            assert_true(fabsf(drawn.dz[i] - d->z[from]) < 3e-7f);
            ray.ox[i] = p[0], ray.oy[i] = p[1], ray.oz[i] = p[2];
            ray.dx[i] = d->x[from], ray.dy[i] = d->y[from], ray.dz[i] = d->z[from];
            ray.tfar[i] = want;
        }
        drawn = ray;
        known = prt_draw_look(cpu, &room->drawing[0], texel, length, want, t, at);
        prt_draw_hits(cpu, &room->near, &room->drawing[0], at, t, &drawn, &normals);
        prt_scene_intersect16(scene, &ray, 0xffff, false);
        for (int i = 0; i < 16; i++) {
            sum->looks++;
            if (!(known >> i & 1)) continue;
            sum->certain++;
            sum->none += drawn.triangle[i] == UINT32_MAX;
            if (drawn.triangle[i] != ray.triangle[i]) {
                sum->other_triangle++;
                continue;
            }
            if (drawn.triangle[i] == UINT32_MAX) continue;
            const uint32_t *corner = mesh->triangle[ray.triangle[i]];
            sum->far = fmax(sum->far, fabs((double)drawn.t[i] / (double)ray.t[i] - 1));
            sum->corners = fmax(sum->corners, fabs((double)drawn.u[i] - (double)ray.u[i]));
            sum->corners = fmax(sum->corners, fabs((double)drawn.v[i] - (double)ray.v[i]));
            double same = (double)(drawn.gx[i] * ray.gx[i] + drawn.gy[i] * ray.gy[i] +
                                   drawn.gz[i] * ray.gz[i]);
            assert_true(same > 0);
            for (int j = 0; j < 3; j++)
                for (int k = 0; k < 3; k++)
                    assert_true(normals.n[j][k][i] == mesh->normal[corner[j]][k]);
        }
    }
}

// Triangles within `gathered` mm of a centre are drawn; exits within `want` mm are looked for.
static void check_drawings(struct prt_mesh *mesh, uint32_t n, unsigned cpu, float want,
                           float gathered, double least_certain)
{
    struct prt_scene *scene;
    struct directions *d;
    struct draw_room room;
    struct comparison sum = {0};
    struct triangle_grid *grid = prt_triangle_grid_create(mesh);
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_directions_create(cpu, n, 4, 1, &d), PRT_OK);
    void *memory = prt_alloc(prt_draw_bytes(d->n_coef, 1), 1);
    assert_true(grid && memory);
    prt_draw_carve(memory, d->n_coef, 1, &room);
    for (uint32_t v = 11; v < mesh->n_vertex; v += mesh->n_vertex / 60)
        for (int i = 0; i < 3; i++) {
            static const float depth[3] = {0.03f, 0.4f, 1.5f};
            compare(scene, d, cpu, v, depth[i], (float[]){want, gathered}, &room, grid, &sum);
        }
    printf("%.0f directions, %.3f certain, %.3f of those without an exit\n", sum.looks,
           sum.certain / sum.looks, sum.none / sum.certain);
    expect_above("share of directions that are certain", sum.certain / sum.looks,
                 least_certain);
    // A direction along an edge may meet either triangle.
    expect_below("share that sees another triangle", sum.other_triangle / sum.certain, 1e-5);
    expect_below("difference of distances", sum.far, 3e-4);
    expect_below("difference of barycentric coordinates", sum.corners, 2.5e-3);
    prt_free(memory);
    prt_triangle_grid_destroy(grid);
    prt_directions_destroy(d);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

// Law: the first triangle that is drawn towards a direction is the first that its ray meets
// (METHODS §3.5, the exits of W05 eq 5).
static void drawings_show_what_rays_meet(void **state)
{
    const unsigned all = context.cpu;
    // At the poles of a ball are more than DRAW_MOST triangles.
    check_drawings(flutes(), 32, all, 1.2f, 2.5f, 0.9);
    check_drawings(flutes(), 16, all & PRT_CPU_AVX2, 1.2f, 2.5f, 0.9);
    check_drawings(flutes(), 32, 0, 12, 13, 0.4);
    // The deepest points lie 1.2 mm from the centre, so triangles within reach of them are
    // missing.
    check_drawings(flutes(), 16, all, 3, 3.1f, 0.3);
    check_drawings(large_and_small(), 64, all, 30, 31, 0.4);
}

// Contract of prt_draw_gather: where triangles are too many its reach falls, and what lies
// beyond is not certain.
static void too_many_triangles_are_not_drawn(void **state)
{
    struct prt_mesh *mesh = flutes();
    struct triangle_grid *grid = prt_triangle_grid_create(mesh);
    struct draw_room room;
    void *memory = prt_alloc(prt_draw_bytes(6 * 16 * 16, 1), 1);
    assert_true(grid && memory);
    prt_draw_carve(memory, 6 * 16 * 16, 1, &room);
    prt_draw_gather(grid, mesh, mesh->position[900], 100, &room.near);
    assert_true(room.near.reach < 100 && room.near.reach > 0.5f);
    assert_in_range(room.near.n, 16, DRAW_MOST);
    assert_int_equal(room.near.n % 16, 0);
    prt_free(memory);
    prt_triangle_grid_destroy(grid);
    prt_mesh_destroy(mesh);
}

int main(void)
{
    prt_context_init(&context);
    const struct CMUnitTest tests[] = {cmocka_unit_test(near_triangles_are_found),
                                       cmocka_unit_test(drawings_show_what_rays_meet),
                                       cmocka_unit_test(too_many_triangles_are_not_drawn)};
    return run_physics_tests(tests, NULL, NULL);
}
