// SPDX-License-Identifier: MIT
// Answers to queries against the command contract: terms, views, planes of exit, media. Above
// 600 lines: short cases, each read alone.
#include "defined_tensors.h"

#include <stdatomic.h>

static int transport_of(struct prt_transport *t, const struct synthetic_options *a,
                        const struct synthetic_options *b)
{
    *t = (struct prt_transport){.cube = 16, .n_tensor = 1};
    static const struct prt_material material = {.name = "x",
                                                 .sigma_s_prime = {1, 1.5f, 2},
                                                 .sigma_a = {0.01f, 0.02f, 0.03f},
                                                 .g = {0.2f, 0, -0.1f},
                                                 .eta = 1.3f,
                                                 .roughness = 0.3f};
    t->media = prt_media_one(&material);
    assert_int_equal(synthetic_mesh(N, true, &t->mesh), 0);
    assert_int_equal(synthetic_tensor(a, &t->tensor[0]), 0);
    if (b) assert_int_equal(synthetic_tensor(b, &t->tensor[t->n_tensor++]), 0);
    return 0;
}

static void finish_transport(struct prt_transport *t)
{
    for (uint32_t i = 0; i < t->n_tensor; i++) synthetic_tensor_finish(&t->tensor[i]);
    synthetic_mesh_finish(&t->mesh);
}

static void some_cube(struct prt_cube *cube)
{
    struct prt_rng rng;
    assert_int_equal(prt_cube_init(cube, 16), 0);
    prt_rng_init(&rng, 5, 5);
    for (int i = 0; i < 6 * 16 * 16 * 3; i++) cube->texel[i] = 1 + prt_rng_f32(&rng);
}

enum { MANY = PRT_RELIGHT_MAX_LIGHTS };

// Nine colours of one kind (a group and one), four of the planes behind them, and others, one
// with another exit.
static void ask_many(struct prt_cube cube[MANY], struct prt_query q[MANY], bool planes[MANY])
{
    static const float eye[3] = {30, 80, 10};
    for (int i = 0; i < MANY; i++) {
        some_cube(&cube[i]);
        for (int k = 0; k < 6 * 16 * 16 * 3; k++) cube[i].texel[k] *= (float)(1 + (k + i) % 3);
        q[i] = (struct prt_query){.light = &cube[i],
                                  .term =
                                      i < 13 ? PRT_ANSWER_TOTAL : (enum prt_answer_term)(i % 3),
                                  .eye = i >= 12 ? eye : NULL,
                                  .exit = i == 14 ? PRT_EXIT_PAPERS : PRT_EXIT_NORMALISED};
        planes[i] = i >= 8 && i < 12;
    }
}

// How far an answer's values may lie from their definition: the bounds of all planes that it
// sums. Spherical harmonics up to l = 3 and Fresnel transmittance are below 1.
static void answer_bound(const struct prt_transport *t, const struct prt_cube *cube,
                         float *bound)
{
    struct prt_light light;
    assert_int_equal(prt_light_from_cube(cube, &light), 0);
    memset(bound, 0, 12 * N);
    for (uint32_t i = 0; i < t->n_tensor; i++) {
        const size_t n = 3ull * N * t->tensor[i].n_phase;
        float *color = malloc(4 * n), *one = malloc(4 * n);
        define(&t->tensor[i], &light, NULL, ~0u, color, one);
        for (size_t k = 0; k < n; k++) bound[k % (3 * N)] += one[k];
        free(color);
        free(one);
    }
    prt_light_finish(&light);
}

static void compare_many(const struct prt_transport *t)
{
    struct prt_context ctx = quiet();
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    bool planes[MANY];
    float *out[MANY], *alone = malloc((size_t)9 * 12 * N), *bound = malloc(12 * N);
    ask_many(cube, q, planes);
    for (int i = 0; i < MANY; i++) out[i] = malloc((size_t)9 * 12 * N);
    assert_int_equal(prt_answer_many(&ctx, t, MANY, q, planes, out, NULL), 0);
    for (int i = 0; i < MANY; i++) {
        unsigned n_plane = 1;
        if (planes[i]) {
            assert_int_equal(prt_answer_planes(&ctx, t, &q[i], &n_plane, alone), 0);
        } else {
            assert_int_equal(prt_answer_colors(&ctx, t, &q[i], (float(*)[3])alone), 0);
        }
        answer_bound(t, &cube[i], bound);
        for (unsigned k = 0; k < n_plane; k++)
            check_values("one of many", out[i] + k * 3 * N, alone + k * 3 * N, bound, 2, 3 * N);
        free(out[i]);
        prt_cube_finish(&cube[i]);
    }
    free(alone);
    free(bound);
}

// Queries that are answered in one pass get the values that each gets alone. Tensors have the
// same clusters or others, opaque vertices among them or not, or are sparse. Where there are
// planes of exit, a sum has terms of one plane and of nine.
static void many_queries_equal_one_by_one(void **state)
{
    struct synthetic_options pairs = kind[6], single = kind[0], exits = kind[1];
    exits.term = PRT_TERM_VIEW;
    exits.n_phase = 9;
    pairs.cube = 16;
    single.term = PRT_TERM_SINGLE; // on the clusters of the multiple one
    struct {
        const struct synthetic_options *a, *b;
        bool opaque;
    } c[] = {{&kind[0], &kind[1], true},
             {&kind[0], &kind[1], false},
             {&kind[0], &single, false},
             {&pairs, &kind[1], false},
             {&pairs, &kind[3], true}};
    for (size_t i = 0; i < sizeof c / sizeof *c; i++) {
        struct prt_transport t;
        transport_of(&t, c[i].a, c[i].b);
        for (uint32_t k = 0; k < t.mesh.n_surface && !c[i].opaque; k++)
            t.mesh.surface[k].translucent = true;
        compare_many(&t);
        assert_int_equal(synthetic_tensor(&exits, &t.tensor[t.n_tensor++]), 0);
        compare_many(&t);
        finish_transport(&t);
    }
}

