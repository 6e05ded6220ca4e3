// SPDX-License-Identifier: MIT
// Every variant of every relight kernel against the C reference, on random shapes and with
// guarded edges, and its time beside it (printed, never judged).
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "guard.h"
#include "kernels.h"
#include "synthetic.h"

static const struct relight_kernels *variants[4];
static int n_variant;

enum { MAX_GUARD = 16 };
static struct guard guards[MAX_GUARD];
static int n_guard;

static void *guarded(const void *from, size_t n)
{
    assert_true(n_guard < MAX_GUARD);
    void *p = guard_copy(&guards[n_guard++], from, n);
    assert_non_null(p);
    return p;
}

static void unguard(void)
{
    while (n_guard) guard_free(&guards[--n_guard]);
}

static void guard_rows(const struct prt_rows *from, struct prt_rows *to)
{
    uint64_t n = from->begin[from->n_row], j = from->n_function;
    *to = *from;
    to->begin = guarded(from->begin, 8 * (from->n_row + 1));
    to->index = guarded(from->index, n * from->index_bytes);
    if (from->direction) {
        uint64_t d = from->direction[from->n_row];
        to->entry = guarded(from->entry, from->value_begin[from->n_row]);
        to->value_begin = guarded(from->value_begin, 8 * (from->n_row + 1));
        to->direction = guarded(from->direction, 4 * (from->n_row + 1));
        to->scale = guarded(from->scale, 4 * d);
        to->mix = guarded(from->mix, 2 * d * j);
        to->shift = guarded(from->shift, n);
    } else {
        to->entry = guarded(from->entry, n * j * (from->value == PRT_VALUE_I8 ? 1 : 2));
        if (from->scale) to->scale = guarded(from->scale, 4 * j * from->n_row);
    }
    to->scaling = guarded(from->scaling, 12 * j * from->n_row);
}

// Relative to the largest result: cancellation within a row is no kernel's fault.
static void closer_than(double limit, const float *a, const float *b, size_t n,
                        const char *what)
{
    float most = 0, worst = 0;
    for (size_t i = 0; i < n; i++) most = fmaxf(most, fabsf(b[i]));
    for (size_t i = 0; i < n; i++) {
        assert_true(isfinite(a[i]));
        worst = fmaxf(worst, fabsf(a[i] - b[i]));
    }
    if (!((double)worst <= limit * (double)most))
        fail_msg("%s: off by %g of %g", what, (double)worst, (double)most);
}

static void close_enough(const float *a, const float *b, size_t n, const char *what)
{
    closer_than(2e-5, a, b, n, what);
}

static uint32_t pick(struct prt_rng *rng, uint32_t lo, uint32_t hi)
{
    return lo + prt_rng_u32(rng) % (hi - lo + 1);
}

enum which { DIAGONAL, GROUP, FULL };

static void run_rows(const struct relight_kernels *k, enum which which,
                     const struct prt_rows *rows, uint32_t begin, uint32_t end,
                     const void *light, unsigned n_light, const size_t pitch[2], float *out)
{
    if (which == DIAGONAL) k->diagonal(rows, begin, end, light, out);
    if (which == GROUP)
        k->diagonal_group(rows, begin, end, light, n_light, pitch[0], pitch[1], out);
    if (which == FULL) (rows->direction ? k->mixed : k->full)(rows, begin, end, light, out);
}

static void gain(struct prt_light *light, bool back)
{
    for (uint32_t i = 0; i < 24 * light->n * light->n; i++) {
        const float g = prt_pair_gain(light->n, i / 4);
        light->coef[i] *= back ? 1 / g : g;
    }
}

