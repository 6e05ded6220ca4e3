// SPDX-License-Identifier: MIT
// What the bake leaves out: rays whose answer is known, repeated values, turns of the price.
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
#include "bake/stages.h"

static struct prt_context context;

static struct prt_mesh *body(void)
{
    struct model m;
    model_init(&m, 160 * 81, 160 * 80 * 2);
    add_ball(&m, 160, 80, 80, fluted_ball);
    return body_mesh(&context, &m, false);
}

// Law: directions that the horizon knows give the rows of all rays (METHODS §3.2, W05 eq 8).
static void known_directions_take_no_rays(void **state)
{
    struct prt_mesh *mesh = body();
    struct prt_scene *scene;
    struct horizon *horizon;
    struct directions *d;
    struct fresnel_table fresnel;
    assert_int_equal(prt_scene_create(&context, mesh, &scene), PRT_OK);
    assert_int_equal(horizon_create(scene, &horizon), PRT_OK);
    assert_int_equal(directions_create(32, 4, 1, &d), PRT_OK);
    fresnel_table_init(&fresnel, 1.3);
    float *every = prt_alloc(d->n_coef, sizeof *every),
          *seen = prt_alloc(d->n_coef, sizeof *seen);
    assert_true(every && seen);
    uint64_t rays = 0, all = 0;
    double error = 0, sum = 0, hidden = 0, texels = 0;
    for (uint32_t t = 7; t < mesh->n_triangle; t += 211) {
        const uint32_t *v = mesh->triangle[t];
        float at[3], normal[3] = {0}, face[3], e[2][3];
        for (int k = 0; k < 3; k++) {
            const float a = mesh->position[v[0]][k], b = mesh->position[v[1]][k],
                        c = mesh->position[v[2]][k];
            at[k] = (a + b + c) / 3, e[0][k] = b - a, e[1][k] = c - a;
            for (int i = 0; i < 3; i++) normal[k] += mesh->normal[v[i]][k] / 3;
        }
        double length = 0;
        for (int k = 0; k < 3; k++) {
            int i = (k + 1) % 3, j = (k + 2) % 3;
            face[k] = e[0][i] * e[1][j] - e[0][j] * e[1][i];
            length += (double)face[k] * (double)face[k];
        }
        for (int k = 0; k < 3; k++) face[k] /= (float)sqrt(length);
        struct horizon_view view;
        horizon_all(horizon, t, &view);
        all += irradiance_row(scene, d, t, &fresnel, at, normal, face, every);
        rays += irradiance_row_seen(scene, d, t, &fresnel, at, normal, face, &view, seen);
        for (uint32_t i = 0; i < d->n_coef; i++) {
            double w = (double)d->solid_angle[i], x = (double)every[i], y = (double)seen[i];
            error += w * (x - y) * (x - y), sum += w * x * x;
            hidden += x == 0, texels++;
        }
    }
    printf("rays %.3f of all, rows differ by %.3f %%, %.0f %% of texels dark\n",
           (double)rays / (double)all, 100 * sqrt(error / sum), 100 * hidden / texels);
    expect_above("share of dark texels", hidden / texels, 0.52); // flutes hide each other
    expect_below("rays over all rays", (double)rays / (double)all, 0.5);
    expect_below("relative RMSE of the rows", sqrt(error / sum), 0.01);
    prt_free(every);
    prt_free(seen);
    directions_destroy(d);
    horizon_destroy(horizon);
    prt_scene_destroy(scene);
    prt_mesh_destroy(mesh);
}