// Only planes are kept apart: colours are what they are without most_apart, alone and of many.
static void colours_are_never_apart(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    const float eye[3] = {30, 80, 10};
    float *want = malloc(12 * N), *got = malloc(12 * N);
    const bool planes = false;
    transport_of(&t, &kind[0], &kind[1]);
    some_cube(&cube);
    struct prt_query q = {.light = &cube, .term = PRT_ANSWER_TOTAL, .eye = eye};
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])want), 0);
    q.most_apart = 10;
    q.exits = true;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])got), 0);
    assert_memory_equal(got, want, 12 * N);
    assert_int_equal(prt_answer_many(&ctx, &t, 1, &q, &planes, &got, NULL), 0);
    assert_memory_equal(got, want, 12 * N);
    prt_cube_finish(&cube);
    finish_transport(&t);
    free(want);
    free(got);
}

// What a sink was given: colours, and how often each vertex came.
struct taken {
    float color[MANY][N][3];
    atomic_int times[MANY][N];
};

static void take_colors(void *user, const struct prt_context *ctx, unsigned i, size_t begin,
                        size_t end, const float (*color)[3])
{
    struct taken *to = user;
    memcpy(to->color[i][begin], color, (end - begin) * sizeof *color);
    for (size_t v = begin; v < end; v++) to->times[i][v]++;
}

// A sink gets every colour of the queries that it takes once, bit for bit as it is without a
// sink; other queries' colours stay where they were asked for.
static void a_sink_takes_each_colour_once(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    bool planes[MANY], takes[MANY];
    float *out[MANY], *want[MANY];
    struct taken *taken = calloc(1, sizeof *taken);
    const struct prt_colors_sink sink = {takes, take_colors, taken};
    transport_of(&t, &kind[0], &kind[1]);
    ask_many(cube, q, planes);
    for (int i = 0; i < MANY; i++) {
        out[i] = malloc((size_t)9 * 12 * N);
        want[i] = malloc((size_t)9 * 12 * N);
        takes[i] = !planes[i] && i % 3 < 2;
    }
    assert_int_equal(prt_answer_many(&ctx, &t, MANY, q, planes, want, NULL), 0);
    assert_int_equal(prt_answer_many(&ctx, &t, MANY, q, planes, out, &sink), 0);
    for (int i = 0; i < MANY; i++) {
        assert_memory_equal(takes[i] ? taken->color[i][0] : out[i], want[i], 12 * N);
        for (int v = 0; v < N; v++) assert_int_equal(taken->times[i][v], takes[i]);
        free(out[i]);
        free(want[i]);
        prt_cube_finish(&cube[i]);
    }
    free(taken);
    finish_transport(&t);
}

static void plan_coefficients(const struct prt_transport *t, const struct prt_query *q,
                              struct prt_coefficients *out)
{
    struct prt_context ctx = quiet();
    *out = (struct prt_coefficients){.phases = true};
    if (prt_coefficients_plan(&ctx, t, q, out)) fail_msg("%s", last_line);
    out->half = prt_alloc(out->n_half, 2);
    memset(out->half, 0xff, 2 * out->n_half);
}

// Triple i of the packed format by its definition (prt/relight.h).
static void unpack(const uint32_t *word, size_t i, float rgb[3])
{
    const int exponent = (int)(word[i & ~1ul] >> 30) + 4 * (int)(word[i | 1] >> 30);
    for (int c = 0; c < 3; c++) {
        const int bits = (int)(word[i] >> 10 * c) % 1024;
        rgb[c] = ldexpf((float)((bits & 1023) > 511 ? (bits & 1023) - 1024 : bits & 1023),
                        exponent - 9);
    }
}

// Triples are packed by two: a layer of an odd number has room for one more (prt/relight.h).
static void layers_hold_their_triples(const struct prt_transport *t, const struct prt_query *q)
{
    struct prt_context ctx = quiet();
    unsigned odd_at_the_end = 0;
    for (uint32_t most = 1; most < 9; most++) {
        struct prt_coefficients c = {.phases = true, .packed = true, .most_rank = most};
        assert_int_equal(prt_coefficients_plan(&ctx, t, q, &c), PRT_OK);
        for (uint32_t l = 0; l < c.n_layer; l++) {
            const size_t n = (size_t)c.layer[l].n_row * c.layer[l].n_plane;
            const size_t end = c.layer[l].begin + 2 * (n + n % 2);
            const bool last = l + 1 == c.n_layer;
            assert_true(last ? c.n_half == end : c.layer[l + 1].begin >= end);
            odd_at_the_end += last && n % 2;
        }
    }
    assert_true(odd_at_the_end > 0);
}

