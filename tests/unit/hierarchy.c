// SPDX-License-Identifier: MIT
// The tree of surface samples and the clusters of vertices that a bake works on.
#include "bake/stages.h"

#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

enum { N = 700, N_OBJECT = 4 };

static float draw(uint64_t *state)
{
    *state = *state * 6364136223846793005ull + 1442695040888963407ull;
    return (float)(*state >> 40) / (1 << 24);
}

// Samples of three bodies, the second without any: one wide along y, one of few samples.
static struct prt_surface_points *samples(void)
{
    static float position[N][3], centre[N][3], area[N], spread[N];
    static uint32_t begin[N_OBJECT + 1] = {0, 597, 597, 600, N};
    static struct prt_surface_points s;
    uint64_t state = 1;
    for (uint32_t i = 0; i < N; i++) {
        const float size[3] = {3, i < 600 ? 20 : 1, i < 600 ? 1 : 9};
        for (int k = 0; k < 3; k++) {
            position[i][k] = size[k] * draw(&state);
            centre[i][k] = position[i][k] + 0.2f * draw(&state);
        }
        area[i] = 0.1f + draw(&state);
        spread[i] = 0.5f * draw(&state);
    }
    s = (struct prt_surface_points){.n_sample = N,
                                    .n_object = N_OBJECT,
                                    .position = position,
                                    .centre = centre,
                                    .area = area,
                                    .spread = spread,
                                    .object_begin = begin};
    return &s;
}

// A node's area, centre, box and deviation are those of all samples below it.
static void check_node(const struct prt_surface_points *s, const struct hierarchy *h,
                       const struct node *node)
{
    double area = 0, centre[3] = {0}, square = 0;
    for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
        const uint32_t id = h->order[i];
        area += (double)s->area[id];
        for (int k = 0; k < 3; k++) {
            const float x = s->centre[id][k];
            centre[k] += (double)(s->area[id] * x);
            assert_true(x >= node->box[0][k] && x <= node->box[1][k]);
        }
    }
    for (int k = 0; k < 3; k++) {
        uint32_t low = 0, high = 0;
        for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
            low += s->centre[h->order[i]][k] == node->box[0][k];
            high += s->centre[h->order[i]][k] == node->box[1][k];
        }
        assert_true(low && high);
        assert_float_equal(node->centre[k], centre[k] / area, 1e-4);
    }
    assert_float_equal(node->area, area, 1e-3);
    // Across a direction a piece of surface deviates by half of its variance in the plane.
    for (uint32_t i = node->begin; i < node->begin + node->count; i++) {
        const uint32_t id = h->order[i];
        double own = (double)s->spread[id] * (double)s->spread[id];
        for (int k = 0; k < 3; k++)
            own += pow((double)s->centre[id][k] - centre[k] / area, 2) / 2;
        square += (double)s->area[id] * own;
    }
    assert_float_equal(node->spread, sqrt(square / area), 1e-3);
}

// The halves of a node lie on both sides of a plane across the longest axis of its samples.
static void check_halves(const struct prt_surface_points *s, const struct hierarchy *h,
                         const struct node *node)
{
    const struct node *a = &h->node[node->child[0]], *b = &h->node[node->child[1]];
    float low[2][3], high[2][3], most = 0;
    assert_int_equal(a->begin, node->begin);
    assert_int_equal(b->begin, node->begin + a->count);
    assert_int_equal(a->count + b->count, node->count);
    assert_in_range(b->count, a->count, a->count + 1);
    for (int side = 0; side < 2; side++) {
        const struct node *half = side ? b : a;
        for (int k = 0; k < 3; k++) low[side][k] = INFINITY, high[side][k] = -INFINITY;
        for (uint32_t i = half->begin; i < half->begin + half->count; i++)
            for (int k = 0; k < 3; k++) {
                low[side][k] = fminf(low[side][k], s->position[h->order[i]][k]);
                high[side][k] = fmaxf(high[side][k], s->position[h->order[i]][k]);
            }
    }
    int axis = 0;
    for (int k = 0; k < 3; k++) {
        const float width = fmaxf(high[0][k], high[1][k]) - fminf(low[0][k], low[1][k]);
        if (width > most) most = width, axis = k;
    }
    assert_true(high[0][axis] <= low[1][axis]);
}

