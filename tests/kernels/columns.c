// SPDX-License-Identifier: MIT
// Rows of pairs or halves by column (prt/columns.h, METHODS §3.4): that columns hold what the
// rows hold, every kernel against the one in C, and that what a contraction leaves out is
// small.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdio.h>
#include <stdlib.h>

#include <cmocka.h>

#include "contract_columns.h"
#include "guard.h"
#include "prt/relight.h"
#include "synthetic.h"

static struct prt_context ctx;

static const struct synthetic_options shape = {.storage = PRT_STORAGE_FACTORED,
                                               .coupling = PRT_COUPLE_DIAGONAL,
                                               .value = PRT_VALUE_PAIR,
                                               .n_vertex = 900,
                                               .n_cluster = 7,
                                               .rank = 13,
                                               .n_phase = 1,
                                               .cube = 16,
                                               .coefs = 200,
                                               .seed = 3};

// Four planes of halves, as of single scattering with a phase function.
static struct synthetic_options phases(void)
{
    struct synthetic_options o = shape;
    o.value = PRT_VALUE_F16;
    o.n_phase = 4;
    o.term = PRT_TERM_SINGLE;
    return o;
}

// Rows whose entries fall with the coefficient's level and the row, as those of bakes do.
static void let_fall(struct prt_tensor *t, uint32_t rank)
{
    float *scale = (float *)(uintptr_t)t->rows.scale;
    uint16_t *half = (uint16_t *)(uintptr_t)t->rows.entry;
    const uint32_t J = t->rows.n_function;
    for (uint32_t row = 0; row < t->rows.n_row; row++) {
        const float by = ldexpf(1, -(int)(row % rank) / 2);
        for (uint32_t j = 0; scale && j < J; j++) scale[row * J + j] *= by;
        for (uint64_t i = t->rows.begin[row] * J; !scale && i < t->rows.begin[row + 1] * J; i++)
            half[i] = prt_f32_to_f16(prt_f16_to_f32(half[i]) * by);
    }
}

struct with_columns {
    struct prt_tensor tensor;
    struct prt_columns *columns;
};

static void make(struct with_columns *c, const struct synthetic_options *o)
{
    assert_int_equal(synthetic_tensor(o, &c->tensor), 0);
    let_fall(&c->tensor, o->rank);
    assert_int_equal(prt_columns_make(&ctx, &c->tensor, &c->columns), 0);
    c->tensor.columns = c->columns;
}

static void drop(struct with_columns *c)
{
    prt_columns_destroy(c->columns);
    c->tensor.columns = NULL;
    synthetic_tensor_finish(&c->tensor);
}

static float scale_of(const struct prt_columns *c, size_t row, uint32_t ch)
{
    return c->scale[row / PRT_COLUMN_ROWS * PRT_COLUMN_LANES + row % PRT_COLUMN_ROWS * 3 + ch];
}

// Adds the units of a column to dense values [row][3].
static void add_dense(const struct prt_columns *c, const struct prt_column_group *g,
                      uint32_t column, float *dense)
{
    const int16_t *entry = g->entry + 3ull * g->entry_begin[column];
    const float gain = prt_pair_gain(shape.cube, column);
    for (uint32_t k = 0; k < g->count[column][PRT_COLUMN_LEVELS - 1]; k++) {
        const uint32_t unit = g->unit[g->unit_begin[column] + k];
        assert_true(unit >> 5 < g->n_chunk);
        assert_int_not_equal(unit & 31, 0);
        for (uint32_t r = 0; r < PRT_COLUMN_ROWS; r++) {
            if (!(unit >> r & 1)) continue;
            const size_t row = (size_t)PRT_COLUMN_ROWS * (g->chunk_begin + (unit >> 5)) + r;
            for (uint32_t ch = 0; ch < 3; ch++)
                dense[3 * row + ch] += (float)entry[ch] * scale_of(c, row, ch) * gain;
            entry += 3;
        }
    }
}

// Entry e of function j, as a number.
static float entry_of(const struct prt_rows *rows, uint32_t row, uint64_t e, uint32_t j)
{
    if (rows->value == PRT_VALUE_F16)
        return prt_f16_to_f32(((const uint16_t *)rows->entry)[e * rows->n_function + j]);
    return (float)((const int16_t *)rows->entry)[e / 2 * 6 + 2 * j + e % 2] *
           rows->scale[3 * row + j] *
           prt_pair_gain(shape.cube, ((const uint16_t *)rows->index)[e]);
}