// Packed coefficients differ from halves by at most half a step, a step being 2^-8 to 2^-9 of
// the largest of two triples; where that one would round to 512 by a whole one.
static void packed_coefficients_are_near(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    struct prt_coefficients half, packed, *one = &half, *two = &packed;
    bool planes[MANY];
    struct synthetic_options single = kind[0];
    single.term = PRT_TERM_SINGLE;
    transport_of(&t, &kind[0], &single);
    for (uint32_t k = 0; k < t.mesh.n_surface; k++) t.mesh.surface[k].translucent = true;
    ask_many(cube, q, planes);
    q[0].eye = NULL;
    q[0].term = PRT_ANSWER_TOTAL;
    plan_coefficients(&t, &q[0], &half);
    packed = (struct prt_coefficients){.phases = true, .packed = true};
    assert_int_equal(prt_coefficients_plan(&ctx, &t, &q[0], &packed), PRT_OK);
    packed.half = prt_alloc(packed.n_half, 2);
    assert_int_equal(prt_answer_coefficients(&ctx, &t, 1, q, &one), PRT_OK);
    assert_int_equal(prt_answer_coefficients(&ctx, &t, 1, q, &two), PRT_OK);
    assert_int_equal(half.n_layer, packed.n_layer);
    size_t n = 0, coarse = 0;
    for (uint32_t l = 0; l < half.n_layer; l++) {
        const struct prt_coefficient_layer *a = &half.layer[l], *b = &packed.layer[l];
        const uint32_t *from = (const uint32_t *)(const void *)(packed.half + b->begin);
        assert_int_equal(a->n_row, b->n_row);
        assert_float_equal(a->scale, b->scale, 0);
        for (size_t i = 0; i < (size_t)a->n_row * a->n_plane; i++, n++) {
            const size_t all = (size_t)a->n_row * a->n_plane, pair = i & ~(size_t)1;
            const uint16_t *number = half.half + a->begin;
            float got[3], most = 0;
            unpack(from, i, got);
            for (size_t k = 3 * pair; k < 3 * pair + 6 && k < 3 * all; k++)
                most = fmaxf(most, fabsf(prt_f16_to_f32(number[k])));
            for (size_t c = 0; c < 3; c++) {
                const float off = fabsf(got[c] - prt_f16_to_f32(number[3 * i + c]));
                assert_true(off <= most * 0x1p-9f + 0x1p-10f);
                coarse += off > most * 0x1p-11f;
            }
        }
    }
    assert_true(n > 100 && coarse > n / 4); // it is rounded to as few bits as it says
    layers_hold_their_triples(&t, &q[0]);
    prt_free(half.half);
    prt_free(packed.half);
    for (int i = 0; i < MANY; i++) prt_cube_finish(&cube[i]);
    finish_transport(&t);
}

// Coefficients for as many lights as a pass takes are those for each light alone; none and one
// more are refused.
static void coefficients_for_many_lights(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    struct prt_coefficients many[MANY], alone, *out[MANY], *one[] = {&alone};
    bool planes[MANY];
    struct synthetic_options single = kind[0];
    single.term = PRT_TERM_SINGLE;
    transport_of(&t, &kind[0], &single);
    for (uint32_t k = 0; k < t.mesh.n_surface; k++) t.mesh.surface[k].translucent = true;
    ask_many(cube, q, planes);
    for (int i = 0; i < MANY; i++) {
        q[i].eye = NULL;
        q[i].term = PRT_ANSWER_TOTAL;
        plan_coefficients(&t, &q[i], out[i] = &many[i]);
    }
    if (prt_answer_coefficients(&ctx, &t, MANY, q, out)) fail_msg("%s", last_line);
    for (int i = 0; i < MANY; i++) {
        plan_coefficients(&t, &q[i], &alone);
        assert_int_equal(prt_answer_coefficients(&ctx, &t, 1, &q[i], one), PRT_OK);
        assert_int_equal(alone.n_half, many[i].n_half);
        float most = 0, off = 0;
        for (size_t k = 0; k < alone.n_half; k++) {
            const float a = prt_f16_to_f32(alone.half[k]), b = prt_f16_to_f32(many[i].half[k]);
            most = fmaxf(most, fabsf(a));
            off = fmaxf(off, fabsf(a - b));
        }
        assert_true(most > 0 && off < 2e-3f * most);
        for (uint32_t k = 0; k < alone.n_layer; k++)
            assert_float_equal(alone.layer[k].scale, many[i].layer[k].scale, 0);
        prt_free(alone.half);
    }
    assert_int_equal(prt_answer_coefficients(&ctx, &t, 0, q, out), PRT_ARG);
    assert_int_equal(prt_answer_coefficients(&ctx, &t, MANY + 1, q, out), PRT_ARG);
    for (int i = 0; i < MANY; i++) {
        prt_free(many[i].half);
        prt_cube_finish(&cube[i]);
    }
    finish_transport(&t);
}

// Colours from the first rows of each cluster are those of a transport without the others, bit
// for bit, alone and beside queries for all rows. An odd number of rows is one more.
static void fewer_rows_are_a_smaller_transport(void **state)
{
    static const uint32_t ranks[] = {2, 6, 8, 1000};
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    float *cut = malloc(12 * N), *whole = malloc(12 * N), *few = malloc(12 * N);
    float *out[MANY];
    some_cube(&cube);
    for (int i = 0; i < MANY; i++) out[i] = malloc(12 * N);
    for (size_t k = 0; k < sizeof ranks / sizeof *ranks; k++) {
        struct prt_query q[MANY];
        const bool planes[MANY] = {false};
        transport_of(&t, &kind[0], &kind[1]);
        for (uint32_t i = 0; i < t.mesh.n_surface; i++) t.mesh.surface[i].translucent = true;
        for (int i = 0; i < MANY; i++)
            q[i] = (struct prt_query){.light = &cube,
                                      .term = PRT_ANSWER_TOTAL,
                                      .most_rank = i % 2 ? ranks[k] - (k == 2) : 0};
        assert_int_equal(prt_answer_colors(&ctx, &t, &q[0], (float(*)[3])whole), 0);
        assert_int_equal(prt_answer_colors(&ctx, &t, &q[1], (float(*)[3])few), 0);
        assert_int_equal(prt_answer_many(&ctx, &t, MANY, q, planes, out, NULL), 0);
        double off = difference(few, whole, 3 * N);
        if (ranks[k] == 1000) assert_memory_equal(few, whole, 12 * N);
        else assert_true(off > 1e-3);
        for (int i = 0; i < MANY; i++)
            assert_true(difference(out[i], i % 2 ? few : whole, 3 * N) < 1e-4);
        for (uint32_t i = 0; i < t.n_tensor; i++)
            for (uint32_t c = 0; c < t.tensor[i].n_cluster; c++) {
                struct prt_cluster *own = (struct prt_cluster *)&t.tensor[i].cluster[c];
                if (own->rank > ranks[k]) own->rank = ranks[k];
            }
        assert_int_equal(prt_answer_colors(&ctx, &t, &q[0], (float(*)[3])cut), 0);
        assert_memory_equal(few, cut, 12 * N);
        finish_transport(&t);
    }
    prt_cube_finish(&cube);
    for (int i = 0; i < MANY; i++) free(out[i]);
    free(cut);
    free(whole);
    free(few);
}