static void nodes_hold_their_samples(void **state)
{
    const struct prt_surface_points *s = samples();
    struct hierarchy *h;
    uint8_t seen[N] = {0};
    assert_int_equal(prt_hierarchy_create(s, &h), PRT_OK);
    for (uint32_t i = 0; i < N; i++) {
        assert_true(h->order[i] < N);
        assert_false(seen[h->order[i]]++);
    }
    for (uint32_t o = 0; o < N_OBJECT; o++) {
        const uint32_t begin = s->object_begin[o], count = s->object_begin[o + 1] - begin;
        assert_int_equal(h->root[o] != 0, count != 0);
        if (!count) continue;
        assert_int_equal(h->node[h->root[o] - 1].begin, begin);
        assert_int_equal(h->node[h->root[o] - 1].count, count);
        for (uint32_t i = begin; i < begin + count; i++)
            assert_in_range(h->order[i], begin, begin + count - 1);
    }
    for (uint32_t i = 0; i < h->n_node; i++) {
        check_node(s, h, &h->node[i]);
        assert_int_equal(h->node[i].child[0] != 0, h->node[i].count > 8);
        if (h->node[i].child[0]) check_halves(s, h, &h->node[i]);
    }
    assert_true(h->n_node <= prt_hierarchy_most_nodes(N, N_OBJECT));
    prt_hierarchy_destroy(h);
}

// Contract of prt_hierarchy_most_nodes: a bound, which one object all but reaches.
static void nodes_are_bounded(void **state)
{
    struct prt_surface_points s = *samples();
    uint32_t begin[2] = {0};
    s.object_begin = begin;
    s.n_object = 1;
    for (uint32_t n = 1; n <= N; n++) {
        struct hierarchy *h;
        s.n_sample = begin[1] = n;
        assert_int_equal(prt_hierarchy_create(&s, &h), PRT_OK);
        assert_in_range(prt_hierarchy_most_nodes(n, 1), h->n_node, 2 * h->n_node);
        prt_hierarchy_destroy(h);
    }
}

// Vertices of four blocks: two surfaces of object 0, one of which is translucent, then another
// object of either kind.
static void blocks(struct prt_mesh *m)
{
    static float position[N][3];
    static struct prt_block block[4];
    static struct prt_surface surface[2] = {{.translucent = 0}, {.translucent = 1}};
    static const uint32_t end[4] = {100, 353, 600, N}, of[4] = {0, 0, 1, 1};
    uint64_t state = 7;
    for (uint32_t v = 0; v < N; v++)
        for (int k = 0; k < 3; k++) position[v][k] = (float)(3 - k) * draw(&state);
    for (uint32_t b = 0; b < 4; b++) {
        const uint32_t begin = b ? end[b - 1] : 0;
        block[b] = (struct prt_block){.object = of[b],
                                      .surface = (b + 1) % 2,
                                      .vertex_begin = begin,
                                      .n_vertex = end[b] - begin};
    }
    *m = (struct prt_mesh){.n_vertex = N,
                           .position = position,
                           .n_block = 4,
                           .block = block,
                           .n_surface = 2,
                           .surface = surface,
                           .n_object = 2};
}

// Contract of prt_clusters_create: vertices of one object, all translucent or all opaque, at
// most `target`; in the file's order within a cluster, apart from those of its sibling.
static void clusters_are_of_one_kind(void **state)
{
    static const uint32_t target[] = {1, 3, 64, 247, 10000};
    struct prt_mesh m;
    blocks(&m);
    for (size_t k = 0; k < sizeof target / sizeof *target; k++) {
        struct clusters *c;
        uint8_t seen[N] = {0};
        uint32_t end = 0;
        assert_int_equal(prt_clusters_create(&m, target[k], &c), PRT_OK);
        for (uint32_t i = 0; i < c->n_cluster; i++) {
            const struct prt_cluster *one = &c->cluster[i];
            assert_int_equal(one->vertex_begin, end);
            assert_in_range(one->n_vertex, 1, target[k]);
            end += one->n_vertex;
            for (uint32_t j = one->vertex_begin; j < end; j++) {
                const uint32_t v = c->order[j];
                assert_true(v < N && !seen[v]++);
                assert_int_equal(c->object[i], v >= 353);
                assert_int_equal(c->translucent[i], v < 100 || (v >= 353 && v < 600));
                assert_true(j == one->vertex_begin || v > c->order[j - 1]);
            }
        }
        assert_int_equal(end, N);
        if (target[k] == 10000) assert_int_equal(c->n_cluster, 4);
        if (target[k] == 1) assert_int_equal(c->n_cluster, N);
        prt_clusters_destroy(c);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(nodes_hold_their_samples),
        cmocka_unit_test(nodes_are_bounded),
        cmocka_unit_test(clusters_are_of_one_kind),
    };
    return cmocka_run_group_tests_name("hierarchy", tests, NULL, NULL);
}