static void check_what_columns_hold(const struct synthetic_options *o)
{
    struct with_columns c;
    assert_int_equal(synthetic_tensor(o, &c.tensor), 0);
    const struct prt_rows *rows = &c.tensor.rows;
    const uint32_t J = rows->n_function;
    // A row may have two entries of one index, which add up.
    uint16_t *index = (uint16_t *)(uintptr_t)rows->index;
    for (uint32_t row = 0; row < rows->n_row && rows->value == PRT_VALUE_PAIR; row += 3)
        index[rows->begin[row] + 1] = index[rows->begin[row]];
    let_fall(&c.tensor, o->rank);
    assert_int_equal(prt_columns_make(&ctx, &c.tensor, &c.columns), 0);
    const size_t n = (size_t)rows->n_row * J + 3 * PRT_COLUMN_ROWS;
    float *expect = calloc(n * rows->n_coef, 4), *dense = calloc(n * rows->n_coef, 4);
    uint64_t n_unit = 0;
    for (uint32_t row = 0; row < rows->n_row; row++)
        for (uint64_t e = rows->begin[row]; e < rows->begin[row + 1]; e++)
            for (uint32_t j = 0; j < J; j++)
                expect[((const uint16_t *)rows->index)[e] * n + J * row + j] +=
                    entry_of(rows, row, e, j);
    for (uint32_t i = 0; i < c.columns->n_group; i++) {
        n_unit += c.columns->group[i].n_unit;
        for (uint32_t k = 0; k < rows->n_coef; k++)
            add_dense(c.columns, &c.columns->group[i], k, dense + k * n);
    }
    for (uint32_t k = 0; k < rows->n_coef; k++)
        for (size_t i = 0; i < (size_t)rows->n_row * J; i++) {
            // half a step of a rounded half, and the division's own rounding
            const float step = scale_of(c.columns, i / 3, i % 3) * prt_pair_gain(shape.cube, k);
            const float bound = (rows->value == PRT_VALUE_F16 ? 0.51f : 1e-2f) * step;
            if (!(fabsf(dense[k * n + i] - expect[k * n + i]) <= bound))
                fail_msg("column %u, value %zu is %g instead of %g", k, i,
                         (double)dense[k * n + i], (double)expect[k * n + i]);
        }
    assert_int_equal(n_unit, c.columns->n_unit);
    free(expect);
    free(dense);
    drop(&c);
}

static void columns_hold_what_rows_hold(void **state)
{
    const struct synthetic_options halves = phases();
    check_what_columns_hold(&shape);
    check_what_columns_hold(&halves);
}

// Length of the column of U that a row is multiplied with.
static float length_of(const struct prt_tensor *t, uint32_t row)
{
    const struct prt_cluster *c = t->cluster;
    while (row >= c->row_begin + c->rank) c++;
    const uint32_t r = row - c->row_begin;
    const size_t padded = (c->n_vertex + 15ull) & ~15ull;
    const int16_t *u = (const int16_t *)t->u + c->u_begin + r / 2 * 2 * padded + r % 2;
    double sum = 0;
    for (uint32_t v = 0; v < c->n_vertex; v++)
        sum += pow((double)u[2 * v] * (double)PRT_U_UNIT, 2);
    return (float)sqrt(sum);
}

// A unit's weight lies between the bounds of its level.
static void units_stand_at_their_level(void **state)
{
    struct with_columns c;
    make(&c, &shape);
    const struct prt_rows *rows = &c.tensor.rows;
    for (uint32_t i = 0; i < c.columns->n_group; i++) {
        const struct prt_column_group *g = &c.columns->group[i];
        float most = 0;
        for (uint32_t k = 0; k < rows->n_coef; k++) {
            const int16_t *entry = g->entry + 3ull * g->entry_begin[k];
            uint32_t u = 0;
            uint8_t first = PRT_COLUMN_LEVELS;
            for (uint8_t level = 0; level < PRT_COLUMN_LEVELS; level++)
                for (; u < g->count[k][level]; u++) {
                    const uint32_t unit = g->unit[g->unit_begin[k] + u];
                    double sum = 0;
                    for (uint32_t r = 0; r < PRT_COLUMN_ROWS; r++) {
                        const uint32_t row =
                            PRT_COLUMN_ROWS * (g->chunk_begin + (unit >> 5)) + r;
                        if (!(unit >> r & 1)) continue;
                        for (uint32_t ch = 0; ch < 3; ch++)
                            sum += pow((double)entry[ch] * (double)rows->scale[3 * row + ch] *
                                           (double)prt_pair_gain(16, k) *
                                           (double)length_of(&c.tensor, row),
                                       2);
                        entry += 3;
                    }
                    const double weight = sqrt(sum), top = (double)g->top;
                    if (first == PRT_COLUMN_LEVELS) first = level;
                    most = fmaxf(most, (float)weight);
                    assert_true(weight <= 1.0001 * top * pow(2, -0.5 * level));
                    if (level < PRT_COLUMN_LEVELS - 1)
                        assert_true(weight >= 0.9999 * top * pow(2, -0.5 * (level + 1)));
                }
            assert_int_equal(g->lowest[k], first);
        }
        assert_true(fabsf(most - g->top) <= 1e-4f * g->top);
    }
    drop(&c);
}