static void wrong_queries_are_refused(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube[MANY];
    struct prt_query q[MANY];
    bool planes[MANY];
    float *out[MANY] = {NULL};
    transport_of(&t, &kind[0], &kind[1]);
    ask_many(cube, q, planes);
    q[0].light = NULL;
    assert_int_equal(prt_answer_many(&ctx, &t, 0, q, planes, out, NULL), PRT_ARG);
    assert_int_equal(prt_answer_many(&ctx, &t, MANY + 1, q, planes, out, NULL), PRT_ARG);
    assert_int_equal(prt_answer_many(&ctx, &t, MANY, q, planes, out, NULL), PRT_ARG);
    for (int i = 0; i < MANY; i++) prt_cube_finish(&cube[i]);
    finish_transport(&t);
}

// Planes of single scattering [4][N][3] as they are for a view: times the exit's divisor,
// corrected, with plane 0 of multiple scattering added (METHODS §1, exit; §3.6).
static void toward_a_view(const struct prt_transport *t, const float *multiple, double divisor,
                          float *planes)
{
    struct prt_context ctx = quiet();
    for (int i = 0; i < 3 * N; i++) planes[i] *= 0.28209479f;
    for (int i = 0; i < 4 * 3 * N; i++) planes[i] *= (float)divisor;
    assert_int_equal(prt_view_correct(&ctx, t->mesh.n_vertex, 0, t->mesh.n_vertex,
                                      (const float(*)[3])t->mesh.normal,
                                      (double)t->media.medium->eta, 4, 4, planes),
                     0);
    for (int i = 0; i < 3 * N; i++) planes[i] += multiple[i];
}

// Planes of exit are added to the corrected planes of an answer with a view, on translucent
// vertices, and answers without one are as before (METHODS §3.6).
static void planes_of_exit_are_added(void **state)
{
    struct prt_context ctx = quiet();
    struct prt_transport t;
    struct prt_cube cube;
    struct synthetic_options view = kind[1];
    const float eye[3] = {30, 80, 10};
    struct prt_query q = {.light = &cube, .term = PRT_ANSWER_TOTAL};
    float *flat = malloc(12 * N), *again = malloc(12 * N), *own = malloc(9 * 12 * N);
    float *before = calloc(9 * 3 * N, 4), *after = malloc(9 * 12 * N);
    unsigned n_plane;
    some_cube(&cube);
    transport_of(&t, &kind[0], &kind[1]);
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])flat), 0);
    q.eye = eye;
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, before), 0);
    assert_int_equal(n_plane, 4);
    view.n_phase = 9;
    view.term = PRT_TERM_VIEW;
    view.seed = 41;
    assert_int_equal(synthetic_tensor(&view, &t.tensor[t.n_tensor++]), 0);
    assert_int_equal(prt_answer_planes(&ctx, &t, &q, &n_plane, after), 0);
    assert_int_equal(n_plane, 9);
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    assert_int_equal(prt_light_from_cube(&cube, &light), 0);
    assert_int_equal(prt_relight(&ctx, &t.tensor[2], 1, lights, NULL, false, own), 0);
    for (int k = 0; k < 9; k++)
        for (int i = 0; i < 3 * N; i++) {
            const bool opaque = i / 3 >= N - N / 4;
            const double gain = 0.938868 * (k ? 1 : 0.28209479),
                         base = (double)before[k * 3 * N + i];
            const double want = base + (opaque ? 0 : gain * (double)own[k * 3 * N + i]);
            assert_true(fabs((double)after[k * 3 * N + i] - want) < 1e-3 * (1 + fabs(want)));
        }
    q.eye = NULL;
    assert_int_equal(prt_answer_colors(&ctx, &t, &q, (float(*)[3])again), 0);
    assert_memory_equal(again, flat, 12 * N);
    prt_light_finish(&light);
    prt_cube_finish(&cube);
    finish_transport(&t);
    free(flat), free(again), free(own), free(before), free(after);
}

// Factors of single scattering's planes make sigma_s times the phase function of any two
// directions, by the addition theorem; planes of exit have sigma_s alone. sigma_s is sigma_s' /
// (1 - g).
static void factors_make_the_phase_function(void **state)
{
    const struct prt_material m = {.sigma_s_prime = {1, 2, 0.5f}, .g = {0.6f, 0, -0.3f}};
    const struct prt_tensor single = {.term = PRT_TERM_SINGLE, .n_phase = 16};
    const struct prt_tensor exits = {.term = PRT_TERM_VIEW, .n_phase = 16};
    const float w[2][3] = {{0.48f, 0.6f, 0.64f}, {-0.8f, 0.36f, 0.48f}};
    double sum[3] = {0}, cosine = 0;
    float y[2][16];
    for (int i = 0; i < 2; i++) prt_sh_eval(4, w[i], y[i]);
    for (int k = 0; k < 3; k++) cosine += (double)w[0][k] * (double)w[1][k];
    for (unsigned k = 0; k < 16; k++) {
        float factor[3], plain[3];
        prt_phase_plane_factor(&m, &single, k, factor);
        prt_phase_plane_factor(&m, &exits, k, plain);
        for (int c = 0; c < 3; c++) {
            sum[c] += (double)(factor[c] * y[0][k] * y[1][k]);
            assert_float_equal(plain[c], m.sigma_s_prime[c] / (1 - m.g[c]), 1e-6);
        }
    }
    for (int c = 0; c < 3; c++) {
        struct prt_phase phase;
        assert_int_equal(prt_phase_hg(&phase, (double)m.g[c], 16), 0);
        assert_float_equal(sum[c],
                           prt_phase_eval(&phase, cosine) * (double)m.sigma_s_prime[c] /
                               (1 - (double)m.g[c]),
                           1e-6);
    }
}

