// SPDX-License-Identifier: MIT
// Contract of prt/trace.h: a ray meets the triangle that a search through all of them finds, at
// the same distance, and its barycentric coordinates name the same point.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <malloc.h>
#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"
#include "prt/surface.h"
#include "prt/trace.h"

static struct prt_context context;
static struct prt_mesh *mesh;
static struct prt_scene *scene;

static double dents(double theta, double phi)
{
    return 8 + 1.5 * sin(3 * phi) * sin(theta) * sin(theta);
}

static void corners(uint32_t triangle, double p[3][3])
{
    for (int i = 0; i < 3; i++)
        for (int k = 0; k < 3; k++)
            p[i][k] = (double)mesh->position[mesh->triangle[triangle][i]][k];
}

static void cross(const double a[3], const double b[3], double out[3])
{
    for (int k = 0; k < 3; k++)
        out[k] = a[(k + 1) % 3] * b[(k + 2) % 3] - a[(k + 2) % 3] * b[(k + 1) % 3];
}

static double dot(const double a[3], const double b[3])
{
    return a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
}

// Distance at which the ray meets a triangle, or infinity; *edge is the least barycentric
// coordinate: near 0 the neighbour is as good an answer.
static double distance_to(uint32_t triangle, const double o[3], const double d[3], double *edge)
{
    double p[3][3], e1[3], e2[3], n[3], to[3], q[3];
    corners(triangle, p);
    for (int k = 0; k < 3; k++)
        e1[k] = p[1][k] - p[0][k], e2[k] = p[2][k] - p[0][k], to[k] = p[0][k] - o[k];
    cross(e1, e2, n);
    double det = dot(n, d), t = dot(n, to) / det;
    cross(to, d, q);
    double u = dot(q, e2) / det, v = -dot(q, e1) / det;
    *edge = fmin(fmin(u, v), 1 - u - v);
    return *edge >= 0 ? t : INFINITY;
}

// The nearest triangle of all; UINT32_MAX: none, or the ray passes within 1e-4 of an edge,
// which *sure tells.
static uint32_t nearest(const double o[3], const double d[3], double tnear, double tfar,
                        double *t, bool *sure)
{
    uint32_t found = UINT32_MAX;
    *t = tfar;
    *sure = true;
    for (uint32_t i = 0; i < mesh->n_triangle; i++) {
        double edge, at = distance_to(i, o, d, &edge);
        if (fabs(edge) < 1e-4 || fabs(at - tnear) < 1e-4 || fabs(at - tfar) < 1e-4)
            *sure = false;
        if (at > tnear && at < *t) *t = at, found = i;
    }
    return found;
}

static void random_packet(struct prt_rng *rng, struct prt_packet *p)
{
    for (int i = 0; i < 16; i++) {
        float o[3], d[3];
        bool inside = prt_rng_f32(rng) < 0.5f;
        for (int k = 0; k < 3; k++) {
            o[k] = (prt_rng_f32(rng) - 0.5f) * (inside ? 6 : 40);
            d[k] = inside ? prt_rng_f32(rng) - 0.5f : (prt_rng_f32(rng) - 0.5f) * 16 - o[k];
        }
        p->ox[i] = o[0], p->oy[i] = o[1], p->oz[i] = o[2];
        p->dx[i] = d[0], p->dy[i] = d[1], p->dz[i] = d[2];
        // behind the first hit of most rays, or before it
        p->tnear[i] = prt_rng_f32(rng) < 0.3f ? inside ? 25 : 0.9f : 0;
        p->tfar[i] = prt_rng_f32(rng) < 0.3f ? 0.6f : 1e3f;
    }
}

// The point and the normal that lane i names, against the search's distance and triangle.
static void lane_agrees(const struct prt_packet *p, int i, uint32_t triangle, double t)
{
    double c[3][3], e1[3], e2[3], n[3], u = (double)p->u[i], v = (double)p->v[i];
    const double o[3] = {(double)p->ox[i], (double)p->oy[i], (double)p->oz[i]};
    const double d[3] = {(double)p->dx[i], (double)p->dy[i], (double)p->dz[i]};
    const double g[3] = {(double)p->gx[i], (double)p->gy[i], (double)p->gz[i]};
    assert_int_equal(p->triangle[i], triangle);
    expect_near("distance over the search's", (double)p->t[i] / t, 1, 2e-6);
    corners(triangle, c);
    for (int k = 0; k < 3; k++) e1[k] = c[1][k] - c[0][k], e2[k] = c[2][k] - c[0][k];
    cross(e1, e2, n);
    for (int k = 0; k < 3; k++) {
        expect_near("point of the coordinates [mm]", c[0][k] + u * e1[k] + v * e2[k],
                    o[k] + t * d[k], 6e-6);
        expect_near("normal, of its length", g[k] / sqrt(dot(n, n)), n[k] / sqrt(dot(n, n)),
                    5e-7);
    }
}