// ---- kernels

struct kernel_case {
    struct guard guard[2];
    struct column_part part[40];
    const int16_t *entry;
    uint32_t n_part, n_chunk, n_light;
    float *sum, *start;
};

// Parts of random units, as many lights and numbers of units as the case asks for.
static void make_parts(struct kernel_case *k, uint16_t *unit, int16_t *entry, uint64_t seed)
{
    struct prt_rng rng;
    prt_rng_init(&rng, seed, 6);
    k->n_light = 1 + (uint32_t)seed % LIGHT_GROUP;
    k->n_chunk = 30;
    k->n_part = 40;
    for (uint32_t i = 0; i < k->n_part; i++) {
        struct column_part *p = &k->part[i];
        *p = (struct column_part){.unit = unit, .entry = entry};
        p->n_light = 1 + prt_rng_u32(&rng) % k->n_light;
        uint32_t n = prt_rng_u32(&rng) % 20;
        for (uint32_t u = 0; u < n; u++) {
            const uint32_t mask = 1 + prt_rng_u32(&rng) % 31;
            *unit++ = (uint16_t)(prt_rng_u32(&rng) % k->n_chunk << 5 | mask);
            for (int e = 0; e < 3 * __builtin_popcount(mask); e++)
                *entry++ = (int16_t)prt_rng_u32(&rng);
        }
        for (unsigned l = 0; l < p->n_light; l++) {
            p->n[l] = n;
            p->at[l] = PRT_COLUMN_LANES * ((l + (uint32_t)i) % k->n_light);
            n -= n ? prt_rng_u32(&rng) % (n + 1) : 0;
            for (int ch = 0; ch < 3; ch++) p->x[l][ch] = prt_rng_f32(&rng) - 0.5f;
        }
    }
}

static void check_kernel(const struct prt_kernels *kernels, struct kernel_case *k)
{
    const size_t stride = (size_t)PRT_COLUMN_LANES * k->n_light, n = stride * k->n_chunk;
    float *expect = malloc(4 * n), *bound = malloc(4 * n);
    memcpy(expect, k->start, 4 * n);
    memcpy(k->sum, k->start, 4 * n);
    prt_columns_c(k->part, k->n_part, stride, expect);
    kernels->columns(k->part, k->n_part, stride, k->sum);
    for (size_t i = 0; i < n; i++) {
        // at most 40 * 20 products of 16384 * 0.5 each, and the start
        bound[i] = (float)KERNEL_TOLERANCE * (fabsf(k->start[i]) + 16384 * 40);
        if (!(fabsf(k->sum[i] - expect[i]) <= bound[i]))
            fail_msg("%s: lane %zu is %g, C gives %g", kernels->name, i, (double)k->sum[i],
                     (double)expect[i]);
    }
    free(expect);
    free(bound);
}

static bool check_cases(void *user, const struct prt_kernels *kernels)
{
    for (uint64_t seed = 0; seed < 40; seed++) {
        struct kernel_case k = {{{0}}};
        uint16_t unit[40 * 20];
        int16_t entry[40 * 20 * 15 + 32];
        make_parts(&k, unit, entry, seed);
        const size_t n = (size_t)PRT_COLUMN_LANES * k.n_light * k.n_chunk;
        k.start = malloc(4 * n);
        for (size_t i = 0; i < n; i++) k.start[i] = (float)i;
        k.sum = guard_alloc(&k.guard[0], 4 * n);
        // Entries end 64 bytes before an unreadable page.
        const int16_t *end = entry;
        for (uint32_t i = 0; i < k.n_part; i++) {
            const struct column_part *p = &k.part[i];
            const int16_t *e = p->entry;
            for (uint32_t u = 0; u < p->n[0]; u++) e += 3 * __builtin_popcount(p->unit[u] & 31);
            end = e > end ? e : end;
        }
        const size_t bytes = (size_t)(end - entry) * 2 + 64;
        const int16_t *guarded = guard_copy(&k.guard[1], entry, bytes);
        for (uint32_t i = 0; i < k.n_part; i++)
            k.part[i].entry = guarded + (k.part[i].entry - entry);
        check_kernel(kernels, &k);
        for (size_t i = 15; i < n; i += 16) assert_true(k.sum[i] == k.start[i]); // unused lane
        for (int i = 0; i < 2; i++) guard_free(&k.guard[i]);
        free(k.start);
    }
    return true;
}

