// SPDX-License-Identifier: MIT
// The smoothing of walks over a cluster's vertices, on answers whose truth is known.
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <setjmp.h>
#include <cmocka.h>

#include <math.h>
#include <string.h>

#include "bake/run.h"
#include "bake/walks.h"
#include "expect.h"

enum { VERTICES = 60, LIGHTS = 96, MODES = 5, CHANNELS = 3, LIKENESSES = 6 };
static const uint32_t bright = 20, dark = 41; // vertices at creases

static struct prt_rng rng;
static float like[LIKENESSES][VERTICES][VERTICES];
static float dipole[CHANNELS][VERTICES][LIGHTS], truth[CHANNELS][VERTICES][LIGHTS];

// A normal deviate.
static float deviate(void)
{
    const float r = sqrtf(-2 * logf(1 - prt_rng_f32(&rng)));
    return r * cosf(6.2831853f * prt_rng_f32(&rng));
}

// Vertices along a line. The dipole's answers change slowly along it; the truth is 0.8 of them,
// and at two vertices `at_crease` and its inverse of that.
static void make_truth(float at_crease)
{
    static float mode[MODES][LIGHTS];
    for (int k = 0; k < MODES; k++)
        for (int i = 0; i < LIGHTS; i++) mode[k][i] = k ? 0.3f * deviate() : 1;
    for (uint32_t c = 0; c < CHANNELS; c++)
        for (uint32_t v = 0; v < VERTICES; v++) {
            const float x = (float)v / VERTICES, own = v == bright ? at_crease
                                                       : v == dark ? 1 / at_crease
                                                                   : 1;
            for (uint32_t i = 0; i < LIGHTS; i++) {
                float sum = 0;
                for (int k = 0; k < MODES; k++) sum += mode[k][i] * cosf(3 * x * (float)k);
                dipole[c][v][i] = sum;
                truth[c][v][i] = 0.8f * own * sum;
            }
        }
    for (int k = 0; k < LIKENESSES; k++)
        for (uint32_t v = 0; v < VERTICES; v++)
            for (uint32_t w = 0; w < VERTICES; w++) {
                const float d = ((float)v - (float)w) / VERTICES;
                like[k][v][w] = expf(-2 * d * d);
            }
}

// Relative RMS error of a vertex after smoothing, where each half has the noise.
static void smooth(float noise, double error[VERTICES], float factor[VERTICES])
{
    static float half[2][CHANNELS][VERTICES][LIGHTS];
    uint32_t n_walk[CHANNELS * VERTICES];
    struct prt_context context = {0};
    struct bake b = {.ctx = &context};
    float *m = NULL;
    double share[2];
    for (uint32_t c = 0; c < CHANNELS; c++)
        for (uint32_t v = 0; v < VERTICES; v++) {
            n_walk[c * VERTICES + v] = 256;
            for (uint32_t i = 0; i < LIGHTS; i++)
                for (int h = 0; h < 2; h++)
                    half[h][c][v][i] = truth[c][v][i] + noise * deviate();
        }
    const struct walk_answers walks = {.n_vertex = VERTICES,
                                       .n_light = LIGHTS,
                                       .n_channel = CHANNELS,
                                       .half = {&half[0][0][0][0], &half[1][0][0][0]},
                                       .n_walk = n_walk};
    assert_int_equal(
        prt_walks_smooth(&b, &like[0][0][0], &dipole[0][0][0], &walks, &m, factor, share),
        PRT_OK);
    for (uint32_t v = 0; v < VERTICES; v++) {
        double off = 0, all = 0;
        for (uint32_t i = 0; i < LIGHTS; i++) {
            double sum = 0;
            for (uint32_t w = 0; w < VERTICES; w++)
                sum += (double)m[v * VERTICES + w] *
                       (double)(half[0][0][w][i] + half[1][0][w][i]) / 2;
            sum = sum * (double)factor[v] - (double)truth[0][v][i];
            off += sum * sum;
            all += (double)truth[0][v][i] * (double)truth[0][v][i];
        }
        error[v] = sqrt(off / all);
    }
    prt_free(m);
}

static double farthest(const float factor[VERTICES])
{
    double most = 0;
    for (uint32_t v = 0; v < VERTICES; v++) most = fmax(most, fabs((double)factor[v] - 1));
    return most;
}