// Contract of prt_scene_intersect16 and prt_scene_occluded16: as above for the lanes of the
// mask; the others miss.
static void packets_meet_what_a_search_finds(void **state)
{
    struct prt_rng rng;
    uint32_t hits = 0, misses = 0;
    (void)state;
    prt_rng_init(&rng, 11, 0);
    for (int round = 0; round < 40; round++) {
        struct prt_packet p;
        uint32_t mask = round % 3 ? prt_rng_u32(&rng) & 0xffff : 0xffff;
        random_packet(&rng, &p);
        uint32_t blocked = prt_scene_occluded16(scene, &p, mask);
        prt_scene_intersect16(scene, &p, mask, round % 2);
        assert_int_equal(blocked & ~mask, 0);
        for (int i = 0; i < 16; i++) {
            const double o[3] = {(double)p.ox[i], (double)p.oy[i], (double)p.oz[i]};
            const double d[3] = {(double)p.dx[i], (double)p.dy[i], (double)p.dz[i]};
            double t;
            bool sure;
            uint32_t triangle = nearest(o, d, (double)p.tnear[i], (double)p.tfar[i], &t, &sure);
            if (!sure) continue;
            if (!(mask >> i & 1)) triangle = UINT32_MAX;
            assert_int_equal(blocked >> i & 1, triangle != UINT32_MAX);
            if (triangle != UINT32_MAX) {
                lane_agrees(&p, i, triangle, t);
                hits++;
                continue;
            }
            assert_int_equal(p.triangle[i], UINT32_MAX);
            assert_true(p.t[i] == p.tfar[i] && p.u[i] == 0 && p.v[i] == 0);
            misses += mask >> i & 1;
        }
    }
    expect_above("rays that hit", hits, 200);
    expect_above("rays that missed", misses, 50);
}

// Contract of prt_scene_intersect: the same for one ray; at a seam, too, something is hit.
static void one_ray_meets_the_same(void **state)
{
    struct prt_rng rng;
    (void)state;
    prt_rng_init(&rng, 12, 0);
    for (int round = 0; round < 400; round++) {
        struct prt_packet p;
        float t, u, v;
        uint32_t triangle;
        random_packet(&rng, &p);
        const float o[3] = {p.ox[0], p.oy[0], p.oz[0]}, d[3] = {p.dx[0], p.dy[0], p.dz[0]};
        bool hit =
            prt_scene_intersect(scene, o, d, p.tnear[0], p.tfar[0], &t, &triangle, &u, &v);
        prt_scene_intersect16(scene, &p, 1, false);
        if (p.triangle[0] == UINT32_MAX) continue;
        assert_true(hit);
        assert_int_equal(triangle, p.triangle[0]);
        assert_true(t == p.t[0] && u == p.u[0] && v == p.v[0]);
    }
    for (uint32_t i = 0; i < mesh->n_vertex; i++) { // from the middle straight at a vertex
        const float *x = mesh->position[i];
        float o[3] = {0, 0, 0}, t, u, v;
        uint32_t triangle;
        assert_true(prt_scene_intersect(scene, o, x, 0, 2, &t, &triangle, &u, &v));
        expect_near("distance to a vertex", t, 1, 1.5e-4);
    }
}

// Contract of prt_scene_epsilon: 1e-4 of the mean edge, 1e-6 of the diagonal at least.
static void epsilon_is_small(void **state)
{
    double sum = 0, diagonal = 2 * sqrt(3) * 9.5;
    (void)state;
    for (uint32_t i = 0; i < mesh->n_triangle; i++) {
        double p[3][3], e[3];
        corners(i, p);
        for (int k = 0; k < 3; k++) e[k] = p[1][k] - p[0][k];
        sum += sqrt(dot(e, e));
    }
    double mean = sum / mesh->n_triangle;
    expect_close("epsilon over the mean edge", prt_scene_epsilon(scene) / mean, 1e-4, 1e-6);
    expect_above("epsilon over the diagonal", prt_scene_epsilon(scene) / diagonal, 1e-6);
}