static void make_integers(unsigned n_light, uint32_t n, const float *const coef[],
                          struct integer_lights *out)
{
    const uint32_t n_coef = 6 * n * n;
    float most[LIGHT_GROUP][4] = {{0}};
    for (unsigned l = 0; l < n_light; l++)
        for (uint32_t i = 0; i < n_coef; i++)
            for (uint32_t ch = 0; ch < 3 && i % (n_coef / 6); ch++)
                most[l][ch] = fmaxf(most[l][ch],
                                    fabsf(prt_pair_gain(n, i) * coef[l][4 * (size_t)i + ch]));
    out->lane = prt_alloc(n_coef, 64);
    assert_true(relight_integers_begin(out, n_light, n, coef, (const float(*)[4])most));
    relight_integers_fill(out, n_light, coef, 0, n_coef);
}

static void check_rows(enum which which, const struct synthetic_options *o, unsigned n_light,
                       const char *label)
{
    struct prt_tensor t;
    struct prt_rows rows;
    struct prt_light light[LIGHT_GROUP];
    const float *lights[LIGHT_GROUP];
    assert_int_equal(synthetic_tensor(o, &t), 0);
    uint32_t n_coef = 6 * o->cube * o->cube, n_row = t.rows.n_row, begin = n_row / 3;
    for (unsigned l = 0; l < n_light; l++) {
        assert_int_equal(synthetic_light(o->cube, l + 1, &light[l]), 0);
        lights[l] = light[l].coef;
    }
    size_t width = t.n_function * (which == FULL ? 3u : 1u);
    size_t n_out = (n_row - begin) * width * n_light;
    size_t table_bytes = (which == GROUP ? 4ull * LIGHT_LANES : 16) * n_coef;
    void *filled = calloc(1, table_bytes);
    float *expect = malloc(n_out * 4 + 4);
    if (which == GROUP) {
        // pairs meet lights times their gains, integers have them of their own
        const bool pairs = t.rows.value == PRT_VALUE_PAIR;
        for (unsigned l = 0; l < n_light && pairs; l++) gain(&light[l], false);
        relight_fill_table(n_light, lights, 0, n_coef, filled);
        for (unsigned l = 0; l < n_light && pairs; l++) gain(&light[l], true);
    }
    if (which != GROUP) memcpy(filled, light[0].coef, table_bytes);
    guard_rows(&t.rows, &rows);
    void *table = guarded(filled, table_bytes);
    float *out = guarded(expect, n_out * 4);
    // lights one after the other, or beside each other
    const bool beside = o->seed % 2;
    const size_t pitch[2] = {beside ? width : (n_row - begin) * width,
                             beside ? n_light * width : width};
    run_rows(&relight_kernels_c, which, &rows, begin, n_row, table, n_light, pitch, expect);
    for (int i = 0; i < n_variant; i++) {
        memset(out, 0xff, n_out * 4);
        run_rows(variants[i], which, &rows, begin, n_row, table, n_light, pitch, out);
        close_enough(out, expect, n_out, variants[i]->name);
        if (which != GROUP || rows.value != PRT_VALUE_PAIR || !variants[i]->pairs_group)
            continue;
        struct integer_lights integers;
        make_integers(n_light, o->cube, lights, &integers);
        memset(out, 0xff, n_out * 4);
        variants[i]->pairs_group(&rows, begin, n_row, &integers, n_light, pitch[0], pitch[1],
                                 out);
        closer_than(1e-4, out, expect, n_out, "integers");
        double best = 1e9;
        for (int rep = 0; rep < 5 && label; rep++) {
            double start = prt_time_s();
            variants[i]->pairs_group(&rows, begin, n_row, &integers, n_light, pitch[0],
                                     pitch[1], out);
            best = fmin(best, prt_time_s() - start);
        }
        if (label)
            print_message("%-36s  %.3f ns an entry\n", "the next one in integers",
                          1e9 * best / (double)(rows.begin[n_row] - rows.begin[begin]));
        prt_free(integers.lane);
    }
    if (label) {
        uint64_t n_entry = rows.begin[n_row] - rows.begin[begin];
        print_message("%-36s", label);
        for (int i = -1; i < n_variant; i++) {
            const struct relight_kernels *k = i < 0 ? &relight_kernels_c : variants[i];
            double best = 1e9;
            for (int rep = 0; rep < 5; rep++) {
                double start = prt_time_s();
                run_rows(k, which, &rows, begin, n_row, table, n_light, pitch, out);
                best = fmin(best, prt_time_s() - start);
            }
            print_message("  %s %.3f", k->name, 1e9 * best / (double)n_entry);
        }
        print_message("  ns an entry\n");
    }
    unguard();
    free(filled);
    free(expect);
    for (unsigned l = 0; l < n_light; l++) prt_free(light[l].coef);
    synthetic_tensor_finish(&t);
}

