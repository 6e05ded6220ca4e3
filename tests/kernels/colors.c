// SPDX-License-Identifier: MIT
// Colours to RGB9E5 by every instruction set: equal to the definition, bit for bit.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "prt/picture.h"

// EXT_texture_shared_exponent, as it is written there.
static uint32_t reference(const float c[3])
{
    float v[3], high = 0;
    int e;
    for (int i = 0; i < 3; i++) {
        v[i] = c[i] > 0 ? fminf(c[i], 65408) : 0;
        high = fmaxf(high, v[i]);
    }
    frexpf(high, &e); // high = m 2^e, m in [0.5, 1)
    int exponent = (e > -15 ? e : -15) + 15;
    if (high == 0) exponent = 0;
    if ((int)floorf(ldexpf(high, 24 - exponent) + 0.5f) == 512) exponent++;
    uint32_t out = (uint32_t)exponent << 27;
    for (int i = 0; i < 3; i++)
        out |= (uint32_t)floorf(ldexpf(v[i], 24 - exponent) + 0.5f) << 9 * i;
    return out;
}

enum { N = 4099 };
static float rgb[3 * N];
static uint32_t out[N + 1];

static void fill(void)
{
    static const float odd[] = {
        0,           -0.0f,    -1,       NAN,           INFINITY,   -INFINITY,
        65408,       65407.9f, 65408.1f, 1e30f,         1e-30f,     0x1p-16f,
        0x1p-25f,    0x1p-24f, 511.5f,   511.49f,       1,          0.99902344f,
        0.99853516f, 2,        1e-40f,   0x1.ff7ffep3f, 0x1.ff8p3f, 0x1.fffffep9f};
    enum { N_ODD = sizeof odd / sizeof *odd };
    struct prt_rng rng;
    prt_rng_init(&rng, 3, 1);
    for (int i = 0; i < 3 * N; i++) {
        uint32_t bits = prt_rng_u32(&rng);
        rgb[i] = ldexpf((float)bits * 0x1p-32f, (int)(bits % 50) - 28);
        if (i % 7 == 0) rgb[i] = odd[bits % N_ODD];
    }
    for (int i = 0; i < N_ODD; i++) rgb[3 * i] = rgb[3 * i + 1] = rgb[3 * i + 2] = odd[i];
}

static void rgb9e5(void **state)
{
    struct prt_context ctx;
    fill();
    for (unsigned cpu = 0; cpu < 3; cpu++) {
        static const unsigned mask[] = {0, PRT_CPU_AVX2, PRT_CPU_AVX2 | PRT_CPU_AVX512};
        prt_context_init(&ctx);
        ctx.cpu = prt_cpu_detect() & mask[cpu];
        for (size_t n = N; n > N - 20; n--) {
            out[n] = 0xdeadbeef;
            prt_encode_rgb9e5(&ctx, rgb, n, out);
            assert_int_equal(out[n], 0xdeadbeef);
            for (size_t i = 0; i < n; i++)
                if (out[i] != reference(rgb + 3 * i))
                    fail_msg("%g %g %g: %08x, not %08x", (double)rgb[3 * i],
                             (double)rgb[3 * i + 1], (double)rgb[3 * i + 2], out[i],
                             reference(rgb + 3 * i));
        }
    }
    double start = prt_time_s();
    for (int i = 0; i < 200; i++) prt_encode_rgb9e5(NULL, rgb, N, out);
    print_message("%.2f ns a colour\n", (prt_time_s() - start) * 1e9 / (200.0 * N));
}

int main(void)
{
    const struct CMUnitTest tests[] = {cmocka_unit_test(rgb9e5)};
    return cmocka_run_group_tests_name("colors", tests, NULL, NULL);
}
