// SPDX-License-Identifier: MIT
// Every variant of every relight kernel against its C reference, value by value, within the
// bound that libprt/relight/kernels.h promises; on random shapes, in arrays that end at
// unreadable pages, with rows of very different size. Each kernel's time is printed, never
// judged. Above 600 lines: short cases, each read alone.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "guard.h"
#include "kernels.h"
#include "synthetic.h"

static const struct prt_kernels *variants[8];
static int n_variant;

static bool add_variant(void *user, const struct prt_kernels *k)
{
    if (k != &prt_kernels_c) variants[n_variant++] = k;
    return true;
}

enum { MAX_GUARD = 16 };
static struct guard guards[MAX_GUARD];
static int n_guard;

static void *guarded(const void *from, size_t n)
{
    assert_in_range(n_guard, 0, MAX_GUARD - 1);
    void *p = guard_copy(&guards[n_guard++], from, n);
    assert_non_null(p);
    return p;
}

static void unguard(void)
{
    while (n_guard) guard_free(&guards[--n_guard]);
}

static uint32_t pick(struct prt_rng *rng, uint32_t lo, uint32_t hi)
{
    return lo + prt_rng_u32(rng) % (hi - lo + 1);
}

static float *copy_floats(const float *from, size_t n)
{
    float *to = malloc(4 * n + 4);
    assert_non_null(to);
    if (n) memcpy(to, from, 4 * n);
    return to;
}

static float *absolute(const float *from, size_t n)
{
    float *to = copy_floats(from, n);
    for (size_t i = 0; i < n; i++) to[i] = fabsf(to[i]);
    return to;
}

// sum[i]: what the C kernel makes of the terms' absolute values. slack: NULL, or what rounding
// to integers may add.
static void check_values(const char *kernel, const char *name, const float *out,
                         const float *expect, const float *sum, const float *slack, size_t n)
{
    for (size_t i = 0; i < n; i++) {
        const double off = fabs((double)out[i] - (double)expect[i]);
        double bound = KERNEL_TOLERANCE * (double)sum[i];
        if (slack) bound += 1.001 * (double)slack[i];
        if (!(off <= bound))
            fail_msg("%s, %s: value %zu is %.9g, C gives %.9g; off by %g, %g allowed", kernel,
                     name, i, (double)out[i], (double)expect[i], off, bound);
    }
}

static void check_bits(const char *kernel, const char *name, const float *out,
                       const float *expect, size_t n)
{
    for (size_t i = 0; i < n; i++)
        if (memcmp(out + i, expect + i, 4))
            fail_msg("%s, %s: value %zu is %.9g, its C twin gives %.9g", kernel, name, i,
                     (double)out[i], (double)expect[i]);
}

// ---- rows times light

enum which { DIAGONAL, GROUP, FULL };

struct row_case {
    enum which which;
    struct synthetic_options options;
    struct prt_tensor tensor;
    struct prt_rows rows, positive; // guarded; absolute values
    unsigned n_light;
    struct prt_light light[LIGHT_GROUP];
    const float *coef[LIGHT_GROUP];
    const void *table; // guarded
    float *positive_table;
    uint32_t begin;
    size_t n_coef, n_table, n_out, light_pitch, row_pitch;
    float *out, *expect, *sum; // out is guarded
};

static uint16_t *shrunk_halves(uint16_t *h, size_t n)
{
    for (size_t i = 0; i < n; i++) h[i] = prt_f32_to_f16(prt_f16_to_f32(h[i]) * 1e-3f);
    return h;
}

// Every third row becomes a thousand times smaller than the others: a kernel that loses it
// cannot hide behind the large ones.
static void shrink_rows(struct prt_rows *r)
{
    const size_t j = r->n_function;
    for (uint32_t row = 1; row < r->n_row; row += 3) {
        const uint64_t e = r->begin[row], n = r->begin[row + 1] - e;
        float *scale = (float *)(uintptr_t)r->scale;
        shrunk_halves((uint16_t *)(uintptr_t)r->scaling + 6 * row * j, 6 * j);
        if (r->direction)
            for (uint32_t d = r->direction[row]; d < r->direction[row + 1]; d++)
                scale[d] *= 1e-3f;
        else if (scale)
            for (size_t k = 0; k < j; k++) scale[row * j + k] *= 1e-3f;
        else shrunk_halves((uint16_t *)(uintptr_t)r->entry + e * j, n * j);
    }
}