static void rows_meet_light(void **state)
{
    static const uint32_t phases[] = {1, 1, 4, 9, 16};
    struct prt_rng rng;
    prt_rng_init(&rng, 1, 1);
    for (int i = 0; i < 120; i++) {
        bool large = i % 40 == 39;
        struct synthetic_options o = {.storage = PRT_STORAGE_SPARSE,
                                      .value = i & 1,
                                      .n_vertex = pick(&rng, 1, 60),
                                      .n_phase = phases[pick(&rng, 0, 4)],
                                      .cube = large ? 128 : 16u << pick(&rng, 0, 1),
                                      .coefs = pick(&rng, 0, 60),
                                      .seed = (uint64_t)i};
        check_rows(DIAGONAL, &o, 1, NULL);
        check_rows(GROUP, &o, pick(&rng, 1, 8), NULL);
        if (!large) {
            const uint32_t value = o.value, n_phase = o.n_phase;
            o.value = PRT_VALUE_PAIR;
            o.n_phase = 1;
            check_rows(DIAGONAL, &o, 1, NULL);
            check_rows(GROUP, &o, pick(&rng, 1, 8), NULL);
            o.value = value;
            o.n_phase = n_phase;
        }
        o.storage = PRT_STORAGE_FACTORED;
        o.coupling = PRT_COUPLE_FULL;
        o.n_cluster = 1;
        o.n_vertex += 20;
        o.rank = pick(&rng, 1, 9);
        o.n_radial = pick(&rng, 1, 40);
        check_rows(FULL, &o, 1, NULL);
    }
    struct synthetic_options o = {.storage = PRT_STORAGE_SPARSE,
                                  .n_vertex = 3000,
                                  .n_phase = 1,
                                  .cube = 32,
                                  .coefs = 122,
                                  .seed = 5};
    check_rows(DIAGONAL, &o, 1, "rows x light, 8 bits");
    check_rows(GROUP, &o, 8, "rows x 8 lights, 8 bits");
    o.n_phase = 4;
    check_rows(DIAGONAL, &o, 1, "rows x light, 4 terms, 8 bits");
    o = (struct synthetic_options){.storage = PRT_STORAGE_FACTORED,
                                   .value = PRT_VALUE_F16,
                                   .n_vertex = 999,
                                   .n_cluster = 8,
                                   .rank = 40,
                                   .n_phase = 1,
                                   .cube = 32,
                                   .coefs = 512,
                                   .seed = 6};
    check_rows(DIAGONAL, &o, 1, "rows x light, half");
    check_rows(GROUP, &o, 8, "rows x 8 lights, half");
    o.value = PRT_VALUE_PAIR;
    check_rows(DIAGONAL, &o, 1, "rows x light, pairs");
    check_rows(GROUP, &o, 8, "rows x 8 lights, pairs");
    o.value = PRT_VALUE_F16;
    o.n_phase = 4;
    check_rows(DIAGONAL, &o, 1, "rows x light, 4 terms, half");
    check_rows(GROUP, &o, 8, "rows x 8 lights, 4 terms, half");
    o.coupling = PRT_COUPLE_FULL;
    o.n_phase = 1;
    o.n_radial = 12;
    check_rows(FULL, &o, 1, "rows x light, 12 functions");
    o.n_phase = 4;
    check_rows(FULL, &o, 1, "rows x light, 4 terms x 12 functions");
    o.value = PRT_VALUE_I8;
    check_rows(FULL, &o, 1, "mixed rows x light, 4 terms x 12 functions");
    o.n_phase = 1;
    o.n_radial = 15;
    check_rows(FULL, &o, 1, "mixed rows x light, 15 functions");
}