// The triangle of a body that a point of its surface lies on, and its barycentric coordinates.
static uint32_t triangle_at(const struct prt_mesh *body, const float x[3], float *u, float *v)
{
    uint32_t best = 0;
    double least = INFINITY;
    for (uint32_t i = 0; i < body->n_triangle; i++) {
        double p[3][3], e1[3], e2[3], n[3], to[3], q[3];
        for (int k = 0; k < 3; k++) {
            for (int j = 0; j < 3; j++)
                p[j][k] = (double)body->position[body->triangle[i][j]][k];
            e1[k] = p[1][k] - p[0][k], e2[k] = p[2][k] - p[0][k];
            to[k] = (double)x[k] - p[0][k];
        }
        cross(e1, e2, n);
        cross(to, e2, q);
        const double a = dot(q, n) / dot(n, n);
        cross(e1, to, q);
        const double b = dot(q, n) / dot(n, n);
        const double off = fmax(fmax(-fmin(a, b), a + b - 1), fabs(dot(to, n)) / dot(n, n));
        if (off >= least) continue;
        least = off, best = i, *u = (float)a, *v = (float)b;
    }
    expect_below("a sample off its triangle", least, 1e-5);
    return best;
}

// Contract of prt_surface_stratum: every sample lies in its own stratum, whose area is that of
// the piece of the sampler's path up to the next one; few have more than two of the mean.
static void samples_lie_in_their_strata(void **state)
{
    enum { SAMPLES = 500, POINTS = 400 };
    struct model m;
    struct prt_surface_points *surface;
    struct prt_surface_strata *strata;
    struct prt_rng rng;
    static uint32_t count[2 * SAMPLES];
    double square = 0, own = 0, large = 0;
    model_init(&m, 4 * 6, 2 * 6);
    add_box(&m, (float[3]){0, 0, 0}, (float[3]){5, 5, 5}, 1);
    struct prt_mesh *box = body_mesh(&context, &m, true);
    assert_int_equal(prt_surface_create(&context, box, SAMPLES, 1, 3, &surface), PRT_OK);
    assert_int_equal(prt_surface_strata_create(&context, box, surface, &strata), PRT_OK);
    const uint32_t n = surface->n_sample;
    const double area = prt_surface_area(box);
    expect_near("samples over those that were asked for", (double)n / SAMPLES, 1, 0.02);
    prt_rng_init(&rng, 21, 0);
    for (uint32_t i = 0; i < n * POINTS; i++) { // all triangles have the same area
        float u = prt_rng_f32(&rng), v = prt_rng_f32(&rng);
        if (u + v > 1) u = 1 - u, v = 1 - v;
        const uint32_t at = prt_surface_stratum(strata, i % box->n_triangle, u, v);
        assert_true(at < n);
        count[at]++;
    }
    for (uint32_t i = 0; i < n; i++) {
        float u = 0, v = 0;
        const uint32_t t = triangle_at(box, surface->position[i], &u, &v);
        const double end = i + 1 < n ? surface->stratum[i + 1] : area;
        const double share = n * (end - surface->stratum[i]) / area;
        square += pow((double)count[i] / POINTS - share, 2) / n;
        own += (double)(prt_surface_stratum(strata, t, u, v) == i) / n;
        large += (double)(share > 2) / n;
    }
    expect_below("areas of strata off the path's, RMS", sqrt(square), 0.08); // 0.05 by chance
    expect_above("samples in their own strata", own, 0.999);
    expect_below("strata above twice the mean", large, 0.04);
    prt_surface_strata_destroy(strata);
    prt_surface_destroy(surface);
    prt_mesh_destroy(box);
}

// The samples of `few` that `many` has not.
static double missing_samples(const struct prt_surface_points *few,
                              const struct prt_surface_points *many)
{
    double missing = 0;
    for (uint32_t i = 0; i < few->n_sample; i++) {
        bool found = false;
        for (uint32_t k = 0; k < many->n_sample && !found; k++)
            found = few->triangle[i] == many->triangle[k] &&
                    !memcmp(few->inside[i], many->inside[k], sizeof few->inside[i]);
        missing += (double)!found / few->n_sample;
    }
    return missing;
}