static void kernels_add_what_c_adds(void **state)
{
    prt_kernels_visit(prt_cpu_detect(), check_cases, NULL);
}

// ---- contractions

enum { N_LIGHT = PRT_RELIGHT_MAX_LIGHTS };

// Suns, lamps, skies and some of each: coefficients of few columns and of many.
static void make_lights(uint32_t cube, struct prt_light light[N_LIGHT])
{
    struct prt_rng rng;
    prt_rng_init(&rng, 8, 8);
    for (uint32_t l = 0; l < N_LIGHT; l++) {
        struct prt_cube c;
        assert_int_equal(prt_cube_init(&c, cube), 0);
        for (uint32_t i = 0; i < 18 * cube * cube; i++)
            c.texel[i] = l % 4 == 0 ? 0 : 0.2f + (float)(i / (3 * cube)) * 0.002f;
        for (uint32_t k = 0; k < (l % 4 == 1 ? 0 : 1 + 3 * l); k++) {
            const uint32_t i = prt_rng_u32(&rng) % (6 * cube * cube);
            for (uint32_t ch = 0; ch < 3; ch++)
                c.texel[3 * i + ch] += 50 + 100 * prt_rng_f32(&rng);
        }
        assert_int_equal(prt_light_from_cube(&c, &light[l]), 0);
        prt_cube_finish(&c);
    }
}

static double difference(const float *a, const float *b, size_t n)
{
    double d = 0, s = 0;
    for (size_t i = 0; i < n; i++) {
        d += pow((double)a[i] - (double)b[i], 2);
        s += pow((double)b[i], 2);
    }
    return sqrt(d / s);
}

static void check_what_is_left_out(const struct synthetic_options *o)
{
    struct with_columns c;
    struct prt_light light[N_LIGHT];
    make(&c, o);
    make_lights(o->cube, light);
    const size_t n = 3ull * o->n_phase * o->n_vertex;
    float *rows = malloc(4 * n), *columns = malloc(4 * n);
    unsigned n_taken = 0;
    for (uint32_t l = 0; l < N_LIGHT; l++) {
        const struct prt_light *one = &light[l];
        struct prt_tensor without = c.tensor;
        bool taken;
        without.columns = NULL;
        assert_int_equal(prt_relight(&ctx, &without, 1, &one, NULL, false, rows), 0);
        assert_int_equal(prt_relight(&ctx, &c.tensor, 1, &one, NULL, false, columns), 0);
        const double off = difference(columns, rows, n);
        if (!(off <= 0.004)) fail_msg("light %u: %g of the colours is left out", l, off);
        float *b = malloc(4ull * c.tensor.n_function * c.tensor.rows.n_row);
        assert_int_equal(
            prt_contract_columns(&ctx, &c.tensor, 1, &one, 0, c.tensor.n_function, b, &taken),
            0);
        n_taken += taken;
        free(b);
    }
    assert_true(n_taken >= N_LIGHT / 2); // else nothing was tried
    for (uint32_t l = 0; l < N_LIGHT; l++) prt_light_finish(&light[l]);
    free(rows);
    free(columns);
    drop(&c);
}

static void what_is_left_out_is_small(void **state)
{
    const struct synthetic_options halves = phases();
    check_what_is_left_out(&shape);
    check_what_is_left_out(&halves);
}