struct expand_shape {
    uint32_t rank, n_vertex, begin, n_triple;
    uint32_t run; // vertices that stay neighbours in the file; 0: few
    bool radial, add, stream;
};

static void check_expand(const struct expand_shape *s, uint64_t seed, const char *label)
{
    struct prt_rng rng;
    prt_rng_init(&rng, seed, 3);
    size_t stride = (s->n_vertex + 15) & ~15u, wide = s->radial ? 3 * s->n_triple : 1;
    size_t n_row = s->radial ? s->rank * wide : (s->rank + 1) & ~1u;
    size_t n_u = stride * n_row, b_stride = s->radial ? 3 : 3 * s->n_triple;
    size_t n_b = b_stride * s->rank, n_out = 3ull * s->n_vertex * s->n_triple;
    uint16_t *u = malloc(2 * n_u + 2);
    float *b = malloc(4 * n_b + 4), *start = malloc(4 * n_out), *expect = malloc(4 * n_out);
    uint32_t *order = malloc(4ull * s->n_vertex);
    for (size_t i = 0; i < n_u; i++) {
        const float x = prt_rng_f32(&rng) - 0.5f;
        const bool beside = !s->radial && i % 2 && i / 2 / stride * 2 + 1 >= s->rank;
        u[i] = s->radial ? prt_f32_to_f16(x)
               : beside  ? 0
                         : (uint16_t)(int16_t)(x * 2 * PRT_U_MOST);
    }
    for (size_t i = 0; i < n_b; i++) b[i] = prt_rng_f32(&rng) - 0.5f;
    for (size_t i = 0; i < n_out; i++) start[i] = prt_rng_f32(&rng);
    for (uint32_t i = 0; i < s->n_vertex; i++) order[i] = i;
    for (uint32_t i = 0; s->run && i < s->n_vertex; i++) { // the last run first
        const uint32_t from = i / s->run * s->run, end = from + s->run;
        order[i] = (end < s->n_vertex ? s->n_vertex - end : 0) + i - from;
    }
    for (uint32_t i = s->n_vertex - 1; !s->run && i > 0; i--) {
        uint32_t k = pick(&rng, i > 15 ? i - 15 : 0, i), swap = order[i];
        order[i] = order[k];
        order[k] = swap;
    }
    float *color[32];
    struct expand_job job = {.u = guarded(u, 2 * n_u),
                             .stride = stride,
                             .rank = s->rank,
                             .b = guarded(b, 4 * n_b),
                             .b_stride = b_stride,
                             .n_triple = s->n_triple,
                             .begin = s->begin,
                             .end = s->n_vertex,
                             .order = guarded(order, 4ull * s->n_vertex),
                             .color = color,
                             .add = s->add,
                             .stream = s->stream};
    float *out = guarded(start, 4 * n_out);
    memcpy(expect, start, 4 * n_out);
    for (uint32_t t = 0; t < s->n_triple; t++) color[t] = expect + 3ull * t * s->n_vertex;
    (s->radial ? relight_kernels_c.radial : relight_kernels_c.expand)(&job);
    for (uint32_t t = 0; t < s->n_triple; t++) color[t] = out + 3ull * t * s->n_vertex;
    for (int i = 0; i < n_variant; i++) {
        memcpy(out, start, 4 * n_out);
        (s->radial ? variants[i]->radial : variants[i]->expand)(&job);
        // 16-bit integers (expand_vnni.c), used for four triples or more
        bool coarse = variants[i]->expand == relight_kernels_vnni.expand && !s->radial;
        closer_than(coarse && s->n_triple >= 4 ? 1e-4 : 2e-5, out, expect, n_out,
                    variants[i]->name);
    }
    if (label) {
        print_message("%-36s", label);
        for (int i = -1; i < n_variant; i++) {
            const struct relight_kernels *k = i < 0 ? &relight_kernels_c : variants[i];
            double best = 1e9;
            for (int rep = 0; rep < 5; rep++) {
                double t = prt_time_s();
                (s->radial ? k->radial : k->expand)(&job);
                best = fmin(best, prt_time_s() - t);
            }
            print_message("  %s %.2f", k->name, 1e9 * best / (double)s->n_vertex);
        }
        print_message("  ns a vertex\n");
    }
    unguard();
    free(u);
    free(b);
    free(start);
    free(expect);
    free(order);
}

