// SPDX-License-Identifier: MIT
// Numbers and names of a LOAD, before anything is done for it.
#include <math.h>
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>
#include <stdio.h>
#include <string.h>

#include <cmocka.h>

#include "ops/load.h"
#include "prt/bake_limits.h"

// NULL where the request is taken, else the fault, which names what is wrong.
static const char *fault_of(const Relight__LoadRequest *r)
{
    static char reason[128];
    reason[0] = 0;
    return load_bad_setting(r, reason);
}

static void expect_fault(const Relight__LoadRequest *r, const char *word)
{
    const char *fault = fault_of(r);
    if (!fault || !strstr(fault, word)) fail_msg("%s: %s", word, fault ? fault : "taken");
}

// Both ends of a range are taken, what lies beyond is not; 0 stands for none.
static void scales(void **state)
{
    static const struct {
        size_t offset;
        const char *name;
        float low, high;
    } cases[] = {{offsetof(Relight__LoadRequest, size_mm), "size_mm is", 1e-3f, 1e6f},
                 {offsetof(Relight__LoadRequest, mm_per_unit), "mm_per_unit is", 1e-9f, 1e9f}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        Relight__LoadRequest r = RELIGHT__LOAD_REQUEST__INIT;
        float *x = (float *)((char *)&r + cases[i].offset);
        const float good[] = {0, cases[i].low, 1, cases[i].high};
        const float bad[] = {nextafterf(cases[i].low, 0),
                             nextafterf(cases[i].high, INFINITY),
                             -1,
                             -cases[i].low,
                             INFINITY,
                             NAN};
        for (size_t j = 0; j < sizeof good / sizeof *good; j++) {
            *x = good[j];
            assert_null(fault_of(&r));
        }
        for (size_t j = 0; j < sizeof bad / sizeof *bad; j++) {
            *x = bad[j];
            expect_fault(&r, cases[i].name);
        }
    }
    Relight__LoadRequest r = RELIGHT__LOAD_REQUEST__INIT;
    r.size_mm = 100, r.mm_per_unit = 1;
    expect_fault(&r, "both");
}

static void variant_and_opaque(void **state)
{
    Relight__LoadRequest r = RELIGHT__LOAD_REQUEST__INIT;
    char name[65];
    memset(name, 'v', sizeof name);
    r.variant = name;
    name[63] = 0;
    assert_null(fault_of(&r));
    name[63] = 'v', name[64] = 0;
    expect_fault(&r, "variant");
    r.variant = "";
    r.n_opaque = MAX_OPAQUE;
    assert_null(fault_of(&r));
    r.n_opaque = MAX_OPAQUE + 1;
    expect_fault(&r, "opaque is");
}

// Each setting of a bake is checked by itself: one that is out of its range is named.
static void settings_of_a_bake(void **state)
{
    static const struct {
        size_t offset;
        uint32_t bad;
        const char *name;
    } cases[] = {{offsetof(Relight__BakeSettings, cube), 17, "cube"},
                 {offsetof(Relight__BakeSettings, phase_terms), 5, "phase"},
                 {offsetof(Relight__BakeSettings, samples), 1, "samples"},
                 {offsetof(Relight__BakeSettings, rank), 1000000, "rank"},
                 {offsetof(Relight__BakeSettings, coeffs), 5, "coeffs"},
                 {offsetof(Relight__BakeSettings, single_points), 1000000, "single"},
                 {offsetof(Relight__BakeSettings, walks), 1, "walks"},
                 {offsetof(Relight__BakeSettings, transport), 99, "transport is unknown"},
                 {offsetof(Relight__BakeSettings, storage), 99, "storage is unknown"},
                 {offsetof(Relight__BakeSettings, scattering), 99, "scattering is unknown"}};
    for (size_t i = 0; i < sizeof cases / sizeof *cases; i++) {
        Relight__LoadRequest r = RELIGHT__LOAD_REQUEST__INIT;
        Relight__BakeSettings b = RELIGHT__BAKE_SETTINGS__INIT;
        r.bake = &b;
        b.scattering = RELIGHT__SCATTERING__SCATTERING_WALK;
        assert_null(fault_of(&r));
        memcpy((char *)&b + cases[i].offset, &cases[i].bad, sizeof cases[i].bad);
        expect_fault(&r, cases[i].name);
    }
}

static void reals_of_a_bake(void **state)
{
    Relight__LoadRequest r = RELIGHT__LOAD_REQUEST__INIT;
    Relight__BakeSettings b = RELIGHT__BAKE_SETTINGS__INIT;
    r.bake = &b;
    static const float turns[] = {-1e6f, -30, 0, 1e6f}, wrong[] = {-2e6f, 2e6f, NAN};
    for (size_t i = 0; i < sizeof turns / sizeof *turns; i++) {
        b.rotate_deg = turns[i];
        assert_null(fault_of(&r));
    }
    for (size_t i = 0; i < sizeof wrong / sizeof *wrong; i++) {
        b.rotate_deg = wrong[i];
        expect_fault(&r, "bake.rotate_deg is");
    }
    b.rotate_deg = 0;
    b.max_error = 77;
    expect_fault(&r, "error");
    b.max_error = 0;
    b.walks = 1000; // a number that a bake by walks takes
    expect_fault(&r, "walks are for scattering walk");
    b.scattering = RELIGHT__SCATTERING__SCATTERING_WALK;
    assert_null(fault_of(&r));
}

static void names(void **state)
{
    static const char *const good[] = {"a",   "a.gltf", "a/b.bin",  "a/b/c", "a..b",
                                       "a b", "a./b",   "\xc3\xa4", "a-",    "a:b"};
    static const char *const bad[] = {"",
                                      "/a",
                                      ".a",
                                      "..",
                                      "../a",
                                      "a/../b",
                                      "a/.b",
                                      "a//b",
                                      "a/..",
                                      "a\\b",
                                      "a\n",
                                      "\x7f",
                                      "a\x7f",
                                      "a\x1f"
                                      "b",
                                      "./a",
                                      "a/b/../../c"};
    for (size_t i = 0; i < sizeof good / sizeof *good; i++)
        if (!load_safe_name(good[i])) fail_msg("refused: %s", good[i]);
    for (size_t i = 0; i < sizeof bad / sizeof *bad; i++)
        if (load_safe_name(bad[i])) fail_msg("taken: %s", bad[i]);
    char longest[202];
    memset(longest, 'n', sizeof longest);
    longest[200] = 0;
    assert_true(load_safe_name(longest));
    longest[200] = 'n', longest[201] = 0;
    assert_false(load_safe_name(longest));
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(scales),
        cmocka_unit_test(variant_and_opaque),
        cmocka_unit_test(settings_of_a_bake),
        cmocka_unit_test(reals_of_a_bake),
        cmocka_unit_test(names),
    };
    return cmocka_run_group_tests(tests, NULL, NULL);
}