// Law: samples stay where they are (METHODS §3.1). Those of a smaller number are among those of
// a larger one; at another scale all are the same; where a vertex is moved, those far from it.
static void samples_stay(void **state)
{
    enum { N = 3000 };
    struct model m;
    struct prt_surface_points *s[4];
    model_init(&m, 40 * 21, 40 * 20 * 2);
    add_ball(&m, 40, 20, 20, fluted_ball);
    struct prt_mesh *ball = body_mesh(&context, &m, true);
    assert_int_equal(prt_surface_create(&context, ball, N, 1, 3, &s[0]), PRT_OK);
    assert_int_equal(prt_surface_create(&context, ball, N * 17 / 10, 1, 3, &s[1]), PRT_OK);
    for (uint32_t v = 0; v < ball->n_vertex; v++)
        for (int k = 0; k < 3; k++) ball->position[v][k] *= 1.7f;
    assert_int_equal(prt_surface_create(&context, ball, N, 1, 3, &s[2]), PRT_OK);
    for (int k = 0; k < 3; k++) ball->model[210][k] *= 1.1f;
    assert_int_equal(prt_surface_create(&context, ball, N, 1, 3, &s[3]), PRT_OK);
    expect_below("samples that a larger number has not", missing_samples(s[0], s[1]), 1e-9);
    expect_below("samples that another scale has not", missing_samples(s[0], s[2]), 1e-9);
    expect_below("samples that move with a vertex", missing_samples(s[0], s[3]), 0.1);
    expect_above("samples that move with a vertex", missing_samples(s[0], s[3]), 1e-4);
    for (int i = 0; i < 4; i++) prt_surface_destroy(s[i]);
    prt_mesh_destroy(ball);
}

// Law: a point of the surface takes the irradiance of its three nearest samples (METHODS §3.1).
static void points_lie_in_three_cells(void **state)
{
    struct model m;
    struct prt_surface_points *s;
    uint32_t n_other = 0;
    model_init(&m, 40 * 21, 40 * 20 * 2);
    add_ball(&m, 40, 20, 20, fluted_ball);
    struct prt_mesh *ball = body_mesh(&context, &m, true);
    assert_int_equal(prt_surface_create(&context, ball, 3000, 1, 3, &s), PRT_OK);
    uint8_t *cells = calloc(s->n_fine, 1);
    for (uint64_t k = 0; k < s->cell_begin[s->n_sample]; k++)
        cells[s->cell_fine[k]] += s->cell_weight[k] > 0;
    for (uint32_t i = 0; i < s->n_fine; i++) n_other += cells[i] != 3;
    expect_below("points in more or fewer cells", (double)n_other / s->n_fine, 1e-3);
    free(cells);
    prt_surface_destroy(s);
    prt_mesh_destroy(ball);
}

// Law: cells end at the edges of a box, as the sheets do (METHODS §3.1): those of a face's
// samples lie on it and add up to its area, also where the other side is nearer than the next
// sample.
static void cells_stay_on_their_face(void **state)
{
    static const float half[2][3] = {{5, 5, 5}, {6, 0.1f, 4}};
    for (int b = 0; b < 2; b++) {
        struct model m;
        struct prt_surface_points *surface;
        double area[3][2] = {{0}}, off = 0;
        model_init(&m, 25 * 6, 32 * 6);
        add_box(&m, (float[3]){0, 0, 0}, half[b], 4);
        struct prt_mesh *box = body_mesh(&context, &m, true);
        assert_int_equal(prt_surface_create(&context, box, 2000, 0.2f, 4, &surface), PRT_OK);
        for (uint32_t i = 0; i < surface->n_sample; i++) {
            const float *n = surface->face_normal[i];
            const int axis = fabsf(n[0]) > 0.5f ? 0 : fabsf(n[1]) > 0.5f ? 1 : 2;
            area[axis][n[axis] > 0] += (double)surface->area[i];
            for (uint64_t k = surface->cell_begin[i]; k < surface->cell_begin[i + 1]; k++) {
                const float *x = surface->fine[surface->cell_fine[k]];
                off = fmax(off, fabs((double)(x[axis] * n[axis] - half[b][axis])));
            }
        }
        expect_below("points of cells off their face [mm]", off, 1e-5);
        for (int axis = 0; axis < 3; axis++)
            for (int side = 0; side < 2; side++)
                expect_near("area of a face's cells over its own",
                            area[axis][side] / (4 * (double)half[b][(axis + 1) % 3] *
                                                (double)half[b][(axis + 2) % 3]),
                            1, 1e-4);
        prt_surface_destroy(surface);
        prt_mesh_destroy(box);
    }
}