static void bases_expand(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 2, 2);
    for (int i = 0; i < 200; i++) {
        struct expand_shape s = {.rank = pick(&rng, 0, 20),
                                 .n_vertex = pick(&rng, 1, 200),
                                 .n_triple = pick(&rng, 1, 17),
                                 .run = i & 4 ? pick(&rng, 1, 150) : 0,
                                 .radial = i & 1,
                                 .add = i & 2,
                                 .stream = !(i & 2) && i & 8};
        s.begin = s.n_vertex > 64 ? 32 * pick(&rng, 0, 2) : 0;
        check_expand(&s, (uint64_t)i, NULL);
    }
    check_expand(&(struct expand_shape){.rank = 40, .n_vertex = 4096, .n_triple = 1}, 7,
                 "expand, rank 40");
    check_expand(&(struct expand_shape){.rank = 40, .n_vertex = 4096, .n_triple = 4}, 7,
                 "expand, rank 40, 4 terms");
    check_expand(&(struct expand_shape){.rank = 40, .n_vertex = 4096, .n_triple = 8}, 7,
                 "expand, rank 40, 8 lights");
    check_expand(
        &(struct expand_shape){.rank = 17, .n_vertex = 4096, .n_triple = 1, .radial = true}, 7,
        "polynomial, 17 functions");
}

static void materials_fold(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 4, 4);
    for (int i = 0; i < 100; i++) {
        uint32_t n = pick(&rng, 1, 20),
                 n_radial = i < 70 ? (uint32_t)i + 1 : pick(&rng, 1, 200);
        size_t n_in = 3ull * n * n_radial;
        float *in = malloc(4 * n_in), *coef = malloc(12ull * n_radial), expect[60];
        for (size_t k = 0; k < n_in; k++) in[k] = prt_rng_f32(&rng) - 0.5f;
        for (uint32_t k = 0; k < 3 * n_radial; k++) coef[k] = prt_rng_f32(&rng) - 0.5f;
        const float *gin = guarded(in, 4 * n_in), *gcoef = guarded(coef, 12ull * n_radial);
        float *out = guarded(expect, 12ull * n);
        relight_kernels_c.material(gin, n, n_radial, gcoef, expect);
        for (int v = 0; v < n_variant; v++) {
            memset(out, 0xff, 12ull * n);
            variants[v]->material(gin, n, n_radial, gcoef, out);
            close_enough(out, expect, 3ull * n, variants[v]->name);
        }
        unguard();
        free(in);
        free(coef);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_meet_light),
        cmocka_unit_test(bases_expand),
        cmocka_unit_test(materials_fold),
    };
#if defined(__x86_64__)
    unsigned cpu = prt_cpu_detect();
    if (cpu & PRT_CPU_AVX2) variants[n_variant++] = &relight_kernels_avx2;
    if (cpu & PRT_CPU_AVX512) variants[n_variant++] = &relight_kernels_avx512;
    if (cpu & PRT_CPU_AVX512VNNI) variants[n_variant++] = &relight_kernels_vnni;
#endif
    if (!n_variant) print_message("this processor has no variant to hold against C\n");
    return cmocka_run_group_tests(tests, NULL, NULL);
}
