// SPDX-License-Identifier: MIT
// Pass 1 and what pass 2 gathers from: samples divide the surface among them, nodes of the
// hierarchy are sums of their samples, and the kernel of a cluster is the integral over all.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <stdlib.h>
#include <string.h>

#include "bodies.h"
#include "expect.h"
#include "bake/stages.h"

static struct prt_context context;
static struct prt_mesh *mesh;
static struct prt_surface_points *surface;
static struct hierarchy *hierarchy;

// 32 mm across, with dents; the samples are some 1.5 mm apart.
static double dents(double theta, double phi)
{
    return 16 + 2 * sin(3 * phi) * sin(theta) * sin(theta);
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

// The first corner, the two edges from it and their cross product.
struct face {
    double p[3], e1[3], e2[3], n[3];
};

static struct face face_of(uint32_t t)
{
    const uint32_t *i = mesh->triangle[t];
    struct face f;
    for (int k = 0; k < 3; k++) {
        f.p[k] = (double)mesh->position[i[0]][k];
        f.e1[k] = (double)mesh->position[i[1]][k] - f.p[k];
        f.e2[k] = (double)mesh->position[i[2]][k] - f.p[k];
    }
    cross(f.e1, f.e2, f.n);
    return f;
}

static double surface_area(void)
{
    double area = 0;
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        struct face f = face_of(t);
        area += sqrt(dot(f.n, f.n)) / 2;
    }
    return area;
}

// Whether a point lies in the triangle's plane and between its edges.
static bool contains(const struct face *f, const float q[3])
{
    double to[3], c[3], n2 = dot(f->n, f->n);
    for (int k = 0; k < 3; k++) to[k] = (double)q[k] - f->p[k];
    if (fabs(dot(f->n, to)) > 1e-4 * sqrt(n2)) return false;
    cross(to, f->e2, c);
    double u = dot(c, f->n) / n2;
    cross(f->e1, to, c);
    double v = dot(c, f->n) / n2;
    return u > 1e-3 && v > 1e-3 && u + v < 1 - 1e-3;
}

// Law: a triangle has a square number of fine points, in congruent pieces (METHODS §3.1)
static void pieces_fill_their_triangles(void **state)
{
    uint32_t all = 0;
    (void)state;
    for (uint32_t t = 0; t < mesh->n_triangle; t++) {
        struct face f = face_of(t);
        double n = 0, root, mean[3] = {0};
        if (sqrt(dot(f.n, f.n)) < 1e-6) continue; // at the poles
        for (uint32_t q = 0; q < surface->n_fine; q++)
            if (contains(&f, surface->fine[q])) {
                n++;
                for (int k = 0; k < 3; k++) mean[k] += (double)surface->fine[q][k];
            }
        root = round(sqrt(n));
        expect_near("fine points of a triangle", n, root * root, 0);
        for (int k = 0; k < 3; k++)
            expect_near("their mean, from its centre [mm]",
                        mean[k] / n - f.p[k] - (f.e1[k] + f.e2[k]) / 3, 0, 1.5e-6);
        all += (uint32_t)n;
    }
    assert_int_equal(all, surface->n_fine);
}

// Law: the cells of the samples are a partition of the surface: they have its area, and area,
// centre and spread are those of their points (METHODS §3.1)
static void cells_divide_the_surface(void **state)
{
    double area = surface_area(), cells = 0;
    (void)state;
    for (uint32_t i = 0; i < surface->n_sample; i++) {
        double own = 0, mean[3] = {0}, spread = 0;
        for (uint64_t k = surface->cell_begin[i]; k < surface->cell_begin[i + 1]; k++) {
            double w = (double)surface->cell_weight[k];
            own += w;
            for (int d = 0; d < 3; d++)
                mean[d] += w * (double)surface->fine[surface->cell_fine[k]][d];
        }
        expect_close("area of a sample over its points'", surface->area[i], own, 3e-7);
        for (uint64_t k = surface->cell_begin[i]; k < surface->cell_begin[i + 1]; k++)
            for (int d = 0; d < 3; d++) {
                double off = (double)surface->fine[surface->cell_fine[k]][d] - mean[d] / own;
                spread += (double)surface->cell_weight[k] * off * off / 2; // two axes
            }
        expect_close("spread of a sample [mm]", surface->spread[i], sqrt(spread / own), 5e-7);
        cells += own;
        for (int d = 0; d < 3; d++)
            expect_near("centre of a sample [mm]", surface->centre[i][d], mean[d] / own, 3e-6);
    }
    expect_close("area of the cells [mm^2]", cells, area, 1e-8);
}