// A half-space lit from one direction: single scattering along the path to the eye is (1 +
// 1/mu_i') / (1 + mu_o'/mu_i') times that along -n_o (METHODS §8). mu_i' is not known to the
// correction.
static void half_space_seen_from_the_side(void **state)
{
    struct prt_context ctx = quiet();
    for (int e = 0; e < 2; e++) {
        const double eta = e ? 1.5 : 1.3, low = sqrt(1 - 1 / (eta * eta));
        float normal[1][3] = {{0.6f, 0, 0.8f}};
        for (int i = 0; i <= 8; i++) {
            double mu_o = low + (1 - low) * i / 8, sine = sqrt(1 - mu_o * mu_o);
            // two azimuths about the normal
            for (int side = -1; side <= 1; side += 2) {
                const float w[3] = {(float)(0.6 * mu_o + side * 0.8 * sine), 0,
                                    (float)(0.8 * mu_o - side * 0.6 * sine)};
                float planes[4][3] = {{1, 1, 1}}, y[4];
                assert_int_equal(prt_view_correct(&ctx, 1, 0, 1, (const float(*)[3])normal, eta,
                                                  1, 4, planes[0]),
                                 0);
                prt_sh_eval(2, w, y);
                double got = (double)planes[0][0];
                for (int k = 1; k < 4; k++) got += (double)(y[k] * planes[k][0]);
                // light at 0, 45 and 90 degrees
                for (int l = 0; l < 3; l++) {
                    double outside = l == 1 ? sqrt(0.5) : l == 2 ? 0 : 1;
                    double mu_i = sqrt(1 - (1 - outside * outside) / (eta * eta));
                    double want = (1 + 1 / mu_i) / (1 + mu_o / mu_i);
                    assert_true(fabs(got / want - 1) < 0.04);
                    if (i == 8) assert_true(fabs(got - 1) < 1e-5);
                }
                double mean = eta < 1.4 ? 0.826 : 0.874; // mu_i' of even light
                double even = (1 + 1 / mean) / (1 + mu_o / mean);
                assert_true(fabs(got / even - 1) < 0.012);
            }
        }
    }
}

// A wavelet transport with made-up tensors under a light, and the answers by their definition.
struct defined_answers {
    struct prt_context ctx;
    struct prt_transport t;
    struct prt_cube cube;
    struct prt_query q;
    double divisor;        // T of METHODS §9, or 1 as in the papers
    float *multiple, *own; // [N][3], [4][N][3]: what the tensors give
    float *answer;         // [4][N][3]: room for answers
};

static void answers_begin(struct defined_answers *a, bool papers)
{
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    *a = (struct defined_answers){.ctx = quiet(),
                                  .divisor = papers ? 1 : 0.938868,
                                  .multiple = malloc(12 * N),
                                  .own = malloc(4 * 12 * N),
                                  .answer = malloc(4 * 12 * N)};
    a->q = (struct prt_query){.light = &a->cube,
                              .exit = papers ? PRT_EXIT_PAPERS : PRT_EXIT_NORMALISED};
    transport_of(&a->t, &kind[0], &kind[1]);
    some_cube(&a->cube);
    assert_int_equal(prt_light_from_cube(&a->cube, &light), 0);
    assert_int_equal(prt_relight(&a->ctx, &a->t.tensor[0], 1, lights, NULL, false, a->multiple),
                     0);
    assert_int_equal(prt_relight(&a->ctx, &a->t.tensor[1], 1, lights, NULL, false, a->own), 0);
    prt_light_finish(&light);
}

static void answers_end(struct defined_answers *a)
{
    prt_cube_finish(&a->cube);
    finish_transport(&a->t);
    free(a->multiple);
    free(a->own);
    free(a->answer);
}

static int colors_of(struct defined_answers *a)
{
    return prt_answer_colors(&a->ctx, &a->t, &a->q, (float(*)[3])a->answer);
}

// Without an eye. The last quarter is opaque: nothing scatters in it, whatever the tensor says.
static void check_terms(struct defined_answers *a)
{
    const float y00 = 0.28209479f, *multiple = a->multiple, *got = a->answer;
    float *own = a->own;
    unsigned n_bright = 0;
    a->q.term = PRT_ANSWER_MULTIPLE;
    assert_int_equal(colors_of(a), 0);
    for (int i = 0; i < 3 * N; i++) assert_float_equal(got[i], fmaxf(0, multiple[i]), 1e-4);
    a->q.term = PRT_ANSWER_SINGLE;
    assert_int_equal(colors_of(a), 0);
    for (int i = 3 * (N - N / 4); i < 3 * N; i++)
        for (int k = 0; k < 4; k++) own[k * 3 * N + i] = 0;
    for (int i = 0; i < 3 * N; i++) assert_float_equal(got[i], fmaxf(0, y00 * own[i]), 1e-4);
    a->q.term = PRT_ANSWER_TOTAL;
    assert_int_equal(colors_of(a), 0);
    for (int i = 0; i < 3 * N; i++) {
        // never Fresnel on opaque surfaces
        bool opaque = i / 3 >= N - N / 4;
        double mean = opaque ? 1 : 0.938868, share = opaque ? 1 : a->divisor;
        double want = fmax(0, mean * ((double)multiple[i] / share + (double)(y00 * own[i])));
        assert_true(fabs((double)got[i] - want) < 1e-4 * (1 + want));
        n_bright += got[i] > 0;
    }
    assert_true(n_bright > N / 2);
}