// Law: where the truth varies slowly over the vertices, smoothing leaves less than a third of
// the noise, and no vertex gets a factor (METHODS §9).
static void noise_is_taken_out(void **state)
{
    double error[VERTICES], sum = 0;
    float factor[VERTICES];
    prt_rng_init(&rng, 11, 0);
    make_truth(1);
    smooth(0.2f, error, factor);
    for (uint32_t v = 0; v < VERTICES; v++) sum += error[v] * error[v] / VERTICES;
    // The means of the halves err by 0.17.
    expect_below("error after smoothing", sqrt(sum), 0.055);
    expect_below("a factor's distance from 1", farthest(factor), 0.05);
}

// Law: a vertex that differs from its neighbours by a factor under all lights keeps it, upwards
// and downwards; noise alone gives no other vertex one.
static void a_crease_keeps_its_factor(void **state)
{
    double error[VERTICES], worst = 0;
    float factor[VERTICES];
    prt_rng_init(&rng, 12, 0);
    make_truth(1.3f);
    smooth(0.05f, error, factor);
    assert_true(factor[bright] > 1.1f);
    assert_true(factor[dark] < 1 / 1.1f);
    for (uint32_t v = 0; v < VERTICES; v++) worst = fmax(worst, error[v]);
    expect_below("error of the worst vertex", worst, 0.04);
}

// Law: the likeness of two vertices of a cluster is exp(-d^2 / (2 l^2) - (1 - n . n') / 4),
// with l in diagonals of the cluster's box (METHODS §9).
static void likeness_of_places(void **state)
{
    enum { N = 5, N_MESH = 8, FIRST = 2 };
    static const float length[LIKENESSES] = {0.5f, 0.25f, 1, 0.5f, 0.5f, 0.12f};
    float position[N_MESH][3], normal[N_MESH][3];
    uint32_t order[N_MESH] = {1, 0, 7, 3, 5, 2, 6, 4};
    struct prt_cluster cluster[2] = {{.vertex_begin = 0, .n_vertex = FIRST},
                                     {.vertex_begin = FIRST, .n_vertex = N}};
    struct clusters clusters = {.n_cluster = 2, .cluster = cluster, .order = order};
    struct prt_mesh mesh = {.n_vertex = N_MESH, .position = position, .normal = normal};
    const struct bake b = {.mesh = &mesh, .clusters = &clusters};
    for (int v = 0; v < N_MESH; v++)
        for (int k = 0; k < 3; k++) {
            position[v][k] = (float)((v * 7 + k * 5) % 11) + (float)(v < FIRST) * 100;
            normal[v][k] = (float)(k == v % 3);
        }
    position[6][1] = -20; // the last of the cluster, and the farthest
    float *likeness = prt_walk_likeness(&b, 1);
    assert_non_null(likeness);
    double diagonal2 = 0, worst = 0;
    for (int k = 0; k < 3; k++) {
        float low = INFINITY, high = -INFINITY;
        for (int v = 0; v < N; v++) {
            low = fminf(low, position[order[FIRST + v]][k]);
            high = fmaxf(high, position[order[FIRST + v]][k]);
        }
        diagonal2 += (double)((high - low) * (high - low));
    }
    for (int i = 0; i < LIKENESSES; i++)
        for (int v = 0; v < N; v++)
            for (int w = 0; w < N; w++) {
                const uint32_t p = order[FIRST + v], q = order[FIRST + w];
                double d2 = 0, cosine = 0;
                for (int k = 0; k < 3; k++) {
                    d2 += pow((double)position[p][k] - (double)position[q][k], 2);
                    cosine += (double)(normal[p][k] * normal[q][k]);
                }
                const double l = (double)length[i];
                const double want = exp(-d2 / (2 * l * l * diagonal2) - (1 - cosine) / 4);
                worst = fmax(worst, fabs((double)likeness[(i * N + v) * N + w] - want));
            }
    expect_below("error of a likeness", worst, 9e-8);
    prt_free(likeness);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(noise_is_taken_out),
        cmocka_unit_test(a_crease_keeps_its_factor),
        cmocka_unit_test(likeness_of_places),
    };
    return run_physics_tests(tests, NULL, NULL);
}