// Law: a node's area and centre are those of its samples, its spread about the centre holds the
// samples' own, and its box holds them (METHODS §3.3)
static void nodes_are_sums_of_samples(void **state)
{
    (void)state;
    for (uint32_t at = 0; at < hierarchy->n_node; at++) {
        const struct node *node = &hierarchy->node[at];
        double area = 0, mean[3] = {0}, spread = 0;
        for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
            uint32_t s = hierarchy->order[i];
            area += (double)surface->area[s];
            for (int k = 0; k < 3; k++) {
                mean[k] += (double)surface->area[s] * (double)surface->centre[s][k];
                assert_true(surface->centre[s][k] >= node->box[0][k]);
                assert_true(surface->centre[s][k] <= node->box[1][k]);
            }
        }
        for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
            uint32_t s = hierarchy->order[i];
            double own = (double)surface->spread[s] * (double)surface->spread[s];
            for (int k = 0; k < 3; k++) {
                double off = (double)surface->centre[s][k] - mean[k] / area;
                own += off * off / 2;
            }
            spread += (double)surface->area[s] * own;
        }
        expect_close("area of a node [mm^2]", node->area, area, 3e-7);
        expect_close("spread of a node [mm]", node->spread, sqrt(spread / area), 5e-7);
        for (int k = 0; k < 3; k++)
            expect_near("centre of a node [mm]", node->centre[k], mean[k] / area, 3e-6);
        if (!node->child[0]) continue;
        const struct node *a = &hierarchy->node[node->child[0]],
                          *b = &hierarchy->node[node->child[1]];
        assert_int_equal(a->begin, node->begin);
        assert_int_equal(b->begin, a->begin + a->count);
        assert_int_equal(a->count + b->count, node->count);
    }
}

// Law: the irradiance of a node is the mean over its samples by area (METHODS §3.3, W05 eq 8)
static void rows_of_nodes_are_means(void **state)
{
    const struct prt_material medium = {.eta = 1.3f};
    const struct prt_media media = prt_media_one(&medium);
    struct irradiance_source from = {
        .surface = surface, .hierarchy = hierarchy, .media = &media, .room = SIZE_MAX};
    struct prt_scene *scene;
    struct directions *d;
    struct half_rows rows;
    (void)state;
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(prt_directions_create(context.cpu, 16, 4, 1, &d), PRT_OK);
    from.scene = scene, from.directions = d;
    assert_int_equal(prt_irradiance_bake(&context, &from, &rows), PRT_OK);
    double *mean = malloc(d->n_coef * sizeof *mean);
    assert_non_null(mean);
    for (uint32_t at = 0; at < hierarchy->n_node; at++) {
        const struct node *node = &hierarchy->node[at];
        double off = 0, norm = 0;
        memset(mean, 0, d->n_coef * sizeof *mean);
        for (uint32_t i = node->begin; i < node->begin + node->count; i++)
            for (uint32_t k = 0; k < d->n_coef; k++)
                mean[k] += (double)surface->area[hierarchy->order[i]] / (double)node->area *
                           (double)prt_f16_to_f32(rows.half[(size_t)i * d->n_coef + k]);
        for (uint32_t k = 0; k < d->n_coef; k++) {
            size_t row = (size_t)surface->n_sample + at;
            double got = (double)prt_f16_to_f32(rows.half[row * d->n_coef + k]);
            off += (got - mean[k]) * (got - mean[k]), norm += mean[k] * mean[k];
        }
        expect_below("row of a node: relative RMSE", sqrt(off / norm), 0.001);
    }
    free(mean);
    prt_half_rows_finish(&rows);
    prt_directions_destroy(d);
    prt_scene_destroy(scene);
}