// Clusters of made-up rows whose coefficients fall off at very different rates.
static struct factored *rows_of(uint32_t n_cluster, uint32_t n_vertex, uint32_t n, uint32_t J)
{
    uint32_t n_coef = 6 * n * n, rank = 4;
    struct factored *f = calloc(n_cluster, sizeof *f);
    struct prt_rng rng;
    assert_non_null(f);
    prt_rng_init(&rng, 3, 3);
    for (uint32_t c = 0; c < n_cluster; c++) {
        struct factored *own = &f[c];
        double loud = exp(4 * (double)prt_rng_f32(&rng));
        own->n_vertex = n_vertex, own->rank = rank;
        own->u = prt_calloc(rank * n_vertex, sizeof *own->u);
        own->b = prt_alloc(rank * J * n_coef, sizeof *own->b);
        own->scale = prt_alloc(rank * J, sizeof *own->scale);
        own->energy = prt_calloc(rank * n_coef, sizeof *own->energy);
        own->tail = calloc(rank + 1, sizeof *own->tail);
        assert_true(own->u && own->b && own->scale && own->energy && own->tail);
        for (uint32_t i = 0; i < rank * J; i++) own->scale[i] = 1;
        for (uint32_t r = rank; r-- > 0;) {
            own->tail[r] = own->tail[r + 1];
            own->u[r * n_vertex + r] = 1;
            for (uint32_t k = 0; k < n_coef; k++) {
                double x = loud * exp(-8 * (double)prt_rng_f32(&rng) - r);
                own->energy[r * n_coef + k] = (float)(x * x);
                own->tail[r] += x * x;
                for (uint32_t j = 0; j < J; j++)
                    own->b[((size_t)r * J + j) * n_coef + k] = prt_f32_to_f16((float)x);
            }
        }
    }
    return f;
}

// Law: the multiplier of energy + lambda * bytes fills the byte budget and no more (METHODS
// §3.4).
static void the_bytes_allowed_are_used(void **state)
{
    enum { CLUSTERS = 67, VERTICES = 40, N = 16, J = 3 };
    struct prt_cluster cluster[CLUSTERS];
    uint32_t order[CLUSTERS * VERTICES];
    for (uint32_t i = 0; i < CLUSTERS * VERTICES; i++) order[i] = i;
    for (uint32_t c = 0; c < CLUSTERS; c++)
        cluster[c] = (struct prt_cluster){c * VERTICES, VERTICES, 0, 0, 0};
    struct clusters clusters = {.n_cluster = CLUSTERS, .cluster = cluster, .order = order};
    struct factored *f = rows_of(CLUSTERS, VERTICES, N, J);
    static const double budget[] = {2e5, 6e5, 1e12};
    for (int i = 0; i < 3; i++) {
        struct pack_options o = {.energy_error = i < 2 ? 1e-4 : 0.05, .max_bytes = budget[i]};
        struct prt_tensor t;
        uint64_t u_bytes, row_bytes;
        assert_int_equal(pack_factored(&context, &clusters, f, J, N, &o, &t), PRT_OK);
        prt_tensor_bytes(&t, &u_bytes, &row_bytes);
        // Energies lost: all less what is kept.
        double total = 0, kept = 0;
        for (uint32_t c = 0; c < CLUSTERS; c++) total += f[c].tail[0];
        for (uint32_t c = 0; c < CLUSTERS; c++)
            for (uint32_t r = 0; r < t.cluster[c].rank; r++) {
                uint32_t row = t.cluster[c].row_begin + r;
                const float *e = f[c].energy + (size_t)r * 6 * N * N;
                for (uint32_t k = 0; k < 6; k++) kept += (double)e[k * N * N];
                const uint16_t *index = t.rows.index;
                for (uint64_t at = t.rows.begin[row]; at < t.rows.begin[row + 1]; at++)
                    if (at == t.rows.begin[row] || index[at] != index[at - 1]) // no half pair
                        kept += (double)e[index[at]];
            }
        double bytes =
            (double)t.rows.begin[t.rows.n_row] * (2 + 2 * J) + t.rows.n_row * (16.0 * J + 8);
        for (uint32_t c = 0; c < CLUSTERS; c++) // rows of U lie in pairs
            bytes += (t.cluster[c].rank + 1) / 2 * 4.0 * VERTICES;
        double error = sqrt((total - kept) / total);
        printf("budget %.0f: %.0f bytes, %.4f lost\n", budget[i], bytes, error);
        assert_true(bytes <= budget[i]);
        if (i < 2) expect_near("bytes over the budget", bytes / budget[i], 1, 0.01);
        else expect_near("energy lost without a budget", error, 0.05, 0.001);
        tensor_finish(&t);
    }
    for (uint32_t c = 0; c < CLUSTERS; c++) factored_finish(&f[c]);
    free(f);
}

int main(void)
{
    prt_context_init(&context);
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(known_directions_take_no_rays),
        cmocka_unit_test(the_bytes_allowed_are_used),
    };
    return run_physics_tests(tests, NULL, NULL);
}