// The cosine at vertex v towards the eye, and the harmonics of that direction bent to the
// normal: same azimuth, sine / eta.
static float bent_harmonics(const struct prt_mesh *mesh, int v, const float eye[3], float y[4])
{
    const float *p = mesh->position[v], *n = mesh->normal[v];
    float w[3] = {eye[0] - p[0], eye[1] - p[1], eye[2] - p[2]}, inside[3], tangent[3];
    float length = sqrtf(w[0] * w[0] + w[1] * w[1] + w[2] * w[2]), cosine = 0, l = 0;
    for (int i = 0; i < 3; i++) cosine += (w[i] /= length) * n[i];
    float sine = sqrtf(fmaxf(0, 1 - cosine * cosine)) / 1.3f;
    for (int i = 0; i < 3; i++) tangent[i] = w[i] - cosine * n[i];
    for (int i = 0; i < 3; i++) l += tangent[i] * tangent[i];
    l = sqrtf(l);
    for (int i = 0; i < 3; i++)
        inside[i] = sqrtf(1 - sine * sine) * n[i] + (l > 0 ? tangent[i] / l * sine : 0);
    prt_sh_eval(2, inside, y);
    return cosine;
}

// Towards an eye: planes that are corrected for the view, times Fresnel's transmittance.
static void check_view(struct defined_answers *a, const float eye[3])
{
    const float *own = a->own, *got = a->answer;
    unsigned n_plane;
    a->q.eye = eye;
    toward_a_view(&a->t, a->multiple, a->divisor, a->own);
    assert_int_equal(colors_of(a), 0);
    for (int v = 0; v < N; v++) {
        float y[4], cosine = bent_harmonics(&a->t.mesh, v, eye, y);
        bool opaque = v >= N - N / 4;
        double ft = cosine > 0 ? prt_fresnel_transmittance((double)1.3f, (double)cosine) : 0;
        for (int at = 3 * v; at < 3 * v + 3; at++) {
            double sum = (double)own[at];
            for (int k = 1; k < (opaque ? 1 : 4); k++)
                sum += (double)y[k] * (double)own[k * 3 * N + at];
            double want = fmax(0, sum * (opaque ? 1 : ft / a->divisor));
            if (cosine <= 0 && !opaque) assert_true(got[at] == 0); // it faces away
            else assert_true(fabs((double)got[at] - want) < 2e-4 * (1 + fabs(sum)));
        }
    }
    assert_int_equal(prt_answer_planes(&a->ctx, &a->t, &a->q, &n_plane, NULL), 0);
    assert_int_equal(n_plane, 4);
    assert_int_equal(prt_answer_planes(&a->ctx, &a->t, &a->q, &n_plane, a->answer), 0);
    for (int i = 0; i < 4 * 3 * N; i++) assert_true(fabsf(got[i] - own[i]) < 1e-3f);
}

// What does not fit together is refused.
static void check_refusals(struct defined_answers *a)
{
    float eye[3] = {30, NAN, 10};
    a->q.media = a->t.media;
    assert_int_equal(colors_of(a), PRT_MISMATCH);
    a->q.media.n = 0;
    a->cube.n = 8;
    assert_int_equal(colors_of(a), PRT_MISMATCH);
    a->cube.n = 16;
    a->q.light = NULL;
    assert_int_equal(colors_of(a), PRT_ARG);
    a->q.light = &a->cube;
    a->q.eye = eye;
    assert_int_equal(colors_of(a), PRT_ARG);
}

// total = F_t(eta, w_o) [multiple/T + sum_k Y_k(w_o') plane_k], clamped; W05 section 5 and
// METHODS §1 (exit). The planes of single scattering are corrected for the view.
static void check_answers(bool papers)
{
    static const float eye[3] = {30, 80, 10};
    struct defined_answers a;
    answers_begin(&a, papers);
    check_terms(&a);
    check_view(&a, eye);
    check_refusals(&a);
    answers_end(&a);
}

static void answers_follow_the_command_contract(void **state)
{
    check_answers(false);
    check_answers(true);
}

static void give_basis(struct prt_tensor *t, const struct prt_radial *radial)
{
    size_t n = (size_t)radial->n_grid * radial->n_function;
    float *knot = prt_alloc(radial->n_grid, 4), *basis = prt_alloc(n, 4);
    memcpy(knot, radial->r, 4ull * radial->n_grid);
    memcpy(basis, radial->value, 4 * n);
    t->n_knot = radial->n_grid;
    t->basis_kind = (uint32_t)radial->kind;
    t->knot = knot;
    t->basis = basis;
}

// A joint transport with made-up tensors and the bases of its file, under a light.
struct free_transport {
    struct prt_context ctx;
    struct prt_transport t;
    struct prt_cube cube;
    struct prt_radial *radial[2];
    struct prt_material m;
    struct prt_query q;    // of m under the light
    float *planes, *again; // [4][N][3]: the answer to q, and room for another
};

