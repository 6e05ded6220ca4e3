// SPDX-License-Identifier: MIT
// The finer model that prt-bench relight_million measures is one that a file could hold.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdlib.h>
#include <string.h>

#include <cmocka.h>

#include "subdivide.h"
#include "synthetic.h"

enum { COARSE = 400, FINE = 5000, RANK = 5 };

static int number(const struct prt_tensor *t, uint32_t cluster, uint32_t r, uint32_t position)
{
    const struct prt_cluster *c = &t->cluster[cluster];
    const size_t padded = (c->n_vertex + 15) / 16 * 16;
    return (int16_t)t->u[c->u_begin + 2 * (r / 2 * padded + position) + r % 2];
}

// Where every vertex is: [n][2] cluster and position.
static uint32_t (*places_of(const struct prt_tensor *t))[2]
{
    uint32_t(*at)[2] = malloc(t->n_vertex * sizeof *at);
    assert_non_null(at);
    memset(at, 0xff, t->n_vertex * sizeof *at);
    for (uint32_t c = 0; c < t->n_cluster; c++)
        for (uint32_t v = 0; v < t->cluster[c].n_vertex; v++) {
            const uint32_t file = t->order[t->cluster[c].vertex_begin + v];
            assert_true(file < t->n_vertex && at[file][0] == UINT32_MAX);
            if (v) assert_true(file > t->order[t->cluster[c].vertex_begin + v - 1]);
            at[file][0] = c, at[file][1] = v;
        }
    for (uint32_t v = 0; v < t->n_vertex; v++) assert_int_not_equal(at[v][0], UINT32_MAX);
    return at;
}

static void a_finer_model_keeps_the_transport(void **state)
{
    const struct synthetic_options o = {.storage = PRT_STORAGE_FACTORED,
                                        .value = PRT_VALUE_PAIR,
                                        .n_vertex = COARSE,
                                        .n_cluster = 3,
                                        .rank = RANK,
                                        .n_phase = 1,
                                        .cube = 16,
                                        .coefs = 20,
                                        .seed = 1,
                                        .run = 4};
    struct prt_tensor coarse, fine;
    struct prt_mesh mesh;
    assert_int_equal(synthetic_mesh(COARSE, false, &mesh), PRT_OK);
    assert_int_equal(synthetic_tensor(&o, &coarse), PRT_OK);
    assert_int_equal(subdivided_tensor(&mesh, &coarse, FINE, &fine), PRT_OK);
    assert_int_equal(fine.n_vertex, FINE);
    uint32_t(*at)[2] = places_of(&fine);
    int changed = 0;
    for (uint32_t c = 0; c < coarse.n_cluster; c++)
        for (uint32_t v = 0; v < coarse.cluster[c].n_vertex; v++) {
            const uint32_t file = coarse.order[coarse.cluster[c].vertex_begin + v];
            assert_int_equal(at[file][0], c); // the model's own vertices stay what they are
            for (uint32_t r = 0; r < RANK; r++)
                assert_int_equal(number(&fine, c, r, at[file][1]), number(&coarse, c, r, v));
        }
    for (uint32_t v = COARSE; v < FINE; v++) // and new ones are not empty, nor out of range
        for (uint32_t r = 0; r < RANK; r++) {
            const int u = number(&fine, at[v][0], r, at[v][1]);
            assert_true(abs(u) <= PRT_U_MOST);
            changed += u != 0;
        }
    assert_true(changed > (FINE - COARSE) * RANK * 99 / 100);
    free(at);
    subdivided_finish(&fine);
    synthetic_tensor_finish(&coarse);
    synthetic_mesh_finish(&mesh);
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(a_finer_model_keeps_the_transport)};
    return cmocka_run_group_tests(tests, NULL, NULL);
}