static size_t entry_values(const struct prt_rows *r)
{
    return r->direction ? r->value_begin[r->n_row] : r->begin[r->n_row] * r->n_function;
}

static void guard_rows(const struct prt_rows *from, struct prt_rows *to)
{
    const uint64_t n = from->begin[from->n_row], j = from->n_function;
    const uint64_t d = from->direction ? from->direction[from->n_row] : 0;
    *to = *from;
    to->begin = guarded(from->begin, 8 * (from->n_row + 1));
    to->index = guarded(from->index, n * from->index_bytes);
    to->entry =
        guarded(from->entry, entry_values(from) * (from->value == PRT_VALUE_I8 ? 1 : 2));
    to->scaling = guarded(from->scaling, 12 * j * from->n_row);
    if (from->scale) to->scale = guarded(from->scale, 4 * (d ? d : j * from->n_row));
    if (!from->direction) return;
    to->value_begin = guarded(from->value_begin, 8 * (from->n_row + 1));
    to->direction = guarded(from->direction, 4 * (from->n_row + 1));
    to->mix = guarded(from->mix, 2 * d * j);
    to->shift = guarded(from->shift, n);
}

static uint16_t *positive_halves(const uint16_t *from, size_t n)
{
    uint16_t *to = malloc(2 * n + 2);
    for (size_t i = 0; i < n; i++) to[i] = from[i] & 0x7fff;
    return to;
}

static void make_positive(const struct prt_rows *from, struct prt_rows *to)
{
    const size_t n = entry_values(from), j = from->n_function;
    *to = *from;
    to->scaling = positive_halves(from->scaling, 6 * j * from->n_row);
    if (from->direction)
        to->mix = positive_halves(from->mix, j * (size_t)from->direction[from->n_row]);
    if (from->value == PRT_VALUE_F16) {
        to->entry = positive_halves(from->entry, n);
        return;
    }
    const size_t size = from->value == PRT_VALUE_I8 ? 1 : 2;
    void *entry = malloc(n * size + 1);
    for (size_t i = 0; i < n; i++) {
        if (size == 2) ((int16_t *)entry)[i] = (int16_t)abs(((const int16_t *)from->entry)[i]);
        else
            ((int8_t *)entry)[i] = (int8_t)abs(((const int8_t *)from->entry)[i] == -128
                                                   ? 127
                                                   : ((const int8_t *)from->entry)[i]);
    }
    to->entry = entry;
}

static void finish_positive(struct prt_rows *r)
{
    free((void *)(uintptr_t)r->entry);
    free((void *)(uintptr_t)r->scaling);
    if (r->direction) free((void *)(uintptr_t)r->mix);
}

static void gain(struct prt_light *light, bool back)
{
    for (uint32_t i = 0; i < 24 * light->n * light->n; i++) {
        const float g = prt_pair_gain(light->n, i / 4);
        light->coef[i] *= back ? 1 / g : g;
    }
}

static void run_rows(const struct prt_kernels *k, const struct row_case *c,
                     const struct prt_rows *rows, const void *table, float *out)
{
    const uint32_t end = rows->n_row;
    if (c->which == DIAGONAL) k->diagonal(rows, c->begin, end, table, out);
    if (c->which == GROUP)
        k->diagonal_group(rows, c->begin, end, table, c->n_light, c->light_pitch, c->row_pitch,
                          out);
    if (c->which == FULL)
        (rows->direction ? k->mixed : k->full)(rows, c->begin, end, table, out);
}