static void free_begin(struct free_transport *f)
{
    *f = (struct free_transport){.ctx = quiet(),
                                 .m = {.name = "y",
                                       .sigma_s_prime = {0.8f, 1, 3},
                                       .sigma_a = {0.02f, 0.05f, 0.1f},
                                       .g = {0.3f, 0, -0.2f},
                                       .eta = 1.3f,
                                       .roughness = 0.3f},
                                 .planes = malloc(4 * 12 * N),
                                 .again = malloc(4 * 12 * N)};
    transport_of(&f->t, &kind[4], &kind[5]);
    f->t.engine = PRT_TRANSPORT_JOINT;
    for (int k = 0; k < 2; k++) {
        struct prt_radial_options o = {.kind = PRT_RADIAL_REDUCED,
                                       .family = (enum prt_radial_family)k,
                                       .eta = 1.3,
                                       .n_function = k ? 11 : 12};
        assert_int_equal(prt_radial_create(&f->ctx, &o, &f->radial[k]), 0);
        give_basis(&f->t.tensor[k], f->radial[k]);
    }
    some_cube(&f->cube);
    f->q = (struct prt_query){
        .term = PRT_ANSWER_TOTAL, .light = &f->cube, .media = prt_media_one(&f->m)};
}

static void free_end(struct free_transport *f)
{
    prt_cube_finish(&f->cube);
    finish_transport(&f->t);
    for (int k = 0; k < 2; k++) prt_radial_destroy(f->radial[k]);
    free(f->planes);
    free(f->again);
}

static int planes_of(struct free_transport *f, const struct prt_transport *t,
                     const struct prt_query *q, float *out)
{
    unsigned n_plane;
    int status = prt_answer_planes(&f->ctx, t, q, &n_plane, out);
    if (!status) assert_int_equal(n_plane, 4);
    return status;
}

// The planes by their definition, in the outward convention: a_0 = 1, a_1 = -g. bound: what a
// kernel may err by.
static void define_planes(struct free_transport *f, float *multiple, float *bound,
                          float *wanted, float *own_bound)
{
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    float coef[2][36], *own = malloc(4 * 12 * N);
    double error;
    assert_int_equal(prt_light_from_cube(&f->cube, &light), 0);
    for (int k = 0; k < 2; k++)
        assert_int_equal(prt_radial_fit_material(f->radial[k], &f->m, coef[k], &error), 0);
    define(&f->t.tensor[0], &light, coef[0], ~0u, multiple, bound);
    define(&f->t.tensor[1], &light, coef[1], ~0u, own, own_bound);
    assert_int_equal(prt_relight(&f->ctx, &f->t.tensor[0], 1, lights, coef[0], false, multiple),
                     0);
    assert_int_equal(prt_relight(&f->ctx, &f->t.tensor[1], 1, lights, coef[1], false, own), 0);
    for (int i = 0; i < 3 * N; i++)
        for (int k = 0; k < 4; k++) {
            int ch = i % 3;
            double a = i >= 3 * (N - N / 4) ? 0 : k ? -(double)f->m.g[ch] : 1;
            double sigma_s = (double)f->m.sigma_s_prime[ch] / (1 - (double)f->m.g[ch]);
            wanted[k * 3 * N + i] = (float)(a * sigma_s * (double)own[k * 3 * N + i]);
            own_bound[k * 3 * N + i] *= (float)(fabs(a) * sigma_s);
        }
    toward_a_view(&f->t, multiple, 0.938868, wanted);
    prt_light_finish(&light);
    free(own);
}

// Joint and polynomial transport: coefficients from the radial basis in the file, sigma_s and
// the phase function's a_l at run time.
static void free_materials_follow_the_basis(void **state)
{
    struct free_transport f;
    float *multiple = malloc(12 * N), *bound = malloc(12 * N);
    float *wanted = malloc(4 * 12 * N), *own_bound = malloc(4 * 12 * N);
    free_begin(&f);
    define_planes(&f, multiple, bound, wanted, own_bound);
    assert_int_equal(planes_of(&f, &f.t, &f.q, f.planes), 0);
    for (int i = 0; i < 3 * N; i++)
        for (int k = 0; k < 4; k++) {
            // the correction mixes the four planes; its factors are below 3 with Y_1's constant
            double most = k ? 0 : (double)bound[i];
            for (int l = 0; l < 4; l++) most += 3 * (double)own_bound[l * 3 * N + i];
            const double want = (double)wanted[k * 3 * N + i];
            const double off = fabs(want - (double)f.planes[k * 3 * N + i]);
            if (!(off <= 2 * most))
                fail_msg("plane %d, value %d: %g, expected %g, %g allowed", k, i,
                         (double)f.planes[k * 3 * N + i], want, 2 * most);
        }
    // the bake's own material when none is given; the same answer the second time
    f.q.media.n = 0;
    assert_int_equal(planes_of(&f, &f.t, &f.q, f.again), 0);
    assert_true(difference(f.again, f.planes, 12 * N) > 1e-3);
    f.q.media = prt_media_one(&f.m);
    assert_int_equal(planes_of(&f, &f.t, &f.q, f.again), 0);
    assert_memory_equal(f.again, f.planes, 4 * 12 * N);
    f.m.eta = 1.5f;
    assert_int_equal(planes_of(&f, &f.t, &f.q, f.again), PRT_MISMATCH);
    free_end(&f);
    free(multiple);
    free(bound);
    free(wanted);
    free(own_bound);
}