// Contract of prt_scene_blocked: harmonics of the directions that are hidden and of their
// mirror images in the tangent plane (METHODS §6, specular occlusion). A roof as wide as a
// cube's face hides that face.
static void a_roof_hides_the_sky(void **state)
{
    enum { STEPS = 200 };
    struct model m;
    struct prt_scene *scenery;
    double want[PRT_MESH_BLOCKED] = {0};
    model_init(&m, 9 + 4, 8 + 2);
    struct prt_block *block = begin_block(&m, true);
    add_sheet(&m, (float[3]){0, 0, 0}, (float[3]){0, 0, 1}, (float[3]){1, 0, 0}, 2);
    add_sheet(&m, (float[3]){0, 10, 0}, (float[3]){10, 0, 0}, (float[3]){0, 0, 10}, 1);
    end_block(&m, block);
    struct prt_mesh *body = body_mesh(&context, &m, true);
    int8_t(*got)[PRT_MESH_BLOCKED] = calloc(body->n_vertex, sizeof *got);
    assert_int_equal(prt_scene_create(&context, body, &scenery), PRT_OK);
    assert_int_equal(prt_scene_blocked(&context, scenery, got), PRT_OK);
    for (int i = 0; i < STEPS * STEPS; i++) {
        const double s = 2 * (i % STEPS + 0.5) / STEPS - 1,
                     t = 2 * (i / STEPS + 0.5) / STEPS - 1;
        const double r = sqrt(1 + s * s + t * t), omega = 4 / (r * r * r) / (STEPS * STEPS);
        float y[2][PRT_MESH_BLOCKED];
        for (int k = 0; k < 2; k++) // and below the floor
            prt_sh_eval(4, (float[]){(float)(s / r), (float)((k ? -1 : 1) / r), (float)(t / r)},
                        y[k]);
        for (int k = 0; k < PRT_MESH_BLOCKED; k++)
            want[k] += omega * (double)(y[0][k] + y[1][k]);
    }
    uint32_t middle = 0;
    while (body->position[middle][0] != 0 || body->position[middle][2] != 0) middle++;
    for (int k = 0; k < PRT_MESH_BLOCKED; k++)
        expect_near("a harmonic of what is hidden",
                    got[middle][k] * (double)PRT_MESH_BLOCKED_SCALE / 127, want[k],
                    0.15); // of 256 directions
    free(got);
    prt_scene_destroy(scenery);
    prt_mesh_destroy(body);
}

// Bytes that are allocated.
static double heap(void)
{
    const struct mallinfo2 m = mallinfo2();
    return (double)(m.uordblks + m.hblkhd);
}

// Contract of prt_scene_destroy: it frees all memory of the scene.
static void scenes_give_their_memory_back(void **state)
{
    enum { FIRST = 4, ALL = 12 };
    const double copies = 12.0 * mesh->n_vertex + 12.0 * mesh->n_triangle;
    double before = 0;
    if (!(heap() > 0)) skip(); // a sanitizer's allocator does not count
    for (int i = 0; i < ALL; i++) {
        struct prt_scene *s;
        if (i == FIRST) before = heap();
        assert_int_equal(prt_scene_create(&context, mesh, &s), PRT_OK);
        prt_scene_destroy(s);
    }
    expect_below("bytes kept over those of the mesh",
                 (heap() - before) / (ALL - FIRST) / copies, 0.1);
}

int main(void)
{
    struct model m;
    prt_context_init(&context);
    model_init(&m, 24 * 13, 24 * 12 * 2);
    add_ball(&m, 24, 12, 12, dents);
    mesh = body_mesh(&context, &m, false);
    if (prt_scene_create(&context, mesh, &scene)) return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(packets_meet_what_a_search_finds),
        cmocka_unit_test(one_ray_meets_the_same),
        cmocka_unit_test(epsilon_is_small),
        cmocka_unit_test(samples_lie_in_their_strata),
        cmocka_unit_test(samples_stay),
        cmocka_unit_test(points_lie_in_three_cells),
        cmocka_unit_test(cells_stay_on_their_face),
        cmocka_unit_test(a_roof_hides_the_sky),
        cmocka_unit_test(scenes_give_their_memory_back),
    };
    int failed = run_physics_tests(tests, NULL, NULL);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
    return failed;
}