static void begin_case(struct row_case *c, enum which which, const struct synthetic_options *o,
                       unsigned n_light)
{
    *c = (struct row_case){.which = which, .options = *o, .n_light = n_light};
    assert_int_equal(synthetic_tensor(o, &c->tensor), 0);
    struct prt_rows *rows = &c->tensor.rows;
    shrink_rows(rows);
    c->begin = rows->n_row / 3;
    c->n_coef = 6ull * o->cube * o->cube;
    for (unsigned l = 0; l < n_light; l++) {
        assert_int_equal(synthetic_light(o->cube, l + 1, &c->light[l]), 0);
        c->coef[l] = c->light[l].coef;
    }
    const size_t n_row = rows->n_row - c->begin;
    const size_t width = c->tensor.n_function * (which == FULL ? 3u : 1u);
    c->n_out = n_row * width * n_light;
    // lights one after the other, or beside each other
    const bool beside = o->seed % 2;
    c->light_pitch = beside ? width : n_row * width;
    c->row_pitch = beside ? n_light * width : width;
    c->n_table = c->n_coef * (which == GROUP ? LIGHT_LANES : 4);
    float *table = malloc(4 * c->n_table);
    // rows of pairs take lights times their gains
    const bool pairs = which == GROUP && rows->value == PRT_VALUE_PAIR;
    for (unsigned l = 0; l < n_light && pairs; l++) gain(&c->light[l], false);
    if (which == GROUP) prt_light_table_fill(n_light, c->coef, 0, (uint32_t)c->n_coef, table);
    else memcpy(table, c->coef[0], 4 * c->n_table);
    for (unsigned l = 0; l < n_light && pairs; l++) gain(&c->light[l], true);
    guard_rows(rows, &c->rows);
    make_positive(rows, &c->positive);
    c->table = guarded(table, 4 * c->n_table);
    c->positive_table = absolute(table, c->n_table);
    free(table);
    c->expect = calloc(c->n_out + 1, 4);
    c->sum = calloc(c->n_out + 1, 4);
    c->out = guarded(c->expect, 4 * c->n_out);
    run_rows(&prt_kernels_c, c, &c->rows, c->table, c->expect);
    run_rows(&prt_kernels_c, c, &c->positive, c->positive_table, c->sum);
}

static void end_case(struct row_case *c)
{
    unguard();
    finish_positive(&c->positive);
    free(c->positive_table);
    free(c->expect);
    free(c->sum);
    for (unsigned l = 0; l < c->n_light; l++) prt_light_finish(&c->light[l]);
    synthetic_tensor_finish(&c->tensor);
}

// ---- the same in integers

static void make_integers(const struct prt_kernels *k, const struct row_case *c,
                          struct integer_lights *q)
{
    const uint32_t n = c->options.cube, n_coef = (uint32_t)c->n_coef;
    float most[LIGHT_GROUP][4] = {{0}};
    for (unsigned l = 0; l < c->n_light; l++)
        for (uint32_t i = 0; i < n_coef; i++)
            for (uint32_t ch = 0; ch < 3 && i % (n * n); ch++)
                most[l][ch] = fmaxf(
                    most[l][ch], fabsf(prt_pair_gain(n, i) * c->coef[l][4 * (size_t)i + ch]));
    q->lane = prt_alloc(n_coef, 64);
    assert_non_null(q->lane);
    assert_true(
        prt_integer_lights_init(q, c->n_light, k->quads, n, c->coef, (const float(*)[4])most));
    k->lights_to_integers(q, c->n_light, c->coef, 0, n_coef);
}

static void run_integers(const struct prt_kernels *k, const struct row_case *c,
                         const struct integer_lights *q, float *out)
{
    k->pairs_group(&c->rows, c->begin, c->rows.n_row, q, c->n_light, c->light_pitch,
                   c->row_pitch, out);
}

// Half a step of each light's integers, times the entries' absolute values.
static float *integer_slack(const struct row_case *c, const struct integer_lights *q)
{
    const uint32_t face = c->options.cube * c->options.cube;
    float *table = calloc(c->n_table, 4), *slack = calloc(c->n_out + 1, 4);
    for (size_t i = 0; i < c->n_coef; i++)
        for (unsigned l = 0; l < c->n_light && i % face; l++)
            for (size_t ch = 0; ch < 3; ch++)
                table[LIGHT_LANES * i + 3 * l + ch] = 0.5f * q->back[l][ch];
    run_rows(&prt_kernels_c, c, &c->positive, table, slack);
    free(table);
    return slack;
}