// Light contracted once gives the same bits, whichever material comes; of another transport it
// is refused.
static void contracted_light_serves_any_material(void **state)
{
    struct free_transport f;
    struct prt_contracted_light *lit, *other;
    free_begin(&f);
    struct prt_transport elsewhere = f.t;
    float *second = malloc(4 * 12 * N);
    assert_int_equal(planes_of(&f, &f.t, &f.q, f.planes), 0);
    assert_int_equal(prt_contracted_light_create(&f.ctx, &f.t, &f.cube, &lit), 0);
    assert_int_equal(prt_contracted_light_create(&f.ctx, &elsewhere, &f.cube, &other), 0);
    assert_true(prt_contracted_light_bytes(lit) > 0);
    struct prt_query q = f.q;
    q.light = NULL;
    q.lit = lit;
    memset(f.again, 0xff, 4 * 12 * N);
    assert_int_equal(planes_of(&f, &f.t, &q, f.again), 0);
    assert_memory_equal(f.again, f.planes, 4 * 12 * N);
    const struct prt_query both[2] = {q, f.q};
    const bool as_planes[2] = {true, true};
    float *pair[2] = {f.again, second};
    assert_int_equal(prt_answer_many(&f.ctx, &f.t, 2, both, as_planes, pair, NULL), 0);
    assert_memory_equal(f.again, f.planes, 4 * 12 * N);
    assert_memory_equal(second, f.planes, 4 * 12 * N);
    q.lit = other;
    assert_int_equal(planes_of(&f, &f.t, &q, f.again), PRT_ARG);
    q.lit = NULL;
    assert_int_equal(planes_of(&f, &f.t, &q, f.again), PRT_ARG);
    prt_contracted_light_destroy(lit);
    prt_contracted_light_destroy(other);
    free(second);
    free_end(&f);
}

// A material contracted once serves any light, within PRT_FIXED_ERROR; it takes no other.
static void a_contracted_material_serves_any_light(void **state)
{
    struct free_transport f;
    struct prt_contracted_transport *fixed, *twice;
    free_begin(&f);
    assert_int_equal(planes_of(&f, &f.t, &f.q, f.planes), 0);
    assert_int_equal(prt_contracted_transport_create(&f.ctx, &f.t, &f.q.media, &fixed), 0);
    assert_true(prt_contracted_transport_bytes(fixed) > 0);
    const struct prt_transport *t = prt_contracted_transport_get(fixed);
    const struct prt_query lit_only = {.term = PRT_ANSWER_TOTAL, .light = &f.cube};
    assert_int_equal(planes_of(&f, t, &lit_only, f.again), 0);
    double off = difference(f.again, f.planes, 4 * 3 * N);
    assert_true(off > 0 && off < 2 * PRT_FIXED_ERROR);
    assert_int_equal(planes_of(&f, t, &f.q, f.again), PRT_MISMATCH);
    assert_int_equal(prt_contracted_transport_create(&f.ctx, t, &f.q.media, &twice),
                     PRT_MISMATCH);
    prt_contracted_transport_destroy(fixed);
    free_end(&f);
}

// Contract of prt_answer_planes: coefficients that are kept from earlier answers are those of
// this material in this basis, whatever was asked before.
static void kept_coefficients_are_of_their_material_and_basis(void **state)
{
    struct prt_context ctx = quiet();
    const struct prt_material material[2] = {{.sigma_s_prime = {0.8f, 1, 3},
                                              .sigma_a = {0.02f, 0.05f, 0.1f},
                                              .eta = 1.3f,
                                              .roughness = 0.3f},
                                             {.sigma_s_prime = {2, 0.5f, 1},
                                              .sigma_a = {0.1f, 0.01f, 0.3f},
                                              .eta = 1.3f,
                                              .roughness = 0.3f}};
    struct prt_transport t[2];
    struct prt_radial *radial[2];
    struct prt_cube cube;
    struct prt_light light;
    const struct prt_light *lights[1] = {&light};
    float *want = malloc(12 * N), *got = malloc(12 * N);
    some_cube(&cube);
    assert_int_equal(prt_light_from_cube(&cube, &light), 0);
    for (int b = 0; b < 2; b++) {
        const struct prt_radial_options o = {
            .eta = 1.3, .n_function = 12, .radius_mm = b ? 20 : 60};
        assert_int_equal(prt_radial_create(&ctx, &o, &radial[b]), 0);
        transport_of(&t[b], &kind[4], &kind[5]);
        t[b].engine = PRT_TRANSPORT_JOINT;
        give_basis(&t[b].tensor[0], radial[b]);
    }
    for (int i = 0; i < 8; i++) { // each of the four twice
        const int b = i & 1, m = i >> 1 & 1;
        const struct prt_query q = {
            .term = PRT_ANSWER_MULTIPLE, .light = &cube, .media = prt_media_one(&material[m])};
        float coef[36];
        double error;
        assert_int_equal(prt_radial_fit_material(radial[b], &material[m], coef, &error), 0);
        assert_int_equal(prt_relight(&ctx, &t[b].tensor[0], 1, lights, coef, false, want), 0);
        unsigned n_plane; // planes, because colours are clamped
        if (prt_answer_planes(&ctx, &t[b], &q, &n_plane, got)) fail_msg("%s", last_line);
        const double off = difference(got, want, 3 * (N - N / 4)); // the others are opaque
        if (!(off < 1e-3)) fail_msg("basis %d, material %d: off by %g", b, m, off);
    }
    for (int b = 0; b < 2; b++) {
        finish_transport(&t[b]);
        prt_radial_destroy(radial[b]);
    }
    prt_light_finish(&light);
    prt_cube_finish(&cube);
    free(want);
    free(got);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(many_queries_equal_one_by_one),
        cmocka_unit_test(colours_are_never_apart),
        cmocka_unit_test(a_sink_takes_each_colour_once),
        cmocka_unit_test(coefficients_for_many_lights),
        cmocka_unit_test(packed_coefficients_are_near),
        cmocka_unit_test(fewer_rows_are_a_smaller_transport),
        cmocka_unit_test(wrong_queries_are_refused),
        cmocka_unit_test(answers_follow_the_command_contract),
        cmocka_unit_test(planes_of_exit_are_added),
        cmocka_unit_test(factors_make_the_phase_function),
        cmocka_unit_test(half_space_seen_from_the_side),
        cmocka_unit_test(free_materials_follow_the_basis),
        cmocka_unit_test(contracted_light_serves_any_material),
        cmocka_unit_test(a_contracted_material_serves_any_light),
        cmocka_unit_test(kept_coefficients_are_of_their_material_and_basis),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