// Neither the lights beside it nor threads change a light's bits.
static void a_light_keeps_its_bits(void **state)
{
    struct with_columns c;
    struct prt_light light[N_LIGHT];
    const struct prt_light *all[N_LIGHT];
    struct synthetic_options o = shape;
    struct prt_context many = ctx;
    bool taken[N_LIGHT], alone;
    o.n_cluster = 90; // several groups
    o.n_vertex = 2000;
    o.rank = 120;
    make(&c, &o);
    assert_true(c.columns->n_group > 1);
    make_lights(shape.cube, light);
    assert_int_equal(prt_pool_create(4, &many.pool), 0);
    const size_t n = 3ull * c.tensor.rows.n_row;
    float *beside = malloc(4 * n * N_LIGHT), *one = malloc(4 * n);
    for (uint32_t l = 0; l < N_LIGHT; l++) all[l] = &light[l];
    assert_int_equal(prt_contract_columns(&many, &c.tensor, N_LIGHT, all, n, 3, beside, taken),
                     0);
    for (uint32_t l = 0; l < N_LIGHT; l++) {
        assert_int_equal(prt_contract_columns(&ctx, &c.tensor, 1, &all[l], 0, 3, one, &alone),
                         0);
        assert_int_equal(alone, taken[l]);
        if (alone) assert_memory_equal(one, beside + l * n, 4 * n);
        prt_light_finish(&light[l]);
    }
    prt_pool_destroy(many.pool);
    free(beside);
    free(one);
    drop(&c);
}

// One coefficient takes nearly all of the light away that the faces' averages promise; what is
// left is of the size of what a first round leaves out.
static void dark_colours_are_summed_again(void **state)
{
    struct with_columns c;
    struct synthetic_options o = shape;
    struct prt_light light;
    bool taken;
    o.n_cluster = 1;
    o.rank = 1;
    o.coefs = 900;
    make(&c, &o);
    const struct prt_rows *rows = &c.tensor.rows;
    assert_int_equal(synthetic_light(o.cube, 1, &light), 0);
    memset(light.coef, 0, 96ull * o.cube * o.cube);
    double base[3] = {0}, expect[3];
    float out[3];
    for (uint32_t ch = 0; ch < 3; ch++) {
        light.coef[ch] = 1;
        base[ch] = expect[ch] = (double)prt_f16_to_f32(rows->scaling[ch]);
    }
    for (uint64_t e = 0; e < rows->begin[1]; e++) {
        const uint32_t at = ((const uint16_t *)rows->index)[e];
        for (uint32_t ch = 0; ch < 3; ch++) {
            const double a =
                (double)((const int16_t *)rows->entry)[e / 2 * 6 + 2 * ch + e % 2] *
                (double)rows->scale[ch] * (double)prt_pair_gain(o.cube, at);
            float *x = &light.coef[4 * (size_t)at + ch];
            if (a == 0 || *x != 0 || e % 3) continue; // a third: more would go by rows
            *x = (float)(e == 0 ? -0.999 * base[ch] / a : 2e-5 * base[ch] / a);
            expect[ch] += a * (double)*x;
        }
    }
    const struct prt_light *one = &light;
    assert_int_equal(prt_contract_columns(&ctx, &c.tensor, 1, &one, 0, 3, out, &taken), 0);
    assert_true(taken);
    for (uint32_t ch = 0; ch < 3; ch++)
        if (!(fabs((double)out[ch] - expect[ch]) <= 0.02 * fabs(expect[ch])))
            fail_msg("channel %u is %g instead of %g", ch, (double)out[ch], expect[ch]);
    prt_light_finish(&light);
    drop(&c);
}

static void infinite_lights_go_by_rows(void **state)
{
    struct with_columns c;
    struct prt_light light[N_LIGHT];
    bool taken[2];
    make(&c, &shape);
    make_lights(shape.cube, light);
    light[0].coef[4 * 5 + 1] = INFINITY;
    const struct prt_light *two[2] = {&light[0], &light[4]};
    const size_t n = 3ull * c.tensor.rows.n_row;
    float *out = malloc(8 * n);
    assert_int_equal(prt_contract_columns(&ctx, &c.tensor, 2, two, n, 3, out, taken), 0);
    assert_false(taken[0]);
    assert_true(taken[1]);
    for (uint32_t l = 0; l < N_LIGHT; l++) prt_light_finish(&light[l]);
    free(out);
    drop(&c);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(columns_hold_what_rows_hold),
        cmocka_unit_test(units_stand_at_their_level),
        cmocka_unit_test(kernels_add_what_c_adds),
        cmocka_unit_test(what_is_left_out_is_small),
        cmocka_unit_test(a_light_keeps_its_bits),
        cmocka_unit_test(dark_colours_are_summed_again),
        cmocka_unit_test(infinite_lights_go_by_rows),
    };
    prt_context_init(&ctx);
    return cmocka_run_group_tests(tests, NULL, NULL);
}