static void same_lanes(const struct row_case *c, const struct integer_lights *a,
                       const struct integer_lights *b)
{
    const uint32_t face = c->options.cube * c->options.cube;
    for (size_t i = 0; i < c->n_coef; i++) // scaling coefficients are not read
        for (unsigned l = 0; l < c->n_light && i % face; l++)
            if (memcmp(a->lane + a->lanes * i + integer_lane_of(a, l),
                       b->lane + b->lanes * i + integer_lane_of(b, l), 8))
                fail_msg("lights_to_integers: coefficient %zu differs from its C twin's", i);
}

static void check_integers(struct row_case *c, bool timed)
{
    struct integer_lights plain, q;
    float *twin = calloc(c->n_out + 1, 4);
    make_integers(&prt_kernels_integer_c, c, &plain);
    float *slack = integer_slack(c, &plain);
    run_integers(&prt_kernels_integer_c, c, &plain, twin);
    check_values("pairs_group", "integer_c", twin, c->expect, c->sum, slack, c->n_out);
    for (int i = 0; i < n_variant; i++) {
        const struct prt_kernels *k = variants[i];
        assert_int_equal(!k->pairs_group, !k->lights_to_integers);
        if (!k->pairs_group) continue;
        make_integers(k, c, &q);
        same_lanes(c, &q, &plain);
        memset(c->out, 0xff, 4 * c->n_out);
        run_integers(k, c, &q, c->out);
        check_bits("pairs_group", k->name, c->out, twin, c->n_out);
        double best = 1e9;
        for (int rep = 0; rep < 5 && timed; rep++) {
            double start = prt_time_s();
            run_integers(k, c, &q, c->out);
            best = fmin(best, prt_time_s() - start);
        }
        if (timed)
            print_message("%-36s  %s %.3f ns an entry\n", "the next one in integers", k->name,
                          1e9 * best /
                              (double)(c->rows.begin[c->rows.n_row] - c->rows.begin[c->begin]));
        prt_free(q.lane);
    }
    prt_free(plain.lane);
    free(slack);
    free(twin);
}

static void print_row_times(const struct row_case *c, const char *label)
{
    const uint64_t n_entry = c->rows.begin[c->rows.n_row] - c->rows.begin[c->begin];
    print_message("%-36s", label);
    for (int i = -1; i < n_variant; i++) {
        const struct prt_kernels *k = i < 0 ? &prt_kernels_c : variants[i];
        double best = 1e9;
        for (int rep = 0; rep < 5; rep++) {
            double start = prt_time_s();
            run_rows(k, c, &c->rows, c->table, c->out);
            best = fmin(best, prt_time_s() - start);
        }
        print_message("  %s %.3f", k->name, 1e9 * best / (double)n_entry);
    }
    print_message("  ns an entry\n");
}

static void check_rows(enum which which, const struct synthetic_options *o, unsigned n_light,
                       const char *label)
{
    static const char *const kernel[] = {"diagonal", "diagonal_group", "full"};
    struct row_case c;
    begin_case(&c, which, o, n_light);
    for (int i = 0; i < n_variant; i++) {
        memset(c.out, 0xff, 4 * c.n_out);
        run_rows(variants[i], &c, &c.rows, c.table, c.out);
        check_values(kernel[which], variants[i]->name, c.out, c.expect, c.sum, NULL, c.n_out);
    }
    if (which == GROUP && c.rows.value == PRT_VALUE_PAIR) check_integers(&c, label);
    if (label) print_row_times(&c, label);
    end_case(&c);
}

