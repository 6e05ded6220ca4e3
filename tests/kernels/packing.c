// SPDX-License-Identifier: MIT
// The packed format of coefficients: each word by its definition (prt/relight.h), for every
// instruction set.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stdlib.h>

#include <cmocka.h>

#include "guard.h"
#include "pack_triples.h"
#include "prt/base.h"

enum { MOST = 101 };

static const unsigned sets[] = {0, PRT_CPU_AVX2, PRT_CPU_AVX2 | PRT_CPU_AVX512};

static bool has(unsigned set)
{
    struct prt_context ctx;
    prt_context_init(&ctx);
    return (ctx.cpu & set) == set;
}

// The words of two triples in double precision.
static void expect_pair(const double x[6], uint32_t word[2])
{
    double most = 0;
    int exponent = 0;
    for (int i = 0; i < 6; i++) most = fmax(most, fabs(x[i]));
    if (most > 0) frexp(most, &exponent);
    if (exponent < 0) exponent = 0;
    if (exponent < 15 && rint(ldexp(most, 9 - exponent)) >= 512) exponent++;
    for (int t = 0; t < 2; t++) {
        word[t] = (uint32_t)(exponent >> 2 * t & 3) << 30;
        for (int c = 0; c < 3; c++) {
            const double m = rint(ldexp(x[3 * t + c], 9 - exponent));
            const int limited = (int)fmin(fmax(m, -511), 511);
            word[t] |= ((uint32_t)limited & 1023) << 10 * c;
        }
    }
}

static void check_words(const float *rgb, float factor, size_t n)
{
    struct guard from, to;
    const float *in = guard_copy(&from, rgb, n * 12);
    for (size_t s = 0; s < sizeof sets / sizeof *sets; s++) {
        if (!has(sets[s])) continue;
        uint32_t *out = guard_alloc(&to, 4 * (n + n % 2));
        prt_pack_triples(sets[s], in, factor, n, out);
        for (size_t i = 0; i < n; i += 2) {
            double x[6] = {0};
            uint32_t word[2];
            for (size_t k = 0; k < (i + 1 < n ? 6 : 3); k++)
                x[k] = (double)rgb[3 * i + k] * (double)factor;
            expect_pair(x, word);
            if (out[i] != word[0] || out[i + 1] != word[1])
                fail_msg("set %zu, triple %zu of %zu: %08x %08x in place of %08x %08x", s, i, n,
                         out[i], out[i + 1], word[0], word[1]);
        }
        guard_free(&to);
    }
    guard_free(&from);
}

// Numbers of every size, and those whose mantissa rounds up to 512: the next exponent is taken,
// but at the last one.
static void words_are_those_of_the_format(void **state)
{
    struct prt_rng rng;
    float rgb[3 * MOST];
    prt_rng_init(&rng, 8, 1);
    for (size_t n = 1; n <= MOST; n++) {
        for (size_t i = 0; i < 3 * n; i++)
            rgb[i] = ldexpf(2 * prt_rng_f32(&rng) - 1, (int)(prt_rng_u32(&rng) % 24) - 8);
        check_words(rgb, 0.5f, n);
        check_words(rgb, 0x1p-60f, n);
    }
    for (size_t i = 0; i < MOST; i++) {
        const float largest = ldexpf(511.25f + 0.25f * (float)(i / 2 % 4), (int)(i / 8) - 9);
        for (size_t c = 0; c < 3; c++) rgb[3 * i + c] = largest * (c == i % 3 ? -1 : 0.3f);
    }
    check_words(rgb, 1, MOST);
}

// NaN becomes the least number and decides no exponent.
static void nan_harms_no_neighbour(void **state)
{
    for (size_t s = 0; s < sizeof sets / sizeof *sets; s++) {
        const float rgb[6] = {NAN, 100, -100, 7, 0, -7};
        uint32_t out[2];
        if (!has(sets[s])) continue;
        prt_pack_triples(sets[s], rgb, 1, 2, out);
        assert_int_equal(out[0], 3u << 30 | (-400 & 1023u) << 20 | 400u << 10 | (-511 & 1023u));
        assert_int_equal(out[1], 1u << 30 | (-28 & 1023u) << 20 | 28u);
    }
}

static void the_largest_is_found_at_every_place(void **state)
{
    float x[67];
    for (size_t s = 0; s < sizeof sets / sizeof *sets; s++) {
        if (!has(sets[s])) continue;
        assert_float_equal(prt_largest_magnitude(sets[s], x, 0), 0, 0);
        for (size_t n = 1; n <= 67; n++)
            for (size_t at = 0; at < n; at++) {
                struct guard g;
                for (size_t i = 0; i < n; i++) x[i] = i % 5 == 4 ? NAN : 1;
                x[at] = at % 2 ? 3 : -3;
                const float *in = guard_copy(&g, x, n * sizeof *x);
                assert_float_equal(prt_largest_magnitude(sets[s], in, n), 3, 0);
                guard_free(&g);
            }
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(words_are_those_of_the_format),
        cmocka_unit_test(nan_harms_no_neighbour),
        cmocka_unit_test(the_largest_is_found_at_every_place),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
