// SPDX-License-Identifier: MIT
// How far a bake is and how long it still takes, from the stages that prt reports: laws of the
// fraction, and recorded bakes, whose time left is foreseen.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include <math.h>

#include "jobs/pace.h"

static const char *const stages[] = {"irradiance", "hierarchy", "multiple-scattering",
                                     "single-scattering", "measuring"};

static struct pace plan_of(bool joint, uint32_t n_vertex, bool draft,
                           const struct pace_history *history)
{
    struct pace pace = {.fraction = 0};
    const struct pace_kind kind = {
        .joint = joint, .single = true, .draft = draft, .n_vertex = n_vertex};
    pace_plan(&pace, &kind, history);
    return pace;
}

// A stage begins where the one before it ended, and the last one ends short of the whole: a
// bake is done when its file is open.
static void stages_follow_each_other(void **state)
{
    const struct pace_history none = {0};
    struct pace p = plan_of(false, 0, false, &none);
    double at = 0;
    for (int i = 0; i < 5; i++) {
        pace_report(&p, false, stages[i], 0, i);
        if (fabs(p.fraction - at) > 1e-12)
            fail_msg("%s begins at %g, not %g", stages[i], p.fraction, at);
        pace_report(&p, false, stages[i], 0.5, i);
        double middle = p.fraction;
        pace_report(&p, false, stages[i], 1, i);
        if (!(at < middle && middle < p.fraction && p.fraction < 1))
            fail_msg("%s: %g, %g, %g", stages[i], at, middle, p.fraction);
        at = p.fraction;
    }
}

// A stage that begins again, as the measuring of several lights does, takes nothing back; nor
// does a number of vertices that becomes known in the middle.
static void progress_never_falls(void **state)
{
    const struct pace_history none = {0};
    struct pace p = plan_of(true, 0, true, &none);
    const struct pace_kind known = {
        .joint = true, .single = true, .draft = true, .n_vertex = 9};
    double at = 0;
    for (int round = 0; round < 3; round++)
        for (int i = 0; i < 5; i++)
            for (int k = 0; k <= 10; k++) {
                if (round == 1 && i == 2) pace_plan(&p, &known, &none);
                pace_report(&p, !round, stages[i], k / 10.0, 60 * round + 10 * i + k);
                if (p.fraction < at) fail_msg("%s: %g after %g", stages[i], p.fraction, at);
                at = p.fraction;
            }
}

static void other_stages_leave_it(void **state)
{
    const struct pace_history none = {0};
    struct pace p = plan_of(false, 0, false, &none);
    pace_report(&p, false, "irradiance", 0.5, 1);
    double at = p.fraction;
    pace_report(&p, false, "surface", 0.9, 2);
    pace_report(&p, false, "", 1, 2);
    pace_report(&p, true, "irradiance", 1, 2); // of a draft, in the bake
    assert_true(p.fraction == at);
    struct pace fresh = plan_of(false, 0, false, &none);
    assert_true(pace_left_s(&fresh, 5) < 0);
}

// ---- recorded bakes: CPU seconds at which prt reported a stage's fraction (spot, 3,225
// vertices, 50 mm, marble, 150,000 samples)

struct point {
    double s;
    const char *stage; // NULL: the end
    double fraction;
};
static const struct point spot_wavelet[] = {{0.2, "surface", 0.217},
                                            {0.3, "surface", 0.652},
                                            {0.8, "irradiance", 0.002},
                                            {4.9, "irradiance", 0.076},
                                            {9.1, "irradiance", 0.151},
                                            {13.2, "irradiance", 0.212},
                                            {17.3, "irradiance", 0.277},
                                            {21.5, "irradiance", 0.344},
                                            {25.6, "irradiance", 0.418},
                                            {29.7, "irradiance", 0.485},
                                            {33.8, "irradiance", 0.549},
                                            {37.9, "irradiance", 0.609},
                                            {42.0, "irradiance", 0.681},
                                            {46.1, "irradiance", 0.753},
                                            {50.3, "irradiance", 0.825},
                                            {54.4, "irradiance", 0.895},
                                            {58.5, "irradiance", 0.977},
                                            {59.6, "irradiance", 0.999},
                                            {59.8, "hierarchy", 0.051},
                                            {61.6, "hierarchy", 0.957},
                                            {62.0, "multiple-scattering", 0.013},
                                            {66.1, "multiple-scattering", 0.676},
                                            {72.1, "multiple-scattering", 0.250},
                                            {78.2, "multiple-scattering", 1.000},
                                            {82.2, "single-scattering", 0.125},
                                            {89.2, "single-scattering", 0.625},
                                            {92.6, "single-scattering", 0.875},
                                            {93.3, "measuring", 0.000},
                                            {97.5, "measuring", 0.775},
                                            {97.8, "measuring", 0.925},
                                            {97.8, NULL, 1}};
static const struct point spot_joint[] = {{0.1, "surface", 0.087},
                                          {0.6, "surface", 1.000},
                                          {1.4, "irradiance", 0.001},
                                          {7.6, "irradiance", 0.115},
                                          {13.8, "irradiance", 0.212},
                                          {20.0, "irradiance", 0.314},
                                          {26.2, "irradiance", 0.421},
                                          {32.4, "irradiance", 0.520},
                                          {38.6, "irradiance", 0.611},
                                          {44.8, "irradiance", 0.721},
                                          {50.9, "irradiance", 0.835},
                                          {57.1, "irradiance", 0.952},
                                          {59.5, "irradiance", 1.000},
                                          {59.5, "hierarchy", 0.016},
                                          {60.8, "hierarchy", 0.996},
                                          {61.0, "multiple-scattering", 0.001},
                                          {70.9, "multiple-scattering", 0.125},
                                          {78.7, "multiple-scattering", 0.500},
                                          {85.3, "multiple-scattering", 0.688},
                                          {90.0, "multiple-scattering", 0.938},
                                          {97.9, "single-scattering", 0.125},
                                          {106.2, "single-scattering", 0.375},
                                          {113.8, "single-scattering", 0.562},
                                          {123.2, "single-scattering", 0.812},
                                          {127.3, "single-scattering", 0.938},
                                          {138.1, "measuring", 0.000},
                                          {147.1, "measuring", 0.700},
                                          {147.7, "measuring", 0.925},
                                          {147.9, "hidden-sky", 0.308},
                                          {147.9, "hidden-sky", 0.846},
                                          {147.9, NULL, 1}};