static void rows_times_light(void **state)
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
            struct synthetic_options pairs = o;
            pairs.value = PRT_VALUE_PAIR;
            pairs.n_phase = 1;
            check_rows(DIAGONAL, &pairs, 1, NULL);
            check_rows(GROUP, &pairs, pick(&rng, 1, 8), NULL);
        }
        o.storage = PRT_STORAGE_FACTORED;
        o.coupling = PRT_COUPLE_FULL;
        o.n_cluster = 1;
        o.n_vertex += 20;
        o.rank = pick(&rng, 1, 9);
        o.n_radial = pick(&rng, 1, 40);
        check_rows(FULL, &o, 1, NULL);
    }
}

static void rows_times_light_is_timed(void **state)
{
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
    check_rows(GROUP, &o, 1, "rows x light, pairs, as a group");
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
    check_rows(FULL, &o, 1, "low-rank rows x light, 4 x 12 functions");
    o.n_phase = 1;
    o.n_radial = 15;
    check_rows(FULL, &o, 1, "low-rank rows x light, 15 functions");
}

// ---- expansion

struct expand_shape {
    uint32_t rank, n_vertex, begin, n_triple;
    uint32_t run; // vertices that stay neighbours in the file; 0: few
    bool radial, add, stream;
    bool infinite; // one coefficient is not finite
};

struct expand_case {
    struct expand_shape shape;
    size_t stride, n_u, n_b, n_out;
    struct expand_job job, positive;           // guarded; absolute values
    uint16_t *positive_u;                      // of job.positive
    float *positive_b, *step;                  // [n_b]; half a step of the integers
    float *start, *out, *expect, *sum, *slack; // [triple][n_vertex][3]; out is guarded
    float *color[32];
};

static uint16_t *random_u(struct prt_rng *rng, const struct expand_case *c)
{
    uint16_t *u = malloc(2 * c->n_u + 2);
    for (size_t i = 0; i < c->n_u; i++) {
        // every third vertex a thousand times smaller
        const size_t vertex = (c->shape.radial ? i : i / 2) % c->stride;
        const float x = (prt_rng_f32(rng) - 0.5f) * (vertex % 3 == 1 ? 1e-3f : 1);
        const bool beside =
            !c->shape.radial && i % 2 && i / 2 / c->stride * 2 + 1 >= c->shape.rank;
        u[i] = c->shape.radial ? prt_f32_to_f16(x)
               : beside        ? 0
                               : (uint16_t)(int16_t)(x * 2 * PRT_U_MOST);
    }
    return u;
}

static uint32_t *random_order(struct prt_rng *rng, uint32_t n, uint32_t run)
{
    uint32_t *order = malloc(4ull * n);
    for (uint32_t i = 0; i < n; i++) order[i] = i;
    for (uint32_t i = 0; run && i < n; i++) { // the last run first
        const uint32_t from = i / run * run, end = from + run;
        order[i] = (end < n ? n - end : 0) + i - from;
    }
    for (uint32_t i = n - 1; !run && i > 0; i--) {
        uint32_t k = pick(rng, i > 15 ? i - 15 : 0, i), swap = order[i];
        order[i] = order[k];
        order[k] = swap;
    }
    return order;
}

static bool in_integers(const struct expand_shape *s, uint32_t triple)
{
    return !s->radial && s->rank <= EXPAND_RANK_MOST && triple < s->n_triple;
}

// Half a step of every coefficient's integer; 0 for triples that stay in f32.
static float *half_steps(const struct expand_case *c, const float *positive)
{
    const size_t stride = c->job.b_stride;
    float *step = calloc(c->n_b + 1, 4);
    for (size_t k = 0; k < stride; k++) {
        double sum = 0, most = 0;
        for (uint32_t r = 0; r < c->shape.rank; r++) {
            sum += (double)positive[r * stride + k];
            most = fmax(most, (double)positive[r * stride + k]);
        }
        const double scale = fmin(EXPAND_SUM_MOST / sum, EXPAND_COEF_MOST / most);
        for (uint32_t r = 0; r < c->shape.rank; r++)
            step[r * stride + k] =
                in_integers(&c->shape, (uint32_t)k / 3) && sum > 0 ? (float)(0.5 / scale) : 0;
    }
    return step;
}