// Two functions: 1, whose integral is the area, and one that falls within a few samples.
static void eval_functions(const void *user, unsigned cpu, size_t n, const float *r2,
                           float *const *out)
{
    (void)user, (void)cpu;
    for (size_t i = 0; i < n; i++) out[0][i] = 1, out[1][i] = expf(-sqrtf(r2[i])) / (r2[i] + 1);
}

// Law: the columns of a cluster's kernel add up to the integral of R over the surface, whatever
// nodes and samples they are (W05 eq 7, METHODS §3.4)
static void kernels_integrate_the_surface(void **state)
{
    struct radial_set radial = {.n = 2, .eval = eval_functions, .steepest = 1};
    struct clusters *clusters;
    struct cut cut = {0};
    double area = surface_area();
    (void)state;
    expect_above("spacing of the samples [mm]", surface->spacing, 1.2);
    assert_int_equal(prt_clusters_create(mesh, 64, &clusters), PRT_OK);
    struct cut_source from = {mesh, surface, hierarchy, clusters, 1};
    for (uint32_t c = 0; c < clusters->n_cluster; c += 3) {
        const struct prt_cluster *cluster = &clusters->cluster[c];
        uint32_t n = cluster->n_vertex;
        assert_int_equal(prt_cut_build(&context, &from, c, &radial, &cut), PRT_OK);
        expect_below("columns over samples", cut.n_column, surface->n_sample);
        for (uint32_t v = 0; v < n; v++) {
            const float *x = mesh->position[clusters->order[cluster->vertex_begin + v]];
            double sum[2] = {0}, want = 0;
            for (uint32_t k = 0; k < cut.n_column; k++)
                for (uint32_t f = 0; f < 2; f++)
                    sum[f] += (double)cut.k[((size_t)f * cut.n_column + k) * n + v];
            for (uint64_t k = 0; k < surface->cell_begin[surface->n_sample]; k++) {
                const float *q = surface->fine[surface->cell_fine[k]];
                float r2 = 0, value[2], *out[2] = {&value[0], &value[1]};
                for (int d = 0; d < 3; d++) r2 += (q[d] - x[d]) * (q[d] - x[d]);
                eval_functions(NULL, 0, 1, &r2, out);
                want += (double)(surface->cell_weight[k] * value[1]);
            }
            expect_close("sum of the constant", sum[0] * M_PI, area, 2e-7);
            expect_near("sum over the integral", sum[1] * M_PI / want, 1, 7e-4);
        }
    }
    prt_cut_finish(&cut);
    prt_clusters_destroy(clusters);
}

int main(void)
{
    struct model m;
    prt_context_init(&context);
    if (prt_pool_create(0, &context.pool)) return 1;
    model_init(&m, 40 * 21, 40 * 20 * 2);
    add_ball(&m, 40, 20, 20, dents);
    mesh = body_mesh(&context, &m, false);
    if (prt_surface_create(&context, mesh, 1400, 0.4f, 5, &surface) ||
        prt_hierarchy_create(surface, &hierarchy))
        return 1;
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(pieces_fill_their_triangles),
        cmocka_unit_test(cells_divide_the_surface),
        cmocka_unit_test(nodes_are_sums_of_samples),
        cmocka_unit_test(rows_of_nodes_are_means),
        cmocka_unit_test(kernels_integrate_the_surface),
    };
    int failed = run_physics_tests(tests, NULL, NULL);
    prt_hierarchy_destroy(hierarchy);
    prt_surface_destroy(surface);
    prt_mesh_destroy(mesh);
    prt_pool_destroy(context.pool);
    return failed;
}