static const struct point spot_walk[] = {{0.1, "by-walks", 0.000},
                                         {0.2, "surface", 0.043},
                                         {0.9, "irradiance", 0.000},
                                         {4.9, "irradiance", 0.079},
                                         {9.0, "irradiance", 0.157},
                                         {13.1, "irradiance", 0.228},
                                         {17.1, "irradiance", 0.308},
                                         {21.1, "irradiance", 0.382},
                                         {25.2, "irradiance", 0.461},
                                         {29.2, "irradiance", 0.532},
                                         {33.2, "irradiance", 0.599},
                                         {37.2, "irradiance", 0.675},
                                         {41.2, "irradiance", 0.758},
                                         {45.3, "irradiance", 0.844},
                                         {49.3, "irradiance", 0.926},
                                         {52.5, "hierarchy", 0.055},
                                         {54.7, "lit-samples", 0.013},
                                         {58.7, "lit-samples", 0.711},
                                         {74.9, "multiple-scattering", 0.125},
                                         {89.5, "multiple-scattering", 0.250},
                                         {100.1, "multiple-scattering", 0.375},
                                         {110.7, "multiple-scattering", 0.500},
                                         {125.3, "multiple-scattering", 0.625},
                                         {137.5, "multiple-scattering", 0.750},
                                         {151.9, "multiple-scattering", 0.875},
                                         {162.7, "multiple-scattering", 1.000},
                                         {164.8, "unscattered-light", 0.125},
                                         {169.6, "unscattered-light", 0.750},
                                         {172.7, "single-scattering", 0.125},
                                         {178.0, "single-scattering", 0.625},
                                         {182.3, "measuring", 0.000},
                                         {199.3, "measuring", 0.200},
                                         {213.2, "measuring", 0.400},
                                         {214.7, NULL, 1}};

// The largest error of the total time [1] after a tenth of it, while the bake is replayed.
static double replay(const struct point *point, struct pace_kind kind, double speed,
                     struct pace_history *history)
{
    struct pace p = {.fraction = 0};
    const struct point *end = point;
    double worst = 0;
    while (end->stage) end++;
    pace_plan(&p, &kind, history);
    for (; point->stage; point++) {
        if (pace_is_walk(point->stage)) {
            kind.walk = true;
            pace_plan(&p, &kind, history);
        }
        pace_report(&p, false, point->stage, point->fraction, point->s * speed);
        double left = pace_left_s(&p, point->s * speed);
        if (point->s < end->s / 10) continue;
        worst = fmax(worst, fabs(left - (end->s - point->s) * speed) / (end->s * speed));
    }
    pace_learn(&p, &kind, history, end->s * speed);
    return worst;
}

// The time left is foreseen within a fifth of the whole: of a bake like earlier ones, on a
// machine three times as slow, too. Without any before it, within a quarter.
static void time_left(void **state)
{
    static const struct {
        const char *name;
        const struct point *point;
        bool joint;
    } bake[] = {{"wavelet", spot_wavelet, false},
                {"joint", spot_joint, true},
                {"walks", spot_walk, false}};
    for (int i = 0; i < 3; i++) {
        const struct pace_kind kind = {
            .joint = bake[i].joint, .single = true, .n_vertex = 3225, .n_sample = 150000};
        struct pace_history history = {0};
        double first = replay(bake[i].point, kind, 1, &history);
        double second = replay(bake[i].point, kind, 3, &history);
        print_message("%s: off by %.0f %% of the whole at first, then %.0f %%\n", bake[i].name,
                      100 * first, 100 * second);
        assert_true(first < 0.25);
        assert_true(second < 0.2);
    }
}

// Law: after a bake whose single scattering took five times as long as planned, the next bakes
// plan with that time.
static void a_slow_stage_is_learned(void **state)
{
    const struct pace_kind kind = {.single = true, .n_vertex = 10000};
    struct pace_history history = {0};
    for (int round = 0; round < 4; round++) {
        struct pace p = plan_of(false, kind.n_vertex, false, &history);
        double now = 0, all = 0, at_single = 0;
        static const double seconds[] = {58, 2, 19, 235, 5.5};
        for (int i = 0; i < 5; i++) all += seconds[i];
        for (int i = 0; i < 5; i++) {
            pace_report(&p, false, stages[i], 0, now);
            if (i == 3) at_single = pace_left_s(&p, now);
            now += seconds[i];
            pace_report(&p, false, stages[i], 1, now);
        }
        double error = (at_single - (seconds[3] + seconds[4])) / all;
        print_message("round %d: at single scattering off by %.0f %%\n", round, 100 * error);
        assert_true(round ? fabs(error) < 0.02 : error < -0.3);
        pace_learn(&p, &kind, &history, now);
    }
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(stages_follow_each_other), cmocka_unit_test(progress_never_falls),
        cmocka_unit_test(other_stages_leave_it),    cmocka_unit_test(time_left),
        cmocka_unit_test(a_slow_stage_is_learned),
    };
    return cmocka_run_group_tests_name("jobs", tests, NULL, NULL);
}