static void run_expand(const struct prt_kernels *k, struct expand_case *c,
                       const struct expand_job *job, float *out)
{
    for (uint32_t t = 0; t < job->n_triple; t++)
        c->color[t] = out + 3ull * t * c->shape.n_vertex;
    (c->shape.radial ? k->radial : k->expand)(job);
}

static void begin_expand(struct expand_case *c, const struct expand_shape *s, uint64_t seed)
{
    struct prt_rng rng;
    prt_rng_init(&rng, seed, 3);
    *c = (struct expand_case){.shape = *s, .stride = (s->n_vertex + 15) & ~15u};
    const size_t b_stride = s->radial ? 3 : 3 * s->n_triple;
    c->n_u = c->stride * (s->radial ? 3ull * s->n_triple * s->rank : (s->rank + 1) & ~1u);
    c->n_b = b_stride * s->rank;
    c->n_out = 3ull * s->n_vertex * s->n_triple;
    uint16_t *u = random_u(&rng, c);
    float *b = malloc(4 * c->n_b + 4);
    for (size_t i = 0; i < c->n_b; i++)
        b[i] = (prt_rng_f32(&rng) - 0.5f) * (i % b_stride / 3 % 3 == 1 ? 1e-3f : 1);
    if (s->infinite) b[c->n_b / 2] = INFINITY;
    c->start = malloc(4 * c->n_out);
    for (size_t i = 0; i < c->n_out; i++) c->start[i] = prt_rng_f32(&rng);
    uint32_t *order = random_order(&rng, s->n_vertex, s->run);
    c->job = (struct expand_job){.u = guarded(u, 2 * c->n_u),
                                 .stride = c->stride,
                                 .rank = s->rank,
                                 .b = guarded(b, 4 * c->n_b),
                                 .b_stride = b_stride,
                                 .n_triple = s->n_triple,
                                 .begin = s->begin,
                                 .end = s->n_vertex,
                                 .order = guarded(order, 4ull * s->n_vertex),
                                 .color = c->color,
                                 .add = s->add,
                                 .stream = s->stream};
    c->positive = c->job;
    c->positive_b = absolute(b, c->n_b);
    c->positive.b = c->positive_b;
    c->step = half_steps(c, c->positive_b);
    for (size_t i = 0; i < c->n_u; i++)
        u[i] = s->radial ? u[i] & 0x7fff : (uint16_t)abs((int16_t)u[i]);
    c->positive.u = c->positive_u = u;
    c->out = guarded(c->start, 4 * c->n_out);
    free(b);
    free(order);
    c->expect = copy_floats(c->start, c->n_out);
    c->sum = copy_floats(c->start, c->n_out);
    c->slack = calloc(c->n_out + 1, 4);
    run_expand(&prt_kernels_c, c, &c->job, c->expect);
    run_expand(&prt_kernels_c, c, &c->positive, c->sum);
    struct expand_job steps = c->positive;
    steps.b = c->step;
    steps.add = false;
    if (!s->radial) run_expand(&prt_kernels_c, c, &steps, c->slack);
}

static void end_expand(struct expand_case *c)
{
    unguard();
    free(c->start);
    free(c->positive_u);
    free(c->positive_b);
    free(c->step);
    free(c->expect);
    free(c->sum);
    free(c->slack);
}

static void print_expand_times(struct expand_case *c, const char *label)
{
    print_message("%-36s", label);
    for (int i = -1; i < n_variant; i++) {
        const struct prt_kernels *k = i < 0 ? &prt_kernels_c : variants[i];
        double best = 1e9;
        for (int rep = 0; rep < 5; rep++) {
            double t = prt_time_s();
            run_expand(k, c, &c->job, c->out);
            best = fmin(best, prt_time_s() - t);
        }
        print_message("  %s %.2f", k->name, 1e9 * best / (double)c->shape.n_vertex);
    }
    print_message("  ns a vertex\n");
}

