// SPDX-License-Identifier: MIT
// The progress of a bake from the stages that prt reports.
#include <setjmp.h>
#include <stdarg.h>
#include <stddef.h>
#include <stdint.h>

#include <cmocka.h>

#include "jobs/job_private.h"

static const char *const stages[] = {"irradiance", "hierarchy", "multiple scattering",
                                     "single scattering", "measuring"};

// A stage begins where the one before it ended, and the last one ends short of the whole: a
// bake is done when its file is open.
static void stages_follow_each_other(void **state)
{
    double at = 0;
    for (int i = 0; i < 5; i++) {
        double begin = job_overall(stages[i], 0, at);
        if (begin != at) fail_msg("%s begins at %g, not %g", stages[i], begin, at);
        double middle = job_overall(stages[i], 0.5, begin);
        double end = job_overall(stages[i], 1, middle);
        if (!(begin < middle && middle < end && end < 1))
            fail_msg("%s: %g, %g, %g", stages[i], begin, middle, end);
        at = end;
    }
}

// A stage that begins again, as the measuring of several lights does, takes nothing back.
static void progress_never_falls(void **state)
{
    double at = 0;
    for (int round = 0; round < 3; round++)
        for (int i = 0; i < 5; i++)
            for (int k = 0; k <= 10; k++) {
                double now = job_overall(stages[i], k / 10.0, at);
                if (now < at) fail_msg("%s: %g after %g", stages[i], now, at);
                at = now;
            }
}

static void other_stages_leave_it(void **state)
{
    assert_true(job_overall("surface", 0.9, 0.2) == 0.2);
    assert_true(job_overall("", 1, 0) == 0);
}

int main(void)
{
    const struct CMUnitTest tests[] = {
        cmocka_unit_test(stages_follow_each_other),
        cmocka_unit_test(progress_never_falls),
        cmocka_unit_test(other_stages_leave_it),
    };
    return cmocka_run_group_tests_name("jobs", tests, NULL, NULL);
}