static void check_expand(const struct expand_shape *s, uint64_t seed, const char *label)
{
    const char *kernel = s->radial ? "radial" : "expand";
    struct expand_case c;
    begin_expand(&c, s, seed);
    float *twin = copy_floats(c.start, c.n_out);
    if (!s->radial) {
        run_expand(&prt_kernels_integer_c, &c, &c.job, twin);
        check_values(kernel, "integer_c", twin, c.expect, c.sum, c.slack, c.n_out);
    }
    for (int i = 0; i < n_variant; i++) {
        const bool integers = variants[i]->integers && !s->radial;
        memcpy(c.out, c.start, 4 * c.n_out);
        run_expand(variants[i], &c, &c.job, c.out);
        check_values(kernel, variants[i]->name, c.out, c.expect, c.sum,
                     integers ? c.slack : NULL, c.n_out);
        if (integers && !s->add && s->rank <= EXPAND_RANK_MOST)
            check_bits(kernel, variants[i]->name, c.out, twin, c.n_out);
    }
    if (label) print_expand_times(&c, label);
    free(twin);
    end_expand(&c);
}

static void bases_expand(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 2, 2);
    for (int i = 0; i < 200; i++) {
        struct expand_shape s = {.rank = i == 100 ? 300 : pick(&rng, 0, 20),
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

// A coefficient that is not finite cannot become an integer: its group goes in f32, and triples
// without it keep their values.
static void infinite_coefficients_stay_in_f32(void **state)
{
    const struct expand_shape s = {
        .rank = 6, .n_vertex = 100, .n_triple = 12, .infinite = true};
    struct expand_case c;
    begin_expand(&c, &s, 5);
    for (int i = -1; i < n_variant; i++) {
        const struct prt_kernels *k = i < 0 ? &prt_kernels_integer_c : variants[i];
        memcpy(c.out, c.start, 4 * c.n_out);
        run_expand(k, &c, &c.job, c.out);
        for (size_t v = 0; v < c.n_out; v++) {
            if (!isfinite(c.expect[v])) assert_false(isfinite(c.out[v]));
            else
                check_values("expand", k->name, c.out + v, c.expect + v, c.sum + v, c.slack + v,
                             1);
        }
    }
    end_expand(&c);
}

static void materials_fold(void **state)
{
    struct prt_rng rng;
    prt_rng_init(&rng, 4, 4);
    for (int i = 0; i < 100; i++) {
        uint32_t n = pick(&rng, 1, 20),
                 n_radial = i < 70 ? (uint32_t)i + 1 : pick(&rng, 1, 200);
        size_t n_in = 3ull * n * n_radial;
        float *in = malloc(4 * n_in), *coef = malloc(12ull * n_radial), expect[60], sum[60];
        for (size_t k = 0; k < n_in; k++)
            in[k] = (prt_rng_f32(&rng) - 0.5f) * (k / 3 / n_radial % 3 == 1 ? 1e-3f : 1);
        for (uint32_t k = 0; k < 3 * n_radial; k++) coef[k] = prt_rng_f32(&rng) - 0.5f;
        const float *gin = guarded(in, 4 * n_in), *gcoef = guarded(coef, 12ull * n_radial);
        float *out = guarded(expect, 12ull * n);
        float *positive = absolute(in, n_in), *positive_coef = absolute(coef, 3ull * n_radial);
        prt_kernels_c.material(gin, n, n_radial, gcoef, expect);
        prt_kernels_c.material(positive, n, n_radial, positive_coef, sum);
        for (int v = 0; v < n_variant; v++) {
            memset(out, 0xff, 12ull * n);
            variants[v]->material(gin, n, n_radial, gcoef, out);
            check_values("material", variants[v]->name, out, expect, sum, NULL, 3ull * n);
        }
        unguard();
        free(in);
        free(coef);
        free(positive);
        free(positive_coef);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(rows_times_light), cmocka_unit_test(rows_times_light_is_timed),
        cmocka_unit_test(bases_expand),     cmocka_unit_test(infinite_coefficients_stay_in_f32),
        cmocka_unit_test(materials_fold),
    };
    prt_kernels_visit(prt_cpu_detect(), add_variant, NULL);
    int failed = cmocka_run_group_tests(tests, NULL, NULL);
    if (failed || n_variant) return failed;
    print_message("skipped: this processor has no kernels but those in C\n");
    return 77;
}
